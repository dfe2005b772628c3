//! Exponentials and the activations that use them, lane by lane.

use pulp::Simd;

/// Returns a b + c, rounded once where the machine has an instruction for it.
#[inline(always)]
pub fn multiply_add<S: Simd>(simd: S, a: S::f32s, b: S::f32s, c: S::f32s) -> S::f32s {
    // With the four lanes of `Instructions::Scalar`, a fused operation would be a call of the C library per lane.
    if S::F32_LANES == 4 { simd.add_f32s(simd.mul_f32s(a, b), c) } else { simd.mul_add_e_f32s(a, b, c) }
}

/// Returns 2^x to a relative error of 4e-7, for any `x` up to 127; below -126 the result is 2^-126, which stands for zero.
#[inline(always)]
pub fn exp2<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    // Adding 1.5 * 2^23 leaves no bits for a fraction: the sum's low bits are the nearest whole number.
    const ROUND: f32 = 12_582_912.0;
    let splat = |x| simd.splat_f32s(x);
    let x = simd.max_f32s(x, splat(-126.0));
    let shifted = simd.add_f32s(x, splat(ROUND));
    let fraction = simd.sub_f32s(x, simd.sub_f32s(shifted, splat(ROUND)));
    // 2^f on [-0.5, 0.5]: a polynomial through 1 fitted at Chebyshev nodes, to 2e-7.
    let mut p = splat(1.339_086_7e-3);
    for c in [9.666_374e-3, 5.550_357e-2, 2.402_235e-1, 6.931_472e-1, 1.0] {
        p = multiply_add(simd, p, fraction, splat(c));
    }
    let exponent = simd.wrapping_dyn_shl_u32s(simd.transmute_u32s_f32s(shifted), simd.splat_u32s(23));
    simd.transmute_f32s_u32s(simd.add_u32s(simd.transmute_u32s_f32s(p), exponent))
}

/// Returns e^x; see [`exp2`] for the error and the range.
#[inline(always)]
pub fn exp<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    exp2(simd, simd.mul_f32s(x, simd.splat_f32s(std::f32::consts::LOG2_E)))
}

/// Returns 1 / (1 + e^-x).
#[inline(always)]
pub fn sigmoid<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let one = simd.splat_f32s(1.0);
    // e^88 is the greatest whole power that fits in an f32.
    let power = exp(simd, simd.min_f32s(simd.neg_f32s(x), simd.splat_f32s(87.0)));
    simd.div_f32s(one, simd.add_f32s(one, power))
}

/// Returns x sigmoid(x).
#[inline(always)]
pub fn silu<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    simd.mul_f32s(x, sigmoid(simd, x))
}

/// Returns ln(1 + e^x) = max(x, 0) + ln(1 + e^-|x|); the series of 2 artanh gives the logarithm.
#[inline(always)]
pub fn softplus<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let splat = |x| simd.splat_f32s(x);
    let power = exp(simd, simd.neg_f32s(simd.abs_f32s(x)));
    let t = simd.div_f32s(power, simd.add_f32s(power, splat(2.0)));
    let t2 = simd.mul_f32s(t, t);
    let mut p = splat(2.0 / 13.0);
    for c in [2.0 / 11.0, 2.0 / 9.0, 2.0 / 7.0, 0.4, 2.0 / 3.0, 2.0] {
        p = multiply_add(simd, p, t2, splat(c));
    }
    multiply_add(simd, p, t, simd.max_f32s(x, splat(0.0)))
}

