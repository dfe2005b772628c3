//! A pose graph: poses tied to one another by measured motions, brought into agreement. [`system`] is the problem over the few poses of a window.
//!
//! Minimises the sum of |L (log(Z^-1 Ti^-1 Tj))|^2 over all edges by Gauss-Newton, each step solved by preconditioned conjugate
//! gradients, so that time grows with the number of edges (Dellaert and Kaess, "Factor Graphs for Robot Perception", 2017).
//!
//! ```
//! use mvt_graph::{Edge, optimise};
//! use nalgebra::Isometry3;
//!
//! // Two steps of 1 m were measured, and from the first pose to the last 1.7 m: the disagreement is spread.
//! let step = |x| Isometry3::translation(x, 0.0, 0.0);
//! let edge = |from, to, x| Edge { from, to, motion: step(x), sigma: [0.1, 0.1] };
//! let mut poses = [step(0.0), step(1.0), step(2.0)];
//! let [before, after] = optimise(&mut poses, &[edge(0, 1, 1.0), edge(1, 2, 1.0), edge(0, 2, 1.7)]);
//! assert!(after < before && (poses[2].translation.x - 1.8).abs() < 1e-6);
//! ```

pub mod system;

use nalgebra as na;

use mvt_frames::se3;
use mvt_frames::se3::Twist;

/// A measured motion between two poses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// The pose that the motion starts from,
    pub from: usize,
    /// and the one that it leads to.
    pub to: usize,
    /// T_from^-1 T_to as it was measured.
    pub motion: na::Isometry3<f64>,
    /// Standard deviation of its translation (m) and rotation (rad).
    pub sigma: [f64; 2],
}

/// Gauss-Newton steps at most; motions between keyframes are small, so that few are needed.
const STEPS: usize = 6;
/// Conjugate gradient steps at most per Gauss-Newton step.
const INNER_STEPS: usize = 300;
/// A step below this (m, rad) ends the search.
const SMALL_STEP: f64 = 1e-7;
/// Larger errors than this many standard deviations count less and less: a wrong loop must not bend the whole graph.
const ROBUST_SIGMAS: f64 = 10.0;

/// Derivatives of an edge's error by its two poses, weighted, and the weighted error.
struct Linear {
    from: usize,
    to: usize,
    by_from: na::Matrix6<f64>,
    by_to: na::Matrix6<f64>,
    error: Twist,
}

/// Moves all poses but the first, which stays, to where they agree best with the edges. An edge to a pose that is not there counts
/// for nothing. Returns the sum of squared errors in standard deviations, before and after.
pub fn optimise(poses: &mut [na::Isometry3<f64>], edges: &[Edge]) -> [f64; 2] {
    let edges: Vec<Edge> = edges.iter().copied().filter(|e| e.from < poses.len() && e.to < poses.len()).collect();
    let before = edges.iter().map(|edge| error(poses, edge).norm_squared()).sum();
    for _ in 0..STEPS {
        let linear: Vec<Linear> = edges.iter().map(|edge| linearise(poses, edge)).collect();
        let step = solve(&linear, poses.len());
        let largest = step.iter().map(na::Matrix::amax).fold(0.0, f64::max);
        for (pose, twist) in poses.iter_mut().zip(&step) {
            *pose *= se3::exp(twist);
            pose.rotation.renormalize();
        }
        if largest < SMALL_STEP {
            break;
        }
    }
    [before, edges.iter().map(|edge| error(poses, edge).norm_squared()).sum()]
}

/// The error of an edge in standard deviations.
fn error(poses: &[na::Isometry3<f64>], edge: &Edge) -> Twist {
    let motion = poses[edge.from].inverse() * poses[edge.to];
    scale(edge).component_mul(&se3::log(&(edge.motion.inverse() * motion)))
}

fn scale(edge: &Edge) -> Twist {
    Twist::from_fn(|i, _| 1.0 / edge.sigma[i / 3])
}

fn linearise(poses: &[na::Isometry3<f64>], edge: &Edge) -> Linear {
    let motion = poses[edge.from].inverse() * poses[edge.to];
    let raw = se3::log(&(edge.motion.inverse() * motion));
    let weighted = scale(edge).component_mul(&raw);
    // Cauchy's weight, shared by residual and derivative.
    let weight = (1.0 + weighted.norm_squared() / (ROBUST_SIGMAS * ROBUST_SIGMAS)).sqrt().recip();
    let rows = na::Matrix6::from_diagonal(&(scale(edge) * weight));
    let by_to = rows * se3::inverse_right_jacobian(&raw);
    let by_from = -by_to * se3::adjoint(&motion.inverse());
    Linear { from: edge.from, to: edge.to, by_from, by_to, error: weighted * weight }
}

