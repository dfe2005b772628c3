//! Bad bags: each is refused, or read with a note, in one line that says what to do.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a failed assumption in a test is a failed test"
)]

use std::fs;
use std::path::{Path, PathBuf};

use crate::common::{Cdr, IMAGE, INFO, Written, color, data, depth, frame, image, info, mcap};
use mvt_bag::{Bag, RgbdBag, RgbdTopics};
use tempfile::TempDir;

const SECOND: i64 = 1_000_000_000;

struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn with(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    }
}

/// Opens a bag of these messages as RGB-D frames.
fn rgbd(messages: &[Written<'_>]) -> Result<(RgbdBag, Folder), String> {
    let folder = Folder::new();
    let path = folder.with("bag.mcap", &mcap(messages, "cdr"));
    RgbdBag::open(&path).map(|bag| (bag, folder)).map_err(|error| error.to_string())
}

fn refused(messages: &[Written<'_>], words: &[&str]) {
    let error = rgbd(messages).err().expect("it is refused");
    assert!(!error.contains('\n') && words.iter().all(|word| error.contains(word)), "{error}");
}

fn noted(messages: &[Written<'_>], frames: usize, words: &[&str]) -> RgbdBag {
    let (mut bag, _folder) = rgbd(messages).unwrap();
    let notes = bag.notes().join("\n");
    assert!(words.iter().all(|word| notes.contains(word)), "{notes}");
    assert_eq!(bag.frames().map(Result::unwrap).count(), frames);
    bag
}

fn several(frames: i64) -> Vec<Written<'static>> {
    (1..=frames).flat_map(|k| frame(k * SECOND / 10, k * SECOND / 10)).collect()
}

fn open(path: &Path) -> String {
    Bag::open(path).expect_err("it is refused").to_string()
}

#[test]
fn files_that_are_no_bags_of_ros_2_are_refused_with_what_to_do() {
    let folder = Folder::new();
    let ros1 = open(&folder.with("old.bag", b"#ROSBAG V2.0\nrest"));
    assert!(ros1.contains("ROS 1") && ros1.contains("rosbags-convert --src"), "{ros1}");
    let pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:2f\nsize 12345\n";
    assert!(open(&folder.with("a.mcap", pointer)).contains("git lfs pull"));
    assert!(open(&folder.with("b.mcap", b"")).contains("the file is empty"));
    assert!(open(&folder.with("c.mcap", b"something else entirely")).contains("neither MCAP nor SQLite"));
    assert!(open(&folder.0.path().join("nothing.db3")).contains("nothing.db3"));
    let empty = Folder::new();
    assert!(open(empty.0.path()).contains("neither metadata.yaml nor files"));
    empty.with("old.bag", b"#ROSBAG V2.0\nrest");
    assert!(open(empty.0.path()).contains("rosbags-convert"));
    let other = folder.with("other.db3", b"SQLite format 3\0 and then nothing of it");
    assert!(open(&other).contains("SQLite"), "{}", open(&other));
    let messages = several(1);
    let protobuf = folder.with("p.mcap", &mcap(&messages, "protobuf"));
    let error = RgbdBag::open(&protobuf).unwrap_err().to_string();
    assert!(error.contains("encoded as \"protobuf\"") && error.contains("import"), "{error}");
}

#[test]
fn what_is_missing_of_a_split_bag_is_noted() {
    let folder = Folder::new();
    for file in ["metadata.yaml", "split_0.mcap", "split_2.mcap"] {
        fs::copy(data("split").join(file), folder.0.path().join(file)).unwrap();
    }
    let mut bag = Bag::open(folder.0.path()).unwrap();
    let notes = bag.notes().join("\n");
    assert!(notes.contains("split_1.mcap is missing and left out: copy it"), "{notes}");
    assert!(bag.messages(&["/tf"]).unwrap().map(Result::unwrap).count() > 0);
    for file in ["split_0.mcap", "split_2.mcap"] {
        fs::remove_file(folder.0.path().join(file)).unwrap();
    }
    assert!(open(folder.0.path()).contains("no file that metadata.yaml names is there"));
    folder.with("metadata.yaml", b"relative_file_paths:\n- ../../../etc/passwd\n");
    assert!(open(folder.0.path()).contains("no file that metadata.yaml names is there"));
}

#[test]
fn what_a_bag_held_before_it_was_cut_off_is_read_with_a_note() {
    for name in ["mcap/mcap.mcap", "lz4.mcap", "unchunked.mcap", "unsorted.mcap"] {
        let whole = fs::read(data(name)).unwrap();
        let folder = Folder::new();
        let all = Bag::open(&data(name)).unwrap().topics().iter().map(|topic| topic.count).sum::<u64>() as usize;
        let mut most = 0;
        for part in [95, 80, 60, 30] {
            let path = folder.with("cut.mcap", &whole[..whole.len() * part / 100]);
            let mut bag = Bag::open(&path).unwrap();
            assert!(
                bag.notes().iter().any(|note| note.contains("cut off") && note.contains("mcap recover")),
                "{:?}",
                bag.notes()
            );
            let names: Vec<String> = bag.topics().iter().map(|topic| topic.name.clone()).collect();
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            let times: Vec<i64> = bag.messages(&names).unwrap().map(|message| message.unwrap().log_ns).collect();
            assert!(times.is_sorted() && times.len() <= all);
            most = most.max(times.len());
        }
        assert!(most > 0 || name.starts_with("mcap/"), "{name}");
    }
    let whole = fs::read(data("db3/db3.db3")).unwrap();
    let folder = Folder::new();
    let error = open(&folder.with("cut.db3", &whole[..whole.len() / 2]));
    assert!(error.contains(".recover"), "{error}");
}

#[test]
fn a_damaged_chunk_is_left_out_with_a_note() {
    let mut bytes = fs::read(data("lz4.mcap")).unwrap();
    // Behind the name of the compression and a length come the compressed records.
    let second = bytes.windows(3).enumerate().filter(|(_, name)| name == b"lz4").nth(1).unwrap().0;
    bytes[second + 60] ^= 0xff;
    let folder = Folder::new();
    let mut bag = Bag::open(&folder.with("bag.mcap", &bytes)).unwrap();
    let names: Vec<String> = bag.topics().iter().map(|topic| topic.name.clone()).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let count = bag.messages(&names).unwrap().map(Result::unwrap).count();
    let all: u64 = bag.topics().iter().map(|topic| topic.count).sum();
    assert!(count > 10 && (count as u64) < all, "{count} of {all}");
    assert!(
        bag.notes().iter().any(|note| note.contains("the chunk at byte") && note.contains("left out")),
        "{:?}",
        bag.notes()
    );
}

#[test]
fn topics_in_doubt_are_listed_and_bag_toml_decides() {
    let mut messages = several(3);
    messages.push(Written(SECOND, "/left/image", IMAGE, color(SECOND)));
    refused(&messages, &["2 topics have colour images", "`color = \"TOPIC\"`", "/rgb/image, /left/image"]);
    let folder = Folder::new();
    let path = folder.with("bag.mcap", &mcap(&messages, "cdr"));
    folder.with("bag.toml", b"color = \"/rgb/image\"\ndepth_unit_m = 0.002\n");
    let mut bag = RgbdBag::open(&path).unwrap();
    assert_eq!(bag.frame(0).unwrap().depth_m[(1, 2)], 2.0);
    for (text, words) in [
        ("colour = \"/rgb/image\"", "unknown field"),
        ("slop_s = 0", "slop_s must be above 0"),
        ("color = \"/none\"", "there is no topic \"/none\""),
        ("color = \"/depth/camera_info\"", "has messages sensor_msgs/msg/CameraInfo, not"),
    ] {
        folder.with("bag.toml", text.as_bytes());
        let error = RgbdBag::open(&path).unwrap_err().to_string();
        assert!(error.contains(words) && !error.contains('\n'), "{error}");
    }
    // Depth that is aligned is preferred, and so is a topic to its compressed copy.
    let mut messages = several(2);
    messages.push(Written(SECOND, "/aligned_depth/image", IMAGE, depth(SECOND / 10)));
    messages.push(Written(SECOND, "/aligned_depth/camera_info", INFO, info(SECOND, [4, 3])));
    messages.push(Written(SECOND, "/ir/image", IMAGE, image(SECOND, "mono16", [4, 3], 8, &[1; 24])));
    let jpeg = Cdr::header(SECOND, "optical").text("jpeg").bytes(&[0xff, 0xd8]).done();
    messages.push(Written(SECOND, "/rgb/image/compressed", "sensor_msgs/msg/CompressedImage", jpeg));
    let (bag, _folder) = rgbd(&messages).unwrap();
    let (color, depth, camera_info, masks) = bag.image_topics();
    let found = [color.as_str(), depth.as_str(), camera_info.as_str()];
    assert_eq!(found, ["/rgb/image", "/aligned_depth/image", "/aligned_depth/camera_info"]);
    assert_eq!(masks, None);
}

#[test]
fn a_missing_part_says_what_to_record() {
    let without = |topic: &str| several(2).into_iter().filter(|message| message.1 != topic).collect::<Vec<_>>();
    refused(&without("/depth/camera_info"), &["there is no camera model: record /depth/camera_info"]);
    refused(&without("/depth/image"), &["no topic has depth images", "`depth = \"TOPIC\"`"]);
    refused(&[], &["there are no messages"]);
    let mut far = without("/rgb/image");
    far.push(Written(SECOND, "/rgb/image", IMAGE, color(9 * SECOND)));
    let mut infrared = several(2);
    infrared.push(Written(SECOND, "/ir/image", IMAGE, image(SECOND, "mono16", [4, 3], 8, &[1; 24])));
    assert_eq!(noted(&infrared, 2, &[]).image_topics().1, "/depth/image");
    refused(&far, &["no colour image lies within 50.0 ms", "slop_s"]);
}

#[test]
fn images_that_do_not_fit_are_refused() {
    let with = |topic: &str, data: Vec<u8>| {
        let mut messages = several(1);
        messages.iter_mut().filter(|message| message.1 == topic).for_each(|message| message.3.clone_from(&data));
        messages
    };
    let stamp = SECOND / 10;
    refused(
        &with("/depth/image", image(stamp, "16UC1", [4, 3], 8, &[1; 20])),
        &["20 bytes of pixels", "3 rows of 8 bytes", "cut off"],
    );
    refused(&with("/depth/image", image(stamp, "16UC1", [4, 3], 6, &[1; 24])), &["a row has 6 bytes (step)", "need 8"]);
    refused(
        &with("/depth/image", image(stamp, "16UC1", [2, 3], 8, &[1; 24])),
        &["2 x 3 pixels", "4 x 3", "camera_info"],
    );
    refused(&with("/depth/image", image(stamp, "16UC1", [0, 0], 0, &[])), &["0 x 0 pixels"]);
    refused(&with("/depth/image", image(stamp, "16UC1", [u32::MAX, u32::MAX], u32::MAX, &[])), &["that of no camera"]);
    refused(&with("/rgb/image", image(stamp, "yuv422_yuy2", [4, 3], 8, &[1; 24])), &["yuv422_yuy2", "known are rgb8"]);
    refused(&with("/rgb/image", image(stamp, "rgb8", [4, 4], 12, &[1; 48])), &["another shape", "aligned"]);
    refused(&with("/depth/camera_info", info(stamp, [640, 480])), &["4 x 3 pixels", "640 x 480"]);
    let mut cut = depth(stamp);
    cut.truncate(30);
    refused(&with("/depth/image", cut), &["no topic has depth images"]);
}

#[test]
fn messages_that_cannot_be_used_are_counted() {
    let mut messages = several(3);
    messages.push(Written(SECOND, "/depth/image", IMAGE, vec![0, 1, 0, 0, 1]));
    messages.push(Written(SECOND, "/depth/image", IMAGE, vec![0, 9, 0, 0, 1]));
    noted(&messages, 3, &["2 messages of /depth/image are left out, the first because the message ends at byte 5"]);
}

#[test]
fn stamps_of_zero_give_way_to_the_times_of_recording() {
    let mut messages: Vec<_> = (1..=4).flat_map(|k| frame(k * SECOND / 10, k * SECOND / 10)).collect();
    for message in &mut messages {
        if message.1 == "/depth/image" {
            message.3 = depth(0);
        }
    }
    let bag = noted(&messages, 4, &["the images of depth state no time: the times of recording are used"]);
    let times: Vec<f64> = bag.times_s().collect();
    assert!(times.iter().zip([0.0, 0.1, 0.2, 0.3]).all(|(a, b)| (a - b).abs() < 1e-9), "{times:?}");
}

#[test]
fn frames_that_are_not_newer_are_left_out() {
    let stamps = [1, 2, 3, 1, 2, 3, 4];
    let messages: Vec<_> = (1..).zip(stamps).flat_map(|(k, stamp)| frame(k * SECOND, stamp * SECOND)).collect();
    let bag = noted(&messages, 4, &["3 images of depth that are not newer than the one before are left out"]);
    assert!(bag.times_s().is_sorted());
}

#[test]
fn masks_with_several_labels_need_the_object() {
    let mut messages = several(2);
    for k in 1..=2 {
        let labels = image(k * SECOND / 10, "8UC1", [4, 3], 4, &[0, 5, 7, 7, 0, 5, 7, 7, 0, 0, 0, 0]);
        messages.push(Written(k * SECOND / 10, "/labels", IMAGE, labels));
    }
    refused(&messages, &["several labels (5, 7)", "object = LABEL"]);
    let folder = Folder::new();
    let path = folder.with("bag.mcap", &mcap(&messages, "cdr"));
    let topics = RgbdTopics { object: Some(5), ..Default::default() };
    let mut bag = RgbdBag::open_with(&path, &topics).unwrap();
    let mask = bag.frame(1).unwrap().mask.unwrap();
    assert_eq!(mask.iter().filter(|inside| **inside).count(), 2);
    assert!(bag.frame(2).unwrap_err().to_string().contains("there is no frame 2; there are 2"));
}

#[test]
fn a_compressed_file_that_was_cut_off_is_refused() {
    let whole = fs::read(data("mcap_file/mcap_file.mcap.zstd")).unwrap();
    let folder = Folder::new();
    let error = open(&folder.with("bag.mcap.zstd", &whole[..whole.len() / 2]));
    assert!(error.contains("`zstd -d` decompresses it by hand") && !error.contains('\n'), "{error}");
}

#[test]
fn an_image_belongs_to_one_frame() {
    // Twice as many depth images as colours, and a slop beyond their period.
    let mut messages = several(4);
    messages
        .extend((1..=4).map(|k| Written(k * SECOND / 10, "/depth/image", IMAGE, depth(k * SECOND / 10 + SECOND / 20))));
    messages.sort_by_key(|message| message.0);
    let folder = Folder::new();
    let path = folder.with("bag.mcap", &mcap(&messages, "cdr"));
    let topics = RgbdTopics { slop_s: Some(1.0), ..Default::default() };
    let bag = RgbdBag::open_with(&path, &topics).unwrap();
    assert_eq!(bag.len(), 4, "{:?}", bag.notes());
}

#[test]
fn colours_and_masks_take_the_size_of_depth() {
    let mut messages = several(2);
    let mut pixels = vec![10; 8 * 6 * 3];
    pixels[..8 * 3 * 3].fill(200);
    let mask: Vec<u8> = (0..48).map(|k| if k % 8 < 4 { 255 } else { 0 }).collect();
    for k in 1..=2 {
        let stamp = k * SECOND / 10;
        messages.iter_mut().filter(|message| message.0 == stamp && message.1 == "/rgb/image").for_each(|message| {
            message.3 = image(stamp, "rgb8", [8, 6], 24, &pixels);
        });
        messages.push(Written(stamp, "/mask", IMAGE, image(stamp, "mono8", [8, 6], 8, &mask)));
    }
    let (mut bag, _folder) = rgbd(&messages).unwrap();
    let frame = bag.frame(1).unwrap();
    assert_eq!(frame.color.dimensions(), (4, 3));
    assert_eq!((frame.color.get_pixel(0, 0)[0], frame.color.get_pixel(3, 2)[0]), (200, 10));
    let mask = frame.mask.unwrap();
    assert!(mask.indexed_iter().all(|((_, u), inside)| *inside == (u < 2)), "{mask}");
}

#[test]
fn depth_that_is_seen_from_elsewhere_is_noted() {
    let mut messages = several(1);
    for message in messages.iter_mut().filter(|message| message.1 == "/rgb/image") {
        let head = Cdr::header(SECOND / 10, "color_optical").u32(3).u32(4).text("rgb8");
        message.3 = head.u8(0).u32(12).bytes(&[90; 36]).done();
    }
    let words = ["colours are seen from color_optical and depth from optical", "record depth aligned to the colours"];
    noted(&messages, 1, &words);
}

#[test]
fn ten_thousand_frames_are_read_in_their_order() {
    let messages: Vec<_> = (1..=10_000).flat_map(|k| frame(k * SECOND / 10, k * SECOND / 10)).collect();
    let bag = noted(&messages, 10_000, &[]);
    assert_eq!(bag.len(), 10_000);
}
