//! The forward pass of each network.

use std::collections::BTreeMap;
use std::sync::Arc;

use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::ops::Ops;
use super::resample::Resample;
use super::tokens::space_to_depth;
use crate::network::{Architecture, Layer, Mamba, Op, Pyramid, RobustMamba, Scan, Tensor, Vit};

/// Images that are put into a network together.
#[derive(Debug, Clone, Copy)]
pub struct Images<'a> {
    /// RGB of each pixel, image by image and row by row.
    pub levels: &'a [u8],
    /// Images, rows and columns.
    pub shape: [usize; 3],
}

/// A network whose tensors are values.
pub struct Model<'a, O: Ops> {
    /// Which network.
    pub architecture: &'a Architecture,
    /// What computes it.
    pub ops: &'a O,
    /// Its tensors by name.
    pub variables: &'a BTreeMap<&'a str, O::Value>,
}

impl<O: Ops> Model<'_, O> {
    /// Indentation in millimetres, which may be negative, and logit of contact, `[images, rows, columns, 2]`, of RGB images
    /// `[images, rows, columns, 3]` whose sides are multiples of the stride.
    pub fn forward(&self, images: Images<'_>) -> O::Value {
        let Images { levels, shape, .. } = images;
        match self.architecture {
            Architecture::Default(pyramid) => self.pyramid(pyramid, self.ops.constant(with_coordinates(images)), shape),
            Architecture::Vit(vit) => self.vit(vit, levels, shape),
            Architecture::Mamba(mamba) => self.mamba_network(mamba, levels, shape),
            Architecture::RobustMamba(robust) => self.robust_mamba(robust, levels, shape),
        }
    }

    /// A tensor. The table of tensors comes from the same architecture.
    fn get(&self, name: &str) -> O::Value {
        match self.variables.get(name) {
            Some(variable) => variable.clone(),
            None => unreachable!("network {} has no tensor {name}", self.architecture.name()),
        }
    }

    fn weight_and_bias(&self, name: &str) -> [O::Value; 2] {
        ["weight", "bias"].map(|part| self.get(&format!("{name}.{part}")))
    }

    fn linear(&self, name: &str, x: O::Value) -> O::Value {
        self.ops.linear(x, self.weight_and_bias(name))
    }

    fn norm(&self, name: &str, x: O::Value) -> O::Value {
        self.ops.norm(x, self.weight_and_bias(name))
    }

    fn convolution(&self, name: &str, x: O::Value, stride: usize, relu: bool) -> O::Value {
        self.ops.convolution(x, self.weight_and_bias(name), stride, relu)
    }

    /// `x + conv2(relu(conv1(relu(x))))`.
    fn unit(&self, name: &str, x: O::Value) -> O::Value {
        let inner = self.convolution(&format!("{name}.conv1"), x.clone(), 1, true);
        self.ops.add(x, self.convolution(&format!("{name}.conv2"), inner, 1, true))
    }

    /// A Mamba block without norm and residual, of tokens `[images, tokens, channels]`.
    fn mamba(&self, name: &str, x: O::Value, order: &Arc<[usize]>) -> O::Value {
        let xz = self.ops.product(x, self.get(&format!("{name}.in_proj.weight")));
        let parts = ["conv1d.weight", "conv1d.bias", "x_proj.weight", "dt_proj.weight", "dt_proj.bias", "A_log", "D"];
        let [taps, bias, projection, step, step_bias, a_log, skip] =
            parts.map(|part| self.get(&format!("{name}.{part}")));
        let y = self.ops.selective(order, [xz, taps, bias, projection, step, step_bias, a_log, skip]);
        self.ops.product(y, self.get(&format!("{name}.out_proj.weight")))
    }

    fn pyramid(&self, pyramid: &Pyramid, input: O::Value, [images, rows, columns]: [usize; 3]) -> O::Value {
        let stem = self.ops.relu(self.convolution("stem", input, 2, false));
        let quarter = self.convolution("encoder.0.down", stem.clone(), 2, false);
        let quarter = self.unit("encoder.0.unit", quarter);
        let eighth = self.convolution("encoder.1.down", quarter.clone(), 2, false);
        let eighth = self.unit("encoder.1.unit", eighth);
        let coarse = self.convolution("encoder.2.down", eighth.clone(), 2, false);
        let grid = grid([images, rows, columns], 16);
        let mut tokens = self.ops.reshape(coarse, &[images, grid[0] * grid[1], pyramid.widths[3]]);
        let orders = orders(&pyramid.scans, grid, 0);
        for (k, order) in (0..pyramid.depth).zip(orders.iter().cycle()) {
            let normed = self.norm(&format!("blocks.{k}.norm"), tokens.clone());
            tokens = self.ops.add(tokens, self.mamba(&format!("blocks.{k}.mamba"), normed, order));
        }
        let normed = self.norm("norm", tokens);
        let mut map = self.ops.reshape(normed, &[images, grid[0], grid[1], pyramid.widths[3]]);
        for (k, skip) in [eighth, quarter, stem].into_iter().enumerate() {
            let up = self.ops.depth_to_space(self.linear(&format!("decoder.{k}.up"), map), 2);
            map = self.unit(&format!("decoder.{k}.unit"), self.ops.add(skip, up));
        }
        self.ops.depth_to_space(self.convolution("head", map, 1, true), 2)
    }

    fn vit(&self, vit: &Vit, levels: &[u8], shape: [usize; 3]) -> O::Value {
        let mut tokens = self.embed(vit.patch, self.learned_positions(vit.positions, vit.patch, shape), levels, shape);
        let mut hooked = Vec::new();
        for k in 0..vit.depth {
            let block = format!("blocks.{k}");
            let normed = self.norm(&format!("{block}.norm1"), tokens.clone());
            let qkv = self.linear(&format!("{block}.attn.qkv"), normed);
            let mixed = self.ops.attention(qkv, vit.heads);
            tokens = self.ops.add(tokens, self.linear(&format!("{block}.attn.proj"), mixed));
            let normed = self.norm(&format!("{block}.norm2"), tokens.clone());
            tokens = self.ops.add(tokens, self.mlp(&block, normed));
            hooked.extend(vit.hooks.contains(&k).then(|| tokens.clone()));
        }
        self.decode(vit.patch, hooked, shape)
    }

    fn mamba_network(&self, mamba: &Mamba, levels: &[u8], shape: [usize; 3]) -> O::Value {
        let positions = self.learned_positions(mamba.positions, mamba.patch, shape);
        let mut tokens = self.embed(mamba.patch, positions, levels, shape);
        let orders = orders(&mamba.scans, grid(shape, mamba.patch), 1);
        let mut hooked = Vec::new();
        for (k, order) in (0..mamba.depth).zip(orders.iter().cycle()) {
            let normed = self.norm(&format!("blocks.{k}.norm"), tokens.clone());
            tokens = self.ops.add(tokens, self.mamba(&format!("blocks.{k}.mamba"), normed, order));
            hooked.extend(mamba.hooks.contains(&k).then(|| tokens.clone()));
        }
        self.decode(mamba.patch, hooked, shape)
    }

    fn robust_mamba(&self, robust: &RobustMamba, levels: &[u8], shape: [usize; 3]) -> O::Value {
        let grid = grid(shape, robust.patch);
        let positions = self.ops.constant(waves(grid, robust.width));
        let mut tokens = self.embed(robust.patch, positions, levels, shape);
        let orders = orders(&robust.scans, grid, 1);
        let mut hooked = Vec::new();
        for (k, order) in (0..robust.depth).zip(orders.iter().cycle()) {
            let block = format!("blocks.{k}");
            let normed = self.norm(&format!("{block}.norm1"), tokens.clone());
            let mixed = self.mamba(&format!("{block}.mamba"), normed, order);
            let normed = self.norm(&format!("{block}.norm2"), mixed);
            tokens = self.ops.add(tokens, self.mlp(&block, normed));
            hooked.extend(robust.hooks.contains(&k).then(|| tokens.clone()));
        }
        self.decode(robust.patch, hooked, shape)
    }

    fn mlp(&self, block: &str, x: O::Value) -> O::Value {
        let hidden = self.ops.gelu(self.linear(&format!("{block}.mlp.fc1"), x));
        self.linear(&format!("{block}.mlp.fc2"), hidden)
    }

    /// Learned positions on the image's grid, `[tokens, width]`.
    fn learned_positions(&self, [rows, columns]: [usize; 2], patch: usize, shape: [usize; 3]) -> O::Value {
        let table = self.get("positions");
        let (size, width) = (grid(shape, patch), self.ops.shape(&table)[1]);
        let map = self.ops.reshape(table, &[1, rows, columns, width]);
        let map = self.ops.resample(map, Resample { size, aligned: false });
        self.ops.reshape(map, &[size[0] * size[1], width])
    }

    /// Patches as tokens with positions, and the class token behind them.
    fn embed(&self, patch: usize, positions: O::Value, levels: &[u8], [images, rows, columns]: [usize; 3]) -> O::Value {
        let values = levels.iter().map(|level| f32::from(*level) / 127.5 - 1.0).collect();
        let patches = space_to_depth(&Tensor { shape: vec![images, rows, columns, 3], values }, patch);
        let map = self.linear("patch", self.ops.constant(patches));
        let &[count, width] = &*self.ops.shape(&positions) else { unreachable!("a table has two axes") };
        let tokens = self.ops.add_table(self.ops.reshape(map, &[images, count, width]), positions);
        self.ops.append(tokens, self.get("class"))
    }

    /// Rows and columns of a map.
    fn size(&self, map: &O::Value) -> [usize; 2] {
        let shape = self.ops.shape(map);
        [shape[1], shape[2]]
    }

    /// DPT's decoder of the hooked tokens, shallow first.
    fn decode(&self, patch: usize, hooked: Vec<O::Value>, shape: [usize; 3]) -> O::Value {
        let [images, rows, columns] = shape;
        let grid = grid(shape, patch);
        let reassemble = |(k, tokens): (usize, O::Value)| {
            let name = |part: &str| format!("reassemble.{k}.{part}");
            let read = self.ops.gelu(self.linear(&name("read"), self.ops.with_last(tokens)));
            let flat = self.linear(&name("project"), read);
            let channels = self.ops.shape(&flat)[2];
            let map = self.ops.reshape(flat, &[images, grid[0], grid[1], channels]);
            match k {
                0 => self.ops.depth_to_space(self.linear(&name("resize"), map), 4),
                1 => self.ops.depth_to_space(self.linear(&name("resize"), map), 2),
                2 => map,
                _ => self.convolution(&name("resize"), map, 2, false),
            }
        };
        let maps: Vec<O::Value> = hooked.into_iter().enumerate().map(reassemble).collect();
        let resampled = |x: O::Value, size: [usize; 2]| {
            if self.size(&x) == size { x } else { self.ops.resample(x, Resample { size, aligned: true }) }
        };
        let mut fused: Option<O::Value> = None;
        for (k, map) in maps.into_iter().enumerate().rev() {
            let size = self.size(&map);
            let mut sum = self.unit(&format!("fusion.{k}.unit1"), map);
            if let Some(coarser) = fused {
                sum = self.ops.add(sum, resampled(coarser, size));
            }
            fused = Some(self.unit(&format!("fusion.{k}.unit2"), sum));
        }
        let Some(fused) = fused else { unreachable!("a network without hooks is refused") };
        let double = self.size(&fused).map(|side| 2 * side);
        let fine = resampled(fused, double);
        let head = |name: &str| {
            let map = self.convolution(&format!("{name}.conv1"), fine.clone(), 1, false);
            let map = self.convolution(&format!("{name}.conv2"), resampled(map, [rows, columns]), 1, false);
            self.linear(&format!("{name}.out"), self.ops.relu(map))
        };
        self.ops.pair(head("depth"), head("contact"))
    }
}

