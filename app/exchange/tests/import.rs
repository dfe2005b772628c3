//! Logs to MCAP and back, and files that are no recordings.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a failed assumption in a test is a failed test")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::common::{FRAMES, write_log};
use mvt_exchange::{ExchangeError, Imported, export_mcap, import_mcap};
use mvt_feelsight::{Log, LogFormat, convert};

struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    /// A folder with a log and its export.
    fn new() -> Self {
        let place = Self { folder: tempfile::tempdir().unwrap() };
        write_log(&place.path("log"));
        place.export("log", "log.mcap");
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn export(&self, log: &str, file: &str) {
        export_mcap(&Log::open(&self.path(log)).unwrap(), &self.path(file), false, || ()).unwrap();
    }

    fn import(&self, file: &str, log: &str) -> Result<Imported, ExchangeError> {
        import_mcap(&self.path(file), None, &self.path(log), |_, _| ())
    }

    /// Returns the message that importing these bytes ends with.
    fn refused(&self, bytes: &[u8]) -> String {
        fs::write(self.path("wrong.mcap"), bytes).unwrap();
        let error = self.import("wrong.mcap", "wrong").unwrap_err().to_string();
        let left: Vec<_> = fs::read_dir(self.folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert!(left.iter().all(|name| !name.to_string_lossy().contains("wrong") || name == "wrong.mcap"), "{left:?}");
        assert!(error.contains("wrong.mcap: ") && !error.contains('\n'), "{error}");
        error
    }
}

/// Files of a log without its preview.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    fn collect(root: &Path, folder: &Path, into: &mut BTreeMap<PathBuf, Vec<u8>>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                collect(root, &path, into);
            } else if !path.extension().is_some_and(|end| end == "gif" || end == "mp4") {
                into.insert(path.strip_prefix(root).unwrap().to_path_buf(), fs::read(&path).unwrap());
            }
        }
    }
    let mut all = BTreeMap::new();
    collect(folder, folder, &mut all);
    all
}

#[test]
fn an_import_of_an_export_is_the_log_again() {
    let place = Place::new();
    let imported = place.import("log.mcap", "again").unwrap();
    assert_eq!(imported.frames, FRAMES);
    assert!(imported.channels.iter().all(|channel| channel.offset_ms == 0.0), "{imported:?}");
    assert!(imported.channels.iter().all(|channel| channel.frames.is_none_or(|frames| frames == FRAMES)));
    let (before, after) = (files(&place.path("log")), files(&place.path("again")));
    assert!(before.keys().eq(after.keys()), "{:?}", after.keys());
    for (path, bytes) in &before {
        assert!(after[path] == *bytes, "{}", path.display());
    }
    let refused = place.import("log.mcap", "again").unwrap_err().to_string();
    assert!(refused.contains("not empty"), "{refused}");
}

/// Without data.pkl, times are exact to a nanosecond and poses to the rounding of a rotation.
#[test]
fn channels_alone_give_nearly_the_same_log() {
    let place = Place::new();
    let mut bytes = fs::read(place.path("log.mcap")).unwrap();
    // The name stands in the attachment, whose checksum is then set to none, and in the index.
    let at = bytes.windows(8).position(|window| window == b"data.pkl").unwrap();
    bytes[at] = b'x';
    let length = usize::try_from(u64::from_le_bytes(bytes[at - 28..at - 20].try_into().unwrap())).unwrap();
    bytes[at - 20 + length - 4..at - 20 + length].fill(0);
    fs::write(place.path("other.mcap"), bytes).unwrap();
    place.import("other.mcap", "again").unwrap();
    let (log, again) = (Log::open(&place.path("log")).unwrap(), Log::open(&place.path("again")).unwrap());
    assert_eq!(again.joints(), log.joints());
    assert_eq!(again.object_name(), log.object_name());
    for (time, expected) in again.times_s().iter().zip(log.times_s()) {
        assert!((time - expected).abs() <= 0.5e-9, "{time} and not {expected}");
    }
    for (pose, expected) in again.object_poses().iter().zip(log.object_poses()) {
        let motion = pose.unwrap().untyped().inverse() * expected.unwrap().untyped();
        assert!(motion.translation.vector.norm() < 1e-12 && motion.rotation.angle() < 1e-7);
    }
    for (camera, expected) in again.cameras().iter().zip(log.cameras()) {
        assert_eq!((&camera.name, &camera.intrinsics), (&expected.name, &expected.intrinsics));
        let motion = camera.pose.untyped().inverse() * expected.pose.untyped();
        assert!(motion.translation.vector.norm() < 1e-12 && motion.rotation.angle() < 1e-7);
    }
}

