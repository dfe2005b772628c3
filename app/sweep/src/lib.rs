//! `sweep`: thousands of episodes as independent tasks, on one machine or on a cluster.
//!
//! A plan lists tasks; each has a name that is the checksum of all that decides its result. A process does the tasks of its shard, and each
//! result appears whole or not at all, so that a shared folder suffices: there are no locks, no server and no clocks. Merging is independent
//! of order. Details stand in docs/cluster.md.
//!
//! ```
//! use mvt_sweep::{Shard, SweepSpec};
//!
//! let spec = SweepSpec::parse(
//!     "command = \"generate\"\n[fixed]\nduration = 2.0\n[axes]\nobject = [\"cube70\"]\nseed = { from = 0, count = 3 }\n",
//!     1000,
//! )?;
//! assert_eq!(spec.len(), 3);
//! assert_eq!(spec.task(2)["seed"], 2);
//!
//! // Task k belongs to shard k modulo N.
//! let shard: Shard = "1/2".parse().map_err(anyhow::Error::msg)?;
//! assert!(shard.contains(1) && !shard.contains(2));
//! # Ok::<(), anyhow::Error>(())
//! ```

// Its build script puts libmujoco on the link line.
use mvt_mujoco_lib as _;

mod merge;
mod plan;
mod shard;
mod slurm;
mod spec;
mod status;
mod store;
mod work;
mod worker;

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use anyhow::{Context as _, Result, bail, ensure};
use clap::{Args, Subcommand, value_parser};
use mvt_files::input;
use mvt_run::io::{print_line, shell_word};

pub use merge::merge;
pub use plan::{InputSums, SweepPlan, SweepTask};
pub use shard::Shard;
pub use slurm::SlurmArguments;
pub use spec::{SweepSpec, TaskCommand, TaskSettings};
pub use status::SweepStatus;
pub use store::{FileSum, Manifest, Store, TaskProgress};
pub use worker::{Outcome, TaskWork, Worker};

/// Largest specification that is read, bytes.
const LARGEST_SPEC: u64 = 16 << 20;

/// Do thousands of episodes as independent tasks, on one machine or on a cluster
///
/// `plan` lists the tasks, `run` does them or a shard of them, `merge` makes one data set or one table. Processes share
/// a folder and nothing else: no locks and no server. A process may be killed at any time; the same command continues.
///
/// SPEC.toml names the command that a task does, and what varies:
///
///   command = "generate"                     # or "evaluate"
///   points = 20                              # for axes with min and max alone: points of a Latin hypercube
///   [fixed]                                  # the same in all tasks
///   duration = 30.0
///   format = "compact"
///   [axes]                                   # every combination is a task
///   object = ["077_rubiks_cube", "025_mug"]  # a list, or { from = 0, count = 50, prefix = "random:" }
///   seed = { from = 0, count = 100 }
///   cameras = ["front-left", "side,top-down"]
///
/// Keys of generate: object, seed, cameras, duration, noise, touch_config, background, gait, side, format. Keys of
/// evaluate: object, seed, cameras, duration, mode, modality, estimator_seed, touch_depth, weights, and every setting of
/// `run --set`, such as slam.tracker.touch_weight = { min = 0.5, max = 2.0, steps = 4 }.
#[derive(Debug, Subcommand)]
#[command(verbatim_doc_comment)]
#[allow(rustdoc::broken_intra_doc_links, reason = "`[fixed]` and `[axes]` are tables of a TOML file in the help text")]
pub enum SweepCommand {
    #[allow(missing_docs, reason = "the arguments have the help text")]
    Plan(PlanArguments),
    #[allow(missing_docs, reason = "the arguments have the help text")]
    Run(RunShardArguments),
    #[allow(missing_docs, reason = "the arguments have the help text")]
    Status(StatusArguments),
    #[allow(missing_docs, reason = "the arguments have the help text")]
    Merge(MergeArguments),
    #[allow(missing_docs, reason = "the arguments have the help text")]
    Retry(RetryArguments),
    #[allow(missing_docs, reason = "the arguments have the help text")]
    Slurm(SlurmArguments),
}

/// List the tasks of a specification in a folder
#[derive(Debug, Args)]
pub struct PlanArguments {
    /// Specification (TOML); see `sweep --help`
    #[arg(value_name = "SPEC")]
    spec: PathBuf,
    /// Folder for plan and results
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Largest number of tasks
    #[arg(long, default_value_t = 100_000, value_parser = value_parser!(u64).range(1..=10_000_000))]
    limit: u64,
}

/// Do the tasks of a plan, or a shard of them
///
/// Finished tasks are skipped. A failed task is tried again after the others and then set aside with its reason. SIGINT
/// or SIGTERM ends the command after the task in hand.
#[derive(Debug, Args)]
pub struct RunShardArguments {
    /// Folder of the sweep
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Do only every Nth task, from number I on (0 to N - 1) [default: by SLURM_ARRAY_TASK_ID, else all]
    #[arg(long, value_name = "I/N", conflicts_with = "shards")]
    shard: Option<Shard>,
    /// Number of shards; the index comes from SLURM_ARRAY_TASK_ID or JOB_COMPLETION_INDEX
    #[arg(long, value_name = "N", value_parser = value_parser!(u64).range(1..))]
    shards: Option<u64>,
    /// Number of tasks at a time
    #[arg(long, default_value_t = 1, value_parser = value_parser!(u16).range(1..=1024))]
    jobs: u16,
    /// How often a failed task is tried again
    #[arg(long, default_value_t = 2, value_parser = value_parser!(u32).range(0..=100))]
    retries: u32,
}

