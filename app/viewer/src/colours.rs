//! All colours: light and dark, and the maps that stand for numbers. All maps read the same for people who see red and green alike.

use image::Rgb;

/// The colours of everything that is not data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Theme {
    /// Behind everything.
    pub paper: Rgb<u8>,
    /// Behind groups of things.
    pub panel: Rgb<u8>,
    /// Text and lines.
    pub ink: Rgb<u8>,
    /// Text and lines that matter less.
    pub faint: Rgb<u8>,
    /// Links of the hand.
    pub link: Rgb<u8>,
    /// Housings of the DIGITs.
    pub digit: Rgb<u8>,
    /// Gels of the DIGITs.
    pub gel: Rgb<u8>,
    /// A surface without data.
    pub surface: Rgb<u8>,
    /// The true surface.
    pub truth: Rgb<u8>,
    /// The estimated trajectory.
    pub estimate: Rgb<u8>,
    /// Where a frame has been kept.
    pub keyframe: Rgb<u8>,
    /// Where the object was lost, and what is amiss.
    pub lost: Rgb<u8>,
}

impl Theme {
    /// On white paper.
    pub const LIGHT: Self = Self {
        paper: Rgb([250, 250, 248]),
        panel: Rgb([238, 239, 240]),
        ink: Rgb([34, 38, 46]),
        faint: Rgb([138, 144, 152]),
        link: Rgb([112, 118, 126]),
        digit: Rgb([176, 180, 186]),
        gel: Rgb([226, 150, 84]),
        surface: Rgb([214, 216, 214]),
        truth: Rgb([86, 156, 112]),
        estimate: Rgb([40, 98, 178]),
        keyframe: Rgb([204, 121, 167]),
        lost: Rgb([196, 84, 0]),
    };
    /// In the dark.
    pub const DARK: Self = Self {
        paper: Rgb([24, 26, 30]),
        panel: Rgb([36, 39, 44]),
        ink: Rgb([226, 228, 232]),
        faint: Rgb([128, 134, 142]),
        link: Rgb([92, 98, 106]),
        digit: Rgb([140, 144, 150]),
        gel: Rgb([216, 140, 74]),
        surface: Rgb([196, 198, 196]),
        truth: Rgb([104, 180, 132]),
        estimate: Rgb([110, 168, 240]),
        keyframe: Rgb([214, 137, 180]),
        lost: Rgb([240, 136, 62]),
    };
}

/// Which sensor saw a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SeenBy {
    /// A camera.
    Vision,
    /// A DIGIT.
    Touch,
    /// None: the field has made it up.
    Nothing,
}

impl SeenBy {
    /// Its colour (Okabe and Ito's blue, vermilion and grey).
    pub fn colour(self) -> Rgb<u8> {
        match self {
            Self::Vision => Rgb([86, 180, 233]),
            Self::Touch => Rgb([213, 94, 0]),
            Self::Nothing => Rgb([170, 170, 170]),
        }
    }
}

/// Colours of curves that have to be told apart (Okabe and Ito), readable on either paper.
pub const CURVES: [Rgb<u8>; 4] = [Rgb([0, 114, 178]), Rgb([213, 94, 0]), Rgb([0, 158, 115]), Rgb([204, 121, 167])];

/// Signed distance at which the map of slices is darkest, metres.
pub const SLICE_SCALE_M: f32 = 0.01;

/// The colour of a signed distance: white at the surface, blue inside, brown outside, darker with the distance. The same lightness on
/// either side, so that white stands out.
pub fn signed_distance(distance_m: f32) -> Rgb<u8> {
    const INSIDE: [[u8; 3]; 2] = [[116, 173, 209], [49, 54, 149]];
    const OUTSIDE: [[u8; 3]; 2] = [[223, 164, 96], [120, 62, 10]];
    let share = (distance_m / SLICE_SCALE_M).clamp(-1.0, 1.0);
    let [middle, end] = if share < 0.0 { INSIDE } else { OUTSIDE };
    ramp(&[[250; 3], middle, end], share.abs())
}

/// The colour of a share from 0 (never seen) to 1 (certain): dark blue to yellow, lighter all the way (after cividis).
pub fn confidence(share: f32) -> Rgb<u8> {
    ramp(&[[0, 34, 78], [67, 78, 108], [125, 124, 120], [188, 175, 111], [254, 232, 56]], share)
}

