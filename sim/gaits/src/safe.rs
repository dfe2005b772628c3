//! Controllers between which the hand can change without dropping the object, by the object's shape.

use std::sync::LazyLock;

use mvt_objects::object::Object;
use mvt_robot::hand::Hand;
use serde::Deserialize;

use crate::gait;
use crate::shape::ObjectShape;

/// A controller that keeps an object, also when it follows another one of the object's safe controllers.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SafeController {
    /// Name of the shipped controller.
    pub name: String,
    /// Net rate at which it turns the object about its axis, radians per second.
    pub rate_rad_s: f64,
}

/// An object on which changes were tried.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct TriedObject {
    name: String,
    /// Longer and shorter side of the footprint, and height, millimetres.
    size_mm: [f64; 3],
    /// See [`ObjectShape::fill`].
    fill: f64,
    controllers: Vec<SafeController>,
}

// Why: notes/decisions/simulation.md, "Controllers that may follow one another are a list by shape".
/// Largest relative difference in size, and difference in fill, from an object on which changes were tried.
const SIZE_MARGIN: f64 = 0.05;
const FILL_MARGIN: f64 = 0.05;

/// Returns the safe controllers of the most similar object on which changes were tried; an episode begins with the first of them. It is
/// empty if no object is similar, if the object has a single safe controller, or if the hand has no shipped ones.
pub fn safe_controllers(object: &Object, hand: &Hand) -> &'static [SafeController] {
    if !gait::suits(hand) {
        return &[];
    }
    let shape = ObjectShape::of(object);
    let difference = |tried: &TriedObject| {
        let sizes = [shape.length_mm, shape.width_mm, shape.height_mm].into_iter().zip(tried.size_mm);
        let size = sizes.map(|(a, b)| (a / b).ln().abs()).fold(0.0, f64::max);
        (size / SIZE_MARGIN).max((shape.fill - tried.fill).abs() / FILL_MARGIN)
    };
    let similar = tried().iter().map(|tried| (difference(tried), tried)).filter(|(difference, _)| *difference <= 1.0);
    similar.min_by(|(a, _), (b, _)| a.total_cmp(b)).map_or(&[], |(_, tried)| &tried.controllers)
}

fn tried() -> &'static [TriedObject] {
    #[derive(Deserialize)]
    struct File {
        object: Vec<TriedObject>,
    }
    static OBJECTS: LazyLock<Vec<TriedObject>> = LazyLock::new(|| {
        // A test parses this file. If it were invalid, no object would have safe controllers.
        toml::from_str::<File>(include_str!("../assets/safe_controllers.toml")).map_or(Vec::new(), |file| file.object)
    });
    &OBJECTS
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvt_objects::catalogue;
    use mvt_robot::hand::Side;

    #[test]
    fn every_object_of_the_file_has_two_axes_and_shipped_controllers() {
        assert!(tried().len() >= 10, "{}", tried().len());
        for TriedObject { name, controllers, .. } in tried() {
            let axes = controllers.iter().map(|controller| {
                assert!((0.05..3.0).contains(&controller.rate_rad_s), "{name}: {controller:?}");
                gait::find(&controller.name).unwrap().1.axis
            });
            let mut axes: Vec<_> = axes.collect();
            axes.sort_unstable();
            axes.dedup();
            assert!(axes.len() >= 2 && axes.len() == controllers.len(), "{name}");
        }
    }

    #[test]
    fn objects_find_their_own_entry_and_others_none() {
        let load = |name: &str| catalogue::load(name, &mut Vec::new()).unwrap();
        let hand = Hand::allegro(Side::Left);
        for tried in
            tried().iter().filter(|tried| catalogue::entries().any(|e| e.is_procedural() && e.name == tried.name))
        {
            assert_eq!(safe_controllers(&load(&tried.name), &hand), tried.controllers, "{}", tried.name);
        }
        assert!(!safe_controllers(&load("cube70"), &hand).is_empty());
        assert!(safe_controllers(&load("pepper_grinder"), &hand).is_empty());
        assert!(safe_controllers(&load("cube70"), &Hand::none()).is_empty());
    }
}
