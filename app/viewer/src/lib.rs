//! Pictures of a recording: the scene in three dimensions and what the sensors showed.

pub mod colours;
mod curves;
pub mod eye;
pub mod film;
pub mod key;
mod observed;
pub mod page;
pub mod pictures;
pub mod raster;
pub mod scene;
pub mod window;
pub mod words;

pub use colours::Theme;
pub use eye::{Eye, Preset};
pub use page::{Layout, Page};
pub use scene::{Clouds, Colouring, Keyframes, Layers, Scene};
