//! `touch weigh`: the stiffness of a gel from presses with known forces.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail, ensure};
use clap::Args;
use mvt_robot::digit::profile::SensorProfile;
use mvt_run::io::{check_named, print_line, write_named};
use mvt_touch::contact::ContactConfig;

use crate::images::{SensorImages, engine};
use crate::predictor::Predictor;

/// Measure the stiffness of a gel by presses with known forces, and write its profile
///
/// Stand the sensor, or an object on it, on a scale; press with three or more forces and take an image of each. The force per volume
/// that is pressed in is fitted, and its deviation from press to press becomes that of all forces that `touch predict` states with the profile.
#[derive(Debug, Args)]
pub struct TouchWeighArguments {
    /// Images of the presses (.png, .jpg), or folders of them
    #[arg(long, value_name = "PATH", required = true, num_args = 1..)]
    images: Vec<PathBuf>,
    /// Image of the sensor that touches nothing; without it, the median of all images is used
    #[arg(long, value_name = "FILE")]
    untouched: Option<PathBuf>,
    /// Table (.csv) with the columns id and force_n: the name of each image without .png or _img.png, and its normal force, newtons
    #[arg(long, value_name = "FILE")]
    forces: PathBuf,
    /// Sensor: digit, gelsight_mini, or the path of a profile (.toml), as `touch calibrate` writes it
    #[arg(long, value_name = "NAME", default_value = "digit")]
    profile: String,
    /// File for the profile (.toml)
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Replace an existing file
    #[arg(long)]
    overwrite: bool,
}

/// Fewer presses say nothing of the deviation.
const LEAST_PRESSES: usize = 3;
/// Forces of a finger; a larger one was typed in grams.
const MOST_N: f64 = 100.0;
/// Presses that differ by more from one stiffness are not of one gel, or the forces belong to other images.
const MOST_DEVIATION: f64 = 1.0;
/// Largest table, bytes.
const LARGEST_FILE: u64 = 1 << 20;

/// Runs `touch weigh`.
///
/// # Errors
/// If a file cannot be read or written, too few images have a force and contact, or forces and volumes do not belong together.
pub fn weigh(arguments: &TouchWeighArguments) -> Result<()> {
    check_named(&arguments.out, arguments.overwrite)?;
    let mut profile = SensorProfile::load(&arguments.profile)?;
    let forces = forces(&arguments.forces)?;
    let mut predictor = Predictor::new(engine(&profile, None)?, &profile, ContactConfig::default());
    let SensorImages { ids, images, untouched } =
        SensorImages::read(&arguments.images, arguments.untouched.as_deref(), &profile, &predictor.engine)?;
    predictor.set_untouched(&untouched)?;
    let mut presses = Vec::new();
    for reading in predictor.predict(&ids, &images)? {
        let force_n = forces.iter().find(|(id, _)| *id == reading.line.id).map(|(_, force_n)| *force_n);
        let volume_mm3 = reading.line.press.volume_mm3;
        presses
            .extend(force_n.filter(|force_n| *force_n > 0.0 && volume_mm3 > 0.0).map(|force_n| (volume_mm3, force_n)));
    }
    ensure!(
        presses.len() >= LEAST_PRESSES,
        "only {} of {} images have a force above 0 in {} and show contact; give {LEAST_PRESSES} or more",
        presses.len(),
        ids.len(),
        arguments.forces.display()
    );
    let (stiffness, deviation) = fit(&presses);
    ensure!(
        deviation <= MOST_DEVIATION,
        "forces and images do not belong together: the force per volume differs by {:.0} % from press to press; check {}",
        100.0 * deviation,
        arguments.forces.display()
    );
    (profile.stiffness_n_per_mm3, profile.stiffness_deviation) = (stiffness as f32, deviation as f32);
    profile.validate().context("the presses give an impossible gel; check the forces")?;
    write_named(&arguments.out, toml::to_string(&profile)?.as_bytes(), arguments.overwrite)?;
    print_line(&format!(
        "{} presses: {stiffness:.3} N per cubic millimetre, +- {:.0} % from press to press; profile in {}",
        presses.len(),
        100.0 * deviation,
        arguments.out.display()
    ))
}

/// Returns the stiffness of presses (volume, force), the geometric mean of their ratios, and the standard deviation of a press as a share of it:
/// errors of a reading grow with it.
fn fit(presses: &[(f64, f64)]) -> (f64, f64) {
    let logs: Vec<f64> = presses.iter().map(|(volume_mm3, force_n)| (force_n / volume_mm3).ln()).collect();
    let mean = logs.iter().sum::<f64>() / logs.len() as f64;
    let variance = logs.iter().map(|log| (log - mean).powi(2)).sum::<f64>() / (logs.len() as f64 - 1.0).max(1.0);
    (mean.exp(), variance.sqrt())
}

/// Reads the table of forces.
fn forces(path: &Path) -> Result<Vec<(String, f64)>> {
    let text = mvt_files::input::read_text(path, LARGEST_FILE)
        .with_context(|| format!("cannot read --forces {}", path.display()))?;
    let mut forces = Vec::new();
    for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let [id, force] = cells[..] else {
            bail!("{} line {}: expected two columns, id and force_n", path.display(), number + 1);
        };
        if number == 0 && id == "id" {
            ensure!(
                force == "force_n",
                "{}: the second column is {force:?}; expected force_n, newtons",
                path.display()
            );
            continue;
        }
        let force_n = force.parse::<f64>().ok().filter(|force_n| (0.0..=MOST_N).contains(force_n));
        let force_n = force_n.with_context(|| {
            format!("{} line {}: {force:?} is no force from 0 to {MOST_N} newtons", path.display(), number + 1)
        })?;
        forces.push((id.to_owned(), force_n));
    }
    Ok(forces)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_of_forces_is_read_and_its_faults_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("forces.csv");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            forces(&path)
        };
        let two = vec![("000".to_owned(), 0.5), ("001".to_owned(), 2.0)];
        assert_eq!(read("id,force_n\n000,0.5\n001, 2\n\n").unwrap(), two);
        assert_eq!(read("000,0.5\r\n001,2").unwrap(), two);
        for (text, part) in [
            ("id,force_g\n000,50", "force_n"),
            ("000,500", "line 1: \"500\" is no force"),
            ("id,force_n\n000,-1", "line 2"),
            ("id,force_n\n000,nan", "line 2"),
            ("000", "two columns"),
        ] {
            let error = format!("{:#}", read(text).unwrap_err());
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn the_stiffness_of_exact_presses_is_found() {
        let (stiffness, deviation) = fit(&[(1.0, 0.2), (2.0, 0.4), (10.0, 2.0)]);
        assert!((stiffness - 0.2).abs() < 1e-12 && deviation < 1e-12);
        let (_, deviation) = fit(&[(1.0, 0.1), (1.0, 0.2), (1.0, 0.4)]);
        assert!((deviation - 2_f64.ln()).abs() < 1e-9);
    }
}
