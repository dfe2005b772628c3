//! `score` of the poses of any program on an RGB-D sequence.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Result, bail};
use mvt_frames::{Isometry, Model};
use mvt_mesh::Mesh;
use mvt_metrics::{SequenceJudge, SequenceScore, TrackedFrame};
use mvt_objects::Object;
use mvt_rgbd::read_pose_in_camera;
use mvt_run::io::print_line;
use mvt_run::report::{FrameCamera, is_symmetric};
use mvt_run::source::RgbdSequence;
use serde::Serialize;

/// The printed result.
#[derive(Serialize)]
struct SequenceReport<'a> {
    sequence: String,
    truth: &'a str,
    frames: usize,
    #[serde(flatten)]
    score: SequenceScore,
}

/// Scores the poses in a folder, NAME.txt of each certified frame with 4 x 4 numbers from the model to a camera with OpenCV axes, and prints the result as JSON
/// or in words. `estimate` is the mesh in the coordinates of the model.
///
/// # Errors
/// If a file cannot be used, no pose belongs to a frame, or the sequence has no true poses.
pub fn score(path: &Path, poses: &Path, estimate: Option<&Mesh>, truth: &Object, json: bool) -> Result<()> {
    let sequence = RgbdSequence::open(path)?;
    let mut frames = Vec::new();
    for frame in FrameCamera::of_sequence(&sequence, truth.object_from_file, sequence.len()) {
        let file = poses.join(format!("{}.txt", frame.name));
        let estimate: Option<Isometry<Model, _>> = if file.exists() { Some(read_pose_in_camera(&file)?) } else { None };
        frames.push(TrackedFrame { truth: frame.camera_from_object, estimate });
    }
    if frames.iter().all(|frame| frame.estimate.is_none()) {
        let first = sequence.names().into_iter().next().unwrap_or_default();
        bail!(
            "--pose {}: it holds no pose of a frame of {}: name them as the frames, such as {first}.txt",
            poses.display(),
            path.display()
        );
    }
    let judge = SequenceJudge::new(&truth.mesh, is_symmetric(&truth.name));
    let Some(score) = judge.score(&frames, estimate) else {
        bail!(
            "{}: the sequence has no true poses: name them as `object_poses` in rgbd.toml, or record a topic",
            path.display()
        );
    };
    if json {
        let report =
            SequenceReport { sequence: path.display().to_string(), truth: &truth.name, frames: frames.len(), score };
        return print_line(&serde_json::to_string(&report)?);
    }
    print_line(&format!("{}, {}, {} frames\n{}", path.display(), truth.name, frames.len(), score_in_words(&score)))
}

/// Returns scores in lines.
pub fn score_in_words(score: &SequenceScore) -> String {
    let mut text = format!(
        "ADD    {:6.2} % of the area to 10 cm, mean {:.2} mm\nADD-S  {:6.2} % of the area to 10 cm, mean {:.2} mm",
        score.add_auc, score.add_mm, score.add_s_auc, score.add_s_mm
    );
    if let Some((chamfer_mm, f5)) = score.chamfer_mm.zip(score.f5) {
        let _ = write!(text, "\nmesh   Chamfer distance {chamfer_mm:.2} mm, F-score at 5 mm {f5:.3}");
    }
    let _ = write!(
        text,
        "\nof {} frames with truth {:.1} % are certified and wrong, {:.1} % are not certified",
        score.scored_frames, score.wrong, score.abstained
    );
    if let Some(first) = score.first_frame.filter(|first| *first > 0) {
        let _ = write!(
            text,
            "\nframe {first}, counted from 0, is the first that is certified and ties the model to the object"
        );
    }
    text
}
