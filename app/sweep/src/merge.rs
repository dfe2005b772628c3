//! The results of all tasks as one data set or one table.

use std::collections::HashMap;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail, ensure};
use mvt_evaluation::Line;
use mvt_feelsight::{SCENE_FILE, SceneFile};
use mvt_files::input;
use rayon::prelude::*;
use serde::Serialize;
use serde_json::Value;

use crate::plan::{SweepPlan, SweepTask};
use crate::spec::{TaskCommand, TaskSettings};
use crate::store::{Manifest, Store};
use crate::work::{LOG, RUN};

/// File that says which result is of which task.
const INDEX: &str = "sweep.jsonl";
/// Largest scene.json and result that are read, bytes.
const LARGEST_RESULT: u64 = 1 << 20;

/// Line of sweep.jsonl.
#[derive(Debug, Serialize)]
struct IndexLine<'a> {
    /// The log, relative to the data set; `None` for runs.
    #[serde(skip_serializing_if = "Option::is_none")]
    log: Option<String>,
    task: &'a str,
    settings: &'a TaskSettings,
}

/// Writes the results of a plan into the folder `out`, which must not exist; they may lie in several folders of the same plan. Returns the number
/// of results.
///
/// # Errors
/// If a task has no result and `partial` is false, a result does not fit its manifest, or a file cannot be written.
pub fn merge(plans: &[SweepPlan], out: &Path, partial: bool) -> Result<usize> {
    let plan = plans.first().context("give the folder of a sweep")?;
    for other in plans {
        let is_same = other.tasks == plan.tasks && other.command == plan.command;
        ensure!(is_same, "{} and {} hold different plans", plan.folder.display(), other.folder.display());
    }
    let stores: Vec<Store> = plans.iter().map(|plan| Store::new(&plan.folder)).collect();
    let place = |task: &SweepTask| stores.iter().find(|store| store.done(&task.id).is_dir());
    let found: Vec<Option<&Store>> = plan.tasks.par_iter().map(place).collect();
    let missing: Vec<&SweepTask> =
        plan.tasks.iter().zip(&found).filter(|(_, store)| store.is_none()).map(|(task, _)| task).collect();
    if let Some(first) = missing.first().filter(|_| !partial) {
        bail!(
            "{} of {} tasks have no result, such as {} ({}); see `mambavitact sweep status`, or give --partial",
            missing.len(),
            plan.tasks.len(),
            first.id,
            first.in_words()
        );
    }
    ensure!(!out.exists(), "{} exists; choose another --out", out.display());
    let name = out.file_name().with_context(|| format!("{} does not end in a name", out.display()))?;
    let mut hidden = std::ffi::OsString::from(".");
    hidden.push(name);
    hidden.push(format!(".{}.partial", std::process::id()));
    let unfinished = Unfinished(out.with_file_name(hidden));
    fs::create_dir_all(&unfinished.0).with_context(|| format!("cannot make {}", unfinished.0.display()))?;
    let checked = plan.tasks.par_iter().zip(&found).map(|(task, store)| match store {
        Some(store) => store.check(&task.id).map(|manifest| Some((store.done(&task.id), manifest))),
        None => Ok(None),
    });
    let checked: Vec<Option<(PathBuf, Manifest)>> = checked.collect::<Result<_>>()?;
    let results = plan.tasks.iter().zip(checked).collect();
    match plan.command {
        TaskCommand::Generate => logs(results, &unfinished.0)?,
        TaskCommand::Evaluate => runs(results, &unfinished.0)?,
    }
    fs::rename(&unfinished.0, out).with_context(|| format!("cannot make {}", out.display()))?;
    Ok(plan.tasks.len() - missing.len())
}

/// Folder that is removed unless it was renamed.
struct Unfinished(PathBuf);

impl Drop for Unfinished {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

type Results<'a> = Vec<(&'a SweepTask, Option<(PathBuf, Manifest)>)>;

/// Lays out logs as `generate` does: OBJECT/00, OBJECT/01 and so on. A missing log keeps its number.
fn logs(results: Results<'_>, out: &Path) -> Result<()> {
    let mut numbers = HashMap::<&str, usize>::new();
    let mut index = Vec::new();
    for (task, result) in results {
        let object = task.settings.get("object").and_then(Value::as_str).unwrap_or_default();
        let number = numbers.entry(object).or_default();
        let log = format!("{number:02}");
        *number += 1;
        let Some((folder, manifest)) = result else { continue };
        let path = folder.join(LOG).join(SCENE_FILE);
        let bytes = input::read(&path, LARGEST_RESULT).with_context(|| format!("cannot read {}", path.display()))?;
        let scene: SceneFile = serde_json::from_slice(&bytes).with_context(|| path.display().to_string())?;
        let target = out.join(&scene.object.name).join(&log);
        ensure!(!target.exists(), "two objects are called {}; rename the file of one", scene.object.name);
        for name in manifest.files.keys() {
            let (from, relative) = (folder.join(name), name.strip_prefix(LOG).unwrap_or(name));
            place(&from, &target.join(relative.trim_start_matches('/')))?;
        }
        let log = Some(format!("{}/{log}", scene.object.name));
        serde_json::to_writer(&mut index, &IndexLine { log, task: &task.id, settings: &task.settings })?;
        index.write_all(b"\n")?;
    }
    mvt_run::io::write_file(out, INDEX, &index)
}

/// Gives a file a second name, or copies it where that is impossible.
fn place(from: &Path, to: &Path) -> Result<()> {
    if let Some(parent) = to.parent() {
        fs::create_dir_all(parent).with_context(|| format!("cannot make {}", parent.display()))?;
    }
    let linked = fs::hard_link(from, to).or_else(|_| fs::copy(from, to).map(drop));
    linked.with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))
}

/// Writes runs and tables as `evaluate` does.
fn runs(results: Results<'_>, out: &Path) -> Result<()> {
    let (mut lines, mut index) = (Vec::<Line>::new(), Vec::new());
    for (task, result) in results {
        let Some((folder, _)) = result else { continue };
        let path = folder.join(RUN);
        let bytes = input::read(&path, LARGEST_RESULT).with_context(|| format!("cannot read {}", path.display()))?;
        lines.push(serde_json::from_slice(&bytes).with_context(|| path.display().to_string())?);
        serde_json::to_writer(&mut index, &IndexLine { log: None, task: &task.id, settings: &task.settings })?;
        index.write_all(b"\n")?;
    }
    lines.sort_by(|a, b| a.key.cmp(&b.key));
    let mut text = Vec::new();
    for line in &lines {
        serde_json::to_writer(&mut text, line)?;
        text.write_all(b"\n")?;
    }
    mvt_run::io::write_file(out, INDEX, &index)?;
    mvt_run::io::write_file(out, "runs.jsonl", &text)?;
    mvt_run::io::write_file(out, "table.md", mvt_evaluation::tables(&lines).as_bytes())
}
