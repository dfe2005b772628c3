//! Shapes of a run for the page: thinned out, quantised, with their errors.

use std::path::Path;

use glam::{Vec3, Vec3A};
use mvt_frames::Point;
use mvt_mesh::{Mesh, SignedDistance as _};
use mvt_objects::distance::MeshDistance;
use mvt_recording::Recording;
use mvt_run::report::{file, placed_shape};
use serde_json::{Value, json};

use crate::encode::base64;
use crate::thin::thinned;

/// Most vertices of a shape on the page.
const MOST_VERTICES: usize = 3500;
/// Most vertices that 16-bit indices tell apart.
const MOST_INDICES: usize = 1 << 16;
/// Error that has the darkest colour, metres.
const ERROR_SCALE_M: f64 = 0.005;
/// Steps of a quantised coordinate.
const STEPS: f32 = 65535.0;

/// The shapes of a run, in the coordinates of the true object.
#[derive(Debug, Clone, PartialEq)]
pub struct PageShapes {
    /// The estimated shape, as the page reads it.
    pub estimate: Value,
    /// The true shape, whole.
    pub truth: Option<Mesh>,
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
        let (mut estimate, _) = mvt_mesh::read(&path).map_err(|error| error.to_string())?;
        mvt_mesh::check(&estimate).map_err(|defect| format!("{}: {defect}", path.display()))?;
        let truth = recording.and_then(Recording::true_mesh);
        let moments = recording.map(Recording::moments).unwrap_or_default();
        let estimated = moments.iter().filter(|moment| moment.estimate().is_some()).map(|moment| &moment.row);
        let motion = placed_shape(estimated);
        let (Some(truth), Some(motion)) = (truth, motion) else {
            return Ok(Some(Self { estimate: page_shape(&estimate, None)?, truth: None }));
        };
        let (rotation, translation) = motion.to_f32();
        for vertex in &mut estimate.vertices {
            *vertex = Vec3::from(rotation * Vec3A::from(*vertex) + translation);
        }
        Ok(Some(Self {
            estimate: page_shape(&estimate, MeshDistance::new(truth).as_ref())?,
            truth: Some(truth.clone()),
        }))
    }
}

/// Thins out a mesh and returns it as the page reads it, with the distances of its vertices from a surface.
///
/// # Errors
/// If too many vertices remain.
pub fn page_shape(mesh: &Mesh, truth: Option<&MeshDistance>) -> Result<Value, String> {
    let thin = thinned(mesh, MOST_VERTICES);
    if thin.vertices.len() > MOST_INDICES {
        return Err(format!("{} vertices cannot be merged; weld the mesh", thin.vertices.len()));
    }
    let errors_m: Option<Vec<f64>> = truth.map(|surface| {
        let error = |v: &Vec3| {
            let [x, y, z] = v.to_array().map(f64::from);
            surface.distance_m(Point::new(x, y, z)).abs()
        };
        thin.vertices.iter().map(error).collect()
    });
    Ok(encoded(&thin, errors_m.as_deref()))
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

    #[test]
    fn shapes_with_more_vertices_than_indices_are_refused() {
        let single = Mesh { vertices: vec![Vec3::ZERO, 0.01 * Vec3::X, 0.01 * Vec3::Y], faces: vec![[0, 1, 2]] };
        let mut soup = Mesh::default();
        for k in 0..22_000 {
            soup.vertices.extend(single.vertices.iter().map(|v| *v + 1e-5 * k as f32 * Vec3::Z));
            soup.faces.push([0, 1, 2].map(|corner| corner + 3 * k));
        }
        assert!(page_shape(&soup, None).is_err());
        assert!(page_shape(&single, None).is_ok());
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
