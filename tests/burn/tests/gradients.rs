//! Gradients of whole networks, by the tape and by the kernels on the emulator, beside those of burn on the CPU.

#![allow(clippy::unwrap_used, reason = "a failed assumption in a test is a failed test")]

use std::sync::Arc;

use burn_autodiff::Autodiff;
use burn_ndarray::NdArray;
use mvt_cuda::machine::Arithmetic;
use mvt_cuda::{Gpu, GpuTraining};
use mvt_cuda_emulator::Emulator;
use mvt_training::mvt_touch::network::Architecture;
use mvt_training::backend::{OptimiserState, Tensors};
use mvt_training::{LossConfig, Penalty, Targets, TrainingBatch, backend};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

const NETWORKS: [&str; 6] = [
    r#"{"name": "vit", "patch": 8, "width": 16, "depth": 4, "heads": 2, "mlp": 2, "positions": [3, 5], "hooks": [0, 1, 2, 3],
        "channels": 8}"#,
    r#"{"name": "mamba", "patch": 8, "width": 16, "depth": 2, "state": 4, "hooks": [0, 1], "channels": 8}"#,
    r#"{"name": "robust_mamba", "patch": 8, "width": 16, "depth": 3, "state": 4, "mlp": 2, "hooks": [0, 1, 2], "channels": 8}"#,
    r#"{"name": "swin", "widths": [8, 12, 16, 16], "depths": [2, 1, 2, 1], "heads": [2, 3, 2, 4], "window": 3, "mlp": 2,
        "channels": 8}"#,
    r#"{"name": "convnext", "widths": [8, 12, 16, 16], "depths": [1, 1, 2, 1], "mlp": 2, "channels": 8}"#,
    r#"{"name": "default", "widths": [4, 6, 8, 16], "depth": 2, "state": 4}"#,
];
/// Sides of the images, pixels: no multiples of twice a patch.
const ROWS: usize = 64;
const COLUMNS: usize = 32;

/// Two images with a bright disc each, whose brightness is its depth.
fn discs(rng: &mut ChaCha8Rng) -> TrainingBatch {
    let (mut levels, mut targets) = (Vec::new(), Targets::default());
    for _ in 0..2 {
        let [x, y, r]: [f32; 3] = [8.0..24.0, 8.0..24.0, 4.0..9.0].map(|range| rng.random_range(range));
        for k in 0..ROWS * COLUMNS {
            let inside = (x - (k % COLUMNS) as f32).hypot(y - (k / COLUMNS) as f32) / r;
            let depth = (1.0 - inside * inside).max(0.0);
            levels.extend([90 + (120.0 * depth) as u8, 60, 120 - (90.0 * depth) as u8]);
            targets.indentation_mm.push(depth);
            targets.contact.push(f32::from(u8::from(depth > 0.1)));
        }
    }
    TrainingBatch { shape: [2, ROWS, COLUMNS], levels, targets: Arc::new(targets) }
}

/// Returns the length of the difference of tensors as a share of the length of the second ones.
fn difference(ours: &Tensors, theirs: &Tensors) -> f64 {
    let (mut error, mut size) = (0.0, 0.0);
    for (ours, theirs) in ours.values().zip(theirs.values()) {
        for (a, b) in ours.values.iter().zip(&theirs.values) {
            error += f64::from(a - b).powi(2);
            size += f64::from(*b).powi(2);
        }
    }
    (error / size).sqrt()
}

/// Loss and gradients of the tape equal those of burn, also if burn sums over passes.
#[test]
fn gradients_are_those_of_burn() {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let batch = discs(&mut rng);
    let penalties = [Penalty::Mse, Penalty::L1, Penalty::Huber].into_iter().cycle();
    for (network, penalty) in NETWORKS.into_iter().zip(penalties) {
        let network: Architecture = serde_json::from_str(network).unwrap();
        let name = network.name();
        let loss = LossConfig { penalty, huber_mm: 0.2, ..LossConfig::default() };
        // Initial biases are zero and initial steps small.
        let mut weights = backend::initial(&network, 3);
        for weight in weights.values_mut().flat_map(|tensor| &mut tensor.values) {
            *weight += rng.random_range(-0.2..0.2);
        }
        let (value, ours) = backend::gradients(&network, &weights, loss, &batch);
        for pixels in [ROWS * COLUMNS, 2 * ROWS * COLUMNS] {
            let device = Default::default();
            let (exact, theirs) =
                burn_judge::gradients::<Autodiff<NdArray>>(&device, &network, &weights, loss, &batch, pixels).unwrap();
            let gpu = Gpu::new(Emulator::machine(Arithmetic::Exact));
            let mut training = GpuTraining::new(gpu, &network, loss, &OptimiserState::new(weights.clone())).unwrap();
            let (of_kernels, by_kernels) = training.loss_and_gradients(&batch).unwrap();
            let error = difference(&by_kernels, &theirs);
            assert!((of_kernels - exact).abs() < 1e-4 * exact && error < 1e-4, "{name}: kernels are off by {error}");
            assert!((value - exact).abs() < 1e-3 * exact, "{name}: loss {value} for {exact}");
            assert!(ours.keys().eq(weights.keys()) && theirs.keys().eq(weights.keys()));
            for ((tensor, ours), theirs) in ours.iter().zip(theirs.values()) {
                let size = theirs.values.iter().fold(0.0_f32, |most, g| most.max(g.abs()));
                let pairs = ours.values.iter().zip(&theirs.values);
                let error = pairs.fold(0.0_f32, |most, (a, b)| most.max((a - b).abs()));
                assert!(size > 0.0 && error < 1e-3 * size, "{name}: gradient by {tensor} is off by {error} of {size}");
            }
        }
    }
}
