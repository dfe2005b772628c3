//! Decoder of DPT: maps are joined from the coarsest to the finest; then two heads.

use super::image::resample;
use super::layers::{Convolution, Linear, Matrix, Unit};
use super::map::FeatureMap;
use crate::network::Weights;
use mvt_products::Instructions;
use mvt_products::multiply::{LANES, Then};

/// Decoder with packed weights.
#[derive(Debug)]
pub(super) struct Dpt {
    instructions: Instructions,
    pub(super) channels: usize,
    /// Two per level, shallow first.
    units: Vec<[Unit; 2]>,
    /// Depth, contact.
    heads: [Head; 2],
}

#[derive(Debug)]
struct Head {
    conv1: Convolution,
    conv2: Convolution,
    /// Writes one of the two channels of the output.
    out: Linear,
    channels: [usize; 2],
}

/// Memory of the decoder.
#[derive(Debug)]
pub(super) struct DecoderBuffers {
    /// Maps from which the decoder starts.
    pub(super) levels: Vec<FeatureMap>,
    between: Vec<FeatureMap>,
    /// Twice the size of the finest level.
    fused: FeatureMap,
    /// Maps of a head, at that size and at the size of the input.
    narrow: FeatureMap,
    wide: FeatureMap,
    features: FeatureMap,
    /// Indentation and contact at the input's size.
    pub(super) output: FeatureMap,
}

impl Dpt {
    pub(super) fn new(instructions: Instructions, weights: &Weights, levels: usize) -> Self {
        let channels = weights.values("reassemble.0.project.bias").len();
        let stored_channels = channels.next_multiple_of(LANES);
        let units = |k: usize| {
            let unit = |part: &str| Unit::new(instructions, weights, &format!("fusion.{k}.{part}"), stored_channels);
            [unit("unit1"), unit("unit2")]
        };
        let head = |k: usize, name: &str| {
            let narrow = weights.values(&format!("{name}.conv1.bias")).len();
            let matrix = Matrix::of(weights, &format!("{name}.out"));
            let own = |n: usize| (n == k).then_some(0);
            let convolution =
                |part: &str, channels| Convolution::new(instructions, weights, &format!("{name}.{part}"), channels, 1);
            Head {
                conv1: convolution("conv1", stored_channels),
                conv2: convolution("conv2", narrow.next_multiple_of(LANES)),
                out: Linear::spread(instructions, &matrix, 2, own, matrix.inputs, Some),
                channels: [narrow, matrix.inputs],
            }
        };
        Self {
            instructions,
            channels,
            units: (0..levels).map(units).collect(),
            heads: [head(0, "depth"), head(1, "contact")],
        }
    }

    /// Returns memory for an input of some rows and columns, and for maps of some rows and columns each.
    pub(super) fn buffers(&self, size: [usize; 2], levels: Vec<[usize; 2]>) -> DecoderBuffers {
        let fused = levels.first().map_or([0, 0], |finest| finest.map(|side| 2 * side));
        let levels: Vec<FeatureMap> = levels.into_iter().map(|size| FeatureMap::framed(size, self.channels)).collect();
        let [narrow, features] = self.heads[0].channels;
        DecoderBuffers {
            between: levels.clone(),
            levels,
            fused: FeatureMap::framed(fused, self.channels),
            narrow: FeatureMap::framed(fused, narrow),
            wide: FeatureMap::framed(size, narrow),
            features: FeatureMap::tokens(size, 0, features),
            output: FeatureMap::tokens(size, 0, 2),
        }
    }

    /// Computes the output from the maps of all levels.
    pub(super) fn forward(&self, buffers: &mut DecoderBuffers, words: &mut Vec<u32>) {
        let DecoderBuffers { levels, between, fused, narrow, wide, features, output, .. } = buffers;
        for (k, [unit1, unit2]) in self.units.iter().enumerate().rev() {
            let (finer, coarser) = levels.split_at_mut(k + 1);
            unit1.apply(words, &mut between[k], &mut finer[k]);
            if let Some(coarser) = coarser.first() {
                resample(self.instructions, coarser, true, &mut finer[k]);
            }
            unit2.apply(words, &mut between[k], &mut finer[k]);
        }
        if let Some(finest) = levels.first() {
            resample(self.instructions, finest, false, fused);
        }
        for (head, then) in self.heads.iter().zip([Then::Store, Then::Add]) {
            head.conv1.apply(fused, false, Then::Store, words, narrow);
            resample(self.instructions, narrow, false, wide);
            head.conv2.apply(wide, false, Then::Relu, words, features);
            head.out.apply(features, then, words, output);
        }
    }
}