/// Rows and columns of patches.
fn grid([_, rows, columns]: [usize; 3], patch: usize) -> [usize; 2] {
    [rows / patch, columns / patch]
}

/// The orders of scans over a grid; `extra` tokens come last in each.
fn orders(scans: &[Scan], [rows, columns]: [usize; 2], extra: usize) -> Vec<Arc<[usize]>> {
    let last = rows * columns..rows * columns + extra;
    scans.iter().map(|scan| scan.order(rows, columns).into_iter().chain(last.clone()).collect()).collect()
}

/// Fixed positions: sines and cosines of row and column, a quarter of the width each.
fn waves([rows, columns]: [usize; 2], width: usize) -> Tensor {
    let quarter = width / 4;
    let value = |k: usize| {
        let (token, channel) = (k / width, k % width);
        let place = if channel < 2 * quarter { token / columns } else { token % columns };
        let frequency = 1e4_f32.powf(-((channel % quarter) as f32) / quarter as f32);
        let angle = place as f32 * frequency;
        if (channel / quarter).is_multiple_of(2) { angle.sin() } else { angle.cos() }
    };
    Tensor { shape: vec![rows * columns, width], values: (0..rows * columns * width).map(value).collect() }
}

/// Levels as numbers from -1 to 1, with the pixels' places as two more channels.
fn with_coordinates(Images { levels, shape: [images, rows, columns] }: Images<'_>) -> Tensor {
    let place = |i: usize, count: usize| 2.0 * (i as f32 + 0.5) / count as f32 - 1.0;
    let mut values = Vec::with_capacity(levels.len() / 3 * 5);
    for (k, pixel) in levels.as_chunks::<3>().0.iter().enumerate() {
        values.extend(pixel.map(|level| f32::from(level) / 127.5 - 1.0));
        values.extend([place(k % columns, columns), place(k / columns % rows, rows)]);
    }
    Tensor { shape: vec![images, rows, columns, 5], values }
}

