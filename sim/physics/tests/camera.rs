//! Compares the rendered depth with MuJoCo's camera rangefinder, and images with each other.

use std::fmt::Write as _;

use mujoco_rs::prelude::*;
use mvt_frames::Isometry;
use mvt_frames::camera::{Intrinsics, PosedCamera};
use mvt_frames::depth::Label;
use mvt_mesh::Mesh;
use mvt_objects::object::Object;
use mvt_render::camera::{CameraScratch, Renderer};
use mvt_render::tessellation::tessellate;
use mvt_robot::hand::{Hand, Primitive, Side, UPRIGHT};
use mvt_robot::rig::PLACEMENTS;
use nalgebra as na;

const JOINTS: [f64; 16] = [0.1, 0.7, 0.8, 0.6, 0.0, 0.6, 0.9, 0.5, -0.1, 0.8, 0.7, 0.6, 1.2, 0.4, 0.5, 0.6];

fn object() -> Object {
    let mut mesh = tessellate(
        &Primitive::Ellipsoid { centre: [0.0; 3], semi: [0.03, 0.025, 0.035], orientation_wxyz: UPRIGHT },
        48,
    );
    for p in &mut mesh.vertices {
        let d = p.normalize();
        *p *= 1.0 + 0.12 * (6.0 * d.x).sin() * (5.0 * d.y + 1.0).cos();
    }
    Object {
        name: "blob".into(),
        mesh,
        exact: None,
        object_from_file: Isometry::identity(),
        collision: vec![],
        mass_kg: 0.1,
    }
}

fn object_pose() -> Isometry<mvt_frames::Object, mvt_frames::World> {
    Isometry::from_parts([-0.04, 0.005, 0.05], [0.9, 0.1, -0.3, 0.2])
}

fn small(camera: PosedCamera) -> PosedCamera {
    PosedCamera { intrinsics: Intrinsics::from_fov_y(320, 240, 45f64.to_radians()), ..camera }
}

fn list(values: impl IntoIterator<Item = f64>) -> String {
    values.into_iter().fold(String::new(), |mut text, value| {
        let _ = write!(text, "{value} ");
        text
    })
}

/// Returns the depth per pixel from MuJoCo's camera rangefinder, with MuJoCo's own primitives; negative where a ray
/// hits nothing.
fn rangefinder(hand: &Hand, camera: &PosedCamera, mesh: &Mesh) -> Result<Vec<f64>, MjModelError> {
    let pose = |pose: na::Isometry3<f64>| {
        let q = pose.rotation;
        format!("pos=\"{}\" quat=\"{}\"", list(pose.translation.vector.iter().copied()), list([q.w, q.i, q.j, q.k]))
    };
    let mut bodies = format!("<body {}><geom type=\"mesh\" mesh=\"object\"/></body>", pose(object_pose().untyped()));
    let poses = hand.body_poses(&JOINTS);
    for (body, part) in hand.parts() {
        let geom = match &part.shape {
            Primitive::Box { centre, half, .. } => {
                format!("type=\"box\" pos=\"{}\" size=\"{}\"", list(*centre), list(*half))
            }
            Primitive::Ellipsoid { centre, semi, .. } => {
                format!("type=\"ellipsoid\" pos=\"{}\" size=\"{}\"", list(*centre), list(*semi))
            }
            Primitive::Capsule { from, to, radius } => {
                format!("type=\"capsule\" fromto=\"{}\" size=\"{radius}\"", list(from.iter().chain(to).copied()))
            }
            // The built-in hand has none.
            Primitive::Hull(_) => continue,
        };
        let _ = write!(bodies, "<body {}><geom {geom}/></body>", pose(poses[body]));
    }
    let k = camera.intrinsics;
    let xml = format!(
        "<mujoco><asset><mesh name=\"object\" vertex=\"{}\" face=\"{}\"/></asset><worldbody>\
         <camera name=\"eye\" {} fovy=\"45\" resolution=\"{} {}\"/>{bodies}</worldbody>\
         <sensor><rangefinder camera=\"eye\" data=\"depth\"/></sensor></mujoco>",
        list(mesh.vertices.iter().flat_map(glam::Vec3::to_array).map(f64::from)),
        list(mesh.faces.iter().flatten().map(|&i| f64::from(i))),
        pose(camera.pose.untyped()),
        k.width,
        k.height,
    );
    let model = MjModel::from_xml_string(&xml)?;
    let mut data = model.make_data();
    data.forward();
    Ok(data.sensordata().to_vec())
}

