use serde::{Deserialize, Serialize};

use super::*;
use crate::config::RunConfig;

mvt_settings::settings! {
    /// Settings of all kinds.
    pub struct Run {
        /// A text.
        pub name: String = "run".into();
        /// A whole number.
        pub threads: u32 = 2, 1..=64;
        /// A group.
        pub tracker: Tracker, Nested;
    }
}

mvt_settings::settings! {
    /// A group.
    pub struct Tracker {
        /// A number.
        pub icp_weight: f64 = 1.0, 0.0..=10.0;
        /// A number of 32 bits.
        pub sdf_weight: f32 = 0.1, 0.0..=1.0;
        /// A list.
        pub factors: Vec<f64> = vec![1.0, 2.0], List { length: 1..=3, each: -10.0..=10.0 };
        /// A switch.
        pub enabled: bool = true;
        /// A choice.
        pub start: Start = Start::Disturbed;
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Start {
    Truth,
    Disturbed,
}

impl mvt_settings::Unlimited for Start {}

fn set(assignments: &[&str]) -> Result<Run, LoadSettingsError> {
    load(Run::default(), None, &assignments.iter().map(|&s| s.to_owned()).collect::<Vec<_>>())
}

fn file(text: &str) -> Result<Run, LoadSettingsError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("config.toml");
    std::fs::write(&path, text).unwrap();
    load(Run::default(), Some(&path), &["threads=7".to_owned()])
}

#[test]
fn defaults_file_and_assignments_in_this_order() {
    assert_eq!(set(&[]).unwrap(), Run::default());
    let run = file("threads = 3\n[tracker]\nicp_weight = 4\nfactors = [3]\n").unwrap();
    assert_eq!((run.threads, run.tracker.icp_weight, run.tracker.factors), (7, 4.0, vec![3.0]));
    let run = set(&[
        "tracker.icp_weight=0.25",
        " tracker.factors = [1, 2.5] ",
        "name=12",
        "tracker.start=truth",
        "tracker.enabled=false",
        "threads=1",
        "threads=4",
    ])
    .unwrap();
    let tracker = Tracker {
        icp_weight: 0.25,
        factors: vec![1.0, 2.5],
        enabled: false,
        start: Start::Truth,
        ..Tracker::default()
    };
    assert_eq!(run, Run { name: "12".into(), threads: 4, tracker });
    assert_eq!(set(&["name=\"a = b\""]).unwrap().name, "a = b");
}

#[test]
fn what_is_written_is_read_as_the_same() {
    let run = set(&["tracker.icp_weight=0.1", "name=a \"b\" = [c]", "tracker.sdf_weight=0.3"]).unwrap();
    let text = to_toml(&run).unwrap();
    let again: Run = {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        std::fs::write(&path, &text).unwrap();
        load(Run::default(), Some(&path), &[]).unwrap()
    };
    assert_eq!(again, run, "{text}");
    assert!(text.contains("sdf_weight = 0.3\n"), "{text}");
}

#[test]
fn mistakes_are_named_in_one_line() {
    for (assignment, expected) in [
        ("threads", "--set threads: give a key and a value"),
        ("=3", "--set =3: give a key and a value"),
        ("thraeds=3", "there is no setting thraeds; did you mean threads?"),
        ("icp_wieght=3", "there is no setting icp_wieght; did you mean tracker.icp_weight?"),
        ("traker.icp_weight=3", "did you mean tracker.icp_weight?"),
        ("threads.x=3", "there is no setting threads.x"),
        ("zzzzzzzzzzzz=3", "there is no setting zzzzzzzzzzzz"),
        ("tracker=3", "tracker must be one of its own keys (icp_weight, sdf_weight, factors, enabled, start), not 3"),
        ("tracker.icp_weight=heavy", "tracker.icp_weight must be a number, from 0 to 10, not \"heavy\""),
        ("tracker.icp_weight=nan", "settings: tracker.icp_weight must be from 0 to 10 (it is NaN)"),
        ("tracker.enabled=1", "tracker.enabled must be true or false, not 1"),
        ("threads=1.5", "threads must be a whole number, from 1 to 64, not 1.5"),
        ("threads=-1", "--set: threads must be a whole number, from 1 to 64, not -1"),
        (
            "tracker.factors=[\"a\"]",
            "tracker.factors must be a list such as [1.0, 2.0], 1 to 3 numbers, each from -10 to 10, not [\"a\"]",
        ),
        ("tracker.start=midway", "tracker.start must be `truth` or `disturbed`, not \"midway\""),
        ("threads=3\nname=\"x\"", "threads must be a whole number"),
    ] {
        let error = set(&[assignment]).unwrap_err().to_string();
        assert!(error.contains(expected) && !error.contains('\n'), "{error}");
    }
    assert!(!set(&["zzzzzzzzzzzz=3"]).unwrap_err().to_string().contains("did you mean"));
    let variant = set(&["tracker.start=midway"]).unwrap_err().to_string();
    assert!(variant.contains("truth") && variant.contains("disturbed"), "{variant}");

    for (text, expected) in [
        ("threads = 3\nx = = 4\n", "config.toml: line 2: "),
        (
            "threads = 3\n[tracker]\nicp_weigth = 4\n",
            "there is no setting tracker.icp_weigth; did you mean tracker.icp_weight?",
        ),
        ("tracker = 4\n", "tracker must be one of its own keys"),
        ("[threads]\nx = 1\n", "threads must be a whole number"),
    ] {
        let error = file(text).unwrap_err().to_string();
        assert!(error.contains(expected) && error.contains("config.toml") && !error.contains('\n'), "{error}");
    }
    let missing = load(Run::default(), Some(Path::new("nowhere.toml")), &[]).unwrap_err().to_string();
    assert!(missing.starts_with("nowhere.toml: "), "{missing}");
}

proptest::proptest! {
    #[test]
    fn no_assignment_panics(text in "[a-z.=\\[\\]\"0-9\n-]{0,24}") {
        let _ = set(&[&text, &format!("name={text}"), &format!("tracker.factors={text}")]);
        let _ = file(&text);
    }
}

/// Reads settings of a run from the text of a file.
fn run_config(text: &str, set: &[&str]) -> Result<RunConfig, LoadSettingsError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("config.toml");
    std::fs::write(&path, text).unwrap();
    load(RunConfig::default(), Some(&path), &set.iter().map(|&s| s.to_owned()).collect::<Vec<_>>())
}

