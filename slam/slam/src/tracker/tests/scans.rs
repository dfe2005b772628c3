//! The surface of one frame on that of another.

use super::*;

/// A face seen from the front, so that a point that finds another match keeps its residual: between matches the cost jumps.
#[test]
fn scan_to_scan_residuals() {
    const STEP: f64 = 1e-5;
    let place = na::Vector3::from(PLACE_M);
    let (intrinsics, _) = camera();
    let above = (intrinsics, look_at(place + na::Vector3::z() * 0.35, place, na::Vector3::x()));
    for upright in [[0.0; 3], [90.0, 0.0, 0.0], [0.0, 90.0, 0.0]] {
        let solid = Solid::Block([0.03; 3]);
        let tilted = |tilt: [f64; 3]| {
            let tilt = na::UnitQuaternion::from_scaled_axis(na::Vector3::from(tilt));
            let at = pose([0.0; 3], upright).untyped();
            na::Isometry3::from_parts(at.translation, tilt * at.rotation)
        };
        let scan = |k, at: na::Isometry3<f64>| {
            Scan::new(
                k,
                &frame(0.0, vec![Some(see(solid, Isometry::<Field, _>::new(at), above))]).measured(),
                &scan::ScanConfig::default(),
                1,
            )
        };
        let poses = [tilted([0.02, -0.03, 0.05]), tilted([-0.01, 0.02, 0.0])];
        let scans = [scan(0, poses[0]), scan(1, poses[1])];
        // As tracking has it: a little wrong.
        let wrong = se3::exp(&Twist::new(0.0004, -0.0003, 0.0005, 0.01, -0.02, 0.01));
        let poses = [poses[0], poses[1] * wrong];
        let system = |poses: &[na::Isometry3<f64>; 2]| {
            let mut system = System::new(2);
            let [a, b] = std::array::from_fn(|i| (Some(i), Posed { scan: &scans[i], pose: &poses[i] }));
            let [tried, matched] = icp::add(&mut system, a, b, matching(300));
            assert!(matched > tried / 2, "{matched} of {tried}");
            system
        };
        let found = system(&poses).gradient;
        let expected = na::DVector::from_fn(12, |i, _| {
            let cost = |sign: f64| {
                let mut poses = poses;
                let mut twist = Twist::zeros();
                twist[i % 6] = sign * STEP;
                poses[i / 6] *= se3::exp(&twist);
                system(&poses).cost
            };
            (cost(1.0) - cost(-1.0)) / (2.0 * STEP)
        });
        for rows in [0, 3, 6, 9] {
            let (found, expected) = (found.rows(rows, 3), expected.rows(rows, 3));
            assert!((found - expected).norm() < 0.02 * expected.norm(), "{rows}: {found}{expected}");
        }
    }
}
