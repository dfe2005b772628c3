//! A camera in the world: rays from pixels, pixels from points.

use glam::Vec3;
use mvt_frames::camera::Intrinsics;
use mvt_frames::{Camera, Isometry, World};
use nalgebra as na;
use ndarray::{Array2, s};

use super::{Hit, NORMAL_REACH_PX, NORMAL_STEP_M};

/// A plane is fitted to at least so many of the 121 pixels around one.
const FEWEST_FITTED: f32 = 40.0;

/// A camera in the world, in the `f32` of rays.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Lens {
    pub rotation: glam::Mat3A,
    pub origin: Vec3,
    pub focal_px: f32,
    pub centre: [f32; 2],
    pub focal: [f32; 2],
}

impl Lens {
    /// A camera whose images are displaced by `shift_px` columns and rows.
    pub fn new(intrinsics: &Intrinsics, world_from_camera: Isometry<Camera, World>, shift_px: [f32; 2]) -> Self {
        let (rotation, origin) = world_from_camera.to_f32();
        Self {
            rotation,
            origin: origin.into(),
            focal_px: (0.5 * (intrinsics.fx + intrinsics.fy)) as f32,
            centre: [intrinsics.cx as f32 + shift_px[0], intrinsics.cy as f32 + shift_px[1]],
            focal: [intrinsics.fx as f32, intrinsics.fy as f32],
        }
    }

    /// A point at depth 1 seen at a pixel, camera frame.
    fn at(&self, u: f32, v: f32) -> Vec3 {
        Vec3::new((u - self.centre[0]) / self.focal[0], -(v - self.centre[1]) / self.focal[1], -1.0)
    }

    /// Unit direction of a pixel in the world, and metres along it per metre of depth.
    pub fn ray(&self, u: f32, v: f32) -> (Vec3, f32) {
        let p = self.at(u, v);
        let length = p.length();
        (self.rotation * (p / length), length)
    }

    /// Unit normal towards the camera around a pixel, world frame; zero where neighbours are missing or an edge. It is that of the plane that
    /// fits the inverse depths of a square: those of a plane are linear in column and row. Noise of millimetres needs it.
    pub fn fitted_normal(&self, depth_m: &Array2<f32>, u: usize, v: usize) -> Vec3 {
        let z = depth_m[(v, u)];
        if z <= 0.0 {
            return Vec3::ZERO;
        }
        const REACH: usize = NORMAL_REACH_PX;
        let around = |middle: usize, length: usize| middle.saturating_sub(REACH)..(middle + REACH + 1).min(length);
        let (rows, columns) = (around(v, depth_m.nrows()), around(u, depth_m.ncols()));
        let square = depth_m.slice(s![rows.clone(), columns.clone()]);
        // Sums of the products of 1, x and y with each other and with the inverse depth, from that of the pixel on.
        let (mut lhs, mut rhs) = (na::Matrix3::zeros(), na::Vector3::zeros());
        for (row, depths_m) in rows.zip(square.rows()) {
            for (column, &depth) in columns.clone().zip(depths_m) {
                let p = na::Vector3::new(1.0, column as f32 - u as f32, row as f32 - v as f32);
                let fits = depth > 0.0 && (depth - z).abs() < NORMAL_STEP_M;
                let (part, w) = if fits { (1.0, 1.0 / depth - 1.0 / z) } else { (0.0, 0.0) };
                lhs += p * p.transpose() * part;
                rhs += p * w;
            }
        }
        // A third of the square, so that a rim of two pixels is no face.
        let Some(fit) = (lhs.m11 >= FEWEST_FITTED).then(|| lhs.try_inverse()).flatten() else { return Vec3::ZERO };
        let fit = fit * rhs;
        // 1 / z = a + b du + c dv: the plane n . p = 1 in camera coordinates, x right, y up, z back.
        let [fx, fy] = self.focal;
        let (b, c) = (fit.y, fit.z);
        let a = 1.0 / z + fit.x - b * (u as f32 - self.centre[0]) - c * (v as f32 - self.centre[1]);
        let inside = Vec3::new(b * fx, -c * fy, -a);
        self.rotation * -inside.normalize_or_zero()
    }

