//! Pads in the coordinates of gaits: those of the right hand, whose mirror image a left hand plays.

use mvt_frames::{Gel, Pad};
use mvt_gaits::gait::right_ranges;
use mvt_robot::hand::{Hand, JointAngles, PartSurface, Primitive};
use nalgebra as na;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// Damping of the inverse of a pad's Jacobian, metres per radian.
const DAMPING_M: f64 = 0.01;
/// Postures that are tried for a pad, and steps of the descent from the best of them.
const TRIES: usize = 4000;
const STEPS: usize = 300;
/// Metres that a gel may lie off its target for a normal that is off by one radian.
const METRES_PER_RADIAN: f64 = 0.02;

/// Returns the joints that a pad moves with, each with its place along the chain and its index, but for those that an earlier pad has.
pub(crate) fn own_joints(hand: &Hand, pad: usize) -> impl Iterator<Item = (usize, usize)> {
    let is_taken = move |j: &usize| (0..pad).any(|earlier| hand.pad_chain(earlier).contains(j));
    hand.pad_chain(pad).iter().copied().enumerate().filter(move |(_, j)| !is_taken(j))
}

/// Returns the joints of all pads, each with its name in parameters, PAD_PLACE, and its index.
pub(crate) fn named_joints(hand: &Hand) -> impl Iterator<Item = (String, usize)> {
    let named =
        move |pad: usize| own_joints(hand, pad).map(move |(k, j)| (format!("{}_{k}", hand.pads()[pad].name), j));
    (0..hand.pads().len()).flat_map(named)
}

/// Returns the apex of a pad's gel in the world, metres, and the gel's outward normal there.
pub(crate) fn gel(hand: &Hand, pad: usize, joints: &[f64]) -> (na::Point3<f64>, na::Vector3<f64>) {
    let body =
        hand.world_from_pads(&hand.mirrored(joints)).get(pad).map_or(na::Isometry3::identity(), |pad| pad.untyped());
    let (apex, normal) = apex_on_body(hand, pad);
    let (mut point, mut outward) = (body * apex, body * normal);
    point.y *= hand.side().sign();
    outward.y *= hand.side().sign();
    (point, outward)
}

/// Returns the change of the gel's apex per radian of each joint of the pad's chain, metres.
pub(crate) fn jacobian(hand: &Hand, pad: usize, joints: &[f64]) -> na::Matrix3xX<f64> {
    const STEP_RAD: f64 = 1e-5;
    let moved = |j: usize, by: f64| {
        let mut joints = joints.to_vec();
        if let Some(angle) = joints.get_mut(j) {
            *angle += by;
        }
        gel(hand, pad, &joints).0.coords
    };
    let column = |&j: &usize| (moved(j, STEP_RAD) - moved(j, -STEP_RAD)) / (2.0 * STEP_RAD);
    from_columns(&hand.pad_chain(pad).iter().map(column).collect::<Vec<_>>())
}

/// Returns the matrix of these columns, of which there may be none.
pub(crate) fn from_columns(columns: &[na::Vector3<f64>]) -> na::Matrix3xX<f64> {
    na::Matrix3xX::from_fn(columns.len(), |axis, k| columns[k][axis])
}

/// Returns the damped inverse of a pad's Jacobian.
pub(crate) fn damped_inverse(jacobian: &na::Matrix3xX<f64>) -> na::MatrixXx3<f64> {
    let damped = jacobian * jacobian.transpose() + na::Matrix3::identity() * DAMPING_M * DAMPING_M;
    // The damping makes it positive definite; angles that are not finite cause no motion.
    let inverse = damped.try_inverse().unwrap_or_else(na::Matrix3::zeros);
    jacobian.transpose() * inverse
}

/// Returns the joint angles that are nearest to 0.
pub(crate) fn rest(hand: &Hand) -> JointAngles {
    right_ranges(hand).iter().map(|[low, high]| 0.0_f64.clamp(*low, *high)).collect()
}

