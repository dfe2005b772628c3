//! Where the object is: a sliding window of poses, solved jointly against the shape.

mod align;
pub mod assess;
mod colour;
mod contact;
pub(crate) mod icp;
mod passed;
mod photometric;
pub(crate) mod query;
pub mod relocalise;

use std::collections::VecDeque;
use std::sync::Arc;

use glam::Vec3;
use mvt_frames::{Field, Isometry, Occupied, World};
use mvt_settings::settings;
use nalgebra as na;

use crate::earlier::EarlierView;
use crate::scan::{Detail, Scan};
use colour::{Pair, Tie};
use contact::{PressedPad, pressed_pad};
use icp::{Matching, Posed};
use mvt_field::shape::Shape;
use mvt_frames::se3::{self, Twist};
use mvt_graph::system::{Block, Loss, System, velocity};
use photometric::Comparison;
use query::{ask, ask_measured, ask_values, in_model, surface};

/// A shape to track against.
pub trait Reference: Shape {
    /// Whether the surface near each point has been measured well enough to be tracked against.
    fn trusted(&self, points: &[Vec3], out: &mut [bool]);

    /// Whether each point lies where no surface can be, because sensors looked through it. By default nothing is known of it.
    fn seen_empty(&self, _points: &[Vec3], out: &mut [bool]) {
        out.fill(false);
    }

    /// Standard deviation of the surface itself, metres.
    fn sigma_m(&self) -> f32;
}

settings! {
    /// Points, weights and standard deviations of the tracker. Each weight scales the cost of its factor; 0 switches the factor off.
    pub struct TrackerConfig {
        /// Frames solved together.
        pub window: usize = 3, 1..=30;
        /// Most steps of the solver per frame.
        pub iterations: usize = 12, 1..=1000;
        /// Measured points used per camera and frame.
        pub camera_points: usize = 700, 1..=1_000_000;
        /// Points of the outline used per camera and frame.
        pub outline_points: usize = 200, 0..=1_000_000;
        /// Measured points used per touching pad and frame.
        pub touch_points: usize = 100, 1..=1_000_000;
        /// Weight of the factor: camera depth lies on the surface.
        pub camera_weight: f64 = 1.0, 0.0..=1e6;
        /// Weight of the factor: touch depth lies on the surface.
        pub touch_weight: f64 = 1.0, 0.0..=1e6;
        /// Weight of the factor: free space lies outside the object.
        pub free_space_weight: f64 = 1.0, 0.0..=1e6;
        /// Weight of the factor: the surface of each frame lies on the surface of the frame before.
        pub icp_weight: f64 = 1.0, 0.0..=1e6;
        /// Weight of the factor: places of the surface keep their colours, from frame to frame and since earlier views of the same side.
        pub colour_weight: f64 = 1.0, 0.0..=1e6;
        /// Weight of the factor: the object keeps its velocity.
        pub velocity_weight: f64 = 1.0, 0.0..=1e6;
        /// Weight of the factor: a pad carries the surface that it touches.
        pub contact_weight: f64 = 1.0, 0.0..=1e6;
        /// Weight of the factor: the hand lies outside the object.
        pub penetration_weight: f64 = 1.0, 0.0..=1e6;
        // Why: notes/decisions/estimation.md, "Residuals are weighted by the sensor's noise, not by their number".
        /// Points of a camera image with independent errors: neighbours share noise, and all points share the calibration.
        pub camera_independent: f64 = 200.0, 1e-3..=1e6;
        /// Places in a colour image with independent errors.
        pub colour_independent: f64 = 30.0, 1e-3..=1e6;
        /// Standard deviation of the place at which a colour image shows a point, pixels.
        pub colour_sigma_px: f64 = 0.4, 1e-3..=100.0;
        /// Points of a touch image with independent errors.
        pub touch_independent: f64 = 6.0, 1e-3..=1e6;
        /// Weight of the factor: points of the surface keep their colours, pixel by pixel. It needs fewer pixels than places that are searched for.
        pub texel_weight: f64 = 1.0, 0.0..=1e6;
        /// Points of an image with independent colours.
        pub texel_independent: f64 = 60.0, 1e-3..=1e6;
        /// How far an object may move between two frames so that they are laid on each other first, metres. 0 trusts the motion so far.
        pub align_reach_m: f64 = 0.0, 0.0..=1.0;
        // Why: notes/decisions/estimation.md, "The prediction keeps 0.6 of the last motion".
        /// Time over which an object's velocity falls to 1/e, seconds. An object in a hand soon comes to rest.
        pub velocity_memory_s: f64 = 0.06525, 1e-4..=1e6;
        /// Velocity that an object may have, one standard deviation, metres per second.
        pub velocity_sigma_m_s: f64 = 0.0375, 1e-6..=1000.0;
        /// Angular velocity that it may have, one standard deviation, radians per second.
        pub velocity_sigma_rad_s: f64 = 1.125, 1e-6..=1000.0;
        /// Slip of a pad over the surface within a second while the pressed area stays the same, one standard deviation, metres. It grows with
        /// the square root of time.
        pub slip_still_1s_sigma_m: f64 = 0.0002739, 1e-6..=1.0;
        /// Slip that is added when the whole pressed area changes, one standard deviation, metres.
        pub slip_changing_sigma_m: f64 = 0.002, 0.0..=1.0;
        /// Depth of the hand inside the object that counts as touching only, metres. Gels give way.
        pub penetration_slack_m: f32 = 0.0015, 0.0..=0.1;
    }
}

