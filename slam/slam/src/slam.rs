//! Shape and pose, frame by frame.

mod glance;
mod search;

use std::f64::consts::PI;
use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::Vec3;
use mvt_field::exact::KnownShape;
use mvt_field::shape::{Distance, Shape};
use mvt_frames::{Field, Isometry, Model, Occupied, World};
use mvt_mesh::Mesh;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::agreement::Agreement;
use crate::config::SlamConfig;
use crate::deviation::{Deviation, Drift, Side, Variance};
use crate::earlier::{self, EarlierView};
use crate::map::{BoxChange, Keyframe, Learnt, Map};
use crate::obstacles::Obstacles;
use crate::scan::{Measurement, Scan};
use crate::start::first_pose;
use crate::tracker::assess::Assessment;
use crate::tracker::relocalise::Reach;
use crate::tracker::{self, Reference, Tracker};
use mvt_settings::SettingError;

/// Whether the tracker trusts the pose of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TrackState {
    /// Nothing of the object has been measured yet.
    Waiting,
    /// The pose is trusted.
    Tracking,
    /// The pose is trusted again after it was lost.
    Relocalised,
    /// The pose is not trusted; the estimate repeats the last one that was.
    Lost,
}

impl TrackState {
    /// Whether the pose is trusted.
    pub fn is_tracking(self) -> bool {
        matches!(self, Self::Tracking | Self::Relocalised)
    }
}

/// The result of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Number of the frame.
    pub frame: usize,
    /// Seconds since the start.
    pub time_s: f64,
    /// Pose of the object: the pose of the frame in which [`Slam::mesh`] gives the shape.
    pub pose: Isometry<Model, World>,
    /// Part of the measurements that agree with the pose, 0 to 1.
    pub confidence: f64,
    /// How far the pose may be off; `None` while the object is lost, or was not seen yet.
    pub deviation: Option<Deviation>,
    /// Whether it trusts the pose.
    pub state: TrackState,
    /// Whether the frame became a keyframe.
    pub keyframe: bool,
    /// Whether the frame closed a loop, so that all keyframes moved.
    pub loop_closed: bool,
    /// If the object reached out of the box that is mapped.
    pub box_change: Option<BoxChange>,
    /// Time spent on the pose and on the map.
    pub spent: Spent,
}

/// Time spent on a frame.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Spent {
    /// On the pose.
    pub track: Duration,
    /// On teaching the field.
    pub map: Duration,
}

/// The shape that the tracker follows.
enum Knowledge {
    /// A shape that grows.
    Growing(Box<Map>),
    /// A shape that was given.
    Known(Given),
}

impl Knowledge {
    /// The shape that poses are compared with.
    fn reference(&self) -> &dyn Reference {
        match self {
            Self::Growing(map) => map.as_ref(),
            Self::Known(given) => given,
        }
    }

    /// Earlier views, in order of time.
    fn views(&self) -> Box<dyn Iterator<Item = EarlierView> + '_> {
        let view = |keyframe: &Keyframe| EarlierView { scan: keyframe.shared_scan(), pose: keyframe.pose() };
        match self {
            Self::Growing(map) => Box::new(map.keyframes().iter().map(view)),
            Self::Known(given) => Box::new(given.views.iter().cloned()),
        }
    }

    /// Earlier views that are like one at this pose.
    fn alike(&self, pose: Isometry<Field, World>) -> Vec<EarlierView> {
        earlier::alike(self.views(), pose)
    }

    /// The earlier views that are most like one at this pose, the most alike first.
    fn most_alike(&self, pose: Isometry<Field, World>) -> Vec<EarlierView> {
        earlier::most_alike(self.views(), pose)
    }
}

struct Given {
    shape: KnownShape,
    obstacles: Obstacles,
    centre: Vec3,
    /// In order of time.
    views: Vec<EarlierView>,
}

