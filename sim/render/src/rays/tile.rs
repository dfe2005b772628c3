//! The kernel: a tile of pixels goes through the trees.
//!
//! A pixel's ray has the direction (x, y, -1) in the camera, so its parameter is the depth along the optical axis, and
//! every quantity of a triangle is linear in x and y: with corners p0, p1, p2 seen from the camera, the ray passes
//! inside the edge from p to q where d . (p x q) has the sign of the triangle's side (Pluecker). (p + q) x (q - p) = 2
//! p x q is both precise for short edges and exactly opposite when p and q change places.

use glam::{Mat3A, Vec3A, Vec4, Vec4Swizzles};
use mvt_frames::camera::Intrinsics;
use pulp::{Simd, WithSimd};

use super::mesh::{RayMesh, Triangle};
use super::{Faces, Hits, Instance, MISS, PixelWindow};

/// Pixels along the side of a tile.
const TILE: usize = 8;
/// Pixels along the side of a block.
const BLOCK: usize = 4;
/// Pixels of a block.
const BLOCK_AREA: usize = BLOCK * BLOCK;
/// Pixels of a tile.
const TILE_AREA: usize = TILE * TILE;
/// Widens the triangles by about a rounding error of the edge functions. Neighbours agree about the side of their
/// common edge whatever the rounding, but around a corner all edges might err to the same side.
const EDGE_SLACK: f32 = 1e-6;
/// Widens frusta by this share of the distance: more than all rounding errors of the test.
const FRUSTUM_SLACK: f32 = 1e-6;

/// Working memory that stays allocated from frame to frame.
#[derive(Debug, Clone, Default)]
pub(super) struct Scratch {
    views: Vec<View>,
    /// x of the rays of each column and y of the rays of each row of the window.
    columns: Vec<f32>,
    rows: Vec<f32>,
    stack: Vec<(u32, f32)>,
}

impl Scratch {
    pub(super) fn prepare(&mut self, views: impl Iterator<Item = View>, intrinsics: &Intrinsics, window: &PixelWindow) {
        self.views.clear();
        self.views.extend(views);
        // Nearest first, so that they hide the others.
        self.views.sort_unstable_by(|a, b| a.nearest.total_cmp(&b.nearest).then(a.instance.cmp(&b.instance)));
        self.columns.clear();
        self.columns.extend(window.columns.clone().map(|u| ((u as f64 - intrinsics.cx) / intrinsics.fx) as f32));
        self.rows.clear();
        self.rows.extend(window.rows.clone().map(|v| (-(v as f64 - intrinsics.cy) / intrinsics.fy) as f32));
    }
}

/// An instance in the camera's frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    instance: u32,
    /// Position of the camera in the mesh's frame.
    origin: Vec3A,
    /// Columns are the camera's axes in the mesh's frame.
    axes: Mat3A,
    /// Least depth of any part, metres.
    nearest: f32,
    /// Range of x and y over depth that it covers in the image.
    covers: Rectangle,
    edge_slack: f32,
    frustum_slack: f32,
}

/// A rectangle of the image, in the units of ray directions.
#[derive(Debug, Clone, Copy)]
struct Rectangle {
    x: [f32; 2],
    y: [f32; 2],
}

impl View {
    /// Returns `None` if the mesh is empty or lies behind the camera.
    pub(super) fn new(instance: &Instance<'_>, index: usize) -> Option<Self> {
        let (axes, origin) = instance.mesh_from_camera;
        let bounds = instance.mesh.tree.nodes.first()?.aabb();
        let camera_from_mesh = axes.transpose();
        let corners: [Vec3A; 8] = std::array::from_fn(|k| {
            let pick = |axis: usize| if k >> axis & 1 == 0 { bounds.min[axis] } else { bounds.max[axis] };
            camera_from_mesh * (Vec3A::new(pick(0), pick(1), pick(2)) - origin)
        });
        let nearest = corners.iter().fold(f32::INFINITY, |nearest, p| nearest.min(-p.z));
        let farthest = corners.iter().fold(f32::NEG_INFINITY, |farthest, p| farthest.max(-p.z));
        if farthest.is_nan() || farthest <= 0.0 {
            return None;
        }
        let reach = corners.iter().fold(0.0f32, |reach, p| reach.max(p.length()));
        // A box that reaches behind the camera may be anywhere in the image.
        let everywhere = nearest <= 1e-3 * reach;
        let range = |axis: usize| {
            let ratios = corners.map(|p| p[axis] / -p.z);
            let low = ratios.into_iter().fold(f32::INFINITY, f32::min);
            let high = ratios.into_iter().fold(f32::NEG_INFINITY, f32::max);
            if everywhere { [f32::NEG_INFINITY, f32::INFINITY] } else { [low - 1e-4, high + 1e-4] }
        };
        Some(Self {
            instance: index as u32,
            origin,
            axes,
            nearest: nearest.max(0.0),
            covers: Rectangle { x: range(0), y: range(1) },
            edge_slack: EDGE_SLACK * reach,
            frustum_slack: FRUSTUM_SLACK * reach,
        })
    }
}

