//! `touch data`: touch images of random presses with their true indentation and contact.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, ensure};
use clap::Args;
use image::{GrayImage, ImageBuffer};
use mvt_feelsight::array::Array;
use mvt_feelsight::npy;
use mvt_files::folder::{ClaimedFolder, Earlier};
use mvt_render::touch::TouchFrame;
use mvt_robot::digit::profile::SensorProfile;
use rayon::prelude::*;
use serde::Deserialize;

use mvt_presses::{DataConfig, Example, Rack, example, objects};
use mvt_run::io::{png, print_line, shell_word, write_file};
use mvt_run::{progress, settings};

/// Render touch images of random presses, with depth and contact mask, for `touch evaluate`
///
/// DIR receives four files for each image: ID_img.png, ID_depth_m.npy (32-bit floats, rows x columns, metres along the
/// camera's axis), ID_mask.png (white where the object touches the gel) and, if the untouched image of the sensor is
/// known, ID_untouched.png.
///
/// Without --config the presses follow the protocol of MidasTouch: 0.5 to 1 mm deep, within 5 degrees of the surface
/// normal, any roll, and image noise of 2 grey levels.
#[derive(Debug, Args)]
pub struct TouchDataArguments {
    /// Objects, separated by commas: names that `assets list` shows, random:SEED, or one of the sets `train`,
    /// `validation` and `test`
    #[arg(long, value_name = "NAMES", value_delimiter = ',', default_value = "test")]
    objects: Vec<String>,
    /// Number of images
    #[arg(long, value_name = "N", default_value_t = 200)]
    images: u32,
    /// Touch sensor: tacto (a DIGIT), digit, gelsight_mini, or the path of a profile (.toml)
    #[arg(long, value_name = "NAME", default_value = "tacto")]
    profile: String,
    /// Seed of the presses, the sensors and the noise
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Training configuration (.toml) whose table `data` replaces the protocol of MidasTouch
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Folder for the images; earlier images in it are moved to DIR.1, DIR.2 and so on
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Write into a folder that contains other files; images of the same numbers are replaced
    #[arg(long)]
    overwrite: bool,
}

/// The table of a training configuration that is read.
#[derive(Deserialize)]
struct Settings {
    #[serde(default)]
    data: DataConfig,
}

/// Runs the command.
pub fn run(arguments: &TouchDataArguments) -> Result<()> {
    let config = match &arguments.config {
        None => DataConfig::protocol(),
        Some(path) => settings::read::<Settings>(path)?.data,
    };
    config.objects.check()?;
    config.validate().map_err(|error| error.within("data"))?;
    let profile = SensorProfile::load(&arguments.profile)?;
    let out = &arguments.out;
    ensure!(arguments.images > 0, "--images 0: give at least 1");
    let claimed = ClaimedFolder::claim(out, "touch data", Earlier::Move, arguments.overwrite)?;
    if let Some(moved) = claimed.moved() {
        tracing::warn!("{} contained earlier images, which are now in {}", out.display(), moved.display());
    }
    let surfaces = objects::load(&objects::resolve(&arguments.objects))?;
    let mut rack = Rack::new(&config, &profile, arguments.seed)?;
    let sensors = rack.of_step(0)?;
    let bar = progress::bar(u64::from(arguments.images), "presses");
    (0..u64::from(arguments.images)).into_par_iter().try_for_each_init(TouchFrame::default, |frame, index| {
        let example = example(&surfaces, &sensors, &config, (arguments.seed, index), frame);
        bar.inc(1);
        write(out, index, &example, frame)
    })?;
    bar.finish_and_clear();
    let images = arguments.images;
    print_line(&format!("{images} image{} in {}", if images == 1 { "" } else { "s" }, out.display()))?;
    print_line(&format!(
        "next: score a network with `mambavitact touch evaluate --weights FILE --data {}{}`",
        shell_word(&out.to_string_lossy()),
        if profile.is_tacto() { String::new() } else { format!(" --profile {}", shell_word(&arguments.profile)) }
    ))
}

/// Writes the files of an image. The image itself is the last: without it, `touch evaluate` passes over the others.
fn write(folder: &Path, index: u64, example: &Example, frame: &TouchFrame) -> Result<()> {
    let put = |what: &str, bytes: &[u8]| write_file(folder, &format!("{index:05}_{what}"), bytes);
    let depth_m = Array::from_f32(example.size.to_vec(), frame.depth_m().iter().copied());
    put("depth_m.npy", &npy::to_bytes(&depth_m))?;
    let mask = example.contact.iter().map(|&contact| if contact > 0.5 { u8::MAX } else { 0 }).collect();
    let mask: GrayImage = ImageBuffer::from_raw(example.size[1] as u32, example.size[0] as u32, mask)
        .context("the mask does not have the size of its image")?;
    put("mask.png", &png(&mask)?)?;
    if let Some(untouched) = example.untouched() {
        put("untouched.png", &png(&untouched)?)?;
    }
    put("img.png", &png(&example.image())?)
}