/// Error of a given shape on its grid, metres.
const GIVEN_SIGMA_M: f32 = 0.0001;
/// While the shape grows, the tracker uses every Nth of the points inside obstacles: the map needs them dense, the tracker does not.
const OBSTACLE_STRIDE: usize = 8;
/// Another pose takes the place of the one that was followed if the part of the measurements that agrees is larger by this.
const BETTER: f64 = 0.03;
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

/// Estimates pose and shape of one object, frame by frame.
pub struct Slam {
    config: SlamConfig,
    seed: u64,
    tracker: Tracker,
    knowledge: Knowledge,
    state: TrackState,
    /// The last pose that was trusted.
    pose: Isometry<Field, World>,
    /// Time of the first of the doubtful frames in a row, seconds.
    doubted_s: Option<f64>,
    /// Of the frame before.
    confidence: f64,
    /// Time of the frame before, seconds.
    before_s: Option<f64>,
    agreement: Agreement,
    drift: Drift,
    frame: usize,
    /// Time of the last search, or of the frame in which the object was lost, seconds.
    searched_s: Option<f64>,
    /// Whether the rotation of the pose is more than a guess among poses that fit alike, as a search may end with.
    turn_is_known: bool,
    /// Turns of the model after which its shape fits as well, while it is not known which of them is right.
    rivals: Vec<nalgebra::Isometry3<f64>>,
    /// Whether colours have recognised the turn in this frame.
    is_recognised: bool,
    /// Height in the world that nothing of the object is below, metres.
    support_z_m: Option<f64>,
}

/// Settings and knowledge with which [`Slam`] starts.
#[derive(Default)]
pub struct SlamBuilder {
    config: SlamConfig,
    seed: u64,
    obstacles: Obstacles,
    support_z_m: Option<f64>,
    prior: Prior,
}

/// Prior knowledge of the shape.
#[derive(Default)]
enum Prior {
    /// Nothing: the first frame that shows the object fixes the model's frame.
    #[default]
    Unknown,
    /// A map of an earlier run.
    Map(Box<Map>),
    /// The whole shape.
    Shape { shape: KnownShape, bounds_m: [Vec3; 2], start: Option<Isometry<Model, World>> },
}

impl SlamBuilder {
    /// Settings; the defaults suit an object of 4 to 12 cm at 0.3 to 0.6 m from RGB-D cameras.
    pub fn config(mut self, config: SlamConfig) -> Self {
        self.config = config;
        self
    }

    /// Seed of all random draws: rays, samples and the field's start. Results are the same for the same seed and measurements.
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Bodies that the object cannot occupy, such as fingers. Their poses are part of each [`Measurement`]. A map that
    /// [`SlamBuilder::map`] continues has obstacles of its own.
    pub fn obstacles(mut self, obstacles: Obstacles) -> Self {
        self.obstacles = obstacles;
        self
    }

    /// Height in the world below which nothing of the object lies, metres: that of a palm or table under it. The box that is mapped then
    /// reaches down to it, so that a tall object that is seen from above is not cut off at its foot.
    pub fn support(mut self, z_m: f64) -> Self {
        self.support_z_m = Some(z_m);
        self
    }

    /// Continues the map of an earlier run from an unknown pose: the object is searched for first.
    pub fn map(mut self, map: Map) -> Self {
        self.prior = Prior::Map(Box::new(map));
        self
    }

    /// Tracks a known shape instead of learning one. `bounds_m` are its lowest and highest corner in the model's frame; `start` is
    /// its pose, to a centimetre and ten degrees, or `None` to search for it.
    pub fn shape(mut self, shape: KnownShape, bounds_m: [Vec3; 2], start: Option<Isometry<Model, World>>) -> Self {
        self.prior = Prior::Shape { shape, bounds_m, start };
        self
    }

