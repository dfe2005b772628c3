//! Finding an object again, from nothing or from near where it was last seen.

use glam::Vec3;
use mvt_frames::{Field, Isometry, World};
use nalgebra as na;
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use super::align::is_apart;
use super::assess::Assessment;
use super::query::{ask, ask_measured, in_model};
use super::{
    Instant, Loss, Measured, Reference, Solution, System, Tracker, UNSEEN_COSTS_M, interval_s, sigma, surface, to_na,
    to_vec,
};
use mvt_frames::se3;
use mvt_frames::se3::Twist;

/// Turns tried, from none to any, at evenly spread random.
const CANDIDATES: usize = 400;
/// Of these, as many go on to the next round. Those that have converged to nearly one rotation count as one, so that all rotations in which the
/// shape fits are among the last.
const ROUNDS: [Round; 3] = [
    Round { kept: 60, alike: 60, points: 60, steps: 4 },
    Round { kept: 16, alike: 3, points: 150, steps: 8 },
    Round { kept: 6, alike: 1, points: 500, steps: 12 },
];

struct Round {
    kept: usize,
    /// Most that are kept of those that differ little in rotation.
    alike: usize,
    points: usize,
    steps: usize,
}

/// Turns that are tried to find rivals of a pose.
const RIVALS: usize = 1000;
/// A different pose that agrees less by up to this part of the measurements is as good.
const RIVAL: f64 = 0.03;

/// Refines candidates round by round; returns the best, best first.
fn narrowed(
    instant: &Instant,
    shape: &dyn Reference,
    mut candidates: Vec<Candidate>,
    near: Option<&Near>,
    rounds: &[Round],
) -> Vec<Isometry<Field, World>> {
    for round in rounds {
        for candidate in &mut candidates {
            *candidate = refine(instant, shape, candidate.pose, round, near);
        }
        candidates.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let mut kept = Vec::new();
        candidates.retain(|Candidate { pose, .. }| {
            let alike = kept.iter().filter(|other| !is_apart(other, pose)).count();
            let is_kept = kept.len() < round.kept && alike < round.alike;
            kept.extend(is_kept.then_some(*pose));
            is_kept
        });
    }
    candidates.into_iter().map(|found| Isometry::new(found.pose)).collect()
}

/// How far poses around a pose are searched.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reach {
    candidates: usize,
    turn_rad: f64,
    shift_m: f64,
    /// How far the object may have gone from where it is expected, one standard deviation, metres and radians.
    sigma: [f64; 2],
}

impl Reach {
    // Why: notes/decisions/estimation.md, "Poses around a jerk are tried".
    /// Of an object that topples: it turns by 40 degrees between frames.
    pub const JERK: Self = Self { candidates: 200, turn_rad: 0.7, shift_m: 0.008, sigma: [0.005, 0.2] };
    /// Of an object that was lost a few frames ago.
    pub const ASTRAY: Self = Self { candidates: 500, turn_rad: 1.2, shift_m: 0.02, sigma: [0.015, 0.5] };

    /// The reach between two frames, of one that holds for 1/30 s.
    pub fn over(self, interval_s: f64) -> Self {
        let by = (30.0 * interval_s).clamp(1.0, LONGEST_REACH);
        Self { shift_m: by * self.shift_m, sigma: self.sigma.map(|sigma| by * sigma), ..self }
    }
}

/// Over longer times, in 1/30 s, an object goes no farther: it stays in the hand.
const LONGEST_REACH: f64 = 4.0;
/// An object has gone with its seen points if so many more of them then lie where the surface was seen before, as a share.
const SEEN_BEFORE: f64 = 0.03;

/// Rounds of the search around a pose.
const LOCAL_ROUNDS: [Round; 2] =
    [Round { kept: 10, alike: 10, points: 60, steps: 3 }, Round { kept: 1, alike: 1, points: 150, steps: 6 }];

/// A pose that may be the right one.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    pose: na::Isometry3<f64>,
    cost: f64,
}

