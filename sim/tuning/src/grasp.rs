//! Grasps that hold an object in the air on the fingertips.
//!
//! A try draws a place over the palm, finds joint angles at which the gels touch the object there, and keeps them if fingertips
//! can carry the object at these contacts. Trials in the simulator then show whether the hand holds it after a support is taken away:
//! the fingers close until they are stopped, and press from there with the forces that carry the object.

use std::path::Path;
use std::sync::Arc;

use mvt_files::input;
use mvt_frames::{Isometry, Object as ObjectFrame, Point};
use mvt_gaits::controller_file::{check_hand, hand_model};
use mvt_gaits::feedback::PlaceFeedback;
use mvt_gaits::gait::{Gait, right_ranges};
use mvt_mesh::SignedDistance as _;
use mvt_objects::distance::MeshDistance;
use mvt_objects::object::Object;
use mvt_physics::episode::{EpisodeStart, Randomisation};
use mvt_physics::simulation::{Simulation, SimulationError};
use mvt_robot::hand::{Hand, JointAngles};
use nalgebra as na;
use rand::seq::IndexedRandom as _;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::air;
use crate::equilibrium::{self, Contact};
use crate::pads::{self, damped_inverse, from_columns, jacobian, named_joints, own_joints};
use crate::search::SearchError;
use crate::seeds;
use crate::stroke;
use crate::trial::EPISODE_STEPS;

/// A grasp that held an object in the air, in the coordinates of gaits: those of the right hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grasp {
    /// Place of the object's origin in the world, metres.
    pub place_m: [f64; 3],
    /// Turn of the object about the vertical, radians.
    pub yaw_rad: f64,
    /// Joint angles from which the fingers close, radians.
    pub open_pose: JointAngles,
    /// Joint angles at which the gels touch the object, radians.
    pub touching: JointAngles,
    /// Joint angles at which the fingers aim to press with the forces that carry the object, radians.
    pub grasp: JointAngles,
    /// Mean number of pads that touched the object in the trials.
    pub pads: f64,
    /// Share of the trials' time in which something else than fingertips touched the object.
    pub touched_beside_tips: f64,
}

/// Content of a file of grasps of one object, the best first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraspFile {
    /// Version of the format, [`GRASP_FORMAT`].
    pub format: u32,
    /// Name of the hand.
    pub hand: String,
    /// Checksum of the hand, [`hand_model`].
    pub model: String,
    /// Name of the object.
    pub object: String,
    /// The grasps.
    pub grasps: Vec<Grasp>,
}

/// Version of the format.
pub const GRASP_FORMAT: u32 = 1;
/// Largest file that is read, bytes.
const LARGEST_FILE: u64 = 16 << 20;

/// Places of an object that all fingertips over a palm reach from several sides, metres from the grasp.
const PLACES_M: [[f64; 2]; 3] = [[0.0325, 0.0725], [-0.022, 0.012], [0.0419, 0.0699]];
/// Places of an object in a hand without a palm, metres from the grasp along each axis.
const AROUND_M: [f64; 2] = [-0.02, 0.02];
/// Starts of the search for joint angles, per pad.
const STARTS: usize = 20;
/// Sets of contacts that are tried.
const SETS: usize = 100;
/// Depth to which a gel is pressed in by the object at the contact that is aimed at, metres.
const PRESSED_M: f64 = 4e-4;
/// Curvature radius at which a wrong direction counts as a distance, metres.
const RADIUS_M: f64 = 0.01;
/// Error of place and direction together at which a gel touches the object, metres.
const TOUCHING_M: f64 = 0.0015;
/// Depth to which a fingertip is pressed in at most before the fingers close, metres.
const MOST_PRESSED_M: f64 = 0.002;
/// Distance by which a fingertip is away from the object before it closes, metres.
const OPEN_M: f64 = 0.012;
const GRAVITY: f64 = 9.81;
/// Trials of a grasp, all of which must hold the object, and their length, seconds.
const TRIALS: u64 = 4;
const TRIAL_S: f64 = 2.5;

