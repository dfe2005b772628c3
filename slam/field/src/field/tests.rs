use glam::DVec3;
use pulp::WithSimd;
use rand::RngExt;

use super::train::Differentiate;
use super::*;

mod disk;
mod reference;

use reference::Reference;

/// A field whose lattices have vertices at multiples of 1/16 m, exactly, and features that matter.
fn rough(seed: u64) -> NeuralField {
    let config = FieldConfig {
        half_extent_m: 0.5,
        truncation_m: 0.1,
        levels: vec![5, 17],
        hidden: 16,
        ..FieldConfig::default()
    };
    roughen(NeuralField::new(&config, seed).unwrap(), seed)
}

/// The finer level of `rough` is hashed here.
fn hashed(seed: u64) -> NeuralField {
    let config = FieldConfig { table_log2: 8, ..rough(seed).config };
    roughen(NeuralField::new(&config, seed).unwrap(), seed)
}

fn roughen(mut field: NeuralField, seed: u64) -> NeuralField {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    field.parameters.table.as_flattened_mut().fill_with(|| random.random_range(-0.3..0.3));
    let bias = field.layout.biases()..field.layout.output();
    field.parameters.network[bias].fill_with(|| random.random_range(-0.3..0.3));
    field
}

fn points(seed: u64, count: usize, extent: f32) -> Vec<Vec3> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(|_| Vec3::from_array(std::array::from_fn(|_| random.random_range(-extent..extent)))).collect()
}

fn values(field: &NeuralField, points: &[Vec3]) -> Vec<f32> {
    let mut out = vec![0.0; points.len()];
    field.distances(points, &mut out);
    out
}

fn distances(field: &NeuralField, points: &[Vec3]) -> Vec<Distance> {
    let mut out = vec![Distance::default(); points.len()];
    field.distances_and_gradients(points, &mut out);
    out
}

/// Samples of a signed distance around its surface, some of them one-sided.
fn samples(seed: u64, count: usize, config: &FieldConfig, distance: impl Fn(Vec3) -> f32) -> Vec<Sample> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut out = Vec::new();
    while out.len() < count {
        let position =
            Vec3::from_array(std::array::from_fn(|_| random.random_range(-config.half_extent_m..config.half_extent_m)));
        let target = distance(position) / config.truncation_m;
        // Mostly in the band, some in the free and in the inner space.
        if target.abs() < 1.0 || random.random_bool(0.05) {
            let at_least = target > 1.0 && random.random_bool(0.5);
            out.push(Sample { position, target, weight: 1.0, at_least });
        }
    }
    out
}

#[test]
fn values_are_those_of_the_definition() {
    for field in [rough(1), hashed(1)] {
        let reference = Reference::new(&field);
        for set in FieldInstructions::available() {
            // More than the cube, and not a whole number of chunks.
            let points = points(2, 333, 0.6);
            let field = field.clone().with_instructions(set);
            let (plain, with_gradient) = (values(&field, &points), distances(&field, &points));
            for (k, p) in points.iter().enumerate() {
                let expected = 0.1 * reference.value(p.as_dvec3().to_array());
                assert!((f64::from(plain[k]) - expected).abs() < 1e-6, "{set:?} {p}: {} {expected}", plain[k]);
                assert_eq!(plain[k], with_gradient[k].value_m);
            }
        }
    }
}

/// The derivative of the reference along an axis from `point` to `step` further.
fn slope(reference: &Reference, point: DVec3, axis: usize, step: f64) -> f64 {
    let mut ahead = point.to_array();
    ahead[axis] += step;
    (reference.value(ahead) - reference.value(point.to_array())) / step
}

#[test]
fn spatial_gradients_are_those_of_differences() {
    for field in [rough(3), hashed(3)] {
        let reference = Reference::new(&field);
        for set in FieldInstructions::available() {
            let points = points(4, 300, 0.499);
            for (p, distance) in points.iter().zip(distances(&field.clone().with_instructions(set), &points)) {
                for axis in 0..3 {
                    // No step may cross into another cell or over the bend of a neuron: half a step on either side must agree.
                    let [left, right] = [-1e-6, 1e-6].map(|step| 0.1 * slope(&reference, p.as_dvec3(), axis, step));
                    if (left - right).abs() < 1e-5 {
                        let error = f64::from(distance.gradient[axis]) - right;
                        assert!(error.abs() < 2e-5, "{set:?} {p} axis {axis}: {distance:?} {right}");
                    }
                }
            }
        }
    }
}

