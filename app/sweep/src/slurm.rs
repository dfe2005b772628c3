//! A job array of Slurm as a script that people can read and change.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, ensure};
use clap::{Args, value_parser};
use mvt_files::input;
use mvt_run::io::{print_line, shell_word};

use crate::plan::SweepPlan;

/// Tasks of a job, if the number of jobs is not given.
const TASKS_PER_JOB: usize = 10;
/// Most jobs of an array: Slurm's default allows 1001.
const MOST_JOBS: usize = 1000;

/// Print a job array for Slurm, and submit it with --submit
///
/// Each job does one shard. Change the script as your cluster needs: a partition, an account, modules.
#[derive(Debug, Args)]
pub struct SlurmArguments {
    /// Folder of the sweep; all nodes must see it under this path
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Number of jobs [default: one for ten tasks, at most 1000]
    #[arg(long, value_parser = value_parser!(u64).range(1..=100_000))]
    shards: Option<u64>,
    /// Longest time of a job in minutes
    #[arg(long, default_value_t = 240, value_parser = value_parser!(u32).range(1..=100_000))]
    minutes: u32,
    /// Time before the end of a job, in seconds, at which it stops after the task in hand and is queued again
    #[arg(long, default_value_t = 120, value_parser = value_parser!(u32).range(1..=65_535))]
    warn: u32,
    /// Cores of a job
    #[arg(long, default_value_t = 1, value_parser = value_parser!(u16).range(1..=1024))]
    cpus: u16,
    /// Memory of a job in MB
    #[arg(long, default_value_t = 4000, value_parser = value_parser!(u32).range(1..))]
    memory: u32,
    /// Submit the script with sbatch; it is kept as DIR/slurm.sh, and an earlier one is used as it stands
    #[arg(long)]
    submit: bool,
}

/// Runs the command.
pub fn run(arguments: &SlurmArguments) -> Result<()> {
    let plan = SweepPlan::read(&arguments.folder)?;
    plan.refuse_problems()?;
    let program = std::env::current_exe().context("cannot find this program")?;
    let here = std::env::current_dir().context("cannot find the current folder")?;
    let folder = here.join(&arguments.folder);
    let script = script(arguments, plan.tasks.len(), &program, &here, &folder);
    if !arguments.submit {
        return print_line(script.trim_end());
    }
    let path = folder.join("slurm.sh");
    if !path.exists() {
        mvt_run::io::write_file(&folder, "slurm.sh", script.as_bytes())?;
    }
    let text = input::read_text(&path, 1 << 20).with_context(|| format!("cannot read {}", path.display()))?;
    // Some versions of Slurm fail without a word when the folder of the output is absent.
    let logs = folder.join("logs");
    std::fs::create_dir_all(&logs).with_context(|| format!("cannot make {}", logs.display()))?;
    let output = Command::new("sbatch").arg("--parsable").arg(&path).output().context("cannot start sbatch")?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "sbatch refused {}: {}", path.display(), said.trim());
    let job = String::from_utf8_lossy(&output.stdout).trim().to_owned();
    let jobs = text.lines().find_map(|line| line.strip_prefix("#SBATCH --array=")).unwrap_or("?");
    print_line(&format!("job {job}, array {jobs}"))?;
    print_line(&format!("next: mambavitact sweep status {}", shell_word(&arguments.folder.to_string_lossy())))
}

fn script(arguments: &SlurmArguments, tasks: usize, program: &Path, here: &Path, folder: &Path) -> String {
    let word = |path: &Path| shell_word(&path.to_string_lossy());
    let jobs = tasks.div_ceil(TASKS_PER_JOB).clamp(1, MOST_JOBS) as u64;
    let jobs = arguments.shards.unwrap_or(jobs);
    let SlurmArguments { minutes, warn, cpus, memory, .. } = arguments;
    let (program, here, sweep, last) = (word(program), word(here), word(folder), jobs - 1);
    let name = folder.file_name().map_or_else(|| "sweep".into(), |name| shell_word(&name.to_string_lossy()));
    let logs = word(&folder.join("logs"));
    format!(
        r#"#!/bin/bash
#SBATCH --job-name={name}
#SBATCH --array=0-{last}
#SBATCH --cpus-per-task={cpus}
#SBATCH --mem={memory}M
#SBATCH --time={minutes}
#SBATCH --requeue
#SBATCH --signal=B:USR1@{warn}
#SBATCH --open-mode=append
#SBATCH --output={logs}/%A_%a.txt
# {tasks} tasks in {jobs} jobs. Make the folder of the logs before you submit this yourself:
#   mkdir -p {sweep}/logs
# A job that was killed, cancelled or queued again skips finished tasks. To do some shards again, submit this with --array=3,7.
cd {here} || exit 1
export RAYON_NUM_THREADS={cpus}
# USR1 comes {warn} s before the time limit. The program then finishes the task in hand, and the job is queued again.
warned=
trap 'warned=yes; kill -TERM $program' USR1
trap 'kill -TERM $program' TERM
{program} sweep run {sweep} --shard "$SLURM_ARRAY_TASK_ID/{jobs}" &
program=$!
wait $program
code=$?
while kill -0 $program 2>/dev/null; do wait $program; code=$?; done
# 137: the program was killed, perhaps for memory. A task that is killed again and again is set aside.
if [ -n "$warned" ] || {{ [ $code = 137 ] && [ "${{SLURM_RESTART_COUNT:-0}}" -lt 5 ]; }}; then
    scontrol requeue "${{SLURM_ARRAY_JOB_ID}}_$SLURM_ARRAY_TASK_ID"
fi
exit $code
"#
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_script_names_its_shards_and_quotes_paths() {
        let arguments = SlurmArguments {
            folder: "a b".into(),
            shards: None,
            minutes: 60,
            warn: 90,
            cpus: 2,
            memory: 500,
            submit: false,
        };
        let text =
            script(&arguments, 95, Path::new("/opt/mvt"), Path::new("/home/o'neil"), Path::new("/home/o'neil/a b"));
        for line in [
            "#SBATCH --array=0-9",
            "#SBATCH --signal=B:USR1@90",
            "#SBATCH --requeue",
            r"cd '/home/o'\''neil' || exit 1",
            r#"/opt/mvt sweep run '/home/o'\''neil/a b' --shard "$SLURM_ARRAY_TASK_ID/10" &"#,
        ] {
            assert!(text.lines().any(|found| found == line), "{line}\n{text}");
        }
        assert_eq!(
            script(&arguments, 1_000_000, Path::new("p"), Path::new("/"), Path::new("/s")).matches("0-999").count(),
            1
        );
    }
}
