//! Colours of a surface as cameras saw them.

use std::collections::HashMap;

use glam::{IVec3, Vec3, Vec3A};
use mvt_frames::depth::{CameraDepth, Label};
use mvt_frames::{Isometry, Object, World};

/// Edge of the cells in which colours are averaged, metres.
const CELL_M: f32 = 0.003;
/// Every Nth row and column of an image gives a point.
const STRIDE: usize = 2;
/// A vertex has the colours of the cells that are nearest, at most so many cells away.
const REACH: i32 = 3;
/// Colour of a vertex of which none was seen.
const UNSEEN: [u8; 3] = [128; 3];
/// Most cells: an object of half a metre has a tenth of them.
const MOST_CELLS: usize = 2_000_000;

/// Mean colours of the places of a surface.
#[derive(Debug, Clone, Default)]
pub struct SurfaceColours {
    /// Sums of red, green and blue, and their number.
    cells: HashMap<IVec3, [u32; 4]>,
}

impl SurfaceColours {
    /// Takes the colours of an image at the estimated pose of the surface; an image without colours, or with those of another size, has no
    /// effect.
    pub fn add(&mut self, camera: &CameraDepth, pose: Isometry<Object, World>) {
        let Some(colour) = &camera.colour else { return };
        let (rows, columns) = camera.depth_m.dim();
        if [colour.height() as usize, colour.width() as usize] != [rows, columns] {
            return;
        }
        let (rotation, origin) = (pose.inverse() * camera.world_from_camera).to_f32();
        let k = &camera.intrinsics;
        for (v, u) in (0..rows).step_by(STRIDE).flat_map(|v| (0..columns).step_by(STRIDE).map(move |u| (v, u))) {
            let depth_m = camera.depth_m[(v, u)];
            if camera.labels.get((v, u)) != Some(&Label::Object) || depth_m <= 0.0 || !depth_m.is_finite() {
                continue;
            }
            let ray = Vec3A::new(((u as f64 - k.cx) / k.fx) as f32, ((k.cy - v as f64) / k.fy) as f32, -1.0);
            let cell = cell((origin + rotation * (ray * depth_m)).into());
            if self.cells.len() < MOST_CELLS || self.cells.contains_key(&cell) {
                let [r, g, b] = colour.get_pixel(u as u32, v as u32).0.map(u32::from);
                let sums = self.cells.entry(cell).or_default();
                *sums = [sums[0] + r, sums[1] + g, sums[2] + b, sums[3] + 1];
            }
        }
    }

    /// Returns the colours of points of the surface; `None` if no camera saw colours.
    pub fn of(&self, points: &[Vec3]) -> Option<Vec<[u8; 3]>> {
        (!self.cells.is_empty()).then(|| points.iter().map(|point| self.at(*point)).collect())
    }

    fn at(&self, point: Vec3) -> [u8; 3] {
        let middle = cell(point);
        for reach in 0..=REACH {
            let mut sums = [0_u64; 4];
            for x in -reach..=reach {
                for y in -reach..=reach {
                    for z in -reach..=reach {
                        let is_shell = [x, y, z].into_iter().any(|d| d.abs() == reach);
                        let found = is_shell.then(|| self.cells.get(&(middle + IVec3::new(x, y, z)))).flatten();
                        for (sum, value) in sums.iter_mut().zip(found.into_iter().flatten()) {
                            *sum += u64::from(*value);
                        }
                    }
                }
            }
            if sums[3] > 0 {
                let [r, g, b, count] = sums;
                return [r, g, b].map(|sum| (sum / count) as u8);
            }
        }
        UNSEEN
    }
}

fn cell(point: Vec3) -> IVec3 {
    (point / CELL_M).floor().as_ivec3()
}

#[cfg(test)]
mod tests {
    use image::{Rgb, RgbImage};
    use mvt_frames::camera::Intrinsics;
    use ndarray::Array2;

    use super::*;

    #[test]
    fn a_place_has_the_colour_in_which_it_was_seen() {
        let camera = CameraDepth {
            intrinsics: Intrinsics::from_fov_y(64, 48, 0.2),
            world_from_camera: Isometry::identity(),
            depth_m: Array2::from_elem((48, 64), 0.5),
            labels: Array2::from_elem((48, 64), Label::Object),
            colour: Some(RgbImage::from_fn(64, 48, |u, _| Rgb(if u < 32 { [200, 0, 0] } else { [0, 0, 100] }))),
        };
        let mut colours = SurfaceColours::default();
        assert_eq!(colours.of(&[Vec3::ZERO]), None);
        // The surface has moved by a centimetre: its coordinates do not move.
        colours.add(&camera, Isometry::translation(0.01, 0.0, 0.0));
        let seen = colours.of(&[Vec3::new(-0.03, 0.0, -0.5), Vec3::new(0.01, 0.0, -0.502), Vec3::ZERO]).unwrap();
        assert_eq!(seen, [[200, 0, 0], [0, 0, 100], UNSEEN]);
    }
}
