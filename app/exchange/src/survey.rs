//! The content of a recording, without its images: times, joints, poses, calibrations.

use std::collections::HashMap;
use std::path::Path;

use mvt_bag::mcap::{McapChannel, McapRecord, scan};
use mvt_feelsight::{LogImage, SCENE_FILE};
use mvt_frames::camera::Intrinsics;
use nalgebra::Isometry3;

use crate::clock::Stamps;
use crate::error::Defect;
use crate::joints::Readings;
use crate::mapping::{Mapping, is_plausible};
use crate::messages::{Calibration, Decoded, Transform, decode, frame_name};
use crate::record::RECORD_FILE;
use crate::skips::Skips;
use crate::tree::Tree;

/// Least memory that a file may take, bytes.
const LEAST_KEPT: u64 = 4 << 20;

/// The kind of a channel's messages in a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Role {
    Joints,
    Image(LogImage),
    Depth(usize),
    Calibration(usize),
    Transforms,
}

/// Topic of a file with its use.
#[derive(Debug)]
pub(crate) struct Used {
    pub topic: String,
    pub role: Role,
    /// Times of the messages that can be used.
    pub stamps: Stamps,
    /// The number of each of these in the file.
    pub numbers: Vec<usize>,
    /// Number of all messages.
    pub messages: usize,
}

/// Pinhole model with the frame of the camera.
#[derive(Debug, Clone)]
pub(crate) struct CameraModel {
    pub frame: String,
    pub intrinsics: Intrinsics,
    pub distortion: Option<[f64; 5]>,
    /// A lens model without numbers that is read as a pinhole model.
    pub assumed_pinhole: Option<String>,
}

/// Contents of a file without images.
#[derive(Debug)]
pub(crate) struct Survey {
    pub used: Vec<Used>,
    /// The place of each channel in `used`, and its schema.
    channels: HashMap<u16, (usize, String)>,
    /// Channels whose messages cannot be read, with their role.
    unread: Vec<(Role, String)>,
    pub joints: Readings,
    pub tree: Tree,
    /// Poses of the object in its parent, with their times.
    pub object: Vec<Isometry3<f64>>,
    pub object_stamps: Stamps,
    object_parent: String,
    models: Vec<Option<CameraModel>>,
    /// Contents of scene.json.
    pub scene: Option<Vec<u8>>,
    /// Contents of data.pkl.
    pub record: Option<Vec<u8>>,
    pub skips: Skips,
    pub notes: Vec<String>,
    /// Bytes that may still be kept.
    left: u64,
}

/// Returns the topics of a file in their order.
pub(crate) fn topics(path: &Path) -> Result<Vec<String>, Defect> {
    let mut topics = Vec::new();
    scan(path, &mut |record| -> Result<bool, Defect> {
        if let McapRecord::Channel(_, channel) = record {
            topics.push(channel.topic.clone());
        }
        Ok(false)
    })?;
    Ok(topics)
}

/// Returns the role of each topic.
fn roles(mapping: &Mapping) -> Result<HashMap<&str, Role>, String> {
    let mut list = vec![(&mapping.hand.joints, Role::Joints)];
    for (k, camera) in mapping.cameras.iter().enumerate() {
        list.push((&camera.depth, Role::Depth(k)));
        let others = [
            (&camera.colours, Role::Image(LogImage::Colours(k))),
            (&camera.labels, Role::Image(LogImage::Labels(k))),
            (&camera.calibration, Role::Calibration(k)),
        ];
        list.extend(others.into_iter().filter_map(|(topic, role)| Some((topic.as_ref()?, role))));
    }
    for pad in 0..mapping.hand.hand().pads().len() {
        let Some(touch) = mapping.touch(pad) else { continue };
        list.push((&touch.image, Role::Image(LogImage::Touch(pad))));
        let truth = [(&touch.depth, LogImage::TouchDepth(pad)), (&touch.contact, LogImage::Contact(pad))];
        list.extend(truth.into_iter().filter_map(|(topic, image)| Some((topic.as_ref()?, Role::Image(image)))));
    }
    let mut roles = HashMap::new();
    for (topic, role) in list {
        if roles.insert(frame_name(topic), role).is_some() {
            return Err(format!("the mapping names {topic} twice; each sensor has a topic of its own"));
        }
    }
    Ok(roles)
}

