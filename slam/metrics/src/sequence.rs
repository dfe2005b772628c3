//! Scores of a tracked sequence by the protocol of YCBInEOAT and HO3D.

use mvt_frames::{Camera, Isometry, Model, Object};
use mvt_mesh::Mesh;
use serde::{Deserialize, Serialize};

use crate::sample::sample_surface;
use crate::surface::TrueSurface;

/// Errors up to this count for the area under the curve, metres.
const AUC_M: f64 = 0.10;
/// A certified pose with a larger ADD is wrong, metres.
const WRONG_M: f64 = 0.020;
/// A certified pose that is turned by more is wrong, radians.
const WRONG_RAD: f64 = 20.0 * std::f64::consts::PI / 180.0;
/// Threshold of the F-score of the mesh, metres.
const F_SCORE_M: f64 = 0.005;
/// Points of the object for ADD and ADD-S.
const ADD_POINTS: usize = 1000;
/// Points of each mesh for the distances between them.
const MESH_POINTS: usize = 20_000;

/// A frame of a tracked sequence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackedFrame {
    /// True pose of the object; without it the frame is not scored.
    pub truth: Option<Isometry<Object, Camera>>,
    /// Estimated pose of the model; `None` where it is not certified.
    pub estimate: Option<Isometry<Model, Camera>>,
}

/// True object with which tracked sequences are scored. It is made once per object.
#[derive(Debug)]
pub struct SequenceJudge {
    add: TrueSurface,
    mesh: TrueSurface,
    is_symmetric: bool,
}

/// Scores of a tracked sequence. The estimated motion since the first certified frame is applied to the true pose of that frame; frames that are
/// not certified hold the last pose, and before the first certified frame the first true pose. All frames with a true pose count.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct SequenceScore {
    /// Frames with a true pose.
    pub scored_frames: usize,
    /// Number of the first frame that is certified and has a true pose, from 0; null without one.
    pub first_frame: Option<usize>,
    /// Area under the curve of the share of frames below an ADD, 0 to 10 cm, percent.
    pub add_auc: f64,
    /// The same of ADD-S.
    pub add_s_auc: f64,
    /// Mean ADD, mm.
    pub add_mm: f64,
    /// Mean ADD-S, mm.
    pub add_s_mm: f64,
    /// Mean of both mean distances between the estimated and the true mesh, mm; null without a mesh.
    pub chamfer_mm: Option<f64>,
    /// F-score of the mesh at 5 mm, 0 to 1; null without a mesh.
    pub f5: Option<f64>,
    /// Share of the frames, percent, that are certified although ADD is above 20 mm or the rotation off by more than 20 degrees; of a symmetric
    /// object although ADD-S is above 20 mm.
    pub wrong: f64,
    /// Share of the frames, percent, that are not certified.
    pub abstained: f64,
}

impl SequenceJudge {
    /// Takes the mesh of an object in the object's frame. The rotation of a symmetric object does not decide whether a pose is wrong.
    pub fn new(mesh: &Mesh, is_symmetric: bool) -> Self {
        let surface = |points: usize| TrueSurface::of_points(sample_surface(mesh, points, 0));
        Self { add: surface(ADD_POINTS), mesh: surface(MESH_POINTS), is_symmetric }
    }

