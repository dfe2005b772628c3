//! Pixels of images: colours, depth and labels.

use image::{DynamicImage, Rgb, RgbImage};
use ndarray::Array2;

use crate::error::RosError;
use crate::messages::{RosCompressedImage, RosImage};
use crate::rvl;

/// Most pixels of an image: more than any camera has.
const MOST_PIXELS: usize = 1 << 26;
/// Most pixels of an image in RVL, which a few bytes can promise: more than any camera of depth has.
const MOST_OF_RVL: usize = 1 << 23;
/// Bytes before the file in an image of the transport `compressedDepth`: an enumeration and two numbers.
const DEPTH_HEAD: usize = 12;

/// Returns pixels as an array of rows and columns.
fn array<T: Copy + Default>(width: usize, height: usize, pixels: Vec<T>) -> Array2<T> {
    // There are as many pixels as the image has.
    Array2::from_shape_vec((height, width), pixels).unwrap_or_default()
}

/// Returns a depth in metres, 0 where nothing was measured.
fn measured(metres: f32) -> f32 {
    if metres.is_finite() && metres > 0.0 { metres } else { 0.0 }
}

fn metres_of_levels(levels: impl Iterator<Item = u16>, unit_m: f64) -> Vec<f32> {
    levels.map(|level| (f64::from(level) * unit_m) as f32).collect()
}