impl Tracker {
    /// Searches for the pose of the newest frame. `centre` is the middle of the shape's surface in the model's frame and
    /// `near` a pose it may be close to. Returns the best poses that were found, best first, to be judged by [`Tracker::assess`] after
    /// [`Tracker::restart`].
    pub fn relocalise(
        &self,
        shape: &dyn Reference,
        centre: Vec3,
        near: Option<Isometry<Field, World>>,
        rng: &mut ChaCha8Rng,
    ) -> Vec<Isometry<Field, World>> {
        let Some(instant) = self.window.back().filter(|instant| !instant.measured.is_empty()) else {
            return Vec::new();
        };
        let seen = to_na(instant.measured.iter().map(|m| m.point).sum::<Vec3>() / instant.measured.len() as f32);
        let mut candidates = Vec::new();
        let mut propose = |rotation: na::UnitQuaternion<f64>, origin: na::Vector3<f64>| {
            candidates
                .push(Candidate { pose: na::Isometry3::from_parts(origin.into(), rotation), cost: f64::INFINITY });
        };
        if let Some(near) = near.map(Isometry::untyped) {
            propose(near.rotation, near.translation.vector);
            for _ in 0..CANDIDATES / 4 {
                let turn = na::UnitQuaternion::from_scaled_axis(random_in_ball(rng) * 1.2);
                let shift = random_in_ball(rng) * 0.03;
                // About the middle of the shape, so that turns do not throw it out of the hand.
                let middle = near * na::Point3::from(to_na(centre));
                let rotation = turn * near.rotation;
                propose(rotation, middle.coords + shift - rotation * to_na(centre));
            }
        }
        for _ in 0..CANDIDATES {
            let rotation = random_rotation(rng);
            // Cameras see the near side: the middle lies behind the seen surface.
            let away =
                instant.scan.views.first().map_or(Vec3::ZERO, |view| (to_vec(seen) - view.origin).normalize_or_zero());
            let middle = seen + to_na(away) * 0.02 + random_in_ball(rng) * 0.01;
            propose(rotation, middle - rotation * to_na(centre));
        }
        let near = near.filter(|_| !instant.is_seen()).map(|near| Near { pose: near.untyped(), sigma: SEARCH_SIGMA });
        narrowed(instant, shape, candidates, near.as_ref(), &ROUNDS)
    }

    /// Returns other turns about the middle of the shape, `centre` in the model's frame, in which the newest frame agrees nearly as well as at a pose.
    pub(crate) fn rivals(
        &self,
        shape: &dyn Reference,
        best: Isometry<Field, World>,
        centre: Vec3,
        rng: &mut ChaCha8Rng,
    ) -> Vec<Isometry<Field, World>> {
        let Some(instant) = self.window.back() else { return Vec::new() };
        let (centre, middle) = (to_na(centre), best.untyped() * na::Point3::from(to_na(centre)));
        let candidate = |rotation: na::UnitQuaternion<f64>| {
            let pose = na::Isometry3::from_parts((middle.coords - rotation * centre).into(), rotation);
            Candidate { pose, cost: f64::INFINITY }
        };
        let candidates = (0..RIVALS).map(|_| candidate(random_rotation(rng))).collect();
        let mut tracker = self.clone();
        let mut confidence = |pose: &Isometry<Field, World>| {
            tracker.restart(*pose);
            tracker.assess(shape).confidence
        };
        let least = confidence(&best) - RIVAL;
        let mut found = narrowed(instant, shape, candidates, None, &ROUNDS);
        found.retain(|other| is_apart(&best.untyped(), &other.untyped()) && confidence(other) > least);
        found
    }

