//! Forward passes of `swin` and `convnext`: four stages of blocks, each at half the size of the stage before, and the decoder.

use ::image::RgbImage;

use super::attention::{Attention, AttentionBuffers};
use super::dpt::{DecoderBuffers, Dpt};
use super::image::{load, store};
use super::layers::{Embedding, Linear, Mlp, Norm};
use super::map::FeatureMap;
use super::pass::{Forward, Prediction};
use crate::network::{ConvNext, ShiftedWindows, Swin, Weights, squares};
use mvt_products::Instructions;
use mvt_products::depthwise::Depthwise;
use mvt_products::multiply::{LANES, Then};

/// Side of a patch, pixels.
const PATCH: usize = 4;

/// Network of stages with packed weights.
#[derive(Debug)]
pub(super) struct Hierarchy {
    embedding: Embedding,
    norm: Norm,
    stages: Vec<Stage>,
    decoder: Dpt,
}

#[derive(Debug)]
struct Stage {
    width: usize,
    /// All but the first stage begin with it.
    down: Option<Down>,
    blocks: Vec<Block>,
    /// To the map of the decoder.
    norm: Norm,
    project: Linear,
}

/// Joins squares of 2 x 2 tokens.
#[derive(Debug)]
struct Down {
    norm: Norm,
    linear: Linear,
    /// Whether squares are joined before they are normalised.
    is_joined_first: bool,
}

/// Block of a stage.
#[derive(Debug)]
pub(super) enum Block {
    Swin { norm1: Norm, attention: Box<Attention>, window: usize, is_shifted: bool, norm2: Norm, mlp: Mlp },
    ConvNext { depthwise: Depthwise, norm: Norm, mlp: Mlp },
}

/// Memory of the blocks of a stage.
#[derive(Debug)]
pub(super) struct BlockBuffers {
    normed: FeatureMap,
    hidden: FeatureMap,
    /// Tokens in a frame, for convolutions.
    framed: FeatureMap,
    /// Unshifted and shifted.
    windows: [Places; 2],
    attention: Option<AttentionBuffers>,
    /// Tokens window by window, and their result.
    windowed: [FeatureMap; 2],
}

/// Tokens of windows, and their regions in rows that fill vectors.
#[derive(Debug, Default)]
struct Places {
    tokens: Vec<Option<usize>>,
    regions: Vec<f32>,
}

impl Places {
    fn new(size: [usize; 2], window: usize, is_shifted: bool) -> Self {
        let ShiftedWindows { tokens, regions } = ShiftedWindows::new(size, window, is_shifted);
        let count = window * window;
        let filled = regions.chunks_exact(count).flat_map(|regions| {
            let regions = regions.iter().map(|&region| f32::from(region));
            regions.chain(std::iter::repeat_n(0.0, count.next_multiple_of(LANES) - count))
        });
        Self { tokens, regions: filled.collect() }
    }
}

impl Block {
    pub(super) fn swin(
        instructions: Instructions,
        weights: &Weights,
        name: &str,
        [heads, window]: [usize; 2],
        is_shifted: bool,
    ) -> Self {
        let norm = |part: &str| Norm::new(instructions, weights, &format!("{name}.{part}"));
        Self::Swin {
            norm1: norm("norm1"),
            attention: Box::new(Attention::windowed(instructions, weights, &format!("{name}.attn"), heads, window)),
            window,
            is_shifted,
            norm2: norm("norm2"),
            mlp: Mlp::new(instructions, weights, &format!("{name}.mlp"), &[]),
        }
    }

    pub(super) fn convnext(instructions: Instructions, weights: &Weights, name: &str) -> Self {
        let values = |part: &str| weights.values(&format!("{name}.{part}"));
        let (kernels, bias) = (values("depthwise.weight"), values("depthwise.bias"));
        let side = (kernels.len() / bias.len().max(1)).isqrt();
        Self::ConvNext {
            depthwise: Depthwise::new(instructions, side, kernels, bias),
            norm: Norm::new(instructions, weights, &format!("{name}.norm")),
            mlp: Mlp::new(instructions, weights, &format!("{name}.mlp"), values("scale")),
        }
    }

