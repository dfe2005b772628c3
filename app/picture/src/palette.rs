//! All colours: a light and a dark theme, and colour maps of numbers. People who confuse red and green can read every
//! map.

use image::Rgb;

/// Colours of everything that is not data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct Theme {
    /// Background.
    pub paper: Rgb<u8>,
    /// Background of panels and plots.
    pub panel: Rgb<u8>,
    /// Text and lines.
    pub ink: Rgb<u8>,
    /// Less important text and lines.
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
    /// Keyframes.
    pub keyframe: Rgb<u8>,
    /// Times at which the object is lost, and problems.
    pub lost: Rgb<u8>,
}

impl Theme {
    /// Dark ink on light paper.
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
    /// Light ink on dark paper.
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

/// Places that cameras saw (Okabe and Ito's blue).
pub const VISION: Rgb<u8> = Rgb([86, 180, 233]);
/// Places that touch sensors saw (Okabe and Ito's vermilion).
pub const TOUCH: Rgb<u8> = Rgb([213, 94, 0]);
/// Places that no sensor saw.
pub const UNSEEN: Rgb<u8> = Rgb([170, 170, 170]);

/// Colours of curves in one plot (Okabe and Ito): blue, vermilion, green and purple, readable in both themes.
pub const CURVES: [Rgb<u8>; 4] = [Rgb([0, 114, 178]), Rgb([213, 94, 0]), Rgb([0, 158, 115]), Rgb([204, 121, 167])];

/// Returns the colour of a pad everywhere (Okabe and Ito), distinct also to people who cannot distinguish red and green. The first four are those
/// of index, middle, ring and thumb; after eight they repeat.
pub fn pad_colour(pad: usize) -> Rgb<u8> {
    const COLOURS: [[u8; 3]; 8] = [
        [0, 114, 178],
        [230, 159, 0],
        [0, 158, 115],
        [204, 121, 167],
        [213, 94, 0],
        [86, 180, 233],
        [150, 140, 40],
        [110, 110, 110],
    ];
    Rgb(COLOURS[pad % COLOURS.len()])
}

/// Spans of a plot in which the object is lost (Okabe and Ito's orange), drawn translucent.
pub const LOST_SPAN: Rgb<u8> = Rgb([230, 159, 0]);

/// Signed distance at which the map of slices is darkest, metres.
pub const SLICE_SCALE_M: f32 = 0.01;

/// Returns the colour of a signed distance: white at the surface, blue inside, brown outside, darker with the distance.
/// Both sides have the same lightness, so that the surface stands out.
pub fn signed_distance(distance_m: f32) -> Rgb<u8> {
    const INSIDE: [[u8; 3]; 2] = [[116, 173, 209], [49, 54, 149]];
    const OUTSIDE: [[u8; 3]; 2] = [[223, 164, 96], [120, 62, 10]];
    let share = (distance_m / SLICE_SCALE_M).clamp(-1.0, 1.0);
    let [middle, end] = if share < 0.0 { INSIDE } else { OUTSIDE };
    ramp(&[[250; 3], middle, end], share.abs())
}

/// Returns the colour of a share from 0 (never seen) to 1 (certain): dark blue to yellow, lighter all the way (after
/// cividis).
pub fn confidence(share: f32) -> Rgb<u8> {
    ramp(&[[0, 34, 78], [67, 78, 108], [125, 124, 120], [188, 175, 111], [254, 232, 56]], share)
}

/// Returns the colour of a depth between two bounds: near is light. Pixels without a depth are grey.
pub fn depth(depth_m: f32, [near_m, far_m]: [f32; 2]) -> Rgb<u8> {
    if depth_m > 0.0 { confidence(1.0 - (depth_m - near_m) / (far_m - near_m)) } else { Rgb([90, 90, 94]) }
}

/// Returns the colour of an indentation up to `most_mm`: 0 is nearly black, `most_mm` is light.
pub fn indentation(depth_mm: f32, most_mm: f32) -> Rgb<u8> {
    ramp(&[[18, 20, 30], [70, 40, 110], [180, 70, 90], [245, 150, 70], [252, 240, 180]], depth_mm / most_mm)
}

/// Error from which on the colour of an error no longer changes, metres: the threshold of the headline F-score.
pub const ERROR_SCALE_M: f32 = 0.005;

/// Returns the colour of a distance from the true surface, metres: from pale over orange to dark red. The lightness
/// falls all the way, so that the map is readable in grey and for people who confuse red and green. Small errors are
/// pale, so that shading remains visible. NaN has the colour of the largest error.
pub fn surface_error(error_m: f32) -> Rgb<u8> {
    const STEPS: [[u8; 3]; 5] = [[236, 236, 228], [250, 204, 116], [232, 130, 52], [188, 58, 46], [92, 20, 58]];
    let share = error_m.abs() / ERROR_SCALE_M;
    ramp(&STEPS, if share < 1.0 { share } else { 1.0 })
}

/// Returns the colour of a unit vector: red, green and blue grow with x, y and z.
pub fn normal([x, y, z]: [f32; 3]) -> Rgb<u8> {
    Rgb([x, y, z].map(|c| (127.5 + 127.5 * c).clamp(0.0, 255.0) as u8))
}

/// Colours of the axes x, y and z (Okabe and Ito's vermilion, bluish green and blue).
pub const AXES: [Rgb<u8>; 3] = [Rgb([213, 94, 0]), Rgb([0, 158, 115]), Rgb([0, 114, 178])];

/// Interpolates between evenly spaced colours; NaN gives the first.
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
    fn lightness_follows_the_number() {
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
    fn numbers_that_are_not_finite_have_a_colour() {
        for wrong in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let _ = (signed_distance(wrong), confidence(wrong), depth(wrong, [0.0, 0.0]), indentation(wrong, 0.0));
            let _ = normal([wrong; 3]);
        }
    }

    /// Returns the distance between two colours for a person without red (or green) cones (Vienot, Brettel and Mollon
    /// 1999), 0 to about 440.
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
    fn sensors_differ_for_people_who_confuse_red_and_green() {
        let all = [VISION, TOUCH, UNSEEN];
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

    #[test]
    fn a_larger_error_is_darker_up_to_full_scale() {
        let steps: Vec<f32> = (0..=20).map(|k| lightness(surface_error(ERROR_SCALE_M * k as f32 / 20.0))).collect();
        assert!(steps.windows(2).all(|pair| pair[1] < pair[0]), "{steps:?}");
        for error_m in [1.0, f32::INFINITY, f32::NAN] {
            assert_eq!(surface_error(error_m), surface_error(ERROR_SCALE_M));
        }
        assert_eq!(surface_error(-0.001), surface_error(0.001));
    }
}
