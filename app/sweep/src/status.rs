//! What became of a sweep, in words and as JSON.

use std::fmt::Write as _;

use anyhow::Result;
use rayon::prelude::*;
use serde::Serialize;

use crate::plan::{SweepPlan, SweepTask};
use crate::store::Store;

/// Tasks that are named, of each kind.
const NAMED: usize = 10;

/// What became of a sweep.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SweepStatus {
    /// All tasks.
    pub tasks: usize,
    /// Finished.
    pub done: usize,
    /// Set aside after their last attempt.
    pub set_aside: usize,
    /// Begun and not finished: being done, or left by a process that was killed.
    pub begun: usize,
    /// Not begun.
    pub waiting: usize,
    /// The first tasks that were set aside, with the reason.
    pub reasons: Vec<String>,
    /// The problems, in a sentence each.
    pub problems: Vec<String>,
}

impl SweepStatus {
    /// Lists the outcomes of the tasks of a plan; with `check`, reads all results and compares them with their manifests.
    ///
    /// # Errors
    /// If a folder cannot be read.
    pub fn read(plan: &SweepPlan, check: bool) -> Result<Self> {
        let store = Store::new(&plan.folder);
        let progress = store.progress()?;
        let mut status = Self {
            tasks: plan.tasks.len(),
            done: 0,
            set_aside: 0,
            begun: 0,
            waiting: 0,
            reasons: Vec::new(),
            problems: plan.problems.clone(),
        };
        let mut finished = Vec::new();
        for task in &plan.tasks {
            if progress.done.contains(&task.id) {
                status.done += 1;
                finished.push(task);
            } else if progress.failed.contains(&task.id) {
                status.set_aside += 1;
                if status.reasons.len() < NAMED {
                    status.reasons.push(format!("{} ({}): {}", task.id, task.in_words(), store.failure(&task.id)));
                }
            } else if progress.begun.contains_key(&task.id) {
                status.begun += 1;
            } else {
                status.waiting += 1;
            }
        }
        let foreign = progress.done.len() - status.done;
        if foreign > 0 {
            status
                .problems
                .push(format!("{foreign} results belong to no task of the plan; another plan was here before"));
        }
        if check {
            let damaged = damaged(&store, &finished);
            status.problems.extend(damaged.into_iter().take(NAMED).map(|(_, reason)| reason));
        }
        Ok(status)
    }

    /// Describes it for people.
    pub fn in_words(&self, plan: &SweepPlan) -> String {
        let Self { tasks, done, set_aside, begun, waiting, .. } = self;
        let mut text = format!(
            "{tasks} tasks of {}: {done} done, {set_aside} set aside, {begun} begun, {waiting} waiting",
            plan.command.name()
        );
        for reason in &self.reasons {
            let _ = write!(text, "\nset aside: {reason}");
        }
        for problem in &self.problems {
            let _ = write!(text, "\nproblem: {problem}");
        }
        text
    }
}

/// Returns the tasks whose results do not fit their manifests, with the reason.
pub fn damaged<'a>(store: &Store, finished: &[&'a SweepTask]) -> Vec<(&'a SweepTask, String)> {
    let check = |task: &&'a SweepTask| Some((*task, format!("{:#}", store.check(&task.id).err()?)));
    finished.par_iter().filter_map(check).collect()
}
