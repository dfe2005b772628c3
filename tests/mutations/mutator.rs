//! Changes of files: of bits, bytes and slices, of numbers in text and in binary, and of words.

use rand::seq::IndexedRandom as _;
use rand::{Rng, RngExt as _};

/// Numbers in text that readers may not expect.
const NUMBERS: &str = "0 -1 1 255 256 65536 2147483647 2147483648 4294967295 4294967296 9223372036854775807 18446744073709551615 \
                       18446744073709551616 -9223372036854775808 NaN nan inf -inf 1e308 1e999 -1e308 1e-320 0.1";
/// Words that mean something to one reader or another.
const WORDS: &[&str] = &[
    "null",
    "true",
    "{}",
    "[]",
    "\"\"",
    "{",
    "}",
    "[",
    "]",
    "\"",
    ",",
    "\n",
    " ",
    "\0",
    "\u{fc}",
    "\u{feff}",
    "=",
    ":",
    "/",
    "../..",
    "v",
    "f",
    "vt",
    "vertex",
    "facet",
    "endsolid",
    "solid",
    "element face",
    "property list uchar int vertex_indices",
    "property double x",
    "end_header",
    "I",
    "J",
    "F32",
    "BF16",
    "U8",
    "__metadata__",
    "<f8",
    ">u2",
    "|O",
    "'shape': (2, 2)",
    "PK\x01\x02",
    "PK\x03\x04",
    "PK\x05\x06",
    "IDAT",
    "IHDR",
    "PLTE",
    "tRNS",
    "acTL",
];
/// Bytes at the beginning and at the end of a file that are changed more often: headers and directories stand there.
const EDGE: usize = 600;

/// Returns a file with one to four changes.
pub fn mutated(original: &[u8], random: &mut impl Rng) -> Vec<u8> {
    let mut bytes = original.to_vec();
    // Half of them have one change, which readers accept more often.
    let changes = if random.random() { 1 } else { random.random_range(2..=4) };
    for _ in 0..changes {
        change(&mut bytes, original, random);
    }
    bytes
}

fn change(bytes: &mut Vec<u8>, original: &[u8], random: &mut impl Rng) {
    if bytes.is_empty() {
        return bytes.extend_from_slice(original);
    }
    let at = place(bytes.len(), random);
    let end = (at + length(random)).min(bytes.len());
    match random.random_range(0..11) {
        0 => bytes[at] ^= 1 << random.random_range(0..8),
        1 => bytes[at] = *[0, 1, 0x7f, 0x80, 0xff].choose(random).unwrap_or(&0),
        2 => bytes.truncate(at),
        3 => drop(bytes.drain(at..end)),
        4 => {
            let copy = bytes[at..end].to_vec();
            bytes.splice(at..at, copy);
        }
        5 => {
            // A slice of the original in another place, instead of the bytes there or before them.
            let from = place(original.len(), random);
            let slice = &original[from..(from + length(random)).min(original.len())];
            let end = if random.random() { at } else { end };
            bytes.splice(at..end, slice.iter().copied());
        }
        6 => {
            let noise: Vec<u8> = (0..random.random_range(1..9)).map(|_| random.random()).collect();
            bytes.splice(at..at, noise);
        }
        7 | 8 => {
            let numbers: Vec<&str> = NUMBERS.split(' ').collect();
            let number = *numbers.choose(random).unwrap_or(&"0");
            let range = number_at(bytes, at).unwrap_or(at..at);
            bytes.splice(range, number.bytes());
        }
        9 => binary_number(&mut bytes[at..], random),
        _ => {
            let word = *WORDS.choose(random).unwrap_or(&"");
            let end = if random.random() { at } else { (at + word.len()).min(bytes.len()) };
            bytes.splice(at..end, word.bytes());
        }
    }
}

/// Returns a place in a file, more often near its ends.
fn place(length: usize, random: &mut impl Rng) -> usize {
    let edge = EDGE.min(length);
    match random.random_range(0..4) {
        0 => random.random_range(0..edge.max(1)),
        1 => length - random.random_range(0..edge.max(1)).min(length) - usize::from(length > 0),
        _ => random.random_range(0..length.max(1)),
    }
}

/// Returns the length of a slice: mostly short.
fn length(random: &mut impl Rng) -> usize {
    let most = 1 << random.random_range(0..12);
    random.random_range(1..=most)
}

/// Returns where the next number in text stands.
fn number_at(bytes: &[u8], from: usize) -> Option<std::ops::Range<usize>> {
    const FAR: usize = 200;
    let is_digit = |byte: &u8| byte.is_ascii_digit();
    let is_part = |byte: &u8| byte.is_ascii_digit() || b"+-.eE".contains(byte);
    let first = from + bytes[from..].iter().take(FAR).position(is_digit)?;
    let start = bytes[..first].iter().rposition(|byte| !is_part(byte)).map_or(0, |before| before + 1);
    let end = first + bytes[first..].iter().position(|byte| !is_part(byte)).unwrap_or(bytes.len() - first);
    Some(start..end)
}

/// Overwrites the first bytes with a number of one, two, four or eight bytes.
fn binary_number(bytes: &mut [u8], random: &mut impl Rng) {
    let number: u64 =
        *[0, 1, u64::MAX, 1 << 31, 1 << 63, (1 << 31) - 1, 1 << 32, 1000, 70_000].choose(random).unwrap_or(&0);
    let float = *[f64::NAN, f64::INFINITY, -1.0, 1e308, 1e-320, 0.5].choose(random).unwrap_or(&0.0);
    let little: Vec<u8> = match random.random_range(0..6) {
        0 => (number as u16).to_le_bytes().to_vec(),
        1 => (number as u32).to_le_bytes().to_vec(),
        2 => number.to_le_bytes().to_vec(),
        3 => (number as u32).to_be_bytes().to_vec(),
        4 => (float as f32).to_le_bytes().to_vec(),
        _ => float.to_le_bytes().to_vec(),
    };
    for (byte, new) in bytes.iter_mut().zip(little) {
        *byte = new;
    }
}
