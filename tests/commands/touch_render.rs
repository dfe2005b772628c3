//! `touch render`: arrays that NumPy reads, and refusals of a wrong pose, mesh or background.

use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;

use crate::npy;
use crate::workplace::Workplace;

const RADIUS_M: f64 = 0.008;
const INDENTATION_M: f64 = 0.001;
/// Distance from the camera to the gel on the optical axis, along x.
const APEX_M: f64 = 0.022;

/// Returns a sphere as OBJ, with a pole towards the camera.
fn sphere() -> String {
    const RINGS: usize = 60;
    const SIDES: usize = 120;
    let mut text = format!("v {} 0 0\nv {RADIUS_M} 0 0\n", -RADIUS_M);
    for ring in 1..RINGS {
        let (sin, cos) = (PI * ring as f64 / RINGS as f64).sin_cos();
        for side in 0..SIDES {
            let (y, z) = (TAU * side as f64 / SIDES as f64).sin_cos();
            writeln!(text, "v {} {} {}", -RADIUS_M * cos, RADIUS_M * sin * y, RADIUS_M * sin * z).unwrap();
        }
    }
    let at = |ring: usize, side: usize| 3 + (ring - 1) * SIDES + side % SIDES;
    for side in 0..SIDES {
        writeln!(text, "f 1 {} {}", at(1, side), at(1, side + 1)).unwrap();
        writeln!(text, "f 2 {} {}", at(RINGS - 1, side + 1), at(RINGS - 1, side)).unwrap();
        for ring in 1..RINGS - 1 {
            let [a, b] = [at(ring, side), at(ring, side + 1)];
            let [c, d] = [at(ring + 1, side), at(ring + 1, side + 1)];
            writeln!(text, "f {a} {c} {b}\nf {b} {c} {d}").unwrap();
        }
    }
    text
}

fn pose(x: f64, z: f64) -> String {
    format!("[[1,0,0,{x}],[0,1,0,0],[0,0,1,{z}],[0,0,0,1]]")
}

fn with_sphere() -> Workplace {
    let workplace = Workplace::new();
    let centre = APEX_M + RADIUS_M - INDENTATION_M;
    workplace.write("sphere.obj", sphere());
    workplace.write("fork.json", pose(centre, 0.0));
    // TACTO 0.0.3 has its camera at z = 15 mm of the sensor's frame.
    workplace.write("tacto.json", pose(centre, 0.015));
    workplace.write("away.json", pose(1.0, 0.0));
    workplace
}

#[test]
fn a_sphere_indents_the_gel_by_its_depth() {
    let workplace = with_sphere();
    workplace.run("touch render --mesh sphere.obj --pose away.json --out empty").good();
    let empty = npy::read_f32(&workplace.path("empty_depth.npy"));
    for config in ["fork", "tacto"] {
        let line = format!("touch render --mesh sphere.obj --pose {config}.json --config {config} --out new/{config}");
        assert_eq!(workplace.run(&line).good(), "");
        let raw = npy::read_u8(&workplace.path(&format!("new/{config}_rgb_raw.npy")));
        let calibrated = npy::read_u8(&workplace.path(&format!("new/{config}_rgb_cal.npy")));
        let depth = npy::read_f32(&workplace.path(&format!("new/{config}_depth.npy")));
        assert_eq!((raw.dim(), calibrated.dim(), depth.dim()), ((320, 240, 3), (320, 240, 3), (320, 240)));

        // The four pixels around the optical axis show the pole; the corners show the untouched gel.
        let nearest = depth.iter().copied().fold(f32::INFINITY, f32::min);
        let expected = APEX_M - INDENTATION_M;
        assert!((f64::from(depth[[159, 119]]) - expected).abs() < 3e-6, "{config}: {}", depth[[159, 119]]);
        assert!(nearest < depth[[160, 120]] + 1e-6 || nearest == depth[[0, 0]], "{config}: {nearest}");
        let touched = depth.iter().zip(&empty).filter(|(with, without)| *without - *with > 1e-6).count();
        // The cap inside the gel has radius sqrt(2 r d - d^2) = 3.9 mm on a pad of 20 x 30 mm, less for the bulge.
        assert!((2000..20_000).contains(&touched), "{config}: {touched} pixels touch");
        assert_eq!(depth[[0, 0]], empty[[0, 0]]);
        assert_ne!(raw[[159, 119, 0]], raw[[0, 0, 0]]);
    }
    // Noise is off.
    workplace.run("touch render --mesh sphere.obj --pose fork.json --out again").good();
    for array in ["rgb_raw", "rgb_cal", "depth"] {
        let read = |prefix: &str| std::fs::read(workplace.path(&format!("{prefix}_{array}.npy"))).unwrap();
        assert_eq!(read("again"), read("new/fork"), "{array}");
    }
}

