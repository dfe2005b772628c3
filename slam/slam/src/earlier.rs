//! Earlier views of the object with which the colours of a new one are compared.

use std::sync::Arc;

use mvt_frames::{Field, Isometry, World};

use crate::scan::Scan;

/// A scan with the pose that the object had in it.
#[derive(Debug, Clone)]
pub(crate) struct EarlierView {
    pub scan: Arc<Scan>,
    pub pose: Isometry<Field, World>,
}

/// Views that differ by more than this rotation show the surface too differently, radians.
const ALIKE_RAD: f64 = 20.0 * std::f64::consts::PI / 180.0;
/// At a coarse resolution a view is recognised although it differs by this rotation, radians.
const RECOGNISED_RAD: f64 = 70.0 * std::f64::consts::PI / 180.0;
/// Most views that are compared to recognise one.
const COMPARED: usize = 12;
/// A view of a known shape is kept if it differs from all others by this rotation, radians.
const NEW_RAD: f64 = 8.0 * std::f64::consts::PI / 180.0;
/// Most views kept of a known shape: its pictures take about 100 kB each.
const MOST: usize = 600;

/// Of views in order of time, those that are compared with a view at a pose: the oldest that is alike, which ends drift, and the one
/// that is most alike.
pub(crate) fn alike(views: impl Iterator<Item = EarlierView>, pose: Isometry<Field, World>) -> Vec<EarlierView> {
    let rotation = pose.untyped().rotation;
    let turn = |view: &EarlierView| view.pose.untyped().rotation.angle_to(&rotation);
    let mut alike: Vec<EarlierView> = views.filter(|view| view.scan.has_picture() && turn(view) < ALIKE_RAD).collect();
    let nearest = alike.iter().enumerate().skip(1).min_by(|a, b| turn(a.1).total_cmp(&turn(b.1))).map(|(k, _)| k);
    if let Some(nearest) = nearest {
        alike.swap(1, nearest);
    }
    alike.truncate(2);
    alike
}

/// Of views in order of time, those that are alike enough to a view at a pose to recognise it, the most alike first, and [`COMPARED`] at most.
pub(crate) fn most_alike(views: impl Iterator<Item = EarlierView>, pose: Isometry<Field, World>) -> Vec<EarlierView> {
    let rotation = pose.untyped().rotation;
    let turned = views
        .filter(|view| view.scan.has_picture())
        .map(|view| (view.pose.untyped().rotation.angle_to(&rotation), view))
        .filter(|(turn_rad, _)| *turn_rad < RECOGNISED_RAD);
    let mut turned: Vec<_> = turned.collect();
    turned.sort_by(|a, b| a.0.total_cmp(&b.0));
    turned.into_iter().take(COMPARED).map(|(_, view)| view).collect()
}

/// Keeps a view of a known shape if no other is like it.
pub(crate) fn keep(views: &mut Vec<EarlierView>, scan: &Arc<Scan>, pose: Isometry<Field, World>) {
    let rotation = pose.untyped().rotation;
    let is_new = views.iter().all(|view| view.pose.untyped().rotation.angle_to(&rotation) > NEW_RAD);
    if is_new && scan.has_picture() && views.len() < MOST {
        views.push(EarlierView { scan: Arc::new(scan.earlier()), pose });
    }
}
