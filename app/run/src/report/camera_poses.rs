//! Poses of the model in the camera, in the files that other programs read: one 4 x 4 per frame, TUM's trajectory and BOP's table.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result};
use mvt_frames::{Camera, Isometry, Object, World};
use nalgebra as na;

use super::{FrameRow, KNOWN_RAD};
use crate::io::write_file;

/// A frame of a recording: its name there, and where the camera was.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameCamera {
    /// Name, such as `000123`.
    pub name: String,
    /// Pose of the camera.
    pub world_from_camera: Isometry<Camera, World>,
    /// True pose of the object, where it is known.
    pub camera_from_object: Option<Isometry<Object, Camera>>,
}

/// Folder of the 4 x 4 matrices.
const POSES: &str = "poses";
/// Trajectory in the format of TUM: time, position, quaternion (x, y, z, w).
const TUM: &str = "trajectory_tum.txt";
/// Table in the format of BOP: rotation row by row, translation in millimetres.
const BOP: &str = "poses_bop.csv";
/// A pose is certified if it is tracked and its stated deviation is at most this, metres and radians.
const CERTIFIED: (f64, f64) = (0.01, KNOWN_RAD);

/// Writes the certified poses: they take coordinates of mesh.obj to those of a camera with OpenCV axes (x right, y down, z forward). Frames
/// belong together by their number.
///
/// # Errors
/// If a file cannot be written.
pub fn write_camera_poses(out: &Path, rows: &[FrameRow], cameras: &[FrameCamera]) -> Result<()> {
    let folder = out.join(POSES);
    fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let (mut tum, mut bop) = (String::new(), "scene_id,im_id,obj_id,score,R,t,time\n".to_owned());
    for (number, FrameCamera { name, world_from_camera, .. }) in cameras.iter().enumerate() {
        let file = format!("{name}.txt");
        let Some(row) = certified(rows, number) else {
            // That of an earlier run.
            let stale = folder.join(file);
            if stale.is_file() {
                fs::remove_file(&stale).with_context(|| format!("cannot remove {}", stale.display()))?;
            }
            continue;
        };
        let pose = opencv(world_from_camera.untyped().inverse() * row.estimate.untyped());
        let matrix = pose.to_homogeneous();
        let line = |k: usize| matrix.row(k).iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
        write_file(&folder, &file, ((0..4).map(line).collect::<Vec<_>>().join("\n") + "\n").as_bytes())?;
        let (t, q) = (pose.translation.vector, pose.rotation.coords);
        let _ = writeln!(tum, "{} {} {} {} {} {} {} {}", row.time_s, t.x, t.y, t.z, q.x, q.y, q.z, q.w);
        let rotation = pose.rotation.to_rotation_matrix();
        let rotation: Vec<String> = rotation.matrix().transpose().iter().map(f64::to_string).collect();
        let digits: String = name.chars().filter(char::is_ascii_digit).collect();
        let image = digits.trim_start_matches('0');
        let _ = writeln!(
            bop,
            "0,{},1,{},{},{} {} {},-1",
            if image.is_empty() { "0" } else { image },
            row.confidence,
            rotation.join(" "),
            1e3 * t.x,
            1e3 * t.y,
            1e3 * t.z
        );
    }
    write_file(out, TUM, tum.as_bytes())?;
    write_file(out, BOP, bop.as_bytes())
}

/// Returns the row of a frame, if its pose is certified. Rows are in order of time, and so of their frames.
pub(super) fn certified(rows: &[FrameRow], number: usize) -> Option<&FrameRow> {
    let at = rows.binary_search_by_key(&(number as u64), |row| row.frame).ok()?;
    rows.get(at).filter(|row| is_certified(row))
}

fn is_certified(row: &FrameRow) -> bool {
    is_placed(row) && row.deviation.is_some_and(|it| it.angle_rad <= CERTIFIED.1)
}

/// Whether a pose is certified up to a rotation that leaves the surface where it is.
pub(super) fn is_placed(row: &FrameRow) -> bool {
    row.state.is_tracking() && row.deviation.is_some_and(|it| it.surface_m <= CERTIFIED.0)
}

/// Takes a pose in a camera with OpenGL axes to the same in one with OpenCV axes.
fn opencv(camera_from_model: na::Isometry3<f64>) -> na::Isometry3<f64> {
    na::Isometry3::rotation(na::Vector3::x() * std::f64::consts::PI) * camera_from_model
}

#[cfg(test)]
mod tests {
    use mvt_slam::{Deviation, TrackState};

    use super::*;

    #[test]
    fn certified_poses_are_written_with_opencv_axes_and_others_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let row = |frame: u64, deviation_m: f64| FrameRow {
            frame,
            time_s: 0.1 * frame as f64,
            state: TrackState::Tracking,
            confidence: 0.9,
            deviation: Some(Deviation { surface_m: deviation_m, angle_rad: 0.0 }),
            // 0.5 m before the camera, 0.1 m to the right and 0.2 m above its axis, not turned.
            estimate: Isometry::translation(1.1, 0.2, -0.5),
            truth: None,
            add_s: None,
            add_m: None,
            stage_ms: Default::default(),
        };
        let camera = |name: &str| FrameCamera {
            name: name.to_owned(),
            world_from_camera: Isometry::translation(1.0, 0.0, 0.0),
            camera_from_object: None,
        };
        fs::create_dir(folder.path().join(POSES)).unwrap();
        fs::write(folder.path().join("poses/000008.txt"), "stale").unwrap();
        let cameras = ["000007", "000008", "000009"].map(camera);
        write_camera_poses(folder.path(), &[row(0, 0.001), row(1, 0.02)], &cameras).unwrap();
        let read = |name: &str| fs::read_to_string(folder.path().join(name));
        let numbers: Vec<f64> =
            read("poses/000007.txt").unwrap().split_whitespace().map(|x| x.parse().unwrap()).collect();
        let expected = [1.0, 0.0, 0.0, 0.1, 0.0, -1.0, 0.0, -0.2, 0.0, 0.0, -1.0, 0.5, 0.0, 0.0, 0.0, 1.0];
        assert!(numbers.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{numbers:?}");
        assert!(read("poses/000008.txt").is_err() && read("poses/000009.txt").is_err());
        assert_eq!(read(TUM).unwrap().lines().count(), 1);
        let table = read(BOP).unwrap();
        let line: Vec<&str> = table.lines().nth(1).unwrap().split(',').collect();
        assert_eq!((line[1], line[4].split(' ').count()), ("7", 9));
        let millimetres: Vec<f64> = line[5].split(' ').map(|x| x.parse().unwrap()).collect();
        assert!((millimetres[2] - 500.0).abs() < 1e-9, "{line:?}");
    }
}
