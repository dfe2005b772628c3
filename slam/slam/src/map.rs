//! The growing shape: keyframes, the space that they saw, and the field that learns from them.

mod file;
mod growth;
mod keyframe;
mod loops;
mod refine;
mod sampling;
mod support;

use std::sync::Arc;

use glam::Vec3;
use mvt_field::surface::outer_surface;
use mvt_frames::{Field, Isometry, Model, Occupied, World};
use mvt_mesh::Mesh;
use mvt_settings::{SettingError, settings};
use nalgebra as na;
use rand_chacha::ChaCha8Rng;

use crate::obstacles::Obstacles;
use crate::scan::Scan;
use crate::space::{Space, Unseen};
use crate::tracker::Reference;
pub use growth::BoxChange;
pub use keyframe::Keyframe;
use mvt_field::field::{self, FieldTrainer, NeuralField, Sample};
use mvt_field::shape::{Distance, Shape};
use mvt_graph::Edge;

settings! {
    /// Keyframes, and the samples on which the field is trained.
    pub struct MapConfig {
        /// Steps of the optimiser on the first frame.
        pub first_steps: usize = 200, 0..=100_000;
        /// Steps of the optimiser per second on later frames.
        pub steps_per_s: f64 = 360.0, 0.0..=1e6;
        /// Samples per step.
        pub batch: usize = 2048, 1..=1_000_000;
        /// Depth of the samples behind a measured surface that count as inside, metres. Thin walls need less, uncertain poses more.
        pub behind_m: f32 = 0.003, 1e-4..=0.05;
        /// Depth of the free space in front of a measured surface that is sampled, metres.
        pub free_reach_m: f32 = 0.06, 0.0..=1.0;
        /// Part of the samples from the current frame. The other samples replay keyframes; without them the field forgets.
        pub current_part: f32 = 0.3, 0.0..=1.0;
        /// Part of the samples of measured surfaces that comes from touch, if a sensor touches.
        pub touch_part: f32 = 0.15, 0.0..=1.0;
        /// Part of the samples in the band around measured surfaces.
        pub band_part: f32 = 0.5, 0.0..=1.0;
        /// Part of the samples in front of measured surfaces.
        pub before_part: f32 = 0.2, 0.0..=1.0;
        /// Part of the samples on rays that passed the object.
        pub passed_part: f32 = 0.15, 0.0..=1.0;
        /// Part of the samples inside the hand, where the object cannot be.
        pub hand_part: f32 = 0.05, 0.0..=1.0;
        /// Weight of samples in free space.
        pub free_weight: f32 = 1.0, 0.0..=1e6;
        /// Weight of samples in space that no sensor has seen and that the object must fill, such as the space between it and the palm.
        /// The rest of the samples lies there.
        pub inside_weight: f32 = 0.1, 0.0..=1e6;
        /// Weight of such samples deep inside. An unseen cavity there would be an error of the field; a pit in a face may reach less deep.
        pub core_weight: f32 = 1.0, 0.0..=1e6;
        /// Depth below the hull of the seen surface from which on core_weight counts, metres.
        pub core_depth_m: f32 = 0.01, 0.0..=1.0;
        /// Rotation of the object since the last keyframe that makes a keyframe, degrees.
        pub keyframe_turn_deg: f64 = 8.0, 0.0..=180.0;
        /// Translation since the last keyframe that makes a keyframe, metres.
        pub keyframe_distance_m: f64 = 0.005, 0.0..=1.0;
        /// Time since the last keyframe that makes a keyframe, seconds.
        pub keyframe_interval_s: f64 = 0.5, 0.0..=1e6;
        /// Most keyframes. Beyond this, every second one of the older half is dropped.
        pub keyframes: usize = 600, 4..=1_000_000;
        /// Keyframes whose pose is refined against the field per second.
        pub refined_per_s: f64 = 60.0, 0.0..=1e5;
        /// How far the refinement may move a keyframe, one standard deviation, metres.
        pub refine_sigma_m: f64 = 0.0005, 1e-6..=1.0;
        /// How far the refinement may turn a keyframe, one standard deviation, radians.
        pub refine_sigma_rad: f64 = 0.01, 1e-6..=10.0;
        /// A keyframe that saw the object turned by less than this against an older one closes a loop, degrees. 0 closes no loops.
        pub loop_turn_deg: f64 = 12.0, 0.0..=180.0;
        /// Largest half edge of the box around the object, metres. The box begins with slam.field.half_extent_m and grows when the object
        /// reaches out of it.
        pub largest_half_extent_m: f32 = 0.125, 0.005..=10.0;
        /// Whether meshes close the sides that no sensor saw by a guess.
        pub mesh_guesses: bool = true;
        /// Standard deviation of the learnt surface, metres.
        pub surface_sigma_m: f32 = 0.0004, 1e-6..=0.1;
    }
    rule = parts_fit;
}

