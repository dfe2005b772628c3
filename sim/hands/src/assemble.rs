//! The hand of a hand file and its model.

use std::f64::consts::TAU;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::{
    Body, Drive, GraspPoint, Hand, HandDescription, Inertial, Joint, JointMotion, Part, PartSurface, Placing, TouchPad,
    UPRIGHT,
};
use nalgebra as na;

use crate::camera;
use crate::check;
use crate::error::{HandFileError, unknown};
use crate::file::{GraspMount, HandFile, LoadedHand, PadMount};
use crate::model::{Coupling, Link, LinkJoint, LinkMotion, Model};
use crate::shape::{self, placing};

/// Extents at joint angles 0 that a hand can have, metres. Others are due to another unit.
const EXTENT_M: RangeInclusive<f64> = 0.01..=3.0;
/// Greatest limit of a hinge, radians: two turns. Greater ones are degrees.
const GREATEST_RAD: f64 = 2.0 * TAU;
/// Density by which a mass is estimated, kg/m^3: a box around the link, half full of plastic.
const DENSITY: f64 = 500.0;

/// Makes the hand.
///
/// # Errors
/// [`HandFileError`] if the file names what the model does not have, or asks for the impossible.
pub(crate) fn assemble(
    file: &HandFile,
    model: Model,
    path: &Path,
    model_path: PathBuf,
) -> Result<LoadedHand, HandFileError> {
    let content = HandFileError::content(path);
    let builder = Builder::new(file, model).map_err(&content)?;
    let joints = builder.joints().map_err(&content)?;
    let mounts = builder.mounts(path)?;
    let (description, mut warnings) = builder.describe(&joints, &mounts).map_err(&content)?;
    let extent = check::extent_m(&description);
    // Numbers that are not finite are reported with their places.
    if !extent.is_nan() && !EXTENT_M.contains(&extent) {
        let reason = format!(
            "the hand spans {extent:.3} m at joint angles 0, so its lengths are in another unit; convert positions, sizes and meshes to \
             metres (meshes in millimetres with scale=\"0.001 0.001 0.001\")"
        );
        return Err(HandFileError::model(&model_path)(reason));
    }
    let invalid = |source| HandFileError::Hand { path: path.to_owned(), source };
    let hand = Hand::new(description).map_err(invalid)?;
    let hand = check::without_overlaps(&hand, &mut warnings).map_err(invalid)?;
    warnings.extend(check::covered_gels(&hand));
    let fingers = fingers(file, &hand).map_err(&content)?;
    let cameras = camera::cameras(file, &hand, |name| builder.fixed_link(name, &hand)).map_err(&content)?;
    Ok(LoadedHand { hand, cameras, fingers, model: model_path, warnings })
}

/// How a link of the hand moves against its parent.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Movement {
    /// By its joint, between limits.
    Free([f64; 2]),
    /// Not at all: its joint, if it has one, is held at a value.
    Held(f64),
}

/// A touch sensor on a link.
struct Mount {
    link: usize,
    /// Place of the gel's frame on the link.
    place: na::Isometry3<f64>,
    profile: SensorProfile,
    /// Whether a shape of the link is its gel, so that the link is the sensor.
    is_link: bool,
}

pub(crate) struct Builder<'a> {
    file: &'a HandFile,
    model: Model,
    base: usize,
    /// Links that hang on the base, which is the first.
    links: Vec<usize>,
}

