//! Pictures of a recording: the scene in three dimensions and what the sensors showed.

pub mod colours;
pub mod eye;
mod observed;
pub mod raster;
pub mod scene;

pub use colours::Theme;
pub use eye::{Eye, Preset};
pub use scene::{Clouds, Colouring, Keyframes, Layers, Scene};
