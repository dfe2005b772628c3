//! A simulated robot and a run that drives it: two processes, over the network of ROS 2.

use std::fs;
use std::io::{BufRead as _, BufReader, Lines, Read as _};
use std::path::Path;
use std::process::ChildStderr;

use mvt_robot::hand::{Hand, Side};
use serde_json::Value;

use crate::policies;
use crate::ros::{begun, domain, ended, python, start};
use crate::workplace::{Workplace, signal};

/// The shipped robot, on the loopback of a domain, with the time of the simulator.
fn robot_file(workplace: &Workplace, domain: u32) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("app/ros/rigs/allegro_v4.toml");
    let text = fs::read_to_string(file).unwrap();
    let head = format!(
        "[ros]\ndomain = {domain}\naddresses = [\"127.0.0.1\"]\nreliable = true\nsim_time = true\ntruth = \"/truth\"\n"
    );
    workplace.write("rig.toml", text.replace("[ros]\n", &head));
}

/// What a program says on its standard error, line by line.
struct Said {
    lines: Lines<BufReader<ChildStderr>>,
    all: String,
}

impl Said {
    fn of(messages: ChildStderr) -> Self {
        Self { lines: BufReader::new(messages).lines(), all: String::new() }
    }

    /// Reads on until these words have come.
    fn until(&mut self, words: &str) {
        while !self.all.contains(words) {
            self.all += &self.lines.next().unwrap_or_else(|| panic!("no {words:?} in {}", self.all)).unwrap();
        }
    }
}

/// Simulated seconds per second, so that a loaded machine with a program for tests keeps up.
const SPEED: &str = "--speed 0.15";

#[test]
fn the_estimate_drives_a_simulated_hand_that_keeps_its_object() {
    let (workplace, domain) = (Workplace::new(), domain(5));
    robot_file(&workplace, domain);
    let python = python();
    let recorder = python.as_ref().map(|python| {
        let topic = "/allegro_hand_position_controller/commands";
        start(&workplace, python, domain, "hear_commands.py", &format!("commands.json {topic}"))
    });
    let robot = begun(&workplace, &format!("simulate --ros rig.toml --object cube70 --duration 3 {SPEED} --json"));
    let run = begun(&workplace, "run --ros rig.toml --drive --object cube70 --controller auto --out live --quiet");
    let played = ended(robot);
    signal(&run, "INT");
    let said = ended(run);
    let outcome: Value = serde_json::from_str(&played.stdout).unwrap_or_else(|_| panic!("{played:?}, {said:?}"));
    assert_eq!((played.code, said.code), (Some(0), Some(0)), "{played:?}, {said:?}");
    // The object is kept, and the hand obeyed.
    assert_eq!(
        (&outcome["end"]["reason"], &outcome["refused"]),
        (&"completed".into(), &0.into()),
        "{outcome}, {said:?}"
    );
    assert!(outcome["commands"].as_u64().unwrap() > 100, "{outcome}, {said:?}");
    let summary = workplace.json("live/summary.json");
    let live = &summary["live"];
    assert!(summary["frames"].as_u64().unwrap() > 30, "{summary}");
    assert!(live["commands"]["sent"].as_u64() >= outcome["commands"].as_u64(), "{live}, {outcome}");
    assert!(said.stderr.contains("the hand is driven"), "{said:?}");
    // The stamps are those of the simulator's clock, and the true poses score the estimate.
    assert!(
        live["latency_ms"]["median"].as_f64().unwrap() < 5000.0 && !said.stderr.contains("synchronise"),
        "{said:?}"
    );
    assert!(summary["add_s_mm"]["mean"].as_f64().unwrap() < 5.0, "{summary}");

    let Some(recorder) = recorder else { return };
    signal(&recorder, "INT");
    let recorded = ended(recorder);
    assert_eq!(recorded.code, Some(0), "{recorded:?}");
    let commands: Vec<Vec<f64>> = serde_json::from_slice(&fs::read(workplace.path("commands.json")).unwrap()).unwrap();
    assert!(commands.len() > 100, "{} commands", commands.len());
    // Thumb, index, middle, ring on the wire; index, middle, ring, thumb in the hand.
    let ranges = Hand::allegro(Side::Right).ranges();
    let of_wire = [12, 0, 4, 8].into_iter().flat_map(|first| first..first + 4);
    let ranges: Vec<[f64; 2]> = of_wire.map(|joint| ranges[joint]).collect();
    for pair in commands.windows(2) {
        for ((before, after), [low, high]) in pair[0].iter().zip(&pair[1]).zip(&ranges) {
            assert!((*low..=*high).contains(after), "{after} is not from {low} to {high}");
            assert!((after - before).abs() <= 0.05 + 1e-9, "a step from {before} to {after}");
        }
    }
}

