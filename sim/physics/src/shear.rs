//! How an object drags the gels of the pads along.
//!
//! The gel is a spring between pad and object, as bristles are in Dahl's model of friction: where the object sticks, the surface of the gel
//! moves with it; once the spring pulls as strongly as friction can hold, the object slides. The motion of the object, the normal force and
//! friction are those of MuJoCo, whose own gel is rigid along its surface.

// Why: notes/decisions/touch.md, "The gel is a spring between MuJoCo's object and pad".

use mvt_frames::{Gel, Isometry, Object, World};
use mvt_robot::digit::markers::GelShear;
use mvt_robot::hand::{Hand, PerPad};
use nalgebra as na;

use crate::simulation::PadContact;

/// Shear modulus of a silicone of 15 Shore A, of which the gel of a DIGIT is cast, pascals: a third of Young's modulus by Gent's formula (1958).
const SHEAR_MODULUS_PA: f64 = 1.9e5;
/// Radius of curvature of the gel's contact surface, metres: the mean of 18 and 30 mm, as a product.
const CURVATURE_M: f64 = 0.023;

/// Returns the radius of the contact with a flat object that a force presses onto the gel, metres: a^3 = 3 F R / (4 E*) by Hertz, with
/// E* = E / (1 - nu^2) = 4 G for a material that keeps its volume.
fn contact_radius_m(force_n: f64) -> f64 {
    (3.0 * force_n.max(0.0) * CURVATURE_M / (16.0 * SHEAR_MODULUS_PA)).cbrt()
}

/// Returns the stiffness of a gel along its surface while a force presses it, N/m: 8 G a / (2 - nu) with nu = 1/2 (Mindlin 1949).
pub fn stiffness_n_per_m(force_n: f64) -> f64 {
    16.0 / 3.0 * SHEAR_MODULUS_PA * contact_radius_m(force_n)
}

/// Returns the stiffness against a turn about the normal, Nm/rad: 16/3 G a^3 (Reissner and Sagoci 1944).
pub fn stiffness_nm_per_rad(force_n: f64) -> f64 {
    16.0 / 3.0 * SHEAR_MODULUS_PA * contact_radius_m(force_n).powi(3)
}

/// Shear of all gels of a hand, step by step.
#[derive(Debug, Clone, PartialEq)]
pub struct GelShears {
    shear: PerPad<GelShear>,
    /// Pose of the object at each gel, one step ago.
    before: Option<PerPad<Isometry<Object, Gel>>>,
}

impl GelShears {
    /// Starts with gels at rest.
    pub fn new(hand: &Hand) -> Self {
        Self { shear: hand.per_pad(|_| GelShear::default()), before: None }
    }

    /// Returns the shear of each gel.
    pub fn shear(&self) -> &PerPad<GelShear> {
        &self.shear
    }

    /// Adds one integration step, after which hand, object and contacts are these.
    pub fn step(&mut self, hand: &Hand, joints: &[f64], object: Isometry<Object, World>, pads: &PerPad<PadContact>) {
        let world_from_gels = hand.world_from_gels(joints);
        let now: PerPad<_> = world_from_gels.iter().map(|gel| gel.inverse() * object).collect();
        let before = self.before.replace(now.clone()).unwrap_or_else(|| now.clone());
        let poses = world_from_gels.iter().zip(before.iter().zip(&now));
        for (shear, (pad, (world_from_gel, (before, now)))) in self.shear.iter_mut().zip(pads.iter().zip(poses)) {
            let touched = world_from_gel.untyped().inverse_transform_point(&pad.point_m.into());
            let motion = now.untyped() * before.untyped().inverse();
            *shear = if pad.is_touching() { dragged(*shear, &motion, touched, pad) } else { GelShear::default() };
        }
    }
}

/// Returns the shear after the object has moved in the gel frame by `motion`, which took it to the touched point.
fn dragged(shear: GelShear, motion: &na::Isometry3<f64>, touched: na::Point3<f64>, pad: &PadContact) -> GelShear {
    let slip = touched - motion.inverse_transform_point(&touched);
    // Right in the image is -y of the gel, down is -z.
    let moved = [shear.displacement_mm[0] - 1e3 * slip.y, shear.displacement_mm[1] - 1e3 * slip.z];
    let most_mm = 1e3 * pad.friction_limit_n / stiffness_n_per_m(pad.force_n).max(1e-9);
    let kept = (most_mm / moved[0].hypot(moved[1]).max(1e-12)).min(1.0);
    let most_rad = pad.torsion_limit_nm / stiffness_nm_per_rad(pad.force_n).max(1e-12);
    GelShear {
        displacement_mm: moved.map(|x| kept * x),
        twist_rad: (shear.twist_rad + motion.rotation.scaled_axis().x).clamp(-most_rad, most_rad),
    }
}

#[cfg(test)]
mod tests {
    use mujoco_rs::prelude::*;

    use super::*;
    use crate::mjcf::HEADER;

