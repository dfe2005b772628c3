//! `touch describe`, `touch data`, `touch evaluate`, `bench networks`, and runs with a touch network.

use mvt_robot::digit::profile::SensorProfile;
use std::path::Path;

use serde_json::Value;

use crate::npy;
use crate::workplace::Workplace;

/// Returns the path of random weights of a tiny `default` network.
fn weights() -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("perception/touch/tests/fixtures");
    folder.join("default.safetensors").display().to_string()
}

/// The point of a DIGIT's gel at a pixel.
fn digit_point(u: f64, v: f64) -> mvt_frames::Point<mvt_frames::Gel> {
    SensorProfile::tacto().gel_surface().point(&SensorProfile::tacto().intrinsics(), u, v)
}

#[test]
fn networks_are_counted() {
    let workplace = Workplace::new();
    let description = workplace.run("touch describe vit --input 224 --json").json();
    let parts = description["parts"].as_array().unwrap();
    for count in ["parameters", "macs", "activation_bytes"] {
        let sum: u64 = parts.iter().map(|part| part[count].as_u64().unwrap()).sum();
        assert_eq!(description[count], sum, "{count}");
    }
    // ViT-S/16 has 12 blocks of 1.77 M parameters.
    let blocks = parts.iter().find(|part| part["name"] == "blocks").unwrap();
    assert_eq!(blocks["parameters"], 12 * 1_774_464, "{description}");
    // 250 is not a multiple of 16.
    assert!(workplace.run("touch describe default --input 250x320").good().contains("input 256x320"));
    workplace.write("small.toml", "[network]\nname = \"vit\"\nwidth = 192\nheads = 3\n\n[training]\nseed = 1\n");
    assert!(workplace.run("touch describe small.toml").good().contains("\"width\":192,\"depth\":12"));
    workplace.write("wrong.toml", "[network]\nname = \"vit\"\nwidht = 192\n");
    assert!(workplace.run("touch describe wrong.toml").error().contains("widht"));
    let said = workplace.run("touch describe resnet").error();
    assert!(
        ["vit", "mamba", "robust_mamba", "swin", "convnext", "default"].iter().all(|name| said.contains(name)),
        "{said}"
    );
    assert!(workplace.run("touch describe default --input 0x3").usage().contains("240x320"));
}

#[test]
fn networks_are_timed() {
    let workplace = Workplace::new();
    let line = format!("bench networks --weights {} --input 64x48 --batch 1,3 --seconds 0 --json", weights());
    let figures = workplace.run(&line).json();
    let figures = figures.as_array().unwrap();
    assert_eq!(figures.len(), 4, "two batches on one and two threads");
    assert!(figures.iter().all(|figure| figure["images_per_second"].as_f64().unwrap() > 0.0), "{figures:?}");
    assert!(workplace.run("bench networks --networks resnet").error().contains("robust_mamba"));
    assert!(workplace.run("bench networks --instructions mmx").usage().contains("avx512"));
}

/// Random weights predict nothing useful, but the predictions reach the result, simulated and from a log, and are the same
/// each time.
#[test]
fn runs_use_the_touch_network() {
    let workplace = Workplace::new();
    workplace.run("run --object cube70 --duration 0.4 --touch-depth network --quiet --out shipped").good();
    let network = format!("--touch-depth network --weights {}", weights());
    workplace.run("generate --object cube70 --logs 1 --duration 0.4 --cameras side --out set").good();
    for (name, source) in [("simulated", "--object cube70 --duration 0.4"), ("log", "--log set/cube70/00")] {
        let trajectory = |folder: &str| {
            // Random weights may or may not find an image plausible, which leads to a warning.
            assert_eq!(workplace.run(&format!("run {source} {network} --quiet --out {folder}")).code, Some(0));
            let text = std::fs::read_to_string(workplace.path(folder).join("trajectory.csv")).unwrap();
            text.lines().map(|line| line.rsplitn(5, ',').last().unwrap().to_owned()).collect::<Vec<_>>()
        };
        let first = trajectory(&format!("{name}1"));
        assert_eq!(first.len(), 13, "{first:?}");
        assert_eq!(first, trajectory(&format!("{name}2")));
    }
}

