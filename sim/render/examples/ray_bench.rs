//! Times the ray caster on one thread for the rays of a DIGIT close-up and of a camera view.
//!
//! Usage: `cargo run --release -p mvt-render --example ray_bench -- [--dump] [--mesh FILE.stl] [--set N] FOLDER`
//!
//! It prints one line per view: name, rays, hits, CPU seconds of the fastest repetition. `--dump` writes triangles and
//! rays to FOLDER/<view>.bin, which `benches/embree` reads. `--mesh FILE.stl` takes that mesh as the object in place of
//! a procedural one. `--set N` takes the Nth instruction set of this machine, from 0 (portable).
#![allow(clippy::print_stdout)]

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, bail};
use glam::Vec3;
use mvt_frames::camera::{Intrinsics, look_at};
use mvt_frames::{Camera, Isometry, Object, World};
use mvt_mesh::Mesh;
use mvt_render::rays::{Caster, Faces, Hits, Instance, MISS, PixelWindow, RayInstructions, RayMesh};
use mvt_render::tessellation::tessellate;
use mvt_robot::digit;
use mvt_robot::hand::{Hand, Primitive, Side, UPRIGHT};
use nalgebra as na;

struct View {
    name: &'static str,
    eye: Isometry<Camera, World>,
    intrinsics: Intrinsics,
    /// Number of instances in the view, counted from the first.
    instances: usize,
}

fn main() -> anyhow::Result<()> {
    let (mut dump, mut mesh, mut instructions, mut dir) = (false, None, RayInstructions::best(), None);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--dump" => dump = true,
            "--mesh" => mesh = Some(arguments.next().context("--mesh needs a file")?),
            "--set" => {
                let k: usize = arguments.next().context("--set needs a number")?.parse()?;
                let sets = RayInstructions::available();
                instructions =
                    *sets.get(k).with_context(|| format!("this machine has the sets 0 to {}", sets.len() - 1))?;
            }
            _ => dir = Some(argument),
        }
    }
    let dir = dir.context("usage: ray_bench [--dump] [--mesh FILE.stl] [--set N] FOLDER")?;
    let object = match mesh {
        Some(path) => read_stl(Path::new(&path))?,
        None => blob(),
    };

    let grasp = [-0.0475, 0.0, 0.0561];
    let mut scene = vec![(object, Isometry::<Object, World>::translation(grasp[0], grasp[1], grasp[2]))];
    let hand = Hand::allegro(Side::Right);
    let joints: Vec<f64> = (0..hand.joints().len()).map(|k| if k % 4 == 0 { 0.0 } else { 0.6 }).collect();
    let poses = hand.body_poses(&joints);
    for (body, part) in hand.parts() {
        scene.push((tessellate(&part.shape, 96), Isometry::new(poses[body])));
    }
    let meshes: Vec<RayMesh> = scene.iter().map(|(mesh, _)| RayMesh::new(mesh)).collect();

    // 22 mm in front of the point of the object that lies furthest towards the side.
    let side = na::Vector3::new(0.3, 1.0, 0.5).normalize();
    let along = |p: &Vec3| f64::from(p.x) * side.x + f64::from(p.y) * side.y + f64::from(p.z) * side.z;
    let touched =
        scene[0].0.vertices.iter().max_by(|a, b| along(a).total_cmp(&along(b))).context("the mesh is empty")?;
    let touched =
        na::Vector3::new(f64::from(touched.x), f64::from(touched.y), f64::from(touched.z)) + na::Vector3::from(grasp);
    let views = [
        View {
            name: "close-up",
            eye: look_at(touched + side * 0.022, touched, na::Vector3::z()),
            intrinsics: digit::intrinsics(),
            instances: 1,
        },
        View {
            name: "camera",
            eye: look_at(na::Vector3::new(-0.0475, 0.2475, 0.2586), grasp.into(), na::Vector3::z()),
            intrinsics: Intrinsics::from_fov_y(640, 480, 45f64.to_radians()),
            instances: scene.len(),
        },
    ];
    let mut caster = Caster::new(instructions);
    for view in &views {
        let instances: Vec<Instance<'_>> = meshes[..view.instances]
            .iter()
            .zip(&scene)
            .map(|(mesh, (_, pose))| Instance::new(mesh, view.eye.inverse() * *pose))
            .collect();
        let mut hits = Hits::new(PixelWindow::whole(&view.intrinsics));
        let mut fastest = f64::INFINITY;
        let started = Instant::now();
        while started.elapsed().as_secs_f64() < 0.7 {
            let start = cpu_seconds();
            hits.reset(PixelWindow::whole(&view.intrinsics));
            caster.cast(&instances, &view.intrinsics, Faces::Both, &mut hits);
            fastest = fastest.min(cpu_seconds() - start);
        }
        let hit = hits.triangle().iter().filter(|&&t| t != MISS).count();
        println!("{} {} {hit} {fastest:.6}", view.name, hits.depth().len());
        if dump {
            write(&Path::new(&dir).join(format!("{}.bin", view.name)), &scene[..view.instances], view, hits.depth())?;
        }
    }
    Ok(())
}

