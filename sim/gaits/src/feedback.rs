//! Controllers that hold an object in the air on the fingertips and turn it there, with feedback on its place.
//!
//! The place is an estimate. Only [`EstimatedPlace`] reaches the controller of a run, and it is made from an estimated
//! pose; [`RehearsedPlace`] is made from the true one, for searches and for simulations without cameras.

use std::sync::Arc;

use mvt_robot::hand::{Hand, JointAngles};
use nalgebra::Vector3;

use crate::clock::CONTROL_HZ;
use crate::controller::{Controller, Proprioception};
use crate::gait::Gait;
use crate::schedule::{blend, smooth};

pub use crate::place::{EstimatedPlace, PlaceFeedback, RehearsedPlace, SeenPlace};

// Why: notes/decisions/simulation.md, "In the air, an episode begins with a hand-over".
/// Time from the start of an episode until the support under the object is taken away, seconds. The fingers have closed
/// by then.
pub const HANDED_OVER_S: f64 = 1.0;
/// Time over which the fingers close around the supported object, seconds.
const CLOSING_S: f64 = 0.8;
/// Time over which the table's motion grows to its full size, seconds.
const GROWING_S: f64 = 0.6;
/// Age at which an estimate is too old to hold the object by, seconds. Without feedback it falls after a second or more.
pub const STALE_S: f64 = 0.3;
/// Share of a new velocity in the mean of the last ones.
const VELOCITY_SHARE: f64 = 0.25;
/// Time in which most of the summed displacement is forgotten, seconds, and its limit along each axis, m s.
const FORGETTING_S: f64 = 8.0;
const SUM_LIMIT: f64 = 0.03;
/// Distance of an estimate from the last one that no held object covers between two frames, metres.
const JUMP_M: f64 = 0.03;

/// Controller that holds an object in the air. If it does not know where the object is, it lowers it to the palm.
#[derive(Debug, Clone)]
pub struct FeedbackController {
    gait: Gait,
    feedback: PlaceFeedback,
    hand: Arc<Hand>,
    seen: Option<SeenPlace>,
    /// Mean velocity of the object, m/s.
    velocity: Vector3<f64>,
    /// Displacement summed over time, m s.
    summed: Vector3<f64>,
    /// Sum and number of the places before the hand-over. Their mean is where the object is to stay.
    before: (Vector3<f64>, u32),
    /// Time at which the hand began to lower the object, seconds, and the targets of then.
    lowering: Option<(f64, JointAngles)>,
    aimed_at: JointAngles,
    /// Joint angles at which the closed fingers aim; the table swings around them.
    closed: JointAngles,
    /// Time at which the table's motion was stopped, seconds, and the sum of all stops.
    paused_at_s: Option<f64>,
    paused_s: f64,
    time_s: f64,
}

impl FeedbackController {
    /// Starts with open fingers around a supported object. `None` if the gait has no feedback.
    pub fn new(gait: &Gait, hand: &Arc<Hand>) -> Option<Self> {
        let feedback = gait.feedback.as_deref()?.clone();
        Some(Self {
            closed: feedback.grasp.clone(),
            feedback,
            gait: gait.clone(),
            hand: Arc::clone(hand),
            seen: None,
            velocity: Vector3::zeros(),
            summed: Vector3::zeros(),
            before: (Vector3::zeros(), 0),
            lowering: None,
            aimed_at: gait.open_pose.clone(),
            paused_at_s: None,
            paused_s: 0.0,
            time_s: 0.0,
        })
    }

    fn take(&mut self, place: SeenPlace) {
        let SeenPlace { time_s, mut middle_m, .. } = place;
        // Everything below is that of the right hand.
        middle_m.y *= self.hand.side().sign();
        if !(time_s.is_finite() && middle_m.iter().all(|v| v.is_finite())) {
            return;
        }
        if let Some(last) = self.seen {
            let (moved, elapsed_s) = (middle_m - last.middle_m, time_s - last.time_s);
            if elapsed_s <= 0.0 || moved.norm() > JUMP_M {
                return;
            }
            self.velocity += (moved / elapsed_s - self.velocity) * VELOCITY_SHARE;
        }
        self.seen = Some(SeenPlace { middle_m, ..place });
        if time_s < HANDED_OVER_S {
            self.before = (self.before.0 + middle_m, self.before.1 + 1);
            self.velocity = Vector3::zeros();
        }
    }

