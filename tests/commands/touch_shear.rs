//! `touch predict` on rendered sensors whose gel carries dots: shear is read, and images without the dots are refused.

use image::RgbImage;
use mvt_frames::Isometry;
use mvt_objects::catalogue;
use mvt_render::rays::RayMesh;
use mvt_render::touch::{Background, GelPress, NoiseKey, TouchConfig, TouchFrame, TouchOptions, TouchRenderer};
use mvt_robot::digit::markers::GelShear;
use mvt_robot::digit::profile::SensorProfile;

use crate::workplace::Workplace;

/// Shear of the images that [`presses`] writes: to the right and downwards in millimetres, and the twist in radians.
const SHEAR: [([f64; 2], f64); 4] = [([0.0; 2], 0.0), ([0.8, 0.0], 0.0), ([-0.3, 0.6], 0.0), ([0.2, -0.4], -0.15)];

/// Writes images of a ball of 8 mm that drags the gel, and the untouched image `NAME_untouched.png`.
fn presses(workplace: &Workplace, name: &str) {
    let profile = SensorProfile::load(name).unwrap();
    let background = Background::Synthetic { seed: 5 };
    let options = TouchOptions { background, ..TouchOptions::of_profile(&profile, TouchConfig::Fork) };
    let renderer = TouchRenderer::new(&options).unwrap();
    let mut ball = catalogue::find("ball").unwrap().mesh_without_download().unwrap();
    let scale = 0.008 / ball.extents_m().max_element();
    ball.vertices.iter_mut().for_each(|vertex| *vertex *= scale);
    let (ball, mut frame) = (RayMesh::new(&ball), TouchFrame::default());
    std::fs::create_dir(workplace.path(name)).unwrap();
    renderer.empty().save(workplace.path(&format!("{name}_untouched.png"))).unwrap();
    for (k, (displacement_mm, twist_rad)) in (0_u32..).zip(SHEAR) {
        // The ball dents the gel by 0.8 mm.
        let gel_from_object = Isometry::translation(0.022 - 0.0008 + 0.004, 0.001, -0.001);
        let press = GelPress { gel_from_object, shear: GelShear { displacement_mm, twist_rad } };
        renderer.render_dragged(&ball, press, Some(NoiseKey { seed: 1, pad: 0, frame: k }), &mut frame);
        frame.calibrated().save(workplace.path(&format!("{name}/{k}.png"))).unwrap();
    }
}

const PREDICT: &str =
    "touch predict --images digit_markers --untouched digit_markers_untouched.png --profile digit_markers";

#[test]
fn shear_is_read_and_drawn() {
    let workplace = Workplace::new();
    presses(&workplace, "digit_markers");
    presses(&workplace, "digit");
    let lines = workplace.run(&format!("{PREDICT} --json --out out")).json();
    let plain = "touch predict --images digit --untouched digit_untouched.png --json --out plain";
    let plain = workplace.run(plain).json();
    let mut drawn_px = Vec::new();
    for (k, ([right_mm, down_mm], twist_rad)) in SHEAR.into_iter().enumerate() {
        let figure = |name: &str| lines[k][name].as_f64().unwrap();
        assert!((figure("shear_right_mm") - right_mm).abs() < 0.1, "{}", lines[k]);
        assert!((figure("shear_down_mm") - down_mm).abs() < 0.1, "{}", lines[k]);
        assert!((figure("twist_deg").to_radians() - twist_rad).abs() < 0.05, "{}", lines[k]);
        assert!(figure("shear_residual_mm") < 0.08 && figure("dots") > 60.0, "{}", lines[k]);
        // The network sees no dots: it reads the same as without them.
        let (marked, plain) = (figure("deepest_mm"), plain[k]["deepest_mm"].as_f64().unwrap());
        assert!((marked - plain).abs() < 0.2 * plain, "{marked} mm with dots, {plain} mm without");
        let picture = image::open(workplace.path(&format!("out/{k}_shear.png"))).unwrap().into_rgb8();
        let drawn = picture.pixels().filter(|pixel| pixel.0 == [240, 228, 66]).count();
        assert_eq!(picture.dimensions(), (480, 640));
        drawn_px.push(drawn);
    }
    // Dilation alone moves the dots around the contact less.
    assert!(drawn_px[1] > 300 && 2 * drawn_px[1] > 3 * drawn_px[0], "{drawn_px:?} pixels of arrows");
    // A sensor without dots has no such figures.
    assert_eq!(plain[0].get("shear_right_mm"), None);
    assert!(!workplace.path("plain/0_shear.png").exists());
    let head = |folder: &str| {
        let table = workplace.text(&format!("{folder}/predictions.csv"));
        table.lines().next().unwrap().to_owned()
    };
    assert_eq!(head("plain"), "id,area_mm2,deepest_mm,volume_mm3,force_n,force_sigma_n,plausibility");
    assert!(head("out").ends_with(",shear_right_mm,shear_down_mm,twist_deg,dilation,shear_residual_mm,dots"));
}

#[test]
fn images_and_profiles_that_do_not_fit_are_refused_or_said() {
    let workplace = Workplace::new();
    presses(&workplace, "digit_markers");
    presses(&workplace, "digit");
    let error = |options: &str| workplace.run(&format!("touch predict --out out {options}")).error();
    let unmarked = error("--images digit --untouched digit_untouched.png --profile digit_markers");
    assert!(unmarked.contains("shows 0 of the 72 dots of the profile"), "{unmarked}");
    // Marked untouched, but the images come from a gel without dots.
    let said = workplace
        .run("touch predict --images digit --untouched digit_markers_untouched.png --profile digit_markers --out lost")
        .warned();
    assert!(said.contains("dots of the untouched image are not found in 4 images"), "{said}");
    let other = RgbImage::from_pixel(240, 320, image::Rgb([200, 20, 20]));
    other.save(workplace.path("other.png")).unwrap();
    let other = error("--images digit_markers --untouched other.png --profile digit_markers");
    assert!(other.contains("another sensor") || other.contains("of the 72 dots"), "{other}");
    let profile = include_str!("../../scenes/robot/src/digit/profiles/digit_markers.toml");
    workplace.write("tiny.toml", profile.replace("pitch_mm = 1.38", "pitch_mm = 0.1"));
    let tiny = error("--images digit_markers --profile tiny.toml");
    assert!(tiny.contains("markers.pitch_mm must be from 0.4 to 6"), "{tiny}");
    workplace.write("wide.toml", profile.replace("pitch_mm = 1.38", "pitch_mm = 5.0"));
    let wide = error("--images digit_markers --profile wide.toml");
    assert!(wide.contains("markers.columns must be so few"), "{wide}");
}
