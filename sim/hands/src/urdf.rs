//! URDF, read by the crate urdf-rs.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::Vec3;
use mvt_mesh::Format;
use mvt_objects::decompose;
use mvt_robot::hand::{Inertial, JointMotion, Primitive};
use nalgebra as na;
use urdf_rs::{Geometry, JointType, Pose, Robot};

use crate::error::unknown;
use crate::model::{Coupling, Link, LinkJoint, LinkMotion, LinkShape, MOST_LINKS, Model};
use crate::shape;

/// Largest URDF that is read, bytes, without its meshes.
const LARGEST_FILE: u64 = 4 << 20;
/// Greatest coordinate of a mesh, in any unit.
const GREATEST: f32 = 1e7;
/// Deepest nesting of elements; a URDF needs five. The parser recurses.
const DEEPEST: usize = 64;

/// Reads a URDF.
///
/// # Errors
/// What is wrong, and what to do.
pub(crate) fn read(path: &Path) -> Result<Model, String> {
    let text = mvt_files::input::read_text(path, LARGEST_FILE).map_err(|error| format!("cannot be read: {error}"))?;
    if nesting(&text) > DEEPEST {
        return Err(format!("its elements are nested more than {DEEPEST} deep; it is no URDF"));
    }
    let robot = urdf_rs::read_from_string(&text).map_err(|error| format!("it is no URDF: {error}"))?;
    if robot.links.is_empty() {
        return Err("it has no links; name a URDF of a hand".to_owned());
    }
    if robot.links.len() > MOST_LINKS {
        let links = robot.links.len();
        return Err(format!("it has {links} links; name a URDF of the hand alone, with at most {MOST_LINKS}"));
    }
    let any_collision = robot.links.iter().any(|link| !link.collision.is_empty());
    let mut reader =
        Reader { folder: path.parent().unwrap_or(Path::new("")), meshes: HashMap::new(), model: Model::default() };
    if !any_collision {
        reader
            .model
            .warnings
            .push("no link has a collision shape, so the visual shapes are the solid of the hand".to_owned());
    }
    for (link, joint) in depth_first(&robot)? {
        reader.add(&robot, link, joint, any_collision)?;
    }
    for joint in &robot.joints {
        if let Some(mimic) = &joint.mimic {
            let (by, joints) =
                (format!("mimic in joint {}", joint.name), vec![joint.name.clone(), mimic.joint.clone()]);
            reader.model.couplings.push(Coupling { by, joints, refused: true });
        }
    }
    Ok(reader.model)
}

/// Returns the deepest nesting of elements, or more.
fn nesting(text: &str) -> usize {
    let (mut depth, mut deepest) = (0usize, 0);
    let mut rest = text;
    while let Some(at) = rest.find(['<', '/']) {
        let here = &rest[at..];
        let mut step = 1;
        if here.starts_with("<!--") {
            step = here.find("-->").unwrap_or(here.len());
        } else if here.starts_with("</") {
            depth = depth.saturating_sub(1);
            step = 2;
        } else if here.starts_with("/>") {
            depth = depth.saturating_sub(1);
        } else if here.starts_with('<') && !here.starts_with("<?") && !here.starts_with("<!") {
            depth += 1;
        }
        deepest = deepest.max(depth);
        rest = &here[step..];
    }
    deepest
}

/// Returns the links depth first, each with its joint.
fn depth_first(robot: &Robot) -> Result<Vec<(usize, Option<usize>)>, String> {
    let mut link_of: HashMap<&str, usize> = HashMap::new();
    for (k, link) in robot.links.iter().enumerate() {
        if link_of.insert(&link.name, k).is_some() {
            return Err(format!("two links are named {:?}; rename one", link.name));
        }
    }
    let mut parent_joint: Vec<Option<usize>> = vec![None; robot.links.len()];
    let mut children: Vec<Vec<usize>> = vec![Vec::new(); robot.links.len()];
    for (j, joint) in robot.joints.iter().enumerate() {
        let find = |name: &str| {
            let known = || robot.links.iter().map(|link| link.name.as_str());
            link_of
                .get(name)
                .copied()
                .ok_or_else(|| format!("joint {}: {}", joint.name, unknown("link", name, known())))
        };
        let (parent, child) = (find(&joint.parent.link)?, find(&joint.child.link)?);
        if let Some(other) = parent_joint[child].replace(j) {
            return Err(format!(
                "link {} hangs on two joints, {} and {}: a hand has no loops; remove one of the joints",
                joint.child.link, robot.joints[other].name, joint.name
            ));
        }
        children[parent].push(child);
    }
    let mut open: Vec<usize> = (0..robot.links.len()).rev().filter(|&link| parent_joint[link].is_none()).collect();
    let mut ordered = Vec::new();
    while let Some(link) = open.pop() {
        ordered.push((link, parent_joint[link]));
        open.extend(children[link].iter().rev());
    }
    if ordered.len() < robot.links.len() {
        let inside = (0..robot.links.len()).find(|link| !ordered.iter().any(|(other, _)| other == link));
        let name = inside.map_or("", |link| &robot.links[link].name);
        return Err(format!(
            "link {name} hangs on itself over its joints: a hand has no loops; remove one of the joints"
        ));
    }
    Ok(ordered)
}

