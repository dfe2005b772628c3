//! Comparison of each op with a plain version in 64-bit numbers and of its gradients with finite differences; then training as a whole.

use std::path::Path;
use std::sync::Arc;

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::attention::Attention;
use crate::batch::TrainingImages;
use crate::convolution::Convolution;
use crate::linear::Linear;
use crate::loss::TouchLoss;
use crate::pointwise::{DepthToSpace, Norm, Relu};
use crate::resample::Resample;
use crate::scan::Selective;
use crate::tape::{Kernel, Var, apply};
use crate::tokens::{AddTable, Append, Gelu, Pair, WithLast, space_to_depth};
use crate::*;
use mvt_products::Instructions;
use mvt_touch::network::{Architecture, Precision, Pyramid, ScanOrder, WeightTensor};

mod hierarchy;

/// Numbers between -1 and 1.
fn random(shape: &[usize], seed: u64) -> WeightTensor {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let count = shape.iter().product();
    WeightTensor { shape: shape.to_vec(), values: (0..count).map(|_| rng.random_range(-1.0..1.0)).collect() }
}

/// Odd sixteenths between -1 and 1, which bf16 holds exactly, so that its products are exact, too. No number is zero, where a rectifier
/// has no slope.
fn sixteenths(shape: &[usize], seed: u64) -> WeightTensor {
    let mut tensor = random(shape, seed);
    tensor.values.iter_mut().for_each(|x| *x = ((*x * 8.0).floor() + 0.5) / 8.0);
    tensor
}

fn doubles<const N: usize>(inputs: &[WeightTensor; N]) -> [Vec<f64>; N] {
    std::array::from_fn(|i| inputs[i].values.iter().map(|&x| f64::from(x)).collect())
}

/// Compares an op's result with that of `plain`, and its gradients by all inputs with central differences of `plain`.
#[expect(clippy::needless_pass_by_value, reason = "inputs are made in the call")]
fn check<K: Kernel<N>, const N: usize>(
    kernel: K,
    inputs: [WeightTensor; N],
    plain: impl Fn(&[Vec<f64>; N]) -> Vec<f64>,
) {
    let variables: [Var; N] = std::array::from_fn(|i| Var::parameter(inputs[i].clone()));
    let output = apply(kernel, variables.clone());
    let exact = plain(&doubles(&inputs));
    let result = output.tensor().clone();
    assert_eq!(result.values.len(), exact.len(), "length of the result");
    for (i, (a, b)) in result.values.iter().zip(&exact).enumerate() {
        assert!((f64::from(*a) - b).abs() < 2e-5 * (1.0 + b.abs()), "result {i}: {a} for {b}");
    }
    // The loss is the product of the result with fixed numbers, which any wrong place would change.
    let weights = sixteenths(&[1, exact.len()], 99);
    let score = |inputs: &[Vec<f64>; N]| -> f64 {
        plain(inputs).iter().zip(&weights.values).map(|(y, w)| y * f64::from(*w)).sum()
    };
    let product = apply(
        Linear { instructions: Instructions::best().exact() },
        [
            output.reshape(&[1, exact.len()]),
            Var::constant(weights.clone()),
            Var::constant(WeightTensor { shape: vec![1], values: vec![0.0] }),
        ],
    );
    let mut slopes = product.backward();
    for (i, variable) in variables.iter().enumerate() {
        let slope = slopes.take(variable).expect("every input has a gradient");
        assert_eq!(slope.shape, inputs[i].shape, "shape of the gradient by input {i}");
        let scale = slope.values.iter().fold(0.0_f64, |most, s| most.max(f64::from(s.abs())));
        for k in (0..slope.values.len()).step_by(1 + slope.values.len() / 150) {
            let moved = |by: f64| {
                let mut moved = doubles(&inputs);
                moved[i][k] += by;
                score(&moved)
            };
            let difference = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            let found = f64::from(slope.values[k]);
            assert!((found - difference).abs() < 1e-4 * (1.0 + scale), "by input {i}, {k}: {found} for {difference}");
        }
    }
}

