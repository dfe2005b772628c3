//! How far an estimated pose may be off.
//!
//! A pose is found by comparison with a shape, and a shape that grows was learnt at earlier poses. The error of a pose therefore has two
//! parts: its error against the shape, and that of the shape's part that it was compared with, which adds up from keyframe to keyframe
//! like a random walk, until the object shows a side again that was learnt early. The constants were chosen with `results/deviation.py`
//! on the objects and seeds that `results/objects.toml` lists for tuning.

use std::f64::consts::PI;

use glam::Vec3;
use mvt_frames::{Field, Isometry, World};
use nalgebra as na;

use crate::config::TrustConfig;
use crate::scan::{Scan, Sensor};

/// How far an estimated pose may be off, one standard deviation. In 19 of 20 frames the error is at most twice this.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviation {
    /// Distance of the object's surface from where the pose places it (ADD-S), metres.
    pub surface_m: f64,
    /// Rotation, radians, at most pi. It is large about an axis about which the object looks the same from all sides.
    pub angle_rad: f64,
}

/// Variance of a pose against the shape.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Variance {
    /// Of the translation along the direction that is known least, square metres.
    pub translation_m2: f64,
    /// Of the rotation about the axis that is known least, square radians.
    pub rotation_rad2: f64,
}

impl Variance {
    fn plus(self, other: Self) -> Self {
        Self {
            translation_m2: self.translation_m2 + other.translation_m2,
            rotation_rad2: self.rotation_rad2 + other.rotation_rad2,
        }
    }
}

/// What of an object the sensors see.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Side {
    rotation: na::UnitQuaternion<f64>,
    /// From the first camera to the object; `None` without a camera that sees it.
    sight: Option<na::Vector3<f64>>,
}

impl Side {
    pub fn new(pose: Isometry<Field, World>, scan: &Scan) -> Self {
        let camera = scan.views.iter().find(|view| matches!(view.sensor(), Sensor::Camera(_)) && !view.hits.is_empty());
        Self::seen_from(pose, camera.map(|view| view.origin))
    }

    fn seen_from(pose: Isometry<Field, World>, eye: Option<Vec3>) -> Self {
        let pose = pose.untyped();
        let sight = eye.map(|eye| pose.translation.vector - na::Vector3::from(eye.to_array()).cast::<f64>());
        Self { rotation: pose.rotation, sight }
    }

    /// Rotation of the object against the line of sight between two sides, radians: an object that moves past a camera without turning also shows
    /// another side.
    fn angle_to(&self, other: &Self) -> f64 {
        let swept = self.sight.zip(other.sight).and_then(|(from, to)| na::UnitQuaternion::rotation_between(&from, &to));
        (swept.unwrap_or_default() * self.rotation).angle_to(&other.rotation)
    }
}

/// A pose at which the shape learnt.
#[derive(Debug, Clone, Copy)]
struct Station {
    side: Side,
    /// Of the part of the shape that was learnt here, against the first.
    variance: Variance,
}

/// The random walk of the poses at which a shape learns.
#[derive(Debug, Clone, Default)]
pub(crate) struct Drift {
    /// In order of time.
    stations: Vec<Station>,
}

/// Angle between two sides that are the same part of an object for the most part, radians.
const SAME_SIDE_RAD: f64 = 12.0 * PI / 180.0;
/// Rotation of a pose against a shape that is learnt well, one deviation, radians.
const FLOOR_RAD: f64 = 0.01;
/// Deviation of the surface by that of the translation along the direction that is known least: most of the surface does not lie across it.
const SURFACE_BY_TRANSLATION: f64 = 0.6;
/// Deviation of the surface where no measurement agrees with the pose, metres.
const MISFIT_M: f64 = 0.1;
/// The same of the rotation, radians.
const MISFIT_RAD: f64 = 2.5;

