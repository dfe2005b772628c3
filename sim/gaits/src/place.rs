//! Places of an object in the air, and feedback on them.

use mvt_frames::{Isometry, Model, Object as ObjectFrame, Point, World};
use mvt_robot::hand::JointAngles;
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

// Why: notes/decisions/simulation.md, "Feedback in the air is linear in displacement, velocity and summed displacement".
/// Feedback of a gait on the place of the object, for the right hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlaceFeedback {
    /// Place of the object's middle when it is handed over, in the world, metres.
    pub place_m: [f64; 3],
    /// Turn of the object about the vertical when it is handed over, radians. Without it any turn is drawn.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub yaw_rad: Option<f64>,
    /// Joint angles at which the fingers aim when they close around the object, radians. The table swings around them.
    pub grasp: JointAngles,
    /// Joint angles at which the fingertips touch the object. With them the fingers press by force and not by angle: where they are
    /// stopped, each joint aims as far ahead as `grasp` lies ahead of this, so that objects of all sizes are held alike.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub touching: Option<JointAngles>,
    /// Change of each joint's target per displacement of the object, along x, y and z of the world, rad/m.
    pub gains: Vec<[f64; 3]>,
    /// Change of each joint's target per velocity of the object, along x, y and z of the world, rad per m/s.
    pub damping: Vec<[f64; 3]>,
    /// Change of each joint's target per displacement of the object summed over time, along x, y and z of the world, rad per
    /// m s. It lifts heavy objects.
    pub lift: Vec<[f64; 3]>,
    /// Joint angles through which the hand lowers the object to the palm if its place is unknown, one per second, radians.
    pub lowering: Vec<JointAngles>,
}

impl PlaceFeedback {
    /// Returns all numbers.
    pub(crate) fn numbers(&self) -> impl Iterator<Item = &f64> {
        let rates = self.gains.iter().chain(&self.damping).chain(&self.lift).flatten();
        self.place_m.iter().chain(&self.yaw_rad).chain(rates).chain(self.poses().flatten())
    }

    /// Returns the joint angles of all poses.
    pub(crate) fn poses(&self) -> impl Iterator<Item = &JointAngles> {
        [&self.grasp].into_iter().chain(&self.touching).chain(&self.lowering)
    }
}

/// Estimated place of the object at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EstimatedPlace(pub(crate) SeenPlace);

/// True place of the object at an instant, with errors like those of an estimate. The controller of a run never receives
/// it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RehearsedPlace(pub(crate) SeenPlace);

/// Place of the object in the world as a controller sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeenPlace {
    /// Seconds since the start of the episode.
    pub time_s: f64,
    /// The object's middle, metres.
    pub middle_m: Vector3<f64>,
    /// Turn from the object's axes, or those of its estimated model, to the world's.
    pub orientation: UnitQuaternion<f64>,
    /// How far the estimate is to be trusted, 0 to 1.
    pub confidence: f64,
}

impl EstimatedPlace {
    /// Returns the place of a point of the estimated model at a time, seconds since the start of the episode, with full confidence.
    pub fn new(time_s: f64, pose: Isometry<Model, World>, middle: Point<Model>) -> Self {
        let orientation = pose.untyped().rotation;
        Self(SeenPlace { time_s, middle_m: (pose * middle).coords(), orientation, confidence: 1.0 })
    }

    /// Returns the place with a confidence, 0 to 1.
    #[must_use]
    pub fn trusted(self, confidence: f64) -> Self {
        Self(SeenPlace { confidence, ..self.0 })
    }

    /// Returns the place with its time counted from `start_s`, seconds.
    #[must_use]
    pub fn counted_from(self, start_s: f64) -> Self {
        Self(SeenPlace { time_s: self.0.time_s - start_s, ..self.0 })
    }

    /// Returns the place.
    pub fn seen(&self) -> SeenPlace {
        self.0
    }
}

impl RehearsedPlace {
    /// Returns the place of the object's origin with an error, metres, at a time, seconds since the start of the episode.
    pub fn new(time_s: f64, pose: Isometry<ObjectFrame, World>, error_m: Vector3<f64>) -> Self {
        let (middle_m, orientation) = (pose.origin().coords() + error_m, pose.untyped().rotation);
        Self(SeenPlace { time_s, middle_m, orientation, confidence: 1.0 })
    }

    /// Returns the place.
    pub fn seen(&self) -> SeenPlace {
        self.0
    }
}
