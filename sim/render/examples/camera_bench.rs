//! Times the camera renderer: frames per second of wall time, and CPU time, on one and two threads.
//!
//! Usage: `cargo run --release -p mvt-render --example camera_bench -- [FOLDER]`
//!
//! It renders 640 x 480 frames of a turning object. Other programs disturb CPU time less than wall time. With FOLDER it
//! also writes the view of each named camera into that folder.
#![allow(clippy::print_stdout)]

use std::path::Path;
use std::time::Instant;

use anyhow::Context;
use image::GrayImage;
use mvt_frames::{Isometry, Object as ObjectFrame, World};
use mvt_objects::object::Object;
use mvt_render::camera::{CameraScratch, Renderer};
use mvt_render::tessellation::tessellate;
use mvt_robot::hand::{Hand, Primitive, Side, UPRIGHT};
use mvt_robot::rig::PLACEMENTS;
use rayon::prelude::*;

const FRAMES: usize = 60;

fn pose(frame: usize) -> Isometry<ObjectFrame, World> {
    let half_turn = frame as f64 * 0.05;
    Isometry::from_parts([-0.0375, 0.005, 0.05], [half_turn.cos(), 0.0, 0.0, half_turn.sin()])
}

/// Returns the CPU time of all threads, seconds.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

fn main() -> anyhow::Result<()> {
    let mesh = tessellate(
        &Primitive::Ellipsoid { centre: [0.0; 3], semi: [0.034, 0.03, 0.036], orientation_wxyz: UPRIGHT },
        128,
    );
    let object = Object {
        name: "ellipsoid".into(),
        mesh,
        exact: None,
        object_from_file: Isometry::identity(),
        collision: vec![],
        mass_kg: 0.1,
    };
    let joints = [0.1, 0.7, 0.8, 0.6, 0.0, 0.6, 0.9, 0.5, -0.1, 0.8, 0.7, 0.6, 1.2, 0.4, 0.5, 0.6];
    let hand = Hand::allegro(Side::Left);
    let renderer = Renderer::new(&hand, &object);
    if let Some(dir) = std::env::args().nth(1) {
        for placement in PLACEMENTS {
            let frame = renderer.render(&placement.camera(&hand), &joints, pose(4), &mut CameraScratch::default());
            let path = |suffix| Path::new(&dir).join(format!("{}{suffix}.png", placement.name));
            frame.rgbd.color.save(path("")).with_context(|| dir.clone())?;
            let (height, width) = frame.labels.dim();
            let levels = frame.labels.iter().map(|label| label.grey()).collect();
            let image = GrayImage::from_raw(width as u32, height as u32, levels).context("labels")?;
            image.save(path("-segmentation"))?;
        }
    }
    let camera = PLACEMENTS[3].camera(&hand);
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let (start, cpu) = (Instant::now(), cpu_seconds());
        let pixels: usize = pool.install(|| {
            (0..FRAMES)
                .into_par_iter()
                .map_init(CameraScratch::default, |scratch, k| renderer.render(&camera, &joints, pose(k), scratch))
                .map(|frame| frame.rgbd.depth_m.iter().filter(|&&d| d > 0.0).count())
                .sum()
        });
        println!(
            "{threads} thread(s): {:.0} frames/s, {:.1} ms of CPU time a frame, {:.0} % of the pixels hit",
            FRAMES as f64 / start.elapsed().as_secs_f64(),
            (cpu_seconds() - cpu) * 1e3 / FRAMES as f64,
            pixels as f64 / FRAMES as f64 / 3072.0
        );
    }
    Ok(())
}
