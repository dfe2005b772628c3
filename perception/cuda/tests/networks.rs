//! Gradients, steps and predictions of whole networks by the kernels, beside those of the CPU. The kernels run on the emulator.

#![allow(clippy::unwrap_used, reason = "a failed assumption in a test is a failed test")]

#[cfg(feature = "nvidia")]
use std::io::Write as _;
use std::rc::Rc;
use std::sync::Arc;

use mvt_cuda::machine::{Arithmetic, Machine};
use mvt_cuda::mvt_touch::engine::{Engine, Instructions};
use mvt_cuda::mvt_touch::image::{Rgb, RgbImage};
use mvt_cuda::mvt_touch::network::{Architecture, Provenance, Weights};
use mvt_cuda::{Gpu, GpuNetwork, GpuTraining};
use mvt_cuda_emulator::Emulator;
use mvt_training::backend::{self, OptimiserState, Tensors};
use mvt_training::{LossConfig, OptimiserConfig, Penalty, Targets, TrainingBatch};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

const NETWORKS: [&str; 6] = [
    r#"{"name": "vit", "patch": 8, "width": 16, "depth": 4, "heads": 2, "mlp": 2, "positions": [3, 5], "hooks": [0, 1, 2, 3],
        "channels": 8}"#,
    r#"{"name": "mamba", "patch": 8, "width": 24, "depth": 2, "state": 6, "hooks": [0, 1], "channels": 8}"#,
    r#"{"name": "robust_mamba", "patch": 8, "width": 16, "depth": 3, "state": 16, "mlp": 2, "hooks": [0, 1, 2], "channels": 8,
        "scans": ["rows", "columns_reversed"]}"#,
    r#"{"name": "swin", "widths": [8, 12, 16, 16], "depths": [2, 1, 2, 1], "heads": [2, 3, 2, 4], "window": 3, "mlp": 2,
        "channels": 8}"#,
    r#"{"name": "convnext", "widths": [8, 12, 16, 16], "depths": [1, 1, 2, 1], "mlp": 2, "channels": 8}"#,
    r#"{"name": "default", "widths": [4, 6, 8, 16], "depth": 2, "state": 4}"#,
];
/// Sides of the images, pixels: no multiples of twice a patch.
const ROWS: usize = 64;
const COLUMNS: usize = 32;

/// Returns the emulator and, where there is one, the GPU.
fn machines(arithmetic: Arithmetic) -> Vec<Rc<dyn Machine>> {
    let mut machines = vec![Emulator::machine(arithmetic)];
    #[cfg(feature = "nvidia")]
    match mvt_cuda::nvidia::find() {
        Ok(()) => machines.push(mvt_cuda::nvidia::Nvidia::open(arithmetic).unwrap()),
        // Past the harness, which hides what a test prints.
        Err(reason) => {
            let text = format!("NO GPU: the kernels ran on the emulator alone ({reason})\n");
            std::io::stderr().write_all(text.as_bytes()).unwrap();
        }
    }
    machines
}

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

