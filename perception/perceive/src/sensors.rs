//! Indentation of the touch sensors: from a network that sees their images, or the true one.

use std::sync::Arc;

use image::RgbImage;
use mvt_products::Instructions;
use mvt_robot::digit::gel::GelView;
use mvt_robot::digit::profile::{Appearance, SensorProfile};
use mvt_robot::hand::{Hand, PerPad, TouchPad};
use mvt_robot::observation::{Press, SensorError, SensorName, TouchTruth};
use mvt_shear::ShearSensor;
use mvt_touch::contact::{ContactConfig, Feeler};
use mvt_touch::engine::Engine;
use mvt_touch::light::SensorLight;
use mvt_touch::network::Weights;
use mvt_touch::untouched::estimate;
use ndarray::Zip;

use crate::error::PerceptionError;

/// Standard deviation of true touch depth, millimetres: logs store it in steps of 1/33 mm.
const TRUTH_SIGMA_MM: f32 = 0.05;

/// First images of a sensor of which the untouched image is estimated if nothing else tells it.
const FIRST_IMAGES: usize = 10;

/// True touch on a gel as a press. Pixels without a valid depth are no contact. `None` without images of the sensor's size.
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

/// Returns whether an image needs no untouched one: the sensor looks as TACTO renders it, or the size is wrong, which is an error.
fn can_be_read_at_once(profile: &SensorProfile, image: &RgbImage) -> bool {
    profile.appearance.is_none() || image.dimensions() != profile.size_px.map(|px| px as u32).into()
}

/// The touch sensors of a hand, whose images a network reads, with the warnings that were given.
pub(crate) struct TouchSensors {
    feeler: Feeler,
    /// The hand, with the profiles of its sensors.
    hand: Arc<Hand>,
    told: PerPad<bool>,
    /// Light of sensors that is not the usual one; said with the next frame.
    unusual: Vec<String>,
    /// Whose light is known, from the untouched image or a first image.
    judged: PerPad<bool>,
    /// First images of sensors that cannot be read before their untouched image is known.
    first: PerPad<Vec<RgbImage>>,
    /// Find the dots of gels that have some, which the network must not see. Known with the untouched image.
    dots: PerPad<Option<ShearSensor>>,
}

impl TouchSensors {
    /// For the sensors of one hand, with the weights of each.
    pub(crate) fn new(weights: &PerPad<Arc<Weights>>, config: ContactConfig, hand: &Arc<Hand>) -> Self {
        let mut engines: Vec<(&Arc<Weights>, Arc<Engine>)> = Vec::new();
        let engine = |weights| {
            let known = engines.iter().find(|(known, _)| Arc::ptr_eq(known, weights)).map(|(_, engine)| engine);
            let engine = known.cloned().unwrap_or_else(|| Arc::new(Engine::new(weights, Instructions::best())));
            engines.push((weights, Arc::clone(&engine)));
            engine
        };
        Self {
            feeler: Feeler::new(hand, weights.iter().map(engine).collect(), config),
            hand: Arc::clone(hand),
            told: hand.per_pad(|_| false),
            unusual: Vec::new(),
            judged: hand.per_pad(|_| false),
            first: hand.per_pad(|_| Vec::new()),
            dots: hand.per_pad(|_| None),
        }
    }

    /// Sets the untouched image of the sensor of a pad. Has no effect if there is no such pad.
    ///
    /// # Errors
    /// If the image has another size than the sensor's, or does not show the dots of the profile.
    pub(crate) fn set_untouched(&mut self, pad: usize, image: &RgbImage) -> Result<(), PerceptionError> {
        let Self { feeler, hand, dots, judged, unusual, .. } = self;
        let Some(TouchPad { name, profile, .. }) = hand.pads().get(pad) else { return Ok(()) };
        let name = SensorName::Touch(name.clone());
        if profile.markers.is_none() {
            feeler.set_untouched(pad, image)?;
        } else {
            let sensor = ShearSensor::new(profile, image)
                .map_err(|reason| PerceptionError::Dots { sensor: name.clone(), reason })?;
            feeler.set_untouched(pad, &sensor.erased(image))?;
            dots[pad] = Some(sensor);
        }
        judged[pad] = true;
        let light = feeler.light(pad).filter(|light| !light.is_usual());
        unusual.extend(light.map(|light| format!("{name}: {light}")));
        Ok(())
    }

