//! Frames before the newest, and what they say of a pixel.

use glam::Vec3;
use mvt_frames::depth::{CameraDepth, Label};
use mvt_frames::{Camera, Isometry, Model, Point};

use super::pixels::{Pixels, are_alike, beside, colour, tolerance_m};

/// A surface that was seen so far behind a place, and the tolerance, was seen through it, metres.
const THROUGH_M: f32 = 0.004;

/// A frame that was learnt, and where the object was in it.
#[derive(Debug, Clone)]
pub struct Earlier {
    pub image: CameraDepth,
    pub camera_from_model: Isometry<Model, Camera>,
}

impl Earlier {
    /// The pixel of the frame that shows a point.
    fn pixel(&self, point: Point<Camera>) -> Option<(usize, usize)> {
        let (u, v) = self.image.intrinsics.project(point)?;
        Some((v.round().max(0.0) as usize, u.round().max(0.0) as usize))
    }

    /// How far the surface that was seen at a pixel is behind a point, metres; `None` where nothing was measured.
    fn behind_m(&self, at: (usize, usize), point: Point<Camera>) -> Option<f32> {
        let depth_m = self.image.depth_m.get(at).copied().filter(|depth_m| *depth_m > 0.0)?;
        Some(depth_m + point.coords().z as f32)
    }

    /// The place in the frame of what a pixel of a later one shows, if it has not moved since.
    fn still(&self, later: &Pixels<'_>, (v, u): (usize, usize), depth_m: f32) -> Point<Camera> {
        let in_camera = later.image.intrinsics.unproject(u as f64, v as f64, f64::from(depth_m));
        self.image.world_from_camera.inverse() * (later.image.world_from_camera * in_camera)
    }

    /// Whether a pixel of a later frame shows a surface that already lay at its place in the world, in the same colour, and was not the object's.
    pub fn lay_still(&self, later: &Pixels<'_>, at: (usize, usize), depth_m: f32) -> bool {
        let point = self.still(later, at, depth_m);
        let Some(then) = self.pixel(point) else { return false };
        let is_other = matches!(self.image.labels.get(then), Some(Label::Background | Label::Hand));
        let is_near = self.behind_m(then, point).is_some_and(|behind| behind.abs() < 1.2 * tolerance_m(depth_m));
        is_other && is_near && later.colour(at).zip(colour(&self.image, then)).is_none_or(|(a, b)| are_alike(a, b))
    }

    /// Whether the frame rules out that a pixel of a later one shows the object at a place of it: the surface there lay still although the object was
    /// elsewhere, or its place on the object was looked through.
    pub fn rules_out(&self, later: &Pixels<'_>, at: (usize, usize), depth_m: f32, in_model: Vec3) -> bool {
        let tolerance_m = tolerance_m(depth_m);
        let of_object = self.camera_from_model * Point::new(in_model.x.into(), in_model.y.into(), in_model.z.into());
        let is_behind = |at| self.behind_m(at, of_object).is_some_and(|m| m > THROUGH_M + 2.0 * tolerance_m);
        let looked_through =
            self.pixel(of_object).is_some_and(|at| beside(at, self.image.depth_m.dim()).chain([at]).all(is_behind));
        let has_moved = || {
            let still = self.still(later, at, depth_m);
            (of_object.coords() - still.coords()).norm() > f64::from(4.0 * tolerance_m)
        };
        looked_through || (has_moved() && self.lay_still(later, at, depth_m))
    }
}