#[test]
fn linear() {
    // Odd and even numbers of channels, full vectors and rests.
    for (instructions, (i, o)) in
        Instructions::available().flat_map(|set| [(7, 4), (6, 16), (16, 6), (35, 5)].map(|s| (set, s)))
    {
        let inputs = [sixteenths(&[3, 5, i], 1), sixteenths(&[o, i], 2), sixteenths(&[o], 3)];
        check(Linear { instructions }, inputs, |[x, w, b]| {
            let output = |x: &[f64], o: usize| b[o] + (0..i).map(|i0| w[o * i + i0] * x[i0]).sum::<f64>();
            x.chunks_exact(i).flat_map(|x| (0..o).map(|o| output(x, o)).collect::<Vec<_>>()).collect()
        });
    }
}

/// The definition of a convolution, pixel by pixel.
fn plain_convolution(
    [images, rows, columns, inputs, outputs]: [usize; 5],
    stride: usize,
    relu: bool,
    [x, w, b]: &[Vec<f64>; 3],
) -> Vec<f64> {
    let mut y = Vec::new();
    for (n, i, j, o) in places(images, rows.div_ceil(stride), columns.div_ceil(stride), outputs) {
        let mut sum = b[o];
        for (dy, dx, c) in (0..3).flat_map(|dy| (0..3).flat_map(move |dx| (0..inputs).map(move |c| (dy, dx, c)))) {
            let (v, u) = ((i * stride + dy) as isize - 1, (j * stride + dx) as isize - 1);
            if (0..rows as isize).contains(&v) && (0..columns as isize).contains(&u) {
                let value = x[((n * rows + v as usize) * columns + u as usize) * inputs + c];
                let value = if relu { value.max(0.0) } else { value };
                sum += value * w[((o * inputs + c) * 3 + dy) * 3 + dx];
            }
        }
        y.push(sum);
    }
    y
}

fn places(a: usize, b: usize, c: usize, d: usize) -> impl Iterator<Item = (usize, usize, usize, usize)> {
    (0..a * b * c * d).map(move |k| (k / (b * c * d), k / (c * d) % b, k / d % c, k % d))
}

#[test]
fn convolution() {
    let shapes = [
        (1, false, [2, 6, 5, 3, 4]),
        (1, true, [2, 4, 9, 6, 16]),
        (2, false, [2, 6, 8, 5, 3]),
        (2, true, [2, 5, 7, 4, 6]),
        (1, true, [1, 3, 4, 17, 2]),
    ];
    for instructions in Instructions::available() {
        for (stride, relu, sizes) in shapes {
            let [images, rows, columns, inputs, outputs] = sizes;
            let x = sixteenths(&[images, rows, columns, inputs], 4);
            let tensors = [x, sixteenths(&[outputs, inputs, 3, 3], 5), sixteenths(&[outputs], 6)];
            check(Convolution { stride, relu, instructions }, tensors, |values| {
                plain_convolution(sizes, stride, relu, values)
            });
        }
    }
}

/// More rows than are multiplied at once.
#[test]
fn convolution_of_a_large_map() {
    let tensors = [random(&[1, 40, 60, 2], 7), random(&[3, 2, 3, 3], 8), random(&[3], 9)];
    let exact = plain_convolution([1, 40, 60, 2, 3], 1, false, &doubles(&tensors));
    let result = apply(
        Convolution { stride: 1, relu: false, instructions: Instructions::best().exact() },
        tensors.map(Var::constant),
    )
    .tensor()
    .clone();
    assert!(result.values.iter().zip(&exact).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-5));
}

