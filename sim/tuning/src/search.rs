//! A search for a gait that turns given objects, and the scores of a gait.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use mvt_files::{input, output};
use mvt_gaits::axis::TurnAxis;
use mvt_gaits::controller_file::hand_model;
use mvt_gaits::gait::{self, Gait};
use mvt_objects::object::Object;
use mvt_physics::simulation::SimulationError;
use mvt_robot::hand::{Hand, Side};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::air;
use crate::evolution::Evolution;
use crate::seeds::{self, SeedRange};
use crate::stroke::{self, StrokeParameters};
use crate::trial::{self, TrialConditions, TrialResult};

/// Everything that decides the result of a search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SearchSettings {
    /// Names of the objects, which are turned in the same way.
    pub objects: Vec<String>,
    /// Axis about which they are turned.
    pub axis: TurnAxis,
    /// Seconds of a trial. Trials of less than 8 s hide late drops.
    pub duration_s: f64,
    /// Starts per object and candidate. Each generation has its own.
    pub starts: u64,
    /// Rate about the axis above which faster turning gains nothing, rad/s; 1.2 on the palm and 0.3 in the air if `None`.
    pub sufficient_rate_rad_s: Option<f64>,
    /// Candidates per generation.
    pub population: usize,
    /// First step size relative to the scales of the parameters.
    pub sigma: f64,
    /// Beginnings of the names of the parameters that are changed; all are changed if there are none.
    pub only: Vec<String>,
    /// Seed of the search.
    pub seed: u64,
}

/// State of a search, which its file contains.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Search {
    /// Checksum of the hand; `None` for the built-in one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    model: Option<String>,
    settings: SearchSettings,
    from: Gait,
    origin: StrokeParameters,
    evolution: Evolution,
    #[serde(skip, default = "Hand::none")]
    hand: Arc<Hand>,
}

/// Reason why a search cannot go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SearchError {
    /// MuJoCo refuses an object.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// The state cannot be read or written.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The problem.
        reason: String,
    },
    /// The file contains the state of another search.
    #[error("{} belongs to a search with other settings; repeat its settings, or remove it", path.display())]
    Other {
        /// The file.
        path: PathBuf,
    },
}

/// Integration steps per command of the search. Steps of 6.7 ms rank candidates as the 3.3 ms of an episode do.
pub(crate) const SEARCH_STEPS: u32 = 6;
/// Largest file of a state that is read, bytes.
const LARGEST_STATE: u64 = 4 << 20;

impl Search {
    /// Returns whether a search from this gait with this hand has a parameter whose name begins so.
    pub fn has_parameter(from: &Gait, hand: &Hand, begin: &str) -> bool {
        !scales(from, hand, &[begin.to_owned()]).is_empty()
    }

    /// Starts from a gait for a hand. If it turns the opposite way, the search starts from the same stroke played backwards.
    pub fn new(settings: SearchSettings, from: &Gait, hand: &Arc<Hand>) -> Self {
        let is_opposite =
            from.feedback.is_none() && settings.axis.direction(Side::Right) == -from.axis.direction(Side::Right);
        let params = stroke::parameters_of(from, hand);
        let origin = if is_opposite { stroke::backwards(params) } else { params };
        let dimensions = scales(from, hand, &settings.only).len();
        let evolution = Evolution::new(dimensions, settings.population, settings.sigma, settings.seed);
        let model = (!gait::suits(hand)).then(|| hand_model(hand));
        Self { model, settings, from: from.clone(), origin, evolution, hand: Arc::clone(hand) }
    }

    /// Continues with the state in a file, or starts as [`Search::new`] if there is no file.
    ///
    /// # Errors
    /// [`SearchError`] if the file is no state, or that of another search.
    pub fn resume(path: &Path, settings: SearchSettings, from: &Gait, hand: &Arc<Hand>) -> Result<Self, SearchError> {
        let fresh = Self::new(settings, from, hand);
        if !path.exists() {
            return Ok(fresh);
        }
        let failed = |reason: String| SearchError::File { path: path.to_owned(), reason };
        let text = input::read_text(path, LARGEST_STATE).map_err(|e| failed(e.to_string()))?;
        let read: Self = toml::from_str(&text)
            .map_err(|e| failed(format!("it is not the state of a search: {}; remove it", e.message())))?;
        let read = Self { hand: Arc::clone(hand), ..read };
        let Self { model, settings, from, origin, evolution, .. } = &fresh;
        let is_same = (model, settings, from, origin) == (&read.model, &read.settings, &read.from, &read.origin);
        if !is_same || !read.evolution.continues(evolution) {
            return Err(SearchError::Other { path: path.to_owned() });
        }
        Ok(read)
    }

