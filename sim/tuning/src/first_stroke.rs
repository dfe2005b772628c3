//! A stroke to start a search from, for a hand that no controller was made for.

use mvt_gaits::axis::TurnAxis;
use mvt_gaits::gait::{Gait, right_ranges};
use mvt_objects::object::Object;
use mvt_robot::hand::{Hand, JointAngles, Side};
use nalgebra as na;

use crate::pads::{gel, own_joints, reach, rest};
use crate::stroke::{self, StrokeParameters};

/// Distance by which an open hand stays away from the object, metres.
const OPEN_M: f64 = 0.025;
/// Amplitudes of the stroke along the object and into it, metres.
const ALONG_M: f64 = 0.012;
const PRESS_M: f64 = 0.006;

/// Makes a stroke of a hand for an object that stands on its palm, or hangs between its pads: each pad stands around the object at half its
/// height, looks at it, and moves along it in one direction while it presses; neighbours take turns. It holds few objects as it is.
pub fn first_stroke(hand: &Hand, object: &Object, axis: TurnAxis) -> Gait {
    let [length, width, height] = object.extents_m();
    let radius = 0.25 * (length + width);
    let mut middle = hand.grasp_centre(&[]).map_or_else(na::Vector3::zeros, mvt_frames::Point::coords);
    middle.y *= hand.side().sign();
    if let Some([_, _, palm]) = hand.palm_centre_m() {
        middle.z = palm + 0.5 * height;
    }
    let (mut pose, mut open_pose) = (rest(hand), rest(hand));
    let mut params = StrokeParameters::from([
        ("period_s".to_owned(), 1.2),
        ("tilt_rad".to_owned(), if hand.palm_centre_m().is_some() { 0.15 } else { 0.0 }),
        ("roll_rad".to_owned(), 0.0),
        ("torque_nm".to_owned(), 0.3),
        ("x_m".to_owned(), middle.x),
        ("y_m".to_owned(), middle.y),
    ]);
    let along = axis.direction(Side::Right);
    for (pad, touch) in hand.pads().iter().enumerate() {
        let inward = inward(hand, pad, &middle);
        reach(hand, pad, &mut pose, &(middle - inward * radius), &inward);
        reach(hand, pad, &mut open_pose, &(middle - inward * (radius + OPEN_M)), &inward);
        params.extend(own_joints(hand, pad).map(|(k, j)| (format!("pose_{}_{k}", touch.name), pose[j])));
        // Neighbours take turns.
        let turn = if pad % 2 == 0 { 1.0 } else { -1.0 };
        let tangent = along.cross(&-inward);
        let [sine, cosine] = [tangent * ALONG_M * turn, inward * PRESS_M * turn];
        for (wave, displacement) in [("sin", sine), ("cos", cosine)] {
            let axes = ["x", "y", "z"].into_iter().zip(displacement.iter());
            params.extend(axes.map(|(a, metres)| (format!("{wave}_{}_{a}", touch.name), *metres)));
        }
    }
    stroke::gait(&params, hand, open_pose, axis, "a first stroke, computed from the hand and the object")
}

/// Returns the horizontal direction from a pad to the middle, where the pad is on average.
fn inward(hand: &Hand, pad: usize, middle: &na::Vector3<f64>) -> na::Vector3<f64> {
    let ranges = right_ranges(hand);
    let at = |share: f64| -> JointAngles { ranges.iter().map(|[low, high]| low + share * (high - low)).collect() };
    let mean =
        [0.25, 0.5, 0.75].into_iter().map(|share| gel(hand, pad, &at(share)).0.coords).sum::<na::Vector3<f64>>() / 3.0;
    let mut way = middle - mean;
    way.z = 0.0;
    way.try_normalize(1e-6).unwrap_or_else(na::Vector3::x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pads_of_the_allegro_stand_around_the_object_and_look_at_it() {
        let hand = Hand::allegro(Side::Right);
        let object = mvt_objects::catalogue::load("cube70", &mut Vec::new()).unwrap();
        let gait = first_stroke(&hand, &object, TurnAxis::PlusZ);
        let middle = na::Vector3::new(-0.0475, 0.0, 0.0111 + 0.035);
        let mean: Vec<f64> = (0..16).map(|j| gait.table.iter().map(|row| row[j]).sum::<f64>() / 32.0).collect();
        for pad in 0..4 {
            let (apex, normal) = gel(&hand, pad, &mean);
            let way = middle - apex.coords;
            let off = normal.dot(&way.normalize()).acos().to_degrees();
            assert!((0.02..0.07).contains(&way.norm()) && off < 60.0, "pad {pad}: {} m, {off} degrees", way.norm());
            // The open hand is farther away.
            let open = (gel(&hand, pad, &gait.open_pose).0.coords - middle).norm();
            assert!(open > way.norm() + 0.01, "pad {pad}: {open}");
        }
        assert_eq!(first_stroke(&hand, &object, TurnAxis::PlusZ), gait, "it is the same each time");
    }
}
