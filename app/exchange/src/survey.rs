//! The content of a recording, without its images: times, joints, poses, calibrations.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use mvt_feelsight::{LogImage, SCENE_FILE};
use mvt_frames::camera::Intrinsics;
use mvt_robot::hand::{Finger, JOINTS, JointAngles};
use nalgebra::Isometry3;

use crate::clock::Stamps;
use crate::error::Defect;
use crate::mapping::{Mapping, is_plausible};
use crate::messages::{Decoded, Transform, decode};
use crate::reader::{ChannelRecord, Record, scan};
use crate::record::RECORD_FILE;

/// Motion of a camera that counts as moving, metres and radians.
const STILL_M: f64 = 1e-3;
const STILL_RAD: f64 = 2e-3;
/// Steps from a frame to the world, at most.
const LONGEST_CHAIN: usize = 32;
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

/// Channel of a file with its use.
#[derive(Debug)]
pub(crate) struct Used {
    pub record: ChannelRecord,
    pub role: Role,
    pub stamps: Stamps,
}

/// Pinhole model with the frame of the camera.
#[derive(Debug, Clone)]
pub(crate) struct CameraModel {
    pub frame: String,
    pub intrinsics: Intrinsics,
    pub distortion: Option<[f64; 5]>,
}

/// Contents of a file without images.
#[derive(Debug)]
pub(crate) struct Survey {
    pub channels: BTreeMap<u16, Used>,
    pub joints: Vec<JointAngles>,
    /// Parent and first pose of each frame.
    frames: HashMap<String, (String, Isometry3<f64>)>,
    /// Poses of the object in its parent, with their times.
    pub object: Vec<Isometry3<f64>>,
    pub object_stamps: Stamps,
    object_parent: String,
    models: Vec<Option<CameraModel>>,
    /// Contents of scene.json.
    pub scene: Option<Vec<u8>>,
    /// Contents of data.pkl.
    pub record: Option<Vec<u8>>,
    /// Frames that moved.
    pub moving: Vec<String>,
    /// Bytes that may still be kept.
    left: u64,
}

/// Returns the topics of a file in their order.
pub(crate) fn topics(path: &Path) -> Result<Vec<String>, Defect> {
    let mut topics = Vec::new();
    scan(path, &mut |record| -> Result<bool, Defect> {
        if let Record::Channel(_, channel) = record {
            topics.push(channel.topic.clone());
        }
        Ok(false)
    })?;
    Ok(topics)
}

/// Returns the role of each topic.
fn roles(mapping: &Mapping) -> HashMap<&str, Role> {
    let mut roles = HashMap::from([(mapping.hand.joints.as_str(), Role::Joints)]);
    for (k, camera) in mapping.cameras.iter().enumerate() {
        roles.insert(&camera.depth, Role::Depth(k));
        let others = [
            (&camera.colours, Role::Image(LogImage::Colours(k))),
            (&camera.labels, Role::Image(LogImage::Labels(k))),
            (&camera.calibration, Role::Calibration(k)),
        ];
        roles.extend(others.into_iter().filter_map(|(topic, role)| Some((topic.as_deref()?, role))));
    }
    for finger in Finger::ALL {
        let Some(touch) = mapping.touch.of(finger) else { continue };
        roles.insert(&touch.image, Role::Image(LogImage::Touch(finger)));
        let truth = [(&touch.depth, LogImage::TouchDepth(finger)), (&touch.contact, LogImage::Contact(finger))];
        roles.extend(truth.into_iter().filter_map(|(topic, image)| Some((topic.as_deref()?, Role::Image(image)))));
    }
    roles
}

