//! Images of simulated sensors: pinhole cameras with depth noise, and DIGIT touch sensors that render like TACTO.
//!
//! The crate traces rays over rigid triangle meshes ([`rays`]), renders colour, depth and labels of a hand with an
//! object ([`camera`]), renders touch images with their true depth and contact ([`touch`]), and does both for all
//! sensors of a hand ([`observer`]). It needs no GPU and no physics: poses and joint angles come from the caller.
//! Nothing deforms except, on request, the gel. The same input gives the same bits on every machine and for any number
//! of threads.
//!
//! A ball of 10 mm radius that is pressed 1 mm deep into the middle of the gel:
//!
//! ```
//! use mvt_frames::Isometry;
//! use mvt_render::rays::RayMesh;
//! use mvt_render::tessellation::tessellate;
//! use mvt_render::touch::{TouchConfig, TouchFrame, TouchOptions, TouchRenderer};
//! use mvt_robot::digit::gel;
//! use mvt_robot::hand::{Primitive, UPRIGHT};
//!
//! let ball = Primitive::Ellipsoid { centre: [0.0; 3], semi: [0.010; 3], orientation_wxyz: UPRIGHT };
//! let ball = RayMesh::new(&tessellate(&ball, 64));
//! let renderer = TouchRenderer::new(&TouchOptions::new(TouchConfig::Fork))?;
//! let mut frame = TouchFrame::default();
//! let gel_from_ball = Isometry::translation(gel::APEX_M + 0.010 - 0.001, 0.0, 0.0);
//! renderer.render(&ball, gel_from_ball, None, &mut frame);
//!
//! // Row 160 and column 120 are in the middle of the image. Its untouched gel is 22 mm from the camera.
//! assert!((frame.depth_m()[(160, 120)] - 0.021).abs() < 1e-5);
//! assert!(frame.contact()[(160, 120)]);
//! assert_ne!(frame.calibrated(), &renderer.empty());
//! # Ok::<(), mvt_render::touch::TouchError>(())
//! ```

pub mod camera;
pub mod depth_noise;
pub mod observer;
pub mod rays;
pub mod tessellation;
pub mod touch;

pub use {glam, image, nalgebra, ndarray};