/// Planes through the camera that bound a tile, in a mesh's coordinates relative to the camera.
struct Frustum {
    x: Vec4,
    y: Vec4,
    z: Vec4,
    forward: Vec3A,
    origin: Vec3A,
    slack: f32,
}

impl Frustum {
    #[inline(always)]
    fn new(view: &View, tile: &Rectangle) -> Self {
        let Mat3A { x_axis: right, y_axis: up, z_axis: back } = view.axes;
        let offset = Vec4::new(tile.x[0], -tile.x[1], tile.y[0], -tile.y[1]);
        let plane = |k: usize| Vec4::new(right[k], -right[k], up[k], -up[k]) + offset * back[k];
        Self { x: plane(0), y: plane(1), z: plane(2), forward: -back, origin: view.origin, slack: -view.frustum_slack }
    }

    /// Returns the least depth of a box inside the frustum; infinite if the box lies outside.
    #[inline(always)]
    fn enter(&self, bounds: &obvhs::aabb::Aabb) -> f32 {
        let (low, high) = (bounds.min - self.origin, bounds.max - self.origin);
        let inside = (self.x * low.x).max(self.x * high.x)
            + (self.y * low.y).max(self.y * high.y)
            + (self.z * low.z).max(self.z * high.z);
        if inside.cmplt(Vec4::splat(self.slack)).any() {
            return f32::INFINITY;
        }
        let depth = (self.forward * low).min(self.forward * high);
        depth.x + depth.y + depth.z + self.slack
    }
}

/// Rays of a tile and their nearest hits. Pixels are ordered by blocks, row by row inside each.
#[repr(C, align(64))]
struct Tile {
    x: [f32; TILE_AREA],
    y: [f32; TILE_AREA],
    depth: [f32; TILE_AREA],
    u: [f32; TILE_AREA],
    v: [f32; TILE_AREA],
    triangle: [u32; TILE_AREA],
    instance: [u32; TILE_AREA],
    /// Limits of x and y of each block.
    x_low: Vec4,
    x_high: Vec4,
    y_low: Vec4,
    y_high: Vec4,
    /// Greatest depth at which a hit still counts, for each block.
    farthest: Vec4,
}

/// Returns the index in a tile of the first of four pixels in row `row`, columns from `4 * half`.
#[inline(always)]
fn quad(row: usize, half: usize) -> usize {
    ((row / BLOCK) * (TILE / BLOCK) + half) * BLOCK_AREA + (row % BLOCK) * BLOCK
}

/// Returns the coordinates of four points along an axis.
#[inline(always)]
fn seen_along(x: Vec4, y: Vec4, z: Vec4, axis: Vec3A) -> Vec4 {
    x * axis.x + y * axis.y + z * axis.z
}

/// The dot product of ray directions (x, y, -1) with a vector.
///
/// No closures or adapters of vectors stand here and in its callers: one that is not inlined is compiled without the
/// vector instructions.
#[derive(Clone, Copy)]
struct Plane<S: Simd> {
    x: S::f32s,
    y: S::f32s,
    z: S::f32s,
}

impl<S: Simd> Plane<S> {
    #[inline(always)]
    fn new(simd: S, x: f32, y: f32, z: f32) -> Self {
        Self { x: simd.splat_f32s(x), y: simd.splat_f32s(y), z: simd.splat_f32s(z) }
    }

