//! Indentation of the touch sensors: from a network that sees their images, or the true one.

use image::RgbImage;
use mvt_products::Instructions;
use mvt_robot::digit::gel::GelView;
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::{Finger, PerFinger};
use mvt_robot::observation::{Press, SensorError, SensorName, TouchTruth};
use mvt_shear::ShearSensor;
use mvt_touch::contact::{ContactConfig, Feeler};
use mvt_touch::engine::Engine;
use mvt_touch::network::Weights;
use mvt_touch::untouched::{UnusualLight, estimate};
use ndarray::Zip;

use crate::error::PerceptionError;

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

/// The touch sensors of a hand, whose images a network reads, with the warnings that were given.
pub(crate) struct TouchSensors {
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

impl TouchSensors {
    /// For the sensors of one hand.
    pub(crate) fn new(weights: &Weights, config: ContactConfig, profile: &SensorProfile) -> Self {
        let engine = Engine::new(weights, Instructions::best());
        Self {
            feeler: Feeler::new(engine, config, profile.gains()),
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
    pub(crate) fn set_untouched(&mut self, finger: Finger, image: &RgbImage) -> Result<(), PerceptionError> {
        if self.profile.markers.is_none() {
            self.feeler.set_untouched(finger, image)?;
        } else {
            let sensor = ShearSensor::new(&self.profile, image)
                .map_err(|reason| PerceptionError::Dots { sensor: SensorName::Touch(finger), reason })?;
            self.feeler.set_untouched(finger, &sensor.erased(image))?;
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
    pub(crate) fn learn_untouched(&mut self, finger: Finger, images: &[RgbImage]) -> Result<(), PerceptionError> {
        let unfit = |reason| PerceptionError::Image { sensor: SensorName::Touch(finger), reason };
        match estimate(self.feeler.engine(), images).map_err(unfit)? {
            Some(untouched) => self.set_untouched(finger, &untouched),
            None => Ok(()),
        }
    }

    /// Returns the press of each finger whose image is plausible. The first implausible image of a finger adds a warning.
    ///
    /// # Errors
    /// If an image has another size than a DIGIT's.
    pub(crate) fn feel(
        &mut self,
        frame: u64,
        images: &PerFinger<RgbImage>,
        warnings: &mut Vec<String>,
    ) -> Result<PerFinger<Option<Press>>, SensorError> {
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
