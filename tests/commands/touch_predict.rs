//! `touch predict`, held against images of real DIGITs.

use std::path::{Path, PathBuf};

use image::{GrayImage, RgbImage};
use mvt_feelsight::npy;

use crate::workplace::Workplace;

/// Circles of a ball's contact in an image: middle, radius of contact and fade length, and middle and radius of the mask, pixels.
struct Circles {
    id: String,
    contact: [f64; 4],
    mask: [f64; 3],
}

/// Means over the images of a sensor.
#[derive(Debug)]
struct RealScores {
    iou: f64,
    mae_mm: f64,
    /// Radius of the ball from the curvature of the depth, millimetres; median.
    radius_mm: f64,
    false_contact_percent: f64,
}

const PX_PER_MM: f64 = 18.8;
const BALL_MM: f64 = 3.0;

fn folder(sensor: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/real_digit").join(sensor)
}

fn circles(sensor: &str) -> Vec<Circles> {
    let text = std::fs::read_to_string(folder(sensor).join("circles.csv")).unwrap();
    let line = |line: &str| {
        let (id, numbers) = line.split_once(',').unwrap();
        let numbers: Vec<f64> = numbers.split(',').map(|number| number.parse().unwrap()).collect();
        Circles { id: id.to_owned(), contact: numbers[..4].try_into().unwrap(), mask: numbers[4..].try_into().unwrap() }
    };
    text.lines().skip(1).map(line).collect()
}

/// Predicts with an untouched image, and returns the scores.
fn score(sensor: &str, untouched: &Path, options: &str) -> RealScores {
    let workplace = Workplace::new();
    let mut command = workplace.command(&format!("touch predict --out out {options}"));
    command.arg("--images").arg(folder(sensor)).arg("--untouched").arg(untouched);
    assert!(command.output().unwrap().status.success());
    let circles = circles(sensor);
    let (mut sums, mut radii) = ([0.0; 3], Vec::new());
    for Circles { id, contact: [x, y, a, fade], mask: [mask_x, mask_y, mask_radius] } in &circles {
        let depth = npy::read(&workplace.path(&format!("out/{id}_indentation_mm.npy"))).unwrap();
        let depth: Vec<f64> = depth.to_f64().collect();
        let contact: GrayImage = image::open(workplace.path(&format!("out/{id}_contact.png"))).unwrap().into_luma8();
        let (mut both, mut either, mut inside, mut error, mut beyond) = (0.0_f64, 0.0_f64, 0.0, 0.0, 0.0);
        // Least squares of the depth inside over 1, u, v and -r^2 / 2.
        let (mut normal, mut right) = (nalgebra::Matrix4::<f64>::zeros(), nalgebra::Vector4::zeros());
        for (i, (&mm, level)) in depth.iter().zip(contact.iter()).enumerate() {
            let (u, v) = ((i % 240) as f64 - x, (i / 240) as f64 - y);
            let (r, touches) = (u.hypot(v), *level > 127);
            let from_mask = (u + x - mask_x).hypot(v + y - mask_y);
            let in_mask = from_mask <= *mask_radius;
            both += f64::from(u8::from(in_mask && touches));
            either += f64::from(u8::from(in_mask || touches));
            beyond += f64::from(u8::from(touches && from_mask > 1.5 * mask_radius));
            if r <= *a {
                let truth = ((a * a - r * r) / 2.0 + a * fade) / (BALL_MM * PX_PER_MM) / PX_PER_MM;
                inside += 1.0;
                error += (mm - truth).abs();
                let terms = nalgebra::Vector4::new(1.0, u, v, -r * r / 2.0 / PX_PER_MM / PX_PER_MM);
                normal += terms * terms.transpose();
                right += terms * mm;
            }
        }
        let term = [both / either.max(1.0), error / inside, 100.0 * beyond / depth.len() as f64];
        sums.iter_mut().zip(term).for_each(|(sum, term)| *sum += term / circles.len() as f64);
        radii.push(1.0 / normal.lu().solve(&right).unwrap()[3]);
    }
    radii.sort_by(f64::total_cmp);
    let [iou, mae_mm, false_contact_percent] = sums;
    RealScores { iou, mae_mm, radius_mm: radii[radii.len() / 2], false_contact_percent }
}

