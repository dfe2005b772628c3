//! Tests of the window through its widgets, without a display.

mod comparison;
mod example;
mod painter;
mod pictures;
mod sensor_images;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use eframe::egui::accesskit::Toggled;
use eframe::egui::{self, Key, Modifiers};
use egui_kittest::kittest::{NodeT as _, Queryable as _};
use egui_kittest::{Harness, SnapshotOptions, SnapshotResults};
use mvt_picture::palette::Theme;
use mvt_recording::{FOLDER, Recording, VERSION};
use proptest::prelude::*;
use tempfile::TempDir;

use super::start_page::StartPage;
use super::{Appearance, Page, Preferences, Window, WindowContents};
use mvt_viewer::RecordingSource;
use mvt_viewer::dashboard::{Dashboard, DashboardLayout};
use mvt_viewer::eye::Eye;
use mvt_viewer::layers::{Clouds, Colouring, Keyframes, Layers};
use mvt_viewer::legend::Legend;
use painter::Painter;

/// Window on a recording with preferences of its own.
struct Bench {
    harness: Harness<'static, Option<Window>>,
    settings: TempDir,
    /// Thumbnails take a while, and only pictures need them.
    waits_for_thumbnails: bool,
}

impl Bench {
    fn new(contents: WindowContents, preferences: &Preferences, size: [f32; 2], with_pictures: bool) -> Self {
        let settings = tempfile::tempdir().unwrap();
        preferences.save(settings.path()).unwrap();
        let folder = settings.path().to_path_buf();
        let mut builder = Harness::builder().with_size(size).with_max_steps(32).with_step_dt(1.0 / 60.0);
        if with_pictures {
            builder = builder.renderer(Painter::default());
        }
        let app = move |ui: &mut egui::Ui, window: &mut Option<Window>| {
            window.get_or_insert_with(|| Window::new(ui.ctx(), Some(folder.clone()), contents.clone())).ui(ui);
        };
        let mut bench =
            Self { harness: builder.build_ui_state(app, None), settings, waits_for_thumbnails: with_pictures };
        bench.settle();
        bench
    }

    /// Returns a dark window on a run, without pictures.
    fn on(run: &Path) -> Self {
        Self::new(on_run(run), &dark(), [1280.0, 1000.0], false)
    }

    fn window(&self) -> &Window {
        self.harness.state().as_ref().unwrap()
    }

    /// Runs frames until nothing is being painted.
    fn settle(&mut self) {
        let deadline = Instant::now() + Duration::from_secs(120);
        // A picture that has come may change the layout, which then needs others.
        let mut quiet = 0;
        while quiet < 2 {
            self.harness.run_ok();
            let is_busy = match &self.window().page {
                Page::Recording(page) => page.is_busy(),
                Page::Comparison(page) => page.is_busy(),
                Page::Start => {
                    self.waits_for_thumbnails && self.window().start.as_ref().is_some_and(StartPage::is_busy)
                }
                Page::Starting(_) | Page::Problem(..) => false,
            };
            quiet = if is_busy { 0 } else { quiet + 1 };
            assert!(Instant::now() < deadline, "the window does not come to rest");
            std::thread::sleep(Duration::from_millis(5));
        }
        self.harness.run_ok();
    }

    fn press(&mut self, key: Key) {
        self.harness.key_press(key);
        self.settle();
    }

    fn click(&mut self, label: &str) {
        self.harness.get_by_label(label).click();
        self.settle();
    }

    fn shows(&self, text: &str) -> bool {
        self.harness.query_all_by_label_contains(text).next().is_some()
    }

    /// Returns the number of the shown moment, from 1.
    fn frame(&self) -> usize {
        let node = self.harness.query_all_by_label_contains("frame ").find_map(|node| {
            let label = node.accesskit_node().label().or_else(|| node.accesskit_node().value())?;
            label.strip_prefix("frame ")?.split(' ').next()?.parse().ok()
        });
        node.unwrap()
    }

    /// Compares the window with the picture of that name.
    fn compare(mut self, name: &str, results: &mut SnapshotResults) {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/src/tests/snapshots");
        let options = SnapshotOptions::new().output_path(folder);
        self.harness.snapshot_options(name, &options);
        results.extend_harness(&mut self.harness);
    }
}

fn on_run(run: &Path) -> WindowContents {
    WindowContents::Recording(RecordingSource::Run(run.to_path_buf()))
}

fn both(a: &Path, b: &Path) -> WindowContents {
    WindowContents::Comparison([a, b].map(|run| RecordingSource::Run(run.to_path_buf())))
}

fn dark() -> Preferences {
    Preferences { appearance: Appearance::Dark, ..Preferences::default() }
}

