//! Copies of logs with a wrong calibration, to test its effect.

use std::fs;
use std::path::Path;

use mvt_robot::hand::JointAngles;
use nalgebra as na;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::error::LogError;
use crate::io::write_synced;
use crate::pickle;
use crate::record::{Matrix, Record};
use crate::writer::PartialFolder;

/// How wrong the calibration of the copy is. Axes, directions and offsets are drawn from the seed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Disturbance {
    /// Turn of each camera about its own centre, about a random axis, degrees.
    pub camera_deg: f64,
    /// Shift of each camera in a random direction, millimetres.
    pub camera_mm: f64,
    /// Constant error of each joint reading, one standard deviation, degrees.
    pub joints_deg: f64,
    /// Error of each joint reading that is drawn for each frame, one standard deviation, degrees.
    pub joint_noise_deg: f64,
    /// By how much joint readings are later than images, milliseconds; negative if they are earlier.
    pub lag_ms: f64,
    /// Seed of all draws.
    pub seed: u64,
}

/// The disturbance of a log: the truth that a calibration should find. It is the file [`DISTURBANCE_FILE`] of the copy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Disturbed {
    /// The undisturbed camera poses, camera to world, OpenGL axes, 4 x 4 row-major, by the camera's name.
    pub true_camera_poses: Vec<(String, [[f64; 4]; 4])>,
    /// True angle minus reading of each joint, degrees.
    pub joint_offsets_deg: JointAngles,
    /// By how much joint readings are later than images, milliseconds.
    pub lag_ms: f64,
}

/// Name of the file that holds [`Disturbed`].
pub const DISTURBANCE_FILE: &str = "disturbance.json";

/// Copies a log with a wrong calibration: images, times and true poses of the object stay, joint readings and camera poses change.
///
/// # Errors
/// [`LogError::NotEmpty`] if `out` is not empty, [`LogError::Io`] if a file cannot be read or written, else what reading `data.pkl` reports.
pub fn disturb(log: &Path, out: &Path, disturbance: &Disturbance) -> Result<Disturbed, LogError> {
    let path = log.join("data.pkl");
    let mut record = Record::read(&path)?;
    let disturbed = apply(&mut record, disturbance).map_err(|reason| LogError::defect(&path, reason))?;
    let partial = PartialFolder::begin(out)?;
    copy_folder(log, partial.path(), DEEPEST)?;
    write_synced(&partial.path().join("data.pkl"), &pickle::to_bytes(&record.to_value()))?;
    let path = partial.path().join(DISTURBANCE_FILE);
    let text = serde_json::to_vec_pretty(&disturbed).map_err(|reason| LogError::Json { path: path.clone(), reason })?;
    write_synced(&path, &text)?;
    partial.place(out)?;
    Ok(disturbed)
}

/// Changes the camera poses and joint readings of a record.
fn apply(record: &mut Record, disturbance: &Disturbance) -> Result<Disturbed, String> {
    let mut rng = ChaCha8Rng::seed_from_u64(disturbance.seed);
    let mut true_camera_poses = Vec::new();
    for camera in &mut record.cameras {
        true_camera_poses.push((camera.name.clone(), camera.pose));
        let turn = direction(&mut rng) * disturbance.camera_deg.to_radians();
        let shift = direction(&mut rng) * (disturbance.camera_mm * 1e-3);
        camera.pose = moved(&camera.pose, &na::Rotation3::from_scaled_axis(turn), &shift);
    }
    let count = record.joints.first().map_or(0, Vec::len);
    let offsets_deg: JointAngles = (0..count).map(|_| disturbance.joints_deg * normal(&mut rng)).collect();
    if record.times_s.len() != record.joints.len() {
        return Err(format!("{} times and {} joint states", record.times_s.len(), record.joints.len()));
    }
    let truth = record.joints.clone();
    for (frame, joints) in record.joints.iter_mut().enumerate() {
        let late = interpolated(&record.times_s, &truth, record.times_s[frame] - disturbance.lag_ms * 1e-3);
        for ((joint, late), offset_deg) in joints.iter_mut().zip(late).zip(&offsets_deg) {
            let noise_deg = disturbance.joint_noise_deg * normal(&mut rng);
            *joint = late + (noise_deg - offset_deg).to_radians();
        }
    }
    // They follow from the true joint angles.
    record.finger_poses = None;
    Ok(Disturbed { true_camera_poses, joint_offsets_deg: offsets_deg, lag_ms: disturbance.lag_ms })
}

