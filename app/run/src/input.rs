//! From percepts of the hand to the measurements of mvt-slam, which knows no hand.

use std::sync::Arc;

use mvt_frames::depth::TouchDepth;
use mvt_frames::{Isometry, Obstacle, World};
use mvt_robot::hand::Hand;
use mvt_robot::hand::solid::HandSamples;
use mvt_robot::observation::Percept;
use mvt_slam::Obstacles;
use mvt_slam::scan::Measurement;

use crate::source::Modality;

/// Spacing of the points that stand for the volume of the hand while the shape grows, metres: that of the cells they fall into.
const MAP_SPACING_M: f64 = 0.0025;
/// Spacing of points inside the hand that bound a known shape, metres. Coarser than the map's: they only push.
const KNOWN_SPACING_M: f64 = 0.005;
/// Chooses the places of a map's points; which of them are used does not matter.
const MAP_SEED: u64 = 7;

/// The hand as obstacles of an estimator that learns the shape.
pub fn map_obstacles(hand: &Arc<Hand>) -> Obstacles {
    obstacles(&HandSamples::new(hand, MAP_SPACING_M, MAP_SEED))
}

/// The hand as obstacles of an estimator that knows the shape.
pub fn known_obstacles(hand: &Arc<Hand>, seed: u64) -> Obstacles {
    obstacles(&HandSamples::new(hand, KNOWN_SPACING_M, seed))
}

fn obstacles(samples: &HandSamples) -> Obstacles {
    Obstacles::new(samples.bodies().map(<[_]>::to_vec))
}

/// The hand's part of a measurement.
#[derive(Debug, Clone)]
pub struct Input {
    touch: Vec<Option<TouchDepth>>,
    obstacles: Vec<Isometry<Obstacle, World>>,
}

impl Input {
    /// Poses pads and links by the joint angles, and turns indentation of each gel into depth.
    pub fn new(hand: &Hand, percept: &Percept) -> Self {
        let joints = &percept.joints;
        let poses = hand.world_from_touch_cameras(joints).into_iter().zip(hand.world_from_pads(joints));
        let pads = percept.touch.iter().zip(hand.gel_views().iter()).zip(poses);
        let touch = pads.map(|((press, gel), (world_from_camera, world_from_pad))| {
            let press = press.as_ref()?;
            Some(TouchDepth {
                intrinsics: *gel.camera(),
                world_from_camera,
                world_from_pad,
                depth_m: gel.depth_of(&press.indentation_mm)?,
                contact: press.contact.clone(),
                sigma_m: 1e-3 * press.sigma_mm,
            })
        });
        Self { touch: touch.collect(), obstacles: HandSamples::body_poses(hand, joints) }
    }

    /// The measurement of the percept that this was made of, with the sensors of a modality.
    pub fn measured<'a>(&'a self, percept: &'a Percept, modality: Modality) -> Measurement<'a> {
        Measurement {
            time_s: percept.time_s,
            cameras: if modality.has_vision() { &percept.cameras } else { &[] },
            touch: if modality.has_touch() { &self.touch } else { &[] },
            obstacles: &self.obstacles,
        }
    }
}
