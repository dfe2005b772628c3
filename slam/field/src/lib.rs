//! Signed-distance fields: one that learns from samples, one that is given, and meshes of either.

pub mod exact;
pub mod field;
pub mod shape;
pub mod surface;
pub mod tensors;
