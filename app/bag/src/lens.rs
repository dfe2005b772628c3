//! Camera models of ROS, and images without the distortion of the lens.

use image::RgbImage;
use mvt_frames::camera::Intrinsics;
use ndarray::Array2;

use crate::error::RosError;
use crate::messages::RosCameraInfo;

/// Pinhole model of a camera and the distortion of its lens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RosLens {
    /// Pinhole model, of the image without distortion, too.
    pub intrinsics: Intrinsics,
    /// k1, k2, p1, p2, k3, k4, k5, k6 of OpenCV's model; all 0 without distortion. `plumb_bob` has the first five.
    pub distortion: [f64; 8],
}

/// Greatest focal length and size, pixels: more than any camera has.
const LARGEST: f64 = 1e5;

impl RosLens {
    /// Converts a camera model. `is_rectified` says that the images are without distortion: then the projection P counts.
    ///
    /// # Errors
    /// [`RosError`] if the camera is not calibrated, or its lens model is unknown.
    pub fn new(info: &RosCameraInfo, is_rectified: bool) -> Result<Self, RosError> {
        let [fx, _, cx, _, fy, cy, ..] = info.k;
        let [pfx, _, pcx, _, _, pfy, pcy, ..] = info.p;
        let has_projection = is_rectified && pfx > 0.0 && pfy > 0.0;
        let [fx, fy, cx, cy] = if has_projection { [pfx, pfy, pcx, pcy] } else { [fx, fy, cx, cy] };
        if fx == 0.0 && fy == 0.0 {
            return Err(RosError::fault(
                "the camera is not calibrated (K is zero): calibrate it, or set the intrinsics in its driver",
            ));
        }
        let is_plausible =
            [fx, fy].iter().all(|f| *f > 0.0 && *f < LARGEST) && [cx, cy].iter().all(|c| c.abs() < LARGEST);
        let [column, row, part_width, part_height] = info.part;
        let [width, height] =
            [(part_width, info.width), (part_height, info.height)].map(|(part, all)| if part > 0 { part } else { all });
        let [across, down] = info.binning.map(|binning| binning.max(1));
        if !is_plausible || width < across || height < down || width.max(height) as f64 > LARGEST {
            let fault =
                format!("it is the model of no camera: {width} x {height} pixels, focal lengths {fx} and {fy} pixels");
            return Err(RosError::fault(fault));
        }
        // Centres of pixels are at whole numbers.
        let place = |c: f64, first: usize, binning: usize| (c - first as f64 + 0.5) / binning as f64 - 0.5;
        let intrinsics = Intrinsics {
            width: width / across,
            height: height / down,
            fx: fx / across as f64,
            fy: fy / down as f64,
            cx: place(cx, column, across),
            cy: place(cy, row, down),
        };
        let distortion = if is_rectified { [0.0; 8] } else { distortion(info)? };
        Ok(Self { intrinsics, distortion })
    }

    /// Returns the same model for images of another size.
    pub fn resized(&self, [width, height]: [usize; 2]) -> Self {
        let old = self.intrinsics;
        let (across, down) = (width as f64 / old.width as f64, height as f64 / old.height as f64);
        let place = |c: f64, scale: f64| (c + 0.5) * scale - 0.5;
        let intrinsics = Intrinsics {
            width,
            height,
            fx: old.fx * across,
            fy: old.fy * down,
            cx: place(old.cx, across),
            cy: place(old.cy, down),
        };
        Self { intrinsics, ..*self }
    }

    /// Returns the place in the camera's image (column, row) of a place in the image without distortion.
    pub fn distorted(&self, u: f64, v: f64) -> [f64; 2] {
        let Intrinsics { fx, fy, cx, cy, .. } = self.intrinsics;
        let [k1, k2, p1, p2, k3, k4, k5, k6] = self.distortion;
        let (x, y) = ((u - cx) / fx, (v - cy) / fy);
        let r2 = x * x + y * y;
        let radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        let across = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
        let down = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
        [across * fx + cx, down * fy + cy]
    }
}

