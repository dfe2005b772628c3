//! The undeformed gel of a touch sensor in closed form.
//!
//! TACTO tessellates this surface with 100 x 150 vertices, which deviates by 0.2 micrometres between the vertices. A
//! point at distance rho from the camera's axis lies at x = apex - k h with h = R - sqrt(R^2 - rho^2), and k scales h
//! so that the corners of the pad lie a given bulge behind the apex. A flat gel has k = 0.

use mvt_frames::camera::Intrinsics;
use mvt_frames::{Camera, Gel, Point, Vector};
use ndarray::{Array2, Zip};

/// Distance from a DIGIT's camera to the apex of its gel, which lies on the optical axis, metres.
pub const APEX_M: f64 = 0.022;
/// Radius of the sphere whose cap, stretched along x, is the pad, metres (TACTO's `R`).
pub const CAP_RADIUS_M: f64 = 0.1;

// Why: notes/decisions/touch.md, "A gel is a stretched cap before a camera".
/// Surface of an undeformed gel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GelSurface {
    apex_m: f64,
    /// Stretch k of the spherical cap along x: about 3.05 for a DIGIT, 0 for a flat gel.
    stretch: f64,
}

impl GelSurface {
    /// Returns the surface of a pad of this size along y and z, of which the corners lie `bulge_m` behind the apex, metres. The apex lies
    /// on the optical axis at a distance from the camera.
    pub fn new(apex_m: f64, [width_m, height_m]: [f64; 2], bulge_m: f64) -> Self {
        let corner = CAP_RADIUS_M - (CAP_RADIUS_M.powi(2) - (width_m.powi(2) + height_m.powi(2)) / 4.0).sqrt();
        Self { apex_m, stretch: bulge_m / corner }
    }

    /// Returns the distance from the camera to the apex, metres.
    pub fn apex_m(self) -> f64 {
        self.apex_m
    }

    /// Returns the point at pixel (column u, row v) of the sensor's camera; its x coordinate is the depth.
    pub fn point(self, camera: &Intrinsics, u: f64, v: f64) -> Point<Gel> {
        // The ray is (1, y, z) times depth; the stretched sphere gives a quadratic equation for the depth.
        let (y, z) = (-(u - camera.cx) / camera.fx, -(v - camera.cy) / camera.fy);
        let k2 = self.stretch.powi(2);
        let centre = self.apex_m - self.stretch * CAP_RADIUS_M;
        let a = 1.0 + k2 * (y * y + z * z);
        let c = centre * centre - k2 * CAP_RADIUS_M.powi(2);
        let depth = (centre + (centre * centre - a * c).sqrt()) / a;
        Point::new(depth, depth * y, depth * z)
    }

    /// Returns the place of a pixel on the gel: millimetres to the right and downwards in the image, from the camera's axis.
    pub fn place_mm(self, camera: &Intrinsics, [u, v]: [f64; 2]) -> [f64; 2] {
        let point = self.point(camera, u, v).coords();
        [-1e3 * point.y, -1e3 * point.z]
    }

    /// Returns the pixel, column and row, that shows a place on the gel: the inverse of [`GelSurface::place_mm`].
    pub fn pixel(self, camera: &Intrinsics, [right_mm, down_mm]: [f64; 2]) -> [f64; 2] {
        let (y, z) = (-1e-3 * right_mm, -1e-3 * down_mm);
        let depth = self.apex_m - self.stretch * (CAP_RADIUS_M - (CAP_RADIUS_M.powi(2) - y * y - z * z).sqrt());
        [camera.cx - camera.fx * y / depth, camera.cy - camera.fy * z / depth]
    }

    /// Returns the unit normal at a point of the surface, towards the camera.
    pub fn normal(self, point: Point<Gel>) -> Vector<Gel> {
        let p = point.coords();
        let slope = self.stretch / (CAP_RADIUS_M.powi(2) - p.y * p.y - p.z * p.z).sqrt();
        Vector::from(nalgebra::Vector3::new(-1.0, -slope * p.y, -slope * p.z).normalize())
    }
}

/// A camera's view of the undeformed gel.
#[derive(Debug, Clone, PartialEq)]
pub struct GelView {
    camera: Intrinsics,
    surface: GelSurface,
    depth_m: Array2<f32>,
}

impl GelView {
    /// Computes the view of a sensor's camera.
    pub fn new(camera: Intrinsics, surface: GelSurface) -> Self {
        let depth = |(row, column)| surface.point(&camera, column as f64, row as f64).coords().x as f32;
        Self { camera, surface, depth_m: Array2::from_shape_fn((camera.height, camera.width), depth) }
    }

    /// Returns the camera.
    pub fn camera(&self) -> &Intrinsics {
        &self.camera
    }

