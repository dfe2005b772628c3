//! Pictures of the window, compared with those in the repository.

use super::*;
use crate::preferences::Panels;

#[test]
fn pictures_of_the_start_page() {
    let mut results = SnapshotResults::new();
    for (appearance, name) in [(Appearance::Light, "start_light"), (Appearance::Dark, "start_dark")] {
        let mut preferences = Preferences { appearance, ..Preferences::default() };
        preferences.choices.folder = PathBuf::from("runs");
        preferences.recent = vec![PathBuf::from("runs/duck-001")];
        let mut bench = Bench::new(WindowContents::Start, &preferences, [800.0, 400.0], true);
        if let Some(start) = &mut bench.harness.state_mut().as_mut().unwrap().start {
            start.keep_procedural();
        }
        bench.settle();
        bench.compare(name, &mut results);
    }
}

#[test]
fn pictures_of_a_frame() {
    let run = finished();
    let mut results = SnapshotResults::new();
    for (appearance, zoom_percent, size, name) in [
        (Appearance::Light, 100, [920.0, 560.0], "frame_light"),
        (Appearance::Dark, 100, [920.0, 560.0], "frame_dark"),
        (Appearance::Light, 200, [1280.0, 800.0], "frame_light_200"),
        (Appearance::Dark, 200, [1280.0, 800.0], "frame_dark_200"),
    ] {
        let preferences = Preferences { appearance, zoom_percent, ..Preferences::default() };
        let mut bench = Bench::new(on_run(run.path()), &preferences, size, true);
        bench.press(Key::Home);
        bench.harness.key_press_modifiers(Modifiers::SHIFT, Key::ArrowRight);
        bench.settle();
        bench.compare(name, &mut results);
    }
}

#[test]
fn a_picture_of_a_recording_that_cannot_be_shown() {
    let bench = Bench::new(on_run(Path::new("/nowhere")), &dark(), [640.0, 360.0], true);
    bench.compare("trouble", &mut SnapshotResults::new());
}

#[test]
fn pictures_of_a_comparison() {
    let run = finished();
    let mut bench = Bench::new(both(run.path(), run.path()), &dark(), [900.0, 520.0], true);
    if let Page::Comparison(page) = &mut bench.harness.state_mut().as_mut().unwrap().page {
        // Folders of tests have random names.
        page.rename(["A runs/cube-001", "B runs/cube-002"]);
    }
    bench.press(Key::Home);
    bench.harness.key_press_modifiers(Modifiers::SHIFT, Key::ArrowRight);
    bench.settle();
    bench.compare("comparison_dark", &mut SnapshotResults::new());
}

#[test]
fn pictures_of_every_colouring() {
    let run = finished();
    let mut results = SnapshotResults::new();
    for (appearance, theme) in [(Appearance::Light, "light"), (Appearance::Dark, "dark")] {
        for colouring in Colouring::ALL {
            let panels = Panels { layers: false, sensors: false, plots: false };
            let preferences = Preferences { appearance, colouring, panels, ..Preferences::default() };
            let bench = Bench::new(on_run(run.path()), &preferences, [260.0, 250.0], true);
            bench.compare(&format!("{}_{theme}", colouring.name().replace(' ', "_")), &mut results);
        }
    }
    let preferences = Preferences { panels: Panels { layers: false, sensors: false, plots: false }, ..dark() };
    let mut bench = Bench::new(on_run(run.path()), &preferences, [420.0, 330.0], true);
    bench.press(Key::V);
    bench.press(Key::K);
    bench.compare("slice_and_keyframes", &mut results);
}
