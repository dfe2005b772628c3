//! How far runs on the same frames part that differ in the seed of the estimator alone.

use std::fmt::Write as _;

use super::{Key, Line};

/// Returns a table of the median and the worst ADD-S over the estimator seeds of each episode, with a blank line before it; nothing if no
/// episode was run with several.
pub fn table(lines: &[Line]) -> String {
    let mut episodes: Vec<Key> = lines.iter().map(|line| Key { estimator_seed: 0, ..line.key.clone() }).collect();
    episodes.sort();
    episodes.dedup();
    let mut text = String::new();
    let mut ratios = Vec::new();
    let mut beyond = [0, 0];
    for episode in episodes {
        let is_of = |line: &&Line| Key { estimator_seed: 0, ..line.key.clone() } == episode;
        let mean_mm = |line: &Line| line.add_s_mm.map_or(f64::INFINITY, |errors| errors.mean);
        let mut errors: Vec<f64> = lines.iter().filter(is_of).map(mean_mm).collect();
        errors.sort_by(f64::total_cmp);
        let (Some(&median), Some(&worst)) = (errors.get(errors.len() / 2), errors.last()) else { continue };
        if errors.len() < 2 {
            continue;
        }
        beyond[0] += errors.iter().filter(|error| **error > 2.0 * median).count();
        beyond[1] += errors.len();
        ratios.push(worst / median);
        let Key { object, seed, cameras, mode, modality, variant, .. } = episode;
        let name = format!("{object} | {seed} | {cameras} | {mode} | {modality} | {variant}");
        let _ = write!(text, "\n| {name} | {} | {median:.2} | {worst:.2} | {:.2} |", errors.len(), worst / median);
    }
    if ratios.is_empty() {
        return text;
    }
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    format!(
        "\n\n| object | seed | cameras | mode | modality | variant | estimator seeds | ADD-S median, mm | worst | worst / median |\n\
         |---|---|---|---|---|---|---|---|---|---|{text}\n\n\
         worst / median, mean: {mean:.2}; {} of {} runs are beyond twice the median\n",
        beyond[0], beyond[1]
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Errors, FULL};
    use mvt_run::estimator::Mode;
    use mvt_run::source::Modality;

    fn line(object: &str, estimator_seed: u64, mean: f64) -> Line {
        Line {
            key: Key {
                object: object.to_owned(),
                seed: 3,
                cameras: "side".to_owned(),
                mode: Mode::Slam,
                modality: Modality::Vitac,
                estimator_seed,
                variant: FULL.to_owned(),
                settings: String::new(),
            },
            frames: 30,
            end: String::new(),
            hidden: None,
            f_score: Default::default(),
            f_score_fine: Default::default(),
            f_score_observed: Default::default(),
            turned_rad: 0.0,
            add_s_mm: Some(Errors { mean, median: mean, p95: mean, last: mean }),
            add_s_symmetric_mm: None,
            add_mm: None,
            rotation_deg: None,
            lost_frames: 0,
            recovered: 0,
            undeclared: false,
            frames_per_second: Some(30.0),
        }
    }

    #[test]
    fn the_worst_seed_is_held_against_the_median() {
        let lines = [
            line("ball", 0, 1.0),
            line("ball", 1, 1.2),
            line("ball", 2, 3.0),
            line("mug", 0, 1.0),
            line("mug", 1, 1.0),
        ];
        let table = table(&lines);
        assert!(table.contains("| ball | 3 | side | slam | vitac | full | 3 | 1.20 | 3.00 | 2.50 |"), "{table}");
        assert!(table.contains("mean: 1.75; 1 of 5 runs"), "{table}");
    }

    #[test]
    fn one_seed_has_no_spread() {
        assert_eq!(table(&[line("ball", 0, 1.0), line("mug", 0, 2.0)]), "");
    }
}
