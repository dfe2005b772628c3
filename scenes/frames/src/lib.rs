//! Coordinate frames as types, rigid motions, pinhole cameras and depth images: the vocabulary of every other crate.
//!
//! A pose is an [`Isometry<From, To>`]. It takes coordinates in frame `From` to coordinates in frame `To`, so the pose
//! of the object in the world is an `Isometry<Object, World>`. The compiler accepts a product of poses only if the
//! inner frames agree:
//!
//! ```
//! use mvt_frames::{Camera, Isometry, Object, Point, World};
//! let world_from_camera = Isometry::<Camera, World>::translation(0.0, 0.0, 0.3);
//! let world_from_object = Isometry::<Object, World>::identity();
//! let camera_from_object: Isometry<Object, Camera> = world_from_camera.inverse() * world_from_object;
//! let p: Point<Camera> = camera_from_object * Point::new(0.0, 0.0, 0.0);
//! assert_eq!(p.coords().z, -0.3);
//! ```
//!
//! Lengths are metres and all frames are right-handed. Poses are `f64`; [`Isometry::to_f32`] converts them for ray
//! casting. The frames are a closed set, and camera models have no lens distortion.

pub mod camera;
pub mod depth;
mod frame;
mod occupied;
pub mod se3;

pub use frame::*;
pub use occupied::Occupied;
pub use {glam, image, nalgebra, ndarray};
