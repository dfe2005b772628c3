//! `touch units`: how well a network reads sensors that it has never seen, and whether it knows.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context as _, Result, ensure};
use clap::Args;
use image::RgbImage;
use mvt_presses::{DataConfig, Example, Rack, SensorFault, example, objects};
use mvt_render::touch::TouchFrame;
use mvt_robot::digit::profile::SensorProfile;
use mvt_run::io::{check_named, print_line, write_named};
use mvt_run::{progress, settings};
use mvt_touch::contact::{ContactConfig, Felt, TouchSensor};
use mvt_touch::engine::Engine;
use mvt_touch::plausibility::{Evidence, GOOD};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::ball::{BallPress, fit};
use crate::calibrate::contacts;
use crate::images::engine;

/// Read simulated sensors that no training can have seen, and say how many are read well
///
/// Each unit has its own view, gel, LEDs, response, blur and noise, drawn as for a training but from random numbers that no training uses. It
/// presses objects of the test set. A unit is read well if its error in contact is at most 0.045 mm and the IoU of contact at least 0.9, means
/// over its presses; a reading is good if the error is at most 0.15 mm and the IoU at least 0.7,
/// which is what the plausibility of a reading is the probability of.
///
/// With --balls each unit presses a ball of 6 mm first, at as many places, and is calibrated as by `touch calibrate`.
///
/// With --faults a share of the readings has a fault: other light, response, colours, range or exposure, a mirrored or turned sensor,
/// missing rows, stray light, or an untouched image that shows a press. A reading is told if its plausibility is below 0.5.
#[derive(Debug, Args)]
pub struct TouchUnitsArguments {
    /// Sensor of which the units are: digit, gelsight_mini, or the path of a profile (.toml) with an appearance
    #[arg(long, value_name = "NAME", default_value = "digit")]
    profile: String,
    /// Weights of the network (.safetensors); without it, the shipped ones for the profile
    #[arg(long, value_name = "FILE")]
    weights: Option<PathBuf>,
    /// Number of units
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    units: u32,
    /// Presses of each unit
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=1000))]
    presses: u32,
    /// Presses of a ball by which each unit is calibrated first; 0 for none
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=1000))]
    balls: u32,
    /// Share of readings with a fault
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    faults: f64,
    /// Objects, separated by commas: names that `assets list` shows, random:SEED, or one of the sets `validation` and `test`
    #[arg(long, value_name = "NAMES", value_delimiter = ',', default_value = "test")]
    objects: Vec<String>,
    /// Seed of units, presses and faults
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Training configuration (.toml) whose table `data` says how units differ; without it, as DIGITs do
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// File that receives a line of JSON per reading
    #[arg(long, value_name = "FILE")]
    readings: Option<PathBuf>,
    /// Folder that receives the profile of each unit (0.toml, 1.toml, ...), for `generate --touch-profile`
    #[arg(long, value_name = "DIR")]
    profiles: Option<PathBuf>,
    /// Replace existing files
    #[arg(long)]
    overwrite: bool,
    /// Print JSON instead of words
    #[arg(long)]
    json: bool,
}

/// The table of a training configuration that is read.
#[derive(Deserialize)]
struct Settings {
    #[serde(default)]
    data: DataConfig,
}

/// Of a unit that is read well: greatest error in contact, millimetres, and least IoU.
const WELL: (f32, f32) = (0.045, 0.9);
/// Diameter of the ball by which a unit is calibrated, millimetres.
const BALL_MM: f32 = 6.0;
/// It is pressed straight into the gel, within these degrees.
const BALL_TILT_DEG: f64 = 10.0;
/// A reading with a lower plausibility is told.
const TOLD: f32 = 0.5;

/// A reading beside the truth.
#[derive(Debug, Serialize)]
struct UnitReading {
    unit: u32,
    fault: Option<SensorFault>,
    /// Mean error of the indentation where the object touches, millimetres; 0 without contact.
    contact_mae_mm: f32,
    /// Indentation that was read over the true one, sums where the object touches; 1 without contact.
    depth_ratio: f32,
    iou: f32,
    is_good: bool,
    plausibility: f32,
    evidence: Option<Evidence>,
}

/// The printed result.
#[derive(Debug, Serialize)]
struct Report {
    units: u32,
    readings: usize,
    /// Means of the readings without a fault.
    contact_mae_mm: f64,
    iou: f64,
    /// Share of the units that are read well, by their readings without a fault.
    well: f64,
    /// Share of all readings that are good.
    good: f64,
    /// Share of the readings that are not told that is good, and of the good ones that is not told.
    good_of_trusted: f64,
    trusted_of_good: f64,
}

