//! The training: steps of the environments and updates in turn.

use std::f32::consts::TAU;
use std::sync::Arc;

use mvt_environment::{Environments, LATER_SEED, Readings, Sense, StepOutcome, TurnSettings};
use mvt_physics::episode::Randomisation;
use mvt_policy::{MadePolicy, PolicyContract, PolicyLayer};
use mvt_robot::hand::Hand;
use ndarray::{Array2, Axis, s};
use rand::{Rng as _, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::config::LearningConfig;
use crate::curriculum::Curriculum;
use crate::error::LearningError;
use crate::moments::{Moments, NORMALISED};
use crate::update::{Experience, Learner, advantages};

/// What the policies of a block of updates did.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LearningPoint {
    /// Steps of all environments until the end of the block.
    pub steps: u64,
    /// Mean reward of a step.
    pub reward: f64,
    /// Mean rate of turning, rad/s.
    pub rate_rad_s: f64,
    /// Falls of the object per minute.
    pub falls_per_minute: f64,
}

impl LearningPoint {
    /// Returns whether the objects were held and turned well enough for the later scenes of a curriculum.
    fn has_learnt(&self, config: &LearningConfig) -> bool {
        self.rate_rad_s >= config.later_rad_s && self.falls_per_minute <= config.later_falls_per_minute
    }
}

/// Sums over the steps of a block.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    steps: u64,
    reward: f64,
    turned_rad: f64,
    falls: u64,
}

/// Training of a policy that turns objects, or corrects the gaits that do, by proprioception, their place and the forces on the pads, with a
/// critic that knows the truth.
pub struct PolicyTraining {
    pub(crate) config: LearningConfig,
    pub(crate) seed: u64,
    environments: Environments,
    /// Its later scenes are none once they have joined.
    curriculum: Curriculum,
    contract: PolicyContract,
    pub(crate) learner: Learner,
    pub(crate) moments: Moments,
    pub(crate) updates: u64,
    pub(crate) curve: Vec<LearningPoint>,
    sums: Sums,
    /// Last observations, as they were sensed.
    sensed: Array2<f32>,
    /// Whether the next step of an environment begins an episode, and does nothing else.
    begins: Vec<bool>,
    /// Angle by which each object had turned, radians.
    turned_rad: Vec<f64>,
}

/// Returns the settings of the environments of a training: half the integration steps of a run, and wider ranges of friction, stiffness and
/// latency than those of its starts. With `corrects` the policy corrects the gait that suits each object.
pub fn training_settings(hand: &Arc<Hand>, corrects: bool) -> TurnSettings {
    TurnSettings {
        hand: Arc::clone(hand),
        physics_hz: 150,
        duration_s: 20.0,
        randomisation: Randomisation { friction: 0.25, stiffness: 0.15, ..Randomisation::default() },
        // Half the time between two commands.
        latency_s: 0.02,
        senses: vec![if corrects { Sense::Guided } else { Sense::Sighted }, Sense::Privileged],
        cameras: Vec::new(),
        ..TurnSettings::default()
    }
}

impl PolicyTraining {
    /// Starts a training in scenes with [`training_settings`].
    ///
    /// # Errors
    /// [`LearningError`] if a setting is out of range, or the environments cannot be made.
    pub fn new(scenes: impl Into<Curriculum>, config: LearningConfig, seed: u64) -> Result<Self, LearningError> {
        config.validate()?;
        let (count, curriculum) = (config.environments, scenes.into());
        let environments = Environments::of_scenes(curriculum.first.clone(), count, true)?;
        let settings = environments.scene().settings();
        let mut contract = settings.contract();
        contract.side = Some(settings.hand.side());
        let size = |sense| environments.scene().shape(sense).iter().product::<usize>();
        let all = settings.senses.iter().map(|&sense| size(sense)).sum();
        let sizes = [contract.observation_size(&settings.hand), all, settings.hand.joints().len()];
        let mut training = Self {
            learner: Learner::draw(sizes, &config, &mut ChaCha8Rng::seed_from_u64(seed)),
            moments: Moments::new(all),
            sensed: Array2::zeros((count, all)),
            begins: vec![false; count],
            turned_rad: vec![0.0; count],
            updates: 0,
            curve: Vec::new(),
            sums: Sums::default(),
            config,
            seed,
            environments,
            curriculum,
            contract,
        };
        training.begin_block()?;
        Ok(training)
    }

