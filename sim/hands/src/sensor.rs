//! Bodies of the touch sensors that are mounted on hands.

use mvt_robot::hand::{Inertial, Part, PartSurface, Primitive, UPRIGHT};
use serde::{Deserialize, Serialize};

/// Body of a touch sensor: its housing and its gel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorHousing {
    /// A DIGIT.
    Digit,
    /// A GelSight Mini.
    GelsightMini,
}

impl SensorHousing {
    /// Returns the body of the sensors that a shipped profile describes; `None` for a file.
    pub fn of_profile(name: &str) -> Option<Self> {
        match name {
            "digit" | "digit_markers" | "tacto" => Some(Self::Digit),
            "gelsight_mini" | "gelsight_mini_markers" => Some(Self::GelsightMini),
            _ => None,
        }
    }

    /// Returns the housing and the gel in the gel frame: x out of the gel from the camera, z up in the image. The gel is that of the pad of
    /// this index.
    pub(crate) fn parts(self, pad: usize) -> Vec<Part> {
        let (housing, gel) = match self {
            Self::Digit => (
                // Narrower than the gel; otherwise its hard edge would touch first at 45 degrees.
                block([0.005_882, 0.0, -0.000_745], [0.009_75, 0.0115, 0.0155]),
                // More domed than TACTO's gel, so that a touch has one contact point; as on the fingertips of the built-in Allegro.
                Primitive::Ellipsoid {
                    centre: [0.013_232, 0.0, -0.001_045],
                    semi: [0.009, 0.0128, 0.0165],
                    orientation_wxyz: UPRIGHT,
                },
            ),
            // 32 x 28 x 28 mm with the gel, of which 3 mm stand out of the housing. The gel is 25.25 mm long and 20.75 mm wide, and its flat
            // front lies 22 mm before the camera, as in the profile.
            Self::GelsightMini => (
                block([0.0065, 0.0, 0.0], [0.0125, 0.014, 0.016]),
                block([0.0195, 0.0, 0.0], [0.0025, 0.010_375, 0.012_625]),
            ),
        };
        vec![
            Part { surface: PartSurface::Housing, shape: housing },
            Part { surface: PartSurface::Gel(pad), shape: gel },
        ]
    }

    /// Returns its mass, in the gel frame. That of a GelSight Mini is assumed to be a DIGIT's.
    pub(crate) fn inertial(self) -> Inertial {
        let (centre_m, diagonal) = match self {
            Self::Digit => ([0.007_132, 0.0, -0.000_545], [3.5e-6, 3e-6, 2.5e-6]),
            Self::GelsightMini => ([0.0075, 0.0, 0.0], [3e-6, 3e-6, 2.6e-6]),
        };
        Inertial { mass_kg: 0.020, centre_m, orientation_wxyz: UPRIGHT, diagonal }
    }
}

fn block(centre: [f64; 3], half: [f64; 3]) -> Primitive {
    Primitive::Box { centre, half, orientation_wxyz: UPRIGHT }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvt_robot::digit::gel::APEX_M;

    #[test]
    fn gels_end_at_the_apex_and_stand_out_of_their_housing() {
        for sensor in [SensorHousing::Digit, SensorHousing::GelsightMini] {
            let parts = sensor.parts(2);
            let front = |part: &Part| match &part.shape {
                Primitive::Box { centre, half, .. } => centre[0] + half[0],
                Primitive::Ellipsoid { centre, semi, .. } => centre[0] + semi[0],
                other => panic!("{other:?}"),
            };
            assert_eq!(parts[1].surface, PartSurface::Gel(2));
            assert!((front(&parts[1]) - APEX_M).abs() < 0.3e-3);
            assert!(front(&parts[0]) < front(&parts[1]) - 2e-3);
        }
    }
}