impl RosImage<'_> {
    /// Returns the used bytes of each row.
    fn rows(&self, bytes_per_pixel: usize) -> Result<impl Iterator<Item = &[u8]>, RosError> {
        let Self { width, height, step, data, .. } = *self;
        if width == 0 || height == 0 || width.saturating_mul(height) > MOST_PIXELS {
            return Err(RosError::fault(format!("an image of {width} x {height} pixels is that of no camera")));
        }
        let used = width * bytes_per_pixel;
        if step < used {
            let fault = format!("a row has {step} bytes (step), but {width} pixels of {} need {used}", self.encoding);
            return Err(RosError::fault(fault));
        }
        if step.checked_mul(height).is_none_or(|size| data.len() < size) {
            let have = data.len();
            let fault = format!(
                "it has {have} bytes of pixels, but {height} rows of {step} bytes: it was cut off; record it again"
            );
            return Err(RosError::fault(fault));
        }
        Ok(data.chunks_exact(step).take(height).filter_map(move |row| row.get(..used)))
    }

    fn unknown(&self, purpose: &str, known: &str) -> RosError {
        RosError::fault(format!("the encoding {:?} is none of {purpose}; known are {known}", self.encoding))
    }

    fn numbers_of_16_bits(&self) -> Result<Vec<u16>, RosError> {
        let of = if self.is_big_endian { u16::from_be_bytes } else { u16::from_le_bytes };
        let mut numbers = Vec::with_capacity(self.data.len() / 2);
        for row in self.rows(2)? {
            numbers.extend(row.as_chunks::<2>().0.iter().map(|pair| of(*pair)));
        }
        Ok(numbers)
    }

    /// Returns the colours; grey images become grey colours, and Bayer patterns are interpolated.
    ///
    /// # Errors
    /// [`RosError`] if the encoding has no colours, or the data are shorter than the image.
    pub fn colours(&self) -> Result<RgbImage, RosError> {
        let (size, order): (usize, [usize; 3]) = match self.encoding {
            "rgb8" => (3, [0, 1, 2]),
            "bgr8" | "8UC3" => (3, [2, 1, 0]),
            "rgba8" => (4, [0, 1, 2]),
            "bgra8" | "8UC4" => (4, [2, 1, 0]),
            "mono8" | "8UC1" => (1, [0, 0, 0]),
            "bayer_rggb8" => return self.bayer([0, 0]),
            "bayer_grbg8" => return self.bayer([1, 0]),
            "bayer_gbrg8" => return self.bayer([0, 1]),
            "bayer_bggr8" => return self.bayer([1, 1]),
            _ => return Err(self.unknown("colour images", "rgb8, bgr8, rgba8, bgra8, mono8 and bayer_*8")),
        };
        let rows = self.rows(size)?;
        let mut pixels = Vec::with_capacity(3 * self.width * self.height);
        for row in rows {
            if order == [0, 1, 2] && size == 3 {
                pixels.extend_from_slice(row);
            } else {
                pixels
                    .extend(row.chunks_exact(size).flat_map(|pixel| order.map(|k| pixel.get(k).copied().unwrap_or(0))));
            }
        }
        Ok(RgbImage::from_raw(self.width as u32, self.height as u32, pixels).unwrap_or_default())
    }

    /// Interpolates a Bayer pattern; the first red pixel is in this column and row.
    fn bayer(&self, [red_column, red_row]: [usize; 2]) -> Result<RgbImage, RosError> {
        let rows: Vec<&[u8]> = self.rows(1)?.collect();
        let level = |column: usize, row: usize| rows.get(row).and_then(|row| row.get(column)).copied().unwrap_or(0);
        // 0 red, 1 green, 2 blue.
        let colour = |column: usize, row: usize| match ((column + red_column) % 2, (row + red_row) % 2) {
            (0, 0) => 0,
            (1, 1) => 2,
            _ => 1,
        };
        Ok(RgbImage::from_fn(self.width as u32, self.height as u32, |x, y| {
            let (column, row) = (x as usize, y as usize);
            let (mut sums, mut counts) = ([0u32; 3], [0u32; 3]);
            for near_row in row.saturating_sub(1)..=(row + 1).min(self.height - 1) {
                for near_column in column.saturating_sub(1)..=(column + 1).min(self.width - 1) {
                    let of = colour(near_column, near_row);
                    if let (Some(sum), Some(count)) = (sums.get_mut(of), counts.get_mut(of)) {
                        *sum += u32::from(level(near_column, near_row));
                        *count += 1;
                    }
                }
            }
            let own = colour(column, row);
            Rgb(std::array::from_fn(|of| {
                let mean = (sums[of] + counts[of] / 2).checked_div(counts[of]).unwrap_or(0);
                if of == own { level(column, row) } else { mean.min(255) as u8 }
            }))
        }))
    }

    /// Returns depth in metres, 0 where nothing was measured. `unit_m` is that of levels of 16 bits; numbers with fractions are metres.
    ///
    /// # Errors
    /// [`RosError`] if the encoding is not one of depth, or the data are shorter than the image.
    pub fn depth_m(&self, unit_m: f64) -> Result<Array2<f32>, RosError> {
        let metres = match self.encoding {
            "16UC1" | "mono16" => metres_of_levels(self.numbers_of_16_bits()?.into_iter(), unit_m),
            "32FC1" => {
                let of = if self.is_big_endian { f32::from_be_bytes } else { f32::from_le_bytes };
                let mut metres = Vec::with_capacity(self.data.len() / 4);
                for row in self.rows(4)? {
                    metres.extend(row.as_chunks::<4>().0.iter().map(|four| measured(of(*four))));
                }
                metres
            }
            _ => return Err(self.unknown("depth images", "16UC1, mono16 and 32FC1")),
        };
        Ok(array(self.width, self.height, metres))
    }

    /// Returns labels.
    ///
    /// # Errors
    /// [`RosError`] if the encoding is not one of labels, or the data are shorter than the image.
    pub fn labels(&self) -> Result<Array2<u16>, RosError> {
        let labels = match self.encoding {
            "8UC1" | "mono8" => self.rows(1)?.flatten().map(|level| u16::from(*level)).collect(),
            "16UC1" | "mono16" => self.numbers_of_16_bits()?,
            // A mask in three equal colours.
            "rgb8" | "bgr8" | "8UC3" => self.rows(3)?.flat_map(|row| row.chunks_exact(3)).map(green).collect(),
            _ => return Err(self.unknown("label images", "8UC1, mono8, 16UC1, mono16, rgb8 and bgr8")),
        };
        Ok(array(self.width, self.height, labels))
    }
}

/// Returns the middle one of three colours.
fn green(pixel: &[u8]) -> u16 {
    pixel.get(1).copied().unwrap_or(0).into()
}

