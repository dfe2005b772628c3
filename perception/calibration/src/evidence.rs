//! The evidence of an instant: points that cameras measured, and how the joints moved.

use mvt_frames::camera::Intrinsics;
use mvt_robot::hand::JointAngles;
use nalgebra as na;
use ndarray::Array2;

/// Time in seconds and joint readings.
pub(crate) type Reading = (f64, JointAngles);

/// Joint readings around an instant, as a parabola through three readings.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Motion {
    joints: JointAngles,
    rate: JointAngles,
    acceleration: JointAngles,
}

impl Motion {
    /// The joints as they were read, without motion.
    pub fn still(joints: JointAngles) -> Self {
        let rest = vec![0.0; joints.len()];
        Self { joints, rate: rest.clone(), acceleration: rest }
    }

    /// The motion at the second of three readings, of which the first and the last may be unknown. Readings out of order are ignored.
    pub fn at_reading(before: Option<&Reading>, now: &Reading, after: Option<&Reading>) -> Self {
        match (before.filter(|before| before.0 < now.0), after.filter(|after| now.0 < after.0)) {
            (Some(before), Some(after)) => Self::between(before, now, after),
            (Some(a), None) => Self::straight(a, now, &now.1),
            (None, Some(b)) => Self::straight(now, b, &now.1),
            (None, None) => Self::still(now.1.clone()),
        }
    }

    /// Motion at a constant rate, from `joints` on.
    fn straight(a: &Reading, b: &Reading, joints: &[f64]) -> Self {
        let rate = a.1.iter().zip(&b.1).map(|(a_rad, b_rad)| (b_rad - a_rad) / (b.0 - a.0)).collect();
        Self { rate, ..Self::still(joints.to_vec()) }
    }

    fn between(before: &Reading, now: &Reading, after: &Reading) -> Self {
        let (a, b) = (now.0 - before.0, after.0 - now.0);
        let readings = before.1.iter().zip(&now.1).zip(&after.1);
        let slopes = readings.map(|((before, now), after)| ((now - before) / a, (after - now) / b));
        let (rate, acceleration) =
            slopes.map(|slope| ((slope.0 * b + slope.1 * a) / (a + b), 2.0 * (slope.1 - slope.0) / (a + b))).unzip();
        Self { joints: now.1.clone(), rate, acceleration }
    }

    /// The readings this much later.
    pub fn at(&self, later_s: f64) -> JointAngles {
        let part = |rate: f64, acceleration: f64| later_s * (rate + 0.5 * later_s * acceleration);
        self.terms().map(|[joint, rate, acceleration]| joint + part(rate, acceleration)).collect()
    }

    /// How fast the readings change this much later, per second.
    pub fn rate_at(&self, later_s: f64) -> JointAngles {
        self.terms().map(|[_, rate, acceleration]| rate + later_s * acceleration).collect()
    }

    /// Reading, rate and acceleration of each joint.
    fn terms(&self) -> impl Iterator<Item = [f64; 3]> {
        let terms = self.joints.iter().zip(&self.rate).zip(&self.acceleration);
        terms.map(|((joint, rate), acceleration)| [*joint, *rate, *acceleration])
    }
}

/// A measured point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sighted {
    /// In the camera's frame, metres.
    pub point: na::Point3<f64>,
    /// Standard deviation, metres.
    pub sigma_m: f64,
}

/// An instant that is used for calibration.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Instant {
    pub motion: Motion,
    /// Points of each camera.
    pub sighted: Vec<Vec<Sighted>>,
}

/// Pixels are taken from a lattice of this spacing; more would be neighbours with common errors.
const SPACING_PX: usize = 4;
/// A pixel whose neighbours this far away are much nearer or farther lies at an edge, where depth frays.
const EDGE_PX: usize = 3;
/// Greater differences of depth over that distance are edges, metres.
const EDGE_M: f32 = 0.01;
/// Standard deviation of depth, metres per square metre of depth: that of `slam.scan.camera_sigma_per_m2`.
const SIGMA_PER_M2: f64 = 0.0041;
/// Standard deviation of a point across its ray and of the hand's model, metres.
const SIGMA_M: f64 = 0.0008;

/// Returns up to `count` points of a depth image (metres, 0 where nothing was measured) that are not at edges and for which `keeps` is
/// true, spread evenly over the image.
pub(crate) fn sight(
    depth_m: &Array2<f32>,
    intrinsics: &Intrinsics,
    count: usize,
    shift: usize,
    keeps: impl Fn(&na::Point3<f64>) -> bool,
) -> Vec<Sighted> {
    let (height, width) = depth_m.dim();
    let is_measured = |z: f32| z > 0.0 && z.is_finite();
    let mut found = Vec::new();
    for v in (EDGE_PX + shift % SPACING_PX..height.saturating_sub(EDGE_PX)).step_by(SPACING_PX) {
        for u in (EDGE_PX + (shift / SPACING_PX) % SPACING_PX..width.saturating_sub(EDGE_PX)).step_by(SPACING_PX) {
            let z = depth_m[(v, u)];
            if !is_measured(z) {
                continue;
            }
            let around = [(v - EDGE_PX, u), (v + EDGE_PX, u), (v, u - EDGE_PX), (v, u + EDGE_PX)].map(|at| depth_m[at]);
            if around.iter().any(|&other| !is_measured(other) || (other - z).abs() > EDGE_M) {
                continue;
            }
            let point = na::Point3::from(intrinsics.unproject(u as f64, v as f64, f64::from(z)).coords());
            if keeps(&point) {
                let sigma_m = (SIGMA_PER_M2 * f64::from(z).powi(2)).hypot(SIGMA_M);
                found.push(Sighted { point, sigma_m });
            }
        }
    }
    spread(&found, count)
}

/// Returns up to `count` points; every nth of a list in the order of the image is spread evenly over it.
pub(crate) fn spread(points: &[Sighted], count: usize) -> Vec<Sighted> {
    let count = count.min(points.len());
    let every = points.len() as f64 / count.max(1) as f64;
    (0..count).filter_map(|k| points.get((k as f64 * every) as usize).copied()).collect()
}
