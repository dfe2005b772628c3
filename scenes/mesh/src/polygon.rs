//! Triangles of polygons.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::{DVec2, DVec3, Vec3};

use crate::error::Defect;

/// Number of corners of the largest polygon without a fan that is accepted: its triangles take about a second.
const MAX_CORNERS: usize = 20_000;

/// Appends the triangles of a polygon to `faces`. They use every corner, so that neighbours still share whole edges.
///
/// Corners may lie on one line, and the polygon may be concave, touch itself (as at a bridge to a hole), or be not quite flat. Polygons
/// without a plane, such as those that name vertices that do not exist, become fans.
pub(crate) fn triangulate(vertices: &[Vec3], polygon: &[u32], faces: &mut Vec<[u32; 3]>) -> Result<(), Defect> {
    if let &[a, b, c] = polygon {
        faces.push([a, b, c]);
        return Ok(());
    }
    let fan = |corners: &[u32], faces: &mut Vec<[u32; 3]>| {
        if let [first, others @ ..] = corners {
            faces.extend(others.windows(2).map(|edge| [*first, edge[0], edge[1]]));
        }
    };
    let Some((corners, outline)) = Outline::of(vertices, polygon) else {
        fan(polygon, faces);
        return Ok(());
    };
    let is_large = corners.len() > MAX_CORNERS;
    // Rounding dents round outlines with very many corners.
    if outline.is_fan(if is_large { outline.flat } else { 0.0 }) {
        fan(&corners, faces);
        return Ok(());
    }
    if is_large {
        let count = corners.len();
        return Err(Defect::Syntax(format!(
            "a concave face has {count} corners, the limit is {MAX_CORNERS}; export triangles"
        )));
    }
    faces.extend(outline.ears().into_iter().map(|triangle| triangle.map(|i| corners[i])));
    Ok(())
}

/// Polygon in its plane, counter-clockwise.
struct Outline {
    points: Vec<DVec2>,
    /// Distance below which a corner lies on a line.
    flat: f64,
}

/// Returns twice the area of a triangle, negative if it runs clockwise.
fn area(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b - a).perp_dot(c - a)
}

impl Outline {
    /// Puts a polygon into its plane (Newell's). Returns the corners without repetitions, too. `None` for polygons without area, and if a
    /// vertex does not exist or is not finite.
    fn of(vertices: &[Vec3], polygon: &[u32]) -> Option<(Vec<u32>, Self)> {
        let mut corners = Vec::with_capacity(polygon.len());
        let mut points: Vec<DVec3> = Vec::with_capacity(polygon.len());
        for &corner in polygon {
            let point = vertices.get(corner as usize).filter(|v| v.is_finite())?.as_dvec3();
            if points.last() != Some(&point) {
                corners.push(corner);
                points.push(point);
            }
        }
        while points.len() > 1 && points.first() == points.last() {
            corners.pop();
            points.pop();
        }
        let origin = *points.first()?;
        let next = points.iter().cycle().skip(1);
        let normal: DVec3 = points.iter().zip(next).map(|(a, b)| (a - origin).cross(b - origin)).sum();
        let normal = normal.try_normalize()?;
        let (x, y) = normal.any_orthonormal_pair();
        let reach = points.iter().fold(0.0, |reach: f64, p| reach.max(p.abs().max_element()));
        // The coordinates are rounded to f32.
        let flat = 4.0 * f64::from(f32::EPSILON) * reach;
        let points = points.iter().map(|p| DVec2::new((p - origin).dot(x), (p - origin).dot(y))).collect();
        Some((corners, Self { points, flat }))
    }

    /// Returns whether a triangle is counter-clockwise and no sliver.
    fn is_proper(&self, a: DVec2, b: DVec2, c: DVec2) -> bool {
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        area(a, b, c) > self.flat * longest
    }

    /// Returns whether the triangles from the first corner to all sides make up the polygon. They may be dented by so much.
    fn is_fan(&self, dent: f64) -> bool {
        let [first, others @ ..] = self.points.as_slice() else { return true };
        let reach = others.iter().fold(0.0, |reach: f64, p| reach.max(first.distance(*p)));
        others.windows(2).all(|edge| area(*first, edge[0], edge[1]) > -dent * reach)
    }