/// Reads everything but images.
pub(crate) fn survey(path: &Path, mapping: &Mapping) -> Result<Survey, Defect> {
    let roles = roles(mapping);
    let size = path.metadata().map_or(0, |file| file.len());
    let mut survey = Survey {
        channels: BTreeMap::new(),
        joints: Vec::new(),
        frames: HashMap::new(),
        object: Vec::new(),
        object_stamps: Stamps::default(),
        object_parent: String::new(),
        models: vec![None; mapping.cameras.len()],
        scene: None,
        record: None,
        moving: Vec::new(),
        left: size.max(LEAST_KEPT),
    };
    scan(path, &mut |record| match record {
        Record::Channel(id, channel) => survey.channel(id, channel, &roles),
        Record::Message(id, time_ns, data) => {
            let topic = survey.channels.get(&id).map_or_else(String::new, |used| used.record.topic.clone());
            survey.message(id, time_ns, data, mapping).map_err(|defect| format!("{topic}: {defect}"))?;
            Ok(true)
        }
        Record::Attachment(name, data) => {
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
    Ok(survey)
}

impl Survey {
    fn channel(&mut self, id: u16, channel: &ChannelRecord, roles: &HashMap<&str, Role>) -> Result<bool, Defect> {
        let role = match (roles.get(channel.topic.as_str()), channel.schema.as_str()) {
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
        let ChannelRecord { topic, schema, encoding } = channel;
        let fits = schema.strip_prefix("foxglove.").is_some_and(|name| schemas.contains(&name));
        if !fits || encoding != "protobuf" {
            let wanted = schemas.iter().map(|name| format!("foxglove.{name}")).collect::<Vec<_>>().join(" or ");
            return Err(format!(
                "{topic} has the schema {schema:?} in {encoding:?}; give a topic with {wanted} in protobuf"
            )
            .into());
        }
        let is_twice = role != Role::Transforms && self.channels.values().any(|used| used.role == role);
        if is_twice {
            return Err(format!("two channels have the topic {topic}; keep one with `mcap filter`").into());
        }
        self.channels.insert(id, Used { record: channel.clone(), role, stamps: Stamps::default() });
        Ok(true)
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

    fn message(&mut self, id: u16, time_ns: u64, data: &[u8], mapping: &Mapping) -> Result<(), String> {
        self.keep(Stamps::SIZE)?;
        let Some(used) = self.channels.get_mut(&id) else { return Ok(()) };
        let (stated_ns, decoded) = decode(&used.record.schema, data)?;
        used.stamps.push(time_ns, stated_ns);
        match (used.role, decoded) {
            (Role::Joints, Decoded::Joints(joints)) => {
                self.keep(std::mem::size_of::<JointAngles>() as u64)?;
                self.joints.push(in_order(&joints, &mapping.hand.names)?);
            }
            (Role::Calibration(camera), Decoded::Calibration(found)) => {
                let Some(place @ None) = self.models.get_mut(camera) else { return Ok(()) };
                if !is_plausible(&found.intrinsics) {
                    return Err("the calibration is not that of a camera; its sizes are pixels".to_owned());
                }
                let distortion = match (found.model, found.distortion.as_slice()) {
                    (_, numbers) if numbers.iter().all(|&k| k == 0.0) => None,
                    ("plumb_bob" | "", &[k1, k2, p1, p2, k3]) => Some([k1, k2, p1, p2, k3]),
                    (model, _) => {
                        return Err(format!(
                            "the distortion {model:?} is unknown; undistort the images, or give plumb_bob"
                        ));
                    }
                };
                if distortion.is_some_and(|numbers| numbers.iter().any(|k| !k.is_finite())) {
                    return Err("a number of the distortion is not finite".to_owned());
                }
                *place = Some(CameraModel { frame: found.frame.to_owned(), intrinsics: found.intrinsics, distortion });
            }
            (Role::Transforms, Decoded::Transforms(transforms)) => {
                for transform in transforms {
                    self.transform(&transform, (time_ns, stated_ns), mapping)?;
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn transform(&mut self, found: &Transform<'_>, times: (u64, u64), mapping: &Mapping) -> Result<(), String> {
        let &Transform { parent, child, pose } = found;
        if mapping.object.frame.as_deref() == Some(child) {
            if !self.object.is_empty() && self.object_parent != parent {
                return Err(format!("the frame {child} has two parents: {} and {parent}", self.object_parent));
            }
            self.keep(Stamps::SIZE + std::mem::size_of_val(&pose) as u64)?;
            parent.clone_into(&mut self.object_parent);
            self.object.push(pose);
            self.object_stamps.push(times.0, times.1);
            return Ok(());
        }
        if let Some((_, first)) = self.frames.get(child) {
            let motion = first.inverse() * pose;
            let is_still = motion.translation.vector.norm() < STILL_M && motion.rotation.angle() < STILL_RAD;
            if !is_still && !self.moving.iter().any(|name| name == child) {
                self.keep(child.len() as u64 + 32)?;
                self.moving.push(child.to_owned());
            }
            return Ok(());
        }
        self.keep((child.len() + parent.len()) as u64 + 256)?;
        self.frames.insert(child.to_owned(), (parent.to_owned(), pose));
        Ok(())
    }

    /// Returns the pose of a frame in another, by the first pose of each frame between them.
    pub fn pose(&self, frame: &str, root: &str) -> Result<Isometry3<f64>, String> {
        let (mut at, mut pose) = (frame, Isometry3::identity());
        for _ in 0..LONGEST_CHAIN {
            if at == root {
                return Ok(pose);
            }
            let Some((parent, of)) = self.frames.get(at) else {
                return Err(format!("no transform leads from {frame:?} to {root:?}: {at:?} has no parent"));
            };
            pose = of * pose;
            at = parent;
        }
        Err(format!("the transforms from {frame:?} to {root:?} go in a circle"))
    }

    /// Returns the poses of the object in a frame.
    pub fn object_poses(&self, root: &str) -> Result<Vec<Isometry3<f64>>, String> {
        if self.object.is_empty() {
            return Ok(Vec::new());
        }
        let parent = self.pose(&self.object_parent, root)?;
        Ok(self.object.iter().map(|pose| parent * pose).collect())
    }

    /// Returns the pinhole model of a camera of the mapping.
    pub fn model(&self, camera: usize) -> Option<&CameraModel> {
        self.models.get(camera)?.as_ref()
    }

    /// Returns the channel of a role.
    pub fn channel_of(&self, role: Role) -> Option<&Used> {
        self.channels.values().find(|used| used.role == role && used.stamps.len() > 0)
    }
}

/// Returns the joint angles in the hand's order.
fn in_order(joints: &[(&str, f64)], names: &[String]) -> Result<JointAngles, String> {
    let mut angles = [0.0; JOINTS];
    for (angle, name) in angles.iter_mut().zip(names) {
        let found = joints.iter().find(|(known, _)| known == name);
        let &(_, position) = found.ok_or_else(|| {
            let known: Vec<&str> = joints.iter().map(|(name, _)| *name).take(20).collect();
            format!("there is no joint {name:?} among {}; give hand.names in the mapping", known.join(", "))
        })?;
        if !position.is_finite() {
            return Err(format!("the position of joint {name:?} is not finite"));
        }
        *angle = position;
    }
    Ok(angles)
}
