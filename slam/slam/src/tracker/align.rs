//! A start for fast motion: the newest frame is laid on the frame before, from coarse to fine, before the shape is asked.
//!
//! The shape attracts points from a few millimetres only. Two frames of a camera attract each other as far as their points are matched, and
//! this reach is narrowed step by step (projective point-to-plane alignment: Rusinkiewicz and Levoy, "Efficient variants of the ICP
//! algorithm", 2001), together with the resolution at which their brightness is compared.

use nalgebra as na;

use super::assess::LEVER_M;
use super::icp::{self, Matching, Posed};
use super::photometric::{self, Comparison};
use super::query::ask_measured;
use super::{FINAL_LEVEL, Instant, ROBUST_SIGMAS, Reference, Tracker, WORSE_SIGMAS, to_na};
use crate::earlier::EarlierView;
use crate::scan::LEVELS;
use mvt_frames::se3::Twist;
use mvt_frames::{Field, Isometry, World, se3};
use mvt_graph::system::{Loss, System, along};

/// Points that are matched, and how many of them are independent.
const POINTS: usize = 400;
/// Steps at each resolution.
const STEPS: usize = 5;
/// A step below this ends them, metres and radians.
const SMALL_STEP: f64 = 1e-4;
/// Turns about an axis of revolution that are tried.
const SPINS: usize = 24;
/// The surface does not hold a turn that moves it off itself by less than this part of what another motion does, squared.
const WEAK: f64 = 0.02;
/// Poses that differ by more than this rotation are different ones, radians.
const APART_RAD: f64 = 20.0 * std::f64::consts::PI / 180.0;
/// Brightness recognises a pose if it correlates by so much more than at any different pose.
const CLEARLY: f64 = 0.15;
/// Brightness that correlates by this much with that of views from elsewhere is recognised: light and slant differ, by up to 70 degrees.
const RECOGNISED: f64 = 0.5;
/// Fewer matches than this say nothing about a motion.
const FEWEST_MATCHES: usize = 30;

impl Tracker {
    /// Moves the newest frame to where it lies on the frame before and on earlier views that are `alike`, unless the shape speaks against it.
    /// Without a reach it moves along with its seen points at most, and is compared with these views only.
    pub(crate) fn align(&mut self, shape: &dyn Reference, alike: &dyn Fn(Isometry<Field, World>) -> Vec<EarlierView>) {
        let is_near = self.config.align_reach_m == 0.0;
        if is_near {
            self.follow_seen(shape);
        }
        let Some(start) = self.window.back().map(|newest| newest.pose) else { return };
        if is_near {
            if self.config.texel_weight > 0.0 {
                self.place(start, alike);
            }
            return;
        }
        let median = self.median_residual(shape);
        let fits = |tracker: &Self| tracker.median_residual(shape) <= median + WORSE_SIGMAS;
        let has_texels =
            self.window.back().is_some_and(|newest| newest.scan.views.iter().any(|view| view.texels().is_some()));
        let mut best = start;
        // Depth alone goes first where brightness leads nowhere: after a leap places do not lie within a few pixels of where they were.
        for is_depth_first in [false, true] {
            self.place(start, alike);
            // Twice, with the earlier views that are alike at the pose that is found.
            for _ in 0..2 {
                if let Some(pose) = self.aligned(is_depth_first) {
                    self.place(pose, alike);
                }
            }
            let does_fit = fits(self);
            if does_fit && (self.judge_texels() || !has_texels) {
                return;
            }
            if let Some(newest) = self.window.back().filter(|_| does_fit && !is_depth_first) {
                best = newest.pose;
            }
        }
        self.place(best, alike);
        self.judge_texels();
    }

    /// Places the newest frame, and gives it the earlier views that are alike there.
    fn place(&mut self, pose: na::Isometry3<f64>, alike: &dyn Fn(Isometry<Field, World>) -> Vec<EarlierView>) {
        if let Some(newest) = self.window.back_mut() {
            newest.pose = pose;
            newest.earlier = alike(Isometry::new(pose));
        }
    }

    /// Notes and returns whether the newest frame shows the brightness of the frame before.
    fn judge_texels(&mut self) -> bool {
        let Some(newest) = self.window.back() else { return false };
        let now = Posed::new(newest);
        let before = self
            .window
            .iter()
            .rev()
            .nth(1)
            .and_then(|before| photometric::correlation([Posed::new(before)], now, FINAL_LEVEL));
        let agrees = before.is_some_and(|correlation| correlation > photometric::AGREES);
        if let Some(newest) = self.window.back_mut() {
            newest.texels_agree = agrees;
        }
        agrees
    }

