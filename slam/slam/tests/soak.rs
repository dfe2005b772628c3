//! A minute of a hand that turns an object: memory does not grow, the object is not lost, and the last pose is right.

// Only Linux reports the memory of a process.
#![cfg(target_os = "linux")]

mod synthetic;

use mvt_frames::Isometry;
use mvt_slam::scan::Measurement;
use mvt_slam::{Slam, SlamConfig};
use synthetic::{BRICK, frame, pose, see};

/// Two rounds a minute, as gaits turn objects, and a nod. Six frames a second stand for all that cameras see in that time, and a
/// twentieth of the keyframes for all that are kept, so that their number has reached its bound after half a minute.
#[test]
fn a_minute_takes_no_more_memory_than_half_of_it() {
    const HZ: usize = 6;
    const KEYFRAMES: usize = 30;
    /// Largest error of the last position, millimetres.
    const FINAL_MM: f64 = 3.0;
    let resident_bytes = || {
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
        1024 * line.trim().strip_suffix(" kB").unwrap().parse::<u64>().unwrap()
    };
    let at = |k: usize| {
        let t = k as f64 / HZ as f64;
        pose([0.004 * (0.3 * t).sin(), 0.003 * (0.2 * t).cos(), 0.0], [6.0 * (0.25 * t).sin(), 0.0, 12.0 * t])
    };
    let (mut intrinsics, place) = synthetic::camera();
    // A quarter of the pixels: memory would grow with every frame, not with every pixel.
    intrinsics = mvt_frames::camera::Intrinsics {
        width: 160,
        height: 120,
        fx: 0.5 * intrinsics.fx,
        fy: 0.5 * intrinsics.fy,
        cx: 79.5,
        cy: 59.5,
    };
    let mut config = SlamConfig::default();
    config.map.keyframes = KEYFRAMES;
    let mut slam = Slam::builder().config(config).seed(1).build().unwrap();
    let (mut gauge, mut then, mut final_mm) = (Isometry::identity(), 0, f64::INFINITY);
    let mut lost = 0;
    let frames = 60 * HZ;
    for k in 0..frames {
        let estimate =
            slam.observe(&frame(k as f64 / HZ as f64, vec![Some(see(BRICK, at(k), (intrinsics, place)))]).measured());
        lost += usize::from(!estimate.state.is_tracking());
        if k == 0 {
            gauge = Isometry::new(estimate.pose.untyped().inverse() * at(0).untyped());
        }
        if k == 30 * HZ {
            then = resident_bytes();
        }
        if k + 1 == frames {
            let found: Isometry<mvt_frames::Model, mvt_frames::World> = estimate.pose * gauge;
            final_mm = 1e3 * (found.untyped().inverse() * at(k).untyped()).translation.vector.norm();
            println!("{final_mm:.2} mm off in the end, lost {lost} of {frames} frames");
        }
    }
    let keyframes = slam.map().unwrap().keyframes().len();
    assert!((KEYFRAMES / 2..=KEYFRAMES).contains(&keyframes), "{keyframes} keyframes");
    assert!(lost < frames / 100, "lost in {lost} of {frames} frames");
    assert!(final_mm < FINAL_MM, "{final_mm} mm off in the end");
    let now = resident_bytes();
    assert!(now < then + then / 20 + (2 << 20), "{then} bytes after half a minute, {now} after all of it");
}