/// A measured point on the surface, world frame.
#[derive(Debug, Clone, Copy)]
struct Measured {
    point: Vec3,
    sigma_m: f32,
    /// Part of the cost of its sensor that it carries.
    share: f64,
    is_touch: bool,
}

/// A place that the object does not occupy, world frame.
#[derive(Debug, Clone, Copy)]
struct Vacant {
    point: Vec3,
    /// No surface is nearer than this, metres.
    clearance_m: f32,
    sigma_m: f32,
    share: f64,
}

/// One frame of the window.
#[derive(Debug, Clone)]
struct Instant {
    scan: Arc<Scan>,
    pose: na::Isometry3<f64>,
    measured: Vec<Measured>,
    /// Inside the hand, or beside an untouched gel.
    occupied: Vec<Vacant>,
    /// On rays that passed the object, where they come nearest to it; chosen anew for each solution.
    passed: Vec<Vacant>,
    /// In the order of the touch sensors.
    pads: Vec<PressedPad>,
    /// Places that earlier frames show, too.
    ties: Vec<Tie>,
    /// Earlier views whose brightness is compared with this frame's.
    earlier: Vec<EarlierView>,
    /// Whether its brightness agrees with that of frames before, pixel by pixel.
    texels_agree: bool,
}

impl Instant {
    /// Whether a camera measured the object.
    fn is_seen(&self) -> bool {
        self.measured.iter().any(|m| !m.is_touch)
    }
}

/// Tracks one object in one hand.
#[derive(Debug, Clone)]
pub struct Tracker {
    config: TrackerConfig,
    /// Oldest first. Two more than the configured window: the oldest poses are held, and tie the others to the past.
    window: VecDeque<Instant>,
    /// Where the newest frame was expected when it came.
    expected: na::Isometry3<f64>,
}

/// How the newest pose was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solution {
    /// The newest pose.
    pose: Isometry<Field, World>,
    /// How far the solution is from the prediction by the motion before, metres and radians.
    surprise: [f64; 2],
}

impl Solution {
    /// The newest pose.
    pub fn pose(&self) -> Isometry<Field, World> {
        self.pose
    }

    /// How far the pose is from the prediction by the motion before, metres and radians.
    pub fn surprise(&self) -> [f64; 2] {
        self.surprise
    }
}

/// A point where nothing was seen before costs as much as one so far from the surface, metres: else poses that show new sides only, and
/// slides along a face of which a part was seen, would cost nothing.
const UNSEEN_COSTS_M: f64 = 0.002;
/// Cost grows with the logarithm from this many standard deviations on.
const ROBUST_SIGMAS: f64 = 2.0;
/// How exactly the hand's surface is known, metres.
const HAND_SIGMA_M: f32 = 0.001;
/// Points of the hand that are farther from the object than this do not come to bear within a frame, metres.
const OCCUPIED_REACH_M: f32 = 0.008;
/// Points of the hand used per frame, the nearest.
const OCCUPIED_POINTS: usize = 150;
/// Colours are not believed if the motion on which they agree takes the measured points so much farther from the surface.
const WORSE_SIGMAS: f64 = 0.5;
/// Resolution at which the window compares brightness: noise of single pixels is less there.
const FINAL_LEVEL: usize = 1;
/// Points matched from frame to frame.
const ICP_POINTS: usize = 200;

