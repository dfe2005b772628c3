//! Choice of the topics of RGB-D frames.

use std::path::Path;

use serde::Deserialize;

use crate::bag::{Bag, BagTopic, names};
use crate::error::{BagError, FILE};
use crate::messages::{RosCompressedImage, RosImage};

/// Types of messages that are decoded.
pub(crate) const IMAGE: &str = "sensor_msgs/msg/Image";
pub(crate) const COMPRESSED_IMAGE: &str = "sensor_msgs/msg/CompressedImage";
pub(crate) const CAMERA_INFO: &str = "sensor_msgs/msg/CameraInfo";
pub(crate) const JOINT_STATE: &str = "sensor_msgs/msg/JointState";
pub(crate) const TRANSFORMS: &str = "tf2_msgs/msg/TFMessage";
pub(crate) const POSE: &str = "geometry_msgs/msg/PoseStamped";
/// The encoding of messages that are decoded.
pub(crate) const ENCODING: &str = "cdr";
/// Bytes of a message that hold its header and encoding.
pub(crate) const HEAD: usize = 1024;

/// Topics of RGB-D frames, as `bag.toml` states them; what is not stated is found.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RgbdTopics {
    /// Colour images.
    pub color: Option<String>,
    /// Depth images, registered to the colours.
    pub depth: Option<String>,
    /// Camera model of the depth images.
    pub camera_info: Option<String>,
    /// Masks or labels of the object.
    pub masks: Option<String>,
    /// Joint angles.
    pub joints: Option<String>,
    /// True poses of the object, for scores.
    pub object_pose: Option<String>,
    /// Frame of the transforms in which the camera's pose is given; without it the root of the tree.
    pub world_frame: Option<String>,
    /// Whether masks are carried into the frames that have none.
    pub carry_masks: Option<bool>,
    /// Label of the object in the masks; without it a mask has two levels.
    pub object: Option<u16>,
    /// Metres per level of depth images of 16 bits; 0.001 without it.
    pub depth_unit_m: Option<f64>,
    /// Greatest difference of the stamps of images of one frame, seconds; half of a frame period without it.
    pub slop_s: Option<f64>,
}

impl RgbdTopics {
    /// Reads `bag.toml` in the folder of a bag, or beside its file; without one nothing is stated.
    ///
    /// # Errors
    /// [`BagError`] if the file is invalid.
    pub fn beside(bag: &Path) -> Result<Self, BagError> {
        let folder = if bag.is_dir() { Some(bag) } else { bag.parent() };
        let path = folder.map(|folder| folder.join(FILE)).unwrap_or_default();
        if !path.is_file() {
            return Ok(Self::default());
        }
        let text = mvt_files::input::read_text(&path, 1 << 20).map_err(BagError::io(&path))?;
        let topics: Self =
            toml::from_str(&text).map_err(|error| BagError::fault(&path, error.message().replace('\n', "; ")))?;
        for (name, number) in [("depth_unit_m", topics.depth_unit_m), ("slop_s", topics.slop_s)] {
            if let Some(number) = number.filter(|number| !(number.is_finite() && *number > 0.0)) {
                return Err(BagError::fault(&path, format!("{name} must be above 0 (it is {number})")));
            }
        }
        Ok(topics)
    }
}

/// What the images of a topic show.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shows {
    Colours,
    Depth,
    /// Labels, or grey images whose name says so.
    Labels,
    Other,
}

/// Numbers of the chosen topics in the bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Chosen {
    pub color: usize,
    pub depth: usize,
    pub camera_info: usize,
    /// Camera model beside the colours, if it is another.
    pub color_info: Option<usize>,
    pub masks: Option<usize>,
    pub joints: Option<usize>,
    pub object_pose: Option<usize>,
}

/// Names of transports that follow the name of an image topic.
const TRANSPORTS: [&str; 4] = ["compressed", "compressedDepth", "raw", "zstd"];

/// Words in the names of topics of depth that is registered to the colours.
const ALIGNED: [&str; 4] = ["aligned", "registered", "depth_to_rgb", "depth_to_color"];

/// Returns the name of a topic without its transport.
fn base(name: &str) -> &str {
    match name.rsplit_once('/') {
        Some((base, last)) if TRANSPORTS.contains(&last) => base,
        _ => name,
    }
}

/// Returns the name of the camera model beside an image topic.
fn info_beside(name: &str) -> String {
    base(name).rsplit_once('/').map_or("camera_info".to_owned(), |(folder, _)| format!("{folder}/camera_info"))
}

fn is_named_as_labels(name: &str) -> bool {
    let name = name.to_lowercase();
    ["mask", "label", "segment"].iter().any(|word| name.contains(word))
}

