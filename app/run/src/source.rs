//! Where sensed frames come from: a simulated episode, a log, or an RGB-D sequence.

mod log;
mod recorded;
mod rgbd;
mod sequence;
mod touch;

use anyhow::Result;
use clap::ValueEnum;
use image::RgbImage;
use mvt_calibration::Calibration;
use mvt_frames::{Isometry, Object, World};
use mvt_gaits::directive::Directive;
use mvt_gaits::feedback::EstimatedPlace;
use mvt_robot::hand::{Hand, PerPad};
use mvt_robot::observation::Percept;
use mvt_segmentation::{CarriedMask, SegmentationConfig};
use ndarray::Array2;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;

pub use log::LogSource;
pub use recorded::{Recorded, RecordedOptions};
pub use rgbd::RgbdSource;
pub use sequence::{BagSequence, RgbdSequence};
pub use touch::{TouchArguments, TouchOrigin, equipped, shipped_weights, weights_of};

/// A frame of a source.
#[derive(Debug, Clone)]
pub struct Sensed {
    /// Number of the frame in the episode or log.
    pub frame: u64,
    /// The measurements: all that estimation receives.
    pub percept: Percept,
    /// True pose of the object, for scores; `None` where it is unknown.
    pub truth: Option<Isometry<Object, World>>,
    /// The mask that the program carries into this frame, which has none of its own; empty before that.
    pub carried: Option<CarriedMask>,
    /// Images for recordings.
    pub pictures: Pictures,
    /// Wall time of simulation and rendering, or of reading, and of perception, milliseconds.
    pub sense_ms: f64,
    /// Share of the object that the hand hides from the first camera, where the source knows it and was asked for it.
    pub hidden: Option<f64>,
    /// Warnings that were not given before, in sentences.
    pub warnings: Vec<String>,
    /// Actions of the hand without a directive since the last frame, in words.
    pub events: Vec<String>,
}

/// Images of touch sensors at one instant for recordings and viewers; estimation does not receive them. Each list has one entry per pad or is empty.
#[derive(Debug, Clone, Default)]
pub struct Pictures {
    /// Images of the touch sensors.
    pub touch: PerPad<RgbImage>,
    /// True indentation, millimetres, where it is known and estimation receives another.
    pub true_indentation_mm: PerPad<Option<Array2<f32>>>,
    /// Normal force on each pad, newtons, where a simulator knows it.
    pub forces_n: Option<PerPad<f64>>,
}

/// A source of frames.
pub trait Source: Send {
    /// Returns the next frame, or `None` at the end.
    ///
    /// # Errors
    /// If the next frame cannot be simulated or read.
    fn next(&mut self) -> Result<Option<Sensed>>;

    /// Directs the hand from the next frame on. A log ignores directives.
    fn direct(&mut self, _: Directive) -> Result<()> {
        Ok(())
    }

    /// How the pixels of frames are labelled whose mask must be carried from others; `None` if there are no such frames.
    fn carries_masks(&self) -> Option<SegmentationConfig> {
        None
    }

    /// How wrong lengths may be that the cameras measure, one standard deviation, as a part of them; 0 if the cameras are calibrated.
    fn camera_scale_sigma(&self) -> f64 {
        0.0
    }

    /// Whether [`Source::see`] needs the place of the object.
    fn needs_place(&self) -> bool {
        false
    }

    /// Tells a controller that holds the object in the air where the object is, from the next frame on. Only estimates reach it.
    fn see(&mut self, _: EstimatedPlace) {}

    /// The hand that touches the object, with its touch sensors.
    fn hand(&self) -> &Arc<Hand>;

    /// The number of frames that there will be at most.
    fn frame_count(&self) -> usize;

    /// Why the source ended, in words, and whether it ended as intended.
    fn end(&self) -> (String, bool);

    /// The calibration known so far; `None` if it is taken as given.
    fn calibration(&self) -> Option<Calibration>;
}

/// Which sensors are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Modality {
    /// Cameras and touch
    #[default]
    Vitac,
    /// Cameras alone
    Vi,
    /// Touch alone
    Tac,
}

impl Modality {
    /// Whether cameras are used.
    pub fn has_vision(self) -> bool {
        self != Self::Tac
    }

    /// Whether touch is used.
    pub fn has_touch(self) -> bool {
        self != Self::Vi
    }

    /// Its name on the command line and in results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vitac => "vitac",
            Self::Vi => "vi",
            Self::Tac => "tac",
        }
    }
}

impl fmt::Display for Modality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
