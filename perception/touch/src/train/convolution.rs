//! 3 x 3 convolutions as matrix products over shifted rows.
//!
//! A row of three pixels' channels is contiguous in a padded map, so that each row of the window is one product, whose left matrix
//! is the map itself read with overlapping rows.

use rayon::prelude::*;

use super::linear::{Scratch, add_to, for_length, rows_of, total, with_scratch};
use super::tape::{Kernel, View};
use crate::network::Tensor;
use mvt_products::Instructions;
use mvt_products::multiply::{Left, Packed, Windows};

/// 3 x 3 correlation with zeros around the map and bias; inputs x `[images, rows, columns, in]`, W `[out, in, 3, 3]`, b `[out]`.
#[derive(Debug, Clone, Copy)]
pub struct Convolution {
    /// 1 or 2. With 2, output (i, j) is centred on input (2 i, 2 j).
    pub stride: usize,
    /// Whether negative inputs count as zero.
    pub relu: bool,
    /// With which products are formed.
    pub instructions: Instructions,
}

/// Sides of one image's map and its channels.
#[derive(Clone, Copy)]
struct Map {
    rows: usize,
    columns: usize,
    channels: usize,
}

impl Map {
    fn new(shape: &[usize]) -> Self {
        Self { rows: shape[1], columns: shape[2], channels: shape[3] }
    }

    fn len(self) -> usize {
        self.rows * self.columns * self.channels
    }

    /// Channels of a padded pixel: bf16 numbers are multiplied in pairs.
    fn step(self) -> usize {
        self.channels.next_multiple_of(2)
    }

    /// Length of a padded row.
    fn pitch(self) -> usize {
        (self.columns + 2) * self.step()
    }

    /// The map with a ring of zeros, and room for the last window to overlap, in `padded`.
    fn pad(self, values: &[f32], relu: bool, padded: &mut Vec<f32>) {
        let (step, pitch) = (self.step(), self.pitch());
        padded.clear();
        padded.resize((self.rows + 2) * pitch + 2 * step, 0.0);
        let rows = values.chunks_exact(self.columns * self.channels);
        for (from, to) in rows.zip(padded[pitch..].chunks_exact_mut(pitch)) {
            let to = &mut to[step..step + self.columns * step];
            match (relu, step == self.channels) {
                (true, true) => to.iter_mut().zip(from).for_each(|(to, from)| *to = from.max(0.0)),
                (false, true) => to.copy_from_slice(from),
                (_, false) => {
                    let least = if relu { 0.0 } else { f32::NEG_INFINITY };
                    for (to, from) in to.chunks_exact_mut(step).zip(from.chunks_exact(self.channels)) {
                        to.iter_mut().zip(from).for_each(|(to, from)| *to = from.max(least));
                    }
                }
            }
        }
    }

    fn strided(self, stride: usize, channels: usize) -> Self {
        Self { rows: self.rows.div_ceil(stride), columns: self.columns.div_ceil(stride), channels }
    }

    /// The windows of a padded map, `stride` apart.
    fn windows(self, padded: &[f32], stride: usize) -> Left<'_> {
        let Self { rows, columns, .. } = self.strided(stride, self.channels);
        let (step, pitch) = (stride * self.step(), stride * self.pitch());
        let windows = Windows { first: 0, step, pitch, columns, rows, segment_pitch: self.pitch() };
        Left { data: padded, windows, rectified: false }
    }
}

/// A padded map channel by channel, the pixels of each in `stride` x `stride` planes: those whose rows and columns leave the same
/// rests. In a plane, the pixels under one place of all windows lie as the windows do, so that their products with the outputs'
/// gradients are rows of numbers.
struct Planes {
    stride: usize,
    /// From a row of a plane to the next; even, since bf16 numbers are multiplied in pairs.
    pitch: usize,
    /// From a plane to the next.
    len: usize,
}

impl Planes {
    fn new(out: Map, stride: usize) -> Self {
        let more = 2 / stride;
        let pitch = (out.columns + more).next_multiple_of(2);
        Self { stride, pitch, len: ((out.rows + more) * pitch + more).next_multiple_of(2) }
    }

