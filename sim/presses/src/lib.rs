//! Rendered touch images of random presses, with their true indentation and contact: data for training and evaluation
//! of touch networks.
//!
//! A press is drawn from a seed and an index alone: an object of the catalogue, a point of its surface, a pose of the
//! sensor, a DIGIT with its own lights, background and noise. Objects are split into sets for training, validation and
//! test ([`objects`]). The crate neither trains networks nor simulates physics: each press is a single image of a rigid
//! object.
//!
//! ```
//! use mvt_presses::{DataConfig, Rack, example, objects};
//! use mvt_render::touch::TouchFrame;
//! use mvt_robot::digit::profile::SensorProfile;
//!
//! // One sensor, and only images with contact.
//! let config = DataConfig { sensors: 1, untouched: 0.0, ..DataConfig::default() };
//! let surfaces = objects::load(&["ball"])?;
//! let mut rack = Rack::new(&config, &SensorProfile::tacto(), 7)?;
//! let press = example(&surfaces, &rack.of_step(0)?, &config, (7, 0), &mut TouchFrame::default());
//!
//! assert_eq!(press.image().dimensions(), (240, 320));
//! let deepest_mm = press.indentation_mm.iter().copied().fold(0.0, f32::max);
//! assert!(deepest_mm > 0.05 && press.contact.contains(&1.0));
//! # Ok::<(), mvt_presses::PressError>(())
//! ```

mod backdrop;
mod config;
mod error;
mod example;
pub mod objects;
mod resize;
mod sensor_fault;
mod sensors;

pub use config::DataConfig;
pub use error::PressError;
pub use example::{Example, example};
pub use image;
pub use resize::resized;
pub use sensor_fault::SensorFault;
pub use sensors::{PressSensor, Rack};