/// Runs `touch units`.
///
/// # Errors
/// If a file cannot be read or written, an object is unknown, or the profile has no appearance.
pub fn units(arguments: &TouchUnitsArguments) -> Result<()> {
    let &TouchUnitsArguments { units, presses, balls, faults, seed, .. } = arguments;
    ensure!((0.0..=1.0).contains(&faults), "--faults {faults}: give a share from 0 to 1");
    let profile_file = |unit: u32| arguments.profiles.as_ref().map(|folder| folder.join(format!("{unit}.toml")));
    for path in arguments.readings.iter().cloned().chain((0..units).filter_map(profile_file)) {
        check_named(&path, arguments.overwrite)?;
    }
    let profile = SensorProfile::load(&arguments.profile)?;
    ensure!(
        profile.appearance.is_some(),
        "--profile {}: all sensors without an appearance look alike; give digit, gelsight_mini or a profile with one",
        arguments.profile
    );
    let data = match &arguments.config {
        None => DataConfig::units(),
        Some(path) => settings::read::<Settings>(path)?.data,
    };
    data.validate().map_err(|error| error.within("data"))?;
    let data = DataConfig { sensors: 1, known_untouched: 1.0, ..data };
    if let Some(folder) = &arguments.profiles {
        fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    }
    let engine = engine(&profile, arguments.weights.as_deref())?;
    let surfaces = objects::load(&objects::resolve(&arguments.objects))?;
    let (ball, of_ball) = ([objects::ball(BALL_MM)?], ball_presses(&data));
    let mut rack = Rack::new(&data, &profile, seed)?.held_out();
    let bar = progress::bar(u64::from(units) * u64::from(presses), "presses");
    let mut readings = Vec::new();
    for unit in 0..units {
        let sensors = rack.of_step(u64::from(unit))?;
        if let Some((file, sensor)) = profile_file(unit).zip(sensors.first()) {
            write_named(&file, toml::to_string(sensor.profile())?.as_bytes(), arguments.overwrite)?;
        }
        let index = |press: u32| u64::from(unit) * u64::from(presses) + u64::from(press);
        let draw = |frame: &mut TouchFrame, press| example(&surfaces, &sensors, &data, (!seed, index(press)), frame);
        let press_ball = |frame: &mut TouchFrame, press: u32| {
            let index = u64::from(unit) * u64::from(balls) + u64::from(press);
            example(&ball, &sensors, &of_ball, (!seed.rotate_left(1), index), frame)
        };
        let pressed: Vec<Example> = (0..balls).into_par_iter().map_init(TouchFrame::default, press_ball).collect();
        let profile = &calibrated(&engine, &profile, &pressed)?;
        let shown: Vec<Example> = (0..presses).into_par_iter().map_init(TouchFrame::default, draw).collect();
        let read = |(press, of_press): (u32, &Example)| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(index(press) + 1);
            let fault = (faults > 0.0 && rng.random_bool(faults)).then(|| SensorFault::draw(&mut rng));
            let other = shown.get(((press + 1) % presses) as usize).unwrap_or(of_press);
            bar.inc(1);
            read(&engine, profile, of_press, fault, other, unit)
        };
        let of_unit: Result<Vec<UnitReading>> = (0..presses).into_par_iter().zip(&shown).map(read).collect();
        readings.extend(of_unit?);
    }
    bar.finish_and_clear();
    if let Some(path) = &arguments.readings {
        let lines = readings.iter().map(serde_json::to_string).collect::<Result<Vec<_>, _>>()?;
        write_named(path, (lines.join("\n") + "\n").as_bytes(), arguments.overwrite)?;
    }
    let report = Report::of(units, &readings);
    if arguments.json {
        return print_line(&serde_json::to_string_pretty(&report)?);
    }
    let Report { contact_mae_mm, iou, well, good, good_of_trusted, trusted_of_good, .. } = report;
    let percent = |share: f64| 100.0 * share;
    print_line(&format!(
        "{units} units, {} readings: error in contact {contact_mae_mm:.3} mm, IoU {iou:.3}; {:.0} % of the units are read well, {:.0} % of the \
         readings are good\nof the readings with a plausibility of 0.5 or more {:.1} % are good; of the good ones {:.1} % have it",
        readings.len(),
        percent(well),
        percent(good),
        percent(good_of_trusted),
        percent(trusted_of_good)
    ))
}

/// Presses as people make them to calibrate a sensor.
fn ball_presses(data: &DataConfig) -> DataConfig {
    DataConfig { untouched: 0.0, small: 0.0, deep: 0.0, protocol: 0.0, tilt_deg: BALL_TILT_DEG, ..data.clone() }
}