/// Reads everything but images.
pub(crate) fn survey(path: &Path, mapping: &Mapping) -> Result<Survey, Defect> {
    let roles = roles(mapping)?;
    let size = path.metadata().map_or(0, |file| file.len());
    let mut survey = Survey {
        used: Vec::new(),
        channels: HashMap::new(),
        unread: Vec::new(),
        joints: Readings::default(),
        tree: Tree::default(),
        object: Vec::new(),
        object_stamps: Stamps::default(),
        object_parent: String::new(),
        models: vec![None; mapping.cameras.len()],
        scene: None,
        record: None,
        skips: Skips::default(),
        notes: Vec::new(),
        left: size.max(LEAST_KEPT),
    };
    scan(path, &mut |record| match record {
        McapRecord::Channel(id, channel) => survey.channel(id, channel, &roles),
        McapRecord::Message(id, time_ns, data) => {
            let Some((place, schema)) = survey.channels.get(&id) else { return Ok(true) };
            let (place, schema) = (*place, schema.clone());
            let topic = survey.used.get(place).map_or_else(String::new, |used| used.topic.clone());
            survey.message(place, &schema, time_ns, data, mapping).map_err(|defect| format!("{topic}: {defect}"))?;
            Ok(true)
        }
        McapRecord::Attachment(name, data) => {
            let place = match name {
                SCENE_FILE => &mut survey.scene,
                RECORD_FILE => &mut survey.record,
                _ => return Ok(true),
            };
            *place = Some(data.to_vec());
            survey.keep(data.len() as u64)?;
            Ok(true)
        }
    })?;
    survey.check(mapping)?;
    Ok(survey)
}

impl Survey {
    fn channel(&mut self, id: u16, channel: &McapChannel, roles: &HashMap<&str, Role>) -> Result<bool, Defect> {
        let McapChannel { topic, schema, encoding } = channel;
        let role = match (roles.get(frame_name(topic)), schema.as_str()) {
            (Some(role), _) => *role,
            (None, "foxglove.FrameTransform" | "foxglove.FrameTransforms") => Role::Transforms,
            (None, _) => return Ok(false),
        };
        let schemas: &[&str] = match role {
            Role::Joints => &["JointStates"],
            Role::Image(_) | Role::Depth(_) => &["CompressedImage", "RawImage"],
            Role::Calibration(_) => &["CameraCalibration"],
            Role::Transforms => &["FrameTransform", "FrameTransforms"],
        };
        let fits = schema.strip_prefix("foxglove.").is_some_and(|name| schemas.contains(&name));
        if !fits || encoding != "protobuf" {
            let wanted = schemas.iter().map(|name| format!("foxglove.{name}")).collect::<Vec<_>>().join(" or ");
            let defect =
                format!("{topic} has the schema {schema:?} in {encoding:?}; give a topic with {wanted} in protobuf");
            self.unread.push((role, defect));
            return Ok(false);
        }
        let is_same = |used: &Used| used.role == role && frame_name(&used.topic) == frame_name(topic);
        let place = self.used.iter().position(is_same).unwrap_or(self.used.len());
        if place == self.used.len() {
            let (stamps, numbers) = (Stamps::default(), Vec::new());
            self.used.push(Used { topic: topic.clone(), role, stamps, numbers, messages: 0 });
        }
        self.channels.insert(id, (place, schema.clone()));
        Ok(true)
    }

