//! Knowledge of the space around an object: where surface was measured, where sensors looked through, and the rest.

mod frontier;
mod walls;

use glam::{UVec3, Vec3};
use mvt_frames::Occupied;
use nalgebra::{Matrix4, Vector4};
use pulp::Arch;

use crate::scan::View;
pub use frontier::FrontierPatch;

/// Cells along an edge of the box: 2.3 mm each in a box of 15 cm, a little coarser than the field.
const CELLS: u32 = 64;
/// Measured points in a cell before its surface counts as seen. One may be a displaced pixel.
const SEEN: u8 = 3;
/// Rays through a cell before it counts as empty.
const EMPTY: u8 = 3;
/// A ray is taken for free up to this far before its end, metres: noise, drift and half a cell.
const MARGIN_M: f32 = 0.004;
/// How far below the hand's surface a point must be to count as not the object's, metres: gels and drift give way.
const HAND_DEPTH_M: f32 = 0.002;
/// Unseen space counts as the inside of the object up to this far around the hull of the seen surface, metres: cameras see to three
/// pixels before the hand, 2 mm at 0.35 m, and the object continues to where it lies on the hand. More grows slabs on hidden sides.
const HULL_MARGIN_M: f32 = 0.002;

/// Space that was looked through this far below the hull of the seen surface is a cavity, metres. Drift and noise reach half as deep.
const CAVITY_DEPTH_M: f32 = 0.008;
/// A cavity continues this far into unseen cells, metres: half the width of a cup.
const CAVITY_REACH_M: f32 = 0.03;
/// Cells that were looked through, so that a cavity counts: a cube of a centimetre.
const LEAST_CAVITY: usize = 64;

/// A cell that no sensor has seen, within the hull of the seen points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unseen {
    /// Its centre.
    pub centre: Vec3,
    /// How far below the hull of the seen points it lies, metres; negative little outside.
    pub depth_m: f32,
    /// The guess about it.
    pub assumed: Assumed,
}

/// Guess about an unseen cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Assumed {
    /// The inside of a solid object.
    Inside,
    /// The wall that closes an object with thin walls, such as the foot of a cup.
    Wall,
    /// The air in an object with thin walls.
    Air,
}

impl Assumed {
    /// Whether it belongs to the object.
    pub fn is_object(self) -> bool {
        self != Self::Air
    }
}

/// Counts per cell of a cube around the origin of the model's frame.
#[derive(Debug, Clone)]
pub struct Space {
    half_extent_m: f32,
    hits: Vec<u8>,
    passes: Vec<u8>,
    /// Whether surface was seen in the cell or beside it.
    near_surface: Vec<bool>,
    /// How far the seen surface reaches along each direction of [`directions`], metres.
    support_m: Vec<f32>,
    directions: Vec<Vec3>,
}

impl Space {
    /// Nothing is known of a cube that reaches `half_extent_m` from the origin.
    pub fn new(half_extent_m: f32) -> Self {
        let count = (CELLS * CELLS * CELLS) as usize;
        let directions = directions();
        Self {
            half_extent_m,
            hits: vec![0; count],
            passes: vec![0; count],
            near_surface: vec![false; count],
            support_m: vec![f32::NEG_INFINITY; directions.len()],
            directions,
        }
    }

    fn cell_m(&self) -> f32 {
        2.0 * self.half_extent_m / CELLS as f32
    }

    fn cell(&self, p: Vec3) -> Option<UVec3> {
        let at = (p + self.half_extent_m) / self.cell_m();
        (at.min_element() >= 0.0 && at.max_element() < CELLS as f32).then(|| at.as_uvec3())
    }

    fn index(&self, p: Vec3) -> Option<usize> {
        self.cell(p).map(flatten)
    }