impl<'a> Builder<'a> {
    fn new(file: &'a HandFile, model: Model) -> Result<Self, String> {
        let names = || model.links.iter().map(|link| link.name.as_str());
        let base = match &file.base.link {
            Some(name) => model.link(name).ok_or_else(|| format!("[base] link: {}", unknown("link", name, names())))?,
            None => {
                let roots: Vec<usize> = (0..model.links.len()).filter(|&k| model.links[k].parent.is_none()).collect();
                let [root] = roots.as_slice() else {
                    let names: Vec<&str> = roots.iter().map(|&root| model.links[root].name.as_str()).collect();
                    return Err(format!(
                        "the model has {} roots ({}); name the hand's as link under [base]",
                        names.len(),
                        names.join(", ")
                    ));
                };
                *root
            }
        };
        let mut links: Vec<usize> = (0..model.links.len()).filter(|&link| model.carries(base, link)).collect();
        for name in &file.without {
            let known = || links[1..].iter().map(|&link| model.links[link].name.as_str());
            let left_out = model
                .link(name)
                .filter(|link| *link != base && links.contains(link))
                .ok_or_else(|| format!("without: {}", unknown("link", name, known())))?;
            links.retain(|&link| !model.carries(left_out, link));
        }
        Ok(Self { file, model, base, links })
    }

    /// Returns the link of a name if it hangs on the base.
    fn link(&self, name: &str) -> Result<usize, String> {
        let found = self.links.iter().copied().find(|&link| self.model.links[link].name == name);
        found.ok_or_else(|| unknown("link", name, self.links.iter().map(|&link| self.model.links[link].name.as_str())))
    }

    /// Returns the joints of the links that hang on the base, without that of the base.
    fn joint_names(&self) -> impl Iterator<Item = &str> {
        self.links[1..].iter().filter_map(|&link| Some(self.model.links[link].joint.as_ref()?.name.as_str()))
    }

    /// Returns how each link of the hand moves, in their order.
    fn joints(&self) -> Result<Vec<Movement>, String> {
        let HandFile { joints, joint_changes, .. } = self.file;
        let movement = |&link: &usize| match &self.model.links[link].joint {
            Some(joint) if link != self.base => self.movement(&self.model.links[link], joint),
            _ => Ok(Movement::Held(0.0)),
        };
        let movements = self.links.iter().map(movement).collect::<Result<Vec<_>, _>>()?;
        for name in joints.iter().flatten().chain(joint_changes.keys()) {
            if !self.joint_names().any(|known| known == name) {
                return Err(unknown("joint", name, self.joint_names()));
            }
        }
        match self.couplings(&movements).into_iter().find(|(coupling, _)| coupling.refused) {
            Some((coupling, joints)) => Err(format!(
                "the {} couples {}, which is not possible here; write `held_at = 0.0` under [joint.{}]",
                coupling.by,
                joints.join(" and "),
                joints[0]
            )),
            None => Ok(movements),
        }
    }

    fn movement(&self, link: &Link, joint: &LinkJoint) -> Result<Movement, String> {
        let name = &joint.name;
        let change = self.file.joint_changes.get(name).copied().unwrap_or_default();
        let listed = self.file.joints.as_ref().map(|joints| joints.contains(name));
        let held_at = match (change.held_at, listed) {
            (Some(_), Some(true)) => {
                return Err(format!("joint {name} is in `joints`, and held by [joint.{name}]; drop one of them"));
            }
            (None, Some(false)) => Some(0.0),
            (held_at, _) => held_at,
        };
        match (held_at, joint.motion) {
            (Some(value), LinkMotion::Complex(_)) if value != 0.0 => {
                Err(format!("joint {name} can only be held at 0: it is {}", motion_name(joint.motion)))
            }
            (Some(value), _) => Ok(Movement::Held(value)),
            (None, LinkMotion::Complex(what)) => Err(format!(
                "link {} moves by {what}; a hand has hinges and slides, each on a link of its own: split the link, or write `held_at = 0.0` \
                 under [joint.{name}]",
                link.name
            )),
            (None, motion) => {
                let continuous = (motion == LinkMotion::Continuous).then_some([-TAU, TAU]);
                let [low, high] = change.range.or(joint.range).or(continuous).ok_or_else(|| {
                    format!("joint {name} has no limits; write `range = [lower, upper]` under [joint.{name}]")
                })?;
                if motion != LinkMotion::Simple(JointMotion::Slide)
                    && (low.abs() > GREATEST_RAD || high.abs() > GREATEST_RAD)
                {
                    return Err(format!(
                        "joint {name} has the limits {low} and {high}, which are degrees, it seems; write radians, in the model or as \
                         `range` under [joint.{name}]"
                    ));
                }
                Ok(Movement::Free([low, high]))
            }
        }
    }

