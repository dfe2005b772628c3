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
    /// Whether the frame rules out that a pixel of a later one shows the object: the surface already lay at its place in the world, in the same colour,
    /// and was not the object's, although the object was elsewhere; or its place on the object was looked through.
    pub fn rules_out(&self, later: &Pixels<'_>, (v, u): (usize, usize), depth_m: f32, in_model: Vec3) -> bool {
        let Self { image: then, camera_from_model } = self;
        let tolerance_m = tolerance_m(depth_m);
        let pixel = |point: Point<Camera>| {
            let (u, v) = then.intrinsics.project(point)?;
            Some((v.round().max(0.0) as usize, u.round().max(0.0) as usize))
        };
        let then_m = |at: (usize, usize)| then.depth_m.get(at).copied().unwrap_or(0.0);
        // How far the surface that was seen at a pixel is behind a point.
        let behind_m = |at: (usize, usize), point: Point<Camera>| then_m(at) + point.coords().z as f32;
        let of_object = *camera_from_model * Point::new(in_model.x.into(), in_model.y.into(), in_model.z.into());
        let looked_through = pixel(of_object).is_some_and(|at| {
            let mut around = beside(at, then.depth_m.dim()).chain([at]);
            around.all(|at| then_m(at) > 0.0 && behind_m(at, of_object) > THROUGH_M + 2.0 * tolerance_m)
        });
        let lay_still = || {
            let in_camera = later.image.intrinsics.unproject(u as f64, v as f64, f64::from(depth_m));
            let point = then.world_from_camera.inverse() * (later.image.world_from_camera * in_camera);
            let has_moved = (of_object.coords() - point.coords()).norm() > f64::from(4.0 * tolerance_m);
            let Some(at) = pixel(point).filter(|at| has_moved && then_m(*at) > 0.0) else { return false };
            let is_other = matches!(then.labels.get(at), Some(Label::Background | Label::Hand));
            let is_alike = later.colour((v, u)).zip(colour(then, at)).is_none_or(|(a, b)| are_alike(a, b));
            is_other && is_alike && behind_m(at, point).abs() < 1.2 * tolerance_m
        };
        looked_through || lay_still()
    }
}
