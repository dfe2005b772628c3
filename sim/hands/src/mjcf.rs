//! MJCF, read by MuJoCo.

use std::path::Path;

use mujoco_rs::prelude::*;
use mvt_robot::hand::{Inertial, JointMotion, Primitive};
use nalgebra as na;

use crate::model::{Coupling, Link, LinkJoint, LinkMotion, LinkShape, MOST_LINKS, Model, Site};
use crate::shape;
use mvt_physics::messages;

/// Largest file of a model that is read, bytes, without its meshes.
const LARGEST_FILE: u64 = 16 << 20;

/// Reads an MJCF.
///
/// # Errors
/// What is wrong, and what to do.
pub(crate) fn read(path: &Path) -> Result<Model, String> {
    // MuJoCo's own message for a missing file names the file alone. It refuses no FIFO.
    mvt_files::input::read_text(path, LARGEST_FILE).map_err(|error| format!("cannot be read: {error}"))?;
    if path.to_string_lossy().contains('\0') {
        return Err("the path contains a zero byte; rename the file".to_owned());
    }
    messages::route();
    links(MjModel::from_xml(path))
}

/// Reads the text of an MJCF without meshes.
///
/// # Errors
/// What is wrong.
pub(crate) fn parse(text: &str) -> Result<Model, String> {
    messages::route();
    links(MjModel::from_xml_string(text))
}

fn links(compiled: Result<MjModel, impl std::fmt::Display>) -> Result<Model, String> {
    let compiled = compiled.map_err(|error| {
        let reason = error.to_string();
        let reason = reason.strip_prefix("model load failed: ").unwrap_or(&reason);
        let advice = if reason.contains("opening file") { "; put the file there, or correct the MJCF" } else { "" };
        format!("MuJoCo cannot read the MJCF or a file that it names: {}{advice}", reason.trim_end())
    })?;
    let bodies = compiled.body_parentid().len();
    if bodies > MOST_LINKS {
        return Err(format!("it has {bodies} bodies; name an MJCF of the hand alone, with at most {MOST_LINKS}"));
    }
    let reader = Reader { compiled: &compiled, warnings: Vec::new() };
    reader.read()
}

struct Reader<'a> {
    compiled: &'a MjModel,
    warnings: Vec<String>,
}

