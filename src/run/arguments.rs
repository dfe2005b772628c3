//! Arguments of `run`, and the command that repeats a run.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::{Args, ValueEnum, value_parser};
use mvt_evaluation::manner::Manner;
use mvt_exchange::FoxgloveArguments;
use mvt_robot::hand::ALLEGRO_DIGIT;
use mvt_run::arguments::{HandSide, duration};
use mvt_run::device::DeviceArguments;
use mvt_run::estimator::{Init, Mode};
use mvt_run::io::shell_word;
use mvt_run::source::{Modality, TouchArguments};
use mvt_run::supervisor::Goal;

/// Estimate shape and pose of the object in the hand, simulated or from a log
///
/// Without --log the program simulates an episode in a closed loop: it renders the sensors' images, estimates the
/// object from them, and directs the hand by the estimate alone. With --log it reads the images from a FeelSight log.
///
/// The results in DIR: summary.json (scores, times, events), trajectory.csv (poses and errors of every frame), mesh.ply
/// and mesh.obj (the estimated shape), mesh.glb (in the colours that cameras saw), mesh.gif (the shape beside the true one), curves.svg (errors over time),
/// config.toml (all settings, and the command that repeats the run) and recording/ (for `view`, also during the run).
/// Unless the shape was given, also field.safetensors and keyframes.safetensors, for `mesh` and --resume. Summary and
/// trajectory are rewritten every second; after an interruption summary.json contains "complete": false.
#[derive(Debug, Args)]
pub struct RunArguments {
    /// Object: a name that `assets list` shows, random:SEED for a shape that the number decides, or the path of a mesh
    /// in metres [default: 077_rubiks_cube]. With --log, the true object for the scores [default: the object that the
    /// log names]
    #[arg(long)]
    pub object: Option<String>,
    /// Read this FeelSight log, RGB-D sequence or bag of ROS 2 (docs/rgbd.md) instead of simulating an episode
    #[arg(long, value_name = "LOGDIR", conflicts_with_all = ["goal", "controller", "rig", "side"])]
    pub log: Option<PathBuf>,
    #[cfg(feature = "ros")]
    #[command(flatten)]
    pub live: mvt_ros::command::LiveArguments,
    /// Quantities to estimate
    #[arg(long, value_enum, default_value_t = Mode::Slam)]
    pub mode: Mode,
    /// Sensors to use
    #[arg(long, value_enum, default_value_t = Modality::Vitac)]
    pub modality: Modality,
    #[command(flatten)]
    pub touch: TouchArguments,
    #[command(flatten)]
    pub device: DeviceArguments,
    /// One to three cameras, separated by commas: front-left, back-right, top-down, side, or azimuth/elevation in
    /// degrees such as 330/35 [default: side]. With --log, cameras of the log [default: its first one]
    #[arg(long)]
    pub cameras: Option<String>,
    /// Poses of the cameras and joint angles [default: refine, or as in the settings]
    #[arg(long, value_enum)]
    pub calibration: Option<CalibrationChoice>,
    /// Start from this calibration, which `calibrate` wrote
    #[arg(long, value_name = "FILE")]
    pub calibration_file: Option<PathBuf>,
    /// Longest duration in seconds, at most 3600 [default: 30, or the whole log]
    #[arg(long, value_name = "SECONDS", value_parser = duration)]
    pub duration: Option<f64>,
    /// Seed of the episode, its noise and the estimate [default: 0, or that of the log]
    #[arg(long)]
    pub seed: Option<u64>,
    /// End the episode when the estimate has reached this goal: turn=360deg, turn=2rev, coverage=0.9 (share of the
    /// directions around the object that were observed), pose=90deg (turned by this angle against the start about the
    /// controller's axis, and held there), show=180/0 (the side that looks to this azimuth and elevation at the start is
    /// turned to the first camera and held there), explored (with --explore: no controller would show clearly more surface) or
    /// time (only when the duration is over)
    #[arg(long, default_value = "time")]
    pub goal: Goal,
    /// Choose the next controller by the estimate alone: the one that will probably show most of the unseen surface. The
    /// hand changes among controllers between which it does not drop objects of this shape, or re-grasps; a change takes
    /// 2 s. summary.json contains the choices with the expected gains
    #[arg(long, conflicts_with = "log")]
    pub explore: bool,
    /// Start of the pose with --mode pose [default: near]
    #[arg(long, value_enum)]
    pub init: Option<Init>,
    /// Continue with the shape that an earlier run left in this folder; the program first searches for the object
    #[arg(long, value_name = "DIR")]
    pub resume: Option<PathBuf>,
    /// Read settings from a TOML file, such as the config.toml of another run
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override a setting (repeatable), for example slam.tracker.touch_weight=0.5; config.toml of a run lists all
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Folder for the results; an earlier run in it is moved to DIR.1, DIR.2 and so on
    #[arg(long, value_name = "DIR", default_value = "out")]
    pub out: PathBuf,
    /// Replace an earlier run instead of moving it, and allow a folder that contains other files
    #[arg(long)]
    pub overwrite: bool,
    /// Number of threads; it does not change the result [default: one per core]
    #[arg(long, value_name = "N", value_parser = value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Print summary.json instead of words
    #[arg(long)]
    pub json: bool,
    /// Print neither progress nor results
    #[arg(long)]
    pub quiet: bool,
    /// Also write the run as this MCAP file, which Foxglove and rerun open; `export mcap` does so later
    #[arg(long, value_name = "FILE")]
    pub mcap: Option<PathBuf>,
    #[command(flatten)]
    pub foxglove: FoxgloveArguments,
    /// Show the run in a window; closing the window does not end the run
    #[arg(long)]
    pub view: bool,
    #[command(flatten)]
    pub manner: Manner,
}

