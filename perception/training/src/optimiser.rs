//! AdamW with a moving average of the weights, a cosine schedule with warm-up, and clipping of gradients.

use std::collections::BTreeMap;

use mvt_settings::settings;

use mvt_touch::network::WeightTensor;

settings! {
    /// Step sizes and averages of the optimiser.
    #[derive(Copy)]
    pub struct OptimiserConfig {
        /// Greatest step size, after the warm-up.
        pub learning_rate: f32 = 1e-3, 1e-9..=10.0;
        /// Step size at the end, as a share of the greatest.
        pub final_share: f32 = 0.02, 0.0..=1.0;
        /// Steps over which the step size grows from zero.
        pub warm_up: u64 = 200, 0..=1_000_000_000;
        /// Shares of the mean gradient and of its mean square that are kept per step.
        pub betas: [f32; 2] = [0.9, 0.99], 0.0..=0.999_999;
        /// Share of a matrix or kernel that is subtracted per step, times the step size. 0 is Adam.
        pub weight_decay: f32 = 0.01, 0.0..=1000.0;
        /// Greatest length of the gradient over all tensors; longer gradients are shortened to it.
        pub clip: f32 = 1.0, 1e-6..=1e6;
        /// Share of the averaged weights that is kept per step.
        pub average: f32 = 0.998, 0.0..=0.999_999;
    }
}

/// Added to the root of the mean square gradient.
const EPS: f32 = 1e-8;

/// Tensors by name.
pub type Tensors = BTreeMap<String, WeightTensor>;

// Why: notes/decisions/touch.md, "The optimiser is ours".
/// Weights in training with the memory of the optimiser.
#[derive(Debug, Clone, PartialEq)]
pub struct OptimiserState {
    /// Completed steps.
    pub step: u64,
    /// Weights.
    pub weights: Tensors,
    /// Moving average of the weights.
    pub average: Tensors,
    /// Mean gradients.
    pub mean: Tensors,
    /// Mean squares of gradients.
    pub square: Tensors,
}

impl OptimiserState {
    /// Returns the state at the start of training.
    pub fn new(weights: Tensors) -> Self {
        let zeros: Tensors = weights.iter().map(|(name, tensor)| (name.clone(), tensor.zeros())).collect();
        Self { step: 0, average: weights.clone(), mean: zeros.clone(), square: zeros, weights }
    }

    /// Does one of `steps` steps. Returns the length of the gradient before clipping; if it is not finite, nothing changes.
    pub fn advance(&mut self, gradients: &Tensors, config: &OptimiserConfig, steps: u64) -> f32 {
        let squares = gradients.values().flat_map(|tensor| &tensor.values).map(|&g| f64::from(g) * f64::from(g));
        let length = squares.sum::<f64>().sqrt() as f32;
        if !length.is_finite() {
            return length;
        }
        let Update { rate, decay, clip, betas: [b1, b2], unbiased: [first, second], keep } =
            config.update(self.step, steps);
        let scale = (clip / length).min(1.0);
        self.step += 1;
        let states = self.mean.values_mut().zip(self.square.values_mut());
        for (((name, weight), average), (mean, square)) in
            self.weights.iter_mut().zip(self.average.values_mut()).zip(states)
        {
            let Some(gradient) = gradients.get(name) else { continue };
            let decay = if Self::is_decayed(name, &weight.shape) { rate * decay } else { 0.0 };
            for i in 0..weight.values.len() {
                let g = gradient.values[i] * scale;
                let (m, v, w) = (&mut mean.values[i], &mut square.values[i], &mut weight.values[i]);
                *m = b1 * *m + (1.0 - b1) * g;
                *v = b2 * *v + (1.0 - b2) * g * g;
                *w -= decay * *w + rate * (*m / first) / ((*v / second).sqrt() + EPS);
                average.values[i] = keep * average.values[i] + (1.0 - keep) * *w;
            }
        }
        length
    }

    /// Returns whether a tensor is a matrix or kernel, which decays.
    pub fn is_decayed(name: &str, shape: &[usize]) -> bool {
        shape.len() > 1 && !name.ends_with("A_log")
    }
}

