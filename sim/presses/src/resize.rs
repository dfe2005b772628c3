//! Images of other sizes: a training learns coarse structure from small ones at a lower cost.

use crate::example::Example;

/// Brings an example to another size; each pixel becomes the mean over the area that it covers.
pub fn resized(example: Example, [rows, columns]: [usize; 2]) -> Example {
    if example.size == [rows, columns] {
        return example;
    }
    let (down, across) = (cover(example.size[0], rows), cover(example.size[1], columns));
    let image = |of: &dyn Fn(usize) -> f32| -> Vec<f32> {
        // Rows first, so that only one row is kept at a time.
        let mut resized = Vec::with_capacity(rows * columns);
        for parts in &down {
            let mut row = vec![0.0; example.size[1]];
            for &(v, share) in parts {
                row.iter_mut().enumerate().for_each(|(u, sum)| *sum += share * of(v * example.size[1] + u));
            }
            resized.extend(across.iter().map(|parts| parts.iter().map(|&(u, share)| share * row[u]).sum::<f32>()));
        }
        resized
    };
    let colours: [Vec<f32>; 3] = std::array::from_fn(|c| image(&|i| f32::from(example.levels[3 * i + c])));
    let levels = (0..3 * rows * columns).map(|k| colours[k % 3][k / 3].round() as u8).collect();
    let (indentation_mm, contact) = (image(&|i| example.indentation_mm[i]), image(&|i| example.contact[i]));
    Example { size: [rows, columns], levels, untouched: None, indentation_mm, contact }
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
