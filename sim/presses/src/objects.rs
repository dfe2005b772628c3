//! Objects for training, validation and test of a network.

use std::sync::LazyLock;

use glam::Vec3;
use mvt_mesh::Mesh;
use mvt_objects::catalogue;
use mvt_render::rays::RayMesh;
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::error::PressError;

/// Objects of the test set, which no network is trained or chosen by: the ten of YCB-Slide, and four procedural ones.
pub const TEST: [&str; 14] = [
    "004_sugar_box",
    "005_tomato_soup_can",
    "006_mustard_bottle",
    "021_bleach_cleanser",
    "025_mug",
    "035_power_drill",
    "037_scissors",
    "042_adjustable_wrench",
    "048_hammer",
    "055_baseball",
    "bell_pepper",
    "duck",
    "rubiks_cube_small",
    "soup_can",
];

/// Objects of the validation set, which no network is trained on. A training keeps the weights with the best result on
/// them.
pub const VALIDATION: [&str; 8] = [
    "010_potted_meat_can",
    "014_lemon",
    "022_windex_bottle",
    "038_padlock",
    "051_large_clamp",
    "065-e_cups",
    "073-c_lego_duplo",
    "pear",
];

/// Names of the objects for training and validation.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Split {
    /// Objects for training. Default: all in the catalogue that are neither in [`VALIDATION`] nor in [`TEST`].
    pub train: Vec<String>,
    /// Objects for validation. Default: [`VALIDATION`].
    pub validate: Vec<String>,
}

impl Default for Split {
    fn default() -> Self {
        let names = catalogue::entries().map(|entry| entry.name);
        let train = names.filter(|name| !TEST.contains(name) && !VALIDATION.contains(name));
        Self { train: train.map(str::to_owned).collect(), validate: VALIDATION.map(str::to_owned).to_vec() }
    }
}

impl Split {
    /// Returns whether this is the default split.
    pub fn is_published(&self) -> bool {
        *self == Self::default()
    }

    /// Checks that neither set is empty, that all objects are in the catalogue or random ones, and that no object is in two sets.
    ///
    /// # Errors
    /// [`PressError`] that names the object.
    pub fn check(&self) -> Result<(), PressError> {
        if self.train.is_empty() || self.validate.is_empty() {
            return Err(PressError::EmptySet);
        }
        for name in self.train.iter().chain(&self.validate) {
            catalogue::check(name).map_err(|reason| PressError::Unknown(Box::new(reason)))?;
            if TEST.contains(&name.as_str()) {
                return Err(PressError::KeptForTests(name.clone()));
            }
            if self.train.contains(name) && self.validate.contains(name) {
                return Err(PressError::InBothSets(name.clone()));
            }
        }
        Ok(())
    }
}

/// Surface of an object, for presses anywhere on it.
pub struct PressedSurface {
    /// The mesh, prepared for the renderer.
    pub(crate) rays: RayMesh,
    mesh: Mesh,
    /// Sum of the areas of all faces up to each one, square metres.
    areas: Vec<f64>,
}

impl PressedSurface {
    fn new(mesh: Mesh) -> Self {
        let areas = mesh.triangles().scan(0.0, |sum, [a, b, c]| {
            *sum += 0.5 * f64::from((b - a).cross(c - a).length());
            Some(*sum)
        });
        Self { rays: RayMesh::new(&mesh), areas: areas.collect(), mesh }
    }

    /// Draws a point, uniformly over the surface, and its outward normal.
    pub(crate) fn point(&self, rng: &mut ChaCha8Rng) -> (Vec3, Vec3) {
        let area = rng.random::<f64>() * self.areas.last().copied().unwrap_or(0.0);
        let face = self.areas.partition_point(|&sum| sum <= area);
        let face = self.mesh.faces.get(face).copied().unwrap_or_default();
        let [a, b, c] = face.map(|i| self.mesh.vertices.get(i as usize).copied().unwrap_or_default());
        let (mut s, mut t) = (rng.random::<f32>(), rng.random::<f32>());
        if s + t > 1.0 {
            (s, t) = (1.0 - s, 1.0 - t);
        }
        (a + (b - a) * s + (c - a) * t, (b - a).cross(c - a).try_normalize().unwrap_or(Vec3::X))
    }
}

