use super::*;
use proptest::prelude::*;

/// Small numbers without a pattern.
fn numbers(seed: u32, count: usize) -> Vec<f32> {
    let mut x = seed.wrapping_mul(2_654_435_761) | 1;
    let mut next = || {
        x ^= x << 13;
        x ^= x >> 17;
        x ^= x << 5;
        (x >> 8) as f32 / (1 << 23) as f32 - 1.0
    };
    (0..count).map(|_| next()).collect()
}

/// Sums in f64, one by one.
fn naive(left: &[f32], windows: Windows, segments: usize, length: usize, right: &[f32], columns: usize) -> Vec<f64> {
    let mut out = Vec::new();
    for row in 0..windows.rows {
        for column in 0..windows.columns {
            for n in 0..columns {
                let mut sum = 0.0;
                for segment in 0..segments {
                    let at =
                        windows.first + row * windows.pitch + column * windows.step + segment * windows.segment_pitch;
                    for k in 0..length {
                        sum += f64::from(left[at + k]) * f64::from(right[(segment * length + k) * columns + n]);
                    }
                }
                out.push(sum);
            }
        }
    }
    out
}

proptest! {
    #[test]
    fn products_are_those_of_the_definition(
        (rows, columns, segments, length) in (1..3usize, 1..70usize, 1..4usize, 1..40usize),
        (outputs, step, seed) in (1..70usize, 1..20usize, any::<u32>()),
        then in prop::sample::select(vec![Then::Store, Then::Add, Then::Relu]),
        rectified in any::<bool>(),
    ) {
        let step = 2 * step;
        let (segment_pitch, pitch) = (2 * length, 2 * (columns * step + segments * length));
        let windows = Windows { first: 2, step, pitch, columns, rows, segment_pitch };
        let left = numbers(seed, 2 + rows * pitch + segments * segment_pitch + columns * step);
        let right = numbers(seed ^ 1, segments * length * outputs);
        let bias = numbers(seed ^ 2, outputs);
        let seen: Vec<f32> = if rectified { left.iter().map(|x| x.max(0.0)).collect() } else { left.clone() };
        let exact = naive(&seen, windows, segments, length, &right, outputs);
        for set in Instructions::available() {
            let packed = Packed::new(set, segments, length, &bias, |k, n| right[k * outputs + n]);
            let wide = packed.outputs;
            let mut out = vec![0.5; 7 + rows * columns * wide];
            // Words of an earlier product must not matter.
            let mut words = vec![0x7fc0_7fc0; 10_000];
            let target = Target { data: &mut out, first: 7, step: wide, pitch: columns * wide, then };
            multiply(&packed, Left { data: &left, windows, rectified }, &mut words, target);
            // Each factor is rounded to 8 bits.
            let unit = if set.is_bf16() { 2.0 * 2.0_f64.powi(-8) } else { 1e-6 };
            let bound = unit * (segments * length) as f64 + 1e-6;
            for (window, exact) in exact.chunks(outputs).enumerate() {
                for n in 0..outputs {
                    let sum = exact[n] + f64::from(bias[n]);
                    let exact = match then {
                        Then::Add => sum + 0.5,
                        Then::Relu => sum.max(0.0),
                        _ => sum,
                    };
                    let found = f64::from(out[7 + window * wide + n]);
                    prop_assert!((found - exact).abs() < bound, "{set:?}: {found} is not {exact}");
                }
            }
            prop_assert!(out[..7].iter().all(|&x| x == 0.5), "values before the target are changed");
        }
    }
}

/// bf16 paths are exact where the operands are bf16.
#[test]
fn small_whole_numbers_are_exact() {
    let (columns, length, outputs) = (45, 48, 40);
    let left: Vec<f32> = (0..columns * length).map(|k| (k % 7) as f32 - 3.0).collect();
    let windows = Windows { first: 0, step: length, pitch: 0, columns, rows: 1, segment_pitch: 0 };
    let right: Vec<f32> = (0..length * outputs).map(|k| (k % 5) as f32 - 2.0).collect();
    let exact = naive(&left, windows, 1, length, &right, outputs);
    for set in Instructions::available() {
        let packed = Packed::new(set, 1, length, &vec![0.0; outputs], |k, n| right[k * outputs + n]);
        let mut out = vec![0.0; columns * packed.outputs];
        let target = Target { data: &mut out, first: 0, step: packed.outputs, pitch: 0, then: Then::Store };
        multiply(&packed, Left { data: &left, windows, rectified: false }, &mut Vec::new(), target);
        for (window, exact) in exact.chunks(outputs).enumerate() {
            let found: Vec<f64> = out[window * packed.outputs..][..outputs].iter().map(|&x| f64::from(x)).collect();
            assert_eq!(found, exact, "{set:?}");
        }
    }
}

/// A shared operand takes part from any place on, odd ones too, with a matrix packed row by row.
#[test]
fn shared_operands_begin_anywhere() {
    let (columns, step, length, outputs) = (37, 72, 53, 45);
    let left: Vec<f32> = (0..columns * step + 9).map(|k| (k % 7) as f32 - 3.0).collect();
    let right: Vec<f32> = (0..length * outputs).map(|k| (k % 5) as f32 - 2.0).collect();
    for set in Instructions::available() {
        let mut shared = SharedLeft::default();
        shared.load(set, &numbers(1, 40_000), step);
        shared.load(set, &left, step);
        let packed = Packed::of_rows(set, &right, length, outputs);
        for first in [0, 1, 6, 9] {
            let windows = Windows { first, step, pitch: 0, columns, rows: 1, segment_pitch: 0 };
            let exact = naive(&left, windows, 1, length, &right, outputs);
            let mut out = vec![0.0; columns * packed.outputs];
            let target = Target { data: &mut out, first: 0, step: packed.outputs, pitch: 0, then: Then::Store };
            shared.multiply(&packed, first, step, columns, target);
            for (window, exact) in exact.chunks(outputs).enumerate() {
                let found: Vec<f64> = out[window * packed.outputs..][..outputs].iter().map(|&x| f64::from(x)).collect();
                assert_eq!(found, exact, "{set:?} from {first}");
            }
        }
    }
}

#[test]
#[should_panic(expected = "a window ends outside")]
fn windows_outside_their_operand_are_refused() {
    let windows = Windows { first: 0, step: 4, pitch: 0, columns: 3, rows: 1, segment_pitch: 0 };
    let packed = Packed::new(Instructions::best(), 1, 4, &[0.0], |_, _| 0.0);
    let target = Target { data: &mut [0.0; 48], first: 0, step: 16, pitch: 0, then: Then::Store };
    multiply(&packed, Left { data: &[0.0; 11], windows, rectified: false }, &mut Vec::new(), target);
}
