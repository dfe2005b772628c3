//! Our touch images against TACTO's own, for the scenes in data/tacto (see the README there).
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stderr)]

use std::collections::HashMap;
use std::path::PathBuf;

use glam::Vec3;
use image::RgbImage;
use mvt_frames::{Gel, Isometry, Object};
use mvt_mesh::{Format, Mesh, read_bytes, repair};
use mvt_objects::catalogue;
use mvt_render::rays::RayMesh;
use mvt_render::touch::{Background, TouchConfig, TouchFrame, TouchOptions, TouchRenderer};
use mvt_robot::digit::{HEIGHT, WIDTH};
use ndarray::Array2;
use serde::Deserialize;

#[derive(Deserialize)]
struct Scene {
    name: String,
    config: String,
    #[serde(rename = "T_sensor_object")]
    sensor_from_object: Option<[[f64; 4]; 4]>,
    sphere_radius_m: Option<f32>,
    mesh: Option<String>,
}

/// Images that TACTO rendered.
struct Reference {
    raw: RgbImage,
    calibrated: Option<RgbImage>,
    depth_m: Array2<f32>,
}

/// Says that a test is skipped, and fails where every test must run. Written past the test harness, which hides what passing tests say.
fn skip(reason: impl std::fmt::Display) {
    use std::io::Write as _;
    let _ = writeln!(std::io::stderr(), "SKIPPED: {reason}");
    assert!(
        std::env::var_os("REQUIRE_ALL").is_none_or(|value| value != "1"),
        "REQUIRE_ALL=1 allows no skipped test: {reason}"
    );
}

fn data(file: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data/tacto").join(file)
}

fn scenes() -> Vec<Scene> {
    serde_json::from_slice(&std::fs::read(data("scenes.json")).unwrap()).unwrap()
}

impl Scene {
    fn config(&self) -> TouchConfig {
        self.config.parse().unwrap()
    }

    fn reference(&self) -> Reference {
        let open = |kind: &str| image::open(data(&format!("{}_{kind}.png", self.name)));
        // Both configurations have the same untouched gel.
        let depth = open("depth").or_else(|_| image::open(data("fork_empty_depth.png"))).unwrap().into_luma16();
        let depth_m = depth.as_raw().iter().map(|&q| (0.018 + f64::from(q) * 1e-7) as f32).collect();
        Reference {
            raw: open("raw").unwrap().into_rgb8(),
            calibrated: open("calibrated").ok().map(image::DynamicImage::into_rgb8),
            depth_m: Array2::from_shape_vec((HEIGHT, WIDTH), depth_m).unwrap(),
        }
    }

    /// The object and its pose; `None` for the untouched gel, and with a message if the mesh is not on this machine.
    fn object(&self) -> Option<(RayMesh, Isometry<Object, Gel>)> {
        let sensor_from_object = Isometry::<Object, Gel>::from_matrix(&self.sensor_from_object?).unwrap();
        let mesh = match (self.sphere_radius_m, &self.mesh) {
            (Some(radius), _) => icosphere(radius, 5),
            (None, Some(file)) => {
                let name = file.trim_end_matches(".stl");
                let bytes = match catalogue::ycb_library().and_then(|library| library.read(name)) {
                    Ok(bytes) => bytes,
                    Err(error) => {
                        skip(format!("scene {}: {error}", self.name));
                        return None;
                    }
                };
                repair(&read_bytes(&bytes, Format::Stl, file).unwrap().0, file).unwrap().0
            }
            (None, None) => panic!("{} has no object", self.name),
        };
        Some((RayMesh::new(&mesh), self.config().gel_from_sensor() * sensor_from_object))
    }
}

