//! Warnings about meshes.

use std::fmt;

use crate::mesh::EdgeCount;

/// Change of a mesh by [`read`](crate::read()) or [`repair`](crate::repair()), or a fault that they left. The caller shows it.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct MeshWarning {
    /// File, as the user named it.
    pub file: String,
    /// Change or fault.
    pub finding: Finding,
}

/// Change or fault that [`read`](crate::read()) or [`repair`](crate::repair()) reports.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Finding {
    /// The file was in millimetres.
    ScaledFromMillimetres {
        /// Largest side in the units of the file.
        extent: f64,
    },
    /// Vertices at open edges that lay close together were merged.
    Seams {
        /// Number of vertices that were replaced by others.
        merged: usize,
        /// Greatest distance to the other vertex, in the units of the file.
        distance: f64,
    },
    /// Lines of a text have more numbers than the header says; those at their ends were ignored.
    SurplusNumbers {
        /// First of these lines, from 1.
        line: usize,
        /// Number of these lines.
        count: usize,
    },
    /// The header of a binary STL file does not know the number of triangles.
    Uncounted {
        /// Number in the header.
        promised: u32,
        /// Number of triangles in the file.
        held: usize,
    },
    /// Bytes after the last triangle were ignored.
    TrailingBytes(usize),
    /// Free-form surfaces were ignored.
    FreeFormSurfaces(usize),
    /// The mesh lies so far from the origin that single precision rounds its coordinates visibly.
    FarFromOrigin {
        /// Greatest coordinate, metres.
        reach_m: f64,
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
                write!(
                    f,
                    "{file}: largest side is {} units, so the file is in millimetres; scaled by 0.001",
                    extent as f32
                )
            }
            Finding::Seams { merged, distance } => {
                write!(
                    f,
                    "{file}: merged {merged} vertices at open edges with others at most {distance:.1e} units away"
                )
            }
            Finding::SurplusNumbers { line, count } => write!(
                f,
                "{file}: ignored numbers at the end of {count} line(s), because the header names fewer; the first is line {line}"
            ),
            Finding::Uncounted { promised, held } => {
                write!(f, "{file}: the header promises {promised} triangles; read all {held} in the file")
            }
            Finding::TrailingBytes(n) => write!(f, "{file}: ignored {n} byte(s) after the last triangle"),
            Finding::FreeFormSurfaces(n) => {
                write!(f, "{file}: ignored {n} free-form surface(s); export them as polygons")
            }
            Finding::FarFromOrigin { reach_m } => write!(
                f,
                "{file}: coordinates of up to {reach_m:.0} m are rounded to {:.3} mm; move the mesh to the origin",
                1e3 * reach_m * f64::from(f32::EPSILON)
            ),
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