    /// Scores a sequence with the estimated mesh, in the model's frame; `None` if no frame has a true pose.
    pub fn score(&self, frames: &[TrackedFrame], mesh: Option<&Mesh>) -> Option<SequenceScore> {
        let first_truth = frames.iter().find_map(|frame| frame.truth)?;
        let tie = frames.iter().enumerate().find_map(|(k, frame)| Some((k, frame.truth?, frame.estimate?)));
        let object_from_model = tie.map(|(_, truth, estimate)| truth.inverse() * estimate);
        let model_from_object = object_from_model.map(Isometry::inverse);
        let mut held = first_truth;
        let (mut count, mut certified) = (0usize, 0usize);
        let (mut wrong, mut add, mut add_s) = (0usize, Sum::default(), Sum::default());
        for frame in frames {
            if let Some((estimate, model_from_object)) = frame.estimate.zip(model_from_object) {
                held = estimate * model_from_object;
            }
            let Some(truth) = frame.truth else { continue };
            let off = truth.inverse() * held;
            // From the true points to the nearest estimated ones, as the tools of YCB do.
            let (add_m, add_s_m) = (self.add.add_m(off), self.add.add_s(off.inverse()).one_directional_m);
            let is_off = match self.is_symmetric {
                true => add_s_m > WRONG_M,
                false => add_m > WRONG_M || off.untyped().rotation.angle() > WRONG_RAD,
            };
            count += 1;
            certified += usize::from(frame.estimate.is_some());
            wrong += usize::from(frame.estimate.is_some() && is_off);
            add.push(add_m);
            add_s.push(add_s_m);
        }
        let per_frame = 1.0 / count.max(1) as f64;
        let percent = |part: usize| 100.0 * part as f64 * per_frame;
        let shape = mesh.zip(object_from_model).map(|(mesh, object_from_model)| {
            let points = sample_surface(mesh, MESH_POINTS, 1);
            self.mesh.score(&points, object_from_model, &[F_SCORE_M])
        });
        Some(SequenceScore {
            scored_frames: count,
            first_frame: tie.map(|(k, ..)| k),
            add_auc: 100.0 * add.under_curve * per_frame,
            add_s_auc: 100.0 * add_s.under_curve * per_frame,
            add_mm: 1e3 * add.total_m * per_frame,
            add_s_mm: 1e3 * add_s.total_m * per_frame,
            chamfer_mm: shape.as_ref().map(|shape| 500.0 * (shape.mesh_error_m + shape.completeness_m)),
            f5: shape.as_ref().and_then(|shape| Some(shape.f_scores.first()?.f())),
            wrong: percent(wrong),
            abstained: percent(count - certified),
        })
    }
}

/// Sum of errors and of their parts of the area under the curve.
#[derive(Default)]
struct Sum {
    total_m: f64,
    under_curve: f64,
}

impl Sum {
    fn push(&mut self, error_m: f64) {
        self.total_m += error_m;
        // The share of thresholds up to the largest that the error is below.
        self.under_curve += (1.0 - error_m / AUC_M).max(0.0);
    }
}

#[cfg(test)]
mod tests {
    use mvt_frames::glam::Vec3;
    use mvt_frames::nalgebra as na;

    use super::*;

    /// A square plate of 0.2 m in the plane z = 0.
    fn plate() -> Mesh {
        let vertices =
            [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| Vec3::new(0.1 * x, 0.1 * y, 0.0));
        Mesh { vertices: vertices.to_vec(), faces: vec![[0, 1, 2], [0, 2, 3]] }
    }

    fn truth(k: usize) -> Isometry<Object, Camera> {
        Isometry::translation(0.01 * k as f64, 0.0, -0.6)
    }

    /// The model is displaced from the object: only motions count.
    fn estimate(k: usize, off: Isometry<Object, Object>) -> Isometry<Model, Camera> {
        truth(k) * off * Isometry::<Model, Object>::translation(0.03, -0.02, 0.01)
    }

    fn frame(k: usize, off: Option<Isometry<Object, Object>>) -> TrackedFrame {
        TrackedFrame { truth: Some(truth(k)), estimate: off.map(|off| estimate(k, off)) }
    }

