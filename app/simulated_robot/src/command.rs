//! The arguments of `simulate --ros`, and what it prints.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context as _, Result, bail};
use clap::Args;
use mvt_evaluation::manner::Subject;
use mvt_hands::load_rig;
use mvt_physics::episode::End;
use mvt_robot::hand::Side;
use mvt_ros::RosSetup;
use mvt_run::io::print_line;
use mvt_simulated::recorder::NoiseLevel;
use serde::Serialize;

use crate::robot::{RobotOutcome, RobotSettings, SimulatedRobot};

/// How a robot is played.
#[derive(Debug, Args)]
pub struct RobotArguments {
    /// Play the robot whose topics of ROS 2 this file names (docs/live.md): publish images, joint angles and true poses, and move the joints as its
    /// command topic says. Hand and object rest until the first command; the duration counts from there
    #[arg(long, value_name = "FILE", conflicts_with_all = ["rig", "side"])]
    pub ros: Option<PathBuf>,
    /// With --ros, simulated seconds per second. Other speeds than 1 need `sim_time = true` in the file; the time is then published on /clock
    #[arg(long, value_name = "X", requires = "ros", default_value_t = 1.0, value_parser = speed)]
    speed: f64,
    /// With --ros, noise in the images
    #[arg(long, value_enum, requires = "ros", default_value_t = NoiseLevel::Full)]
    noise: NoiseLevel,
}

fn speed(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.01..=10.0).contains(&value) => Ok(value),
        _ => Err("give a number from 0.01 to 10".to_owned()),
    }
}

/// The printed result: the outcome and the arguments that led to it.
#[derive(Debug, Serialize)]
struct RobotReport<'a> {
    object: &'a str,
    gait: &'a str,
    side: Side,
    seed: u64,
    #[serde(flatten)]
    outcome: RobotOutcome,
}

impl RobotArguments {
    /// Plays the robot of the file; does nothing without one. The seed, the longest duration, seconds, and whether to print JSON are those of
    /// `simulate`. `stop` returns a flag that ends it.
    ///
    /// # Errors
    /// If the file, the object or the controller cannot be used, or the network fails.
    pub fn run(
        &self,
        subject: &Subject,
        (seed, duration_s, json): (u64, f64, bool),
        stop: fn() -> Result<Arc<AtomicBool>>,
    ) -> Result<()> {
        let Some(file) = &self.ros else { return Ok(()) };
        let named = || file.display().to_string();
        let setup = RosSetup::read(file)?;
        if self.speed != 1.0 && !setup.sim_time {
            bail!("{}: --speed needs sim_time = true, so that others follow /clock", named());
        }
        let Some(rig) = setup.rig_beside(file) else {
            bail!("{}: a simulated robot needs a hand: name it as `rig`", named());
        };
        let rig = load_rig(&rig, setup.side).with_context(named)?;
        let cameras = setup.camera.as_deref().map_or_else(|| Ok(rig.cameras.clone()), |name| rig.placed(name))?;
        let Some(camera) = cameras.into_iter().next() else {
            bail!("{}: the place of the camera is unknown: name a camera of the rig as `camera`", named());
        };
        if setup.world_frame.is_some() {
            bail!("{}: a simulated robot publishes no transforms: leave out world_frame", named());
        }
        let (object, controller) = subject.load(&rig)?;
        if !controller.schedule.is_empty() {
            bail!("--controller {}: the palm cannot be tilted anew; name one controller", controller.name);
        }
        let side = rig.hand.side();
        let settings = RobotSettings {
            hand: rig.hand,
            gait: controller.gait,
            mover: controller.mover,
            camera,
            seed,
            duration_s,
            noise: self.noise.into(),
            speed: self.speed,
        };
        let robot = SimulatedRobot::new(&object, &settings, &setup).with_context(named)?;
        let outcome = robot.run(&*stop()?)?;
        let report = RobotReport { object: &object.name, gait: &controller.name, side, seed, outcome };
        print_line(&if json { serde_json::to_string(&report)? } else { in_words(&report) })
    }
}

fn in_words(report: &RobotReport<'_>) -> String {
    let RobotReport { object, gait, seed, outcome, .. } = report;
    let RobotOutcome { episode, frames, commands, refused, silences, speed } = outcome;
    let ended = match &episode.end {
        End::Completed => "stayed in the hand",
        End::Dropped => "fell off the hand",
        End::Stopped => "was stopped",
        End::Uncontrolled(reason) | End::Unstable(reason) => reason.as_str(),
    };
    format!(
        "{object} (gait {gait}, seed {seed}): {ended} for {:.1} s and turned {:.1} rad; {frames} frames published, {commands} commands obeyed, {refused} refused, {silences} silences, at {speed:.2} of real time",
        episode.survived_s, episode.turned_rad
    )
}