impl GraspFile {
    /// Returns the file of grasps of an object by a hand, sorted.
    pub fn new(object: &Object, hand: &Hand, mut grasps: Vec<Grasp>) -> Self {
        // Housings of the sensors are hard and smooth: what rests on them slips when it is turned.
        grasps.sort_by(|a, b| a.touched_beside_tips.total_cmp(&b.touched_beside_tips).then(b.pads.total_cmp(&a.pads)));
        let (name, model) = (hand.name().to_owned(), hand_model(hand));
        Self { format: GRASP_FORMAT, hand: name, model, object: object.name.clone(), grasps }
    }

    /// Reads a file for a hand.
    ///
    /// # Errors
    /// [`SearchError::File`] if it cannot be read, contains no grasp, or belongs to another hand or model.
    pub fn read(path: &Path, hand: &Hand) -> Result<Self, SearchError> {
        let failed = |reason: String| SearchError::File { path: path.to_owned(), reason };
        let text = input::read_text(path, LARGEST_FILE).map_err(|e| failed(e.to_string()))?;
        let file: Self = toml::from_str(&text)
            .map_err(|e| failed(format!("it is not a file of grasps: {}", e.message().replace('\n', " "))))?;
        file.check(hand).map_err(failed)?;
        Ok(file)
    }

    fn check(&self, hand: &Hand) -> Result<(), String> {
        let Self { format, grasps, .. } = self;
        if *format != GRASP_FORMAT {
            return Err(format!("its format is {format}; this program reads format {GRASP_FORMAT}"));
        }
        check_hand(&self.hand, &self.model, hand)?;
        for Grasp { place_m, yaw_rad, open_pose, touching, grasp, .. } in grasps {
            let joints = hand.joints().len();
            if let Some(pose) = [open_pose, touching, grasp].into_iter().find(|pose| pose.len() != joints) {
                return Err(format!("a grasp is for {} joints; the hand {} has {joints}", pose.len(), hand.name()));
            }
            let mut numbers = place_m.iter().chain([yaw_rad]).chain(open_pose).chain(touching).chain(grasp);
            // Angles in radians and places in metres are all smaller.
            if !numbers.all(|number| number.abs() < 10.0) {
                return Err(
                    "a grasp contains a number that is no angle of a joint and no place over the palm".to_owned()
                );
            }
        }
        if grasps.is_empty() { Err("it contains no grasp".to_owned()) } else { Ok(()) }
    }
}

impl Grasp {
    /// Returns the controller that holds the object by this grasp. Path, gains, lowering, torque and gravity are those of another
    /// controller with feedback; `None` if it has none.
    pub fn gait(&self, from: &Gait, hand: &Hand) -> Option<Gait> {
        let feedback = from.feedback.as_deref()?;
        let mut params = stroke::parameters_of(from, hand);
        let angle = |pose: &JointAngles, j: usize| stroke::rounded(pose.get(j).copied().unwrap_or(0.0));
        for (name, j) in named_joints(hand) {
            params.insert(format!("pose_{name}"), angle(&self.grasp, j));
            params.insert(format!("touching_{name}"), angle(&self.touching, j));
        }
        let place_m = self.place_m.map(stroke::rounded);
        let yaw_rad = Some(stroke::rounded(self.yaw_rad));
        let feedback = Some(Box::new(PlaceFeedback {
            place_m,
            yaw_rad,
            touching: Some(self.touching.clone()),
            ..feedback.clone()
        }));
        let open_pose = self.open_pose.iter().map(|angle| stroke::rounded(*angle)).collect();
        let from = Gait { open_pose, feedback, ..from.clone() };
        air::gait(&params, hand, &from, from.axis, &from.description)
    }
}

/// Result of a try.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Attempt {
    /// The fingertips do not reach the object, or cannot carry it.
    Unbalanced,
    /// Fingertips can carry the object, but it fell in a trial.
    Fell,
    /// It held in all trials.
    Held(Box<Grasp>),
}

