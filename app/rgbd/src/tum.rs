//! Sequences of the TUM RGB-D benchmark: lists of stamps and files, and the camera's trajectory.

use std::path::{Path, PathBuf};

use nalgebra as na;

use crate::description::Description;
use crate::error::RgbdError;
use crate::folders;
use crate::parts::{FrameFiles, Parts};
use crate::pattern::{FrameName, paired};
use crate::pixels::DepthCode;
use crate::text;

/// Metres per level of depth.
const UNIT_M: f64 = 1.0 / 5000.0;
/// Colours, depth and poses that are farther apart belong to different instants, seconds. The benchmark's own tool takes the same.
const MOST_APART_S: f64 = 0.02;
/// fx, fy, cx, cy of the Kinect as ROS has them: the benchmark asks for these where depth is registered to colours.
const KINECT: [f64; 4] = [525.0, 525.0, 319.5, 239.5];

/// Returns whether a folder is such a sequence.
pub(crate) fn is_here(folder: &Path) -> bool {
    ["rgb.txt", "depth.txt"].iter().all(|name| folder.join(name).is_file())
}

/// Finds the frames of a folder.
pub(crate) fn parts(folder: &Path, description: &Description) -> Result<Parts, RgbdError> {
    let (colours, depths) = (lines(&folder.join("rgb.txt"))?, lines(&folder.join("depth.txt"))?);
    let trajectory = folder.join("groundtruth.txt");
    let trajectory = if trajectory.exists() { poses(&trajectory)? } else { Vec::new() };
    let mut notes = Vec::new();
    let intrinsics = description.intrinsics_or_cam_k(folder)?.unwrap_or_else(|| {
        notes.push("there is no cam_K.txt: the intrinsics of the benchmark's registered Kinect are assumed".to_owned());
        KINECT
    });
    let masks = folders::masks(folder, description)?;
    let mut frames = Vec::new();
    for (time_s, color) in &colours {
        let Some((_, depth)) = nearest(&depths, *time_s) else { continue };
        let pose = nearest(&trajectory, *time_s).map(|(_, pose)| text::from_opencv(*pose));
        if !trajectory.is_empty() && pose.is_none() {
            continue;
        }
        let name =
            |path: &str| FrameName::new(Path::new(path).file_stem().and_then(|stem| stem.to_str()).unwrap_or_default());
        let mask = [color, depth].into_iter().find_map(|path| masks.get(&name(path)).cloned());
        frames.push(FrameFiles {
            name: name(color).text,
            time_s: *time_s,
            color: Some(folder.join(color)),
            depth: folder.join(depth),
            mask,
            intrinsics,
            world_from_camera: pose,
            camera_from_object: None,
        });
    }
    if masks.len() == frames.len() && frames.iter().all(|frame| frame.mask.is_none()) {
        let names: Vec<FrameName> = frames.iter().map(|frame| FrameName::new(&frame.name)).collect();
        let found: Vec<Option<PathBuf>> = paired(&names, &masks).into_iter().map(Option::<&PathBuf>::cloned).collect();
        frames.iter_mut().zip(found).for_each(|(frame, mask)| frame.mask = mask);
    }
    if frames.len() < colours.len() {
        notes.push(format!(
            "{} of {} colour images have depth and a pose within {MOST_APART_S} s; the others are left out",
            frames.len(),
            colours.len()
        ));
    }
    let code = DepthCode::Levels { unit_m: description.depth_unit_m.unwrap_or(UNIT_M) };
    Ok(Parts { frames, code, object: description.object, notes, object_name: None })
}

fn nearest<T>(list: &[(f64, T)], time_s: f64) -> Option<&(f64, T)> {
    let at = list.partition_point(|(other_s, _)| *other_s < time_s);
    let around = list.get(at.saturating_sub(1)..(at + 1).min(list.len()))?;
    let apart_s = |entry: &&(f64, T)| (entry.0 - time_s).abs();
    around.iter().min_by(|a, b| apart_s(a).total_cmp(&apart_s(b))).filter(|entry| apart_s(entry) <= MOST_APART_S)
}

/// Reads lines of a stamp and what follows it, without comments, in the order of their stamps.
fn lines(path: &Path) -> Result<Vec<(f64, String)>, RgbdError> {
    let mut lines = Vec::new();
    for (number, line) in text::read(path)?.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let parts = line
            .split_once(char::is_whitespace)
            .and_then(|(stamp, rest)| Some((stamp.parse::<f64>().ok()?, rest.trim().to_owned())));
        match parts.filter(|(time_s, _)| time_s.is_finite()) {
            Some(parts) => lines.push(parts),
            None => {
                return Err(RgbdError::fault(
                    path,
                    format!("line {}: a stamp in seconds and more is expected", number + 1),
                ));
            }
        }
    }
    lines.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(lines)
}

/// Reads a trajectory: stamp, tx ty tz, qx qy qz qw.
fn poses(path: &Path) -> Result<Vec<(f64, na::Isometry3<f64>)>, RgbdError> {
    let pose = |(time_s, rest): (f64, String)| {
        let numbers: Option<Vec<f64>> =
            rest.split_whitespace().map(|word| word.parse().ok().filter(|n: &f64| n.is_finite())).collect();
        let Some(&[x, y, z, qx, qy, qz, qw]) = numbers.as_deref() else {
            return Err(RgbdError::fault(path, format!("{time_s}: a pose is tx ty tz qx qy qz qw")));
        };
        let rotation = na::UnitQuaternion::try_new(na::Quaternion::new(qw, qx, qy, qz), 1e-6)
            .ok_or_else(|| RgbdError::fault(path, format!("{time_s}: the quaternion is 0")))?;
        Ok((time_s, na::Isometry3::from_parts(na::Translation3::new(x, y, z), rotation)))
    };
    lines(path)?.into_iter().map(pose).collect()
}