#[test]
fn a_hand_whose_driver_is_killed_holds_and_says_so() {
    let (workplace, domain) = (Workplace::new(), domain(6));
    robot_file(&workplace, domain);
    let mut robot = begun(&workplace, &format!("simulate --ros rig.toml --object cube70 --duration 2 {SPEED} --json"));
    let mut run = begun(&workplace, "run --ros rig.toml --drive --object cube70 --out live --quiet");
    let mut of_robot = Said::of(robot.stderr.take().unwrap());
    of_robot.until("the first command has come");
    run.kill().unwrap();
    run.wait().unwrap();
    of_robot.until("no command for 0.5 s: the hand holds its last targets");
    let mut printed = String::new();
    robot.stdout.take().unwrap().read_to_string(&mut printed).unwrap();
    assert!(robot.wait().unwrap().success(), "{printed}");
    let outcome: Value = serde_json::from_str(&printed).unwrap();
    assert_eq!((&outcome["end"]["reason"], &outcome["silences"]), (&"completed".into(), &1.into()), "{outcome}");
}

#[test]
fn a_driver_whose_robot_is_killed_opens_the_hand_and_says_so() {
    let (workplace, domain) = (Workplace::new(), domain(7));
    robot_file(&workplace, domain);
    let text = workplace.text("rig.toml");
    let text = text.replace("std_msgs/msg/Float64MultiArray", "trajectory_msgs/msg/JointTrajectory");
    let text = text.replace("on_stop = \"hold\"", "on_stop = \"open\"");
    workplace.write("rig.toml", &text);
    let mut robot = begun(&workplace, &format!("simulate --ros rig.toml --object cube70 --duration 60 {SPEED}"));
    let mut of_robot = Said::of(robot.stderr.take().unwrap());
    policies::write(&workplace, "50");
    let mut run = begun(
        &workplace,
        "run --ros rig.toml --drive --controller policy.safetensors --object cube70 --out live --quiet",
    );
    let mut of_run = Said::of(run.stderr.take().unwrap());
    of_run.until("the hand is driven");
    of_robot.until("the first command has come");
    robot.kill().unwrap();
    robot.wait().unwrap();
    of_run.until("the hand opens: /clock stands still");
    signal(&run, "INT");
    assert!(run.wait().unwrap().success());
    let stops = &workplace.json("live/summary.json")["live"]["commands"]["stops"];
    assert_eq!(stops.as_array().unwrap().last(), Some(&"/clock stands still".into()));
}

#[test]
fn a_command_topic_to_which_nobody_subscribes_is_named() {
    let (workplace, domain) = (Workplace::new(), domain(8));
    robot_file(&workplace, domain);
    let text = workplace.text("rig.toml");
    workplace.write("elsewhere.toml", text.replace("/allegro_hand_position_controller/commands", "/elsewhere"));
    let mut robot = begun(&workplace, &format!("simulate --ros rig.toml --object cube70 {SPEED}"));
    let mut run = begun(&workplace, "run --ros elsewhere.toml --drive --object cube70 --out live --quiet");
    Said::of(run.stderr.take().unwrap()).until("/elsewhere: nobody subscribes");
    run.kill().unwrap();
    run.wait().unwrap();
    signal(&robot, "INT");
    let mut printed = String::new();
    robot.stdout.take().unwrap().read_to_string(&mut printed).unwrap();
    assert!(robot.wait().unwrap().success() && printed.contains("was stopped for 0.0 s"), "{printed}");
}

#[test]
fn files_and_arguments_that_do_not_fit_are_refused_in_one_line() {
    let workplace = Workplace::new();
    robot_file(&workplace, 1);
    let error = |line: &str| workplace.run(line).error();
    assert!(error("run --ros rig.toml --controller cube").contains("--drive"));
    assert!(error("run --ros rig.toml --drive").contains("--controller NAME, or --object"));
    assert!(error("run --ros rig.toml --drive --controller cube:8,bal:8").contains("cannot be tilted"));
    assert!(error("run --ros rig.toml --drive --controller cube --goal explored").contains("--goal explored"));
    workplace.write(
        "bare.toml",
        "[ros]\ndepth = \"/d\"\ncamera_info = \"/i\"\nrig = \"allegro_digit\"\njoints = \"/j\"\ncamera = \"side\"\n",
    );
    assert!(error("run --ros bare.toml --drive --controller cube").contains("[ros.command]"));
    assert!(error("simulate --ros bare.toml --object cube70").contains("[ros.command]"));
    assert!(error("simulate --ros bare.toml --object cube70 --speed 0.5").contains("sim_time = true"));
    let text = workplace.text("rig.toml");
    workplace.write("order.toml", text.replace("\"ah_joint33\",", "\"ah_joint32\","));
    assert!(error("simulate --ros order.toml --object cube70").contains("each of the 16 joints once"));
}
