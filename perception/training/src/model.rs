//! Forward pass of each network.

use std::collections::BTreeMap;
use std::sync::Arc;

use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::attention::WindowAttention;
use crate::batch::TrainingImages;
use crate::ops::Ops;
use crate::resample::Resample;
use mvt_touch::network::{
    Architecture, ConvNext, Mamba, NetworkLayer, Op, Pyramid, RobustMamba, ScanOrder, ShiftedWindows, Swin, Vit,
    WeightTensor, squares,
};

/// Network whose tensors are values.
pub struct Model<'a, O: Ops> {
    /// Architecture.
    pub architecture: &'a Architecture,
    /// Operations.
    pub ops: &'a O,
    /// Tensors by name; all those of the architecture.
    pub variables: &'a BTreeMap<&'a str, O::Value>,
}

impl<O: Ops> Model<'_, O> {
    /// Predicts indentation in millimetres, which may be negative, and the logit of contact, `[images, rows, columns, 2]`, for RGB images
    /// `[images, rows, columns, 3]` whose sides are multiples of the stride.
    pub fn forward(&self, images: TrainingImages<'_>) -> O::Value {
        let shape = images.shape;
        match self.architecture {
            Architecture::Default(pyramid) => self.pyramid(pyramid, self.ops.with_coordinates(images), shape),
            Architecture::Vit(vit) => self.vit(vit, images),
            Architecture::Mamba(mamba) => self.mamba_network(mamba, images),
            Architecture::RobustMamba(robust) => self.robust_mamba(robust, images),
            Architecture::Swin(swin) => self.swin(swin, images),
            Architecture::ConvNext(convnext) => self.convnext(convnext, images),
        }
    }

    /// Returns a tensor. Callers take the variables from the tensors of the same architecture, so every name is there.
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

    /// Computes `x + conv2(relu(conv1(relu(x))))`.
    fn unit(&self, name: &str, x: O::Value) -> O::Value {
        let inner = self.convolution(&format!("{name}.conv1"), x.clone(), 1, true);
        self.ops.add(x, self.convolution(&format!("{name}.conv2"), inner, 1, true))
    }

    /// Computes a Mamba block without norm and residual, of tokens `[images, tokens, channels]`.
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

    fn vit(&self, vit: &Vit, images: TrainingImages<'_>) -> O::Value {
        let shape = images.shape;
        let mut tokens = self.embed(vit.patch, self.learned_positions(vit.positions, vit.patch, shape), images);
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

    fn mamba_network(&self, mamba: &Mamba, images: TrainingImages<'_>) -> O::Value {
        let shape = images.shape;
        let positions = self.learned_positions(mamba.positions, mamba.patch, shape);
        let mut tokens = self.embed(mamba.patch, positions, images);
        let orders = orders(&mamba.scans, grid(shape, mamba.patch), 1);
        let mut hooked = Vec::new();
        for (k, order) in (0..mamba.depth).zip(orders.iter().cycle()) {
            let normed = self.norm(&format!("blocks.{k}.norm"), tokens.clone());
            tokens = self.ops.add(tokens, self.mamba(&format!("blocks.{k}.mamba"), normed, order));
            hooked.extend(mamba.hooks.contains(&k).then(|| tokens.clone()));
        }
        self.decode(mamba.patch, hooked, shape)
    }

    fn robust_mamba(&self, robust: &RobustMamba, images: TrainingImages<'_>) -> O::Value {
        let shape = images.shape;
        let grid = grid(shape, robust.patch);
        let name = format!("waves of {} x {}", grid[0], grid[1]);
        let positions = self.ops.fixed(&name, &[grid[0] * grid[1], robust.width], || waves(grid, robust.width));
        let mut tokens = self.embed(robust.patch, positions, images);
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

    fn swin(&self, swin: &Swin, images: TrainingImages<'_>) -> O::Value {
        self.stages(swin.depths, true, images, |[k, b], x, size| {
            let block = format!("stages.{k}.blocks.{b}");
            let windows = ShiftedWindows::new(size, swin.window, b % 2 == 1);
            let (count, tokens) = (swin.window * swin.window, size[0] * size[1]);
            let [images, _, width] = self.sides(&x);
            let normed = self.norm(&format!("{block}.norm1"), x.clone());
            let places = windows.places(tokens).into();
            let in_windows = windows.tokens.len();
            let qkv = self.linear(&format!("{block}.attn.qkv"), self.ops.gather(normed, &windows.tokens.into()));
            let qkv = self.ops.reshape(qkv, &[images * in_windows / count, count, 3 * width]);
            let table = self.get(&format!("{block}.attn.relative_position_bias_table"));
            let attention =
                WindowAttention { heads: swin.heads[k], side: swin.window, regions: windows.regions.into() };
            let mixed = self.ops.window_attention(qkv, table, &attention);
            let mixed = self.ops.reshape(mixed, &[images, in_windows, width]);
            let mixed = self.linear(&format!("{block}.attn.proj"), self.ops.gather(mixed, &places));
            let x = self.ops.add(x, mixed);
            let normed = self.norm(&format!("{block}.norm2"), x.clone());
            self.ops.add(x, self.mlp(&block, normed))
        })
    }

    fn convnext(&self, convnext: &ConvNext, images: TrainingImages<'_>) -> O::Value {
        self.stages(convnext.depths, false, images, |[k, b], x, size| {
            let block = format!("stages.{k}.blocks.{b}");
            let [images, tokens, width] = self.sides(&x);
            let map = self.ops.reshape(x.clone(), &[images, size[0], size[1], width]);
            let map = self.ops.depthwise(map, self.weight_and_bias(&format!("{block}.depthwise")));
            let normed = self.norm(&format!("{block}.norm"), self.ops.reshape(map, &[images, tokens, width]));
            let scaled = self.ops.scale(self.mlp(&block, normed), self.get(&format!("{block}.scale")));
            self.ops.add(x, scaled)
        })
    }

    /// Computes a network of four stages; `block` computes a block from its stage and number, its input and the sides of that.
    fn stages(
        &self,
        depths: [usize; 4],
        is_joined_first: bool,
        images: TrainingImages<'_>,
        block: impl Fn([usize; 2], O::Value, [usize; 2]) -> O::Value,
    ) -> O::Value {
        let shape = images.shape;
        let mut size = grid(shape, 4);
        let flat = |x: O::Value, size: [usize; 2]| {
            let width = self.ops.shape(&x).last().copied().unwrap_or(1);
            self.ops.reshape(x, &[shape[0], size[0] * size[1], width])
        };
        let mut x = flat(self.norm("norm", self.patches(4, images)), size);
        let mut maps = Vec::new();
        for (k, depth) in depths.into_iter().enumerate() {
            if k > 0 {
                let norm = format!("stages.{k}.down.norm");
                let squares = squares(size).into();
                size = size.map(|side| side.div_ceil(2));
                let join = |x: O::Value| {
                    let [_, _, width] = self.sides(&x);
                    self.ops.reshape(self.ops.gather(x, &squares), &[shape[0], size[0] * size[1], 4 * width])
                };
                x = if is_joined_first { self.norm(&norm, join(x)) } else { join(self.norm(&norm, x)) };
                x = self.linear(&format!("stages.{k}.down.linear"), x);
            }
            for b in 0..depth {
                x = block([k, b], x, size);
            }
            let normed = self.norm(&format!("reassemble.{k}.norm"), x.clone());
            let level = self.linear(&format!("reassemble.{k}.project"), normed);
            let [images, _, channels] = self.sides(&level);
            maps.push(self.ops.reshape(level, &[images, size[0], size[1], channels]));
        }
        self.fuse(maps, shape)
    }

    /// Returns the sides of tokens.
    fn sides(&self, tokens: &O::Value) -> [usize; 3] {
        let shape = self.ops.shape(tokens);
        [shape[0], shape[1], shape[2]]
    }

    fn mlp(&self, block: &str, x: O::Value) -> O::Value {
        let hidden = self.ops.gelu(self.linear(&format!("{block}.mlp.fc1"), x));
        self.linear(&format!("{block}.mlp.fc2"), hidden)
    }

    /// Returns the learned positions on the grid of the image, `[tokens, width]`.
    fn learned_positions(&self, [rows, columns]: [usize; 2], patch: usize, shape: [usize; 3]) -> O::Value {
        let table = self.get("positions");
        let (size, width) = (grid(shape, patch), self.ops.shape(&table)[1]);
        let map = self.ops.reshape(table, &[1, rows, columns, width]);
        let map = self.ops.resample(map, Resample { size, aligned: false });
        self.ops.reshape(map, &[size[0] * size[1], width])
    }

    /// Returns patches as tokens with positions, and the class token behind them.
    fn embed(&self, patch: usize, positions: O::Value, images: TrainingImages<'_>) -> O::Value {
        let shape = images.shape;
        let map = self.patches(patch, images);
        let table = self.ops.shape(&positions);
        let tokens = self.ops.add_table(self.ops.reshape(map, &[shape[0], table[0], table[1]]), positions);
        self.ops.append(tokens, self.get("class"))
    }

    /// Returns a linear map of the patches of images.
    fn patches(&self, patch: usize, images: TrainingImages<'_>) -> O::Value {
        self.linear("patch", self.ops.patches(images, patch))
    }

    /// Returns rows and columns of a map.
    fn size(&self, map: &O::Value) -> [usize; 2] {
        let shape = self.ops.shape(map);
        [shape[1], shape[2]]
    }

    /// Computes the decoder of DPT from the hooked tokens, shallow first.
    fn decode(&self, patch: usize, hooked: Vec<O::Value>, shape: [usize; 3]) -> O::Value {
        let (images, grid) = (shape[0], grid(shape, patch));
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
        self.fuse(hooked.into_iter().enumerate().map(reassemble).collect(), shape)
    }

    /// Computes the output from the maps of the decoder, fine to coarse.
    fn fuse(&self, maps: Vec<O::Value>, [_, rows, columns]: [usize; 3]) -> O::Value {
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
        // `Architecture::check` refuses networks without hooks.
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

/// Returns rows and columns of patches.
fn grid([_, rows, columns]: [usize; 3], patch: usize) -> [usize; 2] {
    [rows / patch, columns / patch]
}

/// Returns the orders of scans over a grid; `extra` tokens come last in each.
fn orders(scans: &[ScanOrder], [rows, columns]: [usize; 2], extra: usize) -> Vec<Arc<[usize]>> {
    let last = rows * columns..rows * columns + extra;
    scans.iter().map(|scan| scan.order(rows, columns).into_iter().chain(last.clone()).collect()).collect()
}

/// Returns fixed positions: sines and cosines of row and column, a quarter of the width each.
fn waves([rows, columns]: [usize; 2], width: usize) -> Vec<f32> {
    let quarter = width / 4;
    let value = |k: usize| {
        let (token, channel) = (k / width, k % width);
        let place = if channel < 2 * quarter { token / columns } else { token % columns };
        let frequency = 1e4_f32.powf(-((channel % quarter) as f32) / quarter as f32);
        let angle = place as f32 * frequency;
        if (channel / quarter).is_multiple_of(2) { angle.sin() } else { angle.cos() }
    };
    (0..rows * columns * width).map(value).collect()
}

/// Returns random tensors from which a training starts.
pub fn initial(architecture: &Architecture, seed: u64) -> BTreeMap<String, WeightTensor> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let layers = architecture.layers();
    let blocks = layers.iter().filter(|layer| matches!(layer.op, Op::Mamba { .. } | Op::Attention { .. })).count();
    layers.iter().flat_map(|layer| initial_layer(layer, blocks, &mut rng)).collect()
}

fn initial_layer(layer: &NetworkLayer, blocks: usize, rng: &mut ChaCha8Rng) -> Vec<(String, WeightTensor)> {
    let mut draw = |name: &str, shape: &[usize]| -> Vec<f32> {
        let count = shape.iter().product();
        let fan_in: usize = shape.iter().skip(1).product();
        let mut normal = |sigma: f32| (0..count).map(|_| sigma * standard_normal(rng)).collect();
        let part = name.strip_prefix(&layer.name).unwrap_or_default();
        match (layer.op, part) {
            (Op::Table { .. }, _) => normal(0.02),
            // A hundredth of it, as usual, suits far longer trainings.
            (Op::Scale { .. }, _) => vec![0.1; count],
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
            // Logits start at no contact, where most pixels are.
            (Op::Convolution { .. }, ".bias") if layer.name == "head" => {
                (0..count).map(|i| if i % 2 == 1 { -2.0 } else { 0.0 }).collect()
            }
            (_, bias) if bias.ends_with("bias") => vec![0.0; count],
            (Op::Convolution { .. }, _) if layer.name == "head" => normal(0.1 * (1.0 / fan_in as f32).sqrt()),
            // Residual units start close to the identity.
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
            (name, WeightTensor { shape, values })
        })
        .collect()
}

/// Returns a standard normal number (Box and Muller).
fn standard_normal(rng: &mut impl Rng) -> f32 {
    let radius = (-2.0 * (1.0 - rng.random::<f32>()).ln()).sqrt();
    radius * (std::f32::consts::TAU * rng.random::<f32>()).cos()
}
