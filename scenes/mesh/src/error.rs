//! Errors about meshes.

use crate::limits::{MAX_EXTENT_M, MAX_FILE_BYTES, MILLIMETRES_ABOVE_M, MIN_EXTENT_M};

/// Unusable mesh file, with its defect.
#[derive(Debug, thiserror::Error)]
#[error("{file}: {defect}")]
pub struct MeshError {
    /// File, as the user named it.
    pub file: String,
    /// Defect of the file.
    pub defect: Defect,
}

/// Defect of a mesh file. A message says what to do where the defect does not imply it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Defect {
    /// The file could not be read.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// The file name has no ending of a known [`Format`](crate::Format).
    #[error("unknown mesh format; give an .obj, .stl or .ply file")]
    UnknownFormat,
    /// The file is larger than [`MAX_FILE_BYTES`].
    #[error("it has more than {MAX_FILE_BYTES} bytes; simplify the mesh")]
    FileTooLarge,
    /// The amount of data differs from the header.
    #[error("the header promises {promised}, but the file has {held}; it is cut off or damaged")]
    WrongLength {
        /// Amount of data according to the header.
        promised: String,
        /// Amount of data in the file.
        held: String,
    },
    /// The text or structure breaks the format.
    #[error("{0}")]
    Syntax(String),
    /// A coordinate is NaN or infinite.
    #[error("vertex {vertex} has a coordinate that is not a finite number")]
    NotFinite {
        /// Index of the vertex, from 0.
        vertex: usize,
    },
    /// A face names a vertex that does not exist.
    #[error("face {face} names vertex {index}, but there are {vertices} vertices")]
    IndexOutOfRange {
        /// Index of the face, from 0.
        face: usize,
        /// Index of the vertex that it names, from 0.
        index: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// The mesh has no face with an area.
    #[error("it has no faces with an area")]
    NoFaces,
    /// The surface is one-sided, as a Moebius strip, and has no inside.
    #[error("its faces cannot be made to agree on an outside")]
    NotOrientable,
    /// The size does not tell the unit of the file.
    #[error(
        "its largest side is {} units: centimetres, millimetres or inches? give the unit behind the name of the file, as in can.obj:cm \
         (or :mm, :in)",
        *extent as f32
    )]
    AmbiguousUnit {
        /// Largest side in the units of the file.
        extent: f64,
    },
    /// The size is out of range for a hand, also after the conversion from millimetres.
    #[error(
        "its largest side is {:.3} mm, but it must be from {:.0} to {:.0} mm; scale it, or give its unit behind the name of the \
         file, as in can.obj:cm (without, units are metres, or millimetres if the largest side is above {MILLIMETRES_ABOVE_M})",
        extent_m * 1e3,
        MIN_EXTENT_M * 1e3,
        MAX_EXTENT_M * 1e3
    )]
    Size {
        /// Largest side of the bounding box, metres.
        extent_m: f64,
    },
}

impl Defect {
    /// Adds the name of the file to the defect.
    pub fn of(self, file: &str) -> MeshError {
        MeshError { file: file.to_owned(), defect: self }
    }
}
