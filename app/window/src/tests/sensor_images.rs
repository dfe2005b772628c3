//! Tests of the panel of sensor images.

use mvt_robot::hand::{Hand, PartSurface, Side, TouchPad};
use mvt_run::estimator::Mode;

use super::*;

#[test]
fn a_sensor_image_is_enlarged_by_a_click() {
    let run = finished();
    let mut bench = Bench::on(run.path());
    let small = bench.harness.get_by_label("side: depth").rect();
    bench.click("side: depth");
    let large = bench.harness.get_by_label("Camera side: depth, enlarged").rect();
    assert!(large.width() > 3.0 * small.width(), "{small} {large}");
    bench.press(Key::Escape);
    assert!(!bench.shows("enlarged"));
    bench.click("thumb: contact");
    bench.click("thumb: contact, enlarged");
    assert!(!bench.shows("enlarged"));
}

#[test]
fn all_fingers_are_reached_without_scrolling() {
    let run = finished();
    for size in [[1280.0, 800.0], [1920.0, 1080.0]] {
        let bench = Bench::new(on_run(run.path()), &dark(), size, false);
        let rect = |label: &str| bench.harness.get_by_label(label).rect();
        let bottom = figure(&bench, "Contact by finger").top();
        for finger in ["index", "middle", "ring", "thumb"] {
            let picture = rect(&format!("{finger}: contact"));
            assert!(picture.bottom() < bottom && picture.right() < size[0] && picture.width() > 35.0, "{picture}");
        }
    }
}

/// Records a hand with so many pads of the Allegro's, or with twice its own.
fn with_pads(pads: usize) -> TempDir {
    let hand = match pads {
        0 => Hand::none(),
        _ => {
            let mut description = Hand::allegro(Side::Left).description().clone();
            let more = description.pads.clone();
            description.pads.extend(more.into_iter().map(|pad| TouchPad { name: format!("{}_2", pad.name), ..pad }));
            description.pads.truncate(pads);
            for part in description.bodies.iter_mut().flat_map(|body| &mut body.parts) {
                if matches!(part.surface, PartSurface::Gel(pad) if pad >= pads) {
                    part.surface = PartSurface::Link;
                }
            }
            Hand::new(description).unwrap()
        }
    };
    let run = tempfile::tempdir().unwrap();
    example::record_with(&hand, run.path(), 9, Some(Mode::Slam)).finish(true).unwrap();
    run
}

#[test]
fn any_number_of_pads_is_shown() {
    for (pads, shown, hidden) in [
        (0, "side: depth", ": contact"),
        (2, "middle: contact", "ring: contact"),
        (8, "thumb_2: contact", "thumb_3: contact"),
    ] {
        let run = with_pads(pads);
        let bench = Bench::new(on_run(run.path()), &dark(), [1280.0, 800.0], false);
        assert!(bench.shows(shown) && !bench.shows(hidden), "{pads}");
        assert_eq!(bench.shows("Contact by finger"), pads > 0);
        let right = bench.harness.get_by_label(shown).rect().right();
        assert!(right < 1280.0, "{pads}: {right}");
        let recording = Recording::open(run.path()).unwrap();
        assert!(recording.warnings().is_empty(), "{:?}", recording.warnings());
        let layers = Layers { keyframes: Keyframes::All, clouds: Clouds::Both, ..Layers::default() };
        let paint = |hand: bool| {
            let layers = Layers { hand, ..layers };
            let mut dashboard = Dashboard::new(DashboardLayout::All, [640, 400], layers, Theme::LIGHT);
            dashboard.paint(&recording, 8, &Eye::default())
        };
        assert_eq!(paint(true) == paint(false), pads == 0, "without a hand nothing of it is drawn");
    }
}

#[test]
fn images_say_when_they_were_taken() {
    let run = finished();
    let mut bench = Bench::on(run.path());
    bench.press(Key::Home);
    assert!(bench.shows("Images of this frame"));
    bench.press(Key::ArrowRight);
    assert!(bench.shows("Images from 0.03 s before"));
}