#[test]
fn on_a_face_the_gradient_is_that_of_the_upper_cell_and_at_the_end_of_the_last() {
    for field in [rough(5), hashed(5)] {
        let reference = Reference::new(&field);
        let mut random = ChaCha8Rng::seed_from_u64(6);
        let mut differ = 0;
        for _ in 0..200 {
            // x on a vertex of the finer lattice, y at an end of the cube, z anywhere.
            let x = random.random_range(-8..8) as f32 / 16.0;
            let y = if random.random_bool(0.5) { 0.5 } else { -0.5 };
            let p = Vec3::new(x, y, random.random_range(-0.4..0.4));
            let gradient = distances(&field, &[p])[0].gradient.as_dvec3();
            let up = 0.1 * slope(&reference, p.as_dvec3(), 0, 1e-6);
            let down = 0.1 * slope(&reference, p.as_dvec3(), 0, -1e-6);
            assert!((gradient.x - up).abs() < 2e-5, "{p}: {gradient} {up} {down}");
            differ += usize::from((up - down).abs() > 1e-3);
            let inward = 0.1 * slope(&reference, p.as_dvec3(), 1, -1e-6 * f64::from(y.signum()));
            assert!((gradient.y - inward).abs() < 2e-5, "{p}: {gradient} {inward}");
        }
        assert!(differ > 100, "the sides must differ for this to say anything: {differ}");
    }
}

#[test]
fn outside_of_the_cube_is_the_nearest_point_and_no_gradient_along_the_axes_outside() {
    let field = rough(7);
    for p in points(8, 300, 0.8) {
        let nearest = p.clamp(Vec3::splat(-0.5), Vec3::splat(0.5));
        let [there, here] = [distances(&field, &[nearest])[0], distances(&field, &[p])[0]];
        assert_eq!(here.value_m, there.value_m);
        for axis in 0..3 {
            let expected = if p[axis].abs() > 0.5 { 0.0 } else { there.gradient[axis] };
            assert_eq!(here.gradient[axis], expected, "{p}");
        }
    }
    let far = distances(&field, &[Vec3::splat(f32::INFINITY), Vec3::splat(f32::NAN), Vec3::splat(f32::MIN)]);
    let ends = distances(&field, &[Vec3::splat(0.5), Vec3::splat(-0.5)]);
    assert_eq!(far[0].value_m, ends[0].value_m);
    assert_eq!([far[1].value_m, far[2].value_m], [ends[1].value_m; 2]);
    assert!(far.iter().all(|d| d.gradient == Vec3::ZERO));
}

/// The loss and its gradient, without a step.
fn differentiate(field: &NeuralField, set: FieldInstructions, samples: &[Sample]) -> (f32, Parameters) {
    struct Run<'a>(&'a mut FieldTrainer, &'a [Sample]);
    impl WithSimd for Run<'_> {
        type Output = f32;
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> f32 {
            Differentiate { trainer: self.0, samples: self.1 }.with_simd(simd)
        }
    }
    let mut trainer = FieldTrainer::new(field.clone().with_instructions(set));
    let loss = set.run(Run(&mut trainer, samples));
    (loss, trainer.gradient().clone())
}

#[test]
fn parameter_gradients_are_those_of_differences() {
    for field in [rough(9), hashed(9)] {
        for eikonal_weight in [0.0, 0.5] {
            let mut field = field.clone();
            field.config.eikonal_weight = eikonal_weight;
            let mut samples = samples(10, 150, &field.config, |p| p.length() - 0.3);
            for (k, sample) in samples.iter_mut().enumerate() {
                sample.weight = 0.5 + 0.01 * k as f32;
                sample.at_least |= k % 7 == 0;
            }
            let reference = Reference::new(&field);
            let loss = reference.loss(&samples);
            for set in FieldInstructions::available() {
                let (found, gradient) = differentiate(&field, set, &samples);
                assert!((f64::from(found) / loss - 1.0).abs() < 1e-5, "{set:?}: loss {found} {loss}");
                let check = |found: &[f32], parameters: fn(&mut Reference) -> &mut Vec<f64>, choose: usize| {
                    let scale = found.iter().fold(0.0f32, |scale, g| scale.max(g.abs()));
                    assert!(scale > 1e-4);
                    let mut checked = 0;
                    for k in (0..found.len()).step_by(choose) {
                        let moved = |step: f64| {
                            let mut moved = reference.clone();
                            parameters(&mut moved)[k] += step;
                            moved.loss(&samples)
                        };
                        let (right, left) = ((moved(1e-6) - loss) / 1e-6, (loss - moved(-1e-6)) / 1e-6);
                        // Not where a neuron or a one-sided sample turns on or off within the step.
                        if (right - left).abs() < 1e-4 * f64::from(scale) {
                            let error = (f64::from(found[k]) - 0.5 * (left + right)).abs();
                            assert!(error < 1e-3 * f64::from(scale), "{set:?} {k}: {} {left} {right}", found[k]);
                            checked += usize::from(found[k] != 0.0);
                        }
                    }
                    assert!(checked > 20, "{checked}");
                };
                check(&gradient.network[..field.layout.parameters()], |reference| &mut reference.network, 3);
                let stride = (gradient.table.as_flattened().len() / 1000) | 1;
                check(gradient.table.as_flattened(), |reference| &mut reference.table, stride);
            }
        }
    }
}

