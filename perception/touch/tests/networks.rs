//! Comparison of the engine with PyTorch: fixtures/make.py wrote weights, images and predictions.

#![allow(clippy::unwrap_used, reason = "a failed assumption in a test is a failed test")]

use std::path::{Path, PathBuf};

use image::RgbImage;
use mvt_products::Instructions;
use mvt_touch::engine::{Engine, Prediction};
use mvt_touch::network::{Architecture, Weights};
use ndarray::Array2;
use safetensors::SafeTensors;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(format!("{name}.safetensors"))
}

/// Returns the bytes and sides of an expected tensor.
fn expected(name: &str) -> (Vec<u8>, Vec<usize>) {
    let bytes = std::fs::read(fixture("expected")).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let tensor = file.tensor(name).unwrap();
    (tensor.data().to_vec(), tensor.shape().to_vec())
}

fn image(name: &str) -> RgbImage {
    let (bytes, shape) = expected(&format!("{name}.image"));
    RgbImage::from_raw(shape[1] as u32, shape[0] as u32, bytes).unwrap()
}

fn plane(name: &str) -> Array2<f32> {
    let (bytes, shape) = expected(name);
    let values = bytes.as_chunks::<4>().0.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect();
    Array2::from_shape_vec((shape[0], shape[1]), values).unwrap()
}

/// Returns root mean square and greatest absolute difference.
fn difference(a: &Array2<f32>, b: &Array2<f32>) -> (f32, f32) {
    assert_eq!(a.dim(), b.dim());
    let difference = a - b;
    ((difference.mapv(|d| d * d).mean().unwrap()).sqrt(), difference.fold(0.0, |most, d| d.abs().max(most)))
}

/// Outputs are of the order of 1 to 3. In f32 only the order of sums differs; bf16 keeps 8 bits of each factor.
#[test]
fn every_network_predicts_what_pytorch_does_on_every_path() {
    for name in Architecture::NAMES {
        let weights = Weights::read(&fixture(name)).unwrap();
        let (image, depth, contact) =
            (image(name), plane(&format!("{name}.indentation_mm")), plane(&format!("{name}.contact_logit")));
        for set in Instructions::available() {
            let mut prediction = Prediction::default();
            Engine::new(&weights, set).infer(&image, &mut prediction).unwrap();
            let bound = if set.is_bf16() { [0.03, 0.2] } else { [1e-5, 1e-4] };
            for (found, exact) in [(&prediction.indentation_mm, &depth), (&prediction.contact_logit, &contact)] {
                let (rms, most) = difference(found, exact);
                println!("{name} {}: rms {rms:.1e}, greatest {most:.1e}", set.name());
                assert!(rms < bound[0] && most < bound[1], "{name} {}: {rms} {most}", set.name());
            }
        }
    }
}

/// The error for tensors of another architecture names the misfit; the error for an unknown network lists the known ones.
#[test]
fn weights_of_another_network_are_refused() {
    let bytes = std::fs::read(fixture("mamba")).unwrap();
    let replaced = |from: &str, to: &str| {
        let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
        let mut bytes = bytes.clone();
        bytes[at..at + from.len()].copy_from_slice(to.as_bytes());
        Weights::from_bytes(&bytes, Path::new("w.safetensors")).unwrap_err().to_string()
    };
    let error = replaced(r#"\"width\": 10"#, r#"\"width\": 11"#);
    assert!(error.contains("w.safetensors") && error.contains("A_log") && error.contains("[22, 9]"), "{error}");
    let error = replaced(r#"\"name\": \"mamba\""#, r#"\"name\": \"mamma\""#);
    assert!(Architecture::NAMES.iter().all(|name| error.contains(name)), "{error}");
}

/// Any damage to a file leads to weights or an error, and the engine can run weights that were read.
#[test]
fn damaged_weights_never_panic() {
    let mut random = 0x2545_f491_u32;
    let mut next = move |below: usize| {
        random ^= random << 13;
        random ^= random >> 17;
        random ^= random << 5;
        random as usize % below
    };
    let (mut refused, image) = (0, RgbImage::new(16, 16));
    for name in Architecture::NAMES {
        let whole = std::fs::read(fixture(name)).unwrap();
        let header = 8 + u64::from_le_bytes(whole[..8].try_into().unwrap()) as usize;
        for _ in 0..400 {
            let mut bytes = whole.clone();
            for _ in 0..=next(3) {
                // Mostly in the header, which is parsed.
                let at = if next(4) > 0 { next(header) } else { next(bytes.len()) };
                match next(5) {
                    0 => bytes[at] ^= 1 << next(8),
                    1 => bytes[at] = b"0123456789{}[]\",:-.eE"[next(21)],
                    2 => drop(bytes.drain(at..(at + 1 + next(8)).min(bytes.len()))),
                    3 => bytes.insert(at, next(256) as u8),
                    _ => bytes.truncate(at),
                }
                if bytes.len() <= header {
                    break;
                }
            }
            match Weights::from_bytes(&bytes, Path::new("damaged")) {
                Ok(weights) => {
                    let mut prediction = Prediction::default();
                    Engine::new(&weights, Instructions::best()).infer(&image, &mut prediction).unwrap();
                }
                Err(error) => {
                    refused += 1;
                    assert!(error.to_string().starts_with("damaged: "), "{error}");
                }
            }
        }
    }
    assert!(refused > 1200, "only {refused} of 2400 were refused");
}