    /// The normal by the differences between depths to both sides of a pixel.
    pub fn difference_normal(&self, depth_m: &Array2<f32>, u: usize, v: usize) -> Vec3 {
        let z = depth_m[(v, u)];
        let neighbour = |du: isize, dv: isize| {
            let (u, v) = (u.checked_add_signed(du)?, v.checked_add_signed(dv)?);
            let depth = *depth_m.get((v, u))?;
            (depth > 0.0 && (depth - z).abs() < NORMAL_STEP_M).then(|| self.at(u as f32, v as f32) * depth)
        };
        let here = self.at(u as f32, v as f32) * z;
        let along = |du: isize, dv: isize| match (neighbour(-du, -dv), neighbour(du, dv)) {
            (Some(a), Some(b)) => Some(b - a),
            (Some(a), None) => Some(here - a),
            (None, Some(b)) => Some(b - here),
            (None, None) => None,
        };
        const REACH: isize = NORMAL_REACH_PX as isize;
        let (Some(right), Some(down)) = (along(REACH, 0), along(0, REACH)) else { return Vec3::ZERO };
        self.rotation * down.cross(right).normalize_or_zero()
    }

    /// The pixel at which a point of the world is seen, and the slopes of its column and row over the point, pixels per metre; `None`
    /// behind the camera.
    pub fn project_with_slopes(&self, point: na::Vector3<f64>) -> Option<(na::Vector2<f64>, [na::Vector3<f64>; 2])> {
        let axes = na::Matrix3::from_fn(|row, column| f64::from(self.rotation.col(column)[row]));
        let origin = na::Vector3::from(self.origin.to_array().map(f64::from));
        let p = axes.transpose() * (point - origin);
        let depth = -p.z;
        let [fx, fy] = self.focal.map(f64::from);
        let [x, y] = [p.x / depth, -p.y / depth];
        let pixel = na::Vector2::new(f64::from(self.centre[0]) + fx * x, f64::from(self.centre[1]) + fy * y);
        let slope = |f: f64, along: na::Vector3<f64>| axes * (along * (f / depth));
        (depth > 0.0)
            .then(|| (pixel, [slope(fx, na::Vector3::new(1.0, 0.0, x)), slope(fy, na::Vector3::new(0.0, -1.0, y))]))
    }

    /// The pixel (u, v) at which a point of the world is seen; `None` behind the camera.
    pub fn project(&self, point: Vec3) -> Option<(f32, f32)> {
        let p = self.rotation.transpose() * glam::Vec3A::from(point - self.origin);
        let depth = -p.z;
        (depth > 0.0)
            .then(|| (self.centre[0] + self.focal[0] * p.x / depth, self.centre[1] - self.focal[1] * p.y / depth))
    }
}

/// Side of a cell of the lookup, pixels: about one of three thousand hits falls on each.
const CELL_PX: usize = 4;

/// Hits by the pixel at which they are seen.
#[derive(Debug, Clone, PartialEq)]
pub struct Lookup {
    lens: Lens,
    /// Width and height of the image, pixels.
    size: [usize; 2],
    columns: usize,
    rows: usize,
    /// The hit in each cell, or `u32::MAX`.
    cells: Vec<u32>,
}

impl Lookup {
    pub(crate) fn new(lens: Lens, width: usize, height: usize, origin: Vec3, hits: &[Hit]) -> Self {
        let (columns, rows) = (width.div_ceil(CELL_PX), height.div_ceil(CELL_PX));
        let mut lookup = Self { lens, size: [width, height], columns, rows, cells: vec![u32::MAX; columns * rows] };
        for (i, hit) in (0..).zip(hits) {
            if let Some(cell) = lookup.cell(origin + hit.direction * hit.range_m) {
                lookup.cells[cell] = i;
            }
        }
        lookup
    }

    /// Returns the memory of the lookup of a camera with so many pixels, bytes.
    pub(crate) fn bytes_of(width: usize, height: usize) -> usize {
        width.div_ceil(CELL_PX) * height.div_ceil(CELL_PX) * size_of::<u32>()
    }

    /// Returns its memory, bytes.
    pub(crate) fn size_bytes(&self) -> usize {
        size_of_val(self.cells.as_slice())
    }

    pub(crate) fn lens(&self) -> &Lens {
        &self.lens
    }

    pub(crate) fn size(&self) -> [usize; 2] {
        self.size
    }

    fn cell(&self, point: Vec3) -> Option<usize> {
        let (u, v) = self.lens.project(point)?;
        let (column, row) = ((u + 0.5) / CELL_PX as f32, (v + 0.5) / CELL_PX as f32);
        let inside = column >= 0.0 && row >= 0.0 && column < self.columns as f32 && row < self.rows as f32;
        inside.then(|| row as usize * self.columns + column as usize)
    }

    /// Index of a hit that is seen where this point of the world would be.
    pub fn at(&self, point: Vec3) -> Option<usize> {
        let hit = self.cells[self.cell(point)?];
        (hit != u32::MAX).then_some(hit as usize)
    }
}
