//! dev harness, to be rewritten
use anyhow::{Context as _, Result};
use clap::Args;
use glam::Vec3;
use scenes::catalogue;
use scenes::frame::{Isometry, Model, Object, World};
use scenes::hand::PerFinger;
use scenes::mesh::MeshDistance;
use scenes::object::SignedDistance;
use sim::feelsight::Log;
use slam::exact::KnownShape;
use slam::metrics::{THRESHOLDS_M, TrueSurface, sample_surface};
use std::path::PathBuf;

/// Dev
#[derive(Debug, Clone, Args)]
pub struct Arguments {
    #[arg(long)]
    log: PathBuf,
    #[arg(long, default_value = "pose")]
    mode: String,
    #[arg(long, default_value = "vitac")]
    modality: String,
    #[arg(long, default_value_t = 0)]
    camera: usize,
    #[arg(long, default_value_t = 900)]
    frames: usize,
    #[arg(long)]
    set: Vec<String>,
    #[arg(long)]
    verbose: bool,
    #[arg(long)]
    mesh: Option<PathBuf>,
}

pub fn run(a: &Arguments) -> Result<()> {
    let log = Log::open(&a.log)?;
    let name = log.scene().map(|s| s.object.mesh.clone()).context("no scene")?;
    let object = catalogue::load(&name, &mut Vec::new())?;
    let mut json = serde_json::to_value(slam::Config::default())?;
    for s in &a.set {
        let (k, v) = s.split_once('=').context("set")?;
        let mut at = &mut json;
        for part in k.split('.') {
            at = at.get_mut(part).with_context(|| format!("key {k}"))?;
        }
        *at = serde_json::from_str(v)?;
    }
    let config: slam::Config = serde_json::from_value(json)?;
    let truth_surface = TrueSurface::new(&object.mesh, 10000, 0);
    let vision = a.modality.contains("vi");
    let touch = a.modality.contains("tac");
    let side = log.side();
    let exact: std::sync::Arc<dyn SignedDistance> = match &object.exact {
        Some(e) => e.clone(),
        None => std::sync::Arc::new(MeshDistance::new(&object.mesh).context("mesh")?),
    };
    let mut slam = None;
    let mut gauge: Option<Isometry<Model, Object>> = None;
    let mut errors = vec![];
    let (mut ttrack, mut tmap, mut lost, mut frames) = (0.0, 0.0, 0, 0.0);
    let mut last = None;
    let t0 = std::time::Instant::now();
    let (sender, receiver) = std::sync::mpsc::sync_channel(16);
    std::thread::scope(|scope| -> Result<()> {
        let log = &log;
        scope.spawn(move || {
            for frame in log.frames().unwrap().take(a.frames) {
                let frame = frame.unwrap();
                let truth = frame.truth.unwrap();
                let mut observation = frame.observation;
                let cams: Vec<_> = if vision { vec![log.cameras()[a.camera].clone()] } else { vec![] };
                observation.cameras = if vision { vec![observation.cameras.swap_remove(a.camera)] } else { vec![] };
                let images = PerFinger::from_fn(|f| {
                    touch.then(|| perception::TouchImages {
                        depth_m: &truth.touch[f].depth_m,
                        contact: &truth.touch[f].contact,
                    })
                });
                let (depth, _) =
                    perception::depth_frame(&observation, images, &cams, side, &perception::Config::default()).unwrap();
                if sender.send((depth, truth.object_pose)).is_err() {
                    return;
                }
            }
        });
        for (depth, object_pose) in receiver {
            let slam = slam.get_or_insert_with(|| {
                if a.mode == "slam" || a.mode == "map" {
                    slam::Slam::new(config.clone(), side, 0).unwrap()
                } else {
                    let b = object.mesh.bounds_m();
                    let t = std::time::Instant::now();
                    let shape = KnownShape::new(exact.as_ref(), b);
                    println!("known shape in {:?}", t.elapsed());
                    let p = object_pose.untyped();
                    let d = slam::se3::exp(&slam::se3::Twist::new(0.006, -0.006, 0.005, 0.1, -0.1, 0.1));
                    let start: Isometry<Model, World> = Isometry::new(p * d);
                    let start = if a.mode == "find" { None } else { Some(start) };
                    slam::Slam::with_shape(config.clone(), side, 0, shape, [b[0], b[1]], start)
                }
            });
            let e = if a.mode == "map" {
                slam.step_at(&depth, Isometry::new(object_pose.untyped()))
            } else {
                slam.step(&depth)
            };
            let g = *gauge.get_or_insert_with(|| {
                if a.mode == "slam" { object_pose.inverse() * e.pose } else { Isometry::identity() }
            });
            // estimate of object pose
            let est: Isometry<Object, World> = e.pose * g.inverse();
            ttrack += e.spent.track.as_secs_f64();
            tmap += e.spent.map.as_secs_f64();
            lost += usize::from(e.state == slam::State::Lost);
            frames += 1.0;
            let adds = if e.frame % 5 != 0 && !a.verbose && e.frame != a.frames - 1 {
                continue;
            } else {
                truth_surface.add_s(object_pose.inverse() * est).one_directional_m * 1e3
            };
            errors.push(adds);
            ttrack += e.spent.track.as_secs_f64();
            tmap += e.spent.map.as_secs_f64();
            lost += usize::from(e.state == slam::State::Lost);
            if let Some((_, before, _)) = last {
                let b: Isometry<Object, World> = before;
                let d = slam::se3::log(&(b.inverse() * object_pose).untyped());
                if a.verbose && (1..32).contains(&e.frame) {
                    println!(
                        "{} moved {:.2} mm {:.2} deg, err {:.2} conf {:.2}",
                        e.frame,
                        d.fixed_rows::<3>(0).norm() * 1e3,
                        d.fixed_rows::<3>(3).norm().to_degrees(),
                        adds,
                        e.confidence
                    );
                }
            }
            if a.verbose && e.frame % 30 == 0 {
                let d = slam::se3::log(&(object_pose.inverse() * est).untyped());
                println!(
                    "{:4} adds {:.2} conf {:.2} {:?} dpos {:.2} mm drot {:.2} deg  kf {}",
                    e.frame,
                    adds,
                    e.confidence,
                    e.state,
                    d.fixed_rows::<3>(0).norm() * 1e3,
                    d.fixed_rows::<3>(3).norm().to_degrees(),
                    slam.map().map_or(0, |m| m.keyframes().len())
                );
            }
            last = Some((est, object_pose, g));
        }
        Ok(())
    })?;
    let n = errors.len() as f64;
    let mean = errors.iter().sum::<f64>() / n;
    let mut sorted = errors.clone();
    sorted.sort_by(f64::total_cmp);
    let wall = t0.elapsed().as_secs_f64();
    let mut f = String::new();
    if let (Some(map), Some((est, truth, g))) = (slam.as_ref().and_then(|s| s.map()), last) {
        let t = std::time::Instant::now();
        let half = map.field().config().half_extent_m;
        let mesh = slam::surface::extract(map.field(), [Vec3::splat(-half), Vec3::splat(half)], 0.0015, &|_| true);
        let mesh = slam::surface::largest_component(&mesh);
        let te = t.elapsed();
        let m = map.field_from_model().inverse();
        let mut mesh = mesh;
        for v in &mut mesh.vertices {
            let q = m * nalgebra::Point3::new(v.x as f64, v.y as f64, v.z as f64);
            *v = Vec3::new(q.x as f32, q.y as f32, q.z as f32);
        }
        let surface = TrueSurface::new(&object.mesh, 100_000, 0);
        let points = sample_surface(&mesh, 100_000, 1);
        let s = surface.score(&points, truth.inverse() * est * g, &THRESHOLDS_M);
        let s0 = surface.score(&points, g, &THRESHOLDS_M);
        f = format!(
            "F1 {:.3} F2 {:.3} F5 {:.3} (P {:.3} R {:.3}) gaugeF5 {:.3} F2 {:.3} mesh {:?} {} faces",
            s.f_scores[0].f(),
            s.f_scores[1].f(),
            s.f_scores[2].f(),
            s.f_scores[2].precision,
            s.f_scores[2].recall,
            s0.f_scores[2].f(),
            s0.f_scores[1].f(),
            te,
            mesh.faces.len()
        );
        if let Some(path) = &a.mesh {
            let mut text = String::new();
            for v in &mesh.vertices {
                text += &format!("v {} {} {}\n", v.x, v.y, v.z);
            }
            for t in &mesh.faces {
                text += &format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1);
            }
            std::fs::write(path, text)?;
        }
    }
    println!(
        "{:22} {} {} cam{} mean {:.2} median {:.2} p95 {:.2} final {:.2} lost {} | track {:.1} map {:.1} ms/frame, {:.1} fps | {f}",
        object.name,
        a.mode,
        a.modality,
        a.camera,
        mean,
        sorted[sorted.len() / 2],
        sorted[sorted.len() * 95 / 100],
        errors[errors.len() - 1],
        lost,
        1e3 * ttrack / frames,
        1e3 * tmap / frames,
        frames / wall
    );
    Ok(())
}
