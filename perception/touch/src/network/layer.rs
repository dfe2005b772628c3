//! A network as a list of layers, from which tensors and counts are derived.

use super::architecture::{Architecture, Mamba, Pyramid, RobustMamba, Vit};

/// Added to the variance in a layer norm.
pub const LAYER_NORM_EPS: f32 = 1e-5;
/// Channels of `default`'s input: red, green, blue, x, y.
const INPUTS: usize = 5;

/// One layer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NetworkLayer {
    /// What the names of its tensors start with.
    pub name: String,
    /// What it does.
    pub op: Op,
    /// Where its results are.
    pub grid: Grid,
}

/// What a layer does; see the module's description.
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
        /// States of each of them.
        state: usize,
        /// Taps of the causal convolution.
        taps: usize,
        /// Channels from which the step sizes are made.
        rank: usize,
    },
    /// Attention without its linear maps.
    Attention {
        /// Channels of queries, keys and values each.
        width: usize,
    },
    /// Learned numbers that are added to tokens or are tokens.
    Table {
        /// How many.
        rows: usize,
        /// Channels.
        width: usize,
    },
}

/// Where a layer's results are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grid {
    /// A map whose sides are the input's divided by this, rounded up.
    Map(usize),
    /// A token per patch of this side, and one for the whole image.
    Tokens(usize),
    /// Nowhere: numbers that are the same for every image.
    Once,
}

impl Grid {
    /// Pixels or tokens for an input of `[height, width]`.
    pub fn count(self, [height, width]: [usize; 2]) -> usize {
        match self {
            Self::Map(divisor) => height.div_ceil(divisor) * width.div_ceil(divisor),
            Self::Tokens(patch) => (height / patch) * (width / patch) + 1,
            Self::Once => 0,
        }
    }
}

impl NetworkLayer {
    /// Names and shapes of its tensors.
    pub fn tensors(&self) -> Vec<(String, Vec<usize>)> {
        let named = |part: &str, shape: &[usize]| (format!("{}.{part}", self.name), shape.to_vec());
        match self.op {
            Op::Linear { inputs, outputs } => vec![named("weight", &[outputs, inputs]), named("bias", &[outputs])],
            Op::Convolution { inputs, outputs } => {
                vec![named("weight", &[outputs, inputs, 3, 3]), named("bias", &[outputs])]
            }
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
            Op::Attention { .. } => vec![],
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

    fn embedding(&mut self, patch: usize, width: usize, positions: Option<[usize; 2]>) {
        self.linear("patch", 3 * patch * patch, width, Grid::Map(patch));
        if let Some([rows, columns]) = positions {
            self.push("positions", Op::Table { rows: rows * columns, width }, Grid::Once);
        }
        self.push("class", Op::Table { rows: 1, width }, Grid::Once);
    }

    fn dpt(&mut self, patch: usize, width: usize, levels: usize, channels: usize) {
        let maps = Grid::Map(patch);
        let level = |k: usize| Grid::Map(if k == 3 { 2 * patch } else { patch >> (2 - k) });
        for k in 0..levels {
            let name = format!("reassemble.{k}");
            self.linear(format!("{name}.read"), 2 * width, width, maps);
            self.linear(format!("{name}.project"), width, channels, maps);
            match k {
                0 | 1 => self.linear(format!("{name}.resize"), channels, channels << (4 - 2 * k), maps),
                2 => {}
                _ => self.convolution(format!("{name}.resize"), channels, channels, level(3)),
            }
        }
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

impl Architecture {
    /// Its layers in the order in which they run.
    pub fn layers(&self) -> Vec<NetworkLayer> {
        let mut list = List::default();
        match self {
            Self::Default(pyramid) => list.pyramid(pyramid),
            Self::Vit(Vit { patch, width, depth, mlp, positions, hooks, channels, .. }) => {
                list.embedding(*patch, *width, Some(*positions));
                let grid = Grid::Tokens(*patch);
                for k in 0..*depth {
                    list.norm(format!("blocks.{k}.norm1"), *width, grid);
                    list.linear(format!("blocks.{k}.attn.qkv"), *width, 3 * width, grid);
                    list.push(format!("blocks.{k}.attn"), Op::Attention { width: *width }, grid);
                    list.linear(format!("blocks.{k}.attn.proj"), *width, *width, grid);
                    list.norm(format!("blocks.{k}.norm2"), *width, grid);
                    list.mlp(&format!("blocks.{k}.mlp"), *width, mlp * width, grid);
                }
                list.dpt(*patch, *width, hooks.len(), *channels);
            }
            Self::Mamba(Mamba { patch, width, depth, state, expand, taps, positions, hooks, channels, .. }) => {
                list.embedding(*patch, *width, Some(*positions));
                let grid = Grid::Tokens(*patch);
                for k in 0..*depth {
                    list.norm(format!("blocks.{k}.norm"), *width, grid);
                    list.mamba(format!("blocks.{k}.mamba"), [*width, *expand, *state, *taps], grid);
                }
                list.dpt(*patch, *width, hooks.len(), *channels);
            }
            Self::RobustMamba(RobustMamba {
                patch, width, depth, state, expand, taps, mlp, hooks, channels, ..
            }) => {
                list.embedding(*patch, *width, None);
                let grid = Grid::Tokens(*patch);
                for k in 0..*depth {
                    list.norm(format!("blocks.{k}.norm1"), *width, grid);
                    list.mamba(format!("blocks.{k}.mamba"), [*width, *expand, *state, *taps], grid);
                    list.norm(format!("blocks.{k}.norm2"), *width, grid);
                    list.mlp(&format!("blocks.{k}.mlp"), *width, mlp * width, grid);
                }
                list.dpt(*patch, *width, hooks.len(), *channels);
            }
        }
        list.0
    }

    /// Names and shapes of all tensors of its weights, in the order of the layers.
    pub fn tensors(&self) -> Vec<(String, Vec<usize>)> {
        self.layers().iter().flat_map(NetworkLayer::tensors).collect()
    }
}
