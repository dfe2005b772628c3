//! Meshes as bytes of GLB files, the binary form of glTF 2.0.

use std::fmt::Write as _;

use glam::Vec3;

use crate::mesh::Mesh;

/// First bytes of a GLB, its version, and the kinds of its two parts.
const MAGIC: &[u8; 4] = b"glTF";
const VERSION: u32 = 2;
const JSON: &[u8; 4] = b"JSON";
const BINARY: &[u8; 4] = b"BIN\0";

/// Encodes a GLB in the coordinates of the mesh, metres, with a comment and the sRGB colours (red, green, blue) of the vertices. A vertex without
/// one is black. There is no material: some readers ignore the colours of vertices beside one. glTF takes y for the upward direction; nothing is turned. `None` for a mesh of 4 GB and more, which the format does not have.
pub fn encode_glb(mesh: &Mesh, comment: &str, colours: Option<&[[u8; 3]]>) -> Option<Vec<u8>> {
    let count = mesh.vertices.len();
    let mut binary: Vec<u8> = Vec::new();
    binary.extend(mesh.vertices.iter().flat_map(Vec3::to_array).flat_map(f32::to_le_bytes));
    binary.extend(normals(mesh).iter().flat_map(Vec3::to_array).flat_map(f32::to_le_bytes));
    if let Some(colours) = colours {
        let linear = (0..count).map(|k| colours.get(k).copied().unwrap_or_default().map(linear));
        binary.extend(linear.flat_map(|[r, g, b]| [r, g, b, 1.0]).flat_map(f32::to_le_bytes));
    }
    let faces_at = binary.len();
    binary.extend(mesh.faces.iter().flatten().flat_map(|vertex| vertex.to_le_bytes()));
    let [low, high] = if count == 0 { [Vec3::ZERO; 2] } else { mesh.bounds_m() };
    let mut views = String::new();
    let mut accessors = format!(
        r#"{{"bufferView":0,"componentType":5126,"count":{count},"type":"VEC3","min":[{},{},{}],"max":[{},{},{}]}},"#,
        low.x, low.y, low.z, high.x, high.y, high.z
    );
    let mut attributes = r#""POSITION":0,"NORMAL":1"#.to_owned();
    accessors.push_str(&accessor(1, "VEC3", 5126, count));
    for (k, size) in [12, 12, 16].into_iter().enumerate().take(if colours.is_some() { 3 } else { 2 }) {
        let _ = write!(
            views,
            r#"{{"buffer":0,"byteOffset":{},"byteLength":{},"target":34962}},"#,
            12 * k * count,
            size * count
        );
    }
    if colours.is_some() {
        attributes.push_str(r#","COLOR_0":2"#);
        accessors.push_str(&accessor(2, "VEC4", 5126, count));
    }
    let faces_view = if colours.is_some() { 3 } else { 2 };
    let indices = 3 * mesh.faces.len();
    accessors.push_str(accessor(faces_view, "SCALAR", 5125, indices).trim_end_matches(','));
    let _ = write!(views, r#"{{"buffer":0,"byteOffset":{faces_at},"byteLength":{},"target":34963}}"#, 4 * indices);
    let comment = comment.replace(['"', '\\'], "'").replace(char::is_control, " ");
    let mut json = format!(
        r#"{{"asset":{{"version":"2.0","generator":"MambaViTact: {comment}"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{{attributes}}},"indices":{faces_view}}}]}}],"accessors":[{accessors}],"bufferViews":[{views}],"buffers":[{{"byteLength":{}}}]}}"#,
        binary.len()
    )
    .into_bytes();
    // Parts end at multiples of four bytes.
    json.resize(json.len().next_multiple_of(4), b' ');
    let total = u32::try_from(12 + 8 + json.len() + 8 + binary.len()).ok()?;
    let mut bytes = Vec::with_capacity(total as usize);
    bytes.extend(MAGIC);
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend(total.to_le_bytes());
    for (kind, part) in [(JSON, json), (BINARY, binary)] {
        bytes.extend((part.len() as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend(part);
    }
    Some(bytes)
}

/// Unit normals of the vertices: sums of those of the faces by area.
fn normals(mesh: &Mesh) -> Vec<Vec3> {
    let mut sums = vec![Vec3::ZERO; mesh.vertices.len()];
    for (face, [a, b, c]) in mesh.faces.iter().zip(mesh.triangles()) {
        let normal = (b - a).cross(c - a);
        for vertex in face {
            if let Some(sum) = sums.get_mut(*vertex as usize) {
                *sum += normal;
            }
        }
    }
    sums.into_iter().map(|sum| sum.try_normalize().unwrap_or(Vec3::Z)).collect()
}

fn accessor(view: usize, shape: &str, component: u32, count: usize) -> String {
    format!(r#"{{"bufferView":{view},"componentType":{component},"count":{count},"type":"{shape}"}},"#)
}

/// Light of an sRGB level: colours of glTF's vertices are linear.
fn linear(level: u8) -> f32 {
    let s = f32::from(level) / 255.0;
    if s <= 0.04045 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(bytes: &[u8], at: usize) -> usize {
        u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize
    }

    #[test]
    fn parts_have_their_stated_lengths_and_contain_the_mesh() {
        let mesh = Mesh { vertices: vec![Vec3::ZERO, Vec3::new(0.1, 0.2, -0.3), Vec3::Y], faces: vec![[0, 1, 2]] };
        for colours in [None, Some(&[[255, 0, 128]; 3][..])] {
            let bytes = encode_glb(&mesh, "metres, \"y up\"", colours).unwrap();
            assert_eq!((&bytes[..4], number(&bytes, 4), number(&bytes, 8)), (&b"glTF"[..], 2, bytes.len()));
            let json_bytes = number(&bytes, 12);
            let json = std::str::from_utf8(&bytes[20..20 + json_bytes]).unwrap();
            let binary = &bytes[28 + json_bytes..];
            assert_eq!(number(&bytes, 20 + json_bytes), binary.len());
            assert!(json.contains(&format!(r#""buffers":[{{"byteLength":{}}}]"#, binary.len())), "{json}");
            assert_eq!(json.matches('{').count(), json.matches('}').count());
            assert_eq!(json.contains("COLOR_0"), colours.is_some());
            assert!(json.contains(r#""min":[0,0,-0.3],"max":[0.1,1,0]"#), "{json}");
            assert_eq!(f32::from_le_bytes(binary[12..16].try_into().unwrap()), 0.1);
            assert_eq!(&binary[binary.len() - 8..], [1, 0, 0, 0, 2, 0, 0, 0]);
        }
    }

    #[test]
    fn colours_are_linear() {
        assert_eq!((linear(0), linear(255)), (0.0, 1.0));
        assert!((linear(188) - 0.5).abs() < 0.01);
    }
}
