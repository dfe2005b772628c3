//! The plan of a sweep on disk: plan.json and tasks.jsonl.

use std::collections::HashMap;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::{Context as _, Result, bail, ensure};
use mvt_files::folder::{ClaimedFolder, Earlier};
use mvt_files::input;
use mvt_files::output::PartialFile;
use serde::{Deserialize, Serialize};

use crate::spec::{SweepSpec, TaskCommand, TaskSettings};
use crate::work;

/// Name of the file that describes a plan.
const PLAN: &str = "plan.json";
/// Name of the file with a task per line.
const TASKS: &str = "tasks.jsonl";
/// Version of both files.
const FORMAT: u32 = 1;
/// Largest plan.json and tasks.jsonl that are read, bytes.
const LARGEST_PLAN: u64 = 1 << 16;
const LARGEST_TASKS: u64 = 4 << 30;
/// Largest file that a task may name, bytes: meshes, weights, images.
const LARGEST_INPUT: u64 = 1 << 30;
/// Settings that name a file, if the value is a path.
const FILES: [&str; 3] = ["object", "background", "weights"];
/// Hexadecimal digits of a task's name: 128 bits.
const ID_DIGITS: usize = 32;

/// Contents of plan.json.
#[derive(Debug, Serialize, Deserialize)]
struct PlanFile {
    format: u32,
    program_version: String,
    command: TaskCommand,
    tasks: usize,
    /// BLAKE3 of tasks.jsonl, hexadecimal.
    tasks_blake3: String,
}

/// Task of a sweep: a line of tasks.jsonl.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SweepTask {
    /// BLAKE3 of program version, command, settings and the files that they name, hexadecimal, its first 128 bits.
    pub id: String,
    /// All settings.
    pub settings: TaskSettings,
}

impl SweepTask {
    /// Returns the settings in one line, for messages.
    pub fn in_words(&self) -> String {
        let pairs: Vec<String> = self.settings.iter().map(|(key, value)| format!("{key}={value}")).collect();
        pairs.join(" ").replace('"', "")
    }
}

/// Plan of a sweep.
#[derive(Debug)]
pub struct SweepPlan {
    /// The folder.
    pub folder: PathBuf,
    /// The command of each task.
    pub command: TaskCommand,
    /// The tasks, in order.
    pub tasks: Vec<SweepTask>,
    /// Version of the program that made the plan.
    pub program_version: String,
    /// The problems of the plan, in a sentence each.
    pub problems: Vec<String>,
}

/// Checksums of files that tasks name, each read once.
#[derive(Debug, Default)]
pub struct InputSums(Mutex<HashMap<PathBuf, String>>);

impl InputSums {
    /// Returns the name of a task with these settings.
    ///
    /// # Errors
    /// If a file that the settings name cannot be read.
    pub fn id(&self, command: TaskCommand, settings: &TaskSettings) -> Result<String> {
        // Why: notes/decisions/sweeps.md, "A task's name is the checksum of everything that decides its result".
        let mut files = Vec::new();
        for key in FILES {
            let Some(name) = settings.get(key).and_then(|value| value.as_str()) else { continue };
            let file = if key == "object" { mvt_objects::catalogue::mesh_path(name) } else { Some(name.into()) };
            if let Some(file) = file {
                files.push(self.sum(&file)?);
            }
        }
        let identity = serde_json::to_vec(&(env!("CARGO_PKG_VERSION"), command, settings, files))?;
        let mut id = blake3::hash(&identity).to_hex().to_string();
        id.truncate(ID_DIGITS);
        Ok(id)
    }

    fn sum(&self, path: &Path) -> Result<String> {
        let mut sums = self.0.lock().map_err(|_| anyhow::anyhow!("a worker panicked"))?;
        if let Some(sum) = sums.get(path) {
            return Ok(sum.clone());
        }
        let bytes = input::read(path, LARGEST_INPUT).with_context(|| format!("cannot read {}", path.display()))?;
        let sum = blake3::hash(&bytes).to_hex().to_string();
        sums.insert(path.to_owned(), sum.clone());
        Ok(sum)
    }
}

