//! Images of other sizes: a training learns coarse structure from small ones at a lower cost.

use crate::backdrop::grey_level;
use crate::example::Example;

/// Brings an example to another size; each pixel becomes the mean over the area that it covers.
pub fn resized(example: Example, [rows, columns]: [usize; 2]) -> Example {
    if example.size == [rows, columns] {
        return example;
    }
    let width = example.size[1];
    let covers = [cover(example.size[0], rows), cover(width, columns)];
    let levels = means::<3, u8>(&example.levels, width, &covers);
    Example {
        size: [rows, columns],
        levels: levels.as_flattened().iter().map(|&level| grey_level(level)).collect(),
        untouched: None,
        indentation_mm: means::<1, f32>(&example.indentation_mm, width, &covers).into_flattened(),
        contact: means::<1, f32>(&example.contact, width, &covers).into_flattened(),
    }
}

/// Returns the means over the areas of `covers` (down and across) of an image with `N` channels in each pixel.
fn means<const N: usize, T: Copy + Into<f32>>(
    pixels: &[T],
    width: usize,
    [down, across]: &[Vec<Vec<(usize, f32)>>; 2],
) -> Vec<[f32; N]> {
    let (pixels, _) = pixels.as_chunks::<N>();
    let mut means = Vec::with_capacity(down.len() * across.len());
    let mut sums = vec![[0.0; N]; width];
    for parts in down {
        // Rows first, so that only one row is kept at a time.
        sums.fill([0.0; N]);
        for &(v, share) in parts {
            for (sums, pixel) in sums.iter_mut().zip(&pixels[v * width..]) {
                for (sum, &level) in sums.iter_mut().zip(pixel) {
                    *sum += share * level.into();
                }
            }
        }
        for parts in across {
            let mut mean = [0.0; N];
            for &(u, share) in parts {
                for (mean, sum) in mean.iter_mut().zip(sums[u]) {
                    *mean += share * sum;
                }
            }
            means.push(mean);
        }
    }
    means
}

/// For each of `to` pixels, returns the pixels among `from` that it covers and the share of each in the mean.
fn cover(from: usize, to: usize) -> Vec<Vec<(usize, f32)>> {
    let width = from as f32 / to as f32;
    let parts = |i: usize| {
        let (begin, end) = (i as f32 * width, (i + 1) as f32 * width);
        let places = begin as usize..(end.ceil() as usize).min(from);
        let overlap = |k: usize| (end.min((k + 1) as f32) - begin.max(k as f32)).max(0.0);
        places.map(|k| (k, overlap(k) / width)).collect()
    };
    (0..to).map(parts).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_pixel_of_a_resized_image_is_the_mean_over_its_area() {
        let whole = Example {
            size: [4, 6],
            levels: (0..4 * 6 * 3).map(|i| (i * 3) as u8).collect(),
            untouched: None,
            indentation_mm: (0..24).map(|i| i as f32).collect(),
            contact: vec![1.0; 24],
        };
        assert_eq!(resized(whole.clone(), [4, 6]), whole);
        let half = resized(whole.clone(), [2, 3]);
        assert_eq!(half.indentation_mm[..3], [3.5, 5.5, 7.5]);
        // Six columns to four: each covers one and a half.
        let narrow = resized(whole, [4, 4]);
        assert!((narrow.indentation_mm[0] - (0.0 + 0.5) / 1.5).abs() < 1e-6, "{:?}", &narrow.indentation_mm[..4]);
        assert!(narrow.contact.iter().all(|c| (c - 1.0).abs() < 1e-6));
    }
}
