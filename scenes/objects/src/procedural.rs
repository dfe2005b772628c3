//! Objects that are made here, so that nothing needs to be downloaded. Each knows its exact signed distance: in closed form
//! where the shape has one (boxes, die, lathed shapes); the others are by definition the polyhedron that is their mesh.

use std::sync::Arc;

use crate::decompose::{self, NoHull};
use crate::distance::MeshDistance;
use crate::object::Object;
use mvt_frames::{Isometry, Object as ObjectFrame, Point};
use mvt_mesh::Mesh;
use mvt_mesh::SignedDistance;

mod die;
mod lathe;
mod moulded;
mod nets;
mod rounded_box;

/// How an object is made.
pub(crate) type Recipe = fn() -> Shape;

/// A closed outward mesh with its bounding box centred on the origin, and the exact distance to what it approximates.
pub(crate) struct Shape {
    pub(crate) mesh: Mesh,
    exact: Option<Arc<dyn SignedDistance>>,
}

impl Shape {
    fn new(mesh: Mesh, exact: impl SignedDistance + 'static) -> Self {
        Self { mesh, exact: Some(Arc::new(exact)) }
    }

    /// The shape that is its mesh.
    fn polyhedron(mesh: Mesh) -> Self {
        let exact = MeshDistance::new(&mesh).map(|exact| Arc::new(exact) as Arc<dyn SignedDistance>);
        Self { mesh, exact }
    }
}

/// Name, mass in kg and recipe of every procedural object, sorted by name. The masses are those of plausible real ones: hollow
/// toys, a wooden grinder, a full can.
pub(crate) const RECIPES: [(&str, f64, Recipe); 11] = [
    ("ball", 0.060, lathe::ball),
    ("bell_pepper", 0.120, moulded::bell_pepper),
    ("cube70", 0.200, rounded_box::cube70),
    ("duck", 0.050, moulded::duck),
    ("elephant", 0.090, moulded::elephant),
    ("large_dice", 0.100, die::large_dice),
    ("mug", 0.200, moulded::mug),
    ("pear", 0.060, lathe::pear),
    ("pepper_grinder", 0.150, lathe::pepper_grinder),
    ("rubiks_cube_small", 0.070, rounded_box::rubiks_cube_small),
    ("soup_can", 0.349, lathe::soup_can),
];

pub(crate) fn build(name: &str, mass_kg: f64, recipe: Recipe) -> Result<Object, NoHull> {
    let Shape { mesh, exact } = recipe();
    let collision = decompose::pieces(&mesh)?;
    Ok(Object { name: name.to_owned(), mesh, exact, object_from_file: Isometry::identity(), collision, mass_kg })
}
