//! A keyframe whose sensor was 1e38 m away made `run --resume` follow its rays for ever; one with the lens of an impossible camera took
//! memory for all pixels that it promised.

use std::fs;

use crate::workplace::Workplace;

/// Writes numbers over those of a tensor, and takes the checksum out of the file.
fn with_numbers(file: &[u8], tensor: &str, numbers: impl Fn(usize) -> Option<f32>) -> Vec<u8> {
    const SEAL: &[u8] = b"\"checksum\"";
    let mut bytes = file.to_vec();
    let start = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let header: serde_json::Value = serde_json::from_slice(&bytes[8..start]).unwrap();
    let offset = |k: usize| start + header[tensor]["data_offsets"][k].as_u64().unwrap() as usize;
    for (k, at) in (offset(0)..offset(1)).step_by(4).enumerate() {
        if let Some(number) = numbers(k) {
            bytes[at..at + 4].copy_from_slice(&number.to_le_bytes());
        }
    }
    let seal = bytes.windows(SEAL.len()).position(|window| window == SEAL).unwrap();
    bytes[seal..seal + SEAL.len()].copy_from_slice(b"\"whatever\"");
    bytes
}

#[test]
fn a_run_refuses_keyframes_from_far_away_and_of_impossible_cameras() {
    let workplace = Workplace::new();
    workplace.run("run --object rubiks_cube_small --touch-depth truth --duration 0.5 --quiet").good();
    let path = workplace.path("out/keyframes.safetensors");
    let whole = fs::read(&path).unwrap();
    let resume = "run --object rubiks_cube_small --touch-depth truth --duration 0.2 --quiet --resume out --out again";
    // A file without a checksum is one of version 0.1.0.
    fs::write(&path, with_numbers(&whole, "origin", |_| None)).unwrap();
    workplace.run(resume).good();
    fs::write(&path, with_numbers(&whole, "origin", |_| Some(1e38))).unwrap();
    let said = workplace.run(resume).error();
    assert!(said.contains("keyframes.safetensors: tensor origin has 1"), "{said}");
    // The last two of the 15 numbers of a lens are columns and rows.
    fs::write(&path, with_numbers(&whole, "lens", |k| (k % 15 > 12).then_some(20_000.0))).unwrap();
    let said = workplace.run(resume).error();
    assert!(said.contains("tensor lens is that of a camera with too many pixels"), "{said}");
}