/// Returns the CPU time of this thread, seconds: other programs on the machine hardly change it.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Writes a view, little-endian: number of instances; of each 12 floats (rows of the 3 x 4 pose), numbers of vertices
/// and faces, vertices, faces; width, height, origin, then for each ray its direction (as long as one unit of depth)
/// and our depth.
fn write(path: &Path, scene: &[(Mesh, Isometry<Object, World>)], view: &View, depth: &[f32]) -> anyhow::Result<()> {
    let mut out = BufWriter::new(File::create(path).with_context(|| path.display().to_string())?);
    let mut word = |bytes: [u8; 4]| out.write_all(&bytes);
    word((scene.len() as u32).to_le_bytes())?;
    for (mesh, pose) in scene {
        for value in pose.to_matrix()[..3].iter().flatten() {
            word((*value as f32).to_le_bytes())?;
        }
        word((mesh.vertices.len() as u32).to_le_bytes())?;
        word((mesh.faces.len() as u32).to_le_bytes())?;
        for value in mesh.vertices.iter().flat_map(Vec3::to_array) {
            word(value.to_le_bytes())?;
        }
        for index in mesh.faces.iter().flatten() {
            word(index.to_le_bytes())?;
        }
    }
    let k = view.intrinsics;
    word((k.width as u32).to_le_bytes())?;
    word((k.height as u32).to_le_bytes())?;
    for value in view.eye.origin().coords().iter() {
        word((*value as f32).to_le_bytes())?;
    }
    for (pixel, depth) in depth.iter().enumerate() {
        let direction = k.unproject((pixel % k.width) as f64, (pixel / k.width) as f64, 1.0).coords();
        for value in (view.eye.untyped().rotation * direction).iter() {
            word((*value as f32).to_le_bytes())?;
        }
        word(depth.to_le_bytes())?;
    }
    Ok(())
}

/// Returns a bumpy body of 16,000 triangles, 75 mm across.
fn blob() -> Mesh {
    let mut mesh =
        tessellate(&Primitive::Ellipsoid { centre: [0.0; 3], semi: [0.032; 3], orientation_wxyz: UPRIGHT }, 128);
    for p in &mut mesh.vertices {
        let d = p.normalize();
        *p *= 1.0 + 0.1 * (7.0 * d.x).sin() * (5.0 * d.y + 1.0).cos() + 0.07 * (9.0 * d.z).sin();
    }
    mesh
}

/// Reads a binary STL with equal vertices merged, centred on its bounding box.
fn read_stl(path: &Path) -> anyhow::Result<Mesh> {
    let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
    let (mut mesh, mut known) = (Mesh::default(), std::collections::HashMap::new());
    let facets = bytes.get(84..).context("too short for a binary STL")?;
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for facet in facets.chunks_exact(50) {
        let value = |k: usize| f32::from_le_bytes([facet[k], facet[k + 1], facet[k + 2], facet[k + 3]]);
        let corner = |k: usize| Vec3::new(value(12 * k + 12), value(12 * k + 16), value(12 * k + 20));
        mesh.faces.push([0, 1, 2].map(|k| {
            let p = corner(k);
            (low, high) = (low.min(p), high.max(p));
            *known.entry(p.to_array().map(f32::to_bits)).or_insert_with(|| {
                mesh.vertices.push(p);
                mesh.vertices.len() as u32 - 1
            })
        }));
    }
    if mesh.faces.is_empty() {
        bail!("{} holds no triangle", path.display());
    }
    for p in &mut mesh.vertices {
        *p -= (low + high) / 2.0;
    }
    Ok(mesh)
}
