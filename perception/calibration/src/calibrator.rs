//! The estimate that goes on while frames arrive.

use std::sync::Arc;

use mvt_frames::camera::PosedCamera;
use mvt_frames::{Camera, Isometry, Point, World};
use mvt_robot::hand::solid::{HandSamples, HandSolid};
use mvt_robot::hand::{Hand, JointAngles};
use mvt_settings::settings;
use nalgebra as na;
use ndarray::Array2;

use crate::calibration::{Calibration, CalibrationError, CameraCalibration, from_shown, shown};
use crate::evidence::{Instant, Motion, Reading, Sighted, sight, spread};
use crate::search::{Look, Misfit, find, misfit, posed};
use crate::solver::{PER_CAMERA, Prior, State, Weighing, narrow, solve};

settings! {
    /// Whether and how the calibration is refined: its prior, and how much is measured.
    #[derive(Copy)]
    pub struct CalibrationConfig {
        /// Whether the given calibration is refined.
        pub refine: bool = true;
        /// How far a camera's given position may be off, one standard deviation, metres.
        pub camera_sigma_m: f64 = 0.02, 0.0..=1.0;
        /// How far a camera's given orientation may be off, one standard deviation, degrees.
        pub camera_sigma_deg: f64 = 5.0, 0.0..=90.0;
        /// How far a joint's reading may be off all the time, one standard deviation, degrees (of sliding joints millimetres). 0 takes joints
        /// as they are read.
        pub joint_sigma_deg: f64 = 1.0, 0.0..=45.0;
        /// The same of the joints of an arm, which move all touch sensors: at most joint_sigma_deg.
        pub arm_joint_sigma_deg: f64 = 0.05, 0.0..=45.0;
        /// How far joint readings may be late or early, one standard deviation, seconds. 0 takes them as simultaneous with the images.
        pub lag_sigma_s: f64 = 0.03, 0.0..=1.0;
        /// Points of the hand used per image.
        pub points: usize = 400, 10..=100_000;
        // Why: notes/decisions/calibration.md, "Some tens of instants, spread over the run, are solved together".
        /// Instants that are solved together. They are spread over the time since the start.
        pub instants: usize = 24, 2..=1000;
        /// Points of an image with independent errors: neighbours share noise, and all share the errors of the hand's model.
        pub independent: f64 = 200.0, 1.0..=1e6;
    }
}

/// A frame with the calibration known so far.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibrated {
    /// Joint angles at the time of the images, without their offsets.
    pub joints: JointAngles,
    /// The cameras with their refined poses.
    pub cameras: Vec<PosedCamera>,
    /// For each camera whether its image agrees with the hand. If it does not, its points lie elsewhere.
    pub agrees: Vec<bool>,
    /// Whether the joint readings stand still while images show that the hand moves: nobody knows then where it touches.
    pub is_frozen: bool,
    /// What changed with this frame, in words.
    pub warnings: Vec<String>,
}

/// Refines the poses of cameras, the offsets of joints and the lag between both, from depth images of the hand.
#[derive(Debug, Clone)]
pub struct Calibrator {
    config: CalibrationConfig,
    hand: Arc<Hand>,
    given: Vec<PosedCamera>,
    prior: Prior,
    state: State,
    sigmas: na::DVector<f64>,
    samples: HandSamples,
    /// How each camera's images agree with the hand.
    watch: Vec<Watch>,
    /// Time of the first of the frames in a row with the present joint readings, seconds.
    still_since_s: Option<f64>,
    /// Time of the first frame, seconds.
    begun_s: Option<f64>,
    warnings: Vec<String>,
    instants: Vec<Instant>,
    /// Points of the frame before, if it is kept: they wait for the next reading, from which the motion of the joints is known.
    waiting: Option<Vec<Vec<Sighted>>>,
    /// The readings of the frame before, and of the one before that.
    before: Option<Reading>,
    older: Option<Reading>,
    /// Time between instants that are kept, seconds.
    every_s: f64,
    frame: usize,
}

