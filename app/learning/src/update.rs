//! The update of PPO: advantages, losses, gradients.

use ndarray::{Array1, Array2, ArrayView2, Axis, Zip, s};
use rand::seq::SliceRandom as _;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::config::LearningConfig;
use crate::perceptron::{Adam, Perceptron};

/// Policy and critic with the memories of their optimisers.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Learner {
    pub(crate) actor: Perceptron,
    pub(crate) critic: Perceptron,
    pub(crate) actor_adam: Adam,
    pub(crate) critic_adam: Adam,
    pub(crate) rate: f32,
}

/// Steps of all environments in which an action counted.
#[derive(Debug, Clone)]
pub(crate) struct Experience {
    /// Normalised numbers that the critic observes. The policy observes the first of them.
    pub(crate) observed: Array2<f32>,
    /// The actions, and the means about which they were drawn.
    pub(crate) actions: Array2<f32>,
    pub(crate) means: Array2<f32>,
    /// Advantage of each action, of mean 0 and deviation 1.
    pub(crate) advantages: Array1<f32>,
    /// Return that the critic is to predict.
    pub(crate) returns: Array1<f32>,
}

/// Gradients of a part of the steps, and the sum of their divergences.
struct Part {
    actor: Perceptron,
    critic: Perceptron,
    divergence: f32,
}

/// Rows that a thread handles at once. It is part of the result: sums are made in this order for any number of threads.
const ROWS: usize = 128;
/// Bounds of the step size.
const RATES: [f32; 2] = [1e-5, 2e-3];
/// Bounds of the logarithm of the standard deviation of an action: 0.05 to 1.
const LOG_SPREAD: [f32; 2] = [-3.0, 0.0];

impl Experience {
    fn rows(&self, rows: &[usize]) -> Self {
        let of = |array: &Array1<f32>| array.select(Axis(0), rows);
        Self {
            observed: self.observed.select(Axis(0), rows),
            actions: self.actions.select(Axis(0), rows),
            means: self.means.select(Axis(0), rows),
            advantages: of(&self.advantages),
            returns: of(&self.returns),
        }
    }
}

/// Returns advantages and returns of a row of steps (steps x environments), by generalised advantage estimation. `values` has a row more. A step
/// that ended its episode by a fall is followed by nothing; after one that ran out of time the value of the last observation counts. Steps that
/// begin an episode do not count, and are the first of what follows.
pub(crate) fn advantages(
    rewards: &Array2<f32>,
    values: &Array2<f32>,
    fell: &Array2<bool>,
    ended: &Array2<bool>,
    config: &LearningConfig,
) -> (Array2<f32>, Array2<f32>) {
    let mut advantages = Array2::zeros(rewards.dim());
    for k in 0..rewards.ncols() {
        let mut ahead = 0.0;
        for t in (0..rewards.nrows()).rev() {
            let at = [t, k];
            let next = if fell[at] { 0.0 } else { values[[t + 1, k]] };
            let surprise = rewards[at] + config.discount * next - values[at];
            ahead = surprise + if ended[at] { 0.0 } else { config.discount * config.trace * ahead };
            advantages[at] = ahead;
        }
    }
    let returns = &advantages + &values.slice(s![..rewards.nrows(), ..]);
    (advantages, returns)
}

impl Learner {
    /// Draws both networks. The policy observes `observed` numbers, the critic `all`.
    pub(crate) fn draw([observed, all, joints]: [usize; 3], config: &LearningConfig, random: &mut ChaCha8Rng) -> Self {
        /// The first actions are small, so that the hand stays as it starts.
        const FIRST_ACTIONS: f32 = 0.01;
        let widths = |inputs: usize, outputs: usize| [&[inputs], config.hidden.as_slice(), &[outputs]].concat();
        let spread = Array1::from_elem(joints, config.spread.ln());
        let actor = Perceptron::draw(&widths(observed, joints), FIRST_ACTIONS, spread, random);
        let critic = Perceptron::draw(&widths(all, 1), 1.0, Array1::zeros(0), random);
        Self {
            actor_adam: Adam::new(&actor),
            critic_adam: Adam::new(&critic),
            actor,
            critic,
            rate: config.learning_rate,
        }
    }

