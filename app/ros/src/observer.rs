//! Frames of messages as observations: images in the size of depth, joint angles by name.

use std::collections::BTreeMap;
use std::sync::Arc;

use image::RgbImage;
use mvt_bag::{RosCamera, RosCameraInfo, RosJointState, RosLens, RosPicture};
use mvt_frames::depth::GivenLabels;
use mvt_frames::{Camera, Isometry, World};
use mvt_robot::hand::{Hand, JointAngles, PerPad, TouchPad};
use mvt_robot::observation::{Observation, Rgbd};
use mvt_sensor::GelWindow;

use crate::feed::StreamNumbers;
use crate::pairing::{FramePart, PairedFrame};
use crate::setup::RosSetup;

/// Names of joints that a message lists are given up to this number.
const NAMED: usize = 6;

/// Makes observations of frames.
pub(crate) struct Observer {
    setup: RosSetup,
    hand: Arc<Hand>,
    camera: RosCamera,
    info: RosCameraInfo,
    numbers: StreamNumbers,
    /// By pad, where the images of a topic show more than the gel. Those of sensors of this computer are cut already.
    windows: Vec<Option<GelWindow>>,
}

/// A frame that cannot be used: its topic, and the reason in one line.
pub(crate) type Unusable = (String, String);

impl Observer {
    /// Returns an observer for a camera of this model. `file` names the user's file, for messages.
    ///
    /// # Errors
    /// A sentence if the model is none of a camera.
    pub fn new(
        setup: &RosSetup,
        hand: Arc<Hand>,
        info: RosCameraInfo,
        numbers: StreamNumbers,
        file: &str,
    ) -> Result<Self, String> {
        let lens = RosLens::new(&info, RosCamera::is_rectified(&setup.depth))
            .map_err(|reason| format!("{}: {reason}", setup.camera_info))?;
        let mut camera = RosCamera::new(lens, file);
        (camera.depth_unit_m, camera.object) = (setup.depth_unit_m, setup.object);
        let window = |pad: &TouchPad| setup.touch.get(&pad.name).and_then(|_| GelWindow::of(&pad.profile));
        let windows = hand.pads().iter().map(window).collect();
        Ok(Self { setup: setup.clone(), hand, camera, info, numbers, windows })
    }

    /// Returns the lens of depth.
    pub fn lens(&self) -> RosLens {
        self.camera.lens
    }

    /// Takes a camera model that may have changed; returns whether it did.
    ///
    /// # Errors
    /// A sentence if the model is none of a camera.
    pub fn update(&mut self, info: RosCameraInfo) -> Result<bool, String> {
        let is_same = |a: &RosCameraInfo, b: &RosCameraInfo| {
            (a.width, a.height, a.k, &a.d, a.binning, a.part) == (b.width, b.height, b.k, &b.d, b.binning, b.part)
        };
        if is_same(&self.info, &info) {
            return Ok(false);
        }
        let new = Self::new(&self.setup, Arc::clone(&self.hand), info, self.numbers.clone(), &self.camera.file)?;
        *self = new;
        Ok(true)
    }