/// Judges an image topic by its first message.
fn shows(topic: &BagTopic, message: &[u8]) -> Shows {
    let encoding = if topic.type_name == IMAGE {
        RosImage::encoding_of(message).unwrap_or_default()
    } else {
        match RosCompressedImage::format_of(message) {
            Ok(format) if RosCompressedImage::is_depth(format) => "16UC1",
            // The encoding before compression, if it is stated.
            Ok(format) => format.split_once(';').map_or("rgb8", |(encoding, _)| encoding.trim()),
            Err(_) => "",
        }
    };
    match encoding {
        "8UC1" | "mono8" | "16UC1" | "mono16" if is_named_as_labels(&topic.name) => Shows::Labels,
        "16UC1" | "mono16" | "32FC1" => Shows::Depth,
        "8UC1" | "mono8" | "" => Shows::Other,
        _ if is_named_as_labels(&topic.name) => Shows::Labels,
        _ => Shows::Colours,
    }
}

/// Finds and checks topics.
struct Chooser<'a> {
    bag: &'a Bag,
    shows: Vec<Shows>,
}

impl Chooser<'_> {
    fn name(&self, topic: usize) -> &str {
        self.bag.topics().get(topic).map_or("", |topic| topic.name.as_str())
    }

    /// Returns the numbers of the topics of a type.
    fn of_type(&self, type_name: &str) -> Vec<usize> {
        let topics = self.bag.topics().iter().enumerate();
        topics.filter(|(_, topic)| topic.type_name == type_name && topic.count > 0).map(|(number, _)| number).collect()
    }

    fn showing(&self, what: Shows) -> Vec<usize> {
        self.shows.iter().enumerate().filter(|(_, shows)| **shows == what).map(|(number, _)| number).collect()
    }

    /// Returns the number of a topic that is stated, after a check of its type.
    fn stated(&self, name: &str, types: &[&str]) -> Result<usize, BagError> {
        let path = self.bag.path();
        let topics = self.bag.topics();
        let Some(number) = topics.iter().position(|topic| topic.name == name) else {
            let of_types = topics.iter().filter(|topic| types.contains(&topic.type_name.as_str()));
            let found = names(of_types.map(|topic| topic.name.as_str()));
            return Err(BagError::NoTopic { path: path.to_owned(), topic: name.to_owned(), found });
        };
        match topics.get(number) {
            Some(topic) if !types.contains(&topic.type_name.as_str()) => {
                let fault = format!(
                    "topic {name} has messages {}, not {}: name another one",
                    topic.type_name,
                    types.join(" or ")
                );
                Err(BagError::fault(path, fault))
            }
            Some(topic) if topic.count == 0 => {
                Err(BagError::fault(path, format!("topic {name} has no messages: name another one")))
            }
            _ => Ok(number),
        }
    }

    fn choice(&self, key: &'static str, fault: &str, candidates: &[usize]) -> BagError {
        let candidates = names(candidates.iter().map(|topic| self.name(*topic)));
        BagError::Choice { path: self.bag.path().to_owned(), fault: fault.to_owned(), key, candidates }
    }

    /// Returns the one topic among candidates, without those that repeat another one in a transport.
    fn only(&self, key: &'static str, what: &str, mut candidates: Vec<usize>) -> Result<usize, BagError> {
        let all: Vec<&str> = candidates.iter().map(|topic| self.name(*topic)).collect();
        candidates
            .retain(|topic| base(self.name(*topic)) == self.name(*topic) || !all.contains(&base(self.name(*topic))));
        if key == "depth" && candidates.len() > 1 {
            // Infrared images and maps of confidence have the encodings of depth.
            let named = |words: &[&str]| -> Vec<usize> {
                let is_named = |topic: &usize| words.iter().any(|word| self.name(*topic).contains(word));
                candidates.iter().copied().filter(is_named).collect()
            };
            let preferred = [named(&ALIGNED), named(&["depth"])];
            candidates = preferred.into_iter().find(|topics| !topics.is_empty()).unwrap_or(candidates);
        }
        match candidates[..] {
            [one] => Ok(one),
            [] => {
                let images = [self.of_type(IMAGE), self.of_type(COMPRESSED_IMAGE)].concat();
                Err(self.choice(key, &format!("no topic has {what}"), &images))
            }
            _ => Err(self.choice(key, &format!("{} topics have {what}", candidates.len()), &candidates)),
        }
    }

    fn camera_info(&self, depth: usize, color: usize) -> Result<usize, BagError> {
        let infos = self.of_type(CAMERA_INFO);
        let named = |name: &str| infos.iter().copied().find(|info| self.name(*info) == name);
        let beside = |image: usize| named(&info_beside(self.name(image)));
        // Depth that is registered to the colours has their model.
        let found = beside(depth).or_else(|| beside(color)).or(match infos[..] {
            [one] => Some(one),
            _ => None,
        });
        found.ok_or_else(|| match infos[..] {
            [] => BagError::fault(
                self.bag.path(),
                format!(
                    "there is no camera model: record {} (sensor_msgs/msg/CameraInfo), too",
                    info_beside(self.name(depth))
                ),
            ),
            _ => self.choice("camera_info", &format!("no camera model stands beside {}", self.name(depth)), &infos),
        })
    }
}

