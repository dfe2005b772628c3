//! Triangle meshes: what they are, how they are read and how they are repaired.

use std::fmt;

use glam::Vec3;
use mvt_frames::{Object, Point};

mod obj;
mod ply;
mod read;
mod repair;
mod stl;

pub use read::{Format, MAX_FILE_BYTES, read, read_bytes};
pub use repair::{MAX_EXTENT_M, MILLIMETRES_ABOVE_M, MIN_EXTENT_M, check, repair};

/// A shape that knows how far any point is from its surface.
pub trait SignedDistance: fmt::Debug + Send + Sync {
    /// Euclidean distance to the surface, metres, negative inside.
    fn distance_m(&self, p: Point<Object>) -> f64;
}

/// A triangle mesh: vertices in metres in the object's frame, faces counter-clockwise seen from outside.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// Positions, metres.
    pub vertices: Vec<Vec3>,
    /// Indices into `vertices`.
    pub faces: Vec<[u32; 3]>,
}

impl Mesh {
    /// The corners of every face, in the order of `faces`.
    ///
    /// # Panics
    /// If a face names a vertex that is not there, which no mesh that went through [`repair`] does.
    pub fn triangles(&self) -> impl ExactSizeIterator<Item = [Vec3; 3]> {
        self.faces.iter().map(|face| face.map(|v| self.vertices[v as usize]))
    }

    /// Area of the surface, m^2.
    pub fn area_m2(&self) -> f64 {
        self.triangles().map(triangle_area_m2).sum()
    }

    /// Signed volume by the divergence theorem, m^3: positive if the faces of a closed mesh look outward. For an open mesh it
    /// is the volume of the cone over the mesh from the centre of its bounding box.
    pub fn volume_m3(&self) -> f64 {
        let [low, high] = self.bounds_m();
        let centre = (low.as_dvec3() + high.as_dvec3()) * 0.5;
        let six_fold = |corners: [Vec3; 3]| {
            let [a, b, c] = corners.map(|corner| corner.as_dvec3() - centre);
            a.dot(b.cross(c))
        };
        self.triangles().map(six_fold).sum::<f64>() / 6.0
    }

    /// Lowest and highest corner of the bounding box of the vertices, metres; both zero if there are no vertices.
    pub fn bounds_m(&self) -> [Vec3; 2] {
        let Some(&first) = self.vertices.first() else { return [Vec3::ZERO; 2] };
        self.vertices.iter().fold([first; 2], |[low, high], &v| [low.min(v), high.max(v)])
    }

    /// Size along x, y and z, metres.
    pub fn extents_m(&self) -> Vec3 {
        let [low, high] = self.bounds_m();
        high - low
    }

    /// How the edges of the faces fit together.
    pub fn edges(&self) -> EdgeCount {
        let mut edges: Vec<[u32; 2]> = self
            .faces
            .iter()
            .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
            .map(|[a, b]| [a.min(b), a.max(b)])
            .collect();
        edges.sort_unstable();
        edges.chunk_by(|a, b| a == b).fold(EdgeCount::default(), |mut count, same| {
            match same.len() {
                1 => count.open += 1,
                2 => {}
                _ => count.crowded += 1,
            }
            count
        })
    }
}

/// The edges of a mesh that two faces do not share.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct EdgeCount {
    /// Edges of one face only: the rim of a hole.
    pub open: usize,
    /// Edges of three or more faces.
    pub crowded: usize,
}

impl EdgeCount {
    /// Whether the mesh encloses a volume: every edge belongs to exactly two faces.
    pub fn watertight(self) -> bool {
        self == Self::default()
    }
}

/// A mesh from points that were computed face by face: points within a tenth of a micrometre are one vertex.
pub fn weld(points: &[nalgebra::Vector3<f64>], faces: &[[u32; 3]]) -> Mesh {
    let grid = |metres: f64| (metres * 1e7).round() as i64;
    let mut known = std::collections::HashMap::new();
    let mut vertices = Vec::new();
    let mut index = Vec::with_capacity(points.len());
    for p in points {
        index.push(*known.entry([grid(p.x), grid(p.y), grid(p.z)]).or_insert_with(|| {
            vertices.push(Vec3::new(p.x as f32, p.y as f32, p.z as f32));
            vertices.len() as u32 - 1
        }));
    }
    let faces = faces.iter().map(|face| face.map(|v| index[v as usize]));
    Mesh { vertices, faces: faces.filter(|[a, b, c]| a != b && b != c && c != a).collect() }
}

/// Area of a triangle, m^2.
pub fn triangle_area_m2(corners: [Vec3; 3]) -> f64 {
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    0.5 * (b - a).cross(c - a).length()
}

