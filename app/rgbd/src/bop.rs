//! Scenes of the BOP benchmark.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra as na;
use serde::Deserialize;

use crate::description::{self, Description};
use crate::error::RgbdError;
use crate::folders::{self, IMAGES};
use crate::parts::{FrameFiles, Parts};
use crate::pattern::{NamedFiles, in_folder};
use crate::pixels::DepthCode;
use crate::text;

/// File of the cameras, by which a scene is known.
const CAMERAS: &str = "scene_camera.json";

#[derive(Deserialize)]
struct SceneCamera {
    #[serde(rename = "cam_K")]
    matrix: [f64; 9],
    /// Millimetres per level.
    depth_scale: Option<f64>,
    #[serde(rename = "cam_R_w2c")]
    rotation: Option<[f64; 9]>,
    /// Millimetres.
    #[serde(rename = "cam_t_w2c")]
    translation: Option<[f64; 3]>,
}

#[derive(Deserialize)]
struct ObjectPose {
    obj_id: u32,
    #[serde(rename = "cam_R_m2c")]
    rotation: [f64; 9],
    /// Millimetres.
    #[serde(rename = "cam_t_m2c")]
    translation: [f64; 3],
}

/// Returns whether a folder is such a scene.
pub(crate) fn is_here(folder: &Path) -> bool {
    folder.join(CAMERAS).is_file()
}

/// Finds the frames of a folder.
pub(crate) fn parts(folder: &Path, description: &Description) -> Result<Parts, RgbdError> {
    let cameras: BTreeMap<u64, SceneCamera> = json(&folder.join(CAMERAS))?;
    let truths = folder.join("scene_gt.json");
    let truths: BTreeMap<u64, Vec<ObjectPose>> = if truths.exists() { json(&truths)? } else { BTreeMap::new() };
    let object = choose(folder, description, &truths)?;
    let depths = in_folder(&folder.join("depth"), &["png"])?;
    let colours = match in_folder(&folder.join("rgb"), &IMAGES)? {
        none if none.is_empty() => in_folder(&folder.join("gray"), &IMAGES)?,
        found => found,
    };
    let visible = in_folder(&folder.join("mask_visib"), &["png"])?;
    let own = folders::masks(folder, description)?;
    let mut notes = Vec::new();
    let names: Vec<_> = depths.keys().cloned().collect();
    let times_s = folders::times_s(&names, description.frame_hz, &mut notes);
    let mut scales: Vec<f64> = Vec::new();
    let mut frames = Vec::new();
    for ((name, depth), time_s) in depths.into_iter().zip(times_s) {
        let number = name.number().and_then(|number| u64::try_from(number).ok());
        let Some((number, camera)) = number.and_then(|number| Some((number, cameras.get(&number)?))) else { continue };
        let Some(color) = colours.get(&name).cloned() else { continue };
        let intrinsics = text::of_matrix(&camera.matrix)
            .ok_or_else(|| RgbdError::fault(folder, format!("{CAMERAS}: image {number}: cam_K is no camera matrix")))?;
        scales.push(camera.depth_scale.unwrap_or(1.0));
        let at = truths.get(&number).and_then(|all| all.iter().position(|pose| Some(pose.obj_id) == object));
        let of_object = at.and_then(|at| mask_of(&visible, number, at));
        frames.push(FrameFiles {
            mask: of_object.or_else(|| own.get(&name).cloned()),
            name: name.text,
            time_s,
            color: Some(color),
            depth,
            intrinsics,
            world_from_camera: match (camera.rotation, camera.translation) {
                (Some(rotation), Some(translation)) => Some(text::from_opencv(motion(rotation, translation).inverse())),
                _ => None,
            },
            camera_from_object: at
                .and_then(|at| truths.get(&number)?.get(at))
                .map(|pose| text::to_opencv(motion(pose.rotation, pose.translation))),
        });
    }
    scales.dedup();
    let &[scale] = scales.as_slice() else {
        return Err(RgbdError::fault(
            folder,
            format!("{CAMERAS}: {} values of depth_scale; one is expected", scales.len()),
        ));
    };
    let unit_m = description.depth_unit_m.unwrap_or(1e-3 * scale);
    let object_name = object.map(|id| format!("obj_{id:06}"));
    Ok(Parts { frames, code: DepthCode::Levels { unit_m }, object: None, notes, object_name })
}

fn json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, RgbdError> {
    serde_json::from_str(&text::read(path)?).map_err(|error| RgbdError::fault(path, error.to_string()))
}

/// The object that is followed: the one of the description, or the only one.
fn choose(
    folder: &Path,
    description: &Description,
    truths: &BTreeMap<u64, Vec<ObjectPose>>,
) -> Result<Option<u32>, RgbdError> {
    let mut known: Vec<u32> = truths.values().flatten().map(|pose| pose.obj_id).collect();
    known.sort_unstable();
    known.dedup();
    match (description.object, known.as_slice()) {
        (Some(id), _) if known.contains(&id) || known.is_empty() => Ok(Some(id)),
        (None, []) => Ok(None),
        (None, [only]) => Ok(Some(*only)),
        (asked, _) => {
            let names: Vec<String> = known.iter().map(u32::to_string).collect();
            let asked = asked.map_or(String::new(), |id| format!(" (object = {id} is none of them)"));
            let fault = format!(
                "the scene shows the objects {}{asked}: choose one by `object = ID` in {}",
                names.join(", "),
                description::FILE
            );
            Err(RgbdError::fault(folder, fault))
        }
    }
}

/// The visible mask of the object with this place in the list of an image: `IMAGE_PLACE.png`.
fn mask_of(masks: &NamedFiles, image: u64, place: usize) -> Option<std::path::PathBuf> {
    let is_it = |text: &str| {
        let (a, b) = text.split_once('_')?;
        Some(a.parse::<u64>().ok()? == image && b.parse::<usize>().ok()? == place)
    };
    masks.iter().find(|(name, _)| is_it(&name.text) == Some(true)).map(|(_, path)| path.clone())
}

fn motion(rotation: [f64; 9], translation_mm: [f64; 3]) -> na::Isometry3<f64> {
    let rotation = na::UnitQuaternion::from_matrix(&na::Matrix3::from_row_slice(&rotation));
    na::Isometry3::from_parts((1e-3 * na::Vector3::from(translation_mm)).into(), rotation)
}
