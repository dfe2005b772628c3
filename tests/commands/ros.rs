//! `run --ros` and `ros topics` with a real ROS 2 node beside them.
//!
//! The node is `tests/ros/peer.py`, which needs rclpy; `tests/ros/hear_tf.py` listens with Cyclone DDS. ROS_PYTHON names a Python that has both;
//! without it python3 is tried.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use mvt_feelsight::Log;
use nalgebra as na;
use serde_json::{Value, json};

use crate::rgbd::as_named_folders;
use crate::touch_stream::with_ffmpeg;
use crate::workplace::{Ended, Workplace, signal, skip};

/// Stamps of the sequence: 30 frames per second.
fn stamp_ns(frame: usize) -> i64 {
    1_581_120_424_100_262_102 + 33_333_333 * frame as i64
}

/// The Python with rclpy; without one the test is skipped.
pub fn python() -> Option<String> {
    let python = std::env::var("ROS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let modules =
        "import rclpy, sensor_msgs.msg, geometry_msgs.msg, visualization_msgs.msg, diagnostic_msgs.msg, cyclonedds";
    let asked = Command::new(&python).args(["-c", modules]).output();
    if asked.is_ok_and(|asked| asked.status.success()) {
        return Some(python);
    }
    skip(&format!("{python} has no rclpy or cyclonedds: see .ci/run for the packages, and set ROS_PYTHON"));
    None
}

/// A domain that no other test of this machine uses at the same time. Ports of domains above 100 overlap with those that the system gives away.
pub fn domain(test: u32) -> u32 {
    1 + (std::process::id() * 4 + test) % 100
}

/// Writes a sequence in folders as bytes of messages.
fn as_messages(folder: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    let text = fs::read_to_string(folder.join("cam_K.txt")).unwrap();
    let k: Vec<f64> = text.split_whitespace().map(|word| word.parse().unwrap()).collect();
    let mut names: Vec<String> = fs::read_dir(folder.join("rgb"))
        .unwrap()
        .map(|file| file.unwrap().path().file_stem().unwrap().to_str().unwrap().to_owned())
        .collect();
    names.sort();
    let mut size = (0, 0);
    for name in &names {
        let open = |kind: &str| image::open(folder.join(format!("{kind}/{name}.png"))).unwrap();
        let (rgb, depth, mask) = (open("rgb").to_rgb8(), open("depth").to_luma16(), open("masks").to_luma8());
        size = rgb.dimensions();
        let levels: Vec<u8> = depth.iter().flat_map(|level| level.to_le_bytes()).collect();
        for (kind, bytes) in [("rgb", rgb.as_raw()), ("depth", &levels), ("mask", mask.as_raw())] {
            fs::write(to.join(format!("{name}.{kind}")), bytes).unwrap();
        }
    }
    let sequence = json!({ "width": size.0, "height": size.1, "k": k, "names": names });
    fs::write(to.join("sequence.json"), sequence.to_string()).unwrap();
}

/// A sequence of this many seconds, in folders and as bytes of messages, and the file that names the peer's topics.
fn prepare(workplace: &Workplace, seconds: f64, domain: u32) {
    let line = format!("generate --object cube70 --logs 1 --duration {seconds} --cameras side --out set");
    workplace.run(&line).good();
    as_named_folders(&workplace.path("set/cube70/00"), &workplace.path("folder"), |i| stamp_ns(i).to_string());
    // Without the truth the coordinates of the estimate are its own, as those of a live run.
    fs::remove_dir_all(workplace.path("folder/annotated_poses")).unwrap();
    as_messages(&workplace.path("folder"), &workplace.path("messages"));
    let file = format!(
        "[ros]\ndomain = {domain}\nreliable = true\naddresses = [\"127.0.0.1\"]\ndepth = \"/camera/depth/image_raw\"\n\
         color = \"/camera/color/image_raw\"\ncamera_info = \"/camera/depth/camera_info\"\nmasks = \"/masks\"\n"
    );
    workplace.write("ros.toml", file);
}

/// Adds joints and touch images of a simulated log to the bytes of messages of its frames.
fn add_hand(log: &Path, to: &Path) {
    let log = Log::open(log).unwrap();
    let mut sequence = json_of(&to.join("sequence.json"));
    let names: Vec<&str> = log.hand().joints().iter().map(|joint| joint.name.as_str()).collect();
    let positions: Vec<Vec<f64>> = log.joints().iter().map(|joints| joints.to_vec()).collect();
    sequence["joints"] = json!({ "names": names, "positions": positions });
    for (pad, of) in log.hand().pads().iter().enumerate() {
        let stamps = sequence["names"].as_array().unwrap().clone();
        for (number, name) in stamps.iter().enumerate() {
            let image = log.touch_image(pad, number).unwrap();
            fs::write(to.join(format!("{}.{}", name.as_str().unwrap(), of.name)), image.as_raw()).unwrap();
            sequence["touch"][&of.name] = json!([image.width(), image.height()]);
        }
    }
    fs::write(to.join("sequence.json"), sequence.to_string()).unwrap();
}

/// As `prepare`, with a hand.
fn prepare_hand(workplace: &Workplace, seconds: f64, domain: u32) {
    prepare(workplace, seconds, domain);
    add_hand(&workplace.path("set/cube70/00"), &workplace.path("messages"));
    let text = workplace.text("ros.toml");
    let text =
        text.replace("masks = \"/masks\"", "rig = \"allegro_digit\"\ncamera = \"side\"\njoints = \"/joint_states\"");
    let pads = ["index", "middle", "ring", "thumb"].map(|pad| format!("{pad} = \"/touch/{pad}/image_raw\"\n")).concat();
    workplace.write("ros.toml", format!("{text}\n[ros.touch]\n{pads}"));
}

pub fn begun(workplace: &Workplace, line: &str) -> Child {
    workplace.command(line).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Starts a script of `tests/ros`.
pub fn start(workplace: &Workplace, python: &str, domain: u32, script: &str, arguments: &str) -> Child {
    let mut command = Command::new(python);
    command
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/ros").join(script))
        .args(arguments.split_whitespace())
        .current_dir(workplace.path(""));
    command.env("ROS_DOMAIN_ID", domain.to_string()).env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

pub fn ended(child: Child) -> Ended {
    let output = child.wait_with_output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    Ended { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) }
}

fn json_of(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

#[test]
fn a_live_run_estimates_what_the_same_frames_in_a_folder_give_and_ros_reads_it() {
    let Some(python) = python() else { return };
    let (workplace, domain) = (Workplace::new(), domain(0));
    prepare(&workplace, 1.5, domain);
    workplace.run("run --log folder --out of_folder --quiet").warned();
    let run = begun(&workplace, "run --ros ros.toml --out live --record recorded");
    let transforms = start(&workplace, &python, domain, "hear_tf.py", "transforms.json 20 100");
    let heard = ended(start(&workplace, &python, domain, "peer.py", "messages heard.json --reliable"));
    signal(&run, "INT");
    let of_transforms = ended(transforms);
    assert_eq!(of_transforms.code, Some(0), "{of_transforms:?}");
    let said = ended(run);
    assert_eq!(heard.code, Some(0), "{heard:?}, {said:?}");
    assert_eq!(said.code, Some(0), "{said:?}");
    assert!(said.stdout.contains("live: 45 frames used, 0 late, 0 unpaired, 0 unusable"), "{said:?}");
    assert!(said.stdout.contains("recorded: 45 frames, 0 left out"), "{said:?}");
    workplace.run("run --log recorded --out again --quiet").good();
    assert_eq!(trajectory(&workplace, "again"), trajectory(&workplace, "live"));

    let heard = workplace.json("heard.json");
    let summary = workplace.json("live/summary.json");
    assert_eq!((&heard["sent"], &summary["frames"], &summary["complete"]), (&json!(45), &json!(45), &json!(true)));
    let live = &summary["live"];
    assert_eq!((&live["frames"], &live["late"]), (&json!(45), &json!(0)));
    for topic in live["topics"].as_array().unwrap() {
        assert_eq!((&topic["received"], &topic["lost"]), (&json!(45), &json!(0)), "{topic}");
    }
    // The stamps are those of the recording, years ago.
    assert!(live["latency_ms"].is_null() && said.stderr.contains("stamps are more than 1 s old"), "{said:?}");

    let poses = heard["poses"].as_array().unwrap();
    // Poses that came before the node was found are missed.
    assert!(poses.len() > 40 && heard["stopped"].is_null(), "{} poses, {}", poses.len(), heard["stopped"]);
    for (number, pose) in (45 - poses.len()..).zip(poses) {
        assert_eq!((&pose["stamp_ns"], &pose["frame"]), (&json!(stamp_ns(number)), &json!("camera_optical")));
        let covariance = numbers(&pose["covariance"]);
        assert!((0..36).all(|k| (covariance[k] > 0.0) == (k % 7 == 0)), "{covariance:?}");
        let text = fs::read_to_string(workplace.path(&format!("of_folder/poses/{}.txt", stamp_ns(number)))).unwrap();
        let of_folder: Vec<f64> = text.split_whitespace().map(|word| word.parse().unwrap()).collect();
        let of_folder = na::Matrix4::from_row_slice(&of_folder);
        let [x, y, z, i, j, k, w] = numbers(&pose["pose"]).try_into().unwrap();
        let turn = na::UnitQuaternion::from_quaternion(na::Quaternion::new(w, i, j, k));
        let apart =
            (na::Isometry3::from_parts(na::Translation3::new(x, y, z), turn).to_homogeneous() - of_folder).norm();
        assert!(apart < 1e-5, "frame {number}: {apart}");
    }
    let transforms = workplace.json("transforms.json");
    assert_eq!(transforms.as_array().unwrap().len(), 20);
    for transform in transforms.as_array().unwrap() {
        let pose = poses.iter().find(|pose| pose["stamp_ns"] == transform["stamp_ns"]);
        assert_eq!(pose.map(|pose| &pose["pose"]), Some(&transform["pose"]));
        assert_eq!(
            (&transform["frame"], &transform["child"]),
            (&json!("camera_optical"), &json!("mambavitact_object"))
        );
    }
    let markers = heard["markers"].as_array().unwrap();
    assert!(!markers.is_empty());
    for marker in markers {
        let corners = marker["corners"].as_array().unwrap();
        assert_eq!((&marker["type"], &marker["frame"]), (&json!(11), &json!("mambavitact_object")));
        assert_eq!((&marker["scale"], &marker["text"]), (&json!([1.0, 1.0, 1.0]), &json!("")));
        assert!(!corners.is_empty() && corners.len() % 3 == 0 && corners.len() <= 3 * 830);
        assert!(corners.iter().all(|corner| numbers(corner).iter().all(|x| x.abs() < 0.5)));
    }
    let diagnostics = &heard["diagnostics"];
    assert_eq!((&diagnostics["name"], &diagnostics["level"]), (&json!("mambavitact"), &json!(0)), "{diagnostics}");
    assert!(diagnostics["values"]["confidence"].as_str().unwrap().parse::<f64>().unwrap() > 0.5);
}

/// The poses of a run, to the last digit that is written.
fn trajectory(workplace: &Workplace, out: &str) -> Vec<Vec<f64>> {
    let text = workplace.text(&format!("{out}/trajectory.csv"));
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    let head = lines.next().unwrap();
    let is_pose = |name: &str| ["time_s", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz", "confidence"].contains(&name);
    let numbers = |row: Vec<String>| {
        let of_pose = row.into_iter().zip(&head).filter(|(_, name)| is_pose(name));
        of_pose.map(|(number, _)| number.parse().unwrap()).collect()
    };
    lines.map(numbers).collect()
}

#[test]
fn topics_are_listed_with_types_and_two_publishers_are_noticed() {
    let Some(python) = python() else { return };
    let (workplace, domain) = (Workplace::new(), domain(1));
    prepare(&workplace, 0.3, domain);
    let run = begun(&workplace, "run --ros ros.toml --out live");
    let peer = start(&workplace, &python, domain, "peer.py", "messages heard.json --twice --reliable");
    let listed = workplace.run(&format!("ros topics --domain {domain} --addresses 127.0.0.1 --duration 6")).good();
    let heard = ended(peer);
    signal(&run, "INT");
    let said = ended(run);
    let line = |topic: &str| listed.lines().find(|line| line.starts_with(topic)).unwrap_or_else(|| panic!("{listed}"));
    assert!(line("/camera/depth/image_raw").contains("sensor_msgs/msg/Image"), "{listed}, {heard:?}");
    assert!(line("/camera/depth/image_raw").contains("2 publishers"), "{listed}");
    assert!(line("/mambavitact/pose").contains("geometry_msgs/msg/PoseWithCovarianceStamped"), "{listed}");
    assert!(said.stderr.contains("/camera/depth/image_raw: it has 2 publishers"), "{said:?}");
}

#[test]
fn topics_that_do_not_come_are_named_with_what_is_seen_instead() {
    let Some(python) = python() else { return };
    let (workplace, domain) = (Workplace::new(), domain(2));
    prepare(&workplace, 0.1, domain);
    let text = workplace.text("ros.toml");
    workplace.write(
        "ros.toml",
        text.replace("/masks", "/segments").replace("camera/color/image_raw", "camera/depth/camera_info_2"),
    );
    let mut run = begun(&workplace, "run --ros ros.toml --out live");
    let mut peer = start(&workplace, &python, domain, "peer.py", "messages heard.json --reliable");
    let mut said = String::new();
    {
        use std::io::{BufRead as _, BufReader};
        let mut lines = BufReader::new(run.stderr.take().unwrap()).lines();
        while !said.contains("/segments") {
            said += &lines.next().unwrap().unwrap();
        }
    }
    peer.kill().unwrap();
    peer.wait().unwrap();
    signal(&run, "INT");
    let _ = run.wait();
    assert!(said.contains("no publisher; these topics are seen:") || said.contains("no topic is seen"), "{said}");
}

#[test]
fn files_that_cannot_be_used_are_refused_in_one_line() {
    let workplace = Workplace::new();
    let error = |line: &str| workplace.run(line).error();
    assert!(error("run --ros missing.toml").contains("missing.toml"));
    workplace.write("ros.toml", "[ros]\ndepth = \"/d\"\ncamera_info = \"/i\"\n");
    assert!(error("run --ros ros.toml").contains("name their topic as `masks`"));
    workplace.write("ros.toml", "[ros]\ndepth = \"/d\"\ncamera_info = \"/i\"\nmasks = \"/m\"\n");
    assert!(error("run --ros ros.toml --modality tac").contains("--modality tac"));
    assert!(error("run --ros ros.toml --mode map").contains("--mode slam"));
    workplace.write("ros.toml", "[ros]\nrig = \"nothing\"\ndepth = \"/d\"\ncamera_info = \"/i\"\njoints = \"/j\"\n");
    assert!(error("run --ros ros.toml").contains("nothing"));
}

#[test]
fn what_a_fast_publisher_sends_is_received_and_counted() {
    let Some(python) = python() else { return };
    let (workplace, domain) = (Workplace::new(), domain(3));
    prepare(&workplace, 1.5, domain);
    let text = workplace.text("ros.toml");
    workplace.write("ros.toml", text.replace("reliable = true\n", ""));
    let run = begun(&workplace, "run --ros ros.toml --out live --quiet");
    let heard = ended(start(&workplace, &python, domain, "peer.py", "messages heard.json --hz 15"));
    signal(&run, "INT");
    let said = ended(run);
    assert_eq!((heard.code, said.code), (Some(0), Some(0)), "{heard:?}, {said:?}");
    let (heard, summary) = (workplace.json("heard.json"), workplace.json("live/summary.json"));
    let live = &summary["live"];
    let count = |value: &Value| value.as_u64().unwrap();
    let sent = count(&heard["sent"]);
    for topic in live["topics"].as_array().unwrap() {
        // Best effort: a loaded machine may lose some. The last ones may be lost without a successor that shows it.
        let (received, lost) = (count(&topic["received"]), count(&topic["lost"]));
        assert!(
            received + lost <= sent && received + lost + 3 > sent && received * 10 > sent * 9,
            "{topic}, {sent} sent"
        );
    }
    let depth = count(&live["topics"][0]["received"]);
    let used = count(&live["frames"]) + count(&live["late"]) + count(&live["unpaired"]) + count(&live["unusable"]);
    // Some wait for partners at the end.
    assert!(used <= depth && used + 8 > depth, "{live}");
    assert_eq!(count(&live["frames"]), count(&summary["frames"]));
    assert!(live["latency_ms"]["median"].as_f64().unwrap() > 0.0, "{live}");
    // Each pose has the stamp of a depth image.
    let stamps = heard["stamps"].as_array().unwrap();
    assert!(heard["poses"].as_array().unwrap().iter().all(|pose| stamps.contains(&pose["stamp_ns"])));
}

#[test]
fn a_hand_with_joints_and_touch_sensors_gives_the_motion_that_its_log_gives() {
    let Some(python) = python() else { return };
    let (workplace, domain) = (Workplace::new(), domain(4));
    prepare_hand(&workplace, 1.0, domain);
    // Depth as in the messages, which hold millimetres.
    let options = "--modality vi --calibration given --quiet";
    workplace.run(&format!("run --log set/cube70/00 --set camera_noise=0 --out of_log {options}")).warned();
    let run = begun(&workplace, &format!("run --ros ros.toml --out live {options}"));
    let heard = ended(start(&workplace, &python, domain, "peer.py", "messages heard.json --reliable"));
    signal(&run, "INT");
    let said = ended(run);
    assert_eq!((heard.code, said.code), (Some(0), Some(0)), "{heard:?}, {said:?}");
    let summary = workplace.json("live/summary.json");
    assert_eq!((&summary["frames"], &summary["live"]["unusable"]), (&json!(30), &json!(0)), "{summary}, {said:?}");
    // Depth, colours, joints and four pads.
    assert_eq!(summary["live"]["topics"].as_array().unwrap().len(), 7);
    assert!(workplace.json("heard.json")["poses"].as_array().unwrap().iter().all(|pose| pose["frame"] == "world"));
    // Both models have coordinates of their own, so that motions since the first frame are compared.
    let motions = |out: &str| {
        let rows = mvt_run::report::read_trajectory(&workplace.text(&format!("{out}/trajectory.csv"))).unwrap();
        let poses: Vec<_> = rows.iter().map(|row| row.estimate.untyped()).collect();
        let first = poses[0];
        poses.into_iter().map(|pose| pose * first.inverse()).collect::<Vec<_>>()
    };
    let (live, of_log) = (motions("live"), motions("of_log"));
    assert_eq!(live.len(), of_log.len());
    for (number, (live, of_log)) in live.iter().zip(&of_log).enumerate() {
        let apart = of_log.inverse() * live;
        // A millimetre, and the motion of a corner by as much.
        assert!(apart.translation.vector.norm() < 1.5e-3 && apart.rotation.angle() < 0.03, "frame {number}: {apart}");
    }
}

/// With touch networks, and a calibration that is refined: a log of another origin is read with its later frames in view.
#[test]
fn what_a_hand_delivers_is_recorded_and_repeats_the_estimate() {
    let Some(python) = python() else { return };
    let (workplace, domain) = (Workplace::new(), domain(5));
    prepare_hand(&workplace, 0.7, domain);
    let run = begun(&workplace, "run --ros ros.toml --out live --record recorded --object cube70");
    let heard = ended(start(&workplace, &python, domain, "peer.py", "messages heard.json --reliable"));
    signal(&run, "INT");
    let said = ended(run);
    assert_eq!((heard.code, said.code), (Some(0), Some(0)), "{heard:?}, {said:?}");
    let summary = workplace.json("live/summary.json");
    assert_eq!(summary["live"]["log"], json!({ "frames": 21, "left_out": 0 }), "{summary}, {said:?}");
    assert_eq!(Log::open(&workplace.path("recorded")).unwrap().object_name(), "cube70");
    workplace.run("run --log recorded --out again --quiet").good();
    let (again, live) = (trajectory(&workplace, "again"), trajectory(&workplace, "live"));
    assert_eq!(again.len(), live.len());
    // A log holds the pose of the camera as a matrix, which rounds the last bits.
    let apart = again.iter().flatten().zip(live.iter().flatten()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(apart < 1e-9, "{apart}");
    workplace.run("inspect recorded").good();
    contacts_lie_on_the_cube(&Log::open(&workplace.path("set/cube70/00")).unwrap(), &workplace.path("heard.json"));
    let refused = workplace.run("run --ros ros.toml --out other --record recorded").error();
    assert!(refused.contains("the folder is not empty"), "{refused}");
}

/// Compares points of contact that ROS read with the true cube of 70 mm.
fn contacts_lie_on_the_cube(log: &Log, heard: &Path) {
    let clouds = json_of(heard)["contacts"].as_array().unwrap().clone();
    let mut off_m = Vec::new();
    for cloud in &clouds {
        assert_eq!(cloud["frame"], "world");
        let frame = (0..log.len()).find(|&frame| cloud["stamp_ns"] == stamp_ns(frame)).unwrap();
        let object_from_world = log.object_poses()[frame].unwrap().inverse().untyped();
        let [x, y, z, indentation_m] = ["x", "y", "z", "indentation"].map(|name| numbers(&cloud[name]));
        for k in 0..x.len() {
            let place = object_from_world * na::Point3::new(x[k], y[k], z[k]);
            off_m.push(place.coords.amax() - 0.035);
            assert!((0.0..3e-3).contains(&indentation_m[k]), "{} m", indentation_m[k]);
        }
    }
    assert!(clouds.len() > 15 && off_m.len() > 50, "{} clouds, {} points", clouds.len(), off_m.len());
    off_m.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    assert!(off_m[off_m.len() / 2].abs() < 1e-3, "{} m", off_m[off_m.len() / 2]);
}

/// The sensor of the thumb is ffmpeg's test picture, played by a script in the place of ffmpeg; the others are topics.
#[test]
fn a_touch_sensor_of_this_computer_is_read_beside_the_topics() {
    let Some(python) = python() else { return };
    let (workplace, domain) = (Workplace::new(), domain(6));
    prepare_hand(&workplace, 0.7, domain);
    let text = workplace.text("ros.toml");
    let mut sequence = workplace.json("messages/sequence.json");
    sequence["touch"].as_object_mut().unwrap().remove("thumb");
    workplace.write("messages/sequence.json", sequence.to_string());
    let text = text.replace("reliable = true\n", "").replace("thumb = \"/touch/thumb/image_raw\"\n", "");
    workplace.write("ros.toml", format!("{text}[ros.touch_cameras]\nthumb = \"/dev/null\"\n"));
    let play = "FFMPEG -nostdin -loglevel error -re -f lavfi -i testsrc2=size=320x240:rate=60 -f image2pipe -c:v ppm -";
    // At the first start it is in use.
    let script = format!(
        "if [ -e busy ]; then {play}; else touch busy; echo /dev/null: Device or resource busy >&2; exit 1; fi"
    );
    let mut run = with_ffmpeg(&workplace, "run --ros ros.toml --out live --record recorded --modality vi", &script);
    let run = run.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let heard = ended(start(&workplace, &python, domain, "peer.py", "messages heard.json --hz 5"));
    signal(&run, "INT");
    let said = ended(run);
    assert_eq!((heard.code, said.code), (Some(0), Some(0)), "{heard:?}, {said:?}");
    assert!(said.stderr.contains("cannot read the camera /dev/null: Device or resource busy"), "{said:?}");
    let summary = workplace.json("live/summary.json");
    let topics = summary["live"]["topics"].as_array().unwrap();
    let camera = topics.iter().find(|topic| topic["topic"] == "touch sensor /dev/null").unwrap();
    assert!(camera["received"].as_u64().unwrap() > 30 && topics.len() == 7, "{summary}");
    let log = Log::open_tolerant(&workplace.path("recorded")).unwrap();
    let thumb = log.hand().pads().iter().position(|pad| pad.name == "thumb").unwrap();
    let images: Vec<_> = (0..log.len()).filter_map(|frame| log.touch_image(thumb, frame).ok()).collect();
    // Frames before it was there do not wait for it. Its picture moves.
    assert!(2 * images.len() > log.len() && images.windows(2).all(|pair| pair[0] != pair[1]), "{said:?}");
    workplace.write("ros.toml", text + "[ros.touch_cameras]\nthumb = \"\"\n");
    assert!(workplace.run("run --ros ros.toml").error().contains("touch_cameras.thumb"));
}
