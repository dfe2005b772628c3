//! Exploration: the explorer chooses the controller that will probably show most of the surface that no sensor has seen.
//!
//! It receives an [`Outlook`], which is made of the estimate and of measurements. The true pose and shape have no place in it:
//!
//! ```
//! use mvt_frames::{Isometry, Model, World};
//! use mvt_robot::{hand::Hand, observation::Percept};
//! use mvt_run::{explorer::Outlook, mvt_slam::map::Map};
//!
//! fn look<'a>(map: &'a Map, estimate: Isometry<Model, World>, percept: &'a Percept, hand: &'a Hand) -> Outlook<'a> {
//!     Outlook::new(map, estimate, percept, hand)
//! }
//! ```
//!
//! ```compile_fail,E0308
//! use mvt_frames::{Isometry, Object, World};
//! use mvt_robot::{hand::Hand, observation::Percept};
//! use mvt_run::{explorer::Outlook, mvt_slam::map::Map};
//!
//! fn cheat<'a>(map: &'a Map, truth: Isometry<Object, World>, percept: &'a Percept, hand: &'a Hand) -> Outlook<'a> {
//!     Outlook::new(map, truth, percept, hand)
//! }
//! ```

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use glam::Vec3;
use mvt_frames::depth::{CameraDepth, Label};
use mvt_frames::{Camera, Field, Isometry, Model, Point, World};
use mvt_gaits::directive::Directive;
use mvt_robot::hand::Hand;
use mvt_robot::observation::Percept;
use mvt_slam::map::Map;
use mvt_slam::space::FrontierPatch;
use nalgebra as na;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::belief::Belief;

/// Least time that a controller plays, seconds: two for the change, and as much to show something.
const PART_S: f64 = 4.0;
/// Time that a controller plays with the strategies that do not predict, seconds.
const TURN_S: f64 = 6.0;
/// Time between two looks at the unknown surface, seconds. A look takes some ten milliseconds.
const LOOK_S: f64 = 0.5;
/// Time until the fingers turn the object again after a change and after a re-grasp, seconds.
const CHANGE_S: f64 = 2.0;
const REGRASP_S: f64 = 1.3;
/// Predictions end here, seconds; later the object is not where it was predicted to be.
const HORIZON_S: f64 = 6.0;
const STEP_S: f64 = 0.25;
/// Least cosine between the normal of a patch and the direction to a camera; a camera does not measure a flatter view.
const LEAST_COSINE: f64 = 0.35;
/// A pixel of the hand hides points further behind it than this, metres.
const BEHIND_HAND_M: f64 = 0.004;
/// A pad feels patches up to this far from its middle, metres.
const PAD_REACH_M: f64 = 0.008;
/// Less that staying shows per second is nothing, square metres: noise of the frontier.
const LEAST_GAIN_M2_S: f64 = 2e-5;
/// A change or a re-grasp must show at least this much more per second than staying, square metres. Each is a risk for the object, and
/// late in an episode gains of 0.5 cm^2/s are noise of the frontier.
const LEAST_ADVANTAGE_M2_S: f64 = 1e-4;
/// Time after which a prediction is compared with the outcome, seconds.
const PROMISE_S: f64 = 1.5;
/// Weight of the latest observation in learnt rates and in the share of predictions that come true.
const LEARN: f64 = 0.5;
/// Slowest turning that is assumed, radians per second.
const SLOWEST_RAD_S: f64 = 0.05;

/// A controller among which the explorer chooses.
#[derive(Debug, Clone, PartialEq)]
pub struct ExplorerOption {
    /// Name of a shipped controller.
    pub name: String,
    /// Axis about which it turns the object, a unit vector in the world.
    pub axis: na::Vector3<f64>,
    /// How fast it usually turns the object, radians per second. The explorer learns it from the estimates.
    pub rate_rad_s: f64,
}

/// The knowledge of the explorer at an instant: the map, the estimated pose, and the sensors.
#[derive(Clone, Copy)]
pub struct Outlook<'a> {
    map: &'a Map,
    pose: Isometry<Model, World>,
    percept: &'a Percept,
    hand: &'a Hand,
}

impl<'a> Outlook<'a> {
    /// Joins a map with the estimated pose and the measurements of an instant.
    pub fn new(map: &'a Map, pose: Isometry<Model, World>, percept: &'a Percept, hand: &'a Hand) -> Self {
        Self { map, pose, percept, hand }
    }

    /// Returns the map.
    pub fn map(&self) -> &'a Map {
        self.map
    }
}

/// Finds the surface that is unknown, in place of the map's frontier. An oracle that knows the true shape implements it; `run` has none.
pub trait UnknownSurface: fmt::Debug + Send + Sync {
    /// Returns the unknown surface in the frame of the map's field.
    fn patches(&self, map: &Map) -> Vec<FrontierPatch>;
}

