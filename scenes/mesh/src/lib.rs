//! Triangle meshes: readers for OBJ, STL and PLY files, checks, and repair.
//!
//! [`read()`] returns a mesh with the coordinates of the file. [`repair()`] makes one closed outward surface in metres of
//! it, and reports every change as a [`MeshWarning`]. Damaged files give an error, never a panic, and a file header
//! never decides how much memory is used. [`encode_obj()`], [`encode_ply()`] and [`encode_glb()`] return the bytes of
//! a file. The crate keeps neither colours nor texture coordinates.
//!
//! ```
//! use mvt_mesh::{Finding, Format, read_bytes, repair};
//!
//! // A tetrahedron with legs of 50 mm, in millimetres.
//! let obj = b"v 0 0 0\nv 50 0 0\nv 0 50 0\nv 0 0 50\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
//! let (raw, _) = read_bytes(obj, Format::Obj, "tetrahedron.obj")?;
//! let (mesh, warnings) = repair(&raw, "tetrahedron.obj")?;
//! assert!(mesh.edges().watertight());
//! assert!((mesh.volume_m3() - 0.05_f64.powi(3) / 6.0).abs() < 1e-12);
//! assert!(matches!(warnings[0].finding, Finding::ScaledFromMillimetres { .. }));
//! # Ok::<(), mvt_mesh::MeshError>(())
//! ```

mod encode;
mod error;
mod glb;
mod limits;
mod mesh;
mod obj;
mod ply;
mod polygon;
mod read;
mod repair;
mod seams;
mod stl;
mod text;
mod units;
mod warning;

pub use encode::{VertexProperties, encode_obj, encode_ply};
pub use error::{Defect, MeshError};
pub use glb::encode_glb;
pub use limits::{MAX_EXTENT_M, MAX_FILE_BYTES, MILLIMETRES_ABOVE_M, MILLIMETRES_FROM, MIN_EXTENT_M};
pub use mesh::{EdgeCount, Mesh, SignedDistance, triangle_area_m2, weld};
pub use read::{Format, read, read_bytes};
pub use repair::{check, repair};
pub use units::split_unit;
pub use warning::{Finding, MeshWarning};
pub use {glam, mvt_frames, nalgebra};