    /// Returns the couplings of which several joints move, with these joints.
    fn couplings(&self, movements: &[Movement]) -> Vec<(&Coupling, Vec<&str>)> {
        let moves = |name: &&str| {
            self.links.iter().zip(movements).any(|(&link, movement)| {
                let joint = self.model.links[link].joint.as_ref();
                joint.is_some_and(|joint| joint.name == **name) && matches!(movement, Movement::Free(_))
            })
        };
        let couplings = self.model.couplings.iter().map(|coupling| {
            let moving = coupling.joints.iter().map(String::as_str).filter(moves);
            (coupling, moving.collect::<Vec<&str>>())
        });
        couplings.filter(|(_, joints)| joints.len() > 1).collect()
    }

    /// Returns the sensors on their links.
    fn mounts(&self, path: &Path) -> Result<Vec<Mount>, HandFileError> {
        self.file.pads.iter().map(|pad| self.mount(pad, path)).collect()
    }

    fn mount(&self, pad: &PadMount, path: &Path) -> Result<Mount, HandFileError> {
        let name = &pad.name;
        let fault = |reason: String| HandFileError::content(path)(format!("pad {name}: {reason}"));
        let place = placing(pad.position_m, pad.orientation_wxyz).map_err(fault)?;
        let (link, place) = match (&pad.link, &pad.site) {
            (Some(link), None) => {
                let link = self.link(link).map_err(fault)?;
                (link, self.model.links[link].frame.inverse() * place)
            }
            (None, Some(site)) => {
                let sites = || self.model.sites.iter().filter(|site| self.links.contains(&site.link));
                let found = sites()
                    .find(|known| known.name == *site)
                    .ok_or_else(|| fault(unknown("site", site, sites().map(|known| known.name.as_str()))))?;
                (found.link, found.place * place)
            }
            _ => return Err(fault("write either `link` or `site`".to_owned())),
        };
        let profile = match pad.profile.ends_with(".toml") {
            true => SensorProfile::load(&path.with_file_name(&pad.profile).to_string_lossy()),
            false => SensorProfile::load(&pad.profile),
        };
        let profile = profile.map_err(|source| HandFileError::Profile {
            path: path.to_owned(),
            pad: name.clone(),
            source: Box::new(source),
        })?;
        if let Some(gel) = &pad.gel {
            if pad.replaces {
                let reason = "`gel` names a shape of the link, so `replaces` has no meaning; drop it";
                return Err(fault(reason.to_owned()));
            }
            let named = || self.model.links[link].shapes.iter().filter_map(|shape| shape.name.as_deref());
            if !named().any(|name| name == gel) {
                return Err(fault(unknown("shape", gel, named())));
            }
        }
        Ok(Mount { link, place, profile, is_link: pad.gel.is_some() })
    }