/// Returns x Phi(x) with the normal distribution's Phi. The error function is that of Abramowitz and Stegun, 7.1.26 (absolute error
/// 1.5e-7).
#[inline(always)]
pub fn gelu<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let splat = |x| simd.splat_f32s(x);
    let one = splat(1.0);
    let z = simd.mul_f32s(simd.abs_f32s(x), splat(std::f32::consts::FRAC_1_SQRT_2));
    let t = simd.div_f32s(one, multiply_add(simd, splat(0.327_591_1), z, one));
    let mut p = splat(1.061_405_4);
    for c in [-1.453_152, 1.421_413_7, -0.284_496_74, 0.254_829_6] {
        p = multiply_add(simd, p, t, splat(c));
    }
    let tail = simd.mul_f32s(simd.mul_f32s(p, t), exp(simd, simd.neg_f32s(simd.mul_f32s(z, z))));
    // Half of |x| (1 - tail) + x: Phi(-|x|) = tail / 2.
    let even = simd.mul_f32s(simd.abs_f32s(x), simd.sub_f32s(one, tail));
    simd.mul_f32s(splat(0.5), simd.add_f32s(x, even))
}

#[cfg(test)]
mod tests {
    use super::super::Instructions;
    use super::*;
    use pulp::WithSimd;

    struct Map<'a, F>(F, &'a mut [f32]);

    /// Function of a vector; closures cannot be generic.
    trait Function {
        fn call<S: Simd>(&self, simd: S, x: S::f32s) -> S::f32s;
    }

    impl<F: Function> WithSimd for Map<'_, F> {
        type Output = ();

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            for x in S::as_mut_simd_f32s(self.1).0 {
                *x = self.0.call(simd, *x);
            }
        }
    }

    macro_rules! check {
        ($function:ident, $exact:expr, $low:expr, $high:expr, $absolute:expr, $relative:expr) => {{
            struct It;
            impl Function for It {
                #[inline(always)]
                fn call<S: Simd>(&self, simd: S, x: S::f32s) -> S::f32s {
                    $function(simd, x)
                }
            }
            let at: Vec<f32> = (0..4096).map(|k| $low + ($high - $low) * k as f32 / 4095.0).collect();
            for set in Instructions::available() {
                let mut values = at.clone();
                set.run(Map(It, &mut values));
                for (&x, &value) in at.iter().zip(&values) {
                    let exact: f64 = $exact(f64::from(x));
                    let bound = $absolute + $relative * exact.abs();
                    let error = (f64::from(value) - exact).abs();
                    assert!(error <= bound, "{}({x}) = {value}, not {exact} ({set:?})", stringify!($function));
                }
            }
        }};
    }

    #[test]
    fn functions_are_those_of_the_standard_library() {
        check!(exp2, |x: f64| x.exp2(), -125.9f32, 126.0f32, 0.0, 4e-7);
        // The argument's own rounding grows with it.
        check!(exp, |x: f64| x.exp(), -80.0f32, 80.0f32, 0.0, 8e-6);
        check!(sigmoid, |x: f64| 1.0 / (1.0 + (-x).exp()), -30.0f32, 30.0f32, 0.0, 3e-6);
        check!(silu, |x: f64| x / (1.0 + (-x).exp()), -30.0f32, 30.0f32, 0.0, 3e-6);
        check!(softplus, |x: f64| x.exp().ln_1p(), -30.0f32, 30.0f32, 1e-7, 3e-6);
        // The normal distribution by its series.
        let phi = |x: f64| {
            let (mut term, mut sum, mut n) = (x, x, 1.0);
            while term.abs() > 1e-20 {
                n += 2.0;
                term *= x * x / n;
                sum += term;
            }
            0.5 + sum * (-x * x / 2.0).exp() / (2.0 * std::f64::consts::PI).sqrt()
        };
        check!(gelu, |x: f64| x * phi(x), -6.0f32, 6.0f32, 2e-6, 1e-6);
    }

    #[test]
    fn extremes_stay_finite() {
        check!(sigmoid, |x: f64| 1.0 / (1.0 + (-x).exp()), -3e4f32, 3e4f32, 1e-30, 3e-6);
        check!(softplus, |x: f64| if x > 50.0 { x } else { x.exp().ln_1p() }, -3e4f32, 3e4f32, 1e-7, 3e-6);
    }
}