    /// A plate that a motor presses onto the gel with 1 N and a servo drags along y, in the gel frame.
    fn plate_on_gel() -> MjData<Box<MjModel>> {
        const DRIVE: &str = r#"damping="0.1" armature="0.001" frictionloss="0.01""#;
        let xml = format!(
            r#"{HEADER}<option timestep="{}" gravity="0 0 0" integrator="implicitfast" cone="elliptic" impratio="10"/>
<worldbody><geom name="gel" class="gel" friction="0.9 0.004 0.0001" type="ellipsoid" pos="0.0132 0 -0.001" size="0.009 0.0128 0.0165"/>
<body pos="0.0325 0 0"><joint name="x" type="slide" axis="1 0 0" limited="false" {DRIVE}/>
<joint name="y" type="slide" axis="0 1 0" limited="false" {DRIVE}/>
<geom class="object" type="box" size="0.01 0.04 0.04" mass="0.1" friction="0.9 0.002 0.0001"/></body></worldbody>
<actuator><motor joint="x"/><position joint="y" kp="5000" dampratio="1"/></actuator></mujoco>"#,
            1.0 / f64::from(mvt_gaits::clock::PHYSICS_HZ)
        );
        MjData::new(Box::new(MjModel::from_xml_string(&xml).unwrap()))
    }

    fn correlation(pairs: &[[f64; 2]]) -> f64 {
        let mean = |k: usize| pairs.iter().map(|pair| pair[k]).sum::<f64>() / pairs.len() as f64;
        let means = [mean(0), mean(1)];
        let moment =
            |i: usize, j: usize| -> f64 { pairs.iter().map(|pair| (pair[i] - means[i]) * (pair[j] - means[j])).sum() };
        moment(0, 1) / (moment(0, 0) * moment(1, 1)).sqrt()
    }

    /// Back and forth by 8 mm: the gel follows the plate until friction gives way, then pulls as hard as MuJoCo's friction.
    #[test]
    fn a_dragged_gel_agrees_with_mujoco_in_slip_and_force() {
        let mut data = plate_on_gel();
        let gel = data.model().name_to_id(MjtObjBase::mjOBJ_GEOM, "gel").unwrap();
        let (mut shear, mut before) = (GelShear::default(), [0.0; 2]);
        let (mut forces, mut stuck_steps, mut slid) = (Vec::new(), 0, Vec::new());
        for k in 0..1500 {
            // From 0 to 4 mm, to -4 mm and back at 8 mm/s, in 2 s.
            let way = f64::from((k.max(150) - 150 + 150) % 600) / 300.0;
            data.ctrl_mut().copy_from_slice(&[-1.0, 0.004 * if way < 1.0 { 2.0 * way - 1.0 } else { 3.0 - 2.0 * way }]);
            data.step();
            let mut pad = PadContact::default();
            for (i, contact) in data.contact().iter().enumerate() {
                pad.add(contact, data.try_contact_force(i).unwrap(), gel);
            }
            pad.point_m = pad.point_m.map(|sum| sum / pad.force_n.max(1e-9));
            let now = [data.qpos()[0], data.qpos()[1]];
            let moved = na::Isometry3::translation(now[0] - before[0], now[1] - before[1], 0.0);
            before = now;
            if !pad.is_touching() {
                continue;
            }
            let last = shear;
            shear = dragged(shear, &moved, pad.point_m.into(), &pad);
            if k < 150 {
                continue;
            }
            assert!((pad.force_n - 1.0).abs() < 0.1, "the plate is pressed with {} N", pad.force_n);
            // Right in the image is -y.
            let [gel_n, friction_n] =
                [-1e-3 * shear.displacement_mm[0] * stiffness_n_per_m(pad.force_n), pad.friction_n[1]];
            assert!(shear.displacement_mm[1].abs() < 1e-9 && shear.twist_rad == 0.0);
            forces.push([gel_n, friction_n]);
            if gel_n.abs() < 0.999 * pad.friction_limit_n {
                stuck_steps += 1;
                let followed_mm = last.displacement_mm[0] - shear.displacement_mm[0];
                assert!((followed_mm - 1e3 * moved.translation.y).abs() < 1e-9);
            } else if gel_n.signum() * moved.translation.y > 1e-5 {
                // Slower than 3 mm/s, MuJoCo lets the plate creep below the limit.
                slid.push((gel_n - friction_n).abs() / pad.friction_limit_n);
            }
        }
        assert!(stuck_steps > 100 && slid.len() > 300, "{stuck_steps} and {} steps", slid.len());
        let off = slid.iter().sum::<f64>() / slid.len() as f64;
        assert!(off < 0.03, "while it slides, the gel pulls {:.1} % beside MuJoCo's friction", 100.0 * off);
        let agreement = correlation(&forces);
        assert!(agreement > 0.9, "{agreement}");
    }

    #[test]
    fn a_turned_gel_follows_until_torsion_gives_way() {
        let pad = PadContact {
            force_n: 1.0,
            penetration_m: 1e-3,
            point_m: [0.022, 0.003, -0.002],
            friction_limit_n: 0.9,
            torsion_limit_nm: 0.004,
            ..PadContact::default()
        };
        // About the contact itself: no displacement.
        let touched = na::Point3::from(pad.point_m);
        let turn = na::UnitQuaternion::from_scaled_axis(na::Vector3::new(0.1, 0.0, 0.0));
        let motion = na::Isometry3::rotation_wrt_point(turn, touched);
        let mut shear = GelShear::default();
        for step in 1..=10 {
            shear = dragged(shear, &motion, touched, &pad);
            let most = 0.004 / stiffness_nm_per_rad(1.0);
            assert!((shear.twist_rad - (0.1 * f64::from(step)).min(most)).abs() < 1e-12);
            assert!(shear.displacement_mm[0].hypot(shear.displacement_mm[1]) < 1e-12);
        }
    }
}
