//! Objects that are held in the air: the place that a rehearsal shows to the controller, and how the object is held.

use mvt_frames::{Isometry, Object as ObjectFrame, World as WorldFrame};
use mvt_gaits::feedback::RehearsedPlace;
use mvt_objects::object::Object;
use mvt_robot::hand::Hand;
use nalgebra as na;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::start::floor_m;

/// Errors of a place that a rehearsal shows, along each axis, metres, one standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaceErrors {
    /// Error of its own in each frame.
    pub noise_m: f64,
    /// Error that changes within two seconds or so, as that of a growing model does.
    pub drift_m: f64,
}

impl Default for PlaceErrors {
    fn default() -> Self {
        Self { noise_m: 0.001, drift_m: 0.0015 }
    }
}

/// Shows the true place with errors, and as late as a run shows the estimate: the place at a frame arrives a step after the next
/// frame.
#[derive(Debug, Clone)]
pub struct Rehearsal {
    errors: PlaceErrors,
    rng: ChaCha8Rng,
    drift_m: na::Vector3<f64>,
    /// The place of the last frame.
    latest: Option<RehearsedPlace>,
    /// The place of the frame before it, which arrives with the next step.
    arriving: Option<RehearsedPlace>,
    /// The last place that arrived.
    shown: Option<RehearsedPlace>,
}

impl Rehearsal {
    /// Starts; `seed` decides the errors.
    pub fn new(errors: PlaceErrors, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // Apart from the numbers of the start, which has the same seed.
        rng.set_stream(1);
        Self { errors, rng, drift_m: na::Vector3::zeros(), latest: None, arriving: None, shown: None }
    }

    /// Makes an integration step, at a frame with its time, seconds, and the true pose. Returns the place that arrives.
    pub fn step(&mut self, frame: Option<(f64, Isometry<ObjectFrame, WorldFrame>)>) -> Option<RehearsedPlace> {
        let arrived = self.arriving.take();
        self.shown = arrived.or(self.shown);
        if let Some((time_s, pose)) = frame {
            let place = self.look(time_s, pose);
            self.arriving = self.latest.replace(place);
        }
        arrived
    }

    /// Returns the last place that arrived.
    pub fn shown(&self) -> Option<RehearsedPlace> {
        self.shown
    }

    /// Returns the object's place as it is seen at a frame.
    fn look(&mut self, time_s: f64, pose: Isometry<ObjectFrame, WorldFrame>) -> RehearsedPlace {
        /// Share of the drift that stays from frame to frame: half is forgotten in 1.4 s.
        const KEPT: f64 = 0.983;
        let PlaceErrors { noise_m, drift_m } = self.errors;
        let fresh = self.normal() * (drift_m * (1.0 - KEPT * KEPT).sqrt());
        self.drift_m = self.drift_m * KEPT + fresh;
        let noise = self.normal() * noise_m;
        RehearsedPlace::new(time_s, pose, self.drift_m + noise)
    }

    /// Draws standard normal numbers, as sums of uniform ones.
    fn normal(&mut self) -> na::Vector3<f64> {
        na::Vector3::from_fn(|_, _| (0..12).map(|_| self.rng.random::<f64>()).sum::<f64>() - 6.0)
    }
}

/// How an object was held in the air, from the hand-over to the end.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct AirOutcome {
    /// Least height of the object's lowest point over the palm, millimetres; over a plane 100 mm below the grasp for a hand without a palm.
    pub least_height_mm: f64,
    /// Share of the time in which something else than fingertips touched the object.
    pub touched_beside_tips: f64,
    /// Net rotation about x, y and z of the world, radians.
    pub net_rad: [f64; 3],
    /// Time at which the hand began to lower the object, because its place was unknown, seconds; `None` if it did not.
    pub lowered_at_s: Option<f64>,
}

impl std::fmt::Display for AirOutcome {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { least_height_mm, touched_beside_tips, net_rad: [x, y, z], lowered_at_s } = self;
        write!(
            f,
            "in the air it was at least {least_height_mm:.0} mm over the palm, touched by more than fingertips {:.1} % of the time, \
             and turned by {x:.1}, {y:.1} and {z:.1} rad about x, y and z",
            100.0 * touched_beside_tips
        )?;
        lowered_at_s.map_or(Ok(()), |time_s| write!(f, "; lowered to the palm after {time_s:.1} s"))
    }
}

impl AirOutcome {
    /// Least height at which an object is in the air, millimetres.
    pub const IN_AIR_MM: f64 = 30.0;
}

/// Statistics of an object in the air, added step by step.
#[derive(Debug, Clone)]
pub struct AirTally {
    /// Corners of the collision shape.
    corners: Vec<na::Point3<f64>>,
    /// Height of the palm, metres.
    floor_m: f64,
    steps: u64,
    beside: u64,
    least_height_m: f64,
    rotation: Option<na::UnitQuaternion<f64>>,
    net: na::Vector3<f64>,
}

impl AirTally {
    /// Starts with no step of a hand at these joint angles.
    pub fn new(object: &Object, hand: &Hand, joints: &[f64]) -> Self {
        let corners = object.collision.iter().flatten().map(|v| na::Point3::from(v.to_array().map(f64::from)));
        Self {
            corners: corners.collect(),
            floor_m: floor_m(hand, joints),
            steps: 0,
            beside: 0,
            least_height_m: f64::INFINITY,
            rotation: None,
            net: na::Vector3::zeros(),
        }
    }

    /// Adds a step.
    pub fn add(&mut self, pose: Isometry<ObjectFrame, WorldFrame>, is_touched_beside: bool) {
        let pose = pose.untyped();
        let height = |corner: &na::Point3<f64>| (pose * corner).z - self.floor_m;
        self.least_height_m = self.corners.iter().map(height).fold(self.least_height_m, f64::min);
        let last = self.rotation.replace(pose.rotation).unwrap_or(pose.rotation);
        self.net += (pose.rotation * last.inverse()).scaled_axis();
        self.steps += 1;
        self.beside += u64::from(is_touched_beside);
    }

    /// Returns the outcome of the steps that were added.
    pub fn outcome(&self, lowered_at_s: Option<f64>) -> AirOutcome {
        AirOutcome {
            least_height_mm: if self.steps > 0 { 1e3 * self.least_height_m } else { 0.0 },
            touched_beside_tips: self.beside as f64 / self.steps.max(1) as f64,
            net_rad: self.net.into(),
            lowered_at_s,
        }
    }
}