/// Records a finished run.
fn finished() -> TempDir {
    let run = tempfile::tempdir().unwrap();
    example::record(run.path(), example::FRAMES).finish(true).unwrap();
    run
}

/// Returns the rectangle of a plot.
fn figure(bench: &Bench, name: &str) -> egui::Rect {
    bench.harness.get_by_role_and_label(egui::accesskit::Role::Figure, name).rect()
}

/// Turns the wheel by clicks over a point.
fn wheel(bench: &mut Bench, at: egui::Pos2, clicks: f32) {
    bench.harness.hover_at(at);
    bench.harness.run_ok();
    bench.harness.event(egui::Event::MouseWheel {
        unit: egui::MouseWheelUnit::Line,
        delta: egui::vec2(0.0, clicks),
        phase: egui::TouchPhase::Move,
        source: egui::MouseWheelSource::Wheel,
        modifiers: Modifiers::NONE,
    });
    bench.settle();
}

#[test]
fn the_timeline_plays_steps_and_is_dragged() {
    let run = finished();
    let mut bench = Bench::on(run.path());
    assert_eq!(bench.frame(), 36);
    bench.press(Key::Home);
    assert_eq!(bench.frame(), 1);
    bench.press(Key::ArrowRight);
    bench.click("One frame on (Right)");
    assert_eq!(bench.frame(), 3);
    bench.harness.key_press_modifiers(Modifiers::SHIFT, Key::ArrowRight);
    bench.settle();
    assert_eq!(bench.frame(), 33);
    bench.click("To the first frame (Home)");
    bench.harness.key_press(Key::Space);
    bench.harness.run_steps(30);
    let playing = bench.frame();
    assert!((2..36).contains(&playing), "after half a second at frame {playing}");
    bench.press(Key::Space);
    let track = bench.harness.get_by_label("Time").rect();
    bench.harness.drag_at(track.center());
    bench.harness.run_ok();
    bench.harness.drop_at(track.center());
    bench.settle();
    assert!((17..=20).contains(&bench.frame()), "{}", bench.frame());
    assert!(bench.shows("Lost for 0."), "the state is shown in words");
}

#[test]
fn keys_and_check_boxes_change_the_layers() {
    let run = finished();
    let mut bench = Bench::on(run.path());
    let is_on = |bench: &Bench, label: &str| {
        bench.harness.get_by_label(label).accesskit_node().toggled() == Some(Toggled::True)
    };
    for (label, key) in [
        ("Estimated mesh (M)", Key::M),
        ("Ground truth (G)", Key::G),
        ("Hand (A)", Key::A),
        ("Axes (O)", Key::O),
        ("Trail (T)", Key::T),
        ("Cameras (R)", Key::R),
        ("Slice (V)", Key::V),
        ("Box (B)", Key::B),
        ("Follow the object (F)", Key::F),
    ] {
        let before = is_on(&bench, label);
        bench.press(key);
        assert_eq!(is_on(&bench, label), !before, "{label}");
        bench.click(label);
        assert_eq!(is_on(&bench, label), before, "{label}");
    }
    bench.press(Key::I);
    assert!(!bench.shows("Camera side"));
    bench.press(Key::I);
    assert!(bench.shows("Camera side"));
    bench.press(Key::H);
    assert!(bench.shows("30 frames back, on"));
    bench.click("Close");
    assert!(!bench.shows("30 frames back, on"));
}

#[test]
fn a_log_has_no_layers_of_an_estimate() {
    let run = tempfile::tempdir().unwrap();
    example::record_as(run.path(), 6, None).finish(true).unwrap();
    let bench = Bench::on(run.path());
    for (label, shown) in [("Estimated mesh (M)", false), ("Slice (V)", false), ("Ground truth (G)", true)] {
        let node = bench.harness.get_by_label(label);
        let node = node.accesskit_node();
        assert_eq!((node.toggled() == Some(Toggled::True), node.is_disabled()), (shown, true), "{label}");
    }
    assert!(!bench.shows("error, mm"));
}

#[test]
fn the_first_frame_claims_no_error_of_zero() {
    let run = finished();
    let mut bench = Bench::on(run.path());
    assert!(bench.shows("ADD-S 0.8 mm"));
    bench.press(Key::Home);
    assert!(bench.shows("errors are measured from this frame on") && !bench.shows("ADD-S 0.0 mm"));
}

#[test]
fn a_narrow_window_puts_the_layers_above_the_sensors() {
    let run = finished();
    let preferences = Preferences { zoom_percent: 200, ..dark() };
    let bench = Bench::new(on_run(run.path()), &preferences, [1280.0, 800.0], false);
    let rect = |label: &str| bench.harness.get_by_label(label).rect();
    assert!(rect("Follow the object (F)").bottom() < rect("Sensors").top());
}

