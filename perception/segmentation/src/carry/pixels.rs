//! Pixels of a depth image, and the points that they show.

use glam::{Mat3A, Vec3, Vec3A};
use mvt_frames::camera::Intrinsics;
use mvt_frames::depth::CameraDepth;
use mvt_frames::{Camera, Isometry, Model};
use ndarray::Array2;

/// Tolerance of depths near a surface: of the pose, metres, and by the sensor, metres per square metre of depth.
const TOLERANCE: [f32; 2] = [0.0015, 0.006];
/// Levels of red, green and blue that differ by less are alike.
const ALIKE_LEVELS: u8 = 30;

/// Pixels of a camera in the frame of the model.
pub struct Pixels<'a> {
    pub image: &'a CameraDepth,
    rotation: Mat3A,
    origin: Vec3A,
}

impl<'a> Pixels<'a> {
    pub fn new(image: &'a CameraDepth, model_from_camera: Isometry<Camera, Model>) -> Self {
        let (rotation, origin) = model_from_camera.to_f32();
        Self { image, rotation, origin }
    }

    /// The measured depth of a pixel, metres.
    pub fn depth_m(&self, at: (usize, usize)) -> Option<f32> {
        self.image.depth_m.get(at).copied().filter(|depth| *depth > 0.0 && depth.is_finite())
    }

    pub fn point(&self, (v, u): (usize, usize), depth_m: f32) -> Vec3 {
        let Intrinsics { fx, fy, cx, cy, .. } = self.image.intrinsics;
        let ray = Vec3A::new(((u as f64 - cx) / fx) as f32, (-(v as f64 - cy) / fy) as f32, -1.0);
        (self.origin + self.rotation * (ray * depth_m)).into()
    }

    /// The pixel and the depth at which a point of the model is seen.
    pub fn project(&self, point: Vec3) -> Option<((f32, f32), f32)> {
        let p = self.rotation.transpose() * (Vec3A::from(point) - self.origin);
        let depth = -p.z;
        let Intrinsics { fx, fy, cx, cy, .. } = self.image.intrinsics;
        let place = (cy as f32 - fy as f32 * p.y / depth, cx as f32 + fx as f32 * p.x / depth);
        (depth > 0.01).then_some((place, depth))
    }

    pub fn colour(&self, at: (usize, usize)) -> Option<[u8; 3]> {
        colour(self.image, at)
    }

    /// Depths at which points of the model are seen, metres, and their colours, drawn as squares that reach `reach` pixels; infinite elsewhere.
    pub fn drawn(&self, points: &[(Vec3, Option<[u8; 3]>)], reach: isize) -> Array2<(f32, Option<[u8; 3]>)> {
        let mut depths = Array2::from_elem(self.image.depth_m.dim(), (f32::INFINITY, None));
        let projected = points.iter().filter_map(|(point, colour)| Some((self.project(*point)?, *colour)));
        for (((v, u), depth), colour) in projected {
            let (v, u) = (v.round() as isize, u.round() as isize);
            for (dv, du) in (-reach..=reach).flat_map(|dv| (-reach..=reach).map(move |du| (dv, du))) {
                let at = usize::try_from(v + dv).ok().zip(usize::try_from(u + du).ok());
                if let Some(drawn) = at.and_then(|at| depths.get_mut(at)).filter(|drawn| depth < drawn.0) {
                    *drawn = (depth, colour);
                }
            }
        }
        depths
    }
}

/// The colour of a pixel.
pub fn colour(image: &CameraDepth, (v, u): (usize, usize)) -> Option<[u8; 3]> {
    let colour = image.colour.as_ref()?;
    (colour.width() as usize > u && colour.height() as usize > v).then(|| colour.get_pixel(u as u32, v as u32).0)
}

/// Whether two colours may be those of one place.
pub fn are_alike(a: [u8; 3], b: [u8; 3]) -> bool {
    (0..3).all(|k| a[k].abs_diff(b[k]) < ALIKE_LEVELS)
}

pub fn tolerance_m(depth_m: f32) -> f32 {
    TOLERANCE[0] + TOLERANCE[1] * depth_m * depth_m
}

/// Area that a pixel covers across its ray, square metres.
pub fn area_m2(intrinsics: &Intrinsics, depth_m: f32) -> f32 {
    depth_m * depth_m / (intrinsics.fx * intrinsics.fy) as f32
}

/// The four pixels beside one.
pub fn beside((v, u): (usize, usize), (rows, columns): (usize, usize)) -> impl Iterator<Item = (usize, usize)> {
    [(-1, 0), (1, 0), (0, -1), (0, 1)].into_iter().filter_map(move |(dv, du): (isize, isize)| {
        let (v, u) = (v.checked_add_signed(dv)?, u.checked_add_signed(du)?);
        (v < rows && u < columns).then_some((v, u))
    })
}

/// The pixels that hang together with one; `takes` says whether a pixel takes in one beside it, and must not do so twice.
pub fn region(
    start: (usize, usize),
    dim: (usize, usize),
    mut takes: impl FnMut((usize, usize), (usize, usize)) -> bool,
) -> Vec<(usize, usize)> {
    let (mut region, mut next) = (vec![start], 0);
    while let Some(&at) = region.get(next) {
        next += 1;
        region.extend(beside(at, dim).filter(|other| takes(at, *other)));
    }
    region
}

/// Rows and columns of the pixels that are set, and of those `reach` around them, each from and to before.
pub fn window(dim: (usize, usize), pixels: impl Iterator<Item = (usize, usize)>, reach: usize) -> Option<[usize; 4]> {
    let bounds = pixels.fold(None, |bounds: Option<[usize; 4]>, (v, u)| {
        let [top, bottom, left, right] = bounds.unwrap_or([v, v, u, u]);
        Some([top.min(v), bottom.max(v), left.min(u), right.max(u)])
    });
    let [top, bottom, left, right] = bounds?;
    let (top, left) = (top.saturating_sub(reach), left.saturating_sub(reach));
    Some([top, (bottom + reach + 1).min(dim.0), left, (right + reach + 1).min(dim.1)])
}

pub fn pixels([top, bottom, left, right]: [usize; 4]) -> impl Iterator<Item = (usize, usize)> {
    (top..bottom).flat_map(move |v| (left..right).map(move |u| (v, u)))
}

/// Steps in depth from a pixel to the next on a surface that is seen under up to 75 degrees, and noise, metres.
pub fn step_m(depth_m: f32) -> f32 {
    0.004 * depth_m + 0.004 * depth_m * depth_m
}
