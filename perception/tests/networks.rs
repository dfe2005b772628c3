//! The engine beside PyTorch: fixtures/make.py has made weights, images and what they lead to.

use std::path::{Path, PathBuf};

use image::RgbImage;
use ndarray::Array2;
use perception::engine::{Engine, Instructions, Prediction};
use perception::network::{Architecture, Weights};
use safetensors::SafeTensors;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(format!("{name}.safetensors"))
}

/// The bytes and sides of a tensor of the expectations.
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

/// Root mean square and greatest absolute difference.
fn difference(a: &Array2<f32>, b: &Array2<f32>) -> (f32, f32) {
    assert_eq!(a.dim(), b.dim());
    let difference = a - b;
    ((difference.mapv(|d| d * d).mean().unwrap()).sqrt(), difference.fold(0.0, |most, d| d.abs().max(most)))
}

/// Outputs are of the order of 1 to 3. In f32 what differs is the order of sums; bf16 keeps 8 bits of each factor.
#[test]
fn every_network_predicts_what_pytorch_does_on_every_path() {
    for name in Architecture::NAMES {
        let weights = Weights::read(&fixture(name)).unwrap();
        let (image, depth, contact) =
            (image(name), plane(&format!("{name}.indentation_mm")), plane(&format!("{name}.contact_logit")));
        for set in Instructions::available() {
            let mut prediction = Prediction::default();
            Engine::new(&weights, set).infer(&image, &mut prediction).unwrap();
            let bound = match set {
                Instructions::Amx | Instructions::Avx512Bf16 => [0.03, 0.2],
                Instructions::Avx512 | Instructions::Avx2 | Instructions::Scalar => [1e-5, 1e-4],
            };
            for (found, exact) in [(&prediction.indentation_mm, &depth), (&prediction.contact_logit, &contact)] {
                let (rms, most) = difference(found, exact);
                println!("{name} {}: rms {rms:.1e}, greatest {most:.1e}", set.name());
                assert!(rms < bound[0] && most < bound[1], "{name} {}: {rms} {most}", set.name());
            }
        }
    }
}