impl Calibrated {
    /// Removes the images of the cameras that do not agree with the hand.
    pub fn skip(&self, depths_m: &mut [Option<Array2<f32>>]) {
        let disagreeing = depths_m.iter_mut().zip(&self.agrees).filter(|(_, agrees)| !**agrees);
        disagreeing.for_each(|(depth_m, _)| *depth_m = None);
    }
}

/// Agreement of a camera's images with the hand.
#[derive(Debug, Clone, Default)]
struct Watch {
    /// Whether the hand was found.
    found: bool,
    /// Whether images have agreed with the hand since it was found.
    has_agreed: bool,
    /// Whether it was reported that the hand is not found.
    is_missed: bool,
    /// Comparisons in a row that did not agree.
    doubts: usize,
}

/// Time between comparisons of images with the hand, seconds.
const COMPARED_EVERY_S: f64 = 0.1;
/// An image that sees through more than this share of the hand does not agree with it. With the right pose less than 0.005 of a hand is seen
/// through, at a camera that was turned by 4 degrees or that shows the other hand mostly more than 0.05.
const SEEN_THROUGH: f64 = 0.03;
/// Doubts in a row that make a change: one image may be bad.
const DOUBTS: usize = 2;
/// The same joint readings for so long, while the images change, are no readings, seconds.
const FROZEN_S: f64 = 0.16;
/// Points of an image that are compared with the hand.
const COMPARED_POINTS: usize = 300;
/// Time between searches for a hand that was not found, seconds: a search takes as long as three frames.
const SEARCHED_EVERY_S: f64 = 1.0;

/// Points farther from the middle of the grasp than this are not the hand's, metres: its length, and the error of a camera.
const REACH_M: f64 = 0.24;
/// Once the hand is found, points farther from it than this are not kept, metres.
const NEAR_M: f32 = 0.008;
/// The gate of the solver once the hand is found, metres: three standard deviations of a point.
const GATE_M: f64 = 0.004;
/// The gate while offsets of joints are still unknown, metres: a degree at the length of a finger.
const FIRST_GATE_M: f64 = 0.008;
/// Time between instants that are kept at first, seconds.
const FIRST_EVERY_S: f64 = 1.0 / 15.0;
/// Stamps are rounded: an interval is over when so small a part of it is left.
const ROUNDING: f64 = 0.05;
/// Steps of the solver per new instant: the state is near its optimum.
const STEPS: usize = 3;
const FIRST_STEPS: usize = 10;
/// A fit of the search that is worse than this is not the hand.
const GREATEST_MISFIT: Misfit = Misfit { cost: 0.9, seen_through: 0.2 };
/// Spacing of the points that are tested for being seen through, metres.
const SAMPLES_M: f64 = 0.008;

impl Calibrator {
    /// Starts from the poses that the cameras have, and from joints without errors. By a hand without parts nothing is refined.
    pub fn new(mut config: CalibrationConfig, hand: Arc<Hand>, cameras: Vec<PosedCamera>) -> Self {
        config.refine &= hand.parts().next().is_some();
        let poses = cameras.iter().map(|camera| camera.pose.untyped()).collect();
        let joints = hand.joints().len();
        let state = State { cameras: poses, joint_offsets_rad: vec![0.0; joints], lag_s: 0.0 };
        let mut sigmas = na::DVector::zeros(State::unknowns(cameras.len(), joints));
        for k in 0..cameras.len() {
            sigmas.rows_mut(PER_CAMERA * k, 3).fill(config.camera_sigma_m);
            sigmas.rows_mut(PER_CAMERA * k + 3, 3).fill(config.camera_sigma_deg.to_radians());
        }
        let first = PER_CAMERA * cameras.len();
        for (j, joint) in hand.joints().iter().enumerate() {
            // An arm reads its joints more exactly than a hand, and what it may be off cannot be told from a wrong pose of the camera.
            let is_of_arm =
                !hand.pads().is_empty() && (0..hand.pads().len()).all(|pad| hand.pad_chain(pad).contains(&j));
            let sigma =
                if is_of_arm { config.arm_joint_sigma_deg.min(config.joint_sigma_deg) } else { config.joint_sigma_deg };
            sigmas[first + j] = from_shown(joint, sigma);
        }
        sigmas[first + joints] = config.lag_sigma_s;
        Self {
            samples: HandSamples::new(&hand, SAMPLES_M, 0),
            config,
            hand,
            given: cameras,
            watch: vec![Watch::default(); state.cameras.len()],
            still_since_s: None,
            begun_s: None,
            warnings: Vec::new(),
            prior: Prior { state: state.clone(), sigmas: sigmas.clone() },
            state,
            sigmas,
            instants: Vec::new(),
            waiting: None,
            before: None,
            older: None,
            every_s: FIRST_EVERY_S,
            frame: 0,
        }
    }

