//! What a network costs.

use std::iter::Sum;

use super::architecture::Architecture;
use super::layer::{NetworkLayer, Op};

/// Counts of a network, or a layer of it, for one image.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Cost {
    /// Numbers in its weights.
    pub parameters: u64,
    /// Multiplications with addition of matrix products and convolutions, and of a scan's recurrence and readout. Norms,
    /// activations, residuals and resampling are left out, as is usual.
    pub macs: u64,
    /// Bytes of all layers' results in 32-bit floats: what training keeps of an image, up to activations that are kept twice.
    pub activation_bytes: u64,
}

impl Architecture {
    /// Counts for an input of `[height, width]`, which is resized if need be ([`Architecture::fit`]).
    pub fn cost(&self, size: [usize; 2]) -> Cost {
        let size = self.fit(size);
        self.layers().iter().map(|layer| layer.cost(size)).sum()
    }
}

impl NetworkLayer {
    /// Counts for an input of `[height, width]` of the network that it is a layer of.
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

/// Of the layer, at `count` places.
fn macs(layer: &NetworkLayer, count: u64) -> u64 {
    let each = match layer.op {
        Op::Linear { inputs, outputs } => inputs * outputs,
        Op::Convolution { inputs, outputs } => 9 * inputs * outputs,
        Op::Norm { .. } | Op::Table { .. } => 0,
        Op::Mamba { width, inner, state, taps, rank } => {
            // Projections, convolution, and per state: exponent, decay, input, readout; and the gate and skip of a channel.
            3 * width * inner + inner * (rank + 2 * state) + rank * inner + inner * taps + inner * (4 * state + 2)
        }
        // Scores and their use on the values, with every token.
        Op::Attention { width } => 2 * width * count as usize,
    };
    count * each as u64
}

/// Channels of the layer's results, a Mamba block's inner ones among them.
fn results(layer: &NetworkLayer) -> u64 {
    let channels = match layer.op {
        Op::Linear { outputs, .. } | Op::Convolution { outputs, .. } => outputs,
        Op::Norm { width } | Op::Attention { width } => width,
        Op::Mamba { width, inner, state, rank, .. } => 5 * inner + rank + 2 * state + width,
        Op::Table { .. } => 0,
    };
    channels as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::Vit;

    /// The published figures of ViT-S/16 at 224: 21.67 M parameters in the encoder without its final norm, 4.6 GMAC.
    #[test]
    fn vit_small_counts_as_published() {
        let vit = Architecture::Vit(Vit { positions: [14, 14], ..Vit::default() });
        let encoder =
            |layer: &&NetworkLayer| ["patch", "positions", "class", "blocks"].iter().any(|p| layer.name.starts_with(p));
        let layers = vit.layers();
        let encoder: Vec<&NetworkLayer> = layers.iter().filter(encoder).collect();
        let count: u64 = encoder.iter().map(|layer| parameters(layer)).sum();
        // The class token has no position of its own here, 384 numbers.
        assert_eq!(count + 384, 21_664_896);
        let macs: u64 = encoder.iter().map(|layer| macs(layer, layer.grid.count([224, 224]) as u64)).sum();
        assert!((macs as f64 / 1e9 - 4.6).abs() < 0.05, "{macs}");
    }

    #[test]
    fn default_is_small() {
        let cost = Architecture::preset("default").unwrap().cost([320, 240]);
        assert!(cost.parameters < 2_500_000 && cost.macs < 900_000_000, "{cost:?}");
    }
}
