//! Shapes of a run for the page: thinned out, quantised, with their errors.

use std::collections::HashMap;
use std::path::Path;

use glam::{IVec3, Vec3, Vec3A};
use mvt_frames::Point;
use mvt_mesh::{Mesh, SignedDistance as _};
use mvt_objects::distance::MeshDistance;
use mvt_recording::Recording;
use mvt_run::report::file;
use serde_json::{Value, json};

use crate::encode::base64;

/// Most vertices of a shape on the page.
const MOST_VERTICES: usize = 3500;
/// Error that has the darkest colour, metres.
const ERROR_SCALE_M: f64 = 0.005;
/// Steps of a quantised coordinate.
const STEPS: f32 = 65535.0;

/// The shapes of a run, in the coordinates of the true object.
#[derive(Debug, Clone, PartialEq)]
pub struct PageShapes {
    /// The estimated shape, as the page reads it.
    pub estimate: Value,
    /// The true shape.
    pub truth: Option<Value>,
}

impl PageShapes {
    /// Reads the estimated shape of a run and its true one, if it was recorded. `None` if the run left no estimate.
    ///
    /// # Errors
    /// A line that names the file and the problem.
    pub fn read(folder: &Path, recording: Option<&Recording>) -> Result<Option<Self>, String> {
        let path = folder.join(file::PLY);
        if !path.exists() {
            return Ok(None);
        }
        let mut estimate = mvt_mesh::read(&path).map_err(|error| error.to_string())?;
        mvt_mesh::check(&estimate).map_err(|defect| format!("{}: {defect}", path.display()))?;
        let truth = recording.and_then(Recording::true_mesh);
        let moments = recording.map(Recording::moments).unwrap_or_default();
        let motion =
            moments.iter().rev().find_map(|moment| Some(moment.row.truth?.inverse() * moment.estimate()?));
        let (Some(truth), Some(motion)) = (truth, motion) else {
            return Ok(Some(Self { estimate: encoded(&thinned(&estimate), None), truth: None }));
        };
        let (rotation, translation) = motion.to_f32();
        for vertex in &mut estimate.vertices {
            *vertex = Vec3::from(rotation * Vec3A::from(*vertex) + translation);
        }
        let estimate = thinned(&estimate);
        let errors_m = MeshDistance::new(truth).map(|surface| {
            let error = |v: &Vec3| {
                let [x, y, z] = v.to_array().map(f64::from);
                surface.distance_m(Point::new(x, y, z)).abs()
            };
            estimate.vertices.iter().map(error).collect::<Vec<f64>>()
        });
        Ok(Some(Self {
            estimate: encoded(&estimate, errors_m.as_deref()),
            truth: Some(encoded(&thinned(truth), None)),
        }))
    }
}

/// Merges the vertices of each cell of a grid, the finest that leaves few enough, if their normals have the same main
/// axis: so the two sides of a thin wall stay apart. The vertex nearest to the mean remains at its place, so that corners
/// stay sharp.
fn thinned(mesh: &Mesh) -> Mesh {
    let mut cell_m = mesh.extents_m().max_element() / 250.0;
    let sides = sides(mesh);
    loop {
        let thin = with_cells(mesh, &sides, cell_m);
        // Faces of a mesh whose vertices are spread out vanish at last.
        if thin.vertices.len() <= MOST_VERTICES || thin.faces.is_empty() {
            return thin;
        }
        cell_m *= (thin.vertices.len() as f32 / MOST_VERTICES as f32).sqrt().max(1.03);
    }
}

/// Returns the main axis of the normal of each vertex, 0 to 2 for x to z, 3 to 5 for the negative directions.
fn sides(mesh: &Mesh) -> Vec<usize> {
    let mut normals = vec![Vec3::ZERO; mesh.vertices.len()];
    for (face, [a, b, c]) in mesh.faces.iter().zip(mesh.triangles()) {
        for &corner in face {
            if let Some(normal) = normals.get_mut(corner as usize) {
                *normal += (b - a).cross(c - a);
            }
        }
    }
    let side = |normal: Vec3| {
        let axis = normal.abs().max_position();
        if normal.to_array()[axis] < 0.0 { axis + 3 } else { axis }
    };
    normals.into_iter().map(side).collect()
}

