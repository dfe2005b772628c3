//! Objects without end: the seed in `random:SEED` decides family, proportions and mass.
//!
//! The same seed gives the same object in every version of the program: results over seeds are compared with older
//! ones. Seeds below 1000 are for tuning, 1000 to 1099 for results.

use std::fmt;

use mvt_frames::Isometry;
use mvt_mesh::Mesh;
use nalgebra::Vector3;

use super::nets;
use super::shape::Shape;
use crate::decompose::{self, NoHull};
use crate::object::Object;
use crate::stand::stand;
use draw::Draw;

mod draw;
mod hollow;
mod outline;
mod solid;

/// Beginning of the name of every random object.
pub const PREFIX: &str = "random:";
/// Range of the largest extent, metres: the hand turns objects of this size.
const LARGEST_EXTENT_M: [f32; 2] = [0.040, 0.090];
/// Range of the number of faces: below, edges look cut; above, distances and pictures take long.
const FACES: [usize; 2] = [5_000, 40_000];
/// Ratio of the hull's volume to the shape's up to which the hull collides: notches of every L, T and U are above.
const CONVEX_RATIO: f64 = 1.04;
/// Range of the mass, kg: that of the catalogue's objects which the hand turns.
const MASS_KG: [f64; 2] = [0.025, 0.350];

/// Family of shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ShapeFamily {
    /// Prism with 3 to 8 sides, regular or not, and rounded edges.
    Prism,
    /// Solid of revolution: a vase, a barrel or a beaker.
    Lathe,
    /// Superquadric, between a ball, a box, a cylinder and an octahedron.
    Superquadric,
    /// Box with rounded edges.
    RoundedCuboid,
    /// Smooth union of a few balls with a flat foot.
    Blob,
    /// Prism over an L, a T, a U or a star.
    Concave,
    /// Round cup or pot with corners.
    Hollow,
    /// Round cup with a handle.
    Handled,
}

impl ShapeFamily {
    /// All families.
    pub const ALL: [Self; 8] = [
        Self::Prism,
        Self::Lathe,
        Self::Superquadric,
        Self::RoundedCuboid,
        Self::Blob,
        Self::Concave,
        Self::Hollow,
        Self::Handled,
    ];

    /// Draws proportions.
    fn shape(self, draw: &mut Draw) -> Shape {
        match self {
            Self::Prism => solid::prism(draw),
            Self::Lathe => solid::lathe(draw),
            Self::Superquadric => solid::superquadric(draw),
            Self::RoundedCuboid => solid::cuboid(draw),
            Self::Blob => solid::blob(draw),
            Self::Concave => solid::concave(draw),
            Self::Hollow => hollow::vessel(draw),
            Self::Handled => hollow::handled(draw),
        }
    }

    /// Returns the range of the density, kg/m^3: wood and light plastics for solids, plastics and ceramics for walls.
    fn density_kg_m3(self) -> [f64; 2] {
        match self {
            Self::Hollow | Self::Handled => [1200.0, 2200.0],
            _ => [300.0, 700.0],
        }
    }
}

impl fmt::Display for ShapeFamily {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Prism => "prism",
            Self::Lathe => "lathe",
            Self::Superquadric => "superquadric",
            Self::RoundedCuboid => "cuboid",
            Self::Blob => "blob",
            Self::Concave => "concave",
            Self::Hollow => "hollow",
            Self::Handled => "handled",
        })
    }
}

/// Name that begins like that of a random object, without a valid seed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{name:?} has no valid seed; give a whole number from 0 to {} without leading zeros, such as random:17",
    u64::MAX
)]
pub struct InvalidSeed {
    /// The invalid name.
    pub name: String,
}

/// Object that is a function of its seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RandomObject {
    seed: u64,
}

impl RandomObject {
    /// Chooses the object of a seed.
    pub fn new(seed: u64) -> Self {
        Self { seed }
    }

    /// Reads a name such as `random:17`. `None` if the name does not begin with [`PREFIX`].
    ///
    /// # Errors
    /// [`InvalidSeed`] if no number follows.
    pub fn from_name(name: &str) -> Option<Result<Self, InvalidSeed>> {
        let digits = name.strip_prefix(PREFIX)?;
        // One object has one name: neither +17 nor 017.
        let seed = digits.parse().ok().filter(|seed: &u64| seed.to_string() == digits);
        Some(seed.map(Self::new).ok_or_else(|| InvalidSeed { name: name.to_owned() }))
    }

    /// Returns the family of the shape.
    pub fn family(self) -> ShapeFamily {
        self.start().1
    }

    /// Makes only the mesh. Saves the decomposition into convex pieces, which takes most of the time of
    /// [`Self::load`].
    pub fn mesh(self) -> Mesh {
        self.shape().0.mesh
    }

    /// Makes the object. Its name is `random-SEED`, which can be that of a folder on every system.
    ///
    /// # Errors
    /// [`NoHull`] if the shape is flat; no shape that was drawn is.
    pub fn load(self) -> Result<Object, NoHull> {
        let (Shape { mesh, exact }, mass_kg) = self.shape();
        let collision = decompose::pieces_above(&mesh, CONVEX_RATIO)?;
        let name = format!("random-{}", self.seed);
        Ok(Object { name, mesh, exact, object_from_file: Isometry::identity(), collision, mass_kg })
    }

    /// Draws the family.
    fn start(self) -> (Draw, ShapeFamily) {
        let mut draw = Draw::new(self.seed);
        let family = draw.one_of(ShapeFamily::ALL);
        (draw, family)
    }

    /// Draws shapes of the family until one is sound, and its mass.
    fn shape(self) -> (Shape, f64) {
        let (mut draw, family) = self.start();
        loop {
            let shape = family.shape(&mut draw);
            if is_sound(&shape.mesh) {
                let mass_kg = draw.between(family.density_kg_m3()) * shape.mesh.volume_m3();
                return (shape, mass_kg.clamp(MASS_KG[0], MASS_KG[1]));
            }
        }
    }
}

/// Meshes the zero set of a field within a box, and aligns it with the axes.
fn moulded(field: impl Fn(Vector3<f64>) -> f64, half_m: Vector3<f64>, cell_m: f64) -> Shape {
    Shape::polyhedron(stand(&nets::mesh(field, half_m, cell_m), [0.0, 0.0, 1.0]).0)
}

/// Returns whether a mesh is closed and its size is within the ranges.
fn is_sound(mesh: &Mesh) -> bool {
    let largest_m = mesh.extents_m().max_element();
    (LARGEST_EXTENT_M[0]..=LARGEST_EXTENT_M[1]).contains(&largest_m)
        && (FACES[0]..=FACES[1]).contains(&mesh.faces.len())
        && mesh.edges().watertight()
        && mesh.volume_m3() > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_have_plain_numbers() {
        assert_eq!(RandomObject::from_name("random:17"), Some(Ok(RandomObject::new(17))));
        assert_eq!(RandomObject::from_name("random-17"), None);
        for name in ["random:", "random:x", "random:-1", "random:+1", "random:01", "random:1.5", "random: 1"] {
            let error = RandomObject::from_name(name).unwrap().unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("random:17"), "{error}");
        }
    }
}
