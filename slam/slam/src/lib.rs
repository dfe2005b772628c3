//! Pose and shape of one object from depth images and touch, frame by frame.
//!
//! Input is a [`Measurement`](scan::Measurement) per instant: labelled depth images with the poses of their cameras, depth images of touch
//! sensors with their contact, and the poses of bodies that the object cannot occupy. All but one camera may be missing. [`Slam`] returns an
//! [`Estimate`] for each, and the surface in the same frame at any time. The shape is a neural signed-distance field that learns while the
//! object is tracked against it; with [`SlamBuilder::shape`] a known shape is tracked instead.
//!
//! ```
//! use mvt_frames::camera::Intrinsics;
//! use mvt_frames::depth::{CameraDepth, Label};
//! use mvt_frames::{Isometry, ndarray::Array2};
//! use mvt_slam::{SlamConfig, Slam, scan::Measurement};
//!
//! // A wall of 2 x 2 cm, 30 cm in front of a camera that looks down from the world's origin.
//! let intrinsics = Intrinsics::from_fov_y(64, 48, 0.2);
//! let is_object = |(v, u): (usize, usize)| (8..40).contains(&v) && (16..48).contains(&u);
//! let depth_m = Array2::from_shape_fn((48, 64), |p| if is_object(p) { 0.3 } else { 0.0 });
//! let labels = depth_m.mapv(|z| if z > 0.0 { Label::Object } else { Label::Background });
//! let view = CameraDepth { intrinsics, world_from_camera: Isometry::identity(), depth_m, labels, colour: None };
//!
//! let mut config = SlamConfig::default();
//! config.map.first_steps = 20;
//! let mut slam = Slam::builder().config(config).seed(1).build()?;
//! let estimate = slam.observe(&Measurement { time_s: 0.0, cameras: &[Some(view)], touch: &[], obstacles: &[] });
//! assert!(estimate.state.is_tracking());
//! let mesh = slam.mesh(0.002).expect("the object was seen");
//! println!("{} triangles at {:?}", mesh.faces.len(), estimate.pose);
//! # Ok::<(), mvt_slam::SettingError>(())
//! ```
//!
//! Nothing here knows of a simulator, of networks that see, of a hand, or of the true pose.

mod agreement;
mod config;
mod deviation;
mod earlier;
pub mod map;
mod obstacles;
pub mod scan;
mod slam;
pub mod space;
mod start;
pub mod tracker;

pub use config::{SlamConfig, TrustConfig};
pub use deviation::Deviation;
pub use mvt_settings::SettingError;
pub use obstacles::Obstacles;
pub use slam::{Estimate, Slam, SlamBuilder, Spent, TrackState};
pub use {glam, mvt_field, mvt_frames, mvt_mesh};

#[cfg(test)]
use scan::Measurement;
#[cfg(test)]
#[path = "../tests/synthetic/mod.rs"]
mod synthetic;
