//! Meshes as bytes of OBJ and PLY files.

use std::fmt::Write as _;

use crate::mesh::Mesh;

/// Encodes a Wavefront OBJ that begins with comments, each of one line.
pub fn encode_obj(mesh: &Mesh, comments: &[&str]) -> String {
    let mut text: String = comments.iter().map(|comment| format!("# {comment}\n")).collect();
    for v in &mesh.vertices {
        let _ = writeln!(text, "v {} {} {}", v.x, v.y, v.z);
    }
    for [a, b, c] in mesh.faces.iter().map(|face| face.map(|v| v + 1)) {
        let _ = writeln!(text, "f {a} {b} {c}");
    }
    text
}

/// What a PLY states about the vertices of a mesh.
#[derive(Debug, Clone, Copy, Default)]
pub struct VertexProperties<'a> {
    /// Red, green and blue. A vertex without a colour is black.
    pub colours: Option<&'a [[u8; 3]]>,
    /// Standard deviation of the surface, metres; `None` where it is a guess. They become the properties `seen`, 0 or 1, and `deviation`, metres,
    /// which is infinite where nothing was seen.
    pub deviations_m: Option<&'a [Option<f32>]>,
}

/// Encodes a binary PLY, little-endian, with comments, each of one line.
pub fn encode_ply(mesh: &Mesh, comments: &[&str], properties: VertexProperties<'_>) -> Vec<u8> {
    let VertexProperties { colours, deviations_m } = properties;
    let comments: String = comments.iter().map(|comment| format!("comment {comment}\n")).collect();
    let mut channels = String::new();
    if colours.is_some() {
        channels += "property uchar red\nproperty uchar green\nproperty uchar blue\n";
    }
    if deviations_m.is_some() {
        channels += "property uchar seen\nproperty float deviation\n";
    }
    let header = format!(
        "ply\nformat binary_little_endian 1.0\n{comments}element vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         {channels}element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        mesh.vertices.len(),
        mesh.faces.len()
    );
    let mut bytes = header.into_bytes();
    for (k, vertex) in mesh.vertices.iter().enumerate() {
        bytes.extend(vertex.to_array().iter().flat_map(|x| x.to_le_bytes()));
        if let Some(colours) = colours {
            bytes.extend(colours.get(k).copied().unwrap_or_default());
        }
        if let Some(deviations_m) = deviations_m {
            let deviation_m = deviations_m.get(k).copied().flatten();
            bytes.push(deviation_m.is_some().into());
            bytes.extend(deviation_m.unwrap_or(f32::INFINITY).to_le_bytes());
        }
    }
    for face in &mesh.faces {
        bytes.push(3);
        bytes.extend(face.iter().flat_map(|v| v.to_le_bytes()));
    }
    bytes
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::{Format, read_bytes};

    #[test]
    fn encoded_meshes_are_read_without_loss() {
        let mesh = Mesh {
            vertices: vec![Vec3::ZERO, Vec3::new(0.1, 1.0 / 3.0, -1e-7), Vec3::Y, Vec3::NEG_Z],
            faces: vec![[0, 1, 2], [0, 2, 3]],
        };
        let all =
            VertexProperties { colours: Some(&[[1, 2, 3]; 4]), deviations_m: Some(&[None, Some(1e-3), None, None]) };
        for (bytes, format) in [
            (encode_ply(&mesh, &["metres"], all), Format::Ply),
            (encode_ply(&mesh, &[], VertexProperties::default()), Format::Ply),
            (encode_obj(&mesh, &["metres"]).into_bytes(), Format::Obj),
        ] {
            assert_eq!(read_bytes(&bytes, format, "mesh").unwrap(), (mesh.clone(), Vec::new()));
        }
    }
}