#[test]
fn what_no_sample_touches_stays() {
    let field = rough(11);
    let mut trainer = FieldTrainer::new(field.clone());
    let corner = Vec3::splat(-0.49);
    let all = |target, at_least| [Sample { position: corner, target, weight: 1.0, at_least }; 3];
    let before = values(&field, &[corner])[0] / field.config.truncation_m;
    // A bound that is met teaches nothing, nor does an empty batch, nor a NaN.
    trainer.step(&all(before - 0.1, true));
    trainer.step(&[]);
    trainer.step(&all(f32::NAN, false));
    assert_eq!(trainer.field().parameters, field.parameters);
    trainer.step(&all(before - 0.1, false));
    let changed = |k: usize| trainer.field().parameters.table[k] != field.parameters.table[k];
    // The low corner's cell of the coarse level (5 vertices per axis), and nothing else of it.
    let touched: Vec<usize> = (0..125).filter(|&k| changed(k)).collect();
    assert_eq!(touched, [0, 1, 5, 6, 25, 26, 30, 31]);
}

#[test]
fn steps_are_those_of_lazy_adam() {
    let mut trainer = FieldTrainer::new(rough(12));
    let layout = trainer.field.layout;
    // Of each parameter: itself and the running means of its gradient and of the square, in double precision.
    let mut expected: Vec<[f64; 3]> = Vec::new();
    for step in 1..=5 {
        // Few samples, so that each step leaves other parameters alone.
        let samples = samples(step, 40, &trainer.field.config, |p| p.length() - 0.3);
        let (_, gradient) = differentiate(&trainer.field, FieldInstructions::best(), &samples);
        let table = trainer.field.parameters.table.len() * FEATURES;
        let flat = |p: &Parameters| [p.table.as_flattened(), &p.network[..layout.parameters()]].concat();
        let before = flat(&trainer.field.parameters);
        expected.resize(before.len(), [0.0; 3]);
        trainer.step(&samples);
        let correction = (1.0 - 0.99f64.powi(step as i32)).sqrt() / (1.0 - 0.9f64.powi(step as i32));
        for (k, g) in flat(&gradient).into_iter().map(f64::from).enumerate() {
            let [parameter, mean, square] = &mut expected[k];
            *parameter = f64::from(before[k]);
            if g != 0.0 {
                *mean = 0.9 * *mean + 0.1 * g;
                *square = 0.99 * *square + 0.01 * g * g;
                let rate = if k < table { 5e-3 } else { 2e-3 * correction };
                *parameter -= rate * *mean / (square.sqrt() + 1e-12);
            }
        }
        for (k, (found, [parameter, ..])) in flat(&trainer.field.parameters).into_iter().zip(&expected).enumerate() {
            assert!((f64::from(found) - parameter).abs() < 1e-6, "step {step}, {k}: {found} {parameter}");
        }
    }
    assert!(expected.iter().any(|[_, mean, _]| *mean == 0.0) && expected.iter().any(|[_, mean, _]| *mean != 0.0));
}

/// Largest and mean distance to a surface that the field shows at points on it, metres.
fn error(field: &NeuralField, surface: &[Vec3]) -> [f32; 2] {
    let values = values(field, surface);
    let largest = values.iter().fold(0.0f32, |largest, v| largest.max(v.abs()));
    [largest, values.iter().map(|v| v.abs()).sum::<f32>() / values.len() as f32]
}

fn train(
    config: &FieldConfig,
    steps: u64,
    set: FieldInstructions,
    distance: impl Fn(Vec3) -> f32 + Copy,
) -> NeuralField {
    let mut trainer = FieldTrainer::new(NeuralField::new(config, 1).unwrap().with_instructions(set));
    for step in 0..steps {
        trainer.step(&samples(step, 2048, config, distance));
    }
    trainer.field
}

fn sphere(p: Vec3) -> f32 {
    p.length() - 0.035
}

/// A box of 60 x 50 x 40 mm.
fn block(p: Vec3) -> f32 {
    let q = p.abs() - Vec3::new(0.03, 0.025, 0.02);
    q.max(Vec3::ZERO).length() + q.max_element().min(0.0)
}

