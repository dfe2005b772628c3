//! Sequences of HO3D.

use std::path::Path;

use mvt_feelsight::pickle::{self, PickleValue};
use mvt_files::input;
use mvt_frames::Isometry;
use nalgebra as na;

use crate::description::Description;
use crate::error::RgbdError;
use crate::folders::{self, IMAGES};
use crate::parts::{FrameFiles, Parts};
use crate::pattern::{in_folder, paired};
use crate::pixels::DepthCode;
use crate::text;

/// Largest file of annotations, bytes.
const LARGEST_META: u64 = 16 << 20;

/// Returns whether a folder is such a sequence.
pub(crate) fn is_here(folder: &Path) -> bool {
    ["rgb", "depth", "meta"].iter().all(|name| folder.join(name).is_dir())
}

/// Finds the frames of a folder.
pub(crate) fn parts(folder: &Path, description: &Description) -> Result<Parts, RgbdError> {
    let metas = in_folder(&folder.join("meta"), &["pkl"])?;
    let names: Vec<_> = metas.keys().cloned().collect();
    let (colours, depths) = (in_folder(&folder.join("rgb"), &IMAGES)?, in_folder(&folder.join("depth"), &["png"])?);
    let masks = folders::masks(folder, description)?;
    let (colours, depths, masks) = (paired(&names, &colours), paired(&names, &depths), paired(&names, &masks));
    let mut notes = Vec::new();
    let times_s = folders::times_s(&names, description.frame_hz, &mut notes);
    let (mut frames, mut object_name) = (Vec::new(), None);
    for (k, (name, path)) in metas.iter().enumerate() {
        let (Some(color), Some(depth)) = (colours[k], depths[k]) else { continue };
        let bytes = input::read(path, LARGEST_META).map_err(RgbdError::io(path))?;
        let meta = pickle::from_bytes(&bytes).map_err(|error| RgbdError::fault(path, error.to_string()))?;
        let numbers = |key: &str| meta.get(key).and_then(PickleValue::to_tensor).map(|(_, numbers)| numbers);
        let intrinsics = match description.intrinsics {
            Some(intrinsics) => intrinsics,
            None => numbers("camMat")
                .and_then(|matrix| text::of_matrix(&matrix))
                .ok_or_else(|| RgbdError::fault(path, "camMat is no camera matrix; is it a file of HO3D?"))?,
        };
        // The cameras of HO3D have OpenGL axes, as ours.
        let camera_from_object = match (numbers("objTrans").as_deref(), numbers("objRot").as_deref()) {
            (Some(&[x, y, z]), Some(&[a, b, c])) => {
                let rotation = na::UnitQuaternion::from_scaled_axis(na::Vector3::new(a, b, c));
                Some(Isometry::new(na::Isometry3::from_parts(na::Translation3::new(x, y, z), rotation)))
            }
            _ => None,
        };
        object_name = object_name.or_else(|| meta.get("objName").and_then(PickleValue::as_str).map(str::to_owned));
        frames.push(FrameFiles {
            name: name.text.clone(),
            time_s: times_s[k],
            color: Some(color.clone()),
            depth: depth.clone(),
            mask: masks[k].cloned(),
            intrinsics,
            world_from_camera: None,
            camera_from_object,
        });
    }
    Ok(Parts { frames, code: DepthCode::Ho3d, object: description.object, notes, object_name })
}