#[test]
fn norm() {
    check(Norm, [random(&[4, 3, 6], 10), random(&[6], 11), random(&[6], 12)], |[x, w, b]| {
        let unit = |x: &[f64], i: usize| {
            let mean = x.iter().sum::<f64>() / 6.0;
            let variance = x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 6.0;
            (x[i] - mean) / (variance + 1e-5).sqrt()
        };
        x.chunks_exact(6).flat_map(|x| (0..6).map(move |i| unit(x, i) * w[i] + b[i])).collect()
    });
}

#[test]
fn relu() {
    check(Relu, [random(&[5, 7], 13)], |[x]| x.iter().map(|x| x.max(0.0)).collect());
}

#[test]
fn depth_to_space() {
    let (images, rows, columns, factor, channels) = (2, 3, 2, 2, 3);
    check(DepthToSpace(factor), [random(&[images, rows, columns, factor * factor * channels], 14)], |[x]| {
        let fine = places(images, rows * factor, columns * factor, channels);
        let place = |v: usize, u: usize, c: usize| ((v % factor) * factor + u % factor) * channels + c;
        let pixel = |n: usize, v: usize, u: usize| (n * rows + v / factor) * columns + u / factor;
        fine.map(|(n, v, u, c)| x[pixel(n, v, u) * factor * factor * channels + place(v, u, c)]).collect()
    });
}

#[test]
fn resampling() {
    for (aligned, size) in [(true, [6, 5]), (false, [6, 5]), (false, [2, 2]), (true, [7, 3])] {
        let (rows, columns, channels) = (3, 4, 2);
        check(Resample { size, aligned }, [random(&[2, rows, columns, channels], 15)], |[x]| {
            let place = |i: usize, from: usize, to: usize| -> f64 {
                let at = if aligned {
                    i as f64 * (from - 1) as f64 / (to - 1) as f64
                } else {
                    (i as f64 + 0.5) * from as f64 / to as f64 - 0.5
                };
                at.clamp(0.0, (from - 1) as f64)
            };
            let tent = |at: f64, i: usize| (1.0 - (at - i as f64).abs()).max(0.0);
            let value = |(n, v, u, c): (usize, usize, usize, usize)| {
                let (y, z) = (place(v, rows, size[0]), place(u, columns, size[1]));
                places(1, rows, columns, 1)
                    .map(|(_, i, j, _)| tent(y, i) * tent(z, j) * x[((n * rows + i) * columns + j) * channels + c])
                    .sum()
            };
            places(2, size[0], size[1], channels).map(value).collect()
        });
    }
}

#[test]
fn attention() {
    let (tokens, heads, head) = (5, 2, 3);
    let width = heads * head;
    check(Attention { heads }, [random(&[2, tokens, 3 * width], 16)], |[qkv]| {
        let at = |n: usize, t: usize, part: usize, c: usize| qkv[(n * tokens + t) * 3 * width + part * width + c];
        let value = |(n, t, h, c): (usize, usize, usize, usize)| {
            let score =
                |s: usize| (0..head).map(|k| at(n, t, 0, h * head + k) * at(n, s, 1, h * head + k)).sum::<f64>();
            let shares: Vec<f64> = (0..tokens).map(|s| (score(s) / (head as f64).sqrt()).exp()).collect();
            let mixed: f64 = (0..tokens).map(|s| shares[s] * at(n, s, 2, h * head + c)).sum();
            mixed / shares.iter().sum::<f64>()
        };
        places(2, tokens, heads, head).map(value).collect()
    });
}

#[test]
fn token_ops() {
    let (images, tokens, width) = (2, 3, 4);
    let x = || random(&[images, tokens, width], 17);
    check(AddTable, [x(), random(&[tokens, width], 18)], |[x, table]| {
        x.iter().enumerate().map(|(i, x)| x + table[i % (tokens * width)]).collect()
    });
    check(Append, [x(), random(&[1, width], 18)], |[x, last]| {
        x.chunks(tokens * width).flat_map(|image| [image, last].concat()).collect()
    });
    check(WithLast, [x()], |[x]| {
        let pair = |n: usize, t: usize| {
            let token = |t: usize| x[(n * tokens + t) * width..][..width].to_vec();
            [token(t), token(tokens - 1)].concat()
        };
        places(images, tokens - 1, 1, 1).flat_map(|(n, t, _, _)| pair(n, t)).collect()
    });
    check(Pair, [random(&[1, 2, 3, 1], 19), random(&[1, 2, 3, 1], 20)], |[a, b]| {
        a.iter().zip(b).flat_map(|(a, b)| [*a, *b]).collect()
    });
}

