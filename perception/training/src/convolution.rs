//! 3 x 3 convolutions as matrix products over shifted rows.
//!
//! The channels of three pixels in a row are contiguous in a padded map. Each row of the window is therefore one product, and its left
//! matrix is the map itself, read with overlapping rows.

use rayon::prelude::*;

use crate::lanes::{add_to, total};
use crate::linear::{ProductBuffers, for_length, with_buffers};
use crate::tape::{Inputs, Kernel, Slopes, TensorView};
use mvt_products::Instructions;
use mvt_products::multiply::{Left, Packed, Windows};
use mvt_touch::network::WeightTensor;

/// 3 x 3 correlation with zeros around the map and bias; inputs x `[images, rows, columns, in]`, W `[out, in, 3, 3]`, b `[out]`.
#[derive(Debug, Clone, Copy)]
pub struct Convolution {
    /// 1 or 2. With 2, output (i, j) is centred on input (2 i, 2 j).
    pub stride: usize,
    /// Whether negative inputs count as zero.
    pub relu: bool,
    /// Instructions of the products.
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
    fn new(x: TensorView<'_>) -> Self {
        let [_, rows, columns, channels] = x.sides();
        Self { rows, columns, channels }
    }

    fn len(self) -> usize {
        self.rows * self.columns * self.channels
    }

    /// Returns the channels of a padded pixel: bf16 numbers are multiplied in pairs.
    fn step(self) -> usize {
        self.channels.next_multiple_of(2)
    }

    /// Returns the length of a padded row.
    fn pitch(self) -> usize {
        (self.columns + 2) * self.step()
    }

    /// Writes the map with a ring of zeros, and room for the last window to overlap, to `padded`.
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

    /// Returns the windows of a padded map, `stride` apart.
    fn windows(self, padded: &[f32], stride: usize) -> Left<'_> {
        let Self { rows, columns, .. } = self.strided(stride, self.channels);
        let (step, pitch) = (stride * self.step(), stride * self.pitch());
        let windows = Windows { first: 0, step, pitch, columns, rows, segment_pitch: self.pitch() };
        Left { data: padded, windows, rectified: false }
    }
}

/// Padded map channel by channel. The pixels of a channel lie in `stride` x `stride` planes; the rows and columns of a plane leave the
/// same remainder when divided by `stride`. In a plane, the pixels under one place of all windows lie in the order of the windows, so
/// that their products with the gradients of the outputs are rows of numbers.
struct Planes {
    stride: usize,
    /// Distance from a row of a plane to the next; even, since bf16 numbers are multiplied in pairs.
    pitch: usize,
    /// Distance from a plane to the next.
    len: usize,
}

impl Planes {
    fn new(out: Map, stride: usize) -> Self {
        let more = 2 / stride;
        let pitch = (out.columns + more).next_multiple_of(2);
        Self { stride, pitch, len: ((out.rows + more) * pitch + more).next_multiple_of(2) }
    }

    /// Writes a map plane by plane, all channels of a plane together; the plane of even rows and even columns comes first.
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
    /// Packs weights by place in the window and input; the weights of filling channels are zero.
    fn pack(self, weight: TensorView<'_>, bias: &[f32]) -> Packed {
        let inputs = weight.shape[1];
        let step = inputs.next_multiple_of(2);
        Packed::new(self.instructions, 3, 3 * step, bias, |row, o| {
            let (tap, i) = (row / step, row % step);
            if i < inputs { weight.values[(o * inputs + i) * 9 + tap] } else { 0.0 }
        })
    }

    /// Packs weights with inputs and outputs swapped and the window turned by 180 degrees: the transpose of a convolution of stride 1.
    fn pack_flipped(self, weight: TensorView<'_>) -> Packed {
        let (outputs, inputs) = (weight.shape[0], weight.shape[1]);
        let step = outputs.next_multiple_of(2);
        Packed::new(self.instructions, 3, 3 * step, &vec![0.0; inputs], |row, i| {
            let (tap, o) = (row / step, row % step);
            if o < outputs { weight.values[(o * inputs + i) * 9 + 8 - tap] } else { 0.0 }
        })
    }

    /// Packs weights by output, all places in the window side by side.
    fn pack_transposed(self, weight: TensorView<'_>) -> Packed {
        let (outputs, inputs) = (weight.shape[0], weight.shape[1]);
        let instructions = for_length(self.instructions, outputs);
        Packed::new(instructions, 1, outputs, &vec![0.0; 9 * inputs], |o, column| {
            weight.values[(o * inputs + column % inputs) * 9 + column / inputs]
        })
    }
}

impl Kernel<3> for Convolution {
    type Kept = ();

