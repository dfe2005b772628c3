//! Pictures on the CPU: triangles with a depth buffer, text, colours, curves and films.
//!
//! Everything is drawn into [`image::RgbImage`] without a graphics driver, so that pictures are the same on every
//! machine and for any number of threads. The crate knows meshes and pinhole cameras, but no robot, no run and no
//! window. It does not read pictures either.
//!
//! ```
//! use mvt_picture::glam::Vec3A;
//! use mvt_picture::palette::Theme;
//! use mvt_picture::raster::Rasteriser;
//! use mvt_picture::{mvt_frames::camera::Intrinsics, text};
//!
//! let camera = Intrinsics::from_fov_y(160, 120, 0.6);
//! let mut raster = Rasteriser::default();
//! raster.begin(&camera, Theme::LIGHT.paper);
//! // The camera looks along -z (OpenGL axes); colours are numbers from 0 to 255.
//! let triangle = [Vec3A::new(-0.1, -0.1, -0.5), Vec3A::new(0.1, -0.1, -0.5), Vec3A::new(0.0, 0.1, -0.5)];
//! raster.flat(triangle, [Vec3A::new(200.0, 60.0, 30.0); 3], false);
//! let mut picture = raster.finish(0.5).clone();
//! text::write(&mut picture, (4, 4), 14.0, Theme::LIGHT.ink, "a triangle");
//! assert_eq!(picture.get_pixel(80, 60).0, [200, 60, 30]);
//! ```

pub mod chart;
pub mod contact_sheet;
pub mod cut_plane;
pub mod draw;
pub mod film;
pub mod occlusion;
pub mod palette;
pub mod raster;
pub mod text;

pub use {gif, glam, image, mvt_frames, mvt_mesh};