    /// Returns the surface of the undeformed gel.
    pub fn surface(&self) -> GelSurface {
        self.surface
    }

    /// Returns the depth of the undeformed gel at every pixel, metres along the camera's axis, indexed (row, column).
    pub fn depth_m(&self) -> &Array2<f32> {
        &self.depth_m
    }

    /// Returns the depth of a gel that is pressed in: metres from millimetres of indentation. `None` if the image has another size.
    pub fn depth_of(&self, indentation_mm: &Array2<f32>) -> Option<Array2<f32>> {
        (indentation_mm.dim() == self.depth_m.dim()).then(|| {
            Zip::from(&self.depth_m).and(indentation_mm).map_collect(|gel, indentation| gel - 1e-3 * indentation)
        })
    }

    /// Returns the indentation of a gel of which the depth is known: millimetres from metres. `None` if the image has another size.
    pub fn indentation_of(&self, depth_m: &Array2<f32>) -> Option<Array2<f32>> {
        (depth_m.dim() == self.depth_m.dim())
            .then(|| Zip::from(&self.depth_m).and(depth_m).map_collect(|gel, depth| (gel - depth) * 1e3))
    }

    /// Returns the points at which a gel is touched, in every `stride`th row and column, and the indentation at each, millimetres. Images of
    /// another size have no points.
    pub fn touched_points(
        &self,
        indentation_mm: &Array2<f32>,
        contact: &Array2<bool>,
        stride: usize,
    ) -> Vec<(Point<Camera>, f32)> {
        let Some(depth_m) = self.depth_of(indentation_mm).filter(|depth_m| depth_m.dim() == contact.dim()) else {
            return Vec::new();
        };
        let touched = contact
            .indexed_iter()
            .filter(|((row, column), touches)| **touches && row % stride == 0 && column % stride == 0);
        let point = |(at @ (row, column), _)| {
            let point = self.camera.unproject(column as f64, row as f64, f64::from(depth_m[at]));
            (point, indentation_mm[at])
        };
        touched.map(point).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::digit::profile::SensorProfile;
    use crate::digit::{HEIGHT, WIDTH, gel_from_camera, intrinsics};

    fn digit() -> GelSurface {
        SensorProfile::tacto().gel_surface()
    }

    #[test]
    fn pixels_show_the_gel_points_that_project_to_them() {
        let camera = intrinsics();
        for (u, v) in [(0.0, 0.0), (119.5, 159.5), (17.0, 301.0), (WIDTH as f64 - 1.0, HEIGHT as f64 - 1.0)] {
            let p = digit().point(&camera, u, v);
            let (pu, pv) = camera.project(gel_from_camera().inverse() * p).unwrap();
            assert!((pu - u).abs() < 1e-9 && (pv - v).abs() < 1e-9, "({u}, {v}) projects to ({pu}, {pv})");
            let q = p.coords();
            let rho2 = q.y * q.y + q.z * q.z;
            let on_gel = APEX_M - digit().stretch * (CAP_RADIUS_M - (CAP_RADIUS_M.powi(2) - rho2).sqrt());
            assert!((q.x - on_gel).abs() < 1e-15);
            let [back_u, back_v] = digit().pixel(&camera, digit().place_mm(&camera, [u, v]));
            assert!((back_u - u).abs() < 1e-9 && (back_v - v).abs() < 1e-9);
        }
        assert!(
            (digit().point(&camera, 119.5, 159.5).coords().x - APEX_M).abs() < 1e-15,
            "the apex is on the optical axis"
        );
    }

    #[test]
    fn a_flat_gel_is_a_plane() {
        let flat = GelSurface::new(APEX_M, [0.02, 0.03], 0.0);
        for (u, v) in [(0.0, 0.0), (119.5, 159.5), (230.0, 7.0)] {
            let point = flat.point(&intrinsics(), u, v);
            assert!((point.coords().x - APEX_M).abs() < 1e-15);
            assert_eq!(flat.normal(point).coords(), nalgebra::Vector3::new(-1.0, 0.0, 0.0));
        }
        let view = GelView::new(intrinsics(), flat);
        let indentation_mm = view.indentation_of(&(view.depth_m() - 1e-3)).unwrap();
        assert!(indentation_mm.iter().all(|mm| (mm - 1.0).abs() < 1e-4));
    }

    #[test]
    fn normals_are_perpendicular_to_finite_differences() {
        let (u, v) = (40.0, 250.0);
        let point = |u, v| digit().point(&intrinsics(), u, v);
        let n = digit().normal(point(u, v)).coords();
        for (du, dv) in [(1e-3, 0.0), (0.0, 1e-3)] {
            let along = point(u + du, v + dv).coords() - point(u - du, v - dv).coords();
            assert!(n.dot(&along.normalize()).abs() < 1e-6);
        }
        assert!(n.x < 0.0);
    }
}