/// Solves (J^T J) x = -J^T r for all poses but the first by conjugate gradients with a block-diagonal preconditioner.
fn solve(edges: &[Linear], poses: usize) -> Vec<Twist> {
    let mut diagonal = vec![na::Matrix6::identity() * 1e-9; poses];
    let mut residual = vec![Twist::zeros(); poses];
    for e in edges {
        diagonal[e.from] += e.by_from.transpose() * e.by_from;
        diagonal[e.to] += e.by_to.transpose() * e.by_to;
        residual[e.from] -= e.by_from.transpose() * e.error;
        residual[e.to] -= e.by_to.transpose() * e.error;
    }
    let inverse: Vec<na::Matrix6<f64>> = diagonal.iter().map(|m| m.try_inverse().unwrap_or_default()).collect();
    let hold_first = |v: &mut Vec<Twist>| {
        if let Some(first) = v.first_mut() {
            first.fill(0.0);
        }
    };
    let multiply = |x: &[Twist]| {
        let mut product = vec![Twist::zeros(); poses];
        for e in edges {
            let along = e.by_from * x[e.from] + e.by_to * x[e.to];
            product[e.from] += e.by_from.transpose() * along;
            product[e.to] += e.by_to.transpose() * along;
        }
        hold_first(&mut product);
        product
    };
    let precondition = |r: &[Twist]| -> Vec<Twist> { r.iter().zip(&inverse).map(|(r, m)| m * r).collect() };
    let dot = |a: &[Twist], b: &[Twist]| a.iter().zip(b).map(|(a, b)| a.dot(b)).sum::<f64>();
    hold_first(&mut residual);
    let mut x = vec![Twist::zeros(); poses];
    let mut z = precondition(&residual);
    let mut direction = z.clone();
    let mut size = dot(&residual, &z);
    let goal = 1e-16 * size;
    for _ in 0..INNER_STEPS {
        if size <= goal || size == 0.0 {
            break;
        }
        let product = multiply(&direction);
        let length = size / dot(&direction, &product);
        for i in 0..poses {
            x[i] += length * direction[i];
            residual[i] -= length * product[i];
        }
        z = precondition(&residual);
        let next = dot(&residual, &z);
        for i in 0..poses {
            direction[i] = z[i] + (next / size) * direction[i];
        }
        size = next;
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A turn in the hand: a pose every 12 degrees, 35 of them, so that the last five see the same sides as the first.
    fn turn() -> Vec<na::Isometry3<f64>> {
        (0..35)
            .map(|k| {
                let angle = 12f64.to_radians() * f64::from(k);
                se3::exp(&Twist::new(0.002 * angle.sin(), 0.0, 0.001 * angle, 0.0, 0.1 * angle.sin(), angle))
            })
            .collect()
    }

    fn edge(poses: &[na::Isometry3<f64>], from: usize, to: usize) -> Edge {
        Edge { from, to, motion: poses[from].inverse() * poses[to], sigma: [0.0005, 0.005] }
    }

    #[test]
    fn loops_undo_drift() {
        let truth = turn();
        // Along and about the axis: what drifts across it comes back on its own within a turn.
        let drift = se3::exp(&Twist::new(0.0, 0.0, 0.0003, 0.0, 0.0, 0.004));
        let mut edges = Vec::new();
        let mut poses = vec![truth[0]];
        for k in 1..truth.len() {
            let motion = truth[k - 1].inverse() * truth[k] * drift;
            edges.push(Edge { from: k - 1, to: k, motion, sigma: [0.0005, 0.005] });
            poses.push(poses[k - 1] * motion);
        }
        let error = |poses: &[na::Isometry3<f64>]| {
            let worst =
                |(a, b): (&na::Isometry3<f64>, &na::Isometry3<f64>)| (a.inverse() * b).translation.vector.norm();
            poses.iter().zip(&truth).map(worst).fold(0.0, f64::max)
        };
        let drifted = error(&poses);
        edges.extend((30..35).map(|k| edge(&truth, k - 30, k)));
        let [before, after] = optimise(&mut poses, &edges);
        assert!(after < 0.2 * before, "{before} {after}");
        assert!(error(&poses) < 0.4 * drifted, "{} of {drifted}", error(&poses));
    }

    #[test]
    fn exact_edges_are_met_from_a_bad_start() {
        let truth = turn();
        let edges: Vec<_> = (1..35).map(|k| edge(&truth, k - 1, k)).chain([edge(&truth, 0, 30)]).collect();
        let mut poses = truth.clone();
        for (k, pose) in poses.iter_mut().enumerate().skip(1) {
            *pose *= se3::exp(&Twist::new(0.004, 0.0, -0.003, 0.05, -0.04, 0.03 * (k % 3) as f64));
        }
        optimise(&mut poses, &edges);
        for (pose, truth) in poses.iter().zip(&truth) {
            assert!(se3::log(&(pose.inverse() * truth)).norm() < 1e-5);
        }
    }

    #[test]
    fn a_wrong_loop_does_not_bend_the_graph() {
        let truth = turn();
        let mut edges: Vec<_> =
            (1..35).map(|k| edge(&truth, k - 1, k)).chain([edge(&truth, 0, 30), edge(&truth, 4, 34)]).collect();
        edges.push(Edge { motion: edges[3].motion, ..edge(&truth, 2, 20) });
        edges.push(Edge { from: 1, to: 99, ..edges[0] });
        let mut poses = truth.clone();
        optimise(&mut poses, &edges);
        let worst =
            poses.iter().zip(&truth).map(|(a, b)| (a.inverse() * b).translation.vector.norm()).fold(0.0, f64::max);
        assert!(worst < 0.002, "{worst}");
    }

    #[test]
    fn nothing_to_do() {
        assert_eq!(optimise(&mut [], &[]), [0.0, 0.0]);
        let mut one = [se3::exp(&Twist::repeat(0.1))];
        optimise(&mut one, &[]);
    }
}