    /// Returns the number of updates that were made.
    pub fn updates(&self) -> u64 {
        self.updates
    }

    /// Returns how many steps of environments an update takes.
    pub fn steps_per_update(&self) -> u64 {
        (self.config.steps * self.config.environments) as u64
    }

    /// Returns what the policies of the complete blocks did.
    pub fn curve(&self) -> &[LearningPoint] {
        &self.curve
    }

    /// Starts all environments anew, so that a training which goes on after an interruption is the same as one without.
    pub(crate) fn begin_block(&mut self) -> Result<(), LearningError> {
        if self.curve.iter().any(|point| point.has_learnt(&self.config))
            && let Some(scenes) = self.curriculum.widen()
        {
            self.environments = Environments::of_scenes(scenes, self.config.environments, true)?;
        }
        let mut random = self.random(0);
        let seeds: Vec<u64> = (0..self.config.environments).map(|_| random.next_u64() | LATER_SEED).collect();
        let readings = self.environments.reset(&seeds)?;
        self.sensed = self.gathered(&readings);
        self.begins.fill(false);
        self.turned_rad.fill(0.0);
        Ok(())
    }

    /// Returns a generator for one purpose in this update.
    fn random(&self, purpose: u64) -> ChaCha8Rng {
        const PURPOSES: u64 = 4;
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        // Stream 0 drew the networks.
        random.set_stream(1 + PURPOSES * self.updates + purpose);
        random
    }

    /// Returns the observations of all environments, row by row.
    fn gathered(&self, readings: &[Readings]) -> Array2<f32> {
        let mut rows = Array2::zeros(self.sensed.raw_dim());
        let mut first = 0;
        for readings in readings {
            let Readings::Numbers(numbers) = readings else { continue };
            let width = numbers.len() / self.config.environments.max(1);
            for (mut row, numbers) in rows.rows_mut().into_iter().zip(numbers.chunks(width.max(1))) {
                row.slice_mut(s![first..first + width]).iter_mut().zip(numbers).for_each(|(to, number)| *to = *number);
            }
            first += width;
        }
        rows
    }

