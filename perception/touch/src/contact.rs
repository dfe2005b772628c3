//! From touch images to depth and contact by a network: the prediction for the untouched sensor is subtracted, contact depends on the
//! frame before, and images that no such sensor makes are reported.

use std::sync::Arc;

use image::RgbImage;
use mvt_robot::hand::{Hand, PerPad, TouchPad};
use mvt_settings::settings;
use ndarray::{Array2, Zip};
use rayon::iter::{
    IndexedParallelIterator as _, IntoParallelRefIterator as _, IntoParallelRefMutIterator as _, ParallelIterator as _,
};

use crate::engine::{Engine, Prediction};
use crate::untouched::{Squares, UnusualLight, differences, scale_change, squares, subtract_untouched};
use mvt_robot::observation::{Press, SensorError, SensorName};

settings! {
    /// Thresholds that turn predictions into depth and contact.
    #[derive(Copy)]
    pub struct ContactConfig {
        /// A pixel touches if its indentation exceeds this, millimetres, and its probability of contact exceeds `probability`.
        pub threshold_mm: f32 = 0.08, 0.0..=5.0;
        /// Least probability of contact of a pixel that touches.
        pub probability: f32 = 0.5, 0.001..=0.999;
        /// A pixel that touched in the frame before touches until indentation and probability both fall below this share of their
        /// thresholds.
        pub hysteresis: f32 = 0.7, 0.001..=1.0;
        /// Contact on a smaller share of the image is discarded.
        pub least_area: f32 = 0.001, 0.0..=1.0;
        /// A sensor whose image differs from its untouched image by less than this, grey levels, is untouched, and the network does not run.
        /// The means of squares of pixels are compared: noise hardly changes them, the rim of a contact does.
        pub untouched_grey: f32 = 1.2, 0.0..=255.0;
        /// Standard deviation of the depth in contact, millimetres. It is larger in frames in which the network finds indentation outside
        /// of contact.
        pub sigma_mm: f32 = 0.05, 1e-4..=5.0;
        /// Images with a lower plausibility are not used.
        pub least_plausibility: f32 = 0.5, 0.0..=1.0;
    }
}

/// The contact on a touch sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Felt {
    /// The press; `None` if the image is not plausible.
    pub press: Option<Press>,
    /// From 0 to 1 how far the image is one that a DIGIT makes: how much of it is neither black nor saturated, how much colour
    /// varies over it, how far it is the untouched sensor's where nothing touches, and how far the network's two answers agree.
    pub plausibility: f32,
    /// Whether the network was asked.
    pub asked: bool,
}

/// An image that is not of its sensor's size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the image is {} x {} pixels; {} x {} expected", found[0], found[1], expected[0], expected[1])]
pub struct UnfitImage {
    /// Width and height of the sensor's images, pixels.
    pub expected: [usize; 2],
    /// Width and height, pixels.
    pub found: [usize; 2],
}

/// One touch sensor that a network reads, with what must be remembered of its earlier images. The one place where contact is decided.
#[derive(Debug, Clone)]
pub struct TouchSensor {
    /// Multiply the change of red, green and blue from the untouched image before the network sees it.
    gains: [f32; 3],
    /// The given image without contact, if any; it is subtracted from each image before the network reads it.
    untouched: Option<RgbImage>,
    /// Its light, if its changes must be scaled.
    light: Option<UnusualLight>,
    /// The sensor's last image without contact, and the network's indentation for it, millimetres; `None` before the first.
    empty: Option<(Squares, Array2<f32>)>,
    /// The image that the network sees.
    seen: RgbImage,
    prediction: Prediction,
    press: Press,
}

impl TouchSensor {
    /// Starts without an untouched image. The image is corrected after [`TouchSensor::set_untouched`], the prediction after that or after the
    /// first image without contact. `gains` multiply the change of red, green and blue from the untouched image before the network
    /// sees it. `size` is the width and height of the sensor's images, pixels.
    pub fn new([width, height]: [usize; 2], gains: [f32; 3]) -> Self {
        Self {
            gains,
            untouched: None,
            light: None,
            empty: None,
            seen: RgbImage::new(width as u32, height as u32),
            prediction: Prediction::default(),
            press: Press {
                indentation_mm: Array2::zeros((height, width)),
                contact: Array2::from_elem((height, width), false),
                sigma_mm: 0.0,
            },
        }
    }

