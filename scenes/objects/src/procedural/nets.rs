//! Naive surface nets (Gibson 1998): a closed mesh of the zero set of a smooth field.

use nalgebra::Vector3;

use mvt_mesh::Mesh;

/// Meshes the zero set of `field`, which is negative inside, within a box that the surface must not leave. Moves the
/// vertices onto the zero set along the gradient. `cell_m` must be at most half of the thinnest wall.
pub(super) fn mesh(field: impl Fn(Vector3<f64>) -> f64, half_m: Vector3<f64>, cell_m: f64) -> Mesh {
    let size = half_m.map(|half| (2.0 * half / cell_m).ceil() as usize + 2);
    // Shifts the nodes off the middle; on a flat part of a shape, vertices would coincide.
    let position = |at: [usize; 3]| Vector3::from(at.map(|i| (i as f64 - 0.31) * cell_m)) - half_m;
    let place = |[x, y, z]: [usize; 3]| (z * size.y + y) * size.x + x;
    let indices = |margin: usize| {
        (0..size.z - margin)
            .flat_map(move |z| (0..size.y - margin).flat_map(move |y| (0..size.x - margin).map(move |x| [x, y, z])))
    };
    let values: Vec<f64> = indices(0).map(|at| field(position(at))).collect();

    let mut vertex_of = vec![None; values.len()];
    let mut vertices = Vec::new();
    for at in indices(1) {
        let corner = |i: usize| [at[0] + (i & 1), at[1] + (i >> 1 & 1), at[2] + (i >> 2)];
        let crossings: Vec<Vector3<f64>> = EDGES
            .iter()
            .filter_map(|&[a, b]| {
                let (a, b) = (corner(a), corner(b));
                let (from, to) = (values[place(a)], values[place(b)]);
                ((from < 0.0) != (to < 0.0)).then(|| position(a).lerp(&position(b), from / (from - to)))
            })
            .collect();
        if !crossings.is_empty() {
            let mean = crossings.iter().sum::<Vector3<f64>>() / crossings.len() as f64;
            vertex_of[place(at)] = Some(vertices.len() as u32);
            vertices.push(onto_surface(&field, mean, cell_m));
        }
    }

    let mut faces = Vec::new();
    for at in indices(1) {
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            if at[u] == 0 || at[v] == 0 {
                continue;
            }
            let mut end = at;
            end[axis] += 1;
            let (inside, end_inside) = (values[place(at)] < 0.0, values[place(end)] < 0.0);
            if inside == end_inside {
                continue;
            }
            // The four cells round the edge, counter-clockwise seen along the axis.
            let cell = |back_u: usize, back_v: usize| {
                let mut cell = at;
                cell[u] -= back_u;
                cell[v] -= back_v;
                vertex_of[place(cell)]
            };
            if let [Some(a), Some(b), Some(c), Some(d)] = [cell(1, 1), cell(0, 1), cell(0, 0), cell(1, 0)] {
                faces.extend(if inside { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] });
            }
        }
    }
    Mesh { vertices: vertices.iter().map(|v| glam::Vec3::new(v.x as f32, v.y as f32, v.z as f32)).collect(), faces }
}

/// Edges of a cell, as pairs of corners numbered by x + 2 y + 4 z.
const EDGES: [[usize; 2]; 12] =
    [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]];

/// Moves a point to the zero set by a few Newton steps. Stops before a step that would leave the cell.
fn onto_surface(field: &impl Fn(Vector3<f64>) -> f64, start: Vector3<f64>, cell_m: f64) -> Vector3<f64> {
    const STEP_M: f64 = 1e-6;
    let mut p = start;
    for _ in 0..6 {
        let value = field(p);
        let gradient = Vector3::from_fn(|axis, _| {
            let mut step = Vector3::zeros();
            step[axis] = STEP_M;
            (field(p + step) - field(p - step)) / (2.0 * STEP_M)
        });
        let next = p - gradient * (value / gradient.norm_squared().max(1e-6));
        if (next - start).norm() > cell_m {
            break;
        }
        p = next;
    }
    p
}