#[test]
fn curves_are_zoomed_with_the_wheel_and_reset_by_a_double_click() {
    let run = finished();
    let mut bench = Bench::on(run.path());
    let zoomed = |bench: &Bench| match &bench.window().page {
        Page::Recording(page) => page.zoomed_s(),
        _ => panic!("no recording is shown"),
    };
    let plot = figure(&bench, "Confidence");
    assert_eq!(zoomed(&bench), None);
    wheel(&mut bench, plot.center(), 3.0);
    let [from_s, to_s] = zoomed(&bench).unwrap();
    assert!(to_s - from_s < 0.9 && from_s > 0.0, "{from_s} {to_s}");
    for _ in 0..2 {
        bench.harness.drag_at(plot.center());
        bench.harness.step();
        bench.harness.drop_at(plot.center());
        bench.harness.step();
    }
    bench.settle();
    assert_eq!(zoomed(&bench), None);
}

#[test]
fn five_clicks_of_the_wheel_keep_the_hand_in_view() {
    let run = finished();
    let mut bench = Bench::on(run.path());
    let distance_m = |bench: &Bench| match &bench.window().page {
        Page::Recording(page) => page.eye().distance_m,
        _ => panic!("no recording is shown"),
    };
    let before_m = distance_m(&bench);
    let view = bench.harness.get_by_label("The scene in three dimensions").rect();
    wheel(&mut bench, view.center(), 5.0);
    let after_m = distance_m(&bench);
    assert!((0.6..0.95).contains(&(after_m / before_m)), "{after_m}");
    wheel(&mut bench, view.center(), 500.0);
    assert!(distance_m(&bench) >= 0.1);
}

#[test]
fn a_hidden_hand_is_shown_in_the_next_recording() {
    let run = finished();
    let mut bench = Bench::on(run.path());
    let is_on =
        |bench: &Bench| bench.harness.get_by_label("Hand (A)").accesskit_node().toggled() == Some(Toggled::True);
    bench.press(Key::A);
    assert!(!is_on(&bench));
    bench.click("Start page");
    let name = mvt_viewer::captions::folder(run.path());
    bench.click(&name);
    assert!(is_on(&bench));
}

#[test]
fn a_run_that_does_not_start_is_reported_in_words() {
    let runs = tempfile::tempdir().unwrap();
    let mut preferences = dark();
    // This test program does not know the arguments of a run, and fails.
    preferences.choices.folder = runs.path().join("runs");
    let mut bench = Bench::new(WindowContents::Start, &preferences, [1280.0, 800.0], false);
    bench.click("Start page");
    bench.click("Start");
    let deadline = Instant::now() + Duration::from_secs(60);
    while !bench.shows("The run did not start") {
        assert!(Instant::now() < deadline, "the failure is not noticed");
        std::thread::sleep(Duration::from_millis(20));
        bench.settle();
    }
    assert!(!preferences.choices.folder.exists() && !bench.shows("ERROR"));
}

#[test]
fn every_colouring_has_a_legend() {
    let run = finished();
    let recording = Recording::open(run.path()).unwrap();
    for colouring in Colouring::ALL {
        let layers = Layers { colouring, ..Layers::default() };
        assert_eq!(Legend::of(&layers, &recording, &Theme::LIGHT).len(), 1, "{colouring:?}");
        let more = Layers { slice: true, truth: true, clouds: Clouds::Both, ..layers };
        assert_eq!(Legend::of(&more, &recording, &Theme::LIGHT).len(), 4, "{colouring:?}");
    }
}

#[test]
fn the_slice_is_seen_inside_the_mesh() {
    let run = finished();
    let recording = Recording::open(run.path()).unwrap();
    let deep = mvt_picture::palette::signed_distance(-1.0);
    let pixels = |slice: bool| {
        let layers = Layers { slice, hand: false, axes: false, trail: false, ..Layers::default() };
        let mut painter = mvt_viewer::ScenePainter::new();
        let picture = painter.paint(&recording, 30, &layers, &Eye::default(), &Theme::LIGHT, [320, 240]);
        picture.pixels().filter(|pixel| **pixel == deep).count()
    };
    assert_eq!(pixels(false), 0);
    assert!(pixels(true) > 400, "{}", pixels(true));
}

