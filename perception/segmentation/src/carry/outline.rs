//! From what speaks for the object at each pixel to its mask.

use std::collections::VecDeque;

use ndarray::Array2;

use super::pixels::{Pixels, beside, pixels, region, step_m};
use super::{GROWTH_PX, KNOWN};
use crate::colours::Colours;

/// Fewer pixels that hang together are a speck.
const SPECK_PX: usize = 8;
/// Pixels without depth that are as near to the object as this may show it, pixels.
const HOLE_PX: usize = 3;
/// A pixel beside the object belongs to it if no more than this speaks against it.
const GROWS_ABOVE: f32 = -0.2;
/// How much a pixel beside one weighs that surely belongs to the object, if their colours are the same.
const TOGETHER: f32 = 1.0;
/// Difference of colours of one surface, levels.
const LIKE_LEVELS: f32 = 25.0;
/// Repetitions until scores hardly change.
const SMOOTHINGS: usize = 10;

/// Removes regions that are too small, and those apart from the best known one in whose place the object was seldom seen.
pub fn drop_specks(mask: &mut Array2<bool>, evidence: &Array2<f32>) {
    let dim = mask.dim();
    let mut left = mask.clone();
    let mut regions: Vec<Vec<(usize, usize)>> = Vec::new();
    for (start, _) in mask.indexed_iter().filter(|(_, inside)| **inside) {
        if !std::mem::replace(&mut left[start], false) {
            continue;
        }
        regions.push(region(start, dim, |_, other| std::mem::replace(&mut left[other], false)));
    }
    let known = |region: &Vec<(usize, usize)>| region.iter().map(|at| evidence[*at]).sum::<f32>();
    let best = regions.iter().map(known).max_by(f32::total_cmp).unwrap_or(0.0);
    for region in regions {
        let (known, count) = (known(&region), region.len());
        if count < SPECK_PX || known < best && known < KNOWN * count as f32 {
            region.iter().for_each(|at| mask[*at] = false);
        }
    }
}

/// Scores of pixels in the light of those beside them: pixels of like colour at like depth belong together. Mean field of a conditional random
/// field whose unary terms are half the scores (Kraehenbuehl and Koltun 2011, with the nearest neighbours alone).
pub fn smoothed(seen: &Pixels<'_>, near: [usize; 4], scores: &Array2<f32>) -> Array2<f32> {
    let dim = scores.dim();
    let alike = |at: (usize, usize), other: (usize, usize)| {
        let continues = seen.depth_m(at).zip(seen.depth_m(other)).is_some_and(|(a, b)| (a - b).abs() < step_m(a));
        let differ = match seen.colour(at).zip(seen.colour(other)) {
            Some((a, b)) => (0..3).map(|k| f32::from(a[k].abs_diff(b[k])).powi(2)).sum::<f32>(),
            None => 0.0,
        };
        if continues { TOGETHER * (-differ / (2.0 * LIKE_LEVELS * LIKE_LEVELS)).exp() } else { 0.0 }
    };
    type Pixel = (usize, usize);
    let links: Vec<(Pixel, [(Pixel, f32); 4])> = pixels(near)
        .filter(|at| scores[*at].is_finite())
        .map(|at| {
            let mut links = [(at, 0.0); 4];
            for (link, other) in links.iter_mut().zip(beside(at, dim)) {
                if scores[other].is_finite() {
                    *link = (other, alike(at, other));
                }
            }
            (at, links)
        })
        .collect();
    let mut smoothed = scores.clone();
    for _ in 0..SMOOTHINGS {
        let before = smoothed.mapv(|score| (0.5 * score).tanh());
        for (at, links) in &links {
            smoothed[*at] = scores[*at] + links.iter().map(|(other, weight)| weight * before[*other]).sum::<f32>();
        }
    }
    smoothed
}

/// Adds pixels that continue the surface of the mask and that speak for the object. Returns the pixels that continue it and of which it is open
/// whose they are. Both lie where the object may be, as `opens` says.
pub fn grow(seen: &Pixels<'_>, scores: &Array2<f32>, opens: &Array2<bool>, mask: &mut Array2<bool>) -> Array2<bool> {
    let dim = mask.dim();
    let mut contested = Array2::from_elem(dim, false);
    let mut edge: VecDeque<((usize, usize), usize)> =
        mask.indexed_iter().filter(|(_, inside)| **inside).map(|(at, _)| (at, 0)).collect();
    while let Some((at, steps)) = edge.pop_front() {
        let Some(depth_m) = seen.depth_m(at).filter(|_| steps < GROWTH_PX) else { continue };
        for other in beside(at, dim) {
            let continues = || seen.depth_m(other).is_some_and(|other_m| (other_m - depth_m).abs() < step_m(depth_m));
            if mask[other] || contested[other] || !opens[other] || !continues() {
                continue;
            }
            let is_object = scores[other] > GROWS_ABOVE && mask[at];
            if is_object {
                mask[other] = true;
            } else {
                contested[other] = true;
            }
            edge.push_back((other, steps + 1));
        }
    }
    contested
}

/// Adds pixels without depth inside of the mask, and those beside it that have the object's colours.
pub fn fill(seen: &Pixels<'_>, colours: &Colours, near: [usize; 4], mask: &mut Array2<bool>) {
    for _ in 0..HOLE_PX {
        let before = mask.clone();
        for at in pixels(near).filter(|at| !before[*at]) {
            let around = beside(at, before.dim()).filter(|other| before[*other]).count();
            if around == 0 {
                continue;
            }
            let is_like = seen.colour(at).is_some_and(|colour| colours.log_odds(colour) > 0.5);
            let is_hole = seen.depth_m(at).is_none();
            mask[at] = around == 4 || is_hole && (around == 3 || is_like);
        }
    }
}

/// Means over squares that reach `reach` pixels.
pub fn blurred(image: &Array2<f32>, reach: usize) -> Array2<f32> {
    let along = |image: &Array2<f32>| {
        let (rows, columns) = image.dim();
        let mut result = Array2::zeros((columns, rows));
        for v in 0..rows {
            for u in 0..columns {
                let (from, to) = (u.saturating_sub(reach), (u + reach + 1).min(columns));
                let sum: f32 = (from..to).map(|u| image[(v, u)]).sum();
                result[(u, v)] = sum / (to - from) as f32;
            }
        }
        result
    };
    along(&along(image))
}