    /// Returns the numbers that the policy observes.
    pub(crate) fn observed(&self) -> usize {
        self.actor.layers.first().map_or(0, |layer| layer.weight.ncols())
    }

    /// Returns the means of the actions.
    pub(crate) fn act(&self, observed: &ArrayView2<'_, f32>) -> Array2<f32> {
        self.actor.run(&observed.slice(s![.., ..self.observed()])).pop().unwrap_or_default()
    }

    /// Returns the values of observations.
    pub(crate) fn values(&self, observed: &ArrayView2<'_, f32>) -> Array1<f32> {
        let chunks: Vec<ArrayView2<'_, f32>> = observed.axis_chunks_iter(Axis(0), ROWS).collect();
        let values: Vec<f32> = chunks
            .into_par_iter()
            .flat_map_iter(|rows| self.critic.run(&rows).pop().unwrap_or_default().into_iter())
            .collect();
        Array1::from(values)
    }

    /// Learns from the steps, which the present policy made.
    pub(crate) fn learn(&mut self, experience: &Experience, config: &LearningConfig, random: &mut ChaCha8Rng) {
        let before = self.actor.spread.clone();
        let mut order: Vec<usize> = (0..experience.actions.nrows()).collect();
        for _ in 0..config.passes {
            order.shuffle(random);
            for rows in order.chunks(config.minibatch) {
                let Part { actor, critic, divergence } = self.gradient(experience, rows, &before, config);
                if config.divergence > 0.0 {
                    let divergence = divergence / rows.len() as f32;
                    if divergence > 2.0 * config.divergence {
                        self.rate = (self.rate / 1.5).max(RATES[0]);
                    } else if divergence < 0.5 * config.divergence {
                        self.rate = (self.rate * 1.5).min(RATES[1]);
                    }
                }
                self.actor_adam.advance(&mut self.actor, &actor, self.rate);
                self.critic_adam.advance(&mut self.critic, &critic, self.rate);
                let [low, high] = LOG_SPREAD;
                self.actor.spread.mapv_inplace(|spread| spread.clamp(low, high));
            }
        }
    }

    /// Returns the gradients of the mean losses of a minibatch.
    fn gradient(&self, experience: &Experience, rows: &[usize], before: &Array1<f32>, config: &LearningConfig) -> Part {
        let weight = 1.0 / rows.len().max(1) as f32;
        let parts: Vec<Part> =
            rows.par_chunks(ROWS).map(|rows| self.part(&experience.rows(rows), before, weight, config)).collect();
        let nothing = Part { actor: self.actor.zeros(), critic: self.critic.zeros(), divergence: 0.0 };
        let mut sum = parts.iter().fold(nothing, |sum, part| Part {
            actor: sum.actor.add(&part.actor),
            critic: sum.critic.add(&part.critic),
            divergence: sum.divergence + part.divergence,
        });
        // The entropy of a normal distribution grows with the logarithm of its deviation.
        sum.actor.spread.mapv_inplace(|slope| slope - config.entropy);
        sum
    }