    /// Lays a map out: all channels of the plane of even rows and even columns, then of those that follow.
    fn fill(&self, map: Map, x: &[f32], relu: bool, planes: &mut Vec<f32>) {
        let &Self { stride, pitch, len } = self;
        planes.clear();
        planes.resize(stride * stride * map.channels * len, 0.0);
        let least = if relu { 0.0 } else { f32::NEG_INFINITY };
        for (i, row) in x.chunks_exact(map.columns * map.channels).enumerate() {
            let row_rest = (i + 1) % stride;
            for column_rest in 0..stride {
                let plane = (row_rest * stride + column_rest) * map.channels * len + (i + 1) / stride * pitch;
                // Column j of the map is column j + 1 of the padded one.
                let first = (column_rest + stride - 1) % stride;
                for c in 0..map.channels {
                    let to = &mut planes[plane + c * len + (first + 1) / stride..];
                    let from = row[first * map.channels + c..].iter().step_by(stride * map.channels);
                    to.iter_mut().zip(from).for_each(|(to, from)| *to = from.max(least));
                }
            }
        }
    }
}

impl Convolution {
    /// Weights by place in the window and input; filling channels have none.
    fn pack(self, weight: View<'_>, bias: &[f32]) -> Packed {
        let inputs = weight.shape[1];
        let step = inputs.next_multiple_of(2);
        Packed::new(self.instructions, 3, 3 * step, bias, |row, o| {
            let (tap, i) = (row / step, row % step);
            if i < inputs { weight.values[(o * inputs + i) * 9 + tap] } else { 0.0 }
        })
    }

    /// The same with inputs and outputs swapped and the window turned by 180 degrees, which makes a convolution of stride 1 its own
    /// transpose.
    fn pack_flipped(self, weight: View<'_>) -> Packed {
        let (outputs, inputs) = (weight.shape[0], weight.shape[1]);
        let step = outputs.next_multiple_of(2);
        Packed::new(self.instructions, 3, 3 * step, &vec![0.0; inputs], |row, i| {
            let (tap, o) = (row / step, row % step);
            if o < outputs { weight.values[(o * inputs + i) * 9 + 8 - tap] } else { 0.0 }
        })
    }

    /// Weights by output; all places in the window side by side.
    fn pack_transposed(self, weight: View<'_>) -> Packed {
        let (outputs, inputs) = (weight.shape[0], weight.shape[1]);
        let instructions = for_length(self.instructions, outputs);
        Packed::new(instructions, 1, outputs, &vec![0.0; 9 * inputs], |o, column| {
            weight.values[(o * inputs + column % inputs) * 9 + column / inputs]
        })
    }
}

impl Kernel<3> for Convolution {
    type Kept = ();

