//! Two minutes of a hand that turns an object: memory does not grow, the object is not lost, and the last pose is right.

mod synthetic;

use mvt_frames::Isometry;
use mvt_slam::scan::Measurement;
use mvt_slam::{Slam, SlamConfig};
use synthetic::{BRICK, frame, pose, see};

/// Says that a test is skipped, and fails where every test must run. Written past the test harness, which hides what passing tests say.
fn skip(reason: impl std::fmt::Display) {
    use std::io::Write as _;
    let _ = writeln!(std::io::stderr(), "SKIPPED: {reason}");
    assert!(
        std::env::var_os("REQUIRE_ALL").is_none_or(|value| value != "1"),
        "REQUIRE_ALL=1 allows no skipped test: {reason}"
    );
}

/// Resident memory of this process, bytes. Only Linux reports it.
fn resident_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok().map(|kibibytes| 1024 * kibibytes)
}

/// Two rounds a minute, as gaits turn objects, and a nod. Six frames a second stand for all that cameras see in that time, and a
/// tenth of the keyframes for all that are kept, so that their number has reached its bound after a minute.
#[test]
fn two_minutes_take_no_more_memory_than_one() {
    const HZ: usize = 6;
    const KEYFRAMES: usize = 60;
    /// Largest error of the last position, millimetres.
    const FINAL_MM: f64 = 3.0;
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
    let (mut gauge, mut after_a_minute, mut final_mm) = (Isometry::identity(), None, f64::INFINITY);
    let mut lost = 0;
    let frames = 120 * HZ;
    for k in 0..frames {
        let estimate =
            slam.observe(&frame(k as f64 / HZ as f64, vec![Some(see(BRICK, at(k), (intrinsics, place)))]).measured());
        lost += usize::from(!estimate.state.is_tracking());
        if k == 0 {
            gauge = Isometry::new(estimate.pose.untyped().inverse() * at(0).untyped());
        }
        if k == 60 * HZ {
            after_a_minute = resident_bytes();
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
    let (Some(then), Some(now)) = (after_a_minute, resident_bytes()) else {
        return skip("this system does not report the memory of a process");
    };
    println!("{} MB after a minute, {} MB after two", then >> 20, now >> 20);
    assert!(now < then + then / 10 + (4 << 20), "{then} bytes after a minute, {now} after two");
}
