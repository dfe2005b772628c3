//! Networks that turn touch images of a DIGIT into indentation and contact.
//!
//! [`network`] describes six architectures and reads their weights; [`Weights::shipped`](network::Weights::shipped) needs no file.
//! [`engine`] runs them on the CPU, faster than a camera delivers images, or on the [`device`] that the program brings. [`untouched`] finds
//! and subtracts the image of a sensor without contact, [`light`] makes its levels those of the usual sensor, [`contact`] decides which pixels
//! touch, [`plausibility`] says how far a reading can be trusted, [`figures`] has its
//! volume and force, and [`accuracy`] compares predictions with the truth.
//! The crate `mvt-training` trains them.
//!
//! The crate deliberately has no camera driver, no tracking, and no network but these six; it runs no ONNX or PyTorch files.
//!
//! ```
//! use image::RgbImage;
//! use mvt_touch::engine::{Engine, Instructions, Prediction};
//! use mvt_touch::image;
//! use mvt_touch::network::Weights;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let engine = Engine::new(&Weights::shipped()?, Instructions::best());
//! // The shipped weights see images over the grey level `EVEN`, with the untouched image subtracted: here nothing touches.
//! let level = mvt_touch::untouched::EVEN;
//! let image = RgbImage::from_pixel(240, 320, image::Rgb([level; 3]));
//! let mut prediction = Prediction::default();
//! engine.infer(&image, &mut prediction)?;
//! assert_eq!(prediction.indentation_mm.dim(), (320, 240));
//! assert!(prediction.contact_logit.iter().all(|&logit| logit < 0.0));
//! # Ok(())
//! # }
//! ```

pub mod accuracy;
pub mod contact;
pub mod device;
pub mod engine;
pub mod figures;
pub mod light;
pub mod network;
pub mod plausibility;
pub mod untouched;

pub use image;
pub use mvt_robot;
pub use ndarray;
