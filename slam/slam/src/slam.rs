//! Shape and pose, frame by frame.

use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::Vec3;
use mvt_frames::{Isometry, Model, World};
use mvt_robot::hand::Side;
use mvt_robot::hand::solid::{HandSamples, Occupied};
use mvt_robot::observation::DepthFrame;
use mvt_robot::rig::PALM_CENTRE_M;
use nalgebra as na;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::config::SlamConfig;
use crate::map::{Learnt, Map};
use crate::scan::{Scan, Sensor};
use crate::tracker::assess::Assessment;
use crate::tracker::{self, Reference, Tracker};
use mvt_field::exact::KnownShape;
use mvt_field::shape::{Distance, Shape};
use mvt_settings::SettingError;

/// Whether the pose of a frame can be believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Nothing of the object has been measured yet.
    Waiting,
    /// The pose is followed.
    Tracking,
    /// The pose is not believed; what is given is the last one that was.
    Lost,
}

/// What is known after a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Number of the frame.
    pub frame: usize,
    /// Seconds since the start.
    pub time_s: f64,
    /// Pose of the object.
    pub pose: Isometry<Model, World>,
    /// From 0 to 1.
    pub confidence: f64,
    /// Whether the pose can be believed.
    pub state: State,
    /// The frame became a keyframe.
    pub keyframe: bool,
    /// The frame closed a loop, and all keyframes were brought into agreement.
    pub loop_closed: bool,
    /// Time spent on rays and pose, and on the map.
    pub spent: Spent,
}

/// Time spent on a frame.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Spent {
    /// From depth images to a pose.
    pub track: Duration,
    /// Teaching the field.
    pub map: Duration,
}

/// What the tracker follows.
enum Knowledge {
    /// A shape that grows.
    Growing(Box<Map>),
    /// A shape that was given.
    Known(Given),
}

impl Knowledge {
    /// What the tracker is held against.
    fn reference(&self) -> &dyn Reference {
        match self {
            Self::Growing(map) => map.as_ref(),
            Self::Known(given) => given,
        }
    }
}

struct Given {
    shape: KnownShape,
    hand: HandSamples,
    centre: Vec3,
}

/// Error of a given shape on its grid, metres.
const GIVEN_SIGMA_M: f32 = 0.0001;
/// Spacing of points inside the hand that bound a given shape, metres. Coarser than the map's: they only push.
const HAND_SPACING_M: f64 = 0.005;
/// Every how many-th of the map's points inside the hand the tracker uses.
const HAND_STRIDE: usize = 8;
/// The middle of an object lies about so far behind its visible surface, metres.
const BEHIND_SURFACE_M: f32 = 0.015;

impl Shape for Given {
    fn distances(&self, points: &[Vec3], out: &mut [f32]) {
        self.shape.distances(points, out);
    }
    fn distances_and_gradients(&self, points: &[Vec3], out: &mut [Distance]) {
        self.shape.distances_and_gradients(points, out);
    }
}

impl Reference for Given {
    fn trusted(&self, _: &[Vec3], out: &mut [bool]) {
        out.fill(true);
    }
    fn sigma_m(&self) -> f32 {
        GIVEN_SIGMA_M
    }
}

/// Estimates pose and shape of one object in one hand.
pub struct Slam {
    config: SlamConfig,
    seed: u64,
    tracker: Tracker,
    knowledge: Knowledge,
    state: State,
    /// The last pose that was believed.
    pose: Isometry<Model, World>,
    doubts: usize,
    /// Of the frame before.
    confidence: f64,
    frame: usize,
    last_search: usize,
}

impl Slam {
    /// Knows neither shape nor pose: the first frame that shows the object fixes the model's frame.
    ///
    /// # Errors
    /// [`SettingError`] if a setting is out of range.
    pub fn new(config: SlamConfig, side: Side, seed: u64) -> Result<Self, SettingError> {
        config.validate()?;
        let map = Map::new(config.map.clone(), &config.field, side, seed)?;
        Ok(Self::with(config, side, seed, Knowledge::Growing(Box::new(map)), State::Waiting, Isometry::identity()))
    }

