//! Training of policies that turn an object in the hand.
//!
//! [`PolicyTraining`] is PPO over the environments of [`mvt_environment`]. The policy observes proprioception, the object's place and the
//! forces on the pads; its critic knows the object's true motion, mass and friction, which differ from episode to episode, as do size,
//! stiffness of the drives and latency. A [`Curriculum`] begins with easy objects; the others join when these are held and turned. The result depends on the settings and the seed, and not on the number of threads or on
//! interruptions. Its episodes never begin as those that people name by their seeds ([`mvt_environment::LATER_SEED`]), so that any small
//! seed tests what was learnt.
//!
//! ```
//! use std::sync::Arc;
//!
//! use mvt_environment::Scene;
//! use mvt_learning::{LearningConfig, PolicyTraining, in_sizes, training_settings};
//! use mvt_robot::hand::{Hand, Side};
//!
//! let cube = mvt_objects::catalogue::load("cube70", &mut Vec::new())?;
//! let settings = training_settings(&Hand::allegro(Side::Left), false);
//! let scenes = in_sizes(&cube, 2, 0.05).into_iter().map(|size| Ok(Arc::new(Scene::new(size, settings.clone())?)));
//! let scenes = scenes.collect::<Result<Vec<Arc<Scene>>, mvt_environment::TaskError>>()?;
//! let config = LearningConfig { environments: 2, steps: 4, minibatch: 16, block: 1, ..LearningConfig::default() };
//! let mut training = PolicyTraining::new(scenes, config, 7)?;
//! training.advance()?;
//! println!("{:?}", training.curve());
//! let (weights, contract) = training.policy_files()?;
//! assert!(contract.contains("joint_pos_target_unit") && !weights.is_empty());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

// Its build script puts libmujoco on the link line.
use mvt_mujoco_lib as _;

mod config;
mod curriculum;
mod error;
mod moments;
mod objects;
mod perceptron;
mod state;
mod training;
mod update;

pub use config::LearningConfig;
pub use curriculum::Curriculum;
pub use error::LearningError;
pub use objects::{check_trainable, in_sizes};
pub use training::{LearningPoint, PolicyTraining, training_settings};
pub use {mvt_environment, mvt_objects, mvt_robot};