/// A file that is no usable mesh: which file, and what is wrong with it.
#[derive(Debug, thiserror::Error)]
#[error("{file}: {defect}")]
pub struct MeshError {
    /// The file, as the user named it.
    pub file: String,
    /// What is wrong.
    pub defect: Defect,
}

/// What is wrong with a mesh file. Each message says what to do where that is not plain.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Defect {
    /// The file could not be read.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// Neither the name nor the content is of a format that is read here.
    #[error("not a mesh format that is read here; give an .obj, .stl or .ply file")]
    UnknownFormat,
    /// The file is larger than is read here.
    #[error("{bytes} bytes is more than the {MAX_FILE_BYTES} that are read; simplify the mesh")]
    FileTooLarge {
        /// Its size.
        bytes: u64,
    },
    /// The header promises other data than the file holds.
    #[error("the header promises {promised}, the file holds {held}; it is cut off or damaged")]
    WrongLength {
        /// What the header says.
        promised: String,
        /// What there is.
        held: String,
    },
    /// Text or structure that breaks the format.
    #[error("{0}")]
    Syntax(String),
    /// A coordinate is NaN or infinite.
    #[error("vertex {vertex} has a coordinate that is not a finite number")]
    NotFinite {
        /// Which vertex, from 0.
        vertex: usize,
    },
    /// A face names a vertex that does not exist.
    #[error("face {face} names vertex {index}, but there are {vertices} vertices")]
    IndexOutOfRange {
        /// Which face, from 0.
        face: usize,
        /// The vertex it names, from 0.
        index: u32,
        /// How many there are.
        vertices: usize,
    },
    /// There are no faces, or none with an area.
    #[error("it has no faces with an area")]
    NoFaces,
    /// A one-sided surface, such as a Moebius strip, has no inside.
    #[error("its faces cannot be made to agree on an outside")]
    NotOrientable,
    /// The size is outside of what a hand could turn, also after the rule for millimetres.
    #[error(
        "its largest side is {:.1} mm, outside {:.0} to {:.0} mm; scale it (units are metres, or millimetres if the largest side \
         is above {MILLIMETRES_ABOVE_M})",
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
    /// The error that says which file has this defect.
    pub fn of(self, file: &str) -> MeshError {
        MeshError { file: file.to_owned(), defect: self }
    }
}

/// What was changed in a mesh, or is worth knowing about it. Values that the caller shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Warning {
    /// The file, as the user named it.
    pub file: String,
    /// What was done or found.
    pub finding: Finding,
}

/// What [`repair`] did or found.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Finding {
    /// The file was in millimetres.
    ScaledFromMillimetres {
        /// Largest side as the file has it.
        extent: f64,
    },
    /// Faces with no area were dropped.
    DegenerateFaces(usize),
    /// Faces with the same three corners as another one were dropped.
    DuplicateFaces(usize),
    /// Only the largest connected part was kept.
    Components {
        /// How many others were dropped.
        dropped: usize,
        /// Their share of the whole area, 0 to 1.
        area_share: f64,
    },
    /// Faces were turned so that neighbours agree.
    InconsistentWinding(usize),
    /// The normals looked inward; all faces were turned.
    Inverted,
    /// The mesh does not enclose a volume; it was left as it is, and collides as its convex hull.
    NotWatertight(EdgeCount),
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let file = &self.file;
        match self.finding {
            Finding::ScaledFromMillimetres { extent } => write!(
                f,
                "{file}: largest side is {extent} units, so the file is taken to be in millimetres and scaled by 0.001"
            ),
            Finding::DegenerateFaces(n) => write!(f, "{file}: dropped {n} face(s) without area"),
            Finding::DuplicateFaces(n) => write!(f, "{file}: dropped {n} face(s) that were there twice"),
            Finding::Components { dropped, area_share } => write!(
                f,
                "{file}: kept the largest part; dropped {dropped} other(s), {:.2} % of the area",
                100.0 * area_share
            ),
            Finding::InconsistentWinding(n) => write!(f, "{file}: turned {n} face(s) so that neighbours agree"),
            Finding::Inverted => write!(f, "{file}: normals looked inward; turned all faces"),
            Finding::NotWatertight(EdgeCount { open, crowded }) => {
                write!(
                    f,
                    "{file}: not watertight: {open} open edge(s), {crowded} edge(s) with more than two faces; it is kept, and \
                     collides as its convex hull"
                )
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn area_volume_and_edges_of_a_tetrahedron() {
        let corner = Mesh {
            vertices: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z],
            faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        };
        assert!((corner.volume_m3() - 1.0 / 6.0).abs() < 1e-12);
        assert!((corner.area_m2() - (1.5 + 0.75_f64.sqrt())).abs() < 1e-7);
        assert!(corner.edges().watertight());
        let open = Mesh { faces: corner.faces[..3].to_vec(), ..corner };
        assert_eq!(open.edges(), EdgeCount { open: 3, crowded: 0 });
    }
}
