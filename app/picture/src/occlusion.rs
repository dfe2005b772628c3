//! Ambient occlusion from a depth buffer: creases and places where surfaces nearly touch are darker, as under an overcast sky.
//!
//! One over the depth is linear over the screen on a plane. So the plane through a pixel predicts the depth of its neighbours, and a neighbour
//! that is nearer than predicted hides a part of the sky (after Bavoil and Sainz, Image-Space Horizon-Based Ambient Occlusion, 2008).

use glam::Vec2;

/// Surfaces farther than this from a point do not darken it, metres: a third of a fingertip.
const REACH_M: f32 = 0.014;
/// Smallest height above the plane that counts, as a share of the distance: rounding, and the facets of meshes.
const BIAS: f32 = 0.0012;
/// Darkening where everything around is above the plane, 0 to 1.
const STRENGTH: f32 = 1.1;
/// Neighbours: rings with their share of the reach, and directions on each.
const RINGS: [f32; 3] = [0.2, 0.5, 1.0];
const DIRECTIONS: usize = 6;
/// Greatest distance of a neighbour, pixels.
const FARTHEST_PX: f32 = 60.0;
/// Relative step of the depth that separates one surface from another.
const STEP: f32 = 0.02;

/// Depth buffer of a picture.
#[derive(Debug, Clone, Copy)]
pub struct DepthBuffer<'a> {
    /// One over the depth of each pixel, 1/m, row by row; 0 for the background.
    pub nearness: &'a [f32],
    /// Columns.
    pub width: usize,
    /// Focal length, pixels.
    pub focal: f32,
}

impl DepthBuffer<'_> {
    /// Returns the share of the sky that a pixel sees, 0 to 1; 1 for the background.
    pub fn sky(&self, x: usize, y: usize) -> f32 {
        let here = self.at(x as isize, y as isize);
        if here <= 0.0 {
            return 1.0;
        }
        let slope = Vec2::new(self.slope(here, x, y, 1, 0), self.slope(here, x, y, 0, 1));
        let reach_px = (self.focal * REACH_M * here).min(FARTHEST_PX);
        if reach_px < 2.0 {
            return 1.0;
        }
        let depth = 1.0 / here;
        let (bias, mut hidden) = (BIAS * depth, 0.0);
        for (ring, share) in RINGS.into_iter().enumerate() {
            for k in 0..DIRECTIONS {
                // Each ring is turned against the one before.
                let turn = (k as f32 + 0.5 * ring as f32) / DIRECTIONS as f32 * std::f32::consts::TAU;
                let by = (Vec2::from_angle(turn) * share * reach_px).round();
                let there = self.at(x as isize + by.x as isize, y as isize + by.y as isize);
                let plane = here + slope.dot(by);
                // Where the plane reaches infinity, nothing can be above it.
                if there <= 0.0 || plane <= 0.0 {
                    continue;
                }
                let height = 1.0 / plane - 1.0 / there;
                if height > bias && height < REACH_M {
                    // A step is hidden by its height, seen from its distance; far ones fade.
                    let across = share * REACH_M;
                    hidden += height / height.hypot(across) * (1.0 - height / REACH_M);
                }
            }
        }
        let most = (RINGS.len() * DIRECTIONS) as f32;
        (1.0 - STRENGTH * hidden / most).clamp(0.0, 1.0)
    }

    /// Returns the nearness of a pixel; 0 outside the picture.
    fn at(&self, x: isize, y: isize) -> f32 {
        let is_inside = (0..self.width as isize).contains(&x) && y >= 0;
        if is_inside { self.nearness.get(x as usize + y as usize * self.width).copied().unwrap_or(0.0) } else { 0.0 }
    }

    /// Returns the change of the nearness from pixel to pixel along an axis, on the side where the surface goes on.
    fn slope(&self, here: f32, x: usize, y: usize, dx: isize, dy: isize) -> f32 {
        let (x, y) = (x as isize, y as isize);
        let (before, after) = (self.at(x - dx, y - dy), self.at(x + dx, y + dy));
        let is_same = |other: f32| other > 0.0 && (other - here).abs() < STEP * here;
        match (is_same(before), is_same(after)) {
            (true, true) => {
                let (left, right) = (here - before, after - here);
                // At an edge the plane of the flatter side is taken, so that no edge is dark.
                if left.abs() < right.abs() { left } else { right }
            }
            (true, false) => here - before,
            (false, true) => after - here,
            (false, false) => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 200;
    const FOCAL: f32 = 800.0;

    /// Draws depths by their ray: `depth_m` gets the direction (x, y) per metre of depth.
    fn buffer(depth_m: impl Fn(Vec2) -> f32) -> Vec<f32> {
        let ray = |pixel: usize| (Vec2::new((pixel % WIDTH) as f32, (pixel / WIDTH) as f32) - 100.0) / FOCAL;
        (0..WIDTH * WIDTH).map(|pixel| 1.0 / depth_m(ray(pixel))).collect()
    }

    fn sky(nearness: &[f32], x: usize, y: usize) -> f32 {
        DepthBuffer { nearness, width: WIDTH, focal: FOCAL }.sky(x, y)
    }

    #[test]
    fn a_plane_sees_the_whole_sky_however_it_leans() {
        for lean in [-2.0, 0.0, 0.7, 3.0] {
            let nearness = buffer(|ray| 0.3 / (1.0 + lean * ray.x - 0.4 * ray.y));
            for (x, y) in [(100, 100), (0, 0), (199, 7), (30, 150)] {
                assert!(sky(&nearness, x, y) > 0.99, "{lean}: {}", sky(&nearness, x, y));
            }
        }
    }

    #[test]
    fn a_corner_is_darker_than_the_walls_beside_it() {
        // Two walls that meet in the column x = 0, at a depth of 0.3 m, and stand towards the eye.
        let nearness = buffer(|ray| 0.3 / (1.0 + ray.x.abs()));
        let [corner, wall] = [sky(&nearness, 101, 100), sky(&nearness, 180, 100)];
        assert!(corner < 0.9 && wall > 0.97, "{corner} {wall}");
        // The same walls from the other side: an edge towards the eye sees the whole sky.
        let nearness = buffer(|ray| 0.3 / (1.0 - ray.x.abs()));
        assert!(sky(&nearness, 101, 100) > 0.99);
    }

    #[test]
    fn a_thing_far_in_front_casts_no_shadow() {
        let nearness = buffer(|ray| if ray.x > 0.0 { 0.2 } else { 0.3 });
        assert!(sky(&nearness, 98, 100) > 0.99 && sky(&nearness, 102, 100) > 0.99);
        // Nothing is drawn.
        assert_eq!(sky(&[0.0; WIDTH * WIDTH], 50, 50), 1.0);
        assert_eq!(sky(&[], 0, 0), 1.0);
    }
}
