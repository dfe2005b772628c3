//! Objects of a training.

use mvt_objects::object::Object;

use crate::error::LearningError;

/// First random object that is kept for results.
const FIRST_KEPT: u64 = 1000;

/// Checks that an object is not kept for results.
///
/// # Errors
/// [`LearningError::KeptObject`] for `random:1000` and those behind it.
pub fn check_trainable(name: &str) -> Result<(), LearningError> {
    let seed = name.strip_prefix("random:").and_then(|seed| seed.parse::<u64>().ok());
    match seed {
        Some(FIRST_KEPT..) => Err(LearningError::KeptObject(name.to_owned())),
        _ => Ok(()),
    }
}

/// Returns an object in other sizes, `1 - range` to `1 + range` of its own, of the same density.
pub fn in_sizes(object: &Object, count: usize, range: f32) -> Vec<Object> {
    let sized = |k: usize| {
        let place = if count > 1 { 2.0 * k as f32 / (count - 1) as f32 - 1.0 } else { 0.0 };
        let factor = 1.0 + range * place;
        let mut sized = object.clone();
        let vertices = sized.mesh.vertices.iter_mut();
        vertices.chain(sized.collision.iter_mut().flatten()).for_each(|vertex| *vertex *= factor);
        sized.exact = None;
        sized.mass_kg *= f64::from(factor).powi(3);
        sized
    };
    (0..count.max(1)).map(sized).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a failed assumption in a test is a failed test")]

    use super::*;

    #[test]
    fn objects_for_results_are_refused() {
        assert!(check_trainable("random:999").is_ok() && check_trainable("cube70").is_ok());
        assert!(check_trainable("random:1000").unwrap_err().to_string().contains("random:1000 is kept"));
    }

    #[test]
    fn sizes_lie_on_both_sides() {
        let cube = mvt_objects::catalogue::load("cube70", &mut Vec::new()).unwrap();
        let sizes = in_sizes(&cube, 3, 0.1);
        let edges: Vec<f64> = sizes.iter().map(|object| object.extents_m()[0] / cube.extents_m()[0]).collect();
        assert!(edges.iter().zip([0.9, 1.0, 1.1]).all(|(edge, expected)| (edge - expected).abs() < 1e-6), "{edges:?}");
        assert!((sizes[2].mass_kg / cube.mass_kg - 1.331).abs() < 1e-6);
        assert_eq!(in_sizes(&cube, 1, 0.1)[0].mass_kg, cube.mass_kg);
    }
}