fn parts_fit(config: &MapConfig) -> Result<(), SettingError> {
    let parts = config.band_part + config.before_part + config.passed_part + config.hand_part;
    // Half a thousandth: the parts are rounded numbers.
    if parts <= 1.0005 {
        return Ok(());
    }
    Err(SettingError::new("band_part + before_part + passed_part + hand_part", parts.to_string(), "at most 1"))
}

/// The growing shape.
pub struct Map {
    config: MapConfig,
    trainer: FieldTrainer,
    space: Space,
    keyframes: Vec<Keyframe>,
    /// Motions between keyframes as loops measured them.
    loops: Vec<Edge>,
    /// Cells that no sensor has seen, with the guesses about them.
    unseen: Vec<Unseen>,
    obstacles: Obstacles,
    samples: Vec<Sample>,
    /// The pose of the first keyframe as it came.
    first_pose: Option<Isometry<Model, World>>,
    /// Whose turn it is to be refined.
    next_refined: usize,
    /// Parts of steps of the optimiser and of refinements that are due.
    due: [f64; 2],
    /// Keyframes in a row that reach out of the box.
    outside: usize,
    /// Seed of fields.
    seed: u64,
}

/// After a longer pause no more is learnt than after this, seconds.
const LONGEST_INTERVAL_S: f64 = 0.5;
/// Stamps are rounded: so little less than a whole step is one.
const ROUNDING: f64 = 1e-3;

/// The result of learning from a frame.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Learnt {
    /// Whether it became a keyframe.
    pub keyframe: bool,
    /// If it closed a loop: takes coordinates of the corrected field frame to those before.
    pub correction: Option<na::Isometry3<f64>>,
    /// If the object reached out of the box.
    pub box_change: Option<BoxChange>,
}

impl Map {
    /// A map of nothing.
    ///
    /// # Errors
    /// [`SettingError`] if a setting of the field is out of range.
    pub fn new(
        config: MapConfig,
        field: &field::FieldConfig,
        obstacles: Obstacles,
        seed: u64,
    ) -> Result<Self, SettingError> {
        let trainer = FieldTrainer::new(NeuralField::new(field, seed)?);
        Ok(Self { seed, ..Self::with(config, trainer, obstacles) })
    }

    /// A map of nothing with a field that may have learnt something.
    fn with(config: MapConfig, trainer: FieldTrainer, obstacles: Obstacles) -> Self {
        Self {
            config,
            space: Space::new(trainer.field().config().half_extent_m),
            trainer,
            keyframes: Vec::new(),
            loops: Vec::new(),
            unseen: Vec::new(),
            obstacles,
            samples: Vec::new(),
            first_pose: None,
            next_refined: 0,
            due: [0.0; 2],
            outside: 0,
            seed: 0,
        }
    }

    /// The field as learnt so far.
    pub fn field(&self) -> &NeuralField {
        self.trainer.field()
    }

    /// Counts of seen and empty space.
    pub fn space(&self) -> &Space {
        &self.space
    }

    /// The surface in the model's frame, with cells of `cell_m` metres; without the guesses of sides that no sensor saw, if so configured.
    pub fn mesh(&self, cell_m: f32) -> Mesh {
        let mut mesh = outer_surface(self.field(), self.half_extent_m(), cell_m);
        if let Some(seen) = self.seen() {
            mesh = mesh.part(|vertex| seen.is_near_surface(vertex));
        }
        let (rotation, translation) = self.field_from_model().inverse().to_f32();
        for vertex in &mut mesh.vertices {
            *vertex = Vec3::from(rotation * glam::Vec3A::from(*vertex) + translation);
        }
        mesh
    }

    /// The space to whose seen surface meshes are limited, if they are.
    pub fn seen(&self) -> Option<&Space> {
        (!self.config.mesh_guesses).then_some(&self.space)
    }

    /// The keyframes, oldest first.
    pub fn keyframes(&self) -> &[Keyframe] {
        &self.keyframes
    }

    /// From the frame that the first pose fixed to the frame of the field. They part as the first keyframe is refined: the
    /// whole run determines its pose better than the first frame.
    pub fn field_from_model(&self) -> Isometry<Model, Field> {
        // Why: notes/decisions/estimation.md, "Poses refer to the first keyframe as refined".
        match (self.keyframes.first(), self.first_pose) {
            (Some(first), Some(pose)) => first.pose().inverse() * pose,
            _ => Isometry::identity(),
        }
    }

