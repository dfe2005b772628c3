//! `run --log` of bags of ROS 2.

use std::fs;
use std::path::Path;

use nalgebra as na;

use crate::rgbd::as_named_folders;
use crate::run::summary;
use crate::small_bags::{Cdr, IMAGE, INFO, Written, image, mcap};
use crate::workplace::Workplace;

fn stamp_ns(frame: usize) -> i64 {
    1_581_120_424_100_262_102 + 33_333_333 * frame as i64
}

fn numbers(path: &Path) -> Vec<f64> {
    fs::read_to_string(path).unwrap().split_whitespace().map(|word| word.parse().unwrap()).collect()
}

/// Writes a sequence in folders as a bag, with or without a topic of masks.
fn as_bag(folder: &Path, has_masks: bool) -> Vec<u8> {
    let k = numbers(&folder.join("cam_K.txt"));
    let mut names: Vec<_> = fs::read_dir(folder.join("rgb")).unwrap().map(|file| file.unwrap().file_name()).collect();
    names.sort();
    let mut messages = Vec::new();
    for name in names {
        let name = name.to_str().unwrap();
        let stem = name.strip_suffix(".png").unwrap();
        let time_ns: i64 = stem.parse().unwrap();
        let open = |kind: &str| image::open(folder.join(kind).join(name)).unwrap();
        let (rgb, depth, mask) = (open("rgb").to_rgb8(), open("depth").to_luma16(), open("masks").to_luma8());
        let size @ [width, height] = [rgb.width(), rgb.height()];
        let info = Cdr::header(time_ns, "optical").u32(height).u32(width).text("plumb_bob").u32(0);
        let info = info.f64s(&k).f64s(&[0.0; 9]).f64s(&[0.0; 12]);
        let info = info.u32(0).u32(0).u32(0).u32(0).u32(0).u32(0).u8(0).done();
        let levels: Vec<u8> = depth.iter().flat_map(|level| level.to_le_bytes()).collect();
        let pose = na::Matrix4::from_row_slice(&numbers(&folder.join(format!("annotated_poses/{stem}.txt"))));
        let turn = na::UnitQuaternion::from_matrix(&pose.fixed_view::<3, 3>(0, 0).into_owned());
        let place = [pose[(0, 3)], pose[(1, 3)], pose[(2, 3)]];
        let pose = Cdr::header(time_ns, "optical").f64s(&place).f64s(&[turn.i, turn.j, turn.k, turn.w]).done();
        messages.extend([
            Written(time_ns, "/color/image", IMAGE, image(time_ns, "rgb8", size, 3 * width, &rgb)),
            Written(time_ns, "/depth/image", IMAGE, image(time_ns, "16UC1", size, 2 * width, &levels)),
            Written(time_ns, "/depth/camera_info", INFO, info),
            Written(time_ns, "/object/pose", "geometry_msgs/msg/PoseStamped", pose),
        ]);
        if has_masks {
            messages.push(Written(time_ns, "/mask", IMAGE, image(time_ns, "mono8", size, width, &mask)));
        }
    }
    mcap(&messages, "cdr")
}

#[test]
fn a_bag_gives_what_the_same_frames_in_a_folder_give() {
    let workplace = Workplace::new();
    workplace.run("generate --object cube70 --logs 1 --duration 0.3 --cameras side --out set").good();
    as_named_folders(&workplace.path("set/cube70/00"), &workplace.path("folder"), |i| stamp_ns(i).to_string());
    workplace.write("all.mcap", as_bag(&workplace.path("folder"), true));
    workplace.write("bag.toml", "object_pose = \"/object/pose\"\n");
    let run = |log: &str, out: &str| workplace.run(&format!("run --log {log} --object cube70 --out {out} --quiet"));
    run("folder", "of_folder").good();
    run("all.mcap", "of_bag").warned();
    let poses = |out: &str| workplace.files(&format!("{out}/poses"));
    assert!(poses("of_bag").len() > 5, "{:?}", poses("of_bag").keys());
    // The quaternions of the bag are rounded matrices of the folder.
    let same_poses = |left: &str, right: &str| {
        let (left, right) = (poses(left), poses(right));
        assert!(left.keys().eq(right.keys()), "{:?}", right.keys());
        let numbers = |bytes: &[u8]| -> Vec<f64> {
            std::str::from_utf8(bytes).unwrap().split_whitespace().map(|word| word.parse().unwrap()).collect()
        };
        for (name, bytes) in &left {
            let apart = numbers(bytes).into_iter().zip(numbers(&right[name])).map(|(a, b)| (a - b).abs());
            let apart = apart.fold(0.0, f64::max);
            assert!(apart < 1e-9, "{}: {apart}", name.display());
        }
    };
    same_poses("of_folder", "of_bag");
    assert!(poses("of_bag").contains_key(Path::new(&format!("{}.txt", stamp_ns(0)))));
    let errors = ["of_folder", "of_bag"].map(|out| summary(&workplace, out)["add_s_mm"]["mean"].as_f64().unwrap());
    assert!((errors[0] - errors[1]).abs() < 1e-3, "{errors:?}");

    // As a folder that other programs read, too; its frames count from the first.
    let told = workplace.run("import all.mcap --out imported").warned_with_output();
    assert!(told.contains("9 true poses"), "{told}");
    run("imported", "of_imported").good();
    let values = |out: &str| -> Vec<f64> {
        let words = poses(out).into_values().map(|bytes| String::from_utf8(bytes).unwrap());
        words.flat_map(|text| text.split_whitespace().map(|x| x.parse().unwrap()).collect::<Vec<f64>>()).collect()
    };
    let apart = values("of_bag").into_iter().zip(values("of_imported")).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(apart < 1e-9 && values("of_bag").len() == values("of_imported").len(), "{apart}");
    assert!(workplace.run("import folder --out imported").error().contains("not empty"));
    let again: serde_json::Value = workplace.run("import folder --out again --json").json();
    assert_eq!([&again["frames"], &again["masks"], &again["object_poses"]], [9, 9, 9], "{again}");

    // The folder of a bag, with masks that were drawn later, named by stamps.
    fs::create_dir(workplace.path("rosbag")).unwrap();
    workplace.write("rosbag/a_0.mcap", as_bag(&workplace.path("folder"), false));
    let error = |line: &str| workplace.run(line).error();
    assert!(error("run --log rosbag").contains("`masks = \"TOPIC\"`"));
    workplace.write("rosbag/bag.toml", "masks = \"drawn/*.png\"\nobject_pose = \"/object/pose\"\n");
    assert!(error("run --log rosbag").contains("drawn"));
    fs::rename(workplace.path("folder/masks"), workplace.path("rosbag/drawn")).unwrap();
    run("rosbag", "of_drawn").warned();
    same_poses("of_folder", "of_drawn");

    assert!(error("run --log rosbag --modality tac").contains("no touch sensors"));
    assert!(error("run --log missing.mcap").contains("missing.mcap"));
    workplace.write("other.mcap", "no bag");
    assert!(error("run --log other.mcap").contains("it is no bag of ROS 2"));
    workplace.write("rosbag/bag.toml", "masks = \"drawn/*.png\"\ndepth_unit_m = 1.0\n");
    assert!(error("run --log rosbag").contains("`depth_unit_m` in bag.toml"));
}
