//! `touch predict`, held against images of real DIGITs.

use std::path::Path;
use std::process::Command;

use image::{GrayImage, RgbImage};

use crate::workplace::{Workplace, others_data, skip};

/// Predicts with an untouched image, and returns the means over the images of a sensor by the rules that come with them: `iou`, `mae_full_mm`,
/// `ball_radius_mm` and `false_contact_percent`. `None` where nothing can judge them.
fn score(sensor: &str, untouched: &str) -> Option<impl Fn(&str) -> f64> {
    let data = others_data("real_digit")?;
    let workplace = Workplace::new();
    let mut command = workplace.command("touch predict --out out");
    command.arg("--images").arg(data.join(sensor)).arg("--untouched").arg(data.join(untouched).join("untouched.png"));
    assert!(command.output().unwrap().status.success());
    let mut judge = Command::new("python3");
    judge.arg(data.join("score.py")).arg(data.join(sensor)).arg(workplace.path("out")).arg("--json");
    let judged = judge.output();
    let Some(judged) = judged.ok().filter(|judged| !String::from_utf8_lossy(&judged.stderr).contains("No module"))
    else {
        skip("Python with NumPy and Pillow is not installed");
        return None;
    };
    let means: serde_json::Value = serde_json::from_slice(&judged.stdout).unwrap();
    Some(move |name: &str| means[name].as_f64().unwrap_or_else(|| panic!("no {name} in {means}")))
}

#[test]
fn a_ball_on_real_sensors_is_read() {
    for sensor in ["dd", "tx1", "tx2"] {
        let Some(mean) = score(sensor, sensor) else { return };
        let [iou, mae_mm] = [mean("iou"), mean("mae_full_mm")];
        assert!(iou > 0.83 && mae_mm < 0.07, "{sensor}: {iou}, {mae_mm} mm");
        let [radius_mm, beyond] = [mean("ball_radius_mm"), mean("false_contact_percent")];
        assert!((2.6..3.3).contains(&radius_mm) && beyond < 0.2, "{sensor}: {radius_mm} mm, {beyond} %");
    }
}

#[test]
fn an_untouched_image_of_another_day_adds_little_contact() {
    let Some(mean) = score("dd", "tx1") else { return };
    assert!(mean("false_contact_percent") < 0.5, "{}", mean("false_contact_percent"));
}

/// Returns a workplace with three images of a sensor, changed, and its untouched image, changed likewise.
fn changed(data: &Path, change: impl Fn(RgbImage) -> RgbImage) -> Workplace {
    let workplace = Workplace::new();
    std::fs::create_dir(workplace.path("in")).unwrap();
    for name in ["000_img", "001_img", "002_img", "untouched"] {
        let image = image::open(data.join("dd").join(format!("{name}.png"))).unwrap().into_rgb8();
        change(image).save(workplace.path(&format!("in/{name}.png"))).unwrap();
    }
    workplace
}

/// Returns the contact masks.
fn masks(workplace: &Workplace) -> Vec<Vec<u8>> {
    let masks = ["000", "001", "002"].map(|id| workplace.path(&format!("out/{id}_contact.png")));
    masks.iter().map(|path| image::open(path).unwrap().into_luma8().into_raw()).collect()
}

const PREDICT: &str = "touch predict --images in --untouched in/untouched.png --out out";

#[test]
fn sensors_that_lie_and_colours_in_another_order_are_noticed() {
    let Some(data) = others_data("real_digit") else { return };
    use image::imageops::{rotate90, rotate180};
    let upright = changed(&data, |image| image);
    upright.run(PREDICT).good();
    let truth = masks(&upright);
    assert!(truth.iter().all(|mask| mask.iter().filter(|&&level| level > 127).count() > 800));
    let swap = |mut image: RgbImage| {
        image.pixels_mut().for_each(|pixel| pixel.0.swap(0, 2));
        image
    };
    let lying = changed(&data, |image| rotate90(&image));
    assert!(lying.run(PREDICT).warned().contains("turned by 270 degrees"));
    assert_eq!(masks(&lying), truth);
    let standing = changed(&data, |image| swap(rotate180(&image)));
    let said = standing.run(PREDICT).warned();
    assert!(said.contains("180 degrees") && said.contains("BGR"), "{said}");
    assert_eq!(masks(&standing), truth);
    let large = changed(&data, |image| image::imageops::resize(&image, 480, 640, image::imageops::FilterType::Nearest));
    large.run(PREDICT).good();
    let differ = masks(&large).concat().iter().zip(truth.concat()).filter(|(a, b)| **a != *b).count();
    assert!(differ < 300, "{differ} pixels");
}

#[test]
fn results_are_files_and_a_table() {
    let Some(data) = others_data("real_digit") else { return };
    let workplace = changed(&data, |image| image);
    let json = workplace.run(&format!("{PREDICT} --json")).json();
    for (line, id) in json.as_array().unwrap().iter().zip(["000", "001", "002"]) {
        assert_eq!(line["id"], id);
        // A ball of 3 mm that lies on the gel within a radius of 1 to 1.6 mm.
        assert!((3.0..8.0).contains(&line["area_mm2"].as_f64().unwrap()), "{line}");
        assert!((0.3..0.9).contains(&line["deepest_mm"].as_f64().unwrap()), "{line}");
        assert!(line["plausibility"].as_f64().unwrap() > 0.5, "{line}");
    }
    let table = workplace.text("out/predictions.csv");
    assert_eq!(table.lines().count(), 4);
    assert!(workplace.path("out/001_picture.png").exists());
    // Three images are few for a median.
    let said = workplace.run("touch predict --images in --out median").warned();
    assert!(said.contains("--untouched"), "{said}");
}

#[test]
fn what_is_no_image_of_a_sensor_is_refused() {
    let Some(data) = others_data("real_digit") else { return };
    let workplace = changed(&data, |image| image);
    let error = |options: &str| workplace.run(&format!("touch predict --out out {options}")).error();
    assert!(error("--images nowhere").contains("nowhere"));
    std::fs::create_dir(workplace.path("empty")).unwrap();
    assert!(error("--images empty").contains("no image"));
    assert!(error("--images in in/000_img.png").contains("named \"000\""));
    assert!(error("--images in --profile digitt").contains("choose digit, digit_markers, gelsight_mini"));
    // The shipped weights would take light from the right for light from above.
    workplace.write("odd.toml", b"[appearance]\nled_angles_deg = [60.0, 180.0, -60.0]\n");
    assert!(error("--images in --profile odd.toml").contains("no weights are shipped"));
    GrayImage::new(240, 320).save(workplace.path("grey.png")).unwrap();
    assert!(error("--images grey.png").contains("grey image"));
    RgbImage::new(100, 320).save(workplace.path("narrow.png")).unwrap();
    assert!(error("--images in --untouched narrow.png").contains("differ in size"));
    RgbImage::from_pixel(240, 320, image::Rgb([220, 30, 200])).save(workplace.path("other.png")).unwrap();
    assert!(error("--images in --untouched other.png").contains("another sensor"));
    workplace.write("bad.png", b"no image");
    assert!(error("--images bad.png").contains("bad.png"));
}