#[test]
fn a_ball_on_real_sensors_is_read() {
    for sensor in ["dd", "tx1", "tx2"] {
        let scores = score(sensor, &folder(sensor).join("untouched.png"), "");
        assert!(scores.iou > 0.83 && scores.mae_mm < 0.07, "{sensor}: {scores:?}");
        assert!((2.6..3.3).contains(&scores.radius_mm) && scores.false_contact_percent < 0.2, "{sensor}: {scores:?}");
    }
}

#[test]
fn an_untouched_image_of_another_day_adds_little_contact() {
    let scores = score("dd", &folder("tx1").join("untouched.png"), "");
    assert!(scores.false_contact_percent < 0.5, "{scores:?}");
}

/// Returns a workplace with three images of a sensor, changed, and its untouched image, changed likewise.
fn changed(change: impl Fn(RgbImage) -> RgbImage) -> Workplace {
    let workplace = Workplace::new();
    std::fs::create_dir(workplace.path("in")).unwrap();
    for name in ["000_img", "001_img", "002_img", "untouched"] {
        let image = image::open(folder("dd").join(format!("{name}.png"))).unwrap().into_rgb8();
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
    use image::imageops::{rotate90, rotate180};
    let upright = changed(|image| image);
    upright.run(PREDICT).good();
    let truth = masks(&upright);
    assert!(truth.iter().all(|mask| mask.iter().filter(|&&level| level > 127).count() > 800));
    let swap = |mut image: RgbImage| {
        image.pixels_mut().for_each(|pixel| pixel.0.swap(0, 2));
        image
    };
    let lying = changed(|image| rotate90(&image));
    assert!(lying.run(PREDICT).warned().contains("turned by 270 degrees"));
    assert_eq!(masks(&lying), truth);
    let standing = changed(|image| swap(rotate180(&image)));
    let said = standing.run(PREDICT).warned();
    assert!(said.contains("180 degrees") && said.contains("BGR"), "{said}");
    assert_eq!(masks(&standing), truth);
    let large = changed(|image| image::imageops::resize(&image, 480, 640, image::imageops::FilterType::Nearest));
    large.run(PREDICT).good();
    let differ = masks(&large).concat().iter().zip(truth.concat()).filter(|(a, b)| **a != *b).count();
    assert!(differ < 300, "{differ} pixels");
}

#[test]
fn results_are_files_and_a_table() {
    let workplace = changed(|image| image);
    let json: serde_json::Value = serde_json::from_str(&workplace.run(&format!("{PREDICT} --json")).good()).unwrap();
    for (line, id) in json.as_array().unwrap().iter().zip(["000", "001", "002"]) {
        assert_eq!(line["id"], id);
        // A ball of 3 mm that lies on the gel within a radius of 1 to 1.6 mm.
        assert!((3.0..8.0).contains(&line["area_mm2"].as_f64().unwrap()), "{line}");
        assert!((0.3..0.9).contains(&line["deepest_mm"].as_f64().unwrap()), "{line}");
        assert!(line["plausibility"].as_f64().unwrap() > 0.5, "{line}");
    }
    let table = std::fs::read_to_string(workplace.path("out/predictions.csv")).unwrap();
    assert_eq!(table.lines().count(), 4);
    assert!(workplace.path("out/001_picture.png").exists());
    // Three images are few for a median.
    let said = workplace.run("touch predict --images in --out median").warned();
    assert!(said.contains("--untouched"), "{said}");
}

#[test]
fn what_is_no_image_of_a_sensor_is_refused() {
    let workplace = changed(|image| image);
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
