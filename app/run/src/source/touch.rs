//! Indentation of the touch sensors: from a network that sees their images, or the true one.

use std::path::PathBuf;

use anyhow::{Context as _, Result, bail, ensure};
use clap::{Args, ValueEnum};
use image::RgbImage;
use mvt_products::Instructions;
use mvt_robot::digit::gel::GelView;
use mvt_robot::digit::profile::{Appearance, SensorProfile};
use mvt_robot::hand::{Finger, PerFinger};
use mvt_robot::observation::TouchTruth;
use mvt_robot::observation::{Press, SensorName};
use mvt_shear::ShearSensor;
use mvt_touch::contact::{ContactConfig, Feeler};
use mvt_touch::engine::Engine;
use mvt_touch::network::Weights;
use mvt_touch::untouched::{UnusualLight, estimate};
use ndarray::Zip;
use serde::Deserialize;

/// Name of TACTO's sensor.
const TACTO: &str = "tacto";

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
    #[arg(long, value_name = "NAME", default_value = TACTO)]
    touch_profile: String,
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
    /// Returns the options with these values, for TACTO's sensor.
    pub fn new(touch_depth: TouchOrigin, weights: Option<PathBuf>) -> Self {
        Self { touch_depth, touch_profile: TACTO.to_owned(), weights }
    }

    /// The options as they stand on a command line: names and values.
    pub fn options(&self) -> [(&'static str, Option<String>); 3] {
        let weights = self.weights.as_ref().map(|path| path.display().to_string());
        let profile = (self.touch_profile != TACTO).then(|| self.touch_profile.clone());
        [("touch-depth", Some(self.touch_depth.name().to_owned())), ("touch-profile", profile), ("weights", weights)]
    }

    /// The touch sensor.
    ///
    /// # Errors
    /// If its profile cannot be used.
    pub fn profile(&self) -> Result<SensorProfile> {
        Ok(SensorProfile::load(&self.touch_profile)?)
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

/// Standard deviation of true touch depth, millimetres: logs store it in steps of 1/33 mm.
const TRUTH_SIGMA_MM: f32 = 0.05;

/// True touch on a gel as a press. Pixels without a valid depth are no contact. `None` without images of a DIGIT's size.
pub fn true_press(truth: &TouchTruth, gel: &GelView) -> Option<Press> {
    let mut indentation_mm = gel.indentation_of(&truth.depth_m)?;
    if truth.contact.dim() != truth.depth_m.dim() {
        return None;
    }
    let mut contact = truth.contact.clone();
    Zip::from(&truth.depth_m).and(&mut indentation_mm).and(&mut contact).for_each(
        |&depth_m, indentation_mm, touches| {
            if !(depth_m.is_finite() && depth_m > 0.0) {
                (*indentation_mm, *touches) = (0.0, false);
            }
        },
    );
    Some(Press { indentation_mm, contact, sigma_mm: TRUTH_SIGMA_MM })
}

/// The touch network of one hand, with the warnings it has given.
pub struct TouchNetwork {
    feeler: Feeler,
    told: PerFinger<bool>,
    profile: SensorProfile,
    /// Light of sensors that is not the usual one; said with the next frame.
    unusual: Vec<String>,
    /// Whose light is known, from the untouched image or a first image.
    judged: PerFinger<bool>,
    /// Find the dots of gels that have some, which the network must not see. Known with the untouched image.
    dots: PerFinger<Option<ShearSensor>>,
}

impl TouchNetwork {
    /// For the sensors of one hand.
    pub fn new(weights: &Weights, config: ContactConfig, profile: &SensorProfile) -> Self {
        let engine = Engine::new(weights, Instructions::best());
        Self {
            feeler: Feeler::new(engine, config).with_gains(profile.gains()),
            told: PerFinger::default(),
            profile: *profile,
            unusual: Vec::new(),
            judged: PerFinger::default(),
            dots: PerFinger::default(),
        }
    }

    /// Sets the untouched image of a sensor.
    ///
    /// # Errors
    /// If the image has another size than a DIGIT's, or does not show the dots of the profile.
    pub fn set_empty(&mut self, finger: Finger, image: &RgbImage) -> Result<()> {
        if self.profile.markers.is_none() {
            self.feeler.set_empty(finger, image)?;
        } else {
            let sensor =
                ShearSensor::new(&self.profile, image).with_context(|| SensorName::Touch(finger).to_string())?;
            self.feeler.set_empty(finger, &sensor.erased(image))?;
            self.dots[finger] = Some(sensor);
        }
        self.judged[finger] = true;
        let light = self.feeler.light(finger);
        self.unusual.extend(light.map(|light| format!("{}: {light}", SensorName::Touch(finger))));
        Ok(())
    }

    /// Estimates the untouched image of a sensor from images with contacts at different places. Without images it stays unknown.
    ///
    /// # Errors
    /// If images have another size than a DIGIT's.
    pub fn learn_empty(&mut self, finger: Finger, images: &[RgbImage]) -> Result<()> {
        match estimate(self.feeler.engine(), images)? {
            Some(untouched) => self.set_empty(finger, &untouched),
            None => Ok(()),
        }
    }

    /// Returns the press of each finger whose image is plausible. The first implausible image of a finger adds a warning.
    ///
    /// # Errors
    /// If an image has another size than a DIGIT's.
    pub fn feel(
        &mut self,
        frame: u64,
        images: &PerFinger<RgbImage>,
        warnings: &mut Vec<String>,
    ) -> Result<PerFinger<Option<Press>>> {
        let Self { feeler, told, dots, unusual, judged, profile } = self;
        warnings.append(unusual);
        let is_calibrated = profile.gains() != [1.0; 3];
        for finger in Finger::ALL {
            let image = &images[finger];
            if image.is_empty() || is_calibrated || std::mem::replace(&mut judged[finger], true) {
                continue;
            }
            if UnusualLight::of(image).is_some() {
                warnings.push(format!(
                    "frame {frame}: {} has another light than a DIGIT, and its untouched image is unknown: its depths are wrong in proportion; \
                     record 10 s or more",
                    SensorName::Touch(finger)
                ));
            }
        }
        let erased = PerFinger::from_fn(|finger| {
            let image = &images[finger];
            dots[finger].as_ref().filter(|_| !image.is_empty()).map(|sensor| sensor.erased(image))
        });
        let felt = match erased.0.iter().any(Option::is_some) {
            true => feeler
                .feel(&PerFinger::from_fn(|finger| erased[finger].clone().unwrap_or_else(|| images[finger].clone())))?,
            false => feeler.feel(images)?,
        };
        for finger in Finger::ALL {
            if let Some(felt) = felt[finger].as_ref().filter(|felt| felt.press.is_none())
                && !std::mem::replace(&mut told[finger], true)
            {
                warnings.push(format!(
                    "frame {frame}: {} is skipped wherever its image is implausible (plausibility {:.2} of 1): black, saturated, of another sensor, or unlike the training images",
                    SensorName::Touch(finger),
                    felt.plausibility
                ));
            }
        }
        Ok(PerFinger(felt.0.map(|felt| felt?.press)))
    }
}
