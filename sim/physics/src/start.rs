//! Starts of episodes: the drawn physical quantities and the initial state.

use mvt_frames::{Isometry, Object as ObjectFrame, World as WorldFrame};
use mvt_gaits::clock::PHYSICS_HZ;
use mvt_gaits::gait::Gait;
use mvt_objects::object::Object;
use mvt_robot::hand::{Hand, JointAngles};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::mjcf::Physics;

/// Ranges of the differences between a start and the nominal one. Every quantity is drawn independently.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Randomisation {
    /// Relative change of each friction coefficient, uniform in +- this.
    pub friction: f64,
    /// Factor of the mass: up to 1 + this, or its inverse, log-uniform.
    pub mass: f64,
    /// Shift of the centre of mass along each axis, metres, uniform in +- this.
    pub centre_of_mass_m: f64,
    /// Relative change of the joints' stiffness, uniform in +- this.
    pub stiffness: f64,
    /// Shift of the start along x and y, metres, uniform in +- this.
    pub position_m: f64,
    /// Yaw of the start, radians, uniform in +- this.
    pub yaw_rad: f64,
    /// Change of each joint's start angle, radians, uniform in +- this.
    pub joints_rad: f64,
}

impl Default for Randomisation {
    fn default() -> Self {
        Self {
            friction: 0.15,
            mass: 0.49,
            centre_of_mass_m: 0.004,
            stiffness: 0.05,
            position_m: 0.008,
            yaw_rad: std::f64::consts::PI,
            joints_rad: 0.03,
        }
    }
}

impl Randomisation {
    /// Returns zero ranges, which give the nominal start.
    pub fn none() -> Self {
        Self {
            friction: 0.0,
            mass: 0.0,
            centre_of_mass_m: 0.0,
            stiffness: 0.0,
            position_m: 0.0,
            yaw_rad: 0.0,
            joints_rad: 0.0,
        }
    }
}

/// Nominal friction of the gel: with that of the links, the middle of the range in which all starts of the tuning study
/// survived.
const GEL_FRICTION: f64 = 1.05;
/// Nominal friction of palm, links and object. Higher values stop the object on the palm.
const LINK_FRICTION: f64 = 0.35;
/// Start height of the object's lowest point above the palm, metres: 4 mm.
const START_HEIGHT_M: f64 = 0.0039;
/// Depth below the grasp at which heights begin for a hand without a palm, metres: as deep as an object of 20 cm reaches.
const NO_PALM_M: f64 = 0.1;
/// Shift of a place at which an object is handed over, relative to that of a start on the palm: 2 mm by default.
const HAND_OVER_SHARE: f64 = 0.25;
/// Turn of an object that is handed over at a given turn, relative to that of a start on the palm: 5 degrees by default.
const HAND_OVER_TURN_SHARE: f64 = 0.03;

/// Drawn start: the physical quantities of the model and the initial state.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct EpisodeStart {
    /// Physical quantities of the model.
    pub physics: Physics,
    /// Initial joint angles, radians.
    pub joints: JointAngles,
    /// Initial pose of the object.
    pub object: Isometry<ObjectFrame, WorldFrame>,
}

impl EpisodeStart {
    /// Draws a start. With the same seed, the starts of the left and the right hand are mirror images. A hand without a palm gets the middle
    /// of the object to its grasp.
    pub fn draw(object: &Object, gait: &Gait, hand: &Hand, randomisation: &Randomisation, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut within = |amplitude: f64| amplitude * rng.random_range(-1.0..=1.0);
        let r = randomisation;
        let mirror = hand.side().sign();
        let gel_friction = GEL_FRICTION * (1.0 + within(r.friction));
        let link_friction = LINK_FRICTION * (1.0 + within(r.friction));
        let object_mass_kg = object.mass_kg * within((1.0 + r.mass).ln()).exp();
        let [cx, cy, cz] = std::array::from_fn(|_| within(r.centre_of_mass_m));
        let stiffness_factor = 1.0 + within(r.stiffness);
        let shift = [within(r.position_m), within(r.position_m)];
        let drawn = within(r.yaw_rad);
        let given = gait.feedback.as_ref().and_then(|feedback| feedback.yaw_rad);
        let yaw = mirror * given.map_or(drawn, |yaw| yaw + drawn * HAND_OVER_TURN_SHARE);
        let open = |j: usize| gait.open_pose.get(j).copied().unwrap_or(0.0);
        let right: JointAngles = (0..hand.joints().len()).map(|j| open(j) + within(r.joints_rad)).collect();
        let joints = hand.within_ranges(&hand.mirrored(&right));
        let heights = || object.mesh.vertices.iter().map(|v| v.z);
        let lowest = Some(heights().fold(f32::INFINITY, f32::min)).filter(|z| z.is_finite()).map_or(0.0, f64::from);
        let highest = heights().fold(lowest as f32, f32::max);
        let height = match hand.palm_centre_m() {
            Some([.., palm]) => palm + START_HEIGHT_M - lowest,
            None => floor_m(hand, &joints) + NO_PALM_M - (lowest + f64::from(highest)) / 2.0,
        };
        let [x, y, z] = match &gait.feedback {
            None => [gait.start_xy_m[0] + shift[0], gait.start_xy_m[1] + shift[1], height],
            Some(feedback) => {
                let [x, y, z] = feedback.place_m;
                let [dx, dy] = shift.map(|metres| metres * HAND_OVER_SHARE);
                [x + dx, y + dy, z + within(r.position_m) * HAND_OVER_SHARE]
            }
        };
        Self {
            physics: Physics {
                timestep_s: 1.0 / f64::from(PHYSICS_HZ),
                gravity: gait.gravity_on(hand.side()),
                gel_friction,
                link_friction,
                stiffness_factor,
                torque_limit: gait.torque_limit_nm,
                object_mass_kg,
                com_offset_m: [cx, mirror * cy, cz],
            },
            joints,
            object: Isometry::from_parts([x, mirror * y, z], [(yaw / 2.0).cos(), 0.0, 0.0, (yaw / 2.0).sin()]),
        }
    }
}

/// Returns the height from which those of objects are counted, metres in the world: that of the palm's surface, or of a plane below the
/// grasp.
pub(crate) fn floor_m(hand: &Hand, joints: &[f64]) -> f64 {
    let grasp = || hand.grasp_centre(joints).map_or(0.0, |centre| centre.coords().z) - NO_PALM_M;
    hand.palm_centre_m().map_or_else(grasp, |[.., z]| z)
}
