//! The multi-resolution grid: feature vectors on the vertices of nested lattices, interpolated trilinearly.
//!
//! Vertices that are neighbours along x are neighbours in the table, in hashed levels too, where whole rows along x are hashed:
//! the two corners at the ends of a cell's edge along x are one access. Points go through in chunks, one array per coordinate.

use glam::{Mat4, Vec4};

use super::FieldConfig;

/// Features per vertex.
pub const FEATURES: usize = 4;
/// Points that go through the kernels together.
pub(super) const CHUNK: usize = 64;
/// One quantity of the points of a chunk.
pub(super) type Row = [f32; CHUNK];
/// Vertices whose features share a line of 64 bytes, by which gradients are visited.
pub(super) const LINE: usize = 4;

/// One lattice.
#[derive(Debug, Clone)]
pub(super) struct Level {
    /// Vertices per axis.
    resolution: u32,
    /// Of the hash of (y, z); `None` where every vertex has an entry of its own.
    mask: Option<u32>,
    /// Where the level starts in the table.
    first: u32,
    /// Cells per metre.
    pub(super) density: f32,
    half_extent: f32,
}

/// The cells of a level that hold the points of a chunk.
#[derive(Debug, Clone)]
pub(super) struct Cells {
    /// Entries of the low-x ends of each cell's edges along x, at (y, z) = (0, 0), (1, 0), (0, 1), (1, 1).
    rows: [[u32; CHUNK]; 4],
    /// Where in the cell the point is, 0 to 1 along each axis.
    fraction: [Row; 3],
}

impl Default for Cells {
    fn default() -> Self {
        Self { rows: [[0; CHUNK]; 4], fraction: [[0.0; CHUNK]; 3] }
    }
}

/// Derivatives of the features of a level with respect to the position in the cell (0 to 1), along x, y and z.
pub(super) type Slopes = [Vec4; 3];

/// The levels of a configuration and the number of entries of their common table, whole lines.
pub(super) fn levels(config: &FieldConfig) -> (Vec<Level>, usize) {
    let mut entries = 0u32;
    let mut levels = Vec::with_capacity(config.levels.len());
    for &resolution in &config.levels {
        let dense = u64::from(resolution).pow(3) <= 1 << config.table_log2;
        let mask = (!dense).then(|| (1 << config.table_log2) - 1);
        let density = (resolution - 1) as f32 / (2.0 * config.half_extent_m);
        levels.push(Level { resolution, mask, first: entries, density, half_extent: config.half_extent_m });
        // The rows that hash to the last slots run past them.
        entries += mask.map_or(resolution.pow(3), |mask| mask + 1 + resolution);
        entries = entries.next_multiple_of(LINE as u32);
    }
    (levels, entries as usize)
}

impl Level {
    /// Finds the cells of points (x, y, z in metres). Outside of the grid the nearest point inside counts; NaN counts as low.
    #[inline(always)]
    pub(super) fn locate(&self, points: &[Row; 3], cells: &mut Cells) {
        let last = self.resolution as i32 - 2;
        let top = (self.resolution - 1) as f32;
        let mut corner = [[0u32; CHUNK]; 3];
        for axis in 0..3 {
            for i in 0..CHUNK {
                let at = (points[axis][i] + self.half_extent) * self.density;
                // Comparisons, as these are one instruction each, unlike max, min and clamp, which care about NaN.
                let at = if at > 0.0 { at } else { 0.0 };
                let at = if at < top { at } else { top };
                let cell = (at as i32).min(last);
                corner[axis][i] = cell as u32;
                cells.fraction[axis][i] = at - cell as f32;
            }
        }
        let [x, y, z] = &corner;
        let [near, right, far, both] = &mut cells.rows;
        let step = self.resolution;
        match self.mask {
            None => {
                for i in 0..CHUNK {
                    let row = self.first + x[i] + step * (y[i] + step * z[i]);
                    near[i] = row;
                    right[i] = row + step;
                    far[i] = row + step * step;
                    both[i] = row + step + step * step;
                }
            }
            Some(mask) => {
                // Odd multipliers with well mixed bits, as is usual for hashed lattices.
                const Y: u32 = 2_654_435_761;
                const Z: u32 = 805_459_861;
                for i in 0..CHUNK {
                    let start = self.first + x[i];
                    let (y0, z0) = (y[i].wrapping_mul(Y), z[i].wrapping_mul(Z));
                    let (y1, z1) = (y0.wrapping_add(Y), z0.wrapping_add(Z));
                    near[i] = start + ((y0 ^ z0) & mask);
                    right[i] = start + ((y1 ^ z0) & mask);
                    far[i] = start + ((y0 ^ z1) & mask);
                    both[i] = start + ((y1 ^ z1) & mask);
                }
            }
        }
    }
}

/// Interpolates the features at the points of a chunk into `FEATURES` rows.
#[inline(always)]
pub(super) fn encode(table: &[[f32; FEATURES]], cells: &Cells, out: &mut [Row]) {
    for first in (0..CHUNK).step_by(4) {
        let (a, _) = interpolate(table, cells, first);
        let (b, _) = interpolate(table, cells, first + 1);
        let (c, _) = interpolate(table, cells, first + 2);
        let (d, _) = interpolate(table, cells, first + 3);
        store(Mat4::from_cols(a, b, c, d), first, out);
    }
}

