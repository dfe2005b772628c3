//! Networks that turn touch images into indentation and contact.

pub mod accuracy;
pub mod contact;
pub mod engine;
pub mod network;
#[cfg(feature = "train")]
pub mod train;
pub mod untouched;
