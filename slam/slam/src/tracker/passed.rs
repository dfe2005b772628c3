//! Rays that passed the object: they lie outside of it.

use glam::Vec3;

use super::{Reference, Tracker, Vacant, apply, to_vec};

/// Distance between the samples of a ray that passed, metres.
const PASSED_STEP_M: f32 = 0.008;
/// Rays that passed, per view.
const PASSED_RAYS: usize = 100;
/// How exactly a ray that passed is known at its nearest point, metres: a pixel and its displacement.
const PASSED_SIGMA_M: f32 = 0.001;
/// Half the diagonal of the largest object that a hand turns, metres.
const REACH_M: f32 = 0.1;

impl Tracker {
    /// For rays that passed the object: where they come nearest to it.
    pub(super) fn choose_passed(&mut self, shape: &dyn Reference) {
        if self.config.free_space_weight == 0.0 {
            return;
        }
        let held = self.held();
        for instant in self.window.iter_mut().skip(held) {
            instant.passed.clear();
            let model_from_world = instant.pose.inverse();
            let centre = to_vec(instant.pose.translation.vector);
            for view in instant.scan.views.iter().filter(|view| view.is_camera()) {
                let mut samples = Vec::new();
                let mut rays = Vec::new();
                for miss in &view.misses {
                    // Only the part of the ray that may meet the object.
                    let middle = (centre - view.origin).dot(miss.direction);
                    let beside = (view.origin + miss.direction * middle - centre).length_squared();
                    let reach = REACH_M * REACH_M - beside;
                    if reach <= 0.0 || rays.len() == PASSED_RAYS {
                        continue;
                    }
                    let (from, to) = (middle - reach.sqrt(), (middle + reach.sqrt()).min(miss.free_m - PASSED_STEP_M));
                    let first = samples.len();
                    let mut t = from;
                    while t < to {
                        samples.push(view.origin + miss.direction * t);
                        t += PASSED_STEP_M;
                    }
                    if samples.len() > first {
                        rays.push(first..samples.len());
                    }
                }
                let inside: Vec<Vec3> = samples.iter().map(|&p| apply(&model_from_world, p)).collect();
                let mut distances = vec![0.0; inside.len()];
                shape.distances(&inside, &mut distances);
                let share = (0.25 * self.config.camera_independent / rays.len().max(1) as f64).min(1.0);
                for ray in rays {
                    let Some(nearest) = ray.min_by(|&a, &b| distances[a].total_cmp(&distances[b])) else { continue };
                    if distances[nearest] < 0.5 * PASSED_STEP_M {
                        instant.passed.push(Vacant {
                            point: samples[nearest],
                            clearance_m: 0.0,
                            sigma_m: PASSED_SIGMA_M,
                            share,
                        });
                    }
                }
            }
        }
    }
}