/// Makes one try, which the seed and its number decide, with the torque and gravity of a controller with feedback.
///
/// # Errors
/// [`SimulationError`] if MuJoCo refuses the object.
pub fn attempt(
    object: &Object,
    from: &Gait,
    hand: &Arc<Hand>,
    seed: u64,
    number: u64,
) -> Result<Attempt, SimulationError> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(number);
    let physics = EpisodeStart::draw(object, from, hand, &Randomisation::none(), 0).physics;
    let mut simulation = Simulation::new(hand, object, &physics)?;
    let Some(mut grasp) = draw(object, hand, &mut simulation, &mut rng) else { return Ok(Attempt::Unbalanced) };
    let Some(gait) = grasp.gait(&air::still(from, hand), hand) else { return Ok(Attempt::Unbalanced) };
    let (mut pads, mut beside) = (0.0, 0.0);
    for trial in 0..TRIALS {
        let seed = seeds::tuning().at(number.wrapping_mul(TRIALS).wrapping_add(trial));
        let held = air::run(&gait, object, hand, seed, TRIAL_S, EPISODE_STEPS)?.filter(|trial| trial.alive);
        let Some(held) = held else { return Ok(Attempt::Fell) };
        pads += held.pads / TRIALS as f64;
        beside += held.outcome.touched_beside_tips / TRIALS as f64;
    }
    (grasp.pads, grasp.touched_beside_tips) = (pads, beside);
    Ok(Attempt::Held(Box::new(grasp)))
}

/// Draws a place of the object, and joint angles at which fingertips can carry it there. Fingertips that are in each other's way push
/// each other aside when they close.
fn draw(object: &Object, hand: &Hand, simulation: &mut Simulation, rng: &mut ChaCha8Rng) -> Option<Grasp> {
    let mirror = hand.side().sign();
    let place_m = places_m(hand).map(|[low, high]| rng.random_range(low..=high));
    let yaw_rad = rng.random_range(-std::f64::consts::PI..=std::f64::consts::PI);
    let rotation = na::UnitQuaternion::from_axis_angle(&na::Vector3::z_axis(), mirror * yaw_rad);
    let [x, y, z] = place_m;
    let world_from_object = na::Isometry3::from_parts(na::Translation3::new(x, mirror * y, z), rotation);
    let distance = MeshDistance::new(&object.mesh)?;
    let surface = Surface { distance, object_from_world: world_from_object.inverse(), hand };
    let ranges = right_ranges(hand);
    let mut touching = Vec::new();
    for pad in 0..hand.pads().len() {
        let mut found: Vec<Touch> = Vec::new();
        for _ in 0..STARTS {
            let start: JointAngles = ranges.iter().map(|&[low, high]| rng.random_range(low..=high)).collect();
            let Some((touching, contact)) = surface.touch(pad, &start) else { continue };
            let opening = damped_inverse(&jacobian(hand, pad, &touching)) * (contact.normal * -OPEN_M);
            // The other fingers are stretched out below the object.
            let mut poses = [vec![0.0; ranges.len()], vec![0.0; ranges.len()]];
            for (k, j) in own_joints(hand, pad) {
                poses[0][j] = touching[j];
                poses[1][j] = (touching[j] + opening[k]).clamp(ranges[j][0], ranges[j][1]);
            }
            let mut is_free = |joints: &[f64], pressed_m: f64| {
                simulation.reset(&hand.mirrored(joints), Isometry::new(world_from_object));
                simulation.penetration_m() <= pressed_m && !simulation.touches_beside_fingertips()
            };
            if is_free(&poses[0], MOST_PRESSED_M) && is_free(&poses[1], 0.0) {
                let [touching, open] = poses;
                found.push(Touch { pad, touching, open, contact });
            }
        }
        touching.push(found);
    }
    let centre = na::Point3::from(na::Vector3::from(place_m));
    let mut best: Option<(f64, Vec<Touch>, Vec<na::Vector3<f64>>)> = None;
    for _ in 0..SETS {
        // Around most objects the first finger and its neighbour have no room beside each other. Nothing holds without the others.
        let first = usize::from(rng.random_bool(0.3));
        let chosen = touching.iter().skip(first).map(|found| found.choose(rng).cloned());
        let Some(set) = chosen.collect::<Option<Vec<Touch>>>() else { continue };
        let contacts: Vec<Contact> = set.iter().map(|touch| touch.contact).collect();
        let Some(forces) = equilibrium::balance(&contacts, centre, object.mass_kg * GRAVITY) else { continue };
        let sum = forces.iter().map(na::Vector3::norm).sum();
        let is_better = best.as_ref().is_none_or(|(least, ..)| sum < *least);
        if is_better {
            best = Some((sum, set, forces));
        }
    }
    let (_, set, forces) = best?;
    let touching = together(&set, ranges.len(), |touch| &touch.touching);
    let mut grasp = touching.clone();
    for (Touch { pad, .. }, force) in set.iter().zip(&forces) {
        let torques = jacobian(hand, *pad, &touching).transpose() * force;
        for (k, j) in own_joints(hand, *pad) {
            let stiffness = hand.joints()[j].drive.stiffness;
            grasp[j] += if stiffness > 0.0 { torques[k] / stiffness } else { 0.0 };
        }
    }
    let open_pose = together(&set, ranges.len(), |touch| &touch.open);
    Some(Grasp { place_m, yaw_rad, open_pose, touching, grasp, pads: 0.0, touched_beside_tips: 0.0 })
}

