//! The work of a task, in this process: the functions that `generate` and `evaluate` call.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, anyhow};
use indicatif::ProgressBar;
use mvt_evaluation::SingleRun;
use mvt_feelsight::LogFormat;
use mvt_gaits::gait;
use mvt_objects::catalogue;
use mvt_robot::hand::{Hand, Side};
use mvt_robot::rig::Placement;
use mvt_run::arguments::duration;
use mvt_run::object::load_object;
use mvt_simulated::recorder::{NoiseLevel, Recorder, Settings};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::spec::{SweepSpec, TaskCommand, TaskSettings};

/// Folder of the log among the files of a task of `generate`.
pub const LOG: &str = "log";
/// File with the scores among the files of a task of `evaluate`.
pub const RUN: &str = "run.json";
/// Values of an axis of numbers that are checked one by one; of more, the least and the greatest.
const CHECKED: usize = 200;

/// Log that is described by names and numbers. Its keys are the options of `generate`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct LogTask {
    object: String,
    seed: u64,
    cameras: String,
    duration: f64,
    noise: NoiseLevel,
    touch_config: String,
    background: Option<PathBuf>,
    gait: String,
    side: Side,
    format: LogFormat,
}

impl Default for LogTask {
    fn default() -> Self {
        Self {
            object: String::new(),
            seed: 0,
            cameras: "front-left".to_owned(),
            duration: 30.0,
            noise: NoiseLevel::default(),
            touch_config: "fork".to_owned(),
            background: None,
            gait: "auto".to_owned(),
            side: Side::Left,
            format: LogFormat::default(),
        }
    }
}

impl LogTask {
    fn settings(&self) -> Result<Settings> {
        duration(&self.duration.to_string()).map_err(|reason| anyhow!("duration = {}: {reason}", self.duration))?;
        Ok(Settings {
            controller: self.gait.clone(),
            hand: Hand::allegro(self.side),
            duration_s: self.duration,
            noise: self.noise.into(),
            touch_config: self.touch_config.parse()?,
            background: self.background.clone(),
        })
    }

    fn record(&self, folder: &Path) -> Result<()> {
        let settings = self.settings()?;
        let object = load_object(&self.object)?;
        let placements = Placement::parse_list(&self.cameras)?;
        let cameras: Vec<_> = placements.iter().map(|placement| placement.camera(&settings.hand)).collect();
        let recorder = Recorder::new(&object, &self.object, &settings)?;
        let bar = ProgressBar::hidden();
        recorder.record(self.seed, &cameras, folder, self.format, false, &bar).map(drop)
    }
}

/// Checks every value of a specification before anything is planned. Objects are looked up and not loaded.
///
/// # Errors
/// If a key is unknown or a value invalid; the message names it.
pub fn check(spec: &SweepSpec) -> Result<()> {
    let first = spec.task(0);
    check_task(spec.command, &first)?;
    for (key, values) in spec.axis_values() {
        for value in representative(&values) {
            let mut settings = first.clone();
            settings.insert(key.clone(), value.clone());
            check_task(spec.command, &settings)
                .with_context(|| format!("axis {key}, value {}", value.to_string().trim_matches('"')))?;
        }
    }
    Ok(())
}

fn representative(values: &[Value]) -> Vec<&Value> {
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    if values.len() <= CHECKED || !values.iter().all(Value::is_number) {
        return values.iter().collect();
    }
    let least = values.iter().min_by(|a, b| number(a).total_cmp(&number(b)));
    let greatest = values.iter().max_by(|a, b| number(a).total_cmp(&number(b)));
    least.into_iter().chain(greatest).collect()
}

fn check_task(command: TaskCommand, settings: &TaskSettings) -> Result<()> {
    let object =
        settings.get("object").and_then(Value::as_str).context("object is missing: add it to [axes] or [fixed]")?;
    if let Some(file) = catalogue::mesh_path(object) {
        std::fs::metadata(file).with_context(|| format!("cannot read {object}"))?;
    } else {
        catalogue::check(object)?;
    }
    match command {
        TaskCommand::Generate => {
            let task: LogTask = from_settings(settings)?;
            Placement::parse_list(&task.cameras)?;
            if !gait::is_left_open(&task.gait) {
                gait::find(&task.gait)?;
            }
            task.settings().map(drop)
        }
        TaskCommand::Evaluate => from_settings::<SingleRun>(settings)?.check(),
    }
}

fn from_settings<T: DeserializeOwned>(settings: &TaskSettings) -> Result<T> {
    Ok(serde_json::from_value(Value::Object(settings.clone().into_iter().collect()))?)
}

/// Does a task and leaves its files in a folder.
///
/// # Errors
/// If it cannot be done.
pub fn run(command: TaskCommand, settings: &TaskSettings, folder: &Path) -> Result<()> {
    match command {
        TaskCommand::Generate => from_settings::<LogTask>(settings)?.record(&folder.join(LOG)),
        TaskCommand::Evaluate => {
            let line = from_settings::<SingleRun>(settings)?.run()?;
            mvt_run::io::write_file(folder, RUN, &serde_json::to_vec(&line)?)
        }
    }
}