    /// Moves the newest frame along with its seen points, if the shape fits better there. A face of which a part was seen slides along itself
    /// without a cost, except for the points that come to lie where nothing was seen: these draw no pose.
    pub(crate) fn follow_seen(&mut self, shape: &dyn Reference) {
        let mut instants = self.window.iter().rev();
        let (Some(newest), Some(before)) = (instants.next(), instants.next()) else { return };
        let expected = newest.pose * before.pose.inverse() * na::Point3::from(middle(before));
        let shifted = na::Translation3::from(middle(newest) - expected.coords) * newest.pose;
        let gained = || seen_before(newest, shape, &shifted) - seen_before(newest, shape, &newest.pose);
        if !newest.is_seen() || gained() < SEEN_BEFORE {
            return;
        }
        let reach = Reach::JERK.over(interval_s(before.scan.time_s, newest.scan.time_s));
        let near = Near { pose: newest.pose, sigma: reach.sigma };
        let [expected, shifted] =
            [newest.pose, shifted].map(|pose| refine(newest, shape, pose, &LOCAL_ROUNDS[1], Some(&near)));
        if let Some(newest) = self.window.back_mut().filter(|_| shifted.cost < expected.cost) {
            newest.pose = shifted.pose;
        }
    }

    /// Moves the newest frame to the best pose around where it is, `previous` included. For jerks that the solver alone would not
    /// follow, because it only sees a few millimetres far.
    pub(crate) fn look_around(
        &mut self,
        shape: &dyn Reference,
        previous: Isometry<Field, World>,
        reach: Reach,
        rng: &mut ChaCha8Rng,
    ) {
        let Some(instant) = self.window.back() else { return };
        let start = instant.pose;
        let previous = previous.untyped();
        let seen = middle(instant);
        // The pose before, carried along with the seen points; pads stay where they are while the object moves under them.
        let before = self.window.iter().rev().nth(1).filter(|_| instant.is_seen()).map_or(seen, middle);
        let carried = na::Translation3::from(seen - before) * previous;
        let as_candidate = |pose| Candidate { pose, cost: f64::INFINITY };
        let mut candidates = vec![as_candidate(start), as_candidate(previous), as_candidate(carried)];
        for i in 0..reach.candidates {
            let from = [&start, &previous, &carried][i % 3];
            let turn = na::UnitQuaternion::from_scaled_axis(random_in_ball(rng) * reach.turn_rad);
            let shift = random_in_ball(rng) * reach.shift_m;
            // About the middle of the seen points, which stays where it is.
            let about = na::Translation3::from(seen + shift) * turn * na::Translation3::from(-seen);
            candidates.push(as_candidate(about * from));
        }
        let near = Near { pose: start, sigma: reach.sigma };
        let found = narrowed(instant, shape, candidates, Some(&near), &LOCAL_ROUNDS);
        if let (Some(best), Some(newest)) = (found.first(), self.window.back_mut()) {
            newest.pose = best.untyped();
        }
    }

    /// A tracker at another pose of the newest frame, with how well that agrees: the best within a wide reach. It is not tied to the frames
    /// before, which may be wrong, too.
    pub(crate) fn alternative(
        &self,
        shape: &dyn Reference,
        previous: Isometry<Field, World>,
        rng: &mut ChaCha8Rng,
    ) -> Option<(Self, Solution, Assessment)> {
        let mut other = self.clone();
        other.look_around(shape, previous, Reach::ASTRAY, rng);
        let pose = other.window.back()?.pose;
        other.restart(Isometry::new(pose));
        let solution = other.solve(shape)?;
        let assessment = other.assess(shape);
        Some((other, solution, assessment))
    }

    /// Gives the newest frame another pose and forgets the frames before it.
    pub fn restart(&mut self, pose: Isometry<Field, World>) {
        if let Some(mut newest) = self.window.pop_back() {
            newest.pose = pose.untyped();
            self.window.clear();
            self.window.push_back(newest);
        }
    }
}

/// The middle of the measured points.
fn middle(instant: &Instant) -> na::Vector3<f64> {
    to_na(instant.measured.iter().map(|m| m.point).sum::<Vec3>() / instant.measured.len().max(1) as f32)
}

/// The share of the measurements that lie, at a pose, where the surface was seen before.
fn seen_before(instant: &Instant, shape: &dyn Reference, pose: &na::Isometry3<f64>) -> f64 {
    let points = in_model(pose, instant.measured.iter().map(|m| m.point));
    let mut trusted = vec![false; points.len()];
    shape.trusted(&points, &mut trusted);
    let share = |(m, trusted): (&Measured, bool)| if trusted { m.share } else { 0.0 };
    let all: f64 = instant.measured.iter().map(|m| m.share).sum();
    instant.measured.iter().zip(trusted).map(share).sum::<f64>() / all.max(f64::MIN_POSITIVE)
}