/// Chooses the topics of a bag: those that are stated, and else the one of its kind. Adds notes to the bag.
pub(crate) fn choose(bag: &mut Bag, stated: &RgbdTopics) -> Result<Chosen, BagError> {
    let is_image =
        |topic: &BagTopic| [IMAGE, COMPRESSED_IMAGE].contains(&topic.type_name.as_str()) && topic.encoding == ENCODING;
    check_encoding(bag)?;
    let mut missing: Vec<bool> = bag.topics().iter().map(|topic| is_image(topic) && topic.count > 0).collect();
    let mut shows_of = vec![Shows::Other; missing.len()];
    let heads = vec![Some(HEAD); missing.len()];
    let topics = bag.topics().to_vec();
    let mut left = missing.iter().filter(|missing| **missing).count();
    if left > 0 {
        for message in bag.messages_of(missing.clone(), heads) {
            let message = message?;
            let (Some(missing), Some(shows_it), Some(topic)) =
                (missing.get_mut(message.topic), shows_of.get_mut(message.topic), topics.get(message.topic))
            else {
                continue;
            };
            if std::mem::take(missing) {
                *shows_it = shows(topic, &message.data);
                left -= 1;
            }
            if left == 0 {
                break;
            }
        }
    }
    let (chosen, note) = choose_among(&Chooser { bag, shows: shows_of }, stated)?;
    if let Some(note) = note {
        bag.add_note(note);
    }
    Ok(chosen)
}

fn choose_among(chooser: &Chooser<'_>, stated: &RgbdTopics) -> Result<(Chosen, Option<String>), BagError> {
    const IMAGES: [&str; 2] = [IMAGE, COMPRESSED_IMAGE];
    let image = |key: &'static str, name: &Option<String>, what: &str, shows: Shows| match name {
        Some(name) => chooser.stated(name, &IMAGES),
        None => chooser.only(key, what, chooser.showing(shows)),
    };
    let color = image("color", &stated.color, "colour images", Shows::Colours)?;
    let depth = image("depth", &stated.depth, "depth images", Shows::Depth)?;
    let optional =
        |name: &Option<String>, types: &[&str]| name.as_deref().map(|name| chooser.stated(name, types)).transpose();
    let camera_info = match optional(&stated.camera_info, &[CAMERA_INFO])? {
        Some(info) => info,
        None => chooser.camera_info(depth, color)?,
    };
    let beside_color = info_beside(chooser.name(color));
    let color_info = chooser.of_type(CAMERA_INFO).into_iter().find(|info| chooser.name(*info) == beside_color);
    let masks = match optional(&stated.masks, &IMAGES)? {
        Some(masks) => Some(masks),
        None => match chooser.showing(Shows::Labels) {
            labels if labels.is_empty() => None,
            labels => Some(chooser.only("masks", "masks", labels)?),
        },
    };
    let all_joints = chooser.of_type(JOINT_STATE);
    let (joints, note) = match (optional(&stated.joints, &[JOINT_STATE])?, &all_joints[..]) {
        (None, [one]) => (Some(*one), None),
        (None, [_, _, ..]) => {
            let found = names(all_joints.iter().map(|topic| chooser.name(*topic)));
            (None, Some(format!("joints are not read: `joints = \"TOPIC\"` in {FILE} chooses one of {found}")))
        }
        (stated, _) => (stated, None),
    };
    let object_pose = optional(&stated.object_pose, &[POSE])?;
    let color_info = color_info.filter(|info| *info != camera_info);
    Ok((Chosen { color, depth, camera_info, color_info, masks, joints, object_pose }, note))
}

/// Refuses a bag in which no topic has the encoding of ROS 2.
fn check_encoding(bag: &Bag) -> Result<(), BagError> {
    let with_messages: Vec<&BagTopic> = bag.topics().iter().filter(|topic| topic.count > 0).collect();
    let Some(first) = with_messages.first() else {
        return Err(BagError::fault(bag.path(), "there are no messages in it: record it again"));
    };
    if with_messages.iter().any(|topic| topic.encoding == ENCODING) {
        return Ok(());
    }
    let what_to_do = match first.encoding.as_str() {
        "ros1" => "convert it with rosbags-convert",
        "protobuf" => "`mambavitact import` reads Foxglove's messages",
        _ => "record it with ROS 2",
    };
    Err(BagError::fault(
        bag.path(),
        format!("its messages are encoded as {:?}, not as cdr: {what_to_do}", first.encoding),
    ))
}
