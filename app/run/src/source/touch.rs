//! Options that choose touch sensors and the network that reads them.

use std::path::PathBuf;

use anyhow::{Result, bail, ensure};
use clap::{Args, ValueEnum};
use mvt_robot::digit::profile::{Appearance, SensorProfile};
use mvt_touch::network::Weights;
use serde::Deserialize;

/// Where touch depth comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TouchOrigin {
    /// A network sees it in the touch images
    #[default]
    Network,
    /// The renderer's
    Truth,
}

/// Options that say where touch depth comes from.
#[derive(Debug, Clone, Args)]
pub struct TouchArguments {
    /// Where touch depth comes from
    #[arg(long, value_enum, default_value_t = TouchOrigin::Network)]
    touch_depth: TouchOrigin,
    /// Touch sensor: tacto (as TACTO renders a DIGIT), digit (a real DIGIT), digit_markers (with dots on its gel),
    /// gelsight_mini or gelsight_mini_markers (need --weights, or --touch-depth truth), or the path of a profile (.toml)
    /// [default: that of the rig; tacto for a log]
    #[arg(long, value_name = "NAME")]
    touch_profile: Option<String>,
    /// Weights of a touch network, for --touch-depth network; without it those that are shipped for the sensor
    #[arg(long, value_name = "FILE")]
    weights: Option<PathBuf>,
}

impl TouchOrigin {
    fn name(self) -> &'static str {
        match self {
            Self::Network => "network",
            Self::Truth => "truth",
        }
    }
}

impl TouchArguments {
    /// Returns the options with these values, for the sensor of the rig.
    pub fn new(touch_depth: TouchOrigin, weights: Option<PathBuf>) -> Self {
        Self { touch_depth, touch_profile: None, weights }
    }

    /// The options as they stand on a command line: names and values.
    pub fn options(&self) -> [(&'static str, Option<String>); 3] {
        let weights = self.weights.as_ref().map(|path| path.display().to_string());
        [
            ("touch-depth", Some(self.touch_depth.name().to_owned())),
            ("touch-profile", self.touch_profile.clone()),
            ("weights", weights),
        ]
    }

    /// Returns the profile of all touch sensors: the given one, or that of the pads of a rig; without pads that of TACTO.
    ///
    /// # Errors
    /// If the profile cannot be used, or the pads of the rig have different ones.
    pub fn profile(&self, of_rig: &[SensorProfile]) -> Result<SensorProfile> {
        if let Some(name) = &self.touch_profile {
            return Ok(SensorProfile::load(name)?);
        }
        let first = of_rig.first().copied().unwrap_or_else(SensorProfile::tacto);
        ensure!(
            of_rig.iter().all(|profile| *profile == first),
            "the pads of the rig have different touch sensors; choose one profile for all with --touch-profile"
        );
        Ok(first)
    }

    /// The network's weights for a sensor; `None` if the true indentation is used. Without a file those that need least time.
    ///
    /// # Errors
    /// If they cannot be used.
    pub fn weights(&self, profile: &SensorProfile) -> Result<Option<Weights>> {
        match (self.touch_depth, &self.weights) {
            (TouchOrigin::Truth, None) => Ok(None),
            (TouchOrigin::Truth, Some(_)) => bail!("--weights is for --touch-depth network"),
            (TouchOrigin::Network, Some(path)) => Ok(Some(Weights::read(path)?)),
            (TouchOrigin::Network, None) if profile.appearance.is_none() => Ok(Some(Weights::shipped_half()?)),
            (TouchOrigin::Network, None) => Ok(Some(shipped_weights(profile)?)),
        }
    }
}

/// LEDs of a sensor that stand farther from those of a DIGIT are unknown to the shipped weights, degrees. They were trained with up to 15.
const MOST_TURNED_DEG: f64 = 45.0;

/// Returns the shipped weights for a sensor.
///
/// # Errors
/// If its LEDs stand elsewhere than those of a DIGIT, so that no shipped weights can read it.
pub fn shipped_weights(profile: &SensorProfile) -> Result<Weights> {
    let known = Appearance::default().led_angles_deg;
    let angles = profile.appearance.iter().flat_map(|appearance| appearance.led_angles_deg.into_iter().zip(known));
    let turned_deg = angles.map(|(a, b)| ((a - b + 540.0).rem_euclid(360.0) - 180.0).abs()).fold(0.0, f64::max);
    ensure!(
        turned_deg <= MOST_TURNED_DEG,
        "no weights are shipped for this touch sensor, whose LEDs stand up to {turned_deg:.0} degrees from those of a DIGIT; give --weights \
         of a network that was trained for it, or, for a run, --touch-depth truth"
    );
    Ok(Weights::shipped_for(profile)?)
}