    /// Steps the environments, and learns from it.
    ///
    /// # Errors
    /// [`LearningError`] if MuJoCo refuses an object.
    pub fn advance(&mut self) -> Result<(), LearningError> {
        let LearningConfig { steps, environments: count, discount, .. } = self.config;
        let joints = self.contract.joint_names.len();
        let mut random = self.random(1);
        let mut sensed = Array2::zeros(((steps + 1) * count, self.sensed.ncols()));
        let mut observed = sensed.clone();
        let [mut means, mut actions] = [(); 2].map(|()| Array2::zeros((steps * count, joints)));
        let mut rewards = Array2::zeros((steps, count));
        let [mut fell, mut ended] = [(); 2].map(|()| Array2::from_elem((steps, count), false));
        let mut counted = Vec::with_capacity(steps * count);
        let deviations = self.learner.actor.spread.mapv(f32::exp);
        for t in 0..=steps {
            let rows = s![t * count..(t + 1) * count, ..];
            sensed.slice_mut(rows).assign(&self.sensed);
            observed.slice_mut(rows).assign(&self.moments.normalise(self.sensed.clone()));
            if t == steps {
                break;
            }
            let mean = self.learner.act(&observed.slice(rows));
            let noise = Array2::from_shape_simple_fn(mean.raw_dim(), || normal(&mut random));
            let action = &mean + noise * &deviations;
            means.slice_mut(rows).assign(&mean);
            actions.slice_mut(rows).assign(&action);
            let outcome = self.environments.step(&action.into_iter().collect::<Vec<f32>>())?;
            self.sensed = self.gathered(&outcome.observations);
            for k in 0..count {
                if !self.begins[k] {
                    counted.push(t * count + k);
                }
                // Returns become about 1, whatever the discount.
                rewards[[t, k]] = (1.0 - discount) * outcome.rewards[k].total() as f32;
                (fell[[t, k]], ended[[t, k]]) = (outcome.terminated[k], outcome.terminated[k] || outcome.truncated[k]);
            }
            self.count(&outcome);
        }
        let values = self.learner.values(&observed.view());
        let values = Array2::from_shape_fn((steps + 1, count), |(t, k)| values[t * count + k]);
        let (advantages, returns) = advantages(&rewards, &values, &fell, &ended, &self.config);
        let of = |array: &Array2<f32>| counted.iter().map(|&row| array[[row / count, row % count]]).collect();
        let mut experience = Experience {
            observed: observed.select(Axis(0), &counted),
            actions: actions.select(Axis(0), &counted),
            means: means.select(Axis(0), &counted),
            advantages: of(&advantages),
            returns: of(&returns),
        };
        let mean = experience.advantages.mean().unwrap_or(0.0);
        let deviation = experience.advantages.std(0.0).max(1e-6);
        experience.advantages.mapv_inplace(|advantage| (advantage - mean) / deviation);
        let mut random = self.random(2);
        self.learner.learn(&experience, &self.config, &mut random);
        self.moments.add(&sensed.slice(s![..steps * count, ..]));
        self.updates += 1;
        if self.updates.is_multiple_of(self.config.block) {
            self.finish_block();
            self.begin_block()?;
        }
        Ok(())
    }

    /// Adds a step to the sums of the block.
    fn count(&mut self, outcome: &StepOutcome) {
        for k in 0..self.begins.len() {
            let turned_rad = outcome.progress[k][1];
            if !self.begins[k] {
                self.sums.steps += 1;
                self.sums.reward += outcome.rewards[k].total();
                self.sums.turned_rad += turned_rad - self.turned_rad[k];
                self.sums.falls += u64::from(outcome.terminated[k]);
            }
            self.turned_rad[k] = turned_rad;
            self.begins[k] = outcome.terminated[k] || outcome.truncated[k];
        }
    }

    fn finish_block(&mut self) {
        let Sums { steps, reward, turned_rad, falls } = std::mem::take(&mut self.sums);
        let steps = steps.max(1) as f64;
        let seconds = steps / f64::from(self.contract.control_hz);
        self.curve.push(LearningPoint {
            steps: self.updates * self.steps_per_update(),
            reward: reward / steps,
            rate_rad_s: turned_rad / seconds,
            falls_per_minute: 60.0 * falls as f64 / seconds,
        });
    }

    /// Returns the contents of the policy's safetensors file and of the TOML file beside it. The policy plays the means of the actions.
    ///
    /// # Errors
    /// [`LearningError::Policy`] if they cannot be written.
    pub fn policy_files(&self) -> Result<(Vec<u8>, String), LearningError> {
        let (mean, std) = self.moments.mean_and_std();
        let observed = self.learner.observed();
        let layers = self.learner.actor.layers.iter().map(|layer| PolicyLayer {
            inputs: layer.weight.ncols(),
            weight: layer.weight.iter().copied().collect(),
            bias: layer.bias.to_vec(),
        });
        let made = MadePolicy {
            mean: mean.iter().take(observed).copied().collect(),
            std: std.iter().take(observed).copied().collect(),
            clip: NORMALISED,
            layers: layers.collect(),
        };
        Ok(made.files(&self.contract)?)
    }
}

/// Draws a number of the standard normal distribution, by Box and Muller (1958).
fn normal(random: &mut ChaCha8Rng) -> f32 {
    let [a, b]: [f32; 2] = [random.random_range(f32::MIN_POSITIVE..1.0), random.random_range(0.0..1.0)];
    (-2.0 * a.ln()).sqrt() * (TAU * b).cos()
}
