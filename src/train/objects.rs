//! Which objects a network is trained on, which it is watched on, and which it never sees before it is judged.

use anyhow::{Context as _, Result};
use glam::Vec3;
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use scenes::catalogue;
use scenes::mesh::Mesh;
use sim::rays::RayMesh;

/// Never trained on: the ten objects of YCB-Slide, and four of the procedural ones.
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

/// Never trained on; the best weights of a training are those that do best on these.
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

/// Everything else in the catalogue.
pub fn training() -> Vec<&'static str> {
    let names = catalogue::entries().map(|entry| entry.name);
    names.filter(|name| !TEST.contains(name) && !VALIDATION.contains(name)).collect()
}

/// An object that can be touched anywhere.
pub struct Surface {
    /// As the renderer wants it.
    pub rays: RayMesh,
    mesh: Mesh,
    /// Area of all faces up to each, square metres.
    areas: Vec<f64>,
}

impl Surface {
    fn new(mesh: Mesh) -> Self {
        let areas = mesh.triangles().scan(0.0, |sum, [a, b, c]| {
            *sum += 0.5 * f64::from((b - a).cross(c - a).length());
            Some(*sum)
        });
        Self { rays: RayMesh::new(&mesh), areas: areas.collect(), mesh }
    }

    /// A point, evenly over the surface, and the outward normal there.
    pub fn point(&self, rng: &mut ChaCha8Rng) -> (Vec3, Vec3) {
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

/// Loads objects of the catalogue. Their order is that of the names.
pub fn load(names: &[&str]) -> Result<Vec<Surface>> {
    let surface = |name: &&str| {
        let object = catalogue::load(name, &mut Vec::new()).with_context(|| format!("cannot load {name}"))?;
        Ok(Surface::new(object.mesh))
    };
    names.par_iter().map(surface).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_object_is_in_two_sets() {
        let training = training();
        assert_eq!(
            training.len() + TEST.len() + VALIDATION.len(),
            catalogue::entries().count(),
            "a name that is no object"
        );
        assert!(TEST.iter().all(|name| !VALIDATION.contains(name)));
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
