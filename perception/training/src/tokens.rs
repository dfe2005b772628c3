//! Ops that combine tokens, and the activation of the token networks.

use std::sync::Arc;

use crate::batch::TrainingImages;
use crate::lanes::{add_to, total};
use crate::tape::{Inputs, Kernel, Slopes};
use mvt_touch::network::WeightTensor;

/// Adds a table `[tokens, width]` to the tokens of every image `[images, tokens, width]`.
#[derive(Debug, Clone)]
pub struct AddTable;

impl Kernel<2> for AddTable {
    type Kept = ();

    fn forward(&self, [x, table]: Inputs<'_, 2>) -> (WeightTensor, ()) {
        let values = x.values.iter().zip(table.values.iter().cycle()).map(|(x, t)| x + t).collect();
        (x.like(values), ())
    }

    fn backward(&self, [x, table]: Inputs<'_, 2>, (): &(), gradient: &[f32], _: [bool; 2]) -> Slopes<2> {
        let mut sum = vec![0.0; table.values.len()];
        gradient.chunks_exact(sum.len()).for_each(|image| add_to(&mut sum, image));
        [Some(x.like(gradient.to_vec())), Some(table.like(sum))]
    }
}

/// Appends a token `[1, width]` to the tokens of every image.
#[derive(Debug, Clone)]
pub struct Append;

impl Kernel<2> for Append {
    type Kept = ();

    fn forward(&self, [x, last]: Inputs<'_, 2>) -> (WeightTensor, ()) {
        let [images, tokens, width] = x.sides();
        let values = x.values.chunks_exact(tokens * width).flat_map(|image| image.iter().chain(last.values)).copied();
        (WeightTensor { shape: vec![images, tokens + 1, width], values: values.collect() }, ())
    }

    fn backward(&self, [x, last]: Inputs<'_, 2>, (): &(), gradient: &[f32], _: [bool; 2]) -> Slopes<2> {
        let (tokens, width) = (x.shape[1], x.shape[2]);
        let images = gradient.chunks_exact((tokens + 1) * width);
        let (by_x, by_last): (Vec<_>, Vec<_>) =
            images.map(|g| (&g[..tokens * width], g[tokens * width..].to_vec())).unzip();
        [Some(x.like(by_x.concat())), Some(last.like(total(by_last, width)))]
    }
}

/// Pairs each token with the last one of its image: `[images, tokens + 1, width]` to `[images, tokens, 2 width]`.
#[derive(Debug, Clone)]
pub struct WithLast;

impl Kernel<1> for WithLast {
    type Kept = ();

    fn forward(&self, [x]: Inputs<'_, 1>) -> (WeightTensor, ()) {
        let [images, tokens, width] = x.sides();
        let mut values = Vec::with_capacity(2 * x.values.len());
        for image in x.values.chunks_exact(tokens * width) {
            let (tokens, last) = image.split_at((tokens - 1) * width);
            tokens.chunks_exact(width).for_each(|token| values.extend(token.iter().chain(last)));
        }
        (WeightTensor { shape: vec![images, tokens - 1, 2 * width], values }, ())
    }

    fn backward(&self, [x]: Inputs<'_, 1>, (): &(), gradient: &[f32], _: [bool; 1]) -> Slopes<1> {
        let (tokens, width) = (x.shape[1], x.shape[2]);
        let mut values = Vec::with_capacity(x.values.len());
        for image in gradient.chunks_exact((tokens - 1) * 2 * width) {
            let mut by_last = vec![0.0; width];
            for pair in image.chunks_exact(2 * width) {
                values.extend(&pair[..width]);
                add_to(&mut by_last, &pair[width..]);
            }
            values.extend(by_last);
        }
        [Some(x.like(values))]
    }
}

/// Takes tokens of every image `[images, tokens, width]` by their indices, zeros for `None`.
#[derive(Debug, Clone)]
pub struct Gather {
    /// Index of each token of the result.
    pub tokens: Arc<[Option<usize>]>,
}

impl Kernel<1> for Gather {
    type Kept = ();

    fn forward(&self, [x]: Inputs<'_, 1>) -> (WeightTensor, ()) {
        let [images, count, width] = x.sides();
        let mut values = vec![0.0; images * self.tokens.len() * width];
        let results = values.chunks_exact_mut(self.tokens.len() * width);
        for (to, from) in results.zip(x.values.chunks_exact(count * width)) {
            for (to, token) in to.chunks_exact_mut(width).zip(&*self.tokens) {
                if let Some(token) = token {
                    to.copy_from_slice(&from[token * width..][..width]);
                }
            }
        }
        (WeightTensor { shape: vec![images, self.tokens.len(), width], values }, ())
    }

