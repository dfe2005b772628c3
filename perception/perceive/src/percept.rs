//! The measurements of one instant: checked, then labelled.

use mvt_frames::camera::PosedCamera;
use mvt_frames::depth::CameraDepth;
use mvt_robot::hand::solid::HandSolid;
use mvt_robot::observation::{Observation, SensorError, SensorName, check_size};
use mvt_segmentation::{SegmentationConfig, segment};
use ndarray::Array2;

/// Checks the numbers of an observation and the sizes of its camera images.
///
/// # Errors
/// [`SensorError`] if a depth image has another size than its camera's, if there are more images than cameras, or if the time or a joint
/// angle is not finite.
pub(crate) fn check(observation: &Observation, cameras: &[PosedCamera]) -> Result<(), SensorError> {
    if !observation.time_s.is_finite() {
        return Err(SensorError::NotFinite("the time of the observation"));
    }
    if observation.joints.iter().any(|angle| !angle.is_finite()) {
        return Err(SensorError::NotFinite("a joint angle"));
    }
    let (expected, found) = (cameras.len(), observation.cameras.len());
    if found > expected {
        return Err(SensorError::Cameras { expected, found });
    }
    let images = observation.cameras.iter().zip(cameras).filter(|(rgbd, _)| !rgbd.depth_m.is_empty());
    for (rgbd, camera) in images {
        let expected = [camera.intrinsics.width, camera.intrinsics.height];
        let found = [rgbd.depth_m.ncols(), rgbd.depth_m.nrows()];
        check_size(|| SensorName::Camera(camera.name.clone()), "depth", expected, found)?;
    }
    Ok(())
}

/// Labels the pixels of each camera. `depths_m` are in the order of `cameras`; `None` from a camera that delivered nothing, as from
/// cameras without an entry. Depths that are negative, infinite or NaN count as not measured.
pub(crate) fn labelled(
    depths_m: Vec<Option<Array2<f32>>>,
    cameras: &[PosedCamera],
    hand: &HandSolid,
    config: &SegmentationConfig,
) -> Vec<Option<CameraDepth>> {
    let mut depths_m = depths_m.into_iter();
    let label = |camera: &PosedCamera| {
        let PosedCamera { intrinsics, pose, .. } = camera;
        let mut depth_m = depths_m.next().flatten()?;
        depth_m.mapv_inplace(|depth| if depth.is_finite() && depth >= 0.0 { depth } else { 0.0 });
        let labels = segment(&depth_m, intrinsics, *pose, hand, config);
        Some(CameraDepth { intrinsics: *intrinsics, world_from_camera: *pose, depth_m, labels, colour: None })
    };
    cameras.iter().map(label).collect()
}

#[cfg(test)]
mod tests {
    use mvt_frames::depth::Label;
    use mvt_robot::digit::profile::SensorProfile;
    use mvt_robot::hand::{Finger, JointAngles, PerFinger, Side};
    use mvt_robot::observation::{Percept, Press, Rgbd};
    use mvt_robot::rig::PLACEMENTS;

    use super::*;
    use crate::{Perception, PerceptionConfig, PerceptionError, PerceptionSetup};

    fn cameras() -> Vec<PosedCamera> {
        PLACEMENTS[2..].iter().map(|p| p.camera(Side::Left)).collect()
    }

    fn made(depths_m: Vec<Array2<f32>>, joints: JointAngles) -> Result<Percept, PerceptionError> {
        let press = Press {
            indentation_mm: Array2::zeros((320, 240)),
            contact: Array2::from_elem((320, 240), false),
            sigma_mm: 0.05,
        };
        let mut touch = PerFinger::default();
        touch[Finger::Thumb] = Some(press);
        let cameras_seen = depths_m.into_iter().map(|depth_m| Rgbd { color: Default::default(), depth_m });
        let observation =
            Observation { time_s: 1.5, joints, touch: PerFinger::default(), cameras: cameras_seen.collect() };
        // The joints and cameras are taken as given.
        let mut config = PerceptionConfig::default();
        config.calibration.refine = false;
        let setup = PerceptionSetup { profile: &SensorProfile::tacto(), weights: None, config };
        Ok(Perception::new(Side::Left, cameras(), &setup).see(0, observation, Some(touch))?.percept)
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
