//! Which topics of a recording are which sensors: a short TOML file, or the names of our own export.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use mvt_frames::camera::Intrinsics;
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::{Hand, Side, TouchPad};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use serde::Deserialize;

use crate::error::ExchangeError;
use crate::messages::frame_name;

/// Greatest size of a mapping file, bytes.
const LARGEST: u64 = 1 << 20;

/// Contents of a mapping file.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Mapping {
    pub hand: HandMapping,
    #[serde(default)]
    pub object: ObjectMapping,
    #[serde(default, rename = "camera")]
    pub cameras: Vec<CameraMapping>,
    /// By the name of the pad.
    #[serde(default)]
    touch: BTreeMap<String, TouchMapping>,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct HandMapping {
    pub side: Side,
    /// Topic of the joint angles.
    pub joints: String,
    /// Column of the times in a data set, seconds; without it, the number of the frame by the data set's rate.
    pub time: Option<String>,
    /// Names of the hand's joints in the source, in the order of the hand. A file that gives none has the hand's own.
    names: Option<Vec<String>>,
    /// Frame of the hand's base in the transforms. Without it poses are given in `world`.
    pub base: Option<String>,
    /// Frame in the transforms that is this program's world.
    pub world: String,
}

impl Default for HandMapping {
    fn default() -> Self {
        Self {
            side: Side::Left,
            joints: "/hand/joints".into(),
            time: None,
            names: None,
            base: None,
            world: "world".into(),
        }
    }
}

impl HandMapping {
    /// Returns the hand.
    pub fn hand(&self) -> Arc<Hand> {
        Hand::allegro(self.side)
    }

    /// Returns the names of the hand's joints in the source, in the order of the hand.
    pub fn names(&self) -> &[String] {
        self.names.as_deref().unwrap_or_default()
    }

    /// Fills in the names of the joints.
    fn complete(&mut self) {
        let hand = self.hand();
        self.names.get_or_insert_with(|| hand.joints().iter().map(|joint| joint.name.clone()).collect());
    }
}

#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct ObjectMapping {
    /// Name in the log.
    pub name: Option<String>,
    /// Frame of the object's true pose in the transforms.
    pub frame: Option<String>,
}

#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CameraMapping {
    pub name: String,
    pub depth: String,
    /// Metres of a step, for depth in whole numbers.
    #[serde(default = "millimetre")]
    pub depth_unit_m: f64,
    pub colours: Option<String>,
    pub labels: Option<String>,
    /// Topic of the pinhole model.
    pub calibration: Option<String>,
    /// Pinhole model, in place of a topic.
    pub intrinsics: Option<PinholeMapping>,
    /// Frame in the transforms, z along the optical axis and y down; without it, that of the calibration.
    pub frame: Option<String>,
    /// Pose in the hand's base or the world, in place of a frame.
    pub pose: Option<PoseMapping>,
}

fn millimetre() -> f64 {
    1e-3
}

#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PinholeMapping {
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
}

impl PinholeMapping {
    pub fn intrinsics(self) -> Intrinsics {
        let Self { width, height, fx, fy, cx, cy } = self;
        Intrinsics { width, height, fx, fy, cx, cy }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PoseMapping {
    translation_m: [f64; 3],
    quaternion_xyzw: [f64; 4],
}

impl PoseMapping {
    /// Returns the motion; `None` unless the quaternion has the length 1.
    pub fn isometry(self) -> Option<Isometry3<f64>> {
        let [x, y, z, w] = self.quaternion_xyzw;
        let quaternion = Quaternion::new(w, x, y, z);
        let is_rotation = (quaternion.norm() - 1.0).abs() < 1e-3;
        let [tx, ty, tz] = self.translation_m;
        let is_valid = is_rotation && self.translation_m.iter().all(|value| value.is_finite());
        is_valid
            .then(|| Isometry3::from_parts(Translation3::new(tx, ty, tz), UnitQuaternion::from_quaternion(quaternion)))
    }
}

#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TouchMapping {
    pub image: String,
    /// True depth in FeelSight's levels.
    pub depth: Option<String>,
    /// True contact mask.
    pub contact: Option<String>,
    /// Clockwise quarter turns that put the image upright.
    #[serde(default)]
    pub quarter_turns: u8,
    /// Whether red and blue are exchanged.
    #[serde(default)]
    pub bgr: bool,
    /// The sensor, by the keys of a profile's file; by default TACTO's DIGIT.
    #[serde(default)]
    pub profile: SensorProfile,
}

impl Mapping {
    /// Returns the hand with the touch sensors of the mapping.
    pub fn hand(&self) -> Arc<Hand> {
        let sensor =
            |pad: &TouchPad| self.touch.get(&pad.name).map_or_else(SensorProfile::tacto, |of| of.profile.clone());
        self.hand.hand().with_profiles(sensor)
    }

