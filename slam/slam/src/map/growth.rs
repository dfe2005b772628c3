//! The box of the field follows the object: a larger field learns from the keyframes when the object reaches out of the old one.

// Why: notes/decisions/estimation.md, "The box grows, at most to 25 cm, and learns its keyframes anew".

use std::sync::Arc;

use mvt_field::field::{FieldConfig, FieldTrainer, NeuralField};
use mvt_frames::{Field, Isometry, World};
use rand_chacha::ChaCha8Rng;

use super::{Keyframe, Map};
use crate::scan::Scan;
use crate::space::Space;

/// How the box of a map changed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BoxChange {
    /// It reaches this far from the origin of the field now, metres.
    Grown(f32),
    /// The object reaches out of the largest box: the part beyond is not mapped.
    TooSmall,
}

/// Points nearer to the faces of the box than this count as outside: the field needs space around a surface, metres.
const BORDER_M: f32 = 0.004;
/// Share of a camera's points outside the box that makes it grow. Fewer may be mislabelled pixels.
const SHARE: f32 = 0.02;
/// The new box reaches farther than the seen points by this factor, because more of the object will be seen.
const MARGIN: f32 = 1.15;
/// The box grows by this factor at least, so that it grows twice at most.
const LEAST: f32 = 1.25;

impl Map {
    /// Compares a new keyframe with the box. Two keyframes in a row that reach out of it make it grow.
    pub(super) fn follow(&mut self, keyframe: &Keyframe, rng: &mut ChaCha8Rng) -> Option<BoxChange> {
        let half_m = self.half_extent_m();
        let reaches: Vec<f32> = keyframe
            .scan()
            .views
            .iter()
            .filter(|view| view.is_camera())
            .flat_map(|view| view.hits.iter().map(|hit| keyframe.to_field(view.point(hit)).abs().max_element()))
            .collect();
        let mut outside: Vec<f32> = reaches.iter().copied().filter(|reach| *reach > half_m - BORDER_M).collect();
        if outside.len() as f32 <= SHARE * reaches.len() as f32 {
            self.outside = 0;
            return None;
        }
        self.outside += 1;
        if self.outside < 2 {
            return None;
        }
        let largest_m = self.config.largest_half_extent_m;
        if half_m >= largest_m {
            // Said once.
            return (self.outside == 2).then_some(BoxChange::TooSmall);
        }
        outside.sort_by(f32::total_cmp);
        // Some pixels of the hand or of the background may count as the object's.
        let seen_m = outside.get(outside.len() * 9 / 10).copied().unwrap_or(half_m);
        let grown_m = (seen_m * MARGIN).max(half_m * LEAST).min(largest_m);
        self.grow(grown_m, keyframe, rng).then_some(BoxChange::Grown(grown_m))
    }

    /// Learns all keyframes anew in a box that reaches `half_extent_m`. Takes as long as the first frame.
    fn grow(&mut self, half_extent_m: f32, current: &Keyframe, rng: &mut ChaCha8Rng) -> bool {
        let config = FieldConfig { half_extent_m, ..self.field().config().clone() };
        // A box that is larger than a valid one is valid.
        let Ok(field) = NeuralField::new(&config, self.seed) else { return false };
        self.trainer = FieldTrainer::new(field);
        self.space = Space::new(half_extent_m);
        let kept = std::mem::take(&mut self.keyframes);
        for keyframe in kept {
            self.take_back(&keyframe.shared_scan(), keyframe.pose());
        }
        self.unseen = self.space.unseen();
        for _ in 0..self.config.first_steps {
            self.samples.clear();
            self.draw(current, rng);
            self.trainer.step(&self.samples);
        }
        self.outside = 0;
        true
    }

    /// Adds a keyframe as it was at an earlier time.
    pub(super) fn take_back(&mut self, scan: &Arc<Scan>, pose: Isometry<Field, World>) {
        let occupied = self.occupied(scan);
        let mut keyframe = Keyframe::new(Arc::clone(scan), pose, occupied, self.half_extent_m());
        self.add_to_space(&keyframe);
        keyframe.thin_occupied();
        self.keyframes.push(keyframe);
    }
}
