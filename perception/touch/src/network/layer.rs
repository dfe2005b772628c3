//! Networks as lists of layers, from which tensors and counts follow.

use super::architecture::{Architecture, ConvNext, Mamba, Pyramid, RobustMamba, Swin, Vit};

/// Added to the variance in a layer norm.
pub const LAYER_NORM_EPS: f32 = 1e-5;
/// Side of the windows of `convnext`'s convolutions, pixels.
const DEPTHWISE_SIDE: usize = 7;
/// Channels of `default`'s input: red, green, blue, x, y.
const INPUTS: usize = 5;

/// Layer of a network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NetworkLayer {
    /// Prefix of the names of its tensors.
    pub name: String,
    /// Operation.
    pub op: Op,
    /// Places of its results.
    pub grid: Grid,
}

/// Operation of a layer; see the description of the module.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Op {
    /// Linear map of each pixel or token.
    Linear {
        /// Channels in.
        inputs: usize,
        /// Channels out.
        outputs: usize,
    },
    /// 3 x 3 convolution.
    Convolution {
        /// Channels in.
        inputs: usize,
        /// Channels out.
        outputs: usize,
    },
    /// Convolution of each channel by itself.
    Depthwise {
        /// Channels.
        width: usize,
        /// Side of the window, pixels.
        side: usize,
    },
    /// Multiplication of each channel by a learned number.
    Scale {
        /// Channels.
        width: usize,
    },
    /// Layer norm over the channels.
    Norm {
        /// Channels.
        width: usize,
    },
    /// Mamba without norm and residual.
    Mamba {
        /// Channels in and out.
        width: usize,
        /// Channels of the scan.
        inner: usize,
        /// States of each of those channels.
        state: usize,
        /// Taps of the causal convolution.
        taps: usize,
        /// Channels that lead to the step sizes.
        rank: usize,
    },
    /// Attention without its linear maps.
    Attention {
        /// Channels of queries, keys and values each.
        width: usize,
    },
    /// Attention within windows, without its linear maps.
    WindowAttention {
        /// Channels of queries, keys and values each.
        width: usize,
        /// Side of a window, tokens.
        window: usize,
    },
    /// Learned numbers that are added to tokens or to scores of attention, or are tokens.
    Table {
        /// Rows.
        rows: usize,
        /// Channels.
        width: usize,
    },
}

/// Places of a layer's results.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grid {
    /// Map with the sides of the input divided by this number, rounded up.
    Map(usize),
    /// One token per patch of this side, and one for the whole image.
    Tokens(usize),
    /// No place: numbers that are the same for every image.
    Once,
}

impl Grid {
    /// Returns the number of pixels or tokens for an input of `[height, width]`.
    pub fn count(self, [height, width]: [usize; 2]) -> usize {
        match self {
            Self::Map(divisor) => height.div_ceil(divisor) * width.div_ceil(divisor),
            Self::Tokens(patch) => (height / patch) * (width / patch) + 1,
            Self::Once => 0,
        }
    }
}

impl NetworkLayer {
    /// Returns names and shapes of the layer's tensors.
    pub fn tensors(&self) -> Vec<(String, Vec<usize>)> {
        let named = |part: &str, shape: &[usize]| (format!("{}.{part}", self.name), shape.to_vec());
        match self.op {
            Op::Linear { inputs, outputs } => vec![named("weight", &[outputs, inputs]), named("bias", &[outputs])],
            Op::Convolution { inputs, outputs } => {
                vec![named("weight", &[outputs, inputs, 3, 3]), named("bias", &[outputs])]
            }
            Op::Depthwise { width, side } => vec![named("weight", &[width, side, side]), named("bias", &[width])],
            Op::Scale { width } => vec![(self.name.clone(), vec![width])],
            Op::Norm { width } => vec![named("weight", &[width]), named("bias", &[width])],
            Op::Mamba { width, inner, state, taps, rank } => vec![
                named("in_proj.weight", &[2 * inner, width]),
                named("conv1d.weight", &[inner, taps]),
                named("conv1d.bias", &[inner]),
                named("x_proj.weight", &[rank + 2 * state, inner]),
                named("dt_proj.weight", &[inner, rank]),
                named("dt_proj.bias", &[inner]),
                named("A_log", &[inner, state]),
                named("D", &[inner]),
                named("out_proj.weight", &[width, inner]),
            ],
            Op::Attention { .. } | Op::WindowAttention { .. } => vec![],
            Op::Table { rows, width } => vec![(self.name.clone(), vec![rows, width])],
        }
    }
}

/// Collects layers.
#[derive(Default)]
struct List(Vec<NetworkLayer>);

impl List {
    fn push(&mut self, name: impl Into<String>, op: Op, grid: Grid) {
        self.0.push(NetworkLayer { name: name.into(), op, grid });
    }