    /// Refuses a file that lacks a role because of its messages, and notes other channels that are not read.
    fn check(&mut self, mapping: &Mapping) -> Result<(), String> {
        for (role, defect) in std::mem::take(&mut self.unread) {
            let is_read = role == Role::Transforms || self.used.iter().any(|used| used.role == role);
            if !is_read {
                return Err(defect);
            }
            self.notes.push(format!("a channel is not read: {defect}"));
        }
        for used in self.used.iter().filter(|used| used.stamps.len() == 0 && used.messages > 0) {
            // Without transforms or a calibration, the mapping may give the poses.
            let is_needed = matches!(used.role, Role::Depth(_) | Role::Image(_));
            if let Some(first) = self.skips.first(&used.topic).filter(|_| is_needed) {
                return Err(format!(
                    "{}: none of its {} messages can be used; first {first}",
                    used.topic, used.messages
                ));
            }
        }
        let has_joints = self.used.iter().any(|used| used.role == Role::Joints && used.messages > 0);
        match self.joints.defect(mapping.hand.names(), &mapping.hand.hand()).filter(|_| has_joints) {
            Some(defect) => Err(format!("{}: {defect}", mapping.hand.joints)),
            None => Ok(()),
        }
    }

    /// Counts the kept messages: a few bytes may decompress to very many messages.
    fn keep(&mut self, bytes: u64) -> Result<(), String> {
        match self.left.checked_sub(bytes) {
            Some(left) => {
                self.left = left;
                Ok(())
            }
            None => Err("there are more messages than a file of this size holds".to_owned()),
        }
    }

    /// Keeps what a message says, or counts it as skipped. An error is a defect of the file.
    fn message(
        &mut self,
        place: usize,
        schema: &str,
        time_ns: u64,
        data: &[u8],
        mapping: &Mapping,
    ) -> Result<(), String> {
        self.keep(Stamps::SIZE + std::mem::size_of::<usize>() as u64)?;
        let Some(used) = self.used.get_mut(place) else { return Ok(()) };
        let (role, number, topic) = (used.role, used.messages, used.topic.clone());
        used.messages += 1;
        let skip = |skips: &mut Skips, reason| skips.add(&topic, format!("message {number}"), reason);
        let (stated_ns, decoded) = match decode(schema, data) {
            Ok(decoded) => decoded,
            Err(reason) => {
                skip(&mut self.skips, reason);
                return Ok(());
            }
        };
        match (role, decoded) {
            (Role::Joints, Decoded::Joints(joints)) => {
                let (row, defects) = self.joints.row(&joints, mapping.hand.names(), &mapping.hand.hand());
                defects.into_iter().for_each(|defect| skip(&mut self.skips, defect));
                let Some(row) = row else { return Ok(()) };
                // The joints of one instant may come in several messages.
                let is_last = used.stamps.is_last(time_ns, stated_ns);
                if let Some(last) = self.joints.rows.last_mut().filter(|last| is_last && are_apart(last, &row)) {
                    last.iter_mut()
                        .zip(row)
                        .filter(|(_, angle)| !angle.is_nan())
                        .for_each(|(last, angle)| *last = angle);
                    return Ok(());
                }
                let bytes = std::mem::size_of_val(row.as_slice()) as u64;
                self.joints.rows.push(row);
                used.stamps.push(time_ns, stated_ns);
                used.numbers.push(number);
                return self.keep(bytes);
            }
            (Role::Calibration(camera), Decoded::Calibration(found)) => {
                match (camera_model(&found), self.models.get_mut(camera)) {
                    (Ok(model), Some(place @ None)) => *place = Some(model),
                    (Err(reason), _) => {
                        skip(&mut self.skips, reason);
                        return Ok(());
                    }
                    _ => {}
                }
            }
            (Role::Transforms, Decoded::Transforms(transforms)) => {
                used.stamps.push(time_ns, transforms.last().map_or(0, |last| last.stated_ns));
                used.numbers.push(number);
                for transform in transforms {
                    if let Some(reason) = self.transform(&transform, time_ns, mapping)? {
                        skip(&mut self.skips, reason);
                    }
                }
                return Ok(());
            }
            (_, Decoded::Image(picture)) if picture.data.is_empty() => {
                skip(&mut self.skips, "the image is empty".to_owned());
                return Ok(());
            }
            _ => {}
        }
        used.stamps.push(time_ns, stated_ns);
        used.numbers.push(number);
        Ok(())
    }

