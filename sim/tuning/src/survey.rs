//! A survey: which controllers turn which objects.

use mvt_gaits::axis::TurnAxis;
use mvt_gaits::gait::Gait;
use mvt_gaits::shape::ObjectShape;
use mvt_objects::object::Object;
use mvt_physics::simulation::SimulationError;
use mvt_robot::hand::Side;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::trial::{self, TrialConditions};

/// The outcome of a controller with an object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SurveyRow {
    /// Name of the object.
    pub object: String,
    /// Name or file of the controller.
    pub controller: String,
    /// The object's size and shape.
    pub shape: ObjectShape,
    /// Seeds of the starts, also of those that were not played because the object had fallen.
    pub seeds: Vec<u64>,
    /// Time until the object fell or the start ended, seconds, for each start that was played. A start in which the object
    /// fell is the last.
    pub survived_s: Vec<f64>,
    /// Net angle about x, y and z of the world in each of them, radians.
    pub net_rad: Vec<[f64; 3]>,
    /// The object was on the hand at the end of all starts.
    pub kept: bool,
}

impl SurveyRow {
    /// Returns the least net angle about one and the same axis in all starts, for the axis where it is greatest, radians; 0
    /// if the object fell.
    pub fn turned_rad(&self) -> f64 {
        if !self.kept {
            return 0.0;
        }
        let least = |axis: TurnAxis| {
            let along = |net: &[f64; 3]| Vector3::from(*net).dot(&axis.direction(Side::Right));
            self.net_rad.iter().map(along).fold(f64::INFINITY, f64::min)
        };
        TurnAxis::ALL.into_iter().map(least).fold(0.0, f64::max)
    }
}

/// Plays a controller on the starts of `seeds`, one after the other, up to the first in which the object falls.
///
/// # Errors
/// [`SimulationError`] if MuJoCo refuses the object.
pub fn survey(
    (controller, gait): (&str, &Gait),
    object: &Object,
    seeds: &[u64],
    conditions: &TrialConditions,
) -> Result<SurveyRow, SimulationError> {
    let mut row = SurveyRow {
        object: object.name.clone(),
        controller: controller.to_owned(),
        shape: ObjectShape::of(object),
        seeds: seeds.to_vec(),
        survived_s: Vec::new(),
        net_rad: Vec::new(),
        kept: true,
    };
    for &seed in seeds {
        let result = trial::run(gait, object, seed, conditions)?;
        row.survived_s.push(result.survived_s);
        row.net_rad.push(result.net_rad);
        row.kept = result.alive;
        if !row.kept {
            break;
        }
    }
    Ok(row)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_turn_is_the_least_about_one_axis() {
        let shape = ObjectShape { length_mm: 70.0, width_mm: 70.0, height_mm: 70.0, fill: 1.0, mass_g: 100.0 };
        let row = |kept: bool, net_rad: Vec<[f64; 3]>| SurveyRow {
            object: String::new(),
            controller: String::new(),
            shape,
            seeds: Vec::new(),
            survived_s: Vec::new(),
            net_rad,
            kept,
        };
        assert_eq!(row(true, vec![[1.0, -8.0, 9.0], [0.0, -7.0, 2.0]]).turned_rad(), 7.0);
        assert_eq!(row(true, vec![[0.0, 8.0, 0.0], [0.0, -8.0, 0.0]]).turned_rad(), 0.0);
        assert_eq!(row(false, vec![[0.0, 8.0, 0.0]]).turned_rad(), 0.0);
    }
}
