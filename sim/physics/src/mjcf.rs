//! The MuJoCo model of one episode as MJCF text.
//!
//! The text contains all randomised quantities, so that a compiled model is never edited. In a compiled model, MuJoCo's
//! `geom_sameframe` would move a mesh geom together with a changed centre of mass.

use std::fmt::Write as _;

use mvt_objects::object::Object;
use mvt_robot::hand::{Body, Hand, Inertial, Joint, JointMotion, Part, PartSurface, Placing, Primitive};
use nalgebra as na;

/// Name of the object's body and of its free joint. No name of a hand has a colon.
pub const OBJECT: &str = "object:";

/// Physical quantities of one episode.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Physics {
    /// Integration step, seconds.
    pub timestep_s: f64,
    // Why: notes/decisions/simulation.md, "Gravity is tilted, not the hand".
    /// Gravity in the world, m/s^2. It is tilted towards the fingertips, because the hand is fixed.
    pub gravity: [f64; 3],
    /// Sliding friction between gel and object.
    pub gel_friction: f64,
    /// Sliding friction between the object and all other parts.
    pub link_friction: f64,
    /// Stiffness of the joints' position controllers, relative to that of their drives.
    pub stiffness_factor: f64,
    /// Largest joint torque, Nm; drives may have a lower limit of their own.
    pub torque_limit: f64,
    /// Mass of the object, kg.
    pub object_mass_kg: f64,
    /// Centre of mass of the object in its own frame, relative to that of its uniform solid, metres.
    pub com_offset_m: [f64; 3],
}

/// First part of the model: how each kind of surface touches.
pub(crate) const HEADER: &str = r#"<mujoco model="mambavitact">
<compiler angle="radian" autolimits="true"/>
<default>
<joint limited="true"/>
<default class="link"><geom contype="2" conaffinity="1" condim="3" density="0"/></default>
<default class="housing"><geom contype="6" conaffinity="5" condim="3" density="0"/></default>
<default class="gel"><geom contype="2" conaffinity="1" condim="4" priority="2" density="0" solref="0.015 1" solimp="0.5 0.95 0.0015 0.5 2"/></default>
<default class="object"><geom contype="1" conaffinity="2" condim="3" density="0"/></default>
</default>
"#;

/// Least limit of a drive's torque that MuJoCo takes, Nm.
const WEAKEST: f64 = 1e-9;

