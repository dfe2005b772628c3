//! Touch sensors of several kinds on one hand: from the renderer through perception to the estimator, the recording and a log.

#![expect(clippy::unwrap_used, reason = "a failed assumption is a failed test")]

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use image::RgbImage;
use indicatif::ProgressBar;
use mvt_feelsight::{Log, LogFormat};
use mvt_frames::camera::PosedCamera;
use mvt_objects::catalogue;
use mvt_objects::object::Object;
use mvt_recording::{About, Recording, RecordingWriter, VERSION};
use mvt_render::touch::TouchConfig;
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::{Hand, Side, TouchPad};
use mvt_robot::rig::PLACEMENTS;
use mvt_run::config::RunConfig;
use mvt_run::estimator::Mode;
use mvt_run::input::Input;
use mvt_run::pipeline::Progress;
use mvt_run::source::{LogSource, Modality, Source as _, TouchArguments, TouchOrigin};
use mvt_simulated::recorder::{NoiseLevel, Recorder, Settings};

use crate::{pipeline, source};

/// A flat gel of 12 x 16 mm, 20 mm before a camera with images of 128 x 96 pixels.
fn flat() -> SensorProfile {
    SensorProfile { size_px: [128, 96], apex_mm: 20.0, size_mm: [16.0, 12.0], bulge_mm: 0.0, ..SensorProfile::tacto() }
}

/// An Allegro of which two pads have the flat sensor.
fn hand() -> Arc<Hand> {
    let is_flat = |pad: &TouchPad| ["index", "thumb"].contains(&pad.name.as_str());
    Hand::allegro(Side::Left).with_profiles(|pad| if is_flat(pad) { flat() } else { SensorProfile::tacto() })
}

/// Rows and columns of the images of each pad.
const SHAPES: [(usize, usize); 4] = [(96, 128), (320, 240), (320, 240), (96, 128)];

fn object() -> Object {
    catalogue::load("077_rubiks_cube", &mut Vec::new()).unwrap()
}

fn cameras(hand: &Hand) -> Vec<PosedCamera> {
    vec![PLACEMENTS[3].camera(hand)]
}

#[test]
fn each_pad_is_rendered_estimated_and_recorded_with_its_own_sensor() {
    let mut source = source(&object(), &hand(), Modality::Vitac, 0, 2.0);
    let hand = Arc::clone(source.hand());
    assert!(hand.is_allegro());
    let folder = tempfile::tempdir().unwrap();
    let about = About {
        version: VERSION,
        object: "077_rubiks_cube".into(),
        seed: 0,
        mode: Some(Mode::Slam),
        modality: Modality::Vitac,
        hand: Arc::clone(&hand),
        cameras: cameras(&hand),
        frames: source.frame_count(),
        process: 1,
    };
    let writer = RecordingWriter::create(folder.path(), &about, None).unwrap();
    let config = RunConfig::default();
    let pipeline = pipeline(&config, Modality::Vitac, 0);
    let mut flat_contacts = 0;
    let finished = pipeline.run(&mut source, &AtomicBool::new(false), &mut |progress| {
        if let Progress::Frame { sensed, .. } = &progress {
            let presses = sensed.percept.touch.iter().map(|press| press.as_ref().unwrap());
            assert_eq!(presses.clone().map(|press| press.contact.dim()).collect::<Vec<_>>(), SHAPES);
            flat_contacts += usize::from(presses.clone().next().unwrap().contact.iter().any(|&touches| touches));
            let input = Input::new(&hand, &sensed.percept);
            let measured = input.measured(&sensed.percept, Modality::Vitac);
            for (touch, (rows, columns)) in measured.touch.iter().flatten().zip(SHAPES) {
                assert_eq!(touch.depth_m.dim(), (rows, columns));
                assert_eq!([touch.intrinsics.width, touch.intrinsics.height], [columns, rows]);
            }
            let flat = measured.touch[0].as_ref().unwrap();
            assert!(flat.depth_m.iter().all(|depth_m| (0.0..=0.020_001).contains(depth_m)));
        }
        writer.receive(progress);
    });
    assert!(finished.unwrap().complete && flat_contacts > 0, "nothing touches the flat gel");
    writer.finish(true).unwrap();
    let recording = Recording::open(folder.path()).unwrap();
    assert_eq!(recording.about().hand, hand);
    let images = recording.images(0).unwrap().unwrap();
    let shapes = images.touch.iter().map(|touch| touch.as_ref().unwrap().indentation_mm.dim());
    assert_eq!(shapes.collect::<Vec<_>>(), SHAPES);
}

fn record(folder: &Path, format: LogFormat) {
    let (object, hand) = (object(), hand());
    let settings = Settings {
        controller: "auto".into(),
        hand: Arc::clone(&hand),
        duration_s: 0.3,
        noise: NoiseLevel::Touch.into(),
        touch_config: TouchConfig::Fork,
        background: None,
    };
    let recorder = Recorder::new(&object, "077_rubiks_cube", &settings).unwrap();
    recorder.record(3, &cameras(&hand), folder, format, false, &ProgressBar::hidden()).unwrap();
}

#[test]
fn logs_keep_the_sensors() {
    let folder = tempfile::tempdir().unwrap();
    let [plain, compact] = ["plain", "compact"].map(|name| folder.path().join(name));
    record(&plain, LogFormat::FeelSight);
    record(&compact, LogFormat::Compact);
    let logs = [&plain, &compact].map(|path| Log::open(path).unwrap());
    let hand = hand();
    for log in &logs {
        assert_eq!(*log.hand(), hand);
        for (pad, (rows, columns)) in SHAPES.into_iter().enumerate() {
            assert_eq!(log.touch_image(pad, 4).unwrap().dimensions(), (columns as u32, rows as u32));
            let truth = log.touch_truth(pad, 4).unwrap();
            assert_eq!(truth.depth_m, logs[0].touch_truth(pad, 4).unwrap().depth_m);
            let indentation_mm = hand.gel_views()[pad].indentation_of(&truth.depth_m).unwrap();
            // A log has steps of 0.03 mm.
            assert!(indentation_mm.iter().all(|mm| (-0.02..4.0).contains(mm)), "pad {pad}");
        }
    }
    let open = |path: &Path| {
        let touch = TouchArguments::new(TouchOrigin::Truth, None);
        LogSource::open(path, None, Modality::Vitac, 0.0, &touch, Default::default())
    };
    let mut source = open(&plain).unwrap();
    assert_eq!(*source.hand(), hand);
    let sensed = source.next().unwrap().unwrap();
    let shapes = sensed.percept.touch.iter().map(|press| press.as_ref().unwrap().contact.dim());
    assert_eq!(shapes.collect::<Vec<_>>(), SHAPES);

    let image = plain.join("allegro/index/image/2.jpg");
    RgbImage::new(240, 320).save(&image).unwrap();
    let error = Log::open(&plain).and_then(|log| log.touch_image(0, 2)).unwrap_err().to_string();
    for part in ["index/image/2.jpg", "240 x 320 and not 128 x 96", "size_px in scene.json"] {
        assert!(error.contains(part), "{error}");
    }
    let scene = fs::read_to_string(plain.join("scene.json")).unwrap();
    let damaged = scene.replacen("\"apex_mm\": 20.0", "\"apex_mm\": -1.0", 1);
    assert_ne!(damaged, scene);
    fs::write(plain.join("scene.json"), damaged).unwrap();
    let error = Log::open(&plain).unwrap_err().to_string();
    assert!(error.contains("pad index: apex_mm"), "{error}");
}
