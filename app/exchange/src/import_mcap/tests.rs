//! Recordings of other programs, each with an oddity.

use std::fs;
use std::path::PathBuf;

use mvt_feelsight::{Log, TouchPart};
use mvt_frames::{Camera, World};
use mvt_robot::hand::Side;

use super::*;
use crate::foxglove::{
    CAMERA_CALIBRATION, COMPRESSED_IMAGE, FRAME_TRANSFORMS, JOINT_STATES, RAW_IMAGE, compressed, timestamp,
};
use crate::protobuf::Message;
use crate::schema::MessageType;
use crate::writer::{Mcap, MessageSink as _};

const START_NS: u64 = 1_700_000_000_000_000_000;
const STEP_NS: u64 = 33_333_333;
const FRAMES: usize = 20;
const MAPPING: &str = "[hand]\njoints = \"/joints\"\nbase = \"palm\"\n[[camera]]\nname = \"front\"\ndepth = \"/depth\"\n\
                       calibration = \"/info\"\n";

/// A message: topic, schema, time of recording, contents.
type Sent = (&'static str, &'static MessageType, u64, Message);

fn at(k: usize) -> u64 {
    START_NS + k as u64 * STEP_NS
}

fn names() -> Vec<String> {
    Hand::allegro(Side::Left).joints().iter().map(|joint| joint.name.clone()).collect()
}

/// Joint J of message K is 0.3 + J / 100 + K / 1000.
fn angle(joint: usize, k: usize) -> f64 {
    0.3 + 0.01 * joint as f64 + 0.001 * k as f64
}

fn joints(stamp_ns: u64, joints: &[(String, Option<f64>)]) -> Message {
    joints.iter().fold(Message::default().message(1, &timestamp(stamp_ns)), |list, (name, position)| {
        let joint = Message::default().text(1, name);
        list.message(2, &position.iter().fold(joint, |joint, position| joint.double(2, *position)))
    })
}

fn hand(k: usize) -> Vec<(String, Option<f64>)> {
    names().into_iter().enumerate().map(|(joint, name)| (name, Some(angle(joint, k)))).collect()
}

/// Depth 400 + K millimetres.
fn raw(stamp_ns: u64, [width, height, step]: [u64; 3], encoding: &str, data: &[u8]) -> Message {
    let image = Message::default().message(1, &timestamp(stamp_ns)).varint(2, width).varint(3, height);
    image.text(4, encoding).varint(5, step).bytes(6, data)
}

fn millimetres(k: usize) -> Vec<u8> {
    (0..64 * 48).flat_map(|_| (400 + k as u16).to_le_bytes()).collect()
}

fn info(model: &str, distortion: &[f64], [width, height]: [u64; 2], focal: f64) -> Message {
    let k = [focal, 0.0, 32.0, 0.0, focal, 24.0, 0.0, 0.0, 1.0];
    let message = Message::default().message(1, &timestamp(at(0))).text(9, "front").varint(2, width).varint(3, height);
    message.text(4, model).doubles(5, distortion).doubles(6, &k)
}

fn transform(parent: &str, child: &str, [x, y, z]: [f64; 3], w: f64) -> Message {
    let vector = Message::default().double(1, x).double(2, y).double(3, z);
    let pose = Message::default().message(1, &timestamp(at(0))).text(2, parent).text(3, child).message(4, &vector);
    Message::default().message(1, &pose.message(5, &Message::default().double(4, w)))
}

/// Returns a recording without oddities.
fn recording() -> Vec<Sent> {
    let mut sent: Vec<Sent> = vec![
        ("/info", &CAMERA_CALIBRATION, at(0), info("plumb_bob", &[0.0; 5], [64, 48], 60.0)),
        ("/tf", &FRAME_TRANSFORMS, at(0), transform("palm", "front", [0.3, 0.0, 0.2], 1.0)),
    ];
    for k in 0..FRAMES {
        sent.push(("/joints", &JOINT_STATES, at(k), joints(at(k), &hand(k))));
        sent.push(("/depth", &RAW_IMAGE, at(k), raw(at(k), [64, 48, 128], "16UC1", &millimetres(k))));
    }
    sent
}

/// Returns the place of message K of a topic.
fn find(sent: &[Sent], topic: &str, k: usize) -> usize {
    sent.iter().enumerate().filter(|(_, message)| message.0 == topic).nth(k).unwrap().0
}

fn replace(sent: &mut [Sent], topic: &str, k: usize, message: Message) {
    let place = find(sent, topic, k);
    sent[place].3 = message;
}

struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn import(&self, sent: &[Sent], mapping: &str) -> Result<Imported, ExchangeError> {
        let mut bytes = Vec::new();
        let mut file = Mcap::new(&mut bytes, "test").unwrap();
        let mut channels: Vec<(&str, &str, crate::writer::Channel)> = Vec::new();
        for (topic, schema, time_ns, message) in sent {
            let channel = match channels.iter().find(|(known, name, _)| known == topic && *name == schema.name) {
                Some((_, _, channel)) => *channel,
                None => {
                    let channel = file.channel(topic, schema).unwrap();
                    channels.push((topic, schema.name, channel));
                    channel
                }
            };
            file.push(channel, *time_ns, &message.clone().into_bytes()).unwrap();
        }
        file.finish().unwrap();
        fs::write(self.path("a.mcap"), bytes).unwrap();
        fs::write(self.path("mapping.toml"), mapping).unwrap();
        let _ = fs::remove_dir_all(self.path("log"));
        import_mcap(&self.path("a.mcap"), Some(&self.path("mapping.toml")), &self.path("log"), |_, _| ())
    }

    /// Imports a recording that must give all frames with the right joints and depth. Returns the notes.
    fn good(&self, sent: &[Sent]) -> Vec<String> {
        let imported = self.import(sent, MAPPING).unwrap();
        assert_eq!(imported.frames, FRAMES, "{imported:?}");
        let log = Log::open_tolerant(&self.path("log")).unwrap();
        for (k, row) in log.joints().iter().enumerate() {
            let close = |(joint, found): (usize, &f64)| (found - angle(joint, k)).abs() < 1e-9;
            assert!(row.iter().enumerate().all(close), "frame {k}: {row:?}");
            assert!((log.times_s()[k] - k as f64 * STEP_NS as f64 / 1e9).abs() < 1e-6, "{:?}", log.times_s());
        }
        let depths =
            log.into_partial_frames(&[0], TouchPart::None).map(|frame| frame.cameras[0].as_ref().unwrap()[[20, 20]]);
        let depths: Vec<f32> = depths.collect();
        let expected: Vec<f32> = (0..FRAMES).map(|k| (400 + k) as f32 * 0.001).collect();
        assert!(depths.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-6), "{depths:?}");
        imported.notes
    }

    fn refused(&self, sent: &[Sent]) -> String {
        let error = self.import(sent, MAPPING).unwrap_err().to_string();
        assert!(!error.contains('\n') && !self.path("log").exists(), "{error}");
        error
    }
}

fn has(notes: &[String], said: &str) {
    assert!(notes.iter().any(|note| note.contains(said)), "{said}: {notes:?}");
}

#[test]
fn a_plain_recording_has_no_notes_on_its_messages() {
    let notes = Place::new().good(&recording());
    assert!(notes.iter().all(|note| !note.contains("skipped") && !note.contains("check")), "{notes:?}");
}

#[test]
fn odd_joint_messages_are_skipped_and_counted() {
    let place = Place::new();
    let arm = |k| joints(at(k), &[("arm_0".to_owned(), Some(0.1)), ("arm_1".to_owned(), Some(9.0))]);
    let mut both = recording();
    for k in 0..FRAMES {
        both.insert(find(&both, "/depth", k), ("/joints", &JOINT_STATES, at(k), arm(k)));
    }
    has(
        &place.good(&both),
        "/joints: skipped 20 times, first at message 1: it has none of the hand's joints: arm_0, arm_1",
    );
    let mut one = recording();
    for k in 0..FRAMES {
        let mut all = vec![("arm_0".to_owned(), Some(9.0))];
        all.extend(hand(k));
        replace(&mut one, "/joints", k, joints(at(k), &all));
    }
    place.good(&one);
    for (odd, said) in [
        (vec![], "it has no joints"),
        (hand(7).into_iter().map(|(name, _)| (name, Some(f64::NAN))).collect(), "\"index_0\" is not finite"),
        (hand(7).into_iter().map(|(name, _)| (name, None)).collect(), "\"index_0\" has no position"),
        (hand(7).into_iter().map(|(name, _)| (name, Some(1e9))).collect(), "\"index_0\" is beyond 3.14 rad"),
    ] {
        let mut sent = recording();
        replace(&mut sent, "/joints", 7, joints(at(7), &odd));
        let notes = place.good(&sent);
        assert!(
            notes.iter().any(|note| note.starts_with("/joints: skipped once at message 7: ") && note.contains(said)),
            "{said}: {notes:?}"
        );
    }
    let mut garbage = recording();
    replace(&mut garbage, "/joints", 7, Message::default().bytes(2, &[0xff; 3]));
    has(&place.good(&garbage), "it does not follow the schema");
    let mut twice: Vec<Sent> = recording();
    for (k, message) in twice.iter_mut().filter(|message| message.0 == "/joints").enumerate() {
        message.0 = if k % 2 == 0 { "/joints" } else { "joints" };
    }
    place.good(&twice);
}

