//! Costs of a network.

use std::iter::Sum;

use super::architecture::Architecture;
use super::layer::{NetworkLayer, Op};

/// Costs of a network, or a layer of it, for one image.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Cost {
    /// Numbers in its weights.
    pub parameters: u64,
    /// Multiplications with addition of matrix products and convolutions, and of a scan's recurrence and readout. As usual, the count
    /// omits norms, activations, residuals, resampling, and the padding of windows.
    pub macs: u64,
    /// Bytes of the results of all layers in 32-bit floats. Training keeps about as many per image; it keeps some activations twice.
    pub activation_bytes: u64,
}

impl Architecture {
    /// Returns the costs for an input of `[height, width]`, resized by [`Architecture::fit`].
    pub fn cost(&self, size: [usize; 2]) -> Cost {
        let size = self.fit(size);
        self.layers().iter().map(|layer| layer.cost(size)).sum()
    }
}

impl NetworkLayer {
    /// Returns the costs of the layer if the input of the network is `[height, width]`.
    pub fn cost(&self, size: [usize; 2]) -> Cost {
        let count = self.grid.count(size) as u64;
        Cost { parameters: parameters(self), macs: macs(self, count), activation_bytes: 4 * count * results(self) }
    }
}

impl Sum for Cost {
    fn sum<I: Iterator<Item = Self>>(costs: I) -> Self {
        costs.fold(Self::default(), |a, b| Self {
            parameters: a.parameters + b.parameters,
            macs: a.macs + b.macs,
            activation_bytes: a.activation_bytes + b.activation_bytes,
        })
    }
}

fn parameters(layer: &NetworkLayer) -> u64 {
    layer.tensors().iter().map(|(_, shape)| shape.iter().product::<usize>() as u64).sum()
}

/// Returns the MACs of the layer at `count` places.
fn macs(layer: &NetworkLayer, count: u64) -> u64 {
    let each = match layer.op {
        Op::Linear { inputs, outputs } => inputs * outputs,
        Op::Convolution { inputs, outputs } => 9 * inputs * outputs,
        Op::Depthwise { width, side } => side * side * width,
        Op::Norm { .. } | Op::Scale { .. } | Op::Table { .. } => 0,
        Op::Mamba { width, inner, state, taps, rank } => {
            // Projections, convolution, and per state: exponent, decay, input, readout; and the gate and skip of a channel.
            3 * width * inner + inner * (rank + 2 * state) + rank * inner + inner * taps + inner * (4 * state + 2)
        }
        // Scores and their use on the values, with every token.
        Op::Attention { width } => 2 * width * count as usize,
        Op::WindowAttention { width, window } => 2 * width * window * window,
    };
    count * each as u64
}

/// Returns the channels of the layer's results, the inner ones of a Mamba block included.
fn results(layer: &NetworkLayer) -> u64 {
    let channels = match layer.op {
        Op::Linear { outputs, .. } | Op::Convolution { outputs, .. } => outputs,
        Op::Norm { width } | Op::Scale { width } | Op::Depthwise { width, .. } => width,
        Op::Attention { width } | Op::WindowAttention { width, .. } => width,
        Op::Mamba { width, inner, state, rank, .. } => 5 * inner + rank + 2 * state + width,
        Op::Table { .. } => 0,
    };
    channels as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::Vit;

    /// Published figures of ViT-S/16 at 224: 21.67 M parameters in the encoder without its final norm, 4.6 GMAC.
    #[test]
    fn vit_small_counts_as_published() {
        let vit = Architecture::Vit(Vit { positions: [14, 14], ..Vit::default() });
        let encoder =
            |layer: &&NetworkLayer| ["patch", "positions", "class", "blocks"].iter().any(|p| layer.name.starts_with(p));
        let layers = vit.layers();
        let encoder: Vec<&NetworkLayer> = layers.iter().filter(encoder).collect();
        let count: u64 = encoder.iter().map(|layer| parameters(layer)).sum();
        // The published class token has a position of its own, 384 numbers.
        assert_eq!(count + 384, 21_664_896);
        let macs: u64 = encoder.iter().map(|layer| macs(layer, layer.grid.count([224, 224]) as u64)).sum();
        assert!((macs as f64 / 1e9 - 4.6).abs() < 0.05, "{macs}");
    }

    /// Published figures of Swin-T and ConvNeXt-T at 224 without classifier: 27.52 M and 27.82 M parameters, 4.5 GMAC each.
    #[test]
    fn pyramids_count_as_published() {
        // The published merging of patches has no bias; both have a norm before the classifier, and Swin's four are the decoder's here.
        for (name, parameters, biases) in [("swin", 27_519_354, 192 + 384 + 768), ("convnext", 27_820_128, 0)] {
            let layers = Architecture::preset(name).unwrap().layers();
            let encoder = |layer: &&NetworkLayer| ["patch", "norm", "stages"].iter().any(|p| layer.name.starts_with(p));
            let cost: Cost = layers.iter().filter(encoder).map(|layer| layer.cost([224, 224])).sum();
            assert_eq!(cost.parameters + 2 * 768 - biases, parameters, "{name}");
            assert!((cost.macs as f64 / 1e9 - 4.45).abs() < 0.1, "{name}: {}", cost.macs);
        }
    }

    #[test]
    fn default_is_small() {
        let cost = Architecture::preset("default").unwrap().cost([320, 240]);
        assert!(cost.parameters < 2_500_000 && cost.macs < 900_000_000, "{cost:?}");
    }
}