#[test]
fn gelu() {
    // The distribution function by Simpson's rule.
    let below = |x: f64| {
        let density = |t: f64| (-0.5 * t * t).exp() / std::f64::consts::TAU.sqrt();
        let step = x / 200.0;
        let inner = |k: usize| density(k as f64 * step) * if k % 2 == 1 { 4.0 } else { 2.0 };
        0.5 + step / 3.0 * (density(0.0) + density(x) + (1..200).map(inner).sum::<f64>())
    };
    let mut x = random(&[60], 21);
    x.values.iter_mut().for_each(|x| *x *= 4.0);
    check(Gelu, [x], |[x]| x.iter().map(|&x| x * below(x)).collect());
}

#[test]
fn patches_hold_their_pixels_in_order() {
    let levels: Vec<u8> = (0..3 * 16).collect();
    let patches = space_to_depth(TrainingImages { levels: &levels, shape: [1, 4, 4] }, 2);
    assert_eq!(patches.shape, [1, 2, 2, 12]);
    // Red of the first two patches: pixels 0, 1, 4, 5 and 2, 3, 6, 7.
    let red: Vec<f32> = patches.values[..24].iter().step_by(3).map(|x| ((x + 1.0) * 127.5 / 3.0).round()).collect();
    assert_eq!(red, [0.0, 1.0, 4.0, 5.0, 2.0, 3.0, 6.0, 7.0]);
}

/// The inside of a Mamba block as the module's description defines it, token by token.
fn plain_scan(order: &[usize], [inner, state, taps, rank]: [usize; 4], inputs: &[Vec<f64>; 8]) -> Vec<f64> {
    let [xz, conv, conv_bias, projection, step, step_bias, a_log, skip] = inputs;
    let (tokens, columns) = (order.len(), rank + 2 * state);
    let silu = |x: f64| x / (1.0 + (-x).exp());
    let mut y = vec![0.0; xz.len() / 2];
    for image in 0..xz.len() / (2 * tokens * inner) {
        let at = |t: usize, e: usize| xz[((image * tokens + order[t]) * 2) * inner + e];
        let mut hidden = vec![0.0; inner * state];
        for t in 0..tokens {
            let x: Vec<f64> = (0..inner)
                .map(|e| {
                    let past = (0..taps).filter(|k| t + k + 1 >= taps);
                    silu(conv_bias[e] + past.map(|k| conv[e * taps + k] * at(t + k + 1 - taps, e)).sum::<f64>())
                })
                .collect();
            let dbc: Vec<f64> =
                (0..columns).map(|r| (0..inner).map(|e| projection[r * inner + e] * x[e]).sum()).collect();
            for e in 0..inner {
                let raw = step_bias[e] + (0..rank).map(|r| step[e * rank + r] * dbc[r]).sum::<f64>();
                let delta = raw.exp().ln_1p();
                let mut read = skip[e] * x[e];
                for n in 0..state {
                    let h = &mut hidden[e * state + n];
                    *h = (-delta * a_log[e * state + n].exp()).exp() * *h + delta * x[e] * dbc[rank + n];
                    read += *h * dbc[rank + state + n];
                }
                y[(image * tokens + order[t]) * inner + e] = read * silu(at(t, inner + e));
            }
        }
    }
    y
}