/// As [`encode`], with the derivatives.
#[inline(always)]
pub(super) fn encode_with_slopes(
    table: &[[f32; FEATURES]],
    cells: &Cells,
    out: &mut [Row],
    slopes: &mut [Slopes; CHUNK],
) {
    for first in (0..CHUNK).step_by(4) {
        let (a, along_a) = interpolate(table, cells, first);
        let (b, along_b) = interpolate(table, cells, first + 1);
        let (c, along_c) = interpolate(table, cells, first + 2);
        let (d, along_d) = interpolate(table, cells, first + 3);
        slopes[first] = along_a;
        slopes[first + 1] = along_b;
        slopes[first + 2] = along_c;
        slopes[first + 3] = along_d;
        store(Mat4::from_cols(a, b, c, d), first, out);
    }
}

/// The features of point `i` and their derivatives, which cost nothing where they are not used.
#[inline(always)]
fn interpolate(table: &[[f32; FEATURES]], cells: &Cells, i: usize) -> (Vec4, Slopes) {
    let [x, y, z] = [cells.fraction[0][i], cells.fraction[1][i], cells.fraction[2][i]];
    let (near_0, near_1) = ends(table, cells.rows[0][i]);
    let (right_0, right_1) = ends(table, cells.rows[1][i]);
    let (far_0, far_1) = ends(table, cells.rows[2][i]);
    let (both_0, both_1) = ends(table, cells.rows[3][i]);
    // Suffix 0 and 1: at the low and the high end of x. First along y, then z, then x.
    let (low_y_0, low_y_1) = (right_0 - near_0, right_1 - near_1);
    let (high_y_0, high_y_1) = (both_0 - far_0, both_1 - far_1);
    let (low_0, low_1) = (near_0 + low_y_0 * y, near_1 + low_y_1 * y);
    let (high_0, high_1) = (far_0 + high_y_0 * y, far_1 + high_y_1 * y);
    let (along_z_0, along_z_1) = (high_0 - low_0, high_1 - low_1);
    let (along_y_0, along_y_1) = (low_y_0 + (high_y_0 - low_y_0) * z, low_y_1 + (high_y_1 - low_y_1) * z);
    let (value_0, value_1) = (low_0 + along_z_0 * z, low_1 + along_z_1 * z);
    let along_x = value_1 - value_0;
    let along_y = along_y_0 + (along_y_1 - along_y_0) * x;
    let along_z = along_z_0 + (along_z_1 - along_z_0) * x;
    (value_0 + along_x * x, [along_x, along_y, along_z])
}

#[inline(always)]
fn ends(table: &[[f32; FEATURES]], row: u32) -> (Vec4, Vec4) {
    let ends = &table[row as usize..row as usize + 2];
    (Vec4::from_array(ends[0]), Vec4::from_array(ends[1]))
}

/// Writes four points (columns) into the four rows of `out`.
#[inline(always)]
fn store(points: Mat4, first: usize, out: &mut [Row]) {
    let rows = points.transpose();
    out[0][first..first + 4].copy_from_slice(&rows.x_axis.to_array());
    out[1][first..first + 4].copy_from_slice(&rows.y_axis.to_array());
    out[2][first..first + 4].copy_from_slice(&rows.z_axis.to_array());
    out[3][first..first + 4].copy_from_slice(&rows.w_axis.to_array());
}

/// Four points of `FEATURES` rows, as columns: the inverse of [`store`].
#[inline(always)]
pub(super) fn points_of(rows: &[Row], first: usize) -> Mat4 {
    Mat4::from_cols(
        Vec4::from_slice(&rows[0][first..first + 4]),
        Vec4::from_slice(&rows[1][first..first + 4]),
        Vec4::from_slice(&rows[2][first..first + 4]),
        Vec4::from_slice(&rows[3][first..first + 4]),
    )
    .transpose()
}

/// Adds the gradient with respect to the interpolated features (`FEATURES` rows) to that of the table, and marks the lines in
/// `touched`, a bit each.
#[inline(always)]
pub(super) fn scatter(cells: &Cells, gradient: &[Row], table: &mut [[f32; FEATURES]], touched: &mut [u64]) {
    for first in (0..CHUNK).step_by(4) {
        let points = points_of(gradient, first);
        add_to_corners(cells, first, points.x_axis, table, touched);
        add_to_corners(cells, first + 1, points.y_axis, table, touched);
        add_to_corners(cells, first + 2, points.z_axis, table, touched);
        add_to_corners(cells, first + 3, points.w_axis, table, touched);
    }
}

#[inline(always)]
fn add_to_corners(cells: &Cells, i: usize, gradient: Vec4, table: &mut [[f32; FEATURES]], touched: &mut [u64]) {
    let [x, y, z] = [cells.fraction[0][i], cells.fraction[1][i], cells.fraction[2][i]];
    let (low, high) = (gradient * (1.0 - x), gradient * x);
    let weights = [(1.0 - y) * (1.0 - z), y * (1.0 - z), (1.0 - y) * z, y * z];
    for k in 0..4 {
        let row = cells.rows[k][i] as usize;
        let ends = &mut table[row..row + 2];
        ends[0] = (Vec4::from_array(ends[0]) + low * weights[k]).to_array();
        ends[1] = (Vec4::from_array(ends[1]) + high * weights[k]).to_array();
        for line in [row / LINE, (row + 1) / LINE] {
            touched[line / 64] |= 1 << (line % 64);
        }
    }
}
