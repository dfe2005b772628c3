//! From observations to percepts, frame by frame.

use std::sync::Arc;

use image::RgbImage;
use mvt_calibration::{Calibrated, Calibration, CalibrationConfig, CalibrationError, Calibrator};
use mvt_frames::camera::PosedCamera;
use mvt_robot::hand::solid::HandSolid;
use mvt_robot::hand::{Hand, JointAngles, PerPad};
use mvt_robot::observation::{Observation, Percept, Press, Rgbd, SensorError};
use mvt_segmentation::SegmentationConfig;
use mvt_touch::contact::ContactConfig;
use mvt_touch::network::Weights;

use crate::error::PerceptionError;
use crate::percept::{check, check_per_pad, labelled};
use crate::sensors::TouchSensors;

/// Settings of perception.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PerceptionConfig {
    /// Contact from a touch network's predictions.
    pub touch: ContactConfig,
    /// Refinement of camera poses and joint angles.
    pub calibration: CalibrationConfig,
    /// Labels of camera pixels.
    pub segmentation: SegmentationConfig,
}

/// How a hand's sensors are read.
#[derive(Debug, Clone, Copy)]
pub struct PerceptionSetup<'a> {
    /// The networks that read touch images, by pad; pads with the same weights share one. Without them, presses are given with each
    /// observation.
    pub weights: Option<&'a PerPad<Arc<Weights>>>,
    /// Settings.
    pub config: PerceptionConfig,
}

/// What perception made of a frame.
#[derive(Debug, Clone)]
pub struct Seen {
    /// The measurements: all that estimation receives.
    pub percept: Percept,
    /// The touch images of the observation, for recordings.
    pub touch_images: PerPad<RgbImage>,
    /// Warnings that were not given before, in sentences.
    pub warnings: Vec<String>,
}

/// Turns observations of a hand into percepts.
pub struct Perception {
    hand: Arc<Hand>,
    segmentation: SegmentationConfig,
    calibrator: Calibrator,
    /// Without them, presses are given.
    sensors: Option<TouchSensors>,
    /// Time and joint readings of the frame after the next one.
    next_joints: Option<(f64, JointAngles)>,
    /// Time of the frame before, seconds.
    newest_s: Option<f64>,
    warnings: Vec<String>,
}

impl Perception {
    /// Starts with the poses that the cameras have, and with touch sensors whose untouched images are unknown.
    pub fn new(hand: Arc<Hand>, cameras: Vec<PosedCamera>, setup: &PerceptionSetup<'_>) -> Self {
        let PerceptionConfig { touch, calibration, segmentation } = setup.config;
        Self {
            segmentation,
            calibrator: Calibrator::new(calibration, Arc::clone(&hand), cameras),
            sensors: setup.weights.map(|weights| TouchSensors::new(weights, touch, &hand)),
            next_joints: None,
            newest_s: None,
            warnings: Vec::new(),
            hand,
        }
    }

    /// Whether touch images are read, so that presses need not be given.
    pub fn reads_touch_images(&self) -> bool {
        self.sensors.is_some()
    }

    /// Sets the image of the touch sensor of a pad that touches nothing. Has no effect where touch images are not read.
    ///
    /// # Errors
    /// If the image has another size than the sensor's, or does not show the dots of its profile.
    pub fn set_untouched(&mut self, pad: usize, image: &RgbImage) -> Result<(), PerceptionError> {
        self.sensors.as_mut().map_or(Ok(()), |sensors| sensors.set_untouched(pad, image))
    }

    /// Estimates the untouched image of the touch sensor of a pad from images with contacts at different places. Without images it stays unknown.
    ///
    /// # Errors
    /// As [`Perception::set_untouched`].
    pub fn learn_untouched(&mut self, pad: usize, images: &[RgbImage]) -> Result<(), PerceptionError> {
        self.sensors.as_mut().map_or(Ok(()), |sensors| sensors.learn_untouched(pad, images))
    }

    /// Starts from a calibration that was measured before, in place of the given one.
    ///
    /// # Errors
    /// If a number of it is invalid, or it is that of another hand.
    pub fn start_from(&mut self, calibration: &Calibration) -> Result<(), CalibrationError> {
        self.calibrator.start_from(calibration)
    }

    /// Tells time and joint readings of the frame after the next one, as a log knows them. With readings that are late, joint angles are
    /// else extrapolated.
    pub fn set_next_joints(&mut self, time_s: f64, joints: JointAngles) {
        self.next_joints = Some((time_s, joints));
    }

    /// Takes the next frame; `number` is for warnings. Labels that come with an image are used in place of the hand's geometry. A part of the observation that was not delivered is an empty image; no touch images
    /// are those of sensors that delivered nothing. `presses` are those of touch sensors that measure indentation themselves, as a simulator's
    /// do; without them touch images are read, if there is a network.
    ///
    /// # Errors
    /// If an image or its labels have another size than its sensor's, labels are to be given and are not, there are more cameras than poses, the hand has another number of joints or pads, a
    /// number is not finite, or the frame is not newer than the one before.
    pub fn see(
        &mut self,
        number: u64,
        observation: Observation,
        presses: Option<PerPad<Option<Press>>>,
    ) -> Result<Seen, PerceptionError> {
        check(&observation, &self.hand, self.calibrator.given(), self.segmentation.labels)?;
        check_per_pad(&self.hand, "presses", presses.as_deref().unwrap_or_default())?;
        let time_s = observation.time_s;
        if let Some(newest_s) = self.newest_s.filter(|newest_s| time_s <= *newest_s) {
            return Err(SensorError::Time { time_s, newest_s }.into());
        }
        self.newest_s = Some(time_s);
        let Observation { joints, touch: touch_images, cameras, .. } = observation;
        let mut touch = match (&mut self.sensors, presses) {
            (_, Some(presses)) if !presses.is_empty() => presses,
            (Some(sensors), None) => sensors.feel(number, &touch_images, &mut self.warnings)?,
            _ => self.hand.per_pad(|_| None),
        };
        let (mut colours, mut depths_m, mut labels, mut poses) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for Rgbd { color, depth_m, labels: given, world_from_camera } in cameras {
            colours.push(color);
            depths_m.push((!depth_m.is_empty()).then_some(depth_m));
            labels.push(given);
            poses.push(world_from_camera);
        }
        // Why: notes/decisions/calibration.md, "Calibration comes before pixels are labelled".
        let calibrated = self.calibrator.observe(time_s, &joints, self.next_joints.take(), &depths_m);
        calibrated.skip(&mut depths_m);
        if calibrated.is_frozen {
            touch = self.hand.per_pad(|_| None);
        }
        let Calibrated { joints, mut cameras, warnings, .. } = calibrated;
        for (camera, pose) in cameras.iter_mut().zip(poses) {
            camera.pose = pose.unwrap_or(camera.pose);
        }
        self.warnings.extend(warnings);
        let (hand, grasp) = (HandSolid::new(&self.hand, &joints), self.hand.grasp_centre(&joints));
        let cameras = labelled(depths_m, &labels, &cameras, &hand, grasp, &self.segmentation);
        let mut percept = Percept { time_s, joints, cameras, touch };
        percept.set_colours(colours);
        Ok(Seen { percept, touch_images, warnings: std::mem::take(&mut self.warnings) })
    }

    /// The calibration known so far; `None` if it is taken as given.
    pub fn calibration(&self) -> Option<Calibration> {
        self.calibrator.refined()
    }
}
