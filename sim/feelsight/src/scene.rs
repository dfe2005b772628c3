//! scene.json: everything about an episode that data.pkl has no key for.

use std::collections::BTreeMap;
use std::sync::Arc;

use image::RgbImage;
use mvt_frames::camera::PosedCamera;
use mvt_robot::hand::{Hand, PerPad};
use serde::{Deserialize, Serialize};

/// Name of this file, which lies beside data.pkl.
pub const SCENE_FILE: &str = "scene.json";

/// Version of scene.json that [`LogWriter`](crate::LogWriter) writes.
pub const FORMAT_VERSION: u32 = 1;

/// Contents of scene.json: how an episode was made. Loaders of other programs ignore the file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneFile {
    /// [`FORMAT_VERSION`] of the program that wrote the file.
    pub format_version: u32,
    /// Version of the program that made the log.
    pub program_version: String,
    /// Object in the hand.
    pub object: SceneObject,
    /// The hand. The file holds the side of an Allegro, and the description of any other hand.
    #[serde(with = "crate::hand")]
    pub hand: Arc<Hand>,
    /// Seed of everything random in the episode.
    pub seed: u64,
    /// Gravity in the world at the start, m/s^2. The world's axes follow the palm, so a tilted palm is a tilted vector.
    pub gravity_m_s2: [f64; 3],
    /// Name of the controller, or the text of a schedule.
    pub gait: String,
    /// Names of the cameras, in the order of the observations; also their folders under realsense/.
    pub cameras: Vec<String>,
    /// Frames per second of the log.
    pub frame_rate_hz: f64,
    /// Decisions of the controller per second.
    pub control_rate_hz: f64,
    /// Steps of the physics per second.
    pub physics_rate_hz: f64,
    /// Settings of the sensors' noise, by name; empty without noise.
    pub noise: BTreeMap<String, f64>,
    /// Parameters that were drawn from the seed: friction, mass, gains, start, each by name with its unit.
    pub randomised: BTreeMap<String, f64>,
    /// SHA-256 of the whole configuration, hexadecimal.
    pub config_sha256: String,
    /// End of the episode.
    pub end: EpisodeEnd,
}

/// Object of an episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneObject {
    /// Name in the catalogue, or the file stem of a user's mesh.
    pub name: String,
    /// File of the mesh, or the name of the procedural shape.
    pub mesh: String,
    /// SHA-256 of that file, hexadecimal; `None` for a procedural shape.
    pub mesh_sha256: Option<String>,
    /// Motion from the frame of the published mesh to that of the object, 4 x 4 row-major, metres. data.pkl holds poses
    /// of the published mesh.
    pub object_from_file: [[f64; 4]; 4],
    /// Mass before randomisation, kg.
    pub mass_kg: f64,
}

/// End of an episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EpisodeEnd {
    /// Whether the episode lasted for its planned time.
    pub complete: bool,
    /// Reason of the end, in words: "time is up", "the object was dropped".
    pub reason: String,
}

/// Description of a log before its first frame.
#[derive(Debug, Clone, PartialEq)]
pub struct LogMeta {
    /// Contents of scene.json. [`LogWriter::finish`](crate::LogWriter::finish) sets `end`.
    pub scene: SceneFile,
    /// The cameras, in the order of the observations and of `scene.cameras`.
    pub cameras: Vec<PosedCamera>,
    /// Images of the touch sensors that touch nothing: the log is compact, and its touch images are differences from them. `None` for
    /// FeelSight's layout.
    pub untouched: Option<PerPad<RgbImage>>,
}