/// Numbers of a step of the optimiser.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Update {
    /// Step size.
    pub rate: f32,
    /// Share of a matrix that is subtracted, times the step size.
    pub decay: f32,
    /// Greatest length of the gradient.
    pub clip: f32,
    /// Shares of the mean gradient and its mean square that are kept.
    pub betas: [f32; 2],
    /// Sums of the weights in these means so far; 1 after many steps.
    pub unbiased: [f32; 2],
    /// Share of the averaged weights that is kept.
    pub keep: f32,
}

impl OptimiserConfig {
    /// Returns the numbers of the step that follows `step` of `steps` steps.
    pub fn update(&self, step: u64, steps: u64) -> Update {
        let done = step + 1;
        Update {
            rate: self.rate(step, steps),
            decay: self.weight_decay,
            clip: self.clip,
            betas: self.betas,
            unbiased: self.betas.map(|beta| 1.0 - f64::from(beta).powf(done as f64) as f32),
            // The average of the first steps has equal weights, so that the initial weights are soon forgotten.
            keep: self.average.min((1 + done) as f32 / (10 + done) as f32),
        }
    }

    /// Returns the step size after `step` of `steps` steps.
    pub fn rate(&self, step: u64, steps: u64) -> f32 {
        let warm_up = ((step + 1) as f32 / self.warm_up.max(1) as f32).min(1.0);
        let done = (step as f32 / steps.max(1) as f32).min(1.0);
        let cosine = 0.5 * (1.0 + (std::f32::consts::PI * done).cos());
        self.learning_rate * warm_up * (self.final_share + (1.0 - self.final_share) * cosine)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tensors(values: [f32; 2]) -> Tensors {
        Tensors::from([("w".to_owned(), WeightTensor { shape: vec![1, 2], values: values.to_vec() })])
    }

    #[test]
    fn finds_the_bottom_of_a_parabola() {
        let config = OptimiserConfig { learning_rate: 0.05, weight_decay: 0.0, warm_up: 5, ..Default::default() };
        let mut state = OptimiserState::new(tensors([3.0, -2.0]));
        for _ in 0..600 {
            let w = &state.weights["w"].values;
            let gradients = tensors([2.0 * (w[0] - 1.0), 20.0 * (w[1] - 0.5)]);
            state.advance(&gradients, &config, 600);
        }
        let w = &state.weights["w"].values;
        assert!((w[0] - 1.0).abs() < 1e-2 && (w[1] - 0.5).abs() < 1e-2, "{w:?}");
    }

    /// By hand: the first step of Adam has the size of the rate, whatever the gradient's; decay comes on top.
    #[test]
    fn first_step_by_hand() {
        let config = OptimiserConfig {
            learning_rate: 0.1,
            warm_up: 1,
            weight_decay: 0.5,
            clip: 1e9,
            ..OptimiserConfig::default()
        };
        let mut state = OptimiserState::new(tensors([1.0, 1.0]));
        let length = state.advance(&tensors([3.0, -4.0]), &config, 1_000_000);
        let w = &state.weights["w"].values;
        assert!((length - 5.0).abs() < 1e-6);
        assert!((w[0] - (1.0 - 0.05 - 0.1)).abs() < 1e-5 && (w[1] - (1.0 - 0.05 + 0.1)).abs() < 1e-5, "{w:?}");
    }

    #[test]
    fn rate_rises_and_falls() {
        let config = OptimiserConfig { learning_rate: 1.0, warm_up: 10, final_share: 0.1, ..Default::default() };
        assert!(config.rate(0, 1000) < 0.11 && config.rate(9, 1000) > 0.99);
        assert!((config.rate(500, 1000) - 0.55).abs() < 1e-3 && (config.rate(1000, 1000) - 0.1).abs() < 1e-6);
    }

    #[test]
    fn a_gradient_that_is_not_finite_changes_nothing() {
        let mut state = OptimiserState::new(tensors([1.0, 2.0]));
        let before = state.clone();
        assert!(state.advance(&tensors([f32::NAN, 0.0]), &OptimiserConfig::default(), 10).is_nan());
        assert_eq!(state, before);
    }
}