/// Show how many tasks are done, set aside, begun and waiting
#[derive(Debug, Args)]
pub struct StatusArguments {
    /// Folder of the sweep
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Read all results and compare them with their checksums
    #[arg(long)]
    check: bool,
    /// Print one JSON object instead of words
    #[arg(long)]
    json: bool,
}

/// Make one data set or one table of the results
///
/// Logs become OUT/OBJECT/00, OUT/OBJECT/01 and so on, as `generate` writes them, without taking more space where the
/// file system knows hard links. Runs become OUT/runs.jsonl and OUT/table.md, as `evaluate` writes them, but without
/// frames per second. OUT/sweep.jsonl says which task a result is of.
#[derive(Debug, Args)]
pub struct MergeArguments {
    /// Folder of the sweep; several folders with the same plan if nodes share no disk
    #[arg(value_name = "DIR", required = true)]
    folders: Vec<PathBuf>,
    /// Folder for the result, which must not exist
    #[arg(long, value_name = "OUT")]
    out: PathBuf,
    /// Allow tasks without a result
    #[arg(long)]
    partial: bool,
}

/// Let tasks that were set aside, or left by a killed process, wait again
#[derive(Debug, Args)]
pub struct RetryArguments {
    /// Folder of the sweep, in which no process works
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Also check all results; those that do not fit their manifests are moved to DIR/damaged, and their tasks wait again
    #[arg(long)]
    damaged: bool,
}

/// Runs the command. `stop` is asked for when tasks are done: a flag that signals set.
///
/// # Errors
/// If the command fails.
pub fn run(command: &SweepCommand, stop: impl FnOnce() -> Result<std::sync::Arc<AtomicBool>>) -> Result<()> {
    match command {
        SweepCommand::Plan(arguments) => run_plan(arguments),
        SweepCommand::Run(arguments) => run_shard(arguments, &*stop()?),
        SweepCommand::Status(arguments) => run_status(arguments),
        SweepCommand::Merge(arguments) => run_merge(arguments),
        SweepCommand::Retry(arguments) => run_retry(arguments),
        SweepCommand::Slurm(arguments) => slurm::run(arguments),
    }
}

fn run_plan(arguments: &PlanArguments) -> Result<()> {
    let path = &arguments.spec;
    let text = input::read_text(path, LARGEST_SPEC).with_context(|| format!("cannot read {}", path.display()))?;
    let spec = SweepSpec::parse(&text, arguments.limit).with_context(|| path.display().to_string())?;
    let tasks = SweepPlan::write(&spec, &arguments.out).with_context(|| path.display().to_string())?;
    print_line(&format!("{tasks} tasks of {} in {}", spec.command.name(), arguments.out.display()))?;
    let folder = shell_word(&arguments.out.to_string_lossy());
    print_line(&format!("next: mambavitact sweep run {folder}, or mambavitact sweep slurm {folder}"))
}

fn run_shard(arguments: &RunShardArguments, stop: &AtomicBool) -> Result<()> {
    let plan = SweepPlan::read(&arguments.folder)?;
    let shard = Shard::choose(arguments.shard, arguments.shards, |name| std::env::var(name).ok())?;
    let worker = Worker {
        plan: &plan,
        shard,
        jobs: usize::from(arguments.jobs),
        retries: arguments.retries,
        stop,
        work: &work::run,
    };
    let outcome = worker.run()?;
    let Outcome { done, earlier, set_aside, left, overhead } = outcome;
    let each = overhead.checked_div(done as u32).unwrap_or(Duration::ZERO).as_secs_f64() * 1e3;
    print_line(&format!(
        "shard {shard}: {done} tasks done, {earlier} were done before, {each:.1} ms per task beside the work"
    ))?;
    let folder = shell_word(&arguments.folder.to_string_lossy());
    ensure!(left == 0, "stopped by a signal with {left} tasks left; the same command continues");
    ensure!(set_aside == 0, "{set_aside} tasks are set aside; `mambavitact sweep status {folder}` gives the reasons");
    Ok(())
}

fn run_status(arguments: &StatusArguments) -> Result<()> {
    let plan = SweepPlan::read(&arguments.folder)?;
    let status = SweepStatus::read(&plan, arguments.check)?;
    if arguments.json { print_line(&serde_json::to_string(&status)?) } else { print_line(&status.in_words(&plan)) }
}

fn run_merge(arguments: &MergeArguments) -> Result<()> {
    let plans: Vec<SweepPlan> =
        arguments.folders.iter().map(|folder| SweepPlan::read(folder)).collect::<Result<_>>()?;
    for plan in &plans {
        plan.refuse_problems()?;
    }
    let results = merge(&plans, &arguments.out, arguments.partial)?;
    print_line(&format!("{results} results in {}", arguments.out.display()))
}

fn run_retry(arguments: &RetryArguments) -> Result<()> {
    let plan = SweepPlan::read(&arguments.folder)?;
    let store = Store::new(&plan.folder);
    let progress = store.progress()?;
    let mut put_back = 0;
    let mut finished = Vec::new();
    for task in &plan.tasks {
        if progress.failed.contains(&task.id) || progress.begun.contains_key(&task.id) {
            store.put_back(&task.id, progress.begun.get(&task.id).copied().unwrap_or(0))?;
            put_back += 1;
        } else if progress.done.contains(&task.id) {
            finished.push(task);
        }
    }
    if arguments.damaged {
        for (task, reason) in status::damaged(&store, &finished) {
            tracing::warn!("{reason}");
            store.put_aside_damaged(&task.id)?;
            put_back += 1;
        }
    }
    if put_back == 0 {
        bail!("no task was set aside or left; `mambavitact sweep run` does those that wait");
    }
    print_line(&format!("{put_back} tasks wait again"))
}