    /// Points inside the obstacles in the world, as they stand in a scan.
    pub fn occupied(&self, scan: &Scan) -> impl Iterator<Item = Occupied> {
        self.obstacles.posed(&scan.obstacles)
    }

    /// Learns from a frame at its estimated pose. `interval_s` is the time since the frame before: the more, the more is learnt.
    pub fn learn(
        &mut self,
        scan: &Arc<Scan>,
        pose: Isometry<Field, World>,
        interval_s: f64,
        rng: &mut ChaCha8Rng,
    ) -> Learnt {
        let first = self.keyframes.is_empty();
        let promoted = self.is_new(scan, pose);
        let mut current = Keyframe::new(Arc::clone(scan), pose, self.occupied(scan), self.half_extent_m());
        // At the first frame the field and the model are one.
        self.first_pose.get_or_insert(Isometry::new(pose.untyped()));
        if promoted {
            self.take_in(&current);
        }
        current.thin_occupied();
        let [steps, refined] = self.due(interval_s);
        let steps = if first { self.config.first_steps } else { steps };
        for _ in 0..steps {
            self.samples.clear();
            self.draw(&current, rng);
            self.trainer.step(&self.samples);
        }
        let (mut correction, mut box_change) = (None, None);
        if promoted {
            box_change = self.follow(&current, rng);
            current.become_earlier();
            self.keyframes.push(current);
            if self.config.loop_turn_deg > 0.0 {
                correction = self.close_loop();
            }
            self.thin_out();
        }
        for _ in 0..refined {
            self.refine_one();
        }
        Learnt { keyframe: promoted, correction, box_change }
    }

    /// Whole steps of the optimiser and refinements of keyframes that are due after an interval.
    fn due(&mut self, interval_s: f64) -> [usize; 2] {
        let interval_s = if interval_s.is_finite() { interval_s.clamp(0.0, LONGEST_INTERVAL_S) } else { 0.0 };
        let rates = [self.config.steps_per_s, self.config.refined_per_s];
        std::array::from_fn(|k| {
            let due = self.due[k] + rates[k] * interval_s;
            let whole = (due + ROUNDING).floor();
            self.due[k] = due - whole;
            whole as usize
        })
    }

    fn half_extent_m(&self) -> f32 {
        self.field().config().half_extent_m
    }

    fn is_new(&self, scan: &Scan, pose: Isometry<Field, World>) -> bool {
        let Some(last) = self.keyframes.last() else { return true };
        let (last_pose, pose) = (last.pose().untyped(), pose.untyped());
        let moved = last_pose.inverse() * pose;
        let distance = (last_pose.translation.vector - pose.translation.vector).norm();
        moved.rotation.angle().to_degrees() > self.config.keyframe_turn_deg
            || distance > self.config.keyframe_distance_m
            || scan.time_s - last.scan().time_s > self.config.keyframe_interval_s
    }

    fn take_in(&mut self, keyframe: &Keyframe) {
        self.add_to_space(keyframe);
        self.unseen = self.space.unseen();
    }

    fn add_to_space(&mut self, keyframe: &Keyframe) {
        for view in &keyframe.scan().views {
            self.space.add(view, |p| keyframe.to_field(p));
        }
        self.space.add_occupied(keyframe.occupied().iter().copied());
    }

    /// Drops every other keyframe of the older half once there are too many. The first, which fixes the frame, stays. Loops are
    /// forgotten: the poses keep their effect.
    fn thin_out(&mut self) {
        if self.keyframes.len() <= self.config.keyframes {
            return;
        }
        let older = self.keyframes.len() / 2;
        let mut i = 0;
        self.keyframes.retain(|_| {
            i += 1;
            i == 1 || i > older || i % 2 == 0
        });
        self.loops.clear();
    }
}

impl Shape for Map {
    fn distances(&self, points: &[Vec3], out: &mut [f32]) {
        self.field().distances(points, out);
    }

    fn distances_and_gradients(&self, points: &[Vec3], out: &mut [Distance]) {
        self.field().distances_and_gradients(points, out);
    }
}

impl Reference for Map {
    fn trusted(&self, points: &[Vec3], out: &mut [bool]) {
        for (point, out) in points.iter().zip(out) {
            *out = self.space.is_near_surface(*point);
        }
    }

    fn seen_empty(&self, points: &[Vec3], out: &mut [bool]) {
        for (point, out) in points.iter().zip(out) {
            *out = self.space.is_seen_empty(*point);
        }
    }

    fn sigma_m(&self) -> f32 {
        self.config.surface_sigma_m
    }
}

#[cfg(test)]
mod tests;