impl Tracker {
    /// A tracker that has seen nothing.
    pub fn new(config: TrackerConfig) -> Self {
        Self { config, window: VecDeque::new(), expected: na::Isometry3::identity() }
    }

    /// Where the motion so far leads to at a time after the newest frame; `None` before the first frame.
    pub fn predicted(&self, time_s: f64) -> Option<Isometry<Field, World>> {
        let newest = self.window.back()?;
        let before = self.window.iter().rev().nth(1);
        let motion = before.map_or_else(na::Isometry3::identity, |before| {
            let pace = self.pace(before.scan.time_s, newest.scan.time_s, time_s);
            se3::exp(&(se3::log(&(before.pose.inverse() * newest.pose)) * pace.kept))
        });
        Some(Isometry::new(newest.pose * motion))
    }

    /// How the motion between two frames goes on to a third.
    fn pace(&self, first_s: f64, second_s: f64, third_s: f64) -> Pace {
        let (before_s, after_s) = (interval_s(first_s, second_s), interval_s(second_s, third_s));
        let kept = (-after_s / self.config.velocity_memory_s).exp();
        let spread_s = after_s * (1.0 - kept * kept).sqrt();
        Pace {
            kept: kept * after_s / before_s,
            sigma: [self.config.velocity_sigma_m_s * spread_s, self.config.velocity_sigma_rad_s * spread_s],
        }
    }

    /// Moves all poses to another model frame: `correction` takes coordinates of the new one to the old.
    pub fn rebase(&mut self, correction: &na::Isometry3<f64>) {
        for instant in &mut self.window {
            instant.pose *= correction;
            instant.ties.iter_mut().for_each(|tie| tie.rebase(correction));
            instant.earlier.iter_mut().for_each(|view| view.pose = Isometry::new(view.pose.untyped() * correction));
        }
    }

    /// Forgets the frames before, so that a new pose is not tied to them.
    pub fn reset(&mut self) {
        self.window.clear();
    }

    /// Takes in a frame whose pose is `start` or near it. `occupied` are points inside the hand; those that the object may
    /// reach are used.
    pub fn push(
        &mut self,
        shape: &dyn Reference,
        scan: Arc<Scan>,
        start: Isometry<Field, World>,
        occupied: impl Iterator<Item = Occupied>,
    ) {
        self.expected = start.untyped();
        let slack = self.config.penetration_slack_m;
        let deep: Vec<Occupied> = occupied.filter(|o| o.depth_m > slack).collect();
        let model_from_world = start.untyped().inverse();
        let inside: Vec<Vec3> = deep.iter().map(|o| apply(&model_from_world, o.point)).collect();
        let mut distances = vec![0.0; inside.len()];
        shape.distances(&inside, &mut distances);
        let mut near: Vec<(f32, Occupied)> = distances
            .iter()
            .zip(deep)
            .map(|(d, o)| (d - o.depth_m, o))
            .filter(|(gap, _)| *gap < OCCUPIED_REACH_M)
            .collect();
        if near.len() > OCCUPIED_POINTS {
            near.select_nth_unstable_by(OCCUPIED_POINTS, |a, b| a.0.total_cmp(&b.0));
            near.truncate(OCCUPIED_POINTS);
        }
        let occupied: Vec<Occupied> = near.into_iter().map(|(_, o)| o).collect();
        self.window.push_back(self.instant(scan, start.untyped(), &occupied));
        // One held pose, and one more so that the velocity of the oldest free pose is known.
        while self.window.len() > self.config.window + 2 {
            self.window.pop_front();
        }
    }