#[test]
fn the_calibrated_image_lies_over_the_background() {
    let workplace = with_sphere();
    let grey = image::RgbImage::from_pixel(240, 320, image::Rgb([90, 100, 110]));
    grey.save(workplace.path("grey.png")).unwrap();
    workplace.run("touch render --mesh sphere.obj --pose fork.json --background grey.png --out over").good();
    let calibrated = npy::read_u8(&workplace.path("over_rgb_cal.npy"));
    let at = |row: usize, column: usize| [0, 1, 2].map(|c| calibrated[[row, column, c]]);
    assert_eq!(at(5, 5), [90, 100, 110]);
    assert_ne!(at(130, 119), [90, 100, 110]);
}

#[test]
fn wrong_input_is_named() {
    let workplace = with_sphere();
    let render = |mesh: &str, pose: &str, more: &str| {
        workplace.run(&format!("touch render --mesh {mesh} --pose {pose} --out out/x {more}"))
    };
    for (text, word) in [
        ("", "4 x 4"),
        ("{}", "4 x 4"),
        ("[[1,0,0],[0,1,0],[0,0,1]]", "4 x 4"),
        ("[[1,0,0,0],[0,1,0,0],[0,0,1,0]]", "4 x 4"),
        ("[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1],[0,0,0,1]]", "4 x 4"),
        ("[[NaN,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]", "4 x 4"),
        ("[[1,0,0,1e999],[0,1,0,0],[0,0,1,0],[0,0,0,1]]", "4 x 4"),
        ("[[1,0,0,null],[0,1,0,0],[0,0,1,0],[0,0,0,1]]", "4 x 4"),
        ("[[2,0,0,0],[0,2,0,0],[0,0,2,0],[0,0,0,1]]", "rigid"),
        ("[[-1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]", "rigid"),
        ("[[0,0,0,0],[0,0,0,0],[0,0,0,0],[0,0,0,0]]", "rigid"),
        // Column-major: the translation is where the row 0 0 0 1 should be.
        ("[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0.03,0,0,1]]", "rigid"),
    ] {
        workplace.write("wrong.json", text);
        let said = render("sphere.obj", "wrong.json", "").error();
        assert!(said.contains("wrong.json") && said.contains(word), "{text}: {said}");
    }
    assert!(render("sphere.obj", "nowhere.json", "").error().contains("nowhere.json"));
    assert!(render("nowhere.stl", "fork.json", "").error().contains("nowhere.stl"));
    assert!(render("fork.json", "fork.json", "").error().contains(".obj, .stl or .ply"));
    image::RgbImage::new(320, 240).save(workplace.path("lying.png")).unwrap();
    assert!(render("sphere.obj", "fork.json", "--background lying.png").error().contains("320 x 240"));
    assert!(render("sphere.obj", "fork.json", "--background sphere.obj").error().contains("sphere.obj"));
    assert!(render("sphere.obj", "fork.json", "--background nowhere.png").error().contains("nowhere.png"));
    assert!(render("sphere.obj", "fork.json", "--config gelsight").usage().contains("fork or tacto"));
    assert!(!workplace.path("out").exists(), "something was written");
    workplace.write("file", "");
    let said = workplace.run("touch render --mesh sphere.obj --pose fork.json --out file/x").error();
    assert!(said.contains("file"), "{said}");
}