impl Drift {
    /// The walk of a map of an earlier run: its poses are the reference.
    pub fn of_map(sides: impl Iterator<Item = Side>) -> Self {
        Self { stations: sides.map(|side| Station { side, variance: Variance::default() }).collect() }
    }

    /// The variance of a pose that shows a side and whose variance against the shape is `own`.
    fn variance(&self, side: Side, own: Variance) -> Variance {
        let Some(newest) = self.stations.last() else { return own };
        let walked = newest.variance.plus(own);
        if walked.rotation_rad2 > SAME_SIDE_RAD.powi(2) {
            // Which side is shown is not known.
            return walked;
        }
        let same_side = self.stations.iter().filter(|station| station.side.angle_to(&side) < SAME_SIDE_RAD);
        let tied = same_side.map(|station| station.variance.plus(own));
        tied.chain([walked]).min_by(|a, b| a.translation_m2.total_cmp(&b.translation_m2)).unwrap_or(walked)
    }

    /// Takes a pose at which the shape has learnt.
    pub fn learn(&mut self, side: Side, own: Variance) {
        let variance = self.variance(side, own);
        self.stations.push(Station { side, variance });
    }

    /// Takes a pose that colours recognised by what the object showed at earlier ones: the walk goes on from the one that showed most of the same side,
    /// of those whose rotation is known.
    pub fn recognise(&mut self, side: Side, own: Variance) {
        let known = self.stations.iter().filter(|station| station.variance.rotation_rad2 < SAME_SIDE_RAD.powi(2));
        let nearest = known.min_by(|a, b| a.side.angle_to(&side).total_cmp(&b.side.angle_to(&side)));
        if let Some(variance) = nearest.map(|nearest| nearest.variance.plus(own)) {
            self.stations.push(Station { side, variance });
        }
    }

    /// The way that the object has come since the shape was begun, seen from the camera, metres; 0 if no camera sees it.
    fn way_m(&self, side: Side) -> f64 {
        let begun = self.stations.first().and_then(|station| station.side.sight);
        begun.zip(side.sight).map_or(0.0, |(begun, sight)| (sight - begun).norm())
    }

