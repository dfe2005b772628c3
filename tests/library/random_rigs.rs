//! Hands of any number of fingers, joints and pads, with sensors of any size: perception, estimation, recording and viewer take them.

#![allow(clippy::unwrap_used, reason = "a failed assumption in a test is a failed test")]

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Result;
use mvt_calibration::Calibration;
use mvt_frames::camera::{Intrinsics, PosedCamera, look_at};
use mvt_perceive::{Perception, PerceptionConfig, PerceptionSetup};
use mvt_picture::palette::Theme;
use mvt_recording::{About, Recording, RecordingWriter};
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::{
    Body, GraspPoint, Hand, HandDescription, Inertial, Joint, JointMotion, Part, PartSurface, PerPad, Placing,
    Primitive, TouchPad, UPRIGHT,
};
use mvt_robot::observation::{Observation, Press, Rgbd};
use mvt_run::config::RunConfig;
use mvt_run::estimator::{Init, Mode};
use mvt_run::pipeline::{EstimatorSetup, Meshing, Pipeline};
use mvt_run::source::{Modality, Pictures, Sensed, Source};
use mvt_viewer::{Dashboard, DashboardLayout, Eye, Layers, Preset};
use nalgebra::Vector3;
use ndarray::Array2;
use proptest::prelude::*;

/// A finger: for each of its links whether a joint moves it and whether that slides, and the size of the images of its sensor.
type Finger = (Vec<(bool, bool)>, [usize; 2]);

fn hand(fingers: &[Finger]) -> Arc<Hand> {
    let body = |name: String, parent: Option<usize>, place: [f64; 3]| Body {
        name,
        parent,
        place: Placing::at(place),
        inertial: Some(Inertial { mass_kg: 0.02, centre_m: [0.0; 3], orientation_wxyz: UPRIGHT, diagonal: [1e-5; 3] }),
        parts: vec![Part {
            surface: PartSurface::Link,
            shape: Primitive::Box { centre: [0.0, 0.0, 0.01], half: [0.008, 0.008, 0.01], orientation_wxyz: UPRIGHT },
        }],
    };
    let (mut bodies, mut joints, mut pads) = (vec![body("base".to_owned(), None, [0.0; 3])], Vec::new(), Vec::new());
    for (f, (links, size_px)) in fingers.iter().enumerate() {
        let angle = f as f64 * 0.7;
        for (k, &(moves, slides)) in links.iter().enumerate() {
            let (parent, place) = match k {
                0 => (0, [0.05 * angle.cos(), 0.05 * angle.sin(), 0.02]),
                _ => (bodies.len() - 1, [0.0, 0.0, 0.025]),
            };
            bodies.push(body(format!("link{f}_{k}"), Some(parent), place));
            if moves {
                joints.push(Joint {
                    name: format!("joint{f}_{k}"),
                    body: bodies.len() - 1,
                    motion: if slides { JointMotion::Slide } else { JointMotion::Hinge },
                    axis: [0.0, 1.0, 0.0],
                    range: if slides { [-0.01, 0.01] } else { [-1.0, 1.0] },
                    mirrors: false,
                    drive: Default::default(),
                });
            }
        }
        pads.push(TouchPad {
            name: format!("pad{f}"),
            body: bodies.len() - 1,
            place: Placing::at([0.0; 3]),
            profile: SensorProfile { size_px: *size_px, ..SensorProfile::tacto() },
        });
    }
    let grasp = Some(GraspPoint { body: None, point_m: [0.0, 0.0, 0.1] });
    let none = Hand::none().description().clone();
    Hand::new(HandDescription { name: "random".to_owned(), bodies, joints, pads, grasp, ..none }).unwrap()
}

const FRAMES: u64 = 4;

/// A ball that every second pad feels.
struct Frames {
    hand: Arc<Hand>,
    perception: Perception,
    next: u64,
}

