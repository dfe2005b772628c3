//! Reader for Wavefront OBJ, based on tobj. Ignores materials, groups, normals and texture coordinates.

use glam::Vec3;

use crate::error::Defect;
use crate::mesh::Mesh;

pub(super) fn parse(bytes: &[u8]) -> Result<Mesh, Defect> {
    let options =
        tobj::LoadOptions { triangulate: true, ignore_points: true, ignore_lines: true, ..Default::default() };
    // A material library is a second file, which is not needed.
    let no_materials = |_: &std::path::Path| Ok(Default::default());
    // Names of groups may have any encoding; all other text is ASCII.
    let text = String::from_utf8_lossy(bytes);
    // tobj computes with the numbers of texture coordinates and normals before it checks them, and overflows; they are not needed.
    let is_needed = |line: &&str| !line.trim_start().starts_with("vt") && !line.trim_start().starts_with("vn");
    let text: String = text.split_inclusive('\n').filter(is_needed).collect();
    let (models, _) =
        tobj::load_obj_buf(&mut text.as_bytes(), &options, no_materials).map_err(|error| match error {
            tobj::LoadError::FaceVertexOutOfBounds => {
                Defect::Syntax("a face names a vertex that does not exist".into())
            }
            error => Defect::Syntax(format!("not a valid OBJ file: {error}")),
        })?;
    let mut mesh = Mesh::default();
    for model in models {
        let first = mesh.vertices.len() as u32;
        let model = model.mesh;
        let shift = |corner: &[u32]| match *corner {
            // An index beyond u32 stays out of range, and repair reports it.
            [a, b, c] => [a, b, c].map(|index| index.saturating_add(first)),
            _ => [u32::MAX; 3],
        };
        mesh.vertices.extend(model.positions.chunks_exact(3).map(|p| Vec3::new(p[0], p[1], p[2])));
        mesh.faces.extend(model.indices.chunks(3).map(shift));
    }
    Ok(mesh)
}