    /// Estimates the untouched image of the sensor of a pad from images with contacts at different places. Without images it stays unknown.
    ///
    /// # Errors
    /// If images have another size than the sensor's.
    pub(crate) fn learn_untouched(&mut self, pad: usize, images: &[RgbImage]) -> Result<(), PerceptionError> {
        let Some((pad_of, engine)) = self.hand.pads().get(pad).zip(self.feeler.engine(pad)) else { return Ok(()) };
        let unfit = |reason| PerceptionError::Image { sensor: SensorName::Touch(pad_of.name.clone()), reason };
        match estimate(engine, images).map_err(unfit)? {
            Some(untouched) => self.set_untouched(pad, &untouched),
            None => Ok(()),
        }
    }

    /// Estimates the untouched image of a sensor that looks like a real one from its first images, if nothing else told it: a network that reads such
    /// sensors knows nothing without. Until then the sensor is not read.
    fn learn_from_first(&mut self, frame: u64, images: &[RgbImage], warnings: &mut Vec<String>) {
        let hand = Arc::clone(&self.hand);
        for (pad, (TouchPad { name, profile, .. }, image)) in hand.pads().iter().zip(images).enumerate() {
            let is_done = self.judged[pad] || self.first[pad].len() == FIRST_IMAGES;
            if is_done || can_be_read_at_once(profile, image) || image.is_empty() {
                continue;
            }
            self.first[pad].push(image.clone());
            if self.first[pad].len() < FIRST_IMAGES {
                continue;
            }
            let first = std::mem::take(&mut self.first[pad]);
            let name = SensorName::Touch(name.clone());
            warnings.push(match self.learn_untouched(pad, &first) {
                Ok(()) => format!(
                    "frame {frame}: the untouched image of {name} is not known; it is estimated from the first {FIRST_IMAGES} images, which must show no contact"
                ),
                Err(error) => {
                    // It is not tried again.
                    self.first[pad] = first;
                    format!("frame {frame}: {name} is not read: its untouched image cannot be estimated: {error}")
                }
            });
        }
    }

    /// Returns the press of each sensor whose image is plausible. The first implausible image of a sensor adds a warning.
    ///
    /// # Errors
    /// If an image has another size than its sensor's.
    pub(crate) fn feel(
        &mut self,
        frame: u64,
        images: &[RgbImage],
        warnings: &mut Vec<String>,
    ) -> Result<PerPad<Option<Press>>, SensorError> {
        self.learn_from_first(frame, images, warnings);
        let Self { feeler, hand, told, dots, unusual, judged, .. } = self;
        warnings.append(unusual);
        let sensors = || hand.pads().iter().map(|TouchPad { name, profile, .. }| (name, profile));
        let unread = RgbImage::default();
        let readable: Vec<&RgbImage> = images
            .iter()
            .zip(judged.iter().zip(sensors()))
            .map(|(image, (judged, (_, profile)))| match *judged || can_be_read_at_once(profile, image) {
                true => image,
                false => &unread,
            })
            .collect();
        for ((image, judged), (name, _)) in readable.iter().zip(judged.iter_mut()).zip(sensors()) {
            if image.is_empty() || std::mem::replace(judged, true) {
                continue;
            }
            if !SensorLight::of(image, &Appearance::default(), false).is_usual() {
                warnings.push(format!(
                    "frame {frame}: {} has another light than a DIGIT, and its untouched image is unknown: its depths are wrong in proportion; \
                     record 10 s or more",
                    SensorName::Touch(name.clone())
                ));
            }
        }
        let erase = |(image, dots): (&&RgbImage, &Option<ShearSensor>)| {
            dots.as_ref().filter(|_| !image.is_empty()).map(|sensor| sensor.erased(image))
        };
        let erased: Vec<Option<RgbImage>> = readable.iter().zip(dots.iter()).map(erase).collect();
        let seen: Vec<&RgbImage> =
            readable.iter().zip(&erased).map(|(image, erased)| erased.as_ref().unwrap_or(image)).collect();
        let felt = feeler.feel(&seen)?;
        for ((felt, told), (name, _)) in felt.iter().zip(told.iter_mut()).zip(sensors()) {
            if let Some(felt) = felt.as_ref().filter(|felt| felt.press.is_none())
                && !std::mem::replace(told, true)
            {
                warnings.push(format!(
                    "frame {frame}: {} is skipped wherever its image is implausible (plausibility {:.2} of 1): black, saturated, of another sensor, or unlike the training images",
                    SensorName::Touch(name.clone()),
                    felt.plausibility
                ));
            }
        }
        Ok(felt.into_iter().map(|felt| felt?.press).collect())
    }
}
