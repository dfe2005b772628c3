//! Reader for Wavefront OBJ, based on tobj. Ignores materials, groups, normals, texture coordinates, lines and points.

use std::borrow::Cow;

use glam::Vec3;

use crate::error::Defect;
use crate::mesh::Mesh;
use crate::polygon;
use crate::text::{self, Lines};
use crate::warning::Finding;

pub(super) fn parse(bytes: &[u8]) -> Result<(Mesh, Vec<Finding>), Defect> {
    let Needed { text, lines, surfaces } = Needed::of(&text::decoded(bytes));
    let options = tobj::LoadOptions { ignore_points: true, ignore_lines: true, ..Default::default() };
    // A material library is a second file, which is not needed.
    let no_materials = |_: &std::path::Path| Ok(Default::default());
    let mut rest = text.as_bytes();
    let (models, _) = tobj::load_obj_buf(&mut rest, &options, no_materials)
        .map_err(|error| explained(error, &text, text.len() - rest.len()))?;
    let mut mesh = Mesh::default();
    // Without names of groups there is at most one model.
    for tobj::Model { mesh: model, .. } in models {
        mesh.vertices.extend(model.positions.chunks_exact(3).map(|p| Vec3::new(p[0], p[1], p[2])));
        let mut corners = model.indices.as_slice();
        let triangles = vec![3; if model.face_arities.is_empty() { corners.len() / 3 } else { 0 }];
        for &count in model.face_arities.iter().chain(&triangles) {
            let Some((polygon, others)) = corners.split_at_checked(count as usize) else { break };
            polygon::triangulate(&mesh.vertices, polygon, &mut mesh.faces)?;
            corners = others;
        }
    }
    if mesh.faces.is_empty() && lines + surfaces > 0 {
        let found = if surfaces > 0 { "free-form surfaces" } else { "lines or points" };
        return Err(Defect::Syntax(format!("it has {found} but no faces; export it as polygons")));
    }
    Ok((mesh, if surfaces > 0 { vec![Finding::FreeFormSurfaces(surfaces)] } else { Vec::new() }))
}

/// The statements of a file that are needed, each on the line where it begins, as tobj reads them.
#[derive(Default)]
struct Needed {
    text: String,
    /// Number of lines and points.
    lines: usize,
    /// Number of free-form surfaces.
    surfaces: usize,
}

impl Needed {
    /// Keeps vertices and faces. tobj takes lines of three points for faces, does not join lines that end with a backslash, and computes
    /// with the numbers of texture coordinates and normals before it checks them.
    fn of(file: &[u8]) -> Self {
        let mut needed = Self::default();
        let mut lines = Lines::new(file);
        while let Some(line) = lines.next() {
            let mut statement = without_comment(line);
            let keyword = statement.split_ascii_whitespace().next().unwrap_or_default().trim_end_matches('\\');
            let keyword = keyword.to_ascii_lowercase();
            // "fo" is the older name of a face.
            let is_needed = matches!(keyword.as_str(), "v" | "f" | "fo");
            let mut end = "\n".to_owned();
            while is_needed && statement.trim_end().ends_with('\\') {
                let joined = statement.trim_end().trim_end_matches('\\').to_owned() + " ";
                statement = Cow::Owned(joined + &without_comment(lines.next().unwrap_or_default()));
                end.push('\n');
            }
            let mut words: Vec<&str> = statement.split_ascii_whitespace().skip(1).collect();
            match keyword.as_str() {
                "v" => {
                    // Colours, with or without opacity.
                    if words.len() >= 6 {
                        words.truncate(3);
                    }
                    needed.text += "v ";
                    needed.text += &words.join(" ");
                }
                "f" | "fo" => {
                    // The numbers of the texture coordinate and the normal stand behind that of the vertex.
                    words.iter_mut().for_each(|word| *word = word.split('/').next().unwrap_or_default());
                    needed.text += "f ";
                    needed.text += &words.join(" ");
                }
                "l" | "p" => needed.lines += 1,
                "surf" => needed.surfaces += 1,
                _ => {}
            }
            needed.text += &end;
        }
        needed
    }
}

fn without_comment(line: &[u8]) -> Cow<'_, str> {
    // Names of groups may have any encoding; all other text is ASCII.
    String::from_utf8_lossy(line.split(|&byte| byte == b'#').next().unwrap_or_default())
}

/// Explains an error of tobj, which stopped after `read` bytes of the text.
fn explained(error: tobj::LoadError, text: &str, read: usize) -> Defect {
    let before = text.get(..read).unwrap_or_default();
    let (number, line) = before.lines().enumerate().last().unwrap_or_default();
    let what = match error {
        tobj::LoadError::FaceVertexOutOfBounds => return missing_vertex(text),
        tobj::LoadError::PositionParseError => "is not three numbers with decimal points",
        tobj::LoadError::ScalingByZeroError => "has the weight 0",
        tobj::LoadError::ColorParseError => "has five numbers; a vertex has three",
        tobj::LoadError::FaceParseError => "is not a face of whole numbers",
        error => return Defect::Syntax(format!("line {}: {error}", number + 1)),
    };
    Defect::Syntax(format!("line {}: {} {what}", number + 1, text::quoted(line.as_bytes())))
}

/// Finds the face that names a vertex beyond the last one, or before the first.
fn missing_vertex(text: &str) -> Defect {
    let vertices = text.lines().filter(|line| line.starts_with('v')).count() as i128;
    let mut known = 0;
    for (number, line) in text.lines().enumerate() {
        known += i128::from(line.starts_with('v'));
        let corners =
            line.strip_prefix("f ").unwrap_or_default().split(' ').filter_map(|word| word.parse::<i128>().ok());
        for corner in corners {
            let vertex = if corner < 0 { known + 1 + corner } else { corner };
            if !(1..=vertices).contains(&vertex) {
                return Defect::Syntax(format!(
                    "line {}: a face names vertex {corner}, a vertex that does not exist; the file has {vertices}",
                    number + 1
                ));
            }
        }
    }
    Defect::Syntax("a face names a vertex that does not exist".into())
}