    fn near(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-4 * expected.abs().max(1.0), "{found} and not {expected}");
    }

    #[test]
    fn a_perfect_track_has_all_of_the_area() {
        let frames: Vec<TrackedFrame> = (0..5).map(|k| frame(k, Some(Isometry::identity()))).collect();
        let judge = SequenceJudge::new(&plate(), false);
        let score = judge.score(&frames, None).unwrap();
        near(score.add_auc, 100.0);
        near(score.add_s_auc, 100.0);
        assert_eq!((score.wrong, score.abstained, score.first_frame, score.f5), (0.0, 0.0, Some(0), None));
        assert!(judge.score(&[TrackedFrame { truth: None, estimate: None }], None).is_none());
    }

    #[test]
    fn a_displacement_along_the_normal_is_the_error_of_every_point() {
        // Both errors are 30 mm in the second of two frames: above 20 mm, and 70 % of the area.
        let frames = [frame(0, Some(Isometry::identity())), frame(1, Some(Isometry::translation(0.0, 0.0, 0.03)))];
        let score = SequenceJudge::new(&plate(), false).score(&frames, None).unwrap();
        near(score.add_auc, 85.0);
        near(score.add_s_auc, 85.0);
        near(score.add_mm, 15.0);
        assert_eq!((score.wrong, score.abstained), (50.0, 0.0));
    }

    #[test]
    fn frames_that_are_not_certified_hold_the_last_pose() {
        // The object moves by 10 mm a frame: frame 2 is 10 mm and frame 3 is 20 mm behind.
        let same = Some(Isometry::identity());
        let frames = [frame(0, same), frame(1, same), frame(2, None), frame(3, None)];
        let score = SequenceJudge::new(&plate(), false).score(&frames, None).unwrap();
        near(score.add_auc, 100.0 * (1.0 + 1.0 + 0.9 + 0.8) / 4.0);
        assert_eq!((score.wrong, score.abstained), (0.0, 50.0));
        // Before the first certified frame, which ties the model, the first true pose is held.
        let late = SequenceJudge::new(&plate(), false).score(&[frame(0, None), frame(1, None), frame(2, same)], None);
        let late = late.unwrap();
        near(late.add_mm, 10.0 / 3.0);
        assert_eq!(late.first_frame, Some(2));
        // Frames without a true pose do not count, but their estimates are held.
        let blind = TrackedFrame { truth: None, estimate: Some(estimate(1, Isometry::identity())) };
        let score = SequenceJudge::new(&plate(), false).score(&[frame(0, same), blind, frame(2, None)], None).unwrap();
        near(score.add_mm, 5.0);
        assert_eq!(score.scored_frames, 2);
    }

    #[test]
    fn half_a_turn_is_wrong_except_of_a_symmetric_object() {
        // In its plane: the mean distance from the middle of a square of side a is a (sqrt 2 + ln(1 + sqrt 2)) / 6.
        let turn = na::UnitQuaternion::from_axis_angle(&na::Vector3::z_axis(), std::f64::consts::PI);
        let turn = Isometry::new(na::Isometry3::from_parts(na::Translation3::identity(), turn));
        let frames = [frame(0, Some(Isometry::identity())), frame(1, Some(turn))];
        let score = SequenceJudge::new(&plate(), false).score(&frames, None).unwrap();
        let middle_m = 0.2 * (2f64.sqrt() + (1.0 + 2f64.sqrt()).ln()) / 6.0;
        assert!((score.add_mm - 1e3 * middle_m).abs() < 2.0, "{score:?}");
        assert!(score.add_s_mm < 4.0 && score.wrong == 50.0, "{score:?}");
        assert_eq!(SequenceJudge::new(&plate(), true).score(&frames, None).unwrap().wrong, 0.0);
    }

    #[test]
    fn a_mesh_that_lies_beside_the_true_one_is_so_far_away() {
        let judge = SequenceJudge::new(&plate(), false);
        let frames = [frame(0, Some(Isometry::identity()))];
        // The frame ties the model 3 cm, -2 cm and 1 cm beside the object.
        let mut mesh = plate();
        let score = |mesh: &Mesh| judge.score(&frames, Some(mesh)).unwrap();
        for vertex in &mut mesh.vertices {
            *vertex -= Vec3::new(0.03, -0.02, 0.01);
        }
        let same = score(&mesh);
        assert!(same.chamfer_mm.unwrap() < 1.0 && same.f5.unwrap() > 0.999, "{same:?}");
        for vertex in &mut mesh.vertices {
            vertex.z += 0.008;
        }
        let beside = score(&mesh);
        assert!((beside.chamfer_mm.unwrap() - 8.0).abs() < 0.1 && beside.f5 == Some(0.0), "{beside:?}");
    }
}