    /// Builds the estimator.
    ///
    /// # Errors
    /// If a setting is out of range; the error names it.
    pub fn build(self) -> Result<Slam, SettingError> {
        let Self { mut config, seed, obstacles, support_z_m, prior } = self;
        config.validate()?;
        if config.tracker.colour_weight == 0.0 {
            // Nobody would look at the pictures.
            config.scan.colour_patches = 0;
        }
        if config.tracker.texel_weight == 0.0 {
            config.scan.texels = 0;
        }
        let (knowledge, state, pose) = match prior {
            Prior::Unknown => {
                let map = Map::new(config.map.clone(), &config.field, obstacles, seed)?;
                (Knowledge::Growing(Box::new(map)), TrackState::Waiting, Isometry::identity())
            }
            Prior::Map(map) => {
                let pose = map.keyframes().last().map_or_else(Isometry::identity, crate::map::Keyframe::pose);
                // A map without keyframes is begun, not continued.
                let state = if map.keyframes().is_empty() { TrackState::Waiting } else { TrackState::Lost };
                (Knowledge::Growing(map), state, pose)
            }
            Prior::Shape { shape, bounds_m, start } => {
                let given = Given { shape, obstacles, centre: 0.5 * (bounds_m[0] + bounds_m[1]), views: Vec::new() };
                let state = if start.is_some() { TrackState::Tracking } else { TrackState::Lost };
                // The field of a known shape is the shape itself.
                let pose = start.map_or_else(Isometry::identity, |start| Isometry::new(start.untyped()));
                (Knowledge::Known(given), state, pose)
            }
        };
        let drift = match &knowledge {
            Knowledge::Growing(map) => {
                Drift::of_map(map.keyframes().iter().map(|keyframe| Side::new(keyframe.pose(), keyframe.scan())))
            }
            Knowledge::Known(_) => Drift::default(),
        };
        let tracker = Tracker::new(config.tracker.clone());
        Ok(Slam {
            config,
            seed,
            tracker,
            knowledge,
            state,
            pose,
            doubted_s: None,
            confidence: 1.0,
            before_s: None,
            agreement: Agreement::new(),
            drift,
            frame: 0,
            searched_s: None,
            turn_is_known: true,
            rivals: Vec::new(),
            is_recognised: false,
            support_z_m,
        })
    }
}

impl Slam {
    /// Starts with default settings and without any knowledge of object or surroundings.
    pub fn builder() -> SlamBuilder {
        SlamBuilder::default()
    }

    /// The map, where the shape is not given.
    pub fn map(&self) -> Option<&Map> {
        match &self.knowledge {
            Knowledge::Growing(map) => Some(map),
            Knowledge::Known(_) => None,
        }
    }

    /// Number of frames taken.
    pub fn frames(&self) -> usize {
        self.frame
    }

    /// The estimated surface in the frame from which [`Estimate::pose`] leads, with cells of `cell_m` metres. `None` where the shape
    /// is given, and before anything was seen.
    pub fn mesh(&self, cell_m: f32) -> Option<Mesh> {
        let map = self.map().filter(|map| !map.keyframes().is_empty())?;
        Some(map.mesh(cell_m))
    }

    /// Draws the rays of an instant for the next [`Slam::step`], with the settings and seed of this estimator. Estimators with the same
    /// settings, seed and number of frames may share a scan.
    pub fn scan(&self, measured: &Measurement<'_>) -> Arc<Scan> {
        Arc::new(Scan::new(self.frame, measured, &self.config.scan, self.seed))
    }

    /// Estimates pose and shape from the next measurements.
    pub fn observe(&mut self, measured: &Measurement<'_>) -> Estimate {
        self.step(&self.scan(measured))
    }

