//! Folders of numbered images: `rgb/ depth/ masks/ cam_K.txt`, or as `rgbd.toml` names them.

use std::path::Path;

use crate::description::{self, Description};
use crate::error::RgbdError;
use crate::parts::{FrameFiles, Parts};
use crate::pattern::{FrameName, NamedFiles, in_folder, matching, paired};
use crate::pixels::DepthCode;
use crate::text;

/// Endings of images.
pub(crate) const IMAGES: [&str; 3] = ["png", "jpg", "jpeg"];
/// Folders of masks, the first that exists.
const MASKS: [&str; 4] = ["masks", "mask", "gt_mask", "seg"];
/// Frames per second of files that are numbered, if nobody says.
const FRAME_HZ: f64 = 30.0;

/// Finds the frames of a folder.
pub(crate) fn parts(folder: &Path, description: &Description) -> Result<Parts, RgbdError> {
    let color = files(folder, description.color.as_deref(), &["rgb", "color"], &IMAGES)?;
    let depth = files(folder, description.depth.as_deref(), &["depth"], &["png", "npy"])?;
    let masks = masks(folder, description)?;
    let intrinsics = description.intrinsics_or_cam_k(folder)?.ok_or_else(|| {
        let fault =
            format!("there is no cam_K.txt: write it, or `intrinsics = [fx, fy, cx, cy]` in {}", description::FILE);
        RgbdError::fault(folder, fault)
    })?;
    let truth = files(folder, description.object_poses.as_deref(), &["annotated_poses"], &["txt"])?;
    let motion = files(folder, description.camera_poses.as_deref(), &[], &["txt"])?;
    let mut notes = Vec::new();
    let names: Vec<FrameName> = depth.keys().cloned().collect();
    let (colours, masks) = (paired(&names, &color), paired(&names, &masks));
    let (truths, motions) = (paired(&names, &truth), paired(&names, &motion));
    let times_s = times_s(&names, description.frame_hz, &mut notes);
    let mut frames = Vec::new();
    let parts = names.iter().zip(depth.into_values()).zip(times_s).enumerate();
    for (k, ((name, depth), time_s)) in parts {
        let has_pose = motion.is_empty() || motions[k].is_some();
        if !has_pose || (colours[k].is_none() && !description.live) {
            continue;
        }
        let pose = |path: Option<&std::path::PathBuf>| path.map(|path| text::motion(path)).transpose();
        frames.push(FrameFiles {
            name: name.text.clone(),
            time_s,
            color: colours[k].cloned(),
            depth,
            mask: masks[k].cloned(),
            intrinsics,
            world_from_camera: pose(motions[k])?.map(text::from_opencv),
            camera_from_object: pose(truths[k])?.map(text::to_opencv),
        });
    }
    let (seen, count) = (frames.len(), names.len().max(color.len()));
    if seen < count {
        notes.push(format!(
            "{seen} of {count} frames have colours, depth and what else belongs to them; the others are left out"
        ));
    }
    let code = DepthCode::Levels { unit_m: description.depth_unit_m.unwrap_or(0.001) };
    let object_name = if truth.is_empty() { None } else { object_of_video(folder) };
    Ok(Parts { frames, code, object: description.object, notes, object_name })
}

/// Beginnings of the names of YCBInEOAT's videos, with the objects in them.
const VIDEOS: [(&str, &str); 5] = [
    ("bleach", "021_bleach_cleanser"),
    ("cracker_box", "003_cracker_box"),
    ("mustard", "006_mustard_bottle"),
    ("sugar_box", "004_sugar_box"),
    ("tomato_soup_can", "005_tomato_soup_can"),
];

/// Returns the object of a video of YCBInEOAT.
fn object_of_video(folder: &Path) -> Option<String> {
    let name = folder.file_name()?.to_str()?;
    VIDEOS.iter().find(|(begin, _)| name.starts_with(begin)).map(|(_, object)| (*object).to_owned())
}

/// The masks that a description names, or those of a usual folder.
pub(crate) fn masks(folder: &Path, description: &Description) -> Result<NamedFiles, RgbdError> {
    files(folder, description.masks.as_deref(), &MASKS, &IMAGES)
}

fn files(folder: &Path, pattern: Option<&str>, usual: &[&str], endings: &[&str]) -> Result<NamedFiles, RgbdError> {
    if let Some(pattern) = pattern {
        let found = matching(folder, pattern)?;
        if found.is_empty() {
            return Err(RgbdError::fault(folder, format!("no file fits the pattern {pattern:?}")));
        }
        return Ok(found);
    }
    match usual.iter().map(|name| folder.join(name)).find(|path| path.is_dir()) {
        Some(path) => in_folder(&path, endings),
        None => Ok(NamedFiles::new()),
    }
}

/// Times by the names of frames, seconds from the first: stamps in nanoseconds, microseconds or milliseconds, or numbers at a rate.
pub(crate) fn times_s(names: &[FrameName], frame_hz: Option<f64>, notes: &mut Vec<String>) -> Vec<f64> {
    let numbers: Option<Vec<u128>> = names.iter().map(FrameName::number).collect();
    let Some(numbers) = numbers else {
        return (0..names.len()).map(|k| k as f64 / frame_hz.unwrap_or(FRAME_HZ)).collect();
    };
    let first = numbers.first().copied().unwrap_or(0);
    // Stamps since 1970 have 19, 16 or 13 digits.
    let unit_s = match first {
        _ if frame_hz.is_some() => None,
        1_000_000_000_000_000_000.. => Some(1e-9),
        1_000_000_000_000_000.. => Some(1e-6),
        1_000_000_000_000.. => Some(1e-3),
        _ => None,
    };
    if unit_s.is_none() && frame_hz.is_none() {
        notes.push(format!(
            "{FRAME_HZ} frames per second are assumed; `frame_hz` in {} says otherwise",
            description::FILE
        ));
    }
    let per_number_s = unit_s.unwrap_or(1.0 / frame_hz.unwrap_or(FRAME_HZ));
    numbers.iter().map(|number| (number - first) as f64 * per_number_s).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_video_of_ycbineoat_shows_the_object_of_its_name() {
        let object = |name: &str| object_of_video(Path::new(name));
        assert_eq!(object("data/mustard_easy_00_02").as_deref(), Some("006_mustard_bottle"));
        assert_eq!(object("data/tomato_soup_can_yalehand0").as_deref(), Some("005_tomato_soup_can"));
        assert_eq!(object("data/other"), None);
    }

    #[test]
    fn numbers_count_at_a_rate_and_stamps_do_not() {
        let times = |names: &[&str], hz| {
            let mut notes = Vec::new();
            let names: Vec<FrameName> = names.iter().map(|name| FrameName::new(name)).collect();
            (times_s(&names, hz, &mut notes), notes.len())
        };
        assert_eq!(times(&["000010", "000011", "000014"], Some(10.0)), (vec![0.0, 0.1, 0.4], 0));
        let (found, notes) = times(&["0", "3"], None);
        assert!((found[1] - 0.1).abs() < 1e-12 && notes == 1);
        let (found, notes) = times(&["1581120424100262102", "1581120424134262102"], None);
        assert!((found[1] - 0.034).abs() < 1e-9 && notes == 0);
        assert_eq!(times(&["a", "b"], Some(2.0)).0, [0.0, 0.5]);
    }
}