    #[inline(always)]
    fn at(self, simd: S, x: S::f32s, y: S::f32s) -> S::f32s {
        simd.sub_f32s(simd.add_f32s(simd.mul_f32s(x, self.x), simd.mul_f32s(y, self.y)), self.z)
    }
}

/// Casts the rays of a window.
pub(super) struct Job<'a> {
    pub(super) instances: &'a [Instance<'a>],
    pub(super) faces: Faces,
    pub(super) hits: &'a mut Hits,
    pub(super) scratch: &'a mut Scratch,
}

impl WithSimd for Job<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { instances, faces, hits, scratch: Scratch { views, columns, rows, stack } } = self;
        let mut tile = Tile::new();
        for (tile_row, ys) in rows.chunks(TILE).enumerate() {
            for (tile_column, xs) in columns.chunks(TILE).enumerate() {
                let (Some(&left), Some(&right), Some(&top), Some(&bottom)) =
                    (xs.first(), xs.last(), ys.first(), ys.last())
                else {
                    continue;
                };
                let bounds = Rectangle { x: [left, right], y: [bottom, top] };
                let overlaps = |view: &&View| {
                    let Rectangle { x, y } = view.covers;
                    x[0] <= right && x[1] >= left && y[0] <= top && y[1] >= bottom
                };
                let mut seen = views.iter().filter(overlaps).peekable();
                if seen.peek().is_none() {
                    continue;
                }
                let corner = tile_row * TILE * columns.len() + tile_column * TILE;
                tile.load(xs, ys, &hits.depth[corner..], columns.len());
                for view in seen {
                    if view.nearest > tile.farthest.max_element() {
                        break;
                    }
                    let mesh = instances[view.instance as usize].mesh;
                    tile.trace(simd, mesh, view, &Frustum::new(view, &bounds), faces, stack);
                }
                tile.store(xs.len(), ys.len(), hits, corner, columns.len());
            }
        }
    }
}

impl Tile {
    fn new() -> Self {
        Self {
            x: [0.0; TILE_AREA],
            y: [0.0; TILE_AREA],
            depth: [0.0; TILE_AREA],
            u: [0.0; TILE_AREA],
            v: [0.0; TILE_AREA],
            triangle: [MISS; TILE_AREA],
            instance: [MISS; TILE_AREA],
            x_low: Vec4::ZERO,
            x_high: Vec4::ZERO,
            y_low: Vec4::ZERO,
            y_high: Vec4::ZERO,
            farthest: Vec4::ZERO,
        }
    }

    /// Loads the rays and limits of a tile; `limits` starts at its first pixel, with `stride` to the next row.
    #[inline(always)]
    fn load(&mut self, xs: &[f32], ys: &[f32], limits: &[f32], stride: usize) {
        // Pixels beyond the window repeat the last column and row; their limit of minus infinity excludes every hit.
        let x: [f32; TILE] = std::array::from_fn(|c| xs[c.min(xs.len() - 1)]);
        let y: [f32; TILE] = std::array::from_fn(|r| ys[r.min(ys.len() - 1)]);
        self.depth = [f32::NEG_INFINITY; TILE_AREA];
        self.triangle = [MISS; TILE_AREA];
        for row in 0..TILE {
            for half in 0..TILE / BLOCK {
                let first = quad(row, half);
                self.x[first..first + BLOCK].copy_from_slice(&x[half * BLOCK..][..BLOCK]);
                self.y[first..first + BLOCK].fill(y[row]);
                if row < ys.len() {
                    let columns = half * BLOCK..xs.len().min((half + 1) * BLOCK);
                    if let Some(limits) = limits.get(row * stride..).and_then(|row| row.get(columns)) {
                        self.depth[first..first + limits.len()].copy_from_slice(limits);
                    }
                }
            }
        }
        // y falls from row to row.
        self.x_low = Vec4::new(x[0], x[BLOCK], x[0], x[BLOCK]);
        self.x_high = Vec4::new(x[BLOCK - 1], x[TILE - 1], x[BLOCK - 1], x[TILE - 1]);
        self.y_low = Vec4::new(y[BLOCK - 1], y[BLOCK - 1], y[TILE - 1], y[TILE - 1]);
        self.y_high = Vec4::new(y[0], y[0], y[BLOCK], y[BLOCK]);
        let farthest =
            |k: usize| self.depth[k * BLOCK_AREA..][..BLOCK_AREA].iter().fold(f32::NEG_INFINITY, |a, &b| a.max(b));
        self.farthest = Vec4::new(farthest(0), farthest(1), farthest(2), farthest(3));
    }

