//! Gel that does not crease at the rim of a contact.
//!
//! The gel's surface is a membrane under tension on an elastic foundation, and the object is an obstacle that it cannot
//! pass. With the object's indentation h >= 0 and a reach l, the gel's indentation u satisfies u >= h, and u - l^2
//! (u_xx + u_yy) = 0 off the object. Beside a long straight edge u decays as exp(-x / l).

use std::ops::Range;

use mvt_frames::camera::Intrinsics;
use mvt_robot::digit::gel::GelSurface;

use super::shade::{Row, Shader};

/// Greatest reach, metres: the pad ends a few millimetres beyond the camera's view.
pub(super) const REACH_MAX_M: f32 = 1.5e-3;
/// A reach of more pixels is first solved on coarser grids: the number of sweeps grows with the square of the reach.
const FINE_PX: f64 = 7.0;
/// Sweeps on a grid that starts from the solution of one with cells twice as large: its error fades over a few cells.
const FINISH: usize = 48;
/// Indentation below which the gel counts as untouched, metres: it changes no colour by a whole level.
const UNTOUCHED_M: f32 = 1e-6;

/// Deformation of the gel around the object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Membrane {
    /// Distance beyond the rim over which an indentation decays to 1/e, metres, up to 1.5 mm; real DIGITs show 0.5 to 1 mm.
    pub reach_m: f32,
}

/// Two fields of indentation, metres, between which the sweeps alternate, and the obstacle.
#[derive(Default)]
pub(super) struct Scratch {
    fields: [Vec<f32>; 2],
    obstacle: Vec<f32>,
    /// The same on the coarse grid.
    coarse: [Vec<f32>; 3],
}

impl Membrane {
    /// Lays the gel over the object: lowers `depth`, which holds the nearer of gel and object, to that of the membrane.
    /// Returns the rows that may then differ from the untouched gel; `contact_rows` are those that differ before.
    #[inline(always)]
    pub(super) fn relax(
        &self,
        camera: &Intrinsics,
        gel: GelSurface,
        contact_rows: Range<usize>,
        gel_depth: &[f32],
        depth: &mut [f32],
        scratch: &mut Scratch,
    ) -> Range<usize> {
        // Lateral size of a pixel at the apex; nearer parts of the gel are up to 13 % finer.
        let reach = f64::from(self.reach_m) / (gel.apex_m() / camera.fx);
        let width = camera.width;
        let margin = (6.0 * reach).ceil() as usize;
        let rows = contact_rows.start.saturating_sub(margin)..(contact_rows.end + margin).min(camera.height);
        let window = rows.start * width..rows.end * width;

        let Scratch { fields: [from, to], obstacle, coarse } = scratch;
        obstacle.clear();
        obstacle.extend(gel_depth[window.clone()].iter().zip(&depth[window.clone()]).map(|(gel, d)| gel - d));
        from.clone_from(obstacle);
        let sweeps = if reach > FINE_PX {
            solve_coarsely::<4>(width, reach, 2 * sweeps(reach / 4.0), obstacle, from, coarse);
            solve_coarsely::<2>(width, reach, FINISH, obstacle, from, coarse);
            FINISH / 2
        } else {
            sweeps(reach)
        };
        to.clone_from(from);
        for _ in 0..sweeps {
            sweep(width, weight(reach), obstacle, from, to);
            std::mem::swap(from, to);
        }
        for ((d, gel), u) in depth[window.clone()].iter_mut().zip(&gel_depth[window]).zip(from.iter()) {
            *d = gel - u;
        }
        rows
    }
}

/// Returns the weight of a neighbour in a sweep.
fn weight(reach_px: f64) -> f32 {
    (reach_px * reach_px / (1.0 + 4.0 * reach_px * reach_px)) as f32
}

/// Returns the number of sweeps from the obstacle to the membrane. Each carries a change by one pixel; as in diffusion, n sweeps spread it
/// over about sqrt(n) pixels.
fn sweeps(reach_px: f64) -> usize {
    (8.0 * reach_px * reach_px).ceil() as usize
}

/// Improves a membrane by sweeps on a grid of cells of `CELL` pixels along either axis.
#[inline(always)]
fn solve_coarsely<const CELL: usize>(
    width: usize,
    reach: f64,
    sweeps: usize,
    obstacle: &[f32],
    field: &mut [f32],
    scratch: &mut [Vec<f32>; 3],
) {
    let (rows, columns) = ((obstacle.len() / width).div_ceil(CELL), width.div_ceil(CELL));
    let [coarse, from, to] = scratch;
    for (cells, pixels) in [(&mut *coarse, obstacle), (&mut *from, &*field)] {
        cells.clear();
        cells.resize(rows * columns, 0.0);
        for (v, row) in pixels.chunks_exact(width).enumerate() {
            let cells = &mut cells[v / CELL * columns..(v / CELL + 1) * columns];
            for (cell, pixels) in cells.iter_mut().zip(row.chunks(CELL)) {
                *cell += pixels.iter().sum::<f32>() / (CELL * CELL) as f32;
            }
        }
    }
    to.clone_from(from);
    for _ in 0..sweeps {
        sweep(columns, weight(reach / CELL as f64), coarse, from, to);
        std::mem::swap(from, to);
    }
    for (v, (row, obstacle)) in field.chunks_exact_mut(width).zip(obstacle.chunks_exact(width)).enumerate() {
        let (upper, lower, down) = between(v, CELL, rows);
        let row_of = |k: usize| &from[k * columns..(k + 1) * columns];
        let (upper, lower) = (row_of(upper), row_of(lower));
        for (u, (value, &obstacle)) in row.iter_mut().zip(obstacle).enumerate() {
            let (left, right, across) = between(u, CELL, columns);
            let at = |row: &[f32]| row[left] + across * (row[right] - row[left]);
            let membrane = at(upper) + down * (at(lower) - at(upper));
            *value = if membrane > obstacle { membrane } else { obstacle };
        }
    }
}