/// How the next controller is chosen.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum ExploreStrategy {
    /// By the frontier of the estimate: the greatest predicted gain per time.
    Frontier,
    /// In turn.
    RoundRobin,
    /// At random, by a seed.
    Random(u64),
    /// As [`ExploreStrategy::Frontier`], for unknown surface that is found otherwise.
    Surface(Arc<dyn UnknownSurface>),
}

/// A choice of the explorer.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ExplorerChoice {
    /// Seconds since the start.
    pub time_s: f64,
    /// Controller that was chosen, `regrasp`, or `none` if nothing is left to gain.
    pub chosen: String,
    /// Predicted gain of each controller and of a re-grasp, square centimetres of unseen surface per second, the time of the change counted.
    pub gains_cm2_s: BTreeMap<String, f64>,
}

impl fmt::Display for ExplorerChoice {
    /// Writes the predicted gains, for the end of a sentence; nothing if there are none.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let gains: Vec<String> = self.gains_cm2_s.iter().map(|(name, gain)| format!("{name} {gain:.1}")).collect();
        if gains.is_empty() { Ok(()) } else { write!(f, " (expected to show, cm^2/s: {})", gains.join(", ")) }
    }
}

/// Name of a re-grasp in a choice.
pub const REGRASP: &str = "regrasp";
/// Name of the end in a choice.
pub const NONE: &str = "none";

/// Chooses among controllers between which a change is safe.
#[derive(Debug, Clone)]
pub struct Explorer {
    options: Vec<ExplorerOption>,
    strategy: ExploreStrategy,
    /// The goal asks for an end when nothing is left to gain.
    stops: bool,
    current: usize,
    /// Beginning of the present part and of the turning in it, seconds, and the angles turned until then.
    since_s: f64,
    turning: Option<(f64, na::Vector3<f64>)>,
    looked_s: f64,
    /// Middles of the patches that were predicted to come into view, and the time of the prediction.
    promise: Option<(Vec<Vec3>, f64)>,
    /// Share of the predictions of this part that came true.
    fulfilled: f64,
    chances: ChaCha8Rng,
    choice: Option<ExplorerChoice>,
}

impl Explorer {
    /// Starts with the first of `options`. With `stops`, the episode ends when nothing is left to gain.
    pub fn new(options: Vec<ExplorerOption>, strategy: ExploreStrategy, stops: bool) -> Self {
        let seed = if let ExploreStrategy::Random(seed) = strategy { seed } else { 0 };
        Self {
            options,
            strategy,
            stops,
            current: 0,
            since_s: 0.0,
            turning: None,
            looked_s: 0.0,
            promise: None,
            fulfilled: 1.0,
            chances: ChaCha8Rng::seed_from_u64(seed),
            choice: None,
        }
    }

    /// Returns the choice that led to the last directive, once.
    pub fn take_choice(&mut self) -> Option<ExplorerChoice> {
        self.choice.take()
    }

    /// Returns a directive if another one than the present controller is better. Call it once per frame in which the pose is trusted.
    pub fn decide(&mut self, belief: &Belief, outlook: &Outlook<'_>) -> Option<Directive> {
        let time_s = belief.time_s;
        let begins_s = if self.since_s > 0.0 { self.since_s + CHANGE_S } else { 0.0 };
        if self.turning.is_none() && time_s >= begins_s {
            self.turning = Some((time_s, belief.turned_rad));
        }
        let plays_s = time_s - self.since_s;
        let next = match &self.strategy {
            ExploreStrategy::RoundRobin if plays_s >= TURN_S => (self.current + 1) % self.options.len().max(1),
            ExploreStrategy::Random(_) if plays_s >= TURN_S => self.chances.random_range(0..self.options.len().max(1)),
            ExploreStrategy::RoundRobin | ExploreStrategy::Random(_) => return None,
            ExploreStrategy::Frontier | ExploreStrategy::Surface(_) if time_s < self.looked_s + LOOK_S => return None,
            ExploreStrategy::Frontier => return self.look(belief, outlook, &outlook.map.space().frontier()),
            ExploreStrategy::Surface(unknown) => {
                let patches = unknown.patches(outlook.map);
                return self.look(belief, outlook, &patches);
            }
        };
        self.since_s = time_s;
        (next != self.current).then(|| self.change(belief, next, BTreeMap::new()))
    }

