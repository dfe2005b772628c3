//! Conversion of a sensor's image to a network's input, resizing of maps, and conversion of a network's output to planes.

use image::RgbImage;
use pulp::{Simd, WithSimd};

use super::map::FeatureMap;
use super::pass::Prediction;
use mvt_products::Instructions;
use mvt_products::math::multiply_add;

/// Two neighbours of a place between them, and the share of the second.
type Between = (usize, usize, f32);

/// Returns the place of pixel `at` of `to` among `from` pixels if both images span the same square: centres lie half a pixel inside.
pub(super) fn half_pixel(at: usize, from: usize, to: usize) -> Between {
    between(((at as f32 + 0.5) * from as f32 / to as f32 - 0.5).max(0.0), from)
}

/// Returns the place of pixel `at` of `to` among `from` pixels if the first and the last pixels of both coincide.
fn aligned(at: usize, from: usize, to: usize) -> Between {
    between(at as f32 * (from - 1) as f32 / (to - 1).max(1) as f32, from)
}

fn between(place: f32, count: usize) -> Between {
    let first = (place as usize).min(count - 1);
    (first, (first + 1).min(count - 1), (place - first as f32).clamp(0.0, 1.0))
}

/// Writes an image to the input map of a network, resized to the map's size: levels from -1 to 1 and, if the map has the channels, the
/// two coordinates.
pub(super) fn load(image: &RgbImage, map: &mut FeatureMap) {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let is_same = [height, width] == [map.height, map.width];
    let bytes: &[u8] = image;
    let coordinate = |at: usize, count: usize| 2.0 * (at as f32 + 0.5) / count as f32 - 1.0;
    for row in 0..map.height {
        let (above, below, down) = half_pixel(row, height, map.height);
        let [above, below] = [above, below].map(|row| bytes[row * 3 * width..][..3 * width].as_chunks::<3>().0);
        let y = coordinate(row, map.height);
        let (first, columns, channels) = (map.at(row, 0), map.width, map.channels);
        let pixels = map.data[first..][..columns * channels].chunks_exact_mut(channels);
        for (column, pixel) in pixels.enumerate() {
            let rgb = if is_same {
                above[column].map(f32::from)
            } else {
                let (left, right, along) = half_pixel(column, width, columns);
                std::array::from_fn(|c| {
                    let row = |pixels: &[[u8; 3]]| {
                        let [left, right] = [left, right].map(|at| f32::from(pixels[at][c]));
                        left + along * (right - left)
                    };
                    let [above, below] = [row(above), row(below)];
                    above + down * (below - above)
                })
            };
            for (to, level) in pixel.iter_mut().zip(rgb) {
                *to = level / 127.5 - 1.0;
            }
            if let [_, _, _, x_to, y_to, ..] = pixel {
                (*x_to, *y_to) = (coordinate(column, columns), y);
            }
        }
    }
}

/// Writes the two channels of a map after depth to space by `FACTOR`, resized to the prediction's size.
pub(super) fn store<const FACTOR: usize>(map: &FeatureMap, to: &mut Prediction) {
    let Prediction { indentation_mm, contact_logit } = to;
    let (height, width) = (map.height * FACTOR, map.width * FACTOR);
    let value = |row: usize, column: usize| {
        let part = (row % FACTOR) * FACTOR + column % FACTOR;
        let at = map.at(row / FACTOR, column / FACTOR) + 2 * part;
        [map.data[at], map.data[at + 1]]
    };
    let mix = |[a0, a1]: [f32; 2], [b0, b1]: [f32; 2], share: f32| [a0 + share * (b0 - a0), a1 + share * (b1 - a1)];
    let (rows, columns) = indentation_mm.dim();
    let is_same = [rows, columns] == [height, width];
    let lines = indentation_mm.rows_mut().into_iter().zip(contact_logit.rows_mut());
    for (row, (mut indentation, mut contact)) in lines.enumerate() {
        let (above, below, down) = half_pixel(row, height, rows);
        for (column, (mm, logit)) in indentation.iter_mut().zip(&mut contact).enumerate() {
            let [depth, score] = if is_same {
                value(row, column)
            } else {
                let (left, right, along) = half_pixel(column, width, columns);
                let [above, below] = [above, below].map(|row| mix(value(row, left), value(row, right), along));
                mix(above, below, down)
            };
            (*mm, *logit) = (depth.max(0.0), score);
        }
    }
}

/// Resizes a map to the size of another, the corners of both in the same places. The result is stored or added.
pub(super) fn resample(instructions: Instructions, from: &FeatureMap, is_added: bool, to: &mut FeatureMap) {
    instructions.run(Resample { from, is_added, to });
}

struct Resample<'a> {
    from: &'a FeatureMap,
    is_added: bool,
    to: &'a mut FeatureMap,
}

impl WithSimd for Resample<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { from, is_added, to } = self;
        let channels = to.channels;
        for row in 0..to.height {
            let (above, below, down) = aligned(row, from.height, to.height);
            let down = simd.splat_f32s(down);
            for column in 0..to.width {
                let (left, right, along) = aligned(column, from.width, to.width);
                let along = simd.splat_f32s(along);
                let corner = |row, column| S::as_simd_f32s(&from.data[from.at(row, column)..][..channels]).0;
                let (a, b) = (corner(above, left), corner(above, right));
                let (c, d) = (corner(below, left), corner(below, right));
                let at = to.at(row, column);
                let pixel = S::as_mut_simd_f32s(&mut to.data[at..][..channels]).0;
                for (k, to) in pixel.iter_mut().enumerate() {
                    let top = multiply_add(simd, along, simd.sub_f32s(b[k], a[k]), a[k]);
                    let bottom = multiply_add(simd, along, simd.sub_f32s(d[k], c[k]), c[k]);
                    let value = multiply_add(simd, down, simd.sub_f32s(bottom, top), top);
                    *to = if is_added { simd.add_f32s(*to, value) } else { value };
                }
            }
        }
    }
}
