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

/// Returns as many whole clauses of a sentence, which semicolons separate, as fit into `room` pixels, with an ellipsis where some
/// are missing. The first clause always stays.
pub fn shortened(size: f32, sentence: &str, room: u32) -> String {
    let mut shorter = sentence.to_owned();
    let mut clauses = sentence;
    while width(size, &shorter) > room
        && let Some((earlier, _)) = clauses.rsplit_once("; ")
    {
        clauses = earlier;
        shorter = format!("{earlier} …");
    }
    shorter
}

fn font() -> Option<FontRef<'static>> {
    FontRef::try_from_slice(epaint_default_fonts::UBUNTU_LIGHT).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_clauses_stay_as_far_as_they_fit() {
        let sentence = "Tracking; one finger touches; time is up";
        let shorter = |room| shortened(12.0, sentence, room);
        assert_eq!(shorter(width(12.0, sentence)), sentence);
        let room = width(12.0, "Tracking; one finger touches …");
        assert_eq!(shorter(room), "Tracking; one finger touches …");
        assert_eq!(shorter(room - 1), "Tracking …");
        assert_eq!(shorter(0), "Tracking …");
    }
}