#[test]
fn every_setting_of_a_run_is_listed() {
    RunConfig::default().validate().unwrap();
    let mut listed: Vec<String> = RunConfig::listing().into_iter().map(|setting| setting.key).collect();
    let table = Table::try_from(RunConfig::default()).unwrap();
    let mut keys: Vec<String> = leaves("", table, &[]).into_iter().map(|(key, _)| key).collect();
    listed.sort();
    keys.sort();
    assert_eq!(listed, keys);
    assert!(keys.iter().filter(|key| key.starts_with("supervisor.")).count() == 17);
    assert!(keys.iter().filter(|key| key.starts_with("segmentation.")).count() == 6);
    for setting in RunConfig::listing() {
        assert!(!setting.doc.is_empty(), "{}", setting.key);
        let [low, high] = setting.bounds.unwrap_or([0.0, 1.0]);
        assert!(low < high && high < 1e13, "{}", setting.key);
    }
}

#[test]
fn every_number_out_of_range_is_refused_with_its_key_and_range() {
    let mut table = Table::try_from(RunConfig::default()).unwrap();
    let mut refused = 0;
    for SettingInfo { key, range, bounds, .. } in RunConfig::listing() {
        let default = lookup(&mut table, &key).unwrap().clone();
        let (count, is_whole) = match &default {
            Value::Array(list) => (Some(list.len()), list[0].is_integer()),
            default => (None, default.is_integer()),
        };
        let Some([low, high]) = bounds else {
            assert!(default.is_bool() || default.is_str(), "{key} has no range");
            continue;
        };
        for text in ["nan", "inf", "-inf", "-1", "0", "1e30"] {
            let value: f64 = text.parse().unwrap();
            // All but one entry of a list are valid.
            let given = match (count, &default) {
                (Some(count), Value::Array(list)) => {
                    let others = list[1..].iter().map(|entry| format!(", {entry}")).collect::<String>();
                    assert!(list.len() == count);
                    format!("[{text}{others}]")
                }
                _ => text.to_owned(),
            };
            // 0 is a multiple of 16, but out of range.
            let is_right = (low..=high).contains(&value) && (!is_whole || value.fract() == 0.0);
            match load(RunConfig::default(), None, &[format!("{key}={given}")]) {
                Ok(_) => assert!(is_right, "{key}={given} is accepted"),
                Err(error) => {
                    let message = error.to_string();
                    assert!(!is_right, "{message}");
                    assert!(message.contains(&format!("{key} must be ")) && message.contains(&range), "{message}");
                    refused += 1;
                }
            }
        }
    }
    assert!(refused > 300, "{refused}");
}

