//! Learnt policies that move a robot hand, with the contract under which they were trained.
//!
//! A policy is an ONNX file with mjlab's metadata (feature `onnx`), or a safetensors file with the same fields in a TOML file beside it:
//! names of the joints in any order, stiffness and damping, default angles, scale of the actions, and the observed terms with scales, clips and
//! histories. What is missing or contradicts the network or the hand is refused before an episode starts. [`ObservationMap`] and
//! [`ActionMap`] serve environments of policies, too, so that the same weights move the hand alike in both, to the bit.
//!
//! ```no_run
//! use std::path::Path;
//!
//! use mvt_gaits::controller::{Controller, Proprioception};
//! use mvt_policy::{Policy, PolicyController};
//! use mvt_robot::hand::{Hand, Side};
//!
//! let hand = Hand::allegro(Side::Left);
//! let policy = Policy::read(Path::new("policy.safetensors"), &hand)?;
//! let gait = policy.start(None, &hand);
//! let mut controller = PolicyController::new(&policy, &hand, &gait)?;
//! let targets = controller.command(&Proprioception::at(0.0, vec![0.2; 16]));
//! assert_eq!(targets.len(), 16);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod contract;
mod error;
mod fields;
mod layers;
mod made;
mod maps;
mod network;
#[cfg(feature = "onnx")]
mod onnx;
mod player;
mod policy;
mod term;
#[cfg(feature = "onnx")]
mod wire;

pub use contract::{ActionKind, ObservedTerm, PolicyContract, PolicyStart};
pub use error::PolicyError;
pub use made::{MadePolicy, PolicyLayer};
pub use maps::{ActionMap, ObservationMap, PolicySenses, pooled_touch_mm};
pub use player::PolicyController;
pub use policy::{LARGEST_ACTION, Policy, is_policy};
pub use term::{ObservationTerm, TOUCH_GRID};
pub use {mvt_gaits, mvt_robot};
