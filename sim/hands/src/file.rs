//! The TOML file of a hand.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use mvt_frames::camera::PosedCamera;
use mvt_robot::hand::{Drive, Hand, Side, UPRIGHT};
use serde::{Deserialize, Serialize};

/// A hand with touch sensors, as its file describes it. Lengths are metres, angles radians unless the name says degrees.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandFile {
    /// Name of the hand, also in files of runs.
    pub name: String,
    /// Side of the hand. A gripper is a right hand.
    #[serde(default = "right")]
    pub side: Side,
    /// Path of the MJCF (.xml) or URDF (.urdf), relative to this file. `leap:` before it stands for the folder of the LEAP hand, which is
    /// fetched.
    pub model: String,
    /// Names of links that are left out, with all that they carry.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub without: Vec<String>,
    /// Middle of the palm's surface in the world. Without it the hand carries nothing on its palm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub palm_centre_m: Option<[f64; 3]>,
    /// Names of the joints that move; all others are held. Without it all joints move.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joints: Option<Vec<String>>,
    /// The link that is fixed in the world.
    #[serde(default)]
    pub base: BaseLink,
    /// Names of the joints of each finger, from base to tip. They are checked, and returned as indices.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub fingers: BTreeMap<String, Vec<String>>,
    /// Where the hand holds objects. Without it: the middle of the pads at joint angles 0, as far as these are in range.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grasp: Option<GraspMount>,
    /// Controllers and friction of all joints.
    #[serde(default, skip_serializing_if = "DriveChange::is_default")]
    pub control: DriveChange,
    /// What is particular to a joint.
    #[serde(default, rename = "joint", skip_serializing_if = "BTreeMap::is_empty")]
    pub joint_changes: BTreeMap<String, JointChange>,
    /// Touch sensors.
    #[serde(default, rename = "pad", skip_serializing_if = "Vec::is_empty")]
    pub pads: Vec<PadMount>,
    /// Cameras that look at the hand.
    #[serde(default, rename = "camera", skip_serializing_if = "Vec::is_empty")]
    pub cameras: Vec<CameraMount>,
}

/// The link that is fixed in the world, and where. The world's z axis points out of the palm, and its x axis along the fingers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BaseLink {
    /// Name of the link; what does not hang on it is left out. Without it: the root of the model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub link: Option<String>,
    /// Position of the link's frame in the world.
    #[serde(default)]
    pub position_m: [f64; 3],
    /// Orientation of the link's frame in the world, quaternion (w, x, y, z).
    #[serde(default = "upright")]
    pub orientation_wxyz: [f64; 4],
}

impl Default for BaseLink {
    fn default() -> Self {
        Self { link: None, position_m: [0.0; 3], orientation_wxyz: UPRIGHT }
    }
}

/// Point at which a hand holds objects.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraspMount {
    /// Name of the link with which it moves. Without it: it is fixed in the world.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub link: Option<String>,
    /// The point in the link's frame, or in the world.
    pub point_m: [f64; 3],
}

/// Values that replace those of [`Drive`]. Without them: the model's largest torque, if it gives one, and the drive of the Allegro.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveChange {
    /// Stiffness of the position controller, Nm/rad.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness: Option<f64>,
    /// Damping, Nm s/rad.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damping: Option<f64>,
    /// Inertia of the rotor, kg m^2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub armature: Option<f64>,
    /// Dry friction, Nm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub friction: Option<f64>,
    /// Largest torque, Nm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub torque_limit: Option<f64>,
}

impl DriveChange {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Replaces values of a drive.
    pub(crate) fn apply(&self, drive: &mut Drive) {
        let changes = [
            (&mut drive.stiffness, self.stiffness),
            (&mut drive.damping, self.damping),
            (&mut drive.armature, self.armature),
            (&mut drive.friction, self.friction),
            (&mut drive.torque_limit, self.torque_limit),
        ];
        for (value, change) in changes {
            *value = change.unwrap_or(*value);
        }
    }
}

