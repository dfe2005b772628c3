//! What the colours of a scene stand for.

use image::Rgb;

use super::colours::{self, SeenBy};
use super::{Colouring, Eye, Layers};
use mvt_recording::Recording;
use mvt_run::report::error_colour;

/// What colours stand for.
pub enum Key {
    /// Numbers: what they are, the first, middle and last of them, and the colour of a share of the way.
    Ramp {
        /// What the numbers are, and their unit.
        title: &'static str,
        /// At the beginning, in the middle and at the end.
        labels: [&'static str; 3],
        /// By share of the way, 0 to 1.
        colour: fn(f32) -> Rgb<u8>,
    },
    /// Names.
    Names([(SeenBy, &'static str); 3]),
}

impl Key {
    /// What colours stand for with these layers; none where they stand for nothing.
    pub fn of(layers: &Layers, recording: &Recording) -> Option<Self> {
        if layers.slice {
            let colour = |share: f32| colours::signed_distance((2.0 * share - 1.0) * colours::SLICE_SCALE_M);
            return Some(Self::Ramp { title: "distance, mm", labels: ["-10", "0", "10"], colour });
        }
        let is_estimated = recording.moments().first().is_some_and(|moment| moment.estimate().is_some());
        if !layers.mesh || !is_estimated {
            return None;
        }
        match layers.colouring {
            Colouring::Error if recording.truth().is_some() => {
                let colour = |share: f32| error_colour::of(share * error_colour::FULL_SCALE_M);
                Some(Self::Ramp { title: "error, mm", labels: ["0", "2.5", "5+"], colour })
            }
            Colouring::Confidence => {
                Some(Self::Ramp { title: "seen", labels: ["never", "", "often"], colour: colours::confidence })
            }
            Colouring::Sensor => {
                Some(Self::Names([(SeenBy::Vision, "camera"), (SeenBy::Touch, "touch"), (SeenBy::Nothing, "not seen")]))
            }
            Colouring::Error | Colouring::TrueColour | Colouring::Normals => None,
        }
    }
}

/// A round length that takes about a sixth of the picture's height at the target, metres.
pub fn scale_bar_m(eye: &Eye, height: usize) -> f64 {
    let aim = eye.metres_per_pixel(height) * height as f64 / 6.0;
    let lengths_m = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5];
    lengths_m.into_iter().rev().find(|length| *length <= aim).unwrap_or(0.001)
}