#[test]
fn settings_that_contradict_each_other_are_refused() {
    for (set, expected) in [
        (vec!["slam.field.truncation_m=0.08"], "slam.field.truncation_m must be at most half_extent_m, 0.075"),
        (
            vec!["slam.map.band_part=0.9"],
            "slam.map.band_part + before_part + passed_part + hand_part must be at most 1",
        ),
        (
            vec!["supervisor.drift_end_m=0.02"],
            "supervisor.drift_end_m must be at most drift_begin_m, 0.012 (it is 0.02)",
        ),
        (vec!["slam.field.hidden=24"], "slam.field.hidden must be a multiple of 16 from 16 to 256 (it is 24)"),
        (vec!["segmentation.labels=masks"], "segmentation.labels must be "),
        (vec!["slam.field.levels=[]"], "slam.field.levels must be 1 to 8 numbers"),
        (vec!["slam.scan.camera_shift_px=[1]"], "slam.scan.camera_shift_px must be a list"),
    ] {
        let message = run_config("", &set).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    // Both together fit.
    run_config("", &["supervisor.drift_end_m=0.02", "supervisor.drift_begin_m=0.03"]).unwrap();
}

#[test]
fn settings_of_version_0_1_0_are_read() {
    let old = include_str!("../../tests/golden/config-0.1.0.toml");
    assert_eq!(run_config(old, &[]).unwrap(), RunConfig::default());
    let changed = old.replace("    0.8,", "    0.7,").replace("    0.004,", "    0.003,");
    let config = run_config(&changed, &["slam.tracker.velocity_sigma=[0.002, 1]", "supervisor.push_s=3"]).unwrap();
    assert_eq!((config.slam.trust.surprise_m_s, config.slam.trust.surprise_rad_s), (0.6, 21.0));
    assert_eq!((config.supervisor.drift_begin_m, config.supervisor.drift_end_m), (0.012, 0.003));
    assert_eq!((config.slam.tracker.velocity_sigma_m_s, config.slam.tracker.velocity_sigma_rad_s), (0.075, 37.5));
    let config = run_config(old, &["slam.map.steps=6", "slam.tracker.velocity_kept=0"]);
    assert!(config.unwrap_err().to_string().contains("slam.tracker.velocity_memory_s must be from 0.0001"));
    for (assignment, expected) in [
        ("supervisor.drift_m=0.01", "supervisor.drift_m must be a list of 2 numbers, not 0.01"),
        ("supervisor.drift_m=[0.01]", "supervisor.drift_m must be a list of 2 numbers, not [0.01]"),
        ("supervisor.drift_m=[0.01, true]", "supervisor.drift_end_m must be a number, from 0 to 1, not true"),
        ("slam.map.refine_sigma=[0, 0.1]", "slam.map.refine_sigma_m must be from 1e-6 to 1 (it is 0)"),
        ("slam.map.refine_sigmas=[1, 0.1]", "did you mean slam.map.refine_sigma_m?"),
    ] {
        let message = run_config(old, &[assignment]).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn written_settings_have_comments_and_are_read_back() {
    let set = ["slam.tracker.window=5", "segmentation.edge_px=2", "slam.scan.camera_shift_px=[1, 0.25]"];
    let config = run_config("", &set).unwrap();
    let text = to_toml(&config).unwrap();
    assert_eq!(run_config(&text, &[]).unwrap(), config, "{text}");
    assert!(text.contains("\n# Frames solved together.\n# Range: from 1 to 30. Default: 3.\nwindow = 5\n"), "{text}");
    assert!(text.contains("# Default: true.\nfar_is_free = true\n"), "{text}");
    let commented = text.lines().filter(|line| line.starts_with("# ") && line.contains("Default: ")).count();
    assert_eq!(commented, RunConfig::listing().len());
}
