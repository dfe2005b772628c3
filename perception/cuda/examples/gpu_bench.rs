//! Measures networks on the first NVIDIA GPU, and compares gradients with the CPU's.
//!
//! Reads a list of JSON objects from the file that is named, and prints a line of JSON for each. `benches/gpu` has such lists, and the
//! same measurements with PyTorch.

#![allow(clippy::print_stdout, reason = "its result")]

use std::error::Error;
use std::sync::Arc;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use mvt_cuda::machine::Arithmetic;
use mvt_cuda::mvt_touch::network::{Architecture, Provenance, Weights};
use mvt_cuda::nvidia::Nvidia;
use mvt_cuda::{Gpu, GpuNetwork, GpuTraining};
use mvt_training::backend::{self, OptimiserState};
use mvt_training::{LossConfig, OptimiserConfig, Targets, TrainingBatch};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::Deserialize;
use serde_json::{Value, json};

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Mode {
    /// Steps of a training.
    Train,
    /// Predictions, with images that come from the host and results that stay on the GPU.
    Infer,
    /// Gradients beside those of the CPU.
    Check,
    /// The time of each kind of call in a step.
    Profile,
    /// The same for predictions.
    ProfileInfer,
}

/// A measurement.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Measurement {
    mode: Mode,
    network: Architecture,
    size: [usize; 2],
    batch: usize,
    arithmetic: Arithmetic,
    /// Length of the measurement.
    #[serde(default = "four")]
    seconds: f64,
}

fn four() -> f64 {
    4.0
}

/// Images and targets that no network has seen.
fn noise(size: [usize; 2], batch: usize) -> TrainingBatch {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let pixels = batch * size[0] * size[1];
    let targets = Targets {
        indentation_mm: (0..pixels).map(|_| rng.random_range(0.0..1.0)).collect(),
        contact: (0..pixels).map(|_| f32::from(u8::from(rng.random_range(0.0..1.0) > 0.9))).collect(),
    };
    let levels = (0..3 * pixels).map(|_| rng.random()).collect();
    TrainingBatch { shape: [batch, size[0], size[1]], levels, targets: Arc::new(targets) }
}

/// Returns the seconds since 1970, by which the power that another program samples is assigned.
fn now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

fn measure(measurement: &Measurement) -> Result<Value, Box<dyn Error>> {
    let Measurement { mode, network, size, batch, arithmetic, seconds } = measurement;
    let is_profile = matches!(mode, Mode::Profile | Mode::ProfileInfer);
    let machine = if is_profile { Nvidia::measuring(*arithmetic)? } else { Nvidia::open(*arithmetic)? };
    let gpu = Gpu::new(machine);
    let images = noise(*size, *batch);
    let tensors = backend::initial(network, 3);
    let parameters: usize = tensors.values().map(|tensor| tensor.values.len()).sum();
    let mut result = json!({
        "network": network.name(), "size": size, "batch": batch, "arithmetic": format!("{arithmetic:?}"), "mode": format!("{mode:?}"),
        "device": gpu.pool().machine().name(), "parameters": parameters,
    });
    if matches!(mode, Mode::Infer | Mode::ProfileInfer) {
        let provenance = Provenance { seed: 0, step: 0, data: String::new(), training: Value::Null };
        let weights = Weights::new(network.clone(), provenance, tensors, "noise".as_ref())?;
        let mut network = GpuNetwork::new(gpu.clone(), &weights)?;
        let mut passes = |seconds: f64| -> Result<f64, Box<dyn Error>> {
            let (begin, mut count) = (Instant::now(), 0);
            let mut last = network.queue(&images.levels, images.shape)?;
            while begin.elapsed().as_secs_f64() < seconds || count < 3 {
                last = network.queue(&images.levels, images.shape)?;
                gpu.pool().machine().pace()?;
                count += 1;
            }
            last.download()?;
            Ok(begin.elapsed().as_secs_f64() / f64::from(count + 1))
        };
        passes(0.3)?;
        gpu.pool().machine().times();
        let begin_s = now_s();
        let pass_s = passes(if is_profile { 0.0 } else { *seconds })?;
        result["span_s"] = json!([begin_s, now_s()]);
        result["peak_memory_mb"] = json!(network.most_memory() / 1_000_000);
        result["images_per_s"] = json!(*batch as f64 / pass_s);
        result["ms"] = json!(1e3 * pass_s);
    } else {
        let state = OptimiserState::new(tensors);
        let mut training = GpuTraining::new(gpu.clone(), network, LossConfig::default(), &state)?;
        if *mode == Mode::Check {
            let (loss, ours) = training.loss_and_gradients(&images)?;
            let (exact, theirs) = backend::gradients(network, &state.weights, LossConfig::default(), &images);
            let (mut square, mut of_error, mut worst, mut worst_name) = (0.0_f64, 0.0_f64, 0.0_f64, "");
            for ((name, ours), theirs) in ours.iter().zip(theirs.values()) {
                let (mut error, mut size) = (0.0_f64, 0.0_f64);
                for (a, b) in ours.values.iter().zip(&theirs.values) {
                    error += f64::from(a - b).powi(2);
                    size += f64::from(*b).powi(2);
                }
                (square, of_error) = (square + size, of_error + error);
                if (error / size).sqrt().total_cmp(&worst).is_gt() {
                    (worst, worst_name) = ((error / size).sqrt(), name);
                }
            }
            result["loss"] = json!([loss, exact]);
            result["gradient_error"] = json!((of_error / square).sqrt());
            result["worst_tensor"] = json!([worst_name, worst]);
        } else {
            let (optimiser, mut step, mut losses) = (OptimiserConfig::default(), 0, Vec::new());
            let mut steps = |seconds: f64| -> Result<f64, Box<dyn Error>> {
                let (begin, mut count) = (Instant::now(), 0);
                while begin.elapsed().as_secs_f64() < seconds || count < 3 {
                    training.advance(&images, &optimiser.update(step, 1000))?;
                    (step, count) = (step + 1, count + 1);
                }
                losses = training.results()?;
                Ok(begin.elapsed().as_secs_f64() / f64::from(count))
            };
            steps(0.5)?;
            gpu.pool().machine().times();
            let begin_s = now_s();
            let step_s = steps(if is_profile { 0.0 } else { *seconds })?;
            result["span_s"] = json!([begin_s, now_s()]);
            result["images_per_s"] = json!(*batch as f64 / step_s);
            result["ms"] = json!(1e3 * step_s);
            result["last_loss"] = json!(losses.last().map(|result| result[0]));
        }
    }
    if result["peak_memory_mb"].is_null() {
        result["peak_memory_mb"] = json!(gpu.pool().most() / 1_000_000);
    }
    let times = gpu.pool().machine().times();
    if is_profile {
        let total: f64 = times.iter().map(|time| time.time_ms).sum();
        let rows: Vec<Value> = times
            .iter()
            .take(28)
            .map(|time| json!([time.call, time.count, (1e3 * time.time_ms).round() / 1e3]))
            .collect();
        result["calls"] = json!(rows);
        result["calls_ms"] = json!(total);
    }
    Ok(result)
}

fn main() -> Result<(), Box<dyn Error>> {
    let file = std::env::args().nth(1).ok_or("name a file with a list of measurements")?;
    let list: Vec<Measurement> = serde_json::from_str(&std::fs::read_to_string(file)?)?;
    for measurement in &list {
        let line = match measure(measurement) {
            Ok(result) => result,
            Err(error) => {
                json!({"network": measurement.network.name(), "mode": format!("{:?}", measurement.mode), "error": error.to_string()})
            }
        };
        println!("{line}");
    }
    Ok(())
}
