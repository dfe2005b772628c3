//! Keyframe poses follow the field, which learns from all of them, so that drift spreads instead of staying.

use nalgebra as na;

use super::Map;
use crate::space::Space;
use crate::tracker::query::surface;
use mvt_field::shape::Distance;
use mvt_field::shape::Shape as _;
use mvt_frames::{Isometry, se3};
use mvt_graph::system::{Loss, System};

/// Points of a keyframe's camera and of each touch that take part.
const POINTS: [usize; 2] = [200, 40];
/// Steps per turn: it comes round again.
const STEPS: usize = 2;
/// The first keyframe, which all poses refer to, is refined more often: after every Nth other.
const FIRST_EVERY: usize = 10;
/// Independent points among them.
const INDEPENDENT: [f64; 2] = [60.0, 15.0];

impl Map {
    /// Refines the next keyframe in turn against the field.
    pub(super) fn refine_one(&mut self) {
        let count = self.keyframes.len();
        if count < 3 {
            return;
        }
        self.next_refined = (self.next_refined + 1) % (count + count / FIRST_EVERY);
        let k = if self.next_refined < count { self.next_refined } else { 0 };
        let mut pose = self.keyframes[k].pose().untyped();
        // One turn moves it only so far: what all keyframes agree on comes about over many.
        let anchor = pose;
        for _ in 0..STEPS {
            let mut system = System::new(1);
            self.add_measured(&mut system, k, &pose);
            let moved = se3::log(&(anchor.inverse() * pose));
            for row in 0..6 {
                let s = 1.0 / [self.config.refine_sigma_m, self.config.refine_sigma_rad][row / 3];
                let mut j = se3::Twist::zeros();
                j[row] = s;
                system.add(moved[row] * s, &[(Some(0), j)], 1.0, Loss::Square);
            }
            let Some(step) = system.step(1e-6) else { return };
            pose *= se3::exp(&step.fixed_rows::<6>(0).into_owned());
        }
        self.keyframes[k].set_pose(Isometry::new(pose));
    }

    fn add_measured(&self, system: &mut System, k: usize, pose: &na::Isometry3<f64>) {
        let model_from_world = pose.inverse();
        let space: &Space = &self.space;
        for view in &self.keyframes[k].scan().views {
            let kind = usize::from(!view.is_camera());
            let hits = &view.hits[..view.hits.len().min(POINTS[kind])];
            let points: Vec<_> =
                hits.iter().map(|hit| crate::tracker::apply(&model_from_world, view.point(hit))).collect();
            let mut distances = vec![Distance::default(); points.len()];
            self.field().distances_and_gradients(&points, &mut distances);
            let share = (INDEPENDENT[kind] / hits.len().max(1) as f64).min(1.0);
            for ((hit, point), distance) in hits.iter().zip(&points).zip(&distances) {
                if space.is_near_surface(*point) {
                    let (r, j) = surface(*point, *distance);
                    let s = 1.0 / f64::from(hit.sigma_m.hypot(self.config.surface_sigma_m));
                    system.add(r * s, &[(Some(0), j * s)], share, Loss::Cauchy(2.0));
                }
            }
        }
    }
}