    fn unfit(&self, image: &RgbImage) -> UnfitImage {
        let [expected, found] = [&self.seen, image].map(|of| [of.width() as usize, of.height() as usize]);
        UnfitImage { expected, found }
    }

    fn check(&self, image: &RgbImage) -> Result<(), UnfitImage> {
        if image.dimensions() == self.seen.dimensions() { Ok(()) } else { Err(self.unfit(image)) }
    }

    /// Sets the image of the sensor that touches nothing. Its light counts only if the sensor was not calibrated, which measures the light
    /// itself.
    ///
    /// # Errors
    /// [`UnfitImage`] if the image has another size than the sensor's.
    pub fn set_untouched(&mut self, engine: &Engine, image: &RgbImage) -> Result<(), UnfitImage> {
        self.check(image)?;
        self.untouched = Some(image.clone());
        self.light = if self.gains == [1.0; 3] { UnusualLight::of(image) } else { None };
        self.infer(engine, image)?;
        self.empty = Some((squares(image), self.prediction.indentation_mm.clone()));
        Ok(())
    }

    /// Returns the light of the sensor, if it is not that of other DIGITs. It is known with the untouched image.
    pub fn light(&self) -> Option<UnusualLight> {
        self.light
    }

    /// Returns the contact in the next image.
    ///
    /// # Errors
    /// [`UnfitImage`] if the image has another size than the sensor's.
    pub fn feel(&mut self, engine: &Engine, config: &ContactConfig, image: &RgbImage) -> Result<Felt, UnfitImage> {
        self.check(image)?;
        let Outcome { plausibility, asked } = feel(engine, config, image, self)?;
        let is_plausible = plausibility >= config.least_plausibility;
        Ok(Felt { press: is_plausible.then(|| self.press.clone()), plausibility, asked })
    }

    /// Returns the contacts in images that are independent of one another, as if each were the next, one image per thread.
    ///
    /// # Errors
    /// [`UnfitImage`] if an image has another size than the sensor's.
    pub fn feel_each(
        &self,
        engine: &Engine,
        config: &ContactConfig,
        images: &[RgbImage],
    ) -> Result<Vec<Felt>, UnfitImage> {
        images.par_iter().map(|image| self.clone().feel(engine, config, image)).collect()
    }

    /// The network's output for an image.
    fn infer(&mut self, engine: &Engine, image: &RgbImage) -> Result<(), UnfitImage> {
        let seen = match &self.untouched {
            None => image,
            Some(untouched) => {
                self.seen.copy_from_slice(image);
                subtract_untouched(untouched, &mut self.seen);
                scale_change(self.light.map_or(self.gains, |light| light.gains), &mut self.seen);
                &self.seen
            }
        };
        if engine.infer(seen, &mut self.prediction).is_err() {
            return Err(self.unfit(image));
        }
        Ok(())
    }
}

/// The touch sensors of a hand, each with the network that reads it.
#[derive(Debug)]
pub struct Feeler {
    config: ContactConfig,
    /// Names of the pads, for messages.
    names: Vec<String>,
    sensors: PerPad<(Arc<Engine>, TouchSensor)>,
}

/// How a sensor's image was dealt with.
#[derive(Debug, Clone, Copy)]
struct Outcome {
    plausibility: f32,
    asked: bool,
}

impl Feeler {
    /// Starts with the sensors of a hand without untouched images, and the network of each.
    pub fn new(hand: &Hand, engines: PerPad<Arc<Engine>>, config: ContactConfig) -> Self {
        let sensors = engines.into_iter().zip(hand.pads()).map(|(engine, TouchPad { profile, .. })| {
            let gains = engine.gains(profile);
            (engine, TouchSensor::new(profile.size_px, gains))
        });
        let names = hand.pads().iter().map(|pad| pad.name.clone()).collect();
        Self { config, names, sensors: sensors.collect() }
    }

    /// The network of the sensor of a pad.
    pub fn engine(&self, pad: usize) -> Option<&Engine> {
        self.sensors.get(pad).map(|(engine, _)| engine.as_ref())
    }

