//! data.pkl of a log in another container: its times and poses to the last bit, which nanoseconds and quaternions do not keep. An estimate
//! follows its input so closely that the last bits change its score.

use std::path::Path;

use mvt_feelsight::Log;
use mvt_feelsight::pickle::{self, PickleValue};
use mvt_robot::hand::JointAngles;

/// Name of the file in a log.
pub(crate) const RECORD_FILE: &str = "data.pkl";
/// Greatest size of the file, bytes.
const LARGEST: u64 = 256 << 20;
/// Times that differ by less are the same, seconds.
const SAME_S: f64 = 1e-9;
/// Angles that differ by less are the same, radians: data sets have them in 32 bits.
const SAME_RAD: f64 = 1e-6;

/// Returns data.pkl of a log; `None` if a lens distorts, because images are exported without distortion.
pub(crate) fn record_of(log: &Log) -> Option<Vec<u8>> {
    let bytes = mvt_files::input::read(&log.folder().join(RECORD_FILE), LARGEST).ok()?;
    let value = pickle::from_bytes(&bytes).ok()?;
    let cameras = value.get("realsense")?;
    let distorts = |name: &str| {
        let intrinsics = cameras.get(name).and_then(|camera| camera.get("intrinsics"));
        let bends =
            |key| intrinsics.and_then(|of| of.get(key)).and_then(PickleValue::to_number).is_some_and(|k| k != 0.0);
        ["k1", "k2", "p1", "p2", "k3"].into_iter().any(bends)
    };
    (!log.cameras().iter().any(|camera| distorts(&camera.name))).then_some(bytes)
}

/// Returns whether a data.pkl tells the same times, joints and cameras.
pub(crate) fn agrees<'a>(
    record: &[u8],
    times_s: &[f64],
    joints: &[JointAngles],
    mut cameras: impl Iterator<Item = &'a str>,
) -> bool {
    let Ok(value) = pickle::from_bytes(record) else { return false };
    let numbers = |value: Option<&PickleValue>| value.and_then(PickleValue::to_tensor).map(|(_, numbers)| numbers);
    let has_times = numbers(value.get("time")).is_some_and(|times| {
        times.len() == times_s.len() && times.iter().zip(times_s).all(|(a, b)| (a - b).abs() < SAME_S)
    });
    let state = value.get("allegro").and_then(|allegro| allegro.get("joint_state"));
    let has_joints = numbers(state).is_some_and(|state| {
        state.len() == joints.iter().map(Vec::len).sum::<usize>()
            && state.iter().zip(joints.iter().flatten()).all(|(a, b)| (a - b).abs() < SAME_RAD)
    });
    let places = value.get("realsense");
    has_times && has_joints && cameras.all(|name| places.is_some_and(|places| places.get(name).is_some()))
}

/// Puts a data.pkl into a complete log, unless the log could not be read with it.
pub(crate) fn put(record: &[u8], log: &Path) -> std::io::Result<()> {
    let path = log.join(RECORD_FILE);
    let before = mvt_files::input::read(&path, LARGEST)?;
    mvt_files::output::replace(&path, record)?;
    if Log::open_tolerant(log).is_err() { mvt_files::output::replace(&path, &before) } else { Ok(()) }
}
