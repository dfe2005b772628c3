//! Distances from every point of one cloud to the nearest point of another.
//!
//! A score needs thousands of nearest neighbours at once, and neighbouring points have neighbouring answers. So whole leaves of one
//! tree are looked up in the other, and the boxes of the nodes are tight, because surfaces are flat. This takes a third to a twentieth of
//! the time of a k-d tree that is searched point by point, least where the clouds are far apart.

use glam::{Mat3A, Vec3, Vec3A};
use pulp::Arch;

/// Number of points in a leaf, and of lanes in the inner loop.
const LANES: usize = 16;

/// Points in a balanced tree of boxes.
#[derive(Debug)]
pub(super) struct Cloud {
    points: Vec<Vec3>,
    /// Their number is a power of two, or 0 without points.
    leaves: Vec<Leaf>,
    /// Boxes of the nodes in heap order: the children of node k are 2k + 1 and 2k + 2, and the leaves come last.
    boxes: Vec<Aabb>,
}

/// Up to 16 neighbouring points.
#[derive(Debug, Clone, Copy)]
struct Leaf {
    /// Coordinates by axis. Lanes beyond `len` repeat a point.
    lanes: [[f32; LANES]; 3],
    len: usize,
}

/// Box along the axes.
#[derive(Debug, Clone, Copy)]
struct Aabb {
    low: Vec3,
    high: Vec3,
}

impl Aabb {
    fn of(points: &[Vec3]) -> Self {
        let empty = Self { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY };
        points.iter().fold(empty, |b, &p| Self { low: b.low.min(p), high: b.high.max(p) })
    }

    /// Returns the squared distance of the closest points of two boxes.
    fn squared_gap(self, other: Self) -> f32 {
        (self.low - other.high).max(other.low - self.high).max(Vec3::ZERO).length_squared()
    }
}

impl Cloud {
    /// Builds a tree of finite points and changes their order.
    pub(super) fn new(mut points: Vec<Vec3>) -> Self {
        if points.is_empty() {
            return Self { points, leaves: Vec::new(), boxes: Vec::new() };
        }
        let leaf_count = points.len().div_ceil(LANES).next_power_of_two();
        let mut boxes = vec![Aabb::of(&points); 2 * leaf_count - 1];
        let mut leaves = Vec::with_capacity(leaf_count);
        split(&mut points, 0, &mut boxes, &mut leaves);
        Self { points, leaves, boxes }
    }

    /// Returns the points. Neighbours stand close to one another.
    pub(super) fn points(&self) -> &[Vec3] {
        &self.points
    }

    /// Returns the distance of every point, after a finite motion, to the nearest point of the other cloud, in the order of `points`.
    /// Distances are infinite if the other cloud is empty.
    pub(super) fn distances(&self, motion: (Mat3A, Vec3A), to: &Self) -> Vec<f32> {
        // Compiled for the machine's own vectors; a closure that is not inlined would not be. The distances are the same.
        Arch::new().dispatch(
            #[inline(always)]
            || self.distances_by_leaf(motion, to),
        )
    }

    #[inline(always)]
    fn distances_by_leaf(&self, (rotation, translation): (Mat3A, Vec3A), to: &Self) -> Vec<f32> {
        let mut distances = Vec::with_capacity(self.points.len());
        let mut pending = Vec::new();
        for leaf in &self.leaves {
            let mut moved = leaf.lanes;
            for lane in 0..LANES {
                let p = rotation * Vec3A::from(leaf.lanes.map(|axis| axis[lane])) + translation;
                for (axis, coordinate) in moved.iter_mut().zip(p.to_array()) {
                    axis[lane] = coordinate;
                }
            }
            let squared = to.nearest_squared(&moved, &mut pending);
            distances.extend(squared[..leaf.len].iter().map(|d| d.sqrt()));
        }
        distances
    }

    /// Returns the squared distances of the points of a leaf to the nearest points of this cloud.
    #[inline(always)]
    fn nearest_squared(&self, query: &[[f32; LANES]; 3], pending: &mut Vec<(f32, usize)>) -> [f32; LANES] {
        let mut best = [f32::INFINITY; LANES];
        let Some(&root) = self.boxes.first() else { return best };
        let corner = |pick: fn(f32, f32) -> f32| {
            let [x, y, z] = query.map(|axis| axis.into_iter().reduce(pick).unwrap_or(0.0));
            Vec3::new(x, y, z)
        };
        let bounds = Aabb { low: corner(f32::min), high: corner(f32::max) };
        let mut worst = f32::INFINITY;
        let first_leaf = self.boxes.len() - self.leaves.len();
        pending.push((root.squared_gap(bounds), 0));
        while let Some((gap, node)) = pending.pop() {
            if gap > worst {
                continue;
            }
            if node >= first_leaf {
                improve(query, &self.leaves[node - first_leaf].lanes, &mut best);
                worst = best.into_iter().fold(0.0, f32::max);
                continue;
            }
            let [near, far] = [2 * node + 1, 2 * node + 2].map(|child| (self.boxes[child].squared_gap(bounds), child));
            let (near, far) = if near.0 <= far.0 { (near, far) } else { (far, near) };
            pending.extend([far, near]);
        }
        best
    }
}

/// Halves the points along the longest side of their box until they fit into leaves.
fn split(points: &mut [Vec3], node: usize, boxes: &mut [Aabb], leaves: &mut Vec<Leaf>) {
    let bounds = Aabb::of(points);
    boxes[node] = bounds;
    if 2 * node + 1 >= boxes.len() {
        let lane = |axis: usize, k: usize| points[k.min(points.len() - 1)][axis];
        let lanes = std::array::from_fn(|axis| std::array::from_fn(|k| lane(axis, k)));
        leaves.push(Leaf { lanes, len: points.len() });
        return;
    }
    let axis = (bounds.high - bounds.low).max_position();
    let middle = points.len() / 2;
    points.select_nth_unstable_by(middle, |p, q| p[axis].total_cmp(&q[axis]));
    let (low, high) = points.split_at_mut(middle);
    split(low, 2 * node + 1, boxes, leaves);
    split(high, 2 * node + 2, boxes, leaves);
}

/// Lowers the best squared distances by those to the points of a leaf. The inner loop runs over the query points, so that it needs no
/// sum across lanes.
#[inline(always)]
fn improve(query: &[[f32; LANES]; 3], leaf: &[[f32; LANES]; 3], best: &mut [f32; LANES]) {
    for k in 0..LANES {
        let [x, y, z] = [leaf[0][k], leaf[1][k], leaf[2][k]];
        for lane in 0..LANES {
            let (dx, dy, dz) = (query[0][lane] - x, query[1][lane] - y, query[2][lane] - z);
            let squared = dx * dx + dy * dy + dz * dz;
            // Not f32::min, whose rule for NaN costs a third of the loop.
            best[lane] = if squared < best[lane] { squared } else { best[lane] };
        }
    }
}