/// The colour of a depth between two bounds: near is light. Paper grey for nothing.
pub fn depth(depth_m: f32, [near_m, far_m]: [f32; 2]) -> Rgb<u8> {
    if depth_m > 0.0 { confidence(1.0 - (depth_m - near_m) / (far_m - near_m)) } else { Rgb([90, 90, 94]) }
}

/// The colour of an indentation up to `most_mm`: none is nearly black, much is light.
pub fn indentation(depth_mm: f32, most_mm: f32) -> Rgb<u8> {
    ramp(&[[18, 20, 30], [70, 40, 110], [180, 70, 90], [245, 150, 70], [252, 240, 180]], depth_mm / most_mm)
}

/// The colour of a direction.
pub fn normal([x, y, z]: [f32; 3]) -> Rgb<u8> {
    Rgb([x, y, z].map(|c| (127.5 + 127.5 * c).clamp(0.0, 255.0) as u8))
}

/// Colours of the axes x, y and z (Okabe and Ito's vermilion, bluish green and blue).
pub const AXES: [Rgb<u8>; 3] = [Rgb([213, 94, 0]), Rgb([0, 158, 115]), Rgb([0, 114, 178])];

/// Between evenly spaced colours; the first for what is not a number.
fn ramp(steps: &[[u8; 3]], share: f32) -> Rgb<u8> {
    let position = share.clamp(0.0, 1.0).max(0.0) * (steps.len() - 1) as f32;
    let low = (position as usize).min(steps.len().saturating_sub(2));
    let within = position - low as f32;
    Rgb(std::array::from_fn(|c| {
        let [a, b] = [steps[low][c], steps[low + 1][c]].map(f32::from);
        (a + (b - a) * within).round() as u8
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lightness(colour: Rgb<u8>) -> f32 {
        let [r, g, b] = colour.0.map(f32::from);
        0.2126 * r + 0.7152 * g + 0.0722 * b
    }

    fn is_rising(colours: impl Iterator<Item = Rgb<u8>>) -> bool {
        let steps: Vec<f32> = colours.map(lightness).collect();
        steps.windows(2).all(|pair| pair[1] > pair[0])
    }

    #[test]
    fn lightness_tells_the_order() {
        let shares = || (0..=40).map(|k| k as f32 / 40.0);
        assert!(is_rising(shares().map(confidence)));
        assert!(is_rising(shares().map(|share| indentation(2.0 * share, 2.0))));
        assert!(is_rising(shares().map(|share| depth(0.4 - 0.2 * share, [0.2, 0.4]))));
        for side in [-1.0, 1.0] {
            assert!(is_rising(shares().map(|share| signed_distance(side * (1.0 - share) * SLICE_SCALE_M))));
        }
        assert_eq!(signed_distance(0.0), Rgb([250; 3]));
        assert_eq!(signed_distance(1.0), signed_distance(SLICE_SCALE_M));
    }

    #[test]
    fn what_is_no_number_has_a_colour() {
        for wrong in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let _ = (signed_distance(wrong), confidence(wrong), depth(wrong, [0.0, 0.0]), indentation(wrong, 0.0));
            let _ = normal([wrong; 3]);
        }
    }

    /// Distance of two colours as somebody without red (or green) cones sees them (Vienot, Brettel and Mollon 1999), 0 to about 440.
    fn distance_dichromatic(a: Rgb<u8>, b: Rgb<u8>) -> f32 {
        let seen = |colour: Rgb<u8>| {
            let [r, g, b] = colour.0.map(|c| (f32::from(c) / 255.0).powf(2.2));
            let yellow = 0.292_75 * r + 0.707_25 * g;
            [yellow, yellow, -0.022_34 * r + 0.022_34 * g + b].map(|c| c.max(0.0).powf(1.0 / 2.2) * 255.0)
        };
        let (a, b) = (seen(a), seen(b));
        (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f32>().sqrt()
    }

    #[test]
    fn sensors_differ_for_people_who_see_red_and_green_alike() {
        let all = [SeenBy::Vision, SeenBy::Touch, SeenBy::Nothing].map(SeenBy::colour);
        for (k, a) in all.into_iter().enumerate() {
            for b in &all[..k] {
                assert!(distance_dichromatic(a, *b) > 50.0, "{a:?} and {b:?}");
            }
        }
        for theme in [Theme::LIGHT, Theme::DARK] {
            assert!(distance_dichromatic(theme.truth, theme.estimate) > 50.0);
            assert!((lightness(theme.ink) - lightness(theme.paper)).abs() > 150.0);
        }
    }
}