    /// Takes in the rays of a sensor. `to_model` takes points of the world to the model's frame.
    pub fn add(&mut self, view: &View, to_model: impl Fn(Vec3) -> Vec3) {
        let origin = to_model(view.origin);
        for hit in &view.hits {
            let end = to_model(view.point(hit));
            self.add_hit(end);
            self.pass(origin, end, MARGIN_M / hit.cosine);
        }
        for miss in &view.misses {
            self.pass(origin, to_model(view.origin + miss.direction * miss.free_m), MARGIN_M);
        }
    }

    /// Takes in points inside the hand, in the model's frame.
    pub fn add_occupied(&mut self, occupied: impl Iterator<Item = Occupied>) {
        for Occupied { point, depth_m } in occupied {
            if depth_m > HAND_DEPTH_M
                && let Some(i) = self.index(point)
            {
                self.passes[i] = self.passes[i].saturating_add(1);
            }
        }
    }

    fn add_hit(&mut self, p: Vec3) {
        let Some(cell) = self.cell(p) else { return };
        let hits = &mut self.hits[flatten(cell)];
        *hits = hits.saturating_add(1);
        if *hits != SEEN {
            return;
        }
        let (low, high) = (cell.max(UVec3::ONE) - 1, (cell + 1).min(UVec3::splat(CELLS - 1)));
        for z in low.z..=high.z {
            for y in low.y..=high.y {
                for x in low.x..=high.x {
                    self.near_surface[flatten(UVec3::new(x, y, z))] = true;
                }
            }
        }
        for (support, direction) in self.support_m.iter_mut().zip(&self.directions) {
            *support = support.max(direction.dot(p));
        }
    }

    /// Counts a ray through the cells from `from` to `margin_m` before `to`.
    fn pass(&mut self, from: Vec3, to: Vec3, margin_m: f32) {
        let length = (to - from).length();
        let direction = (to - from) / length;
        let Some((enter, leave)) = clip(from, direction, self.half_extent_m) else { return };
        let (start, end) = (enter.max(0.0), leave.min(length - margin_m));
        let step = self.cell_m();
        let mut last = usize::MAX;
        let mut t = start + 0.5 * step;
        while t < end {
            if let Some(i) = self.index(from + direction * t)
                && i != last
            {
                self.passes[i] = self.passes[i].saturating_add(1);
                last = i;
            }
            t += step;
        }
    }

    /// Whether a point was looked through, and no surface was seen near it.
    pub fn is_seen_empty(&self, p: Vec3) -> bool {
        self.index(p).is_some_and(|i| self.is_open_at(i))
    }

    fn is_open_at(&self, i: usize) -> bool {
        self.passes[i] >= EMPTY && self.hits[i] == 0 && !self.near_surface[i]
    }

    /// Whether surface was seen at or beside a point.
    pub fn is_near_surface(&self, p: Vec3) -> bool {
        self.index(p).is_some_and(|i| self.near_surface[i])
    }

    /// The cells near which no surface was seen, through which no ray passed, and which lie within the hull of the seen surface, with a guess
    /// about each: the inside, unless the object is hollow. Nothing is assumed of cells that continue a cavity of an object that may be solid.
    pub fn unseen(&self) -> Vec<Unseen> {
        // Why: notes/decisions/estimation.md, "Unseen space is taught".
        let depths_m = self.depths_m();
        let seen_cavity = self.seen_cavity(&depths_m);
        let is_hollow = seen_cavity.len() >= LEAST_CAVITY;
        let is_thin_walled = is_hollow && self.is_thin_walled(&seen_cavity);
        let cavity = if is_hollow && !is_thin_walled { self.continued(seen_cavity) } else { Vec::new() };
        let mut unseen = Vec::new();
        for cell in cells() {
            let i = flatten(cell);
            if self.near_surface[i] || self.passes[i] >= EMPTY || cavity.get(i) == Some(&true) {
                continue;
            }
            let depth_m = depths_m[i];
            if depth_m > -HULL_MARGIN_M {
                let centre = self.centre(cell);
                let assumed = match is_thin_walled {
                    false => Assumed::Inside,
                    true if self.closes_a_wall(centre) => Assumed::Wall,
                    true => Assumed::Air,
                };
                unseen.push(Unseen { centre, depth_m, assumed });
            }
        }
        unseen
    }

