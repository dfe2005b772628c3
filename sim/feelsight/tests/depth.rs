//! Depth archives from NumPy, in every form of recorded data (see data/write_depths.py).
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::{Path, PathBuf};

use mvt_feelsight::npz::NpzReader;

fn archive(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/data/depth-{name}.npz"))
}

#[test]
fn types_scales_signs_and_byte_orders() {
    for (name, sign, tolerance) in
        [("u2", 1.0, 1e-6), ("i2", 1.0, 1e-6), ("f4", -1.0, 1e-6), ("f8", -1.0, 1e-6), ("f2", -1.0, 1e-3)]
    {
        let mut reader = NpzReader::open(&archive(name)).unwrap();
        assert_eq!(reader.shape(), [2, 3, 4]);
        for image in 0..2 {
            let values = reader.read().unwrap().unwrap();
            assert_eq!(values.len(), 12);
            for (i, value) in values.into_iter().enumerate() {
                let depth = 0.1 * (12 * image + i) as f32;
                assert!((sign * value - depth).abs() < tolerance, "{name} {image} {i}: {value}");
            }
        }
        assert!(reader.read().unwrap().is_none());
    }
}

#[test]
fn other_contents_are_refused_with_a_reason() {
    for (name, reason) in
        [("fortran", "Fortran order"), ("flat", "three axes"), ("objects", "unknown type"), ("none", "\"depth\"")]
    {
        let error = NpzReader::open(&archive(name)).err().unwrap().to_string();
        assert!(error.contains(reason), "{name}: {error}");
    }
}
