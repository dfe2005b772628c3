//! Comparison of training with the engine, on the weights and images of the engine's tests.

#![allow(clippy::unwrap_used, reason = "a failed assumption in a test is a failed test")]

use std::path::{Path, PathBuf};

use image::RgbImage;
use mvt_products::Instructions;
use mvt_touch::engine::{Engine, Prediction};
use mvt_touch::network::{Architecture, Weights};
use safetensors::SafeTensors;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../touch/tests/fixtures").join(format!("{name}.safetensors"))
}

fn image(name: &str) -> RgbImage {
    let bytes = std::fs::read(fixture("expected")).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let tensor = file.tensor(&format!("{name}.image")).unwrap();
    let shape = tensor.shape();
    RgbImage::from_raw(shape[1] as u32, shape[0] as u32, tensor.data().to_vec()).unwrap()
}

/// Training and the engine predict the same.
#[test]
fn training_sees_what_the_engine_sees() {
    for name in Architecture::NAMES {
        let weights = Weights::read(&fixture(name)).unwrap();
        let image = image(name);
        let shape = [1, image.height() as usize, image.width() as usize];
        let trained = mvt_training::predict(&weights, image.as_raw(), shape).unwrap();
        let mut prediction = Prediction::default();
        for set in Instructions::available() {
            Engine::new(&weights, set).infer(&image, &mut prediction).unwrap();
            let bound = if set.is_bf16() { 0.2 } else { 1e-4 };
            let pixels = prediction.indentation_mm.iter().zip(&prediction.contact_logit).zip(&trained);
            for ((mm, logit), exact) in pixels {
                let error = (mm - exact[0].max(0.0)).abs().max((logit - exact[1]).abs());
                assert!(error < bound, "{name} {}: {error}", set.name());
            }
        }
    }
}
