//! Tests of the crate as others use it: one program, which is linked once.

#![expect(clippy::unwrap_used, reason = "a failed assumption is a failed test")]

use std::sync::Arc;

use mvt_gaits::gait;
use mvt_objects::object::Object;
use mvt_robot::hand::Hand;
use mvt_robot::rig::PLACEMENTS;
use mvt_run::config::RunConfig;
use mvt_run::estimator::{Init, Mode};
use mvt_run::pipeline::{EstimatorSetup, Meshing, Pipeline};
use mvt_run::source::Modality;
use mvt_simulated::{Fault, SimulatedSettings, SimulatedSource};

mod frame_rates;
mod sensors;
mod shear;

/// A hand that turns an object before the camera `side`.
fn source(object: &Object, hand: &Arc<Hand>, modality: Modality, seed: u64, duration_s: f64) -> SimulatedSource {
    let config = RunConfig::default();
    let settings = SimulatedSettings {
        gait: gait::choose("auto", object, hand).unwrap().1.clone(),
        mover: None,
        schedule: Default::default(),
        seed,
        duration_s,
        cameras: vec![PLACEMENTS[3].camera(hand)],
        camera_noise: config.camera_noise,
        perception: config.perception(),
        modality,
        hidden_every: None,
        fault: Fault::default(),
        hand: Arc::clone(hand),
    };
    SimulatedSource::new(object, settings, None).unwrap()
}

/// An estimator of shape and pose.
fn pipeline(config: &RunConfig, modality: Modality, seed: u64) -> Pipeline<'_> {
    let setup = EstimatorSetup { config: &config.slam, mode: Mode::Slam, modality, init: Init::Near, seed, map: None };
    Pipeline {
        estimators: vec![setup],
        meshing: Meshing { cell_m: 0.003, every: None },
        object: None,
        truth: None,
        supervisor: None,
        single_threaded: true,
    }
}
