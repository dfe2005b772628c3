//! Dots on the gel of a touch sensor, and how a force along the gel moves them.
//!
//! Lengths along the gel are millimetres to the right and downwards in the sensor's image, from the middle of the gel; angles turn right
//! towards down. The motion of the gel is that of FOTS (Zhao et al., 2024, arXiv 2404.19217): dilation, shear and twist, each of which fades
//! with the square of the distance from the contact.

use mvt_settings::{SettingError, settings};

settings! {
    /// Rectangular pattern of dark dots on the gel.
    #[derive(Copy)]
    pub struct MarkerPattern {
        /// Dots from left to right.
        pub columns: usize = 8, 3..=40;
        /// Dots from top to bottom.
        pub rows: usize = 9, 3..=60;
        /// Distance between neighbours, millimetres.
        pub pitch_mm: f64 = 1.38, 0.4..=6.0;
        /// Diameter of a dot, millimetres.
        pub diameter_mm: f64 = 0.4, 0.15..=3.0;
        /// Share of the light that a dot swallows.
        pub darkness: f32 = 0.6, 0.1..=1.0;
    }
    rule = MarkerPattern::lie_apart;
}

/// Widest dot, in shares of the pitch: neighbours that move must stay apart.
const WIDEST: f64 = 0.6;

impl MarkerPattern {
    /// Checks that dots lie apart.
    fn lie_apart(&self) -> Result<(), SettingError> {
        if self.diameter_mm > WIDEST * self.pitch_mm {
            let range = format!("at most {WIDEST} times pitch_mm");
            return Err(SettingError::new("diameter_mm", self.diameter_mm.to_string(), range));
        }
        Ok(())
    }

    /// Checks that the dots lie on a gel of this size along the image's columns and rows, millimetres.
    pub(super) fn check_on(&self, size_mm: [f64; 2]) -> Result<(), SettingError> {
        for (name, count, gel_mm) in [("columns", self.columns, size_mm[0]), ("rows", self.rows, size_mm[1])] {
            let wide_mm = (count - 1) as f64 * self.pitch_mm;
            if wide_mm > gel_mm {
                let range = format!("so few that they lie on a gel of {gel_mm} mm (they take {wide_mm:.1} mm)");
                return Err(SettingError::new(name, count.to_string(), range));
            }
        }
        Ok(())
    }

    /// Returns the places of the dots of an unloaded gel, row by row from the top left, millimetres to the right and downwards.
    pub fn places_mm(&self) -> impl Iterator<Item = [f64; 2]> + use<> {
        let Self { columns, rows, pitch_mm, .. } = *self;
        let from_middle = move |i: usize, count: usize| (i as f64 - 0.5 * (count - 1) as f64) * pitch_mm;
        (0..rows)
            .flat_map(move |row| (0..columns).map(move |column| [from_middle(column, columns), from_middle(row, rows)]))
    }
}

/// How a force along the gel has moved its surface where an object holds it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct GelShear {
    /// Displacement at the contact, millimetres to the right and downwards in the sensor's image.
    pub displacement_mm: [f64; 2],
    /// Turn about the gel's normal at the contact, radians from right to down.
    pub twist_rad: f64,
}

/// Pixels per millimetre of the DIGIT on which FOTS measured its decays.
const FOTS_PX_PER_MM: f64 = 19.58;
/// Decay of shear with the square of the distance, 1/mm^2: 0.00021 px^-2 in FOTS.
pub const SHEAR_DECAY: f64 = 0.000_21 * FOTS_PX_PER_MM * FOTS_PX_PER_MM;
/// Decay of twist with the square of the distance, 1/mm^2: 0.00038 px^-2 in FOTS.
pub const TWIST_DECAY: f64 = 0.000_38 * FOTS_PX_PER_MM * FOTS_PX_PER_MM;
/// Decay of dilation with the square of the distance, 1/mm^2: 0.00125 px^-2 in FOTS.
pub const DILATION_DECAY: f64 = 0.001_25 * FOTS_PX_PER_MM * FOTS_PX_PER_MM;
/// Largest twist that FOTS applies, radians: 50 degrees.
const MOST_TWIST_RAD: f64 = 50.0 * std::f64::consts::PI / 180.0;

// Why: notes/decisions/touch.md, "Dots move by FOTS's formula, with a limit for dilation".
/// Greatest dilation, millimetres. The presses that FOTS measured reach less; its sum over a wide and deep contact would throw dots across
/// their neighbours.
const MOST_DILATION_MM: f64 = 0.4;

/// Motion of a gel that an object presses and drags.
#[derive(Debug, Clone, PartialEq)]
pub struct GelMotion {
    /// Middle of the contact, millimetres to the right and downwards.
    pub centre_mm: [f64; 2],
    /// Displacement and turn at the contact.
    pub shear: GelShear,
    /// Places in contact, each with how far the gel is pressed in there, millimetres: the gel dilates around each.
    pub pressed: Vec<([f64; 2], f64)>,
}

