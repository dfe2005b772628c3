//! `touch calibrate`: a sensor's profile from presses of a ball of known size.

use std::path::PathBuf;

use anyhow::{Context as _, Result, ensure};
use clap::Args;
use mvt_robot::digit::profile::SensorProfile;
use mvt_run::io::{check_named, print_line, write_named};
use mvt_shear::ShearSensor;
use ndarray::Array2;

use crate::ball::{BallFit, fit};
use crate::images::{SensorImages, engine, infer};

/// Measure the light of a touch sensor by presses of a ball, and write its profile
///
/// The gain and direction of each LED follow from the known slope of the ball in some 10 to 50 images. The profile is
/// for --profile of `touch predict`, which then reads this sensor as if its light were that of the given profile.
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
    ensure!((1.0..=40.0).contains(&ball_mm), "--ball-mm {ball_mm}: a ball for a DIGIT has 1 to 40 mm");
    check_named(&arguments.out, arguments.overwrite)?;
    let mut profile = SensorProfile::load(&arguments.profile)?;
    if let Some(px_per_mm) = px_per_mm {
        ensure!((8.0..=40.0).contains(&px_per_mm), "--px-per-mm {px_per_mm}: a DIGIT has 8 to 40");
        let focal_px = px_per_mm * profile.apex_mm;
        profile.fov_y_deg = 2.0 * (0.5 * profile.size_px[1] as f64 / focal_px).atan().to_degrees();
    }
    let engine = engine(&profile, None)?;
    let mut appearance = profile.appearance.with_context(|| {
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
    let predictions = infer(&engine, engine.gains(&profile), &untouched, &images)?;
    let contacts: Vec<Array2<bool>> =
        predictions.iter().map(|prediction| prediction.contact_logit.mapv(|logit| logit > 0.0)).collect();
    let presses: Vec<_> = images.iter().zip(&contacts).collect();
    let px_per_mm = profile.intrinsics().fx / profile.apex_mm;
    let BallFit { presses, sensitivity, led_angles_deg, explained } = fit(
        &presses,
        &untouched,
        appearance.background_exponent,
        px_per_mm,
        0.5 * ball_mm,
    )
    .context(
        "no image shows a round contact clear of the border; press the ball straight into the gel, at 10 to 50 places",
    )?;
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
    appearance.sensitivity = sensitivity.map(|gain| gain as f32);
    appearance.led_angles_deg = led_angles_deg;
    profile.appearance = Some(appearance);
    profile.validate().context("the ball gives an impossible sensor; check --ball-mm and the images")?;
    write_named(&arguments.out, toml::to_string(&profile)?.as_bytes(), arguments.overwrite)?;
    print_line(&format!("{text}profile in {}", arguments.out.display()))
}
