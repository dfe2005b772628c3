//! Pose and shape from measurements alone, and the belief that directs the hand.

use std::fmt;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use clap::ValueEnum;
use glam::Vec3;
use mvt_field::exact::KnownShape;
use mvt_frames::{Isometry, Model, Object, Point, World};
use mvt_gaits::feedback::EstimatedPlace;
use mvt_objects::distance::MeshDistance;
use mvt_objects::object::Object as TrueObject;
use mvt_robot::hand::Hand;
use mvt_robot::observation::Percept;
use mvt_slam::map::Map;
use mvt_slam::scan::{Measurement, Scan};
use mvt_slam::{Estimate, SettingError, Slam, SlamBuilder};
use serde::{Deserialize, Serialize};

use crate::input::{self, Input};
use crate::source::Modality;
use nalgebra as na;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::supervisor::Belief;

/// Which of pose and shape are estimated.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// Pose and shape are estimated
    #[default]
    Slam,
    /// The shape is given, the pose is estimated
    Pose,
    /// The pose is given, the shape is estimated
    Map,
}

impl Mode {
    /// Its name on the command line and in results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Slam => "slam",
            Self::Pose => "pose",
            Self::Map => "map",
        }
    }
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Where the pose of a given shape starts.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum Init {
    /// 1 cm and 10 degrees beside the truth, in a direction that the seed decides
    #[default]
    Near,
    /// At the truth
    Truth,
    /// Nowhere: the object is searched for
    Search,
}

impl Init {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Near => "near",
            Self::Truth => "truth",
            Self::Search => "search",
        }
    }

    /// The start, where the truth is this.
    pub fn start(self, truth: Isometry<Object, World>, seed: u64) -> Option<Isometry<Model, World>> {
        const DISTANCE_M: f64 = 0.01;
        const ANGLE_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;
        let truth = truth.untyped();
        match self {
            Self::Search => None,
            Self::Truth => Some(Isometry::new(truth)),
            Self::Near => {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                Some(Isometry::new(truth * random_motion(DISTANCE_M, ANGLE_RAD, &mut rng)))
            }
        }
    }
}

/// A move of this length in a random direction with a turn by this angle about a random axis.
pub fn random_motion(distance_m: f64, angle_rad: f64, rng: &mut ChaCha8Rng) -> na::Isometry3<f64> {
    let mut direction = || loop {
        // Uniform over the sphere: the direction of a point of the ball.
        let v = na::Vector3::from_fn(|_, _| rng.random_range(-1.0..=1.0));
        if (1e-3..=1.0).contains(&v.norm()) {
            return v.normalize();
        }
    };
    let shift = distance_m * direction();
    let turn = na::UnitQuaternion::new(angle_rad * direction());
    na::Isometry3::from_parts(shift.into(), turn)
}

/// A shape that is given.
pub struct Given {
    shape: KnownShape,
    /// Lowest and highest corner, metres.
    bounds_m: [Vec3; 2],
}

impl Given {
    /// The shape of an object: exact where it is known exactly, else that of its mesh.
    ///
    /// # Errors
    /// If the mesh bounds nothing.
    pub fn new(object: &TrueObject) -> Result<Self> {
        let bounds_m = object.mesh.bounds_m();
        let shape = match &object.exact {
            Some(exact) => KnownShape::new(exact.as_ref(), bounds_m),
            None => KnownShape::new(&MeshDistance::new(&object.mesh).context("the mesh bounds nothing")?, bounds_m),
        };
        Ok(Self { shape, bounds_m })
    }
}

/// An estimator of mvt-slam with the belief that a supervisor may use.
pub struct Estimator {
    slam: Slam,
    /// Middle of a given shape, metres.
    given_centre: Option<Vec3>,
    last: Option<Isometry<Model, World>>,
    /// Sum of the rotations between frames, about the axes of the world, radians.
    turned_rad: na::Vector3<f64>,
}

impl Estimator {
    /// Knows neither shape nor pose.
    ///
    /// # Errors
    /// If a setting is out of range.
    pub fn new(config: &mvt_slam::SlamConfig, hand: &Arc<Hand>, seed: u64) -> Result<Self, SettingError> {
        Self::with(builder(config, hand, seed).obstacles(input::map_obstacles(hand)), None)
    }

    /// Knows the map of an earlier run, and not the pose.
    ///
    /// # Errors
    /// If a setting is out of range.
    pub fn resume(config: &mvt_slam::SlamConfig, hand: &Hand, seed: u64, map: Map) -> Result<Self, SettingError> {
        Self::with(builder(config, hand, seed).map(map), None)
    }