    /// Returns memory for this block and others of its stage.
    pub(super) fn buffers(&self, tokens: &FeatureMap) -> BlockBuffers {
        let size = [tokens.height, tokens.width];
        let (Self::Swin { mlp, .. } | Self::ConvNext { mlp, .. }) = self;
        let mut buffers = BlockBuffers {
            normed: tokens.clone(),
            hidden: FeatureMap::tokens(size, 0, mlp.hidden),
            framed: FeatureMap::default(),
            windows: Default::default(),
            attention: None,
            windowed: Default::default(),
        };
        match self {
            Self::Swin { attention, window, .. } => {
                buffers.windows = [false, true].map(|is_shifted| Places::new(size, *window, is_shifted));
                let count = window * window;
                let windows = buffers.windows[0].tokens.len() / count;
                buffers.attention = Some(attention.buffers(count, windows));
                buffers.windowed = [0, 1].map(|_| FeatureMap::tokens([windows, count], 0, tokens.channels));
            }
            Self::ConvNext { depthwise, .. } => {
                buffers.framed = FeatureMap::with_halo(size, depthwise.side() / 2, tokens.channels);
            }
        }
        buffers
    }

    /// Changes the tokens in place.
    pub(super) fn apply(&self, buffers: &mut BlockBuffers, words: &mut Vec<u32>, tokens: &mut FeatureMap) {
        let BlockBuffers { normed, hidden, framed, windows, attention: inner, windowed: [windowed, mixed] } = buffers;
        match self {
            Self::Swin { norm1, attention, is_shifted, norm2, mlp, .. } => {
                let places = &windows[usize::from(*is_shifted)];
                norm1.apply(tokens, normed);
                windowed.gather(normed, normed.channels, &places.tokens);
                if let Some(inner) = inner {
                    attention.apply(windowed, &places.regions, inner, Then::Store, words, mixed);
                }
                tokens.scatter_add(mixed, &places.tokens);
                norm2.apply(tokens, normed);
                mlp.apply(normed, hidden, words, tokens);
            }
            Self::ConvNext { depthwise, norm, mlp } => {
                framed.copy_rows(tokens);
                depthwise.apply([tokens.height, tokens.width], &framed.data, &mut normed.data);
                norm.apply_in_place(normed);
                mlp.apply(normed, hidden, words, tokens);
            }
        }
    }
}

/// Memory of a stage.
#[derive(Debug)]
struct StageBuffers {
    tokens: FeatureMap,
    /// Tokens of the stage before, square by square.
    squares: Vec<Option<usize>>,
    joined: FeatureMap,
    block: BlockBuffers,
}

/// Memory of the forward pass.
#[derive(Debug)]
pub(super) struct HierarchyBuffers {
    input: FeatureMap,
    stages: Vec<StageBuffers>,
    decoder: DecoderBuffers,
}

/// Returns an input of three colours.
fn input(size: [usize; 2]) -> FeatureMap {
    FeatureMap::image(size, 4, 0)
}

impl Hierarchy {
    pub(super) fn swin(instructions: Instructions, swin: &Swin, weights: &Weights) -> Self {
        let &Swin { widths, depths, heads, window, .. } = swin;
        Self::new(instructions, weights, [widths, depths], true, |name, k, b| {
            Block::swin(instructions, weights, name, [heads[k], window], b % 2 == 1)
        })
    }

    pub(super) fn convnext(instructions: Instructions, convnext: &ConvNext, weights: &Weights) -> Self {
        let &ConvNext { widths, depths, .. } = convnext;
        Self::new(instructions, weights, [widths, depths], false, |name, _, _| {
            Block::convnext(instructions, weights, name)
        })
    }