/// Returns the eight numbers of a lens.
fn distortion(info: &RosCameraInfo) -> Result<[f64; 8], RosError> {
    let RosCameraInfo { model, d, .. } = info;
    if d.iter().all(|k| *k == 0.0) {
        return Ok([0.0; 8]);
    }
    if d.iter().any(|k| !k.is_finite()) {
        return Err(RosError::fault("a number of the distortion is not finite: calibrate the camera again"));
    }
    if !matches!(model.as_str(), "" | "plumb_bob" | "rational_polynomial") {
        let fault = format!(
            "the lens model {model:?} is unknown; rectify the images with image_proc, or calibrate with plumb_bob or rational_polynomial"
        );
        return Err(RosError::fault(fault));
    }
    if d.len() < 4 || d.iter().skip(8).any(|k| *k != 0.0) {
        let fault = format!(
            "the lens model {model:?} has {} numbers; 4, 5 and 8 are known: rectify the images with image_proc",
            d.len()
        );
        return Err(RosError::fault(fault));
    }
    Ok(std::array::from_fn(|k| d.get(k).copied().unwrap_or(0.0)))
}

/// Map from each pixel of an image without distortion to a place in the camera's image.
#[derive(Debug)]
pub(crate) struct Remap {
    lens: RosLens,
    /// Columns and rows; outside of the image they are not numbers.
    places: Vec<[f32; 2]>,
}

impl Remap {
    /// Builds the map; `None` if the lens does not distort.
    pub fn new(lens: &RosLens) -> Option<Self> {
        if lens.distortion == [0.0; 8] {
            return None;
        }
        let Intrinsics { width, height, .. } = lens.intrinsics;
        let (right, bottom) = (width as f64 - 0.5, height as f64 - 0.5);
        let place = |u: usize, v: usize| {
            let [u, v] = lens.distorted(u as f64, v as f64);
            let is_inside = (-0.5..right).contains(&u) && (-0.5..bottom).contains(&v);
            if is_inside { [u as f32, v as f32] } else { [f32::NAN; 2] }
        };
        let places = (0..height).flat_map(|v| (0..width).map(move |u| place(u, v))).collect();
        Some(Self { lens: *lens, places })
    }

    /// Returns whether the map was built for this lens.
    pub fn is_of(&self, lens: &RosLens) -> bool {
        self.lens == *lens
    }

    /// Returns the values of the nearest pixels; 0 outside of the camera's image.
    pub fn nearest<T: Copy + Default>(&self, from: &Array2<T>) -> Array2<T> {
        let Intrinsics { width, height, .. } = self.lens.intrinsics;
        let value = |place: &[f32; 2]| {
            let [u, v] = place.map(f32::round);
            // Numbers that are not one become 0 here, and are told apart before.
            if u.is_nan() {
                T::default()
            } else {
                from.get((v.max(0.0) as usize, u.max(0.0) as usize)).copied().unwrap_or_default()
            }
        };
        Array2::from_shape_vec((height, width), self.places.iter().map(value).collect()).unwrap_or_default()
    }

