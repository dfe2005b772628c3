//! `touch calibrate`: a sensor's profile from presses of a ball of known size.

use std::path::PathBuf;

use anyhow::{Context as _, Result, ensure};
use clap::Args;
use image::RgbImage;
use mvt_robot::digit::profile::SensorProfile;
use mvt_run::io::{check_named, print_line, write_named};
use mvt_shear::ShearSensor;
use mvt_touch::engine::{Engine, Prediction};
use ndarray::Array2;

use crate::ball::{BallFit, BallPress, fit, judge};
use crate::images::{SensorImages, engine, infer};

/// Measure the light of a touch sensor by presses of a ball, and write its profile
///
/// The gain and direction of each LED follow from the known slope of the ball in some 10 to 50 images. The profile is
/// for --profile of `touch predict`, which then reads this sensor as if its light were that of the given profile.
///
/// How good the profile is, is judged by presses that it does not come from: thirds of them are read with the gains of
/// the others, and the radius that their indentation shows is compared with that of the ball.
#[derive(Debug, Args)]
pub struct TouchCalibrateArguments {
    /// Images of presses of the ball (.png, .jpg), or folders of them
    #[arg(long, value_name = "PATH", required = true, num_args = 1..)]
    images: Vec<PathBuf>,
    /// Image of the sensor that touches nothing; without it, the median of all images is used
    #[arg(long, value_name = "FILE")]
    untouched: Option<PathBuf>,
    /// Diameter of the ball, millimetres
    #[arg(long, value_name = "MM")]
    ball_mm: f64,
    /// Profile to start from: digit, or the path of a profile (.toml) with an appearance
    #[arg(long, value_name = "NAME", default_value = "digit")]
    profile: String,
    /// Pixels per millimetre of gel, if it was measured, for example with an edge of known length; without it, that of
    /// the profile
    #[arg(long, value_name = "PX")]
    px_per_mm: Option<f64>,
    /// File for the profile (.toml)
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Replace an existing file
    #[arg(long)]
    overwrite: bool,
}

/// Fewer presses leave gains uncertain.
const FEW_PRESSES: usize = 8;
/// Parts of the presses, each of which is read with the gains of the others.
const PARTS: usize = 3;
/// A radius that is further from that of the ball, as a share of it, is not that of a calibrated sensor.
const WRONG_RADIUS: f64 = 0.25;
/// A colour of which less is explained does not behave like a DIGIT's.
const LEAST_EXPLAINED: f64 = 0.5;
/// An LED may stand so far from its place in the profile, degrees.
const MOST_TURN_DEG: f64 = 45.0;

