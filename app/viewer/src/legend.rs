//! Legend of the colours of a scene, and its scale bar.

use image::Rgb;

use mvt_picture::palette;
use mvt_recording::Recording;

use crate::eye::Eye;
use crate::layers::{Colouring, Layers};
use crate::seen_points::SeenBy;

/// Meaning of the colours of a scene.
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
    /// Names of sensors.
    Names([(SeenBy, &'static str); 3]),
}

impl Legend {
    /// Returns the legend for these layers, or `None` where colours have no meaning that needs one.
    pub fn of(layers: &Layers, recording: &Recording) -> Option<Self> {
        if layers.slice {
            let colour = |share: f32| palette::signed_distance((2.0 * share - 1.0) * palette::SLICE_SCALE_M);
            return Some(Self::Ramp { title: "distance, mm", labels: ["-10", "0", "10"], colour });
        }
        let is_estimated = recording.moments().first().is_some_and(|moment| moment.estimate().is_some());
        if !layers.mesh || !is_estimated {
            return None;
        }
        match layers.colouring {
            Colouring::Error if recording.true_mesh().is_some() => {
                let colour = |share: f32| palette::surface_error(share * palette::ERROR_SCALE_M);
                Some(Self::Ramp { title: "error, mm", labels: ["0", "2.5", "5+"], colour })
            }
            Colouring::Confidence => {
                Some(Self::Ramp { title: "seen", labels: ["never", "", "often"], colour: palette::confidence })
            }
            Colouring::Sensor => {
                Some(Self::Names([(SeenBy::Vision, "camera"), (SeenBy::Touch, "touch"), (SeenBy::Nothing, "not seen")]))
            }
            Colouring::Error | Colouring::TrueColour | Colouring::Normals => None,
        }
    }
}

/// Returns a round length of about a sixth of the picture's height at the target, metres.
pub fn scale_bar_m(eye: &Eye, height: usize) -> f64 {
    let aim = eye.metres_per_pixel(height) * height as f64 / 6.0;
    let lengths_m = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5];
    lengths_m.into_iter().rev().find(|length| *length <= aim).unwrap_or(0.001)
}
