//! Wavefront OBJ, through tobj. Materials, groups, normals and texture coordinates are ignored.

use glam::Vec3;

use super::{Defect, Mesh};

pub(super) fn parse(bytes: &[u8]) -> Result<Mesh, Defect> {
    let options =
        tobj::LoadOptions { triangulate: true, ignore_points: true, ignore_lines: true, ..Default::default() };
    // A material library is a second file that we have no use for.
    let no_materials = |_: &std::path::Path| Ok(Default::default());
    // Names of groups may be in any encoding; nothing that matters here is outside ASCII.
    let text = String::from_utf8_lossy(bytes);
    let (models, _) =
        tobj::load_obj_buf(&mut text.as_bytes(), &options, no_materials).map_err(|error| match error {
            tobj::LoadError::FaceVertexOutOfBounds => Defect::Syntax("a face names a vertex that is not there".into()),
            error => Defect::Syntax(format!("not a valid OBJ file: {error}")),
        })?;
    let mut mesh = Mesh::default();
    for model in models {
        let first = mesh.vertices.len() as u32;
        let model = model.mesh;
        let shift = |corner: &[u32]| match *corner {
            // An index beyond u32 stays out of range, which repair reports.
            [a, b, c] => [a, b, c].map(|index| index.saturating_add(first)),
            _ => [u32::MAX; 3],
        };
        mesh.vertices.extend(model.positions.chunks_exact(3).map(|p| Vec3::new(p[0], p[1], p[2])));
        mesh.faces.extend(model.indices.chunks(3).map(shift));
    }
    Ok(mesh)
}