/// Levels of a compressed depth image and how they become metres.
struct DepthLevels {
    levels: Array2<u16>,
    /// Numbers a and b of an inverse depth a / (level - b), metres; without them levels are counted in a unit.
    inverse: Option<[f32; 2]>,
}

impl RosCompressedImage<'_> {
    fn image(&self) -> Result<DynamicImage, RosError> {
        mvt_images::decode(self.data, None)
            .map_err(|reason| RosError::fault(format!("{reason} (format {:?})", self.format)))
    }

    /// Returns whether the transport is `compressedDepth`.
    pub(crate) fn is_depth(format: &str) -> bool {
        format.contains("compressedDepth")
    }

    /// Returns the colours of a JPEG or PNG file.
    ///
    /// # Errors
    /// [`RosError`] if the file is damaged, or is one of depth.
    pub fn colours(&self) -> Result<RgbImage, RosError> {
        if Self::is_depth(self.format) {
            return Err(RosError::fault(format!("it is a depth image ({:?}), not one of colours", self.format)));
        }
        Ok(self.image()?.into_rgb8())
    }

    /// Returns depth in metres, 0 where nothing was measured, of a PNG file of 16 bits or an image of the transport `compressedDepth`.
    /// `unit_m` is that of levels of 16 bits.
    ///
    /// # Errors
    /// [`RosError`] if the file is damaged, or is not one of depth.
    pub fn depth_m(&self, unit_m: f64) -> Result<Array2<f32>, RosError> {
        let DepthLevels { levels, inverse } = self.depth_levels()?;
        Ok(match inverse {
            None => levels.mapv(|level| (f64::from(level) * unit_m) as f32),
            Some([a, b]) => levels.mapv(|level| if level == 0 { 0.0 } else { measured(a / (f32::from(level) - b)) }),
        })
    }

    fn depth_levels(&self) -> Result<DepthLevels, RosError> {
        let wrong = |image: &DynamicImage| {
            RosError::fault(format!(
                "a depth image has one channel of 16 bits; this one is {:?} ({:?})",
                image.color(),
                self.format
            ))
        };
        let levels_of = |image: DynamicImage| match image {
            DynamicImage::ImageLuma16(image) => {
                let (width, height) = (image.width() as usize, image.height() as usize);
                Ok(array(width, height, image.into_raw()))
            }
            other => Err(wrong(&other)),
        };
        if !Self::is_depth(self.format) {
            return Ok(DepthLevels { levels: levels_of(self.image()?)?, inverse: None });
        }
        let Some((head, file)) = self.data.split_first_chunk::<DEPTH_HEAD>() else {
            return Err(RosError::fault("a compressed depth image is shorter than its head: record it again"));
        };
        let number = |at: usize| f32::from_le_bytes(std::array::from_fn(|k| head.get(at + k).copied().unwrap_or(0)));
        let inverse = self.format.trim_start().starts_with("32FC1").then(|| [number(4), number(8)]);
        let levels = if self.format.contains("rvl") {
            rvl::decode(file, MOST_OF_RVL).map_err(RosError::fault)?
        } else {
            let image = mvt_images::decode(file, None).map_err(|reason| RosError::fault(reason.to_string()))?;
            levels_of(image)?
        };
        Ok(DepthLevels { levels, inverse })
    }

    /// Returns the labels of a PNG file or, for masks, a JPEG file.
    ///
    /// # Errors
    /// [`RosError`] if the file is damaged, or has colours.
    pub fn labels(&self) -> Result<Array2<u16>, RosError> {
        let image = self.image()?;
        let (width, height) = (image.width() as usize, image.height() as usize);
        let labels = match image {
            DynamicImage::ImageLuma16(image) => image.into_raw(),
            image => {
                let grey = mvt_images::levels(image).map_err(|reason| RosError::fault(reason.to_string()))?;
                grey.into_raw().into_iter().map(u16::from).collect()
            }
        };
        Ok(array(width, height, labels))
    }

    /// Returns whether the file lost levels: JPEG blurs the edges of masks.
    pub(crate) fn is_lossy(&self) -> bool {
        self.data.starts_with(&[0xff, 0xd8])
    }
}
