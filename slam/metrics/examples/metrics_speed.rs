//! Prints the time of one ADD-S with 10,000 points, both directions, on one thread, and the effect of the choice of points on the scores.
//!
//! `cargo run --release -p mvt-metrics --example metrics_speed -- MESH`

#![allow(clippy::print_stdout, reason = "a program that prints")]

use std::path::PathBuf;
use std::time::Instant;

use clap::Parser;
use mvt_frames::{Isometry, Object};
use mvt_metrics::{FINE_POINTS, POINTS, THRESHOLDS_M, TrueSurface, sample_surface};

#[derive(Parser)]
struct Arguments {
    /// An OBJ, STL or PLY mesh in metres
    mesh: PathBuf,
}

fn main() -> anyhow::Result<()> {
    let path = Arguments::parse().mesh;
    let (mesh, _) = mvt_mesh::repair(&mvt_mesh::read(&path)?.0, &path.display().to_string())?;
    let even = TrueSurface::new(&mesh, POINTS, 0);
    let uniform = TrueSurface::of_points(sample_surface(&mesh, POINTS, 0));
    println!("offset   ms/ADD-S  one-directional mm: even points, uniform points; symmetric mm, even points");
    for millimetres in [0.0, 0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 50.0] {
        let sin = (millimetres / 100.0_f64).sin();
        let motion = Isometry::<Object, Object>::from_parts(
            [millimetres * 1e-3, 0.0, 0.0],
            [1.0, 0.3 * sin, 0.5 * sin, 0.8 * sin],
        );
        let start = Instant::now();
        let rounds = 20;
        for _ in 0..rounds {
            std::hint::black_box(even.add_s(motion));
        }
        let ms = start.elapsed().as_secs_f64() * 1e3 / f64::from(rounds);
        let (e, u) = (even.add_s(motion), uniform.add_s(motion));
        println!(
            "{millimetres:5.1} mm  {ms:8.2}  {:.4} {:.4}  {:.4}",
            e.one_directional_m * 1e3,
            u.one_directional_m * 1e3,
            e.symmetric_m * 1e3
        );
    }
    println!("\na perfect shape, by the number of points: F at 1, 2, 5, 10 mm");
    for (name, truth, points) in [
        ("even", &even, POINTS),
        ("uniform", &uniform, POINTS),
        ("even", &TrueSurface::new(&mesh, FINE_POINTS, 0), FINE_POINTS),
    ] {
        let start = Instant::now();
        let score =
            truth.score(&sample_surface(&mesh, points, 1), Isometry::<Object, Object>::identity(), &THRESHOLDS_M);
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let f: Vec<String> = score.f_scores.iter().map(|f| format!("{:.4}", f.f())).collect();
        println!("{points:6} {name:8} {}  mesh error {:.3} mm, {ms:.1} ms", f.join(" "), score.mesh_error_m * 1e3);
    }
    Ok(())
}
