//! How fast a field learns and answers on one thread, for each instruction set of this machine.
//!
//! ```text
//! cargo run --release -p slam --example field_speed
//! ```
//! Each figure is the fastest of several repetitions, which other programs disturb least. Points lie near the surface of a sphere,
//! where the tracker asks.

#![allow(clippy::print_stdout)]

use std::time::Instant;

use clap::Parser;
use glam::Vec3;
use mvt_field::field::{FieldConfig, FieldInstructions, FieldTrainer, NeuralField, Sample};
use mvt_field::shape::{Distance, Shape};
use mvt_field::surface::outer_surface;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Times the field.
#[derive(Parser)]
struct Arguments {
    /// Samples of a training step.
    #[arg(long, default_value_t = 2048)]
    batch: usize,
    /// Points of a query.
    #[arg(long, default_value_t = 2000)]
    points: usize,
    /// Neurons of the hidden layer.
    #[arg(long, default_value_t = FieldConfig::default().hidden)]
    hidden: usize,
    /// Vertices per axis of each level.
    #[arg(long, value_delimiter = ',', default_values_t = FieldConfig::default().levels)]
    levels: Vec<u32>,
    /// Levels with more than 2^this vertices are hashed.
    #[arg(long, default_value_t = FieldConfig::default().table_log2)]
    table_log2: u32,
    /// Weight of the eikonal loss.
    #[arg(long, default_value_t = FieldConfig::default().eikonal_weight)]
    eikonal_weight: f32,
}

/// Radius of the sphere, metres.
const RADIUS_M: f32 = 0.035;
/// Cells of the mesh of the whole cube, metres.
const CELL_M: f32 = 0.0015;
/// Repetitions of which the fastest counts.
const RUNS: usize = 15;

fn main() -> anyhow::Result<()> {
    let Arguments { batch, points, hidden, levels, table_log2, eikonal_weight } = Arguments::parse();
    let config = FieldConfig { hidden, levels, table_log2, eikonal_weight, ..FieldConfig::default() };
    let mut random = ChaCha8Rng::seed_from_u64(1);
    // As in mapping: half of the samples in the band, the others in the free space before it.
    let batches: Vec<Vec<Sample>> = (0..64)
        .map(|_| {
            (0..batch)
                .map(|k| {
                    let distance = if k % 2 == 0 {
                        random.random_range(-0.004..0.004f32)
                    } else {
                        random.random_range(0.004..0.03)
                    };
                    let position = direction(&mut random) * (RADIUS_M + distance);
                    Sample { position, target: distance / config.truncation_m, weight: 1.0, at_least: false }
                })
                .collect()
        })
        .collect();
    let near: Vec<Vec3> =
        (0..points).map(|_| direction(&mut random) * (RADIUS_M + random.random_range(-0.002..0.002f32))).collect();

    println!("{config:?}\nmillions per second on one thread; batches of {batch}, queries of {points}\n");
    println!("{:12} {:>16} {:>16} {:>16} {:>16}", "", "trained samples", "SDF + gradient", "SDF", "mesh, ms");
    for instructions in FieldInstructions::available() {
        let mut trainer = FieldTrainer::new(NeuralField::new(&config, 0)?.with_instructions(instructions));
        let trained = rate(64 * batch, || {
            for batch in &batches {
                trainer.step(batch);
            }
        });
        let field = trainer.field();
        let repeats = 200_000 / points.max(1) + 1;
        let mut distances = vec![Distance::default(); points];
        let with_gradient = rate(repeats * points, || {
            for _ in 0..repeats {
                field.distances_and_gradients(&near, &mut distances);
            }
        });
        let mut values = vec![0.0; points];
        let plain = rate(repeats * points, || {
            for _ in 0..repeats {
                field.distances(&near, &mut values);
            }
        });
        let meshes = rate(1, || drop(outer_surface(field, config.half_extent_m, CELL_M)));
        let mesh_ms = 1e-3 / meshes;
        println!("{:12} {trained:16.2} {with_gradient:16.2} {plain:16.2} {mesh_ms:16.2}", format!("{instructions:?}"));
    }
    Ok(())
}

/// A direction, uniform on the sphere.
fn direction(random: &mut ChaCha8Rng) -> Vec3 {
    loop {
        let v = Vec3::from_array(std::array::from_fn(|_| random.random_range(-1.0..1.0f32)));
        if (0.01..1.0).contains(&v.length_squared()) {
            return v.normalize();
        }
    }
}

/// Millions of items per second: the fastest of several runs, after one that warms up.
fn rate(items: usize, mut run: impl FnMut()) -> f64 {
    run();
    let seconds = (0..RUNS).map(|_| {
        let start = Instant::now();
        run();
        start.elapsed().as_secs_f64()
    });
    items as f64 / seconds.fold(f64::INFINITY, f64::min) / 1e6
}