    fn linear(&mut self, name: impl Into<String>, inputs: usize, outputs: usize, grid: Grid) {
        self.push(name, Op::Linear { inputs, outputs }, grid);
    }

    fn convolution(&mut self, name: impl Into<String>, inputs: usize, outputs: usize, grid: Grid) {
        self.push(name, Op::Convolution { inputs, outputs }, grid);
    }

    fn norm(&mut self, name: impl Into<String>, width: usize, grid: Grid) {
        self.push(name, Op::Norm { width }, grid);
    }

    fn unit(&mut self, name: &str, width: usize, grid: Grid) {
        self.convolution(format!("{name}.conv1"), width, width, grid);
        self.convolution(format!("{name}.conv2"), width, width, grid);
    }

    fn mamba(&mut self, name: String, [width, expand, state, taps]: [usize; 4], grid: Grid) {
        let op = Op::Mamba { width, inner: expand * width, state, taps, rank: width.div_ceil(16) };
        self.push(name, op, grid);
    }

    fn mlp(&mut self, name: &str, width: usize, hidden: usize, grid: Grid) {
        self.linear(format!("{name}.fc1"), width, hidden, grid);
        self.linear(format!("{name}.fc2"), hidden, width, grid);
    }

    fn pyramid(&mut self, Pyramid { widths, depth, state, expand, taps, .. }: &Pyramid) {
        let at = |level: usize| Grid::Map(2 << level);
        self.convolution("stem", INPUTS, widths[0], at(0));
        for k in 0..3 {
            self.convolution(format!("encoder.{k}.down"), widths[k], widths[k + 1], at(k + 1));
            if k < 2 {
                self.unit(&format!("encoder.{k}.unit"), widths[k + 1], at(k + 1));
            }
        }
        for k in 0..*depth {
            self.norm(format!("blocks.{k}.norm"), widths[3], at(3));
            self.mamba(format!("blocks.{k}.mamba"), [widths[3], *expand, *state, *taps], at(3));
        }
        self.norm("norm", widths[3], at(3));
        for k in 0..3 {
            let [from, to] = [3 - k, 2 - k];
            self.linear(format!("decoder.{k}.up"), widths[from], 4 * widths[to], at(from));
            self.unit(&format!("decoder.{k}.unit"), widths[to], at(to));
        }
        self.convolution("head", widths[0], 8, at(0));
    }

    /// A network of tokens; `block` adds the layers of a block.
    fn tokens(
        &mut self,
        [patch, width, depth, channels]: [usize; 4],
        positions: Option<[usize; 2]>,
        hooks: &[usize],
        block: impl Fn(&mut Self, &str, Grid),
    ) {
        self.linear("patch", 3 * patch * patch, width, Grid::Map(patch));
        if let Some([rows, columns]) = positions {
            self.push("positions", Op::Table { rows: rows * columns, width }, Grid::Once);
        }
        self.push("class", Op::Table { rows: 1, width }, Grid::Once);
        for k in 0..depth {
            block(self, &format!("blocks.{k}"), Grid::Tokens(patch));
        }
        self.dpt(patch, width, hooks.len(), channels);
    }

    fn dpt(&mut self, patch: usize, width: usize, levels: usize, channels: usize) {
        let maps = Grid::Map(patch);
        for k in 0..levels {
            let name = format!("reassemble.{k}");
            self.linear(format!("{name}.read"), 2 * width, width, maps);
            self.linear(format!("{name}.project"), width, channels, maps);
            match k {
                0 | 1 => self.linear(format!("{name}.resize"), channels, channels << (4 - 2 * k), maps),
                2 => {}
                _ => self.convolution(format!("{name}.resize"), channels, channels, Grid::Map(2 * patch)),
            }
        }
        self.fusion(patch, levels, channels);
    }

    /// The part of the decoder behind its maps; the third of four has a pixel per patch.
    fn fusion(&mut self, patch: usize, levels: usize, channels: usize) {
        let level = |k: usize| Grid::Map(if k == 3 { 2 * patch } else { patch >> (2 - k) });
        for k in (0..levels).rev() {
            self.unit(&format!("fusion.{k}.unit1"), channels, level(k));
            self.unit(&format!("fusion.{k}.unit2"), channels, level(k));
        }
        for head in ["depth", "contact"] {
            self.convolution(format!("{head}.conv1"), channels, channels.div_ceil(2), Grid::Map(patch / 8));
            self.convolution(format!("{head}.conv2"), channels.div_ceil(2), 32, Grid::Map(1));
            self.linear(format!("{head}.out"), 32, 1, Grid::Map(1));
        }
    }
}

/// Sizes of a pyramid with a decoder.
struct Stages {
    widths: [usize; 4],
    depths: [usize; 4],
    channels: usize,
    /// Whether squares of pixels are joined before they are normalised.
    is_joined_first: bool,
}

