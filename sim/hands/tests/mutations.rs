//! Damaged hand files and URDFs: each gives a hand or a line about the fault, soon, and never a panic.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a failed assumption in a test is a failed test")]

use std::fs;
use std::panic::catch_unwind;
use std::time::{Duration, Instant};

use mvt_hands::HandFile;
use rand::seq::IndexedRandom as _;
use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// Number of damaged files of each kind.
const COUNT: u64 = 1000;
/// Longest time for one of them.
const LIMIT: Duration = Duration::from_secs(5);
/// Words that mean something to one reader or another.
const WORDS: [&str; 33] = [
    "0",
    "-1",
    "NaN",
    "inf",
    "-inf",
    "1e308",
    "1e-320",
    "1e999",
    "99999999999999999999",
    "",
    " ",
    "\"",
    "'",
    "<",
    ">",
    "/>",
    "</link>",
    "<link name=\"base\"/>",
    "<!--",
    "&amp;",
    "&x;",
    "[",
    "]",
    "[[pad]]\n",
    "=",
    "\0",
    "\u{fc}",
    "..",
    "/dev/zero",
    "package://",
    "base",
    "true",
    "fixed",
];

/// Returns a text with one to four changes.
fn mutated(original: &str, random: &mut impl Rng) -> Vec<u8> {
    let mut bytes = original.as_bytes().to_vec();
    // Half of them have one change, which readers accept more often.
    let changes = if random.random() { 1 } else { random.random_range(2..=4) };
    for _ in 0..changes {
        if bytes.is_empty() {
            break;
        }
        let at = random.random_range(0..bytes.len());
        let end = (at + random.random_range(1..60)).min(bytes.len());
        let word = WORDS.choose(random).unwrap().bytes();
        match random.random_range(0..8) {
            0 => bytes[at] ^= 1 << random.random_range(0..8),
            1 => bytes.truncate(at),
            2 => drop(bytes.drain(at..end)),
            3 => drop(bytes.splice(at..at, word)),
            4 => {
                let copy = bytes[at..end].to_vec();
                let to = random.random_range(0..bytes.len());
                bytes.splice(to..to, copy);
            }
            // A number or a name.
            _ => {
                let part = |b: &u8| b.is_ascii_alphanumeric() || b"._-+".contains(b);
                let start = bytes[at..].iter().position(part).map_or(at, |skip| at + skip);
                let end = bytes[start..].iter().position(|b| !part(b)).map_or(bytes.len(), |length| start + length);
                bytes.splice(start..end, word);
            }
        }
    }
    bytes
}

/// Reads damaged versions of a file of the claw. Returns how many still give a hand.
fn damage(name: &str, seed: u64) -> usize {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("meshes")).unwrap();
    for name in ["claw.toml", "claw.urdf", "meshes/wedge.stl", "meshes/block.obj"] {
        fs::copy(format!("tests/data/{name}"), folder.path().join(name)).unwrap();
    }
    let original = fs::read_to_string(folder.path().join(name)).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut hands = 0;
    for number in 0..COUNT {
        let bytes = mutated(&original, &mut random);
        fs::write(folder.path().join(name), &bytes).unwrap();
        let start = Instant::now();
        let path = folder.path().join("claw.toml");
        let text = || String::from_utf8_lossy(&bytes).into_owned();
        let result =
            catch_unwind(|| HandFile::load(path)).unwrap_or_else(|_| panic!("{name} {number}: panic\n{}", text()));
        assert!(start.elapsed() < LIMIT, "{name} {number}: {:?}\n{}", start.elapsed(), text());
        match result {
            Ok(_) => hands += 1,
            Err(error) => {
                let message = error.to_string();
                assert!(!message.is_empty() && !message.contains('\n'), "{name} {number}: {message}\n{}", text());
            }
        }
    }
    hands
}

#[test]
fn damaged_hand_files() {
    let hands = damage("claw.toml", 1);
    assert!((50..900).contains(&hands), "{hands} hands");
}

#[test]
fn damaged_urdfs() {
    let hands = damage("claw.urdf", 2);
    assert!((50..900).contains(&hands), "{hands} hands");
}
