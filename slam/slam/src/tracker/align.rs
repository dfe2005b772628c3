//! A start for fast motion: the newest frame is laid on the frame before, from coarse to fine, before the shape is asked.
//!
//! The shape attracts points from a few millimetres only. Two frames of a camera attract each other as far as their points are matched, and
//! this reach is narrowed step by step (projective point-to-plane alignment: Rusinkiewicz and Levoy, "Efficient variants of the ICP
//! algorithm", 2001), together with the resolution at which their brightness is compared.

use nalgebra as na;

use super::icp::{self, Matching, Posed};
use super::photometric::{self, Comparison};
use super::system::System;
use super::{Instant, Reference, Tracker, WORSE_SIGMAS};
use crate::earlier::EarlierView;
use crate::scan::LEVELS;
use mvt_frames::se3::Twist;
use mvt_frames::{Field, Isometry, World, se3};

/// Points that are matched, and how many of them are independent.
const POINTS: usize = 400;
/// Steps at each resolution.
const STEPS: usize = 5;
/// A step below this ends them, metres and radians.
const SMALL_STEP: f64 = 1e-4;
/// Fewer matches than this say nothing about a motion.
const FEWEST_MATCHES: usize = 30;

impl Tracker {
    /// Moves the newest frame to where it lies on the frame before and on earlier views that are `alike`, unless the shape speaks against it.
    pub(crate) fn align(&mut self, shape: &dyn Reference, alike: &dyn Fn(Isometry<Field, World>) -> Vec<EarlierView>) {
        if self.config.align_reach_m == 0.0 {
            return;
        }
        let (median, start) = (self.median_residual(shape), self.window.back().map(|newest| newest.pose));
        let (Some(start), Some(pose)) = (start, self.aligned()) else { return };
        let is_worse = |tracker: &Self| tracker.median_residual(shape) > median + WORSE_SIGMAS;
        let place = |tracker: &mut Self, pose: na::Isometry3<f64>| {
            if let Some(newest) = tracker.window.back_mut() {
                newest.pose = pose;
                newest.earlier = alike(Isometry::new(pose));
            }
        };
        place(self, pose);
        // Once more, with the earlier views that are alike at this pose.
        if let Some(pose) = self.aligned() {
            place(self, pose);
        }
        if is_worse(self) {
            place(self, start);
        }
    }

    /// The pose at which the newest frame lies on the frame before and on its earlier views; `None` if too little of it does.
    fn aligned(&self) -> Option<na::Isometry3<f64>> {
        let mut instants = self.window.iter().rev();
        let (newest, before) = (instants.next()?, instants.next()?);
        let mut pose = newest.pose;
        for level in (0..LEVELS).rev() {
            let narrowed = (LEVELS - 1) as f64;
            let reach_m = self.config.align_reach_m.powf(level as f64 / narrowed)
                * f64::from(icp::REACH_M).powf(1.0 - level as f64 / narrowed);
            for _ in 0..STEPS {
                let mut system = System::new(1);
                let now = || (Some(0), Posed { scan: &newest.scan, pose: &pose });
                let matching = Matching { points: POINTS, independent: POINTS as f64, reach_m: reach_m as f32 };
                let [_, matched] = icp::add(&mut system, (None, Posed::new(before)), now(), matching);
                if matched < FEWEST_MATCHES {
                    return None;
                }
                let independent = POINTS as f64 * self.config.texel_weight;
                let comparison = Comparison { level, independent };
                photometric::add(&mut system, (None, Posed::new(before)), now(), comparison);
                add_earlier(&mut system, newest, now(), comparison);
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