    /// Returns the touch sensor of a pad.
    pub fn touch(&self, pad: usize) -> Option<&TouchMapping> {
        self.touch.get(&self.hand.hand().pads().get(pad)?.name)
    }

    /// Reads a mapping file.
    pub fn read(path: &Path) -> Result<Self, ExchangeError> {
        let failed = |reason: String| ExchangeError::Mapping { path: path.to_path_buf(), reason };
        let text = mvt_files::input::read_text(path, LARGEST).map_err(|error| failed(error.to_string()))?;
        Self::parse(&text).map_err(failed)
    }

    /// Reads the text of a mapping file.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut mapping: Self = toml::from_str(text).map_err(|error| {
            let line = error.span().map_or(1, |span| 1 + text.bytes().take(span.start).filter(|&b| b == b'\n').count());
            // One line: the library adds a drawing.
            format!("line {line}: {}", error.message().lines().collect::<Vec<_>>().join(" "))
        })?;
        mapping.hand.complete();
        let (hand, names) = (mapping.hand.hand(), mapping.hand.names());
        if names.len() != hand.joints().len() {
            let own: Vec<&str> = hand.joints().iter().map(|joint| joint.name.as_str()).collect();
            return Err(format!("hand.names has {} names; give {}: of {}", names.len(), own.len(), own.join(", ")));
        }
        if let Some(name) = mapping.touch.keys().find(|name| hand.pads().iter().all(|pad| pad.name != **name)) {
            let pads: Vec<&str> = hand.pads().iter().map(|pad| pad.name.as_str()).collect();
            return Err(format!("touch names the pad {name:?}, and the hand's pads are {}", pads.join(", ")));
        }
        if let Some((_, twice)) = names.iter().enumerate().find(|&(k, name)| names.iter().take(k).any(|n| n == name)) {
            return Err(format!("hand.names has {twice:?} twice"));
        }
        for (name, TouchMapping { profile, .. }) in &mapping.touch {
            profile.validate().map_err(|error| format!("touch.{name}.profile: {error}"))?;
        }
        for CameraMapping { name, depth_unit_m, intrinsics, pose, .. } in &mapping.cameras {
            if !(1e-7..=1.0).contains(depth_unit_m) {
                return Err(format!("camera {name}: depth_unit_m is {depth_unit_m}; give metres, such as 0.001"));
            }
            if pose.is_some_and(|pose| pose.isometry().is_none()) {
                return Err(format!("camera {name}: pose.quaternion_xyzw has not the length 1"));
            }
            if intrinsics.is_some_and(|pinhole| !is_plausible(&pinhole.intrinsics())) {
                return Err(format!("camera {name}: intrinsics are not those of a camera; sizes are pixels"));
            }
        }
        let HandMapping { base, world, .. } = &mut mapping.hand;
        let frames = base.iter_mut().chain([world]).chain(&mut mapping.object.frame);
        frames
            .chain(mapping.cameras.iter_mut().filter_map(|camera| camera.frame.as_mut()))
            .for_each(|frame| *frame = frame_name(frame).to_owned());
        Ok(mapping)
    }

    /// Returns the mapping of a file that [`export_mcap`](crate::export_mcap) wrote, by its topics in their order. The first camera is that
    /// whose topics come first.
    pub fn of_our_export<'a>(topics: impl Iterator<Item = &'a str>) -> Self {
        let mut mapping = Self { hand: HandMapping::default(), ..Self::default() };
        mapping.hand.complete();
        mapping.object.frame = Some("object".to_owned());
        for topic in topics {
            let part = |sensor: &str| topic.strip_prefix(&format!("/{sensor}/")).and_then(|rest| rest.rsplit_once('/'));
            if let Some((name, "depth")) = part("camera") {
                let of = |kind: &str| format!("/camera/{name}/{kind}");
                mapping.cameras.push(CameraMapping {
                    name: name.to_owned(),
                    depth: topic.to_owned(),
                    depth_unit_m: millimetre(),
                    colours: Some(of("color")),
                    labels: Some(of("labels")),
                    calibration: Some(of("calibration")),
                    ..CameraMapping::default()
                });
            }
            if let Some((name, "image")) = part("touch") {
                let of = |kind: &str| Some(format!("/touch/{name}/{kind}"));
                let touch = TouchMapping {
                    image: topic.to_owned(),
                    depth: of("depth"),
                    contact: of("contact"),
                    ..TouchMapping::default()
                };
                mapping.touch.insert(name.to_owned(), touch);
            }
        }
        mapping
    }
}

