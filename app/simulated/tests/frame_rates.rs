//! An estimator that gets fewer frames.

use std::sync::atomic::AtomicBool;

use mvt_frames::{Isometry, Model, Object};
use mvt_objects::catalogue;
use mvt_robot::hand::{Hand, Side};
use mvt_run::config::RunConfig;
use mvt_run::pipeline::Progress;
use mvt_run::source::Modality;

use crate::{pipeline, source};

/// Ten times a second a brick is seen 26 mm and 30 degrees from where it was, and fingers hide the ends along which it slides.
#[test]
fn a_brick_is_followed_at_ten_frames_per_second() {
    let (brick, hand) = (catalogue::load("061_foam_brick", &mut Vec::new()).unwrap(), Hand::allegro(Side::Left));
    for seed in [0, 1] {
        let mut source = source(&brick, &hand, Modality::Vi, seed, 1.5);
        source.set_frame_rate(10);
        let config = RunConfig::default();
        let pipeline = pipeline(&config, Modality::Vi, seed);
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
