//! Layer norm, depth to space, and other ops without matrices.

use rayon::prelude::*;

use crate::lanes::total;
use crate::tape::{Inputs, Kernel, Slopes};
use mvt_touch::network::{LAYER_NORM_EPS, WeightTensor};

/// Rows that are normalised together; rows are summed per block, in a fixed order.
const BLOCK: usize = 512;

/// Layer norm over the last axis; inputs x, weight, bias.
#[derive(Debug, Clone)]
pub struct Norm;

/// Returns mean and reciprocal standard deviation of a row.
fn moments(row: &[f32]) -> (f32, f32) {
    let count = row.len() as f32;
    let mean = row.iter().sum::<f32>() / count;
    let variance = row.iter().map(|x| (x - mean) * (x - mean)).sum::<f32>() / count;
    (mean, 1.0 / (variance + LAYER_NORM_EPS).sqrt())
}

impl Kernel<3> for Norm {
    type Kept = ();

    fn forward(&self, [x, weight, bias]: Inputs<'_, 3>) -> (WeightTensor, ()) {
        let width = weight.values.len();
        let mut values = vec![0.0; x.values.len()];
        values.par_chunks_mut(BLOCK * width).zip(x.values.par_chunks(BLOCK * width)).for_each(|(y, x)| {
            for (y, x) in y.chunks_exact_mut(width).zip(x.chunks_exact(width)) {
                let (mean, scale) = moments(x);
                for (((y, x), weight), bias) in y.iter_mut().zip(x).zip(weight.values).zip(bias.values) {
                    *y = (x - mean) * scale * weight + bias;
                }
            }
        });
        (x.like(values), ())
    }

    fn backward(&self, [x, weight, bias]: Inputs<'_, 3>, (): &(), gradient: &[f32], _: [bool; 3]) -> Slopes<3> {
        let width = weight.values.len();
        let mut values = vec![0.0; x.values.len()];
        let size = BLOCK * width;
        let blocks = values.par_chunks_mut(size).zip(x.values.par_chunks(size)).zip(gradient.par_chunks(size));
        let parts = blocks.map(|((by_x, x), g)| {
            let mut sums = vec![0.0; 2 * width];
            let (by_weight, by_bias) = sums.split_at_mut(width);
            let rows = by_x.chunks_exact_mut(width).zip(x.chunks_exact(width)).zip(g.chunks_exact(width));
            for ((by_x, x), g) in rows {
                let (mean, scale) = moments(x);
                let (mut sum, mut along) = (0.0, 0.0);
                for i in 0..width {
                    let unit = (x[i] - mean) * scale;
                    by_weight[i] += g[i] * unit;
                    by_bias[i] += g[i];
                    by_x[i] = g[i] * weight.values[i];
                    sum += by_x[i];
                    along += by_x[i] * unit;
                }
                let (sum, along) = (sum / width as f32, along / width as f32);
                for (by_x, x) in by_x.iter_mut().zip(x) {
                    *by_x = scale * (*by_x - sum - (x - mean) * scale * along);
                }
            }
            sums
        });
        let mut sums = total(parts.collect(), 2 * width);
        let by_bias = sums.split_off(width);
        [Some(x.like(values)), Some(weight.like(sums)), Some(bias.like(by_bias))]
    }
}

/// Greater of a number and zero.
#[derive(Debug, Clone)]
pub struct Relu;

impl Kernel<1> for Relu {
    type Kept = ();

    fn forward(&self, [x]: Inputs<'_, 1>) -> (WeightTensor, ()) {
        let values = x.values.iter().map(|x| x.max(0.0)).collect();
        (x.like(values), ())
    }

    fn backward(&self, [x]: Inputs<'_, 1>, (): &(), gradient: &[f32], _: [bool; 1]) -> Slopes<1> {
        let values = x.values.iter().zip(gradient).map(|(x, g)| if *x > 0.0 { *g } else { 0.0 }).collect();
        [Some(x.like(values))]
    }
}

/// Product of each channel, the last axis, with a number; inputs x and the numbers.
#[derive(Debug, Clone)]
pub struct Scale;

impl Kernel<2> for Scale {
    type Kept = ();

    fn forward(&self, [x, scale]: Inputs<'_, 2>) -> (WeightTensor, ()) {
        (x.like(x.values.iter().zip(scale.values.iter().cycle()).map(|(x, scale)| x * scale).collect()), ())
    }

    fn backward(&self, [x, scale]: Inputs<'_, 2>, (): &(), gradient: &[f32], _: [bool; 2]) -> Slopes<2> {
        let values = gradient.iter().zip(scale.values.iter().cycle()).map(|(g, scale)| g * scale).collect();
        let mut by_scale = vec![0.0; scale.values.len()];
        let size = scale.values.len();
        for (x, g) in x.values.chunks_exact(size).zip(gradient.chunks_exact(size)) {
            by_scale.iter_mut().zip(x.iter().zip(g)).for_each(|(sum, (x, g))| *sum += x * g);
        }
        [Some(x.like(values)), Some(scale.like(by_scale))]
    }
}

/// Depth to space by this factor: channel `(dy s + dx) C + c` at (i, j) becomes channel c at (s i + dy, s j + dx).
#[derive(Debug, Clone)]
pub struct DepthToSpace(pub usize);

impl DepthToSpace {
    /// Returns the runs of channels that stay together: the index in the coarse map and the index in the fine map.
    fn runs([rows, columns]: [usize; 2], factor: usize, channels: usize) -> impl Iterator<Item = (usize, usize)> {
        (0..rows * factor).flat_map(move |y| {
            (0..columns * factor).map(move |x| {
                let place = (y % factor) * factor + x % factor;
                let pixel = (y / factor) * columns + x / factor;
                ((pixel * factor * factor + place) * channels, (y * columns * factor + x) * channels)
            })
        })
    }
}

impl Kernel<1> for DepthToSpace {
    type Kept = ();

    fn forward(&self, [x]: Inputs<'_, 1>) -> (WeightTensor, ()) {
        let [images, rows, columns, deep] = x.sides();
        let channels = deep / (self.0 * self.0);
        let mut values = vec![0.0; x.values.len()];
        let image = rows * columns * deep;
        values.par_chunks_mut(image).zip(x.values.par_chunks(image)).for_each(|(y, x)| {
            for (coarse, fine) in Self::runs([rows, columns], self.0, channels) {
                y[fine..fine + channels].copy_from_slice(&x[coarse..coarse + channels]);
            }
        });
        (WeightTensor { shape: vec![images, rows * self.0, columns * self.0, channels], values }, ())
    }

    fn backward(&self, [x]: Inputs<'_, 1>, (): &(), gradient: &[f32], _: [bool; 1]) -> Slopes<1> {
        let [_, rows, columns, deep] = x.sides();
        let channels = deep / (self.0 * self.0);
        let mut values = vec![0.0; x.values.len()];
        let image = rows * columns * deep;
        values.par_chunks_mut(image).zip(gradient.par_chunks(image)).for_each(|(by_x, g)| {
            for (coarse, fine) in Self::runs([rows, columns], self.0, channels) {
                by_x[coarse..coarse + channels].copy_from_slice(&g[fine..fine + channels]);
            }
        });
        [Some(x.like(values))]
    }
}