/// Merges vertices of one cell and side.
fn with_cells(mesh: &Mesh, sides: &[usize], cell_m: f32) -> Mesh {
    let [low, _] = mesh.bounds_m();
    let cell = |v: Vec3| if cell_m > 0.0 { ((v - low) / cell_m).floor().as_ivec3() } else { IVec3::ZERO };
    let keys: Vec<(IVec3, usize)> = mesh.vertices.iter().zip(sides).map(|(&v, &side)| (cell(v), side)).collect();
    let mut sums = HashMap::<(IVec3, usize), (Vec3, f32)>::new();
    for (&v, &key) in mesh.vertices.iter().zip(&keys) {
        let (sum, count) = sums.entry(key).or_default();
        *sum += v;
        *count += 1.0;
    }
    let mut nearest = HashMap::<(IVec3, usize), (f32, Vec3)>::new();
    for (&v, &key) in mesh.vertices.iter().zip(&keys) {
        let distance = sums.get(&key).map_or(0.0, |(sum, count)| (*sum / *count).distance_squared(v));
        let kept = nearest.entry(key).or_insert((distance, v));
        if distance < kept.0 {
            *kept = (distance, v);
        }
    }
    let mut thin = Mesh::default();
    let mut index = HashMap::<(IVec3, usize), u32>::new();
    for face in &mesh.faces {
        let [Some(a), Some(b), Some(c)] = face.map(|corner| keys.get(corner as usize)) else { continue };
        if a == b || b == c || c == a {
            continue;
        }
        thin.faces.push([*a, *b, *c].map(|key| {
            *index.entry(key).or_insert_with(|| {
                thin.vertices.push(nearest.get(&key).map_or(Vec3::ZERO, |(_, v)| *v));
                thin.vertices.len() as u32 - 1
            })
        }));
    }
    thin
}

/// Encodes a mesh: coordinates as 16-bit steps from the lowest corner, errors as 8-bit steps to 5 mm, and faces.
fn encoded(mesh: &Mesh, errors_m: Option<&[f64]>) -> Value {
    let [low, high] = mesh.bounds_m();
    let step_m = ((high - low).max_element() / STEPS).max(f32::MIN_POSITIVE);
    let mut positions = Vec::with_capacity(6 * mesh.vertices.len());
    for vertex in &mesh.vertices {
        let steps = ((*vertex - low) / step_m).round().to_array();
        positions.extend(steps.iter().flat_map(|step| (*step as u16).to_le_bytes()));
    }
    let corners: Vec<u8> = mesh.faces.iter().flatten().flat_map(|corner| (*corner as u16).to_le_bytes()).collect();
    let errors = errors_m.map(|errors| {
        let bytes: Vec<u8> = errors.iter().map(|error| (255.0 * error / ERROR_SCALE_M).round() as u8).collect();
        base64(&bytes)
    });
    json!({
        "low_mm": low.to_array().map(|x| f64::from(x) * 1e3),
        "step_mm": f64::from(step_m) * 1e3,
        "positions": base64(&positions),
        "faces": base64(&corners),
        "errors": errors,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on a sphere of 30 mm, joined along meridians and parallels.
    fn sphere(rows: u32) -> Mesh {
        let columns = 2 * rows;
        let point = |row: u32, column: u32| {
            let (polar, around) =
                (std::f32::consts::PI * row as f32 / rows as f32, std::f32::consts::TAU * column as f32 / columns as f32);
            0.03 * Vec3::new(polar.sin() * around.cos(), polar.sin() * around.sin(), polar.cos())
        };
        let vertices = (0..=rows).flat_map(|row| (0..columns).map(move |column| point(row, column))).collect();
        let at = |row: u32, column: u32| row * columns + column % columns;
        let faces = (0..rows).flat_map(|row| {
            (0..columns).flat_map(move |k| {
                [[at(row, k), at(row + 1, k), at(row, k + 1)], [at(row, k + 1), at(row + 1, k), at(row + 1, k + 1)]]
            })
        });
        Mesh { vertices, faces: faces.collect() }
    }

    #[test]
    fn thin_shapes_keep_their_place_and_size() {
        let sphere = sphere(100);
        let thin = thinned(&sphere);
        assert!((1000..=MOST_VERTICES).contains(&thin.vertices.len()), "{}", thin.vertices.len());
        assert!(thin.vertices.iter().all(|v| (v.length() - 0.03).abs() < 1e-6));
        assert!((thin.volume_m3() / sphere.volume_m3() - 1.0).abs() < 0.02);
        assert_eq!(thinned(&Mesh::default()), Mesh::default());
    }

    #[test]
    fn a_shape_without_extent_has_no_faces() {
        let point = Mesh { vertices: vec![Vec3::ONE; 5000], faces: vec![[0, 1, 2]; 10] };
        assert!(thinned(&point).faces.is_empty());
    }

    #[test]
    fn quantised_shapes_are_exact_to_some_micrometres() {
        let mesh = Mesh { vertices: vec![Vec3::ZERO, 0.1 * Vec3::X, 0.05 * Vec3::Y], faces: vec![[0, 1, 2]] };
        let value = encoded(&mesh, Some(&[0.0, 0.0025, 9.0]));
        // 0, 65535 and 32768 (0x8000) steps along the axes; 0, 128 and 255 of 255.
        let positions = [0, 0, 0, 0, 0, 0, 0xff, 0xff, 0, 0, 0, 0, 0, 0, 0x00, 0x80, 0, 0];
        assert_eq!(value["positions"], base64(&positions));
        assert_eq!(value["faces"], base64(&[0, 0, 1, 0, 2, 0]));
        assert_eq!(value["errors"], base64(&[0, 128, 255]));
        assert!((value["step_mm"].as_f64().unwrap() * 65535.0 - 100.0).abs() < 1e-3);
    }
}
