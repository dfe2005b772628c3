//! Strokes of one hand, carried over to another.

use mvt_gaits::gait::Gait;
use mvt_robot::hand::Hand;
use nalgebra as na;

use crate::pads::{gel, own_joints, reach, rest};
use crate::stroke::{self, StrokeParameters};

/// Carries a gait of the hand `of` over to another hand: each pad moves over the palm as the pad of the same name does on `of`, as near as
/// its joints can. `None` if a pad has no namesake, or a hand has no palm.
pub fn carried_over(gait: &Gait, of: &Hand, to: &Hand) -> Option<Gait> {
    let palms = [of, to].map(|hand| hand.palm_centre_m().map(na::Vector3::from));
    let shift = palms[1]? - palms[0]?;
    let mean = stroke::mean_pose(gait, of);
    let theirs = stroke::parameters_of(gait, of);
    // What moves the pads stays as it is, but for the joints.
    let mut params: StrokeParameters =
        theirs.into_iter().filter(|(name, _)| !name.starts_with("pose_") && !is_wave_of_no_pad(name, to)).collect();
    for (name, along) in [("x_m", shift.x), ("y_m", shift.y)] {
        *params.entry(name.to_owned()).or_default() += along;
    }
    let (mut pose, mut open_pose) = (rest(to), rest(to));
    for (pad, touch) in to.pads().iter().enumerate() {
        let namesake = of.pads().iter().position(|other| other.name == touch.name)?;
        for (joints, reached) in [(&mean, &mut pose), (&gait.open_pose, &mut open_pose)] {
            let (apex, outward) = gel(of, namesake, joints);
            reach(to, pad, reached, &(apex.coords + shift), &outward);
        }
        params.extend(own_joints(to, pad).map(|(k, j)| (format!("pose_{}_{k}", touch.name), pose[j])));
    }
    Some(stroke::gait(&params, to, open_pose, gait.axis, &format!("carried over from a stroke of {}", of.name())))
}

/// Returns whether a parameter is a displacement of a pad that the hand does not have.
fn is_wave_of_no_pad(parameter: &str, hand: &Hand) -> bool {
    let is_wave = parameter.starts_with("sin_") || parameter.starts_with("cos_");
    is_wave
        && hand.pads().iter().all(|pad| {
            parameter.get(4..).and_then(|rest| rest.strip_suffix(['x', 'y', 'z'])) != Some(&format!("{}_", pad.name))
        })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use mvt_robot::hand::Side;

    /// The right Allegro without its ring finger, 20 mm higher.
    fn three_fingers() -> Arc<Hand> {
        let mut of = Hand::allegro(Side::Right).description().clone();
        of.bodies.drain(11..16);
        of.joints.drain(8..12);
        of.pads.remove(2);
        of.apart.clear();
        for joint in &mut of.joints[8..] {
            joint.body -= 5;
        }
        for body in &mut of.bodies[11..] {
            body.parent = body.parent.map(|parent| if parent > 10 { parent - 5 } else { parent });
            for part in &mut body.parts {
                if let mvt_robot::hand::PartSurface::Gel(pad) = &mut part.surface {
                    *pad = 2;
                }
            }
        }
        of.pads[2].body -= 5;
        of.bodies[0].place.position_m[2] += 0.02;
        of.palm_centre_m = of.palm_centre_m.map(|[x, y, z]| [x, y, z + 0.02]);
        Hand::new(of).unwrap()
    }

    #[test]
    fn pads_move_over_the_palm_as_their_namesakes() {
        let (allegro, hand) = (Hand::allegro(Side::Right), three_fingers());
        let gait = &mvt_gaits::gait::shipped()["cube"];
        let carried = carried_over(gait, &allegro, &hand).unwrap();
        assert!(carried.params.keys().all(|name| !name.contains("ring")), "{:?}", carried.params);
        assert_eq!((carried.period_s, carried.gravity.len(), carried.axis), (gait.period_s, 3, gait.axis));
        for (pad, namesake) in [(0, 0), (1, 1), (2, 3)] {
            let off = |row: usize| {
                let [ours, theirs] = [gel(&hand, pad, &carried.table[row]), gel(&allegro, namesake, &gait.table[row])];
                (ours.0.coords - theirs.0.coords - na::Vector3::new(0.0, 0.0, 0.02)).norm()
            };
            // A stroke is the first harmonic of a gait, whose pads move by 20 mm and more.
            let mean = (0..gait.table.len()).map(off).sum::<f64>() / gait.table.len() as f64;
            assert!(mean < 0.008, "pad {pad}: {mean} m");
        }
        let mut stranger = hand.description().clone();
        stranger.pads[0].name = "little".to_owned();
        assert_eq!(carried_over(gait, &allegro, &Hand::new(stranger).unwrap()), None);
        assert_eq!(carried_over(gait, &allegro, &Hand::none()), None);
    }
}
