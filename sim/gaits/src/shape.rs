//! Size, fullness and mass of an object, by which its controller is chosen.

use mvt_objects::decompose;
use mvt_objects::object::Object;
use serde::{Deserialize, Serialize};

/// Size and shape of an object as it stands on the palm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectShape {
    /// Longer side of the footprint, millimetres.
    pub length_mm: f64,
    /// Shorter side of the footprint, millimetres.
    pub width_mm: f64,
    /// Height above the palm, millimetres.
    pub height_mm: f64,
    /// Share of its bounding box that the convex hull fills: a ball 0.52, an apple 0.62, an upright cylinder 0.79, a box 1.
    pub fill: f64,
    /// Mass, grams.
    pub mass_g: f64,
}

impl ObjectShape {
    /// Measures an object.
    pub fn of(object: &Object) -> Self {
        let [x, y, height] = object.extents_m();
        Self {
            length_mm: 1e3 * x.max(y),
            width_mm: 1e3 * x.min(y),
            height_mm: 1e3 * height,
            fill: decompose::hull_volume_m3(&object.mesh).unwrap_or(0.0) / (x * y * height),
            mass_g: 1e3 * object.mass_kg,
        }
    }
}