    fn instant(&self, scan: Arc<Scan>, pose: na::Isometry3<f64>, occupied: &[Occupied]) -> Instant {
        let config = &self.config;
        let mut pads = Vec::new();
        let mut measured = Vec::new();
        let mut vacant = Vec::new();
        for view in &scan.views {
            let (count, independent, is_touch) = match view.detail {
                Detail::Camera { .. } => (config.camera_points, config.camera_independent, false),
                Detail::Touch { .. } => (config.touch_points, config.touch_independent, true),
            };
            let used = view.hits.len().min(count);
            let share = (independent / used.max(1) as f64).min(1.0);
            let point = |hit| Measured { point: view.point(hit), sigma_m: hit.sigma_m, share, is_touch };
            measured.extend(view.hits[..used].iter().map(point));
            let used = view.outline().len().min(config.outline_points);
            let share = (0.25 * independent / used.max(1) as f64).min(1.0);
            let point = |hit| Measured { point: view.point(hit), sigma_m: hit.sigma_m, share, is_touch };
            measured.extend(view.outline()[..used].iter().map(point));
            if is_touch {
                pads.extend(pressed_pad(view));
                let share = (independent / view.misses.len().max(1) as f64).min(1.0);
                vacant.extend(view.misses.iter().map(|miss| Vacant {
                    point: view.origin + miss.direction * miss.free_m,
                    clearance_m: 0.0,
                    sigma_m: GEL_SIGMA_M,
                    share,
                }));
            }
        }
        let slack = config.penetration_slack_m;
        vacant.extend(occupied.iter().map(|o| Vacant {
            point: o.point,
            clearance_m: o.depth_m - slack,
            sigma_m: HAND_SIGMA_M,
            share: 0.2,
        }));
        Instant {
            scan,
            pose,
            measured,
            occupied: vacant,
            passed: Vec::new(),
            pads,
            ties: Vec::new(),
            earlier: Vec::new(),
            texels_agree: false,
        }
    }

    /// Compares the colours of the newest frame with those of the frame before and of earlier views. If they agree on a motion, and depth
    /// does not speak against it, the frame is moved.
    pub(crate) fn compare_colours(
        &mut self,
        shape: &dyn Reference,
        alike: &dyn Fn(Isometry<Field, World>) -> Vec<EarlierView>,
    ) {
        let median = self.median_residual(shape);
        let before = self.window.iter().rev().nth(1).map(|before| (before.scan.as_ref(), before.pose));
        let Some(newest) = self.window.back() else { return };
        let start = newest.pose;
        let pair = Pair { now: &newest.scan, before, sigma_px: self.config.colour_sigma_px };
        let Some((pose, ties)) = pair.follow(&start, alike) else { return };
        let Some(newest) = self.window.back_mut() else { return };
        (newest.pose, newest.ties) = (pose, ties);
        if self.median_residual(shape) > median + WORSE_SIGMAS
            && let Some(newest) = self.window.back_mut()
        {
            newest.pose = start;
            newest.ties.clear();
        }
    }

    /// Whether colours were found again near the newest pose: poses farther away, which depth cannot tell apart on round objects, are wrong then.
    pub(crate) fn colours_agree(&self) -> bool {
        self.window.back().is_some_and(|newest| !newest.ties.is_empty() || newest.texels_agree)
    }

    /// Whether the brightness agrees with that of frames before, pixel by pixel.
    pub(crate) fn texels_agree(&self) -> bool {
        self.window.back().is_some_and(|newest| newest.texels_agree)
    }

    /// The information of the colours of earlier views about the newest pose.
    fn colour_information(&self) -> na::Matrix6<f64> {
        let Some(newest) = self.window.back() else { return na::Matrix6::zeros() };
        let independent = self.config.colour_independent * self.config.colour_weight;
        let ties: na::Matrix6<f64> = newest.ties.iter().map(|tie| tie.information(&newest.pose, independent)).sum();
        let mut system = System::new(1);
        let comparison =
            Comparison { level: FINAL_LEVEL, independent: self.config.texel_independent * self.config.texel_weight };
        align::add_earlier(&mut system, newest, (Some(0), Posed::new(newest)), comparison);
        ties + system.hessian.fixed_view::<6, 6>(0, 0)
    }

    fn add_colours(
        &self,
        system: &mut System,
        before: Option<(Option<usize>, &Instant)>,
        now: (Option<usize>, &Instant),
    ) {
        let independent = self.config.colour_independent * self.config.colour_weight;
        let before = before.map(|(index, before)| (index, &before.pose));
        for tie in &now.1.ties {
            tie.add(system, before, (now.0, &now.1.pose), independent);
        }
    }

    /// Number of held poses at the front of the window.
    fn held(&self) -> usize {
        self.window.len().saturating_sub(self.config.window)
    }