    /// Goes on with a map that an earlier run has learnt, from an unknown pose: the object is searched for first.
    ///
    /// # Errors
    /// [`SettingError`] if a setting is out of range.
    pub fn resume(config: SlamConfig, side: Side, seed: u64, map: Map) -> Result<Self, SettingError> {
        config.validate()?;
        let pose = map.keyframes().last().map_or_else(Isometry::identity, |last| Isometry::new(*last.pose()));
        // A map of nothing is begun, not resumed.
        let state = if map.keyframes().is_empty() { State::Waiting } else { State::Lost };
        Ok(Self::with(config, side, seed, Knowledge::Growing(Box::new(map)), state, pose))
    }

    /// Knows the shape, given with its bounds in the model's frame (lowest and highest corner, metres), and roughly the pose;
    /// without one it searches.
    pub fn with_shape(
        config: SlamConfig,
        side: Side,
        seed: u64,
        shape: KnownShape,
        bounds: [Vec3; 2],
        start: Option<Isometry<Model, World>>,
    ) -> Self {
        let hand = HandSamples::new(side, HAND_SPACING_M, seed);
        let given = Given { shape, hand, centre: 0.5 * (bounds[0] + bounds[1]) };
        let state = if start.is_some() { State::Tracking } else { State::Lost };
        Self::with(config, side, seed, Knowledge::Known(given), state, start.unwrap_or_else(Isometry::identity))
    }

    fn with(
        config: SlamConfig,
        side: Side,
        seed: u64,
        knowledge: Knowledge,
        state: State,
        pose: Isometry<Model, World>,
    ) -> Self {
        let tracker = Tracker::new(config.tracker.clone(), side);
        Self { config, seed, tracker, knowledge, state, pose, doubts: 0, confidence: 1.0, frame: 0, last_search: 0 }
    }

    /// The map, where the shape is not given.
    pub fn map(&self) -> Option<&Map> {
        match &self.knowledge {
            Knowledge::Growing(map) => Some(map),
            Knowledge::Known(_) => None,
        }
    }

