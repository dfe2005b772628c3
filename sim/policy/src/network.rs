//! The network of a policy, whatever its file.

use crate::layers::Layers;
#[cfg(feature = "onnx")]
use crate::onnx::OnnxNetwork;

/// A network. What it remembers is kept outside.
#[derive(Debug)]
pub(crate) enum Network {
    Layers(Layers),
    #[cfg(feature = "onnx")]
    Onnx(Box<OnnxNetwork>),
}

impl Network {
    /// Returns the number of inputs, where it is fixed, and that of outputs, where it is stated.
    pub(crate) fn sizes(&self) -> [Option<usize>; 2] {
        match self {
            Self::Layers(layers) => layers.sizes().map(Some),
            #[cfg(feature = "onnx")]
            Self::Onnx(onnx) => onnx.sizes(),
        }
    }

    /// Returns the state before the first observation; empty if the network remembers nothing.
    pub(crate) fn first_state(&self) -> Vec<Vec<f32>> {
        match self {
            Self::Layers(layers) => layers.first_state(),
            #[cfg(feature = "onnx")]
            Self::Onnx(onnx) => onnx.first_state(),
        }
    }

    /// Returns the action for an observation, and changes the state.
    pub(crate) fn run(&self, observation: &[f32], state: &mut [Vec<f32>]) -> Result<Vec<f32>, String> {
        match self {
            Self::Layers(layers) => Ok(layers.run(observation, state)),
            #[cfg(feature = "onnx")]
            Self::Onnx(onnx) => onnx.run(observation, state),
        }
    }

    /// Returns it in words.
    pub(crate) fn in_words(&self) -> String {
        match self {
            Self::Layers(layers) => layers.in_words(),
            #[cfg(feature = "onnx")]
            Self::Onnx(onnx) => onnx.in_words(),
        }
    }
}