/// Returns the profile of a unit by its presses of a ball; without a usable one the given profile.
fn calibrated(engine: &Engine, profile: &SensorProfile, pressed: &[Example]) -> Result<SensorProfile> {
    let images: Vec<RgbImage> = pressed.iter().map(Example::image).collect();
    let (Some(untouched), Some(look)) = (pressed.first().and_then(Example::untouched), profile.appearance) else {
        return Ok(profile.clone());
    };
    let contacts = contacts(engine, profile, &untouched, &images)?;
    let presses: Vec<BallPress<'_>> = images.iter().zip(&contacts).collect();
    let px_per_mm = profile.pixel_mm().recip();
    let found = fit(&presses, &untouched, look.background_exponent, px_per_mm, 0.5 * f64::from(BALL_MM));
    Ok(found.map_or_else(|| profile.clone(), |found| found.applied_to(profile)))
}

/// Reads an image with a fault, as if it were the first of its sensor.
fn read(
    engine: &Engine,
    profile: &SensorProfile,
    shown: &Example,
    fault: Option<SensorFault>,
    other: &Example,
    unit: u32,
) -> Result<UnitReading> {
    let mut image = shown.image();
    let mut untouched: RgbImage = shown.untouched().context("the untouched image of a unit is known")?;
    let stays = fault.is_none_or(|fault| fault.apply(&mut image, &mut untouched, &other.image()));
    let mut sensor = TouchSensor::new(engine, profile);
    sensor.set_untouched(engine, &untouched)?;
    let config = ContactConfig { least_plausibility: 0.0, ..ContactConfig::default() };
    let Felt { press, plausibility, evidence, .. } = sensor.feel(engine, &config, &image)?;
    let (mut error_mm, mut found_mm, mut sought_mm, mut touching, mut either, mut both) = (0.0, 0.0, 0.0, 0, 0, 0);
    if let Some(press) = press.filter(|_| stays) {
        let truth = shown.indentation_mm.iter().zip(&shown.contact);
        for ((mm, touches), (true_mm, contact)) in press.indentation_mm.iter().zip(&press.contact).zip(truth) {
            let truly = *contact > 0.5;
            if truly {
                error_mm += (mm - true_mm).abs();
                found_mm += mm;
                sought_mm += true_mm;
                touching += 1;
            }
            either += usize::from(truly || *touches);
            both += usize::from(truly && *touches);
        }
    }
    let contact_mae_mm = error_mm / touching.max(1) as f32;
    let depth_ratio = if sought_mm > 0.0 { found_mm / sought_mm } else { 1.0 };
    let iou = if either == 0 { f32::from(u8::from(stays)) } else { both as f32 / either as f32 };
    let is_good = contact_mae_mm <= GOOD.0 && iou >= GOOD.1;
    Ok(UnitReading { unit, fault, contact_mae_mm, depth_ratio, iou, is_good, plausibility, evidence })
}

impl Report {
    fn of(units: u32, readings: &[UnitReading]) -> Self {
        let mean = |values: &mut dyn Iterator<Item = f32>| {
            let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + f64::from(value), count + 1));
            sum / f64::from(count.max(1))
        };
        let plain = |unit: Option<u32>| {
            readings.iter().filter(move |of| of.fault.is_none() && unit.is_none_or(|unit| of.unit == unit))
        };
        let is_well = |unit: &u32| {
            mean(&mut plain(Some(*unit)).map(|of| of.contact_mae_mm)) <= f64::from(WELL.0)
                && mean(&mut plain(Some(*unit)).map(|of| of.iou)) >= f64::from(WELL.1)
        };
        let share = |of: &dyn Fn(&UnitReading) -> bool, among: &dyn Fn(&UnitReading) -> bool| {
            let among: Vec<&UnitReading> = readings.iter().filter(|reading| among(reading)).collect();
            among.iter().filter(|reading| of(reading)).count() as f64 / among.len().max(1) as f64
        };
        let is_trusted = |reading: &UnitReading| reading.plausibility >= TOLD;
        Self {
            units,
            readings: readings.len(),
            contact_mae_mm: mean(&mut plain(None).map(|of| of.contact_mae_mm)),
            iou: mean(&mut plain(None).map(|of| of.iou)),
            well: (0..units).filter(is_well).count() as f64 / f64::from(units),
            good: share(&|of| of.is_good, &|_| true),
            good_of_trusted: share(&|of| of.is_good, &is_trusted),
            trusted_of_good: share(&is_trusted, &|of| of.is_good),
        }
    }
}