#[test]
fn fingers_in_several_messages_are_merged() {
    let place = Place::new();
    for delay_ns in [0, 1_000_000] {
        let mut sent = recording();
        for k in (0..FRAMES).rev() {
            replace(&mut sent, "/joints", k, joints(at(k), &hand(k)[..6]));
            let rest = (at(k) + delay_ns, joints(at(k) + delay_ns, &hand(k)[6..]));
            sent.insert(find(&sent, "/depth", k), ("/joints", &JOINT_STATES, rest.0, rest.1));
        }
        if delay_ns == 0 {
            let notes = place.good(&sent);
            assert!(notes.iter().all(|note| !note.contains("/joints:")), "{notes:?}");
        } else {
            let imported = place.import(&sent, MAPPING).unwrap();
            assert_eq!(imported.frames, FRAMES);
            let log = Log::open_tolerant(&place.path("log")).unwrap();
            assert!((log.joints()[9][15] - angle(15, 9)).abs() < 1e-3 && log.joints()[9][0] == angle(0, 9));
        }
    }
    let mut missing = recording();
    (0..FRAMES).for_each(|k| replace(&mut missing, "/joints", k, joints(at(k), &hand(k)[..15])));
    assert!(place.refused(&missing).contains("no message has a valid position of joint \"thumb_3\""));
}

#[test]
fn degrees_are_refused() {
    let mut sent = recording();
    for k in 0..FRAMES {
        let degrees: Vec<_> = hand(k).into_iter().map(|(name, angle)| (name, angle.map(f64::to_degrees))).collect();
        replace(&mut sent, "/joints", k, joints(at(k), &degrees));
    }
    assert!(Place::new().refused(&sent).contains("give radians, not degrees"));
}

#[test]
fn transforms_are_composed_through_the_tree() {
    let place = Place::new();
    let mut sent = recording();
    let nan = transform("front", "imu", [f64::NAN, 0.0, 0.0], 1.0);
    for odd in [nan, transform("front", "imu", [0.0; 3], 0.0), transform("/x", "/y", [0.0; 3], 1.0)] {
        sent.push(("/tf", &FRAME_TRANSFORMS, at(1), odd));
    }
    let notes = place.good(&sent);
    has(&notes, "/tf: skipped once at message 1: the transform front -> imu has numbers that are not finite");
    has(&notes, "/tf: skipped once at message 2: the transform front -> imu has a rotation of length 0.000");
    let straight = Log::open_tolerant(&place.path("log")).unwrap().cameras()[0].pose;
    // Palm and camera are both below the world, and names have slashes.
    let mut sent = recording();
    replace(&mut sent, "/tf", 0, transform("/world", "/palm", [1.0, 0.0, 0.0], 1.0));
    sent.push(("/tf", &FRAME_TRANSFORMS, at(0), transform("/world", "/tripod", [1.1, 0.0, 0.2], 1.0)));
    sent.push(("/tf", &FRAME_TRANSFORMS, at(0), transform("tripod", "/front", [0.2, 0.0, 0.0], 1.0)));
    place.good(&sent);
    let beside = Log::open_tolerant(&place.path("log")).unwrap().cameras()[0].pose;
    let apart: Isometry<Camera, World> = beside;
    assert!((apart.origin().coords() - straight.origin().coords()).norm() < 1e-12);
    let mut sent = recording();
    replace(&mut sent, "/tf", 0, transform("palm", "front", [0.3, 0.0, 0.2], 0.0));
    let said = place.refused(&sent);
    assert!(said.contains("camera front: no transforms lead from \"front\" to \"palm\": the transform palm -> front has a rotation of length 0"), "{said}");
}

#[test]
fn messages_are_sorted_by_their_times() {
    let place = Place::new();
    let mut stamps = recording();
    let (a, b) = (find(&stamps, "/depth", 5), find(&stamps, "/depth", 6));
    let first = stamps[a].3.clone();
    stamps[a].3 = stamps[b].3.clone();
    stamps[b].3 = first;
    has(&place.good(&stamps), "/depth: 1 of 20 messages are not in the order of time");
    let mut reversed = recording();
    reversed[2..].reverse();
    has(&place.good(&reversed), "/joints: 19 of 20 messages are not in the order of time");
    let mut apart = recording();
    apart.sort_by_key(|message| message.0);
    place.good(&apart);
    for times in [|_: u64| 0, |ns: u64| ns / 1_000_000] {
        let mut sent = recording();
        sent.iter_mut().for_each(|message| message.2 = times(message.2));
        place.good(&sent);
    }
}

