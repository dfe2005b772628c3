//! The frame of the model: where the first measurements put it.

use glam::Vec3;
use mvt_frames::{Field, Isometry, World};
use nalgebra as na;

use crate::scan::Scan;
use crate::tracker;

/// The middle of an object lies about so far behind its visible surface, metres.
const BEHIND_SURFACE_M: f32 = 0.015;

/// Of the field's box nothing nearer to its faces than this should be needed, metres.
const BORDER_M: f64 = 0.005;

/// The frame that the first measurements fix: parallel to the world, in the middle of the probable object. Nothing that is
/// farther than `half_extent_m` from it will be mapped, so that of a tall object seen from above it lies low enough to reach the support.
pub(crate) fn first_pose(scan: &Scan, half_extent_m: f64, support_z_m: Option<f64>) -> Option<Isometry<Field, World>> {
    if scan.hits() == 0 {
        return None;
    }
    let (mut sum, mut count, mut top) = (Vec3::ZERO, 0.0, f32::MIN);
    for view in &scan.views {
        let behind = if view.is_camera() { BEHIND_SURFACE_M } else { 0.0 };
        for hit in &view.hits {
            let point = view.point(hit);
            top = top.max(point.z);
            sum += point + hit.direction * behind;
            count += 1.0;
        }
    }
    let mut centre = tracker::to_na(sum / count);
    if let Some(support) = support_z_m {
        let (top, reach) = (f64::from(top), half_extent_m - BORDER_M);
        // What reaches higher does not stand on the support, or does not fit.
        if top <= support + 2.0 * half_extent_m {
            centre.z = centre.z.min((support + reach).max(top - reach));
        }
    }
    Some(Isometry::new(na::Isometry3::from_parts(centre.into(), na::UnitQuaternion::identity())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::{Detail, Hit, View};

    #[test]
    fn the_first_frame_reaches_from_the_palm_to_the_top() {
        let palm = 0.0111_f32;
        // The upper part of a tall object, from 8 to 13 cm above the palm, seen from the side.
        let origin = Vec3::new(0.4, 0.0, palm + 0.105);
        let hit = |height: f32| {
            let ray = Vec3::new(0.0, 0.0, palm + height) - origin;
            let (direction, range_m) = (ray.normalize(), ray.length());
            Hit { direction, range_m, normal: Vec3::X, cosine: 0.9, sigma_m: 0.001 }
        };
        let view = View {
            origin,
            hits: (0..=50).map(|k| hit(0.08 + 0.001 * k as f32)).collect(),
            misses: Vec::new(),
            detail: Detail::Camera { index: 0, outline: Vec::new(), lookup: None, picture: None, texels: None },
        };
        let scan = Scan { frame: 0, time_s: 0.0, obstacles: Vec::new(), views: vec![view] };
        let support = f64::from(palm);
        let height =
            |half_extent_m: f64| first_pose(&scan, half_extent_m, Some(support)).unwrap().origin().coords().z - support;
        // In the middle of the seen points where they reach the palm,
        assert!((height(0.2) - 0.105).abs() < 1e-3);
        // else low enough,
        assert!((height(0.09) - (0.09 - BORDER_M)).abs() < 1e-6);
        // but not so low that seen points are left out;
        assert!((height(0.066) - (0.13 - 0.066 + BORDER_M)).abs() < 1e-6);
        // and where it cannot reach from palm to top, in the middle again.
        assert_eq!(height(0.06), height(0.2));
    }
}
