//! A calibration as a result: what differs from the given one, and how sure that is.

use mvt_frames::NotRigid;
use mvt_robot::hand::{Hand, Joint, JointMotion};
use serde::{Deserialize, Serialize};

/// Calibration of cameras and joints, with one standard deviation of each part. It serialises to the file that `calibrate` writes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// One per camera.
    pub cameras: Vec<CameraCalibration>,
    /// True angle minus reading of each joint, degrees; of sliding joints millimetres.
    pub joint_offsets_deg: Vec<f64>,
    /// Standard deviation of each offset, in the same units.
    pub joint_sigmas_deg: Vec<f64>,
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
    /// Standard deviation of the place of the hand in the camera's view along the worst of the three axes, millimetres.
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
    /// It is that of a hand with another number of joints.
    #[error(
        "the calibration has the offsets of {found} joints; hand {hand} has {expected}: was it measured with another hand?"
    )]
    Joints {
        /// Name of the hand.
        hand: String,
        /// Joints of the hand.
        expected: usize,
        /// Offsets found.
        found: usize,
    },
    /// A joint offset or the lag is not a finite number.
    #[error("a joint offset or the lag is not a finite number")]
    NotFinite,
}

/// A camera that is off by more than this was not calibrated or was bumped, degrees and millimetres.
const LARGE_DEG: f64 = 1.0;
const LARGE_MM: f64 = 5.0;
/// A joint that is off by more than this is worth a look at its encoder, degrees or millimetres.
const LARGE_JOINT_DEG: f64 = 2.0;
/// Joint readings that are off by more than this, a third of a frame, are worth a look at the clocks, milliseconds.
const LARGE_LAG_MS: f64 = 10.0;
/// A deviation below this many standard deviations may be chance.
const SURE_SIGMAS: f64 = 3.0;

impl Calibration {
    /// Returns the deviations from the given calibration that are large enough for a look, in sentences. `hand` is the hand of the
    /// calibration.
    pub fn warnings(&self, hand: &Hand) -> Vec<String> {
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
        for ((offset, sigma), joint) in self.joint_offsets_deg.iter().zip(&self.joint_sigmas_deg).zip(hand.joints()) {
            if offset.abs() > LARGE_JOINT_DEG.max(SURE_SIGMAS * sigma) {
                let (name, unit) = (&joint.name, unit(joint.motion));
                warnings.push(format!("joint {name} is off by {offset:.1} {unit}, which is corrected"));
            }
        }
        if self.lag_ms.abs() > LARGE_LAG_MS.max(SURE_SIGMAS * self.lag_sigma_ms) {
            let side = if self.lag_ms > 0.0 { "late" } else { "early" };
            warnings.push(format!("joint readings are {:.0} ms {side}, which is corrected", self.lag_ms.abs()));
        }
        warnings
    }
    /// Returns the calibration in words: a line per camera, per pad for the joints that move it alone, for the other joints, and for the lag.
    pub fn described(&self, hand: &Hand) -> String {
        let mut lines: Vec<String> = self.cameras.iter().map(CameraCalibration::described).collect();
        let pads = hand.pads().iter().enumerate();
        let mover = |j: usize| {
            let mut moved = pads.clone().filter(|(pad, _)| hand.pad_chain(*pad).contains(&j));
            moved.next().filter(|_| moved.next().is_none()).map(|(pad, _)| pad)
        };
        let groups = pads.clone().map(|(k, pad)| (Some(k), format!("joints of {}", pad.name)));
        for (pad, name) in groups.chain([(None, "other joints".to_owned())]) {
            for motion in [JointMotion::Hinge, JointMotion::Slide] {
                let offsets = self.joint_offsets_deg.iter().zip(&self.joint_sigmas_deg).zip(hand.joints()).enumerate();
                let offsets: Vec<String> = offsets
                    .filter(|(j, (_, joint))| joint.motion == motion && mover(*j) == pad)
                    .map(|(_, ((offset, sigma), _))| format!("{offset:+.2} ({sigma:.2})"))
                    .collect();
                if !offsets.is_empty() {
                    lines.push(format!("{name}: {} {}", offsets.join(", "), unit(motion)));
                }
            }
        }
        lines.push(format!("joint readings: {:+.1} ms late (sigma {:.1})", self.lag_ms, self.lag_sigma_ms));
        lines.join("\n")
    }
}

impl CameraCalibration {
    fn described(&self) -> String {
        let Self { name, turned_deg, moved_mm, sigma_deg, sigma_mm, hand_found, .. } = self;
        match hand_found {
            true => format!(
                "camera {name}: turned by {turned_deg:.2} degrees (sigma {sigma_deg:.2}), moved by {moved_mm:.1} mm \
                 (sigma at the hand {sigma_mm:.1})"
            ),
            false => format!("camera {name}: the hand was not seen"),
        }
    }
}

/// Returns the unit in which offsets are shown.
fn unit(motion: JointMotion) -> &'static str {
    match motion {
        JointMotion::Hinge => "degrees",
        JointMotion::Slide => "mm",
    }
}

/// Returns the offset of a joint, radians or metres, in the unit in which it is shown.
pub(crate) fn shown(joint: &Joint, offset: f64) -> f64 {
    match joint.motion {
        JointMotion::Hinge => offset.to_degrees(),
        JointMotion::Slide => offset * 1e3,
    }
}

/// Returns the offset of a joint, radians or metres, from that in the unit in which it is shown.
pub(crate) fn from_shown(joint: &Joint, offset: f64) -> f64 {
    match joint.motion {
        JointMotion::Hinge => offset.to_radians(),
        JointMotion::Slide => offset * 1e-3,
    }
}