/// What is particular to a joint.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointChange {
    /// Angle or displacement at which the joint is held, radians or metres. Without it the joint moves.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held_at: Option<f64>,
    /// Limits, which replace those of the model, radians or metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<[f64; 2]>,
    /// Whether its angle changes sign between a right and a left hand.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub mirrors: bool,
    /// Stiffness of the position controller, Nm/rad.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness: Option<f64>,
    /// Damping, Nm s/rad.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damping: Option<f64>,
    /// Inertia of the rotor, kg m^2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub armature: Option<f64>,
    /// Dry friction, Nm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub friction: Option<f64>,
    /// Largest torque, Nm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub torque_limit: Option<f64>,
}

impl JointChange {
    /// Returns the values that replace those of the drive.
    pub(crate) fn drive(&self) -> DriveChange {
        let Self { stiffness, damping, armature, friction, torque_limit, .. } = *self;
        DriveChange { stiffness, damping, armature, friction, torque_limit }
    }
}

/// Touch sensor on a link. Its frame is that of the gel: x out of the gel from the camera, z up in the image.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PadMount {
    /// Name, also of its folder in logs.
    pub name: String,
    /// Name of the link that carries it. Either this or `site` is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub link: Option<String>,
    /// Name of the site of an MJCF that carries it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site: Option<String>,
    /// Position of the gel's frame on the link or site.
    #[serde(default)]
    pub position_m: [f64; 3],
    /// Orientation of the gel's frame on the link or site, quaternion (w, x, y, z).
    #[serde(default = "upright")]
    pub orientation_wxyz: [f64; 4],
    /// Name or file of the sensor's profile, with its body; the path of a file is relative to the hand file.
    #[serde(default = "digit")]
    pub profile: String,
    /// Name of a shape of the link that is the gel. The link then is the sensor, and gets no body of one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gel: Option<String>,
    /// Whether the sensor takes the place of the shapes of its link into which it reaches.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub replaces: bool,
}

/// Camera that looks at the hand. Its pose is a position, with the point of grasp in the middle of the image or with an orientation, or a
/// direction from the palm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraMount {
    /// Name, also of its folder in logs.
    pub name: String,
    /// Width of its images, pixels.
    #[serde(default = "width")]
    pub width: usize,
    /// Height of its images, pixels.
    #[serde(default = "height")]
    pub height: usize,
    /// Vertical field of view, degrees. Either this or `fx` is given; without both it is 45.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fov_y_deg: Option<f64>,
    /// Focal length along the columns, pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fx: Option<f64>,
    /// Focal length along the rows, pixels; as `fx` without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fy: Option<f64>,
    /// Column of the principal point, pixels; the middle without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cx: Option<f64>,
    /// Row of the principal point, pixels; the middle without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cy: Option<f64>,
    /// Name of the link, which no joint moves, in whose frame the pose is. Without it: the world.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub link: Option<String>,
    /// Position.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_m: Option<[f64; 3]>,
    /// Orientation, quaternion (w, x, y, z): x to the right in the image, y up, z backwards.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Direction from the palm to the camera, from the fingers towards +y of a right hand, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub azimuth_deg: Option<f64>,
    /// Angle above the palm plane, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub elevation_deg: Option<f64>,
    /// Distance from the palm; 0.35 m without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distance_m: Option<f64>,
}

/// A hand from a file, with all that is not part of the hand itself.
#[derive(Debug, Clone)]
pub struct LoadedHand {
    /// The hand.
    pub hand: Arc<Hand>,
    /// The cameras of the file.
    pub cameras: Vec<PosedCamera>,
    /// Indices of the joints of each finger that the file names, from base to tip.
    pub fingers: BTreeMap<String, Vec<usize>>,
    /// Path of the MJCF or URDF.
    pub model: PathBuf,
    /// What was left out, and what looks wrong; one line each.
    pub warnings: Vec<String>,
}

fn right() -> Side {
    Side::Right
}
fn upright() -> [f64; 4] {
    UPRIGHT
}
fn digit() -> String {
    "digit".to_owned()
}
fn width() -> usize {
    640
}
fn height() -> usize {
    480
}