    /// Stops the turning, or lets it go on. The object stays in the air.
    pub fn pause(&mut self, stop: bool) {
        match (self.paused_at_s, stop) {
            (None, true) => self.paused_at_s = Some(self.time_s),
            (Some(since), false) => {
                self.paused_s += self.time_s - since;
                self.paused_at_s = None;
            }
            _ => (),
        }
    }

    /// Returns the displacement of the object from where it is to stay; `None` if its place is unknown or an old one.
    fn displacement(&self, time_s: f64) -> Option<Vector3<f64>> {
        let (sum, count) = self.before;
        let seen = self.seen.filter(|seen| count > 0 && time_s - seen.time_s <= STALE_S)?;
        Some(seen.middle_m - sum / f64::from(count))
    }

    /// Returns the targets of the right hand, whose joints are at `measured`.
    fn targets(&mut self, time_s: f64, measured: &[f64]) -> JointAngles {
        let PlaceFeedback { grasp, touching, gains, damping, lift, lowering, .. } = &self.feedback;
        if time_s < HANDED_OVER_S {
            if let Some(touching) = touching
                && time_s >= CLOSING_S
            {
                let pressed = measured.iter().zip(grasp).zip(touching);
                self.closed = pressed.map(|((measured, grasp), touching)| measured + grasp - touching).collect();
                return self.closed.clone();
            }
            return blend(&self.gait.open_pose, grasp, smooth(time_s / CLOSING_S));
        }
        if let Some((since, from)) = &self.lowering {
            return along(from, lowering, time_s - since);
        }
        let Some(displacement) = self.displacement(time_s) else {
            self.lowering = Some((time_s, self.aimed_at.clone()));
            return self.aimed_at.clone();
        };
        let period_s = 1.0 / f64::from(CONTROL_HZ);
        let summed = self.summed * (1.0 - period_s / FORGETTING_S) + displacement * period_s;
        self.summed = summed.map(|v| v.clamp(-SUM_LIMIT, SUM_LIMIT));
        let turning_s = self.paused_at_s.unwrap_or(time_s) - self.paused_s - HANDED_OVER_S;
        let swing = self.gait.row(turning_s);
        let size = (turning_s / GROWING_S).clamp(0.0, 1.0);
        let aims = self.closed.iter().zip(swing).zip(grasp).enumerate().map(|(j, ((closed, swing), grasp))| {
            let rates = |of: &[[f64; 3]]| of.get(j).map_or_else(Vector3::zeros, |rates| Vector3::from(*rates));
            let [gain, damping, lift] = [gains, damping, lift].map(|of| rates(of));
            let fed_back = gain.dot(&displacement) + damping.dot(&self.velocity) + lift.dot(&self.summed);
            closed + size * (swing - grasp) + fed_back
        });
        aims.collect()
    }
}

impl Controller for FeedbackController {
    fn copy(&self) -> Box<dyn Controller> {
        Box::new(self.clone())
    }

    fn needs_place(&self) -> bool {
        true
    }

    /// Receives the estimated place of the object. One that is not finite, not newer than the last, or far from it, is
    /// ignored.
    fn see(&mut self, place: EstimatedPlace) {
        self.take(place.0);
    }

    fn rehearse(&mut self, place: RehearsedPlace) {
        self.take(place.0);
    }

    fn lowered_at_s(&self) -> Option<f64> {
        self.lowering.as_ref().map(|(since, _)| *since)
    }

    fn command(&mut self, sensed: &Proprioception) -> JointAngles {
        self.time_s = sensed.time_s;
        let targets = self.targets(sensed.time_s, &self.hand.mirrored(&sensed.joints));
        let targets = self.hand.within_ranges(&self.hand.mirrored(&targets));
        self.aimed_at = self.hand.mirrored(&targets);
        targets
    }
}

