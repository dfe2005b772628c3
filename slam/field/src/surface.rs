//! Surface of a shape as a triangle mesh.
//!
//! Dual marching cubes (Nielson 2004): one vertex for each sheet of the surface in a cell of a lattice, one quadrilateral for each
//! edge of the lattice that crosses the surface. Vertices start at the mean of their sheet's crossings and are moved
//! onto the surface along the gradient. The lattice is worked through from below, two layers of cells at a time, and evaluated
//! only near the surface, so that memory grows with the area of a layer and time with the area of the surface.

// Why: notes/decisions/estimation.md, "Dual marching cubes with Newton steps".

use glam::Vec3;
use mvt_mesh::Mesh;

use crate::shape::{Distance, Shape};

mod component;
mod patches;
mod solid;

use component::largest_component;
use patches::{Patches, corner, edge, ends};
use solid::Solid;

/// A block of two cells per axis is passed over if its corners are farther from the surface than half its diagonal, times this:
/// a shape whose gradient is longer than that may lose a piece of surface.
const STEEPEST: f32 = 1.25;
/// Newton steps that move a vertex onto the surface.
const STEPS: usize = 2;
/// Crossings stay this share of an edge away from its ends, so that quadrilaterals keep an area.
const MARGIN: f32 = 0.01;
/// Most cells per axis.
const MAX_CELLS: f32 = 4096.0;

/// The surface of `shape` as it looks from outside, in a cube that reaches `half_extent_m` from the origin, with cells of `cell_m` metres:
/// its largest connected part, without hollows that a ball 6 mm wide cannot get into. Faces are counter-clockwise seen from outside.
///
/// The mesh is closed where the surface does not leave the cube; the cube grows at its high sides to whole pairs of cells. Where two
/// sheets pass diagonally through one face of a cell and join on both sides of it, an edge may have four faces. The mesh is empty if
/// `half_extent_m` or `cell_m` is not positive, or if an axis would have more than 4096 cells.
pub fn outer_surface(shape: &dyn Shape, half_extent_m: f32, cell_m: f32) -> Mesh {
    let half = Vec3::splat(half_extent_m);
    largest_component(&extract(&Solid::new(shape, half_extent_m), [-half, half], cell_m))
}

/// All of the surface of `shape` inside the box `bounds_m` (low and high corner), else as [`outer_surface`].
fn extract(shape: &dyn Shape, bounds_m: [Vec3; 2], cell_m: f32) -> Mesh {
    let [low, high] = bounds_m;
    let cells = ((high - low) / cell_m).ceil();
    // Written so that NaN fails.
    if !(cell_m > 0.0 && cells.cmpge(Vec3::ONE).all() && cells.cmple(Vec3::splat(MAX_CELLS)).all()) {
        return Mesh::default();
    }
    let cells = cells.to_array().map(|count| (count as usize).next_multiple_of(2));
    let mut lattice = Lattice::new(shape, low, cell_m, cells);
    let mut sheets = Sheets::new(cells);
    for z in (0..cells[2]).step_by(2) {
        lattice.rise(z);
        for half in 0..2 {
            sheets.rise(&lattice, half);
        }
    }
    let Sheets { mut vertices, quads, .. } = sheets;
    project(shape, &mut vertices, 0.5 * cell_m);
    let faces = quads.iter().flat_map(|&quad| split(&vertices, quad)).collect();
    Mesh { vertices, faces }
}

/// Three planes of nodes, the faces of two layers of cells, with the distances that are needed.
struct Lattice<'a> {
    shape: &'a dyn Shape,
    low: Vec3,
    cell: f32,
    cells: [usize; 3],
    /// Height of the lowest plane.
    z: usize,
    /// Distances by y and x. Infinite where they are not needed.
    planes: [Vec<f32>; 3],
    /// Blocks of two by two by two cells near the surface: x and y of the first cell.
    near: Vec<[usize; 2]>,
    queue: Vec<(usize, usize)>,
    points: Vec<Vec3>,
    distances: Vec<f32>,
}

