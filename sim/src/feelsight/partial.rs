//! Frames of a log of which parts may be missing or damaged.

use std::path::PathBuf;

use ndarray::Array2;
use scenes::frame::{Isometry, Object, World};
use scenes::hand::{Finger, JointAngles, PerFinger};
use scenes::observation::TouchTruth;

use super::{Error, Log, npz};

/// A sensor of a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Sensor {
    /// Camera by its index in the log.
    Camera(usize),
    /// The DIGIT of a finger.
    Touch(Finger),
}

/// The depths of one instant, as far as they can be read. Colours are not.
#[derive(Debug)]
pub struct PartialFrame {
    /// Seconds.
    pub time_s: f64,
    /// Joint angles.
    pub joints: JointAngles,
    /// Pose of the object, where the log has one.
    pub object_pose: Option<Isometry<Object, World>>,
    /// Depth of each camera that was asked for, metres, indexed (row, column); NaN and infinite where the log has that.
    pub cameras: Vec<Option<Array2<f32>>>,
    /// True depth and contact of each DIGIT that was asked for.
    pub touch: PerFinger<Option<TouchTruth>>,
    /// Why something is missing. A camera whose file is damaged says so once and is silent from there on.
    pub defects: Vec<(Sensor, Error)>,
}

/// Iterator over what can be read of a log's frames.
pub struct PartialFrames {
    log: Log,
    next: usize,
    /// Index of each camera and its depths; none once they are damaged.
    cameras: Vec<(usize, Option<(PathBuf, npz::Reader)>)>,
    touch: PerFinger<bool>,
    /// Found on opening; told with the first frame.
    defects: Vec<(Sensor, Error)>,
}

impl Log {
    /// The frames of the log as far as they can be read: depths of these cameras, by index, and of these DIGITs.
    pub fn into_partial_frames(self, cameras: &[usize], touch: PerFinger<bool>) -> PartialFrames {
        let mut defects = Vec::new();
        let mut open = |&camera: &usize| match self.depths(camera) {
            Ok(depths) => (camera, Some(depths)),
            Err(error) => {
                defects.push((Sensor::Camera(camera), error));
                (camera, None)
            }
        };
        let cameras = cameras.iter().filter(|&&camera| camera < self.cameras().len()).map(&mut open).collect();
        PartialFrames { log: self, next: 0, cameras, touch, defects }
    }
}

impl PartialFrames {
    /// The log.
    pub fn log(&self) -> &Log {
        &self.log
    }

    /// Whether any sensor may still deliver anything.
    pub fn has_sensor(&self) -> bool {
        self.cameras.iter().any(|(_, depths)| depths.is_some())
            || self.touch.iter().any(|(finger, &wanted)| wanted && self.log.has_touch_truth(finger))
    }

    /// What was found on opening, before the first frame was read.
    pub fn defects(&self) -> &[(Sensor, Error)] {
        &self.defects
    }
}

impl Iterator for PartialFrames {
    type Item = PartialFrame;

    fn next(&mut self) -> Option<PartialFrame> {
        let Self { log, next, cameras, touch, defects } = self;
        let i = *next;
        let (&time_s, &joints) = log.times_s().get(i).zip(log.joints().get(i))?;
        *next += 1;
        let mut defects = std::mem::take(defects);
        let cameras = cameras.iter_mut().map(|(camera, depths)| match log.next_depth(*camera, depths.as_mut()?) {
            Ok(depth_m) => Some(depth_m),
            Err(error) => {
                defects.push((Sensor::Camera(*camera), error));
                *depths = None;
                None
            }
        });
        let cameras = cameras.collect();
        let mut read = |finger: Finger| {
            let truth = touch[finger].then(|| log.touch_truth(finger, i))?;
            truth.map_err(|error| defects.push((Sensor::Touch(finger), error))).ok()
        };
        let touch = PerFinger::from_fn(&mut read);
        let object_pose = log.object_poses().get(i).copied().flatten();
        Some(PartialFrame { time_s, joints, object_pose, cameras, touch, defects })
    }
}
