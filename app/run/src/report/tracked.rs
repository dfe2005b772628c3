//! Scores of a run of an RGB-D sequence by the protocol of YCBInEOAT and HO3D.

use std::path::Path;

use mvt_frames::{Isometry, MeshFile, Object};
use mvt_mesh::Mesh;
use mvt_metrics::{SequenceJudge, SequenceScore, TrackedFrame};

use super::RunRecord;
use super::camera_poses::{FrameCamera, certified};
use crate::source::RgbdSequence;

/// Objects of which a turn about an axis, or by half a turn, leaves the shape as it is.
const SYMMETRIC: [&str; 9] = [
    "001_chips_can",
    "002_master_chef_can",
    "005_tomato_soup_can",
    "007_tuna_fish_can",
    "013_apple",
    "024_bowl",
    "036_wood_block",
    "056_tennis_ball",
    "061_foam_brick",
];

/// Returns whether ADD-S alone decides whether a pose of an object is wrong. `name` is that in the catalogue, or the path of a mesh.
pub fn is_symmetric(name: &str) -> bool {
    let stem = Path::new(name).file_stem().and_then(|stem| stem.to_str()).unwrap_or(name);
    [name, stem].iter().any(|name| SYMMETRIC.contains(name))
}

impl FrameCamera {
    /// Returns the first frames of a sequence with their true poses.
    pub fn of_sequence(
        sequence: &RgbdSequence,
        object_from_file: Isometry<MeshFile, Object>,
        count: usize,
    ) -> Vec<Self> {
        let names = sequence.names().into_iter().take(count);
        let poses = sequence.camera_poses().into_iter().zip(sequence.object_poses());
        let frame = |(name, (world_from_camera, pose)): (_, (_, Option<Isometry<MeshFile, _>>))| Self {
            name,
            world_from_camera,
            camera_from_object: pose.map(|pose| pose * object_from_file.inverse()),
        };
        names.zip(poses).map(frame).collect()
    }
}

/// Scores the certified poses and the mesh of a run of a sequence; `None` without a hand-free sequence or its true poses.
pub fn benchmark(run: &RunRecord, estimate: &Mesh, truth: &Mesh) -> Option<SequenceScore> {
    let frame = |(number, camera): (usize, &FrameCamera)| TrackedFrame {
        truth: camera.camera_from_object,
        estimate: certified(&run.frames, number)
            .map(|row| Isometry::new((camera.world_from_camera.inverse() * row.estimate).untyped())),
    };
    let frames: Vec<TrackedFrame> = run.cameras.iter().enumerate().map(frame).collect();
    if frames.iter().all(|frame| frame.truth.is_none()) {
        return None;
    }
    SequenceJudge::new(truth, is_symmetric(&run.object)).score(&frames, Some(estimate))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn symmetric_objects_are_known_by_name_and_by_path() {
        assert!(is_symmetric("024_bowl") && is_symmetric("meshes/024_bowl.obj"));
        assert!(!is_symmetric("006_mustard_bottle") && !is_symmetric("a/b.obj"));
    }
}