impl SweepPlan {
    /// Writes the plan of a specification into a folder, and returns the number of tasks. A folder that holds the same plan stays as it is.
    ///
    /// # Errors
    /// If a value is invalid, the folder holds something else, or it cannot be written.
    pub fn write(spec: &SweepSpec, folder: &Path) -> Result<usize> {
        work::check(spec)?;
        let _claimed = ClaimedFolder::claim(folder, "sweep", Earlier::Keep, false)?;
        let path = folder.join(TASKS);
        let cannot_write = || format!("cannot write {}", path.display());
        let mut partial = PartialFile::create(&path).with_context(cannot_write)?;
        let (mut hasher, sums) = (blake3::Hasher::new(), InputSums::default());
        let mut out = BufWriter::new(partial.file());
        for number in 0..spec.len() {
            let settings = spec.task(number);
            let id = sums.id(spec.command, &settings)?;
            let mut line = serde_json::to_vec(&SweepTask { id, settings })?;
            line.push(b'\n');
            hasher.update(&line);
            out.write_all(&line).with_context(cannot_write)?;
        }
        out.flush().with_context(cannot_write)?;
        drop(out);
        let plan = PlanFile {
            format: FORMAT,
            program_version: env!("CARGO_PKG_VERSION").to_owned(),
            command: spec.command,
            tasks: spec.len(),
            tasks_blake3: hasher.finalize().to_hex().to_string(),
        };
        let earlier = folder.join(PLAN);
        if earlier.exists() {
            let is_same = read_plan(&earlier)?.tasks_blake3 == plan.tasks_blake3;
            ensure!(is_same, "{} holds the plan of other tasks; choose another --out", folder.display());
            return Ok(spec.len());
        }
        partial.replace().with_context(cannot_write)?;
        // It comes last: a folder with a plan.json is planned.
        mvt_run::io::write_file(folder, PLAN, &serde_json::to_vec_pretty(&plan)?)?;
        Ok(spec.len())
    }

    /// Reads a plan. Its problems stand in [`SweepPlan::problems`].
    ///
    /// # Errors
    /// If the folder holds no plan, or one of a newer format.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(PLAN);
        ensure!(path.exists(), "{} holds no plan; make one with `mambavitact sweep plan`", folder.display());
        let plan = read_plan(&path)?;
        if plan.format > FORMAT {
            bail!("{}: its format {} is newer than {FORMAT}; update the program", path.display(), plan.format);
        }
        let path = folder.join(TASKS);
        let text = input::read_text(&path, LARGEST_TASKS).with_context(|| format!("cannot read {}", path.display()))?;
        let mut problems = Vec::new();
        if plan.program_version != env!("CARGO_PKG_VERSION") {
            problems.push(format!(
                "the plan is of version {} and this program of version {}; run it with that version, or plan anew",
                plan.program_version,
                env!("CARGO_PKG_VERSION")
            ));
        }
        if blake3::hash(text.as_bytes()).to_hex().as_str() != plan.tasks_blake3 {
            problems
                .push(format!("{} was changed after it was planned; plan anew into another folder", path.display()));
        }
        let mut tasks = Vec::with_capacity(plan.tasks.min(text.len() / ID_DIGITS));
        for (number, line) in text.lines().enumerate() {
            let task: SweepTask =
                serde_json::from_str(line).with_context(|| format!("{}, line {}", path.display(), number + 1))?;
            let is_name = task.id.len() == ID_DIGITS && task.id.bytes().all(|byte| byte.is_ascii_hexdigit());
            ensure!(is_name, "{}, line {}: the id is not {ID_DIGITS} hexadecimal digits", path.display(), number + 1);
            tasks.push(task);
        }
        if tasks.len() != plan.tasks {
            problems.push(format!("{} has {} tasks and the plan {}", path.display(), tasks.len(), plan.tasks));
        }
        Ok(Self {
            folder: folder.to_path_buf(),
            command: plan.command,
            tasks,
            program_version: plan.program_version,
            problems,
        })
    }

    /// Returns an error with the first problem, if there is one.
    ///
    /// # Errors
    /// The first problem.
    pub fn refuse_problems(&self) -> Result<()> {
        match self.problems.first() {
            Some(problem) => bail!("{}: {problem}", self.folder.display()),
            None => Ok(()),
        }
    }
}

fn read_plan(path: &Path) -> Result<PlanFile> {
    let bytes = input::read(path, LARGEST_PLAN).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_slice(&bytes).with_context(|| path.display().to_string())
}