#[test]
fn times_that_are_no_clock_are_replaced() {
    let place = Place::new();
    let restamp = |stamp: &dyn Fn(u64) -> u64| -> Vec<Sent> {
        let mut sent = recording();
        for k in 0..FRAMES {
            replace(&mut sent, "/joints", k, joints(stamp(at(k)), &hand(k)));
            let depth = raw(stamp(at(k)), [64, 48, 128], "16UC1", &millimetres(k));
            replace(&mut sent, "/depth", k, depth);
        }
        sent
    };
    for (stamp, said) in [
        ((|_| 0) as fn(u64) -> u64, "/depth: its 20 messages state no time: the times of recording are used"),
        (|ns| ns / 1_000_000_000 * 1_000_000_000, "/depth: its 20 messages state only 1 different times"),
        (|ns| ns / 100_000_000 * 100_000_000, "/depth: its 20 messages state only 7 different times"),
        (|ns| ns / 1000, "/depth: its own times are in another unit"),
        (|ns| if ns < START_NS + 300_000_000 { ns } else { ns - 200_000_000 }, "/depth: its clock jumps by 0.20 s"),
    ] {
        has(&place.good(&restamp(&stamp)), said);
    }
    let mut same = restamp(&|_| START_NS);
    same.iter_mut().for_each(|message| message.2 = START_NS);
    assert!(place.refused(&same).contains("/depth: its 20 messages have one and the same time"));
    let mut twice = recording();
    replace(&mut twice, "/depth", 6, raw(at(5), [64, 48, 128], "16UC1", &millimetres(5)));
    let imported = place.import(&twice, MAPPING).unwrap();
    assert_eq!(imported.frames, 19);
    has(&imported.notes, "1 of 20 images of /depth are left out: they repeat the time of another one");
}

#[test]
fn lens_models_that_a_log_knows_are_accepted() {
    let place = Place::new();
    let with = |model: &str, distortion: &[f64]| {
        let mut sent = recording();
        replace(&mut sent, "/info", 0, info(model, distortion, [64, 48], 60.0));
        sent
    };
    let distorts = |notes: &[String]| notes.iter().any(|note| note.contains("the lens of camera front distorts"));
    for (model, distortion, is_distorted) in [
        ("plumb_bob", vec![0.1, 0.01, 0.0, 0.0], true),
        ("plumb_bob", vec![0.1, 0.01, 0.0, 0.0, 0.001, 0.0, 0.0, 0.0], true),
        ("rational_polynomial", vec![0.1, 0.01, 0.0, 0.0, 0.001, 0.0, 0.0, 0.0], true),
        ("rational_polynomial", vec![0.0; 8], false),
        ("", vec![], false),
        ("equidistant", vec![0.0; 4], false),
    ] {
        let imported = place.import(&with(model, &distortion), MAPPING).unwrap();
        assert_eq!(distorts(&imported.notes), is_distorted, "{model} {distortion:?}");
        let is_assumed = imported.notes.iter().any(|note| note.contains("read as a pinhole"));
        assert_eq!(is_assumed, model == "equidistant");
    }
    for (model, distortion, said) in [
        (
            "rational_polynomial",
            vec![0.1, 0.01, 0.0, 0.0, 0.001, 0.1, 0.0, 0.0],
            "has 8 numbers, of which a log keeps 5",
        ),
        ("plumb_bob", vec![0.1, 0.01], "has 2 numbers; give 4, 5 or 8"),
        ("equidistant", vec![0.1, 0.0, 0.0, 0.0], "the lens model \"equidistant\" is unknown"),
        ("plumb_bob", vec![f64::NAN; 5], "not finite"),
    ] {
        let error = place.refused(&with(model, &distortion));
        assert!(error.contains(said) && error.contains("camera front has no calibration"), "{error}");
    }
    let mut zero = recording();
    replace(&mut zero, "/info", 0, info("plumb_bob", &[0.0; 5], [64, 48], 0.0));
    assert!(place.refused(&zero).contains("the matrix K of the calibration is zero"));
    zero.push(("/info", &CAMERA_CALIBRATION, at(3), info("plumb_bob", &[0.0; 5], [64, 48], 60.0)));
    has(&place.good(&zero), "/info: skipped once at message 0: the matrix K");
}