    /// Returns the description of the hand, and warnings.
    fn describe(&self, movements: &[Movement], mounts: &[Mount]) -> Result<(HandDescription, Vec<String>), String> {
        let HandFile { name, side, palm_centre_m, grasp, base, .. } = self.file;
        let mut warnings = self.model.warnings.clone();
        warnings.extend(self.left_out());
        warnings.extend(self.couplings(movements).into_iter().map(|(coupling, joints)| {
            let listed = joints.join(" and ");
            format!(
                "the {} couples {listed}; here they move independently, unless one is held by `held_at`",
                coupling.by
            )
        }));
        let world_from_base =
            placing(base.position_m, base.orientation_wxyz).map_err(|reason| format!("[base]: {reason}"))?;
        let (mut bodies, mut joints) = (Vec::<Body>::new(), Vec::new());
        let mut body_of: Vec<Option<usize>> = vec![None; self.model.links.len()];
        let mut pads: Vec<Option<TouchPad>> = vec![None; mounts.len()];
        for (&k, movement) in self.links.iter().zip(movements) {
            let link = &self.model.links[k];
            let body = bodies.len();
            body_of[k] = Some(body);
            let place = if k == self.base { world_from_base * link.frame } else { link.place };
            let held = link.joint.as_ref().filter(|_| k != self.base).zip(match movement {
                Movement::Held(value) => Some(*value),
                Movement::Free(_) => None,
            });
            let place = held.map_or(place, |(joint, value)| joint.moved(place, value));
            let here = || mounts.iter().enumerate().filter(|(_, mount)| mount.link == k);
            let mut parts = self.parts(link, here());
            for (pad, mount) in here() {
                if !mount.is_link {
                    warnings.extend(self.make_room(pad, mount, link, &mut parts));
                }
            }
            let mut inertial = link.inertial;
            if let (Movement::Free(range), Some(joint)) = (movement, &link.joint) {
                if inertial.is_none() {
                    let estimated = estimated_mass(&parts);
                    warnings.push(format!(
                        "link {} has no mass: {:.1} g are assumed",
                        link.name,
                        1e3 * estimated.mass_kg
                    ));
                    inertial = Some(estimated);
                }
                if joint.motion == LinkMotion::Continuous && *range == [-TAU, TAU] {
                    warnings.push(format!("joint {} has no limits: it turns once in either direction", joint.name));
                }
                joints.push(self.joint(joint, body, *range));
            }
            bodies.push(Body {
                name: plain(&link.name),
                parent: link.parent.filter(|_| k != self.base).and_then(|parent| body_of[parent]),
                place: placed(&place),
                inertial,
                parts: parts.into_iter().map(|(_, part)| part).collect(),
            });
            for (pad, mount) in here() {
                let (name, profile) = (self.file.pads[pad].name.clone(), mount.profile.clone());
                if mount.is_link {
                    pads[pad] = Some(TouchPad { name, body, place: placed(&mount.place), profile });
                    continue;
                }
                let place = Placing::at([0.0; 3]);
                pads[pad] = Some(TouchPad { name: name.clone(), body: bodies.len(), place, profile });
                bodies.push(Body {
                    name: format!("{name}_sensor"),
                    parent: Some(body),
                    place: placed(&mount.place),
                    inertial: Some(mount.profile.body.inertial()),
                    parts: mount.profile.body.parts(pad),
                });
            }
        }
        if bodies.iter().all(|body| body.parts.is_empty()) {
            warnings.push("the model has no shapes: the hand collides with nothing and covers nothing".to_owned());
        }
        let apart = self.apart(&body_of, &bodies);
        let grasp = grasp.as_ref().map(|grasp| self.grasp(grasp, &body_of)).transpose()?;
        let mut description = HandDescription {
            name: name.clone(),
            side: *side,
            bodies,
            joints,
            pads: pads.into_iter().flatten().collect(),
            apart,
            palm_centre_m: *palm_centre_m,
            grasp,
        };
        if description.grasp.is_none() {
            description.grasp = check::middle_of_pads(&description);
        }
        Ok((description, warnings))
    }

    /// Returns warnings about what does not become part of the hand.
    fn left_out(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        let base = &self.model.links[self.base];
        // A hand that is free in space becomes fixed, as every hand here is.
        if let Some(joint) = base.joint.as_ref().filter(|joint| !joint.is_free()) {
            warnings
                .push(format!("link {} is fixed in the world, so its joint {} does not move", base.name, joint.name));
        }
        let outside = (0..self.model.links.len()).filter(|&link| !self.model.carries(self.base, link)).count();
        if outside > 0 {
            warnings.push(format!("{outside} links that do not hang on {} are left out", base.name));
        }
        warnings
    }