    /// A generator for this frame, independent of all others.
    fn generator(&self, purpose: u64) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed ^ purpose << 32);
        rng.set_stream(self.frame as u64);
        rng
    }

    /// Learns from a frame whose pose is known, as a motion-capture system would give it.
    pub fn step_at(&mut self, depth: &DepthFrame, pose: Isometry<Model, World>) -> Estimate {
        let scan = Arc::new(Scan::new(self.frame, depth, &self.config.scan, self.seed));
        self.state = State::Tracking;
        self.pose = pose;
        let begun = Instant::now();
        let learnt = self.learn(&scan);
        self.estimate(&scan, 1.0, learnt, Spent { track: Duration::ZERO, map: begun.elapsed() })
    }

    /// Estimates the pose of the next frame and learns from it.
    pub fn step(&mut self, depth: &DepthFrame) -> Estimate {
        let begun = Instant::now();
        let scan = Arc::new(Scan::new(self.frame, depth, &self.config.scan, self.seed));
        let mut confidence = 0.0;
        if self.state == State::Waiting {
            if let Some(start) = first_pose(&scan, f64::from(self.config.field.half_extent_m)) {
                self.pose = start;
                self.state = State::Tracking;
                confidence = 1.0;
                self.push(&scan, start);
            }
        } else {
            confidence = self.track(&scan);
        }
        self.confidence = confidence;
        let track = begun.elapsed();
        let begun = Instant::now();
        let believed = self.state == State::Tracking && confidence >= self.config.trust.learn_above;
        let learnt = if believed { self.learn(&scan) } else { Learnt::default() };
        self.estimate(&scan, confidence, learnt, Spent { track, map: begun.elapsed() })
    }

    fn estimate(&mut self, scan: &Scan, confidence: f64, learnt: Learnt, spent: Spent) -> Estimate {
        let frame = self.frame;
        self.frame += 1;
        let pose = match &self.knowledge {
            Knowledge::Growing(map) => Isometry::new(self.pose.untyped() * map.field_from_model()),
            Knowledge::Known(_) => self.pose,
        };
        let Learnt { keyframe, correction } = learnt;
        let loop_closed = correction.is_some();
        Estimate { frame, time_s: scan.time_s, pose, confidence, state: self.state, keyframe, loop_closed, spent }
    }

    fn push(&mut self, scan: &Arc<Scan>, start: Isometry<Model, World>) {
        let middle = tracker::to_vec(start.origin().coords());
        let near = |o: &Occupied| (o.point - middle).length_squared() < REACH_M * REACH_M;
        let scan = Arc::clone(scan);
        match &self.knowledge {
            Knowledge::Growing(map) => {
                let occupied: Vec<_> = map.occupied(&scan).filter(near).step_by(HAND_STRIDE).collect();
                self.tracker.push(map.as_ref(), scan, start, occupied.into_iter());
            }
            Knowledge::Known(given) => {
                let occupied: Vec<_> = given.hand.posed(&scan.joints).filter(near).collect();
                self.tracker.push(given, scan, start, occupied.into_iter());
            }
        }
    }

    /// Follows the object into a frame; returns the confidence.
    fn track(&mut self, scan: &Arc<Scan>) -> f64 {
        let start = match self.state {
            State::Tracking => self.tracker.predicted().unwrap_or(self.pose),
            _ => self.pose,
        };
        if self.state == State::Lost {
            self.tracker.reset();
        }
        self.push(scan, start);
        let mut rng = self.generator(3);
        let (tracker, reference) = (&mut self.tracker, self.knowledge.reference());
        if self.confidence < self.config.trust.learn_above
            || tracker.median_residual(reference) > self.config.trust.jerk_sigmas
        {
            tracker.look_around(reference, self.pose, &mut rng);
        }
        let Some(solution) = tracker.solve(reference) else { return 0.0 };
        let Assessment { confidence, .. } = tracker.assess(reference);
        let trust = self.config.trust.clone();
        if self.state == State::Lost {
            return self.search(solution.pose(), confidence);
        }
        let [distance, angle] = solution.surprise();
        let is_far = distance > trust.surprise_m || angle > trust.surprise_rad;
        let jumped = self.frame > 0 && is_far && confidence < trust.found_above;
        self.doubts = if confidence < trust.doubt_below { self.doubts + 1 } else { 0 };
        if jumped || self.doubts >= trust.lost_after {
            self.state = State::Lost;
            self.last_search = self.frame;
            return confidence.min(trust.doubt_below);
        }
        self.pose = solution.pose();
        confidence
    }

    /// While lost: takes the pose that tracking found if it is convincing, else searches now and then.
    fn search(&mut self, followed: Isometry<Model, World>, confidence: f64) -> f64 {
        let trust = self.config.trust.clone();
        let mut best = (followed, confidence);
        if confidence < trust.found_above && self.frame >= self.last_search + trust.search_every {
            self.last_search = self.frame;
            let centre = match &self.knowledge {
                Knowledge::Growing(map) => map.space().bounds().map_or(Vec3::ZERO, |[a, b]| 0.5 * (a + b)),
                Knowledge::Known(given) => given.centre,
            };
            let mut rng = self.generator(1);
            let found = self.tracker.relocalise(self.knowledge.reference(), centre, Some(self.pose), &mut rng);
            if let Some(found) = found {
                self.tracker.restart(found);
                let confidence = self.tracker.assess(self.knowledge.reference()).confidence;
                if confidence > best.1 {
                    best = (found, confidence);
                }
            }
        }
        if best.1 >= trust.found_above {
            self.tracker.restart(best.0);
            self.pose = best.0;
            self.state = State::Tracking;
            self.doubts = 0;
        }
        best.1
    }

    fn learn(&mut self, scan: &Arc<Scan>) -> Learnt {
        let mut rng = self.generator(2);
        let Knowledge::Growing(map) = &mut self.knowledge else { return Learnt::default() };
        let learnt = map.learn(scan, self.pose, &mut rng);
        if let Some(correction) = &learnt.correction {
            self.tracker.rebase(correction);
            self.pose = Isometry::new(self.pose.untyped() * correction);
        }
        learnt
    }
}