    /// The deviation of a pose that shows a side, whose variance against the shape is `own`, and with which this part of the measurements agrees.
    pub fn deviation(&self, side: Side, own: Variance, confidence: f64, trust: &TrustConfig) -> Deviation {
        let Variance { translation_m2, rotation_rad2 } = self.variance(side, own);
        let misfit = 1.0 - confidence.clamp(0.0, 1.0);
        let walk_m = SURFACE_BY_TRANSLATION * translation_m2.sqrt();
        let scale_m = trust.camera_scale_sigma * self.way_m(side);
        Deviation {
            surface_m: trust.deviation_floor_m.hypot(walk_m).hypot(scale_m).hypot(MISFIT_M * misfit),
            angle_rad: FLOOR_RAD.hypot(rotation_rad2.sqrt()).hypot(MISFIT_RAD * misfit).min(PI),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FLOOR_M: f64 = 0.0009;

    fn trust() -> TrustConfig {
        TrustConfig { deviation_floor_m: FLOOR_M, ..TrustConfig::default() }
    }

    const OWN: Variance = Variance { translation_m2: 1e-6, rotation_rad2: 1e-4 };

    fn pose(position_m: [f64; 3], degrees: f64) -> Isometry<Field, World> {
        Isometry::from_parts(
            position_m,
            [(degrees.to_radians() / 2.0).cos(), 0.0, 0.0, (degrees.to_radians() / 2.0).sin()],
        )
    }

    fn turned(degrees: f64) -> Side {
        Side::seen_from(pose([0.0; 3], degrees), None)
    }

    #[test]
    fn lengths_of_a_camera_that_is_not_calibrated_are_doubted() {
        let at = |x| Side::seen_from(pose([x, 0.0, 1.0], 0.0), Some(Vec3::ZERO));
        let mut drift = Drift::default();
        drift.learn(at(0.0), Variance::default());
        let doubtful = TrustConfig { camera_scale_sigma: 0.04, ..trust() };
        let stated_m = |x| drift.deviation(at(x), Variance::default(), 1.0, &doubtful).surface_m;
        assert!((stated_m(0.5) - FLOOR_M.hypot(0.02)).abs() < 1e-9 && (stated_m(0.0) - FLOOR_M).abs() < 1e-12);
        assert_eq!(drift.deviation(at(0.5), Variance::default(), 1.0, &trust()).surface_m, FLOOR_M);
    }

    #[test]
    fn an_object_that_passes_a_camera_shows_another_side() {
        let eye = Some(Vec3::ZERO);
        let before = Side::seen_from(pose([1.0, 0.0, 0.0], 0.0), eye);
        let passed = Side::seen_from(pose([1.0, 0.5, 0.0], 0.0), eye);
        assert!((before.angle_to(&passed) - 0.5_f64.atan()).abs() < 1e-9);
        // One that turns as the line of sight does shows the same side, and so does one that moves away.
        let turned_along = Side::seen_from(pose([1.0, 0.5, 0.0], 0.5_f64.atan().to_degrees()), eye);
        let farther = Side::seen_from(pose([2.0, 0.0, 0.0], 0.0), eye);
        assert!(before.angle_to(&turned_along) < 1e-6 && before.angle_to(&farther) < 1e-6);
    }

    #[test]
    fn variances_add_up_until_the_object_shows_the_same_side_again() {
        let mut drift = Drift::default();
        drift.learn(turned(0.0), Variance::default());
        for k in 1..36 {
            drift.learn(turned(10.0 * f64::from(k)), OWN);
            let walked = drift.stations.last().unwrap().variance.translation_m2 / OWN.translation_m2;
            // The last pose of the turn shows the side of the first.
            let steps = if k == 35 { 1.0 } else { f64::from(k) };
            assert!((walked - steps).abs() < 1e-9, "pose {k}: {walked} steps");
        }
        assert!((drift.variance(turned(360.0), OWN).translation_m2 - OWN.translation_m2).abs() < 1e-12);
    }

    #[test]
    fn a_side_is_not_recognised_by_a_rotation_that_nothing_tells() {
        let mut drift = Drift::default();
        drift.learn(turned(0.0), Variance::default());
        let unknown = Variance { rotation_rad2: 0.25, ..OWN };
        (0..10).for_each(|_| drift.learn(turned(0.0), unknown));
        let deviation = drift.deviation(turned(0.0), unknown, 1.0, &trust());
        assert!(deviation.angle_rad > 1.5 && deviation.surface_m > 1.8e-3, "{deviation:?}");
    }

    #[test]
    fn colours_end_the_doubt_about_a_rotation() {
        let mut drift = Drift::default();
        drift.learn(turned(0.0), Variance::default());
        drift.learn(turned(10.0), OWN);
        drift.learn(turned(20.0), Variance { rotation_rad2: 0.25, ..OWN });
        assert!(drift.deviation(turned(40.0), OWN, 1.0, &trust()).angle_rad > 0.5);
        drift.recognise(turned(40.0), OWN);
        assert!((drift.stations.last().unwrap().variance.rotation_rad2 - 2.0 * OWN.rotation_rad2).abs() < 1e-12);
        assert!(drift.deviation(turned(40.0), OWN, 1.0, &trust()).angle_rad < 0.03);
    }

    #[test]
    fn a_pose_with_which_measurements_disagree_is_said_to_be_off() {
        let drift = Drift::default();
        let agreed = drift.deviation(turned(0.0), Variance::default(), 1.0, &trust());
        assert_eq!(agreed, Deviation { surface_m: FLOOR_M, angle_rad: FLOOR_RAD });
        assert!(drift.deviation(turned(0.0), Variance::default(), 0.9, &trust()).surface_m > 0.009);
    }
}
