//! The user's file: which topics are read, what is published, and where.

use std::collections::{BTreeMap, BTreeSet};
use std::net::IpAddr;
use std::path::Path;

use mvt_robot::hand::Side;
use serde::Deserialize;

use crate::error::LiveError;
use crate::targets::CommandSetup;

/// Domain without a statement, as in ROS 2.
const DOMAIN: u16 = 0;
/// Greatest domain whose ports exist.
const MOST_DOMAIN: u16 = 232;
/// Greatest difference of stamps in a frame without a statement, seconds: half a period at 30 Hz.
const SLOP_S: f64 = 0.016;
/// Most bytes of the file.
const MOST_BYTES: u64 = 1 << 20;

/// A live connection, as the table `[ros]` of a TOML file states it; docs/live.md describes the keys.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RosSetup {
    /// Domain; without it the variable ROS_DOMAIN_ID, else 0.
    pub domain: Option<u16>,
    /// Addresses of our network cards that are used, such as 127.0.0.1; without any, all.
    #[serde(default)]
    pub addresses: Vec<IpAddr>,
    /// Whether lost images are sent again; without it they are not, as usual for sensors.
    #[serde(default)]
    pub reliable: bool,
    /// Topic of depth images, registered to the colours.
    pub depth: String,
    /// Topic of colour images.
    pub color: Option<String>,
    /// Topic of the camera model of the depth images.
    pub camera_info: String,
    /// Topic of masks or labels of the object.
    pub masks: Option<String>,
    /// Label of the object in the masks; without it a mask has two levels.
    pub object: Option<u16>,
    /// Topic of joint angles.
    pub joints: Option<String>,
    /// Topics of touch images by the name of the pad.
    #[serde(default)]
    pub touch: BTreeMap<String, String>,
    /// Topic of the object's true pose in the world of the rig, from a simulator or markers; scores alone receive it.
    pub truth: Option<String>,
    /// Touch sensors that are cameras of this computer, by the name of the pad: their serial numbers, or devices such as `/dev/video2`.
    #[serde(default)]
    pub touch_cameras: BTreeMap<String, String>,
    /// Names of joints in ROS by their names in the rig, where they differ.
    #[serde(default)]
    pub joint_names: BTreeMap<String, String>,
    /// Hand with touch sensors: a name that `rigs` lists, or a hand file (docs/rigs.md) relative to this file. Without it there is no hand.
    pub rig: Option<String>,
    /// Side of the hand `allegro_digit`; left without it.
    pub side: Option<Side>,
    /// Camera of the rig that the images are from; its first one without it.
    pub camera: Option<String>,
    /// Metres per level of depth images of 16 bits; 0.001 without it.
    pub depth_unit_m: Option<f64>,
    /// Greatest difference of the stamps in a frame, seconds.
    #[serde(default = "slop_s")]
    pub slop_s: f64,
    /// Frame of the transforms in which the camera's pose is looked up and poses are published; without it poses are those in the frame of
    /// the camera, or of the rig's world.
    pub world_frame: Option<String>,
    /// Whether stamps are those of a simulator, which publishes its time on /clock.
    #[serde(default)]
    pub sim_time: bool,
    /// What is published.
    #[serde(default)]
    pub publish: PublishSetup,
    /// Where and how the hand is commanded.
    pub command: Option<CommandSetup>,
}

/// What is published, and under which names.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PublishSetup {
    /// Beginning of the names of our topics.
    pub prefix: String,
    /// Frame in which poses are published; without it the frame of the depth images, the world frame, or `world` with a rig.
    pub frame: Option<String>,
    /// Name of the object's frame in the transforms.
    pub object_frame: String,
    /// Whether the pose is published as a transform on /tf.
    pub transforms: bool,
    /// How often the mesh is published, at most, per second; 0 for never.
    pub mesh_hz: f64,
}

impl Default for PublishSetup {
    fn default() -> Self {
        Self {
            prefix: "/mambavitact".to_owned(),
            frame: None,
            object_frame: "mambavitact_object".to_owned(),
            transforms: true,
            mesh_hz: 1.0,
        }
    }
}

fn slop_s() -> f64 {
    SLOP_S
}

/// The whole file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SetupFile {
    ros: RosSetup,
}

