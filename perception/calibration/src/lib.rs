//! Calibration from the hand itself: where cameras stand, by how much joint readings are off, and by how much they are late.
//!
//! The hand's shape is known, and most of a camera's points are the hand's. A [`Calibrator`] puts the measured points on the hand's surface, for
//! all cameras, joints and some tens of instants together, and returns each frame with the calibration known so far. A quantity that nothing measures
//! keeps its prior: the offset of a joint that no camera sees, and the lag while the hand is still.
//!
//! ```
//! use mvt_calibration::{CalibrationConfig, Calibrator};
//! use mvt_robot::hand::{Hand, Side};
//! use mvt_robot::rig::PLACEMENTS;
//! use ndarray::Array2;
//!
//! let hand = Hand::allegro(Side::Left);
//! let cameras = [PLACEMENTS[2].camera(&hand)];
//! let mut calibrator = Calibrator::new(CalibrationConfig::default(), hand, cameras.to_vec());
//! let nothing = Array2::zeros((480, 640));
//! let frame = calibrator.observe(0.0, &[0.1; 16], None, &[Some(nothing)]);
//! // An image of nothing changes nothing.
//! assert_eq!(frame.cameras, cameras);
//! assert_eq!(frame.joints, [0.1; 16]);
//! assert_eq!(calibrator.calibration().joint_sigmas_deg[0].round(), 1.0);
//! ```

// Why: notes/decisions/calibration.md, "Cameras, joint offsets and lag come from the hand, not from the object".

mod calibration;
mod calibrator;
mod evidence;
mod search;
mod solver;
#[cfg(test)]
mod tests;

pub use calibration::{Calibration, CalibrationError, CameraCalibration};
pub use calibrator::{Calibrated, CalibrationConfig, Calibrator};
