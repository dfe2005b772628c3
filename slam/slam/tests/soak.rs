//! Five minutes of a hand that turns an object: no memory grows, and the object is not lost.

mod synthetic;

use mvt_frames::Isometry;
use mvt_slam::scan::Measurement;
use mvt_slam::{Slam, SlamConfig};
use synthetic::{BRICK, frame, pose, see};

/// Bytes that this process holds, where the system says (Linux).
fn resident_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok().map(|kibibytes| 1024 * kibibytes)
}

/// Two rounds a minute, as gaits turn objects, and a nod. Six frames a second stand for all that cameras see in that time, and a
/// tenth of the keyframes for all that are kept, so that their number has reached its bound after a minute.
#[test]
fn five_minutes_take_no_more_memory_than_one() {
    const HZ: usize = 6;
    const KEYFRAMES: usize = 60;
    let at = |k: usize| {
        let t = k as f64 / HZ as f64;
        pose([0.004 * (0.3 * t).sin(), 0.003 * (0.2 * t).cos(), 0.0], [6.0 * (0.25 * t).sin(), 0.0, 12.0 * t])
    };
    let (mut intrinsics, place) = synthetic::camera();
    // A quarter of the pixels: what grows does so with every frame, not with every pixel.
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
    let (mut gauge, mut after_a_minute) = (Isometry::identity(), None);
    let mut lost = 0;
    let frames = 300 * HZ;
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
            let off = (found.untyped().inverse() * at(k).untyped()).translation.vector.norm();
            println!("{:.2} mm off in the end, lost {lost} of {frames} frames", 1e3 * off);
        }
    }
    let keyframes = slam.map().unwrap().keyframes().len();
    assert!((KEYFRAMES / 2..=KEYFRAMES).contains(&keyframes), "{keyframes} keyframes");
    assert!(lost < frames / 100, "lost in {lost} of {frames} frames");
    let (Some(then), Some(now)) = (after_a_minute, resident_bytes()) else { return };
    println!("{} MB after a minute, {} MB after five", then >> 20, now >> 20);
    assert!(now < then + then / 10 + (4 << 20), "{then} bytes after a minute, {now} after five");
}
