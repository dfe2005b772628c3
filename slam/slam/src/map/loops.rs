//! Loop closure: when a side of the object is seen again, it is aligned with the earlier view of that side.

use nalgebra as na;

use super::Map;
use crate::tracker::icp::{self, Matching, Posed};
use mvt_frames::{Isometry, se3};
use mvt_graph::system::System;
use mvt_graph::{self as graph, Edge};

/// A loop closes over at least this time, seconds: nearer keyframes are tied by tracking.
const APART_S: f64 = 3.0;
/// Both views are of one place if the object has moved by less than this between them, metres.
const APART_M: f64 = 0.03;
/// How the points of two keyframes are matched.
const MATCHING: Matching = Matching { points: 600, independent: 150.0, reach_m: icp::REACH_M };
/// Steps of the alignment.
const STEPS: usize = 8;
/// A loop is believed if so many of its points find a match.
const MATCHED: f64 = 0.7;
// Why: notes/decisions/estimation.md, "Loops are closed only for disagreements above 3 mm or 3.4 degrees".
/// Disagreement from which a loop is worth closing, metres and radians: several times what
/// alignment of two noisy scans errs by. Less is left to refinement against the field, which averages over many scans.
const WORTH: [f64; 2] = [0.003, 0.06];
/// And by how much alignment must lower the mean cost of a matched point.
const WORTH_GAIN: f64 = 2.0;
/// How exactly the motion from keyframe to keyframe is known, and by alignment that of a loop, metres and radians.
const CHAIN_SIGMA: [f64; 2] = [0.0003, 0.005];
const LOOP_SIGMA: [f64; 2] = [0.0005, 0.008];

impl Map {
    /// Looks for an older keyframe that saw the same side as the newest, and if the two disagree, brings all keyframes into
    /// agreement. Returns the motion from the corrected model frame to the one before, as the newest keyframe has it.
    pub(super) fn close_loop(&mut self) -> Option<na::Isometry3<f64>> {
        let (newest, older) = self.keyframes.split_last()?;
        let newest_pose = newest.pose().untyped();
        let time_s = newest.scan().time_s - APART_S;
        let turn = |k: usize| older[k].pose().untyped().rotation.angle_to(&newest_pose.rotation);
        let moved = |k: usize| (older[k].pose().untyped().translation.vector - newest_pose.translation.vector).norm();
        let alike = (0..older.len())
            .filter(|&k| older[k].scan().time_s < time_s && moved(k) < APART_M)
            .min_by(|&a, &b| turn(a).total_cmp(&turn(b)))?;
        if turn(alike).to_degrees() > self.config.loop_turn_deg {
            return None;
        }
        let older_pose = older[alike].pose().untyped();
        let Alignment { pose: aligned, gain } = align(
            Posed { scan: older[alike].scan(), pose: &older_pose },
            Posed { scan: newest.scan(), pose: &newest_pose },
        )?;
        let disagreement = se3::log(&(newest_pose.inverse() * aligned));
        let [distance, angle] = [disagreement.fixed_rows::<3>(0).norm(), disagreement.fixed_rows::<3>(3).norm()];
        // Where an object looks the same after a turn, alignment goes astray and gains nothing by it.
        if (distance < WORTH[0] && angle < WORTH[1]) || gain < WORTH_GAIN {
            return None;
        }
        let motion = older_pose.inverse() * aligned;
        self.loops.push(Edge { from: alike, to: older.len(), motion, sigma: LOOP_SIGMA });
        let mut poses: Vec<_> = self.keyframes.iter().map(|keyframe| keyframe.pose().untyped()).collect();
        // Each keyframe is tied to the one before as both stand now: a loop must not undo what refinement found since.
        let tie = |k: usize| Edge { from: k - 1, to: k, motion: poses[k - 1].inverse() * poses[k], sigma: CHAIN_SIGMA };
        let edges: Vec<Edge> = (1..poses.len()).map(tie).chain(self.loops.iter().copied()).collect();
        graph::optimise(&mut poses, &edges);
        let correction = newest_pose.inverse() * poses.last()?;
        for (keyframe, pose) in self.keyframes.iter_mut().zip(poses) {
            keyframe.set_pose(Isometry::new(pose));
        }
        Some(correction)
    }
}

/// A frame aligned with another.
struct Alignment {
    pose: na::Isometry3<f64>,
    /// Mean cost of a matched point before, as a multiple of that after.
    gain: f64,
}

/// The pose of `b` at which its surface lies on that of `a`; `None` if too little matches.
fn align(a: Posed<'_>, b: Posed<'_>) -> Option<Alignment> {
    let mut pose = *b.pose;
    let mut costs = Vec::with_capacity(STEPS + 1);
    for k in 0..=STEPS {
        let mut system = System::new(1);
        let moving = Posed { pose: &pose, ..b };
        let [tried, matched] = icp::add(&mut system, (None, a), (Some(0), moving), MATCHING);
        if (matched as f64) < MATCHED * tried.max(1) as f64 {
            return None;
        }
        costs.push(system.cost / matched.max(1) as f64);
        if k < STEPS {
            pose *= se3::exp(&system.step(1e-3)?.fixed_rows::<6>(0).into_owned());
        }
    }
    Some(Alignment { pose, gain: costs.first()? / costs.last()?.max(f64::MIN_POSITIVE) })
}
