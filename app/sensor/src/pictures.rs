//! Pictures of the contact on a touch sensor.

use image::imageops::{FilterType, resize};
use image::{Rgb, RgbImage};
use mvt_picture::{draw, palette};
use mvt_shear::{DotMotion, ShearField};
use ndarray::Array2;

/// Colour of the outline of contact and of arrows.
const OUTLINE: Rgb<u8> = Rgb([240, 228, 66]);
/// Pixels of a picture of shear per pixel of the image.
const ENLARGED: u32 = 2;
/// Arrows are so many times as long as the motion of their dots, which is a few pixels.
const LENGTHENED: f64 = 3.0;

/// Paints indentation up to a depth, with the outline of contact.
pub fn indentation(indentation_mm: &Array2<f32>, contact: &Array2<bool>, deepest_mm: f32) -> RgbImage {
    let (height, width) = indentation_mm.dim();
    let touches = |u: usize, v: usize| contact.get((v, u)).is_some_and(|touches| *touches);
    RgbImage::from_fn(width as u32, height as u32, |u, v| {
        let (u, v) = (u as usize, v as usize);
        let is_outside = |u: usize, v: usize| u < width && v < height && !touches(u, v);
        // An index before the first one is beyond the last one, too.
        let beside = [(u.wrapping_sub(1), v), (u + 1, v), (u, v.wrapping_sub(1)), (u, v + 1)];
        if touches(u, v) && beside.into_iter().any(|(u, v)| is_outside(u, v)) {
            OUTLINE
        } else {
            palette::indentation(indentation_mm[[v, u]], deepest_mm)
        }
    })
}

/// Paints an image with an arrow from each dot, which shows where it has moved, three times as long as its way.
pub fn shear(image: &RgbImage, field: &ShearField) -> RgbImage {
    let mut picture = resize(image, ENLARGED * image.width(), ENLARGED * image.height(), FilterType::Triangle);
    let scale = f64::from(ENLARGED);
    for DotMotion { untouched_px, now_px, .. } in &field.dots {
        let place = |share: f64| {
            [0, 1].map(|k| (scale * (untouched_px[k] + share * (now_px[k] - untouched_px[k]) + 0.5) - 0.5) as f32)
        };
        draw::arrow(&mut picture, place(0.0), place(LENGTHENED), 1.5, OUTLINE);
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contact_has_an_outline_and_dots_have_arrows() {
        let contact = Array2::from_shape_fn((32, 24), |(v, u)| (10..20).contains(&v) && (5..15).contains(&u));
        let picture = indentation(&Array2::zeros((32, 24)), &contact, 1.5);
        let outlined = picture.pixels().filter(|pixel| **pixel == OUTLINE).count();
        assert_eq!(outlined, 36);

        let dot = DotMotion { untouched_px: [6.0, 8.0], now_px: [9.0, 8.0], moved_mm: [0.15, 0.0] };
        let picture = shear(&RgbImage::new(24, 32), &ShearField { dots: vec![dot], fit: None });
        // From column 12.5 to 30.5 of row 16.5.
        let is_drawn = |u, v| picture.get_pixel(u, v).0[0] > 100;
        assert!(is_drawn(14, 16) && is_drawn(29, 16) && !is_drawn(34, 16) && !is_drawn(10, 16));
    }
}
