//! TACTO's calibration: the change that contact makes in the rendered image is halved, blurred and added to a real
//! sensor's image.
//!
//! OpenCV blurs with the fixed kernel [2, 7, 14, 18, 14, 7, 2] / 64 along both axes. All of it is a multiple of 2^-13,
//! so integers give TACTO's floating-point result to the bit.

use std::ops::Range;

/// Half of OpenCV's 7-tap kernel for the window (7, 7) and sigma 0, from the centre outwards, times 64.
const KERNEL: [i16; 4] = [18, 14, 7, 2];
/// Reach of the kernel.
pub(super) const REACH: usize = KERNEL.len() - 1;
/// The two passes scale by 64 each, the factor 0.5 by another 2.
const SHIFT: u32 = 13;

/// Rows of an image after the horizontal pass.
#[derive(Default)]
pub(super) struct Blur {
    rows: Vec<i16>,
    padded: Vec<i16>,
    zero: Vec<i16>,
}

impl Blur {
    /// Overwrites the rows of `out` that differ from `background`: those within the kernel's reach of `changed`, the
    /// only rows in which `raw` differs from `empty`. All are images of this width of RGB pixels.
    #[inline(always)]
    pub fn overlay(
        &mut self,
        width: usize,
        changed: Range<usize>,
        [raw, empty, background]: [&[u8]; 3],
        out: &mut [u8],
    ) {
        let (length, height) = (3 * width, out.len() / (3 * width));
        self.rows.resize(length * height, 0);
        self.padded.resize(length + 6 * REACH, 0);
        self.zero.resize(length, 0);
        let row = |v: usize| v * length..(v + 1) * length;
        for v in changed.clone() {
            self.horizontal(&raw[row(v)], &empty[row(v)], v);
        }
        let [k0, k1, k2, k3] = KERNEL.map(i32::from);
        for v in changed.start.saturating_sub(REACH)..(changed.end + REACH).min(height) {
            let taps: [&[i16]; 7] = std::array::from_fn(|k| {
                let at = mirrored(v as isize + k as isize - REACH as isize, height);
                if changed.contains(&at) { &self.rows[row(at)] } else { &self.zero[..length] }
            });
            // Slices of one length, so that the loop has no checks of bounds.
            let (out, under) = (&mut out[row(v)][..length], &background[row(v)][..length]);
            let [a, b, c, d, e, f, g] = taps.map(|row| &row[..length]);
            for i in 0..length {
                let [a, b, c, d, e, f, g] = [a[i], b[i], c[i], d[i], e[i], f[i], g[i]].map(i32::from);
                let sum = k0 * d + k1 * (c + e) + k2 * (b + f) + k3 * (a + g);
                let value = (i32::from(under[i]) << SHIFT) + sum;
                out[i] = (value.clamp(0, 255 << SHIFT) >> SHIFT) as u8;
            }
        }
    }

    /// Blurs the difference of row `v` along the row, times 64; fits 16 bits because the kernel's weights add up to 64.
    #[inline(always)]
    fn horizontal(&mut self, raw: &[u8], empty: &[u8], v: usize) {
        let (length, width) = (raw.len(), raw.len() / 3);
        let (padded, out) = (&mut self.padded[..length + 6 * REACH], &mut self.rows[v * length..(v + 1) * length]);
        for ((padded, raw), empty) in padded[3 * REACH..].iter_mut().zip(raw).zip(empty) {
            *padded = i16::from(*raw) - i16::from(*empty);
        }
        for k in 1..=REACH {
            for c in 0..3 {
                padded[3 * (REACH - k) + c] = padded[3 * (REACH + k) + c];
                padded[3 * (REACH + width - 1 + k) + c] = padded[3 * (REACH + width - 1 - k) + c];
            }
        }
        let [k0, k1, k2, k3] = KERNEL;
        let [a, b, c, d, e, f, g] = std::array::from_fn(|k| &padded[3 * k..3 * k + length]);
        let out = &mut out[..length];
        for i in 0..length {
            out[i] = k0 * d[i] + k1 * (c[i] + e[i]) + k2 * (b[i] + f[i]) + k3 * (a[i] + g[i]);
        }
    }
}

/// Returns the row or column for an index beyond the border. OpenCV's default mirrors the image at its outermost pixels
/// (`BORDER_REFLECT_101`).
fn mirrored(i: isize, size: usize) -> usize {
    let last = size as isize - 1;
    (last - (last - i.abs()).abs()) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 240;
    const HEIGHT: usize = 320;
    const ROW: usize = 3 * WIDTH;

    #[test]
    fn border_mirrors_at_the_outermost_pixel() {
        assert_eq!([-3, -1, 0, 319, 320, 322].map(|i| mirrored(i, 320)), [3, 1, 0, 319, 318, 316]);
    }

    /// A direct two-dimensional sum in f64 as the oracle, with changes in the middle and in all corners.
    #[test]
    fn overlay_is_the_blurred_half_difference() {
        let byte = |i: usize, salt: u64| ((i as u64 + 1).wrapping_mul(salt) >> 40) as u8;
        let image = |salt| (0..ROW * HEIGHT).map(|i| byte(i, salt)).collect::<Vec<u8>>();
        let (empty, background, mut raw) = (image(0x9e37_79b9_7f4a_7c15), image(0xbf58_476d_1ce4_e5b9), vec![]);
        for changed in [0..9, 150..160, 310..320, 0..320] {
            raw.clone_from(&empty);
            for v in changed.clone() {
                for i in 0..ROW {
                    raw[v * ROW + i] = byte(v * ROW + i, 0x94d0_49bb_1331_11eb);
                }
            }
            let mut out = background.clone();
            Blur::default().overlay(WIDTH, changed, [&raw, &empty, &background], &mut out);
            for (v, u, c) in
                (0..HEIGHT).step_by(3).flat_map(|v| (0..WIDTH).step_by(7).map(move |u| (v, u, (u + v) % 3)))
            {
                let mut sum = 0.0;
                for (dv, du) in (-3..=3_isize).flat_map(|dv| (-3..=3_isize).map(move |du| (dv, du))) {
                    let (row, col) = (mirrored(v as isize + dv, HEIGHT), mirrored(u as isize + du, WIDTH));
                    let i = row * ROW + 3 * col + c;
                    let weight = f64::from(KERNEL[dv.unsigned_abs()]) * f64::from(KERNEL[du.unsigned_abs()]) / 4096.0;
                    sum += weight * 0.5 * (f64::from(raw[i]) - f64::from(empty[i]));
                }
                let i = v * ROW + 3 * u + c;
                assert_eq!(out[i], (sum + f64::from(background[i])).clamp(0.0, 255.0) as u8, "({u}, {v}, {c})");
            }
        }
    }
}
