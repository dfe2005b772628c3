//! Shear of the gel of a touch sensor, seen in the motion of the dots on it.
//!
//! [`ShearSensor`] finds the dots in the untouched image of a sensor, follows them into other images, and fits to their motion how an object
//! has dragged, turned and spread the gel at the contact. It knows the pattern of the dots from the sensor's profile, and the contact from
//! the caller; it has no network and no simulator. [`ShearSensor::erased`] removes the dots from an image, for a network that knows none.
//!
//! ```
//! use image::{Rgb, RgbImage};
//! use mvt_robot::digit::profile::SensorProfile;
//! use mvt_shear::{ShearError, ShearSensor};
//!
//! // A gel without dots has no shear that could be seen.
//! let plain = RgbImage::from_pixel(240, 320, Rgb([90; 3]));
//! assert_eq!(ShearSensor::new(&SensorProfile::load("digit")?, &plain).err(), Some(ShearError::NoMarkers));
//! let error = ShearSensor::new(&SensorProfile::load("digit_markers")?, &plain).err();
//! assert_eq!(error, Some(ShearError::Unmarked { found: 0, expected: 72 }));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod dots;
mod fit;
mod matching;
mod sensor;

pub use fit::ShearFit;
pub use sensor::{DotMotion, ShearError, ShearField, ShearSensor};
pub use {image, mvt_robot, ndarray};