    /// Keeps a transform; returns why not otherwise.
    fn transform(&mut self, found: &Transform<'_>, time_ns: u64, mapping: &Mapping) -> Result<Option<String>, String> {
        let Transform { parent, child, pose, stated_ns } = found;
        let pose = match pose {
            Ok(pose) => *pose,
            Err(defect) => {
                self.tree.add_broken(child, defect);
                return Ok(Some(defect.clone()));
            }
        };
        if mapping.object.frame.as_deref() != Some(*child) {
            let kept = self.tree.add(parent, child, pose);
            return self.keep(kept).map(|()| None);
        }
        if !self.object.is_empty() && self.object_parent != *parent {
            let first = &self.object_parent;
            return Ok(Some(format!("the frame {child} has two parents: {first}, which is used, and {parent}")));
        }
        self.keep(Stamps::SIZE + std::mem::size_of_val(&pose) as u64)?;
        self.object_parent = (*parent).to_owned();
        self.object.push(pose);
        self.object_stamps.push(time_ns, *stated_ns);
        Ok(None)
    }

    /// Returns the poses of the object in a frame, and the frames between them that move.
    pub fn object_poses(&self, root: &str) -> Result<(Vec<Isometry3<f64>>, Vec<String>), String> {
        if self.object.is_empty() {
            return Ok((Vec::new(), Vec::new()));
        }
        let parent = self.tree.path(&self.object_parent, root)?;
        Ok((self.object.iter().map(|pose| parent.pose * pose).collect(), parent.moving))
    }

    /// Returns the pinhole model of a camera of the mapping.
    pub fn model(&self, camera: usize) -> Option<&CameraModel> {
        self.models.get(camera)?.as_ref()
    }

    /// Returns the place and the topic of a role.
    pub fn of_role(&self, role: Role) -> Option<&Used> {
        self.used.iter().find(|used| used.role == role && used.stamps.len() > 0)
    }

    /// Returns the place in `used` and the schema of a channel.
    pub fn of_channel(&self, id: u16) -> Option<(usize, &str)> {
        self.channels.get(&id).map(|(place, schema)| (*place, schema.as_str()))
    }
}

/// Returns whether no joint has an angle in both.
fn are_apart(a: &[f64], b: &[f64]) -> bool {
    a.iter().zip(b).all(|(a, b)| a.is_nan() || b.is_nan())
}

/// Returns the camera of a calibration, or why it is none.
fn camera_model(found: &Calibration<'_>) -> Result<CameraModel, String> {
    let Calibration { frame, intrinsics, model, distortion: numbers } = found;
    let Intrinsics { width, height, fx, fy, .. } = intrinsics;
    if *fx == 0.0 && *fy == 0.0 {
        return Err("the matrix K of the calibration is zero: the camera is not calibrated".to_owned());
    }
    if !is_plausible(intrinsics) {
        return Err(format!(
            "the calibration is not that of a camera: {width} x {height} pixels, focal lengths {fx} and {fy} pixels"
        ));
    }
    if numbers.iter().any(|k| !k.is_finite()) {
        return Err("a number of the distortion is not finite".to_owned());
    }
    let (first, rest) = numbers.split_at(numbers.len().min(5));
    let are_zero = |numbers: &[f64]| numbers.iter().all(|&k| k == 0.0);
    let is_known = matches!(*model, "" | "plumb_bob" | "rational_polynomial");
    let distortion = match *first {
        _ if are_zero(numbers) => None,
        _ if !is_known => {
            return Err(format!("the lens model {model:?} is unknown; rectify the images, or give plumb_bob"));
        }
        [k1, k2, p1, p2] => Some([k1, k2, p1, p2, 0.0]),
        [k1, k2, p1, p2, k3] if are_zero(rest) => Some([k1, k2, p1, p2, k3]),
        [_, _, _, _, _] => {
            return Err(format!(
                "the lens model {model:?} has {} numbers, of which a log keeps 5 and the others are not 0; rectify the images",
                numbers.len()
            ));
        }
        _ => return Err(format!("the distortion has {} numbers; give 4, 5 or 8", numbers.len())),
    };
    let is_fisheye = !is_known && !numbers.is_empty();
    let assumed_pinhole = is_fisheye.then(|| (*model).to_owned());
    Ok(CameraModel { frame: (*frame).to_owned(), intrinsics: *intrinsics, distortion, assumed_pinhole })
}
