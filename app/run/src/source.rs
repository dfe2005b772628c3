//! Where sensed frames come from: a live episode, or a log.

mod log;
mod touch;

use anyhow::Result;
use clap::ValueEnum;
use image::RgbImage;
use mvt_frames::{Isometry, Object, World};
use mvt_gaits::directive::Directive;
use mvt_robot::hand::PerFinger;
use mvt_robot::observation::Percept;
use ndarray::Array2;
use serde::{Deserialize, Serialize};
use std::fmt;

pub use log::LogSource;
pub use touch::{TouchArguments, TouchNetwork, true_press};

/// What the sensors measured at one instant.
#[derive(Debug, Clone)]
pub struct Sensed {
    /// Number of the frame in the episode or log.
    pub frame: u64,
    /// The measurements: all that estimation receives.
    pub percept: Percept,
    /// Where the object is, for scores; none where nobody knows.
    pub truth: Option<Isometry<Object, World>>,
    /// What there was to be seen, for recordings.
    pub pictures: Pictures,
    /// Wall time of simulation and rendering, or of reading, and of perception, milliseconds.
    pub sense_ms: f64,
    /// Share of the object that the hand hides from the first camera, where the source knows it and was asked for it.
    pub hidden: Option<f64>,
    /// Warnings that were not given before, in sentences.
    pub warnings: Vec<String>,
}

/// What there was to be seen at one instant: for those who record or show a run, and no part of what estimation receives. Images may
/// be missing or empty.
#[derive(Debug, Clone, Default)]
pub struct Pictures {
    /// Colours of each camera.
    pub cameras: Vec<RgbImage>,
    /// What each DIGIT shows.
    pub touch: PerFinger<RgbImage>,
    /// True touch depth, metres, where it is known and is not what estimation receives.
    pub true_touch_m: PerFinger<Option<Array2<f32>>>,
    /// Normal force on each fingertip, newtons, where a simulator knows it.
    pub forces_n: Option<PerFinger<f64>>,
}

/// Gives sensed frames one at a time.
pub trait Source: Send {
    /// The next frame; none at the end.
    ///
    /// # Errors
    /// If there can be no further frame although this is not the end.
    fn next(&mut self) -> Result<Option<Sensed>>;

    /// What the hand is to do from now on. A log has happened: it takes no notice.
    fn direct(&mut self, _: Directive) -> Result<()> {
        Ok(())
    }

    /// How many frames there will be at most.
    fn len(&self) -> usize;

    /// Why there are no more frames, in words, and whether this is how it was meant to end.
    fn end(&self) -> (String, bool);
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
