//! Scores: ADD-S of a pose, F-score of a shape, and how the errors of a run are summed up.
//!
//! Each score exists as NeuralFeels (Suresh et al., Science Robotics 2024) defines it, so that numbers compare, and in a form without
//! its allowances: every frame counts, both directions count, and a shape that is nowhere near the true one scores 0.
//!
//! ```
//! use glam::Vec3;
//! use mvt_frames::{Isometry, Object};
//! use mvt_mesh::Mesh;
//! use slam::metrics::{POINTS, THRESHOLDS_M, TrueSurface, sample_surface};
//!
//! let triangle = Mesh { vertices: vec![Vec3::ZERO, 0.1 * Vec3::X, 0.1 * Vec3::Y], faces: vec![[0, 1, 2]] };
//! let truth = TrueSurface::new(&triangle, POINTS, 0);
//! // The estimate lies 3 mm beside the truth.
//! let truth_from_estimate = Isometry::<Object, Object>::translation(0.0, 0.0, 0.003);
//! assert!((truth.add_s(truth_from_estimate).one_directional_m - 0.003).abs() < 1e-6);
//! let score = truth.score(&sample_surface(&triangle, POINTS, 1), truth_from_estimate, &THRESHOLDS_M);
//! assert_eq!(score.f_scores[0].f(), 0.0, "at 1 mm");
//! assert!(score.f_scores[2].f() > 0.999, "at 5 mm");
//! ```

mod cloud;
mod run;
mod sample;
mod surface;

pub use run::{FAILURE_M, GRACE_S, OUTLIER_M, PoseStatistics, mean_original};
pub use sample::{sample_surface, sample_surface_even};
pub use surface::{AddS, FScore, ShapeScore, TrueSurface};

/// How many points stand for a surface in NeuralFeels. On an object of 600 cm^2 they are 2.5 mm apart, so that a perfect shape misses
/// a tenth of them at 2 mm and half of them at 1 mm: see [`FINE_POINTS`].
pub const POINTS: usize = 10_000;

/// So many points that a perfect shape scores at least 0.98 at 1 mm on all that a hand can hold.
pub const FINE_POINTS: usize = 100_000;

/// The thresholds of our tables, metres.
pub const THRESHOLDS_M: [f64; 4] = [0.001, 0.002, 0.005, 0.010];

/// NeuralFeels' thresholds, metres; its headline is the one at 5 mm.
pub const ORIGINAL_THRESHOLDS_M: [f64; 15] =
    [0.020, 0.018, 0.016, 0.014, 0.012, 0.010, 0.009, 0.008, 0.007, 0.006, 0.005, 0.004, 0.003, 0.002, 0.001];
