//! Reads a file with the reader of its format.

use std::io;
use std::path::Path;

use crate::error::{Defect, MeshError};
use crate::limits::MAX_FILE_BYTES;
use crate::mesh::Mesh;
use crate::units::split_unit;
use crate::warning::{Finding, MeshWarning};
use crate::{obj, ply, stl};

/// Mesh file format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Format {
    /// Wavefront OBJ.
    Obj,
    /// Stereolithography, binary or text.
    Stl,
    /// Stanford polygons: text, binary little-endian or binary big-endian.
    Ply,
}

impl Format {
    /// Returns the format for the ending of a file name, in upper or lower case. A unit may stand behind the name.
    pub fn from_path(path: &Path) -> Option<Self> {
        let ending = split_unit(path).0.extension()?.to_str()?.to_ascii_lowercase();
        match ending.as_str() {
            "obj" => Some(Self::Obj),
            "stl" => Some(Self::Stl),
            "ply" => Some(Self::Ply),
            _ => None,
        }
    }
}

/// Reads a mesh in the units of the file, or in metres if the path gives the unit, as in `can.obj:cm`. Does not repair it (see
/// [`repair`](crate::repair())).
///
/// # Errors
/// [`MeshError`] if the file cannot be read or breaks its format.
pub fn read(path: &Path) -> Result<(Mesh, Vec<MeshWarning>), MeshError> {
    let name = path.display().to_string();
    let inner = || {
        let format = Format::from_path(path).ok_or(Defect::UnknownFormat)?;
        let (file, unit_m) = split_unit(path);
        let bytes = mvt_files::input::read(&file, MAX_FILE_BYTES).map_err(|error| match error.kind() {
            io::ErrorKind::FileTooLarge => Defect::FileTooLarge,
            _ => Defect::Io(error),
        })?;
        let (mut mesh, findings) = parse(&bytes, format)?;
        if let Some(unit_m) = unit_m {
            mesh.vertices.iter_mut().for_each(|v| *v = (v.as_dvec3() * unit_m).as_vec3());
        }
        Ok((mesh, findings))
    };
    named(inner(), &name)
}

/// Reads a mesh from memory. Errors and warnings contain `name`.
///
/// # Errors
/// [`MeshError`] if the bytes break the format.
pub fn read_bytes(bytes: &[u8], format: Format, name: &str) -> Result<(Mesh, Vec<MeshWarning>), MeshError> {
    let bytes_are_few = bytes.len() as u64 <= MAX_FILE_BYTES;
    named(if bytes_are_few { parse(bytes, format) } else { Err(Defect::FileTooLarge) }, name)
}

/// Adds the name of the file to findings and defects.
pub(super) fn named(
    found: Result<(Mesh, Vec<Finding>), Defect>,
    file: &str,
) -> Result<(Mesh, Vec<MeshWarning>), MeshError> {
    let (mesh, findings) = found.map_err(|defect| defect.of(file))?;
    let warning = |finding| MeshWarning { file: file.to_owned(), finding };
    Ok((mesh, findings.into_iter().map(warning).collect()))
}

fn parse(bytes: &[u8], format: Format) -> Result<(Mesh, Vec<Finding>), Defect> {
    let (mut mesh, findings) = match format {
        Format::Obj => obj::parse(bytes),
        Format::Stl => stl::parse(bytes),
        Format::Ply => ply::parse(bytes),
    }?;
    place_unknown_points(&mut mesh);
    Ok((mesh, findings))
}

/// Moves points that no face names to a vertex of a face if they are not finite. Some programs write points that they do not know as NaN.
fn place_unknown_points(mesh: &mut Mesh) {
    if mesh.vertices.iter().all(|v| v.is_finite()) {
        return;
    }
    let mut is_used = vec![false; mesh.vertices.len()];
    for &corner in mesh.faces.iter().flatten() {
        if let Some(is_used) = is_used.get_mut(corner as usize) {
            *is_used = true;
        }
    }
    let Some(&place) = mesh.faces.iter().flatten().find_map(|&corner| mesh.vertices.get(corner as usize)) else {
        return;
    };
    let unknown = mesh.vertices.iter_mut().zip(is_used).filter(|(v, is_used)| !is_used && !v.is_finite());
    unknown.for_each(|(v, _)| *v = place);
}
