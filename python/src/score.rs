//! Scores of shapes and poses against the truth.

use mambavitact::ShapeReport;
use mvt_frames::{Frame, Isometry, Object, World};
use mvt_metrics::{AddS, POINTS, TrueSurface};
use mvt_objects::catalogue;
use numpy::PyArray1;
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::arrays::{line, motion, numbers};
use crate::errors::{Kind, argument, detached, general};
use crate::mesh;

/// Scores a surface against an object, as `mambavitact score --json` does: F-score, precision and recall at 1 to 20 mm, and mean errors.
///
/// `mesh` is a path or a pair of arrays (vertices, faces), in metres. `object_from_mesh` (4 x 4) takes it to the frame of the object;
/// without it, it already lies there.
#[pyfunction]
#[pyo3(signature = (mesh, truth, object_from_mesh = None))]
pub fn score<'py>(
    py: Python<'py>,
    mesh: &Bound<'_, PyAny>,
    truth: &str,
    object_from_mesh: Option<&Bound<'_, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let mesh = mesh::read(mesh, "mesh")?;
    if mesh.area_m2() <= 0.0 {
        return Err(Kind::Argument.error("mesh: its surface has no area").into());
    }
    let motion: Isometry<Object, Object> =
        object_from_mesh.map_or(Ok(Isometry::identity()), |value| motion(value, "object_from_mesh"))?;
    let text = detached(py, || {
        let truth = catalogue::load(truth, &mut Vec::new()).map_err(argument)?;
        serde_json::to_string(&ShapeReport::new(&mesh, &truth.mesh, motion)).map_err(general)
    })?;
    py.import("json")?.call_method1("loads", (text,))
}

/// ADD-S (one-directional) and symmetric ADD-S of poses, millimetres.
type Errors<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

/// Returns ADD-S and symmetric ADD-S of poses (N, 4, 4), millimetres: two arrays float64 (N,).
#[pyfunction]
pub fn score_poses<'py>(
    py: Python<'py>,
    poses: &Bound<'_, PyAny>,
    true_poses: &Bound<'_, PyAny>,
    truth: &str,
) -> PyResult<Errors<'py>> {
    let estimated = read_poses::<Object, World>(poses, "poses", None)?;
    let true_poses = read_poses::<Object, World>(true_poses, "true_poses", Some(estimated.len()))?;
    let errors: Vec<AddS> = detached(py, || {
        let truth = catalogue::load(truth, &mut Vec::new()).map_err(argument)?;
        let surface = TrueSurface::new(&truth.mesh, POINTS, 0);
        let pairs = estimated.par_iter().zip(&true_poses);
        Ok(pairs.map(|(estimate, truth)| surface.add_s(truth.inverse() * *estimate)).collect())
    })?;
    let of = |error: fn(&AddS) -> f64| line(py, errors.iter().map(|e| 1e3 * error(e)).collect());
    Ok((of(|e| e.one_directional_m), of(|e| e.symmetric_m)))
}

fn read_poses<A: Frame, B: Frame>(
    value: &Bound<'_, PyAny>,
    name: &str,
    count: Option<usize>,
) -> PyResult<Vec<Isometry<A, B>>> {
    let array = numbers(value, name, &[count, Some(4), Some(4)])?;
    let pose = |(k, pose): (usize, ndarray::ArrayViewD<'_, f64>)| {
        let rows: [[f64; 4]; 4] = std::array::from_fn(|i| std::array::from_fn(|j| pose[[i, j]]));
        Ok(Isometry::from_matrix(&rows).map_err(|error| Kind::Argument.error(format!("{name}[{k}] is {error}")))?)
    };
    array.outer_iter().enumerate().map(pose).collect()
}
