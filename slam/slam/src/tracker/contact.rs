//! Contacts: pads that touch carry the surface with them.

use glam::Vec3;
use nalgebra as na;

use super::{Instant, ROBUST_SIGMAS, Tracker, interval_s, to_na};
use crate::scan::{Detail, View};
use mvt_graph::system::{Loss, System, along};

/// A pad that touches: which one, where it is, where its contact is, and which way its gel faces.
#[derive(Debug, Clone, Copy)]
pub(super) struct PressedPad {
    pub index: usize,
    world_from_pad: na::Isometry3<f64>,
    contact: na::Point3<f64>,
    normal: na::Vector3<f64>,
    pub pressed_px: usize,
}

impl Tracker {
    /// A pad that touches in both frames carries the touched surface with it, but for slip.
    pub(super) fn add_contacts(&self, system: &mut System, a: (Option<usize>, &Instant), b: (Option<usize>, &Instant)) {
        if self.config.contact_weight == 0.0 {
            return;
        }
        let still = self.config.slip_still_1s_sigma_m * interval_s(a.1.scan.time_s, b.1.scan.time_s).sqrt();
        let changing = self.config.slip_changing_sigma_m;
        for pad in &a.1.pads {
            let Some(after) = b.1.pads.iter().find(|after| after.index == pad.index) else { continue };
            let s = 1.0 / (still + changing * change(pad.pressed_px, after.pressed_px));
            let carried = after.world_from_pad * (pad.world_from_pad.inverse() * pad.contact);
            let material = a.1.pose.inverse() * pad.contact;
            let now = b.1.pose * material;
            let across = pad.normal.cross(&least_axis(pad.normal)).normalize();
            for direction in [across, pad.normal.cross(&across)] {
                let inside = b.1.pose.rotation.inverse() * direction;
                let j = along(inside, material.coords) * s;
                let r = direction.dot(&(now - carried)) * s;
                system.add(r, &[(b.0, j), (a.0, -j)], self.config.contact_weight, Loss::Cauchy(ROBUST_SIGMAS));
            }
        }
    }
}

/// Touched pixels below which a contact has no place, as of a sample of some hundred.
const PAD_HITS: usize = 10;

pub(super) fn pressed_pad(view: &View) -> Option<PressedPad> {
    let Detail::Touch { index, pad: Some(pad) } = view.detail else { return None };
    if view.hits.len() < PAD_HITS {
        return None;
    }
    let n = view.hits.len() as f32;
    let contact = view.hits.iter().map(|hit| view.point(hit)).sum::<Vec3>() / n;
    let normal = view.hits.iter().map(|hit| hit.normal).sum::<Vec3>().try_normalize()?;
    Some(PressedPad {
        index,
        world_from_pad: pad.world_from_pad.untyped(),
        contact: to_na(contact).into(),
        normal: to_na(normal),
        pressed_px: pad.pressed_px,
    })
}

/// Pixels by which a pressed area changes without slip.
const CHANGE_PX: f64 = 200.0;

/// How much a pressed area changed, from 0 to 1: one that stays the same sticks, one that grows, shrinks or is small slips.
fn change(before_px: usize, after_px: usize) -> f64 {
    // Why: notes/decisions/estimation.md, "A pad whose pressed area is constant does not slip".
    (before_px.abs_diff(after_px) as f64 + CHANGE_PX) / ((before_px + after_px) as f64 + CHANGE_PX)
}

fn least_axis(v: na::Vector3<f64>) -> na::Vector3<f64> {
    let mut axis = na::Vector3::zeros();
    axis[v.iamin()] = 1.0;
    axis
}
