//! Logs to data sets of LeRobot and back, and folders that are no data sets. Files of other writers are read in `python/tests/test_lerobot.py`.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a failed assumption in a test is a failed test")]

use std::fs;
use std::path::PathBuf;

use crate::common::{FRAMES, small_log, write_log};
use mvt_exchange::{ExchangeError, Imported, export_lerobot, export_mcap, import_lerobot, import_mcap};
use mvt_feelsight::Log;
use mvt_robot::hand::{Hand, Side};

struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    /// A folder with a log and a data set of two episodes of it.
    fn new() -> Self {
        let place = Self { folder: tempfile::tempdir().unwrap() };
        write_log(&place.path("log"));
        let log = place.path("log");
        export_lerobot(&[log.clone(), log], &[], &place.path("set"), false, || ()).unwrap();
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn import(&self, episode: usize, mapping: Option<&str>, log: &str) -> Result<Imported, ExchangeError> {
        let file = self.path("mapping.toml");
        let mapping = mapping.map(|text| {
            fs::write(&file, text).unwrap();
            file.as_path()
        });
        import_lerobot(&self.path("set"), episode, mapping, &self.path(log), |_, _| ())
    }

    /// Returns the message with which an import of the first episode ends.
    fn refused(&self, mapping: Option<&str>) -> String {
        let error = self.import(0, mapping, "wrong").unwrap_err().to_string();
        let left: Vec<_> = fs::read_dir(self.folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert!(left.iter().all(|name| !name.to_string_lossy().contains("wrong")), "{left:?}");
        assert!(!error.contains('\n'), "{error}");
        error
    }

    /// Changes a file of the data set.
    fn change(&self, file: &str, change: impl FnOnce(Vec<u8>) -> Vec<u8>) -> Vec<u8> {
        let path = self.path("set").join(file);
        let before = fs::read(&path).unwrap();
        fs::write(path, change(before.clone())).unwrap();
        before
    }
}

#[test]
fn an_import_of_an_export_is_the_log_again() {
    let place = Place::new();
    for episode in [0, 1] {
        let name = format!("again-{episode}");
        let imported = place.import(episode, None, &name).unwrap();
        assert_eq!(imported.frames, FRAMES);
        assert_eq!(imported.channels.len(), 9, "{imported:?}");
        let (before, after) = (Log::open(&place.path("log")).unwrap(), Log::open_tolerant(&place.path(&name)).unwrap());
        assert_eq!((before.times_s(), before.joints()), (after.times_s(), after.joints()));
        assert_eq!((before.object_poses(), before.cameras()), (after.object_poses(), after.cameras()));
        assert_eq!((before.hand(), before.object_name()), (after.hand(), after.object_name()));
        assert_eq!(before.scene(), after.scene());
        for k in 0..FRAMES {
            let (a, b) = (before.image_files(k).unwrap(), after.image_files(k).unwrap());
            assert_eq!(a.colours, b.colours);
            assert_eq!(a.touch, b.touch);
            let (a, b) = (before.frame(k).unwrap().unwrap(), after.frame(k).unwrap().unwrap());
            for (a, b) in a.observation.cameras.iter().zip(&b.observation.cameras) {
                assert!(a.depth_m.iter().zip(&b.depth_m).all(|(a, b)| (a - b).abs() < 0.6e-4));
            }
        }
    }
}

#[test]
fn exact_depth_is_that_of_the_log_to_the_bit() {
    let place = Place::new();
    fs::remove_dir_all(place.path("set")).unwrap();
    export_lerobot(&[place.path("log")], &[], &place.path("set"), true, || ()).unwrap();
    place.import(0, None, "again").unwrap();
    let (before, after) = (Log::open(&place.path("log")).unwrap(), Log::open_tolerant(&place.path("again")).unwrap());
    for k in 0..FRAMES {
        let (a, b) = (before.frame(k).unwrap().unwrap(), after.frame(k).unwrap().unwrap());
        assert!(a.observation.cameras.iter().zip(&b.observation.cameras).all(|(a, b)| a.depth_m == b.depth_m));
    }
    let before = place.change("meta/mambavitact/episode-000000/depth-1.npz", |bytes| bytes[..bytes.len() / 2].to_vec());
    assert!(place.refused(None).contains("depth-1.npz"));
    place.change("meta/mambavitact/episode-000000/depth-1.npz", |_| before);
    place.import(0, None, "repaired").unwrap();
}

#[test]
fn joints_and_columns_are_those_of_the_mapping() {
    let place = Place::new();
    let hand = Hand::allegro(Side::Left);
    let names: Vec<String> = hand.joints().iter().rev().map(|joint| format!("{:?}", joint.name)).collect();
    let mapping = format!(
        "[hand]\njoints = \"action\"\nnames = [{}]\n[touch.thumb]\nimage = \"observation.images.touch_index\"\nquarter_turns = 2\n",
        names.join(", ")
    );
    let imported = place.import(1, Some(&mapping), "other").unwrap();
    assert!(imported.notes.iter().any(|note| note.contains("pad ring has no touch images")), "{imported:?}");
    let (before, after) = (Log::open(&place.path("log")).unwrap(), Log::open_tolerant(&place.path("other")).unwrap());
    for k in 0..FRAMES {
        let expected: Vec<f64> =
            before.joints()[(k + 1).min(FRAMES - 1)].iter().rev().map(|&a| f64::from(a as f32)).collect();
        assert_eq!(after.joints()[k].to_vec(), expected);
        assert!((after.times_s()[k] - k as f64 / 30.0).abs() < 1e-9);
        assert_eq!(after.object_poses()[k], None);
    }
}

#[test]
fn a_log_of_another_hand_is_exported_with_its_own_joints_and_pads() {
    let place = Place { folder: tempfile::tempdir().unwrap() };
    let hand = Hand::new(small_log::gripper()).unwrap();
    small_log::write_of(&hand, &place.path("log"), FRAMES, &[small_log::camera("side", 32, 24)]);
    export_lerobot(&[place.path("log")], &[], &place.path("set"), false, || ()).unwrap();
    let info = fs::read(place.path("set/meta/info.json")).unwrap();
    let info: serde_json::Value = serde_json::from_slice(&info).unwrap();
    assert_eq!(info["robot_type"], "gripper");
    assert_eq!(info["features"]["observation.state"]["names"], serde_json::json!(["slide", "bend", "turn"]));
    assert_eq!(info["features"]["observation.images.touch_back_lower"]["dtype"], "image");
    let mapping = fs::read_to_string(place.path("set/meta/mambavitact/episode-000000/mapping.toml")).unwrap();
    assert!(mapping.contains("[touch.\"back/lower\"]\nimage = \"observation.images.touch_back_lower\""), "{mapping}");
    let said = place.refused(None);
    assert!(said.contains("the pad \"back/lower\", and the hand's pads are index, middle, ring, thumb"), "{said}");

    let log = Log::open(&place.path("log")).unwrap();
    export_mcap(&log, &place.path("log.mcap"), false, || ()).unwrap();
    let said = import_mcap(&place.path("log.mcap"), None, &place.path("wrong"), |_, _| ()).unwrap_err().to_string();
    assert!(said.contains("there is no joint \"index_0\" among slide, bend, turn") && !said.contains('\n'), "{said}");
}

#[test]
fn what_is_no_data_set_is_refused_with_the_reason() {
    let place = Place::new();
    let own = fs::read_to_string(place.path("set/meta/mambavitact/episode-000000/mapping.toml")).unwrap();
    assert!(place.import(2, Some(&own), "wrong").unwrap_err().to_string().contains("it has 2 episodes"));
    assert!(place.import(2, None, "wrong").unwrap_err().to_string().contains("--mapping FILE"));
    for (from, to, said) in [
        ("\"observation.state\"", "\"state\"", "no column \"state\""),
        ("\"observation.time_s\"", "\"index_0\"", "no column \"index_0\""),
        ("\"observation.time_s\"", "\"episode_index\"", "the time does not increase in 3 of 4 rows"),
        (
            "\"observation.object_pose\"",
            "\"action\"",
            "action: none of its rows can be used; first frame 0: it is not x, y, z",
        ),
        (
            "\"observation.images.touch_ring\"",
            "\"action\"",
            "action: none of its rows can be used; first frame 0: it has no image file",
        ),
        ("_depth\"", "\"", "it has Rgb8 pixels and not 16 bits of grey"),
        ("width = 64", "width = 63", "pixels and its camera"),
        ("intrinsics", "#", "give intrinsics and pose"),
        ("joints = ", "names = [\"a\"]\njoints = ", "hand.names has 1 names"),
    ] {
        assert!(own.contains(from), "{from}");
        let error = place.refused(Some(&own.replacen(from, to, 1)));
        assert!(error.contains(said), "{said}: {error}");
    }
    for (file, from, to, said) in [
        ("meta/info.json", "v3.0", "v2.1", "its version is v2.1"),
        ("meta/info.json", "data/chunk", "../chunk", "data_path"),
        ("meta/info.json", "\"fps\": 30", "\"fps\": 0", "fps"),
        ("meta/info.json", "\"index_2\"", "\"index_9\"", "no joint \"index_2\""),
        ("meta/info.json", "\"dtype\": \"image\"", "\"dtype\": \"video\"", "is a video"),
        ("meta/info.json", "{", "", "meta/info.json is invalid"),
    ] {
        let before = place.change(file, |bytes| String::from_utf8(bytes).unwrap().replace(from, to).into_bytes());
        let error = place.refused(None);
        assert!(error.contains(said), "{said}: {error}");
        place.change(file, |_| before);
    }
    for (file, said) in [
        ("data/chunk-000/file-000.parquet", "file-000.parquet"),
        ("meta/episodes/chunk-000/file-000.parquet", "it is no Parquet file"),
    ] {
        for length in [0, 3, 40] {
            let before = place.change(file, |bytes| bytes[..bytes.len() * length / 50].to_vec());
            let error = place.refused(None);
            assert!(error.contains(said), "{said}: {error}");
            place.change(file, |_| before);
        }
    }
    fs::remove_file(place.path("set/meta/info.json")).unwrap();
    assert!(place.refused(None).contains("give the folder of a data set of LeRobot"));
}
