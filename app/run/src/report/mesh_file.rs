//! Meshes as files.

use anyhow::{Context as _, Result};
use mvt_mesh::{Mesh, VertexProperties, encode_glb, encode_obj, encode_ply};
use mvt_picture::palette;

use super::Coordinates;

/// Encodes a binary PLY, little-endian, metres. A comment states the coordinates. With one error (metres) per vertex, the vertices have colours from pale
/// (no error) to dark red (5 mm and more).
pub fn ply(mesh: &Mesh, coordinates: Coordinates, errors_m: Option<&[f32]>) -> Vec<u8> {
    let colour =
        |k| palette::surface_error(errors_m.and_then(|errors_m| errors_m.get(k)).copied().unwrap_or(f32::INFINITY)).0;
    let colours: Option<Vec<[u8; 3]>> = errors_m.map(|_| (0..mesh.vertices.len()).map(colour).collect());
    let properties = VertexProperties { colours: colours.as_deref(), ..Default::default() };
    encode_ply(mesh, &comments(coordinates).each_ref().map(String::as_str), properties)
}

/// Encodes a binary PLY as [`ply`], with how well each vertex is known: its standard deviation, metres, `None` where it is a guess.
pub fn ply_with_deviations(mesh: &Mesh, coordinates: Coordinates, deviations_m: &[Option<f32>]) -> Vec<u8> {
    let properties = VertexProperties { deviations_m: Some(deviations_m), ..Default::default() };
    encode_ply(mesh, &comments(coordinates).each_ref().map(String::as_str), properties)
}

/// Encodes a Wavefront OBJ, metres. A comment states the coordinates.
pub fn obj(mesh: &Mesh, coordinates: Coordinates) -> String {
    encode_obj(mesh, &comments(coordinates).each_ref().map(String::as_str))
}

/// Encodes a GLB with the colours of the vertices (red, green, blue), metres.
///
/// # Errors
/// If the mesh is too large for the format.
pub fn glb(mesh: &Mesh, coordinates: Coordinates, colours: &[[u8; 3]]) -> Result<Vec<u8>> {
    encode_glb(mesh, &comments(coordinates).join(", "), Some(colours)).context("the mesh is too large for a GLB")
}

fn comments(coordinates: Coordinates) -> [String; 2] {
    ["metres".to_owned(), format!("coordinates {}", coordinates.name())]
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use mvt_mesh::{Format, read_bytes};

    use super::*;

    #[test]
    fn written_meshes_are_read_without_loss() {
        let mesh = Mesh {
            vertices: vec![Vec3::ZERO, Vec3::new(0.1, 1.0 / 3.0, -1e-7), Vec3::Y, Vec3::NEG_Z],
            faces: vec![[0, 1, 2], [0, 2, 3]],
        };
        for (bytes, format) in [
            (ply(&mesh, Coordinates::Object, Some(&[0.0, 0.001, f32::NAN, 1.0])), Format::Ply),
            (ply(&mesh, Coordinates::Field, None), Format::Ply),
            (obj(&mesh, Coordinates::Object).into_bytes(), Format::Obj),
        ] {
            assert_eq!(read_bytes(&bytes, format, "mesh").unwrap().0, mesh);
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh");
        for (bytes, stated) in [
            (ply(&mesh, Coordinates::Field, None), Some(Coordinates::Field)),
            (obj(&mesh, Coordinates::Object).into_bytes(), Some(Coordinates::Object)),
            (b"ply\ncomment made by hand\nend_header\ncomment coordinates file\n".to_vec(), None),
        ] {
            std::fs::write(&path, bytes).unwrap();
            assert_eq!(Coordinates::of_mesh_file(&path), stated);
        }
    }
}
