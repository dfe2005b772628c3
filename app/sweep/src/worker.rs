//! The tasks of a shard, one after another or several at a time.

use std::collections::HashSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow, bail};
use mvt_run::progress;

use crate::plan::{InputSums, SweepPlan, SweepTask};
use crate::shard::Shard;
use crate::spec::{TaskCommand, TaskSettings};
use crate::store::Store;

/// The operating system's number for a full disk. The next task would fail for the same reason.
const DISK_FULL: &str = "No space left on device";

/// Does a task: its command, its settings, and the folder for its files.
pub type TaskWork<'a> = &'a (dyn Fn(TaskCommand, &TaskSettings, &Path) -> Result<()> + Sync);

/// What became of the tasks of a shard.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Outcome {
    /// Finished by this call.
    pub done: usize,
    /// Finished before.
    pub earlier: usize,
    /// Set aside, by this call or before.
    pub set_aside: usize,
    /// Left, because the process was asked to stop.
    pub left: usize,
    /// Wall time beside the work itself, of all workers together.
    pub overhead: Duration,
}

/// How tasks are done.
pub struct Worker<'a> {
    /// The plan.
    pub plan: &'a SweepPlan,
    /// Which of its tasks.
    pub shard: Shard,
    /// Tasks at a time.
    pub jobs: usize,
    /// How often a failed task is tried again.
    pub retries: u32,
    /// Set when the process shall stop: tasks that are being done are finished.
    pub stop: &'a AtomicBool,
    /// Does a task.
    pub work: TaskWork<'a>,
}

/// What became of one attempt.
enum Attempt {
    Done,
    Earlier,
    Failed,
    Left,
    SetAside,
}

