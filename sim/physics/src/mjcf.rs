//! The MuJoCo model of one episode as MJCF text.
//!
//! The text contains all randomised quantities, so that a compiled model is never edited. In a compiled model, MuJoCo's
//! `geom_sameframe` would move a mesh geom together with a changed centre of mass.

use std::fmt::Write as _;

use mvt_objects::object::Object;
use mvt_robot::hand;
use mvt_robot::hand::{Body, Finger, JOINTS_PER_FINGER, Part, PartSurface, Primitive, Side};
use nalgebra as na;

/// Name of the object's body and of its free joint.
pub const OBJECT: &str = "object";

/// Physical quantities of one episode.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Physics {
    /// Integration step, seconds.
    pub timestep_s: f64,
    /// Gravity in the world, m/s^2. It is tilted towards the fingertips, because the hand is fixed.
    pub gravity: [f64; 3],
    /// Sliding friction between gel and object.
    pub gel_friction: f64,
    /// Sliding friction between the object and all other parts.
    pub link_friction: f64,
    /// Stiffness of the joints' position controllers, Nm/rad.
    pub joint_stiffness: f64,
    /// Largest joint torque, Nm.
    pub torque_limit: f64,
    /// Mass of the object, kg.
    pub object_mass_kg: f64,
    /// Centre of mass of the object in its own frame, relative to that of its uniform solid, metres.
    pub com_offset_m: [f64; 3],
}

/// First part of the model: joints, and how each kind of surface touches.
pub(crate) const HEADER: &str = r#"<mujoco model="mambavitact">
<compiler angle="radian" autolimits="true"/>
<default>
<joint damping="0.1" armature="0.001" frictionloss="0.01" limited="true"/>
<default class="link"><geom contype="2" conaffinity="1" condim="3" density="0"/></default>
<default class="digit"><geom contype="6" conaffinity="5" condim="3" density="0"/></default>
<default class="gel"><geom contype="2" conaffinity="1" condim="4" priority="2" density="0" solref="0.015 1" solimp="0.5 0.95 0.0015 0.5 2"/></default>
<default class="object"><geom contype="1" conaffinity="2" condim="3" density="0"/></default>
</default>
"#;

