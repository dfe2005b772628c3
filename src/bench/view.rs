//! `bench view`: speed of the viewer.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, bail};
use clap::{Args, value_parser};
use glam::Vec3A;
use mvt_frames::{Isometry, Object, World};
use mvt_recording::Recording;
use mvt_render::tessellation::tessellate;
use mvt_robot::hand::{Primitive, UPRIGHT};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use mvt_picture::palette::Theme;
use mvt_picture::raster::{LitMesh, MeshPlacement, Rasteriser};
use mvt_run::io::print_line;
use mvt_viewer::{Eye, Layers, Preset, ScenePainter};

use mvt_run::image_size::ImageSize;

/// Measure how fast the viewer paints a turning mesh and random moments of a run
///
/// Without --run only the rasteriser is measured, with a mesh that fills most of the picture's height.
#[derive(Debug, Args)]
pub struct BenchViewArguments {
    /// Number of triangles of the mesh
    #[arg(long, default_value_t = 100_000, value_parser = value_parser!(u32).range(100..=10_000_000))]
    triangles: u32,
    /// Size of the picture in pixels, as WIDTHxHEIGHT or one side of a square
    #[arg(long, value_name = "SIZE", default_value = "1280x720")]
    size: ImageSize,
    /// Number of threads
    #[arg(long, default_value_t = 2, value_parser = value_parser!(u16).range(1..=256))]
    threads: u16,
    /// Number of pictures to paint
    #[arg(long, default_value_t = 200, value_parser = value_parser!(u32).range(2..=100_000))]
    pictures: u32,
    /// Folder of a run, whose moments are painted in random order, with the images of the sensors
    #[arg(long, value_name = "DIR")]
    run: Option<PathBuf>,
}

/// Runs the command.
pub fn run(arguments: &BenchViewArguments) -> Result<()> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(usize::from(arguments.threads)).build()?;
    pool.install(|| turn(arguments))?;
    match &arguments.run {
        Some(folder) => pool.install(|| scrub(arguments, &Recording::open(folder)?)),
        None => Ok(()),
    }
}

/// Times a mesh that turns.
fn turn(arguments: &BenchViewArguments) -> Result<()> {
    let segments = f64::from(arguments.triangles).sqrt() as usize;
    let shape = Primitive::Ellipsoid { centre: [0.0; 3], semi: [0.1, 0.1, 0.09], orientation_wxyz: UPRIGHT };
    let mesh = tessellate(&shape, segments);
    let surface = LitMesh::new(&mesh);
    let size = [arguments.size.width, arguments.size.height].map(|side| side as usize);
    let mut eye = Eye::new(Preset::Oblique);
    let world_from_object = Isometry::<Object, World>::new(eye.target.into());
    let mut raster = Rasteriser::default();
    let times_ms = (0..arguments.pictures).map(|_| {
        eye.orbit(0.03, 0.0);
        let begun = Instant::now();
        raster.begin(&eye.intrinsics(size), Theme::LIGHT.paper);
        let camera_from_mesh = (eye.pose().inverse() * world_from_object).to_f32();
        raster.surface(
            &surface,
            |k| Vec3A::splat((k % 256) as f32),
            MeshPlacement { camera_from_mesh, is_glass: false, shine: 0.0 },
        );
        raster.finish(0.5);
        begun.elapsed().as_secs_f64() * 1e3
    });
    report(&format!("turning {} triangles", mesh.faces.len()), times_ms.collect())
}

/// Times random moments of a run.
fn scrub(arguments: &BenchViewArguments, recording: &Recording) -> Result<()> {
    let moments = recording.moments().len();
    if moments == 0 {
        bail!("{} does not contain a frame yet; wait for the run's first second", recording.folder().display());
    }
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut scene = ScenePainter::new();
    let size = [arguments.size.width, arguments.size.height].map(|side| side as usize);
    let (layers, eye) = (Layers::default(), Eye::default());
    let mut times_ms = Vec::new();
    for _ in 0..arguments.pictures {
        let moment = rng.random_range(0..moments);
        let begun = Instant::now();
        recording.images(moment)?;
        scene.paint(recording, moment, &layers, &eye, &Theme::LIGHT, size);
        times_ms.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    report(&format!("scrubbing {moments} frames"), times_ms)
}

/// Prints the median and the longest time, without the first picture, which fills the caches.
fn report(what: &str, mut times_ms: Vec<f64>) -> Result<()> {
    times_ms.remove(0);
    times_ms.sort_by(f64::total_cmp);
    let [median, worst] = [times_ms[times_ms.len() / 2], times_ms[times_ms.len() - 1]];
    print_line(&format!("{what}: median {median:.1} ms ({:.0} pictures/s), worst {worst:.1} ms", 1e3 / median))
}