#[test]
fn depth_of_another_size_or_unit_is_refused_and_a_broken_image_skipped() {
    let place = Place::new();
    let all = |size: [u64; 3], encoding: &str, data: &[u8]| {
        let mut sent = recording();
        (0..FRAMES).for_each(|k| replace(&mut sent, "/depth", k, raw(at(k), size, encoding, data)));
        sent
    };
    let floats: Vec<u8> = (0..64 * 48).flat_map(|_| 543.1_f32.to_le_bytes()).collect();
    for (sent, said) in [
        (
            all([48, 64, 96], "16UC1", &millimetres(0)),
            "48 x 64 pixels and its camera 64 x 48; the two are turned by 90",
        ),
        (all([32, 24, 64], "16UC1", &millimetres(0)), "32 x 24 pixels and its camera 64 x 48; name the calibration"),
        (all([64, 48, 256], "32FC1", &floats), "the depth of camera front is 543.1 m in the median"),
    ] {
        let error = place.refused(&sent);
        assert!(error.contains(said), "{error}");
    }
    place.good(&{
        let mut sent = recording();
        (0..FRAMES).for_each(|k| replace(&mut sent, "/depth", k, raw(at(k), [64, 48, 0], "Z16", &millimetres(k))));
        sent
    });
    let mut short = recording();
    replace(&mut short, "/depth", 4, raw(at(4), [64, 48, 128], "16UC1", &millimetres(4)[..600]));
    replace(&mut short, "/depth", 9, raw(at(9), [64, 48, 128], "16UC1", &[]));
    let imported = place.import(&short, MAPPING).unwrap();
    assert_eq!(imported.frames, FRAMES - 1, "an empty image is no frame");
    has(&imported.notes, "/depth: skipped once at frame 4: the data are shorter than");
    has(&imported.notes, "/depth: skipped once at message 9: the image is empty");
    let log = Log::open_tolerant(&place.path("log")).unwrap();
    let depths =
        log.into_partial_frames(&[0], TouchPart::None).map(|frame| frame.cameras[0].as_ref().unwrap()[[20, 20]]);
    assert_eq!(depths.skip(3).take(3).map(f32::abs).collect::<Vec<_>>(), [0.403, 0.0, 0.405]);
}

#[test]
fn a_cut_and_a_grey_touch_image_are_skipped() {
    use mvt_images::image::{DynamicImage, ImageFormat, RgbImage};
    let encoded = |image: DynamicImage, format| {
        let mut file = std::io::Cursor::new(Vec::new());
        image.write_to(&mut file, format).unwrap();
        file.into_inner()
    };
    let colours = DynamicImage::from(RgbImage::from_fn(240, 320, |x, y| [x as u8, y as u8, (x * y) as u8].into()));
    let jpeg = encoded(colours.clone(), ImageFormat::Jpeg);
    let grey = encoded(DynamicImage::from(colours.into_luma8()), ImageFormat::Jpeg);
    let mapping = format!("{MAPPING}[touch.ring]\nimage = \"/digit\"\n");
    let with = |file: &dyn Fn(usize) -> Vec<u8>| {
        let mut sent = recording();
        (0..FRAMES).for_each(|k| {
            let message = compressed(&timestamp(at(k)), "digit", &file(k));
            sent.push(("/digit", &COMPRESSED_IMAGE, at(k), message));
        });
        sent
    };
    let place = Place::new();
    let odd = with(&|k| match k {
        3 => jpeg[..jpeg.len() / 2].to_vec(),
        5 => grey.clone(),
        _ => jpeg.clone(),
    });
    let imported = place.import(&odd, &mapping).unwrap();
    assert_eq!(imported.frames, FRAMES);
    has(&imported.notes, "/digit: skipped once at frame 3: the JPEG file is cut or damaged");
    has(&imported.notes, "/digit: skipped once at frame 5: it is a grey image");
    let file = |k: usize| place.path("log").join(format!("allegro/ring/image/{k}.jpg"));
    assert!(!file(3).exists() && !file(5).exists());
    assert_eq!(fs::read(file(4)).unwrap(), jpeg);
    let error = place.import(&with(&|_| grey.clone()), &mapping).unwrap_err().to_string();
    assert!(error.contains("/digit: none of its 20 images can be used; first frame 0: it is a grey image"), "{error}");
    let twice = format!("{mapping}[touch.thumb]\nimage = \"digit\"\n");
    let error = place.import(&odd, &twice).unwrap_err().to_string();
    assert!(error.contains("the mapping names digit twice"), "{error}");
}
