//! Options that choose touch sensors and the network that reads them.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Result, bail, ensure};
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
    /// gelsight_mini, gelsight_mini_markers, or the path of a profile (.toml) [default: that of each pad of the rig or log]
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
        let mut known = BTreeMap::new();
        let mut by_pad = PerPad(Vec::new());
        for TouchPad { profile, .. } in hand.pads() {
            let origin = match (self.weights.as_ref().or(profile.weights.as_ref()), &profile.appearance) {
                (Some(path), _) => WeightsOrigin::File(path),
                (None, None) => WeightsOrigin::Half,
                (None, Some(look)) => WeightsOrigin::of_look(look)?,
            };
            let weights = match known.entry(origin) {
                Entry::Occupied(known) => known.into_mut(),
                Entry::Vacant(new) => new.insert(Arc::new(origin.read()?)),
            };
            if let WeightsOrigin::File(path) = origin {
                check_light(profile, weights, path)?;
            }
            by_pad.0.push(Arc::clone(weights));
        }
        Ok(Some(by_pad))
    }
}

/// Where weights come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum WeightsOrigin<'a> {
    /// A file of the user's.
    File(&'a Path),
    // Why: notes/decisions/touch.md, "Runs read touch images at half the size".
    /// The shipped ones for images of half the size, for TACTO's DIGITs.
    Half,
    /// The shipped ones for sensors that look like real DIGITs.
    Digit,
    /// The shipped ones for sensors that look like a GelSight Mini.
    GelSightMini,
}

impl WeightsOrigin<'_> {
    /// The shipped ones for sensors with the LEDs of this look.
    fn of_look(look: &Appearance) -> Result<Self> {
        let gelsight_mini = SensorProfile::load("gelsight_mini")?.appearance.unwrap_or_default();
        let known = [(Self::Digit, Appearance::default()), (Self::GelSightMini, gelsight_mini)];
        let apart_deg = known.map(|(origin, known)| (turned_deg(look, &known), origin));
        match apart_deg.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((deg, origin)) if deg <= MOST_TURNED_DEG => Ok(origin),
            _ => bail!(
                "no weights are shipped for this touch sensor: its LEDs stand elsewhere than those of a DIGIT or a GelSight Mini; {REMEDY}"
            ),
        }
    }

    fn read(self) -> Result<Weights> {
        Ok(match self {
            Self::File(path) => Weights::read(path)?,
            Self::Half => Weights::shipped_half()?,
            Self::Digit => Weights::shipped_digit()?,
            Self::GelSightMini => Weights::shipped_gelsight_mini()?,
        })
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

/// LEDs of a sensor that stand farther from those of a training are unknown to its weights, degrees. They were trained with up to 15.
const MOST_TURNED_DEG: f64 = 45.0;

/// What to do where no weights know a sensor.
const REMEDY: &str = "give --weights of a network that was trained for it, or, for a run, --touch-depth truth";

/// Returns the shipped weights for a sensor, for whole images.
///
/// # Errors
/// If no shipped weights know LEDs where those of the sensor stand, or they cannot be read.
pub fn shipped_weights(profile: &SensorProfile) -> Result<Weights> {
    match &profile.appearance {
        None => Ok(Weights::shipped()?),
        Some(look) => WeightsOrigin::of_look(look)?.read(),
    }
}

/// Reads weights for a sensor from a file.
///
/// # Errors
/// If the file cannot be read, or says that it is for sensors with other lights.
pub fn weights_of(path: &Path, profile: &SensorProfile) -> Result<Weights> {
    let weights = Weights::read(path)?;
    check_light(profile, &weights, path)?;
    Ok(weights)
}

/// The greatest angle between LEDs of the same colour, degrees.
fn turned_deg(a: &Appearance, b: &Appearance) -> f64 {
    let pairs = a.led_angles_deg.into_iter().zip(b.led_angles_deg);
    pairs.map(|(a, b)| ((a - b + 540.0).rem_euclid(360.0) - 180.0).abs()).fold(0.0, f64::max)
}

/// Checks that weights of a file know the light of a sensor: that of the sensors for which they were trained. Files that do not say for which
/// are taken to be right.
fn check_light(profile: &SensorProfile, weights: &Weights, path: &Path) -> Result<()> {
    let Some(trained_for) = weights.trained_for() else { return Ok(()) };
    let apart_deg = profile.appearance.as_ref().map(|look| turned_deg(look, trained_for));
    if apart_deg.is_some_and(|deg| deg <= MOST_TURNED_DEG) {
        return Ok(());
    }
    let stand = apart_deg.map_or("it has the light of TACTO".to_owned(), |deg| {
        format!("its LEDs stand up to {deg:.0} degrees from those of the sensors for which they were trained")
    });
    bail!("the weights {} are of another touch sensor: {stand}; {REMEDY}", path.display())
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
        let turned = |weights: &Weights| weights.trained_for().map(|look| look.led_angles_deg[0]);
        assert_eq!(turned(&touch.weights(&mini).unwrap().unwrap()[0]), Some(-4.0));
        let mut odd = SensorProfile::load("gelsight_mini").unwrap();
        odd.appearance.as_mut().unwrap().led_angles_deg = [60.0, 180.0, -60.0];
        let odd = Hand::allegro(Side::Left).with_profile(&odd);
        assert!(touch.weights(&odd).unwrap_err().to_string().contains("no weights are shipped"));
        // Weights that say for which sensor they are.
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mini.safetensors");
        let weights = Weights::shipped().unwrap().for_sensor(mini.pads()[0].profile.appearance);
        weights.write(&path, mvt_touch::network::Precision::F32).unwrap();
        let touch = TouchArguments::new(TouchOrigin::Network, Some(path));
        assert!(touch.weights(&mini).unwrap().is_some());
        for (other, said) in [("tacto", "light of TACTO"), ("digit", "degrees")] {
            let hand = Hand::allegro(Side::Left).with_profile(&SensorProfile::load(other).unwrap());
            let error = touch.weights(&hand).unwrap_err().to_string();
            assert!(error.contains("another touch sensor") && error.contains(said), "{error}");
        }
        assert_eq!(touch.equipped(&mini).unwrap(), mini);
        assert!(equipped(&mini, Some("tacto")).unwrap().pads()[0].profile.is_tacto());
    }
}
