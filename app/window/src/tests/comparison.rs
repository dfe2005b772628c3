//! Tests of the comparison of two runs.

use super::*;

#[test]
fn one_time_drives_two_runs() {
    let (long, short) = (finished(), tempfile::tempdir().unwrap());
    example::record(short.path(), 24).finish(true).unwrap();
    let mut bench = Bench::new(both(short.path(), long.path()), &dark(), [1280.0, 800.0], false);
    assert_eq!(bench.frame(), 36, "the longer run gives the time");
    assert!(bench.shows("ended at 0.77 s"));
    assert_eq!(bench.harness.get_all_by_label("The scene in three dimensions").count(), 2);
    for label in ["mean ADD-S, mm", "F-score at 5 mm", "confidence"] {
        assert!(bench.shows(label), "{label}");
    }
    bench.press(Key::Home);
    assert_eq!(bench.frame(), 1);
    assert_eq!(bench.harness.get_all_by_label("begins here").count(), 2);
    for _ in 0..16 {
        bench.press(Key::ArrowRight);
    }
    assert_eq!(bench.harness.get_all_by_label("lost").count(), 2);
    let eye = |bench: &Bench| match &bench.window().page {
        Page::Comparison(page) => page.eye(),
        _ => panic!("no comparison is shown"),
    };
    let before = eye(&bench);
    let second = bench.harness.get_all_by_label("The scene in three dimensions").last().unwrap().rect();
    bench.harness.drag_at(second.center());
    bench.harness.run_ok();
    bench.harness.hover_at(second.center() + egui::vec2(60.0, 0.0));
    bench.harness.run_ok();
    bench.harness.drop_at(second.center() + egui::vec2(60.0, 0.0));
    bench.settle();
    assert!(eye(&bench).yaw_rad != before.yaw_rad, "either scene turns both");
    bench.press(Key::M);
    bench.press(Key::U);
    assert!(!bench.shows("mean ADD-S"));
}

#[test]
fn runs_are_compared_from_the_start_page_and_from_a_run() {
    let (a, b) = (finished(), finished());
    let mut preferences = dark();
    preferences.remember(a.path());
    preferences.remember(b.path());
    let names = [a.path(), b.path()].map(mvt_viewer::captions::folder);
    let mut bench = Bench::new(WindowContents::Start, &preferences, [1280.0, 800.0], false);
    for name in &names {
        bench.click(&format!("compare {name}"));
    }
    bench.click("Compare two runs");
    assert!(bench.shows("Comparison of two runs"));
    bench.click("Open one");
    bench.click(&format!("open B {}", names[1]));
    assert!(bench.shows("Camera side"));
    bench.click("Compare");
    bench.click(&format!("with {}", names[0]));
    assert!(bench.shows("Comparison of two runs"));
    let mut bench = Bench::new(both(a.path(), Path::new("/nowhere")), &dark(), [1280.0, 800.0], false);
    assert!(bench.shows("This cannot be shown") && bench.shows("/nowhere holds no recording"));
    bench.click("Go to the start page");
}