    /// Sets the image of the sensor of a pad that touches nothing. Has no effect if there is no such pad.
    ///
    /// # Errors
    /// [`SensorError::Size`] if the image has another size than the sensor's.
    pub fn set_untouched(&mut self, pad: usize, image: &RgbImage) -> Result<(), SensorError> {
        let Some(((engine, sensor), name)) = self.sensors.get_mut(pad).zip(self.names.get(pad)) else {
            return Ok(());
        };
        sensor.set_untouched(engine, image).map_err(|unfit| unfit.of(name))
    }

    /// Returns the light of a sensor, if it is not that of other DIGITs. It is known with the untouched image.
    pub fn light(&self, pad: usize) -> Option<UnusualLight> {
        self.sensors.get(pad)?.1.light()
    }

    /// Returns the contact on each sensor, one image per thread; `None` for a sensor without an image. Images are in the order of the pads.
    ///
    /// # Errors
    /// [`SensorError::Size`] if an image is neither empty nor of its sensor's size.
    pub fn feel(&mut self, images: &[&RgbImage]) -> Result<PerPad<Option<Felt>>, SensorError> {
        let Self { config, names, sensors } = self;
        let felt: Vec<Result<Option<Felt>, SensorError>> = sensors
            .par_iter_mut()
            .zip(names.par_iter())
            .enumerate()
            .map(|(pad, ((engine, sensor), name))| match images.get(pad).filter(|image| !image.is_empty()) {
                None => Ok(None),
                Some(image) => sensor.feel(engine, config, image).map(Some).map_err(|unfit| unfit.of(name)),
            })
            .collect();
        felt.into_iter().collect()
    }
}

impl UnfitImage {
    fn of(self, pad: &str) -> SensorError {
        SensorError::Size {
            sensor: SensorName::Touch(pad.to_owned()),
            image: "colour",
            expected: self.expected,
            found: self.found,
        }
    }
}

/// Depth and contact of one sensor, into `state`.
fn feel(
    engine: &Engine,
    config: &ContactConfig,
    image: &RgbImage,
    state: &mut TouchSensor,
) -> Result<Outcome, UnfitImage> {
    let squares = squares(image);
    let mut plausibility = exposure(image).min(contrast(&squares));
    plausibility = plausibility.min(state.light.map_or(1.0, |light| light.plausibility()));
    let known = state.empty.as_ref().map(|(empty, _)| differences(&squares, empty));
    if let Some((greatest, quartile)) = known {
        plausibility = plausibility.min(1.0 - ramp(quartile, 8.0, 32.0));
        let gain = state.light.map_or(1.0, |light| light.gains.into_iter().fold(1.0, f32::max));
        if gain * greatest < config.untouched_grey {
            state.press.indentation_mm.fill(0.0);
            state.press.contact.fill(false);
            state.press.sigma_mm = config.sigma_mm;
            return Ok(Outcome { plausibility, asked: false });
        }
    }
    if plausibility < config.least_plausibility {
        return Ok(Outcome { plausibility, asked: false });
    }
    state.infer(engine, image)?;
    let raw = &state.prediction.indentation_mm;
    let Press { indentation_mm, contact, sigma_mm } = &mut state.press;
    // An indentation of the untouched sensor is an error of the network, and is subtracted.
    match &state.empty {
        Some((_, empty)) => {
            Zip::from(&mut *indentation_mm).and(raw).and(empty).for_each(|to, a, b| *to = (a - b).max(0.0));
        }
        None => indentation_mm.assign(raw),
    }
    let summary = decide(config, &state.prediction.contact_logit, indentation_mm, contact);
    plausibility = plausibility.min(summary.agreement);
    if let (Some(_), Some(untouched)) = (state.light, &state.untouched) {
        plausibility = plausibility.min(unclipped(image, untouched, contact));
    }
    let has_contact = summary.area >= config.least_area;
    if !has_contact {
        contact.fill(false);
        if plausibility >= config.least_plausibility {
            state.empty = Some((squares, raw.clone()));
        }
    }
    *sigma_mm = config.sigma_mm.max(summary.residual_mm);
    Ok(Outcome { plausibility, asked: true })
}

/// Share of the contact in clipped pixels from which an image is less plausible, and from which not at all.
const CLIPPED: [f32; 2] = [0.1, 0.5];

