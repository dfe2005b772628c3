//! Times the writing and the check of a FeelSight log.
//!
//! Usage: `cargo run --release -p mvt-feelsight --example encode_log -- FOLDER [FRAMES]`
//!
//! It writes the log into FOLDER, which it overwrites; FRAMES is 90 by default. The frames are synthetic and take as
//! long as rendered ones: touch and colour images are noisy, depth is curved and noisy.
#![allow(clippy::print_stdout)]

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::LazyLock;
use std::time::Instant;

use anyhow::Context;
use image::{Rgb, RgbImage};
use mvt_feelsight::{EncodedFrame, EpisodeEnd, FORMAT_VERSION, LogMeta, LogWriter, SceneFile, SceneObject, inspect};
use mvt_frames::Isometry;
use mvt_frames::camera::{Intrinsics, PosedCamera, look_at};
use mvt_frames::depth::Label;
use mvt_robot::digit;
use mvt_robot::hand::{Hand, PerPad, Side};
use mvt_robot::observation::{GroundTruth, Observation, Rgbd, TouchTruth};
use ndarray::Array2;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let out = PathBuf::from(arguments.next().context("usage: encode_log FOLDER [FRAMES]")?);
    let frames: usize = arguments.next().map_or(Ok(90), |n| n.parse())?;
    let camera = PosedCamera {
        name: "front-left".into(),
        intrinsics: Intrinsics::from_fov_y(640, 480, 0.74),
        pose: look_at([0.25, -0.14, 0.2].into(), [-0.05, 0.0, 0.03].into(), nalgebra::Vector3::z()),
    };
    let meta = LogMeta { scene: scene(), cameras: vec![camera], untouched: None };
    let mut writer = LogWriter::create(&out, meta.clone(), true)?;
    let (mut encoding, mut writing) = (0.0, 0.0);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for i in 0..frames {
        let (observation, truth) = frame(i, &mut rng);
        let start = cpu_s();
        let encoded = EncodedFrame::encode(&observation, &truth, &meta)?;
        encoding += cpu_s() - start;
        let start = cpu_s();
        writer.push(&encoded)?;
        writing += cpu_s() - start;
    }
    let start = Instant::now();
    writer.finish(EpisodeEnd { complete: true, reason: "time is up".into() })?;
    let finishing = start.elapsed().as_secs_f64();
    let per_frame = 1e3 / frames as f64;
    let (encoding, writing) = (encoding * per_frame, writing * per_frame);
    println!("CPU time per frame: encode {encoding:.2} ms, write {writing:.2} ms; finish {finishing:.2} s");
    let start = Instant::now();
    println!("{}", inspect(&out)?);
    println!("inspect {:.2} ms per frame", start.elapsed().as_secs_f64() * per_frame);
    Ok(())
}

/// Returns the CPU time of this thread in seconds, on Linux; elsewhere the wall time.
fn cpu_s() -> f64 {
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    let computed = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let computed = computed.and_then(|stat| stat.split(' ').next()?.parse::<f64>().ok());
    computed.map_or_else(|| START.elapsed().as_secs_f64(), |ns| 1e-9 * ns)
}

fn scene() -> SceneFile {
    SceneFile {
        format_version: FORMAT_VERSION,
        program_version: env!("CARGO_PKG_VERSION").into(),
        object: SceneObject {
            name: "ball".into(),
            mesh: "procedural ball".into(),
            mesh_sha256: None,
            object_from_file: Isometry::<mvt_frames::MeshFile, mvt_frames::Object>::identity().to_matrix(),
            mass_kg: 0.1,
        },
        hand: Hand::allegro(Side::Left),
        seed: 1,
        gravity_m_s2: [0.0, 0.0, -9.81],
        gait: "none".into(),
        cameras: vec!["front-left".into()],
        frame_rate_hz: 30.0,
        control_rate_hz: 25.0,
        physics_rate_hz: 500.0,
        noise: BTreeMap::new(),
        randomised: BTreeMap::new(),
        config_sha256: String::new(),
        end: EpisodeEnd { complete: false, reason: String::new() },
    }
}

/// Returns a grey with noise of a few levels.
fn noisy(level: u32, rng: &mut ChaCha8Rng) -> u8 {
    (level.min(240) + (rng.next_u32() & 7)) as u8
}

fn frame(i: usize, rng: &mut ChaCha8Rng) -> (Observation, GroundTruth) {
    let phase = i as f64 / 30.0;
    let depth_m = Array2::from_shape_fn((digit::HEIGHT, digit::WIDTH), |(row, column)| {
        let (x, y) = (column as f64 - 120.0 + 30.0 * phase.sin(), row as f64 - 160.0);
        (0.022 - 1e-3 * (1.0 - (x * x + y * y) / 3600.0).max(-0.5)) as f32
    });
    let contact = depth_m.mapv(|z| z < 0.0217);
    let touch = PerPad::from_fn(4, |_| {
        RgbImage::from_fn(240, 320, |x, y| {
            Rgb([100 + x / 4, 110 + y / 5, 90 + (x + y) / 8].map(|level| noisy(level, rng)))
        })
    });
    // The hand and the ball in front of an empty background.
    let radius2 = |row: usize, column: usize| (row as f64 - 240.0).powi(2) + (column as f64 - 320.0).powi(2);
    let depth = |(row, column): (usize, usize)| {
        let r2 = radius2(row, column);
        let noise = 1e-4 * rng.random::<f32>();
        match r2 {
            r2 if r2 < 6400.0 => 0.3 - 5e-4 * (6400.0 - r2).sqrt() as f32 + noise,
            r2 if r2 < 40_000.0 => 0.35 + 1e-4 * row as f32 + noise,
            _ => 0.0,
        }
    };
    let camera = Rgbd {
        depth_m: Array2::from_shape_fn((480, 640), depth),
        color: RgbImage::from_fn(640, 480, |x, y| Rgb([noisy(x / 3, rng), noisy(y / 2, rng), 80])),
        labels: None,
        world_from_camera: None,
    };
    let labels = Array2::from_shape_fn((480, 640), |(row, column)| match radius2(row, column) {
        r2 if r2 < 6400.0 => Label::Object,
        r2 if r2 < 40_000.0 => Label::Hand,
        _ => Label::Background,
    });
    let observation = Observation { time_s: phase, joints: vec![0.4; 16], touch, cameras: vec![camera] };
    let truth = GroundTruth {
        object_pose: Isometry::translation(0.0, 0.0, 0.05),
        touch: PerPad::from_fn(4, |_| TouchTruth { depth_m: depth_m.clone(), contact: contact.clone() }),
        shear: None,
        labels: vec![labels],
    };
    (observation, truth)
}
