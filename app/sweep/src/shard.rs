//! Which tasks of a plan a process does.

use std::str::FromStr;

use anyhow::{Context as _, Result, bail, ensure};

// Why: notes/decisions/sweeps.md, "Shards are fixed, and no task is claimed".
/// Part of a plan: task k belongs to shard k modulo the number of shards.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    index: u64,
    count: u64,
}

impl Shard {
    /// The whole plan.
    pub const ALL: Self = Self { index: 0, count: 1 };

    /// Returns the shard `index` of `count`, from 0 on; `None` if there is no such shard.
    pub fn new(index: u64, count: u64) -> Option<Self> {
        (index < count).then_some(Self { index, count })
    }

    /// Returns whether a task belongs to it.
    pub fn contains(self, task: usize) -> bool {
        task as u64 % self.count == self.index
    }

    /// Chooses the shard: the one that was given, or one of `shards` (or of Slurm's array) by the variables of a job array, or the whole plan.
    ///
    /// # Errors
    /// If the variables say no shard; the message says what to give.
    pub fn choose(given: Option<Self>, shards: Option<u64>, variable: impl Fn(&str) -> Option<String>) -> Result<Self> {
        if let Some(shard) = given {
            return Ok(shard);
        }
        let number = |name: &str| -> Result<Option<u64>> {
            let Some(text) = variable(name) else { return Ok(None) };
            Ok(Some(text.trim().parse().with_context(|| format!("{name}={text} is not a number; give --shard"))?))
        };
        let shard = |name: &str, index: u64, count: u64| {
            Self::new(index, count)
                .with_context(|| format!("{name}: there is no shard {index} of {count}; give --shard"))
        };
        if let Some(task) = number("SLURM_ARRAY_TASK_ID")? {
            if let Some(count) = shards {
                return shard("SLURM_ARRAY_TASK_ID", task, count);
            }
            let [count, least, most] = ["COUNT", "MIN", "MAX"].map(|end| number(&format!("SLURM_ARRAY_TASK_{end}")));
            let (count, least, most) = (count?.unwrap_or(0), least?.unwrap_or(0), most?.unwrap_or(0));
            // A part of an array, such as --array=3,7, has fewer tasks than the plan has shards.
            ensure!(
                least == 0 && most.checked_add(1) == Some(count),
                "the array of this Slurm job is not 0 to N: give --shard $SLURM_ARRAY_TASK_ID/N with the N of the first submission"
            );
            return shard("SLURM_ARRAY_TASK_ID", task, count);
        }
        match (number("JOB_COMPLETION_INDEX")?, shards) {
            (Some(index), Some(count)) => shard("JOB_COMPLETION_INDEX", index, count),
            (Some(_), None) => bail!("JOB_COMPLETION_INDEX is set: give the number of completions as --shards N"),
            (None, Some(_)) => bail!("--shards needs the index of a job array in the environment; give --shard I/N"),
            (None, None) => Ok(Self::ALL),
        }
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (index, count) = text.split_once('/').ok_or("give I/N, such as 0/8")?;
        let number = |text: &str| text.parse::<u64>().map_err(|_| "give I/N, such as 0/8".to_owned());
        Self::new(number(index)?, number(count)?).ok_or_else(|| "shards are numbered from 0 to N - 1".to_owned())
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn chosen(shards: Option<u64>, variables: &[(&str, &str)]) -> Result<String> {
        let variable = |name: &str| variables.iter().find(|(key, _)| *key == name).map(|(_, value)| value.to_string());
        Shard::choose(None, shards, variable).map(|shard| shard.to_string())
    }

    #[test]
    fn job_arrays_say_which_shard_it_is() {
        let slurm = |task, count, least, most| {
            [("ID", task), ("COUNT", count), ("MIN", least), ("MAX", most)].map(|(end, value)| {
                (
                    ["SLURM_ARRAY_TASK_ID", "SLURM_ARRAY_TASK_COUNT", "SLURM_ARRAY_TASK_MIN", "SLURM_ARRAY_TASK_MAX"]
                        [["ID", "COUNT", "MIN", "MAX"].iter().position(|name| *name == end).unwrap()],
                    value,
                )
            })
        };
        assert_eq!(chosen(None, &slurm("3", "8", "0", "7")).unwrap(), "3/8");
        assert_eq!(chosen(Some(8), &slurm("3", "2", "3", "7")).unwrap(), "3/8");
        // Tasks 3 and 7 alone are submitted again.
        assert!(chosen(None, &slurm("3", "2", "3", "7")).unwrap_err().to_string().contains("--shard"));
        assert_eq!(chosen(Some(4), &[("JOB_COMPLETION_INDEX", "2")]).unwrap(), "2/4");
        assert!(chosen(None, &[("JOB_COMPLETION_INDEX", "2")]).unwrap_err().to_string().contains("--shards"));
        assert!(chosen(Some(2), &[("JOB_COMPLETION_INDEX", "2")]).is_err());
        assert!(chosen(Some(2), &[]).is_err());
        assert_eq!(chosen(None, &[]).unwrap(), "0/1");
        for wrong in ["", "1", "3/3", "-1/3", "1/0", "a/b"] {
            assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn each_task_belongs_to_one_shard(count in 1u64..500, task in 0usize..1_000_000) {
            let owners = (0..count).filter(|&index| Shard::new(index, count).unwrap().contains(task)).count();
            prop_assert_eq!(owners, 1);
        }
    }
}
