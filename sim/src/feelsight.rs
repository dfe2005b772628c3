//! FeelSight logs.
pub mod array;
pub mod pickle;
