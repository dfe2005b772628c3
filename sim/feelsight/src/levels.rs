//! Grey levels of segmentation images.

use mvt_frames::depth::{BACKGROUND, HAND, OBJECT};

/// Returns the level nearest to a grey that JPEG may have changed: `round(grey / 127.5)` of 0, 1, 2, as NeuralFeels'
/// loaders do.
pub(crate) fn nearest_level(grey: u8) -> u8 {
    match grey {
        0..64 => BACKGROUND,
        64..192 => HAND,
        192.. => OBJECT,
    }
}

/// Returns whether a grey is one of the levels.
pub(crate) fn is_level(grey: u8) -> bool {
    [BACKGROUND, HAND, OBJECT].contains(&grey)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segmentation_survives_jpeg_as_in_the_loaders() {
        for grey in 0..=255u8 {
            let rounded = (f64::from(grey) / 127.5).round() as usize;
            assert_eq!(nearest_level(grey), [BACKGROUND, HAND, OBJECT][rounded], "{grey}");
            assert_eq!(is_level(grey), nearest_level(grey) == grey, "{grey}");
        }
    }
}
