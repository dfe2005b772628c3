//! The state of an interrupted training, from which it goes on to the bit.

use std::collections::HashMap;

use ndarray::Array1;
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};

use crate::config::LearningConfig;
use crate::curriculum::Curriculum;
use crate::error::LearningError;
use crate::perceptron::Perceptron;
use crate::training::{LearningPoint, PolicyTraining};

/// Entry of the metadata that names settings, seed and scenes.
const IDENTITY: &str = "training";

fn unusable(reason: impl std::fmt::Display) -> LearningError {
    LearningError::State(reason.to_string())
}

impl PolicyTraining {
    /// Returns the state as a safetensors file; `None` inside a block. `scenes` names what the training depends on beside its settings.
    ///
    /// # Errors
    /// [`LearningError::State`] if it cannot be written.
    pub fn state(&self, scenes: &str) -> Result<Option<Vec<u8>>, LearningError> {
        if !self.updates().is_multiple_of(self.config.block) {
            return Ok(None);
        }
        let of = |network: &Perceptron| network.values().map(|value| f64::from(*value)).collect();
        let learner = &self.learner;
        let curve = self.curve.iter();
        let numbers: [(&str, Vec<f64>); 10] = [
            ("actor", of(&learner.actor)),
            ("actor.mean", of(&learner.actor_adam.mean)),
            ("actor.square", of(&learner.actor_adam.square)),
            ("critic", of(&learner.critic)),
            ("critic.mean", of(&learner.critic_adam.mean)),
            ("critic.square", of(&learner.critic_adam.square)),
            ("observed.mean", self.moments.mean.to_vec()),
            ("observed.squares", self.moments.squares.to_vec()),
            (
                "counts",
                vec![
                    self.updates as f64,
                    learner.actor_adam.steps as f64,
                    learner.critic_adam.steps as f64,
                    f64::from(learner.rate),
                    self.moments.count,
                ],
            ),
            ("curve", curve.flat_map(|p| [p.steps as f64, p.reward, p.rate_rad_s, p.falls_per_minute]).collect()),
        ];
        let bytes =
            numbers.map(|(name, numbers)| (name, numbers.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>()));
        let mut views = Vec::new();
        for (name, bytes) in &bytes {
            views.push((*name, TensorView::new(Dtype::F64, vec![bytes.len() / 8], bytes).map_err(unusable)?));
        }
        let metadata = HashMap::from([(IDENTITY.to_owned(), self.identity(scenes)?)]);
        Ok(Some(safetensors::serialize(views, Some(metadata)).map_err(unusable)?))
    }

    fn identity(&self, scenes: &str) -> Result<String, LearningError> {
        serde_json::to_string(&(&self.config, self.seed, scenes)).map_err(unusable)
    }

    /// Goes on with a training from its state.
    ///
    /// # Errors
    /// [`LearningError`] as for a new one, or if the state is damaged or that of another training.
    pub fn resume(
        scenes: impl Into<Curriculum>,
        config: LearningConfig,
        seed: u64,
        names: &str,
        state: &[u8],
    ) -> Result<Self, LearningError> {
        let mut training = Self::new(scenes, config, seed)?;
        let (_, metadata) = SafeTensors::read_metadata(state).map_err(unusable)?;
        let identity = metadata.metadata().as_ref().and_then(|fields| fields.get(IDENTITY));
        if identity != Some(&training.identity(names)?) {
            return Err(unusable("it is of a training with other objects, settings or seed"));
        }
        let tensors = SafeTensors::deserialize(state).map_err(unusable)?;
        let numbers = |name: &str| -> Result<Vec<f64>, LearningError> {
            let tensor = tensors.tensor(name).map_err(unusable)?;
            let number = |bytes: &[u8]| f64::from_le_bytes(bytes.try_into().unwrap_or_default());
            let numbers: Vec<f64> = tensor.data().chunks_exact(8).map(number).collect();
            match tensor.dtype() == Dtype::F64 && numbers.iter().all(|x| x.is_finite()) {
                true => Ok(numbers),
                false => Err(unusable(format!("{name} is damaged"))),
            }
        };
        let fill = |network: &mut Perceptron, name: &str| -> Result<(), LearningError> {
            let numbers = numbers(name)?;
            if numbers.len() != network.values().count() {
                return Err(unusable(format!("{name} has {} numbers", numbers.len())));
            }
            network.values_mut().zip(numbers).for_each(|(to, number)| *to = number as f32);
            Ok(())
        };
        let learner = &mut training.learner;
        fill(&mut learner.actor, "actor")?;
        fill(&mut learner.actor_adam.mean, "actor.mean")?;
        fill(&mut learner.actor_adam.square, "actor.square")?;
        fill(&mut learner.critic, "critic")?;
        fill(&mut learner.critic_adam.mean, "critic.mean")?;
        fill(&mut learner.critic_adam.square, "critic.square")?;
        let [mean, squares] = [numbers("observed.mean")?, numbers("observed.squares")?].map(Array1::from);
        if [mean.len(), squares.len()] != [training.moments.mean.len(); 2] {
            return Err(unusable("observed.mean has another number of observations"));
        }
        let &[updates, actor, critic, rate, count] = numbers("counts")?.as_slice() else {
            return Err(unusable("counts is damaged"));
        };
        (learner.actor_adam.steps, learner.critic_adam.steps) = (actor as u64, critic as u64);
        learner.rate = rate as f32;
        (training.moments.mean, training.moments.squares, training.moments.count) = (mean, squares, count);
        training.updates = updates as u64;
        training.curve = numbers("curve")?
            .chunks_exact(4)
            .map(|p| LearningPoint { steps: p[0] as u64, reward: p[1], rate_rad_s: p[2], falls_per_minute: p[3] })
            .collect();
        training.begin_block()?;
        Ok(training)
    }
}
