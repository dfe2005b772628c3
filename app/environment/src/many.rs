//! Many environments that step together, on all threads.

use std::sync::Arc;

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::error::TaskError;
use crate::reward::Reward;
use crate::scene::Scene;
use crate::sense::{Part, Readings};
use crate::turn::Environment;

/// Result of a step of all environments.
#[derive(Debug, Clone, PartialEq)]
pub struct StepOutcome {
    /// One entry per sense, in the order of the settings.
    pub observations: Vec<Readings>,
    /// Reward of each environment.
    pub rewards: Vec<Reward>,
    /// Whether the object fell or the physics became unstable.
    pub terminated: Vec<bool>,
    /// Whether the time is up.
    pub truncated: Vec<bool>,
    /// Time since the start (s) and angle turned (rad) of each environment.
    pub progress: Vec<[f64; 2]>,
}

/// Bit that the seeds of later episodes have. People and tables of results name small seeds, so that episodes that follow one another in a
/// training never have the start of a run.
pub const LATER_SEED: u64 = 1 << 63;

/// Environments whose scenes differ in the object alone.
pub struct Environments {
    /// The first of the scenes.
    scene: Arc<Scene>,
    scenes: Arc<[Arc<Scene>]>,
    places: Vec<Place>,
    autoreset: bool,
}

/// One environment with its source of seeds.
struct Place {
    environment: Environment,
    seeds: ChaCha8Rng,
    has_ended: bool,
}

/// Starts an episode with the scene that its seed chooses.
fn start(scenes: &[Arc<Scene>], seed: u64) -> Result<Environment, TaskError> {
    // Neighbouring seeds choose unlike scenes: the golden ratio of 64 bits spreads them.
    let spread = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 32;
    let scene = usize::try_from(spread).ok().and_then(|spread| scenes.get(spread % scenes.len().max(1)));
    let scene = scene.ok_or_else(no_scene)?;
    Environment::new(Arc::clone(scene), seed)
}

fn no_scene() -> TaskError {
    TaskError::Setting("there is no scene; give at least one".to_owned())
}

impl Place {
    fn new(scenes: &[Arc<Scene>], seed: u64) -> Result<Self, TaskError> {
        Ok(Self { environment: start(scenes, seed)?, seeds: ChaCha8Rng::seed_from_u64(seed), has_ended: false })
    }

    fn step(&mut self, scenes: &[Arc<Scene>], action: &[f32], autoreset: bool) -> Result<Reward, TaskError> {
        if autoreset && self.has_ended {
            self.environment = start(scenes, self.seeds.next_u64() | LATER_SEED)?;
            self.has_ended = false;
            return Ok(Reward::default());
        }
        let reward = self.environment.step(action);
        let (terminated, truncated) = self.environment.ended();
        self.has_ended = terminated || truncated;
        Ok(reward)
    }
}

impl Environments {
    /// Makes `count` environments, which start with the seeds 0, 1 and so on. With `autoreset`, the step after the end of
    /// an episode ignores its action and starts the next one: the mode NEXT_STEP of Gymnasium.
    ///
    /// # Errors
    /// [`TaskError`] if there are none or MuJoCo refuses the object.
    pub fn new(scene: Arc<Scene>, count: usize, autoreset: bool) -> Result<Self, TaskError> {
        Self::of_scenes(vec![scene], count, autoreset)
    }

    /// Does the same with several scenes, which have the same settings. The seed of an episode chooses the scene.
    ///
    /// # Errors
    /// As [`Environments::new`], or if there is no scene.
    pub fn of_scenes(scenes: Vec<Arc<Scene>>, count: usize, autoreset: bool) -> Result<Self, TaskError> {
        /// A model takes about a megabyte.
        const MOST: usize = 4096;
        if !(1..=MOST).contains(&count) {
            return Err(TaskError::Setting(format!(
                "the number of environments is {count}; it must be from 1 to {MOST}"
            )));
        }
        let scene = scenes.first().map(Arc::clone).ok_or_else(no_scene)?;
        let places =
            (0..count as u64).into_par_iter().map(|seed| Place::new(&scenes, seed)).collect::<Result<_, _>>()?;
        Ok(Self { scene, scenes: scenes.into(), places, autoreset })
    }