#[test]
fn damaged_weights_are_refused() {
    let workplace = Workplace::new();
    let whole = std::fs::read(weights()).unwrap();
    workplace.write("cut.safetensors", &whole[..whole.len() / 2]);
    let mut wrong = whole.clone();
    // The last number becomes NaN.
    let end = wrong.len();
    wrong[end - 2..].copy_from_slice(&[0xc0, 0x7f]);
    workplace.write("nan.safetensors", wrong);
    for (line, parts) in [
        ("run --touch-depth network --weights cut.safetensors", &["cut.safetensors"][..]),
        ("run --touch-depth network --weights nan.safetensors", &["nan.safetensors", "tensor", "NaN", "["]),
        ("run --touch-depth network --weights nowhere", &["nowhere"]),
        ("run --touch-depth truth --weights nan.safetensors", &["--touch-depth network"]),
        ("run --set touch.probability=2", &["touch.probability"]),
        ("evaluate --objects cube70 --out e --touch-depth network --weights nowhere", &["nowhere"]),
    ] {
        let said = workplace.run(line).error();
        assert!(parts.iter().all(|part| said.contains(part)), "{line}: {said}");
    }
}

/// The image shows an untouched gel, its depth is exact, and the mask claims contact on half of it.
#[test]
fn weights_are_scored_on_images_with_known_depth() {
    let workplace = Workplace::new();
    let folder = workplace.path("triples");
    std::fs::create_dir(&folder).unwrap();
    let depth = ndarray::Array2::from_shape_fn((320, 240), |(v, u)| digit_point(u as f64, v as f64).coords().x as f32);
    let image = image::RgbImage::from_pixel(240, 320, image::Rgb([90, 100, 95]));
    let mask = image::GrayImage::from_fn(240, 320, |u, _| image::Luma([if u < 120 { 255 } else { 0 }]));
    image.save(folder.join("a_img.png")).unwrap();
    mask.save(folder.join("a_mask.png")).unwrap();
    let line = format!("touch evaluate --weights {} --data triples --json", weights());
    assert!(workplace.run(&line).error().contains("a_depth_m.npy"), "the depth is missing");
    npy::write_f32(&folder.join("a_depth_m.npy"), &depth);
    let scores = workplace.run(&line).json();
    let score = |name: &str| scores[name].as_f64().unwrap();
    assert_eq!((score("images"), score("contact_images")), (1.0, 1.0));
    assert!(score("mae_mm") <= score("rmse_mm") && score("contact_mae_mm") <= score("contact_rmse_mm"), "{scores}");
    assert!((0.0..=1.0).contains(&score("iou")) && score("ms_per_image") > 0.0, "{scores}");

    // The size of the sensor does not change the scores; another size does.
    let at = |size: &str| workplace.run(&format!("{line} --input {size}")).json()["mae_mm"].as_f64().unwrap();
    assert!((at("240x320") - score("mae_mm")).abs() < 1e-6 && at("112x160") != score("mae_mm"));

    image::RgbImage::new(240, 240).save(folder.join("a_img.png")).unwrap();
    let said = workplace.run(&line).error();
    assert!(said.contains("240 x 240") && said.contains("240 wide and 320 high"), "{said}");
    std::fs::create_dir(workplace.path("nothing")).unwrap();
    let line = format!("touch evaluate --weights {} --data nothing", weights());
    assert!(workplace.run(&line).error().contains("no *_img.png"));
    assert!(workplace.run("touch evaluate --weights triples/a_mask.png --data triples").error().contains("a_mask.png"));
}

