//! An estimator that gets fewer frames.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use mvt_frames::{Isometry, Model, Object};
use mvt_gaits::gait;
use mvt_objects::catalogue;
use mvt_robot::hand::{Hand, Side};
use mvt_robot::rig::PLACEMENTS;
use mvt_run::config::RunConfig;
use mvt_run::estimator::{Init, Mode};
use mvt_run::pipeline::{EstimatorSetup, Meshing, Pipeline, Progress};
use mvt_run::source::Modality;
use mvt_simulated::{Fault, SimulatedSettings, SimulatedSource};

/// Ten times a second a brick is seen 26 mm and 30 degrees from where it was, and fingers hide the ends along which it slides.
#[test]
fn a_brick_is_followed_at_ten_frames_per_second() {
    for seed in [0, 1] {
        let (object, hand, config) = (
            catalogue::load("061_foam_brick", &mut Vec::new()).unwrap(),
            Hand::allegro(Side::Left),
            RunConfig::default(),
        );
        let settings = SimulatedSettings {
            gait: gait::choose("auto", &object, &hand).unwrap().1.clone(),
            mover: None,
            schedule: Default::default(),
            seed,
            duration_s: 1.5,
            cameras: vec![PLACEMENTS[3].camera(&hand)],
            camera_noise: config.camera_noise,
            perception: config.perception(),
            modality: Modality::Vi,
            hidden_every: None,
            fault: Fault::default(),
            hand: Arc::clone(&hand),
        };
        let mut source = SimulatedSource::new(&object, settings, None).unwrap();
        source.set_frame_rate(10);
        let setup = EstimatorSetup {
            config: &config.slam,
            mode: Mode::Slam,
            modality: Modality::Vi,
            init: Init::Near,
            seed,
            map: None,
        };
        let pipeline = Pipeline {
            estimators: vec![setup],
            meshing: Meshing { cell_m: 0.003, every: None },
            object: None,
            truth: None,
            supervisor: None,
            single_threaded: true,
        };
        let mut model_from_object: Option<Isometry<Object, Model>> = None;
        let finished = pipeline.run(&mut source, &AtomicBool::new(false), &mut |progress| {
            let Progress::Frame { sensed, results } = progress else { return };
            let (truth, estimate) = (sensed.truth.unwrap(), results[0].as_ref().unwrap().estimate.pose);
            let gauge = *model_from_object.get_or_insert(estimate.inverse() * truth);
            let found = estimate * gauge;
            let off_mm = 1e3 * (found.untyped().translation.vector - truth.untyped().translation.vector).norm();
            assert!(off_mm < 2.0, "seed {seed}, frame {}: {off_mm:.1} mm", sensed.frame);
        });
        assert!(finished.unwrap().complete);
    }
}
