//! Cameras of a hand file.

use mvt_frames::camera::{Intrinsics, PosedCamera, look_at};
use mvt_frames::{Camera, Isometry, Point, World};
use mvt_robot::hand::Hand;
use mvt_robot::rig::{DISTANCE_M, Placement};
use nalgebra as na;

use crate::file::{CameraMount, HandFile};
use crate::shape::placing;

/// Least and greatest side of an image, pixels.
const SIDE: std::ops::RangeInclusive<usize> = 16..=8192;
/// Field of view without a lens, degrees.
const FOV_Y_DEG: f64 = 45.0;

/// Returns the cameras in the world. `fixed_link` gives the pose of a link that no joint moves.
///
/// # Errors
/// What is wrong with a camera, and what to do.
pub(crate) fn cameras(
    file: &HandFile,
    hand: &Hand,
    fixed_link: impl Fn(&str) -> Result<na::Isometry3<f64>, String>,
) -> Result<Vec<PosedCamera>, String> {
    let mut cameras: Vec<PosedCamera> = Vec::new();
    for camera in &file.cameras {
        let fault = |reason: String| format!("camera {:?}: {reason}", camera.name);
        let plain = |c: char| c.is_alphanumeric() || "_-".contains(c);
        if camera.name.is_empty() || !camera.name.chars().all(plain) {
            return Err(fault("a name has letters, digits, _ and -".to_owned()));
        }
        if cameras.iter().any(|other| other.name == camera.name) {
            return Err(fault("another camera has this name; rename it".to_owned()));
        }
        let intrinsics = intrinsics(camera).map_err(fault)?;
        let link = camera.link.as_ref().map(|name| fixed_link(name)).transpose().map_err(fault)?;
        let pose = pose(camera, link, hand).map_err(fault)?;
        cameras.push(PosedCamera { name: camera.name.clone(), intrinsics, pose });
    }
    Ok(cameras)
}

fn intrinsics(camera: &CameraMount) -> Result<Intrinsics, String> {
    let &CameraMount { width, height, fov_y_deg, fx, fy, cx, cy, .. } = camera;
    if !SIDE.contains(&width) || !SIDE.contains(&height) {
        return Err(format!("images have {} to {} pixels per side, not {width} x {height}", SIDE.start(), SIDE.end()));
    }
    let Some(fx) = fx else {
        let fov = fov_y_deg.unwrap_or(FOV_Y_DEG);
        if fy.is_some() || cx.is_some() || cy.is_some() {
            return Err("fy, cx and cy need fx".to_owned());
        }
        if !(1.0..=170.0).contains(&fov) {
            return Err(format!("fov_y_deg is between 1 and 170, not {fov}"));
        }
        return Ok(Intrinsics::from_fov_y(width, height, fov.to_radians()));
    };
    if fov_y_deg.is_some() {
        return Err("give either fov_y_deg or fx".to_owned());
    }
    let middle = |side: usize| 0.5 * (side as f64 - 1.0);
    let of = Intrinsics {
        width,
        height,
        fx,
        fy: fy.unwrap_or(fx),
        cx: cx.unwrap_or(middle(width)),
        cy: cy.unwrap_or(middle(height)),
    };
    let longest = 100.0 * width.max(height) as f64;
    let possible = |f: f64| (1.0..=longest).contains(&f);
    match possible(of.fx) && possible(of.fy) && of.cx.abs() <= longest && of.cy.abs() <= longest {
        true => Ok(of),
        false => Err(format!("fx, fy, cx and cy are pixels: focal lengths from 1 to {longest}")),
    }
}

fn pose(
    camera: &CameraMount,
    link: Option<na::Isometry3<f64>>,
    hand: &Hand,
) -> Result<Isometry<Camera, World>, String> {
    let grasp = hand.grasp_centre(&[]).map(Point::coords);
    let needs_grasp =
        || "it looks at the point of grasp; write [grasp] with point_m, or its orientation_wxyz".to_owned();
    let from_link = link.unwrap_or_else(na::Isometry3::identity);
    match (camera.position_m, camera.azimuth_deg, camera.elevation_deg) {
        (Some(position), None, None) if camera.distance_m.is_none() => {
            let upright = mvt_robot::hand::UPRIGHT;
            let place = from_link * placing(position, camera.orientation_wxyz.unwrap_or(upright))?;
            if camera.orientation_wxyz.is_some() {
                return Ok(Isometry::new(place));
            }
            let (eye, target) = (place.translation.vector, grasp.ok_or_else(needs_grasp)?);
            if (eye - target).norm() < 1e-3 {
                return Err("it stands at the point of grasp; move it away".to_owned());
            }
            Ok(look_at(eye, target, na::Vector3::z()))
        }
        (None, Some(azimuth), Some(elevation)) if camera.link.is_none() && camera.orientation_wxyz.is_none() => {
            let distance = camera.distance_m.unwrap_or(DISTANCE_M);
            if !(azimuth.is_finite() && (-90.0..=90.0).contains(&elevation) && (0.05..=10.0).contains(&distance)) {
                return Err("elevation_deg is between -90 and 90, and distance_m between 0.05 and 10".to_owned());
            }
            let target = grasp.ok_or_else(needs_grasp)?;
            let centre = hand.palm_centre_m().map_or(target, na::Vector3::from);
            let mut offset = distance * Placement::direction_of(azimuth, elevation);
            offset.y *= hand.side().sign();
            Ok(look_at(centre + offset, target, na::Vector3::z()))
        }
        _ => {
            Err("its pose is position_m, with orientation_wxyz or without, or azimuth_deg with elevation_deg"
                .to_owned())
        }
    }
}
