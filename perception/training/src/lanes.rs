//! Sixteen channels side by side, and sums of slices. Plain loops, which become vector instructions where the caller is compiled for
//! them.

/// Channels that are computed together.
pub const LANES: usize = 16;

/// One number per channel.
pub type Lanes = [f32; LANES];

/// Adds a slice to another.
pub fn add_to(sum: &mut [f32], terms: &[f32]) {
    for (sum, term) in sum.iter_mut().zip(terms) {
        *sum += term;
    }
}

/// Returns the sum of the parts, added in their order.
pub fn total(parts: Vec<Vec<f32>>, len: usize) -> Vec<f32> {
    parts.into_iter().fold(vec![0.0; len], |mut sum, part| {
        add_to(&mut sum, &part);
        sum
    })
}

/// Returns the lanes of `row[at..]`, zeros past its end.
#[inline(always)]
pub fn load(row: &[f32], at: usize) -> Lanes {
    match row[at..].first_chunk() {
        Some(lanes) => *lanes,
        None => std::array::from_fn(|j| row.get(at + j).copied().unwrap_or(0.0)),
    }
}

/// Writes lanes to `row[at..]`, up to its end.
#[inline(always)]
pub fn store(row: &mut [f32], at: usize, lanes: Lanes) {
    match row[at..].first_chunk_mut() {
        Some(place) => *place = lanes,
        None => row[at..].iter_mut().zip(lanes).for_each(|(place, lane)| *place = lane),
    }
}

/// Computes lane by lane.
#[inline(always)]
pub fn each(f: impl Fn(usize) -> f32) -> Lanes {
    let mut lanes = [0.0; LANES];
    for j in 0..LANES {
        lanes[j] = f(j);
    }
    lanes
}

/// Returns e to the power of each lane, to 3e-7 + 1e-7 |x| of the result; the result is never less than 2e-38.
#[inline(always)]
pub fn exp(x: Lanes) -> Lanes {
    // Adding this rounds to a whole number, which is then in the low bits.
    const ROUND: f32 = 12_582_912.0;
    each(|j| {
        let x = (x[j] * std::f32::consts::LOG2_E).clamp(-125.4, 127.0);
        let shifted = x + ROUND;
        let f = x - (shifted - ROUND);
        let mut p = 1.540_353e-4_f32;
        for c in [1.333_355_8e-3, 9.618_129e-3, 5.550_411e-2, 2.402_265e-1, std::f32::consts::LN_2, 1.0] {
            p = p.mul_add(f, c);
        }
        p * f32::from_bits((shifted.to_bits() << 23).wrapping_add(127 << 23))
    })
}

/// Returns 1 / (1 + e^-x) of each lane.
#[inline(always)]
pub fn sigmoid(x: Lanes) -> Lanes {
    let e = exp(each(|j| -x[j]));
    each(|j| 1.0 / (1.0 + e[j]))
}

/// Returns ln(1 + e^x) of each lane, to 1e-6 + 1e-7 |x| of the result.
#[inline(always)]
pub fn softplus(x: Lanes) -> Lanes {
    let e = exp(each(|j| -x[j].abs()));
    each(|j| {
        // ln(1 + e) = 2 artanh(e / (2 + e)), whose argument is 1/3 at most.
        let s = e[j] / (2.0 + e[j]);
        let square = s * s;
        let mut p: f32 = 1.0 / 15.0;
        for c in [1.0 / 13.0, 1.0 / 11.0, 1.0 / 9.0, 1.0 / 7.0, 1.0 / 5.0, 1.0 / 3.0, 1.0] {
            p = p.mul_add(square, c);
        }
        x[j].max(0.0) + 2.0 * s * p
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn functions_are_exact_to_a_few_ulps() {
        for k in -7900..7900 {
            let x = k as f32 * 0.0107;
            let [y, ..] = exp([x; LANES]);
            let exact = f64::from(x).exp();
            let bound = (3e-7 + 1e-7 * f64::from(x.abs())) * exact;
            assert!((f64::from(y) - exact).abs() <= bound, "{x}: {y} for {exact}");
        }
        for k in -3000..3000 {
            let x = k as f32 * 0.0107;
            let [y, ..] = softplus([x; LANES]);
            let exact = f64::from(x).exp().ln_1p();
            assert!((f64::from(y) - exact).abs() <= (1e-6 + 1e-7 * f64::from(x.abs())) * exact, "{x}: {y} for {exact}");
        }
        assert!(exp([-1e9; LANES])[0] < 3e-38 && exp([1e9; LANES])[0].is_finite());
    }
}