    /// Starts from a calibration that was measured before. Its cameras replace those of the same name; others keep their pose.
    ///
    /// # Errors
    /// If a pose is not rigid, a number not finite, or the number of joints not that of the hand.
    pub fn start_from(&mut self, start: &Calibration) -> Result<(), CalibrationError> {
        for camera in &start.cameras {
            let pose = Isometry::from_matrix(&camera.pose)
                .map_err(|reason| CalibrationError::Pose { camera: camera.name.clone(), reason })?;
            if let Some(given) = self.given.iter_mut().find(|given| given.name == camera.name) {
                given.pose = pose;
            }
        }
        let (expected, found) = (self.hand.joints().len(), start.joint_offsets_deg.len());
        if found != expected {
            return Err(CalibrationError::Joints { hand: self.hand.name().to_owned(), expected, found });
        }
        let numbers = start.joint_offsets_deg.iter().chain([&start.lag_ms]);
        if numbers.into_iter().any(|number| !number.is_finite()) {
            return Err(CalibrationError::NotFinite);
        }
        let offsets = self.hand.joints().iter().zip(&start.joint_offsets_deg);
        self.state = State {
            cameras: self.given.iter().map(|camera| camera.pose.untyped()).collect(),
            joint_offsets_rad: offsets.map(|(joint, offset)| from_shown(joint, *offset)).collect(),
            lag_s: start.lag_ms * 1e-3,
        };
        self.prior.state = self.state.clone();
        Ok(())
    }

    /// Takes in a frame and returns it with the calibration known so far. `depths_m` are the images of the cameras, metres along the
    /// optical axis, 0 where nothing was measured; `None` or an empty image from a camera that delivered nothing. `next` is the time and
    /// joints of the next frame, if they are known, as in a log: with readings that are late, the joints are else extrapolated.
    pub fn observe(
        &mut self,
        time_s: f64,
        joints: &[f64],
        next: Option<(f64, JointAngles)>,
        depths_m: &[Option<Array2<f32>>],
    ) -> Calibrated {
        let now = (time_s, self.of_all(joints));
        let next = next.map(|(time_s, joints)| (time_s, self.of_all(&joints)));
        if let (Some(sighted), Some(before)) = (self.waiting.take(), &self.before) {
            let motion = Motion::at_reading(self.older.as_ref(), before, Some(&now));
            self.instants.push(Instant { motion, sighted });
            self.solve(None, STEPS);
            self.thin_out();
        }
        let motion = Motion::at_reading(self.before.as_ref(), &now, next.as_ref());
        // The readings of no joints cannot stand still.
        let is_same = !now.1.is_empty() && self.before.as_ref().is_some_and(|(_, before)| *before == now.1);
        self.still_since_s = self.still_since_s.filter(|_| is_same).or(Some(time_s));
        self.begun_s = self.begun_s.or(Some(time_s));
        if self.config.refine {
            self.compare(time_s, &motion, depths_m);
            self.refine(time_s, &motion, depths_m);
        }
        self.older = self.before.replace(now);
        self.frame += 1;
        let agrees = |watch: &Watch| !self.config.refine || (watch.found && watch.doubts == 0);
        Calibrated {
            joints: self.state.joints(&motion),
            cameras: self.cameras(),
            agrees: self.watch.iter().map(agrees).collect(),
            is_frozen: self.is_still(time_s) && self.watch.iter().any(|watch| watch.doubts >= DOUBTS),
            warnings: std::mem::take(&mut self.warnings),
        }
    }