/// Returns the targets on the way from one pose through others, one per second; the last one is kept.
fn along(from: &[f64], poses: &[JointAngles], elapsed_s: f64) -> JointAngles {
    let mut last = from;
    for (begins_s, pose) in (0_u32..).zip(poses) {
        let part = elapsed_s - f64::from(begins_s);
        if part < 1.0 {
            return blend(last, pose, part);
        }
        last = pose;
    }
    last.to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gait;
    use mvt_frames::{Isometry, Point};
    use mvt_robot::hand::Side;

    const PERIOD_S: f64 = 0.04;

    fn controller(side: Side) -> FeedbackController {
        FeedbackController::new(gait::find("air_ball").unwrap().1, &Hand::allegro(side)).unwrap()
    }

    /// Returns an estimate at a time, displaced from the place of the hand-over on this hand.
    fn seen(side: Side, time_s: f64, [x, y, z]: [f64; 3]) -> EstimatedPlace {
        let [px, py, pz] = gait::find("air_ball").unwrap().1.feedback.as_ref().unwrap().place_m;
        let place = [px + x, side.sign() * (py + y), pz + z];
        EstimatedPlace::new(time_s, Isometry::from_parts(place, [1.0, 0.0, 0.0, 0.0]), Point::from(Vector3::zeros()))
    }

    /// Returns the targets of `seconds`. `place` tells the displacement that is seen before each command, if one is.
    fn play(
        side: Side,
        seconds: f64,
        place: impl Fn(f64) -> Option<[f64; 3]>,
    ) -> (Vec<JointAngles>, FeedbackController) {
        let mut controller = controller(side);
        let commands = (0..(seconds / PERIOD_S).round() as usize).map(|k| {
            let time_s = k as f64 * PERIOD_S;
            if let Some(displacement) = place(time_s) {
                controller.see(seen(side, time_s, displacement));
            }
            controller.command(&Proprioception::at(time_s, vec![0.0; 16]))
        });
        let targets = commands.collect();
        (targets, controller)
    }

    #[test]
    fn the_left_hand_is_the_mirror_image() {
        let sway = |t: f64| Some([0.002 * t.sin(), 0.003 * t.cos(), -0.001 * t]);
        let [(left, _), (right, _)] = [Side::Left, Side::Right].map(|side| play(side, 4.0, sway));
        for (left, right) in left.iter().zip(right) {
            let mirrored = Hand::allegro(Side::Left).mirrored(&right);
            assert!((0..16).all(|j| (left[j] - mirrored[j]).abs() < 1e-9));
        }
    }

    #[test]
    fn a_displaced_object_moves_the_fingers_and_its_place_at_the_hand_over_does_not() {
        let (still, _) = play(Side::Right, 3.0, |_| Some([0.0; 3]));
        let (elsewhere, _) = play(Side::Right, 3.0, |_| Some([0.004, -0.003, 0.002]));
        let (sagged, _) = play(Side::Right, 3.0, |t| Some([0.0, 0.0, if t < 2.0 { 0.0 } else { -0.005 }]));
        let apart = |a: &[f64], b: &[f64]| (0..16).map(|j| (a[j] - b[j]).abs()).fold(0.0, f64::max);
        for (k, targets) in still.iter().enumerate() {
            assert!(apart(targets, &elsewhere[k]) < 1e-9);
            assert_eq!(apart(targets, &sagged[k]) > 1e-3, k >= 50, "{k}");
        }
    }

    #[test]
    fn without_a_new_place_the_hand_lowers_the_object_and_keeps_it_there() {
        let (targets, controller) = play(Side::Right, 20.0, |t| (t < 3.0).then_some([0.0; 3]));
        let lowered_at_s = controller.lowered_at_s().unwrap();
        assert!((2.96 + STALE_S..2.96 + STALE_S + 2.0 * PERIOD_S).contains(&lowered_at_s), "{lowered_at_s}");
        let last = gait::find("air_ball").unwrap().1.feedback.as_ref().unwrap().lowering.last().unwrap();
        assert_eq!(targets.last().unwrap(), last);
        // No target jumps while it is lowered.
        let step = |pair: &[JointAngles]| (0..16).map(|j| (pair[1][j] - pair[0][j]).abs()).fold(0.0, f64::max);
        let first = (lowered_at_s / PERIOD_S).round() as usize;
        assert!(targets[first - 1..].windows(2).map(step).fold(0.0, f64::max) < 0.1);
        // A place that comes afterwards changes nothing.
        let (again, _) = play(Side::Right, 20.0, |t| (!(3.0..=4.0).contains(&t)).then_some([0.0; 3]));
        assert_eq!(again, targets);
        assert_eq!(play(Side::Right, 2.0, |_| None).1.lowered_at_s(), Some(HANDED_OVER_S));
    }

    #[test]
    fn broken_old_and_impossible_places_are_ignored() {
        let (steady, _) = play(Side::Left, 2.2, |t| (t < 2.0).then_some([0.0; 3]));
        for broken in [[f64::NAN, 0.0, 0.0], [0.0, f64::INFINITY, 0.0], [0.05, 0.0, 0.0]] {
            let (targets, _) = play(Side::Left, 2.2, |t| Some(if t < 2.0 { [0.0; 3] } else { broken }));
            assert_eq!(targets, steady, "{broken:?}");
        }
        let mut controller = controller(Side::Left);
        controller.see(seen(Side::Left, 0.5, [0.0; 3]));
        for time_s in [0.5, 0.3, f64::NAN] {
            controller.see(seen(Side::Left, time_s, [0.01, 0.0, 0.0]));
            assert_eq!(controller.seen.unwrap().time_s, 0.5);
        }
    }

    #[test]
    fn fingers_press_from_where_they_are_stopped() {
        for side in [Side::Left, Side::Right] {
            let mut gait = gait::find("air_ball").unwrap().1.clone();
            let feedback = gait.feedback.as_mut().unwrap();
            let lower = |angles: &[f64], by: f64| -> JointAngles { angles.iter().map(|angle| angle - by).collect() };
            let touching = lower(&feedback.grasp, 0.1);
            feedback.touching = Some(touching.clone());
            // A larger object stops the fingers earlier.
            let stopped = lower(&touching, 0.05);
            let hand = Hand::allegro(side);
            let mut controller = FeedbackController::new(&gait, &hand).unwrap();
            let mut last = Vec::new();
            for k in 0..25 {
                let time_s = f64::from(k) * PERIOD_S;
                controller.see(seen(side, time_s, [0.0; 3]));
                last = controller.command(&Proprioception::at(time_s, hand.mirrored(&stopped)));
            }
            let aimed = hand.mirrored(&last);
            for (j, [low, high]) in Hand::allegro(Side::Right).ranges().into_iter().enumerate() {
                assert!((aimed[j] - (stopped[j] + 0.1).clamp(low, high)).abs() < 1e-9, "joint {j}");
            }
        }
    }

    #[test]
    fn a_pause_stops_the_turning() {
        let mut controller = controller(Side::Right);
        let targets: Vec<JointAngles> = (0..150)
            .map(|k| {
                let time_s = f64::from(k) * PERIOD_S;
                controller.pause((75..100).contains(&k));
                controller.see(seen(Side::Right, time_s, [0.0; 3]));
                controller.command(&Proprioception::at(time_s, vec![0.0; 16]))
            })
            .collect();
        let (plain, _) = play(Side::Right, 6.0, |_| Some([0.0; 3]));
        assert_eq!(targets[..75], plain[..75]);
        assert!(targets[76..100].iter().all(|row| (0..16).all(|j| (row[j] - targets[75][j]).abs() < 1e-9)));
        let resumed = targets[101..].iter().zip(&plain[76..]);
        assert!(resumed.into_iter().all(|(a, b)| (0..16).all(|j| (a[j] - b[j]).abs() < 1e-9)));
    }
}