/// Tensors to start training from, drawn from a seed.
pub fn initial(architecture: &Architecture, seed: u64) -> BTreeMap<String, Tensor> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let layers = architecture.layers();
    let blocks = layers.iter().filter(|layer| matches!(layer.op, Op::Mamba { .. } | Op::Attention { .. })).count();
    layers.iter().flat_map(|layer| initial_layer(layer, blocks, &mut rng)).collect()
}

fn initial_layer(layer: &Layer, blocks: usize, rng: &mut ChaCha8Rng) -> Vec<(String, Tensor)> {
    let mut draw = |name: &str, shape: &[usize]| -> Vec<f32> {
        let count = shape.iter().product();
        let fan_in: usize = shape.iter().skip(1).product();
        let mut normal = |sigma: f32| (0..count).map(|_| sigma * standard_normal(rng)).collect();
        let part = name.strip_prefix(&layer.name).unwrap_or_default();
        match (layer.op, part) {
            (Op::Table { .. }, _) => normal(0.02),
            (Op::Norm { .. }, ".weight") | (Op::Mamba { .. }, ".D") => vec![1.0; count],
            (Op::Mamba { state, .. }, ".A_log") => (0..count).map(|i| ((i % state + 1) as f32).ln()).collect(),
            // Step sizes between 1e-3 and 1e-1, evenly in their logarithm; the bias is their inverse under softplus.
            (Op::Mamba { .. }, ".dt_proj.bias") => (0..count)
                .map(|_| {
                    let step = (rng.random_range(1e-3_f32.ln()..1e-1_f32.ln())).exp();
                    step + (-(-step).exp_m1()).ln()
                })
                .collect(),
            (Op::Mamba { .. }, ".out_proj.weight") => normal((1.0 / (fan_in * blocks) as f32).sqrt()),
            (Op::Linear { .. }, ".bias") if layer.name == "contact.out" => vec![-2.0; count],
            // Logits start where most pixels are: without contact.
            (Op::Convolution { .. }, ".bias") if layer.name == "head" => {
                (0..count).map(|i| if i % 2 == 1 { -2.0 } else { 0.0 }).collect()
            }
            (_, bias) if bias.ends_with("bias") => vec![0.0; count],
            (Op::Convolution { .. }, _) if layer.name == "head" => normal(0.1 * (1.0 / fan_in as f32).sqrt()),
            // Residual units start close to doing nothing.
            (Op::Convolution { .. }, _) if layer.name.ends_with("conv2") => normal(0.3 * (2.0 / fan_in as f32).sqrt()),
            (Op::Convolution { .. }, _) => normal((2.0 / fan_in as f32).sqrt()),
            _ => normal((1.0 / fan_in as f32).sqrt()),
        }
    };
    layer
        .tensors()
        .into_iter()
        .map(|(name, shape)| {
            let values = draw(&name, &shape);
            (name, Tensor { shape, values })
        })
        .collect()
}

/// A standard normal number (Box and Muller).
fn standard_normal(rng: &mut impl Rng) -> f32 {
    let radius = (-2.0 * (1.0 - rng.random::<f32>()).ln()).sqrt();
    radius * (std::f32::consts::TAU * rng.random::<f32>()).cos()
}
