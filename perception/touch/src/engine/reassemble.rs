//! Maps for the decoder from the tokens of some blocks.

use super::dpt::Dpt;
use super::layers::{Convolution, Linear, Matrix, Up};
use super::map::FeatureMap;
use crate::network::Weights;
use mvt_products::Instructions;
use mvt_products::multiply::{LANES, Then};

/// Layers that turn the tokens of a block into a map.
#[derive(Debug)]
pub(super) struct Reassemble {
    read: Linear,
    project: Linear,
    resize: Resize,
}

/// Resizing of a map with one pixel per patch.
#[derive(Debug)]
enum Resize {
    Up(Up),
    Same,
    Down(Convolution),
}

/// Memory for any of the maps.
#[derive(Debug)]
pub(super) struct ReassembleBuffers {
    /// Every token with the class token beside it.
    pairs: FeatureMap,
    read: FeatureMap,
    /// One pixel per patch, framed.
    projected: FeatureMap,
}

impl ReassembleBuffers {
    pub(super) fn new(tokens: &FeatureMap, width: usize, decoder: &Dpt) -> Self {
        let grid = [tokens.height, tokens.width];
        Self {
            pairs: FeatureMap::tokens(grid, 0, 2 * tokens.channels),
            read: FeatureMap::tokens(grid, 0, width),
            projected: FeatureMap::framed(grid, decoder.channels),
        }
    }
}

/// Returns rows and columns of the map of a level.
pub(super) fn level(k: usize, tokens: &FeatureMap) -> [usize; 2] {
    [tokens.height, tokens.width].map(|side| if k == 3 { side.div_ceil(2) } else { side << (2 - k) })
}

impl Reassemble {
    pub(super) fn new(instructions: Instructions, weights: &Weights, width: usize, k: usize) -> Self {
        let name = format!("reassemble.{k}");
        let matrix = Matrix::of(weights, &format!("{name}.read"));
        let stored = width.next_multiple_of(LANES);
        let pair = |n: usize| (n % stored < width).then_some(n / stored * width + n % stored);
        let channels = weights.values(&format!("{name}.project.bias")).len().next_multiple_of(LANES);
        let resize = format!("{name}.resize");
        Self {
            read: Linear::spread(instructions, &matrix, width, Some, 2 * stored, pair),
            project: Linear::new(instructions, weights, &format!("{name}.project")),
            resize: match k {
                0 | 1 => Resize::Up(Up::new(instructions, weights, &resize, 4 >> k)),
                2 => Resize::Same,
                _ => Resize::Down(Convolution::new(instructions, weights, &resize, channels, 2)),
            },
        }
    }

    /// Computes the map of a level from the tokens of its block.
    pub(super) fn apply(
        &self,
        tokens: &FeatureMap,
        buffers: &mut ReassembleBuffers,
        words: &mut Vec<u32>,
        map: &mut FeatureMap,
    ) {
        let ReassembleBuffers { pairs, read, projected } = buffers;
        let stored = tokens.channels;
        let mut all = tokens.data.chunks_exact(stored);
        if let Some(class) = all.next_back() {
            for (pair, token) in pairs.data.chunks_exact_mut(2 * stored).zip(all) {
                let (first, second) = pair.split_at_mut(stored);
                first.copy_from_slice(token);
                second.copy_from_slice(class);
            }
        }
        self.read.apply(pairs, Then::Gelu, words, read);
        match &self.resize {
            Resize::Same => self.project.apply(read, Then::Store, words, map),
            Resize::Up(up) => {
                self.project.apply(read, Then::Store, words, projected);
                up.apply(projected, Then::Store, words, map);
            }
            Resize::Down(down) => {
                self.project.apply(read, Then::Store, words, projected);
                down.apply(projected, false, Then::Store, words, map);
            }
        }
    }
}
