//! Objects that a hand can turn: the YCB catalogue, procedural shapes, exact distances and convex pieces.

pub mod assets;
pub mod catalogue;
pub mod decompose;
pub mod distance;
pub mod object;
pub mod procedural;
pub mod stand;

pub use distance::MeshDistance;
pub use object::Object;
