//! 3 x 3 convolutions as matrix products over shifted rows.
//!
//! A row of three pixels' channels is contiguous in a padded map, so that each row of the window is one product, whose left matrix
//! is the map itself read with overlapping rows.

use rayon::prelude::*;

use super::linear::{add_product, add_to, matrix, matrix_mut, total};
use super::tape::{Kernel, View};
use crate::network::Tensor;

/// Pixels that are multiplied together, about: their results fit the cache.
const BLOCK: usize = 1024;

/// 3 x 3 correlation with zeros around the map and bias; inputs x `[images, rows, columns, in]`, W `[out, in, 3, 3]`, b `[out]`.
#[derive(Debug, Clone, Copy)]
pub struct Convolution {
    /// 1 or 2. With 2, output (i, j) is centred on input (2 i, 2 j).
    pub stride: usize,
    /// Whether negative inputs count as zero.
    pub relu: bool,
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

    /// Length of a padded row.
    fn pitch(self) -> usize {
        (self.columns + 2) * self.channels
    }

    /// The map with a ring of zeros, and room for the last window to overlap, in `padded`.
    fn pad(self, values: &[f32], relu: bool, padded: &mut Vec<f32>) {
        let (row, pitch) = (self.columns * self.channels, self.pitch());
        padded.clear();
        padded.resize((self.rows + 2) * pitch + 2 * self.channels, 0.0);
        for (from, to) in values.chunks_exact(row).zip(padded[pitch..].chunks_exact_mut(pitch)) {
            let to = &mut to[self.channels..self.channels + row];
            if relu {
                to.iter_mut().zip(from).for_each(|(to, from)| *to = from.max(0.0));
            } else {
                to.copy_from_slice(from);
            }
        }
    }

    fn strided(self, stride: usize, channels: usize) -> Self {
        Self { rows: self.rows.div_ceil(stride), columns: self.columns.div_ceil(stride), channels }
    }
}

/// Weights as three matrices `[3 * in, out]`, one per row of the window; `flipped` swaps in and out and turns the window by 180
/// degrees, which makes the convolution its own transpose.
fn window_rows(weight: View<'_>, flipped: bool) -> [Vec<f32>; 3] {
    let (outputs, inputs) = (weight.shape[0], weight.shape[1]);
    let (from, to) = if flipped { (outputs, inputs) } else { (inputs, outputs) };
    std::array::from_fn(|dy| {
        let mut row = vec![0.0; 3 * inputs * outputs];
        for (dx, taps) in row.chunks_exact_mut(from * to).enumerate() {
            let tap = if flipped { 8 - (3 * dy + dx) } else { 3 * dy + dx };
            for (f, taps) in taps.chunks_exact_mut(to).enumerate() {
                for (t, value) in taps.iter_mut().enumerate() {
                    let (o, i) = if flipped { (f, t) } else { (t, f) };
                    *value = weight.values[(o * inputs + i) * 9 + tap];
                }
            }
        }
        row
    })
}

/// The convolution of stride 1 of a padded map, plus `bias`, into `out`.
fn correlate(map: Map, padded: &[f32], rows: &[Vec<f32>; 3], bias: &[f32], block: &mut Vec<f32>, out: &mut [f32]) {
    let (outputs, width) = (bias.len(), map.columns + 2);
    let rows_at_once = (BLOCK / width).max(1);
    for (k, out) in out.chunks_mut(rows_at_once * map.columns * outputs).enumerate() {
        let height = out.len() / (map.columns * outputs);
        block.clear();
        block.resize(height * width * outputs, 0.0);
        block.chunks_exact_mut(outputs).for_each(|pixel| pixel.copy_from_slice(bias));
        for (dy, weights) in rows.iter().enumerate() {
            let start = (k * rows_at_once + dy) * map.pitch();
            let windows = matrix(&padded[start..], [height * width, 3 * map.channels], [map.channels, 1]);
            add_product(
                windows,
                matrix(weights, [3 * map.channels, outputs], [outputs, 1]),
                &mut matrix_mut(block, outputs),
            );
        }
        // The two last windows of each row straddle its end and mean nothing.
        for (to, from) in out.chunks_exact_mut(map.columns * outputs).zip(block.chunks_exact(width * outputs)) {
            to.copy_from_slice(&from[..to.len()]);
        }
    }
}

/// The windows of output row `i` and window row `dy` at stride 2.
fn strided_windows(map: Map, padded: &[f32], i: usize, dy: usize) -> ndarray::ArrayView2<'_, f32> {
    let start = (2 * i + dy) * map.pitch();
    let shape = [map.columns.div_ceil(2), 3 * map.channels];
    matrix(&padded[start..start + map.pitch()], shape, [2 * map.channels, 1])
}

impl Kernel<3> for Convolution {
    type Kept = ();