    /// Compares the patches that the options would show.
    fn look(&mut self, belief: &Belief, outlook: &Outlook<'_>, patches: &[FrontierPatch]) -> Option<Directive> {
        // Why: notes/decisions/estimation.md, "The explorer counts unseen cells on the hull, not the variance of the field".
        let time_s = belief.time_s;
        self.looked_s = time_s;
        self.compare_with_promise(time_s, outlook);
        let view = View::new(outlook, patches);
        let usual: Vec<Vec<f64>> =
            self.options.iter().map(|option| view.shown_m2(option.axis, option.rate_rad_s)).collect();
        let option = self.options.get(self.current)?;
        let rate_rad_s = self.present_rate(belief).unwrap_or(option.rate_rad_s);
        let now = view.shown_m2(option.axis, rate_rad_s);
        if self.turning.is_some() && self.promise.is_none() {
            self.promise = Some((view.promised(option.axis, rate_rad_s, PROMISE_S), time_s));
        }
        if time_s < self.since_s + PART_S {
            return None;
        }
        let per_time = |shown: &[f64], cost_s: f64| {
            let rate = |(k, area): (usize, &f64)| area / (cost_s + (k + 1) as f64 * STEP_S);
            shown.iter().enumerate().map(rate).fold(0.0, f64::max)
        };
        let mut gains: Vec<f64> = usual.iter().map(|shown| per_time(shown, CHANGE_S)).collect();
        let stays = self.fulfilled * per_time(&now, 0.0);
        // A re-grasp restores the usual rate, and does not show what did not come into view before.
        let regrasps = self.fulfilled * usual.get(self.current).map_or(0.0, |shown| per_time(shown, REGRASP_S));
        *gains.get_mut(self.current)? = stays;
        let named = self.options.iter().zip(&gains).map(|(option, gain)| (option.name.clone(), 1e4 * gain));
        let named: BTreeMap<String, f64> = named.chain([(REGRASP.to_owned(), 1e4 * regrasps)]).collect();
        let (best, most) = gains
            .iter()
            .enumerate()
            .fold((self.current, stays), |best, (k, &gain)| if gain > best.1 { (k, gain) } else { best });
        if most.max(regrasps) < stays + LEAST_ADVANTAGE_M2_S {
            let ends = self.stops && stays < LEAST_GAIN_M2_S;
            self.choice = ends.then(|| ExplorerChoice { time_s, chosen: NONE.to_owned(), gains_cm2_s: named });
            return ends.then_some(Directive::Stop);
        }
        if regrasps > most {
            self.begin_part(belief);
            self.choice = Some(ExplorerChoice { time_s, chosen: REGRASP.to_owned(), gains_cm2_s: named });
            return Some(Directive::Regrasp);
        }
        (best != self.current).then(|| self.change(belief, best, named))
    }

    /// Returns how fast the object has turned in this part; `None` too early in it.
    fn present_rate(&self, belief: &Belief) -> Option<f64> {
        let option = self.options.get(self.current)?;
        let (since_s, turned_rad) = self.turning?;
        let elapsed_s = belief.time_s - since_s;
        let rate = (belief.turned_rad - turned_rad).dot(&option.axis) / elapsed_s;
        (elapsed_s >= PROMISE_S).then(|| (LEARN * rate + (1.0 - LEARN) * option.rate_rad_s).max(SLOWEST_RAD_S))
    }

    /// Updates the share of the predictions that came true.
    fn compare_with_promise(&mut self, time_s: f64, outlook: &Outlook<'_>) {
        let Some((middles, _)) = self.promise.take_if(|(_, made_s)| time_s >= *made_s + PROMISE_S) else { return };
        if middles.is_empty() {
            return;
        }
        let space = outlook.map.space();
        let known = middles.iter().filter(|&&p| space.is_near_surface(p) || space.is_seen_empty(p)).count();
        self.fulfilled += LEARN * (known as f64 / middles.len() as f64 - self.fulfilled);
    }

    fn begin_part(&mut self, belief: &Belief) {
        if let Some(rate_rad_s) = self.present_rate(belief)
            && let Some(option) = self.options.get_mut(self.current)
        {
            option.rate_rad_s = rate_rad_s;
        }
        self.since_s = belief.time_s;
        self.turning = None;
        self.promise = None;
        self.fulfilled = 1.0;
    }

    fn change(&mut self, belief: &Belief, next: usize, gains_cm2_s: BTreeMap<String, f64>) -> Directive {
        self.begin_part(belief);
        self.current = next;
        let chosen = self.options.get(next).map(|option| option.name.clone()).unwrap_or_default();
        self.choice = Some(ExplorerChoice { time_s: belief.time_s, chosen: chosen.clone(), gains_cm2_s });
        Directive::ChangeController(chosen)
    }
}