/// Moves the joints of a pad so that the apex of its gel comes to `target` and looks along `outward`, as near as they can.
pub(crate) fn reach(
    hand: &Hand,
    pad: usize,
    joints: &mut JointAngles,
    target: &na::Vector3<f64>,
    outward: &na::Vector3<f64>,
) {
    let ranges = right_ranges(hand);
    let own: Vec<usize> = own_joints(hand, pad).map(|(_, j)| j).collect();
    let cost = |joints: &[f64]| {
        let (apex, normal) = gel(hand, pad, joints);
        let turned = normal.dot(outward).clamp(-1.0, 1.0).acos();
        (apex.coords - target).norm_squared() + (METRES_PER_RADIAN * turned).powi(2)
    };
    let mut rng = ChaCha8Rng::seed_from_u64(pad as u64);
    let mut best = (cost(joints), joints.clone());
    for _ in 0..TRIES {
        let mut tried = joints.clone();
        own.iter().for_each(|&j| tried[j] = rng.random_range(ranges[j][0]..=ranges[j][1]));
        let reached = cost(&tried);
        if reached < best.0 {
            best = (reached, tried);
        }
    }
    // A random walk whose steps shrink: the posture need not be exact.
    for step in 0..STEPS {
        let share = 0.1 * (1.0 - step as f64 / STEPS as f64);
        let mut tried = best.1.clone();
        for &j in &own {
            let [low, high] = ranges[j];
            tried[j] = (tried[j] + share * (high - low) * rng.random_range(-1.0..=1.0)).clamp(low, high);
        }
        let reached = cost(&tried);
        if reached < best.0 {
            best = (reached, tried);
        }
    }
    *joints = best.1;
}

/// Returns the point of a pad's gel that lies farthest along the outward axis of its sensor, and that axis, both on its body.
fn apex_on_body(hand: &Hand, pad: usize) -> (na::Point3<f64>, na::Vector3<f64>) {
    let Some(touch) = hand.pads().get(pad) else { return (na::Point3::origin(), na::Vector3::x()) };
    let place = touch.place.isometry::<Gel, Pad>().untyped();
    let outward = place.rotation * na::Vector3::x();
    let parts = hand.bodies().get(touch.body).map_or(&[][..], |body| &body.parts);
    let gel = parts.iter().find(|part| part.surface == PartSurface::Gel(pad));
    // A pad without a gel touches where its sensor is.
    let apex = gel.map_or(place.translation.vector, |gel| farthest(&gel.shape, &outward));
    (apex.into(), outward)
}