    /// Returns the observation of a frame.
    ///
    /// # Errors
    /// [`Unusable`] if an image or the joints of it cannot be used.
    pub fn observe(
        &mut self,
        frame: &PairedFrame<Vec<u8>>,
        is_compressed: impl Fn(usize) -> bool,
        world_from_camera: Option<Isometry<Camera, World>>,
    ) -> Result<Observation, Unusable> {
        let Self { setup, hand, camera, numbers, windows, .. } = self;
        let message = |number: usize| match frame.parts.get(number) {
            Some(FramePart::One(one)) => Some(one.item.as_slice()),
            _ => None,
        };
        fn of<T>(topic: &str, result: Result<T, mvt_bag::RosError>) -> Result<T, Unusable> {
            result.map_err(|reason| (topic.to_owned(), reason.to_string()))
        }
        let picture = |number: usize, topic: &str| match message(number) {
            Some(bytes) => of(topic, RosPicture::decode(bytes, is_compressed(number))).map(Some),
            None => Ok(None),
        };
        let Some(depth) = picture(0, &setup.depth)? else {
            return Err((setup.depth.clone(), "it is missing".to_owned()));
        };
        let depth_m = of(&setup.depth, camera.depth_m(&depth))?;
        let mut color = RgbImage::default();
        if let (Some(number), Some(topic)) = (numbers.color, &setup.color)
            && let Some(image) = picture(number, topic)?
        {
            color = of(topic, camera.colours(&image, topic))?;
        }
        let mut labels = None;
        if let (Some(number), Some(topic)) = (numbers.masks, &setup.masks)
            && let Some(image) = picture(number, topic)?
        {
            labels = Some(GivenLabels::Mask(of(topic, camera.mask(&image, topic))?));
        }
        let mut touch = Vec::new();
        for ((pad, number), window) in hand.pads().iter().zip(&numbers.touch).zip(windows) {
            let name = setup.touch.get(&pad.name).or_else(|| setup.touch_cameras.get(&pad.name));
            let topic = name.map_or("", String::as_str);
            let image = number.map(|number| picture(number, topic)).transpose()?.flatten();
            let image = image.map(|image| of(topic, image.colours())).transpose()?.unwrap_or_default();
            touch.push(match window {
                Some(window) if !image.is_empty() => {
                    window.cut(&image).map_err(|reason| (topic.to_owned(), reason.to_string()))?
                }
                _ => image,
            });
        }
        let joints = match (numbers.joints.and_then(|number| frame.parts.get(number)), &setup.joints) {
            (Some(part), Some(topic)) => {
                joints(part, frame.stamp_ns, hand, &setup.joint_names).map_err(|reason| (topic.clone(), reason))?
            }
            _ => JointAngles::new(),
        };
        Ok(Observation {
            time_s: frame.time_ns as f64 * 1e-9,
            joints,
            touch: PerPad(touch),
            cameras: vec![Rgbd { color, depth_m, labels, world_from_camera }],
        })
    }
}

/// Returns the angles of a hand's joints at a stamp, in their order.
fn joints(
    part: &FramePart<Vec<u8>>,
    stamp_ns: i64,
    hand: &Hand,
    names: &BTreeMap<String, String>,
) -> Result<JointAngles, String> {
    let read = |message: &[u8]| {
        let state = RosJointState::decode(message).map_err(|reason| reason.to_string())?;
        angles(&state, hand, names)
    };
    match part {
        FramePart::Missing => Err("it is missing".to_owned()),
        FramePart::One(one) => read(&one.item),
        FramePart::Between(before, after) => {
            let (a, b) = (read(&before.item)?, read(&after.item)?);
            let share = (stamp_ns - before.stamp_ns) as f64 / (after.stamp_ns - before.stamp_ns).max(1) as f64;
            Ok(a.iter().zip(&b).map(|(a, b)| a + share * (b - a)).collect())
        }
    }
}

/// Returns the velocities of a hand's joints in their order; `None` if one is unknown.
pub(crate) fn velocities(state: &RosJointState, hand: &Hand, names: &BTreeMap<String, String>) -> Option<JointAngles> {
    let known: BTreeMap<&str, f64> = state.velocities.iter().map(|(name, speed)| (name.as_str(), *speed)).collect();
    let named = |joint: &str| names.get(joint).map_or_else(|| joint.to_owned(), Clone::clone);
    hand.joints().iter().map(|joint| known.get(named(&joint.name).as_str()).copied()).collect()
}

/// Returns the angles of a hand's joints in their order.
pub(crate) fn angles(
    state: &RosJointState,
    hand: &Hand,
    names: &BTreeMap<String, String>,
) -> Result<JointAngles, String> {
    let known: BTreeMap<&str, f64> = state.positions.iter().map(|(name, angle)| (name.as_str(), *angle)).collect();
    let named = |joint: &str| names.get(joint).map_or_else(|| joint.to_owned(), Clone::clone);
    let missing: Vec<String> = hand
        .joints()
        .iter()
        .map(|joint| named(&joint.name))
        .filter(|name| !known.contains_key(name.as_str()))
        .collect();
    if let Some(first) = missing.first() {
        let shown: Vec<&str> = known.keys().copied().take(NAMED).collect();
        let all = hand.joints().len();
        return Err(format!(
            "{} of {all} joints of {} have no position, such as {first}; positions come for {}{}: state joint_names, or another rig",
            missing.len(),
            hand.name(),
            if shown.is_empty() { "none".to_owned() } else { shown.join(", ") },
            if known.len() > NAMED { " and others" } else { "" }
        ));
    }
    Ok(hand.joints().iter().filter_map(|joint| known.get(named(&joint.name).as_str()).copied()).collect())
}

#[cfg(test)]
mod tests;