/// Returns the model of the hand and the object. The free joint of the object sets its pose.
pub fn model(side: Side, object: &Object, physics: &Physics) -> String {
    let mut xml = String::from(HEADER);
    let [gx, gy, gz] = physics.gravity;
    // Elliptic cones with impratio 10 are essential: with MuJoCo's defaults a static grasp creeps by 12 to 60 mm/s.
    // Writing to a String cannot fail.
    let _ = writeln!(
        xml,
        r#"<option timestep="{}" gravity="{gx} {gy} {gz}" integrator="implicitfast" cone="elliptic" impratio="10" iterations="30" ls_iterations="20" tolerance="1e-7"><flag autoreset="disable"/></option>"#,
        physics.timestep_s
    );
    xml.push_str("<asset>\n");
    for (i, piece) in object.collision.iter().enumerate() {
        let _ = write!(xml, r#"<mesh name="piece{i}" maxhullvert="64" vertex=""#);
        for v in piece {
            let _ = write!(xml, "{} {} {} ", v.x, v.y, v.z);
        }
        xml.push_str("\"/>\n");
    }
    xml.push_str("</asset>\n<worldbody>\n");
    hand_bodies(&mut xml, side, physics);
    object_body(&mut xml, object, physics);
    xml.push_str("</worldbody>\n<contact>\n");
    for finger in Finger::ALL {
        let (tip, link) = (Body::Tip(finger).name(), Body::Link(finger, 2).name());
        let _ = writeln!(xml, r#"<exclude body1="{tip}" body2="{link}"/>"#);
    }
    xml.push_str("</contact>\n<actuator>\n");
    for name in joint_names() {
        let (kp, limit) = (physics.joint_stiffness, physics.torque_limit);
        let _ = writeln!(
            xml,
            r#"<position name="{name}" joint="{name}" kp="{kp}" forcerange="-{limit} {limit}" inheritrange="1"/>"#
        );
    }
    xml.push_str("</actuator>\n</mujoco>\n");
    xml
}

/// Returns the names of the joints and actuators, in the order of [`JointAngles`](hand::JointAngles).
pub fn joint_names() -> impl Iterator<Item = String> {
    Finger::ALL.into_iter().flat_map(|f| (0..JOINTS_PER_FINGER).map(move |k| Body::Link(f, k).name()))
}

/// Returns the name of the gel geom of a finger.
pub fn gel_geom(finger: Finger) -> String {
    format!("{}_gel", finger.prefix())
}

fn hand_bodies(xml: &mut String, side: Side, physics: &Physics) {
    let parts = hand::parts(side);
    let [w, x, y, z] = hand::world_from_base().quaternion_wxyz();
    let _ = writeln!(xml, r#"<body name="{}" quat="{w} {x} {y} {z}">"#, Body::Palm.name());
    body_content(xml, side, Body::Palm, &parts, physics);
    for finger in Finger::ALL {
        for k in 0..JOINTS_PER_FINGER {
            let body = Body::Link(finger, k);
            let joint = hand::joint(side, finger, k);
            let ([px, py, pz], [w, x, y, z]) = (joint.origin_m, joint.orientation_wxyz);
            let ([ax, ay, az], [low, high]) = (joint.axis, joint.range_rad);
            let name = body.name();
            let _ = writeln!(
                xml,
                r#"<body name="{name}" pos="{px} {py} {pz}" quat="{w} {x} {y} {z}" gravcomp="1"><joint name="{name}" axis="{ax} {ay} {az}" range="{low} {high}"/>"#
            );
            body_content(xml, side, body, &parts, physics);
        }
        let tip = Body::Tip(finger);
        let _ = writeln!(xml, r#"<body name="{}" pos="0 0 {}" gravcomp="1">"#, tip.name(), hand::tip_offset_m(finger));
        body_content(xml, side, tip, &parts, physics);
        xml.push_str(&"</body>".repeat(JOINTS_PER_FINGER + 1));
        xml.push('\n');
    }
    xml.push_str("</body>\n");
}

fn body_content(xml: &mut String, side: Side, body: Body, parts: &[Part], physics: &Physics) {
    let hand::Inertial { mass_kg, centre_m: [x, y, z], diagonal: [ix, iy, iz] } = hand::inertial(side, body);
    let _ = writeln!(xml, r#"<inertial pos="{x} {y} {z}" mass="{mass_kg}" diaginertia="{ix} {iy} {iz}"/>"#);
    for part in parts.iter().filter(|part| part.body == body) {
        let link = format!("{} 0.002 0.0001", physics.link_friction);
        let (class, friction, name) = match (part.surface, body) {
            // With torsional friction, the gel twists an object that it touches in one point.
            (PartSurface::Gel, Body::Tip(finger)) => {
                ("gel", format!("{} 0.004 0.0001", physics.gel_friction), format!(r#" name="{}""#, gel_geom(finger)))
            }
            (PartSurface::Digit, _) => ("digit", link, String::new()),
            _ => ("link", link, String::new()),
        };
        let _ = write!(xml, r#"<geom{name} class="{class}" friction="{friction}" "#);
        let _ = match part.shape {
            Primitive::Box { centre: [x, y, z], half: [a, b, c] } => {
                writeln!(xml, r#"type="box" pos="{x} {y} {z}" size="{a} {b} {c}"/>"#)
            }
            Primitive::Ellipsoid { centre: [x, y, z], semi: [a, b, c] } => {
                writeln!(xml, r#"type="ellipsoid" pos="{x} {y} {z}" size="{a} {b} {c}"/>"#)
            }
            Primitive::Capsule { from: [a, b, c], to: [d, e, f], radius } => {
                writeln!(xml, r#"type="capsule" fromto="{a} {b} {c} {d} {e} {f}" size="{radius}"/>"#)
            }
        };
    }
}

fn object_body(xml: &mut String, object: &Object, physics: &Physics) {
    let (centre, inertia) = object.solid_inertia(physics.object_mass_kg);
    let c = centre + na::Vector3::from(physics.com_offset_m);
    let i = inertia;
    let _ = writeln!(
        xml,
        r#"<body name="{OBJECT}"><freejoint name="{OBJECT}"/><inertial pos="{} {} {}" mass="{}" fullinertia="{} {} {} {} {} {}"/>"#,
        c.x,
        c.y,
        c.z,
        physics.object_mass_kg,
        i[(0, 0)],
        i[(1, 1)],
        i[(2, 2)],
        i[(0, 1)],
        i[(0, 2)],
        i[(1, 2)]
    );
    for i in 0..object.collision.len() {
        let _ = writeln!(
            xml,
            r#"<geom class="object" type="mesh" mesh="piece{i}" friction="{} 0.002 0.0001"/>"#,
            physics.link_friction
        );
    }
    xml.push_str("</body>\n");
}