    fn forward(&self, [x, weight, bias]: [View<'_>; 3]) -> (Tensor, ()) {
        let map = Map::new(x.shape);
        let out = map.strided(self.stride, weight.shape[0]);
        let packed = weight.forwards(|| self.pack(weight, bias.values));
        let mut values = vec![0.0; x.shape[0] * out.len()];
        let images = values.par_chunks_mut(out.len()).zip(x.values.par_chunks(map.len()));
        images.for_each(|(y, x)| {
            with_scratch(|scratch| {
                let mut padded = std::mem::take(&mut scratch.padded);
                map.pad(x, self.relu, &mut padded);
                scratch.multiply(map.windows(&padded, self.stride), packed, out.channels, y);
                scratch.padded = padded;
            });
        });
        (Tensor { shape: vec![x.shape[0], out.rows, out.columns, out.channels], values }, ())
    }

    fn backward(
        &self,
        [x, weight, bias]: [View<'_>; 3],
        (): &(),
        gradient: View<'_>,
        [x_wanted, ..]: [bool; 3],
    ) -> [Option<Tensor>; 3] {
        let (map, out) = (Map::new(x.shape), Map::new(gradient.shape));
        let by_x = x_wanted.then(|| {
            let packed = weight.backwards(|| match self.stride {
                1 => self.pack_flipped(weight),
                _ => self.pack_transposed(weight),
            });
            let mut values = vec![0.0; x.values.len()];
            let images = values
                .par_chunks_mut(map.len())
                .zip(x.values.par_chunks(map.len()))
                .zip(gradient.values.par_chunks(out.len()));
            images.for_each(|((by_x, x), g)| {
                with_scratch(|scratch| {
                    let mut padded = std::mem::take(&mut scratch.padded);
                    if self.stride == 1 {
                        out.pad(g, false, &mut padded);
                        scratch.multiply(out.windows(&padded, 1), packed, map.channels, by_x);
                    } else {
                        spread(map, out, packed, g, &mut padded, scratch);
                        let row = map.columns * map.channels;
                        let from =
                            padded[(map.columns + 2) * map.channels..].chunks_exact((map.columns + 2) * map.channels);
                        for (to, from) in by_x.chunks_exact_mut(row).zip(from) {
                            to.copy_from_slice(&from[map.channels..map.channels + row]);
                        }
                    }
                    scratch.padded = padded;
                });
                self.mask(x, by_x);
            });
            Tensor { shape: x.shape.to_vec(), values }
        });
        let size = 9 * map.channels * out.channels;
        let images = x.values.par_chunks(map.len()).zip(gradient.values.par_chunks(out.len()));
        let parts = images.map(|(x, g)| {
            let mut sums = vec![0.0; size + out.channels];
            let (by_weight, by_bias) = sums.split_at_mut(size);
            g.chunks_exact(out.channels).for_each(|pixel| add_to(by_bias, pixel));
            with_scratch(|scratch| self.by_weight(map, x, out, g, by_weight, scratch));
            sums
        });
        let mut sums = total(parts.collect(), size + out.channels);
        let by_bias = sums.split_off(size);
        let mut by_weight = vec![0.0; weight.values.len()];
        for (k, taps) in sums.chunks_exact(out.channels).enumerate() {
            let (tap, i) = (k / map.channels, k % map.channels);
            for (o, value) in taps.iter().enumerate() {
                by_weight[(o * map.channels + i) * 9 + tap] = *value;
            }
        }
        [
            by_x,
            Some(Tensor { shape: weight.shape.to_vec(), values: by_weight }),
            Some(Tensor { shape: bias.shape.to_vec(), values: by_bias }),
        ]
    }
}

impl Convolution {
    /// The gradient of an image by the weights, `[place in the window, input, output]`.
    fn by_weight(self, map: Map, x: &[f32], out: Map, g: &[f32], by_weight: &mut [f32], scratch: &mut Scratch) {
        let planes = Planes::new(out, self.stride);
        planes.fill(map, x, self.relu, &mut scratch.padded);
        scratch.shared.load(self.instructions, &scratch.padded, planes.len);
        let mut spaced = vec![0.0; out.rows * planes.pitch * out.channels];
        let row = out.columns * out.channels;
        for (to, from) in spaced.chunks_exact_mut(planes.pitch * out.channels).zip(g.chunks_exact(row)) {
            to[..row].copy_from_slice(from);
        }
        let packed = Packed::of_rows(self.instructions, &spaced, out.rows * planes.pitch, out.channels);
        for (tap, by_weight) in by_weight.chunks_exact_mut(map.channels * out.channels).enumerate() {
            let (dy, dx) = (tap / 3, tap % 3);
            let plane = (dy % self.stride * self.stride + dx % self.stride) * map.channels * planes.len;
            let first = plane + dy / self.stride * planes.pitch + dx / self.stride;
            scratch.multiply_shared(&packed, first, planes.len, map.channels, out.channels, by_weight);
        }
    }

    /// No gradient reaches what counted as zero.
    fn mask(self, x: &[f32], by_x: &mut [f32]) {
        if self.relu {
            by_x.iter_mut().zip(x).filter(|(_, x)| **x <= 0.0).for_each(|(by_x, _)| *by_x = 0.0);
        }
    }
}

/// The gradient by a padded map at stride 2: each output's gradient goes to its window.
fn spread(map: Map, out: Map, packed: &Packed, g: &[f32], padded: &mut Vec<f32>, scratch: &mut Scratch) {
    let (pitch, window) = ((map.columns + 2) * map.channels, 3 * map.channels);
    padded.clear();
    padded.resize((map.rows + 2) * pitch, 0.0);
    let mut row = vec![0.0; out.columns * 3 * window];
    for (i, g) in g.chunks_exact(out.columns * out.channels).enumerate() {
        scratch.multiply(rows_of(g, out.channels), packed, 3 * window, &mut row);
        for (j, windows) in row.chunks_exact(3 * window).enumerate() {
            for (dy, part) in windows.chunks_exact(window).enumerate() {
                add_to(&mut padded[(2 * i + dy) * pitch + 2 * j * map.channels..][..window], part);
            }
        }
    }
}