    fn forward(&self, [x, weight, bias]: Inputs<'_, 3>) -> (WeightTensor, ()) {
        let map = Map::new(x);
        let out = map.strided(self.stride, weight.shape[0]);
        let packed = weight.forwards(|| self.pack(weight, bias.values));
        let mut values = vec![0.0; x.shape[0] * out.len()];
        let images = values.par_chunks_mut(out.len()).zip(x.values.par_chunks(map.len()));
        images.for_each(|(y, x)| {
            with_buffers(|buffers| {
                let mut padded = std::mem::take(&mut buffers.padded);
                map.pad(x, self.relu, &mut padded);
                buffers.multiply(map.windows(&padded, self.stride), packed, out.channels, y);
                buffers.padded = padded;
            });
        });
        (WeightTensor { shape: vec![x.shape[0], out.rows, out.columns, out.channels], values }, ())
    }

    fn backward(&self, [x, weight, bias]: Inputs<'_, 3>, (): &(), gradient: &[f32], wanted: [bool; 3]) -> Slopes<3> {
        let map = Map::new(x);
        let out = map.strided(self.stride, weight.shape[0]);
        let by_x = wanted[0].then(|| {
            let packed = weight.backwards(|| match self.stride {
                1 => self.pack_flipped(weight),
                _ => self.pack_transposed(weight),
            });
            let mut values = vec![0.0; x.values.len()];
            let images = values
                .par_chunks_mut(map.len())
                .zip(x.values.par_chunks(map.len()))
                .zip(gradient.par_chunks(out.len()));
            images.for_each(|((by_x, x), g)| {
                with_buffers(|buffers| {
                    let mut padded = std::mem::take(&mut buffers.padded);
                    if self.stride == 1 {
                        out.pad(g, false, &mut padded);
                        buffers.multiply(out.windows(&padded, 1), packed, map.channels, by_x);
                    } else {
                        spread(map, out, packed, g, &mut padded, buffers);
                        let row = map.columns * map.channels;
                        let from =
                            padded[(map.columns + 2) * map.channels..].chunks_exact((map.columns + 2) * map.channels);
                        for (to, from) in by_x.chunks_exact_mut(row).zip(from) {
                            to.copy_from_slice(&from[map.channels..map.channels + row]);
                        }
                    }
                    buffers.padded = padded;
                });
                self.mask(x, by_x);
            });
            x.like(values)
        });
        let size = 9 * map.channels * out.channels;
        let images = x.values.par_chunks(map.len()).zip(gradient.par_chunks(out.len()));
        let parts = images.map(|(x, g)| {
            let mut sums = vec![0.0; size + out.channels];
            let (by_weight, by_bias) = sums.split_at_mut(size);
            g.chunks_exact(out.channels).for_each(|pixel| add_to(by_bias, pixel));
            with_buffers(|buffers| self.by_weight(map, x, out, g, by_weight, buffers));
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
        [by_x, Some(weight.like(by_weight)), Some(bias.like(by_bias))]
    }
}

impl Convolution {
    /// Computes the gradient of an image by the weights, `[place in the window, input, output]`.
    fn by_weight(self, map: Map, x: &[f32], out: Map, g: &[f32], by_weight: &mut [f32], buffers: &mut ProductBuffers) {
        let planes = Planes::new(out, self.stride);
        planes.fill(map, x, self.relu, &mut buffers.padded);
        buffers.shared.load(self.instructions, &buffers.padded, planes.len);
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
            buffers.multiply_shared(&packed, first, planes.len, map.channels, out.channels, by_weight);
        }
    }

    /// Sets the gradients by rectified inputs to zero.
    fn mask(self, x: &[f32], by_x: &mut [f32]) {
        if self.relu {
            by_x.iter_mut().zip(x).filter(|(_, x)| **x <= 0.0).for_each(|(by_x, _)| *by_x = 0.0);
        }
    }
}

/// Computes the gradient by a padded map at stride 2: the gradient of each output is added to its window.
fn spread(map: Map, out: Map, packed: &Packed, g: &[f32], padded: &mut Vec<f32>, buffers: &mut ProductBuffers) {
    let (pitch, window) = ((map.columns + 2) * map.channels, 3 * map.channels);
    padded.clear();
    padded.resize((map.rows + 2) * pitch, 0.0);
    let mut row = vec![0.0; out.columns * 3 * window];
    for (i, g) in g.chunks_exact(out.columns * out.channels).enumerate() {
        buffers.multiply(Left::rows(g, out.channels), packed, 3 * window, &mut row);
        for (j, windows) in row.chunks_exact(3 * window).enumerate() {
            for (dy, part) in windows.chunks_exact(window).enumerate() {
                add_to(&mut padded[(2 * i + dy) * pitch + 2 * j * map.channels..][..window], part);
            }
        }
    }
}
