//! Text on images, in the font Ubuntu Light.

use ab_glyph::{Font, FontRef, PxScale, ScaleFont};
use image::{Rgb, RgbImage};

use crate::draw::blend;

/// Writes a line of text whose upper left corner is (x, y) and whose height is `size`, in pixels. Parts outside the
/// image are skipped.
pub fn write(image: &mut RgbImage, (x, y): (u32, u32), size: f32, colour: Rgb<u8>, text: &str) {
    let Some(font) = font() else { return };
    let font = font.as_scaled(PxScale::from(size));
    let mut pen = x as f32;
    let mut previous = None;
    for character in text.chars() {
        let id = font.glyph_id(character);
        pen += previous.map_or(0.0, |previous| font.kern(previous, id));
        let glyph = id.with_scale_and_position(font.scale(), ab_glyph::point(pen, y as f32 + font.ascent()));
        pen += font.h_advance(id);
        previous = Some(id);
        if let Some(outline) = font.outline_glyph(glyph) {
            let corner = outline.px_bounds().min;
            outline.draw(|dx, dy, coverage| {
                let (px, py) = (corner.x as i64 + i64::from(dx), corner.y as i64 + i64::from(dy));
                if let (Ok(px), Ok(py)) = (u32::try_from(px), u32::try_from(py)) {
                    blend(image, px, py, colour, coverage);
                }
            });
        }
    }
}

/// Returns the width of a line of text, pixels.
pub fn width(size: f32, text: &str) -> u32 {
    let Some(font) = font() else { return 0 };
    let font = font.as_scaled(PxScale::from(size));
    text.chars().map(|character| font.h_advance(font.glyph_id(character))).sum::<f32>().round() as u32
}

fn font() -> Option<FontRef<'static>> {
    FontRef::try_from_slice(epaint_default_fonts::UBUNTU_LIGHT).ok()
}
