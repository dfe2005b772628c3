//! Files of an export that LeRobot does not read: per episode a mapping with the calibration of the cameras, scene.json and data.pkl.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use mvt_feelsight::{Log, SCENE_FILE};
use mvt_frames::camera::{Intrinsics, PosedCamera};

use crate::error::ExchangeError;
use crate::foxglove::optical;
use crate::record::{RECORD_FILE, record_of};

/// Name of the mapping.
pub(crate) const MAPPING_FILE: &str = "mapping.toml";

/// Returns the folder of an episode's files in a data set.
pub(crate) fn folder(episode: usize) -> PathBuf {
    Path::new("meta/mambavitact").join(format!("episode-{episode:06}"))
}

/// Returns the names and bytes of the files.
pub(crate) fn files(log: &Log, has_poses: bool) -> Result<Vec<(&'static str, Vec<u8>)>, ExchangeError> {
    let mut files = vec![(MAPPING_FILE, mapping(log, has_poses).into_bytes())];
    files.extend(log.scene_file()?.map(|scene| (SCENE_FILE, scene)));
    files.extend(record_of(log).map(|record| (RECORD_FILE, record)));
    Ok(files)
}

/// Returns the column of a pad's images. LeRobot allows no slash in the name of a column.
pub(crate) fn touch_column(pad: &str) -> String {
    format!("observation.images.touch_{}", pad.replace('/', "_"))
}

/// Returns the name of the exact depth of a camera, by its number.
pub(crate) fn depth_file(camera: usize) -> String {
    format!("depth-{camera}.npz")
}

/// Returns the files with exact depth: their names, and those in the log. None for a compact log, or if a lens distorts.
pub(crate) fn depths(log: &Log) -> Vec<(String, PathBuf)> {
    if record_of(log).is_none() {
        return Vec::new();
    }
    let source = |name: &str| log.folder().join("realsense").join(name).join("depth.npz");
    let all = log.cameras().iter().enumerate().map(|(k, camera)| (depth_file(k), source(&camera.name)));
    all.filter(|(_, source)| source.is_file()).collect()
}

/// Returns the mapping with which the episode becomes the log again.
fn mapping(log: &Log, has_poses: bool) -> String {
    let quoted = |text: &str| toml::Value::from(text).to_string();
    let side = log.hand().side().name();
    let mut text = format!("[hand]\nside = \"{side}\"\njoints = \"observation.state\"\n");
    let _ = write!(text, "time = \"observation.time_s\"\n\n[object]\nname = {}\n", quoted(log.object_name()));
    if has_poses {
        text += "frame = \"observation.object_pose\"\n";
    }
    for (k, PosedCamera { name, intrinsics, pose }) in log.cameras().iter().enumerate() {
        let Intrinsics { width, height, fx, fy, cx, cy } = intrinsics;
        let pose = *pose * optical();
        let t = pose.origin().coords();
        let [w, x, y, z] = pose.quaternion_wxyz();
        let key = |rest: &str| quoted(&format!("observation.images.{name}{rest}"));
        let _ = write!(
            text,
            "\n[[camera]]\nname = {}\ndepth = {}\ndepth_unit_m = 0.0001\n{}\
             intrinsics = {{ width = {width}, height = {height}, fx = {fx:?}, fy = {fy:?}, cx = {cx:?}, cy = {cy:?} }}\n\
             pose = {{ translation_m = [{:?}, {:?}, {:?}], quaternion_xyzw = [{x:?}, {y:?}, {z:?}, {w:?}] }}\n",
            quoted(name),
            key("_depth"),
            if log.has_colours(k) { format!("colours = {}\n", key("")) } else { String::new() },
            t.x,
            t.y,
            t.z,
        );
    }
    for (_, pad) in log.hand().pads().iter().enumerate().filter(|(k, _)| log.has_touch_images(*k)) {
        let is_bare = pad.name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
        let key = if is_bare { pad.name.clone() } else { quoted(&pad.name) };
        let image = quoted(&touch_column(&pad.name));
        let _ = write!(text, "\n[touch.{key}]\nimage = {image}\n");
        if !pad.profile.is_tacto() {
            // A profile has no value that TOML cannot express.
            let profile = toml::Value::try_from(&pad.profile).map(|profile| profile.to_string()).unwrap_or_default();
            let _ = writeln!(text, "profile = {profile}");
        }
    }
    text
}
