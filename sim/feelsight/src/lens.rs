//! Distortion of a camera's lens, which is removed from the images of recorded logs.

use image::{ImageBuffer, Pixel};
use mvt_frames::camera::Intrinsics;

/// Map from each pixel of an image without distortion to the pixel of the camera's image: `None` outside that image.
#[derive(Debug)]
pub(crate) struct Lens(Vec<Option<u32>>);

impl Lens {
    /// Builds the map of OpenCV's model with coefficients k1, k2, p1, p2, k3: nearest pixel, same intrinsics, as
    /// NeuralFeels' loaders do. Returns `None` if all coefficients are 0.
    pub fn new(intrinsics: &Intrinsics, [k1, k2, p1, p2, k3]: [f64; 5]) -> Option<Self> {
        if [k1, k2, p1, p2, k3] == [0.0; 5] {
            return None;
        }
        let &Intrinsics { width, height, fx, fy, cx, cy } = intrinsics;
        let pixels = (0..height).flat_map(|row| (0..width).map(move |column| (row, column)));
        let source = |(row, column): (usize, usize)| {
            let (x, y) = ((column as f64 - cx) / fx, (row as f64 - cy) / fy);
            let r2 = x * x + y * y;
            let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
            let u = (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) * fx + cx;
            let v = (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y) * fy + cy;
            let (u, v) = (u.round(), v.round());
            let inside = (0.0..width as f64).contains(&u) && (0.0..height as f64).contains(&v);
            inside.then(|| (v as usize * width + u as usize) as u32)
        };
        Some(Self(pixels.map(source).collect()))
    }

    /// Removes the distortion from one value per pixel; zero outside the camera's image.
    pub fn straighten<T: Copy + Default>(&self, values: &[T]) -> Vec<T> {
        self.0.iter().map(|&from| from.and_then(|i| values.get(i as usize).copied()).unwrap_or_default()).collect()
    }

    /// Removes the distortion from an image; black outside the camera's image.
    pub fn straighten_image<P>(&self, image: &ImageBuffer<P, Vec<u8>>) -> ImageBuffer<P, Vec<u8>>
    where
        P: Pixel<Subpixel = u8>,
    {
        let pixel = |i: usize| self.0.get(i).copied().flatten();
        let width = image.width();
        let black = P::from_slice(&[0; 4][..usize::from(P::CHANNEL_COUNT)]);
        ImageBuffer::from_fn(width, image.height(), |x, y| {
            pixel((y * width + x) as usize).map_or(*black, |from| *image.get_pixel(from % width, from / width))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_barrel_lens_takes_pixels_from_nearer_to_the_centre() {
        let intrinsics = Intrinsics { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5 };
        let lens = Lens::new(&intrinsics, [-0.2, 0.0, 0.0, 0.0, 0.0]).unwrap();
        // x = y = 0.4: radius^2 0.32, factor 1 - 0.2 * 0.32 = 0.936, 24 -> 22.464 pixels from the centre.
        let (row, column) = (47, 55);
        let (x, y) = ((55.0 - 31.5) / 60.0, (47.0 - 23.5) / 60.0);
        let factor = 1.0 - 0.2 * (x * x + y * y);
        let from = f64::round(23.5 + 60.0 * y * factor) * 64.0 + f64::round(31.5 + 60.0 * x * factor);
        assert_eq!(lens.0[row * 64 + column], Some(from as u32));
        assert_eq!(lens.0[24 * 64 + 32], Some(24 * 64 + 32));
        assert!(Lens::new(&intrinsics, [0.0; 5]).is_none());
    }
}
