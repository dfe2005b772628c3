//! `disturb`: a copy of a log with a wrong calibration.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use mvt_feelsight::{DISTURBANCE_FILE, Disturbance};
use mvt_run::io::print_line;

/// Copy a FeelSight log with a wrong calibration, to test its effect
///
/// Images, times and true poses stay the same. The poses of the cameras and the joint readings change; disturbance.json
/// in the copy contains the true ones. Directions and offsets are drawn from the seed.
#[derive(Debug, Args)]
pub struct DisturbArguments {
    /// Folder of the log
    log: PathBuf,
    /// Folder for the copy, which must not exist or be empty
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Rotation of each camera about a random axis through its centre, degrees
    #[arg(long, default_value_t = 0.0, value_parser = amount)]
    camera_deg: f64,
    /// Displacement of each camera in a random direction, millimetres
    #[arg(long, default_value_t = 0.0, value_parser = amount)]
    camera_mm: f64,
    /// Constant error of each joint, one standard deviation, degrees
    #[arg(long, default_value_t = 0.0, value_parser = amount)]
    joints_deg: f64,
    /// Error of each joint in each frame, one standard deviation, degrees
    #[arg(long, default_value_t = 0.0, value_parser = amount)]
    joint_noise_deg: f64,
    /// Delay of the joint readings after the images, milliseconds; negative if they are early
    #[arg(long, default_value_t = 0.0, value_parser = amount)]
    lag_ms: f64,
    /// Seed of the directions and offsets
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

/// Parses a number between -1000 and 1000: beyond this nothing is left of a log.
fn amount(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.abs() <= 1000.0 => Ok(value),
        _ => Err("give a number from -1000 to 1000".to_owned()),
    }
}

/// Runs the command.
pub fn run(arguments: &DisturbArguments) -> Result<()> {
    let &DisturbArguments { camera_deg, camera_mm, joints_deg, joint_noise_deg, lag_ms, seed, .. } = arguments;
    let disturbance = Disturbance { camera_deg, camera_mm, joints_deg, joint_noise_deg, lag_ms, seed };
    let disturbed = mvt_feelsight::disturb(&arguments.log, &arguments.out, &disturbance)?;
    print_line(&format!(
        "{} camera(s) moved, {} joints changed; the true calibration is in {}",
        disturbed.true_camera_poses.len(),
        disturbed.joint_offsets_deg.len(),
        arguments.out.join(DISTURBANCE_FILE).display()
    ))
}