/// Returns the joint angles at a time, between the two nearest frames; those of the first or last frame beyond them.
fn interpolated(times_s: &[f64], joints: &[JointAngles], time_s: f64) -> JointAngles {
    let after = times_s.partition_point(|&t| t < time_s);
    match (after.checked_sub(1), joints.get(after)) {
        (None, _) => joints.first().cloned().unwrap_or_default(),
        (Some(before), None) => joints[before].clone(),
        (Some(before), Some(next)) => {
            let part = (time_s - times_s[before]) / (times_s[after] - times_s[before]);
            joints[before].iter().zip(next).map(|(angle, next)| angle + part * (next - angle)).collect()
        }
    }
}

/// Turns a pose about its own origin and shifts it; world frame.
fn moved(pose: &Matrix, turn: &na::Rotation3<f64>, shift: &na::Vector3<f64>) -> Matrix {
    let rotation = turn.matrix() * na::Matrix3::from_fn(|row, column| pose[row][column]);
    std::array::from_fn(|row| {
        std::array::from_fn(|column| match (row, column) {
            (3, _) => pose[row][column],
            (_, 3) => pose[row][3] + shift[row],
            _ => rotation[(row, column)],
        })
    })
}

/// A unit vector, evenly distributed over the sphere.
fn direction(rng: &mut ChaCha8Rng) -> na::Vector3<f64> {
    na::Vector3::from_fn(|_, _| normal(rng)).normalize()
}

/// A standard normal number (Box and Muller).
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (a, b): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}

/// Folders of a log lie this deep at most: realsense/CAMERA/image, or allegro/PAD/image, where a pad's name may hold slashes.
const DEEPEST: usize = 8;

/// Copies the regular files of a folder and of its folders.
fn copy_folder(from: &Path, to: &Path, depth: usize) -> Result<(), LogError> {
    fs::create_dir_all(to).map_err(LogError::io(to))?;
    for entry in fs::read_dir(from).map_err(LogError::io(from))? {
        let entry = entry.map_err(LogError::io(from))?;
        let (path, target) = (entry.path(), to.join(entry.file_name()));
        let kind = entry.file_type().map_err(LogError::io(&path))?;
        if kind.is_dir() && depth > 1 {
            copy_folder(&path, &target, depth - 1)?;
        } else if kind.is_file() {
            fs::copy(&path, &target).map_err(LogError::io(&target))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_reading_is_an_earlier_angle() {
        let joints: Vec<JointAngles> = [0.0, 1.0, 3.0].map(|angle| vec![angle; 16]).to_vec();
        let at = |time_s| interpolated(&[0.0, 0.1, 0.2], &joints, time_s)[0];
        assert_eq!([at(-1.0), at(0.0), at(0.2), at(9.0)], [0.0, 0.0, 3.0, 3.0]);
        assert!((at(0.15) - 2.0).abs() < 1e-12 && (at(0.05) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn a_camera_turns_about_its_own_centre() {
        let mut pose = [[0.0; 4]; 4];
        (0..4).for_each(|i| pose[i][i] = 1.0);
        pose[0][3] = 0.3;
        let turn = na::Rotation3::from_axis_angle(&na::Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let turned = moved(&pose, &turn, &na::Vector3::new(0.0, 0.0, 0.01));
        assert_eq!([turned[0][3], turned[1][3], turned[2][3]], [0.3, 0.0, 0.01]);
        assert!((turned[1][0] - 1.0).abs() < 1e-12 && turned[3] == [0.0, 0.0, 0.0, 1.0]);
    }
}
