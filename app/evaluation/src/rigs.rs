//! `rigs` and `hand check`: the hands that the program can move, and whether a hand file is right.

use std::io::Cursor;
use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::Args;
use image::{ImageFormat, RgbImage, imageops};
use mvt_frames::camera::PosedCamera;
use mvt_frames::{Isometry, Object as ObjectFrame, Point, World};
use mvt_hands::{HandFile, LoadedHand, load_rig};
use mvt_objects::catalogue;
use mvt_picture::{draw, palette, text};
use mvt_render::camera::{CameraScratch, Renderer};
use mvt_robot::hand::{ALLEGRO_DIGIT, Hand, Joint, JointMotion, Side};
use mvt_robot::rig::PLACEMENTS;
use mvt_run::io::{check_named, print_line, write_named};
use serde::Serialize;

/// List the rigs: hands with their touch sensors
///
/// Each name is one for --rig. Another hand is a file: see docs/rigs.md and `hand check`.
#[derive(Debug, Args)]
pub struct RigsArguments {
    /// Print one JSON array instead of words
    #[arg(long)]
    json: bool,
}

/// Read a hand file, name its joints and pads, and draw them
///
/// Reads the TOML file with its MJCF or URDF, says what was left out and what looks wrong, and writes a picture of the hand at rest from four
/// sides. An arrow leaves each gel in the direction in which it looks.
#[derive(Debug, Args)]
pub struct HandCheckArguments {
    /// Hand file (.toml), or a name that `rigs` lists
    #[arg(value_name = "FILE|NAME")]
    rig: String,
    /// File for the picture (.png)
    #[arg(long, value_name = "PNG")]
    picture: Option<PathBuf>,
    /// Replace an existing picture
    #[arg(long, requires = "picture")]
    overwrite: bool,
    /// Print one JSON object instead of words: the whole description of the hand
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct RigLine {
    name: &'static str,
    pads: Vec<String>,
}

/// Prints the list.
///
/// # Errors
/// If a shipped hand file is invalid, or the output is closed.
pub fn list(arguments: &RigsArguments) -> Result<()> {
    let allegro = Hand::allegro(Side::Left);
    let of_allegro = RigLine { name: ALLEGRO_DIGIT, pads: allegro.pads().iter().map(|pad| pad.name.clone()).collect() };
    // The files alone: models are fetched when they are used.
    let of_files = HandFile::shipped().map(|name| -> Result<RigLine> {
        let file = HandFile::read(name)?;
        let pads = file.pads.into_iter().map(|pad| pad.name).collect();
        Ok(RigLine { name, pads })
    });
    let lines: Vec<RigLine> = std::iter::once(Ok(of_allegro)).chain(of_files).collect::<Result<_>>()?;
    if arguments.json {
        return print_line(&serde_json::to_string(&lines)?);
    }
    for RigLine { name, pads } in &lines {
        let default = if *name == ALLEGRO_DIGIT { " (default)" } else { "" };
        print_line(&format!("{name:<16} touch sensors {}{default}", pads.join(", ")))?;
    }
    print_line("next: choose one with --rig NAME, or check your own with `mambavitact hand check FILE.toml`")
}

/// Runs `hand check`.
pub(crate) fn check(arguments: &HandCheckArguments) -> Result<()> {
    if let Some(path) = &arguments.picture {
        check_named(path, arguments.overwrite)?;
    }
    let rig = load_rig(&arguments.rig, None)?;
    if let Some(path) = &arguments.picture {
        let mut png = Cursor::new(Vec::new());
        picture(&rig)?.write_to(&mut png, ImageFormat::Png)?;
        write_named(path, png.get_ref(), arguments.overwrite)?;
    }
    if arguments.json { print_line(&serde_json::to_string(rig.hand.description())?) } else { in_words(&rig) }
}

fn in_words(rig: &LoadedHand) -> Result<()> {
    let hand = &rig.hand;
    let counts =
        [(hand.joints().len(), "joints"), (hand.pads().len(), "touch sensors"), (rig.cameras.len(), "cameras")];
    let counts: Vec<String> = counts.iter().map(|(count, what)| format!("{count} {what}")).collect();
    print_line(&format!("{}, {} hand: {}", hand.name(), hand.side().name(), counts.join(", ")))?;
    for (j, joint) in hand.joints().iter().enumerate() {
        let of = |(name, joints): (&String, &Vec<usize>)| joints.contains(&j).then(|| format!(", finger {name}"));
        let finger = rig.fingers.iter().find_map(of).unwrap_or_default();
        print_line(&format!("  joint {j:>2} {:<16} {}{finger}", joint.name, range(joint)))?;
    }
    for (pad, sensor) in hand.pads().iter().enumerate() {
        let carrier = hand.bodies().get(sensor.body).map_or("", |body| &body.name);
        let moved = hand.pad_chain(pad).len();
        print_line(&format!("  pad   {pad:>2} {:<16} on {carrier}, moved by {moved} joints", sensor.name))?;
    }
    for camera in &rig.cameras {
        let [x, y, z]: [f64; 3] = camera.pose.origin().coords().into();
        let size = (camera.intrinsics.width, camera.intrinsics.height);
        print_line(&format!(
            "  camera {:<18} {} x {} pixels at ({x:.3}, {y:.3}, {z:.3}) m",
            camera.name, size.0, size.1
        ))?;
    }
    let palm = match hand.palm_centre_m() {
        Some([x, y, z]) => format!("  palm at ({x:.3}, {y:.3}, {z:.3}) m"),
        None => "  no palm: objects are held between the fingers".to_owned(),
    };
    print_line(&palm)
}

fn range(joint: &Joint) -> String {
    let [low, high] = joint.range;
    match joint.motion {
        JointMotion::Hinge => format!("turns {:.0} to {:.0} degrees", low.to_degrees(), high.to_degrees()),
        JointMotion::Slide => format!("slides {:.0} to {:.0} mm", 1e3 * low, 1e3 * high),
    }
}

/// Length of the arrows from the gels, metres.
const ARROW_M: f64 = 0.035;

/// Draws the hand at rest from the four named places, with an arrow out of each gel.
fn picture(rig: &LoadedHand) -> Result<RgbImage> {
    let hand = &rig.hand;
    let joints = hand.within_ranges(&vec![0.0; hand.joints().len()]);
    // The renderer needs an object; it stands out of sight.
    let object = catalogue::load("cube70", &mut Vec::new())?;
    let away = Isometry::<ObjectFrame, World>::translation(0.0, 0.0, -100.0);
    let renderer = Renderer::new(hand, &object);
    let views = PLACEMENTS.iter().map(|place| {
        let camera = place.camera(hand);
        let mut image = renderer.render(&camera, &joints, away, &mut CameraScratch::default()).rgbd.color;
        arrows(&mut image, &camera, hand, &joints);
        text::write(&mut image, (12, 10), 20.0, palette::UNSEEN, &place.name);
        image
    });
    let views: Vec<RgbImage> = views.collect();
    let first = views.first().context("there is no place to look from")?;
    let (width, height) = first.dimensions();
    let mut sheet = RgbImage::new(2 * width, 2 * height);
    for (k, view) in (0..).zip(&views) {
        imageops::replace(&mut sheet, view, i64::from(k % 2 * width), i64::from(k / 2 * height));
    }
    Ok(sheet)
}

fn arrows(image: &mut RgbImage, camera: &PosedCamera, hand: &Hand, joints: &[f64]) {
    for (pad, world_from_gel) in hand.world_from_gels(joints).into_iter().enumerate() {
        let pixel = |x_m: f64| {
            let point = camera.pose.inverse() * (world_from_gel * Point::new(x_m, 0.0, 0.0));
            camera.intrinsics.project(point).map(|(u, v)| [u as f32, v as f32])
        };
        if let (Some(from), Some(to)) = (pixel(0.0), pixel(ARROW_M)) {
            draw::arrow(image, from, to, 3.0, palette::pad_colour(pad));
            let name = hand.pads().get(pad).map_or("", |pad| &pad.name);
            let place = to.map(|p| p.clamp(0.0, image.width() as f32 - 90.0) as u32 + 4);
            text::write(image, place.into(), 15.0, palette::pad_colour(pad), name);
        }
    }
}