/// Presses depend on their seed alone, are as deep as the protocol demands, and can be read by `touch evaluate`.
#[test]
fn presses_are_rendered_for_the_scoring_of_networks() {
    let workplace = Workplace::new();
    let line = |folder: &str, rest: &str| {
        format!("touch data --objects mug,large_dice --images 4 --seed 5 --out {folder} {rest}")
    };
    workplace.run(&line("a", "")).good();
    workplace.run(&line("b", "")).good();
    let bytes = |folder: &str, file: &str| std::fs::read(workplace.path(folder).join(file)).unwrap();
    for id in 0..4 {
        for file in ["img.png", "mask.png", "depth_m.npy"].map(|what| format!("{id:05}_{what}")) {
            assert!(bytes("a", &file) == bytes("b", &file), "{file} differs");
        }
        let depth_m = npy::read_f32(&workplace.path(&format!("a/{id:05}_depth_m.npy")));
        let indentation_mm = depth_m
            .indexed_iter()
            .map(|((v, u), depth)| 1e3 * (digit_point(u as f64, v as f64).coords().x - f64::from(*depth)));
        let deepest = indentation_mm.fold(0.0, f64::max);
        assert!((0.4..1.6).contains(&deepest), "{deepest} mm");
    }
    let score = |folder: &str, rest: &str| -> Value {
        let line = format!("touch evaluate --weights {} --data {folder} --json {rest}", weights());
        workplace.run(&line).json()
    };
    let scores = score("a", "");
    assert_eq!([&scores["contact_images"], &scores["untouched"]["file"]], [4, 4]);
    let unsubtracted = score("a", "--no-subtraction");
    assert_eq!(unsubtracted["untouched"]["unknown"], 4);
    assert_ne!(unsubtracted["mae_mm"], scores["mae_mm"]);
    // The untouched image can be estimated from images of one sensor, but not from images of several.
    for (sensors, of) in [(1, "images"), (16, "unknown")] {
        workplace.write("data.toml", format!("[data]\nknown_untouched = 0.0\nbackground = 0.0\nsensors = {sensors}\n"));
        let folder = format!("{of}-{sensors}");
        let line = format!("touch data --objects mug --images 16 --config data.toml --out {folder}");
        workplace.run(&line).good();
        assert_eq!(score(&folder, "")["untouched"][of], 16);
    }

    workplace.write("data.toml", "[data]\nuntouched = 1.0\n");
    workplace.run(&line("untouched", "--config data.toml")).good();
    assert_ne!(bytes("untouched", "00000_img.png"), bytes("a", "00000_img.png"));
    workplace.write("data.toml", "[data]\nuntuched = 1.0\n");
    assert!(workplace.run(&line("c", "--config data.toml")).error().contains("untuched"));
    assert!(workplace.run(&line("a", "")).warned().contains("a.1"));
    assert!(workplace.run("touch data --objects mugg --out d").error().contains("mugg"));
}

/// What units give does not depend on the number of threads.
#[test]
fn units_that_no_training_has_seen_are_read() {
    let workplace = Workplace::new();
    let run = |threads: &str| {
        let options = "--faults 0.5 --objects ball,cube70 --readings readings.jsonl --overwrite --json";
        let mut command = workplace.command(&format!("touch units --units 2 --presses 3 {options}"));
        let said = String::from_utf8(command.env("RAYON_NUM_THREADS", threads).output().unwrap().stdout).unwrap();
        (said, workplace.text("readings.jsonl"))
    };
    let (said, readings) = run("1");
    assert!(said.contains("\"readings\": 6") && readings.lines().count() == 6, "{said}\n{readings}");
    assert_eq!((said, readings), run("2"));
    // A part of the error is the gain, which a ball shows.
    let error_mm = |options: &str| {
        let line = format!("touch units --units 4 --presses 4 --objects ball --json {options}");
        workplace.run(&line).json()["contact_mae_mm"].as_f64().unwrap()
    };
    assert!(error_mm("--balls 10") < 0.9 * error_mm(""));
    let error = |options: &str| workplace.run(&format!("touch units {options}")).error();
    assert!(error("--faults 2").contains("from 0 to 1") && error("--objects nothing").contains("nothing"));
    assert!(error("--profile tacto").contains("look alike"));
}