/// Returns the two cells, of `cell` pixels each, between whose middles a pixel lies, and its share of the way from one to the other.
#[inline(always)]
pub(super) fn between(pixel: usize, cell: usize, cells: usize) -> (usize, usize, f32) {
    let at = ((pixel as f32 + 0.5) / cell as f32 - 0.5).max(0.0);
    let first = (at as usize).min(cells - 1);
    (first, (first + 1).min(cells - 1), (at - first as f32).min(1.0))
}

/// Does one Jacobi sweep of rows of `columns` values. At the border of the window the membrane is level.
#[inline(always)]
fn sweep(columns: usize, weight: f32, obstacle: &[f32], from: &[f32], to: &mut [f32]) {
    let last = from.len() / columns - 1;
    for (v, (to, obstacle)) in to.chunks_exact_mut(columns).zip(obstacle.chunks_exact(columns)).enumerate() {
        let row = |v: usize| &from[v * columns..(v + 1) * columns];
        let (above, here, below) = (row(v.saturating_sub(1)), row(v), row((v + 1).min(last)));
        let relax = |left: usize, u: usize, right: usize| {
            let u_new = weight * (above[u] + below[u] + here[left] + here[right]);
            if u_new > obstacle[u] { u_new } else { obstacle[u] }
        };
        to[0] = relax(0, 0, 1);
        for u in 1..columns - 1 {
            to[u] = relax(u - 1, u, u + 1);
        }
        to[columns - 1] = relax(columns - 2, columns - 1, columns - 1);
    }
}

/// Computes the normals of row `v` of a depth image at the columns where `free` holds, by central differences,
/// one-sided at the image's border.
#[inline(always)]
pub(super) fn normals(v: usize, depth: &[f32], shader: &Shader, free: impl Fn(usize) -> bool, row: &mut Row) {
    let (width, height) = (shader.camera.width, shader.camera.height);
    let point = |u: usize, v: usize| glam::Vec3::from(shader.point(u, v, depth[v * width + u]));
    let (above, below) = (v.saturating_sub(1), (v + 1).min(height - 1));
    for u in (0..width).filter(|&u| free(u)) {
        let along_row = point((u + 1).min(width - 1), v) - point(u.saturating_sub(1), v);
        let along_column = point(u, below) - point(u, above);
        // Columns run towards -y, rows towards -z: this order points back to the camera.
        let normal = along_column.cross(along_row);
        for (lane, value) in row.normal.iter_mut().zip(normal.to_array()) {
            lane[u] = value;
        }
    }
}

/// Returns whether the membrane at `depth` lies nearer to the camera than `reference`. With the object as reference it
/// is off the object, with the untouched gel it is indented.
#[inline(always)]
pub(super) fn is_indented(reference: f32, depth: f32) -> bool {
    reference - depth > UNTOUCHED_M
}

#[cfg(test)]
mod tests {
    use mvt_robot::digit::{HEIGHT, WIDTH, gel, intrinsics};

    use super::*;

    /// A block with a long straight edge: beyond it the indentation decays as exp(-x / reach); the gel stays on the
    /// block, and no part of it comes nearer to the camera than the object or moves away from it.
    #[test]
    fn indentation_fades_exponentially_beyond_an_edge() {
        const EDGE: usize = 100;
        let gel_depth = vec![gel::APEX_M as f32; WIDTH * HEIGHT];
        let block = |i: usize| if i % WIDTH < EDGE && (40..280).contains(&(i / WIDTH)) { 1e-3 } else { 0.0 };
        for reach_m in [1e-4, 2e-4, 5e-4, 1e-3] {
            let mut depth: Vec<f32> = (0..WIDTH * HEIGHT).map(|i| gel_depth[i] - block(i)).collect();
            let (camera, gel, scratch) =
                (intrinsics(), GelSurface::new(gel::APEX_M, [0.02, 0.03], 0.0), &mut Scratch::default());
            let rows = Membrane { reach_m }.relax(&camera, gel, 40..280, &gel_depth, &mut depth, scratch);
            assert!(rows.start < 40 && rows.end > 280);
            let indentation = |u: usize| gel_depth[0] - depth[160 * WIDTH + u];
            let reach = f64::from(reach_m) * intrinsics().fx / gel::APEX_M;
            // The difference equation's own decay per pixel, cosh(k) = 1 + 1 / (2 reach^2).
            let k = (1.0 + 0.5 / (reach * reach)).acosh();
            // The window ends 6 reaches beyond the block, and the image 3.
            for x in 0..(1.5 * reach) as usize {
                let expected = 1e-3 * (-k * (x + 1) as f64).exp();
                let got = f64::from(indentation(EDGE + x));
                assert!(
                    (got - expected).abs() < 3e-5,
                    "reach {reach:.1} px, {x} px beyond the edge: {got}, not {expected}"
                );
            }
            for i in 0..WIDTH * HEIGHT {
                assert!(gel_depth[i] - depth[i] >= block(i) - 1e-8);
            }
            assert!(
                (indentation(50) - 1e-3).abs() < 1e-8
                    && indentation(WIDTH - 1) < 1e-7 + 1e-3 * (-k * 130.0).exp() as f32
            );
        }
    }
}
