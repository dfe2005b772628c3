//! Objects that are made here, so that nothing needs to be downloaded. Each knows its exact signed distance.

use std::sync::Arc;

use nalgebra::Vector3;

use crate::decompose::{self, NoHull};
use crate::frame::{Isometry, Object as ObjectFrame, Point};
use crate::mesh::Mesh;
use crate::object::{Object, SignedDistance};

mod rounded_box;

use rounded_box::RoundedBox;

/// How an object is made.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Recipe {
    /// A cube.
    Cube70,
}

/// Name, mass in kg and recipe of every procedural object, sorted by name.
pub(crate) const RECIPES: [(&str, f64, Recipe); 1] = [("cube70", 0.2, Recipe::Cube70)];

impl Recipe {
    pub(crate) fn build(self, name: &str, mass_kg: f64) -> Result<Object, NoHull> {
        let (mesh, exact): (Mesh, Arc<dyn SignedDistance>) = match self {
            Self::Cube70 => {
                let shape = RoundedBox::new(Vector3::repeat(0.035), 0.002);
                (shape.mesh(24, 4), Arc::new(shape))
            }
        };
        let collision = decompose::pieces(&mesh)?;
        Ok(Object {
            name: name.to_owned(),
            mesh,
            exact: Some(exact),
            object_from_file: Isometry::identity(),
            collision,
            mass_kg,
        })
    }
}