#[test]
fn the_view_turns_with_the_pointer() {
    let run = finished();
    let mut bench = Bench::on(run.path());
    let eye = |bench: &Bench| match &bench.window().page {
        Page::Recording(page) => page.eye(),
        _ => panic!("no recording is shown"),
    };
    let before = eye(&bench);
    let view = bench.harness.get_by_label("The scene in three dimensions").rect();
    bench.harness.drag_at(view.center());
    bench.harness.run_ok();
    bench.harness.hover_at(view.center() + egui::vec2(60.0, 20.0));
    bench.harness.run_ok();
    bench.harness.drop_at(view.center() + egui::vec2(60.0, 20.0));
    bench.settle();
    assert!(eye(&bench).yaw_rad != before.yaw_rad && eye(&bench).pitch_rad > before.pitch_rad);
    assert_eq!(eye(&bench).target, before.target);
    bench.press(Key::Num0);
    assert_eq!(eye(&bench), before);
    let key = |bench: &mut Bench, modifiers, key| {
        bench.harness.key_press_modifiers(modifiers, key);
        bench.settle();
    };
    key(&mut bench, Modifiers::ALT, Key::ArrowRight);
    key(&mut bench, Modifiers::ALT, Key::ArrowUp);
    assert!(eye(&bench).yaw_rad > before.yaw_rad && eye(&bench).pitch_rad > before.pitch_rad);
    assert_eq!(bench.frame(), 36, "with Alt, arrows do not go through time");
    key(&mut bench, Modifiers::NONE, Key::PageUp);
    assert!(eye(&bench).distance_m < before.distance_m);
}

#[test]
fn a_notice_disappears_after_some_seconds() {
    let run = finished();
    let mut bench = Bench::on(run.path());
    bench.press(Key::Home);
    bench.press(Key::E);
    assert!(bench.shows("there is no mesh yet"));
    bench.harness.run_steps(400);
    assert!(bench.shows("there is no mesh yet"));
    bench.harness.run_steps(200);
    assert!(!bench.shows("there is no mesh yet"));
}

#[test]
fn settings_are_remembered() {
    let run = finished();
    let mut bench = Bench::on(run.path());
    bench.press(Key::C);
    bench.press(Key::D);
    bench.harness.key_press_modifiers(Modifiers::COMMAND, Key::Plus);
    bench.settle();
    assert!((bench.harness.ctx.zoom_factor() - 1.1).abs() < 1e-6);
    bench.harness.state_mut().as_mut().unwrap().save();
    let (preferences, problem) = Preferences::load(bench.settings.path());
    assert_eq!(problem, None);
    assert_eq!(preferences.colouring, Colouring::Sensor);
    assert_eq!((preferences.appearance, preferences.zoom_percent), (Appearance::Light, 110));
    assert_eq!(preferences.recent, [run.path()]);
}

#[test]
fn a_run_that_goes_on_is_followed_and_a_crash_is_reported() {
    let run = tempfile::tempdir().unwrap();
    let writer = example::record(run.path(), 8);
    let mut bench = Bench::on(run.path());
    assert_eq!(bench.frame(), 8);
    assert!(bench.shows("the run is going on"));
    // Ends without finishing.
    drop(writer);
    let deadline = Instant::now() + Duration::from_secs(60);
    while !bench.shows("the run has crashed") {
        assert!(Instant::now() < deadline, "the crash is not noticed");
        std::thread::sleep(Duration::from_millis(20));
        bench.settle();
    }
    bench.press(Key::Home);
    assert_eq!(bench.frame(), 1);
}

#[test]
fn recordings_that_cannot_be_shown_are_reported() {
    let run = finished();
    let about = run.path().join(FOLDER).join("about.json");
    let text = fs::read_to_string(&about).unwrap();
    let newer = text.replacen(&format!("\"version\": {VERSION}"), "\"version\": 900", 1);
    for (damaged, told) in [(newer.as_str(), "newer"), ("{", "damaged"), ("", "damaged")] {
        fs::write(&about, damaged).unwrap();
        let mut bench = Bench::on(run.path());
        assert!(bench.shows("This cannot be shown") && bench.shows(told), "{told}");
        fs::write(&about, &text).unwrap();
        bench.click("Try again");
        assert_eq!(bench.frame(), 36);
    }
    let mut bench = Bench::on(&run.path().join("elsewhere"));
    assert!(bench.shows("holds no recording"));
    bench.click("Go to the start page");
    assert!(bench.shows("Recent runs"));
}

#[test]
fn damaged_pictures_and_shapes_leave_the_rest_usable() {
    let run = finished();
    for file in ["images.bin", "shapes.bin"] {
        let path = run.path().join(FOLDER).join(file);
        let mut bytes = fs::read(&path).unwrap();
        bytes.iter_mut().step_by(7).for_each(|byte| *byte ^= 0x5a);
        fs::write(&path, bytes).unwrap();
    }
    let mut bench = Bench::on(run.path());
    assert!(bench.shows("is damaged"));
    bench.press(Key::Home);
    bench.press(Key::End);
    bench.press(Key::E);
    assert!(bench.shows("is damaged"));
    assert_eq!(bench.frame(), 36);
}

