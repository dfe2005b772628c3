//! Tests of the panel of sensor images.

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

#[test]
fn images_say_when_they_were_taken() {
    let run = finished();
    let mut bench = Bench::on(run.path());
    bench.press(Key::Home);
    assert!(bench.shows("Images of this frame"));
    bench.press(Key::ArrowRight);
    assert!(bench.shows("Images from 0.03 s before"));
}