impl Reader<'_> {
    fn read(mut self) -> Result<Model, String> {
        let m = self.compiled;
        let bodies = m.body_parentid().len();
        let joints: Vec<Option<LinkJoint>> = (0..bodies).map(|body| self.joint(body)).collect();
        // The anchor of each body's joint in the body's frame.
        let frames: Vec<na::Isometry3<f64>> = (0..bodies).map(|body| self.anchor(body)).collect();
        let touches = |geom: usize| m.geom_contype()[geom] != 0 || m.geom_conaffinity()[geom] != 0;
        let any_touches = (0..m.geom_type().len()).any(|geom| index(m.geom_bodyid()[geom]) != Some(0) && touches(geom));
        if !any_touches {
            self.warnings.push("no geom collides, so the visual geoms are the solid of the hand".to_owned());
        }
        // Body 0 is the world.
        let mut links = Vec::with_capacity(bodies);
        for (body, joint) in joints.into_iter().enumerate().skip(1) {
            let name = name(m, m.name_bodyadr()[body]).unwrap_or_else(|| format!("body_{body}"));
            let inverse = frames[body].inverse();
            let parent = index(m.body_parentid()[body]).filter(|&parent| parent > 0);
            let placed = pose(m.body_pos()[body], m.body_quat()[body]);
            let mut place = parent.map_or(placed, |parent| frames[parent].inverse() * placed) * frames[body];
            if let Some(joint) = &joint {
                // The pose in the file is that of the reference angle.
                place = joint.moved(place, -self.reference(body));
            }
            let geoms = range(m.body_geomadr()[body], m.body_geomnum()[body]);
            let shapes = geoms.filter(|&geom| touches(geom) || !any_touches);
            let shapes = shapes.filter_map(|geom| self.shape(geom, &inverse, &name)).collect();
            links.push(Link {
                parent: parent.map(|parent| parent - 1),
                inertial: self.inertial(body, &inverse),
                place,
                frame: frames[body],
                joint,
                shapes,
                name,
            });
        }
        let sites = (0..m.site_bodyid().len()).filter_map(|site| {
            let body = index(m.site_bodyid()[site]).filter(|&body| body > 0)?;
            let place = frames[body].inverse() * pose(m.site_pos()[site], m.site_quat()[site]);
            Some(Site { name: name(m, m.name_siteadr()[site])?, link: body - 1, place })
        });
        let sites = sites.collect();
        let couplings = self.couplings();
        let excluded = m.exclude_signature().iter().filter_map(|signature| {
            let pair = [index(signature >> 16)?, index(signature & 0xffff)?];
            pair.iter().all(|&body| body > 0 && body < bodies).then(|| pair.map(|body| body - 1))
        });
        let excluded = excluded.collect();
        let masked = if any_touches { self.masked() } else { Vec::new() };
        Ok(Model { links, sites, excluded, masked, couplings, warnings: self.warnings })
    }

    /// Returns the joint that moves a body.
    fn joint(&self, body: usize) -> Option<LinkJoint> {
        let m = self.compiled;
        let joints = range(m.body_jntadr()[body], m.body_jntnum()[body]);
        let count = joints.len();
        let joint = joints.into_iter().next()?;
        let motion = match m.jnt_type()[joint] {
            MjtJoint::mjJNT_FREE => LinkMotion::Complex("a free joint"),
            MjtJoint::mjJNT_BALL => LinkMotion::Complex("a ball joint"),
            _ if count > 1 => LinkMotion::Complex("several joints"),
            MjtJoint::mjJNT_SLIDE => LinkMotion::Simple(JointMotion::Slide),
            MjtJoint::mjJNT_HINGE if m.jnt_limited()[joint] => LinkMotion::Simple(JointMotion::Hinge),
            MjtJoint::mjJNT_HINGE => LinkMotion::Continuous,
        };
        Some(LinkJoint {
            name: name(m, m.name_jntadr()[joint]).unwrap_or_else(|| format!("joint_{joint}")),
            motion,
            axis: m.jnt_axis()[joint].into(),
            range: m.jnt_limited()[joint].then(|| m.jnt_range()[joint]),
            effort: self.effort(joint),
        })
    }

    /// Returns the value of a body's joint in the pose of the file.
    fn reference(&self, body: usize) -> f64 {
        let m = self.compiled;
        let joint = range(m.body_jntadr()[body], m.body_jntnum()[body]).next();
        let at = joint.and_then(|joint| index(m.jnt_qposadr()[joint]));
        at.map_or(0.0, |at| m.qpos0()[at])
    }

    /// Returns the motion from the anchor of a body's joint to the body's frame.
    fn anchor(&self, body: usize) -> na::Isometry3<f64> {
        let m = self.compiled;
        let joint = range(m.body_jntadr()[body], m.body_jntnum()[body]).next();
        let simple =
            joint.filter(|&joint| matches!(m.jnt_type()[joint], MjtJoint::mjJNT_HINGE | MjtJoint::mjJNT_SLIDE));
        let [x, y, z] = simple.map_or([0.0; 3], |joint| m.jnt_pos()[joint]);
        na::Isometry3::translation(x, y, z)
    }

    /// Returns the largest torque or force that actuators exert on a joint.
    fn effort(&self, joint: usize) -> Option<f64> {
        let m = self.compiled;
        let largest = |[low, high]: [f64; 2]| f64::max(low.abs(), high.abs());
        if m.jnt_actfrclimited()[joint] {
            return Some(largest(m.jnt_actfrcrange()[joint]));
        }
        (0..m.actuator_trntype().len())
            .filter(|&actuator| {
                m.actuator_trntype()[actuator] == MjtTrn::mjTRN_JOINT
                    && index(m.actuator_trnid()[actuator][0]) == Some(joint)
                    && m.actuator_forcelimited()[actuator]
            })
            .map(|actuator| {
                let gear = index(m.actuator_outadr()[actuator]).map_or(1.0, |out| m.actuator_gear()[out][0].abs());
                gear * largest(m.actuator_forcerange()[actuator])
            })
            .reduce(f64::max)
    }

    /// Returns the mass of a body; `None` without a mass.
    fn inertial(&self, body: usize, frame: &na::Isometry3<f64>) -> Option<Inertial> {
        let m = self.compiled;
        let (mass_kg, diagonal) = (m.body_mass()[body], m.body_inertia()[body]);
        let place = frame * pose(m.body_ipos()[body], m.body_iquat()[body]);
        (mass_kg > 0.0 && diagonal.iter().all(|i| *i > 0.0)).then(|| Inertial {
            mass_kg,
            centre_m: place.translation.vector.into(),
            orientation_wxyz: shape::wxyz(&place.rotation),
            diagonal,
        })
    }

    /// Returns a geom as a primitive. `frame` leads from the body's frame to that of the link.
    fn shape(&mut self, geom: usize, frame: &na::Isometry3<f64>, body: &str) -> Option<LinkShape> {
        let m = self.compiled;
        let place = frame * pose(m.geom_pos()[geom], m.geom_quat()[geom]);
        let [a, b, c] = m.geom_size()[geom];
        let name = name(m, m.name_geomadr()[geom]);
        let shape = match m.geom_type()[geom] {
            MjtGeomBase::mjGEOM_SPHERE => Ok(shape::ellipsoid(&place, [a; 3])),
            MjtGeomBase::mjGEOM_ELLIPSOID => Ok(shape::ellipsoid(&place, [a, b, c])),
            MjtGeomBase::mjGEOM_BOX => Ok(shape::block(&place, [a, b, c])),
            MjtGeomBase::mjGEOM_CAPSULE => Ok(shape::capsule(&place, a, b)),
            MjtGeomBase::mjGEOM_CYLINDER => shape::cylinder(&place, a, b),
            MjtGeomBase::mjGEOM_MESH | MjtGeomBase::mjGEOM_SDF => self.mesh(geom, &place),
            MjtGeomBase::mjGEOM_PLANE | MjtGeomBase::mjGEOM_HFIELD => Err("a hand has no planes".to_owned()),
        };
        match shape {
            Ok(shape) => Some(LinkShape { name, shape }),
            Err(reason) => {
                let geom = name.unwrap_or_else(|| format!("number {geom}"));
                self.warnings.push(format!("geom {geom} of body {body} is left out: {reason}"));
                None
            }
        }
    }

    /// Returns the convex hull of the mesh of a geom, with which MuJoCo collides too.
    fn mesh(&self, geom: usize, place: &na::Isometry3<f64>) -> Result<Primitive, String> {
        let m = self.compiled;
        let mesh = index(m.geom_dataid()[geom]).ok_or("it has no mesh")?;
        let vertices = range(m.mesh_vertadr()[mesh], m.mesh_vertnum()[mesh]);
        shape::hull(vertices.map(|v| place * na::Point3::from(m.mesh_vert()[v].map(f64::from))))
    }

    /// Returns the couplings of joints by equality constraints and tendons. Loops that such constraints close are warned of.
    fn couplings(&mut self) -> Vec<Coupling> {
        let m = self.compiled;
        let joint = |id: i32| {
            let id = index(id)?;
            Some(name(m, *m.name_jntadr().get(id)?).unwrap_or_else(|| format!("joint_{id}")))
        };
        let mut couplings = Vec::new();
        for eq in (0..m.eq_type().len()).filter(|&eq| m.eq_active0()[eq]) {
            let by = name(m, m.name_eqadr()[eq]).unwrap_or_else(|| format!("number {eq}"));
            if m.eq_type()[eq] == MjtEq::mjEQ_JOINT {
                let joints = [m.eq_obj1id()[eq], m.eq_obj2id()[eq]].into_iter().filter_map(joint).collect();
                couplings.push(Coupling { by: format!("equality constraint {by}"), joints, refused: false });
            } else {
                self.warnings.push(format!(
                    "the equality constraint {by} is left out: what it ties together, such as a loop of links, moves freely"
                ));
            }
        }
        for tendon in 0..m.tendon_adr().len() {
            let by = name(m, m.name_tendonadr()[tendon]).unwrap_or_else(|| format!("number {tendon}"));
            let wraps = range(m.tendon_adr()[tendon], m.tendon_num()[tendon]);
            let (fixed, spatial): (Vec<usize>, Vec<usize>) =
                wraps.partition(|&wrap| m.wrap_type()[wrap] == MjtWrap::mjWRAP_JOINT);
            if !spatial.is_empty() {
                self.warnings.push(format!("the tendon {by} is left out: each joint has a controller of its own"));
            }
            let joints = fixed.into_iter().filter_map(|wrap| joint(m.wrap_objid()[wrap])).collect();
            couplings.push(Coupling { by: format!("tendon {by}"), joints, refused: false });
        }
        couplings
    }

    /// Returns the pairs of bodies that do not collide by their types and affinities.
    fn masked(&self) -> Vec<[usize; 2]> {
        let (types, affinities) = (self.compiled.body_contype(), self.compiled.body_conaffinity());
        let with_shape: Vec<usize> =
            (1..types.len()).filter(|&body| types[body] != 0 || affinities[body] != 0).collect();
        let pairs = with_shape.iter().enumerate().flat_map(|(k, &a)| with_shape[k + 1..].iter().map(move |&b| [a, b]));
        let apart = |[a, b]: &[usize; 2]| types[*a] & affinities[*b] == 0 && types[*b] & affinities[*a] == 0;
        pairs.filter(apart).map(|pair| pair.map(|body| body - 1)).collect()
    }
}

/// Returns a name from MuJoCo's list of names; `None` for an element without one.
fn name(model: &MjModel, address: i32) -> Option<String> {
    let rest = model.names().get(index(address)?..)?;
    let bytes: Vec<u8> = rest.iter().take_while(|c| **c != 0).map(|c| c.cast_unsigned()).collect();
    (!bytes.is_empty()).then(|| String::from_utf8_lossy(&bytes).into_owned())
}

/// Returns the index of an element; MuJoCo writes -1 for none.
fn index(id: i32) -> Option<usize> {
    usize::try_from(id).ok()
}

fn range(start: i32, count: i32) -> std::ops::Range<usize> {
    let start = index(start).unwrap_or(0);
    start..start + index(count).unwrap_or(0)
}

fn pose([x, y, z]: [f64; 3], [w, i, j, k]: [f64; 4]) -> na::Isometry3<f64> {
    let turn = na::UnitQuaternion::from_quaternion(na::Quaternion::new(w, i, j, k));
    na::Isometry3::from_parts(na::Translation3::new(x, y, z), turn)
}
