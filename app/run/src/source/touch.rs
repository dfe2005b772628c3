//! Options that choose touch sensors and the network that reads them.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Result, ensure};
use clap::{Args, ValueEnum};
use mvt_robot::digit::profile::{Appearance, SensorProfile};
use mvt_robot::hand::{Hand, PerPad, TouchPad};
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
    /// [default: that of each pad of the rig or log]
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
    /// Returns the options with these values, for the sensors of the hand.
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

    /// Returns the hand with the given touch sensor on all pads; without one as it is.
    ///
    /// # Errors
    /// If the profile cannot be used.
    pub fn equipped(&self, hand: &Arc<Hand>) -> Result<Arc<Hand>> {
        equipped(hand, self.touch_profile.as_deref())
    }

    /// The weights of the network for each touch sensor of a hand; `None` if the true indentation is used. Without a file they are those of the
    /// profile, or those that need least time. Pads share weights that are the same.
    ///
    /// # Errors
    /// If they cannot be used.
    pub fn weights(&self, hand: &Hand) -> Result<Option<PerPad<Arc<Weights>>>> {
        if self.touch_depth == TouchOrigin::Truth {
            ensure!(self.weights.is_none(), "--weights is for --touch-depth network");
            return Ok(None);
        }
        // By their origin: a file, or the shipped ones for a sensor that looks like a real one or not.
        let mut known = BTreeMap::new();
        let mut by_pad = PerPad(Vec::new());
        for TouchPad { profile, .. } in hand.pads() {
            let path = self.weights.as_ref().or(profile.weights.as_ref());
            let origin = (path, path.is_none() && profile.appearance.is_some());
            if path.is_none() {
                check_light(profile)?;
            }
            let read = || match origin {
                (Some(path), _) => Ok(Weights::read(path)?),
                (None, false) => Ok::<_, anyhow::Error>(Weights::shipped_half()?),
                (None, true) => Ok(Weights::shipped_for(profile)?),
            };
            let weights = match known.entry(origin) {
                Entry::Occupied(known) => known.into_mut(),
                Entry::Vacant(new) => new.insert(Arc::new(read()?)),
            };
            by_pad.0.push(Arc::clone(weights));
        }
        Ok(Some(by_pad))
    }
}

/// Returns the hand with the touch sensor of this name or file on all pads; without one as it is.
///
/// # Errors
/// If the profile cannot be used.
pub fn equipped(hand: &Arc<Hand>, touch_profile: Option<&str>) -> Result<Arc<Hand>> {
    match touch_profile {
        Some(name) => Ok(hand.with_profile(&SensorProfile::load(name)?)),
        None => Ok(Arc::clone(hand)),
    }
}

/// LEDs of a sensor that stand farther from those of a DIGIT are unknown to the shipped weights, degrees. They were trained with up to 15.
const MOST_TURNED_DEG: f64 = 45.0;

/// Returns the shipped weights for a sensor.
///
/// # Errors
/// If its LEDs stand elsewhere than those of a DIGIT, so that no shipped weights can read it.
pub fn shipped_weights(profile: &SensorProfile) -> Result<Weights> {
    check_light(profile)?;
    Ok(Weights::shipped_for(profile)?)
}

/// Checks that the LEDs of a sensor stand where the shipped weights know them.
fn check_light(profile: &SensorProfile) -> Result<()> {
    let known = Appearance::default().led_angles_deg;
    let angles = profile.appearance.iter().flat_map(|appearance| appearance.led_angles_deg.into_iter().zip(known));
    let turned_deg = angles.map(|(a, b)| ((a - b + 540.0).rem_euclid(360.0) - 180.0).abs()).fold(0.0, f64::max);
    ensure!(
        turned_deg <= MOST_TURNED_DEG,
        "no weights are shipped for this touch sensor, whose LEDs stand up to {turned_deg:.0} degrees from those of a DIGIT; give --weights \
         of a network that was trained for it, or, for a run, --touch-depth truth"
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use mvt_robot::hand::Side;

    use super::*;

    #[test]
    fn pads_with_the_same_weights_share_them() {
        let hand = Hand::allegro(Side::Left);
        let touch = TouchArguments::new(TouchOrigin::Network, None);
        let digit = SensorProfile::load("digit").unwrap();
        let mixed = hand.with_profiles(|pad| match pad.name.as_str() {
            "index" | "thumb" => digit.clone(),
            _ => SensorProfile { size_px: [100, 80], ..SensorProfile::tacto() },
        });
        let weights = touch.weights(&mixed).unwrap().unwrap();
        let same = |a: usize, b: usize| Arc::ptr_eq(&weights[a], &weights[b]);
        assert!(same(0, 3) && same(1, 2) && !same(0, 1));
        assert!(TouchArguments::new(TouchOrigin::Truth, None).weights(&mixed).unwrap().is_none());
    }

    #[test]
    fn profiles_name_their_weights() {
        let profile = |weights: &str| SensorProfile { weights: Some(weights.into()), ..SensorProfile::tacto() };
        let hand = Hand::allegro(Side::Left).with_profile(&profile("/nowhere/a.safetensors"));
        let refused =
            |weights| TouchArguments::new(TouchOrigin::Network, weights).weights(&hand).unwrap_err().to_string();
        assert!(refused(None).contains("/nowhere/a.safetensors"));
        assert!(refused(Some("/nowhere/b.safetensors".into())).contains("b.safetensors"));
        let mini = Hand::allegro(Side::Left).with_profile(&SensorProfile::load("gelsight_mini").unwrap());
        let touch = TouchArguments::new(TouchOrigin::Network, None);
        assert!(touch.weights(&mini).unwrap_err().to_string().contains("no weights are shipped"));
        assert_eq!(touch.equipped(&mini).unwrap(), mini);
        assert!(equipped(&mini, Some("tacto")).unwrap().pads()[0].profile.is_tacto());
    }
}
