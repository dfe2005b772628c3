//! Meshes as files.

use std::fmt::Write as _;

use mvt_mesh::Mesh;
use mvt_picture::palette;

use super::Coordinates;

/// Encodes a binary PLY, little-endian, metres. A comment states the coordinates. With one error (metres) per vertex, the vertices have colours from pale
/// (no error) to dark red (5 mm and more).
pub fn ply(mesh: &Mesh, coordinates: Coordinates, errors_m: Option<&[f32]>) -> Vec<u8> {
    let colours =
        if errors_m.is_some() { "property uchar red\nproperty uchar green\nproperty uchar blue\n" } else { "" };
    let header = format!(
        "ply\nformat binary_little_endian 1.0\ncomment metres\ncomment coordinates {}\nelement vertex {}\nproperty float x\nproperty float y\n\
         property float z\n{colours}element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        coordinates.name(),
        mesh.vertices.len(),
        mesh.faces.len()
    );
    let mut bytes = header.into_bytes();
    for (k, vertex) in mesh.vertices.iter().enumerate() {
        bytes.extend(vertex.to_array().iter().flat_map(|x| x.to_le_bytes()));
        if let Some(errors_m) = errors_m {
            bytes.extend(palette::surface_error(errors_m.get(k).copied().unwrap_or(f32::INFINITY)).0);
        }
    }
    for face in &mesh.faces {
        bytes.push(3);
        bytes.extend(face.iter().flat_map(|v| v.to_le_bytes()));
    }
    bytes
}

/// Encodes a Wavefront OBJ, metres. A comment states the coordinates.
pub fn obj(mesh: &Mesh, coordinates: Coordinates) -> String {
    let mut text = format!("# metres\n# coordinates {}\n", coordinates.name());
    for v in &mesh.vertices {
        let _ = writeln!(text, "v {} {} {}", v.x, v.y, v.z);
    }
    for [a, b, c] in mesh.faces.iter().map(|face| face.map(|v| v + 1)) {
        let _ = writeln!(text, "f {a} {b} {c}");
    }
    text
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
            assert_eq!(read_bytes(&bytes, format, "mesh").unwrap(), mesh);
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