/// Returns the model of the hand and the object. The joints of the hand come first, in their order; the free joint of the object sets its
/// pose.
pub fn model(hand: &Hand, object: &Object, physics: &Physics) -> String {
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
    for (body, Body { parts, .. }) in hand.bodies().iter().enumerate() {
        for (k, part) in parts.iter().enumerate() {
            if let Primitive::Hull(hull) = &part.shape {
                let vertices = numbers(hull.vertices().iter().flatten());
                let _ = writeln!(xml, r#"<mesh name="{}" vertex="{vertices}"/>"#, geom_name(body, k));
            }
        }
    }
    xml.push_str("</asset>\n<worldbody>\n");
    hand_bodies(&mut xml, hand, physics);
    object_body(&mut xml, object, physics);
    xml.push_str("</worldbody>\n<contact>\n");
    for [a, b] in hand.description().apart.iter().map(|pair| pair.map(|body| body_name(hand, body))) {
        let _ = writeln!(xml, r#"<exclude body1="{a}" body2="{b}"/>"#);
    }
    xml.push_str("</contact>\n<actuator>\n");
    for Joint { name, drive, .. } in hand.joints() {
        let kp = drive.stiffness * physics.stiffness_factor;
        let limit = physics.torque_limit.min(drive.torque_limit).max(WEAKEST);
        let _ = writeln!(
            xml,
            r#"<position name="hand:{name}" joint="hand:{name}" kp="{kp}" forcerange="-{limit} {limit}" inheritrange="1"/>"#
        );
    }
    xml.push_str("</actuator>\n</mujoco>\n");
    xml
}

/// Returns the name of a body of the hand. The prefix keeps it apart from the world and the object.
pub(crate) fn body_name(hand: &Hand, body: usize) -> String {
    format!("hand:{}", hand.bodies().get(body).map_or("", |body| &body.name))
}

/// Returns the name of the geom of a body's part, and of the mesh of a hull.
pub(crate) fn geom_name(body: usize, part: usize) -> String {
    format!("part:{body}:{part}")
}

fn numbers<'a>(values: impl IntoIterator<Item = &'a f64>) -> String {
    values.into_iter().map(f64::to_string).collect::<Vec<_>>().join(" ")
}

/// Returns an attribute with an orientation, empty without rotation.
fn turned(orientation_wxyz: &[f64; 4]) -> String {
    let is_upright = orientation_wxyz.iter().skip(1).all(|q| *q == 0.0);
    if is_upright { String::new() } else { format!(r#" quat="{}""#, numbers(orientation_wxyz)) }
}

fn hand_bodies(xml: &mut String, hand: &Hand, physics: &Physics) {
    let mut path: Vec<usize> = Vec::new();
    for (k, body) in hand.bodies().iter().enumerate() {
        // Bodies stand depth first: those that are open and not its parent are complete.
        while path.last() != body.parent.as_ref() && path.pop().is_some() {
            xml.push_str("</body>\n");
        }
        path.push(k);
        let Placing { position_m, orientation_wxyz } = &body.place;
        // What no joint moves needs no compensation.
        let compensated = if hand.chain(k).is_empty() { "" } else { r#" gravcomp="1""# };
        let _ = writeln!(
            xml,
            r#"<body name="{}" pos="{}"{}{compensated}>"#,
            body_name(hand, k),
            numbers(position_m),
            turned(orientation_wxyz)
        );
        if let Some(joint) = hand.joint_of(k).and_then(|j| hand.joints().get(j)) {
            joint_element(xml, joint);
        }
        body_content(xml, k, body, physics);
    }
    xml.push_str(&"</body>\n".repeat(path.len()));
}

fn joint_element(xml: &mut String, joint: &Joint) {
    let Joint { name, motion, axis, range, drive, .. } = joint;
    let motion = match motion {
        JointMotion::Hinge => "hinge",
        JointMotion::Slide => "slide",
    };
    let _ = writeln!(
        xml,
        r#"<joint name="hand:{name}" type="{motion}" axis="{}" range="{}" damping="{}" armature="{}" frictionloss="{}"/>"#,
        numbers(axis),
        numbers(range),
        drive.damping,
        drive.armature,
        drive.friction
    );
}

fn body_content(xml: &mut String, index: usize, body: &Body, physics: &Physics) {
    if let Some(Inertial { mass_kg, centre_m, orientation_wxyz, diagonal }) = &body.inertial {
        let _ = writeln!(
            xml,
            r#"<inertial pos="{}"{} mass="{mass_kg}" diaginertia="{}"/>"#,
            numbers(centre_m),
            turned(orientation_wxyz),
            numbers(diagonal)
        );
    }
    for (k, Part { surface, shape }) in body.parts.iter().enumerate() {
        let (class, friction) = match surface {
            // With torsional friction, the gel twists an object that it touches in one point.
            PartSurface::Gel(_) => ("gel", format!("{} 0.004 0.0001", physics.gel_friction)),
            PartSurface::Housing => ("housing", format!("{} 0.002 0.0001", physics.link_friction)),
            PartSurface::Link => ("link", format!("{} 0.002 0.0001", physics.link_friction)),
        };
        let name = geom_name(index, k);
        let _ = write!(xml, r#"<geom name="{name}" class="{class}" friction="{friction}" "#);
        let placed = |kind: &str, centre: &[f64; 3], orientation: &[f64; 4], size: &[f64; 3]| {
            format!(r#"type="{kind}" pos="{}"{} size="{}"/>"#, numbers(centre), turned(orientation), numbers(size))
        };
        let shape = match shape {
            Primitive::Box { centre, half, orientation_wxyz } => placed("box", centre, orientation_wxyz, half),
            Primitive::Ellipsoid { centre, semi, orientation_wxyz } => {
                placed("ellipsoid", centre, orientation_wxyz, semi)
            }
            // MuJoCo takes no capsule without an axis.
            Primitive::Capsule { from, to, radius } if from == to => {
                format!(r#"type="sphere" pos="{}" size="{radius}"/>"#, numbers(from))
            }
            Primitive::Capsule { from, to, radius } => {
                format!(r#"type="capsule" fromto="{}" size="{radius}"/>"#, numbers(from.iter().chain(to)))
            }
            Primitive::Hull(_) => format!(r#"type="mesh" mesh="{name}"/>"#),
        };
        let _ = writeln!(xml, "{shape}");
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
