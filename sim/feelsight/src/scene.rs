//! scene.json: what data.pkl cannot say.

use std::collections::BTreeMap;

use mvt_robot::hand::Side;
use serde::{Deserialize, Serialize};

/// Name of the file beside data.pkl.
pub const SCENE_FILE: &str = "scene.json";

/// Version of scene.json that this program writes.
pub const FORMAT_VERSION: u32 = 1;

/// How an episode was made. Written as scene.json beside data.pkl; other people's loaders pass it over.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneFile {
    /// [`FORMAT_VERSION`] of the program that wrote it.
    pub format_version: u32,
    /// Version of the program that made the log.
    pub program_version: String,
    /// What was turned.
    pub object: SceneObject,
    /// Which hand turned it.
    pub hand: Side,
    /// Seed of everything random in the episode.
    pub seed: u64,
    /// Gravity in the world, m/s^2. The world's axes follow the palm, so a tilted palm is a tilted vector.
    pub gravity_m_s2: [f64; 3],
    /// Name of the gait.
    pub gait: String,
    /// Names of the cameras, in the order of the observations; also their folders under realsense/.
    pub cameras: Vec<String>,
    /// Frames per second of the log.
    pub frame_rate_hz: f64,
    /// Decisions of the controller per second.
    pub control_rate_hz: f64,
    /// Steps of the physics per second.
    pub physics_rate_hz: f64,
    /// Settings of the sensors' noise, by name; empty where there is none.
    pub noise: BTreeMap<String, f64>,
    /// Parameters that the seed chose: friction, mass, gains, start, each by name with its unit.
    pub randomised: BTreeMap<String, f64>,
    /// SHA-256 of the whole configuration, hexadecimal.
    pub config_sha256: String,
    /// How the episode ended.
    pub end: EpisodeEnd,
}

/// The object of an episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneObject {
    /// Name in the catalogue, or the file stem of a user's mesh.
    pub name: String,
    /// File of the mesh, or the name of the procedural shape.
    pub mesh: String,
    /// SHA-256 of that file, hexadecimal; `None` for a procedural shape.
    pub mesh_sha256: Option<String>,
    /// Takes the coordinates of the published mesh to the object's frame, 4 x 4 row-major, metres. data.pkl holds poses of the
    /// published mesh.
    pub object_from_file: [[f64; 4]; 4],
    /// Mass, kg, before it was randomised.
    pub mass_kg: f64,
}

/// How an episode ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EpisodeEnd {
    /// Whether it lasted as long as it was meant to.
    pub complete: bool,
    /// Why it ended, in words: "time is up", "the object was dropped".
    pub reason: String,
}