    /// Solves the window. `None` before the first frame.
    pub fn solve(&mut self, shape: &dyn Reference) -> Option<Solution> {
        // Wide at first, so that a start that is off by a centimetre is drawn in; then as wide as the sensors' noise.
        let median = self.median_residual(shape);
        let mut scale = (median / 0.674).clamp(1.0, 20.0);
        let mut left = self.config.iterations;
        loop {
            self.choose_passed(shape);
            self.descend(shape, scale, &mut left);
            if scale <= 1.5 || left == 0 {
                break;
            }
            scale = (scale / 4.0).max(1.0);
        }
        let pose = self.window.back()?.pose;
        let moved = se3::log(&(self.expected.inverse() * pose));
        let angle = moved.fixed_rows::<3>(3).norm();
        // Of the model's origin, which lies in the object, not of the world's.
        let distance = (self.expected.translation.vector - pose.translation.vector).norm();
        Some(Solution { pose: Isometry::new(pose), surprise: [distance, angle] })
    }

    /// Steps until the cost no longer falls.
    fn descend(&mut self, shape: &dyn Reference, scale: f64, left: &mut usize) {
        let mut damping = 1e-4;
        let mut system = self.linearise(shape, scale);
        while *left > 0 {
            *left -= 1;
            let Some(step) = system.step(damping) else { return };
            let before: Vec<_> = self.window.iter().map(|instant| instant.pose).collect();
            let next = is_modest(&step).then(|| {
                self.advance(&step);
                self.linearise(shape, scale)
            });
            if let Some(next) = next.filter(|next| next.cost < system.cost) {
                let gained = (system.cost - next.cost) / system.cost;
                system = next;
                damping = (damping / 5.0).max(1e-7);
                if gained < 1e-3 {
                    break;
                }
            } else {
                for (instant, pose) in self.window.iter_mut().zip(before) {
                    instant.pose = pose;
                }
                damping *= 10.0;
                if damping > 10.0 || step.amax() < 1e-6 {
                    break;
                }
            }
        }
    }

    /// Moves the free poses.
    fn advance(&mut self, step: &na::DVector<f64>) {
        let held = self.held();
        for (i, instant) in self.window.iter_mut().skip(held).enumerate() {
            let twist: Twist = step.fixed_rows::<6>(6 * i).into_owned();
            instant.pose *= se3::exp(&twist);
            instant.pose.rotation.renormalize();
        }
    }

