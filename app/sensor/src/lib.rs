//! Images of a real touch sensor, as people bring them: turned upright, read by a network, and the sensor's light measured.
//!
//! [`SensorImages`] reads images of one sensor and finds its untouched image. [`ball`] fits gains and directions of the LEDs to presses of a
//! ball. The commands `touch predict`, `touch calibrate`, `touch weigh` and `touch units` are here with their arguments. Videos and cameras are decoded by the program
//! ffmpeg; the crate has no camera driver.
//!
//! ```
//! use image::{Rgb, RgbImage};
//! use mvt_sensor::ImageLayout;
//!
//! // Of a sensor that lies on its side: a quarter turn makes its image taller than wide.
//! let lying = RgbImage::from_pixel(320, 240, Rgb([90, 95, 92]));
//! let layout = ImageLayout::of(&lying, [240, 320]);
//! assert_eq!(layout.upright(&lying, [240, 320]).dimensions(), (240, 320));
//! ```

pub mod ball;
mod calibrate;
mod camera;
mod images;
mod layout;
mod pictures;
mod predict;
mod predictor;
mod stream;
mod units;
mod weigh;
mod window;

pub use calibrate::{TouchCalibrateArguments, calibrate};
pub use camera::TouchCamera;
pub use image;
pub use images::SensorImages;
pub use layout::ImageLayout;
pub use mvt_robot;
pub use mvt_touch;
pub use ndarray;
pub use predict::{TouchPredictArguments, predict};
pub use units::{TouchUnitsArguments, units};
pub use weigh::{TouchWeighArguments, weigh};
pub use window::GelWindow;