/// Returns the middle of the points of a primitive that lie farthest in a direction.
fn farthest(shape: &Primitive, direction: &na::Vector3<f64>) -> na::Vector3<f64> {
    let turn = |[w, x, y, z]: [f64; 4]| na::UnitQuaternion::from_quaternion(na::Quaternion::new(w, x, y, z));
    match shape {
        Primitive::Box { centre, half, orientation_wxyz } => {
            let turn = turn(*orientation_wxyz);
            // Along a face the whole face lies farthest.
            let along = turn.inverse_transform_vector(direction).map(|d| if d.abs() < 1e-6 { 0.0 } else { d.signum() });
            na::Vector3::from(*centre) + turn * na::Vector3::from(*half).component_mul(&along)
        }
        Primitive::Ellipsoid { centre, semi, orientation_wxyz } => {
            let (turn, semi) = (turn(*orientation_wxyz), na::Vector3::from(*semi));
            let along = semi.component_mul(&turn.inverse_transform_vector(direction));
            na::Vector3::from(*centre) + turn * semi.component_mul(&(along / along.norm()))
        }
        Primitive::Capsule { from, to, radius } => {
            let (from, to) = (na::Vector3::from(*from), na::Vector3::from(*to));
            let lead = (to - from).dot(direction);
            let end = if lead.abs() < 1e-9 {
                (from + to) / 2.0
            } else if lead > 0.0 {
                to
            } else {
                from
            };
            end + direction * *radius
        }
        Primitive::Hull(hull) => {
            let corners = || hull.vertices().iter().map(|corner| na::Vector3::from(*corner));
            let most = corners().map(|corner| corner.dot(direction)).fold(f64::NEG_INFINITY, f64::max);
            // Corners within a micrometre belong to one face.
            let (sum, count) = corners()
                .filter(|corner| corner.dot(direction) > most - 1e-6)
                .fold((na::Vector3::zeros(), 0.0), |(sum, count), corner| (sum + corner, count + 1.0));
            sum / f64::max(count, 1.0)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvt_robot::hand::{Placing, Side};

    fn angles() -> Vec<f64> {
        (0..16).map(|j| 0.3 + 0.03 * f64::from(j)).collect()
    }

    #[test]
    fn a_left_hand_has_the_same_pads_in_the_coordinates_of_gaits() {
        let [left, right] = [Side::Left, Side::Right].map(Hand::allegro);
        for pad in 0..4 {
            let (l, r) = (gel(&left, pad, &angles()), gel(&right, pad, &angles()));
            assert!((l.0 - r.0).norm() < 1e-12 && (l.1 - r.1).norm() < 1e-12, "{pad}");
            let difference = jacobian(&left, pad, &angles()) - jacobian(&right, pad, &angles());
            assert!(difference.norm() < 1e-9, "{pad}");
        }
        assert_eq!(apex_on_body(&right, 2).0.coords.as_slice(), [0.0201, 0.0, 0.0165]);
    }

    #[test]
    fn a_joint_of_two_pads_belongs_to_the_first_and_a_pad_without_joints_has_none() {
        let mut description = Hand::allegro(Side::Right).description().clone();
        // The second pad moves to the finger of the first, the third to the palm.
        (description.pads[1].body, description.pads[2].body) = (4, 0);
        let hand = Hand::new(description).unwrap();
        let names: Vec<String> = named_joints(&hand).map(|(name, _)| name).collect();
        assert_eq!(names.len(), 8);
        assert_eq!((names[0].as_str(), names[4].as_str()), ("index_0", "thumb_0"));
        let inverse = damped_inverse(&jacobian(&hand, 2, &angles()));
        assert_eq!((inverse.nrows(), (inverse * na::Vector3::x()).len()), (0, 0));
    }

    #[test]
    fn the_apex_lies_on_the_surface_of_any_gel() {
        let mut description = Hand::allegro(Side::Right).description().clone();
        let tip = description.pads[0].body;
        let half = std::f64::consts::FRAC_1_SQRT_2;
        // The sensor looks along y.
        description.pads[0].place = Placing { position_m: [0.0; 3], orientation_wxyz: [half, 0.0, 0.0, half] };
        let corner = |k: usize| [k & 1, k >> 1 & 1, k >> 2 & 1].map(|bit| 0.02 * bit as f64 - 0.01);
        let hull = mvt_robot::hand::Hull::of(&(0..8).map(corner).collect::<Vec<_>>()).unwrap();
        for shape in [
            Primitive::Box { centre: [0.0; 3], half: [0.03, 0.01, 0.02], orientation_wxyz: [1.0, 0.0, 0.0, 0.0] },
            Primitive::Ellipsoid {
                centre: [0.0; 3],
                semi: [0.01, 0.02, 0.03],
                orientation_wxyz: [half, 0.0, 0.0, half],
            },
            Primitive::Capsule { from: [0.0, 0.004, 0.0], to: [0.0, -0.02, 0.0], radius: 0.006 },
            Primitive::Hull(hull),
        ] {
            description.bodies[tip].parts[1].shape = shape.clone();
            let hand = Hand::new(description.clone()).unwrap();
            let (apex, outward) = apex_on_body(&hand, 0);
            assert!((apex.coords - na::Vector3::new(0.0, 0.01, 0.0)).norm() < 1e-7, "{shape:?}: {apex}");
            assert!((outward - na::Vector3::y()).norm() < 1e-12);
        }
    }
}
