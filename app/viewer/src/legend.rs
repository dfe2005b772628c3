//! Legends of the colours of a scene, and its scale bar.

use image::Rgb;

use mvt_picture::palette::{self, Theme};
use mvt_recording::Recording;

use crate::eye::Eye;
use crate::layers::{Clouds, Colouring, Layers};
use crate::seen_points::SeenBy;

/// Meaning of the colours of a part of the scene.
pub enum Legend {
    /// A colour map of numbers.
    Ramp {
        /// Quantity and unit.
        title: &'static str,
        /// Numbers at the beginning, in the middle and at the end.
        labels: [&'static str; 3],
        /// Colour at a share of the length, 0 to 1.
        colour: fn(f32) -> Rgb<u8>,
    },
    /// Colours with their names.
    Names {
        /// The coloured quantity.
        title: &'static str,
        /// The colours.
        names: Vec<(Rgb<u8>, &'static str)>,
    },
}

impl Legend {
    /// Returns the legends for these layers, in the order from bottom to top: of the estimated surface, of the true
    /// surface, of the slice and of the points.
    pub fn of(layers: &Layers, recording: &Recording, theme: &Theme) -> Vec<Self> {
        let layers = &layers.of(recording);
        let has_estimate = recording.about().mode.is_some();
        let mut legends = Vec::new();
        if layers.mesh && has_estimate {
            legends.push(Self::of_surface(layers.colouring, theme));
        }
        if layers.truth && has_estimate && recording.true_mesh().is_some() {
            legends.push(Self::Names { title: "", names: vec![(theme.truth, "true surface, translucent")] });
        }
        if layers.slice && has_estimate {
            let colour = |share: f32| palette::signed_distance((2.0 * share - 1.0) * palette::SLICE_SCALE_M);
            legends.push(Self::Ramp { title: "slice: distance, mm", labels: ["-10 inside", "0", "10"], colour });
        }
        let by = |by: SeenBy, name| (by.colour(), name);
        let names = match layers.clouds {
            Clouds::None => Vec::new(),
            Clouds::Vision => vec![by(SeenBy::Vision, "camera")],
            Clouds::Touch => vec![by(SeenBy::Touch, "touch")],
            Clouds::Both => vec![by(SeenBy::Vision, "camera"), by(SeenBy::Touch, "touch")],
        };
        if !names.is_empty() {
            legends.push(Self::Names { title: "points:", names });
        }
        legends
    }

    fn of_surface(colouring: Colouring, theme: &Theme) -> Self {
        match colouring {
            Colouring::Error => {
                let colour = |share: f32| palette::surface_error(share * palette::ERROR_SCALE_M);
                Self::Ramp { title: "error, mm", labels: ["0", "2.5", "5+"], colour }
            }
            Colouring::Confidence => {
                Self::Ramp { title: "seen", labels: ["never", "", "often"], colour: palette::confidence }
            }
            Colouring::Sensor => {
                let names = [(SeenBy::Vision, "camera"), (SeenBy::Touch, "touch"), (SeenBy::Nothing, "none")];
                Self::Names { title: "seen by:", names: names.map(|(by, name)| (by.colour(), name)).into() }
            }
            Colouring::TrueColour => Self::Names { title: "camera colours;", names: vec![(theme.surface, "unseen")] },
            Colouring::Normals => {
                const DIRECTIONS: [([f32; 3], &str); 6] = [
                    ([1.0, 0.0, 0.0], "+x"),
                    ([-1.0, 0.0, 0.0], "-x"),
                    ([0.0, 1.0, 0.0], "+y"),
                    ([0.0, -1.0, 0.0], "-y"),
                    ([0.0, 0.0, 1.0], "+z"),
                    ([0.0, 0.0, -1.0], "-z"),
                ];
                let names = DIRECTIONS.map(|(direction, name)| (palette::normal(direction), name)).into();
                Self::Names { title: "faces to", names }
            }
        }
    }
}

/// Returns a round length of about a sixth of the picture's height at the target, metres.
pub fn scale_bar_m(eye: &Eye, height: usize) -> f64 {
    let aim = eye.metres_per_pixel(height) * height as f64 / 6.0;
    let lengths_m = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5];
    lengths_m.into_iter().rev().find(|length| *length <= aim).unwrap_or(0.001)
}