#[test]
fn depth_is_that_of_mujocos_rangefinder() {
    let object = object();
    for side in [Side::Left, Side::Right] {
        let hand = Hand::allegro(side);
        let renderer = Renderer::new(&hand, &object);
        for placement in PLACEMENTS {
            let camera = placement.camera(&hand);
            let k = camera.intrinsics;
            let expected = rangefinder(&hand, &camera, &object.mesh).unwrap();
            assert_eq!(expected.len(), k.width * k.height);
            let frame = renderer.render(&camera, &JOINTS, object_pose(), &mut CameraScratch::default());
            let found = frame.rgbd.depth_m.as_slice().unwrap();
            let (mut worst, mut compared, mut exact, mut rim) = (0.0f64, 0, 0, 0);
            let mut beyond = 0.0f64;
            for v in 1..k.height - 1 {
                for u in 1..k.width - 1 {
                    let at = |u: usize, v: usize| expected[v * k.width + u];
                    let truth = at(u, v);
                    // Away from silhouettes: the neighbours lie on the same surface or all are background.
                    let around = [at(u - 1, v), at(u + 1, v), at(u, v - 1), at(u, v + 1)];
                    let depth = f64::from(found[v * k.width + u]);
                    if truth < 0.0 {
                        if around.iter().all(|&d| d < 0.0) {
                            assert_eq!(depth, 0.0, "{} ({u}, {v})", camera.name);
                        }
                        continue;
                    }
                    if around.iter().any(|&d| d < 0.0 || (d - truth).abs() > 0.004) {
                        rim += 1;
                        continue;
                    }
                    compared += 1;
                    if (depth - truth).abs() < 1e-4 {
                        exact += 1;
                    } else {
                        let [low, high] = [f64::min, f64::max].map(|pick| around.into_iter().fold(truth, pick));
                        beyond = beyond.max((depth - depth.clamp(low, high)).abs());
                    }
                    worst = worst.max((depth - truth).abs());
                }
            }
            println!(
                "{side:?} {}: worst {:.4} mm of {compared} pixels, {exact} within 0.1 mm, {rim} on silhouettes",
                camera.name,
                worst * 1e3
            );
            assert!(compared > 20_000 && rim < compared / 3, "the comparison must cover the image");
            // The meshes of the hand are 0.03 mm off; single rays that graze one part hit the part behind it.
            assert!(500 * exact >= 499 * compared, "{}: {exact} of {compared} pixels", camera.name);
            assert!(beyond < 6e-4, "{}: a pixel is {beyond} m off the depths around it", camera.name);
        }
    }
}

#[test]
fn the_hand_hides_what_is_behind_it() {
    let object = object();
    let hand = Hand::allegro(Side::Left);
    let renderer = Renderer::new(&hand, &object);
    let camera = small(PLACEMENTS[2].camera(&hand));
    let hidden = |height_m: f64| {
        let pose = Isometry::translation(-0.0475, 0.0, height_m);
        let mut scratch = CameraScratch::default();
        let frame = renderer.render(&camera, &[0.0; 16], pose, &mut scratch);
        renderer.hidden_share(&camera, pose, &frame.labels, &mut scratch)
    };
    // From above: above the open hand, below the palm, and behind the camera.
    assert_eq!(hidden(0.15), Some(0.0));
    assert_eq!(hidden(-0.15), Some(1.0));
    assert_eq!(hidden(0.6), None);
}

#[test]
fn images_show_hand_and_object() {
    let object = object();
    let hand = Hand::allegro(Side::Left);
    let renderer = Renderer::new(&hand, &object);
    let camera = small(PLACEMENTS[3].camera(&hand));
    let frame = renderer.render(&camera, &JOINTS, object_pose(), &mut CameraScratch::default());
    for label in [Label::Background, Label::Hand, Label::Object] {
        assert!(frame.labels.iter().filter(|&&found| found == label).count() > 2_000, "{label:?}");
    }
    for (depth, label) in frame.rgbd.depth_m.iter().zip(&frame.labels) {
        assert_eq!(*depth == 0.0, *label == Label::Background);
    }
    // The pixel of the object's centre shows the object, nearer than the centre.
    let centre = camera.pose.inverse() * object_pose().origin();
    let (u, v) = camera.intrinsics.project(centre).unwrap();
    let (u, v) = (u.round() as usize, v.round() as usize);
    assert_eq!(frame.labels[(v, u)], Label::Object);
    assert!(f64::from(frame.rgbd.depth_m[(v, u)]) < -centre.coords().z - 0.02);
}