/// Returns the ranges of the place of an object along each axis, metres in the world.
fn places_m(hand: &Hand) -> [[f64; 2]; 3] {
    let around = if hand.palm_centre_m().is_some() { PLACES_M } else { [AROUND_M; 3] };
    let centre = hand.grasp_centre(&[]).map_or_else(na::Vector3::zeros, Point::coords);
    // On the right hand.
    let centre = [centre.x, hand.side().sign() * centre.y, centre.z];
    std::array::from_fn(|axis| around[axis].map(|offset| stroke::rounded(centre[axis] + offset)))
}

/// A pad that touches the object; the angles of joints that are not its own are 0.
#[derive(Debug, Clone)]
struct Touch {
    pad: usize,
    touching: JointAngles,
    /// The pad is [`OPEN_M`] away.
    open: JointAngles,
    contact: Contact,
}

/// Returns the joint angles of all pads.
fn together(set: &[Touch], joints: usize, pose: impl Fn(&Touch) -> &JointAngles) -> JointAngles {
    (0..joints).map(|j| set.iter().map(|touch| pose(touch)[j]).sum()).collect()
}

/// Surface of an object at a place, in the coordinates of gaits.
struct Surface<'a> {
    distance: MeshDistance,
    object_from_world: na::Isometry3<f64>,
    hand: &'a Hand,
}

