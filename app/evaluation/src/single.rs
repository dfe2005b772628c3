//! One run of one estimator on one episode: a task of a sweep.

use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use mvt_gaits::gait::AUTO;
use mvt_hands::LoadedHand;
use mvt_robot::hand::{Hand, Side};
use mvt_run::config::RunConfig;
use mvt_run::controller::choose_any;
use mvt_run::estimator::Mode;
use mvt_run::object::load_object;
use mvt_run::source::{Modality, TouchArguments, TouchOrigin};
use serde::Deserialize;
use serde_json::{Map, Value};

use crate::{Episode, FULL, Key, Line, Trial, key, spread, table, whole};

/// Run that is described by names and numbers, as they stand in a file.
#[derive(Debug, Clone, Deserialize)]
pub struct SingleRun {
    /// The object: a name of the catalogue, random:SEED, or the path of a mesh.
    object: String,
    /// Seed of the episode.
    #[serde(default)]
    seed: u64,
    /// Cameras, with commas between.
    #[serde(default = "default_cameras")]
    cameras: String,
    /// The estimated quantities.
    #[serde(default)]
    mode: Mode,
    /// Which sensors are used.
    #[serde(default)]
    modality: Modality,
    /// Longest duration of the episode, seconds.
    #[serde(default = "default_duration_s")]
    duration: f64,
    /// Added to the seed, gives the seed of the estimator.
    #[serde(default)]
    estimator_seed: u64,
    /// Where touch depth comes from.
    #[serde(default)]
    touch_depth: TouchOrigin,
    /// Weights of a touch network; without it those that are shipped.
    #[serde(default)]
    weights: Option<PathBuf>,
    /// Settings by their keys, as `--set` takes them.
    #[serde(flatten)]
    settings: Map<String, Value>,
}

fn default_cameras() -> String {
    "side".to_owned()
}

fn default_duration_s() -> f64 {
    30.0
}

impl SingleRun {
    /// Checks all names and numbers, without loading the object.
    ///
    /// # Errors
    /// If one is invalid; the message names it.
    pub fn check(&self) -> Result<()> {
        mvt_robot::rig::Placement::parse_list(&self.cameras)?;
        if let Err(reason) = mvt_run::arguments::duration(&self.duration.to_string()) {
            bail!("duration = {}: {reason}", self.duration);
        }
        if let Some(path) = &self.weights {
            TouchArguments::new(self.touch_depth, Some(path.clone())).weights(&Hand::allegro(Side::Left))?;
        }
        self.config().map(drop)
    }

    /// Simulates the episode and runs the estimator. The result depends on no clock and no thread.
    ///
    /// # Errors
    /// As [`SingleRun::check`], and if the episode cannot be simulated.
    pub fn run(&self) -> Result<Line> {
        // Why: notes/decisions/sweeps.md, "Results depend on no clock".
        let config = self.config()?;
        let object = load_object(&self.object)?;
        let rig = LoadedHand::allegro(Side::Left);
        let weights = TouchArguments::new(self.touch_depth, self.weights.clone()).weights(&rig.hand)?;
        let controller = choose_any(AUTO, &object, &rig.hand)?;
        let episode = Episode {
            name: &self.object,
            object: &object,
            seed: self.seed,
            cameras: &self.cameras,
            weights: weights.as_ref(),
            controller: &controller,
            rig: &rig,
        };
        let key = key(self.duration, &episode, self.mode, self.modality, FULL, &config);
        let key = Key { estimator_seed: self.estimator_seed, ..key };
        let trial = Trial { key, mode: self.mode, modality: self.modality, config };
        let mut result = None;
        whole(self.duration, &episode, &[trial], &mut |line| {
            result = Some(line);
            Ok(())
        })?;
        let line = result.context("the run has no result")?;
        Ok(Line { frames_per_second: None, ..line })
    }

    fn config(&self) -> Result<RunConfig> {
        let assignment = |(key, value): (&String, &Value)| match value {
            Value::String(text) => format!("{key}={text}"),
            other => format!("{key}={other}"),
        };
        let set: Vec<String> = self.settings.iter().map(assignment).collect();
        Ok(RunConfig::default().changed(None, &set)?)
    }
}

/// Returns the tables of `evaluate` as Markdown. The order of the lines does not matter.
pub fn tables(lines: &[Line]) -> String {
    table::tables(lines) + &spread::table(lines)
}