#[test]
fn selective_scan() {
    // More channels than lanes, and a rest; all four orders.
    for (scan, inner) in ScanOrder::ALL.into_iter().zip([5, 16, 19, 7]) {
        let ([rows, columns], [state, taps, rank]) = ([3, 4], [3, 4, 2]);
        let order = scan.order(rows, columns);
        let inputs = [
            random(&[2, rows * columns, 2 * inner], 20),
            random(&[inner, taps], 21),
            random(&[inner], 22),
            random(&[rank + 2 * state, inner], 23),
            random(&[inner, rank], 24),
            random(&[inner], 25),
            random(&[inner, state], 26),
            random(&[inner], 27),
        ];
        let kernel = Selective { order: order.clone().into() };
        check(kernel, inputs, |inputs| plain_scan(&order, [inner, state, taps, rank], inputs));
    }
}

#[test]
fn loss() {
    for penalty in [Penalty::Mse, Penalty::L1, Penalty::Huber] {
        let config = LossConfig { penalty, huber_mm: 0.3, contact_weight: 2.5, segmentation: 0.7 };
        let contact = vec![0.0, 1.0, 0.25, 1.0, 0.0, 0.0];
        let indentation_mm = vec![0.0, 0.5, 0.1, 1.5, 0.0, 0.02];
        let targets = Targets { indentation_mm: indentation_mm.clone(), contact: contact.clone() };
        check(TouchLoss { config, targets: Arc::new(targets), first: 0 }, [random(&[1, 2, 3, 2], 30)], |[output]| {
            let pixels = output.as_chunks::<2>().0.iter().zip(indentation_mm.iter().zip(&contact));
            let sum: f64 = pixels
                .map(|([mm, logit], (target, contact))| {
                    let (error, contact) = ((mm - f64::from(*target)).abs(), f64::from(*contact));
                    let cost = match penalty {
                        Penalty::Mse => error * error,
                        Penalty::L1 => error,
                        Penalty::Huber if error < 0.3 => error * error / 0.6,
                        Penalty::Huber => error - 0.15,
                    };
                    let p = 1.0 / (1.0 + (-logit).exp());
                    let entropy = -(contact * p.ln() + (1.0 - contact) * (1.0 - p).ln());
                    (1.0 + 1.5 * contact) * cost + f64::from(0.7_f32) * entropy
                })
                .sum();
            vec![sum / 6.0]
        });
    }
}

/// A network small enough for tests.
fn small() -> Architecture {
    Architecture::Default(Pyramid { widths: [4, 6, 8, 16], depth: 2, state: 4, ..Pyramid::default() })
}

fn config(steps: u64) -> TrainingConfig {
    let optimiser = OptimiserConfig { learning_rate: 3e-3, warm_up: 10, ..OptimiserConfig::default() };
    TrainingConfig {
        gpu_arithmetic: Arithmetic::default(),
        seed: 5,
        stages: vec![Stage { size: [32, 32], batch: 4, steps }],
        resizes: false,
        optimiser,
        loss: LossConfig::default(),
        precision: Precision::F32,
        validate_every: 10,
        validation_images: 1,
    }
}

/// Four images of 32 x 32 pixels with a bright disc each, whose brightness is its depth.
fn discs(seed: u64) -> TrainingBatch {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut levels, mut targets) = (Vec::new(), Targets::default());
    for _ in 0..4 {
        let (x, y, r): (f32, f32, f32) =
            (rng.random_range(8.0..24.0), rng.random_range(8.0..24.0), rng.random_range(4.0..9.0));
        for k in 0..32 * 32 {
            let inside = (x - (k % 32) as f32).hypot(y - (k / 32) as f32) / r;
            let depth = (1.0 - inside * inside).max(0.0);
            levels.extend([90 + (120.0 * depth) as u8, 60, 120 - (90.0 * depth) as u8]);
            targets.indentation_mm.push(depth);
            targets.contact.push(f32::from(u8::from(depth > 0.1)));
        }
    }
    TrainingBatch { shape: [4, 32, 32], levels, targets: Arc::new(targets) }
}