impl Surface<'_> {
    /// Returns the signed distance of a point, metres, and its gradient: both in the world of a right hand.
    fn look(&self, point: na::Point3<f64>) -> (f64, na::Vector3<f64>) {
        /// Step of the difference, metres. Edges are rounded by as much.
        const STEP_M: f64 = 5e-4;
        let at = |offset: na::Vector3<f64>| {
            let mut p = point + offset;
            p.y *= self.hand.side().sign();
            let p = self.object_from_world * p;
            self.distance.distance_m(Point::<ObjectFrame>::new(p.x, p.y, p.z))
        };
        let here = at(na::Vector3::zeros());
        let gradient = na::Vector3::from_fn(|axis, _| at(na::Vector3::ith(axis, STEP_M)) - here) / STEP_M;
        (here, gradient.try_normalize(1e-6).unwrap_or_else(na::Vector3::z))
    }

    /// Returns the error of a pad whose gel should touch with its apex, metres: the distance, and the directions' difference
    /// on a ball of [`RADIUS_M`].
    fn missing(&self, pad: usize, joints: &[f64]) -> na::Vector3<f64> {
        let (apex, normal) = pads::gel(self.hand, pad, joints);
        let (distance_m, outward) = self.look(apex);
        outward * (distance_m + PRESSED_M) + (normal + outward) * RADIUS_M
    }

    /// Moves a pad until its gel touches, by Gauss-Newton. `None` if it does not.
    fn touch(&self, pad: usize, start: &[f64]) -> Option<(JointAngles, Contact)> {
        const ITERATIONS: usize = 18;
        const STEP_RAD: f64 = 1e-4;
        /// Largest change of a joint in one iteration, radians.
        const MOST_RAD: f64 = 0.4;
        let ranges = right_ranges(self.hand);
        let mut joints = start.to_vec();
        for _ in 0..ITERATIONS {
            let missing = self.missing(pad, &joints);
            if missing.norm() < 0.1 * TOUCHING_M {
                break;
            }
            let column = |&j: &usize| {
                let mut moved = joints.clone();
                moved[j] += STEP_RAD;
                (self.missing(pad, &moved) - missing) / STEP_RAD
            };
            let columns: Vec<na::Vector3<f64>> = self.hand.pad_chain(pad).iter().map(column).collect();
            let step = damped_inverse(&from_columns(&columns)) * missing;
            for (&j, step) in self.hand.pad_chain(pad).iter().zip(&step) {
                let [low, high] = ranges[j];
                joints[j] = (joints[j] - step.clamp(-MOST_RAD, MOST_RAD)).clamp(low, high);
            }
        }
        let (point, _) = pads::gel(self.hand, pad, &joints);
        let contact = Contact { point, normal: -self.look(point).1 };
        (self.missing(pad, &joints).norm() < TOUCHING_M).then_some((joints, contact))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvt_gaits::gait;
    use mvt_robot::hand::Side;

    fn right() -> Arc<Hand> {
        Hand::allegro(Side::Right)
    }

    fn file() -> GraspFile {
        let object = mvt_objects::catalogue::load("ball", &mut Vec::new()).unwrap();
        let feedback = gait::find("air_ball").unwrap().1.feedback.clone().unwrap();
        let grasp = |pads: f64, touched_beside_tips: f64| Grasp {
            place_m: feedback.place_m,
            yaw_rad: 0.5,
            open_pose: vec![0.1; 16],
            touching: vec![0.2; 16],
            grasp: vec![0.3; 16],
            pads,
            touched_beside_tips,
        };
        GraspFile::new(&object, &right(), vec![grasp(4.0, 0.5), grasp(2.0, 0.0), grasp(3.0, 0.0)])
    }

    #[test]
    fn places_are_reached_by_all_fingertips() {
        let places = [[-0.015, 0.025], [-0.022, 0.012], [0.098, 0.126]];
        assert_eq!((places_m(&right()), places_m(&Hand::allegro(Side::Left))), (places, places));
    }

    #[test]
    fn grasps_by_fingertips_alone_and_by_most_pads_come_first() {
        let pads: Vec<f64> = file().grasps.iter().map(|grasp| grasp.pads).collect();
        assert_eq!(pads, [3.0, 2.0, 4.0]);
    }

    #[test]
    fn a_file_comes_back_and_what_does_not_fit_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("grasps.toml");
        let text = toml::to_string(&file()).unwrap();
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            GraspFile::read(&path, &right()).map_err(|e| e.to_string())
        };
        assert_eq!(read(&text), Ok(file()));
        let refusal = |from: &str, to: &str| {
            assert!(text.contains(from), "{from}");
            read(&text.replacen(from, to, 1)).unwrap_err()
        };
        assert!(refusal("format = 1", "format = 2").contains("reads format 1"));
        assert!(refusal("allegro_digit", "leap").contains("allegro_digit"));
        assert!(refusal("model = \"", "model = \"0").contains("tune it again"));
        assert!(refusal("yaw_rad = 0.5", "yaw_rad = nan").contains("no angle of a joint"));
        assert!(refusal("yaw_rad = 0.5", "yaw_rad = 1e300").contains("no angle of a joint"));
        assert!(
            refusal("touching = [0.2, ", "touching = [").ends_with("is for 15 joints; the hand allegro_digit has 16")
        );
        let empty = GraspFile { grasps: Vec::new(), ..file() };
        assert!(read(&toml::to_string(&empty).unwrap()).unwrap_err().contains("no grasp"));
        assert!(read("a ball").unwrap_err().contains("not a file of grasps"));
    }

    #[test]
    fn a_grasp_keeps_its_angles_in_the_controller() {
        let from = gait::find("air_ball").unwrap().1;
        let grasp = &file().grasps[0];
        let gait = grasp.gait(&air::still(from, &right()), &right()).unwrap();
        let feedback = gait.feedback.unwrap();
        assert_eq!(
            (feedback.grasp, feedback.touching, gait.open_pose),
            (grasp.grasp.clone(), Some(grasp.touching.clone()), grasp.open_pose.clone())
        );
        assert_eq!(grasp.gait(gait::find("bal").unwrap().1, &right()), None);
    }
}