    /// Cuts off ears, those with the shortest cuts first.
    fn ears(&self) -> Vec<[usize; 3]> {
        let count = self.points.len();
        let mut ring = Ring {
            outline: self,
            cells: Cells::new(&self.points),
            before: (0..count).map(|i| (i + count - 1) % count).collect(),
            after: (0..count).map(|i| (i + 1) % count).collect(),
            is_left: vec![true; count],
        };
        let mut triangles = Vec::with_capacity(count.saturating_sub(2));
        let mut round: BinaryHeap<Reverse<Ear>> = BinaryHeap::new();
        let mut was_cut = true;
        while triangles.len() + 2 < count {
            let Some(Reverse(ear)) = round.pop() else {
                if !was_cut {
                    // The outline crosses itself, or it is thinner than the rounding errors.
                    break;
                }
                was_cut = false;
                round.extend(ring.left().map(|i| Reverse(ring.ear(i))));
                continue;
            };
            if !ring.is_left[ear.tip] || ring.ear(ear.tip) != ear || !ring.is_ear(ear.tip) {
                continue;
            }
            let triangle = ring.cut(ear.tip);
            round.extend([triangle[0], triangle[2]].map(|i| Reverse(ring.ear(i))));
            triangles.push(triangle);
            was_cut = true;
        }
        let first = ring.left().next().unwrap_or_default();
        while triangles.len() + 2 < count {
            triangles.push(ring.cut(ring.after[first]));
        }
        triangles
    }
}

/// Corner that may be cut off.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Ear {
    /// Squared length of the cut, in the order of its bits.
    cut: u64,
    tip: usize,
    before: usize,
    after: usize,
}

/// Corners of an outline that were not cut off.
struct Ring<'a> {
    outline: &'a Outline,
    cells: Cells,
    before: Vec<usize>,
    after: Vec<usize>,
    is_left: Vec<bool>,
}

impl Ring<'_> {
    fn left(&self) -> impl Iterator<Item = usize> {
        (0..self.is_left.len()).filter(|&i| self.is_left[i])
    }

    fn triangle(&self, tip: usize) -> [DVec2; 3] {
        [self.before[tip], tip, self.after[tip]].map(|i| self.outline.points[i])
    }

    fn ear(&self, tip: usize) -> Ear {
        let [a, _, c] = self.triangle(tip);
        Ear { cut: a.distance_squared(c).to_bits(), tip, before: self.before[tip], after: self.after[tip] }
    }

    /// Returns whether a corner is convex and no other corner lies in its triangle or on its cut. A copy of a corner of the triangle does
    /// not count, so outlines with bridges have ears.
    fn is_ear(&self, tip: usize) -> bool {
        let [a, b, c] = self.triangle(tip);
        let flat = self.outline.flat;
        let is_inside = |&i: &usize| {
            let p = self.outline.points[i];
            self.is_left[i]
                && area(a, b, p) > flat * a.distance(b)
                && area(b, c, p) > flat * b.distance(c)
                && area(c, a, p) >= -flat * c.distance(a)
        };
        self.outline.is_proper(a, b, c) && !self.cells.around([a, b, c]).any(|i| is_inside(&i))
    }

    fn cut(&mut self, tip: usize) -> [usize; 3] {
        let (before, after) = (self.before[tip], self.after[tip]);
        self.is_left[tip] = false;
        self.after[before] = after;
        self.before[after] = before;
        [before, tip, after]
    }
}

/// Points in the cells of a grid.
struct Cells {
    low: DVec2,
    per_length: DVec2,
    side: usize,
    points: Vec<Vec<usize>>,
}

impl Cells {
    fn new(points: &[DVec2]) -> Self {
        let low = points.iter().copied().fold(DVec2::INFINITY, DVec2::min);
        let high = points.iter().copied().fold(DVec2::NEG_INFINITY, DVec2::max);
        let side = points.len().isqrt().max(1);
        let per_length = (high - low).map(|length| if length > 0.0 { side as f64 / length } else { 0.0 });
        let mut cells = Self { low, per_length, side, points: vec![Vec::new(); side * side] };
        for (i, &p) in points.iter().enumerate() {
            let [x, y] = cells.cell(p);
            cells.points[y * side + x].push(i);
        }
        cells
    }

    fn cell(&self, p: DVec2) -> [usize; 2] {
        ((p - self.low) * self.per_length).to_array().map(|cell| (cell as usize).min(self.side - 1))
    }

    /// Returns the points in the cells around a triangle.
    fn around(&self, triangle: [DVec2; 3]) -> impl Iterator<Item = usize> {
        let [a, b, c] = triangle;
        let ([left, low], [right, high]) = (self.cell(a.min(b).min(c)), self.cell(a.max(b).max(c)));
        let rows = (low..=high).flat_map(move |y| &self.points[y * self.side + left..=y * self.side + right]);
        rows.flatten().copied()
    }
}
