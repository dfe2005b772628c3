//! `bench`: speed of parts of the program on this machine.

mod view;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail};
use clap::{Args, Subcommand, value_parser};
use image::{Rgb, RgbImage};
use mvt_products::Instructions;
use mvt_run::device::DeviceArguments;
use mvt_run::io::print_line;
use mvt_touch::device::Device;
use mvt_touch::engine::{Engine, Prediction};
use mvt_touch::network::{Architecture, Cost, Provenance, WeightTensor, Weights};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::touch::architecture;
use mvt_run::image_size::ImageSize;

/// Measure the speed of touch networks or of the viewer on this machine
#[derive(Debug, Subcommand)]
pub enum BenchCommand {
    Networks(BenchNetworksArguments),
    View(view::BenchViewArguments),
}

/// Measure the speed, memory and energy of touch networks
///
/// One thread of the CPU works on each image; a GPU works on all images of a batch. Memory and energy are those of the
/// CPU. Without --weights the networks have random weights, which does not change their
/// speed.
#[derive(Debug, Args)]
pub struct BenchNetworksArguments {
    /// Networks, separated by commas: vit, mamba, robust_mamba, swin, convnext, default or training configurations
    /// (.toml)
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "vit,mamba,robust_mamba,swin,convnext,default",
        conflicts_with = "weights"
    )]
    networks: Vec<String>,
    /// Weights of networks (.safetensors), separated by commas
    #[arg(long, value_name = "FILE", value_delimiter = ',')]
    weights: Vec<PathBuf>,
    /// Numbers of images in a batch, separated by commas
    #[arg(long, value_delimiter = ',', default_value = "1,4,32", value_parser = value_parser!(u16).range(1..=1024))]
    batch: Vec<u16>,
    /// Sizes of the images in pixels, as WIDTHxHEIGHT or one side of a square, separated by commas
    #[arg(long, value_delimiter = ',', default_value = "240x320")]
    input: Vec<ImageSize>,
    /// Numbers of threads, separated by commas
    #[arg(long, value_delimiter = ',', default_value = "1,2", value_parser = value_parser!(u16).range(1..=256))]
    threads: Vec<u16>,
    /// Vector instructions: amx, avx512bf16, avx512, avx2 or scalar [default: the fastest of this machine]
    #[arg(long, value_parser = instructions)]
    instructions: Option<Instructions>,
    #[command(flatten)]
    device: DeviceArguments,
    /// Seconds to spend on each row of the table, at most 3600
    #[arg(long, default_value_t = 1.0)]
    seconds: f64,
    /// Print a JSON array instead of a table
    #[arg(long)]
    json: bool,
}

fn instructions(name: &str) -> Result<Instructions, String> {
    let known = Instructions::ALL.into_iter().find(|set| set.name() == name);
    match known {
        Some(set) if set.is_available() => Ok(set),
        Some(_) => {
            Err(format!("this machine does not have {name}; leave --instructions out for the fastest that it has"))
        }
        None => Err(format!("choose one of {}", Instructions::ALL.map(Instructions::name).join(", "))),
    }
}

/// Row of the table.
#[derive(Debug, Serialize)]
struct Figure {
    network: String,
    instructions: &'static str,
    input: String,
    batch: u16,
    threads: u16,
    parameters: u64,
    macs: u64,
    images_per_second: f64,
    /// Wall time of a batch divided by its images, median over all batches.
    ms_per_image: f64,
    /// Memory of weights and intermediate results, megabytes; `None` where the system does not report it.
    memory_mb: Option<f64>,
    /// Energy of the processor, joules per image; `None` where the system does not report it.
    energy_j: Option<f64>,
}

/// Runs the command.
pub fn run(command: &BenchCommand) -> Result<()> {
    let arguments = match command {
        BenchCommand::Networks(arguments) => arguments,
        BenchCommand::View(arguments) => return view::run(arguments),
    };
    if !(0.0..=3600.0).contains(&arguments.seconds) {
        bail!("--seconds {}: it must be from 0 to 3600", arguments.seconds);
    }
    let device = arguments.device.choose()?;
    let set = arguments.instructions.unwrap_or_else(Instructions::best);
    let mut figures = Vec::new();
    let names = if arguments.weights.is_empty() { arguments.networks.as_slice() } else { &[] };
    let presets: Vec<Architecture> = names.iter().map(|name| architecture(name)).collect::<Result<_>>()?;
    let read: Vec<Weights> = arguments.weights.iter().map(|path| Weights::read(path)).collect::<Result<_, _>>()?;
    if !arguments.json {
        print_line(&header())?;
    }
    // Random weights are made for one network at a time, because they are large.
    for weights in presets.iter().map(random_weights).chain(read.into_iter().map(Ok)) {
        let weights = weights?;
        for &input in &arguments.input {
            for &threads in &arguments.threads {
                for &batch in &arguments.batch {
                    let figure = Figure {
                        instructions: if device == Device::Gpu { "cuda" } else { set.name() },
                        ..measure(&weights, set, input, threads, batch, arguments.seconds)?
                    };
                    if !arguments.json {
                        print_line(&row(&figure))?;
                    }
                    figures.push(figure);
                }
            }
        }
    }
    if arguments.json { print_line(&serde_json::to_string_pretty(&figures)?) } else { Ok(()) }
}