/// Returns from 0 to 1 how far a contact lies where neither an image nor the untouched one is as bright as a pixel can be: there its depth is
/// unknown. For sensors with another light than the usual one.
fn unclipped(image: &RgbImage, untouched: &RgbImage, contact: &Array2<bool>) -> f32 {
    let is_clipped = |rgb: &[u8; 3]| rgb.contains(&u8::MAX);
    let pixels = image.as_chunks::<3>().0.iter().zip(untouched.as_chunks::<3>().0);
    let touching = pixels.zip(contact).filter(|(_, touches)| **touches);
    let (all, clipped) = touching.fold((0, 0), |(all, clipped), ((image, untouched), _)| {
        (all + 1, clipped + usize::from(is_clipped(image) || is_clipped(untouched)))
    });
    1.0 - ramp(clipped as f32 / all.max(1) as f32, CLIPPED[0], CLIPPED[1])
}

/// The result of a decision over all pixels.
struct Decision {
    /// Share of the image that touches.
    area: f32,
    /// Root mean square of the indentation where nothing touches, millimetres.
    residual_mm: f32,
    /// From 0 to 1 how far indentation and contact do not contradict each other where either is clear.
    agreement: f32,
}

/// Indented by more than this many times the threshold a pixel is in contact whatever the press, by less than that it is not: between
/// them lie the thresholds from which networks learn what contact is.
const DEEP: f32 = 3.0;
const FLAT: f32 = 0.6;
/// Above this probability a network is sure.
const SURE: f32 = 0.9;

/// Decides pixel by pixel; `contact` holds the frame before and receives the decision.
fn decide(
    config: &ContactConfig,
    logits: &Array2<f32>,
    indentation_mm: &Array2<f32>,
    contact: &mut Array2<bool>,
) -> Decision {
    let logit = |p: f32| (p / (1.0 - p)).ln();
    let [enter, stay] =
        [1.0, config.hysteresis].map(|share| (share * config.threshold_mm, logit(share * config.probability)));
    let [deep_mm, flat_mm] = [DEEP, FLAT].map(|times| times * config.threshold_mm);
    let [sure, sure_not] = [SURE, 1.0 - SURE].map(logit);
    let (mut touching, mut clear, mut contradicted, mut squares) = (0, 0, 0, 0.0);
    for ((touches, &score), &mm) in contact.iter_mut().zip(logits).zip(indentation_mm) {
        let (threshold_mm, least) = if *touches { stay } else { enter };
        let (indented, probable) = (mm > threshold_mm, score > least);
        *touches = indented && probable;
        touching += usize::from(*touches);
        clear += usize::from(mm > deep_mm || score > sure);
        contradicted += usize::from((mm > deep_mm && score < sure_not) || (mm < flat_mm && score > sure));
        if !*touches {
            squares += mm * mm;
        }
    }
    let count = logits.len();
    Decision {
        area: touching as f32 / count as f32,
        residual_mm: (squares / (count - touching).max(1) as f32).sqrt(),
        // Of a few pixels nothing is concluded.
        agreement: if clear * 50 > count { 1.0 - ramp(contradicted as f32 / clear as f32, 0.3, 0.9) } else { 1.0 },
    }
}

/// 0 up to `low`, 1 from `high` on.
fn ramp(x: f32, low: f32, high: f32) -> f32 {
    ((x - low) / (high - low)).clamp(0.0, 1.0)
}

/// From 0 to 1 how far an image is neither black nor saturated.
fn exposure(image: &RgbImage) -> f32 {
    let is_exposed = |rgb: &&[u8; 3]| (12..=250).contains(&rgb.iter().max().copied().unwrap_or(0));
    let pixels = image.as_chunks::<3>().0;
    ramp(pixels.iter().filter(is_exposed).count() as f32 / pixels.len().max(1) as f32, 0.4, 0.8)
}

/// From 0 to 1 how far colours vary over an image: a DIGIT's LEDs light its gel from three sides.
fn contrast(squares: &Squares) -> f32 {
    let count = squares.len().max(1) as f32;
    let spread = [0, 1, 2].map(|c| {
        let mean = squares.iter().map(|rgb| rgb[c]).sum::<f32>() / count;
        (squares.iter().map(|rgb| (rgb[c] - mean).powi(2)).sum::<f32>() / count).sqrt()
    });
    ramp(spread.into_iter().fold(0.0, f32::max), 1.0, 4.0)
}

#[cfg(test)]
mod tests;