    /// Whether each cell is unseen and continues the cells that sensors looked into, `front`: where a cavity that is seen in part ends is not known.
    fn continued(&self, mut front: Vec<UVec3>) -> Vec<bool> {
        let is_unknown = |i: usize| !self.near_surface[i] && self.passes[i] < EMPTY;
        let mut cavity = vec![false; self.passes.len()];
        for _ in 0..(CAVITY_REACH_M / self.cell_m()) as usize {
            let mut next = Vec::new();
            for cell in front {
                for neighbour in neighbours(cell) {
                    let i = flatten(neighbour);
                    if is_unknown(i) && !cavity[i] {
                        cavity[i] = true;
                        next.push(neighbour);
                    }
                }
            }
            front = next;
        }
        cavity
    }

    /// The middle of a cell.
    fn centre(&self, cell: UVec3) -> Vec3 {
        (cell.as_vec3() + 0.5) * self.cell_m() - self.half_extent_m
    }

    /// Whether a point lies within the hull of the seen points or little outside it.
    pub fn is_within_hull(&self, p: Vec3) -> bool {
        self.depth_m(p).is_some()
    }

    /// How far a point lies below the hull of the seen points, metres; `None` if more than little outside it.
    fn depth_m(&self, p: Vec3) -> Option<f32> {
        let mut sides = self.directions.iter().zip(&self.support_m).map(|(d, support)| support - d.dot(p));
        sides.try_fold(f32::INFINITY, |least, depth_m| (depth_m > -HULL_MARGIN_M).then(|| least.min(depth_m)))
    }

    /// How far each cell lies below the hull of the seen points, as [`Self::depth_m`], metres; below -[`HULL_MARGIN_M`] more than little outside it.
    fn depths_m(&self) -> Vec<f32> {
        let mut depths_m = vec![f32::NEG_INFINITY; self.passes.len()];
        let coordinate = |at: u32| (at as f32 + 0.5) * self.cell_m() - self.half_extent_m;
        let xs: [f32; CELLS as usize] = std::array::from_fn(|x| coordinate(x as u32));
        // Compiled for the machine's own vectors; a closure that is not inlined would not be. The depths are the same.
        Arch::new().dispatch(
            #[inline(always)]
            || {
                for (row, depths_m) in depths_m.as_chunks_mut().0.iter_mut().enumerate() {
                    let (y, z) = (coordinate(row as u32 % CELLS), coordinate(row as u32 / CELLS));
                    self.row_depths_m(&xs, [y, z], depths_m);
                }
            },
        );
        depths_m
    }

    /// Writes the depths of a row of cells along x.
    #[inline(always)]
    fn row_depths_m(&self, xs: &[f32; CELLS as usize], [y, z]: [f32; 2], depths_m: &mut [f32; CELLS as usize]) {
        depths_m.fill(f32::INFINITY);
        for (outwards, support_m) in self.directions.iter().zip(&self.support_m) {
            let [along_y, along_z] = [outwards.y * y, outwards.z * z];
            for (depth_m, x) in depths_m.iter_mut().zip(xs) {
                let below_m = support_m - (outwards.x * x + along_y + along_z);
                *depth_m = if below_m < *depth_m { below_m } else { *depth_m };
            }
            // The axes come first: most rows pass beside the object.
            if depths_m.iter().all(|depth_m| *depth_m <= -HULL_MARGIN_M) {
                return;
            }
        }
    }

    /// Edge of a cell, metres.
    pub fn resolution_m(&self) -> f32 {
        self.cell_m()
    }

    /// Lowest and highest corner of the seen points, metres; `None` without any.
    pub fn bounds(&self) -> Option<[Vec3; 2]> {
        let s = &self.support_m;
        let known = s.iter().all(|x| x.is_finite());
        known.then(|| [-Vec3::new(s[1], s[3], s[5]), Vec3::new(s[0], s[2], s[4])])
    }

