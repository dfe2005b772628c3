//! Where touch depth comes from: whoever knows it, or a network that sees touch images.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::{Args, ValueEnum};
use image::RgbImage;
use mvt_products::Instructions;
use mvt_robot::hand::{Finger, PerFinger};
use mvt_robot::observation::TouchTruth;
use mvt_robot::observation::{Sensor, TouchImages};
use mvt_touch::contact::{ContactConfig, Feeler};
use mvt_touch::engine::Engine;
use mvt_touch::network::Weights;
use mvt_touch::untouched::estimate;

/// Where touch depth comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum TouchDepth {
    /// A network sees it in the touch images
    Network,
    /// The renderer's
    Truth,
}

/// Options that say where touch depth comes from.
#[derive(Debug, Clone, Args)]
pub struct TouchArguments {
    /// Where touch depth comes from
    #[arg(long, value_enum, default_value_t = TouchDepth::Network)]
    touch_depth: TouchDepth,
    /// Weights of a touch network, for --touch-depth network; without it those that are shipped
    #[arg(long, value_name = "FILE")]
    weights: Option<PathBuf>,
}

impl TouchDepth {
    fn name(self) -> &'static str {
        match self {
            Self::Network => "network",
            Self::Truth => "truth",
        }
    }
}

impl TouchArguments {
    /// The options as they stand on a command line: names and values.
    pub fn options(&self) -> [(&'static str, Option<String>); 2] {
        let weights = self.weights.as_ref().map(|path| path.display().to_string());
        [("touch-depth", Some(self.touch_depth.name().to_owned())), ("weights", weights)]
    }

    /// The network's weights; none if touch depth is the true one.
    ///
    /// # Errors
    /// If they cannot be used.
    pub fn weights(&self) -> Result<Option<Weights>> {
        match (self.touch_depth, &self.weights) {
            (TouchDepth::Truth, None) => Ok(None),
            (TouchDepth::Truth, Some(_)) => bail!("--weights is for --touch-depth network"),
            (TouchDepth::Network, Some(path)) => Ok(Some(Weights::read(path)?)),
            (TouchDepth::Network, None) => Ok(Some(Weights::shipped()?)),
        }
    }
}

/// Standard deviation of true touch depth, metres: logs store it in steps of 1/33 mm.
const TRUTH_SIGMA_M: f32 = 5e-5;

/// True touch depth and contact as perception wants it.
pub fn true_touch(truth: &TouchTruth) -> TouchImages<'_> {
    TouchImages { depth_m: &truth.depth_m, contact: &truth.contact, sigma_m: TRUTH_SIGMA_M }
}

/// A network that feels, and what it has complained of.
pub struct TouchNetwork {
    feeler: Feeler,
    told: PerFinger<bool>,
}

impl TouchNetwork {
    /// For one hand.
    pub fn new(weights: &Weights, config: ContactConfig) -> Self {
        let engine = Engine::new(weights, Instructions::best());
        Self { feeler: Feeler::new(engine, config), told: PerFinger::default() }
    }

    /// Tells what a sensor shows when it touches nothing.
    ///
    /// # Errors
    /// If the image has another size than a DIGIT's.
    pub fn set_empty(&mut self, finger: Finger, image: &RgbImage) -> Result<()> {
        Ok(self.feeler.set_empty(finger, image)?)
    }

    /// Finds what a sensor shows when it touches nothing from images with contacts at different places. Without images that remains
    /// unknown.
    ///
    /// # Errors
    /// If images have another size than a DIGIT's.
    pub fn learn_empty(&mut self, finger: Finger, images: &[RgbImage]) -> Result<()> {
        match estimate(self.feeler.engine(), images)? {
            Some(untouched) => self.set_empty(finger, &untouched),
            None => Ok(()),
        }
    }

    /// Depth and contact of each finger whose image can be believed. Says once per finger that one cannot.
    ///
    /// # Errors
    /// If an image has another size than a DIGIT's.
    pub fn feel(
        &mut self,
        frame: u64,
        images: &PerFinger<RgbImage>,
        warnings: &mut Vec<String>,
    ) -> Result<PerFinger<Option<TouchImages<'_>>>> {
        let Self { feeler, told } = self;
        let felt = feeler.feel(images)?;
        for finger in Finger::ALL {
            if let Some(felt) = felt[finger].filter(|felt| felt.images.is_none())
                && !std::mem::replace(&mut told[finger], true)
            {
                warnings.push(format!(
                    "frame {frame}: the image of {} is none that a DIGIT makes (plausibility {:.2} of 1): black, saturated, from another sensor, or unlike what the weights know; such images are left out",
                    Sensor::Touch(finger),
                    felt.plausibility
                ));
            }
        }
        Ok(PerFinger::from_fn(|finger| felt[finger].and_then(|felt| felt.images)))
    }
}