#[test]
fn a_run_is_chosen_on_the_start_page() {
    let runs = tempfile::tempdir().unwrap();
    let run = finished();
    let mut preferences = dark();
    preferences.choices.folder = runs.path().to_path_buf();
    preferences.remember(run.path());
    let mut bench = Bench::new(WindowContents::Start, &preferences, [1280.0, 800.0], false);
    bench.click("duck");
    assert_eq!(bench.window().preferences.choices.object, "duck");
    let search = bench.harness.get_by_role_and_label(egui::accesskit::Role::TextInput, "Object");
    search.click();
    bench.settle();
    bench.harness.get_by_role_and_label(egui::accesskit::Role::TextInput, "Object").type_text("pear");
    bench.settle();
    assert!(bench.shows("016_pear") && !bench.shows("025_mug"));
    let parts: Vec<_> = run.path().iter().rev().take(2).map(|part| part.to_string_lossy()).collect();
    bench.click(&format!("{}/{}", parts[1], parts[0]));
    assert_eq!(bench.frame(), 36);
    bench.click("Start page");
    assert!(bench.shows("Recent runs"));
}

#[test]
fn who_has_no_run_sees_one_that_the_program_carries() {
    let mut bench = Bench::new(WindowContents::Start, &dark(), [1280.0, 800.0], false);
    assert!(bench.shows("An example: a simulated hand"));
    // It plays to its end.
    bench.harness.run_steps(320);
    assert_eq!(bench.frame(), 150);
    assert!(bench.window().preferences.recent.is_empty(), "it is no run of the user");
    bench.click("Start page");
    assert!(bench.shows("Recent runs"));
    bench.click("example of the program");
    assert!(bench.shows("An example: a simulated hand"));
}

#[test]
fn everything_fits_at_twice_the_size() {
    let run = finished();
    let mut preferences = Preferences { zoom_percent: 200, ..dark() };
    preferences.remember(run.path());
    // Contents that do not fit are scrolled, and small windows do not panic.
    for size in [[1280.0, 800.0], [480.0, 360.0], [200.0, 160.0]] {
        for contents in [WindowContents::Start, on_run(run.path()), both(run.path(), run.path())] {
            Bench::new(contents, &preferences, size, false);
        }
    }
}

/// Reads a recording and paints two of its moments.
fn paint(folder: &Path) {
    let Ok(recording) = Recording::open(folder) else { return };
    let layers = Layers {
        truth: true,
        frusta: true,
        clouds: Clouds::Both,
        keyframes: Keyframes::All,
        colouring: Colouring::Confidence,
        slice: true,
        bounds: true,
        ..Layers::default()
    };
    let mut dashboard = Dashboard::new(DashboardLayout::All, [240, 160], layers, Theme::LIGHT);
    for moment in [0, recording.moments().len()] {
        dashboard.paint(&recording, moment, &Eye::default());
    }
}

#[test]
fn damaged_recordings_never_panic_when_they_are_painted() {
    let run = tempfile::tempdir().unwrap();
    example::record(run.path(), 12).finish(true).unwrap();
    paint(run.path());
    let inner = run.path().join(FOLDER);
    let names = ["about.json", "frames.jsonl", "images.bin", "shapes.jsonl", "shapes.bin", "events.jsonl", "end.json"];
    let files = names.map(|name| (inner.join(name), fs::read(inner.join(name)).unwrap()));
    let damage = (0..names.len(), any::<prop::sample::Index>(), any::<u8>(), 0..4usize);
    let mut runner = proptest::test_runner::TestRunner::new(ProptestConfig::with_cases(100));
    runner
        .run(&damage, |(file, at, byte, how)| {
            let (path, bytes) = &files[file];
            let mut damaged = bytes.clone();
            if !bytes.is_empty() {
                let at = at.index(bytes.len());
                match how {
                    0 => damaged[at] = byte,
                    1 => damaged.truncate(at),
                    2 => damaged.insert(at, byte),
                    // Changes a number.
                    _ => damaged.iter_mut().skip(at).find(|b| b.is_ascii_digit()).into_iter().for_each(|b| *b = b'9'),
                }
            }
            fs::write(path, damaged).unwrap();
            paint(run.path());
            fs::write(path, bytes).unwrap();
            Ok(())
        })
        .unwrap();
}