impl GelMotion {
    /// Returns where a place on the unloaded gel has moved to, millimetres to the right and downwards: dilation first, then shear, then
    /// twist, as in FOTS, whose dilation is limited here. Shear acts around the place from which the touched gel has come, twist around the place where it is.
    pub fn moved(&self, place_mm: [f64; 2]) -> [f64; 2] {
        let GelMotion { centre_mm, shear: GelShear { displacement_mm, twist_rad }, pressed } = self;
        let mut spread = [0.0; 2];
        for (middle, pressed_mm) in pressed {
            let ([x, y], fades) = fading(place_mm, *middle, DILATION_DECAY);
            spread = [spread[0] + pressed_mm * x * fades, spread[1] + pressed_mm * y * fades];
        }
        let kept = (MOST_DILATION_MM / spread[0].hypot(spread[1]).max(1e-12)).min(1.0);
        let place = [place_mm[0] + kept * spread[0], place_mm[1] + kept * spread[1]];
        let come_from = [centre_mm[0] - displacement_mm[0], centre_mm[1] - displacement_mm[1]];
        let (_, fades) = fading(place, come_from, SHEAR_DECAY);
        let place = [place[0] + displacement_mm[0] * fades, place[1] + displacement_mm[1] * fades];
        let ([x, y], fades) = fading(place, *centre_mm, TWIST_DECAY);
        let (sin, cos) = twist_rad.clamp(-MOST_TWIST_RAD, MOST_TWIST_RAD).sin_cos();
        [place[0] + (x * cos - y * sin - x) * fades, place[1] + (x * sin + y * cos - y) * fades]
    }
}

/// Returns the way from a middle to a place, and how much of a motion at the middle is left there.
pub fn fading(place_mm: [f64; 2], middle_mm: [f64; 2], decay: f64) -> ([f64; 2], f64) {
    let way = [place_mm[0] - middle_mm[0], place_mm[1] - middle_mm[1]];
    (way, (-decay * (way[0] * way[0] + way[1] * way[1])).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_that_cannot_be_are_refused() {
        let refused = |change: fn(&mut MarkerPattern)| {
            let mut pattern = MarkerPattern::default();
            change(&mut pattern);
            pattern.validate().unwrap_err().to_string()
        };
        MarkerPattern::default().validate().unwrap();
        assert!(refused(|p| p.pitch_mm = 0.1).contains("pitch_mm must be from 0.4"));
        assert!(refused(|p| p.pitch_mm = f64::NAN).contains("pitch_mm"));
        assert!(refused(|p| p.diameter_mm = 1.2).contains("diameter_mm must be at most 0.6 times pitch_mm"));
        let wide = MarkerPattern { pitch_mm: 4.0, ..MarkerPattern::default() };
        wide.check_on([40.0, 40.0]).unwrap();
        let error = wide.check_on([20.0, 30.0]).unwrap_err().to_string();
        assert!(error.contains("columns must be so few that they lie on a gel of 20 mm"), "{error}");
    }

    #[test]
    fn dots_lie_in_rows_around_the_middle() {
        let places: Vec<_> =
            MarkerPattern { columns: 3, rows: 5, pitch_mm: 2.0, ..Default::default() }.places_mm().collect();
        assert_eq!(places.len(), 15);
        assert_eq!([places[0], places[7], places[14]], [[-2.0, -4.0], [0.0, 0.0], [2.0, 4.0]]);
    }

    /// The formulas of FOTS in its own units: pixels of 1/19.58 mm.
    #[test]
    fn motion_is_that_of_fots() {
        let (centre, shear, twist) = ([31.0, -12.0], [14.0, -9.0], 0.2_f64);
        let pressed = [([25.0, -20.0], 0.5), ([40.0, -5.0], 0.3)];
        let mm = |px: [f64; 2]| px.map(|x| x / 19.58);
        let motion = GelMotion {
            centre_mm: mm(centre),
            shear: GelShear { displacement_mm: mm(shear), twist_rad: twist },
            pressed: pressed.map(|(place, mm_deep)| (mm(place), mm_deep)).into(),
        };
        for start in [[0.0, 0.0], [30.0, -10.0], [-50.0, 70.0]] {
            let gauss = |p: [f64; 2], c: [f64; 2], lambda: f64| {
                f64::exp(-((p[0] - c[0]).powi(2) + (p[1] - c[1]).powi(2)) * lambda)
            };
            let mut p = start;
            for (c, h) in pressed {
                for axis in 0..2 {
                    p[axis] += h * (start[axis] - c[axis]) * gauss(start, c, 0.00125);
                }
            }
            let g = gauss(p, [centre[0] - shear[0], centre[1] - shear[1]], 0.00021);
            p = [p[0] + shear[0] * g, p[1] + shear[1] * g];
            let (g, dx, dy) = (gauss(p, centre, 0.00038), p[0] - centre[0], p[1] - centre[1]);
            let turned = [dx * twist.cos() - dy * twist.sin(), dx * twist.sin() + dy * twist.cos()];
            p = [p[0] + (turned[0] - dx) * g, p[1] + (turned[1] - dy) * g];
            let moved = motion.moved(mm(start));
            assert!((moved[0] - p[0] / 19.58).hypot(moved[1] - p[1] / 19.58) < 1e-12, "{moved:?} {p:?}");
        }
    }
}
