//! Pictures of a recording: the scene in three dimensions and what the sensors showed.

#![allow(dead_code, reason = "the window, which comes next, needs the rest")]

pub mod colours;
mod curves;
pub mod eye;
mod observed;
pub mod page;
pub mod pictures;
pub mod raster;
pub mod scene;
pub mod words;

pub use colours::Theme;
pub use eye::{Eye, Preset};
pub use page::{Layout, Page};
pub use scene::{Clouds, Colouring, Keyframes, Layers, Scene};
