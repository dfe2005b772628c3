//! TACTO's image noise.

/// Key of the noise of one image. The same key gives the same noise on every machine, in any order of rendering.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct NoiseKey {
    /// Seed of the episode.
    pub seed: u64,
    /// Index of the pad.
    pub pad: u32,
    /// Number of the frame.
    pub frame: u32,
}

/// Gaussian noise on an 8-bit image by TACTO's formula: trunc(clip(c + N(0, sigma), 0, 255)).
///
/// The colour c is an integer, so this is c plus the integer floor(N(0, sigma)), saturated. One table holds the
/// distribution, whose mean is half a grey level below 0.
pub(super) struct Noise {
    /// floor(N(0, sigma)) at each of 2^16 equally likely quantiles.
    quantiles: Box<[i8; QUANTILES]>,
}

/// Greatest sigma, grey levels: every quantile fits the table's `i8`.
pub(super) const SIGMA_MAX: f32 = 28.0;

/// Entries of the table: one for each value of 16 random bits.
const QUANTILES: usize = 1 << 16;

impl Noise {
    /// Builds the table for `sigma` in grey levels, more than 0 and at most [`SIGMA_MAX`].
    pub fn new(sigma: f32) -> Self {
        let sigma = f64::from(sigma);
        let mut quantiles = Box::new([i8::MAX; QUANTILES]);
        let mut start = 0;
        // Level n takes the share of the normal distribution between n and n + 1.
        for n in i8::MIN..i8::MAX {
            let end = (normal_cdf((f64::from(n) + 1.0) / sigma) * QUANTILES as f64).round() as usize;
            quantiles[start..end].fill(n);
            start = end;
        }
        Self { quantiles }
    }

    /// Adds noise to every byte of an image.
    #[inline(always)]
    pub fn add(&self, key: NoiseKey, image: &mut [u8]) {
        let stream = mix(mix(key.seed) ^ (u64::from(key.pad) << 32 | u64::from(key.frame)));
        let (blocks, rest) = image.as_chunks_mut::<BLOCK>();
        let whole = blocks.len();
        for (block, bytes) in blocks.iter_mut().enumerate() {
            self.add_block(stream, block, bytes);
        }
        // Blocks of one length become SIMD: the last bytes are completed to one.
        let mut last = [0; BLOCK];
        let (begin, _) = last.split_at_mut(rest.len());
        begin.copy_from_slice(rest);
        self.add_block(stream, whole, &mut last);
        rest.copy_from_slice(&last[..rest.len()]);
    }

    /// Adds noise to a block of an image. One 64-bit hash gives four draws; hashes and sums become SIMD in loops of their own.
    #[inline(always)]
    fn add_block(&self, stream: u64, block: usize, bytes: &mut [u8; BLOCK]) {
        let mut hashes = [0; BLOCK / 4];
        for (k, hash) in hashes.iter_mut().enumerate() {
            let counter = (block * (BLOCK / 4) + k + 1) as u64;
            *hash = mix(stream.wrapping_add(counter.wrapping_mul(GOLDEN)));
        }
        let mut draws = [0; BLOCK];
        for (draws, hash) in draws.as_chunks_mut::<4>().0.iter_mut().zip(hashes) {
            *draws = std::array::from_fn(|k| self.quantiles[usize::from((hash >> (16 * k)) as u16)]);
        }
        for (byte, draw) in bytes.iter_mut().zip(draws) {
            *byte = byte.saturating_add_signed(draw);
        }
    }
}

/// Bytes that get their noise together; the last ones of an image may be fewer.
const BLOCK: usize = 256;

/// Increment of SplitMix64: 2^64 over the golden ratio.
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// The finaliser of SplitMix64 (Steele, Lea and Flood 2014): a bijection whose every output bit depends on every input
/// bit.
#[inline(always)]
fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Returns the distribution function of the standard normal to 1e-10, by the series and the continued fraction of the
/// error function (Abramowitz and Stegun 7.1.6 and 7.1.14).
fn normal_cdf(x: f64) -> f64 {
    let density = (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt();
    if x.abs() < 3.0 {
        // 1/2 + density (x + x^3/3 + x^5/15 + ...)
        let (mut term, mut sum) = (x, x);
        for k in 1..60 {
            term *= x * x / f64::from(2 * k + 1);
            sum += term;
        }
        0.5 + density * sum
    } else {
        let fraction = (1..80).rev().fold(x.abs(), |tail, k| x.abs() + f64::from(k) / tail);
        let tail = density / fraction;
        if x > 0.0 { 1.0 - tail } else { tail }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_cdf_at_tabulated_points() {
        for (x, p) in [(0.0, 0.5), (1.0, 0.841_344_746_1), (-1.96, 0.024_997_895_1), (3.5, 0.999_767_370_9)] {
            assert!((normal_cdf(x) - p).abs() < 1e-9, "{x}: {}", normal_cdf(x));
        }
    }

    #[test]
    fn moments_are_those_of_a_truncated_gaussian() {
        for sigma in [2.0, 7.0, SIGMA_MAX] {
            let q = Noise::new(sigma).quantiles;
            let mean = q.iter().map(|&n| f64::from(n)).sum::<f64>() / QUANTILES as f64;
            let variance = q.iter().map(|&n| (f64::from(n) - mean).powi(2)).sum::<f64>() / QUANTILES as f64;
            // Rounding down adds the variance 1/12 of a uniform variable, nearly independent of the noise.
            let expected = f64::from(sigma).powi(2) + 1.0 / 12.0;
            assert!((mean + 0.5).abs() < 2e-3, "sigma {sigma}: mean {mean}");
            assert!((variance / expected - 1.0).abs() < 0.005, "sigma {sigma}: variance {variance}, not {expected}");
        }
    }

    #[test]
    fn draws_are_repeatable_uncorrelated_and_different_for_every_key() {
        let noise = Noise::new(7.0);
        let draw = |seed, pad, frame| {
            let mut image = vec![128; 240 * 320 * 3];
            noise.add(NoiseKey { seed, pad, frame }, &mut image);
            image
        };
        let (a, again) = (draw(1, 2, 3), draw(1, 2, 3));
        assert_eq!(a, again);
        for other in [draw(2, 2, 3), draw(1, 3, 3), draw(1, 2, 4), draw(1, 3, 2)] {
            assert!(correlation(&a, &other).abs() < 0.01);
        }
        for lag in [1, 3, 4, 720] {
            assert!(correlation(&a[lag..], &a[..a.len() - lag]).abs() < 0.01, "lag {lag}");
        }
    }

    fn correlation(a: &[u8], b: &[u8]) -> f64 {
        let centred = |x: u8| f64::from(x) - 127.5;
        let sum = |f: &dyn Fn(f64, f64) -> f64| a.iter().zip(b).map(|(&x, &y)| f(centred(x), centred(y))).sum::<f64>();
        sum(&|x, y| x * y) / (sum(&|x, _| x * x) * sum(&|_, y| y * y)).sqrt()
    }

    #[test]
    fn saturates_at_both_ends() {
        let mut image = [0, 255].repeat(BLOCK);
        Noise::new(2.0).add(NoiseKey { seed: 0, pad: 0, frame: 0 }, &mut image);
        assert!(image.iter().all(|&c| !(30..=225).contains(&c)), "{image:?}");
    }
}
