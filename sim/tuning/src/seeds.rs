//! Seeds of the starts of trials: those of the search, and those of the scores, which never meet.

// Why: notes/decisions/simulation.md, "Seeds of tuning and of scores are two files".

use serde::Deserialize;

/// Range of seeds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SeedRange {
    first: u64,
    count: u64,
}

impl SeedRange {
    /// Returns the seed at a place; behind the last seed the first one follows.
    pub fn at(&self, place: u64) -> u64 {
        self.first + place % self.count.max(1)
    }
}

/// Returns the seeds of the search.
pub fn tuning() -> SeedRange {
    parse(include_str!("../assets/tuning_seeds.toml"))
}

/// Returns the seeds of the scores.
pub fn held_out() -> SeedRange {
    parse(include_str!("../assets/held_out_seeds.toml"))
}

fn parse(text: &str) -> SeedRange {
    // A test parses both files.
    toml::from_str(text).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_of_search_and_scores_never_meet() {
        let (tuning, held_out) = (tuning(), held_out());
        assert!(tuning.count >= 1000 && held_out.count >= 100);
        assert!(tuning.first + tuning.count <= held_out.first || held_out.first + held_out.count <= tuning.first);
    }

    #[test]
    fn the_first_seed_follows_the_last() {
        let seeds = SeedRange { first: 5, count: 3 };
        assert_eq!([0, 2, 3, 7].map(|place| seeds.at(place)), [5, 7, 5, 6]);
    }
}