    /// Median distance of the newest frame's points from the surface, in standard deviations.
    pub fn median_residual(&self, shape: &dyn Reference) -> f64 {
        let Some(instant) = self.window.back() else { return 0.0 };
        let points = in_model(&instant.pose, instant.measured.iter().map(|m| m.point));
        let (distances_m, trusted) = ask_values(shape, &points);
        let mut residuals: Vec<f64> = (0..points.len())
            .filter(|&i| trusted[i])
            .map(|i| f64::from(distances_m[i].abs() / sigma(shape, instant.measured[i].sigma_m)))
            .collect();
        if residuals.is_empty() {
            return 0.0;
        }
        let middle = residuals.len() / 2;
        *residuals.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// Adds: the points that an instant measured lie on the surface, at a pose of it.
    fn add_surface(
        &self,
        system: &mut System,
        shape: &dyn Reference,
        instant: &Instant,
        (index, pose): (Option<usize>, &na::Isometry3<f64>),
        robust: Loss,
    ) {
        let config = &self.config;
        let (points, distances, trusted) = ask_measured(shape, pose, instant.measured.iter().map(|m| m.point));
        for (i, m) in instant.measured.iter().enumerate() {
            let weight = if m.is_touch { config.touch_weight } else { config.camera_weight };
            let s = 1.0 / f64::from(sigma(shape, m.sigma_m));
            if !trusted[i] {
                system.cost += weight * m.share * robust.at(UNSEEN_COSTS_M * s).0;
                continue;
            }
            let (r, j) = surface(points[i], distances[i]);
            system.add(r * s, &[(index, j * s)], weight * m.share, robust);
        }
    }

    fn linearise(&self, shape: &dyn Reference, scale: f64) -> System {
        let config = &self.config;
        let held = self.held();
        let mut system = System::new(self.window.len() - held);
        let robust = Loss::Cauchy(ROBUST_SIGMAS * scale);
        let index = |k: usize| k.checked_sub(held);
        for (k, instant) in self.window.iter().enumerate().skip(held) {
            self.add_surface(&mut system, shape, instant, (index(k), &instant.pose), robust);
            for (list, weight) in
                [(&instant.occupied, config.penetration_weight), (&instant.passed, config.free_space_weight)]
            {
                if weight == 0.0 {
                    continue;
                }
                let (points, distances, trusted) = ask(shape, &instant.pose, list.iter().map(|v| v.point));
                for (i, vacant) in list.iter().enumerate().filter(|(i, _)| trusted[*i]) {
                    let (r, j) = surface(points[i], distances[i]);
                    let short = r - f64::from(vacant.clearance_m);
                    if short < 0.0 {
                        let s = 1.0 / f64::from(vacant.sigma_m);
                        system.add(short * s, &[(index(k), j * s)], weight * vacant.share, robust);
                    }
                }
            }
            let before = k.checked_sub(1).and_then(|k| self.window.get(k));
            if config.texel_weight > 0.0 {
                let comparison =
                    Comparison { level: FINAL_LEVEL, independent: config.texel_independent * config.texel_weight };
                if let Some(before) = before {
                    let (then, now) = ((index(k - 1), Posed::new(before)), (index(k), Posed::new(instant)));
                    photometric::add(&mut system, then, now, comparison);
                }
                align::add_earlier(&mut system, instant, (index(k), Posed::new(instant)), comparison);
            }
            self.add_colours(&mut system, before.map(|before| (index(k - 1), before)), (index(k), instant));
            if let Some(before) = before {
                self.add_contacts(&mut system, (index(k - 1), before), (index(k), instant));
                if config.icp_weight > 0.0 {
                    let share = 0.25 * config.camera_independent * config.icp_weight;
                    let (a, b) = (Posed::new(before), Posed::new(instant));
                    let matching = Matching { points: ICP_POINTS, independent: share, reach_m: icp::REACH_M };
                    icp::add(&mut system, (index(k - 1), a), (index(k), b), matching);
                }
            }
            if k > 1 && config.velocity_weight > 0.0 {
                let poses = [&self.window[k - 2].pose, &self.window[k - 1].pose, &instant.pose];
                let time_s = |k: usize| self.window[k].scan.time_s;
                let pace = self.pace(time_s(k - 2), time_s(k - 1), time_s(k));
                let (r, jacobians) = velocity(poses, pace.kept);
                // A camera can tell that an object was thrown; a pad fits wherever it goes.
                let loss = if instant.is_seen() { Loss::Cauchy(3.0) } else { Loss::Square };
                for row in 0..6 {
                    let s = 1.0 / pace.sigma[row / 3];
                    let block = |b: usize| -> Block { (index(k + b - 2), jacobians[b].row(row).transpose() * s) };
                    let blocks = [block(0), block(1), block(2)];
                    system.add(r[row] * s, &blocks, config.velocity_weight, loss);
                }
            }
        }
        system
    }
}

/// How motion goes on: velocity is a first-order autoregressive process.
struct Pace {
    /// The motion between two frames times this is the expected one to the third.
    kept: f64,
    /// Standard deviation of the difference, metres and radians.
    sigma: [f64; 2],
}

/// Shortest time between two frames, seconds. Stamps that are nearer, or in the wrong order, say nothing of a velocity.
const LEAST_INTERVAL_S: f64 = 1e-3;

/// The time from one frame to the next, seconds.
pub(crate) fn interval_s(before_s: f64, after_s: f64) -> f64 {
    (after_s - before_s).max(LEAST_INTERVAL_S)
}

/// The farthest that a step may move and turn a pose, metres and radians: a direction that nothing measures may not carry an object away.
const FARTHEST_STEP: [f64; 2] = [0.05, 1.0];

fn is_modest(step: &na::DVector<f64>) -> bool {
    let within = |at: usize, limit: f64| step.fixed_rows::<3>(at).norm() <= limit;
    (0..step.len()).step_by(6).all(|at| within(at, FARTHEST_STEP[0]) && within(at + 3, FARTHEST_STEP[1]))
}

/// How exactly an untouched gel is known, metres.
const GEL_SIGMA_M: f32 = 0.0003;
fn sigma(shape: &dyn Reference, measured_m: f32) -> f32 {
    shape.sigma_m().hypot(measured_m)
}

pub(crate) fn apply(motion: &na::Isometry3<f64>, p: Vec3) -> Vec3 {
    to_vec((motion * na::Point3::from(to_na(p))).coords)
}

pub(crate) fn to_na(v: Vec3) -> na::Vector3<f64> {
    na::Vector3::new(f64::from(v.x), f64::from(v.y), f64::from(v.z))
}

pub(crate) fn to_vec(v: na::Vector3<f64>) -> Vec3 {
    Vec3::new(v.x as f32, v.y as f32, v.z as f32)
}

#[cfg(test)]
mod tests;
