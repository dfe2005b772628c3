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
use crate::light::{SensorLight, exposure_of};
use crate::plausibility::{Evidence, contrast, exposure, ramp, unclipped};
use crate::untouched::{Squares, differences, squares};
use mvt_robot::digit::profile::{Appearance, SensorProfile};
use mvt_robot::observation::{Press, SensorError, SensorName};

settings! {
    /// Thresholds that turn predictions into depth and contact.
    #[derive(Copy)]
    pub struct ContactConfig {
        /// A pixel touches if its indentation exceeds this, millimetres, and its probability of contact exceeds `probability`.
        pub threshold_mm: f32 = 0.08, 0.0..=5.0;
        /// Least probability of contact of a pixel that touches.
        pub probability: f32 = 0.5, 0.001..=0.999;
        /// A gel that bends is pressed in beyond the contact, too: a pixel touches only if its indentation also exceeds `flank_mm` of the
        /// sensor's profile, or this share of the deepest if that is less, as in a light press.
        pub flank_share: f32 = 0.4, 0.0..=1.0;
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
    /// From 0 to 1 how far the image is one that such a sensor makes: how much of it is neither black nor saturated, how much colour
    /// varies over it, how far it is the untouched sensor's where nothing touches, and how far the network's two answers agree. Of sensors
    /// with an appearance it is also at most the probability that the reading is right, as [`Evidence::probability`] says.
    pub plausibility: f32,
    /// What speaks for the reading; `None` of sensors without an appearance, and of images that the network was not asked about.
    pub evidence: Option<Evidence>,
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
    /// How the sensor looks beside those for which the network was trained. `None`: as TACTO renders it.
    look: Option<Look>,
    /// Indentation of the gel at the border of a contact, millimetres.
    flank_mm: f32,
    light: SensorLight,
    /// The given image without contact, if any; it is subtracted from each image before the network reads it.
    untouched: Option<(RgbImage, Squares)>,
    /// The sensor's last image without contact, and the network's indentation for it, millimetres; `None` before the first.
    empty: Option<(Squares, Array2<f32>)>,
    /// The image that the network sees.
    seen: RgbImage,
    prediction: Prediction,
    press: Press,
}

/// Look of a real sensor.
#[derive(Debug, Clone, Copy)]
struct Look {
    own: Appearance,
    /// Whether it is that of the sensors for which the network was trained, and not one that was calibrated.
    is_usual: bool,
    pixel_mm: f32,
}

impl TouchSensor {
    /// Starts without an untouched image. The image is corrected after [`TouchSensor::set_untouched`], the prediction after that or after the
    /// first image without contact. `engine` reads the sensor's images from now on.
    pub fn new(engine: &Engine, profile: &SensorProfile) -> Self {
        let ([width, height], gains) = (profile.size_px, engine.gains(profile));
        let look = profile.appearance.map(|own| Look {
            own,
            is_usual: gains == [1.0; 3],
            pixel_mm: profile.pixel_mm() as f32,
        });
        Self {
            look,
            flank_mm: profile.flank_mm,
            light: SensorLight::known(gains),
            untouched: None,
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
        let squares = squares(image);
        match self.look {
            Some(Look { own, is_usual: true, .. }) => self.light = SensorLight::of(image, &own, true),
            None => self.light = SensorLight::of(image, &Appearance::default(), false),
            Some(_) => {}
        }
        self.untouched = Some((image.clone(), squares.clone()));
        self.infer(engine, image, [1.0; 3])?;
        self.empty = Some((squares, self.prediction.indentation_mm.clone()));
        Ok(())
    }

    /// Returns the light of the sensor. It is known with the untouched image.
    pub fn light(&self) -> &SensorLight {
        &self.light
    }

    /// Returns the contact in the next image.
    ///
    /// # Errors
    /// [`UnfitImage`] if the image has another size than the sensor's.
    pub fn feel(&mut self, engine: &Engine, config: &ContactConfig, image: &RgbImage) -> Result<Felt, UnfitImage> {
        self.check(image)?;
        let Outcome { plausibility, asked, evidence } = feel(engine, config, image, self)?;
        let is_plausible = plausibility >= config.least_plausibility;
        Ok(Felt { press: is_plausible.then(|| self.press.clone()), plausibility, evidence, asked })
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

    /// The network's output for an image whose exposure relative to the untouched one is known.
    fn infer(&mut self, engine: &Engine, image: &RgbImage, exposure: [f32; 3]) -> Result<(), UnfitImage> {
        let seen = match &self.untouched {
            None => image,
            Some((untouched, _)) => {
                self.light.change(image, untouched, exposure, &mut self.seen);
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
    evidence: Option<Evidence>,
}

impl Feeler {
    /// Starts with the sensors of a hand without untouched images, and the network of each.
    pub fn new(hand: &Hand, engines: PerPad<Arc<Engine>>, config: ContactConfig) -> Self {
        let sensors = engines.into_iter().zip(hand.pads()).map(|(engine, TouchPad { profile, .. })| {
            let sensor = TouchSensor::new(&engine, profile);
            (engine, sensor)
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

    /// Returns the light of a sensor; `None` if there is no such pad. It is known with the untouched image.
    pub fn light(&self, pad: usize) -> Option<&SensorLight> {
        self.sensors.get(pad).map(|(_, sensor)| sensor.light())
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
    // Why: notes/decisions/touch.md, "The network's prediction for the untouched gel is subtracted, too".
    let mut squares = squares(image);
    let mut plausibility = exposure(image).min(contrast(&squares)).min(state.light.plausibility());
    // A real camera's exposure drifts; the light of the simulated ones is constant.
    let exposure = match (&state.look, &state.untouched) {
        (Some(_), Some((_, untouched))) => exposure_of(&squares, untouched),
        _ => [1.0; 3],
    };
    squares.iter_mut().for_each(|rgb| *rgb = std::array::from_fn(|c| rgb[c] / exposure[c]));
    let known = state.empty.as_ref().map(|(empty, _)| differences(&squares, empty));
    if let Some((greatest, quartile)) = known {
        plausibility = plausibility.min(1.0 - ramp(quartile, 8.0, 32.0));
        if state.light.greatest_gain() * greatest < config.untouched_grey {
            state.press.indentation_mm.fill(0.0);
            state.press.contact.fill(false);
            state.press.sigma_mm = config.sigma_mm;
            return Ok(Outcome { plausibility, asked: false, evidence: None });
        }
    }
    if plausibility < config.least_plausibility {
        return Ok(Outcome { plausibility, asked: false, evidence: None });
    }
    state.infer(engine, image, exposure)?;
    let raw = &state.prediction.indentation_mm;
    let Press { indentation_mm, contact, sigma_mm } = &mut state.press;
    // An indentation of the untouched sensor is an error of the network, and is subtracted.
    match &state.empty {
        Some((_, empty)) => {
            Zip::from(&mut *indentation_mm).and(raw).and(empty).for_each(|to, a, b| *to = (a - b).max(0.0));
        }
        None => indentation_mm.assign(raw),
    }
    let deepest_mm = indentation_mm.iter().copied().fold(0.0, f32::max);
    let threshold_mm = (config.flank_share * deepest_mm).min(state.flank_mm).max(config.threshold_mm);
    let summary = decide(config, threshold_mm, &state.prediction.contact_logit, indentation_mm, contact);
    plausibility = plausibility.min(summary.agreement);
    if let (false, Some((untouched, _))) = (state.light.is_usual(), &state.untouched) {
        plausibility = plausibility.min(unclipped(image, untouched, contact));
    }
    let evidence = state.look.filter(|_| state.untouched.is_some()).map(|Look { own, pixel_mm, .. }| {
        Evidence::of(&state.seen, indentation_mm, pixel_mm, &own, summary.residual_mm, &state.light)
    });
    if let Some(evidence) = &evidence {
        plausibility = plausibility.min(evidence.probability());
    }
    let has_contact = summary.area >= config.least_area;
    if !has_contact {
        contact.fill(false);
        if plausibility >= config.least_plausibility {
            state.empty = Some((squares, raw.clone()));
        }
    }
    *sigma_mm = config.sigma_mm.max(summary.residual_mm);
    Ok(Outcome { plausibility, asked: true, evidence })
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

/// Decides pixel by pixel, with the least indentation of a pixel in contact; `contact` holds the frame before and receives the decision.
fn decide(
    config: &ContactConfig,
    threshold_mm: f32,
    logits: &Array2<f32>,
    indentation_mm: &Array2<f32>,
    contact: &mut Array2<bool>,
) -> Decision {
    let logit = |p: f32| (p / (1.0 - p)).ln();
    let [enter, stay] = [1.0, config.hysteresis].map(|share| (share * threshold_mm, logit(share * config.probability)));
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

#[cfg(test)]
mod tests;
