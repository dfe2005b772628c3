//! RGB-D sequences and bags of ROS 2 as folders of images that other programs read, too.

use std::path::Path;

use anyhow::{Context as _, Result};
use mvt_bag::Bag;
use mvt_rgbd::{RgbdFrame, RgbdLayout, RgbdWriter, WrittenFrame};
use mvt_run::source::RgbdSequence;
use serde::Serialize;

/// A sequence as it was imported.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ImportedSequence {
    /// Layout of the source.
    pub layout: &'static str,
    /// Frames.
    pub frames: usize,
    /// Frames with a mask of the object.
    pub masks: usize,
    /// Frames with a true pose of the object.
    pub object_poses: usize,
    /// Whether each frame has a pose of the camera.
    pub moves: bool,
    /// Omissions and assumptions, in sentences.
    pub notes: Vec<String>,
}

/// Returns whether a folder or file is a sequence: not an MCAP file of Foxglove's messages, which becomes a log of a hand.
pub fn is_sequence(source: &Path) -> bool {
    let holds_ros = || {
        Bag::open(source).is_ok_and(|bag| bag.topics().iter().any(|topic| topic.type_name.starts_with("sensor_msgs/")))
    };
    RgbdSequence::is_here(source) && (RgbdLayout::of(source).is_some() || holds_ros())
}

/// Writes a sequence as `rgb/ depth/ masks/ cam_K.txt rgbd.toml`, with `poses/` of a camera that moves and `annotated_poses/` of the object, into a folder
/// that does not exist or is empty. Images are pinhole images of the size of depth, without loss. `progress` receives the numbers of finished frames and of
/// all.
///
/// # Errors
/// If the sequence cannot be used, or the folder not be written.
pub fn import_sequence(source: &Path, out: &Path, mut progress: impl FnMut(usize, usize)) -> Result<ImportedSequence> {
    let mut sequence = RgbdSequence::open(source)?;
    let intrinsics = sequence.intrinsics().with_context(|| format!("{}: there are no frames", source.display()))?;
    let (count, times_s) = (sequence.len(), sequence.times_s());
    let poses = sequence.camera_poses();
    let moves = poses.iter().any(|pose| Some(pose) != poses.first());
    let first = sequence.frame(0)?;
    let writer = RgbdWriter::create_copy(out, &intrinsics, RgbdWriter::unit_of(&first.depth_m))?;
    let begun_s = times_s.first().copied().unwrap_or_default();
    let (mut masks, mut object_poses) = (0, 0);
    for (k, time_s) in times_s.iter().enumerate() {
        let RgbdFrame { color, depth_m, mask, world_from_camera, camera_from_object, .. } = sequence.frame(k)?;
        masks += usize::from(mask.is_some());
        object_poses += usize::from(camera_from_object.is_some());
        writer.push(&WrittenFrame {
            stamp_ns: ((time_s - begun_s) * 1e9).round() as u64,
            color: &color,
            depth_m: &depth_m,
            mask: mask.as_ref(),
            world_from_camera: moves.then_some(world_from_camera),
            camera_from_object,
        })?;
        progress(k + 1, count);
    }
    if let Some(name) = sequence.object_name() {
        writer.name_object(name)?;
    }
    let notes = sequence.notes().to_vec();
    Ok(ImportedSequence { layout: sequence.layout(), frames: count, masks, object_poses, moves, notes })
}
