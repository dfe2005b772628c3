//! Objects that a hand can turn: the YCB catalogue, procedural shapes, random ones without end, the user's mesh files,
//! exact distances and convex pieces.
//!
//! [`catalogue::load`] returns an [`Object`] by name or path. YCB meshes are downloaded once, through pip, and kept in
//! the user's cache; procedural objects need no download. The crate simulates and renders nothing.
//!
//! ```
//! use mvt_frames::Point;
//! use mvt_objects::catalogue;
//!
//! let mut warnings = Vec::new();
//! let cube = catalogue::load("cube70", &mut warnings)?;
//! assert_eq!(cube.extents_m().map(|side| (1e3 * side).round()), [70.0; 3]);
//! let exact = cube.exact.expect("procedural objects have an exact distance");
//! assert!((exact.distance_m(Point::new(0.045, 0.0, 0.0)) - 0.010).abs() < 1e-9);
//! # Ok::<(), catalogue::CatalogueError>(())
//! ```

pub mod assets;
pub mod catalogue;
pub mod decompose;
pub mod distance;
pub mod object;
mod procedural;
pub mod stand;

pub use distance::MeshDistance;
pub use object::Object;
pub use procedural::random;
pub use {glam, mvt_frames, mvt_mesh, mvt_pinned, nalgebra};