#[test]
fn a_sphere_is_learnt() {
    let surface: Vec<Vec3> = points(13, 2000, 1.0).iter().map(|p| p.normalize() * 0.035).collect();
    let dense = FieldConfig::default();
    let hashed = FieldConfig { levels: vec![8, 20, 48], table_log2: 14, ..dense.clone() };
    for (config, bound) in [(&dense, 3e-4), (&hashed, 6e-4)] {
        let field = train(config, 250, FieldInstructions::best(), sphere);
        let [largest, mean] = error(&field, &surface);
        assert!(largest < bound && mean < 0.3 * bound, "largest {largest} mean {mean}");
        for (d, p) in distances(&field, &surface).iter().zip(&surface) {
            assert!(d.gradient.normalize().dot(p.normalize()) > 0.9, "{d:?}");
        }
    }
}

#[test]
fn a_box_is_learnt() {
    // Directions stretched onto the faces.
    let surface: Vec<Vec3> = points(14, 2000, 1.0)
        .iter()
        .map(|p| {
            let half = Vec3::new(0.03, 0.025, 0.02);
            *p * half / p.abs().max_element()
        })
        .collect();
    assert!(surface.iter().all(|&p| block(p).abs() < 1e-6));
    let field = train(&FieldConfig::default(), 200, FieldInstructions::best(), block);
    let [largest, mean] = error(&field, &surface);
    // The finest cells are 3.2 mm wide: edges are rounded.
    assert!(mean < 1e-4 && largest < 1.2e-3, "largest {largest} mean {mean}");
}

#[test]
fn instruction_sets_agree() {
    let surface: Vec<Vec3> = points(15, 500, 1.0).iter().map(|p| p.normalize() * 0.035).collect();
    let fields: Vec<NeuralField> =
        FieldInstructions::available().map(|set| train(&FieldConfig::default(), 10, set, sphere)).collect();
    for field in &fields[1..] {
        for (a, b) in distances(field, &surface).iter().zip(distances(&fields[0], &surface)) {
            assert!((a.value_m - b.value_m).abs() < 2e-6, "{a:?} {b:?}");
            assert!((a.gradient - b.gradient).length() < 2e-3, "{a:?} {b:?}");
        }
    }
}

#[test]
fn the_same_input_gives_the_same_bits() {
    let train = || train(&FieldConfig::default(), 5, FieldInstructions::best(), sphere);
    assert_eq!(train().parameters, train().parameters);
    assert_ne!(
        NeuralField::new(&FieldConfig::default(), 1).unwrap().parameters,
        NeuralField::new(&FieldConfig::default(), 2).unwrap().parameters
    );
    // Nor does it matter which points share a chunk.
    let (field, points) = (rough(16), points(17, 100, 0.5));
    let together = values(&field, &points);
    assert!(points.iter().zip(together).all(|(p, value)| values(&field, &[*p]) == [value]));
}

#[test]
fn settings_out_of_range_are_named() {
    let good = FieldConfig::default();
    good.validate().unwrap();
    let bad = [
        ("half_extent_m", FieldConfig { half_extent_m: f32::NAN, ..good.clone() }),
        ("truncation_m", FieldConfig { truncation_m: 0.0, ..good.clone() }),
        ("truncation_m", FieldConfig { truncation_m: 0.2, ..good.clone() }),
        ("levels", FieldConfig { levels: vec![], ..good.clone() }),
        ("levels", FieldConfig { levels: vec![8, 1], ..good.clone() }),
        ("levels", FieldConfig { levels: vec![8, u32::MAX], ..good.clone() }),
        ("table_log2", FieldConfig { table_log2: 40, ..good.clone() }),
        ("hidden", FieldConfig { hidden: 24, ..good.clone() }),
        ("hidden", FieldConfig { hidden: 0, ..good.clone() }),
        ("grid_rate", FieldConfig { grid_rate: -1.0, ..good.clone() }),
        ("grid_rate", FieldConfig { grid_rate: 0.0, ..good.clone() }),
        ("initial_distance", FieldConfig { initial_distance: -1.0, ..good.clone() }),
        ("mlp_rate", FieldConfig { mlp_rate: f32::INFINITY, ..good.clone() }),
        ("initial_distance", FieldConfig { initial_distance: 2.0, ..good.clone() }),
        ("eikonal_weight", FieldConfig { eikonal_weight: -0.1, ..good.clone() }),
    ];
    for (key, config) in bad {
        let message = NeuralField::new(&config, 0).unwrap_err().to_string();
        assert!(message.contains(key), "{message}");
    }
}
