//! Reader for STL, binary and text. Allocates memory for the data in the file, never for the count in the header.

use glam::Vec3;

use crate::error::Defect;
use crate::mesh::Mesh;
use crate::text::{self, Lines};
use crate::warning::Finding;

const HEADER_BYTES: usize = 84;
const TRIANGLE_BYTES: usize = 50;
/// Bytes at the start of a file that show whether it is text.
const START: usize = 1024;

/// Reads both kinds. Recognises a binary file by its length or its control characters, because many binary files begin with "solid" like
/// text files.
pub(super) fn parse(bytes: &[u8]) -> Result<(Mesh, Vec<Finding>), Defect> {
    if let Some((header, body)) = bytes.split_at_checked(HEADER_BYTES) {
        let count = header.last_chunk().map_or(0, |&count| u32::from_le_bytes(count));
        if body.len() as u64 == u64::from(count) * TRIANGLE_BYTES as u64 || !is_text(&text::decoded(bytes)) {
            return parse_binary(count, body);
        }
    }
    Ok((parse_text(&text::decoded(bytes))?, Vec::new()))
}

fn parse_binary(count: u32, body: &[u8]) -> Result<(Mesh, Vec<Finding>), Defect> {
    let held = body.len() / TRIANGLE_BYTES;
    let mut findings = Vec::new();
    let triangles = match count {
        // Programs that write triangles as they come do not know the number beforehand.
        0 | u32::MAX if held > 0 => {
            findings.push(Finding::Uncounted { promised: count, held });
            held
        }
        count => count as usize,
    };
    let wrong_length = || Defect::WrongLength {
        promised: format!("{count} triangles"),
        held: format!("{} bytes, enough for {held}", body.len()),
    };
    let read = triangles.checked_mul(TRIANGLE_BYTES).and_then(|length| body.split_at_checked(length));
    let (read, trailing) = read.ok_or_else(wrong_length)?;
    // Padding and notes are not triangles; whole triangles mean that the count is wrong.
    if trailing.len() >= TRIANGLE_BYTES
        && trailing.len() % TRIANGLE_BYTES == 0
        && trailing.iter().any(|&byte| byte != 0)
    {
        return Err(wrong_length());
    }
    if !trailing.is_empty() {
        findings.push(Finding::TrailingBytes(trailing.len()));
    }
    // Skips the normal (first twelve bytes), which follows from the corners, and the attributes (last two bytes).
    let corners = read.chunks_exact(TRIANGLE_BYTES).flat_map(|triangle| triangle[12..48].chunks_exact(12).map(point));
    Ok((soup(corners), findings))
}

fn point(bytes: &[u8]) -> Vec3 {
    let number = |i: usize| bytes.get(4 * i..4 * i + 4).and_then(|b| b.try_into().ok()).map_or(0.0, f32::from_le_bytes);
    Vec3::new(number(0), number(1), number(2))
}

/// Returns whether the start of a file is text. The numbers of a binary file contain control characters.
fn is_text(bytes: &[u8]) -> bool {
    let start = &bytes[..bytes.len().min(START)];
    // Byte 26 marks the end of a text of DOS.
    !start.iter().any(|&byte| byte.is_ascii_control() && !byte.is_ascii_whitespace() && byte != 26)
}

fn parse_text(bytes: &[u8]) -> Result<Mesh, Defect> {
    let is = |word: &[u8], name: &str| word.eq_ignore_ascii_case(name.as_bytes());
    if !text::words(bytes).next().is_some_and(|word| is(word, "solid")) {
        let what = match bytes.len() {
            0..HEADER_BYTES => "it is neither text that begins with \"solid\" nor has the 84 bytes of a binary header",
            _ => "the text does not begin with \"solid\"",
        };
        return Err(Defect::Syntax(what.into()));
    }
    let mut corners = Vec::new();
    let (mut in_facet, mut ended) = (0, false);
    let mut lines = Lines::new(bytes);
    while let Some(line) = lines.next() {
        let at = |what: &str| Defect::Syntax(format!("line {}: {what}", lines.number));
        let mut words = text::words(line);
        while let Some(word) = words.next() {
            if is(word, "facet") {
                in_facet = 0;
            } else if is(word, "vertex") {
                let mut number = || words.next().and_then(text::number::<f32>);
                let (Some(x), Some(y), Some(z)) = (number(), number(), number()) else {
                    return Err(at(&format!("{} is not three numbers with decimal points", text::quoted(line))));
                };
                corners.push(Vec3::new(x, y, z));
                in_facet += 1;
            } else if is(word, "endfacet") {
                if in_facet != 3 {
                    return Err(at("a facet does not have three vertices"));
                }
            } else if is(word, "solid") || is(word, "endsolid") {
                ended |= is(word, "endsolid");
                // The rest of the line is a name.
                break;
            }
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