/// Returns random weights that lead to finite results.
fn random_weights(architecture: &Architecture) -> Result<Weights> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let tensors = architecture.tensors().into_iter().map(|(name, shape)| {
        let count: usize = shape.iter().product();
        let scale = (shape.first().map_or(1.0, |&outputs| outputs as f32) / count.max(1) as f32).sqrt();
        let values = (0..count).map(|_| scale * rng.random_range(-1.0..1.0)).collect();
        (name, WeightTensor { shape, values })
    });
    Ok(Weights::new(architecture.clone(), Provenance::default(), tensors.collect(), Path::new("random weights"))?)
}

fn measure(
    weights: &Weights,
    set: Instructions,
    input: ImageSize,
    threads: u16,
    batch: u16,
    seconds: f64,
) -> Result<Figure> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads)).build()?;
    let mut rng = ChaCha8Rng::seed_from_u64(u64::from(batch));
    let mut image = || RgbImage::from_fn(input.width, input.height, |_, _| Rgb(rng.random()));
    let images: Vec<RgbImage> = (0..batch).map(|_| image()).collect();
    let images: Vec<&RgbImage> = images.iter().collect();
    let memory_before = resident_mb();
    let engine = Engine::new(weights, set);
    let mut predictions: Vec<Prediction> = Vec::new();
    let mut times = Vec::new();
    let (elapsed, energy_j) = pool.install(|| -> Result<(Duration, Option<f64>)> {
        // The first two batches allocate memory.
        for _ in 0..2 {
            engine.infer_each(&images, &mut predictions)?;
        }
        let (begun, energy_before) = (Instant::now(), energy_j());
        while times.is_empty() || begun.elapsed().as_secs_f64() < seconds {
            let started = Instant::now();
            engine.infer_each(&images, &mut predictions)?;
            times.push(started.elapsed().as_secs_f64());
        }
        let energy =
            energy_j().zip(energy_before).map(|(after, before)| after - before).filter(|joules| *joules >= 0.0);
        Ok((begun.elapsed(), energy))
    })?;
    let memory_mb = resident_mb().zip(memory_before).map(|(after, before)| (after - before).max(0.0));
    times.sort_unstable_by(f64::total_cmp);
    let count = times.len() as f64 * f64::from(batch);
    let Cost { parameters, macs, .. } = weights.architecture().cost(input.rows_and_columns());
    Ok(Figure {
        network: weights.architecture().name().to_owned(),
        instructions: set.name(),
        input: input.to_string(),
        batch,
        threads,
        parameters,
        macs,
        images_per_second: count / elapsed.as_secs_f64(),
        ms_per_image: times.get(times.len() / 2).context("no batch was timed")? * 1e3 / f64::from(batch),
        memory_mb,
        energy_j: energy_j.map(|joules| joules / count),
    })
}

/// Returns the resident memory of this process, megabytes.
fn resident_mb() -> Option<f64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kibibytes: f64 = line.trim().strip_suffix(" kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024.0 / 1e6)
}

/// Returns the energy that the processor has used so far, joules, from RAPL, which often only root may read.
fn energy_j() -> Option<f64> {
    let text = fs::read_to_string("/sys/class/powercap/intel-rapl:0/energy_uj").ok()?;
    Some(text.trim().parse::<f64>().ok()? * 1e-6)
}

fn header() -> String {
    let [a, b, c, d, e] = ["network", "instructions", "input", "batch", "threads"];
    let [f, g, h, i, j, k] = ["param./M", "GMAC", "images/s", "ms/image", "memory/MB", "energy/J"];
    format!("{a:<13} {b:<12} {c:>9} {d:>6} {e:>7} {f:>9} {g:>7} {h:>9} {i:>9} {j:>10} {k:>12}")
}

fn row(figure: &Figure) -> String {
    let Figure { network, instructions, input, batch, threads, images_per_second, ms_per_image, .. } = figure;
    let (millions, giga) = (figure.parameters as f64 / 1e6, figure.macs as f64 / 1e9);
    let memory = figure.memory_mb.map_or_else(|| "-".to_owned(), |mb| format!("{mb:.0}"));
    let energy = figure.energy_j.map_or_else(|| "unknown".to_owned(), |joules| format!("{joules:.3}"));
    format!(
        "{network:<13} {instructions:<12} {input:>9} {batch:>6} {threads:>7} {millions:>9.2} {giga:>7.2} {images_per_second:>9.1} {ms_per_image:>9.2} {memory:>10} {energy:>12}"
    )
}
