//! Scores of estimated poses and shapes: ADD-S of a pose, F-score of a shape, and statistics of the pose errors of a run.
//!
//! Each score exists as NeuralFeels (Suresh et al., Science Robotics 2024) defines it, so that numbers can be compared, and in a stricter
//! form: every frame counts, both directions count, and a shape that is nowhere near the true one scores 0. The crate compares points with
//! points. It does not align the estimate with the truth, does not read files, and does not know how an estimate was made.
//!
//! A sphere that is compared with itself scores nearly 1, and a sphere of another radius scores less:
//!
//! ```
//! use mvt_metrics::glam::Vec3;
//! use mvt_metrics::{THRESHOLDS_M, TrueSurface};
//! use mvt_frames::{Isometry, Object};
//!
//! /// Evenly spaced points on a sphere about the origin (a Fibonacci spiral).
//! fn sphere(radius_m: f32, count: usize) -> Vec<Vec3> {
//!     let point = |k: usize| {
//!         let z = 1.0 - (2 * k + 1) as f32 / count as f32;
//!         let (sin, cos) = (2.399_963 * k as f32).sin_cos();
//!         radius_m * Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
//!     };
//!     (0..count).map(point).collect()
//! }
//!
//! let truth = TrueSurface::of_points(sphere(0.030, 10_000));
//! let same = truth.score(&sphere(0.030, 9_000), Isometry::<Object, Object>::identity(), &THRESHOLDS_M);
//! assert!(same.f_scores[1].f() > 0.999, "at 2 mm");
//! let larger = truth.score(&sphere(0.034, 9_000), Isometry::<Object, Object>::identity(), &THRESHOLDS_M);
//! assert_eq!(larger.f_scores[1].f(), 0.0, "at 2 mm: every point is 4 mm off");
//! assert!(larger.f_scores[2].f() > 0.999, "at 5 mm");
//!
//! // The pose is 3 mm off along z. Points at the poles are 3 mm off, points at the equator less.
//! let truth_from_estimate = Isometry::<Object, Object>::translation(0.0, 0.0, 0.003);
//! let error = truth.add_s(truth_from_estimate);
//! assert!((0.0010..0.0030).contains(&error.one_directional_m));
//! ```

mod cloud;
mod run;
mod sample;
mod sequence;
mod surface;

pub use glam;

pub use run::{FAILURE_M, GRACE_S, OUTLIER_M, PoseStatistics, mean_original};
pub use sample::{sample_surface, sample_surface_even};
pub use sequence::{SequenceJudge, SequenceScore, TrackedFrame};
pub use surface::{AddS, FScore, ShapeScore, TrueSurface};

// Why: notes/decisions/settings.md, "Metrics".
/// Number of points that represent a surface in NeuralFeels. On an object of 600 cm^2 they are 2.5 mm apart, so that a perfect shape
/// misses a tenth of them at 2 mm and half of them at 1 mm: see [`FINE_POINTS`].
pub const POINTS: usize = 10_000;

/// Number of points with which a perfect shape scores at least 0.98 at 1 mm, on every object that a hand can hold.
pub const FINE_POINTS: usize = 100_000;

/// Thresholds of our tables, metres.
pub const THRESHOLDS_M: [f64; 4] = [0.001, 0.002, 0.005, 0.010];

/// Thresholds of NeuralFeels, metres. Its main figure is at 5 mm.
pub const ORIGINAL_THRESHOLDS_M: [f64; 15] =
    [0.020, 0.018, 0.016, 0.014, 0.012, 0.010, 0.009, 0.008, 0.007, 0.006, 0.005, 0.004, 0.003, 0.002, 0.001];