    /// Returns colours between the pixels; black outside of the camera's image.
    pub fn colours(&self, from: &RgbImage) -> RgbImage {
        let Intrinsics { width, height, .. } = self.lens.intrinsics;
        let (right, bottom) = (from.width().saturating_sub(1), from.height().saturating_sub(1));
        let mut pixels = Vec::with_capacity(3 * self.places.len());
        for place in &self.places {
            let [u, v] = *place;
            if u.is_nan() || from.width() == 0 {
                pixels.extend([0; 3]);
                continue;
            }
            let (u, v) = (u.clamp(0.0, right as f32), v.clamp(0.0, bottom as f32));
            let (column, row) = (u as u32, v as u32);
            let (next_column, next_row) = ((column + 1).min(right), (row + 1).min(bottom));
            let (a, b) = (u.fract(), v.fract());
            let corner = |column: u32, row: u32| from.get_pixel(column, row).0.map(f32::from);
            let [p, q] = [corner(column, row), corner(next_column, row)];
            let [r, s] = [corner(column, next_row), corner(next_column, next_row)];
            pixels.extend(std::array::from_fn::<u8, 3, _>(|k| {
                let top = p[k] + a * (q[k] - p[k]);
                let below = r[k] + a * (s[k] - r[k]);
                (top + b * (below - top)).round() as u8
            }));
        }
        RgbImage::from_raw(width as u32, height as u32, pixels).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn info(model: &str, d: &[f64]) -> RosCameraInfo {
        RosCameraInfo {
            header: crate::RosHeader::default(),
            width: 64,
            height: 48,
            model: model.to_owned(),
            d: d.to_vec(),
            k: [60.0, 0.0, 31.5, 0.0, 61.0, 23.5, 0.0, 0.0, 1.0],
            p: [50.0, 0.0, 30.0, 0.0, 0.0, 51.0, 22.0, 0.0, 0.0, 0.0, 1.0, 0.0],
            binning: [0; 2],
            part: [0; 4],
        }
    }

    #[test]
    fn a_straight_edge_stays_straight() {
        let lens = RosLens::new(&info("plumb_bob", &[-0.2, 0.02, 0.001, -0.002, 0.0]), false).unwrap();
        let remap = Remap::new(&lens).unwrap();
        // An image whose colour and depth are the place in the image without distortion, seen through the lens: the inverse by iteration.
        let straight = |u: f64, v: f64| {
            let mut at = [u, v];
            for _ in 0..50 {
                let [x, y] = lens.distorted(at[0], at[1]);
                at = [at[0] - (x - u), at[1] - (y - v)];
            }
            at
        };
        let seen = RgbImage::from_fn(64, 48, |u, v| {
            let [x, y] = straight(u.into(), v.into());
            [(2.0 * x).round() as u8, (3.0 * y).round() as u8, 7].into()
        });
        let found = remap.colours(&seen);
        for (u, v) in [(32, 24), (10, 9), (50, 40), (20, 40)] {
            let [x, y, z] = found.get_pixel(u, v).0;
            assert!(x.abs_diff(2 * u as u8) <= 1 && y.abs_diff(3 * v as u8) <= 1 && z == 7, "{u} {v}: {x} {y}");
        }
        let depth = Array2::from_shape_fn((48, 64), |(v, u)| straight(u as f64, v as f64)[0] as f32);
        assert!((remap.nearest(&depth)[(9, 10)] - 10.0).abs() < 0.6);
    }

    #[test]
    fn rectified_images_have_the_projection_and_no_distortion() {
        let lens = RosLens::new(&info("plumb_bob", &[-0.2, 0.0, 0.0, 0.0, 0.0]), true).unwrap();
        assert_eq!((lens.intrinsics.fx, lens.intrinsics.cy, lens.distortion), (50.0, 22.0, [0.0; 8]));
        assert!(Remap::new(&lens).is_none());
    }

    #[test]
    fn unknown_lenses_are_refused_unless_their_numbers_are_zero() {
        assert!(RosLens::new(&info("equidistant", &[0.0; 4]), false).is_ok());
        let error = RosLens::new(&info("equidistant", &[0.1, 0.0, 0.0, 0.0]), false).unwrap_err().to_string();
        assert!(error.contains("rectify the images"), "{error}");
        let eight = [0.1, 0.2, 0.0, 0.0, 0.3, 0.4, 0.5, 0.6];
        assert_eq!(RosLens::new(&info("rational_polynomial", &eight), false).unwrap().distortion, eight);
        let mut zero = info("plumb_bob", &[]);
        zero.k = [0.0; 9];
        assert!(RosLens::new(&zero, false).unwrap_err().to_string().contains("not calibrated"));
    }

    #[test]
    fn binning_and_parts_move_the_principal_point() {
        let mut part = info("plumb_bob", &[]);
        part.binning = [2, 2];
        part.part = [8, 4, 32, 24];
        let k = RosLens::new(&part, false).unwrap().intrinsics;
        assert_eq!([k.width, k.height], [16, 12]);
        assert_eq!([k.fx, k.fy, k.cx, k.cy], [30.0, 30.5, 11.5, 9.5]);
    }
}