/// Returns whether ROS allows the name of a topic, with its slash.
fn is_topic(name: &str) -> bool {
    let is_part = |part: &str| {
        part.chars().next().is_some_and(|c| c.is_ascii_alphabetic() || c == '_')
            && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    name.strip_prefix('/').is_some_and(|rest| rest.split('/').all(is_part))
}

impl RosSetup {
    /// Reads a file.
    ///
    /// # Errors
    /// [`LiveError`] if it cannot be read, or a value is invalid.
    pub fn read(path: &Path) -> Result<Self, LiveError> {
        let text = mvt_files::input::read_text(path, MOST_BYTES)
            .map_err(|reason| LiveError::Io { path: path.to_owned(), reason })?;
        Self::parse(&text).map_err(|fault| LiveError::Fault { path: path.to_owned(), fault })
    }

    /// Reads the text of a file.
    ///
    /// # Errors
    /// A sentence if a value is invalid.
    pub fn parse(text: &str) -> Result<Self, String> {
        let file: SetupFile = toml::from_str(text).map_err(|error| {
            let line = error.span().map(|span| 1 + text.get(..span.start).unwrap_or_default().matches('\n').count());
            let place = line.map(|line| format!("line {line}: ")).unwrap_or_default();
            format!("{place}{}", error.message().replace('\n', "; "))
        })?;
        file.ros.check()?;
        Ok(file.ros)
    }

    fn check(&self) -> Result<(), String> {
        for (key, topic) in self.topics() {
            if !is_topic(topic) {
                return Err(format!(
                    "{key} = {topic:?} is no name of a topic: begin it with a slash, as `mambavitact ros topics` shows it"
                ));
            }
        }
        let mut seen = BTreeSet::new();
        for (key, topic) in self.topics() {
            if !seen.insert(topic) {
                return Err(format!("{key} = {topic:?} is stated twice: each topic has one purpose"));
            }
        }
        if !is_topic(&self.publish.prefix) {
            let prefix = &self.publish.prefix;
            return Err(format!(
                "publish.prefix = {prefix:?} is no beginning of a topic: write one such as \"/mambavitact\""
            ));
        }
        let numbers =
            [("depth_unit_m", self.depth_unit_m.unwrap_or(1.0), 1e-6..=1.0), ("slop_s", self.slop_s, 1e-4..=1.0)];
        for (key, number, range) in numbers {
            if !range.contains(&number) {
                return Err(format!("{key} must lie between {} and {} (it is {number})", range.start(), range.end()));
            }
        }
        if !(0.0..=30.0).contains(&self.publish.mesh_hz) {
            return Err(format!("publish.mesh_hz must lie between 0 and 30 (it is {})", self.publish.mesh_hz));
        }
        let mut seen = BTreeSet::new();
        for (pad, camera) in &self.touch_cameras {
            if self.touch.contains_key(pad) {
                return Err(format!("{pad} stands in both touch and touch_cameras: each pad has one sensor"));
            }
            if camera.is_empty() || !seen.insert(camera) {
                return Err(format!(
                    "touch_cameras.{pad} = {camera:?} is empty or stated twice: write the serial number of its sensor"
                ));
            }
        }
        if self.rig.is_none() {
            if self.masks.is_none() {
                return Err(
                    "without a rig the object is what masks show: name their topic as `masks`, or a hand as `rig`"
                        .to_owned(),
                );
            }
            if self.joints.is_some()
                || self.touch_pads().next().is_some()
                || self.camera.is_some()
                || self.side.is_some()
                || !self.joint_names.is_empty()
                || self.command.is_some()
                || self.truth.is_some()
            {
                return Err(
                    "joints, joint_names, touch, touch_cameras, side, camera, command and truth belong to a hand: name it as `rig`"
                        .to_owned(),
                );
            }
        } else if self.joints.is_none() {
            return Err("a hand needs its joint angles: name their topic as `joints`".to_owned());
        }
        self.command.as_ref().map_or(Ok(()), CommandSetup::check)?;
        if self.domain.is_some_and(|domain| domain > MOST_DOMAIN) {
            return Err(format!("domain must lie between 0 and {MOST_DOMAIN}"));
        }
        Ok(())
    }

    /// Returns the topics that are read or commanded, with their keys.
    pub fn topics(&self) -> Vec<(String, &str)> {
        let stated = [
            ("depth", Some(&self.depth)),
            ("color", self.color.as_ref()),
            ("camera_info", Some(&self.camera_info)),
            ("masks", self.masks.as_ref()),
            ("joints", self.joints.as_ref()),
            ("truth", self.truth.as_ref()),
        ];
        let mut topics: Vec<(String, &str)> =
            stated.into_iter().filter_map(|(key, topic)| Some((key.to_owned(), topic?.as_str()))).collect();
        topics.extend(self.touch.iter().map(|(pad, topic)| (format!("touch.{pad}"), topic.as_str())));
        topics.extend(self.command.iter().map(|command| ("command.topic".to_owned(), command.topic.as_str())));
        topics
    }

    /// Returns the pads whose images are read, with the key under which they stand.
    pub(crate) fn touch_pads(&self) -> impl Iterator<Item = (&'static str, &String)> {
        let topics = self.touch.keys().map(|pad| ("touch", pad));
        topics.chain(self.touch_cameras.keys().map(|pad| ("touch_cameras", pad)))
    }

    /// Returns the domain: that of the file, else that of the variable ROS_DOMAIN_ID, else 0.
    pub fn domain(&self) -> u16 {
        self.domain.unwrap_or_else(domain_of_environment)
    }

    /// Returns the hand: the file of this name beside the user's file, else the name.
    pub fn rig_beside(&self, file: &Path) -> Option<String> {
        let rig = self.rig.as_ref()?;
        let beside = file.parent().unwrap_or(Path::new("")).join(rig);
        Some(if beside.is_file() { beside.display().to_string() } else { rig.clone() })
    }

    /// Returns the greatest difference of stamps in a frame, nanoseconds.
    pub fn slop_ns(&self) -> i64 {
        (self.slop_s * 1e9) as i64
    }
}

/// Returns the domain that the variable ROS_DOMAIN_ID states, or 0.
pub fn domain_of_environment() -> u16 {
    let stated = std::env::var("ROS_DOMAIN_ID").ok().and_then(|text| text.trim().parse().ok());
    stated.filter(|domain| *domain <= MOST_DOMAIN).unwrap_or(DOMAIN)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEAST: &str = "[ros]\ndepth = \"/d\"\ncamera_info = \"/i\"\nmasks = \"/m\"\n";

    #[test]
    fn the_least_file_has_the_stated_defaults() {
        let setup = RosSetup::parse(LEAST).unwrap();
        assert_eq!((setup.slop_ns(), setup.reliable, setup.addresses.len()), (16_000_000, false, 0));
        assert_eq!(setup.publish, PublishSetup::default());
        let topics: Vec<&str> = setup.topics().iter().map(|(_, topic)| *topic).collect();
        assert_eq!(topics, ["/d", "/i", "/m"]);
    }

    #[test]
    fn each_fault_is_one_line_that_says_what_to_do() {
        for (more, words) in [
            ("colour = \"/c\"", "colour"),
            ("color = \"c\"", "begin it with a slash"),
            ("color = \"/a//b\"", "no name of a topic"),
            ("color = \"/9a\"", "no name of a topic"),
            ("color = \"/d\"", "stated twice"),
            ("slop_s = nan", "slop_s must lie"),
            ("slop_s = -1.0", "slop_s must lie"),
            ("depth_unit_m = 0.0", "depth_unit_m must lie"),
            ("domain = 300", "domain must lie"),
            ("joints = \"/j\"", "belong to a hand"),
            ("rig = \"allegro_digit\"", "joint angles"),
            ("addresses = [\"localhost\"]", "line 5"),
            ("touch_cameras = { thumb = \"D1\", ring = \"D1\" }", "stated twice"),
            ("touch_cameras = { thumb = \"D1\" }\ntouch = { thumb = \"/t\" }", "both touch and touch_cameras"),
            ("touch_cameras = { thumb = \"D1\" }", "belong to a hand"),
            ("publish = { mesh_hz = 1e9 }", "mesh_hz"),
            ("publish = { prefix = \"x\" }", "publish.prefix"),
        ] {
            let error = RosSetup::parse(&format!("{LEAST}{more}\n")).unwrap_err();
            assert!(error.contains(words) && !error.contains('\n'), "{more}: {error}");
        }
        let error = RosSetup::parse("[ros]\ndepth = \"/d\"\ncamera_info = \"/i\"\n").unwrap_err();
        assert!(error.contains("masks"), "{error}");
    }
}
