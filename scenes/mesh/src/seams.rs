//! Closes seams: vertices that different faces name at nearly the same place.

use std::collections::HashMap;

use glam::DVec3;

use crate::mesh::Mesh;
use crate::warning::Finding;

/// Greatest distance that is closed, as a share of the largest side: 20 micrometres of a can. A touch sensor resolves no less.
const WIDEST: f64 = 2e-4;
/// The same for files that are rounded to few decimals.
const WIDEST_OF_DECIMALS: f64 = 5e-4;

/// Merges the vertices of open edges at the least distance that closes the most of them. The distance begins at the rounding errors of
/// the coordinates; see [`WIDEST`] for its end. Closed surfaces have no open edges, so a thin gap between them stays.
///
/// Returns `None` if no distance helps.
pub(super) fn close(mesh: &Mesh) -> Option<(Mesh, Finding)> {
    let vertices: Vec<DVec3> = mesh.vertices.iter().map(|v| v.as_dvec3()).collect();
    let reach = vertices.iter().fold(0.0, |reach: f64, v| reach.max(v.abs().max_element()));
    let extent = f64::from(mesh.extents_m().max_element());
    let rounding = 2.0 * f64::from(f32::EPSILON) * reach;
    let decimals = decimal_step(&vertices).map_or(0.0, |step| (2.0 * step).min(WIDEST_OF_DECIMALS * extent));
    let widest = (WIDEST * extent).max(decimals).max(rounding);

    let open = open_vertices(mesh);
    let mut fewest = faults(mesh);
    let mut best = None;
    let mut distance = rounding;
    while distance > 0.0 && fewest > 0 {
        let (closed, merged) = merged(mesh, &vertices, &open, distance);
        if faults(&closed) < fewest {
            fewest = faults(&closed);
            best = Some((closed, Finding::Seams { merged, distance }));
        }
        if distance >= widest {
            break;
        }
        distance = (4.0 * distance).min(widest);
    }
    best
}

fn faults(mesh: &Mesh) -> usize {
    let edges = mesh.edges();
    edges.open + edges.crowded
}

/// Returns whether each vertex stands at an open edge.
fn open_vertices(mesh: &Mesh) -> Vec<bool> {
    let mut edges: HashMap<[u32; 2], u32> = HashMap::new();
    for &[a, b, c] in &mesh.faces {
        for [from, to] in [[a, b], [b, c], [c, a]] {
            *edges.entry([from.min(to), from.max(to)]).or_default() += 1;
        }
    }
    let mut is_open = vec![false; mesh.vertices.len()];
    for ([a, b], _) in edges.into_iter().filter(|&(_, faces)| faces == 1) {
        is_open[a as usize] = true;
        is_open[b as usize] = true;
    }
    is_open
}

/// Replaces open vertices by the first open one within the distance. Returns the number of replaced ones, too.
fn merged(mesh: &Mesh, vertices: &[DVec3], is_open: &[bool], distance: f64) -> (Mesh, usize) {
    let cell = |v: DVec3| (v / distance).floor().to_array().map(|x| x as i64);
    let mut kept: HashMap<[i64; 3], Vec<u32>> = HashMap::new();
    let mut count = 0;
    let mut index: Vec<u32> = (0..vertices.len() as u32).collect();
    for (i, &v) in vertices.iter().enumerate().filter(|&(i, _)| is_open[i]) {
        let [x, y, z] = cell(v);
        let around =
            (-1..=1).flat_map(|dx| (-1..=1).flat_map(move |dy| (-1..=1).map(move |dz| [x + dx, y + dy, z + dz])));
        let near = around.filter_map(|cell| kept.get(&cell)).flatten();
        match near.copied().filter(|&k| vertices[k as usize].distance(v) <= distance).min() {
            Some(first) => {
                index[i] = first;
                count += 1;
            }
            None => kept.entry([x, y, z]).or_default().push(i as u32),
        }
    }
    let faces = mesh.faces.iter().map(|face| face.map(|v| index[v as usize]));
    let faces = faces.filter(|[a, b, c]| a != b && b != c && c != a).collect();
    (Mesh { vertices: mesh.vertices.clone(), faces }, count)
}

/// Returns the last decimal place of coordinates that are rounded to at most six, such as 0.001; `None` if they have more.
fn decimal_step(vertices: &[DVec3]) -> Option<f64> {
    // A number that was rounded to f32 is a multiple only up to that rounding.
    let is_multiple = |x: f64| (x - x.round()).abs() <= f64::from(f32::EPSILON) * x.abs();
    (0..=6)
        .map(|places| 10_f64.powi(places))
        .find(|&per_unit| vertices.iter().all(|v| (*v * per_unit).to_array().into_iter().all(is_multiple)))
        .map(f64::recip)
}