    fn part(&self, part: &Experience, before: &Array1<f32>, weight: f32, config: &LearningConfig) -> Part {
        let inputs = part.observed.slice(s![.., ..self.observed()]);
        let outputs = self.actor.run(&inputs);
        let means = outputs.last().cloned().unwrap_or_default();
        let (spread, mut of_means) = (&self.actor.spread, Array2::zeros(means.raw_dim()));
        let mut of_spread: Array1<f32> = Array1::zeros(spread.len());
        let mut divergence = 0.0;
        for k in 0..means.nrows() {
            let (mean, mean_before, action) = (means.row(k), part.means.row(k), part.actions.row(k));
            let mut gain = 0.0;
            for j in 0..spread.len() {
                let [deviation, deviation_before] = [spread[j], before[j]].map(f32::exp);
                let far = |mean: f32, deviation: f32| ((action[j] - mean) / deviation).powi(2);
                gain += 0.5 * (far(mean_before[j], deviation_before) - far(mean[j], deviation)) - spread[j] + before[j];
                let apart = deviation_before.powi(2) + (mean_before[j] - mean[j]).powi(2);
                divergence += spread[j] - before[j] + apart / (2.0 * deviation.powi(2)) - 0.5;
            }
            let (ratio, advantage) = (gain.exp(), part.advantages[k]);
            let gains_nothing = if advantage > 0.0 { ratio > 1.0 + config.clip } else { ratio < 1.0 - config.clip };
            if gains_nothing {
                continue;
            }
            let slope = -weight * advantage * ratio;
            for j in 0..spread.len() {
                let (variance, off) = ((2.0 * spread[j]).exp(), action[j] - mean[j]);
                of_means[[k, j]] = slope * off / variance;
                of_spread[j] += slope * (off * off / variance - 1.0);
            }
        }
        let mut actor = self.actor.gradient(&inputs, &outputs, of_means);
        actor.spread = of_spread;
        let outputs = self.critic.run(&part.observed.view());
        let mut of_values = outputs.last().cloned().unwrap_or_default();
        Zip::from(of_values.rows_mut())
            .and(&part.returns)
            .for_each(|mut value, target| value.mapv_inplace(|value| weight * (value - target)));
        let critic = self.critic.gradient(&part.observed.view(), &outputs, of_values);
        Part { actor, critic, divergence }
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;

    /// The losses whose gradients are computed, in double precision but for the networks.
    fn losses(learner: &Learner, e: &Experience, before: &Array1<f32>, config: &LearningConfig) -> [f64; 2] {
        let means = learner.act(&e.observed.view());
        let values = learner.values(&e.observed.view());
        let (mut of_actor, mut of_critic) = (0.0, 0.0);
        for k in 0..means.nrows() {
            let log = |mean: f32, spread: f32, action: f32| {
                let [mean, spread, action] = [mean, spread, action].map(f64::from);
                -0.5 * ((action - mean) / spread.exp()).powi(2) - spread
            };
            let spread = &learner.actor.spread;
            let gain: f64 = (0..spread.len())
                .map(|j| {
                    log(means[[k, j]], spread[j], e.actions[[k, j]])
                        - log(e.means[[k, j]], before[j], e.actions[[k, j]])
                })
                .sum();
            let (ratio, advantage, clip) = (gain.exp(), f64::from(e.advantages[k]), f64::from(config.clip));
            of_actor -= (ratio * advantage).min(ratio.clamp(1.0 - clip, 1.0 + clip) * advantage);
            of_critic += 0.5 * f64::from(values[k] - e.returns[k]).powi(2);
        }
        let count = means.nrows() as f64;
        let entropy: f64 = learner.actor.spread.iter().map(|spread| f64::from(*spread)).sum();
        [of_actor / count - f64::from(config.entropy) * entropy, of_critic / count]
    }

    #[test]
    fn gradients_are_those_of_the_losses() {
        let config = LearningConfig { hidden: vec![6, 5], entropy: 0.01, minibatch: 300, ..LearningConfig::default() };
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut learner = Learner::draw([4, 7, 3], &config, &mut random);
        let mut numbers =
            |rows, columns| Array2::from_shape_simple_fn((rows, columns), || random.random_range(-1.0..1.0_f32));
        // More rows than a thread handles at once.
        let observed = numbers(300, 7);
        let means = learner.act(&observed.view()) + 0.05 * numbers(300, 3);
        let actions = &means + 0.5 * numbers(300, 3);
        let (advantages, returns) = (numbers(300, 1).column(0).to_owned(), numbers(300, 1).column(0).to_owned());
        let experience = Experience { observed, actions, means, advantages, returns };
        let before = &learner.actor.spread + 0.02;
        let rows: Vec<usize> = (0..300).collect();
        let Part { actor, critic, .. } = learner.gradient(&experience, &rows, &before, &config);
        for (which, gradient) in [actor, critic].into_iter().enumerate() {
            let count = gradient.values().count();
            let largest = gradient.values().fold(0.0_f32, |most, g| most.max(g.abs()));
            for (k, analytic) in gradient.values().enumerate() {
                const STEP: f32 = 3e-3;
                let mut at = |change: f32| {
                    let network = if which == 0 { &mut learner.actor } else { &mut learner.critic };
                    let value = network.values_mut().nth(k).map(|value| std::mem::replace(value, *value + change));
                    let loss = losses(&learner, &experience, &before, &config)[which];
                    let network = if which == 0 { &mut learner.actor } else { &mut learner.critic };
                    if let Some((to, value)) = network.values_mut().nth(k).zip(value) {
                        *to = value;
                    }
                    loss
                };
                let numeric = ((at(STEP) - at(-STEP)) / f64::from(2.0 * STEP)) as f32;
                assert!(
                    (numeric - analytic).abs() < 0.02 * largest,
                    "network {which}, weight {k} of {count}: {numeric} {analytic}"
                );
            }
        }
    }

    #[test]
    fn actions_become_those_that_are_rewarded() {
        let config = LearningConfig { hidden: vec![16], minibatch: 256, ..LearningConfig::default() };
        let mut random = ChaCha8Rng::seed_from_u64(8);
        let mut learner = Learner::draw([2, 3, 2], &config, &mut random);
        // The reward is greatest for the action whose first number is half the first observation, and whose second is 0.3.
        let reward = |observed: &Array2<f32>, actions: &Array2<f32>| {
            Array1::from_shape_fn(actions.nrows(), |k| {
                -(actions[[k, 0]] - 0.5 * observed[[k, 0]]).powi(2) - (actions[[k, 1]] - 0.3).powi(2)
            })
        };
        let mut of_updates = Vec::new();
        for _ in 0..40 {
            let mut numbers =
                |columns| Array2::from_shape_simple_fn((512, columns), || random.random_range(-1.7..1.7_f32));
            let observed = numbers(3);
            let means = learner.act(&observed.view());
            let actions = &means + numbers(2) * learner.actor.spread.mapv(f32::exp);
            let returns = reward(&observed, &actions);
            of_updates.push(reward(&observed, &means).mean().unwrap_or(f32::NAN));
            let advantages = &returns - &learner.values(&observed.view());
            let advantages = (&advantages - advantages.mean().unwrap_or(0.0)) / advantages.std(0.0);
            let experience = Experience { observed, actions, means, advantages, returns };
            learner.learn(&experience, &config, &mut random);
        }
        let (first, last) = (of_updates[0], of_updates[39]);
        assert!(first < -0.2 && last > -0.02, "{first} to {last}");
    }

    #[test]
    fn advantages_end_with_their_episodes() {
        let config = LearningConfig { discount: 0.5, trace: 0.5, ..LearningConfig::default() };
        let column = |numbers: [f32; 3]| Array2::from_shape_fn((3, 1), |(t, _)| numbers[t]);
        let values = Array2::from_shape_fn((4, 1), |(t, _)| [1.0, 2.0, 3.0, 4.0][t]);
        let is = |flags: [bool; 3]| Array2::from_shape_fn((3, 1), |(t, _)| flags[t]);
        let rewards = column([1.0, 1.0, 1.0]);
        let of =
            |fell, ended| advantages(&rewards, &values, &is(fell), &is(ended), &config).0.into_raw_vec_and_offset().0;
        // 1 + 0.5 * 4 - 3 = 0, then 1 + 0.5 * 3 - 2 = 0.5, then 1 + 0.5 * 2 - 1 = 1 and a quarter of what follows.
        assert_eq!(of([false; 3], [false; 3]), [1.125, 0.5, 0.0]);
        // A fall has no future.
        assert_eq!(of([false, true, false], [false, true, false]), [0.75, -1.0, 0.0]);
        // The end of the time has that of its last observation.
        assert_eq!(of([false; 3], [true, false, false]), [1.0, 0.5, 0.0]);
    }
}
