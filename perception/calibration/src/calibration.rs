//! A calibration as a result: what differs from the given one, and how sure that is.

use std::fmt;

use mvt_frames::NotRigid;
use mvt_robot::hand::{Finger, JOINTS_PER_FINGER, JointAngles};
use serde::{Deserialize, Serialize};

/// Calibration of cameras and joints, with one standard deviation of each part. It serialises to the file that `calibrate` writes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// One per camera.
    pub cameras: Vec<CameraCalibration>,
    /// True angle minus reading of each joint, degrees.
    pub joint_offsets_deg: JointAngles,
    /// Standard deviation of each offset, degrees.
    pub joint_sigmas_deg: JointAngles,
    /// By how much joint readings are later than the images, milliseconds; negative if they are earlier.
    pub lag_ms: f64,
    /// Its standard deviation, milliseconds.
    pub lag_sigma_ms: f64,
}

/// Calibration of a camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraCalibration {
    /// Name of the camera.
    pub name: String,
    /// Refined pose, camera to world, OpenGL axes, 4 x 4 row-major, metres.
    pub pose: [[f64; 4]; 4],
    /// Rotation from the given pose, degrees.
    pub turned_deg: f64,
    /// Distance from the given position, millimetres.
    pub moved_mm: f64,
    /// Standard deviation of the rotation about the worst of the three axes, degrees.
    pub sigma_deg: f64,
    /// Standard deviation of the place of the fingers in the camera's view along the worst of the three axes, millimetres.
    pub sigma_mm: f64,
    /// Whether the camera has seen the hand. Otherwise its pose is the given one.
    pub hand_found: bool,
}

/// Calibration that cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrationError {
    /// A pose is not a rigid motion.
    #[error("the pose of camera {camera} is invalid: {reason}")]
    Pose {
        /// Name of the camera.
        camera: String,
        /// The reason.
        reason: NotRigid,
    },
    /// A joint offset or the lag is not a finite number.
    #[error("a joint offset or the lag is not a finite number")]
    NotFinite,
}

/// A camera that is off by more than this was not calibrated or was bumped, degrees and millimetres.
const LARGE_DEG: f64 = 1.0;
const LARGE_MM: f64 = 5.0;
/// A joint that is off by more than this is worth a look at its encoder, degrees.
const LARGE_JOINT_DEG: f64 = 2.0;
/// Joint readings that are off by more than this, a third of a frame, are worth a look at the clocks, milliseconds.
const LARGE_LAG_MS: f64 = 10.0;
/// A deviation below this many standard deviations may be chance.
const SURE_SIGMAS: f64 = 3.0;

impl Calibration {
    /// Deviations from the given calibration that are large enough for a look, in sentences.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        for camera in &self.cameras {
            let CameraCalibration { name, turned_deg, moved_mm, .. } = camera;
            if !camera.hand_found {
                warnings.push(format!("camera {name} has not seen the hand: its given pose is used as it is"));
            } else if *turned_deg > LARGE_DEG.max(SURE_SIGMAS * camera.sigma_deg)
                || *moved_mm > LARGE_MM.max(SURE_SIGMAS * camera.sigma_mm)
            {
                warnings.push(format!(
                    "camera {name} is turned by {turned_deg:.1} degrees and moved by {moved_mm:.0} mm from its given pose; \
                     the refined pose is used"
                ));
            }
        }
        for (j, (offset, sigma)) in self.joint_offsets_deg.iter().zip(&self.joint_sigmas_deg).enumerate() {
            if offset.abs() > LARGE_JOINT_DEG.max(SURE_SIGMAS * sigma) {
                warnings.push(format!("{} is off by {offset:.1} degrees, which is corrected", joint_name(j)));
            }
        }
        if self.lag_ms.abs() > LARGE_LAG_MS.max(SURE_SIGMAS * self.lag_sigma_ms) {
            let side = if self.lag_ms > 0.0 { "late" } else { "early" };
            warnings.push(format!("joint readings are {:.0} ms {side}, which is corrected", self.lag_ms.abs()));
        }
        warnings
    }
}

/// Returns the name of a joint by its index: "joint 2 of the thumb".
fn joint_name(j: usize) -> String {
    let finger = Finger::ALL.get(j / JOINTS_PER_FINGER).map_or("hand", |finger| finger.name());
    format!("joint {} of the {finger}", j % JOINTS_PER_FINGER)
}

impl fmt::Display for Calibration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for camera in &self.cameras {
            let CameraCalibration { name, turned_deg, moved_mm, sigma_deg, sigma_mm, .. } = camera;
            if camera.hand_found {
                writeln!(
                    f,
                    "camera {name}: turned by {turned_deg:.2} degrees (sigma {sigma_deg:.2}), moved by {moved_mm:.1} mm \
                     (sigma at the hand {sigma_mm:.1})"
                )?;
            } else {
                writeln!(f, "camera {name}: the hand was not seen")?;
            }
        }
        for (k, finger) in Finger::ALL.into_iter().enumerate() {
            let joints = JOINTS_PER_FINGER * k..JOINTS_PER_FINGER * (k + 1);
            let offsets =
                joints.map(|j| format!("{:+.2} ({:.2})", self.joint_offsets_deg[j], self.joint_sigmas_deg[j]));
            writeln!(f, "joints of {}: {} degrees", finger.name(), offsets.collect::<Vec<_>>().join(", "))?;
        }
        write!(f, "joint readings: {:+.1} ms late (sigma {:.1})", self.lag_ms, self.lag_sigma_ms)
    }
}