impl<'a> Lattice<'a> {
    fn new(shape: &'a dyn Shape, low: Vec3, cell: f32, cells: [usize; 3]) -> Self {
        let plane = vec![f32::INFINITY; (cells[0] + 1) * (cells[1] + 1)];
        Self {
            shape,
            low,
            cell,
            cells,
            z: 0,
            planes: [plane.clone(), plane.clone(), plane],
            near: Vec::new(),
            queue: Vec::new(),
            points: Vec::new(),
            distances: Vec::new(),
        }
    }

    fn node(&self, x: usize, y: usize) -> usize {
        x + (self.cells[0] + 1) * y
    }

    fn position(&self, x: usize, y: usize, z: usize) -> Vec3 {
        self.low + self.cell * Vec3::new(x as f32, y as f32, z as f32)
    }

    /// Moves to the two layers of cells from height `z` and finds the nodes near the surface there.
    fn rise(&mut self, z: usize) {
        self.z = z;
        self.planes.swap(0, 2);
        for plane in &mut self.planes[if z == 0 { 0 } else { 1 }..] {
            plane.fill(f32::INFINITY);
        }
        let [width, depth, _] = self.cells;
        for plane in if z == 0 { &[0, 2][..] } else { &[2] } {
            for y in (0..=depth).step_by(2) {
                for x in (0..=width).step_by(2) {
                    self.ask(*plane, x, y);
                }
            }
        }
        self.answer();

        self.near.clear();
        let reach = STEEPEST * 3.0f32.sqrt() * self.cell;
        for y in (0..depth).step_by(2) {
            for x in (0..width).step_by(2) {
                let values: [f32; 8] = std::array::from_fn(|c| {
                    let [dx, dy, dz] = corner(c);
                    self.planes[2 * dz][self.node(x + 2 * dx, y + 2 * dy)]
                });
                let inside = values.iter().filter(|&&value| value < 0.0).count();
                if (1..8).contains(&inside) || values.iter().any(|value| value.abs() <= reach) {
                    self.near.push([x, y]);
                }
            }
        }
        for k in 0..self.near.len() {
            let [x, y] = self.near[k];
            for (plane, dy, dx) in (0..27).map(|k| (k / 9, k / 3 % 3, k % 3)) {
                self.ask(plane, x + dx, y + dy);
            }
        }
        self.answer();
    }

    /// Puts a node in the queue unless its distance is known.
    fn ask(&mut self, plane: usize, x: usize, y: usize) {
        let node = self.node(x, y);
        let value = &mut self.planes[plane][node];
        if *value == f32::INFINITY {
            // Queued only once.
            *value = f32::MAX;
            self.queue.push((plane, node));
            self.points.push(self.position(x, y, self.z + plane));
        }
    }

    /// Evaluates the queue.
    fn answer(&mut self) {
        self.distances.resize(self.points.len(), 0.0);
        self.shape.distances(&self.points, &mut self.distances);
        for ((plane, node), &distance) in self.queue.drain(..).zip(&self.distances) {
            // A NaN is outside.
            self.planes[plane][node] = if distance.is_finite() { distance } else { f32::MAX };
        }
        self.points.clear();
    }
}

/// The sheets of a cell: which corners are inside, and the vertex of the first sheet.
#[derive(Debug, Clone, Copy, Default)]
struct Cell {
    inside: u8,
    first: u32,
}

/// The mesh as it grows.
struct Sheets {
    width: usize,
    patches: Patches,
    /// The layer of cells below and the present one.
    layers: [Vec<Cell>; 2],
    vertices: Vec<Vec3>,
    quads: Vec<[u32; 4]>,
}

impl Sheets {
    fn new(cells: [usize; 3]) -> Self {
        let layer = vec![Cell::default(); cells[0] * cells[1]];
        Self {
            width: cells[0],
            patches: Patches::new(),
            layers: [layer.clone(), layer],
            vertices: Vec::new(),
            quads: Vec::new(),
        }
    }