#[test]
fn two_hundred_steps_teach_discs() {
    let mut trainer = TouchTrainer::new(small(), config(200), None).unwrap();
    let losses: Vec<f32> = (0..200).map(|k| trainer.advance(&discs(k)).unwrap().loss).collect();
    let mean = |losses: &[f32]| losses.iter().sum::<f32>() / losses.len() as f32;
    let (first, last) = (mean(&losses[..5]), mean(&losses[195..]));
    assert!(last < 0.05 && last < first / 5.0, "loss went from {first} to {last}");
}

/// The networks with a DPT decoder, small enough for tests.
fn with_decoder() -> [Architecture; 5] {
    [
        r#"{"name": "vit", "patch": 8, "width": 16, "depth": 4, "heads": 2, "mlp": 2, "positions": [3, 5],
            "hooks": [0, 1, 2, 3], "channels": 8}"#,
        r#"{"name": "mamba", "patch": 8, "width": 16, "depth": 2, "state": 4, "hooks": [0, 1], "channels": 8}"#,
        r#"{"name": "robust_mamba", "patch": 8, "width": 16, "depth": 3, "state": 4, "mlp": 2, "hooks": [0, 1, 2],
            "channels": 8}"#,
        r#"{"name": "swin", "widths": [8, 12, 16, 16], "depths": [2, 1, 2, 1], "heads": [2, 3, 2, 4], "window": 3, "mlp": 2,
            "channels": 8}"#,
        r#"{"name": "convnext", "widths": [8, 12, 16, 16], "depths": [1, 1, 2, 1], "mlp": 2, "channels": 8}"#,
    ]
    .map(|network| serde_json::from_str(network).unwrap())
}

/// Every network learns, from images whose sides are not multiples of twice its patch.
#[test]
fn every_network_learns() {
    for network in with_decoder() {
        let name = network.name();
        let mut trainer = TouchTrainer::new(network, config(120), None).unwrap();
        let losses: Vec<f32> = (0..120).map(|k| trainer.advance(&discs(k)).unwrap().loss).collect();
        let (first, last) = (losses[..5].iter().sum::<f32>(), losses[115..].iter().sum::<f32>());
        assert!(last < first / 2.5, "{name}: loss went from {first} to {last}");
    }
}

#[test]
fn gradients_do_not_depend_on_threads() {
    for network in with_decoder() {
        let weights = model::initial(&network, 3);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let best = Instructions::best();
            pool.install(|| trainer::gradients(best, &network, &weights, LossConfig::default(), &discs(0)))
        };
        assert!(run(1) == run(3), "{}", network.name());
    }
}

/// A training that is interrupted and resumed, or that has fewer threads, leads to the same weights to the bit.
#[test]
fn resumes_exactly_and_does_not_depend_on_threads() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("checkpoint.safetensors");
    let run = |trainer: &mut TouchTrainer, to: u64| {
        while trainer.step() < to {
            let batch = discs(trainer.step());
            trainer.advance(&batch).unwrap();
        }
    };
    let mut whole = TouchTrainer::new(small(), config(12), None).unwrap();
    run(&mut whole, 12);
    let mut first = TouchTrainer::new(small(), config(12), None).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| run(&mut first, 7));
    first.save(&path).unwrap();
    drop(first);
    let mut second = TouchTrainer::resume(&path, small(), config(12)).unwrap();
    run(&mut second, 12);
    assert_eq!(whole.weights(String::new()).unwrap(), second.weights(String::new()).unwrap());

    let other = TrainingConfig { seed: 6, ..config(12) };
    assert!(TouchTrainer::resume(&path, small(), other).err().unwrap().to_string().contains("configuration differs"));
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() - 4]).unwrap();
    assert!(TouchTrainer::resume(&path, small(), config(12)).is_err(), "a checkpoint that is cut off");
}