/// Unseen patches in the world, and the sensors that may see them.
struct View<'a> {
    patches: &'a [FrontierPatch],
    /// Middle and normal of each patch, the middle from the centre of the object.
    placed: Vec<[na::Vector3<f64>; 2]>,
    centre: na::Vector3<f64>,
    cameras: Vec<&'a CameraDepth>,
    pads: Vec<na::Vector3<f64>>,
}

impl<'a> View<'a> {
    fn new(outlook: &Outlook<'a>, patches: &'a [FrontierPatch]) -> Self {
        let Outlook { map, pose, percept, hand } = *outlook;
        let world_from_field: Isometry<Field, World> = pose * map.field_from_model().inverse();
        let world_from_field = world_from_field.untyped();
        let double = |v: Vec3| na::Vector3::from(v.to_array().map(f64::from));
        let middle = map.space().bounds().map_or(Vec3::ZERO, |[low, high]| 0.5 * (low + high));
        let at = |p: Vec3| (world_from_field * na::Point3::from(double(p))).coords;
        let centre = at(middle);
        let placed =
            |patch: &FrontierPatch| [at(patch.centre) - centre, world_from_field.rotation * double(patch.normal)];
        Self {
            patches,
            placed: patches.iter().map(placed).collect(),
            centre,
            cameras: percept.cameras.iter().flatten().collect(),
            pads: hand
                .world_from_pads(&percept.joints)
                .into_iter()
                .zip(&percept.touch)
                .filter(|(_, press)| press.is_some())
                .map(|(world_from_pad, _)| world_from_pad.origin().coords())
                .collect(),
        }
    }

    /// Returns, for each patch, the step at which it comes into view if the object turns about an axis. A patch that should be in view now
    /// and is unknown all the same has none.
    fn steps<'b>(&'b self, axis: na::Vector3<f64>, rate_rad_s: f64) -> impl Iterator<Item = Option<usize>> + 'b {
        let turns: Vec<na::UnitQuaternion<f64>> = (0..=(HORIZON_S / STEP_S) as usize)
            .map(|k| na::UnitQuaternion::new(axis * (rate_rad_s * STEP_S * k as f64)))
            .collect();
        let sensed_at = move |[from_centre, normal]: &[na::Vector3<f64>; 2]| {
            turns.iter().position(|turn| self.is_sensed(self.centre + turn * from_centre, turn * normal))
        };
        self.placed.iter().map(move |placed| sensed_at(placed)?.checked_sub(1))
    }

    /// Returns the area that has come into view after each step, square metres.
    fn shown_m2(&self, axis: na::Vector3<f64>, rate_rad_s: f64) -> Vec<f64> {
        let mut shown = vec![0.0; (HORIZON_S / STEP_S) as usize];
        for (patch, step) in self.patches.iter().zip(self.steps(axis, rate_rad_s)) {
            if let Some(shown) = step.and_then(|step| shown.get_mut(step)) {
                *shown += f64::from(patch.area_m2);
            }
        }
        let mut sum = 0.0;
        shown.iter_mut().for_each(|area| {
            sum += *area;
            *area = sum;
        });
        shown
    }

    /// Returns the middles of the patches that come into view within some seconds.
    fn promised(&self, axis: na::Vector3<f64>, rate_rad_s: f64, seconds: f64) -> Vec<Vec3> {
        let last = (seconds / STEP_S) as usize;
        let steps = self.patches.iter().zip(self.steps(axis, rate_rad_s));
        steps.filter(|(_, step)| step.is_some_and(|step| step < last)).map(|(patch, _)| patch.centre).collect()
    }

    fn is_sensed(&self, place: na::Vector3<f64>, normal: na::Vector3<f64>) -> bool {
        self.pads.iter().any(|pad| (pad - place).norm() < PAD_REACH_M)
            || self.cameras.iter().any(|camera| is_seen(camera, place, normal))
    }
}

/// Whether a camera would see a patch that is not behind the hand as it is now.
fn is_seen(camera: &CameraDepth, place: na::Vector3<f64>, normal: na::Vector3<f64>) -> bool {
    let to_camera = camera.world_from_camera.origin().coords() - place;
    if normal.dot(&to_camera) < LEAST_COSINE * to_camera.norm() {
        return false;
    }
    let point: Point<Camera> = camera.world_from_camera.inverse() * Point::<World>::from(place);
    let Some((u, v)) = camera.intrinsics.project(point) else { return false };
    if !(u >= 0.0 && v >= 0.0) {
        return false;
    }
    let pixel = (v.round() as usize, u.round() as usize);
    let (Some(label), Some(&depth_m)) = (camera.labels.get(pixel), camera.depth_m.get(pixel)) else { return false };
    let is_hidden = *label == Label::Hand && f64::from(depth_m) < -point.coords().z - BEHIND_HAND_M;
    !is_hidden
}

#[cfg(test)]
mod tests;
