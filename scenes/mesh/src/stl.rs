//! Reader for STL, binary and text. Allocates memory for the data in the file, never for the count in the header.

use glam::Vec3;

use crate::error::Defect;
use crate::mesh::Mesh;

const HEADER_BYTES: usize = 84;
const TRIANGLE_BYTES: usize = 50;

/// Reads both kinds. Recognises a binary file by its length, because many binary files begin with "solid" like text
/// files.
pub(super) fn parse(bytes: &[u8]) -> Result<Mesh, Defect> {
    let Some((header, body)) = bytes.split_at_checked(HEADER_BYTES) else { return parse_text(bytes) };
    let count = header.last_chunk().map_or(0, |&count| u32::from_le_bytes(count));
    if body.len() as u64 == u64::from(count) * TRIANGLE_BYTES as u64 {
        return Ok(soup(body.chunks_exact(TRIANGLE_BYTES).flat_map(|triangle| {
            // Skips the normal (first twelve bytes), which follows from the corners, and the attributes (last two
            // bytes).
            triangle[12..48].chunks_exact(12).map(point)
        })));
    }
    if is_text(bytes) {
        return parse_text(bytes);
    }
    Err(Defect::WrongLength {
        promised: format!("{count} triangles"),
        held: format!("{} bytes, enough for {}", body.len(), body.len() / TRIANGLE_BYTES),
    })
}

fn point(bytes: &[u8]) -> Vec3 {
    let number = |i: usize| bytes.get(4 * i..4 * i + 4).and_then(|b| b.try_into().ok()).map_or(0.0, f32::from_le_bytes);
    Vec3::new(number(0), number(1), number(2))
}

/// Returns whether a facet follows after "solid". In a damaged binary file whose header begins with "solid", none does.
fn is_text(bytes: &[u8]) -> bool {
    let start = &bytes[..bytes.len().min(1024)];
    bytes.trim_ascii_start().starts_with(b"solid") && start.windows(5).any(|word| word == b"facet")
}

fn parse_text(bytes: &[u8]) -> Result<Mesh, Defect> {
    let text = String::from_utf8_lossy(bytes);
    if !text.trim_start().starts_with("solid") {
        return Err(Defect::Syntax("neither a text STL (no \"solid\") nor a binary one (under 84 bytes)".into()));
    }
    let mut corners = Vec::new();
    let (mut in_facet, mut ended) = (0, false);
    for (number, line) in text.lines().enumerate() {
        let at = |what: &str| Defect::Syntax(format!("line {}: {what}", number + 1));
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("facet") => in_facet = 0,
            Some("vertex") => {
                let mut number = || words.next().and_then(|word| word.parse::<f32>().ok());
                let (Some(x), Some(y), Some(z)) = (number(), number(), number()) else {
                    return Err(at("a vertex is not three numbers"));
                };
                corners.push(Vec3::new(x, y, z));
                in_facet += 1;
            }
            Some("endfacet") if in_facet != 3 => return Err(at("a facet does not have three vertices")),
            Some("endsolid") => ended = true,
            _ => {}
        }
    }
    if !ended || corners.len() % 3 != 0 {
        return Err(Defect::Syntax("the text ends before \"endsolid\"; the file is cut off".into()));
    }
    Ok(soup(corners.into_iter()))
}

/// Makes a mesh of three vertices per face, without shared vertices.
fn soup(corners: impl Iterator<Item = Vec3>) -> Mesh {
    let vertices: Vec<Vec3> = corners.collect();
    let faces = (0..vertices.len() as u32 / 3).map(|face| [3 * face, 3 * face + 1, 3 * face + 2]).collect();
    Mesh { vertices, faces }
}
