//! Training samples of the field: on, before and behind measured surfaces, in free space, in obstacles and inside the object.

use glam::Vec3;
use rand::{Rng, RngExt as _};
use rand_chacha::ChaCha8Rng;

use super::{Keyframe, Map};
use crate::scan::{Hit, View};
use crate::space::{Assumed, clip};
use mvt_field::field::Sample;

/// A bound in front of a measured surface leaves so much room for noise of its depth, in parts of `behind_m`.
const ROOM: f32 = 0.5;

impl Map {
    /// Draws a batch of samples.
    pub(super) fn draw(&mut self, current: &Keyframe, rng: &mut ChaCha8Rng) {
        let mut samples = std::mem::take(&mut self.samples);
        let config = &self.config;
        let truncation = self.field().config().truncation_m;
        let half = self.half_extent_m();
        let bounds = [
            config.band_part,
            config.band_part + config.before_part,
            config.band_part + config.before_part + config.passed_part,
            config.band_part + config.before_part + config.passed_part + config.hand_part,
        ];
        for _ in 0..config.batch {
            let [kind, age] = [uniform(rng), uniform(rng)];
            let keyframe = match self.keyframes.len() {
                n if n > 0 && age >= config.current_part => &self.keyframes[below(rng, n)],
                _ => current,
            };
            let sample = if kind < bounds[1] {
                surface_ray(keyframe, config.touch_part, rng).map(|(view, hit)| {
                    let behind = if kind < bounds[0] {
                        let band = truncation + config.behind_m;
                        config.behind_m - uniform(rng) * band
                    } else {
                        -truncation - uniform(rng) * (config.free_reach_m.min(hit.range_m) - truncation).max(0.0)
                    };
                    let position = keyframe.to_field(view.origin + hit.direction * (hit.range_m + behind));
                    // Why: notes/decisions/estimation.md, "Farther in front of a surface than behind it, samples are bounds".
                    let is_bound = -behind > config.behind_m;
                    let distance = -behind - if is_bound { ROOM * config.behind_m } else { 0.0 };
                    let target = (distance * hit.cosine / truncation).clamp(-1.0, 1.0);
                    let weight = if kind < bounds[0] { 1.0 } else { config.free_weight };
                    Sample { position, target, weight, at_least: is_bound && target < 1.0 }
                })
            } else if kind < bounds[2] {
                passed_ray(keyframe, half, rng).map(|position| Sample {
                    position,
                    target: 1.0,
                    weight: config.free_weight,
                    at_least: false,
                })
            } else if kind < bounds[3] {
                pick(keyframe.occupied(), rng).map(|o| Sample {
                    position: o.point,
                    target: (o.depth_m / truncation).min(1.0),
                    weight: config.free_weight,
                    at_least: true,
                })
            } else {
                pick(&self.unseen, rng).map(|unseen| {
                    let jitter = Vec3::from_array(std::array::from_fn(|_| uniform(rng) - 0.5));
                    let position = unseen.centre + jitter * self.space.resolution_m();
                    let is_shell = unseen.assumed == Assumed::Inside && unseen.depth_m <= config.core_depth_m;
                    let weight = if is_shell { config.inside_weight } else { config.core_weight };
                    let target = if unseen.assumed.is_object() { -1.0 } else { 1.0 };
                    Sample { position, target, weight, at_least: false }
                })
            };
            samples.extend(sample.filter(|s| s.position.abs().max_element() < half));
        }
        self.samples = samples;
    }
}

/// A ray that hit the object, from touch with probability `touch_part` where there is any.
fn surface_ray<'a>(keyframe: &'a Keyframe, touch_part: f32, rng: &mut ChaCha8Rng) -> Option<(&'a View, &'a Hit)> {
    let wants_touch = uniform(rng) < touch_part;
    let touching = |view: &&View| !view.is_camera() && !view.hits.is_empty();
    let seeing = |view: &&View| view.is_camera() && !view.hits.is_empty();
    let views = &keyframe.scan().views;
    let touches = views.iter().filter(touching).count();
    let cameras = views.iter().filter(seeing).count();
    let view = if touches > 0 && (wants_touch || cameras == 0) {
        views.iter().filter(touching).nth(below(rng, touches))?
    } else {
        views.iter().filter(seeing).nth(below(rng, cameras.max(1)))?
    };
    Some((view, pick(&view.hits, rng)?))
}

/// A point in free space on a ray that passed the object, within the box; model frame.
fn passed_ray(keyframe: &Keyframe, half: f32, rng: &mut ChaCha8Rng) -> Option<Vec3> {
    let view = pick(&keyframe.scan().views, rng)?;
    let miss = pick(&view.misses, rng)?;
    let (origin, direction) = (keyframe.to_field(view.origin), keyframe.turn_to_field(miss.direction));
    let (enter, leave) = clip(origin, direction, half)?;
    let (enter, leave) = (enter.max(0.0), leave.min(miss.free_m));
    (enter < leave).then(|| origin + direction * (enter + uniform(rng) * (leave - enter)))
}

fn pick<'a, T>(list: &'a [T], rng: &mut ChaCha8Rng) -> Option<&'a T> {
    if list.is_empty() { None } else { list.get(below(rng, list.len())) }
}

fn uniform(rng: &mut ChaCha8Rng) -> f32 {
    rng.random()
}

/// Uniform in 0..n, by multiplication instead of division; the bias is below n / 2^32.
fn below(rng: &mut ChaCha8Rng, n: usize) -> usize {
    ((u64::from(rng.next_u32()) * n as u64) >> 32) as usize
}