/// Returns whether numbers may be those of a camera.
pub(crate) fn is_plausible(intrinsics: &Intrinsics) -> bool {
    let &Intrinsics { width, height, fx, fy, cx, cy } = intrinsics;
    let is_focal = |focal: f64| (1.0..1e6).contains(&focal);
    (1..=MAX_SIDE).contains(&width)
        && (1..=MAX_SIDE).contains(&height)
        && is_focal(fx)
        && is_focal(fy)
        && cx.is_finite()
        && cy.is_finite()
}

/// Greatest width and height of an image, pixels.
const MAX_SIDE: usize = mvt_feelsight::npz::NpzReader::MAX_SIDE;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mapping_is_read_and_mistakes_are_named() {
        let text = "[hand]\nside = \"right\"\njoints = \"/joint_states\"\nbase = \"palm\"\n[object]\nname = \"mug\"\n\
                    [[camera]]\nname = \"front\"\ndepth = \"/d\"\nintrinsics = { width = 64, height = 48, fx = 60, fy = 60, cx = 32, cy = 24 }\n\
                    pose = { translation_m = [0.3, 0, 0.1], quaternion_xyzw = [0, 0, 0, 1] }\n\
                    [touch.thumb]\nimage = \"/digit/D20123\"\nquarter_turns = 1\n";
        let mapping = Mapping::parse(text).unwrap();
        assert_eq!((mapping.hand.side, mapping.hand.names()[15].as_str()), (Side::Right, "thumb_3"));
        assert_eq!(mapping.touch(3).unwrap().image, "/digit/D20123");
        assert_eq!(mapping.touch(2), None);
        assert_eq!(mapping.cameras[0].pose.unwrap().isometry().unwrap().translation.x, 0.3);
        for (wrong, said) in [
            (text.replace("joints =", "joint ="), "line 3: unknown field `joint`"),
            (text.replace("base =", "names = [\"a\"]\nbase ="), "hand.names has 1 names; give 16: of index_0, index_1"),
            (text.replace("0, 0, 0, 1]", "0, 0, 0, 0]"), "length 1"),
            (text.replace("fx = 60", "fx = 0"), "intrinsics"),
            (text.replace("depth = \"/d\"", "depth = \"/d\"\ndepth_unit_m = 0"), "depth_unit_m"),
            (
                text.replace("[touch.thumb]", "[touch.toe]"),
                "the pad \"toe\", and the hand's pads are index, middle, ring, thumb",
            ),
        ] {
            let error = Mapping::parse(&wrong).unwrap_err();
            assert!(error.contains(said) && !error.contains('\n'), "{error}");
        }
    }

    #[test]
    fn the_topics_of_an_export_are_known() {
        let topics = [
            "/tf",
            "/camera/side/color",
            "/camera/side/depth",
            "/camera/b/depth",
            "/touch/ring/image",
            "/touch/toe/image",
        ];
        let mapping = Mapping::of_our_export(topics.into_iter());
        let names: Vec<&str> = mapping.cameras.iter().map(|camera| camera.name.as_str()).collect();
        assert_eq!(names, ["side", "b"]);
        assert_eq!(mapping.touch(2).unwrap().contact.as_deref(), Some("/touch/ring/contact"));
        assert_eq!(mapping.touch(0), None);
    }
}
