//! Meshes: a path, or arrays of vertices and faces.

use std::path::PathBuf;

use glam::Vec3;
use mvt_mesh::Mesh;
use numpy::PyArrayDyn;
use pyo3::prelude::*;

use crate::arrays::{indices, shaped, singles};
use crate::errors::{Kind, file};

/// Vertices (N, 3) in metres and faces (M, 3).
pub type MeshArrays<'py> = (Bound<'py, PyArrayDyn<f32>>, Bound<'py, PyArrayDyn<u32>>);

/// Reads the path of an OBJ, STL or PLY file, or a pair of arrays.
pub fn read(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Mesh> {
    if let Ok(path) = value.extract::<PathBuf>() {
        let (mesh, warnings) = mvt_mesh::read(&path).map_err(file)?;
        let warn = value.py().import("warnings")?.getattr("warn")?;
        warnings.iter().try_for_each(|warning| warn.call1((warning.to_string(),)).map(drop))?;
        return Ok(mesh);
    }
    let (vertices, faces): (Bound<'_, PyAny>, Bound<'_, PyAny>) = value
        .extract()
        .map_err(|_| Kind::Argument.error(format!("{name}: expected a path or a pair of arrays (vertices, faces)")))?;
    let vertices = singles(&vertices, &format!("{name}[0], the vertices"), &[None, Some(3)])?;
    let faces = indices(&faces, &format!("{name}[1], the faces"), &[None, Some(3)])?;
    let count = vertices.shape()[0];
    if let Some(wrong) = faces.iter().find(|&&corner| usize::try_from(corner).map_or(true, |corner| corner >= count)) {
        return Err(Kind::Argument
            .error(format!("{name}: a face has the corner {wrong}, but there are {count} vertices"))
            .into());
    }
    let mesh = Mesh {
        vertices: vertices.rows().into_iter().map(|v| Vec3::new(v[0], v[1], v[2])).collect(),
        faces: faces.rows().into_iter().map(|f| [f[0] as u32, f[1] as u32, f[2] as u32]).collect(),
    };
    mvt_mesh::check(&mesh).map_err(|defect| Kind::Argument.error(format!("{name}: {defect}")))?;
    Ok(mesh)
}

/// Returns a mesh as arrays.
pub fn arrays(py: Python<'_>, mesh: Mesh) -> MeshArrays<'_> {
    let vertices: Vec<f32> = mesh.vertices.iter().flat_map(Vec3::to_array).collect();
    let faces = mesh.faces.concat();
    (shaped(py, vertices, &[mesh.vertices.len(), 3]), shaped(py, faces, &[mesh.faces.len(), 3]))
}
