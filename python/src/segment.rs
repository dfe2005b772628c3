//! Labels of the pixels of a camera.

use mvt_frames::depth::Label;
use mvt_robot::hand::solid::HandSolid;
use mvt_segmentation::SegmentationConfig;
use numpy::{IntoPyArray as _, PyArray2};
use pyo3::prelude::*;

use crate::arrays::plane;
use crate::camera::{Camera, read_rig};
use crate::errors::{Kind, detached};
use crate::frame::read_joints;

/// Labels the pixels of a depth image as `Slam` does, from depth and joint angles alone: 0 background, 127 hand, 255 object, 64 unsure,
/// which are pixels at the edge of the object. uint8 (height, width).
///
/// `depth_m` is metres along the optical axis, 0 where nothing was measured. `joints` are the angles of the hand's joints, radians.
#[pyfunction]
#[pyo3(signature = (camera, depth_m, joints, side = None, rig = "allegro_digit"))]
pub fn segment<'py>(
    py: Python<'py>,
    camera: PyRef<'py, Camera>,
    depth_m: &Bound<'_, PyAny>,
    joints: &Bound<'_, PyAny>,
    side: Option<&str>,
    rig: &str,
) -> PyResult<Bound<'py, PyArray2<u8>>> {
    let camera = camera.0.clone();
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let depth_m = plane(depth_m, "depth_m", [Some(height), Some(width)])?;
    let joints = read_joints(joints, "joints")?;
    let hand = read_rig(py, rig, side)?.hand;
    let (expected, found) = (hand.joints().len(), joints.len());
    if expected != found {
        return Err(Kind::Argument.error(format!("joints: the hand has {expected}, got {found}")).into());
    }
    let labels = detached(py, || {
        let grasp = hand.grasp_centre(&joints);
        let solid = HandSolid::new(&hand, &joints);
        let config = SegmentationConfig::default();
        Ok(mvt_segmentation::segment(&depth_m, &camera.intrinsics, camera.pose, &solid, grasp, &config))
    })?;
    Ok(labels.mapv(Label::grey).into_pyarray(py))
}
