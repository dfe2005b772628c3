//! The place of a measurement: the repository, its commit, the machine and the date.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;

use anyhow::{Context as _, Result, bail};

/// The generated page, relative to the root.
pub const PAGE: &str = "RESULTS.md";
/// The folder of claims, values and tables, relative to the root.
pub const FOLDER: &str = "results";
/// The generated page of the groups that are not on [`PAGE`], in [`FOLDER`].
pub const MORE: &str = "more.md";
/// What follows the hash of a commit from which tracked files differ.
pub const CHANGES: &str = "+changes";
/// The folder of the files that commands write, relative to the root.
const SCRATCH: &str = "target/results";

/// Paths of the repository.
#[derive(Debug, Clone)]
pub struct Repository {
    /// The folder that contains RESULTS.md and `results/`.
    root: PathBuf,
}

impl Repository {
    /// The repository at this root.
    pub fn at(root: &Path) -> Self {
        Self { root: root.to_owned() }
    }

    /// The repository that contains the current folder.
    pub fn find() -> Result<Self> {
        let here = std::env::current_dir().context("cannot find the current folder")?;
        let root = here.ancestors().find(|folder| folder.join(FOLDER).join("claims.toml").is_file());
        root.map(Self::at).with_context(|| {
            format!("no {FOLDER}/claims.toml in {} or above; run this in the repository", here.display())
        })
    }

    /// The root folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The generated page.
    pub fn page(&self) -> PathBuf {
        self.root.join(PAGE)
    }

    /// The file of claims.
    pub fn claims(&self) -> PathBuf {
        self.root.join(FOLDER).join("claims.toml")
    }

    /// The file of values.
    pub fn values(&self) -> PathBuf {
        self.root.join(FOLDER).join("values.jsonl")
    }

    /// A table that is copied from a measurement.
    pub fn table(&self, name: &str) -> PathBuf {
        self.root.join(FOLDER).join(name)
    }

    /// The folder of a group's files.
    pub fn scratch(&self, group: &str) -> PathBuf {
        self.root.join(SCRATCH).join(group)
    }

    /// A command with `$OUT` replaced by the folder of the group's files, relative to the root.
    pub fn expanded(command: &str, group: &str) -> String {
        command.replace("$OUT", &format!("{SCRATCH}/{group}"))
    }

    /// The short hash of the commit, with `+changes` if tracked files differ from it. Results and notes do not count.
    pub fn commit(&self) -> Result<String> {
        let hash = self.output("git", &["rev-parse", "--short=7", "HEAD"])?;
        let ignored = ["RESULTS.md", "results/*.md", "results/*.csv", "results/values.jsonl", "notes"]
            .map(|path| format!(":(exclude){path}"));
        let mut arguments = vec!["status", "--porcelain", "--untracked-files=no", "--", "."];
        arguments.extend(ignored.iter().map(String::as_str));
        let is_clean = self.output("git", &arguments)?.is_empty();
        Ok(if is_clean { hash } else { hash + CHANGES })
    }

    /// The date in UTC, such as 2026-11-22.
    pub fn date(&self) -> Result<String> {
        self.output("date", &["-u", "+%F"])
    }

    /// The output of a program, without white space at the ends.
    fn output(&self, program: &str, arguments: &[&str]) -> Result<String> {
        let output = Command::new(program).args(arguments).current_dir(&self.root).output();
        let output = output.with_context(|| format!("cannot start {program}; is it installed?"))?;
        if !output.status.success() {
            bail!("{program} {} failed: {}", arguments.join(" "), String::from_utf8_lossy(&output.stderr).trim());
        }
        Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned())
    }
}

/// The processor and the number of cores that this process may use.
pub fn machine() -> String {
    let info = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let plural = if cores == 1 { "" } else { "s" };
    format!("{}, {cores} core{plural}", processor(&info))
}

/// The processor's name in the text of /proc/cpuinfo; a nameless one is described by its vector instructions.
fn processor(info: &str) -> String {
    let value = |key: &str| {
        let line = info.lines().find(|line| line.split(':').next().is_some_and(|name| name.trim() == key))?;
        Some(line.split_once(':')?.1.trim())
    };
    let Some(model) = value("model name") else { return "unknown processor".to_owned() };
    let name = model.replace("(R)", "").replace("(TM)", "");
    let name = name.split('@').next().unwrap_or_default();
    let words: Vec<&str> = name.split_whitespace().filter(|word| !["CPU", "Processor"].contains(word)).collect();
    let mut name = words.join(" ");
    if !name.contains(|c: char| c.is_ascii_digit()) {
        let flags: Vec<&str> = value("flags").unwrap_or_default().split_whitespace().collect();
        let best = [("amx_tile", "AMX"), ("avx512f", "AVX-512"), ("avx2", "AVX2")];
        if let Some((_, shown)) = best.iter().find(|(flag, _)| flags.contains(flag)) {
            name = format!("{name} ({shown})");
        }
    }
    name
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processors_are_named_shortly() {
        let full = "processor : 0\nmodel name\t: Intel(R) Core(TM) i7-8700 CPU @ 3.20GHz\nflags : fpu avx2\n";
        assert_eq!(processor(full), "Intel Core i7-8700");
        let nameless = "model name : Intel(R) Xeon(R) Processor\nflags : fpu avx2 avx512f amx_tile\n";
        assert_eq!(processor(nameless), "Intel Xeon (AMX)");
        assert_eq!(processor(""), "unknown processor");
    }

    #[test]
    fn the_scratch_folder_replaces_its_variable() {
        assert_eq!(
            Repository::expanded("cat $OUT/a > $OUT/b", "slam"),
            "cat target/results/slam/a > target/results/slam/b"
        );
    }
}