    fn forward(&self, [x, weight, bias]: [View<'_>; 3]) -> (Tensor, ()) {
        let map = Map::new(x.shape);
        let out = map.strided(self.stride, weight.shape[0]);
        let rows = window_rows(weight, false);
        let mut values = vec![0.0; x.shape[0] * out.len()];
        let images = values.par_chunks_mut(out.len()).zip(x.values.par_chunks(map.len()));
        images.for_each_init(
            || (Vec::new(), Vec::new()),
            |(padded, block), (y, x)| {
                map.pad(x, self.relu, padded);
                if self.stride == 1 {
                    return correlate(map, padded, &rows, bias.values, block, y);
                }
                for (i, y) in y.chunks_exact_mut(out.columns * out.channels).enumerate() {
                    y.chunks_exact_mut(out.channels).for_each(|pixel| pixel.copy_from_slice(bias.values));
                    for (dy, weights) in rows.iter().enumerate() {
                        let weights = matrix(weights, [3 * map.channels, out.channels], [out.channels, 1]);
                        add_product(strided_windows(map, padded, i, dy), weights, &mut matrix_mut(y, out.channels));
                    }
                }
            },
        );
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
            let mut values = vec![0.0; x.values.len()];
            let images = values
                .par_chunks_mut(map.len())
                .zip(x.values.par_chunks(map.len()))
                .zip(gradient.values.par_chunks(out.len()));
            if self.stride == 1 {
                let (rows, no_bias) = (window_rows(weight, true), vec![0.0; map.channels]);
                images.for_each_init(
                    || (Vec::new(), Vec::new()),
                    |(padded, block), ((by_x, x), g)| {
                        out.pad(g, false, padded);
                        correlate(out, padded, &rows, &no_bias, block, by_x);
                        self.mask(x, by_x);
                    },
                );
            } else {
                let rows = window_rows(weight, false);
                images.for_each_init(
                    || (Vec::new(), Vec::new()),
                    |(padded, block), ((by_x, x), g)| {
                        spread(map, out, &rows, g, padded, block);
                        let row = map.columns * map.channels;
                        let from = padded[map.pitch()..].chunks_exact(map.pitch());
                        for (to, from) in by_x.chunks_exact_mut(row).zip(from) {
                            to.copy_from_slice(&from[map.channels..map.channels + row]);
                        }
                        self.mask(x, by_x);
                    },
                );
            }
            Tensor { shape: x.shape.to_vec(), values }
        });
        let size = 9 * map.channels * out.channels;
        let images = x.values.par_chunks(map.len()).zip(gradient.values.par_chunks(out.len()));
        let parts = images.map_init(
            || (Vec::new(), Vec::new()),
            |(padded, spread), (x, g)| {
                map.pad(x, self.relu, padded);
                let mut sums = vec![0.0; size + out.channels];
                let (by_rows, by_bias) = sums.split_at_mut(size);
                g.chunks_exact(out.channels).for_each(|pixel| add_to(by_bias, pixel));
                let mut by_rows: Vec<&mut [f32]> = by_rows.chunks_exact_mut(size / 3).collect();
                if self.stride == 1 {
                    // The gradient with the map's padded pitch, so that its pixels meet their windows.
                    out.pad(g, false, spread);
                    let count = out.rows * (out.columns + 2) - 2;
                    let start = out.pitch() + out.channels;
                    let g = matrix(&spread[start..], [count, out.channels], [out.channels, 1]);
                    for (dy, by_row) in by_rows.iter_mut().enumerate() {
                        let windows = &padded[dy * map.pitch()..];
                        let transposed = matrix(windows, [3 * map.channels, count], [1, map.channels]);
                        add_product(transposed, g, &mut matrix_mut(by_row, out.channels));
                    }
                } else {
                    for (i, g) in g.chunks_exact(out.columns * out.channels).enumerate() {
                        let g = matrix(g, [out.columns, out.channels], [out.channels, 1]);
                        for (dy, by_row) in by_rows.iter_mut().enumerate() {
                            let windows = strided_windows(map, padded, i, dy);
                            add_product(windows.reversed_axes(), g, &mut matrix_mut(by_row, out.channels));
                        }
                    }
                }
                sums
            },
        );
        let mut sums = total(parts.collect(), size + out.channels);
        let by_bias = sums.split_off(size);
        let mut by_weight = vec![0.0; size];
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
    /// No gradient reaches what counted as zero.
    fn mask(self, x: &[f32], by_x: &mut [f32]) {
        if self.relu {
            by_x.iter_mut().zip(x).filter(|(_, x)| **x <= 0.0).for_each(|(by_x, _)| *by_x = 0.0);
        }
    }
}

/// The gradient by a padded map at stride 2: each output's gradient goes to its window.
fn spread(map: Map, out: Map, rows: &[Vec<f32>; 3], g: &[f32], padded: &mut Vec<f32>, block: &mut Vec<f32>) {
    padded.clear();
    padded.resize((map.rows + 2) * map.pitch(), 0.0);
    for (i, g) in g.chunks_exact(out.columns * out.channels).enumerate() {
        let g = matrix(g, [out.columns, out.channels], [out.channels, 1]);
        for (dy, weights) in rows.iter().enumerate() {
            block.clear();
            block.resize(out.columns * 3 * map.channels, 0.0);
            let transposed = matrix(weights, [out.channels, 3 * map.channels], [1, out.channels]);
            add_product(g, transposed, &mut matrix_mut(block, 3 * map.channels));
            let start = (2 * i + dy) * map.pitch();
            for (j, window) in block.chunks_exact(3 * map.channels).enumerate() {
                add_to(&mut padded[start + 2 * j * map.channels..][..window.len()], window);
            }
        }
    }
}