struct Reader<'a> {
    folder: &'a Path,
    /// Corners of the convex hulls of meshes that have been read, in the units of their files.
    meshes: HashMap<PathBuf, Vec<Vec3>>,
    model: Model,
}

impl Reader<'_> {
    fn add(&mut self, robot: &Robot, link: usize, joint: Option<usize>, any_collision: bool) -> Result<(), String> {
        let link = &robot.links[link];
        let joint = joint.map(|joint| &robot.joints[joint]);
        let mut shapes = Vec::new();
        let of_link: Vec<(&Option<String>, &Pose, &Geometry)> = if any_collision {
            link.collision.iter().map(|c| (&c.name, &c.origin, &c.geometry)).collect()
        } else {
            link.visual.iter().map(|v| (&v.name, &v.origin, &v.geometry)).collect()
        };
        for (name, origin, geometry) in of_link {
            let fault = |reason| format!("link {}: {reason}", link.name);
            match self.shape(&pose(origin), geometry).map_err(fault)? {
                Ok(shape) => shapes.push(LinkShape { name: name.clone(), shape }),
                Err(reason) => {
                    self.model.warnings.push(format!("a shape of link {} is left out: {reason}", link.name));
                }
            }
        }
        let moves = joint.map(link_joint).transpose()?.flatten();
        self.model.links.push(Link {
            name: link.name.clone(),
            // Depth first: the parent is there.
            parent: joint.and_then(|joint| self.model.link(&joint.parent.link)),
            place: joint.map_or_else(na::Isometry3::identity, |joint| pose(&joint.origin)),
            frame: na::Isometry3::identity(),
            joint: moves,
            inertial: inertial(&link.inertial),
            shapes,
        });
        Ok(())
    }

    /// Returns a geometry as a primitive, or why it is left out.
    ///
    /// # Errors
    /// If the mesh cannot be read.
    fn shape(&mut self, place: &na::Isometry3<f64>, geometry: &Geometry) -> Result<Result<Primitive, String>, String> {
        Ok(match geometry {
            Geometry::Box { size } => Ok(shape::block(place, size.map(|s| s / 2.0))),
            Geometry::Sphere { radius } => Ok(shape::ellipsoid(place, [*radius; 3])),
            Geometry::Cylinder { radius, length } => shape::cylinder(place, *radius, length / 2.0),
            Geometry::Capsule { radius, length } => Ok(shape::capsule(place, *radius, length / 2.0)),
            Geometry::Mesh { filename, scale } => {
                let scale = na::Vector3::from(scale.map_or([1.0; 3], |scale| *scale));
                let corners = self.corners(filename)?;
                let scaled = |v: &Vec3| na::Vector3::from(v.to_array().map(f64::from)).component_mul(&scale);
                shape::hull(corners.iter().map(|v| place * na::Point3::from(scaled(v))))
            }
        })
    }

    /// Returns the corners of the convex hull of a mesh, in the units of the file.
    fn corners(&mut self, filename: &str) -> Result<&[Vec3], String> {
        let path = self.resolve(filename)?;
        if !self.meshes.contains_key(&path) {
            if Format::from_path(&path).is_none() {
                return Err(format!(
                    "{filename} is no STL, OBJ or PLY; convert it, for example with `assimp export` or Blender"
                ));
            }
            let (mesh, _) = mvt_mesh::read(&path).map_err(|error| error.to_string())?;
            // Hulls of larger coordinates overflow.
            if !mesh.vertices.iter().all(|v| v.abs().max_element() < GREATEST) {
                return Err(format!("{filename} has coordinates beyond {GREATEST}; repair the mesh"));
            }
            // A flat mesh has no hull; the caller finds out.
            let corners = decompose::hull_points(&mesh.vertices).unwrap_or_default();
            self.meshes.insert(path.clone(), corners);
        }
        Ok(self.meshes.get(&path).map_or(&[], Vec::as_slice))
    }

    /// Returns the path of a mesh. `package://NAME/` stands for a folder NAME beside the URDF or beside a folder that contains it, or for such
    /// a folder itself.
    fn resolve(&self, filename: &str) -> Result<PathBuf, String> {
        let here = std::path::absolute(self.folder).unwrap_or_else(|_| self.folder.to_owned());
        let candidates: Vec<PathBuf> = match filename.strip_prefix("package://") {
            Some(inside) => {
                let within = inside.split_once('/').map_or("", |(_, within)| within);
                here.ancestors().flat_map(|folder| [folder.join(inside), folder.join(within)]).collect()
            }
            None => vec![here.join(filename.strip_prefix("file://").unwrap_or(filename))],
        };
        candidates.iter().find(|path| path.is_file()).cloned().ok_or_else(|| match candidates.as_slice() {
            [path] => format!("the mesh {} is missing; put it there, or correct the URDF", path.display()),
            _ => format!(
                "the mesh {filename} is missing; put the package's folder beside the URDF, or beside a folder that contains it ({})",
                here.display()
            ),
        })
    }
}