    /// Writes the hits to the image, whose pixel `corner` is the first of the tile.
    #[inline(always)]
    fn store(&self, width: usize, height: usize, hits: &mut Hits, corner: usize, stride: usize) {
        for row in 0..height {
            for half in 0..TILE / BLOCK {
                let first = quad(row, half);
                let from = corner + row * stride + half * BLOCK;
                for k in 0..BLOCK.min(width.saturating_sub(half * BLOCK)) {
                    if self.triangle[first + k] != MISS {
                        hits.depth[from + k] = self.depth[first + k];
                        hits.triangle[from + k] = self.triangle[first + k];
                        hits.instance[from + k] = self.instance[first + k];
                        hits.u[from + k] = self.u[first + k];
                        hits.v[from + k] = self.v[first + k];
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn trace<S: Simd>(
        &mut self,
        simd: S,
        mesh: &RayMesh,
        view: &View,
        frustum: &Frustum,
        faces: Faces,
        stack: &mut Vec<(u32, f32)>,
    ) {
        let nodes = &mesh.tree.nodes;
        stack.clear();
        stack.push((0, 0.0));
        while let Some((mut index, entry)) = stack.pop() {
            if entry > self.farthest.max_element() {
                continue;
            }
            loop {
                let node = &nodes[index as usize];
                if node.is_leaf() {
                    for k in node.first_index..node.first_index + node.prim_count {
                        self.intersect(simd, view, faces, &mesh.triangles[k as usize], k);
                    }
                    break;
                }
                let farthest = self.farthest.max_element();
                let first = node.first_index;
                let near = frustum.enter(nodes[first as usize].aabb());
                let far = frustum.enter(nodes[first as usize + 1].aabb());
                let ((near, near_node), (far, far_node)) =
                    if near <= far { ((near, first), (far, first + 1)) } else { ((far, first + 1), (near, first)) };
                if near > farthest || near == f32::INFINITY {
                    break;
                }
                if far <= farthest && far < f32::INFINITY {
                    stack.push((far_node, far));
                }
                index = near_node;
            }
        }
    }

    /// Returns the greatest value in each block of a function linear in x and y: it lies at one of the block's corners.
    #[inline(always)]
    fn greatest(&self, x: f32, y: f32, z: f32) -> Vec4 {
        (self.x_low * x).max(self.x_high * x) + (self.y_low * y).max(self.y_high * y) - z
    }

    #[inline(always)]
    fn intersect<S: Simd>(&mut self, simd: S, view: &View, faces: Faces, triangle: &Triangle, index: u32) {
        // Relative to the camera; lane 3 is the normal, a direction, and stays.
        let corner = Vec4::new(1.0, 1.0, 1.0, 0.0);
        let (x, y, z) = (
            triangle.x - corner * view.origin.x,
            triangle.y - corner * view.origin.y,
            triangle.z - corner * view.origin.z,
        );
        // Minus the camera's height over the triangle's plane, times the normal's length.
        let height = (x * x.wwww() + y * y.wwww() + z * z.wwww()).x;
        if height == 0.0 || (height > 0.0 && faces == Faces::Front) {
            return;
        }
        let (x, y, z) = (
            seen_along(x, y, z, view.axes.x_axis),
            seen_along(x, y, z, view.axes.y_axis),
            seen_along(x, y, z, view.axes.z_axis),
        );

        // Lane k: the edge from corner k to the next. All signs are turned so that inside is positive.
        let side = Vec4::splat(1.0f32.copysign(height));
        let (next_x, next_y, next_z) = (x.yzxw(), y.yzxw(), z.yzxw());
        let (sx, sy, sz) = (x + next_x, y + next_y, z + next_z);
        let (dx, dy, dz) = ((next_x - x) * side, (next_y - y) * side, (next_z - z) * side);
        let (edge_x, edge_y, edge_z) = (sy * dz - sz * dy, sz * dx - sx * dz, sx * dy - sy * dx);
        let slack = -view.edge_slack * triangle.longest_edge;

        // Rounding is monotonic and the operations are those of the pixels, so this never drops a block with a pixel
        // that passes.
        let nearest = -z.x.max(z.y).max(z.z) * (1.0 - 1e-5);
        let covers = self
            .greatest(edge_x.x, edge_y.x, edge_z.x)
            .min(self.greatest(edge_x.y, edge_y.y, edge_z.y))
            .min(self.greatest(edge_x.z, edge_y.z, edge_z.z))
            .cmpge(Vec4::splat(slack))
            & self.farthest.cmpge(Vec4::splat(nearest));
        let mut blocks = covers.bitmask();
        if blocks == 0 {
            return;
        }

        let edges = [
            Plane::new(simd, edge_x.x, edge_y.x, edge_z.x),
            Plane::new(simd, edge_x.y, edge_y.y, edge_z.y),
            Plane::new(simd, edge_x.z, edge_y.z, edge_z.z),
        ];
        let side = side.x;
        let normal = Plane::new(simd, x.w * side, y.w * side, z.w * side);
        let (height, slack) = (simd.splat_f32s(height * side), simd.splat_f32s(slack));
        let (one, half, zero) = (simd.splat_f32s(1.0), simd.splat_f32s(0.5), simd.splat_f32s(0.0));
        let (index, instance) = (simd.splat_u32s(index), simd.splat_u32s(view.instance));
        while blocks != 0 {
            let block = blocks.trailing_zeros() as usize;
            blocks &= blocks - 1;
            let pixels = block * BLOCK_AREA..(block + 1) * BLOCK_AREA;
            let xs = S::as_simd_f32s(&self.x[pixels.clone()]).0;
            let ys = S::as_simd_f32s(&self.y[pixels.clone()]).0;
            let depths = S::as_mut_simd_f32s(&mut self.depth[pixels.clone()]).0;
            let us = S::as_mut_simd_f32s(&mut self.u[pixels.clone()]).0;
            let vs = S::as_mut_simd_f32s(&mut self.v[pixels.clone()]).0;
            let triangles = S::as_mut_simd_u32s(&mut self.triangle[pixels.clone()]).0;
            let instances = S::as_mut_simd_u32s(&mut self.instance[pixels]).0;
            let mut any = false;
            for k in 0..BLOCK_AREA / S::F32_LANES {
                let (x, y) = (xs[k], ys[k]);
                let (e0, e1, e2) = (edges[0].at(simd, x, y), edges[1].at(simd, x, y), edges[2].at(simd, x, y));
                let inside = simd.greater_than_or_equal_f32s(simd.min_f32s(simd.min_f32s(e0, e1), e2), slack);
                if simd.first_true_m32s(inside) == S::F32_LANES {
                    continue;
                }
                let facing = normal.at(simd, x, y);
                let inverse = simd.div_f32s(one, facing);
                let depth = simd.mul_f32s(height, inverse);
                let tie = simd.and_m32s(simd.equal_f32s(depth, depths[k]), simd.less_than_u32s(index, triangles[k]));
                let nearer = simd.or_m32s(simd.less_than_f32s(depth, depths[k]), tie);
                let hit = simd.and_m32s(simd.and_m32s(inside, nearer), simd.greater_than_f32s(facing, zero));
                if simd.first_true_m32s(hit) == S::F32_LANES {
                    continue;
                }
                any = true;
                // The weight of a corner is the edge function of the opposite edge over the sum of all three.
                let weight = simd.mul_f32s(half, inverse);
                depths[k] = simd.select_f32s(hit, depth, depths[k]);
                us[k] = simd.select_f32s(hit, simd.mul_f32s(e2, weight), us[k]);
                vs[k] = simd.select_f32s(hit, simd.mul_f32s(e0, weight), vs[k]);
                triangles[k] = simd.select_u32s(hit, index, triangles[k]);
                instances[k] = simd.select_u32s(hit, instance, instances[k]);
            }
            if any {
                let mut greatest = depths[0];
                for &depth in &depths[1..] {
                    greatest = simd.max_f32s(greatest, depth);
                }
                self.farthest[block] = simd.reduce_max_f32s(greatest);
            }
        }
    }
}