    /// A generator for this frame, independent of all others.
    fn generator(&self, purpose: u64) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed ^ purpose << 32);
        rng.set_stream(self.frame as u64);
        rng
    }

    /// The time since the frame before, seconds; 0 at the first frame.
    fn interval_s(&self, scan: &Scan) -> f64 {
        self.before_s.map_or(0.0, |before_s| tracker::interval_s(before_s, scan.time_s))
    }

    /// Learns from a frame whose pose is known, as a motion-capture system would give it.
    pub fn step_at(&mut self, scan: &Arc<Scan>, pose: Isometry<Model, World>) -> Estimate {
        self.state = TrackState::Tracking;
        // A given pose stands for the field's own; refinement moves the two apart by fractions of a millimetre.
        self.pose = Isometry::new(pose.untyped());
        let begun = Instant::now();
        let learnt = self.learn(scan);
        let exact = Deviation { surface_m: 0.0, angle_rad: 0.0 };
        self.estimate(
            scan,
            (1.0, Some(exact)),
            learnt,
            self.state,
            Spent { track: Duration::ZERO, map: begun.elapsed() },
        )
    }

    /// Estimates the pose of the next frame and learns from it.
    pub fn step(&mut self, scan: &Arc<Scan>) -> Estimate {
        let begun = Instant::now();
        let before = self.state;
        let mut confidence = 0.0;
        if self.state == TrackState::Waiting {
            if let Some(start) = first_pose(scan, f64::from(self.config.field.half_extent_m), self.support_z_m) {
                self.pose = start;
                self.state = TrackState::Tracking;
                confidence = 1.0;
                self.push(scan, start);
            }
        } else {
            confidence = self.track(scan);
        }
        self.confidence = confidence;
        let is_tracking = self.state == TrackState::Tracking;
        // The first pose is exact: it fixes the frame.
        let is_tied = is_tracking && before != TrackState::Waiting;
        let own = if is_tied { self.tracker.variance(self.knowledge.reference()) } else { Variance::default() };
        let side = Side::new(self.pose, scan);
        if std::mem::take(&mut self.is_recognised) && is_tracking {
            self.drift.recognise(side, own);
        }
        let mut deviation = is_tracking.then(|| self.drift.deviation(side, own, confidence, &self.config.trust));
        if let Some(deviation) = deviation.as_mut().filter(|_| !self.turn_is_known) {
            deviation.angle_rad = PI;
        }
        let track = begun.elapsed();
        let begun = Instant::now();
        let trust = &self.config.trust;
        let is_usual = !is_tracking
            || self.agreement.take(scan.time_s, confidence, trust.surprise_confidence, trust.surprised_for_s);
        let is_trusted = is_tracking && self.turn_is_known && is_usual && confidence >= trust.learn_above;
        let learnt = if is_trusted { self.learn(scan) } else { Learnt::default() };
        if learnt.keyframe {
            self.drift.learn(side, own);
        }
        let state = match (before, self.state) {
            // The first frame of a search has nothing to come back from.
            (TrackState::Lost, TrackState::Tracking) if self.frame > 0 => TrackState::Relocalised,
            (_, state) => state,
        };
        let belief = (confidence, deviation);
        self.estimate(scan, belief, learnt, state, Spent { track, map: begun.elapsed() })
    }

    fn estimate(
        &mut self,
        scan: &Scan,
        belief: (f64, Option<Deviation>),
        learnt: Learnt,
        state: TrackState,
        spent: Spent,
    ) -> Estimate {
        self.frame += 1;
        self.before_s = Some(scan.time_s);
        Estimate {
            frame: self.frame - 1,
            time_s: scan.time_s,
            pose: self.model(self.pose),
            confidence: belief.0,
            deviation: belief.1,
            state,
            keyframe: learnt.keyframe,
            loop_closed: learnt.correction.is_some(),
            box_change: learnt.box_change,
            spent,
        }
    }

    fn push(&mut self, scan: &Arc<Scan>, start: Isometry<Field, World>) {
        let middle = tracker::to_vec(start.origin().coords());
        let near = |o: &Occupied| (o.point - middle).length_squared() < REACH_M * REACH_M;
        let scan = Arc::clone(scan);
        match &self.knowledge {
            Knowledge::Growing(map) => {
                let occupied: Vec<_> = map.occupied(&scan).filter(near).step_by(OBSTACLE_STRIDE).collect();
                self.tracker.push(map.as_ref(), scan, start, occupied.into_iter());
            }
            Knowledge::Known(given) => {
                let occupied: Vec<_> = given.obstacles.posed(&scan.obstacles).filter(near).collect();
                self.tracker.push(given, scan, start, occupied.into_iter());
            }
        }
    }

    /// Follows the object into a frame; returns the confidence.
    fn track(&mut self, scan: &Arc<Scan>) -> f64 {
        let start = match self.state {
            TrackState::Tracking => self.tracker.predicted(scan.time_s).unwrap_or(self.pose),
            _ => self.pose,
        };
        if self.state == TrackState::Lost {
            self.tracker.reset();
        }
        self.push(scan, start);
        let interval_s = self.interval_s(scan);
        if self.state == TrackState::Tracking {
            self.tracker.align(self.knowledge.reference(), &|pose| self.knowledge.alike(pose));
        }
        if self.state == TrackState::Tracking && self.config.tracker.colour_weight > 0.0 {
            self.tracker.compare_colours(self.knowledge.reference(), &|pose| self.knowledge.alike(pose));
        }
        let mut rng = self.generator(3);
        let (tracker, reference) = (&mut self.tracker, self.knowledge.reference());
        if !tracker.texels_agree()
            && (self.confidence < self.config.trust.learn_above
                || tracker.median_residual(reference) > self.config.trust.jerk_sigmas)
        {
            tracker.look_around(reference, self.pose, Reach::JERK.over(interval_s), &mut rng);
        }
        let Some(mut solution) = tracker.solve(reference) else { return 0.0 };
        let Assessment { mut confidence, .. } = tracker.assess(reference);
        let trust = self.config.trust.clone();
        if self.state == TrackState::Tracking
            && self.agreement.is_surprised_by(confidence, trust.surprise_confidence)
            && !tracker.colours_agree()
            && let Some((other, other_solution, assessment)) = tracker.alternative(reference, self.pose, &mut rng)
            && assessment.confidence > confidence + BETTER
        {
            (*tracker, solution, confidence) = (other, other_solution, assessment.confidence);
        }
        if self.state == TrackState::Lost {
            return self.search(scan.time_s, solution.pose(), confidence);
        }
        let [distance, angle] = solution.surprise();
        let is_far = distance > trust.surprise_m_s * interval_s || angle > trust.surprise_rad_s * interval_s;
        let jumped = self.frame > 0 && is_far && confidence < trust.found_above;
        let is_doubtful = confidence < trust.doubt_below;
        self.doubted_s = is_doubtful.then(|| self.doubted_s.unwrap_or(scan.time_s));
        let doubted_for_s = self.doubted_s.map_or(0.0, |since_s| scan.time_s - since_s);
        if jumped || (doubted_for_s > 0.0 && doubted_for_s >= trust.lost_after_s) {
            self.state = TrackState::Lost;
            self.searched_s = Some(scan.time_s);
            self.doubted_s.get_or_insert(scan.time_s);
            return confidence.min(trust.doubt_below);
        }
        self.pose = solution.pose();
        if !self.turn_is_known {
            self.recognise_turn(scan.time_s);
        }
        confidence
    }

    fn learn(&mut self, scan: &Arc<Scan>) -> Learnt {
        let mut rng = self.generator(2);
        let interval_s = self.interval_s(scan);
        let map = match &mut self.knowledge {
            Knowledge::Growing(map) => map,
            Knowledge::Known(given) => {
                earlier::keep(&mut given.views, scan, self.pose);
                return Learnt::default();
            }
        };
        let learnt = map.learn(scan, self.pose, interval_s, &mut rng);
        if let Some(correction) = &learnt.correction {
            self.tracker.rebase(correction);
            self.pose = Isometry::new(self.pose.untyped() * correction);
        }
        learnt
    }
}

/// Points of obstacles that are farther from the object than this cannot touch it, metres.
const REACH_M: f32 = 0.12;