    /// Returns the parts of a link with their names.
    fn parts<'m>(&self, link: &Link, mounts: impl Iterator<Item = (usize, &'m Mount)>) -> Vec<(Option<String>, Part)> {
        let gels: Vec<(usize, &str)> =
            mounts.filter_map(|(pad, _)| Some((pad, self.file.pads[pad].gel.as_deref()?))).collect();
        // A link with a gel is a sensor.
        let other = if gels.is_empty() { PartSurface::Link } else { PartSurface::Housing };
        let part = |shape: &crate::model::LinkShape| {
            let gel = gels.iter().find(|(_, gel)| shape.name.as_deref() == Some(*gel));
            let surface = gel.map_or(other, |(pad, _)| PartSurface::Gel(*pad));
            (shape.name.clone(), Part { surface, shape: shape.shape.clone() })
        };
        link.shapes.iter().map(part).collect()
    }

    /// Removes the parts of a link that a sensor replaces. Returns a warning if parts and sensor are at odds.
    fn make_room(
        &self,
        pad: usize,
        mount: &Mount,
        link: &Link,
        parts: &mut Vec<(Option<String>, Part)>,
    ) -> Option<String> {
        let PadMount { name, replaces, .. } = &self.file.pads[pad];
        let sensor = mount.profile.body.parts(0);
        let overlaps = |(_, part): &(Option<String>, Part)| {
            check::overlap(std::slice::from_ref(part), &na::Isometry3::identity(), &sensor, &mount.place)
        };
        let inside: Vec<bool> = parts.iter().map(overlaps).collect();
        let count = inside.iter().filter(|inside| **inside).count();
        if *replaces {
            let mut inside = inside.into_iter();
            parts.retain(|_| !inside.next().unwrap_or(false));
        }
        match (replaces, count) {
            (true, 0) => Some(format!("pad {name} replaces no shape of link {}: none lies in it", link.name)),
            (false, 1..) => Some(format!(
                "pad {name} lies in {count} shapes of link {}; move it, or write `replaces = true` in its [[pad]]",
                link.name
            )),
            _ => None,
        }
    }

    fn joint(&self, joint: &LinkJoint, body: usize, range: [f64; 2]) -> Joint {
        let change = self.file.joint_changes.get(&joint.name).copied().unwrap_or_default();
        let mut drive = Drive::default();
        drive.torque_limit = joint.effort.unwrap_or(drive.torque_limit);
        self.file.control.apply(&mut drive);
        change.drive().apply(&mut drive);
        let motion = match joint.motion {
            LinkMotion::Simple(motion) => motion,
            LinkMotion::Continuous | LinkMotion::Complex(_) => JointMotion::Hinge,
        };
        Joint { name: plain(&joint.name), body, motion, axis: joint.axis.into(), range, mirrors: change.mirrors, drive }
    }

    /// Returns the pairs of bodies that do not collide. A sensor does not collide with what its link is excluded from.
    fn apart(&self, body_of: &[Option<usize>], bodies: &[Body]) -> Vec<[usize; 2]> {
        let pair = |&[a, b]: &[usize; 2]| Some([body_of[a]?, body_of[b]?]);
        let excluded = self.model.excluded.iter().filter_map(pair).flat_map(|[a, b]| {
            let with_sensors = |link: usize| {
                let carried = move |body: &usize| bodies[*body].parent == Some(link) && is_sensor(&bodies[*body]);
                std::iter::once(link).chain((0..bodies.len()).filter(carried))
            };
            with_sensors(a).flat_map(move |a| with_sensors(b).map(move |b| [a, b])).collect::<Vec<_>>()
        });
        let mut apart: Vec<[usize; 2]> = Vec::new();
        for [a, b] in excluded.chain(self.model.masked.iter().filter_map(pair)) {
            if a != b && !apart.contains(&[a, b]) && !apart.contains(&[b, a]) {
                apart.push([a, b]);
            }
        }
        apart
    }

    fn grasp(&self, grasp: &GraspMount, body_of: &[Option<usize>]) -> Result<GraspPoint, String> {
        let Some(name) = &grasp.link else { return Ok(GraspPoint { body: None, point_m: grasp.point_m }) };
        let link = self.link(name).map_err(|reason| format!("[grasp]: {reason}"))?;
        let point = self.model.links[link].frame.inverse() * na::Point3::from(grasp.point_m);
        Ok(GraspPoint { body: body_of[link], point_m: point.coords.into() })
    }

    /// Returns the pose in the world of the frame that a file gives to a link, if no joint moves it.
    pub(crate) fn fixed_link(&self, name: &str, hand: &Hand) -> Result<na::Isometry3<f64>, String> {
        let link = self.link(name)?;
        let body = hand.bodies().iter().position(|body| body.name == plain(name)).unwrap_or(0);
        if !hand.chain(body).is_empty() {
            return Err(format!("link {name} moves; cameras stand on links that no joint moves, or in the world"));
        }
        Ok(hand.body_poses(&[])[body] * self.model.links[link].frame.inverse())
    }
}