impl List {
    /// A network with maps at 1/4 to 1/32; `block` adds the layers of a block of a stage.
    fn stages(&mut self, stages: &Stages, block: impl Fn(&mut Self, &str, usize, Grid)) {
        let &Stages { widths, depths, channels, is_joined_first } = stages;
        let at = |k: usize| Grid::Map(4 << k);
        self.linear("patch", 3 * 4 * 4, widths[0], at(0));
        self.norm("norm", widths[0], at(0));
        for (k, depth) in depths.into_iter().enumerate() {
            if let Some(finer) = k.checked_sub(1) {
                let (width, grid) =
                    if is_joined_first { (4 * widths[finer], at(k)) } else { (widths[finer], at(finer)) };
                self.norm(format!("stages.{k}.down.norm"), width, grid);
                self.linear(format!("stages.{k}.down.linear"), 4 * widths[finer], widths[k], at(k));
            }
            for b in 0..depth {
                block(self, &format!("stages.{k}.blocks.{b}"), k, at(k));
            }
        }
        for k in 0..4 {
            self.norm(format!("reassemble.{k}.norm"), widths[k], at(k));
            self.linear(format!("reassemble.{k}.project"), widths[k], channels, at(k));
        }
        self.fusion(16, 4, channels);
    }
}

impl Architecture {
    /// Returns the layers in the order in which they run.
    pub fn layers(&self) -> Vec<NetworkLayer> {
        let mut list = List::default();
        match self {
            Self::Default(pyramid) => list.pyramid(pyramid),
            &Self::Vit(Vit { patch, width, depth, mlp, positions, ref hooks, channels, .. }) => {
                let table = Some(positions);
                list.tokens([patch, width, depth, channels], table, hooks, |list, block, grid| {
                    list.norm(format!("{block}.norm1"), width, grid);
                    list.linear(format!("{block}.attn.qkv"), width, 3 * width, grid);
                    list.push(format!("{block}.attn"), Op::Attention { width }, grid);
                    list.linear(format!("{block}.attn.proj"), width, width, grid);
                    list.norm(format!("{block}.norm2"), width, grid);
                    list.mlp(&format!("{block}.mlp"), width, mlp * width, grid);
                });
            }
            &Self::Mamba(Mamba {
                patch, width, depth, state, expand, taps, positions, ref hooks, channels, ..
            }) => {
                let table = Some(positions);
                list.tokens([patch, width, depth, channels], table, hooks, |list, block, grid| {
                    list.norm(format!("{block}.norm"), width, grid);
                    list.mamba(format!("{block}.mamba"), [width, expand, state, taps], grid);
                });
            }
            &Self::Swin(Swin { widths, depths, window, mlp, channels, heads }) => {
                let stages = Stages { widths, depths, channels, is_joined_first: true };
                list.stages(&stages, |list, block, k, grid| {
                    let width = widths[k];
                    let table = Op::Table { rows: (2 * window - 1) * (2 * window - 1), width: heads[k] };
                    list.norm(format!("{block}.norm1"), width, grid);
                    list.linear(format!("{block}.attn.qkv"), width, 3 * width, grid);
                    list.push(format!("{block}.attn.relative_position_bias_table"), table, Grid::Once);
                    list.push(format!("{block}.attn"), Op::WindowAttention { width, window }, grid);
                    list.linear(format!("{block}.attn.proj"), width, width, grid);
                    list.norm(format!("{block}.norm2"), width, grid);
                    list.mlp(&format!("{block}.mlp"), width, mlp * width, grid);
                });
            }
            &Self::ConvNext(ConvNext { widths, depths, mlp, channels }) => {
                let stages = Stages { widths, depths, channels, is_joined_first: false };
                list.stages(&stages, |list, block, k, grid| {
                    let width = widths[k];
                    let op = Op::Depthwise { width, side: DEPTHWISE_SIDE };
                    list.push(format!("{block}.depthwise"), op, grid);
                    list.norm(format!("{block}.norm"), width, grid);
                    list.mlp(&format!("{block}.mlp"), width, mlp * width, grid);
                    list.push(format!("{block}.scale"), Op::Scale { width }, grid);
                });
            }
            &Self::RobustMamba(RobustMamba {
                patch,
                width,
                depth,
                state,
                expand,
                taps,
                mlp,
                ref hooks,
                channels,
                ..
            }) => list.tokens([patch, width, depth, channels], None, hooks, |list, block, grid| {
                list.norm(format!("{block}.norm1"), width, grid);
                list.mamba(format!("{block}.mamba"), [width, expand, state, taps], grid);
                list.norm(format!("{block}.norm2"), width, grid);
                list.mlp(&format!("{block}.mlp"), width, mlp * width, grid);
            }),
        }
        list.0
    }

    /// Returns names and shapes of all tensors of the weights, in the order of the layers.
    pub fn tensors(&self) -> Vec<(String, Vec<usize>)> {
        self.layers().iter().flat_map(NetworkLayer::tensors).collect()
    }
}