    /// Middle of the ball that fits best to the seen surface, metres; `None` if no ball fits. Unlike the middle of
    /// [`Space::bounds`] it does not move when the far side of a round object comes into view.
    pub fn ball_middle(&self) -> Option<Vec3> {
        // Why: notes/decisions/simulation.md, "The middle of an unknown object in the air is that of the ball that fits its seen surface".
        // Least squares of |x|^2 = 2 c x + k over the cells, with coordinates relative to a point among them.
        let origin = self.bounds().map(|[low, high]| 0.5 * (low + high))?;
        let (mut normal, mut right) = (Matrix4::<f64>::zeros(), Vector4::<f64>::zeros());
        for cell in cells().filter(|cell| self.hits[flatten(*cell)] >= SEEN) {
            let middle = (cell.as_vec3() + 0.5) * self.cell_m() - self.half_extent_m;
            let x = (middle - origin).as_dvec3();
            let row = Vector4::new(2.0 * x.x, 2.0 * x.y, 2.0 * x.z, 1.0);
            normal += row * row.transpose();
            right += row * x.length_squared();
        }
        let solved = normal.cholesky()?.solve(&right);
        let middle = Vec3::new(solved[0] as f32, solved[1] as f32, solved[2] as f32);
        (middle.is_finite() && middle.length() < self.half_extent_m).then_some(origin + middle)
    }

    /// Part of the directions around the middle of the seen points in which no surface was seen.
    pub fn unseen_fraction(&self) -> f64 {
        let Some([low, high]) = self.bounds() else { return 1.0 };
        let middle = 0.5 * (low + high);
        let seen = self.directions.iter().filter(|direction| {
            (4..CELLS).any(|k| self.is_near_surface(middle + **direction * (k as f32 * 0.5 * self.cell_m())))
        });
        1.0 - seen.count() as f64 / self.directions.len() as f64
    }
}

/// All cells.
fn cells() -> impl Iterator<Item = UVec3> {
    (0..CELLS).flat_map(|z| (0..CELLS).flat_map(move |y| (0..CELLS).map(move |x| UVec3::new(x, y, z))))
}

/// The cells that share a face with a cell.
fn neighbours(cell: UVec3) -> impl Iterator<Item = UVec3> {
    (0..6).filter_map(move |side| neighbour(cell, side))
}

/// The cell beside a cell: at its lower and upper side along x, y and z.
fn neighbour(cell: UVec3, side: usize) -> Option<UVec3> {
    let mut neighbour = cell;
    let along = &mut neighbour[side / 2];
    *along = if side.is_multiple_of(2) { along.checked_sub(1)? } else { *along + 1 };
    (*along < CELLS).then_some(neighbour)
}

fn flatten(cell: UVec3) -> usize {
    (cell.x + CELLS * (cell.y + CELLS * cell.z)) as usize
}

/// Where a ray enters and leaves a cube around the origin that reaches `half` from it: distances along the ray in units of
/// `direction`, the first negative if it starts inside. None if it misses the cube.
pub fn clip(origin: Vec3, direction: Vec3, half: f32) -> Option<(f32, f32)> {
    let inverse = direction.recip();
    let (a, b) = ((Vec3::splat(-half) - origin) * inverse, (Vec3::splat(half) - origin) * inverse);
    let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
    (enter < leave && leave > 0.0).then_some((enter, leave))
}

/// The axes, then directions spread evenly over the sphere.
fn directions() -> Vec<Vec3> {
    const COUNT: usize = 60;
    let axes = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
    let even = (0..COUNT).map(|i| {
        let z = 1.0 - (2 * i + 1) as f32 / COUNT as f32;
        let (sin, cos) = (2.399_963 * i as f32).sin_cos();
        Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
    });
    axes.into_iter().chain(even).collect()
}

#[cfg(test)]
mod tests;
