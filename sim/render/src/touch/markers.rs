//! Dots on the gel, where the pressed and dragged gel has taken them.

use image::RgbImage;
use mvt_frames::camera::Intrinsics;
use mvt_robot::digit::gel::GelSurface;
use mvt_robot::digit::markers::{GelMotion, GelShear, MarkerPattern};
use ndarray::Array2;

/// Half of the width over which a dot fades without blur, pixels: that of a pixel.
const EDGE_PX: f32 = 0.5;

/// Dots of one sensor.
pub(super) struct Markers {
    camera: Intrinsics,
    gel: GelSurface,
    darkness: f32,
    /// Half of the width over which a dot fades, pixels.
    edge_px: f32,
    radius_mm: f64,
    places_mm: Vec<[f64; 2]>,
}

impl Markers {
    /// Prepares the dots of a pattern. The camera's blur softens them.
    pub fn new(pattern: &MarkerPattern, camera: Intrinsics, gel: GelSurface, blur_px: f32) -> Self {
        Self {
            camera,
            gel,
            darkness: pattern.darkness,
            edge_px: EDGE_PX + blur_px,
            radius_mm: 0.5 * pattern.diameter_mm,
            places_mm: pattern.places_mm().collect(),
        }
    }

    /// Darkens the dots of an untouched gel.
    pub fn paint_untouched(&self, image: &mut RgbImage) {
        self.places_mm.iter().for_each(|place| self.paint_dot(*place, image));
    }

    /// Darkens the dots of a gel whose depth is `depth_m` and that an object drags along where it touches.
    pub fn paint(
        &self,
        shear: GelShear,
        gel_depth_m: &[f32],
        depth_m: &Array2<f32>,
        contact: &Array2<bool>,
        image: &mut RgbImage,
    ) {
        match self.motion(shear, gel_depth_m, depth_m, contact) {
            Some(motion) => self.places_mm.iter().for_each(|place| self.paint_dot(motion.moved(*place), image)),
            None => self.paint_untouched(image),
        }
    }

    /// Returns how the gel moves; `None` without contact.
    fn motion(
        &self,
        shear: GelShear,
        gel_depth_m: &[f32],
        depth_m: &Array2<f32>,
        contact: &Array2<bool>,
    ) -> Option<GelMotion> {
        let (mut count, mut sums) = (0.0, [0.0; 2]);
        for ((v, u), _) in contact.indexed_iter().filter(|(_, touches)| **touches) {
            count += 1.0;
            sums = [sums[0] + u as f64, sums[1] + v as f64];
        }
        let middle = (count > 0.0).then(|| sums.map(|sum| sum / count))?;
        let pressed = self.places_mm.iter().filter_map(|place| {
            let [u, v] = self.gel.pixel(&self.camera, *place).map(f64::round);
            // A place out of view has no such pixel.
            let at = (u >= 0.0 && v >= 0.0).then_some((v as usize, u as usize))?;
            contact.get(at).filter(|touches| **touches)?;
            Some((*place, 1e3 * f64::from(gel_depth_m.get(at.0 * self.camera.width + at.1)? - depth_m.get(at)?)))
        });
        Some(GelMotion { centre_mm: self.gel.place_mm(&self.camera, middle), shear, pressed: pressed.collect() })
    }

    /// Darkens a dot.
    fn paint_dot(&self, place_mm: [f64; 2], image: &mut RgbImage) {
        let [u, v] = self.gel.pixel(&self.camera, place_mm).map(|x| x as f32);
        let px_per_mm = (self.gel.pixel(&self.camera, [place_mm[0] + 1.0, place_mm[1]])[0] as f32 - u).abs();
        let radius_px = self.radius_mm as f32 * px_per_mm;
        let reach = radius_px + self.edge_px;
        // Conversions of negative and invalid numbers saturate at 0.
        let span = |at: f32, size: usize| (at - reach).ceil() as usize..((at + reach) as usize + 1).min(size);
        for row in span(v, self.camera.height) {
            for column in span(u, self.camera.width) {
                let (dx, dy) = (column as f32 - u, row as f32 - v);
                let inside = radius_px - (dx * dx + dy * dy).sqrt();
                let covered = (0.5 + 0.5 * inside / self.edge_px).clamp(0.0, 1.0);
                let light = 1.0 - self.darkness * covered;
                if let Some(pixel) = image.get_pixel_mut_checked(column as u32, row as u32) {
                    pixel.0 = pixel.0.map(|level| (f32::from(level) * light + 0.5) as u8);
                }
            }
        }
    }
}
