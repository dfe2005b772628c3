//! Decoder of DPT: tokens of some blocks become maps, which are joined from the coarsest to the finest, and two heads.

use super::image::resample;
use super::layers::{Convolution, Linear, Matrix, Unit, Up};
use super::map::FeatureMap;
use crate::network::Weights;
use mvt_products::Instructions;
use mvt_products::multiply::{LANES, Then};

/// Decoder with packed weights.
#[derive(Debug)]
pub(super) struct Dpt {
    instructions: Instructions,
    /// Channels of a token.
    width: usize,
    /// Channels of a token with those that fill the last vector.
    stored: usize,
    channels: usize,
    patch: usize,
    /// Shallow first.
    levels: Vec<Level>,
    /// Depth, contact.
    heads: [Head; 2],
}

#[derive(Debug)]
struct Level {
    read: Linear,
    project: Linear,
    resize: Resize,
    units: [Unit; 2],
}

/// Resizing of a map with one pixel per patch.
#[derive(Debug)]
enum Resize {
    Up(Up),
    Same,
    Down(Convolution),
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
    /// Every token with the class token beside it.
    pairs: FeatureMap,
    read: FeatureMap,
    /// One pixel per patch, framed.
    projected: FeatureMap,
    levels: Vec<FeatureMap>,
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
    pub(super) fn new(
        instructions: Instructions,
        weights: &Weights,
        width: usize,
        levels: usize,
        patch: usize,
    ) -> Self {
        let stored = width.next_multiple_of(LANES);
        let channels = weights.values("reassemble.0.project.bias").len();
        let stored_channels = channels.next_multiple_of(LANES);
        let level = |k: usize| {
            let name = format!("reassemble.{k}");
            let matrix = Matrix::of(weights, &format!("{name}.read"));
            let pair = |n: usize| (n % stored < width).then_some(n / stored * width + n % stored);
            let unit = |part: &str| Unit::new(instructions, weights, &format!("fusion.{k}.{part}"), stored_channels);
            let resize = format!("{name}.resize");
            Level {
                read: Linear::spread(instructions, &matrix, width, Some, 2 * stored, pair),
                project: Linear::new(instructions, weights, &format!("{name}.project")),
                resize: match k {
                    0 | 1 => Resize::Up(Up::new(instructions, weights, &resize, 4 >> k)),
                    2 => Resize::Same,
                    _ => Resize::Down(Convolution::new(instructions, weights, &resize, stored_channels, 2)),
                },
                units: [unit("unit1"), unit("unit2")],
            }
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
            width,
            stored,
            channels,
            patch,
            levels: (0..levels).map(level).collect(),
            heads: [head(0, "depth"), head(1, "contact")],
        }
    }

    /// Returns memory for an input of some rows and columns and its tokens.
    pub(super) fn buffers(&self, size: [usize; 2], tokens: &FeatureMap) -> DecoderBuffers {
        let grid = [tokens.height, tokens.width];
        let level = |k: usize| {
            let side = |side: usize| if k == 3 { side.div_ceil(2) } else { side << (2 - k) };
            FeatureMap::framed(grid.map(side), self.channels)
        };
        let levels: Vec<FeatureMap> = (0..self.levels.len()).map(level).collect();
        // The finest level has four pixels per side of a patch.
        let fused = size.map(|side| side / self.patch * 8);
        let [narrow, features] = self.heads[0].channels;
        DecoderBuffers {
            pairs: FeatureMap::tokens(grid, 0, 2 * self.stored),
            read: FeatureMap::tokens(grid, 0, self.width),
            projected: FeatureMap::framed(grid, self.channels),
            between: levels.clone(),
            levels,
            fused: FeatureMap::framed(fused, self.channels),
            narrow: FeatureMap::framed(fused, narrow),
            wide: FeatureMap::framed(size, narrow),
            features: FeatureMap::tokens(size, 0, features),
            output: FeatureMap::tokens(size, 0, 2),
        }
    }

    /// Computes the map of a level from the tokens of its block.
    pub(super) fn reassemble(
        &self,
        level: usize,
        tokens: &FeatureMap,
        buffers: &mut DecoderBuffers,
        words: &mut Vec<u32>,
    ) {
        let DecoderBuffers { pairs, read, projected, levels, .. } = buffers;
        let (Some(layers), Some(map)) = (self.levels.get(level), levels.get_mut(level)) else { return };
        let mut all = tokens.data.chunks_exact(self.stored);
        if let Some(class) = all.next_back() {
            for (pair, token) in pairs.data.chunks_exact_mut(2 * self.stored).zip(all) {
                let (first, second) = pair.split_at_mut(self.stored);
                first.copy_from_slice(token);
                second.copy_from_slice(class);
            }
        }
        layers.read.apply(pairs, Then::Gelu, words, read);
        match &layers.resize {
            Resize::Same => layers.project.apply(read, Then::Store, words, map),
            Resize::Up(up) => {
                layers.project.apply(read, Then::Store, words, projected);
                up.apply(projected, Then::Store, words, map);
            }
            Resize::Down(down) => {
                layers.project.apply(read, Then::Store, words, projected);
                down.apply(projected, false, Then::Store, words, map);
            }
        }
    }

    /// Computes the output from the maps of all levels.
    pub(super) fn forward(&self, buffers: &mut DecoderBuffers, words: &mut Vec<u32>) {
        let DecoderBuffers { levels, between, fused, narrow, wide, features, output, .. } = buffers;
        for k in (0..self.levels.len()).rev() {
            let [unit1, unit2] = &self.levels[k].units;
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
