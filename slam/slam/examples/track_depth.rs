//! Tracks an object from depth images and a mask alone: `cargo run --release --example track_depth -- FOLDER`.
//!
//! FOLDER holds `000000_depth.png` (16-bit, millimetres) and `000000_mask.png` (white where the object is), numbered from 0, of a
//! RealSense-like camera. Poses go to standard output, the mesh to FOLDER/mesh.obj.

#![expect(clippy::print_stdout, reason = "a program that prints")]

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use mvt_frames::camera::Intrinsics;
use mvt_frames::depth::{CameraDepth, Label};
use mvt_frames::{Isometry, ndarray::Array2};
use mvt_slam::{Slam, scan::Measurement};

fn main() -> Result<()> {
    let folder = PathBuf::from(std::env::args().nth(1).context("usage: track_depth FOLDER")?);
    let mut slam = Slam::builder().seed(1).build()?;
    for frame in 0.. {
        let open = |what: &str| image::open(folder.join(format!("{frame:06}_{what}.png")));
        let (Ok(depth), Ok(mask)) = (open("depth"), open("mask")) else { break };
        let (depth, mask) = (depth.into_luma16(), mask.into_luma8());
        let (width, height) = (depth.width() as usize, depth.height() as usize);
        let intrinsics = Intrinsics::from_fov_y(width, height, 42.5_f64.to_radians());
        let depth_m = Array2::from_shape_vec((height, width), depth.iter().map(|&mm| f32::from(mm) * 1e-3).collect())?;
        let label = |&level: &u8| if level > 127 { Label::Object } else { Label::Background };
        let labels = Array2::from_shape_vec((height, width), mask.iter().map(label).collect())?;
        let view = CameraDepth { intrinsics, world_from_camera: Isometry::identity(), depth_m, labels, colour: None };
        let time_s = f64::from(frame) / 30.0;
        let estimate = slam.observe(&Measurement { time_s, cameras: &[Some(view)], touch: &[], obstacles: &[] });
        println!("{time_s:.3} s  {:?}  confidence {:.2}  {:?}", estimate.state, estimate.confidence, estimate.pose);
    }
    let mesh = slam.mesh(0.001).context("the object was never seen")?;
    let obj = mvt_mesh::encode_obj(&mesh, &["metres"]);
    std::fs::write(folder.join("mesh.obj"), obj).context("cannot write mesh.obj")
}