/// Points of the hand farther from the object than this cannot touch it, metres.
const REACH_M: f32 = 0.12;

/// Of the field's box nothing nearer to its faces than this should be needed, metres.
const BORDER_M: f64 = 0.005;

/// The frame that the first measurements fix: parallel to the world, in the middle of what is probably the object. What is farther
/// than `half_extent_m` from it will not be mapped, so that of a tall object seen from above it lies low enough to reach the palm.
fn first_pose(scan: &Scan, half_extent_m: f64) -> Option<Isometry<Model, World>> {
    if scan.hits() == 0 {
        return None;
    }
    let (mut sum, mut count, mut top) = (Vec3::ZERO, 0.0, f32::MIN);
    for view in &scan.views {
        for hit in &view.hits {
            let behind = if matches!(view.sensor, Sensor::Camera(_)) { BEHIND_SURFACE_M } else { 0.0 };
            let point = view.point(hit);
            top = top.max(point.z);
            sum += point + hit.direction * behind;
            count += 1.0;
        }
    }
    let mut centre = tracker::to_na(sum / count);
    let (palm, top, reach) = (PALM_CENTRE_M[2], f64::from(top), half_extent_m - BORDER_M);
    // What reaches higher does not stand on the palm, or does not fit.
    if top <= palm + 2.0 * half_extent_m {
        centre.z = centre.z.min((palm + reach).max(top - reach));
    }
    Some(Isometry::new(na::Isometry3::from_parts(centre.into(), na::UnitQuaternion::identity())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::{Hit, View};

    #[test]
    fn the_first_frame_reaches_from_the_palm_to_the_top() {
        let palm = PALM_CENTRE_M[2] as f32;
        // The upper part of a tall object, from 8 to 13 cm above the palm, seen from the side.
        let origin = Vec3::new(0.4, 0.0, palm + 0.105);
        let hit = |height: f32| {
            let ray = Vec3::new(0.0, 0.0, palm + height) - origin;
            let (direction, range_m) = (ray.normalize(), ray.length());
            Hit { direction, range_m, normal: Vec3::X, cosine: 0.9, sigma_m: 0.001 }
        };
        let view = View {
            sensor: Sensor::Camera(0),
            origin,
            hits: (0..=50).map(|k| hit(0.08 + 0.001 * k as f32)).collect(),
            outline: Vec::new(),
            misses: Vec::new(),
            lookup: None,
            pressed_px: 0,
        };
        let scan = Scan { frame: 0, time_s: 0.0, joints: Default::default(), views: vec![view] };
        let height =
            |half_extent_m: f64| first_pose(&scan, half_extent_m).unwrap().origin().coords().z - PALM_CENTRE_M[2];
        // In the middle of what is seen where that reaches the palm,
        assert!((height(0.2) - 0.105).abs() < 1e-3);
        // else low enough,
        assert!((height(0.09) - (0.09 - BORDER_M)).abs() < 1e-6);
        // but not so low that what is seen is left out;
        assert!((height(0.066) - (0.13 - 0.066 + BORDER_M)).abs() < 1e-6);
        // and where it cannot reach from palm to top, in the middle again.
        assert_eq!(height(0.06), height(0.2));
    }
}
