//! The neural signed-distance field.
