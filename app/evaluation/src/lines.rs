//! Lines of results: episodes are worked off several at a time, and finished ones are not repeated.

use std::collections::HashSet;
use std::fs::{File, OpenOptions};
use std::io::{self, Write as _};
use std::path::Path;
use std::sync::Mutex;
use std::thread;

use anyhow::{Context as _, Result, anyhow};
use mvt_files::input;
use mvt_run::progress;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Episode, EvaluateArguments, Key, Line};

/// A line of results that tells which run it is of.
pub trait Keyed {
    fn key(&self) -> &Key;
}

impl Keyed for Line {
    fn key(&self) -> &Key {
        &self.key
    }
}

/// Receives each line when it is complete.
pub type Tell<'a, L> = &'a mut dyn FnMut(L) -> Result<()>;

/// Works off all episodes, several at a time (`work` gives the keys of an episode's lines, those that are done included), and gives the lines of all that were asked for, those of earlier runs included.
pub fn all<L: Keyed + Clone + Serialize + DeserializeOwned + Send>(
    arguments: &EvaluateArguments,
    episodes: &[Episode<'_>],
    path: &Path,
    work: impl Fn(&Episode<'_>, &HashSet<Key>, Tell<'_, L>) -> Result<HashSet<Key>> + Sync,
) -> Result<Vec<L>> {
    let before: Vec<L> = read_lines(path)?;
    let done: HashSet<Key> = before.iter().map(|line| line.key().clone()).collect();
    let file = OpenOptions::new().create(true).append(true).open(path).and_then(|file| end_last_line(file, path));
    let file = file.with_context(|| path.display().to_string())?;
    let written = Mutex::new((file, before));
    let wanted = Mutex::new(HashSet::new());
    let bar = progress::bar(episodes.len() as u64, "episodes");
    let queue = Mutex::new(episodes.iter());
    let worker = || -> Result<()> {
        loop {
            let next = queue.lock().map_err(|_| poisoned())?.next();
            let Some(episode) = next else { return Ok(()) };
            let mut tell = |line: L| {
                let (file, lines) = &mut *written.lock().map_err(|_| poisoned())?;
                append(file, path, &line)?;
                lines.push(line);
                Ok(())
            };
            let of_episode = work(episode, &done, &mut tell)
                .with_context(|| format!("{}, seed {}, {}", episode.name, episode.seed, episode.cameras))?;
            wanted.lock().map_err(|_| poisoned())?.extend(of_episode);
            bar.inc(1);
        }
    };
    thread::scope(|scope| {
        let workers: Vec<_> = (0..arguments.jobs).map(|_| scope.spawn(worker)).collect();
        workers.into_iter().try_for_each(|worker| worker.join().map_err(|_| poisoned())?)
    })?;
    bar.finish_and_clear();
    let (_, lines) = written.into_inner().map_err(|_| poisoned())?;
    let wanted = wanted.into_inner().map_err(|_| poisoned())?;
    let mut lines: Vec<L> = lines.into_iter().filter(|line| wanted.contains(line.key())).collect();
    lines.sort_by(|a, b| a.key().cmp(b.key()));
    Ok(lines)
}

fn poisoned() -> anyhow::Error {
    anyhow!("a worker panicked")
}

/// The lines of an earlier run; the last may have been cut off.
fn read_lines<L: DeserializeOwned>(path: &Path) -> Result<Vec<L>> {
    match input::read_text(path, u64::MAX) {
        Ok(text) => Ok(text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(error).with_context(|| path.display().to_string()),
    }
}

/// Ends a last line that was cut off when a process was killed, so that it spoils no other line.
fn end_last_line(mut file: File, path: &Path) -> io::Result<File> {
    if input::read(path, u64::MAX)?.last().is_some_and(|&byte| byte != b'\n') {
        file.write_all(b"\n")?;
    }
    Ok(file)
}

fn append(file: &mut File, path: &Path, line: &impl Serialize) -> Result<()> {
    let text = serde_json::to_string(line)?;
    file.write_all(format!("{text}\n").as_bytes()).with_context(|| format!("cannot write {}", path.display()))
}