/// Runs `touch calibrate`.
///
/// # Errors
/// If images or the profile cannot be read, no press is usable, or the profile cannot be written.
pub fn calibrate(arguments: &TouchCalibrateArguments) -> Result<()> {
    let TouchCalibrateArguments { ball_mm, px_per_mm, .. } = *arguments;
    ensure!(
        (1.0..=40.0).contains(&ball_mm),
        "--ball-mm {ball_mm}: give the diameter in millimetres; a ball for such a sensor has 1 to 40"
    );
    check_named(&arguments.out, arguments.overwrite)?;
    let mut profile = SensorProfile::load(&arguments.profile)?;
    if let Some(px_per_mm) = px_per_mm {
        ensure!((8.0..=40.0).contains(&px_per_mm), "--px-per-mm {px_per_mm}: a DIGIT has 8 to 40");
        let focal_px = px_per_mm * profile.apex_mm;
        profile.fov_y_deg = 2.0 * (0.5 * profile.size_px[1] as f64 / focal_px).atan().to_degrees();
    }
    let engine = engine(&profile, None)?;
    let appearance = profile.appearance.with_context(|| {
        format!("--profile {}: this sensor has no LEDs to calibrate; start from digit", arguments.profile)
    })?;
    let SensorImages { mut images, mut untouched, .. } =
        SensorImages::read(&arguments.images, arguments.untouched.as_deref(), &profile, &engine)?;
    if profile.markers.is_some() {
        // Neither the network nor the slopes of a ball know dots.
        let shear = ShearSensor::new(&profile, &untouched)?;
        untouched = shear.erased(&untouched);
        images.iter_mut().for_each(|image| *image = shear.erased(image));
    }
    let contacts = contacts(&engine, &profile, &untouched, &images)?;
    let all: Vec<BallPress<'_>> = images.iter().zip(&contacts).collect();
    let exponent = appearance.background_exponent;
    let px_per_mm = profile.pixel_mm().recip();
    let found = fit(&all, &untouched, exponent, px_per_mm, 0.5 * ball_mm).context(
        "no image shows a round contact clear of the border; press the ball straight into the gel, at 10 to 50 places",
    )?;
    let BallFit { presses, sensitivity, led_angles_deg, explained } = found;
    ensure!(
        presses >= FEW_PRESSES || 2 * presses >= images.len(),
        "only {presses} of {} images show a round contact clear of the border: the ball, the scale or the sensor is another than stated; check \
         --ball-mm, --px-per-mm and --profile, or give the usable images alone",
        images.len()
    );
    if presses < FEW_PRESSES {
        tracing::warn!("only {presses} of {} images could be used; 10 to 50 give reliable gains", images.len());
    }
    let names = ["red", "green", "blue"];
    let mut text = format!("{presses} of {} images used\n", images.len());
    for c in 0..3 {
        let turn = (led_angles_deg[c] - appearance.led_angles_deg[c] + 540.0).rem_euclid(360.0) - 180.0;
        if explained[c] < LEAST_EXPLAINED || turn.abs() > MOST_TURN_DEG {
            tracing::warn!(
                "{} does not fit a ball of {ball_mm} mm: {:.0} % explained, {turn:.0} degrees beside its LED; check \
                 --ball-mm and the images",
                names[c],
                100.0 * explained[c]
            );
        }
        text += &format!(
            "{:<5} {:.0} grey levels per unit of slope, towards {:.0} degrees; {:.0} % explained\n",
            names[c],
            sensitivity[c],
            led_angles_deg[c],
            100.0 * explained[c]
        );
    }
    let usable: Vec<_> =
        all.iter().filter(|press| fit(&[**press], &untouched, exponent, px_per_mm, 0.5 * ball_mm).is_some()).collect();
    let mut judged = Vec::new();
    for part in 0..PARTS {
        let others: Vec<BallPress<'_>> =
            usable.iter().enumerate().filter(|(k, _)| k % PARTS != part).map(|(_, press)| **press).collect();
        let Some(of_others) = fit(&others, &untouched, exponent, px_per_mm, 0.5 * ball_mm) else { continue };
        let gains = engine.gains(&of_others.applied_to(&profile));
        let held: Vec<RgbImage> = usable.iter().skip(part).step_by(PARTS).map(|(image, _)| (*image).clone()).collect();
        for Prediction { indentation_mm, contact_logit } in infer(&engine, gains, &untouched, &held)? {
            judged.extend(judge(&indentation_mm, &contact_logit.mapv(|logit| logit > 0.0), px_per_mm, 0.5 * ball_mm));
        }
    }
    let median = |mut values: Vec<f64>| {
        values.sort_unstable_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    let radius_mm = median(judged.iter().map(|(radius_mm, _)| *radius_mm).collect());
    let error_mm = median(judged.iter().map(|(_, error_mm)| *error_mm).collect());
    match radius_mm.zip(error_mm) {
        Some((radius_mm, error_mm)) => {
            text += &format!(
                "presses that were left out: radius {radius_mm:.2} mm instead of {:.2}, error of the depth {error_mm:.3} mm (medians of {})\n",
                0.5 * ball_mm,
                judged.len()
            );
            if (2.0 * radius_mm / ball_mm - 1.0).abs() > WRONG_RADIUS {
                tracing::warn!(
                    "the profile gives a ball of {:.1} mm instead of {ball_mm}; check --ball-mm and --px-per-mm",
                    2.0 * radius_mm
                );
            }
        }
        None => tracing::warn!("no press could be left out: how good the profile is, is not known"),
    }
    profile = found.applied_to(&profile);
    profile.validate().context("the ball gives an impossible sensor; check --ball-mm and the images")?;
    write_named(&arguments.out, toml::to_string(&profile)?.as_bytes(), arguments.overwrite)?;
    print_line(&format!("{text}profile in {}", arguments.out.display()))
}

/// Returns where a network finds contact in images of one sensor.
pub(crate) fn contacts(
    engine: &Engine,
    profile: &SensorProfile,
    untouched: &RgbImage,
    images: &[RgbImage],
) -> Result<Vec<Array2<bool>>> {
    let predictions = infer(engine, engine.gains(profile), untouched, images)?;
    Ok(predictions.iter().map(|prediction| prediction.contact_logit.mapv(|logit| logit > 0.0)).collect())
}