    /// Whether the joint readings have stood still for so long that they are no readings.
    fn is_still(&self, time_s: f64) -> bool {
        self.still_since_s.is_some_and(|since_s| time_s - since_s >= FROZEN_S)
    }

    /// Whether something that is done now and then is due in the frame of this time. It is in the first frame.
    fn is_due(&self, time_s: f64, every_s: f64) -> bool {
        let times = |time_s: f64| ((time_s - self.begun_s.unwrap_or(time_s)) / every_s + ROUNDING).floor();
        self.before.as_ref().is_none_or(|(before_s, _)| times(time_s) > times(*before_s))
    }

    /// Returns one angle per joint of the hand; missing ones are 0.
    fn of_all(&self, joints: &[f64]) -> JointAngles {
        let mut joints = joints.to_vec();
        joints.resize(self.hand.joints().len(), 0.0);
        joints
    }

    /// Looks for the hand, and keeps the points of an instant now and then.
    fn refine(&mut self, time_s: f64, motion: &Motion, depths_m: &[Option<Array2<f32>>]) {
        self.find_hand(time_s, motion, depths_m);
        if self.is_due(time_s, self.every_s) && self.watch.iter().any(|watch| watch.found && watch.doubts == 0) {
            let sighted = self.sighted(motion, depths_m);
            if self.instants.is_empty() {
                // The first images already tell most of the cameras and of the joints that are seen.
                let instant = Instant { motion: motion.clone(), sighted: sighted.clone() };
                self.solve(Some((&instant, FIRST_GATE_M)), FIRST_STEPS);
                self.solve(Some((&instant, GATE_M)), FIRST_STEPS);
            }
            self.waiting = Some(sighted);
        }
    }

    /// The cameras with the poses that were given.
    pub fn given(&self) -> &[PosedCamera] {
        &self.given
    }

    /// The cameras with their refined poses.
    pub fn cameras(&self) -> Vec<PosedCamera> {
        let refined = |(given, pose): (&PosedCamera, &na::Isometry3<f64>)| PosedCamera {
            pose: Isometry::new(*pose),
            ..given.clone()
        };
        self.given.iter().zip(&self.state.cameras).map(refined).collect()
    }

    /// The calibration known so far; `None` if it is not refined or there is no camera.
    pub fn refined(&self) -> Option<Calibration> {
        (self.config.refine && !self.given.is_empty()).then(|| self.calibration())
    }

    /// The calibration known so far.
    pub fn calibration(&self) -> Calibration {
        let largest = |at: usize| self.sigmas.rows(at, 3).max();
        let cameras = self.state.cameras.iter().zip(&self.given).enumerate().map(|(k, (refined, given))| {
            let pose = given.pose.untyped();
            CameraCalibration {
                name: given.name.clone(),
                pose: Isometry::<Camera, World>::new(*refined).to_matrix(),
                turned_deg: (pose.rotation.inverse() * refined.rotation).angle().to_degrees(),
                moved_mm: (pose.translation.vector - refined.translation.vector).norm() * 1e3,
                sigma_deg: largest(PER_CAMERA * k + 3).to_degrees(),
                sigma_mm: largest(PER_CAMERA * k) * 1e3,
                hand_found: self.watch[k].found,
            }
        });
        let first = PER_CAMERA * self.given.len();
        let joints = || self.hand.joints().iter();
        Calibration {
            cameras: cameras.collect(),
            joint_offsets_deg: joints().zip(&self.state.joint_offsets_rad).map(|(of, by)| shown(of, *by)).collect(),
            joint_sigmas_deg: joints().zip(self.sigmas.iter().skip(first)).map(|(of, by)| shown(of, *by)).collect(),
            lag_ms: self.state.lag_s * 1e3,
            lag_sigma_ms: self.sigmas[first + joints().len()] * 1e3,
        }
    }