/// Replaces the names of the sets `train`, `validation` and `test` by the names of their objects.
pub fn resolve(names: &[String]) -> Vec<String> {
    let published = |name: &String| match name.as_str() {
        "train" => Split::default().train,
        "validation" => VALIDATION.map(str::to_owned).to_vec(),
        "test" => TEST.map(str::to_owned).to_vec(),
        _ => vec![name.clone()],
    };
    names.iter().flat_map(published).collect()
}

/// Procedural objects that [`small`] makes smaller, and their sizes, millimetres.
const SMALL: [&str; 5] = ["ball", "cube70", "large_dice", "pear", "soup_can"];
const SMALL_MM: [f32; 6] = [3.0, 4.5, 6.0, 9.0, 13.0, 20.0];

/// Returns small objects. Balls are as many as all others together: a ball of known size is what real sensors are measured with.
pub(crate) fn small() -> &'static [PressedSurface] {
    static SURFACES: LazyLock<Vec<PressedSurface>> = LazyLock::new(|| {
        let balls = SMALL_MM.into_iter().flat_map(|mm| std::iter::repeat_n(("ball", mm), SMALL.len() - 2));
        let others = SMALL.into_iter().flat_map(|name| SMALL_MM.map(|mm| (name, mm)));
        let scaled = |(name, mm): (&str, f32)| {
            Some(PressedSurface::new(resized(catalogue::find(name).ok()?.mesh_without_download()?, mm)))
        };
        balls.chain(others).filter_map(scaled).collect()
    });
    &SURFACES
}

/// Returns a ball of a diameter, millimetres.
///
/// # Errors
/// [`PressError`] if the catalogue has no ball.
pub fn ball(diameter_mm: f32) -> Result<PressedSurface, PressError> {
    Ok(PressedSurface::new(resized(mesh("ball")?, diameter_mm)))
}

/// Returns a mesh whose longest side has this length, millimetres.
fn resized(mut mesh: Mesh, longest_mm: f32) -> Mesh {
    let scale = 1e-3 * longest_mm / mesh.extents_m().max_element();
    mesh.vertices.iter_mut().for_each(|vertex| *vertex *= scale);
    mesh
}

/// Loads objects of the catalogue and random ones, in the order of the names.
///
/// # Errors
/// [`PressError`] if the catalogue does not have an object, or its mesh cannot be loaded.
pub fn load(names: &[impl AsRef<str> + Sync]) -> Result<Vec<PressedSurface>, PressError> {
    names.par_iter().map(|name| Ok(PressedSurface::new(mesh(name.as_ref())?))).collect()
}

fn mesh(name: &str) -> Result<Mesh, PressError> {
    catalogue::check(name).map_err(|reason| PressError::Unknown(Box::new(reason)))?;
    catalogue::load_mesh(name, &mut Vec::new())
        .map_err(|reason| PressError::Load { name: name.to_owned(), reason: Box::new(reason) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_object_is_in_two_sets() {
        let published = Split::default();
        published.check().unwrap();
        let count = published.train.len() + TEST.len() + VALIDATION.len();
        assert_eq!(count, catalogue::entries().count(), "a name is not in the catalogue");
        let split = |train: &[&str], validate: &[&str]| {
            let names = |names: &[&str]| names.iter().copied().map(str::to_owned).collect();
            Split { train: names(train), validate: names(validate) }.check().err().map(|error| format!("{error:#}"))
        };
        assert_eq!(split(&["mug", "ball"], &["pear"]), None);
        assert!(split(&["mug", "pear"], &["pear"]).unwrap().contains("pear"));
        assert!(split(&["duck"], &["pear"]).unwrap().contains("duck is kept for tests"));
        assert_eq!(split(&["random:7"], &["random:8"]), None);
        assert!(split(&["random:7"], &["random:x"]).unwrap().contains("no valid seed"));
        assert!(split(&["mugg"], &["pear"]).unwrap().contains("mugg"));
        assert!(split(&[], &["pear"]).unwrap().contains("some of each"));
    }

    #[test]
    fn points_lie_on_the_surface_and_normals_point_outwards() {
        use rand::SeedableRng as _;
        let ball = load(&["ball"]).unwrap().remove(0);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let radius = ball.mesh.extents_m().x / 2.0;
        for _ in 0..200 {
            let (point, normal) = ball.point(&mut rng);
            assert!((point.length() - radius).abs() < 0.02 * radius, "{point}");
            assert!(normal.dot(point.normalize()) > 0.99, "{normal} at {point}");
        }
    }
}