/// Returns weights of which none is zero or small.
fn shaken(network: &Architecture, rng: &mut ChaCha8Rng) -> Tensors {
    let mut weights = backend::initial(network, 3);
    for weight in weights.values_mut().flat_map(|tensor| &mut tensor.values) {
        *weight += rng.random_range(-0.2..0.2);
    }
    weights
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

#[test]
fn gradients_are_those_of_the_tape() {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let batch = discs(&mut rng);
    let penalties = [Penalty::Mse, Penalty::L1, Penalty::Huber].into_iter().cycle();
    for (network, penalty) in NETWORKS.into_iter().zip(penalties) {
        let network: Architecture = serde_json::from_str(network).unwrap();
        let loss = LossConfig { penalty, huber_mm: 0.2, ..LossConfig::default() };
        let weights = shaken(&network, &mut rng);
        let (exact, theirs) = backend::gradients(&network, &weights, loss, &batch);
        let state = OptimiserState::new(weights);
        for machine in machines(Arithmetic::Exact) {
            let name = format!("{} on {}", network.name(), machine.name());
            let mut training = GpuTraining::new(Gpu::new(machine), &network, loss, &state).unwrap();
            let (value, ours) = training.loss_and_gradients(&batch).unwrap();
            assert!((value - exact).abs() < 1e-5 * exact, "{name}: loss {value} for {exact}");
            assert!(ours.keys().eq(theirs.keys()));
            for ((tensor, ours), theirs) in ours.iter().zip(theirs.values()) {
                assert_eq!(ours.shape, theirs.shape);
                let size = theirs.values.iter().fold(0.0_f32, |most, g| most.max(g.abs()));
                let errors = ours.values.iter().zip(&theirs.values).map(|(a, b)| (a - b).abs());
                // A number that was never set is a NaN, which `max` would pass over.
                let error =
                    errors.fold(0.0_f32, |most, error| if error > most || error.is_nan() { error } else { most });
                assert!(error < 3e-4 * size, "{name}: gradient by {tensor} is off by {error} of {size}");
            }
        }
    }
}

/// Activations of 8 bits leave the direction of the gradient.
#[test]
fn gradients_in_bf16_point_the_same_way() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let batch = discs(&mut rng);
    for network in [NETWORKS[0], NETWORKS[1]] {
        let network: Architecture = serde_json::from_str(network).unwrap();
        let loss = LossConfig { huber_mm: 0.2, ..LossConfig::default() };
        let state = OptimiserState::new(backend::initial(&network, 3));
        let (_, theirs) = backend::gradients(&network, &state.weights, loss, &batch);
        let gpu = Gpu::new(Emulator::machine(Arithmetic::Bf16));
        let (_, ours) = GpuTraining::new(gpu, &network, loss, &state).unwrap().loss_and_gradients(&batch).unwrap();
        let error = difference(&ours, &theirs);
        assert!((1e-5..0.05).contains(&error), "{}: {error}", network.name());
    }
}

/// Steps on the GPU are those of the optimiser on the CPU, also if the memory does not suffice for all images at once.
#[test]
fn steps_are_those_of_the_cpu_with_any_memory() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let batch = discs(&mut rng);
    let network: Architecture = serde_json::from_str(NETWORKS[5]).unwrap();
    let (loss, config) = (LossConfig { huber_mm: 0.2, ..LossConfig::default() }, OptimiserConfig::default());
    let mut cpu = OptimiserState::new(backend::initial(&network, 3));
    let begin = cpu.clone();
    let mut losses = Vec::new();
    for _ in 0..4 {
        let (value, gradients) = backend::gradients(&network, &cpu.weights, loss, &batch);
        losses.push([value, cpu.advance(&gradients, &config, 10)]);
    }
    for bytes in [usize::MAX, 700_000] {
        let gpu = Gpu::new(Emulator::with_memory(Arithmetic::Exact, bytes));
        let mut training = GpuTraining::new(gpu.clone(), &network, loss, &begin).unwrap();
        for step in 0..4 {
            training.advance(&batch, &config.update(step, 10)).unwrap();
        }
        let results = training.results().unwrap();
        for (ours, theirs) in results.iter().zip(&losses) {
            assert!(ours.iter().zip(theirs).all(|(a, b)| (a - b).abs() < 1e-4 * b), "{ours:?} for {theirs:?}");
        }
        assert_eq!(results.len(), 4);
        let [weights, average, mean, square] = training.read().unwrap();
        let pairs = [(&weights, &cpu.weights), (&average, &cpu.average), (&mean, &cpu.mean), (&square, &cpu.square)];
        for (ours, theirs) in pairs {
            assert!(difference(ours, theirs) < 2e-3, "{} with {bytes} bytes", difference(ours, theirs));
        }
        assert!(gpu.pool().most() <= bytes);
    }
}