    /// Returns the number of environments.
    pub fn count(&self) -> usize {
        self.places.len()
    }

    /// Returns the first scene, whose settings are those of all.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Starts new episodes with these seeds, one for each environment, and returns the first observations.
    ///
    /// # Errors
    /// [`TaskError`] if the number of seeds is wrong or MuJoCo refuses the object.
    pub fn reset(&mut self, seeds: &[u64]) -> Result<Vec<Readings>, TaskError> {
        if seeds.len() != self.count() {
            let (expected, found) = (self.count(), seeds.len());
            return Err(TaskError::Setting(format!("there are {found} seeds for {expected} environments")));
        }
        self.places = seeds.par_iter().map(|&seed| Place::new(&self.scenes, seed)).collect::<Result<_, _>>()?;
        let (observations, _) = self.each(|_, _| Ok(()))?;
        Ok(observations)
    }

    /// Steps all environments with a number from -1 to 1 for each joint of each.
    ///
    /// # Errors
    /// [`TaskError`] if the number of actions is wrong or one is not finite.
    pub fn step(&mut self, actions: &[f32]) -> Result<StepOutcome, TaskError> {
        let joints = self.scene.settings().hand.joints().len();
        let expected = joints * self.count();
        if actions.len() != expected {
            return Err(TaskError::Count { expected, found: actions.len() });
        }
        if actions.iter().any(|a| !a.is_finite()) {
            return Err(TaskError::NotFinite);
        }
        let (scenes, autoreset) = (Arc::clone(&self.scenes), self.autoreset);
        let (observations, rewards) = self.each(|k, place| {
            let action = actions.get(joints * k..).unwrap_or_default();
            place.step(&scenes, action, autoreset)
        })?;
        let (terminated, truncated) = self.places.iter().map(|place| place.environment.ended()).unzip();
        let progress = self.places.iter().map(|place| place.environment.progress()).collect();
        Ok(StepOutcome { observations, rewards, terminated, truncated, progress })
    }

    /// Returns the warnings of perception since the last call, each with the number of its environment.
    pub fn take_warnings(&mut self) -> Vec<String> {
        let of = |(k, place): (usize, &mut Place)| {
            place.environment.take_warnings().into_iter().map(move |warning| format!("environment {k}: {warning}"))
        };
        self.places.iter_mut().enumerate().flat_map(of).collect()
    }

    /// Returns a picture of an environment for people, 640 x 480; `None` if there is no such environment.
    pub fn picture(&self, index: usize) -> Option<image::RgbImage> {
        self.places.get(index)?.environment.picture()
    }

    /// Calls a function for each environment, then observes it.
    fn each<T: Send>(
        &mut self,
        act: impl Fn(usize, &mut Place) -> Result<T, TaskError> + Sync,
    ) -> Result<(Vec<Readings>, Vec<T>), TaskError> {
        let (scene, count) = (Arc::clone(&self.scene), self.count());
        let senses = &scene.settings().senses;
        let length = |sense| count * scene.shape(sense).iter().product::<usize>();
        let mut observations: Vec<Readings> =
            senses.iter().map(|&sense| Readings::zeros(sense, length(sense))).collect();
        let mut parts: Vec<Vec<Part<'_>>> = (0..count).map(|_| Vec::with_capacity(senses.len())).collect();
        for readings in &mut observations {
            for (parts, part) in parts.iter_mut().zip(readings.split(count)) {
                parts.push(part);
            }
        }
        let work = |(k, (place, parts)): (usize, (&mut Place, &mut Vec<Part<'_>>))| {
            let result = act(k, place)?;
            place.environment.observe(parts)?;
            Ok(result)
        };
        // To hand a single environment to another thread would only cost time.
        let results = if count == 1 {
            self.places.iter_mut().zip(&mut parts).enumerate().map(work).collect::<Result<Vec<T>, TaskError>>()?
        } else {
            let each = self.places.par_iter_mut().zip(parts.par_iter_mut()).enumerate();
            each.map(work).collect::<Result<Vec<T>, TaskError>>()?
        };
        Ok((observations, results))
    }
}
