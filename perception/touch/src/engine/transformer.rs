//! Forward passes of `vit`, `mamba` and `robust_mamba`: patches as tokens, blocks, and their common decoder.

use ::image::RgbImage;

use super::attention::{Attention, AttentionBuffers};
use super::dpt::{DecoderBuffers, Dpt};
use super::image::{half_pixel, load, store};
use super::layers::{Embedding, Mlp, Norm};
use super::mamba::{self, Mamba, MambaBuffers};
use super::map::FeatureMap;
use super::pass::{Forward, Prediction};
use super::reassemble::{Reassemble, ReassembleBuffers, level};
use crate::network::{self, Architecture, ScanOrder, Weights};
use mvt_products::Instructions;
use mvt_products::multiply::Then;

/// Network of tokens with packed weights.
#[derive(Debug)]
pub(super) struct Transformer {
    patch: usize,
    width: usize,
    embedding: Embedding,
    positions: Positions,
    class: Vec<f32>,
    blocks: Vec<Block>,
    hooks: Vec<usize>,
    /// One per hook.
    levels: Vec<Reassemble>,
    decoder: Dpt,
}

/// Numbers that tell a token its position.
#[derive(Debug)]
enum Positions {
    /// Learned on a grid of `size` rows and columns.
    Learned { size: [usize; 2], values: Vec<f32> },
    /// Sines and cosines of row and column.
    Fixed,
}

#[derive(Debug)]
enum Block {
    Vit { norm1: Norm, attention: Attention, norm2: Norm, mlp: Mlp },
    Mamba { norm: Norm, mamba: Mamba, scan: ScanOrder },
    RobustMamba { norm1: Norm, mamba: Box<Mamba>, scan: ScanOrder, norm2: Norm, mlp: Mlp },
}

/// Memory of the forward pass.
#[derive(Debug)]
pub(super) struct TransformerBuffers {
    input: FeatureMap,
    /// Initial tokens, to which patches are added: positions, and the class token.
    start: FeatureMap,
    tokens: FeatureMap,
    normed: FeatureMap,
    hidden: FeatureMap,
    attention: Option<AttentionBuffers>,
    mamba: MambaBuffers,
    /// One per block that scans.
    orders: Vec<Vec<u32>>,
    reassemble: ReassembleBuffers,
    decoder: DecoderBuffers,
}

impl Transformer {
    /// Packs `vit`, `mamba` or `robust_mamba`.
    pub(super) fn new(instructions: Instructions, architecture: &Architecture, weights: &Weights) -> Self {
        let norm = |name: String| Norm::new(instructions, weights, &name);
        let mamba = |name: String| Mamba::new(instructions, weights, &name);
        let mlp = |name: String| Mlp::new(instructions, weights, &name, &[]);
        let learned = |size| Positions::Learned { size, values: weights.values("positions").to_vec() };
        let turn =
            |scans: &[ScanOrder], k: usize| scans.get(k % scans.len().max(1)).copied().unwrap_or(ScanOrder::Rows);
        let (positions, blocks, hooks) = match architecture {
            Architecture::Vit(network::Vit { depth, heads, positions, hooks, .. }) => {
                let block = |k| Block::Vit {
                    norm1: norm(format!("blocks.{k}.norm1")),
                    attention: Attention::new(instructions, weights, &format!("blocks.{k}.attn"), *heads),
                    norm2: norm(format!("blocks.{k}.norm2")),
                    mlp: mlp(format!("blocks.{k}.mlp")),
                };
                (learned(*positions), (0..*depth).map(block).collect(), hooks.clone())
            }
            Architecture::Mamba(network::Mamba { depth, scans, positions, hooks, .. }) => {
                let block = |k| Block::Mamba {
                    norm: norm(format!("blocks.{k}.norm")),
                    mamba: mamba(format!("blocks.{k}.mamba")),
                    scan: turn(scans, k),
                };
                (learned(*positions), (0..*depth).map(block).collect(), hooks.clone())
            }
            Architecture::RobustMamba(network::RobustMamba { depth, scans, hooks, .. }) => {
                let block = |k| Block::RobustMamba {
                    norm1: norm(format!("blocks.{k}.norm1")),
                    mamba: Box::new(mamba(format!("blocks.{k}.mamba"))),
                    scan: turn(scans, k),
                    norm2: norm(format!("blocks.{k}.norm2")),
                    mlp: mlp(format!("blocks.{k}.mlp")),
                };
                (Positions::Fixed, (0..*depth).map(block).collect(), hooks.clone())
            }
            Architecture::Swin(_) | Architecture::ConvNext(_) | Architecture::Default(_) => {
                (Positions::Fixed, Vec::new(), Vec::new())
            }
        };
        let patch = architecture.stride();
        let width = weights.values("patch.bias").len();
        let level = |k| Reassemble::new(instructions, weights, width, k);
        Self {
            patch,
            width,
            embedding: Embedding::new(instructions, weights, patch, image([0, 0]).channels),
            positions,
            class: weights.values("class").to_vec(),
            blocks,
            levels: (0..hooks.len()).map(level).collect(),
            decoder: Dpt::new(instructions, weights, hooks.len()),
            hooks,
        }
    }