    /// Writes the state.
    ///
    /// # Errors
    /// [`SearchError::File`] if that fails.
    pub fn save(&self, path: &Path) -> Result<(), SearchError> {
        let failed = |reason: String| SearchError::File { path: path.to_owned(), reason };
        let text = toml::to_string(self).map_err(|e| failed(e.to_string()))?;
        output::replace(path, text.as_bytes()).map_err(|e| failed(e.to_string()))
    }

    /// Returns the number of finished generations.
    pub fn generation(&self) -> u64 {
        self.evolution.generation()
    }

    /// Returns the gait in the middle of the candidates.
    pub fn gait(&self, description: &str) -> Gait {
        self.gait_at(self.evolution.mean(), description)
    }

    /// Returns the gait at so many scales from the origin; parameters that the origin lacks are 0 there.
    fn gait_at(&self, steps: &[f64], description: &str) -> Gait {
        let mut params = self.origin.clone();
        for ((name, scale), step) in scales(&self.from, &self.hand, &self.settings.only).into_iter().zip(steps) {
            *params.entry(name).or_default() += scale * step;
        }
        let (from, hand, axis) = (&self.from, &self.hand, self.settings.axis);
        air::gait(&params, hand, from, axis, description)
            .unwrap_or_else(|| stroke::gait(&params, hand, from.open_pose.clone(), axis, description))
    }

    /// Tries one generation of candidates on the objects, in parallel, and returns their mean score. The result does not
    /// depend on the number of threads.
    ///
    /// # Errors
    /// [`SimulationError`] if MuJoCo refuses an object.
    pub fn advance(&mut self, objects: &[Object]) -> Result<f64, SimulationError> {
        let SearchSettings { duration_s, starts, sufficient_rate_rad_s, .. } = self.settings;
        let candidates = self.evolution.candidates();
        let gaits: Vec<Gait> = candidates.iter().map(|steps| self.gait_at(steps, "")).collect();
        let first = self.generation() * starts;
        let conditions = TrialConditions { hand: Arc::clone(&self.hand), duration_s, steps: SEARCH_STEPS };
        let tries: Vec<(&Gait, &Object, u64)> = gaits
            .iter()
            .flat_map(|gait| {
                objects.iter().flat_map(move |object| (first..first + starts).map(move |s| (gait, object, s)))
            })
            .collect();
        let seeds = seeds::tuning();
        let results = tries
            .par_iter()
            .map(|&(gait, object, place)| trial::run(gait, object, seeds.at(place), &conditions))
            .collect::<Result<Vec<TrialResult>, _>>()?;
        let per_candidate = objects.len() * starts as usize;
        let scores: Vec<f64> = results
            .chunks(per_candidate.max(1))
            .map(|results| score(results, duration_s, sufficient_rate_rad_s))
            .collect();
        self.evolution.learn(&scores);
        Ok(scores.iter().sum::<f64>() / scores.len().max(1) as f64)
    }
}

/// Returns the names and scales of the parameters that a search from this gait changes.
fn scales(from: &Gait, hand: &Hand, only: &[String]) -> Vec<(String, f64)> {
    let mut scales = if from.feedback.is_some() { air::parameters(hand) } else { stroke::parameters(hand) };
    scales.retain(|(name, _)| only.is_empty() || only.iter().any(|begin| name.starts_with(begin)));
    scales
}

/// Returns the score of a candidate: the mean over its trials with a share of the worst, so that bad starts count more.
fn score(results: &[TrialResult], duration_s: f64, sufficient_rate_rad_s: Option<f64>) -> f64 {
    let rewards: Vec<f64> = results.iter().map(|result| reward(result, duration_s, sufficient_rate_rad_s)).collect();
    let mean = rewards.iter().sum::<f64>() / rewards.len().max(1) as f64;
    0.7 * mean + 0.3 * rewards.iter().copied().fold(f64::INFINITY, f64::min)
}

