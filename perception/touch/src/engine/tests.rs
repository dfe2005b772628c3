use std::path::Path;

use safetensors::SafeTensors;

use super::attention::Attention;
use super::hierarchy::Block;
use super::layers::{Linear, Norm};
use super::mamba::{self, Mamba};
use super::map::FeatureMap;
use super::*;
use crate::network::{ScanOrder, Weights};
use mvt_products::multiply::Then;

fn weights(name: &str) -> Weights {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/fixtures/{name}.safetensors"));
    Weights::read(&path).unwrap()
}

/// Returns expected tokens, `[count, width]`.
fn tokens(name: &str) -> (Vec<f32>, usize) {
    let bytes = include_bytes!("../../tests/fixtures/expected.safetensors");
    let file = SafeTensors::deserialize(bytes).unwrap();
    let tensor = file.tensor(name).unwrap();
    (tensor.data().as_chunks::<4>().0.iter().map(|&b| f32::from_le_bytes(b)).collect(), tensor.shape()[1])
}

fn stored(values: &[f32], width: usize, [height, columns]: [usize; 2], extra: usize) -> FeatureMap {
    let mut map = FeatureMap::tokens([height, columns], extra, width);
    let channels = map.channels;
    for (to, from) in map.data.chunks_exact_mut(channels).zip(values.chunks_exact(width)) {
        to[..width].copy_from_slice(from);
    }
    map
}

/// Tokens are of the order of 1.
fn assert_alike(map: &FeatureMap, exact: &[f32], width: usize, set: Instructions) {
    let bound = if set.is_bf16() { 0.05 } else { 2e-5 };
    for (found, exact) in map.data.chunks_exact(map.channels).zip(exact.chunks_exact(width)) {
        for (found, exact) in found.iter().zip(exact) {
            assert!((found - exact).abs() < bound, "{found} is not {exact} ({set:?})");
        }
        assert!(found[width..].iter().all(|&x| x == 0.0), "channels beyond the width are not zero ({set:?})");
    }
}

#[test]
fn a_mamba_block_is_that_of_pytorch() {
    let weights = weights("default");
    let ((before, width), (after, _)) = (tokens("default.block.before"), tokens("default.block.after"));
    for set in Instructions::available() {
        let norm = Norm::new(set, &weights, "blocks.2.norm");
        let layer = Mamba::new(set, &weights, "blocks.2.mamba");
        let mut x = stored(&before, width, [3, 2], 0);
        let (mut normed, mut buffers) = (x.clone(), layer.buffers(&x));
        norm.apply(&x, &mut normed);
        let order = mamba::order(ScanOrder::Columns, &x);
        layer.apply(&normed, &order, Then::Add, &mut buffers, &mut Vec::new(), &mut x);
        assert_alike(&x, &after, width, set);
    }
}

#[test]
fn a_vit_block_is_that_of_pytorch() {
    let weights = weights("vit");
    let ((before, width), (after, _)) = (tokens("vit.block.before"), tokens("vit.block.after"));
    for set in Instructions::available() {
        let linear = |name: &str| Linear::new(set, &weights, &format!("blocks.1.mlp.{name}"));
        let [norm1, norm2] = ["norm1", "norm2"].map(|name| Norm::new(set, &weights, &format!("blocks.1.{name}")));
        let attention = Attention::new(set, &weights, "blocks.1.attn", 2);
        let mut x = stored(&before, width, [3, 4], 1);
        let (mut normed, mut words) = (x.clone(), Vec::new());
        norm1.apply(&x, &mut normed);
        attention.apply(&normed, &[], &mut attention.buffers(x.count(), 1), Then::Add, &mut words, &mut x);
        norm2.apply(&x, &mut normed);
        let mut hidden = FeatureMap::tokens([3, 4], 1, 2 * width);
        linear("fc1").apply(&normed, Then::Gelu, &mut words, &mut hidden);
        linear("fc2").apply(&hidden, Then::Add, &mut words, &mut x);
        assert_alike(&x, &after, width, set);
    }
}

/// The block of `swin` shifts its windows over a map that they do not fill.
#[test]
fn blocks_of_swin_and_convnext_are_those_of_torchvision() {
    for name in ["swin", "convnext"] {
        let weights = weights(name);
        let [(before, width), (after, _)] = ["before", "after"].map(|when| tokens(&format!("{name}.block.{when}")));
        for set in Instructions::available() {
            let block = match name {
                "swin" => Block::swin(set, &weights, "stages.0.blocks.1", [1, 3], true),
                _ => Block::convnext(set, &weights, "stages.0.blocks.1"),
            };
            let mut x = stored(&before, width, [10, 8], 0);
            block.apply(&mut block.buffers(&x), &mut Vec::new(), &mut x);
            assert_alike(&x, &after, width, set);
        }
    }
}

