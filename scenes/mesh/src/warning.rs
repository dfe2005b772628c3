//! Warnings about meshes.

use std::fmt;

use crate::mesh::EdgeCount;

/// Change of a mesh by [`repair`](crate::repair()), or a fault that it left. The caller shows it.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct MeshWarning {
    /// File, as the user named it.
    pub file: String,
    /// Change or fault.
    pub finding: Finding,
}

/// Change or fault that [`repair`](crate::repair()) reports.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Finding {
    /// The file was in millimetres.
    ScaledFromMillimetres {
        /// Largest side in the units of the file.
        extent: f64,
    },
    /// Faces without an area were dropped.
    DegenerateFaces(usize),
    /// Faces with the same three corners as another face were dropped.
    DuplicateFaces(usize),
    /// All but the largest connected part were dropped.
    Components {
        /// Number of dropped parts.
        dropped: usize,
        /// Their share of the whole area, 0 to 1.
        area_share: f64,
    },
    /// Faces were turned so that neighbours agree.
    InconsistentWinding(usize),
    /// The normals looked inward; all faces were turned.
    Inverted,
    /// The mesh encloses no volume. It was not changed, and collides as its convex hull.
    NotWatertight(EdgeCount),
}

impl fmt::Display for MeshWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let file = &self.file;
        match self.finding {
            Finding::ScaledFromMillimetres { extent } => {
                write!(f, "{file}: largest side is {extent} units, so the file is in millimetres; scaled by 0.001")
            }
            Finding::DegenerateFaces(n) => write!(f, "{file}: dropped {n} face(s) without area"),
            Finding::DuplicateFaces(n) => write!(f, "{file}: dropped {n} face(s) that were there twice"),
            Finding::Components { dropped, area_share } => write!(
                f,
                "{file}: kept the largest part; dropped {dropped} other(s), {:.2} % of the area",
                100.0 * area_share
            ),
            Finding::InconsistentWinding(n) => write!(f, "{file}: turned {n} face(s) to agree with their neighbours"),
            Finding::Inverted => write!(f, "{file}: normals looked inward; turned all faces"),
            Finding::NotWatertight(EdgeCount { open, crowded }) => {
                write!(
                    f,
                    "{file}: not watertight: {open} open edge(s), {crowded} edge(s) with more than two faces; the mesh \
                     is kept and collides as its convex hull"
                )
            }
        }
    }
}
