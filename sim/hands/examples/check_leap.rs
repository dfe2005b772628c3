//! Loads the LEAP hand, which it fetches at first, compares its kinematics with MuJoCo's, and prints its joints and pads.

#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a program for people who look at the hand")]

#[path = "../tests/common/mod.rs"]
mod common;

use anyhow::{Result, ensure};
use mujoco_rs::prelude::*;
use mvt_hands::HandFile;
use mvt_robot::nalgebra::Vector3;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

fn main() -> Result<()> {
    let loaded = HandFile::load("leap_digit")?;
    for warning in &loaded.warnings {
        println!("warning: {warning}");
    }
    for joint in loaded.hand.joints() {
        println!("{:8} {:6.3} to {:6.3} rad", joint.name, joint.range[0], joint.range[1]);
    }
    let rest = loaded.hand.within_ranges(&vec![0.0; loaded.hand.joints().len()]);
    for (pad, gel) in loaded.hand.pads().iter().zip(loaded.hand.world_from_gels(&rest)) {
        let (at, out) = (gel.origin().coords(), gel.untyped().rotation * Vector3::x());
        println!(
            "pad {:7} at {:6.1} {:6.1} {:6.1} mm, faces {:5.2} {:5.2} {:5.2}",
            pad.name,
            1e3 * at.x,
            1e3 * at.y,
            1e3 * at.z,
            out.x,
            out.y,
            out.z
        );
    }
    let model = MjModel::from_xml(&loaded.model)?;
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let worst = common::greatest_difference(&loaded, &model, Some("palm"), || random.random());
    println!("greatest difference to MuJoCo: {worst:.1e} m or rad");
    ensure!(worst < 1e-9, "the kinematics differ from MuJoCo's");
    Ok(())
}
