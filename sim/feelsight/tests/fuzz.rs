//! Damaged logs. Whatever the damage to a file of a valid log, reading it soon returns a log or an error, and never
//! panics.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use std::fs;
use std::path::{Path, PathBuf};

use mvt_feelsight::pickle;
use mvt_feelsight::{Log, inspect};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Flips bits, cuts, repeats and inserts, once to four times.
fn mutate(bytes: &[u8], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..rng.random_range(1..=4) {
        if bytes.is_empty() {
            break;
        }
        let at = rng.random_range(0..bytes.len());
        match rng.random_range(0..7) {
            0 => bytes[at] ^= 1 << rng.random_range(0..8),
            1 => bytes[at] = rng.next_u32() as u8,
            2 => bytes[at] = [0, 0xff, 0x7f, 0x80][rng.random_range(0..4)],
            3 => bytes.truncate(at),
            4 => {
                let end = (at + rng.random_range(1..20)).min(bytes.len());
                bytes.drain(at..end);
            }
            5 => {
                let noise: Vec<u8> = (0..rng.random_range(1..9)).map(|_| rng.next_u32() as u8).collect();
                bytes.splice(at..at, noise);
            }
            _ => {
                let end = (at + rng.random_range(1..40)).min(bytes.len());
                let copy = bytes[at..end].to_vec();
                bytes.splice(at..at, copy);
            }
        }
    }
    bytes
}

struct Case {
    _folder: tempfile::TempDir,
    place: PathBuf,
    rng: ChaCha8Rng,
}

impl Case {
    fn new(seed: u64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("00");
        common::write(&place, 2, &[common::camera("front-left", 16, 12)]);
        Self { _folder: folder, place, rng: ChaCha8Rng::seed_from_u64(seed) }
    }

    /// Mutates one file many times. Returns how many damages were noticed.
    fn run(&mut self, path: &str, cases: usize, read: impl Fn(&Path) -> bool) -> usize {
        let path = self.place.join(path);
        let good = fs::read(&path).unwrap();
        let noticed = (0..cases).filter(|_| {
            fs::write(&path, mutate(&good, &mut self.rng)).unwrap();
            !read(&self.place)
        });
        let noticed = noticed.count();
        fs::write(&path, good).unwrap();
        noticed
    }
}

#[test]
fn pickles() {
    let mut case = Case::new(1);
    let good = fs::read(case.place.join("data.pkl")).unwrap();
    for _ in 0..40_000 {
        let _ = pickle::from_bytes(&mutate(&good, &mut case.rng));
    }
    let samples = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    for protocol in 0..6 {
        let good = fs::read(samples.join(format!("numpy2-{protocol}.pkl"))).unwrap();
        for _ in 0..8_000 {
            let _ = pickle::from_bytes(&mutate(&good, &mut case.rng));
        }
    }
    assert!(case.run("data.pkl", 1000, |place| Log::open(place).is_ok()) > 250);
}

#[test]
fn depths() {
    let mut case = Case::new(2);
    let read = |place: &Path| Log::open(place).is_ok_and(|log| log.frames().is_ok_and(|mut f| f.all(|f| f.is_ok())));
    let noticed = case.run("realsense/front-left/depth.npz", 3000, read);
    // Dates and flags in the archive are ignored; everything else has a checksum.
    assert!(noticed > 1000, "{noticed}");
}

#[test]
fn scenes() {
    let mut case = Case::new(3);
    assert!(case.run("scene.json", 1500, |place| Log::open(place).is_ok()) > 250);
}

#[test]
fn images() {
    let mut case = Case::new(4);
    let read = |place: &Path| inspect(place).is_ok();
    for path in ["allegro/index/image/0.jpg", "allegro/index/depth/1.jpg", "realsense/front-left/seg/0.jpg"] {
        case.run(path, 50, read);
    }
}
