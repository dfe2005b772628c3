//! Synthetic untouched images like those of a real DIGIT.

use image::RgbImage;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Pool of one LED's light on the gel, in shares of the image's width and height.
struct Pool {
    /// Grey levels that it adds to red, green and blue at its centre.
    color: [f32; 3],
    centre: [f32; 2],
    radius: [f32; 2],
}

/// Light that all real sensors have in common: red enters from the left, green from the right, blue from below, and the
/// far end of the gel is dim.
const POOLS: [Pool; 4] = [
    Pool { color: [172.0, 10.0, 16.0], centre: [0.14, 0.42], radius: [0.34, 0.27] },
    Pool { color: [14.0, 62.0, -14.0], centre: [0.80, 0.45], radius: [0.27, 0.26] },
    Pool { color: [6.0, 4.0, 62.0], centre: [0.40, 0.80], radius: [0.36, 0.27] },
    Pool { color: [22.0, 22.0, 32.0], centre: [0.40, 0.02], radius: [0.45, 0.16] },
];
/// Ambient light, grey levels.
const AMBIENT: [f32; 3] = [24.0, 74.0, 58.0];
/// Mean colour of an untouched image, grey levels.
const MEAN: [f32; 3] = [93.0, 98.0, 92.0];
/// Unevenness of the gel's paint, grey levels from the mean, over patches of [`PATCH`] pixels.
const UNEVENNESS: f32 = 2.0;
/// Size of a patch of paint, pixels.
const PATCH: usize = 4;

/// Returns an untouched image like that of a real DIGIT, of this width and height. Each seed is another sensor: positions
/// and brightness of the LEDs and the paint of the gel differ.
pub fn synthetic_background([width, height]: [usize; 2], seed: u64) -> RgbImage {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut around = |value: f32, spread: f32| value + spread * (2.0 * rng.random::<f32>() - 1.0);
    let pools = POOLS.map(|pool| Pool {
        color: pool.color.map(|c| c * around(1.0, 0.15)),
        centre: pool.centre.map(|c| around(c, 0.05)),
        radius: pool.radius.map(|r| r * around(1.0, 0.12)),
    });
    let mean = MEAN.map(|m| around(m, 6.0));
    let columns = width / PATCH + 2;
    let paint: Vec<f32> = (0..columns * (height / PATCH + 2)).map(|_| around(0.0, UNEVENNESS)).collect();

    let light = |u: usize, v: usize| -> [f32; 3] {
        let at = [(u as f32 + 0.5) / width as f32, (v as f32 + 0.5) / height as f32];
        let corner = (v / PATCH) * columns + u / PATCH;
        let [s, t] = [u, v].map(|i| (i % PATCH) as f32 / PATCH as f32);
        let upper = paint[corner] * (1.0 - s) + paint[corner + 1] * s;
        let lower = paint[corner + columns] * (1.0 - s) + paint[corner + columns + 1] * s;
        let mut color = AMBIENT.map(|a| a + upper * (1.0 - t) + lower * t);
        for Pool { color: added, centre, radius } in &pools {
            let [x, y] = [0, 1].map(|k| (at[k] - centre[k]) / radius[k]);
            let share = (-0.5 * (x * x + y * y)).exp();
            for (c, a) in color.iter_mut().zip(added) {
                *c += a * share;
            }
        }
        color
    };
    let pixels: Vec<[f32; 3]> = (0..width * height).map(|i| light(i % width, i / width)).collect();
    let gain: [f32; 3] =
        std::array::from_fn(|c| mean[c] * pixels.len() as f32 / pixels.iter().map(|p| p[c]).sum::<f32>());
    RgbImage::from_fn(width as u32, height as u32, |u, v| {
        let pixel = pixels[v as usize * width + u as usize];
        image::Rgb(std::array::from_fn(|c| (pixel[c] * gain[c]).round() as u8))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_repeat_differ_and_keep_the_mean() {
        let (a, b) = (synthetic_background([240, 320], 1), synthetic_background([240, 320], 2));
        assert_eq!(a, synthetic_background([240, 320], 1));
        assert_ne!(a, b);
        let small = synthetic_background([97, 62], 1);
        assert_eq!(small.dimensions(), (97, 62));
        for image in [a, b, small] {
            for c in 0..3 {
                let mean =
                    image.pixels().map(|p| f32::from(p.0[c])).sum::<f32>() / (image.width() * image.height()) as f32;
                assert!((mean - MEAN[c]).abs() < 7.0, "channel {c}: {mean}");
            }
        }
    }
}
