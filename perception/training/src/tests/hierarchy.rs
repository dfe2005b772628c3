//! Ops of `swin` and `convnext`.

use mvt_touch::network::{ShiftedWindows, relative_position, squares};

use super::{check, places, random, sixteenths};
use crate::attention::WindowAttention;
use crate::depthwise::Depthwise;
use crate::pointwise::Scale;
use crate::tokens::Gather;
use mvt_products::Instructions;

#[test]
fn depthwise() {
    // Maps narrower than a window, channels that fill vectors and that do not.
    for (instructions, [rows, columns, channels, side]) in Instructions::available()
        .flat_map(|set| [[3, 10, 3, 7], [5, 4, 17, 3], [2, 9, 16, 5]].map(|sizes| (set, sizes)))
    {
        let inputs = [
            sixteenths(&[2, rows, columns, channels], 40),
            sixteenths(&[channels, side, side], 41),
            sixteenths(&[channels], 42),
        ];
        check(Depthwise { instructions }, inputs, |[x, w, b]| {
            let value = |(n, i, j, c): (usize, usize, usize, usize)| {
                let tap = |(_, _, dy, dx): (usize, usize, usize, usize)| {
                    let (v, u) = ((i + dy).checked_sub(side / 2)?, (j + dx).checked_sub(side / 2)?);
                    let inside = v < rows && u < columns;
                    inside.then(|| w[(c * side + dy) * side + dx] * x[((n * rows + v) * columns + u) * channels + c])
                };
                b[c] + places(1, 1, side, side).filter_map(tap).sum::<f64>()
            };
            places(2, rows, columns, channels).map(value).collect()
        });
    }
}

#[test]
fn scale() {
    check(Scale, [random(&[3, 4, 5], 43), random(&[5], 44)], |[x, scale]| {
        x.iter().enumerate().map(|(k, x)| x * scale[k % 5]).collect()
    });
}

#[test]
fn gather() {
    // Tokens that are wanted twice, once, not at all, and none.
    let tokens = [Some(2), None, Some(0), Some(2), Some(3)];
    check(Gather { tokens: tokens.into() }, [random(&[2, 4, 3], 45)], |[x]| {
        let value =
            |(_, n, t, c): (usize, usize, usize, usize)| tokens[t].map_or(0.0, |token| x[(n * 4 + token) * 3 + c]);
        places(1, 2, 5, 3).map(value).collect()
    });
    let joined: Vec<usize> = squares([2, 4]).into_iter().flatten().collect();
    assert_eq!(joined, [0, 1, 4, 5, 2, 3, 6, 7]);
}

#[test]
fn window_attention() {
    let (heads, size, side, images) = (2, 3, 2, 2);
    let (width, count) = (heads * size, side * side);
    let ShiftedWindows { tokens, regions } = ShiftedWindows::new([3, 3], side, true);
    let windows = tokens.len() / count;
    let table = random(&[(2 * side - 1) * (2 * side - 1), heads], 47);
    let kernel = WindowAttention { heads, side, regions: regions.clone().into() };
    check(kernel, [random(&[images * windows, count, 3 * width], 46), table], |[qkv, table]| {
        let at = |n: usize, t: usize, part: usize, c: usize| qkv[(n * count + t) * 3 * width + part * width + c];
        let value = |(n, t, h, c): (usize, usize, usize, usize)| {
            let region = |t: usize| regions[n % windows * count + t];
            let score = |s: usize| {
                let product: f64 = (0..size).map(|c| at(n, t, 0, h * size + c) * at(n, s, 1, h * size + c)).sum();
                (product / (size as f64).sqrt() + table[relative_position(side, t, s) * heads + h]).exp()
            };
            let seen: Vec<usize> = (0..count).filter(|&s| region(s) == region(t)).collect();
            let sum: f64 = seen.iter().map(|&s| score(s)).sum();
            seen.iter().map(|&s| score(s) / sum * at(n, s, 2, h * size + c)).sum()
        };
        places(images * windows, count, heads, size).map(value).collect()
    });
}