/// Returns the reward of a trial. A drop costs more than any rate gains; rates above 1.2 rad/s blur images and gain
/// nothing, unless the search says otherwise. An angle about other axes costs a third of its worth about the axis.
fn reward(result: &TrialResult, duration_s: f64, sufficient_rate_rad_s: Option<f64>) -> f64 {
    let rate = result.turned_rad / duration_s;
    let other = result.other_rad / duration_s;
    let rocked = result.rocked_rad / duration_s;
    let lost = 1.0 - result.survived_s / duration_s + f64::from(u8::from(!result.alive));
    if let Some(beside) = result.touched_beside_tips {
        // In the air any axis is welcome. Holding counts most, so that a slow turn suffices.
        return 1.5 * rate.min(sufficient_rate_rad_s.unwrap_or(0.3)) - 3.0 * lost - beside + 0.1 * result.pads.min(3.0);
    }
    2.0 * rate.min(sufficient_rate_rad_s.unwrap_or(1.2)) - 0.6 * other - 0.1 * rocked - 2.0 * lost
        + 0.1 * result.pads.min(2.0)
}

/// Score of a gait with one object.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GaitScore {
    /// Name of the object.
    pub object: String,
    /// Number of starts.
    pub starts: u64,
    /// Share of the starts after which the object was on the hand at the end.
    pub alive: f64,
    /// Median of the net rate about the axis, rad/s; time after a drop counts.
    pub rate_rad_s: f64,
    /// Net turn about the other axes relative to the one about the axis, from the sums over all starts.
    pub other_share: f64,
    /// Mean number of pads that touched the object.
    pub pads: f64,
}

/// Scores a gait with an object on the first `starts` of `seeds`, in parallel.
///
/// # Errors
/// [`SimulationError`] if MuJoCo refuses the object.
pub fn measure(
    gait: &Gait,
    object: &Object,
    seeds: SeedRange,
    starts: u64,
    conditions: &TrialConditions,
) -> Result<GaitScore, SimulationError> {
    let results = (0..starts)
        .into_par_iter()
        .map(|place| trial::run(gait, object, seeds.at(place), conditions))
        .collect::<Result<Vec<TrialResult>, _>>()?;
    Ok(GaitScore::of(&object.name, &results, conditions.duration_s))
}

impl GaitScore {
    /// Scores the trials of an object.
    pub fn of(object: &str, results: &[TrialResult], duration_s: f64) -> Self {
        let count = results.len().max(1) as f64;
        let sum = |f: fn(&TrialResult) -> f64| results.iter().map(f).sum::<f64>();
        let mut rates: Vec<f64> = results.iter().map(|result| result.turned_rad / duration_s).collect();
        rates.sort_by(f64::total_cmp);
        Self {
            object: object.to_owned(),
            starts: results.len() as u64,
            alive: sum(|result| f64::from(u8::from(result.alive))) / count,
            rate_rad_s: rates.get(rates.len() / 2).copied().unwrap_or(0.0),
            other_share: sum(|result| result.other_rad) / sum(|result| result.turned_rad.abs()).max(1e-9),
            pads: sum(|result| result.pads) / count,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faster_than_sufficient_gains_nothing() {
        let turned = |rate_rad_s: f64| TrialResult {
            survived_s: 10.0,
            alive: true,
            turned_rad: 10.0 * rate_rad_s,
            net_rad: [0.0; 3],
            other_rad: 0.0,
            rocked_rad: 0.0,
            pads: 1.0,
            touched_beside_tips: None,
        };
        let score = |rate, sufficient| score(&[turned(rate)], 10.0, sufficient);
        assert!(score(0.7, None) < score(1.2, None) && score(1.2, None) == score(1.5, None));
        assert!(score(0.6, Some(0.7)) < score(0.7, Some(0.7)) && score(0.7, Some(0.7)) == score(1.2, Some(0.7)));
    }
}