/// Returns the indices of the joints of each finger.
fn fingers(file: &HandFile, hand: &Arc<Hand>) -> Result<std::collections::BTreeMap<String, Vec<usize>>, String> {
    let index = |name: &String| {
        let known = || hand.joints().iter().map(|joint| joint.name.as_str());
        known().position(|known| known == plain(name)).ok_or_else(|| unknown("moving joint", name, known()))
    };
    let finger = |(name, joints): (&String, &Vec<String>)| {
        let indices = joints.iter().map(index).collect::<Result<Vec<_>, _>>();
        let indices = indices.map_err(|reason| format!("finger {name}: {reason}"))?;
        for pair in indices.windows(2) {
            let [base, tip] = [pair[0], pair[1]].map(|joint| &hand.joints()[joint]);
            if pair[0] == pair[1] || !hand.chain(tip.body).contains(&pair[0]) {
                return Err(format!(
                    "finger {name}: joint {} does not carry joint {}; list the joints of one finger, from base to tip",
                    base.name, tip.name
                ));
            }
        }
        Ok((name.clone(), indices))
    };
    file.fingers.iter().map(finger).collect()
}

fn motion_name(motion: LinkMotion) -> &'static str {
    match motion {
        LinkMotion::Simple(_) | LinkMotion::Continuous => "a hinge or slide",
        LinkMotion::Complex(name) => name,
    }
}

fn is_sensor(body: &Body) -> bool {
    body.parts.iter().any(|part| part.surface == PartSurface::Housing)
}

/// Returns a name without the characters that are not possible in names of bodies and joints.
fn plain(name: &str) -> String {
    let plain: String =
        name.chars().map(|c| if c.is_alphanumeric() || "_-./ ".contains(c) { c } else { '_' }).collect();
    plain.trim_start_matches(['.', '/', ' ']).replace("..", "_")
}

fn placed(place: &na::Isometry3<f64>) -> Placing {
    Placing { position_m: place.translation.vector.into(), orientation_wxyz: shape::wxyz(&place.rotation) }
}

/// Returns the mass of a link of plastic from the box around its parts.
fn estimated_mass(parts: &[(Option<String>, Part)]) -> Inertial {
    let points = || parts.iter().flat_map(|(_, part)| shape::outline(&part.shape)).map(|point| point.coords);
    let Some(first) = points().next() else {
        return Inertial { mass_kg: 1e-3, centre_m: [0.0; 3], orientation_wxyz: UPRIGHT, diagonal: [1e-7; 3] };
    };
    let (low, high) = points().fold((first, first), |(low, high), p| (low.inf(&p), high.sup(&p)));
    let size = high - low;
    let mass_kg = (DENSITY * size.product()).max(1e-3);
    let square = size.component_mul(&size);
    let diagonal = [square.y + square.z, square.x + square.z, square.x + square.y];
    Inertial {
        mass_kg,
        centre_m: ((low + high) / 2.0).into(),
        orientation_wxyz: UPRIGHT,
        diagonal: diagonal.map(|s| (mass_kg * s / 12.0).max(1e-7)),
    }
}
