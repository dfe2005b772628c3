//! One pass over a bag: times and places of its images, camera models, transforms, joints and poses of the object.

use std::collections::BTreeMap;

use nalgebra::Isometry3;

use crate::bag::{Bag, BagMessage, BagPlace, names};
use crate::error::{BagError, RosError};
use crate::messages::{RosCameraInfo, RosHeader, RosJointState, RosPose, RosTransform};
use crate::topics::{self, Chosen, ENCODING, HEAD, TRANSFORMS};
use crate::tree::{Track, TransformTree};

/// Time and place of an image.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shot {
    pub time_ns: i64,
    pub place: BagPlace,
}

/// Images of a topic.
#[derive(Debug, Default)]
pub(crate) struct Shots {
    stamps_ns: Vec<i64>,
    logs_ns: Vec<i64>,
    places: Vec<BagPlace>,
    /// Coordinate frame of the first image.
    pub frame: String,
}

/// What a pass over a bag found.
#[derive(Debug, Default)]
pub(crate) struct Survey {
    pub color: Shots,
    pub depth: Shots,
    pub masks: Shots,
    pub camera_info: Option<RosCameraInfo>,
    pub color_info: Option<RosCameraInfo>,
    pub tree: TransformTree,
    pub joints: BTreeMap<String, Track<f64>>,
    /// Frame of the object's poses, and the poses.
    pub object_frame: String,
    pub object: Track<Isometry3<f64>>,
    /// Numbers of messages that cannot be used, by topic, with the first reason.
    skips: BTreeMap<usize, (u64, String)>,
    /// Whether a camera model differs from the first.
    info_changes: bool,
}

impl Shots {
    fn push(&mut self, message: &BagMessage) -> Result<(), RosError> {
        let header = RosHeader::decode(&message.data)?;
        if self.places.is_empty() {
            self.frame = header.frame;
        }
        self.stamps_ns.push(header.stamp_ns);
        self.logs_ns.push(message.log_ns);
        self.places.push(message.place);
        Ok(())
    }

    /// Returns whether there are images and none states its time.
    pub fn lack_stamps(&self) -> bool {
        !self.stamps_ns.is_empty() && self.stamps_ns.iter().all(|stamp| *stamp == 0)
    }

    /// Returns the images in the order of time, and how many are left out because they are not newer than the one before.
    pub fn in_time(&self, by_log: bool) -> (Vec<Shot>, usize) {
        let times = if by_log { &self.logs_ns } else { &self.stamps_ns };
        let mut newest = i64::MIN;
        let shots = times.iter().zip(&self.places).filter(|(time_ns, _)| {
            let is_newer = **time_ns > newest;
            newest = newest.max(**time_ns);
            is_newer
        });
        let shots: Vec<Shot> = shots.map(|(time_ns, place)| Shot { time_ns: *time_ns, place: *place }).collect();
        let left_out = times.len() - shots.len();
        (shots, left_out)
    }
}

impl Survey {
    /// Reads the chosen topics and all transforms of a bag. Adds notes to the bag.
    pub fn of(bag: &mut Bag, chosen: &Chosen) -> Result<Self, BagError> {
        let is_transform = |topic: &crate::BagTopic| topic.type_name == TRANSFORMS && topic.encoding == ENCODING;
        let transforms: Vec<Option<bool>> =
            bag.topics().iter().map(|topic| is_transform(topic).then(|| topic.name.ends_with("tf_static"))).collect();
        let Chosen { color, depth, camera_info, color_info, masks, joints, object_pose } = *chosen;
        let images = [Some(color), Some(depth), masks];
        let others = [Some(camera_info), color_info, joints, object_pose];
        let is_image = |topic: usize| images.contains(&Some(topic));
        let is_wanted = |topic: usize| {
            is_image(topic) || others.contains(&Some(topic)) || matches!(transforms.get(topic), Some(Some(_)))
        };
        let wanted: Vec<bool> = (0..bag.topics().len()).map(is_wanted).collect();
        let heads = (0..wanted.len()).map(|topic| is_image(topic).then_some(HEAD)).collect();
        let mut survey = Self::default();
        for message in bag.messages_of(wanted, heads) {
            let message = message?;
            let topic = Some(message.topic);
            let added = match transforms.get(message.topic).copied().flatten() {
                Some(is_static) => survey.add_transforms(&message, is_static),
                None if topic == Some(color) => survey.color.push(&message),
                None if topic == Some(depth) => survey.depth.push(&message),
                None if topic == masks => survey.masks.push(&message),
                None if topic == Some(camera_info) => {
                    add_info(&mut survey.camera_info, &mut survey.info_changes, &message)
                }
                None if topic == color_info => add_info(&mut survey.color_info, &mut survey.info_changes, &message),
                None if topic == joints => survey.add_joints(&message),
                None => survey.add_object_pose(&message),
            };
            if let Err(reason) = added {
                survey.skips.entry(message.topic).or_insert_with(|| (0, reason.to_string())).0 += 1;
            }
        }
        survey.tree.sort();
        survey.joints.values_mut().for_each(Track::sort);
        survey.object.sort();
        survey.add_notes(bag);
        Ok(survey)
    }