#[test]
fn a_loss_that_is_not_finite_stops_and_changes_nothing() {
    let mut trainer = TouchTrainer::new(small(), config(10), None).unwrap();
    let before = trainer.weights(String::new()).unwrap();
    let mut batch = discs(0);
    Arc::make_mut(&mut batch.targets).indentation_mm[17] = f32::NAN;
    let error = trainer.advance(&batch).unwrap_err().to_string();
    assert!(error.contains("step 0") && error.contains("NaN") && error.contains("learning_rate"), "{error}");
    assert_eq!(trainer.weights(String::new()).unwrap(), before);
}

/// The failure of the paper: with L1 and targets that are mostly zero, a network that cannot yet distinguish pixels learns zero, the
/// median of the targets. Weight on contact moves the median.
#[test]
fn l1_of_masked_targets_predicts_black_and_weight_on_contact_cures_it() {
    let learnt = |loss: LossConfig| {
        // Grey images in which one random pixel in five is in contact: a network can learn only one number.
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let (shape, levels) = ([2, 32, 32], vec![128; 2 * 32 * 32 * 3]);
        let mut trainer = TouchTrainer::new(small(), TrainingConfig { loss, ..config(150) }, None).unwrap();
        for _ in 0..150 {
            let contact: Vec<f32> = (0..2 * 32 * 32).map(|_| f32::from(u8::from(rng.random_bool(0.2)))).collect();
            let targets = Targets { indentation_mm: contact.iter().map(|c| 0.6 * c).collect(), contact };
            trainer.advance(&TrainingBatch { shape, levels: levels.clone(), targets: Arc::new(targets) }).unwrap();
        }
        let weights = trainer.weights(String::new()).unwrap();
        let predicted = predict(&weights, &levels, shape).unwrap();
        predicted.iter().map(|pixel| pixel[0]).sum::<f32>() / predicted.len() as f32
    };
    let masked = LossConfig { penalty: Penalty::L1, contact_weight: 1.0, segmentation: 0.0, ..LossConfig::default() };
    let black = learnt(masked);
    assert!(black < 0.02, "L1 should have gone black: {black}");
    let weighted = learnt(LossConfig { contact_weight: 8.0, ..masked });
    assert!(weighted > 0.5, "weighted L1 should have found the indentation of contact: {weighted}");
    let mean = learnt(LossConfig { penalty: Penalty::Mse, ..masked });
    assert!((mean - 0.12).abs() < 0.03, "the mean of all targets is the best constant of a square loss: {mean}");
}

#[test]
fn senseless_configurations_are_named() {
    let error = |change: &dyn Fn(&mut TrainingConfig)| {
        let mut config = config(1);
        change(&mut config);
        config.validate().unwrap_err().to_string()
    };
    assert!(error(&|c| c.stages.clear()).contains("stages"));
    assert!(error(&|c| c.optimiser.learning_rate = f32::NAN).contains("learning_rate"));
    assert!(error(&|c| c.optimiser.betas[1] = 1.0).contains("betas"));
    let odd = TrainingConfig { stages: vec![Stage { size: [32, 40], batch: 1, steps: 1 }], ..config(1) };
    assert!(TouchTrainer::new(small(), odd, None).err().unwrap().to_string().contains("stride"));
    let mut trainer = TouchTrainer::new(small(), config(1), None).unwrap();
    let short = TrainingBatch { shape: [5, 32, 32], ..discs(0) };
    assert!(trainer.advance(&short).unwrap_err().to_string().contains("5 RGB images of 32 x 32"));
    let start = TouchTrainer::new(small(), config(1), None).unwrap().weights(String::new()).unwrap();
    let other = Architecture::preset("default").unwrap();
    assert!(TouchTrainer::new(other, config(1), Some(&start)).is_err(), "weights of another network");
    assert!(
        TouchTrainer::resume(Path::new("nowhere"), small(), config(1)).err().unwrap().to_string().contains("nowhere")
    );
}
