//! Grey levels of segmentation images and masks.

use image::GrayImage;
use mvt_frames::depth::Label;
use ndarray::Array2;

/// Returns the image of the grey levels of an array's elements.
pub(crate) fn image_of<T>(array: &Array2<T>, grey: impl Fn(&T) -> u8) -> GrayImage {
    let (height, width) = array.dim();
    // There are as many levels as pixels, so that the image is always made.
    GrayImage::from_raw(width as u32, height as u32, array.iter().map(grey).collect()).unwrap_or_default()
}

/// Returns the labels of an image.
pub(crate) fn labels_of(image: &GrayImage) -> Array2<Label> {
    let labels = image.iter().map(|&grey| nearest(grey)).collect();
    // There are as many pixels as labels, so that the shape always fits.
    Array2::from_shape_vec((image.height() as usize, image.width() as usize), labels).unwrap_or_default()
}

/// Returns the label whose level is nearest to a grey that JPEG may have changed: `round(grey / 127.5)` of 0, 1, 2, as
/// NeuralFeels' loaders do.
fn nearest(grey: u8) -> Label {
    match grey {
        0..64 => Label::Background,
        64..192 => Label::Hand,
        192.. => Label::Object,
    }
}

/// Returns whether a grey is exactly the level of background, hand or object.
pub(crate) fn is_level(grey: u8) -> bool {
    nearest(grey).grey() == grey
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segmentation_survives_jpeg_as_in_the_loaders() {
        let loaded = [Label::Background, Label::Hand, Label::Object];
        for grey in 0..=255u8 {
            let rounded = (f64::from(grey) / 127.5).round() as usize;
            assert_eq!(nearest(grey), loaded[rounded], "{grey}");
            assert_eq!(is_level(grey), [0, 127, 255].contains(&grey), "{grey}");
        }
    }

    #[test]
    fn an_image_of_labels_gives_the_labels_back() {
        let labels = Array2::from_shape_fn((3, 5), |(row, column)| match (row + column) % 3 {
            0 => Label::Background,
            1 => Label::Hand,
            _ => Label::Object,
        });
        let image = image_of(&labels, |label| label.grey());
        assert_eq!(image.dimensions(), (5, 3));
        assert_eq!(labels_of(&image), labels);
    }
}