    fn add_transforms(&mut self, message: &BagMessage, is_static: bool) -> Result<(), RosError> {
        for transform in RosTransform::decode(&message.data)? {
            self.tree.add(&transform, stated_or_log(&transform.header, message), is_static);
        }
        Ok(())
    }

    fn add_joints(&mut self, message: &BagMessage) -> Result<(), RosError> {
        let state = RosJointState::decode(&message.data)?;
        let time_ns = stated_or_log(&state.header, message);
        for (name, position) in state.positions {
            self.joints.entry(name).or_default().push(time_ns, position);
        }
        Ok(())
    }

    fn add_object_pose(&mut self, message: &BagMessage) -> Result<(), RosError> {
        let pose = RosPose::decode(&message.data)?;
        let time_ns = stated_or_log(&pose.header, message);
        if self.object.is_empty() {
            self.object_frame = pose.header.frame;
        } else if self.object_frame != pose.header.frame {
            return Err(RosError::fault(format!(
                "its frame is {:?} and not {:?}",
                pose.header.frame, self.object_frame
            )));
        }
        self.object.push(time_ns, pose.pose);
        Ok(())
    }

    fn add_notes(&self, bag: &mut Bag) {
        let name =
            |bag: &Bag, topic: usize| bag.topics().get(topic).map(|topic| topic.name.clone()).unwrap_or_default();
        for (topic, (count, first)) in &self.skips {
            bag.add_note(format!("{count} messages of {} are left out, the first because {first}", name(bag, *topic)));
        }
        if self.info_changes {
            bag.add_note("the camera model changes in the bag: the first one is used".to_owned());
        }
        if !self.tree.torn().is_empty() {
            let torn = names(self.tree.torn().iter().map(String::as_str));
            bag.add_note(format!("frames have two parents, of which the first counts: {torn}"));
        }
        let known = [
            topics::IMAGE,
            topics::COMPRESSED_IMAGE,
            topics::CAMERA_INFO,
            topics::JOINT_STATE,
            topics::TRANSFORMS,
            topics::POSE,
        ];
        let is_unknown = |topic: &&crate::BagTopic| {
            topic.count > 0 && (!known.contains(&topic.type_name.as_str()) || topic.encoding != ENCODING)
        };
        let unknown: Vec<String> = bag
            .topics()
            .iter()
            .filter(is_unknown)
            .map(|topic| format!("{} ({})", topic.name, topic.type_name))
            .collect();
        if !unknown.is_empty() {
            bag.add_note(format!(
                "topics of unknown types are not read: {}",
                names(unknown.iter().map(String::as_str))
            ));
        }
    }
}

fn stated_or_log(header: &RosHeader, message: &BagMessage) -> i64 {
    if header.stamp_ns == 0 { message.log_ns } else { header.stamp_ns }
}

/// Keeps the first camera model.
fn add_info(first: &mut Option<RosCameraInfo>, changes: &mut bool, message: &BagMessage) -> Result<(), RosError> {
    let info = RosCameraInfo::decode(&message.data)?;
    match first {
        None => *first = Some(info),
        Some(first) => {
            let differ =
                first.k != info.k || first.d != info.d || (first.width, first.height) != (info.width, info.height);
            *changes |= differ;
        }
    }
    Ok(())
}

/// Returns the median time between images, nanoseconds; `None` with fewer than two.
pub(crate) fn period_ns(shots: &[Shot]) -> Option<i64> {
    let mut steps: Vec<i64> =
        shots.windows(2).filter_map(|pair| Some(pair.last()?.time_ns.saturating_sub(pair.first()?.time_ns))).collect();
    let middle = steps.len() / 2;
    (!steps.is_empty()).then(|| *steps.select_nth_unstable(middle).1)
}

/// Returns the place of the image that is nearest in time.
pub(crate) fn nearest(shots: &[Shot], time_ns: i64) -> Option<usize> {
    let next = shots.partition_point(|shot| shot.time_ns < time_ns);
    let apart = |at: &usize| shots.get(*at).map_or(u64::MAX, |shot| shot.time_ns.abs_diff(time_ns));
    [next.checked_sub(1), Some(next)].into_iter().flatten().filter(|at| *at < shots.len()).min_by_key(apart)
}