    /// Compares images with the hand, now and then. A camera whose images have become worse has moved, unless the joints are not read any
    /// more.
    fn compare(&mut self, time_s: f64, motion: &Motion, depths_m: &[Option<Array2<f32>>]) {
        if !self.is_due(time_s, COMPARED_EVERY_S) {
            return;
        }
        let joints = self.state.joints(motion);
        let hand = HandSolid::new(&self.hand, &joints);
        let grasp = self.hand.grasp_centre(&joints);
        let inside = posed(&self.samples, &joints);
        let (mut is_frozen, is_still) = (false, self.is_still(time_s));
        for (k, depth_m) in depths_m.iter().enumerate().take(self.given.len()) {
            let Some(depth_m) = depth_m.as_ref().filter(|_| self.watch[k].found) else { continue };
            let camera = &self.given[k];
            let pose = self.state.cameras[k];
            let sighted =
                sight(depth_m, &camera.intrinsics, COMPARED_POINTS, self.frame, |p| is_near(grasp, &(pose * p)));
            let look = Look { depth_m, intrinsics: &camera.intrinsics, sighted: &sighted };
            let agrees = misfit(&look, &pose, &hand, &inside).seen_through < SEEN_THROUGH;
            let watch = &mut self.watch[k];
            watch.doubts = if agrees { 0 } else { watch.doubts + 1 };
            watch.has_agreed |= agrees;
            if watch.doubts >= DOUBTS && is_still {
                is_frozen |= watch.doubts == DOUBTS;
            } else if watch.doubts >= DOUBTS {
                let moved = watch.has_agreed;
                *watch = Watch::default();
                self.forget(k);
                if moved {
                    let name = &self.given[k].name;
                    self.warnings.push(format!("camera {name} moved at {time_s:.1} s: its pose is estimated anew"));
                } else {
                    self.miss(k, time_s);
                }
            }
        }
        if is_frozen {
            self.warnings.push(format!(
                "the joint readings stand still at {time_s:.1} s while the hand in the images moves: \
                 images are skipped until both agree again"
            ));
        }
    }

    /// Forgets a camera's images from its place before.
    fn forget(&mut self, camera: usize) {
        for sighted in self.instants.iter_mut().map(|instant| &mut instant.sighted).chain(&mut self.waiting) {
            if let Some(points) = sighted.get_mut(camera) {
                points.clear();
            }
        }
        self.prior.state.cameras[camera] = self.state.cameras[camera];
        self.every_s = FIRST_EVERY_S;
    }

    /// Looks for the hand in the images of cameras that have not seen it yet.
    fn find_hand(&mut self, time_s: f64, motion: &Motion, depths_m: &[Option<Array2<f32>>]) {
        let joints = self.state.joints(motion);
        let grasp = self.hand.grasp_centre(&joints);
        for (k, depth_m) in depths_m.iter().enumerate().take(self.given.len()) {
            let watch = &self.watch[k];
            let is_due = !watch.found && (!watch.is_missed || self.is_due(time_s, SEARCHED_EVERY_S));
            let Some(depth_m) = depth_m.as_ref().filter(|_| is_due) else { continue };
            let camera = &self.given[k];
            let start = self.state.cameras[k];
            let sighted =
                sight(depth_m, &camera.intrinsics, self.config.points, self.frame, |p| is_near(grasp, &(start * p)));
            let look = Look { depth_m, intrinsics: &camera.intrinsics, sighted: &sighted };
            let found = (!sighted.is_empty()).then(|| find(&self.hand, &look, start, &joints, &self.samples));
            let is_hand = |misfit: &Misfit| {
                misfit.cost < GREATEST_MISFIT.cost && misfit.seen_through < GREATEST_MISFIT.seen_through
            };
            match found.filter(|(_, misfit)| is_hand(misfit)) {
                Some((pose, _)) => {
                    self.state.cameras[k] = pose;
                    self.watch[k].found = true;
                }
                None => self.miss(k, time_s),
            }
        }
    }

