//! `run --log` of RGB-D sequences without a hand.

use std::fs;
use std::path::Path;

use image::{GrayImage, ImageBuffer, Luma};
use mvt_feelsight::Log;
use mvt_frames::depth::Label;

use crate::run::summary;
use crate::workplace::{Workplace, others_data};

/// Writes the frames of a simulated log as `rgb/ depth/ masks/ cam_K.txt annotated_poses/`.
pub fn as_folders(log: &Path, to: &Path) {
    as_named_folders(log, to, |i| format!("{i:06}"));
}

/// The same with other names of the frames.
pub fn as_named_folders(log: &Path, to: &Path, name: impl Fn(usize) -> String) {
    let log = Log::open(log).unwrap();
    let camera = log.cameras()[0].clone();
    for name in ["rgb", "depth", "masks", "annotated_poses"] {
        fs::create_dir_all(to.join(name)).unwrap();
    }
    let k = camera.intrinsics;
    fs::write(to.join("cam_K.txt"), format!("{} 0 {}\n0 {} {}\n0 0 1\n", k.fx, k.cx, k.fy, k.cy)).unwrap();
    for (i, frame) in log.frames().unwrap().enumerate() {
        let (frame, labels) = (frame.unwrap(), log.labels(0, i).unwrap());
        let name = name(i);
        let rgbd = &frame.observation.cameras[0];
        rgbd.color.save(to.join(format!("rgb/{name}.png"))).unwrap();
        let (rows, columns) = rgbd.depth_m.dim();
        let size = (columns as u32, rows as u32);
        let millimetres = rgbd.depth_m.iter().map(|depth_m| (1e3 * depth_m).round() as u16).collect();
        let depth = ImageBuffer::<Luma<u16>, _>::from_vec(size.0, size.1, millimetres).unwrap();
        depth.save(to.join(format!("depth/{name}.png"))).unwrap();
        let mask = labels.iter().map(|label| if *label == Label::Object { 255 } else { 0 }).collect();
        GrayImage::from_vec(size.0, size.1, mask).unwrap().save(to.join(format!("masks/{name}.png"))).unwrap();
        // OpenCV axes: y and z are turned.
        let pose = (camera.pose.inverse() * log.object_poses()[i].unwrap()).to_matrix();
        let row = |row: usize, sign: f64| pose[row].map(|x| (sign * x).to_string()).join(" ");
        let text = [row(0, 1.0), row(1, -1.0), row(2, -1.0), "0 0 0 1".to_owned()].join("\n");
        fs::write(to.join(format!("annotated_poses/{name}.txt")), text).unwrap();
    }
}

#[test]
fn a_folder_of_images_and_masks_is_a_log_without_a_hand() {
    let workplace = Workplace::new();
    workplace.run("generate --object cube70 --logs 1 --duration 0.6 --cameras side --out set").good();
    as_folders(&workplace.path("set/cube70/00"), &workplace.path("folder"));
    let said = workplace.run("run --log folder --object cube70 --out out").warned();
    assert!(said.contains("30 frames per second are assumed"), "{said}");
    let summary = summary(&workplace, "out");
    assert_eq!(summary["frames"], 18, "{summary}");
    assert!(summary["add_s_mm"]["mean"].as_f64().unwrap() < 2.0, "{summary}");
    // Poses of the model in the camera, with OpenCV axes, for the programs that read these layouts.
    let of =
        |path: String| -> Vec<f64> { workplace.text(&path).split_whitespace().map(|x| x.parse().unwrap()).collect() };
    for k in [0, 17] {
        let (found, true_pose) =
            (of(format!("out/poses/{k:06}.txt")), of(format!("folder/annotated_poses/{k:06}.txt")));
        let apart_m = [3, 7, 11].map(|at| (found[at] - true_pose[at]).powi(2)).iter().sum::<f64>().sqrt();
        assert!(apart_m < 0.005, "frame {k}: {apart_m} m");
    }
    assert_eq!(of("out/trajectory_tum.txt".to_owned()).len(), 18 * 8);
    assert_eq!(workplace.text("out/poses_bop.csv").lines().count(), 19);
    // The object is not named, so that there is nothing to score.
    workplace.run("run --log folder --out unnamed --quiet").warned();
    workplace.run("view --run unnamed --layout scene --show mesh --size 320x240 --record object.png").warned();
    let picture = image::open(workplace.path("object.png")).unwrap().into_rgb8();
    let filled = (0..320).filter(|&x| picture.get_pixel(x, 120) != picture.get_pixel(5, 120)).count();
    assert!((80..240).contains(&filled), "the object fills {filled} of 320 pixels in the middle");
    let error = |line: &str| workplace.run(line).error();
    assert!(error("run --log folder --modality tac").contains("no touch sensors"));
    assert!(error("run --log folder --mode pose").contains("--object"));
    workplace.write("folder/rgbd.toml", "depth_unit_m = 1.0\n");
    assert!(error("run --log folder").contains("is the unit of depth right?"));
    fs::create_dir(workplace.path("other")).unwrap();
    assert!(error("run --log other").contains("other"));
}

/// A box that stands still, seen by a real camera.
#[test]
fn a_real_sequence_does_not_drift() {
    let Some(place) = others_data("real_rgbd/standing_box") else { return };
    let workplace = Workplace::new();
    workplace.run(&format!("run --log {} --out out --quiet", place.display())).warned();
    let table = workplace.text("out/trajectory.csv");
    let mut lines = table.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let head = lines.next().unwrap();
    let columns = ["x_m", "y_m", "z_m", "qw"].map(|name| head.iter().position(|column| *column == name).unwrap());
    let poses: Vec<[f64; 4]> = lines.map(|line| columns.map(|column| line[column].parse().unwrap())).collect();
    let (first, last) = (poses[0], poses[10]);
    let moved_m = (0..3).map(|axis| (last[axis] - first[axis]).powi(2)).sum::<f64>().sqrt();
    let turned_deg = 2.0 * last[3].abs().min(1.0).acos().to_degrees();
    assert!(moved_m < 0.001 && turned_deg < 1.0, "{moved_m} m, {turned_deg} degrees");
}