#[test]
fn a_compact_log_is_exported_with_what_a_reader_of_it_sees() {
    let place = Place::new();
    convert(&place.path("log"), &place.path("compact"), LogFormat::Compact, |_| ()).unwrap();
    place.export("compact", "compact.mcap");
    place.import("compact.mcap", "again").unwrap();
    let (compact, again) = (Log::open(&place.path("compact")).unwrap(), Log::open(&place.path("again")).unwrap());
    for (frame, expected) in again.frames().unwrap().zip(compact.frames().unwrap()) {
        let (frame, expected) = (frame.unwrap(), expected.unwrap());
        assert!(frame.observation.touch == expected.observation.touch, "touch images");
        assert!(frame.observation.cameras == expected.observation.cameras, "colours and depths");
        let (truth, expected) = (frame.truth.unwrap(), expected.truth.unwrap());
        assert!(truth.labels == expected.labels && truth.touch == expected.touch, "labels");
    }
}

#[test]
fn damaged_files_are_refused_in_one_line() {
    let place = Place::new();
    let whole = fs::read(place.path("log.mcap")).unwrap();
    assert!(place.refused(b"").contains("not an MCAP file"));
    assert!(place.refused(b"\x89MCAP0\r\n").contains("cut off"));
    for cut in [9, whole.len() / 3, whole.len() / 2, whole.len() - 100, whole.len() - 1] {
        let said = place.refused(&whole[..cut]);
        assert!(said.contains("cut off") || said.contains("last bytes"), "{cut}: {said}");
    }
    let mut flipped = whole.clone();
    // In the middle is a chunk, whose checksum shows it.
    flipped[whole.len() / 2] ^= 4;
    place.refused(&flipped);
    let replaced = |from: &[u8], to: &[u8]| {
        let mut bytes = whole.clone();
        let at = bytes.windows(from.len()).position(|window| window == from).unwrap();
        bytes[at..at + to.len()].copy_from_slice(to);
        bytes
    };
    let said = place.refused(&replaced(b"foxglove.JointStates", b"foxglove.JointStateZ"));
    assert!(said.contains("/hand/joints has the schema \"foxglove.JointStateZ\""), "{said}");
    let said = place.refused(&replaced(b"/hand/joints", b"/head/joints"));
    assert!(said.contains("no message of /hand/joints"), "{said}");
}

/// A record of an MCAP file.
fn record(kind: u8, content: &[u8]) -> Vec<u8> {
    [&[kind], &(content.len() as u64).to_le_bytes()[..], content].concat()
}

#[test]
fn a_bomb_is_refused_before_it_is_unpacked() {
    let place = Place::new();
    let header = record(1, &[0; 8]);
    let chunk = |compression: &str, size: u64, packed: &[u8]| {
        let mut content = [&[0; 16][..], &size.to_le_bytes(), &[0; 4]].concat();
        content.extend((compression.len() as u32).to_le_bytes());
        content.extend(compression.as_bytes());
        content.extend((packed.len() as u64).to_le_bytes());
        content.extend(packed);
        [b"\x89MCAP0\r\n".to_vec(), header.clone(), record(6, &content)].concat()
    };
    // A frame of blocks, each of which repeats one byte 128 KiB times in four bytes: 1 GB in 32 KB.
    let mut bomb = vec![0x28, 0xb5, 0x2f, 0xfd, 0x00, 0x58];
    for _ in 0..8192 {
        bomb.extend([0x02, 0x00, 0x10, 0x07]);
    }
    let said = place.refused(&chunk("zstd", 1 << 30, &bomb));
    assert!(said.contains("more bytes than") || said.contains("larger than a file"), "{said}");
    // A window of 4 GB.
    let said = place.refused(&chunk("zstd", 9, &[0x28, 0xb5, 0x2f, 0xfd, 0x00, 0xb0, 0x02, 0x00, 0x10, 0x07]));
    assert!(said.contains("window"), "{said}");
    let huge = [&[5_u8][..], &u64::MAX.to_le_bytes(), &[0; 40]].concat();
    let said = place.refused(&chunk("", huge.len() as u64, &huge));
    assert!(said.contains("no channel"), "{said}");
}