    fn backward(&self, [x]: Inputs<'_, 1>, (): &(), gradient: &[f32], _: [bool; 1]) -> Slopes<1> {
        let [_, count, width] = x.sides();
        let mut values = vec![0.0; x.values.len()];
        let images = values.chunks_exact_mut(count * width);
        for (to, from) in images.zip(gradient.chunks_exact(self.tokens.len() * width)) {
            for (from, token) in from.chunks_exact(width).zip(&*self.tokens) {
                if let Some(token) = token {
                    add_to(&mut to[token * width..][..width], from);
                }
            }
        }
        [Some(x.like(values))]
    }
}

/// Turns squares of `side` x `side` pixels into tokens, pixel by pixel: images into `[images, rows / side, columns / side,
/// side * side * 3]`, with levels from -1 to 1.
pub fn space_to_depth(TrainingImages { levels, shape }: TrainingImages<'_>, side: usize) -> WeightTensor {
    let [images, rows, columns] = shape;
    let mut values = Vec::with_capacity(levels.len());
    for top in (0..images * rows).step_by(side) {
        for left in (0..columns).step_by(side) {
            for row in top..top + side {
                let levels = &levels[(row * columns + left) * 3..][..side * 3];
                values.extend(levels.iter().map(|&level| from_level(level)));
            }
        }
    }
    WeightTensor { shape: vec![images, rows / side, columns / side, side * side * 3], values }
}

/// Returns a level of 0 to 255 as a number from -1 to 1.
fn from_level(level: u8) -> f32 {
    f32::from(level) / 127.5 - 1.0
}

/// Returns levels as numbers from -1 to 1, with the coordinates of the pixels as two more channels.
pub fn with_coordinates(TrainingImages { levels, shape: [images, rows, columns] }: TrainingImages<'_>) -> WeightTensor {
    let place = |i: usize, count: usize| 2.0 * (i as f32 + 0.5) / count as f32 - 1.0;
    let mut values = Vec::with_capacity(levels.len() / 3 * 5);
    for (k, pixel) in levels.as_chunks::<3>().0.iter().enumerate() {
        values.extend(pixel.map(from_level));
        values.extend([place(k % columns, columns), place(k / columns % rows, rows)]);
    }
    WeightTensor { shape: vec![images, rows, columns, 5], values }
}

/// Joins two maps of one channel to a map of two.
#[derive(Debug, Clone)]
pub struct Pair;

impl Kernel<2> for Pair {
    type Kept = ();

    fn forward(&self, [a, b]: Inputs<'_, 2>) -> (WeightTensor, ()) {
        let mut shape = a.shape.to_vec();
        shape.pop();
        shape.push(2);
        (WeightTensor { shape, values: a.values.iter().zip(b.values).flat_map(|(a, b)| [*a, *b]).collect() }, ())
    }

    fn backward(&self, [a, b]: Inputs<'_, 2>, (): &(), gradient: &[f32], _: [bool; 2]) -> Slopes<2> {
        let (by_a, by_b) = gradient.as_chunks::<2>().0.iter().map(|[a, b]| (*a, *b)).unzip();
        [Some(a.like(by_a)), Some(b.like(by_b))]
    }
}

/// Multiplies `x` by the normal distribution function of x.
#[derive(Debug, Clone)]
pub struct Gelu;

/// Returns the normal distribution function by Abramowitz and Stegun 7.1.26, to 1e-7, and its density.
fn normal(x: f32) -> (f32, f32) {
    let size = x.abs() * std::f32::consts::FRAC_1_SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * size);
    let p = [1.061_405_4, -1.453_152_1, 1.421_413_8, -0.284_496_74, 0.254_829_6_f32]
        .into_iter()
        .fold(0.0, |p, c| p * t + c);
    let bell = (-size * size).exp();
    let tail = 0.5 * p * t * bell;
    (if x >= 0.0 { 1.0 - tail } else { tail }, bell * 0.398_942_3)
}

impl Kernel<1> for Gelu {
    type Kept = ();

    fn forward(&self, [x]: Inputs<'_, 1>) -> (WeightTensor, ()) {
        (x.like(x.values.iter().map(|&x| x * normal(x).0).collect()), ())
    }

    fn backward(&self, [x]: Inputs<'_, 1>, (): &(), gradient: &[f32], _: [bool; 1]) -> Slopes<1> {
        let slope = |(&x, g): (&f32, &f32)| {
            let (below, density) = normal(x);
            g * (below + x * density)
        };
        let values = x.values.iter().zip(gradient).map(slope).collect();
        [Some(x.like(values))]
    }
}
