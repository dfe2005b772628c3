//! Signed-distance fields of objects: a neural one that learns online, a given one, and meshes of either.
//!
//! [`field::NeuralField`] is a dense grid of features with a small network. It learns from samples of distance, two cores suffice for thousands
//! of samples per frame, and results do not depend on the number of threads. [`exact::KnownShape`] samples a shape that is known. Both answer
//! distances and gradients in batches ([`shape::Shape`]), and [`surface`] meshes them. There is no GPU path.
//!
//! ```
//! use mvt_field::field::{FieldTrainer, NeuralField, Sample};
//! use mvt_field::glam::Vec3;
//! use mvt_field::shape::Shape as _;
//!
//! // Learns a ball of 3 cm from random samples of its distance.
//! let field = NeuralField::new(&Default::default(), 1)?;
//! let truncation_m = field.config().truncation_m;
//! let mut trainer = FieldTrainer::new(field);
//! let mut state = 1_u32;
//! let mut random = || {
//!     state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
//!     (state >> 8) as f32 / (1 << 24) as f32 - 0.5
//! };
//! for _ in 0..200 {
//!     let samples: Vec<Sample> = (0..500)
//!         .map(|_| {
//!             let position = Vec3::new(random(), random(), random()) * 0.1;
//!             let target = ((position.length() - 0.03) / truncation_m).clamp(-1.0, 1.0);
//!             Sample { position, target, weight: 1.0, at_least: false }
//!         })
//!         .collect();
//!     trainer.step(&samples);
//! }
//! let mut distance_m = [0.0];
//! trainer.field().distances(&[Vec3::X * 0.031], &mut distance_m);
//! assert!((distance_m[0] - 0.001).abs() < 0.001, "{distance_m:?}");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod exact;
pub mod field;
pub mod shape;
pub mod surface;
pub mod tensors;

pub use glam;