/// Where the object was, and how far it may have gone since, one standard deviation, metres and radians.
struct Near {
    pose: na::Isometry3<f64>,
    sigma: [f64; 2],
}

/// How far from its last pose an object that no camera sees is searched for: all that tells apart the poses that a single pad allows.
const SEARCH_SIGMA: [f64; 2] = [0.02, 0.8];

/// A few damped steps of one pose against the shape, with a sample of all measurements.
fn refine(
    instant: &Instant,
    shape: &dyn Reference,
    mut pose: na::Isometry3<f64>,
    round: &Round,
    near: Option<&Near>,
) -> Candidate {
    let measured = every(&instant.measured, round.points);
    let vacant = every(&instant.occupied, round.points);
    let build = |pose: &na::Isometry3<f64>| {
        let mut system = System::new(1);
        let (points, distances, trusted) = ask_measured(shape, pose, measured.clone().map(|m| m.point));
        // Four times the tracker's tolerance: candidates start far away.
        let loss = Loss::Cauchy(8.0);
        for (i, m) in measured.clone().enumerate() {
            let (r, j) = surface(points[i], distances[i]);
            let s = 1.0 / f64::from(sigma(shape, m.sigma_m));
            if trusted[i] {
                system.add(r * s, &[(Some(0), j * s)], m.share, loss);
            } else {
                system.cost += m.share * loss.at(UNSEEN_COSTS_M * s).0;
            }
        }
        let (points, distances, trusted) = ask(shape, pose, vacant.clone().map(|v| v.point));
        for (i, v) in vacant.clone().enumerate().filter(|(i, _)| trusted[*i]) {
            let (r, j) = surface(points[i], distances[i]);
            let short = r - f64::from(v.clearance_m);
            if short < 0.0 {
                let s = 1.0 / f64::from(v.sigma_m);
                system.add(short * s, &[(Some(0), j * s)], v.share, loss);
            }
        }
        if let Some(near) = near {
            let moved = se3::log(&(near.pose.inverse() * pose));
            let jacobian = se3::inverse_right_jacobian(&moved);
            for row in 0..6 {
                let s = 1.0 / near.sigma[row / 3];
                system.add(moved[row] * s, &[(Some(0), jacobian.row(row).transpose() * s)], 1.0, Loss::Square);
            }
        }
        system
    };
    let mut system = build(&pose);
    let mut damping = 1e-3;
    for _ in 0..round.steps {
        let Some(step) = system.step(damping) else { break };
        let twist: Twist = step.fixed_rows::<6>(0).into_owned();
        let next = pose * se3::exp(&twist);
        let trial = build(&next);
        if trial.cost < system.cost {
            (pose, system, damping) = (next, trial, damping / 4.0);
        } else {
            damping *= 8.0;
        }
    }
    pose.rotation.renormalize();
    Candidate { pose, cost: system.cost }
}

/// About `count` members, evenly spread over the list.
fn every<T>(list: &[T], count: usize) -> impl Iterator<Item = &T> + Clone {
    list.iter().step_by(list.len().div_ceil(count).max(1))
}

/// Uniform over all rotations (Shoemake 1992).
fn random_rotation(rng: &mut ChaCha8Rng) -> na::UnitQuaternion<f64> {
    let [a, b, c]: [f64; 3] = std::array::from_fn(|_| rng.random());
    let (sin_b, cos_b) = (std::f64::consts::TAU * b).sin_cos();
    let (sin_c, cos_c) = (std::f64::consts::TAU * c).sin_cos();
    let (small, large) = (a.sqrt(), (1.0 - a).sqrt());
    na::UnitQuaternion::from_quaternion(na::Quaternion::new(small * cos_c, large * sin_b, large * cos_b, small * sin_c))
}

fn random_in_ball(rng: &mut ChaCha8Rng) -> na::Vector3<f64> {
    loop {
        let v = na::Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
        if v.norm() <= 1.0 {
            return v;
        }
    }
}