/// A step whose loss is not finite changes nothing, and its result says so.
#[test]
fn a_loss_that_is_not_finite_changes_nothing() {
    let network: Architecture = serde_json::from_str(NETWORKS[5]).unwrap();
    let mut batch = discs(&mut ChaCha8Rng::seed_from_u64(3));
    Arc::make_mut(&mut batch.targets).indentation_mm[7] = f32::NAN;
    let state = OptimiserState::new(backend::initial(&network, 3));
    let gpu = Gpu::new(Emulator::machine(Arithmetic::Exact));
    let mut training = GpuTraining::new(gpu, &network, LossConfig::default(), &state).unwrap();
    training.advance(&batch, &OptimiserConfig::default().update(0, 10)).unwrap();
    assert!(training.results().unwrap()[0][0].is_nan());
    let OptimiserState { weights, average, mean, square, .. } = state;
    assert_eq!(training.read().unwrap(), [weights, average, mean, square]);
}

/// A kernel refuses what its registers cannot hold.
#[test]
fn too_many_states_are_refused() {
    let network = r#"{"name": "mamba", "patch": 8, "width": 16, "depth": 1, "state": 17, "hooks": [0], "channels": 8}"#;
    let network: Architecture = serde_json::from_str(network).unwrap();
    let state = OptimiserState::new(backend::initial(&network, 3));
    let gpu = Gpu::new(Emulator::machine(Arithmetic::Exact));
    let mut training = GpuTraining::new(gpu, &network, LossConfig::default(), &state).unwrap();
    let error = training.loss_and_gradients(&discs(&mut ChaCha8Rng::seed_from_u64(4))).unwrap_err().to_string();
    assert!(error.contains("17 states"), "{error}");
}

/// Predictions are those of the engine on the CPU, at the size of the weights too.
#[test]
fn predictions_are_those_of_the_engine() {
    for network in NETWORKS {
        let network: Architecture = serde_json::from_str(network).unwrap();
        // All networks resize alike.
        let sizes = if network.name() == "vit" { vec![None, Some([32, 64])] } else { vec![None] };
        for size in sizes {
            let tensors = shaken(&network, &mut ChaCha8Rng::seed_from_u64(5));
            let weights = Weights::new(network.clone(), Provenance::default(), tensors, "test".as_ref()).unwrap();
            let weights = weights.with_input_size(size).unwrap();
            let images: Vec<RgbImage> = (0..2)
                .map(|k| RgbImage::from_fn(40, 56, |x, y| Rgb([(3 * x + k) as u8, (4 * y) as u8, (x * y) as u8])))
                .collect();
            let levels: Vec<u8> = images.iter().flat_map(RgbImage::as_raw).copied().collect();
            let mut predictions = Vec::new();
            let images: Vec<&RgbImage> = images.iter().collect();
            Engine::new(&weights, Instructions::best().exact()).infer_each(&images, &mut predictions).unwrap();
            let planes = predictions.iter().flat_map(|p| p.indentation_mm.iter().zip(&p.contact_logit));
            let largest = planes.clone().map(|(_, logit)| logit.abs()).fold(0.0_f32, f32::max);
            for machine in machines(Arithmetic::Exact) {
                let name = format!("{} on {} at {size:?}", network.name(), machine.name());
                let mut gpu = GpuNetwork::new(Gpu::new(machine), &weights).unwrap();
                // The second pass of a GPU comes from a recording.
                let passes = if name.contains("in place of") { 1 } else { 2 };
                for _ in 0..passes {
                    let ours = gpu.predict(&levels, [2, 56, 40]).unwrap();
                    for (ours, (mm, logit)) in ours.iter().zip(planes.clone()) {
                        let is_close = (ours[0] - mm).abs().max((ours[1] - logit).abs()) < 2e-4 * largest;
                        assert!(is_close, "{name}: {ours:?} for {mm}, {logit}");
                    }
                }
            }
        }
    }
}