    /// Adds a layer of cells: the lower or the upper half of the lattice's.
    fn rise(&mut self, lattice: &Lattice<'_>, half: usize) {
        self.layers.swap(0, 1);
        self.layers[1].fill(Cell::default());
        let cells = || lattice.near.iter().flat_map(|&[x, y]| (0..4).map(move |k| [x + k % 2, y + k / 2]));
        for [x, y] in cells() {
            self.add_vertices(lattice, [x, y, half]);
        }
        for [x, y] in cells() {
            self.add_quads([x, y]);
        }
    }

    /// The vertices of a cell, one for each sheet.
    fn add_vertices(&mut self, lattice: &Lattice<'_>, [x, y, half]: [usize; 3]) {
        let values: [f32; 8] = std::array::from_fn(|c| {
            let [dx, dy, dz] = corner(c);
            lattice.planes[half + dz][lattice.node(x + dx, y + dy)]
        });
        let inside = (0..8).fold(0, |inside, c| inside | u8::from(values[c] < 0.0) << c);
        let low = lattice.position(x, y, lattice.z + half);
        if inside == 0 || inside == u8::MAX {
            return;
        }
        self.layers[1][x + self.width * y] = Cell { inside, first: self.vertices.len() as u32 };
        let mut sums = [(Vec3::ZERO, 0.0); Patches::MOST];
        for e in 0..12 {
            if let Some(patch) = self.patches.of(inside, e) {
                let [from, to] = ends(e);
                let share = (values[from] / (values[from] - values[to])).clamp(MARGIN, 1.0 - MARGIN);
                let at = |c: usize| Vec3::from_array(corner(c).map(|bit| bit as f32));
                sums[patch].0 += at(from).lerp(at(to), share);
                sums[patch].1 += 1.0;
            }
        }
        let sheets = sums.into_iter().filter(|(_, count)| *count > 0.0);
        self.vertices.extend(sheets.map(|(sum, count)| low + lattice.cell / count * sum));
    }

    /// The quadrilaterals around the three edges of the lattice that leave the low corner of a cell.
    fn add_quads(&mut self, [x, y]: [usize; 2]) {
        let inside = self.layers[1][x + self.width * y].inside;
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let (start, end) = (inside & 1, inside >> (1 << axis) & 1);
            if start == end {
                continue;
            }
            // Counter-clockwise about the axis, which is outward if the start is inside.
            let around = [(1, 1), (0, 1), (0, 0), (1, 0)].map(|(back_u, back_v)| {
                let mut back = [0; 3];
                (back[u], back[v]) = (back_u, back_v);
                let (x, y) = (x.checked_sub(back[0])?, y.checked_sub(back[1])?);
                let cell = self.layers[1 - back[2]][x + self.width * y];
                let patch = self.patches.of(cell.inside, edge(axis, back))?;
                Some(cell.first + patch as u32)
            });
            let [Some(a), Some(b), Some(c), Some(d)] = around else { continue };
            self.quads.push(if start == 1 { [a, b, c, d] } else { [d, c, b, a] });
        }
    }
}

/// Moves points onto the surface along the gradient, each step by `limit` metres at most.
fn project(shape: &dyn Shape, points: &mut [Vec3], limit: f32) {
    let mut distances = vec![Distance::default(); points.len()];
    for _ in 0..STEPS {
        shape.distances_and_gradients(points, &mut distances);
        for (point, &Distance { value_m, gradient }) in points.iter_mut().zip(&distances) {
            let step = value_m / gradient.length_squared() * gradient;
            if step.is_finite() {
                *point -= step.clamp_length_max(limit);
            }
        }
    }
}

/// Two triangles along the shorter diagonal.
fn split(vertices: &[Vec3], [a, b, c, d]: [u32; 4]) -> [[u32; 3]; 2] {
    let length = |p: u32, q: u32| vertices[p as usize].distance_squared(vertices[q as usize]);
    if length(a, c) <= length(b, d) { [[a, b, c], [a, c, d]] } else { [[b, c, d], [b, d, a]] }
}

#[cfg(test)]
mod tests;
