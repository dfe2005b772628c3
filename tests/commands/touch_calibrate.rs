//! `touch calibrate`: gains and directions of LEDs from presses of a ball, on rendered sensors whose light is known.

use mvt_frames::Isometry;
use mvt_objects::catalogue;
use mvt_render::rays::RayMesh;
use mvt_render::touch::{
    Background, NoiseKey, TouchConfig, TouchFrame, TouchOptions, TouchRenderer, synthetic_background,
};
use mvt_robot::digit::profile::SensorProfile;

use crate::workplace::Workplace;

/// Writes images of a ball of 6 mm at twelve places of a sensor, and its untouched image.
fn presses(workplace: &Workplace, profile: &SensorProfile) {
    let background = Background::Image(synthetic_background(profile.size_px, 5));
    let options = TouchOptions { background, ..TouchOptions::of_profile(profile, TouchConfig::Fork) };
    let renderer = TouchRenderer::new(&options).unwrap();
    let mut ball = catalogue::find("ball").unwrap().mesh_without_download().unwrap();
    let scale = 0.006 / ball.extents_m().max_element();
    ball.vertices.iter_mut().for_each(|vertex| *vertex *= scale);
    let (ball, mut frame) = (RayMesh::new(&ball), TouchFrame::default());
    std::fs::create_dir(workplace.path("balls")).unwrap();
    renderer.empty().save(workplace.path("balls/untouched.png")).unwrap();
    for k in 0..12_u32 {
        let place =
            options.gel.point(&options.camera, f64::from(60 + 60 * (k % 3)), f64::from(70 + 60 * (k / 3))).coords();
        // The ball's middle lies on the gel's normal, 0.5 mm deeper than it touches.
        let out = options.gel.normal(mvt_frames::Point::new(place.x, place.y, place.z)).coords();
        let middle = place - out * (0.003 - 0.0005);
        let pose = Isometry::translation(middle.x, middle.y, middle.z);
        renderer.render(&ball, pose, Some(NoiseKey { seed: 1, pad: 0, frame: k }), &mut frame);
        frame.calibrated().save(workplace.path(&format!("balls/{k:02}_img.png"))).unwrap();
    }
}

const CALIBRATE: &str = "touch calibrate --images balls --untouched balls/untouched.png";

#[test]
fn drawn_lights_are_found() {
    let workplace = Workplace::new();
    let mut profile = SensorProfile::load("digit").unwrap();
    let mut appearance = profile.appearance.unwrap();
    appearance.sensitivity = [90.0, 150.0, 120.0];
    appearance.led_angles_deg = [-40.0, -170.0, 85.0];
    profile.appearance = Some(appearance);
    presses(&workplace, &profile);
    let said = workplace.run(&format!("{CALIBRATE} --ball-mm 6 --out mine.toml")).good();
    assert!(said.contains("of 12 images used") && said.contains("presses that were left out: radius"), "{said}");
    let path = workplace.path("mine.toml");
    let found = SensorProfile::load(path.to_str().unwrap()).unwrap().appearance.unwrap();
    for c in 0..3 {
        let gain = found.sensitivity[c] / appearance.sensitivity[c];
        assert!((0.75..1.25).contains(&gain), "colour {c}: {gain} of its gain\n{said}");
        let turn = found.led_angles_deg[c] - appearance.led_angles_deg[c];
        assert!(turn.abs() < 15.0, "colour {c}: {turn} degrees off\n{said}");
    }
    // The profile is read by the command that it is for.
    workplace.run("touch predict --images balls --untouched balls/untouched.png --profile mine.toml --out out").good();

    assert!(workplace.run(&format!("{CALIBRATE} --ball-mm 6 --out mine.toml")).error().contains("mine.toml"));
    let error = |options: &str| workplace.run(&format!("{CALIBRATE} {options} --out other.toml")).error();
    assert!(error("--ball-mm 400").contains("1 to 40"));
    assert!(error("--ball-mm 0.006").contains("in millimetres"));
    assert!(error("--ball-mm 6 --px-per-mm 2").contains("8 to 40"));
    assert!(error("--ball-mm 6 --profile tacto").contains("no LEDs"));
    assert!(!workplace.path("other.toml").exists());
}

/// A few images of a ball among many others give no profile without a word.
#[test]
fn few_presses_of_many_give_no_profile() {
    let workplace = Workplace::new();
    presses(&workplace, &SensorProfile::load("digit").unwrap());
    for k in 3..12 {
        std::fs::copy(workplace.path("balls/untouched.png"), workplace.path(&format!("balls/{k:02}_img.png"))).unwrap();
    }
    let error = workplace.run(&format!("{CALIBRATE} --ball-mm 6 --out few.toml")).error();
    assert!(error.contains("of 12 images show a round contact") && error.contains("--ball-mm"), "{error}");
    assert!(!workplace.path("few.toml").exists());
}

/// Forces of a scale become those that `touch predict` states.
#[test]
fn the_stiffness_of_a_gel_is_measured() {
    let workplace = Workplace::new();
    presses(&workplace, &SensorProfile::load("digit").unwrap());
    let weigh = |table: &str| {
        workplace.write("forces.csv", table.as_bytes());
        workplace.run("touch weigh --images balls --untouched balls/untouched.png --forces forces.csv --out stiff.toml")
    };
    assert!(weigh("00,1\n").error().contains("only 1 of 12 images"));
    assert!(weigh("00,0.01\n03,9\n05,0.2\n07,50\n").error().contains("do not belong together"));
    assert!(weigh("id,force_n\n00,0.6\n03,0.6\n05,0.6\n07,0.6\n").good().contains("4 presses"));
    let predict = "touch predict --images balls --untouched balls/untouched.png --profile stiff.toml --out out --json";
    let lines = workplace.run(predict).json();
    for line in lines.as_array().unwrap() {
        let [force_n, sigma_n] = ["force_n", "force_sigma_n"].map(|key| line[key].as_f64().unwrap());
        assert!((0.4..0.9).contains(&force_n) && sigma_n < 0.3 * force_n, "{line}");
    }
}
