//! The measurements of one instant, checked and labelled.

use mvt_frames::camera::PosedCamera;
use mvt_frames::depth::CameraDepth;
use mvt_robot::hand::solid::HandSolid;
use mvt_robot::hand::{JointAngles, PerFinger, Side};
use mvt_robot::observation::{Percept, Press, SensorError, SensorName, check_size};
use ndarray::Array2;

use crate::segmentation::{SegmentationConfig, segment};

/// Assembles the measurements of one instant and labels the pixels of each camera.
///
/// `depths_m` are depth images in the order of `cameras`, metres along the optical axis; `None` or an empty image from a camera that
/// delivered nothing, as from cameras without an entry. Depths that are negative, infinite or NaN count as not measured.
///
/// # Errors
/// [`SensorError`] if an image has another size than its camera's, if there are more images than cameras, or if the time or a joint
/// angle is not finite.
pub fn percept(
    time_s: f64,
    joints: JointAngles,
    depths_m: Vec<Option<Array2<f32>>>,
    touch: PerFinger<Option<Press>>,
    cameras: &[PosedCamera],
    side: Side,
    config: &SegmentationConfig,
) -> Result<Percept, SensorError> {
    if !time_s.is_finite() {
        return Err(SensorError::NotFinite("the time of the observation"));
    }
    if joints.iter().any(|angle| !angle.is_finite()) {
        return Err(SensorError::NotFinite("a joint angle"));
    }
    if depths_m.len() > cameras.len() {
        return Err(SensorError::Cameras { expected: cameras.len(), found: depths_m.len() });
    }
    let hand = HandSolid::new(side, &joints);
    let mut depths_m = depths_m.into_iter();
    let cameras = cameras
        .iter()
        .map(|camera| match depths_m.next().flatten() {
            Some(depth_m) if !depth_m.is_empty() => camera_depth(depth_m, camera, &hand, config).map(Some),
            _ => Ok(None),
        })
        .collect::<Result<_, _>>()?;
    Ok(Percept { time_s, joints, cameras, touch })
}

fn camera_depth(
    mut depth_m: Array2<f32>,
    camera: &PosedCamera,
    hand: &HandSolid,
    config: &SegmentationConfig,
) -> Result<CameraDepth, SensorError> {
    let PosedCamera { name, intrinsics, pose } = camera;
    let expected = [intrinsics.width, intrinsics.height];
    check_size(|| SensorName::Camera(name.clone()), "depth", expected, [depth_m.ncols(), depth_m.nrows()])?;
    depth_m.mapv_inplace(|depth| if depth.is_finite() && depth >= 0.0 { depth } else { 0.0 });
    let labels = segment(&depth_m, intrinsics, *pose, hand, config);
    Ok(CameraDepth { intrinsics: *intrinsics, world_from_camera: *pose, depth_m, labels, colour: None })
}

#[cfg(test)]
mod tests {
    use mvt_frames::depth::Label;
    use mvt_robot::hand::Finger;
    use mvt_robot::rig::PLACEMENTS;

    use super::*;

    fn cameras() -> Vec<PosedCamera> {
        PLACEMENTS[2..].iter().map(|p| p.camera(Side::Left)).collect()
    }

    fn made(depths_m: Vec<Array2<f32>>, joints: JointAngles) -> Result<Percept, SensorError> {
        let press = Press {
            indentation_mm: Array2::zeros((320, 240)),
            contact: Array2::from_elem((320, 240), false),
            sigma_mm: 0.05,
        };
        let mut touch = PerFinger::default();
        touch[Finger::Thumb] = Some(press);
        let depths_m = depths_m.into_iter().map(Some).collect();
        percept(1.5, joints, depths_m, touch, &cameras(), Side::Left, &SegmentationConfig::default())
    }

    #[test]
    fn whole_percept() {
        let percept = made(vec![Array2::from_elem((480, 640), 0.3); 2], [0.1; 16]).unwrap();
        assert_eq!((percept.time_s, percept.joints), (1.5, [0.1; 16]));
        let top = percept.cameras[0].as_ref().unwrap();
        assert_eq!(top.labels[[240, 320]], Label::Object);
        assert_eq!(top.world_from_camera, cameras()[0].pose);
        assert!(percept.touch[Finger::Thumb].is_some() && percept.touch[Finger::Ring].is_none());
    }

    #[test]
    fn a_silent_camera_is_none() {
        let percept = made(vec![Array2::zeros((0, 0))], [0.1; 16]).unwrap();
        assert_eq!(percept.cameras, [None, None]);
    }

    #[test]
    fn invalid_depth_is_not_measured() {
        let mut depth = Array2::from_elem((480, 640), 0.3);
        (depth[[0, 0]], depth[[240, 320]], depth[[7, 5]]) = (f32::NAN, f32::INFINITY, -0.3);
        let percept = made(vec![depth], [0.1; 16]).unwrap();
        let camera = percept.cameras[0].as_ref().unwrap();
        assert_eq!([(0, 0), (240, 320), (7, 5)].map(|at| camera.depth_m[at]), [0.0; 3]);
        assert_ne!(camera.labels[[240, 320]], Label::Object);
    }

    #[test]
    fn wrong_sizes_name_the_sensor() {
        let message = |depths_m, joints| made(depths_m, joints).unwrap_err().to_string();
        let good = || Array2::zeros((480, 640));
        let text = message(vec![good(), Array2::zeros((640, 480))], [0.1; 16]);
        assert!(text.starts_with("camera side: its depth image is 480 x 640 pixels; 640 x 480 expected"), "{text}");
        assert!(message(vec![good(), good(), good()], [0.1; 16]).contains("3 cameras"));
        let mut joints = [0.1; 16];
        joints[3] = f64::NAN;
        assert!(message(Vec::new(), joints).contains("joint angle"));
    }
}