/// Calibration on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum CalibrationChoice {
    /// Refine the given calibration by the hand in the cameras' images
    Refine,
    /// Take the given calibration as it is
    Given,
}

impl RunArguments {
    /// Checks that the arguments fit the mode.
    pub fn check(&self) -> Result<()> {
        if self.init.is_some() && self.mode != Mode::Pose {
            bail!("--init needs --mode pose; in the other modes the first frame decides where the pose starts");
        }
        if self.resume.is_some() && self.mode != Mode::Slam {
            bail!("--resume needs --mode slam; in the other modes shape or pose is given");
        }
        if (self.explore || matches!(self.goal, Goal::Coverage(_))) && self.mode == Mode::Pose {
            bail!(
                "--goal coverage and --explore need --mode slam or map; with --mode pose the whole shape is known from the start"
            );
        }
        #[cfg(feature = "ros")]
        self.live.check(self.goal, &self.manner.controller)?;
        Ok(())
    }

    /// Whether the frames come from sensors that do not wait.
    pub fn is_live(&self) -> bool {
        #[cfg(feature = "ros")]
        return self.live.ros.is_some();
        #[cfg(not(feature = "ros"))]
        false
    }

    /// Returns the command that repeats the run, for the first line of its config.toml.
    pub fn repeat(&self, object: &str, seed: u64) -> String {
        let mut command = format!("mambavitact run --object {}", shell_word(object));
        let mut add = |key: &str, value: Option<String>| {
            if let Some(value) = value {
                command += &format!(" --{key} {}", shell_word(&value));
            }
        };
        let path = |path: &Path| path.display().to_string();
        add("log", self.log.as_deref().map(path));
        #[cfg(feature = "ros")]
        add("ros", self.live.ros.as_deref().map(path));
        add("seed", Some(seed.to_string()));
        add("mode", Some(self.mode.name().to_owned()));
        add("modality", Some(self.modality.name().to_owned()));
        for (key, value) in self.touch.options() {
            add(key, value);
        }
        add("device", self.device.option());
        add("cameras", self.cameras.clone());
        add("calibration-file", self.calibration_file.as_deref().map(path));
        add("duration", self.duration.map(|seconds| seconds.to_string()));
        add("init", self.init.map(|init| init.name().to_owned()));
        add("resume", self.resume.as_deref().map(path));
        if self.log.is_none() && !self.is_live() {
            add("goal", Some(self.goal.to_string()));
            add("controller", Some(self.manner.controller.clone()));
            add("rig", Some(self.manner.rig.clone()).filter(|rig| rig != ALLEGRO_DIGIT));
            let is_allegro = self.manner.rig == ALLEGRO_DIGIT;
            let side = self.manner.side.or(is_allegro.then_some(HandSide::Left));
            add("side", side.map(|side| side.name().to_owned()));
            command += if self.explore { " --explore" } else { "" };
        }
        command + " --config config.toml"
    }
}

#[cfg(test)]
mod tests {
    use clap::{Args as _, Command, FromArgMatches as _};
    use mvt_viewer::run_choices::RunChoices;

    use super::*;

    #[test]
    fn every_choice_of_the_window_makes_a_command_that_run_understands() {
        let gaits = mvt_gaits::gait::shipped().keys().map(String::as_str).chain(["auto"]);
        for (mode, _) in RunChoices::modes() {
            for (modality, meaning) in RunChoices::modalities() {
                assert!(!meaning.is_empty());
                for gait in gaits.clone() {
                    let choices = RunChoices {
                        mode: mode.to_owned(),
                        modality: modality.to_owned(),
                        gait: gait.to_owned(),
                        ..RunChoices::default()
                    };
                    let arguments = choices.arguments(Path::new("some where"));
                    let matches =
                        RunArguments::augment_args(Command::new("run")).try_get_matches_from(&arguments).unwrap();
                    RunArguments::from_arg_matches(&matches).unwrap();
                }
            }
        }
    }
}