/// trimesh's sphere: an icosahedron whose faces are divided by four, new vertices moved onto the sphere each time.
fn icosphere(radius: f32, subdivisions: usize) -> Mesh {
    let t = (1.0 + 5.0_f64.sqrt()) / 2.0;
    let on_sphere = |v: glam::DVec3| v.normalize();
    let mut vertices: Vec<glam::DVec3> = Vec::new();
    for (a, b) in [(-1.0, t), (1.0, t), (-1.0, -t), (1.0, -t)] {
        vertices.push(glam::dvec3(a, b, 0.0));
    }
    for (a, b) in [(-1.0, t), (1.0, t), (-1.0, -t), (1.0, -t)] {
        vertices.push(glam::dvec3(0.0, a, b));
    }
    for (a, b) in [(-1.0, t), (1.0, t), (-1.0, -t), (1.0, -t)] {
        vertices.push(glam::dvec3(b, 0.0, a));
    }
    vertices.iter_mut().for_each(|v| *v = on_sphere(*v));
    // Any three vertices that are mutual neighbours, turned outwards.
    let near = |a: usize, b: usize| vertices[a].distance(vertices[b]) < 1.1;
    let mut faces: Vec<[u32; 3]> = Vec::new();
    for (a, b, c) in (0..12).flat_map(|a| (a + 1..12).flat_map(move |b| (b + 1..12).map(move |c| (a, b, c)))) {
        if near(a, b) && near(b, c) && near(c, a) {
            let outward = (vertices[b] - vertices[a]).cross(vertices[c] - vertices[a]).dot(vertices[a]) > 0.0;
            let [b, c] = if outward { [b, c] } else { [c, b] };
            faces.push([a, b, c].map(|i| i as u32));
        }
    }
    assert_eq!(faces.len(), 20);
    for _ in 0..subdivisions {
        let mut middles = HashMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                vertices.push(on_sphere(vertices[a as usize] + vertices[b as usize]));
                vertices.len() as u32 - 1
            })
        };
        faces = faces
            .iter()
            .flat_map(|&[a, b, c]| {
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    Mesh { vertices: vertices.iter().map(|v| v.as_vec3() * radius).collect::<Vec<Vec3>>(), faces }
}

/// The flat grey that the calibrated references are laid over.
fn grey() -> Background {
    Background::Image(RgbImage::from_pixel(WIDTH as u32, HEIGHT as u32, image::Rgb([128; 3])))
}

fn rms_um(pairs: impl Iterator<Item = (f32, f32)>) -> f64 {
    let (count, sum) = pairs.fold((0, 0.0), |(n, sum), (a, b)| (n + 1, sum + (f64::from(a) - f64::from(b)).powi(2)));
    if count == 0 { 0.0 } else { (sum / f64::from(count)).sqrt() * 1e6 }
}

/// The 99.9th percentile of the greatest difference of any channel over the pixels where `compared` holds.
fn percentile(ours: &RgbImage, theirs: &RgbImage, compared: impl Fn(usize) -> bool) -> u8 {
    let difference = |(a, b): (&[u8], &[u8])| a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
    let pairs = ours.as_raw().chunks(3).zip(theirs.as_raw().chunks(3)).enumerate();
    let mut differences: Vec<u8> = pairs.filter(|(i, _)| compared(*i)).map(|(_, pair)| difference(pair)).collect();
    differences.sort_unstable();
    differences[differences.len() * 999 / 1000]
}

#[test]
fn scenes_agree_with_tacto() {
    let empty = TouchRenderer::new(&TouchOptions::new(TouchConfig::Fork)).unwrap().gel_depth_m();
    let empty_gel = scenes().iter().find(|s| s.name == "fork_empty").unwrap().reference().depth_m;
    let gel_rms = rms_um(empty.iter().copied().zip(empty_gel.iter().copied()));
    assert!(gel_rms < 1.0, "empty gel: depth differs by {gel_rms} um");

    for scene in scenes() {
        let object = scene.object();
        if object.is_none() && scene.sensor_from_object.is_some() {
            continue;
        }
        let options = TouchOptions { background: grey(), ..TouchOptions::new(scene.config()) };
        let renderer = TouchRenderer::new(&options).unwrap();
        let (mesh, pose) = object.unwrap_or_else(|| (RayMesh::new(&Mesh::default()), Isometry::identity()));
        let mut frame = TouchFrame::default();
        renderer.render(&mesh, pose, None, &mut frame);
        if let Ok(folder) = std::env::var("TOUCH_PARITY_OUT") {
            frame.raw().save(format!("{folder}/{}_raw.png", scene.name)).unwrap();
            frame.calibrated().save(format!("{folder}/{}_cal.png", scene.name)).unwrap();
        }

        let reference = scene.reference();
        let in_contact: Vec<bool> = reference.depth_m.iter().zip(&empty_gel).map(|(d, gel)| *d < gel - 1e-6).collect();
        let on_ring = |i: usize| {
            let (u, v) = ((i % WIDTH) as isize, (i / WIDTH) as isize);
            (-1..=1).flat_map(|dv| (-1..=1).map(move |du| (u + du, v + dv))).any(|(u, v)| {
                (0..WIDTH as isize).contains(&u)
                    && (0..HEIGHT as isize).contains(&v)
                    && in_contact[v as usize * WIDTH + u as usize] != in_contact[i]
            })
        };
        let depth_rms = |contact: bool| {
            let pairs = frame.depth_m().iter().copied().zip(reference.depth_m.iter().copied()).enumerate();
            rms_um(pairs.filter(|(i, _)| in_contact[*i] == contact && !on_ring(*i)).map(|(_, pair)| pair))
        };
        let (gel_rms, contact_rms) = (depth_rms(false), depth_rms(true));
        let raw = percentile(frame.raw(), &reference.raw, |i| !on_ring(i));
        let calibrated = reference.calibrated.map_or(0, |c| percentile(frame.calibrated(), &c, |i| !on_ring(i)));
        println!(
            "{:30} depth rms {gel_rms:.3} um on the gel, {contact_rms:.3} um in contact; 99.9 % of colours within {raw}, calibrated {calibrated}",
            scene.name
        );
        assert!(
            gel_rms < 1.0 && contact_rms < 2.0,
            "{}: {gel_rms} um on the gel, {contact_rms} in contact",
            scene.name
        );
        assert!(raw <= 1 && calibrated <= 1, "{}: colours differ by {raw}, calibrated by {calibrated}", scene.name);
    }
}
