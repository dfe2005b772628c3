//! Ops that put tokens together, and the activation of the token networks.

use super::linear::{add_to, total};
use super::tape::{Kernel, View};
use crate::network::Tensor;

/// Adds a table `[tokens, width]` to the tokens of every image `[images, tokens, width]`.
#[derive(Debug, Clone)]
pub struct AddTable;

impl Kernel<2> for AddTable {
    type Kept = ();

    fn forward(&self, [x, table]: [View<'_>; 2]) -> (Tensor, ()) {
        let values = x.values.iter().zip(table.values.iter().cycle()).map(|(x, t)| x + t).collect();
        (Tensor { shape: x.shape.to_vec(), values }, ())
    }

    fn backward(&self, [x, table]: [View<'_>; 2], (): &(), gradient: View<'_>, _: [bool; 2]) -> [Option<Tensor>; 2] {
        let mut sum = vec![0.0; table.values.len()];
        gradient.values.chunks_exact(sum.len()).for_each(|image| add_to(&mut sum, image));
        [
            Some(Tensor { shape: x.shape.to_vec(), values: gradient.values.to_vec() }),
            Some(Tensor { shape: table.shape.to_vec(), values: sum }),
        ]
    }
}

/// Puts one more token `[1, width]` behind those of every image.
#[derive(Debug, Clone)]
pub struct Append;

impl Kernel<2> for Append {
    type Kept = ();

    fn forward(&self, [x, last]: [View<'_>; 2]) -> (Tensor, ()) {
        let &[images, tokens, width] = x.shape else { unreachable!("tokens have three axes") };
        let values = x.values.chunks_exact(tokens * width).flat_map(|image| image.iter().chain(last.values)).copied();
        (Tensor { shape: vec![images, tokens + 1, width], values: values.collect() }, ())
    }

    fn backward(&self, [x, last]: [View<'_>; 2], (): &(), gradient: View<'_>, _: [bool; 2]) -> [Option<Tensor>; 2] {
        let (tokens, width) = (x.shape[1], x.shape[2]);
        let images = gradient.values.chunks_exact((tokens + 1) * width);
        let (by_x, by_last): (Vec<_>, Vec<_>) =
            images.map(|g| (&g[..tokens * width], g[tokens * width..].to_vec())).unzip();
        [
            Some(Tensor { shape: x.shape.to_vec(), values: by_x.concat() }),
            Some(Tensor { shape: last.shape.to_vec(), values: total(by_last, width) }),
        ]
    }
}

/// Each token with the last one of its image beside it: `[images, tokens + 1, width]` to `[images, tokens, 2 width]`.
#[derive(Debug, Clone)]
pub struct WithLast;

impl Kernel<1> for WithLast {
    type Kept = ();

    fn forward(&self, [x]: [View<'_>; 1]) -> (Tensor, ()) {
        let &[images, tokens, width] = x.shape else { unreachable!("tokens have three axes") };
        let mut values = Vec::with_capacity(2 * x.values.len());
        for image in x.values.chunks_exact(tokens * width) {
            let (tokens, last) = image.split_at((tokens - 1) * width);
            tokens.chunks_exact(width).for_each(|token| values.extend(token.iter().chain(last)));
        }
        (Tensor { shape: vec![images, tokens - 1, 2 * width], values }, ())
    }

    fn backward(&self, [x]: [View<'_>; 1], (): &(), gradient: View<'_>, _: [bool; 1]) -> [Option<Tensor>; 1] {
        let (tokens, width) = (x.shape[1], x.shape[2]);
        let mut values = Vec::with_capacity(x.values.len());
        for image in gradient.values.chunks_exact((tokens - 1) * 2 * width) {
            let mut by_last = vec![0.0; width];
            for pair in image.chunks_exact(2 * width) {
                values.extend(&pair[..width]);
                add_to(&mut by_last, &pair[width..]);
            }
            values.extend(by_last);
        }
        [Some(Tensor { shape: x.shape.to_vec(), values })]
    }
}

/// Squares of `factor` x `factor` pixels as tokens: `[images, rows, columns, channels]` to
/// `[images, rows / factor, columns / factor, factor * factor * channels]`, pixel by pixel. Of an input only: it has no gradient.
pub fn space_to_depth(x: &Tensor, factor: usize) -> Tensor {
    let &[images, rows, columns, channels] = x.shape.as_slice() else { unreachable!("a map has four axes") };
    let mut values = Vec::with_capacity(x.values.len());
    for top in (0..images * rows).step_by(factor) {
        for left in (0..columns).step_by(factor) {
            for row in top..top + factor {
                values.extend(&x.values[(row * columns + left) * channels..][..factor * channels]);
            }
        }
    }
    Tensor { shape: vec![images, rows / factor, columns / factor, factor * factor * channels], values }
}

/// Two maps of one channel as a map of two.
#[derive(Debug, Clone)]
pub struct Pair;

impl Kernel<2> for Pair {
    type Kept = ();

    fn forward(&self, [a, b]: [View<'_>; 2]) -> (Tensor, ()) {
        let mut shape = a.shape.to_vec();
        shape.pop();
        shape.push(2);
        (Tensor { shape, values: a.values.iter().zip(b.values).flat_map(|(a, b)| [*a, *b]).collect() }, ())
    }

    fn backward(&self, [a, b]: [View<'_>; 2], (): &(), gradient: View<'_>, _: [bool; 2]) -> [Option<Tensor>; 2] {
        let (by_a, by_b) = gradient.values.as_chunks::<2>().0.iter().map(|[a, b]| (*a, *b)).unzip();
        [Some(Tensor { shape: a.shape.to_vec(), values: by_a }), Some(Tensor { shape: b.shape.to_vec(), values: by_b })]
    }
}

/// `x` times the normal distribution function of x.
#[derive(Debug, Clone)]
pub struct Gelu;

/// The normal distribution function by Abramowitz and Stegun 7.1.26, to 1e-7, and its density.
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

    fn forward(&self, [x]: [View<'_>; 1]) -> (Tensor, ()) {
        (Tensor { shape: x.shape.to_vec(), values: x.values.iter().map(|&x| x * normal(x).0).collect() }, ())
    }

    fn backward(&self, [x]: [View<'_>; 1], (): &(), gradient: View<'_>, _: [bool; 1]) -> [Option<Tensor>; 1] {
        let slope = |(&x, g): (&f32, &f32)| {
            let (below, density) = normal(x);
            g * (below + x * density)
        };
        let values = x.values.iter().zip(gradient.values).map(slope).collect();
        [Some(Tensor { shape: x.shape.to_vec(), values })]
    }
}
