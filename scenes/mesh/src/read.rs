//! Reads a file with the reader of its format.

use std::io::Read as _;
use std::path::Path;

use crate::error::{Defect, MeshError};
use crate::limits::MAX_FILE_BYTES;
use crate::mesh::Mesh;
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
    /// Returns the format for the ending of a file name, in upper or lower case.
    pub fn from_path(path: &Path) -> Option<Self> {
        let ending = path.extension()?.to_str()?.to_ascii_lowercase();
        match ending.as_str() {
            "obj" => Some(Self::Obj),
            "stl" => Some(Self::Stl),
            "ply" => Some(Self::Ply),
            _ => None,
        }
    }
}

/// Reads a mesh in the units of the file. Does not repair it (see [`repair`](crate::repair())).
///
/// # Errors
/// [`MeshError`] if the file cannot be read or breaks its format.
pub fn read(path: &Path) -> Result<Mesh, MeshError> {
    let name = path.display().to_string();
    let inner = || -> Result<Mesh, Defect> {
        let format = Format::from_path(path).ok_or(Defect::UnknownFormat)?;
        let mut bytes = Vec::new();
        // Limits the bytes that are read, because the file may grow meanwhile.
        mvt_files::input::open(path)?.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes)?;
        parse(&bytes, format)
    };
    inner().map_err(|defect| defect.of(&name))
}

/// Reads a mesh from memory. Errors contain `name`.
///
/// # Errors
/// [`MeshError`] if the bytes break the format.
pub fn read_bytes(bytes: &[u8], format: Format, name: &str) -> Result<Mesh, MeshError> {
    parse(bytes, format).map_err(|defect| defect.of(name))
}

fn parse(bytes: &[u8], format: Format) -> Result<Mesh, Defect> {
    let size = bytes.len() as u64;
    if size > MAX_FILE_BYTES {
        return Err(Defect::FileTooLarge { bytes: size });
    }
    match format {
        Format::Obj => obj::parse(bytes),
        Format::Stl => stl::parse(bytes),
        Format::Ply => ply::parse(bytes),
    }
}