/// The order of columns on an image equals the order of rows on the transposed image.
#[test]
fn orders_are_permutations_and_nothing_else() {
    let weights = weights("default");
    let (values, width) = tokens("default.block.before");
    let layer = Mamba::new(Instructions::best(), &weights, "blocks.0.mamba");
    let result = |map: &FeatureMap, scan| {
        let (mut to, mut buffers) = (map.clone(), layer.buffers(map));
        layer.apply(map, &mamba::order(scan, map), Then::Store, &mut buffers, &mut Vec::new(), &mut to);
        to
    };
    let upright = stored(&values, width, [3, 2], 0);
    let mut lying = stored(&values, width, [2, 3], 0);
    for row in 0..3 {
        for column in 0..2 {
            let (from, to) = (upright.at(row, column), lying.at(column, row));
            lying.data[to..][..width].copy_from_slice(&upright.data[from..][..width]);
        }
    }
    let (a, b) = (result(&upright, ScanOrder::ColumnsReversed), result(&lying, ScanOrder::RowsReversed));
    for row in 0..3 {
        for column in 0..2 {
            assert_eq!(a.data[a.at(row, column)..][..width], b.data[b.at(column, row)..][..width]);
        }
    }
}

/// Images of other sizes are resized like PyTorch's `interpolate` without aligned corners, computed by hand.
#[test]
fn images_are_resized_with_half_pixel_centres() {
    let image = RgbImage::from_fn(2, 1, |u, _| ::image::Rgb([if u == 0 { 0 } else { 255 }, 0, 0]));
    let mut map = FeatureMap::image([2, 4], 5, 1);
    super::image::load(&image, &mut map);
    for row in 0..2 {
        let red: Vec<f32> = (0..4).map(|column| map.data[map.at(row, column)]).collect();
        assert!(red.iter().zip([-1.0, -0.5, 0.5, 1.0]).all(|(a, b)| (a - b).abs() < 1e-6), "{red:?}");
    }
    let last = &map.data[map.at(1, 3)..][..5];
    assert_eq!(last[1..], [-1.0, -1.0, 0.75, 0.5]);
}

#[test]
fn predictions_do_not_depend_on_threads_or_earlier_images() {
    let image =
        |seed: u32| RgbImage::from_fn(24, 40, |u, v| ::image::Rgb([(u * seed) as u8, (v * 3) as u8, seed as u8]));
    let images = [1, 2, 3, 4, 5].map(image);
    for name in ["mamba", "swin", "convnext"] {
        let engine = Engine::new(&weights(name), Instructions::best());
        let alone = images.each_ref().map(|image| {
            let mut prediction = Prediction::default();
            Engine::new(&weights(name), Instructions::best()).infer(image, &mut prediction).unwrap();
            prediction
        });
        for threads in [1, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut together = Vec::new();
            for _ in 0..3 {
                pool.install(|| engine.infer_each(&images.each_ref(), &mut together)).unwrap();
                assert_eq!(together, alone);
            }
        }
    }
}

#[test]
fn predictions_have_the_size_of_any_image() {
    for name in Architecture::NAMES {
        let engine = Engine::new(&weights(name), Instructions::best());
        let mut prediction = Prediction::default();
        for (width, height) in [(1, 1), (17, 30), (33, 16), (16, 33)] {
            let image = RgbImage::from_pixel(width, height, ::image::Rgb([9, 99, 199]));
            engine.infer(&image, &mut prediction).unwrap();
            assert_eq!(prediction.indentation_mm.dim(), (height as usize, width as usize), "{name}");
            assert!(prediction.indentation_mm.iter().all(|mm| mm.is_finite() && *mm >= 0.0), "{name}");
            assert!(prediction.contact_logit.iter().all(|x| x.is_finite()), "{name}");
        }
        for (width, height) in [(0, 5), (5, 0), (4, 2049)] {
            let error = engine.infer(&RgbImage::new(width, height), &mut prediction).unwrap_err();
            assert!(error.to_string().contains("240 x 320"), "{error}");
        }
    }
}

#[test]
fn weights_with_an_input_size_see_images_of_that_size() {
    let image = RgbImage::from_fn(96, 64, |u, v| ::image::Rgb([(2 * u) as u8, (3 * v) as u8, (u * v / 40) as u8]));
    let predict = |size, image: &RgbImage| {
        let weights = weights("default").with_input_size(size).unwrap();
        let mut prediction = Prediction::default();
        Engine::new(&weights, Instructions::Scalar).infer(image, &mut prediction).unwrap();
        prediction
    };
    let resized = predict(Some([32, 48]), &image);
    assert_eq!(resized.indentation_mm.dim(), (64, 96), "the prediction has the size of the image");
    // Half the size is the mean of squares of 2 x 2 pixels; rounding to whole levels changes little.
    let half = RgbImage::from_fn(48, 32, |u, v| {
        let squares = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(a, b)| image.get_pixel(2 * u + a, 2 * v + b).0);
        ::image::Rgb(
            [0, 1, 2].map(|c| (squares.iter().map(|rgb| u32::from(rgb[c])).sum::<u32>() as f32 / 4.0).round() as u8),
        )
    });
    let alone = predict(None, &half);
    for row in 0..32 {
        for column in 0..48 {
            let square =
                [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(a, b)| resized.contact_logit[[2 * row + a, 2 * column + b]]);
            // Between pixels the prediction is linear, so that the mean over a square is near the pixel inside its neighbours.
            let [low, high] = [f32::min, f32::max].map(|pick| {
                let near = |at: usize, most: usize| at.saturating_sub(1)..=(at + 1).min(most);
                let around = near(row, 31).flat_map(|v| near(column, 47).map(move |u| (v, u)));
                around.map(|(v, u)| alone.contact_logit[[v, u]]).reduce(pick).unwrap()
            });
            for value in square {
                assert!((low - 0.05..=high + 0.05).contains(&value), "{value} at {row}, {column}: {low} to {high}");
            }
        }
    }
}
