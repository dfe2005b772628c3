//! Settings of a training.

use mvt_settings::settings;

settings! {
    /// Settings of PPO (Schulman et al. 2017). A policy depends on all of them and on the seed.
    pub struct LearningConfig {
        /// Environments that step together.
        pub environments: usize = 64, 1..=4096;
        /// Steps of each environment between two updates.
        pub steps: usize = 64, 2..=4096;
        /// Updates after which all environments start anew and a training can be interrupted.
        pub block: u64 = 20, 1..=10_000;
        /// Passes over the steps of an update.
        pub passes: usize = 5, 1..=100;
        /// Steps for which a gradient is computed together.
        pub minibatch: usize = 1024, 16..=65_536;
        /// Sizes of the hidden layers, of the policy and of the critic.
        pub hidden: Vec<usize> = vec![128, 64], List { length: 1..=4, each: 4..=1024 };
        /// Share of a reward that counts a step earlier.
        pub discount: f32 = 0.99, 0.0..=0.9999;
        /// Share of an advantage that counts a step earlier: lambda of Schulman et al. (2016).
        pub trace: f32 = 0.95, 0.0..=1.0;
        /// Change of an action's probability, as a share, beyond which nothing is gained.
        pub clip: f32 = 0.2, 0.01..=1.0;
        /// First step size. It follows the divergence of the policies before and after an update.
        pub learning_rate: f32 = 5e-4, 1e-6..=0.1;
        /// Divergence (Kullback and Leibler) of an update that is aimed at; 0 leaves the step size as it is.
        pub divergence: f32 = 0.01, 0.0..=1.0;
        /// Weight of the entropy of the actions.
        pub entropy: f32 = 0.0, 0.0..=1.0;
        /// Standard deviation of the actions at the start.
        pub spread: f32 = 0.4, 0.01..=2.0;
        /// Rate of turning in a block from which the later scenes of a curriculum join, rad/s.
        pub later_rad_s: f64 = 0.5, -10.0..=10.0;
        /// Falls per minute in a block up to which they do.
        pub later_falls_per_minute: f64 = 1.0, 0.0..=1000.0;
    }
}