    /// Fills in positions, and the class token behind them.
    fn start(&self, mut tokens: FeatureMap) -> FeatureMap {
        let Self { width, positions, class, .. } = self;
        let [height, columns] = [tokens.height, tokens.width];
        for row in 0..height {
            for column in 0..columns {
                let at = tokens.at(row, column);
                let to = &mut tokens.data[at..][..*width];
                match positions {
                    Positions::Learned { size, values } => {
                        let (above, below, down) = half_pixel(row, size[0], height);
                        let (left, right, along) = half_pixel(column, size[1], columns);
                        for (k, to) in to.iter_mut().enumerate() {
                            let value = |row, column| values[(row * size[1] + column) * width + k];
                            let across = |row| value(row, left) + along * (value(row, right) - value(row, left));
                            *to = across(above) + down * (across(below) - across(above));
                        }
                    }
                    Positions::Fixed => {
                        let quarter = width / 4;
                        for (k, to) in to.iter_mut().enumerate() {
                            let place = if k < 2 * quarter { row } else { column } as f32;
                            let angle = place * 10_000_f32.powf(-((k % quarter) as f32) / quarter as f32);
                            *to = if k / quarter % 2 == 0 { angle.sin() } else { angle.cos() };
                        }
                    }
                }
            }
        }
        let at = height * columns * tokens.channels;
        tokens.data[at..][..*width].copy_from_slice(class);
        tokens
    }
}

/// Returns an input of three colours.
fn image(size: [usize; 2]) -> FeatureMap {
    FeatureMap::image(size, 4, 0)
}

impl Forward for Transformer {
    type Buffers = TransformerBuffers;

    fn buffers(&self, size: [usize; 2]) -> TransformerBuffers {
        let tokens = FeatureMap::tokens(size.map(|side| side / self.patch), 1, self.width);
        let mut buffers = TransformerBuffers {
            input: image(size),
            start: self.start(tokens.clone()),
            normed: tokens.clone(),
            hidden: FeatureMap::default(),
            attention: None,
            mamba: MambaBuffers::default(),
            orders: Vec::new(),
            reassemble: ReassembleBuffers::new(&tokens, self.width, &self.decoder),
            decoder: self.decoder.buffers(size, (0..self.hooks.len()).map(|k| level(k, &tokens)).collect()),
            tokens,
        };
        let tokens = &buffers.tokens;
        let hidden = |mlp: &Mlp| FeatureMap::tokens([tokens.height, tokens.width], 1, mlp.hidden);
        for block in &self.blocks {
            match block {
                Block::Vit { attention, mlp, .. } => {
                    buffers.attention.get_or_insert_with(|| attention.buffers(tokens.count(), 1));
                    buffers.hidden = hidden(mlp);
                }
                Block::Mamba { mamba, scan, .. } => {
                    buffers.mamba = mamba.buffers(tokens);
                    buffers.orders.push(mamba::order(*scan, tokens));
                }
                Block::RobustMamba { mamba, scan, mlp, .. } => {
                    buffers.mamba = mamba.buffers(tokens);
                    buffers.orders.push(mamba::order(*scan, tokens));
                    buffers.hidden = hidden(mlp);
                }
            }
        }
        buffers
    }

    fn forward(&self, image: &RgbImage, buffers: &mut TransformerBuffers, words: &mut Vec<u32>, to: &mut Prediction) {
        let TransformerBuffers {
            input,
            start,
            tokens,
            normed,
            hidden,
            attention,
            mamba: inner,
            orders,
            reassemble,
            decoder,
        } = buffers;
        load(image, input);
        tokens.data.copy_from_slice(&start.data);
        self.embedding.apply(input, Then::Add, words, tokens);
        let mut orders = orders.iter();
        for (k, block) in self.blocks.iter().enumerate() {
            match block {
                Block::Vit { norm1, attention: layer, norm2, mlp } => {
                    norm1.apply(tokens, normed);
                    if let Some(buffers) = attention {
                        layer.apply(normed, &[], buffers, Then::Add, words, tokens);
                    }
                    norm2.apply(tokens, normed);
                    mlp.apply(normed, hidden, words, tokens);
                }
                Block::Mamba { norm, mamba, .. } => {
                    norm.apply(tokens, normed);
                    mamba.apply(normed, orders.next().map_or(&[], Vec::as_slice), Then::Add, inner, words, tokens);
                }
                Block::RobustMamba { norm1, mamba, norm2, mlp, .. } => {
                    norm1.apply(tokens, normed);
                    let order = orders.next().map_or(&[][..], Vec::as_slice);
                    // The result replaces the input of the block, which is not read again.
                    mamba.apply_in_place(normed, order, inner, words);
                    norm2.apply_in_place(normed);
                    mlp.apply(normed, hidden, words, tokens);
                }
            }
            let levels = self.hooks.iter().zip(&self.levels).zip(&mut decoder.levels);
            for ((_, layers), map) in levels.filter(|((hook, _), _)| **hook == k) {
                layers.apply(tokens, reassemble, words, map);
            }
        }
        self.decoder.forward(decoder, words);
        store::<1>(&decoder.output, to);
    }
}