    /// Reports once that a camera does not show the hand.
    fn miss(&mut self, camera: usize, time_s: f64) {
        if !std::mem::replace(&mut self.watch[camera].is_missed, true) {
            self.warnings.push(format!(
                "camera {} does not show the hand near its given pose at {time_s:.1} s: its images are skipped until it does. \
                 Are two cameras swapped, is it the other hand, or does the pose belong to another camera?",
                self.given[camera].name
            ));
        }
    }

    /// Points of the hand in the images of the cameras that see it.
    fn sighted(&self, motion: &Motion, depths_m: &[Option<Array2<f32>>]) -> Vec<Vec<Sighted>> {
        let hand = HandSolid::new(&self.hand, &self.state.joints(motion));
        let points = |k: usize, camera: &PosedCamera| {
            let is_usable = self.watch[k].found && self.watch[k].doubts == 0;
            let depth_m = depths_m.get(k)?.as_ref().filter(|_| is_usable)?;
            let pose = self.state.cameras[k];
            let body = |p: &na::Point3<f64>| Some(hand.nearest(narrow(&(pose * p).coords), NEAR_M)?.body);
            let all = sight(depth_m, &camera.intrinsics, usize::MAX, self.frame, |p| body(p).is_some());
            Some(shared_out(&all, self.config.points, |sighted| body(&sighted.point)))
        };
        self.given.iter().enumerate().map(|(k, camera)| points(k, camera).unwrap_or_default()).collect()
    }

    /// Solves all instants that are kept together, or one alone with a gate.
    fn solve(&mut self, alone: Option<(&Instant, f64)>, steps: usize) {
        let (instants, gate_m): (Vec<&Instant>, f64) = match alone {
            Some((instant, gate_m)) => (vec![instant], gate_m),
            None => (self.instants.iter().collect(), GATE_M),
        };
        let weighing = Weighing { gate_m, independent: self.config.independent };
        self.sigmas = solve(&self.hand, &mut self.state, &self.prior, &instants, weighing, steps);
    }

    /// Drops every other instant once there are too many, and keeps half as many from then on.
    fn thin_out(&mut self) {
        if self.instants.len() > self.config.instants {
            let mut index = 0;
            self.instants.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.every_s *= 2.0;
        }
    }
}

/// Whether a point of the world may be that of a hand that holds objects at `grasp`; any point may if that is unknown.
fn is_near(grasp: Option<Point<World>>, point: &na::Point3<f64>) -> bool {
    grasp.is_none_or(|grasp| (point.coords - grasp.coords()).norm() < REACH_M)
}

/// Chooses up to `count` points, as evenly among the bodies of the hand as they are seen: palm and links fill most of an image, and the
/// last joints move the fingertips alone.
fn shared_out(points: &[Sighted], count: usize, body: impl Fn(&Sighted) -> Option<usize>) -> Vec<Sighted> {
    let mut groups: Vec<(usize, Vec<Sighted>)> = Vec::new();
    for sighted in points {
        let Some(body) = body(sighted) else { continue };
        match groups.iter_mut().find(|(known, _)| *known == body) {
            Some((_, group)) => group.push(*sighted),
            None => groups.push((body, vec![*sighted])),
        }
    }
    // The smallest first: the rest goes to the others.
    groups.sort_by_key(|(_, group)| group.len());
    let (mut chosen, mut left) = (Vec::new(), groups.len());
    for (_, group) in groups {
        let share = (count.saturating_sub(chosen.len()) / left).min(group.len());
        chosen.extend(spread(&group, share));
        left -= 1;
    }
    chosen
}
