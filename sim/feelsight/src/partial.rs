//! Frames of a log with missing or damaged parts.

use image::RgbImage;
use mvt_frames::{Isometry, Object, World};
use mvt_robot::hand::{JointAngles, PerPad};
use mvt_robot::observation::TouchTruth;
use ndarray::Array2;

use crate::depths::DepthReader;
use crate::error::LogError;
use crate::reader::Log;

/// Sensor of a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LogSensor {
    /// Camera by its index in the log.
    Camera(usize),
    /// Touch sensor by the index of its pad.
    Touch(usize),
}

/// Part of the touch sensors' files that is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TouchPart {
    /// Nothing.
    None,
    /// True depth and contact.
    Truth,
    /// Images.
    Images,
}

/// Measurements of one instant that can be read, without the colours of cameras.
#[derive(Debug)]
pub struct PartialFrame {
    /// Seconds.
    pub time_s: f64,
    /// Joint angles.
    pub joints: JointAngles,
    /// Pose of the object; `None` if the log has no pose.
    pub object_pose: Option<Isometry<Object, World>>,
    /// Depth of each requested camera, metres, indexed (row, column); NaN or infinite where the log is.
    pub cameras: Vec<Option<Array2<f32>>>,
    /// True depth and contact of each touch sensor, with [`TouchPart::Truth`].
    pub touch_truth: PerPad<Option<TouchTruth>>,
    /// Image of each touch sensor, with [`TouchPart::Images`].
    pub touch_images: PerPad<Option<RgbImage>>,
    /// Reasons for missing parts. A damaged file of a camera is reported once.
    pub defects: Vec<(LogSensor, LogError)>,
}

/// Iterator over the readable frames of a log.
pub struct PartialFrames {
    log: Log,
    next: usize,
    /// Index of each camera and its depths; `None` once they are damaged.
    cameras: Vec<(usize, Option<DepthReader>)>,
    touch: TouchPart,
    /// Found on opening; reported with the first frame.
    defects: Vec<(LogSensor, LogError)>,
}

impl Log {
    /// Iterates over the readable parts of the frames: the depths of these cameras, by index, and this part of the
    /// touch sensors' files.
    pub fn into_partial_frames(self, cameras: &[usize], touch: TouchPart) -> PartialFrames {
        let mut defects = Vec::new();
        let mut open = |&camera: &usize| match self.depths(camera) {
            Ok(depths) => (camera, Some(depths)),
            Err(error) => {
                defects.push((LogSensor::Camera(camera), error));
                (camera, None)
            }
        };
        let cameras = cameras.iter().filter(|&&camera| camera < self.cameras().len()).map(&mut open).collect();
        PartialFrames { log: self, next: 0, cameras, touch, defects }
    }
}

impl PartialFrames {
    /// Returns the log.
    pub fn log(&self) -> &Log {
        &self.log
    }

    /// Returns whether any sensor may still deliver data.
    pub fn has_sensor(&self) -> bool {
        self.cameras.iter().any(|(_, depths)| depths.is_some())
            || (0..self.log.hand().pads().len()).any(|pad| match self.touch {
                TouchPart::None => false,
                TouchPart::Truth => self.log.has_touch_truth(pad),
                TouchPart::Images => self.log.has_touch_images(pad),
            })
    }

    /// Returns the defects that were found on opening, before the first frame is read.
    pub fn defects(&self) -> &[(LogSensor, LogError)] {
        &self.defects
    }
}

impl Iterator for PartialFrames {
    type Item = PartialFrame;

    fn next(&mut self) -> Option<PartialFrame> {
        let Self { log, next, cameras, touch, defects } = self;
        let i = *next;
        let (&time_s, joints) = log.times_s().get(i).zip(log.joints().get(i))?;
        *next += 1;
        let mut defects = std::mem::take(defects);
        let cameras = cameras.iter_mut().map(|(camera, depths)| match log.next_depth(*camera, depths.as_mut()?) {
            Ok(depth_m) => Some(depth_m),
            Err(error) => {
                defects.push((LogSensor::Camera(*camera), error));
                *depths = None;
                None
            }
        });
        let cameras = cameras.collect();
        let (mut touch_truth, mut touch_images) = (log.hand().per_pad(|_| None), log.hand().per_pad(|_| None));
        for pad in 0..log.hand().pads().len() {
            let read = match touch {
                TouchPart::None => Ok(()),
                TouchPart::Truth => log.touch_truth(pad, i).map(|truth| touch_truth[pad] = Some(truth)),
                TouchPart::Images => log.touch_image(pad, i).map(|image| touch_images[pad] = Some(image)),
            };
            defects.extend(read.err().map(|error| (LogSensor::Touch(pad), error)));
        }
        let object_pose = log.object_poses().get(i).copied().flatten();
        Some(PartialFrame { time_s, joints: joints.clone(), object_pose, cameras, touch_truth, touch_images, defects })
    }
}