impl Source for Frames {
    fn next(&mut self) -> Result<Option<Sensed>> {
        let number = self.next;
        if number == FRAMES {
            return Ok(None);
        }
        self.next += 1;
        let disc = |(v, u): (usize, usize)| (v as f32 - 60.0).powi(2) + (u as f32 - 80.0).powi(2);
        let depth_m =
            Array2::from_shape_fn((120, 160), |at| if disc(at) < 900.0 { 0.3 + 2e-5 * disc(at) } else { 0.0 });
        let presses: PerPad<Option<Press>> = self.hand.per_pad(|pad| {
            let shape = self.hand.pads()[pad].profile.shape();
            let contact = Array2::from_shape_fn(shape, |(v, _)| v < shape[0] / 2);
            (pad % 2 == 0).then(|| Press {
                indentation_mm: contact.mapv(|inside| 0.5 * f32::from(u8::from(inside))),
                contact,
                sigma_mm: 0.05,
            })
        });
        let observation = Observation {
            time_s: number as f64 / 30.0,
            joints: vec![0.003 * number as f64; self.hand.joints().len()],
            touch: PerPad::default(),
            cameras: vec![Rgbd { color: Default::default(), depth_m, labels: None, world_from_camera: None }],
        };
        let percept = self.perception.see(number, observation, Some(presses))?.percept;
        let pictures = Pictures::default();
        let (warnings, events) = (Vec::new(), Vec::new());
        Ok(Some(Sensed {
            frame: number,
            percept,
            truth: None,
            carried: None,
            pictures,
            sense_ms: 1.0,
            hidden: None,
            warnings,
            events,
        }))
    }

    fn hand(&self) -> &Arc<Hand> {
        &self.hand
    }

    fn frame_count(&self) -> usize {
        FRAMES as usize
    }

    fn end(&self) -> (String, bool) {
        ("it ended".to_owned(), true)
    }

    fn calibration(&self) -> Option<Calibration> {
        None
    }
}

fn camera() -> PosedCamera {
    let pose = look_at(Vector3::new(0.0, 0.3, 0.25), Vector3::new(0.0, 0.0, 0.1), Vector3::z());
    PosedCamera { name: "front".to_owned(), intrinsics: Intrinsics::from_fov_y(160, 120, 0.8), pose }
}

fn check(fingers: &[Finger]) {
    let hand = hand(fingers);
    let mut config = RunConfig::default();
    (config.slam.map.first_steps, config.slam.map.steps_per_s, config.slam.map.batch) = (4, 30.0, 64);
    let setup = PerceptionSetup { weights: None, config: PerceptionConfig::default() };
    let perception = Perception::new(Arc::clone(&hand), vec![camera()], &setup);
    let mut source = Frames { hand: Arc::clone(&hand), perception, next: 0 };
    let folder = tempfile::tempdir().unwrap();
    let about = About {
        version: mvt_recording::VERSION,
        object: "ball".to_owned(),
        seed: 0,
        mode: Some(Mode::Slam),
        modality: Modality::Vitac,
        hand: Arc::clone(&hand),
        cameras: vec![camera()],
        frames: FRAMES as usize,
        process: std::process::id(),
    };
    let writer = RecordingWriter::create(folder.path(), &about, None).unwrap();
    let (slam, init) = (&config.slam, Init::Near);
    let pipeline = Pipeline {
        estimators: vec![EstimatorSetup {
            config: slam,
            mode: Mode::Slam,
            modality: Modality::Vitac,
            init,
            seed: 0,
            map: None,
        }],
        meshing: Meshing { cell_m: 0.008, every: None },
        object: None,
        truth: None,
        supervisor: None,
        single_threaded: true,
    };
    let finished =
        pipeline.run(&mut source, &AtomicBool::new(false), &mut |progress| writer.receive(progress)).unwrap();
    writer.finish(finished.complete).unwrap();
    let recording = Recording::open(folder.path()).unwrap();
    assert_eq!((recording.moments().len(), recording.about().hand.pads().len()), (FRAMES as usize, fingers.len()));
    let mut page = Dashboard::new(DashboardLayout::All, [640, 360], Layers::default(), Theme::LIGHT);
    let picture = page.paint(&recording, FRAMES as usize - 1, &Eye::new(Preset::Oblique));
    assert_eq!(picture.dimensions(), (640, 360));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_rig_is_perceived_estimated_recorded_and_drawn(
        fingers in prop::collection::vec(
            (prop::collection::vec((any::<bool>(), any::<bool>()), 1..=3), prop::array::uniform2(32..=80_usize)), 1..=8),
    ) {
        check(&fingers);
    }
}

#[test]
fn rigs_at_the_limits() {
    check(&[]);
    check(&[(vec![(false, false)], [32, 32])]);
    // Thirty joints.
    check(&vec![(vec![(true, false); 6], [40, 32]); 5]);
}
