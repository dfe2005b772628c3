//! Mutated and cut bags: no reader panics, hangs, or allocates far more than the file.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a failed assumption in a test is a failed test")]

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use common::data;
use mvt_bag::{
    Bag, RgbdBag, RgbdTopics, RosCameraInfo, RosCompressedImage, RosHeader, RosImage, RosJointState, RosPose,
    RosTransform,
};
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};

static NOW: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);
/// One test counts at a time.
static ALONE: Mutex<()> = Mutex::new(());

/// Allocator of the system, with counts.
struct Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

// SAFETY: all calls go to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let now = NOW.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        PEAK.fetch_max(now, Ordering::Relaxed);
        // SAFETY: as promised by the caller.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        NOW.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: as promised by the caller.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// Bytes that a reader may take besides the file: a window of Zstandard, buffers, and the images of a frame.
const BESIDES: usize = 24 << 20;

/// Change of a file: bytes that are replaced, and the share that is kept.
type Change = (Vec<(prop::sample::Index, u8)>, Option<prop::sample::Index>);

fn changes() -> impl Strategy<Value = Change> {
    let byte = (any::<prop::sample::Index>(), prop_oneof![any::<u8>(), Just(0), Just(0xff), Just(0x7f)]);
    (prop::collection::vec(byte, 1..8), prop::option::weighted(0.3, any::<prop::sample::Index>()))
}

fn changed(bytes: &[u8], (bytes_of, end): &Change) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for (at, byte) in bytes_of {
        let at = at.index(bytes.len());
        bytes[at] = *byte;
    }
    if let Some(end) = end {
        bytes.truncate(end.index(bytes.len()));
    }
    bytes
}

/// Decodes a message as each type.
fn decode(message: &[u8]) {
    let _ = RosHeader::decode(message);
    if let Ok(image) = RosImage::decode(message) {
        let _ = (image.colours(), image.depth_m(0.001), image.labels());
    }
    if let Ok(image) = RosCompressedImage::decode(message) {
        let _ = (image.colours(), image.depth_m(0.001), image.labels());
    }
    let _ = (RosCameraInfo::decode(message), RosJointState::decode(message));
    let _ = (RosTransform::decode(message), RosPose::decode(message));
}

/// Reads all of a bag. Returns whether it could be opened.
fn read(path: &Path) -> bool {
    let topics = RgbdTopics { object_pose: Some("/object/pose".to_owned()), ..Default::default() };
    if let Ok(mut bag) = RgbdBag::open_with(path, &topics) {
        bag.frames().take(100).for_each(drop);
    }
    let Ok(mut bag) = Bag::open(path) else { return false };
    let names: Vec<String> = bag.topics().iter().map(|topic| topic.name.clone()).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    for message in bag.messages(&names).unwrap().map_while(Result::ok).take(1000) {
        decode(&message.data);
    }
    assert!(bag.notes().iter().all(|note| !note.contains('\n')), "{:?}", bag.notes());
    true
}

/// Number of mutated files of each storage.
fn cases() -> u32 {
    std::env::var("MUTATIONS").ok().map_or(150, |count| count.parse().unwrap())
}

#[test]
fn no_mutated_bag_is_a_danger() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    for name in [
        "mcap/mcap.mcap",
        "lz4.mcap",
        "unchunked.mcap",
        "unsorted.mcap",
        "mcap_message/mcap_message.mcap",
        "mcap_file/mcap_file.mcap.zstd",
        "fastcdr.mcap",
        "db3/db3.db3",
        "db3_message/db3_message.db3",
        "db3_file/db3_file.db3.zstd",
        "encodings/encodings.db3",
    ] {
        let whole = fs::read(data(name)).unwrap();
        let path = folder.path().join(Path::new(name).file_name().unwrap());
        let mut opened = 0;
        let mut runner = TestRunner::new(Config { cases: cases(), failure_persistence: None, ..Config::default() });
        let result = runner.run(&changes(), |change| {
            fs::write(&path, changed(&whole, &change)).unwrap();
            let before = NOW.load(Ordering::Relaxed);
            PEAK.store(before, Ordering::Relaxed);
            let _ = read(&path);
            let peak = PEAK.load(Ordering::Relaxed) - before;
            prop_assert!(peak < BESIDES + 3 * whole.len(), "{peak} bytes for a file of {}", whole.len());
            Ok(())
        });
        result.unwrap_or_else(|error| panic!("{name}: {error}"));
        for at in (0..whole.len()).step_by(whole.len() / 20 + 1) {
            fs::write(&path, &whole[..at]).unwrap();
            opened += u32::from(read(&path));
        }
        println!("{name}: {opened} of 20 cut files can be opened");
    }
}

#[test]
fn no_mutated_message_is_a_danger() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let mut originals = Vec::new();
    for name in ["fastcdr.mcap", "mcap", "encodings"] {
        let mut bag = Bag::open(&data(name)).unwrap();
        let names: Vec<String> = bag.topics().iter().map(|topic| topic.name.clone()).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        originals.extend(bag.messages(&names).unwrap().map(|message| message.unwrap().data));
    }
    let mut runner = TestRunner::new(Config { cases: 20 * cases(), failure_persistence: None, ..Config::default() });
    let strategy = (any::<prop::sample::Index>(), changes());
    let result = runner.run(&strategy, |(which, change)| {
        let message = changed(&originals[which.index(originals.len())], &change);
        let before = NOW.load(Ordering::Relaxed);
        PEAK.store(before, Ordering::Relaxed);
        decode(&message);
        let peak = PEAK.load(Ordering::Relaxed) - before;
        prop_assert!(peak < BESIDES, "{peak} bytes for a message of {}", message.len());
        Ok(())
    });
    result.unwrap();
}