impl Worker<'_> {
    /// Does all tasks of the shard that are neither done nor set aside. Failed tasks are tried again after all others.
    ///
    /// # Errors
    /// If the plan does not fit this program, a task was changed after it was planned, or the disk is full.
    pub fn run(&self) -> Result<Outcome> {
        self.plan.refuse_problems()?;
        let store = Store::new(&self.plan.folder);
        store.prepare()?;
        let mut waiting: Vec<&SweepTask> = self
            .plan
            .tasks
            .iter()
            .enumerate()
            .filter(|(number, _)| self.shard.contains(*number))
            .map(|(_, task)| task)
            .collect();
        let mine: HashSet<&str> = waiting.iter().map(|task| task.id.as_str()).collect();
        store.tidy(|id| mine.contains(id))?;
        let sums = InputSums::default();
        let mut outcome = Outcome::default();
        let bar = progress::bar(waiting.len() as u64, &format!("shard {}", self.shard));
        while !waiting.is_empty() {
            let next = AtomicUsize::new(0);
            let shared = Mutex::new((&mut outcome, Vec::new()));
            let worker = || -> Result<()> {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    let Some(&task) = waiting.get(number) else { return Ok(()) };
                    if self.stop.load(Ordering::Relaxed) {
                        shared.lock().unwrap_or_else(PoisonError::into_inner).0.left += 1;
                        continue;
                    }
                    let begun = Instant::now();
                    let (attempt, worked) = self.attempt(&store, &sums, task)?;
                    let mut shared = shared.lock().unwrap_or_else(PoisonError::into_inner);
                    shared.0.overhead += begun.elapsed().saturating_sub(worked);
                    match attempt {
                        Attempt::Done => shared.0.done += 1,
                        Attempt::Earlier => shared.0.earlier += 1,
                        Attempt::SetAside => shared.0.set_aside += 1,
                        Attempt::Failed => shared.1.push(number),
                        Attempt::Left => shared.0.left += 1,
                    }
                    if !matches!(attempt, Attempt::Failed | Attempt::Left) {
                        bar.inc(1);
                    }
                }
            };
            thread::scope(|scope| {
                let workers: Vec<_> = (0..self.jobs.max(1)).map(|_| scope.spawn(worker)).collect();
                workers
                    .into_iter()
                    .map(|worker| worker.join().map_err(|_| anyhow!("a worker panicked"))?)
                    .collect::<Result<Vec<()>>>()
            })?;
            let (_, mut again) = shared.into_inner().unwrap_or_else(PoisonError::into_inner);
            again.sort_unstable();
            waiting = again.into_iter().filter_map(|number| waiting.get(number).copied()).collect();
        }
        bar.finish_and_clear();
        Ok(outcome)
    }

    /// Tries a task once; returns what became of it and the time of the work itself.
    fn attempt(&self, store: &Store, sums: &InputSums, task: &SweepTask) -> Result<(Attempt, Duration)> {
        let id = &task.id;
        if store.done(id).exists() {
            return Ok((Attempt::Earlier, Duration::ZERO));
        }
        if store.failed(id).exists() {
            return Ok((Attempt::SetAside, Duration::ZERO));
        }
        if sums.id(self.plan.command, &task.settings)? != *id {
            bail!(
                "{}: task {id} or a file that it names was changed after it was planned; plan anew into another folder",
                self.plan.folder.display()
            );
        }
        let most = self.retries.saturating_add(1);
        let Some(number) = store.begin(id, most)? else {
            store.set_aside(id, most)?;
            return Ok((Attempt::SetAside, Duration::ZERO));
        };
        let begun = Instant::now();
        let place = store.workplace(id, number);
        let worked = catch_unwind(AssertUnwindSafe(|| (self.work)(self.plan.command, &task.settings, &place)));
        let time = begun.elapsed();
        let result = worked.unwrap_or_else(|panic| {
            let text = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
            Err(anyhow!("it panicked: {}", text.unwrap_or("without a message")))
        });
        let Err(error) = result.and_then(|()| store.finish(id, number)) else {
            tracing::info!("task {id} is done after {:.1} s", time.as_secs_f64());
            return Ok((Attempt::Done, time));
        };
        // Another process has finished it while this one worked.
        if store.done(id).exists() {
            return Ok((Attempt::Earlier, time));
        }
        let reason = format!("{error:#}").replace('\n', " ");
        // The signal that stops this process has ended a program that the task needs, such as ffmpeg.
        if self.stop.load(Ordering::Relaxed) {
            store.withdraw(id, number)?;
            tracing::warn!("task {id} is left: {reason}");
            return Ok((Attempt::Left, time));
        }
        store.note_failure(id, number, &reason)?;
        if reason.contains(DISK_FULL) {
            bail!("task {id}: {reason}; make room, then start the same command again");
        }
        tracing::warn!("task {id}, attempt {number} of {most}: {reason}");
        Ok((Attempt::Failed, time))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::SweepSpec;
    use crate::status::SweepStatus;
    use proptest::prelude::*;
    use std::collections::BTreeMap;
    use std::fs;

    /// A plan of so many tasks in a temporary folder.
    fn planned(tasks: usize) -> (tempfile::TempDir, SweepPlan) {
        let folder = tempfile::tempdir().unwrap();
        let text =
            format!("command = \"generate\"\n[axes]\nobject = [\"cube70\"]\nseed = {{ from = 0, count = {tasks} }}\n");
        SweepPlan::write(&SweepSpec::parse(&text, 1000).unwrap(), folder.path()).unwrap();
        let plan = SweepPlan::read(folder.path()).unwrap();
        (folder, plan)
    }

    fn seed(settings: &TaskSettings) -> u64 {
        settings["seed"].as_u64().unwrap()
    }

    fn run(plan: &SweepPlan, shard: Shard, jobs: usize, stop: &AtomicBool, work: TaskWork<'_>) -> Result<Outcome> {
        Worker { plan, shard, jobs, retries: 2, stop, work }.run()
    }

    fn write_seed(_: TaskCommand, settings: &TaskSettings, folder: &Path) -> Result<()> {
        Ok(fs::write(folder.join("seed.txt"), seed(settings).to_string())?)
    }

    /// The files of a sweep's results.
    fn results(plan: &SweepPlan) -> BTreeMap<String, String> {
        let store = Store::new(&plan.folder);
        let text = |task: &SweepTask| fs::read_to_string(store.done(&task.id).join("seed.txt")).ok();
        plan.tasks.iter().filter_map(|task| Some((task.id.clone(), text(task)?))).collect()
    }

    #[test]
    fn failures_are_tried_again_and_set_aside() {
        let (_folder, plan) = planned(6);
        let calls = Mutex::new(BTreeMap::<u64, u32>::new());
        let work = |command: TaskCommand, settings: &TaskSettings, folder: &Path| {
            let mut calls = calls.lock().unwrap_or_else(PoisonError::into_inner);
            let call = calls.entry(seed(settings)).or_default();
            *call += 1;
            match (seed(settings), *call) {
                (1, _) => bail!("the mesh is broken"),
                // It succeeds at its last attempt.
                (2, ..3) => panic!("out of luck"),
                _ => write_seed(command, settings, folder),
            }
        };
        let stop = AtomicBool::new(false);
        let outcome = run(&plan, Shard::ALL, 2, &stop, &work).unwrap();
        assert_eq!((outcome.done, outcome.set_aside, outcome.left), (5, 1, 0));
        let expected = [(0, 1), (1, 3), (2, 3), (3, 1), (4, 1), (5, 1)];
        assert_eq!(*calls.lock().unwrap_or_else(PoisonError::into_inner), BTreeMap::from(expected));
        let status = SweepStatus::read(&plan, true).unwrap();
        assert_eq!((status.done, status.set_aside, status.begun, status.waiting), (5, 1, 0, 0));
        assert!(status.reasons[0].ends_with("the mesh is broken") && status.problems.is_empty(), "{status:?}");
    }

    #[test]
    fn a_task_that_fails_while_the_process_is_stopped_costs_no_attempt() {
        let (_folder, plan) = planned(3);
        for _ in 0..5 {
            let stop = AtomicBool::new(false);
            let work = |command: TaskCommand, settings: &TaskSettings, folder: &Path| {
                write_seed(command, settings, folder)?;
                stop.store(true, Ordering::Relaxed);
                bail!("ffmpeg was interrupted")
            };
            let outcome = run(&plan, Shard::ALL, 1, &stop, &work).unwrap();
            assert_eq!((outcome.done, outcome.set_aside, outcome.left), (0, 0, 3));
        }
        let status = SweepStatus::read(&plan, false).unwrap();
        assert_eq!((status.begun, status.waiting), (0, 3));
        assert_eq!(fs::read_dir(plan.folder.join("partial")).unwrap().count(), 0);
        let outcome = run(&plan, Shard::ALL, 1, &AtomicBool::new(false), &write_seed).unwrap();
        assert_eq!((outcome.done, outcome.set_aside), (3, 0));
    }

    #[test]
    fn a_task_that_kills_its_process_is_set_aside() {
        let (_folder, plan) = planned(2);
        let store = Store::new(&plan.folder);
        store.prepare().unwrap();
        let killer = &plan.tasks[0].id;
        for _ in 0..3 {
            let number = store.begin(killer, 3).unwrap().unwrap();
            fs::write(store.workplace(killer, number).join("half"), "").unwrap();
        }
        let status = SweepStatus::read(&plan, false).unwrap();
        assert_eq!((status.begun, status.waiting), (1, 1));
        let outcome = run(&plan, Shard::ALL, 1, &AtomicBool::new(false), &write_seed).unwrap();
        assert_eq!((outcome.done, outcome.set_aside), (1, 1));
        assert!(store.failure(killer).contains("killed"));
        assert_eq!(fs::read_dir(plan.folder.join("partial")).unwrap().count(), 0);
    }

    #[test]
    fn a_full_disk_stops_the_shard_and_costs_no_other_task_its_attempts() {
        let (_folder, plan) = planned(4);
        let work = |command: TaskCommand, settings: &TaskSettings, folder: &Path| match seed(settings) {
            1 => bail!("cannot write a.jpg: {DISK_FULL} (os error 28)"),
            _ => write_seed(command, settings, folder),
        };
        let stop = AtomicBool::new(false);
        let error = run(&plan, Shard::ALL, 1, &stop, &work).unwrap_err().to_string();
        assert!(error.contains(DISK_FULL) && error.contains("make room"), "{error}");
        let status = SweepStatus::read(&plan, true).unwrap();
        assert_eq!((status.done, status.begun, status.waiting), (1, 1, 2));
        assert_eq!(run(&plan, Shard::ALL, 1, &stop, &write_seed).unwrap().done, 3);
    }

    #[test]
    fn a_signal_ends_the_shard_after_the_task_in_hand() {
        let (_folder, plan) = planned(5);
        let stop = AtomicBool::new(false);
        let work = |command: TaskCommand, settings: &TaskSettings, folder: &Path| {
            stop.store(seed(settings) == 1, Ordering::Relaxed);
            write_seed(command, settings, folder)
        };
        let outcome = run(&plan, Shard::ALL, 1, &stop, &work).unwrap();
        assert_eq!((outcome.done, outcome.left), (2, 3));
    }

    #[test]
    fn leftovers_of_a_finished_task_are_removed() {
        let (_folder, plan) = planned(1);
        let (store, id) = (Store::new(&plan.folder), &plan.tasks[0].id);
        run(&plan, Shard::ALL, 1, &AtomicBool::new(false), &write_seed).unwrap();
        // Processes were killed between the rename and the end, and while they removed files.
        store.begin(id, 3).unwrap().unwrap();
        let partial = store.workplace(id, 2);
        fs::create_dir(partial.with_file_name(format!("{id}.2.gone"))).unwrap();
        run(&plan, Shard::ALL, 1, &AtomicBool::new(false), &write_seed).unwrap();
        for name in ["attempts", "partial"] {
            assert_eq!(fs::read_dir(plan.folder.join(name)).unwrap().count(), 0, "{name}");
        }
        assert_eq!(results(&plan).len(), 1);
    }

    #[test]
    fn a_killed_attempt_is_not_disturbed_by_the_next_one() {
        let (_folder, plan) = planned(1);
        let (store, id) = (Store::new(&plan.folder), &plan.tasks[0].id);
        store.prepare().unwrap();
        // Slurm has given up the node of the first process, but it still works.
        let first = store.begin(id, 3).unwrap().unwrap();
        fs::write(store.workplace(id, first).join("seed.txt"), "first").unwrap();
        let second = store.begin(id, 3).unwrap().unwrap();
        store.note_failure(id, second, "the node has no memory").unwrap();
        store.finish(id, first).unwrap();
        assert_eq!(results(&plan)[id], "first");
        store.check(id).unwrap();
    }

    #[test]
    fn a_task_that_was_left_while_it_was_set_aside_waits_again() {
        let (_folder, plan) = planned(1);
        let (store, id) = (Store::new(&plan.folder), &plan.tasks[0].id);
        store.prepare().unwrap();
        store.begin(id, 3).unwrap().unwrap();
        fs::write(store.failed(id), "the mesh is broken").unwrap();
        let status = SweepStatus::read(&plan, false).unwrap();
        assert_eq!((status.set_aside, status.begun), (1, 0));
        store.put_back(id, store.progress().unwrap().begun[id]).unwrap();
        let status = SweepStatus::read(&plan, false).unwrap();
        assert_eq!((status.set_aside, status.begun, status.waiting), (0, 0, 1));
    }

    #[test]
    fn a_result_of_another_process_stays() {
        let (_folder, plan) = planned(1);
        let (store, id) = (Store::new(&plan.folder), &plan.tasks[0].id);
        store.prepare().unwrap();
        let work = |command: TaskCommand, settings: &TaskSettings, folder: &Path| {
            write_seed(command, settings, folder)?;
            // Meanwhile another process does the same task.
            let number = store.begin(id, 3)?.unwrap();
            fs::write(store.workplace(id, number).join("seed.txt"), "other")?;
            store.finish(id, number)
        };
        run(&plan, Shard::ALL, 1, &AtomicBool::new(false), &work).unwrap();
        assert_eq!(results(&plan)[id], "other");
        assert_eq!(SweepStatus::read(&plan, true).unwrap().done, 1);
        assert_eq!(fs::read_dir(plan.folder.join("partial")).unwrap().count(), 0);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn shards_in_any_order_do_each_task_once(tasks in 1usize..30, count in 1u64..9, jobs in 1usize..4, seed: u64) {
            use rand::SeedableRng as _;
            use rand::seq::SliceRandom as _;

            let (_folder, plan) = planned(tasks);
            let calls = AtomicUsize::new(0);
            let work = |command: TaskCommand, settings: &TaskSettings, folder: &Path| {
                calls.fetch_add(1, Ordering::Relaxed);
                write_seed(command, settings, folder)
            };
            let mut shards: Vec<u64> = (0..count).chain(0..count).collect();
            shards.shuffle(&mut rand_chacha::ChaCha8Rng::seed_from_u64(seed));
            let stop = AtomicBool::new(false);
            for index in shards {
                run(&plan, Shard::new(index, count).unwrap(), jobs, &stop, &work).unwrap();
            }
            prop_assert_eq!(calls.into_inner(), tasks);
            let (_other, alone) = planned(tasks);
            run(&alone, Shard::ALL, 1, &stop, &write_seed).unwrap();
            prop_assert_eq!(results(&plan), results(&alone));
            prop_assert!(SweepStatus::read(&plan, true).unwrap().problems.is_empty());
        }
    }
}
