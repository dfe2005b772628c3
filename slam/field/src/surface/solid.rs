//! Shapes as they look from outside.

use glam::{IVec3, Vec3};

use crate::exact::KnownShape;
use crate::shape::{Distance, Shape};

/// Distance between the nodes of the lattice that decides about inside and outside, metres: about that of the map's cells. More in
/// a cube that would take more than [`MOST_STEPS`] of them.
const STEP_M: f32 = 0.0025;
/// Most steps along an edge of the cube: with two million nodes a mesh is still made in half a second.
const MOST_STEPS: f32 = 128.0;
/// Radius of the ball that must fit through an opening, in steps: 3 mm. The hollows that noise and drift leave below a surface that
/// was seen are connected with the outside through pits a few cells wide.
const BALL_STEPS: f32 = 1.2;
/// How far from every place of the ball's centre space counts as filled, in steps. The ball's radius, and as much again: where the
/// ball can be is known to a step, and shallow hollows shall stay as they are.
const FILL_STEPS: f32 = 2.0 * BALL_STEPS;

/// A shape with everything filled that a ball 6 mm wide cannot reach from outside: its morphological closing, but for the outermost
/// 3 mm of narrow gaps.
pub struct Solid<'a> {
    shape: &'a dyn Shape,
    /// Negative where it is filled.
    reached: KnownShape,
}

impl<'a> Solid<'a> {
    /// `shape`, of which nothing outside a cube matters that reaches `half_extent_m` from the origin. Outside is whatever is
    /// connected with the faces of the cube.
    pub fn new(shape: &'a dyn Shape, half_extent_m: f32) -> Self {
        let step_m = STEP_M.max(2.0 * half_extent_m / MOST_STEPS);
        // A NaN is one step.
        let lattice = Lattice { nodes: (2.0 * half_extent_m / step_m).ceil().max(1.0) as usize + 1 };
        let lowest = Vec3::splat(-half_extent_m);
        let points: Vec<Vec3> = (0..lattice.len()).map(|i| lowest + step_m * lattice.at(i).as_vec3()).collect();
        let mut distances = vec![0.0; points.len()];
        shape.distances(&points, &mut distances);
        let inside: Vec<bool> = distances.iter().map(|distance| *distance < 0.0).collect();
        let to_inside = lattice.distances(&inside, BALL_STEPS);
        let fits: Vec<bool> = to_inside.iter().map(|steps| *steps >= BALL_STEPS).collect();
        // One step more, so that the value changes its sign between nodes.
        let to_ball = lattice.distances(&lattice.flood(&fits), FILL_STEPS + 1.0);
        let value = |at: [usize; 3]| step_m * (FILL_STEPS - to_ball[lattice.index(at.map(|n| n as i32).into())]);
        Self { shape, reached: KnownShape::of_nodes(lowest, step_m, [lattice.nodes; 3], value) }
    }
}

impl Shape for Solid<'_> {
    fn distances(&self, points: &[Vec3], out: &mut [f32]) {
        let mut reached = vec![0.0; points.len()];
        self.reached.distances(points, &mut reached);
        self.shape.distances(points, out);
        out.iter_mut().zip(reached).for_each(|(out, reached)| *out = out.min(reached));
    }

    fn distances_and_gradients(&self, points: &[Vec3], out: &mut [Distance]) {
        let mut reached = vec![Distance::default(); points.len()];
        self.reached.distances_and_gradients(points, &mut reached);
        self.shape.distances_and_gradients(points, out);
        for (out, reached) in out.iter_mut().zip(reached) {
            if reached.value_m < out.value_m {
                *out = reached;
            }
        }
    }
}

/// A cubic lattice with as many nodes along each axis, x fastest.
struct Lattice {
    nodes: usize,
}

impl Lattice {
    fn len(&self) -> usize {
        self.nodes.pow(3)
    }

    fn at(&self, i: usize) -> IVec3 {
        IVec3::from([1, self.nodes, self.nodes.pow(2)].map(|stride| (i / stride % self.nodes) as i32))
    }

    fn is_within(&self, at: IVec3) -> bool {
        at.min_element() >= 0 && at.max_element() < self.nodes as i32
    }

    fn index(&self, at: IVec3) -> usize {
        let n = self.nodes as i32;
        (at.x + n * (at.y + n * at.z)) as usize
    }

    /// Those along the axes; `None` where the lattice ends.
    fn neighbours(&self, i: usize) -> [Option<usize>; 6] {
        let at = self.at(i);
        let beside = |axis: usize, stride: usize| {
            let lower = (at[axis] > 0).then(|| i - stride);
            [lower, (at[axis] + 1 < self.nodes as i32).then_some(i + stride)]
        };
        let [[a, b], [c, d], [e, f]] = [beside(0, 1), beside(1, self.nodes), beside(2, self.nodes.pow(2))];
        [a, b, c, d, e, f]
    }

    /// The nodes that are `free` and connected with the faces of the lattice through such.
    fn flood(&self, free: &[bool]) -> Vec<bool> {
        let mut reached = vec![false; self.len()];
        let mut queue: Vec<usize> =
            (0..self.len()).filter(|&i| free[i] && self.neighbours(i).contains(&None)).collect();
        while let Some(i) = queue.pop() {
            if !std::mem::replace(&mut reached[i], true) {
                queue.extend(self.neighbours(i).into_iter().flatten().filter(|&j| free[j] && !reached[j]));
            }
        }
        reached
    }

    /// Distance of each node to the nearest of `set`, in steps, at most `limit`.
    fn distances(&self, set: &[bool], limit: f32) -> Vec<f32> {
        let mut distances: Vec<f32> = set.iter().map(|&member| if member { 0.0 } else { limit }).collect();
        let reach = limit.ceil() as i32;
        let range = move || -reach..=reach;
        let ball: Vec<(IVec3, f32)> = range()
            .flat_map(|z| range().flat_map(move |y| range().map(move |x| IVec3::new(x, y, z))))
            .map(|offset| (offset, offset.as_vec3().length()))
            .filter(|(_, distance)| *distance < limit)
            .collect();
        // Only members at the rim are the nearest of anything.
        for i in (0..self.len()).filter(|&i| set[i] && !self.neighbours(i).into_iter().flatten().all(|j| set[j])) {
            let at = self.at(i);
            let is_inner = at.min_element() >= reach && at.max_element() + reach < self.nodes as i32;
            for &(offset, distance) in &ball {
                let there = at + offset;
                if is_inner || self.is_within(there) {
                    let j = self.index(there);
                    distances[j] = distances[j].min(distance);
                }
            }
        }
        distances
    }
}