    /// Packs stages; `block` packs the block of a name, a stage and its number in it.
    fn new(
        instructions: Instructions,
        weights: &Weights,
        [widths, depths]: [[usize; 4]; 2],
        is_joined_first: bool,
        block: impl Fn(&str, usize, usize) -> Block,
    ) -> Self {
        let norm = |name: &str| Norm::new(instructions, weights, name);
        let linear = |name: &str| Linear::new(instructions, weights, name);
        let stage = |k: usize| Stage {
            width: widths[k],
            down: (k > 0).then(|| Down {
                norm: norm(&format!("stages.{k}.down.norm")),
                linear: linear(&format!("stages.{k}.down.linear")),
                is_joined_first,
            }),
            blocks: (0..depths[k]).map(|b| block(&format!("stages.{k}.blocks.{b}"), k, b)).collect(),
            norm: norm(&format!("reassemble.{k}.norm")),
            project: linear(&format!("reassemble.{k}.project")),
        };
        Self {
            embedding: Embedding::new(instructions, weights, PATCH, input([0, 0]).channels),
            norm: norm("norm"),
            stages: (0..4).map(stage).collect(),
            decoder: Dpt::new(instructions, weights, 4),
        }
    }
}

impl Forward for Hierarchy {
    type Buffers = HierarchyBuffers;

    fn buffers(&self, size: [usize; 2]) -> HierarchyBuffers {
        let mut grid = size.map(|side| side / PATCH);
        let (mut stages, mut sizes, mut finer) = (Vec::new(), Vec::new(), 0);
        for stage in &self.stages {
            let squares = if stage.down.is_some() { squares(grid) } else { Vec::new() };
            if stage.down.is_some() {
                grid = grid.map(|side| side.div_ceil(2));
            }
            let tokens = FeatureMap::tokens(grid, 0, stage.width);
            // Every stage has a block: the check of the architecture refuses others.
            let Some(block) = stage.blocks.first().map(|block| block.buffers(&tokens)) else { break };
            stages.push(StageBuffers { block, squares, joined: FeatureMap::tokens(grid, 0, 4 * finer), tokens });
            sizes.push(grid);
            finer = stage.width;
        }
        HierarchyBuffers { input: input(size), stages, decoder: self.decoder.buffers(size, sizes) }
    }

    fn forward(&self, image: &RgbImage, buffers: &mut HierarchyBuffers, words: &mut Vec<u32>, to: &mut Prediction) {
        let HierarchyBuffers { input, stages, decoder } = buffers;
        load(image, input);
        if let Some(StageBuffers { tokens, .. }) = stages.first_mut() {
            self.embedding.apply(input, Then::Store, words, tokens);
            self.norm.apply_in_place(tokens);
        }
        for (k, (stage, map)) in self.stages.iter().zip(&mut decoder.levels).enumerate() {
            let (before, rest) = stages.split_at_mut(k);
            let Some(StageBuffers { tokens, squares, joined, block }) = rest.first_mut() else { break };
            if let (Some(Down { norm, linear, is_joined_first }), Some(finer), Some(width)) =
                (&stage.down, before.last_mut(), k.checked_sub(1).map(|k| self.stages[k].width))
            {
                if *is_joined_first {
                    joined.gather(&finer.tokens, width, squares);
                    norm.apply_in_place(joined);
                } else {
                    norm.apply(&finer.tokens, &mut finer.block.normed);
                    joined.gather(&finer.block.normed, width, squares);
                }
                linear.apply(joined, Then::Store, words, tokens);
            }
            for layer in &stage.blocks {
                layer.apply(block, words, tokens);
            }
            stage.norm.apply(tokens, &mut block.normed);
            stage.project.apply(&block.normed, Then::Store, words, map);
        }
        self.decoder.forward(decoder, words);
        store::<1>(&decoder.output, to);
    }
}
