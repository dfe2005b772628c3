//! With half the light a press was read as half as deep, at full plausibility, and so it was with another gamma or a limited range; a mirrored
//! image was called turned by 180 degrees.

use std::path::Path;

use image::RgbImage;
use image::imageops::{flip_horizontal, flip_vertical};

use crate::workplace::{Workplace, others_data};

const PREDICT: &str = "touch predict --images in --untouched in/untouched.png --out out --json";

/// A press on a real sensor, with its images changed.
fn changed(data: &Path, change: impl Fn(RgbImage) -> RgbImage) -> Workplace {
    let workplace = Workplace::new();
    std::fs::create_dir(workplace.path("in")).unwrap();
    for name in ["000_img", "001_img", "002_img", "untouched"] {
        let image = image::open(data.join("dd").join(format!("{name}.png"))).unwrap().into_rgb8();
        change(image).save(workplace.path(&format!("in/{name}.png"))).unwrap();
    }
    workplace
}

fn lit(data: &Path, light: [f32; 3]) -> Workplace {
    changed(data, |mut image| {
        for pixel in image.pixels_mut() {
            for (level, light) in pixel.0.iter_mut().zip(light) {
                *level = (f32::from(*level) * light).round() as u8;
            }
        }
        image
    })
}

/// Deepest indentation of each image, and the least plausibility.
fn deepest_mm(stdout: &str) -> (Vec<f64>, f64) {
    let lines: serde_json::Value = serde_json::from_str(stdout).unwrap();
    let of = |key: &str| lines.as_array().unwrap().iter().map(|line| line[key].as_f64().unwrap()).collect::<Vec<_>>();
    (of("deepest_mm"), of("plausibility").into_iter().fold(1.0, f64::min))
}

#[test]
fn a_press_is_as_deep_under_any_light() {
    let Some(data) = others_data("real_digit") else { return };
    let (full, _) = deepest_mm(&lit(&data, [1.0; 3]).run(PREDICT).good());
    for light in [[0.5; 3], [0.3; 3], [0.7; 3], [1.3; 3], [1.0, 0.5, 1.0], [0.6, 1.0, 1.0]] {
        let ended = lit(&data, light).run(PREDICT);
        assert!(ended.stderr.contains("of the usual red, green and blue light"), "{light:?}: {ended:?}");
        let (found, _) = deepest_mm(&ended.stdout);
        for (found, full) in found.iter().zip(&full) {
            assert!((found / full - 1.0).abs() < 0.12, "{light:?}: {found} instead of {full} mm");
        }
    }
    // Where the light is more than a pixel can hold, a depth that is too small is at least not plausible.
    let ended = lit(&data, [2.2; 3]).run(PREDICT);
    let lines: serde_json::Value = serde_json::from_str(&ended.stdout).unwrap();
    for (line, full) in lines.as_array().unwrap().iter().zip(&full) {
        let [found, plausibility] = ["deepest_mm", "plausibility"].map(|key| line[key].as_f64().unwrap());
        assert!((found / full - 1.0).abs() < 0.12 || plausibility < 0.5, "{line} instead of {full} mm");
    }
    // Too dark to be read.
    let (_, plausibility) = deepest_mm(&lit(&data, [0.06; 3]).run(PREDICT).stdout);
    assert!(plausibility < 0.2, "{plausibility}");
}

#[test]
fn a_press_is_as_deep_through_any_camera() {
    let Some(data) = others_data("real_digit") else { return };
    let (full, _) = deepest_mm(&lit(&data, [1.0; 3]).run(PREDICT).good());
    for (power, low, high) in [(0.45, 0.0, 255.0), (0.7, 0.0, 255.0), (1.6, 0.0, 255.0), (1.0, 64.0, 192.0)] {
        let response = |level: u8| (low + (high - low) * (f32::from(level) / 255.0_f32).powf(power)).round() as u8;
        let through = changed(&data, |mut image| {
            image.iter_mut().for_each(|level| *level = response(*level));
            image
        });
        for (found, full) in deepest_mm(&through.run(PREDICT).stdout).0.iter().zip(&full) {
            assert!((found / full - 1.0).abs() < 0.15, "power {power}, {low} to {high}: {found} instead of {full} mm");
        }
    }
    // Exposure that has changed since the untouched image was taken.
    for ratio in [0.9, 1.1] {
        let workplace = lit(&data, [ratio; 3]);
        std::fs::copy(lit(&data, [1.0; 3]).path("in/untouched.png"), workplace.path("in/untouched.png")).unwrap();
        for (found, full) in deepest_mm(&workplace.run(PREDICT).good()).0.iter().zip(&full) {
            assert!((found / full - 1.0).abs() < 0.1, "exposure {ratio}: {found} instead of {full} mm");
        }
    }
}

#[test]
fn mirrored_images_are_said_to_be_mirrored() {
    let Some(data) = others_data("real_digit") else { return };
    let (plain, _) = deepest_mm(&changed(&data, |image| image).run(PREDICT).good());
    for mirror in [|image: RgbImage| flip_horizontal(&image), |image: RgbImage| flip_vertical(&image)] {
        let ended = changed(&data, mirror).run(PREDICT);
        assert!(ended.stderr.contains("the images are mirrored"), "{ended:?}");
        assert_eq!(deepest_mm(&ended.stdout).0, plain);
    }
}
