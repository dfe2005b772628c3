//! Times touch rendering on one thread and writes one image for a comparison with TACTO (see `benches/tacto/run.sh`).
//!
//! Usage: `cargo run --release -p mvt-render --example touch_bench -- MESH POSE.json BACKGROUND.png FRAMES PREFIX`
//!
//! It renders the mesh, in its own coordinates, at the 4 x 4 row-major pose `T_sensor_object` of POSE.json in TACTO
//! 0.0.3's configuration. It prints one JSON object with the CPU time per frame, noise and blur included. It writes
//! PREFIX_raw.png and PREFIX_calibrated.png, both without noise, and PREFIX_depth.f32.
#![allow(clippy::print_stdout)]

use std::path::Path;
use std::time::Instant;

use anyhow::Context;
use mvt_frames::{Gel, Isometry, Object};
use mvt_render::rays::RayMesh;
use mvt_render::touch::{Background, NoiseKey, TouchConfig, TouchFrame, TouchOptions, TouchRenderer};

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [mesh, pose, background, frames, prefix] = arguments.as_slice() else {
        anyhow::bail!("usage: touch_bench MESH POSE.json BACKGROUND.png FRAMES PREFIX");
    };
    let frames: u32 = frames.parse().context("FRAMES is not a number")?;
    let rows: [[f64; 4]; 4] =
        serde_json::from_slice(&std::fs::read(pose)?).context("POSE.json is not a 4 x 4 matrix")?;
    let config = TouchConfig::Tacto;
    let gel_from_object = config.gel_from_sensor() * Isometry::<Object, Gel>::from_matrix(&rows)?;
    let object = RayMesh::new(&mvt_mesh::repair(&mvt_mesh::read(Path::new(mesh))?.0, mesh)?.0);
    let background = Background::Image(image::open(background)?.into_rgb8());
    let renderer = TouchRenderer::new(&TouchOptions { background, ..TouchOptions::new(config) })?;

    let mut frame = TouchFrame::default();
    let mut render = |noise| renderer.render(&object, gel_from_object, noise, &mut frame);
    // The first frames allocate memory.
    (0..10).for_each(|_| render(None));
    let (wall, cpu) = (Instant::now(), cpu_ns()?);
    for k in 0..frames {
        render(Some(NoiseKey { seed: 0, pad: 0, frame: k }));
    }
    let cpu_ms = (cpu_ns()? - cpu) / 1e6 / f64::from(frames);
    let wall_ms = wall.elapsed().as_secs_f64() * 1e3 / f64::from(frames);
    println!("{}", serde_json::json!({ "cpu_ms_per_frame": cpu_ms, "wall_ms_per_frame": wall_ms }));

    render(None);
    frame.raw().save(format!("{prefix}_raw.png"))?;
    frame.calibrated().save(format!("{prefix}_calibrated.png"))?;
    let depth: Vec<u8> = frame.depth_m().iter().flat_map(|d| d.to_le_bytes()).collect();
    std::fs::write(format!("{prefix}_depth.f32"), depth)?;
    Ok(())
}

/// Returns the CPU time of this thread, nanoseconds: other programs on the machine hardly change it.
fn cpu_ns() -> anyhow::Result<f64> {
    let file = "/proc/thread-self/schedstat";
    let text = std::fs::read_to_string(file).with_context(|| format!("{file} cannot be read; this needs Linux"))?;
    text.split_whitespace().next().and_then(|ns| ns.parse().ok()).with_context(|| format!("{file} has no number"))
}
