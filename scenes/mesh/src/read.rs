//! From a file to a raw mesh: which reader, and the limits that all share.

use std::fs::File;
use std::io::Read as _;
use std::path::Path;

use super::{Defect, Mesh, MeshError, obj, ply, stl};

/// Largest mesh file that is read, bytes: 1.3 million triangles of binary STL. A hand-sized object needs a hundredth of it.
pub const MAX_FILE_BYTES: u64 = 64 << 20;

/// The formats that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Wavefront OBJ.
    Obj,
    /// Stereolithography, binary or text.
    Stl,
    /// Stanford polygons: text, binary little-endian or binary big-endian.
    Ply,
}

impl Format {
    /// The format that the ending of a file name stands for, whatever its case.
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

/// Reads a mesh as the file has it: in the file's units and not yet repaired (see [`super::repair`]).
///
/// # Errors
/// [`MeshError`] if the file cannot be read or breaks its format.
pub fn read(path: &Path) -> Result<Mesh, MeshError> {
    let name = path.display().to_string();
    let inner = || -> Result<Mesh, Defect> {
        let format = Format::from_path(path).ok_or(Defect::UnknownFormat)?;
        let mut bytes = Vec::new();
        // The limit holds for what is read, not for what the file system says: a pipe or /dev/zero has no length.
        File::open(path)?.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes)?;
        parse(&bytes, format)
    };
    inner().map_err(|defect| defect.of(&name))
}

/// Reads a mesh from memory; `name` stands for it in errors.
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