/// Returns what moves a link; `None` for a fixed joint.
fn link_joint(joint: &urdf_rs::Joint) -> Result<Option<LinkJoint>, String> {
    let motion = match joint.joint_type {
        JointType::Fixed => return Ok(None),
        JointType::Revolute => LinkMotion::Simple(JointMotion::Hinge),
        JointType::Prismatic => LinkMotion::Simple(JointMotion::Slide),
        JointType::Continuous => LinkMotion::Continuous,
        JointType::Floating => LinkMotion::Complex("a floating joint"),
        JointType::Planar => LinkMotion::Complex("a planar joint"),
        JointType::Spherical => LinkMotion::Complex("a spherical joint"),
    };
    let axis = na::Vector3::from(*joint.axis.xyz);
    let norm = axis.norm();
    if !(norm > 1e-9 && norm.is_finite()) {
        return Err(format!("joint {}: its axis is zero or not finite; write a direction, such as 0 0 1", joint.name));
    }
    let limit = &joint.limit;
    Ok(Some(LinkJoint {
        name: joint.name.clone(),
        motion,
        axis: axis / norm,
        range: (limit.lower < limit.upper && motion != LinkMotion::Continuous).then_some([limit.lower, limit.upper]),
        effort: Some(limit.effort).filter(|effort| *effort > 0.0 && effort.is_finite()),
    }))
}

/// Returns the mass of a link along its principal axes; `None` if it has none, or an impossible one.
fn inertial(inertial: &urdf_rs::Inertial) -> Option<Inertial> {
    let urdf_rs::Inertia { ixx, ixy, ixz, iyy, iyz, izz } = inertial.inertia;
    let mass_kg = inertial.mass.value;
    let finite = [mass_kg, ixx, ixy, ixz, iyy, iyz, izz].iter().all(|v| v.is_finite());
    if !(finite && mass_kg > 0.0) {
        return None;
    }
    let tensor = na::Matrix3::new(ixx, ixy, ixz, ixy, iyy, iyz, ixz, iyz, izz);
    let na::SymmetricEigen { eigenvalues, mut eigenvectors } = tensor.try_symmetric_eigen(f64::EPSILON, 1000)?;
    if eigenvectors.determinant() < 0.0 {
        eigenvectors.column_mut(2).neg_mut();
    }
    let turn = na::UnitQuaternion::from_rotation_matrix(&na::Rotation3::from_matrix_unchecked(eigenvectors));
    let place = pose(&inertial.origin);
    eigenvalues.iter().all(|i| *i > 0.0).then(|| Inertial {
        mass_kg,
        centre_m: place.translation.vector.into(),
        orientation_wxyz: shape::wxyz(&(place.rotation * turn)),
        diagonal: eigenvalues.into(),
    })
}

fn pose(pose: &Pose) -> na::Isometry3<f64> {
    let ([x, y, z], [roll, pitch, yaw]) = (*pose.xyz, *pose.rpy);
    na::Isometry3::from_parts(na::Translation3::new(x, y, z), na::UnitQuaternion::from_euler_angles(roll, pitch, yaw))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nesting_is_counted() {
        assert_eq!(nesting("<a><b/><b x='1'></b><!-- <c><c><c> --></a>"), 2);
        assert_eq!(nesting(&"<a>".repeat(1000)), 1000);
        assert_eq!(nesting("a / b <"), 1);
    }

    #[test]
    fn an_inertia_is_turned_to_its_principal_axes() {
        let mut of = urdf_rs::Inertial::default();
        of.mass.value = 0.1;
        of.inertia = urdf_rs::Inertia { ixx: 2e-5, ixy: 1e-5, ixz: 0.0, iyy: 2e-5, iyz: 0.0, izz: 4e-5 };
        let Inertial { orientation_wxyz: [w, x, y, z], diagonal, .. } = inertial(&of).unwrap();
        let turn = na::UnitQuaternion::from_quaternion(na::Quaternion::new(w, x, y, z)).to_rotation_matrix();
        let tensor = turn * na::Matrix3::from_diagonal(&diagonal.into()) * turn.transpose();
        assert!((tensor[(0, 1)] - 1e-5).abs() < 1e-12 && (tensor[(2, 2)] - 4e-5).abs() < 1e-12, "{tensor}");
        of.inertia.izz = 0.0;
        assert_eq!(inertial(&of), None);
    }
}