    /// Poses of the newest frame that depth cannot tell from one: turned about the axis about which the seen surface looks the same from all sides.
    pub(crate) fn spun(&self, shape: &dyn Reference, pose: Isometry<Field, World>) -> Vec<Isometry<Field, World>> {
        let Some(newest) = self.window.back() else { return Vec::new() };
        let pose = pose.untyped();
        let (points, distances, trusted) = ask_measured(shape, &pose, newest.measured.iter().map(|m| m.point));
        let seen = || (0..points.len()).filter(|i| trusted[*i]);
        let middle = seen().map(|i| to_na(points[i])).sum::<na::Vector3<f64>>() / seen().count().max(1) as f64;
        // Of an object of revolution all normals meet its axis, wherever that lies: twists of the pose that move no point off the surface.
        let information: na::Matrix6<f64> = seen()
            .map(|i| along(to_na(distances[i].gradient), (to_na(points[i]) - middle) / LEVER_M))
            .map(|j| j * j.transpose())
            .sum();
        let eigen = information.symmetric_eigen();
        let (weakest, strongest) = (eigen.eigenvalues.imin(), eigen.eigenvalues.max());
        let twist: Twist = eigen.eigenvectors.column(weakest).into_owned();
        let turn = twist.fixed_rows::<3>(3).into_owned();
        if eigen.eigenvalues[weakest] > WEAK * strongest || turn.norm() < 0.5 {
            return Vec::new();
        }
        let axis = na::Unit::new_normalize(turn);
        // The axis goes through the point that the twist leaves where it is.
        let through = middle + LEVER_M * turn.cross(&twist.fixed_rows::<3>(0).into_owned()) / turn.norm_squared();
        let spin = |k: usize| {
            let turn = na::UnitQuaternion::from_axis_angle(&axis, k as f64 * std::f64::consts::TAU / SPINS as f64);
            let about = na::Translation3::from(through) * turn * na::Translation3::from(-through);
            Isometry::new(pose * about)
        };
        (1..SPINS).map(spin).collect()
    }

    /// Of poses of the newest frame, refined against shape and brightness, the one whose brightness correlates best with that of earlier views that
    /// are alike, the most alike first; `None` if none agrees, or several.
    pub(crate) fn recognise(
        &self,
        shape: &dyn Reference,
        candidates: &[Isometry<Field, World>],
        most_alike: &dyn Fn(Isometry<Field, World>) -> Vec<EarlierView>,
    ) -> Option<Isometry<Field, World>> {
        let newest = self.window.back()?;
        let judged = candidates.iter().filter_map(|candidate| {
            let views: Vec<_> =
                most_alike(*candidate).into_iter().map(|view| (view.scan, view.pose.untyped())).collect();
            let posed = || views.iter().map(|(scan, pose)| Posed { scan, pose });
            let then = posed().next()?;
            let mut pose = candidate.untyped();
            for level in [2, 2, 2, 1, 1, 1] {
                let mut system = System::new(1);
                self.add_surface(&mut system, shape, newest, (Some(0), &pose), Loss::Cauchy(ROBUST_SIGMAS));
                let comparison = Comparison { level, independent: POINTS as f64 };
                let now = (Some(0), Posed { scan: &newest.scan, pose: &pose });
                photometric::add(&mut system, (None, then), now, comparison);
                pose *= se3::exp(&system.step(1e-3)?.fixed_rows::<6>(0).into_owned());
            }
            pose.rotation.renormalize();
            let now = Posed { scan: &newest.scan, pose: &pose };
            // At the coarsest resolution a view from elsewhere still looks alike.
            let best = photometric::correlation(posed(), now, LEVELS - 1).filter(|best| *best > RECOGNISED)?;
            Some((best, Isometry::new(pose)))
        });
        let judged: Vec<(f64, Isometry<Field, World>)> = judged.collect();
        let (best, pose) = judged.iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        let is_clear =
            judged.iter().all(|(other, at)| !is_apart(&pose.untyped(), &at.untyped()) || *other < best - CLEARLY);
        is_clear.then_some(*pose)
    }

    /// The pose at which the newest frame lies on the frame before and on its earlier views; `None` if too little of it does.
    fn aligned(&self, is_depth_first: bool) -> Option<na::Isometry3<f64>> {
        let mut instants = self.window.iter().rev();
        let (newest, before) = (instants.next()?, instants.next()?);
        let mut pose = newest.pose;
        let depth_alone = is_depth_first.then_some((LEVELS - 1, 0.0));
        for (level, with_texels) in depth_alone.into_iter().chain((0..LEVELS).rev().map(|level| (level, 1.0))) {
            let narrowed = level as f64 / (LEVELS - 1) as f64;
            let reach_m = self.config.align_reach_m.powf(narrowed) * f64::from(icp::REACH_M).powf(1.0 - narrowed);
            let matching = Matching { points: POINTS, independent: POINTS as f64, reach_m: reach_m as f32 };
            let independent = POINTS as f64 * self.config.texel_weight * with_texels;
            let comparison = Comparison { level, independent };
            for _ in 0..STEPS {
                let mut system = System::new(1);
                let now = || (Some(0), Posed { scan: &newest.scan, pose: &pose });
                let [_, matched] = icp::add(&mut system, (None, Posed::new(before)), now(), matching);
                if matched < FEWEST_MATCHES {
                    return None;
                }
                if independent > 0.0 {
                    photometric::add(&mut system, (None, Posed::new(before)), now(), comparison);
                    add_earlier(&mut system, newest, now(), comparison);
                }
                let step: Twist = system.step(1e-3)?.fixed_rows::<6>(0).into_owned();
                pose *= se3::exp(&step);
                if step.norm() < SMALL_STEP {
                    break;
                }
            }
        }
        pose.rotation.renormalize();
        Some(pose)
    }
}

/// Whether two poses are turned against each other.
pub(super) fn is_apart(a: &na::Isometry3<f64>, b: &na::Isometry3<f64>) -> bool {
    a.rotation.angle_to(&b.rotation) > APART_RAD
}

/// Adds the brightness of the earlier views of an instant.
pub(super) fn add_earlier(
    system: &mut System,
    instant: &Instant,
    now: (Option<usize>, Posed<'_>),
    comparison: Comparison,
) {
    for view in &instant.earlier {
        let pose = view.pose.untyped();
        photometric::add(system, (None, Posed { scan: &view.scan, pose: &pose }), now, comparison);
    }
}
