//! Rendered touch images of random presses with their true indentation and contact: what touch networks are trained and judged on.

mod backdrop;
mod example;
pub mod objects;
mod sensors;

pub use example::{DataConfig, Example, example};
pub use sensors::Rack;