    /// Knows the shape and roughly, or not at all, the pose.
    ///
    /// # Errors
    /// If a setting is out of range.
    pub fn with_shape(
        config: &mvt_slam::SlamConfig,
        hand: &Arc<Hand>,
        seed: u64,
        Given { shape, bounds_m }: Given,
        start: Option<Isometry<Model, World>>,
    ) -> Result<Self, SettingError> {
        let centre = 0.5 * (bounds_m[0] + bounds_m[1]);
        let builder = builder(config, hand, seed).obstacles(input::known_obstacles(hand, seed));
        Self::with(builder.shape(shape, bounds_m, start), Some(centre))
    }

    fn with(builder: SlamBuilder, given_centre: Option<Vec3>) -> Result<Self, SettingError> {
        Ok(Self { slam: builder.build()?, given_centre, last: None, turned_rad: na::Vector3::zeros() })
    }

    /// Takes the next frame of a hand, with the sensors of a modality.
    pub fn observe(&mut self, hand: &Hand, percept: &Percept, modality: Modality) -> Estimate {
        let scan = self.scan(&Input::new(hand, percept).measured(percept, modality));
        self.step(&scan, None)
    }

    /// Draws the rays of an instant for the next step.
    pub fn scan(&self, measured: &Measurement<'_>) -> Arc<Scan> {
        self.slam.scan(measured)
    }

    /// Returns the pose to which the motion so far leads; see [`Slam::predicted`].
    pub fn predicted(&self, time_s: f64) -> Option<Isometry<Model, World>> {
        self.slam.predicted(time_s)
    }

    /// Returns where the object is in the next frame, without learning from it; see [`Slam::glance`].
    pub fn glance(&self, scan: &Arc<Scan>) -> Option<(Isometry<Model, World>, f64)> {
        self.slam.glance(scan)
    }

    /// Whether the pose of the newest frame is trusted.
    pub fn is_tracking(&self) -> bool {
        self.slam.is_tracking()
    }

    /// The growing shape, where none is given.
    pub fn map(&self) -> Option<&Map> {
        self.slam.map()
    }

    /// Number of frames taken.
    pub fn frames(&self) -> usize {
        self.slam.frames()
    }

    /// Takes the next frame, whose pose is given where only the shape is estimated.
    pub fn step(&mut self, scan: &Arc<Scan>, given_pose: Option<Isometry<Model, World>>) -> Estimate {
        let estimate = match given_pose {
            Some(pose) => self.slam.step_at(scan, pose),
            None => self.slam.step(scan),
        };
        if estimate.state.is_tracking() {
            if let Some(last) = self.last {
                let turn = (estimate.pose.untyped() * last.untyped().inverse()).rotation.scaled_axis();
                self.turned_rad += turn;
            }
            self.last = Some(estimate.pose);
        }
        estimate
    }

    /// The estimated place of the object's middle after a frame, for a controller that needs it; `None` while the object
    /// is lost.
    pub fn place(&self, estimate: &Estimate) -> Option<EstimatedPlace> {
        let known = || self.given_centre.or_else(|| self.map()?.space().ball_middle());
        let centre = estimate.state.is_tracking().then(known)??;
        let middle = Point::from(na::Vector3::from(centre.to_array().map(f64::from)));
        Some(EstimatedPlace::new(estimate.time_s, estimate.pose, middle).trusted(estimate.confidence))
    }

    /// The belief after a frame, for the supervisor.
    pub fn belief(&self, estimate: &Estimate) -> Belief {
        let bounds = |map: &Map| map.space().bounds().map(|[a, b]| 0.5 * (a + b));
        let centre = self.given_centre.or_else(|| self.map().and_then(bounds)).unwrap_or(Vec3::ZERO);
        let centre = estimate.pose.untyped() * na::Point3::from(centre.to_array().map(f64::from));
        Belief {
            time_s: estimate.time_s,
            pose: estimate.pose,
            centre_m: [centre.x, centre.y],
            turned_rad: self.turned_rad,
            confidence: estimate.confidence,
            deviation_m: estimate.deviation.map_or(f64::INFINITY, |deviation| deviation.surface_m),
            lost: !estimate.state.is_tracking(),
            unobserved: self.map().map_or(0.0, |map| map.space().unseen_fraction()),
        }
    }
}

fn builder(config: &mvt_slam::SlamConfig, hand: &Hand, seed: u64) -> SlamBuilder {
    let builder = Slam::builder().config(config.clone()).seed(seed);
    match hand.palm_centre_m() {
        Some([_, _, height_m]) => builder.support(height_m),
        None => builder,
    }
}
