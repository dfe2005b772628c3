//! Objects that this crate makes, so that they need no download. Each has an exact signed distance: in closed form for
//! boxes, the die and lathed shapes; the other shapes are defined as the polyhedron of their mesh.

use mvt_frames::Isometry;

use crate::decompose::{self, NoHull};
use crate::object::Object;
use shape::Shape;

mod die;
mod lathe;
mod moulded;
mod nets;
pub mod random;
mod rounded_box;
mod shape;

/// Function that makes the shape of an object.
pub(crate) type Recipe = fn() -> Shape;

/// Name, mass in kg and recipe of every procedural object, sorted by name. The masses are plausible for real objects:
/// hollow toys, a wooden grinder, a full can.
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

/// Makes an object by its recipe.
pub(crate) fn build(name: &str, mass_kg: f64, recipe: Recipe) -> Result<Object, NoHull> {
    let Shape { mesh, exact } = recipe();
    let collision = decompose::pieces(&mesh)?;
    Ok(Object { name: name.to_owned(), mesh, exact, object_from_file: Isometry::identity(), collision, mass_kg })
}
