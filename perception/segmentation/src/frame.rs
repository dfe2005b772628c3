//! From an observation to the frame that the tracker receives.

use mvt_frames::camera::PosedCamera;
use mvt_frames::depth::{CameraDepth, TouchDepth};
use mvt_frames::{Camera, Isometry, World};
use mvt_robot::digit;
use mvt_robot::hand::solid::HandSolid;
use mvt_robot::hand::{Finger, PerFinger, Side, world_from_digit_camera};
use mvt_robot::observation::{DepthFrame, Observation, Rgbd, Sensor, SensorError, TouchImages, check_size};
use ndarray::Array2;

use crate::segmentation::{SegmentationConfig, segment};

/// What a frame lacks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Gaps {
    /// Cameras without an image.
    pub silent_cameras: usize,
    /// Fingers without touch.
    pub silent_fingers: usize,
    /// Pixels whose depth was negative, infinite or no number; they count as not measured.
    pub invalid_pixels: usize,
}

/// Assembles what all sensors measured at one instant; `cameras` in the order of the observation's images. A missing or empty
/// image leaves its sensor `None`. Says also what is missing.
///
/// # Errors
/// [`SensorError`] if an image has another size than its sensor's, there are more images than cameras, or the time or a joint
/// angle is not finite.
pub fn depth_frame(
    observation: &Observation,
    touch: PerFinger<Option<TouchImages<'_>>>,
    cameras: &[PosedCamera],
    side: Side,
    segmentation: &SegmentationConfig,
) -> Result<(DepthFrame, Gaps), SensorError> {
    let &Observation { time_s, joints, .. } = observation;
    if !time_s.is_finite() {
        return Err(SensorError::NotFinite("the time of the observation"));
    }
    if joints.iter().any(|angle| !angle.is_finite()) {
        return Err(SensorError::NotFinite("a joint angle"));
    }
    if observation.cameras.len() > cameras.len() {
        return Err(SensorError::Cameras { expected: cameras.len(), found: observation.cameras.len() });
    }
    let mut gaps = Gaps::default();
    let hand = HandSolid::new(side, &joints);
    let mut camera_depths = Vec::with_capacity(cameras.len());
    for (index, camera) in cameras.iter().enumerate() {
        let depth = match observation.cameras.get(index) {
            Some(image) => camera_depth(image, camera, &hand, segmentation, &mut gaps)?,
            None => None,
        };
        gaps.silent_cameras += usize::from(depth.is_none());
        camera_depths.push(depth);
    }
    let mut touch_depths = PerFinger::default();
    for (finger, images) in touch.iter() {
        let pose = world_from_digit_camera(side, finger, &joints);
        touch_depths[finger] = match images {
            Some(images) => touch_from_depth(finger, *images, pose, &mut gaps)?,
            None => None,
        };
        gaps.silent_fingers += usize::from(touch_depths[finger].is_none());
    }
    Ok((DepthFrame { time_s, joints, cameras: camera_depths, touch: touch_depths }, gaps))
}

/// Depth and contact of a DIGIT at a pose; `None` if either image is empty. Pixels without a valid depth are no contact; they are
/// counted in `gaps`.
///
/// # Errors
/// [`SensorError::Size`] if an image is not 240 wide and 320 high.
pub fn touch_from_depth(
    finger: Finger,
    TouchImages { depth_m, contact, sigma_m }: TouchImages<'_>,
    world_from_camera: Isometry<Camera, World>,
    gaps: &mut Gaps,
) -> Result<Option<TouchDepth>, SensorError> {
    if depth_m.is_empty() || contact.is_empty() {
        return Ok(None);
    }
    let sensor = || Sensor::Touch(finger);
    check_size(sensor, "depth", [digit::WIDTH, digit::HEIGHT], size(depth_m))?;
    check_size(
        sensor,
        "contact",
        [digit::WIDTH, digit::HEIGHT],
        [contact.width() as usize, contact.height() as usize],
    )?;
    let depth_m = measured(depth_m, gaps);
    let mut contact = contact.clone();
    for (level, &depth) in contact.iter_mut().zip(&depth_m) {
        *level = if *level > 127 && depth > 0.0 { 255 } else { 0 };
    }
    Ok(Some(TouchDepth { world_from_camera, depth_m, contact, sigma_m }))
}

fn camera_depth(
    image: &Rgbd,
    camera: &PosedCamera,
    hand: &HandSolid,
    config: &SegmentationConfig,
    gaps: &mut Gaps,
) -> Result<Option<CameraDepth>, SensorError> {
    if image.depth_m.is_empty() {
        return Ok(None);
    }
    let PosedCamera { name, intrinsics, pose } = camera;
    let expected = [intrinsics.width, intrinsics.height];
    check_size(|| Sensor::Camera(name.clone()), "depth", expected, size(&image.depth_m))?;
    let depth_m = measured(&image.depth_m, gaps);
    let segmentation = segment(&depth_m, intrinsics, *pose, hand, config);
    Ok(Some(CameraDepth { intrinsics: *intrinsics, world_from_camera: *pose, depth_m, segmentation }))
}

/// The image with 0 for whatever is no depth.
fn measured(depth_m: &Array2<f32>, gaps: &mut Gaps) -> Array2<f32> {
    let mut invalid = 0;
    let valid = depth_m.mapv(|depth| {
        let is_valid = depth.is_finite() && depth >= 0.0;
        invalid += usize::from(!is_valid);
        if is_valid { depth } else { 0.0 }
    });
    gaps.invalid_pixels += invalid;
    valid
}

/// Width and height.
fn size(image: &Array2<f32>) -> [usize; 2] {
    [image.ncols(), image.nrows()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, Luma, RgbImage};
    use mvt_frames::depth::OBJECT;
    use mvt_robot::rig::PLACEMENTS;

    fn observation(depths: Vec<Array2<f32>>) -> Observation {
        let rgbd = |depth_m| Rgbd { color: RgbImage::default(), depth_m };
        Observation {
            time_s: 1.5,
            joints: [0.1; 16],
            touch: PerFinger::from_fn(|_| RgbImage::default()),
            cameras: depths.into_iter().map(rgbd).collect(),
        }
    }

    fn cameras() -> Vec<PosedCamera> {
        PLACEMENTS[2..].iter().map(|p| p.camera(Side::Left)).collect()
    }

    #[test]
    fn whole_frame() {
        let depth = Array2::from_elem((320, 240), 0.021);
        let contact = GrayImage::from_pixel(240, 320, Luma([200]));
        let images = TouchImages { depth_m: &depth, contact: &contact, sigma_m: 5e-5 };
        let observation = observation(vec![Array2::from_elem((480, 640), 0.3); 2]);
        let touch = PerFinger([Some(images); 4]);
        let (frame, gaps) =
            depth_frame(&observation, touch, &cameras(), Side::Left, &SegmentationConfig::default()).unwrap();
        assert_eq!(gaps, Gaps::default());
        assert_eq!((frame.time_s, frame.joints), (1.5, [0.1; 16]));
        let top = frame.cameras[0].as_ref().unwrap();
        assert_eq!(top.segmentation.get_pixel(320, 240).0, [OBJECT]);
        assert_eq!(top.world_from_camera, cameras()[0].pose);
        let thumb = frame.touch[Finger::Thumb].as_ref().unwrap();
        assert_eq!(thumb.world_from_camera, world_from_digit_camera(Side::Left, Finger::Thumb, &frame.joints));
        assert!(thumb.contact.pixels().all(|p| p.0 == [255]) && thumb.sigma_m > 0.0);
    }

    #[test]
    fn silent_sensors_are_none_and_counted() {
        let (depth, contact) = (Array2::zeros((0, 0)), GrayImage::new(240, 320));
        let mut touch = PerFinger::default();
        touch[Finger::Ring] = Some(TouchImages { depth_m: &depth, contact: &contact, sigma_m: 5e-5 });
        let observation = observation(vec![Array2::zeros((0, 0))]);
        let (frame, gaps) =
            depth_frame(&observation, touch, &cameras(), Side::Left, &SegmentationConfig::default()).unwrap();
        assert_eq!(gaps, Gaps { silent_cameras: 2, silent_fingers: 4, invalid_pixels: 0 });
        assert!(frame.cameras.iter().all(Option::is_none) && frame.touch.0.iter().all(Option::is_none));
    }

    #[test]
    fn invalid_depth_is_not_measured() {
        let mut depth = Array2::from_elem((480, 640), 0.3);
        (depth[[0, 0]], depth[[240, 320]], depth[[7, 5]]) = (f32::NAN, f32::INFINITY, -0.3);
        let observation = observation(vec![depth]);
        let (frame, gaps) = depth_frame(
            &observation,
            PerFinger::default(),
            &cameras()[..1],
            Side::Left,
            &SegmentationConfig::default(),
        )
        .unwrap();
        assert_eq!(gaps.invalid_pixels, 3);
        let camera = frame.cameras[0].as_ref().unwrap();
        assert_eq!([(0, 0), (240, 320), (7, 5)].map(|at| camera.depth_m[at]), [0.0; 3]);
        assert_ne!(camera.segmentation.get_pixel(320, 240).0, [OBJECT]);

        let mut depth = Array2::from_elem((320, 240), 0.02);
        depth[[3, 4]] = f32::NAN;
        let contact = GrayImage::from_pixel(240, 320, Luma([255]));
        let mut gaps = Gaps::default();
        let images = TouchImages { depth_m: &depth, contact: &contact, sigma_m: 5e-5 };
        let touch = touch_from_depth(Finger::Index, images, Isometry::identity(), &mut gaps).unwrap().unwrap();
        assert_eq!(
            (gaps.invalid_pixels, touch.contact.get_pixel(4, 3).0, touch.contact.get_pixel(3, 4).0),
            (1, [0], [255])
        );
    }

    #[test]
    fn wrong_sizes_name_the_sensor() {
        let message = |observation: &Observation, touch| {
            depth_frame(observation, touch, &cameras(), Side::Left, &SegmentationConfig::default())
                .unwrap_err()
                .to_string()
        };
        let good = || Array2::zeros((480, 640));
        let wrong = observation(vec![good(), Array2::zeros((640, 480))]);
        let text = message(&wrong, PerFinger::default());
        assert!(text.starts_with("camera side: its depth image is 480 x 640 pixels; 640 x 480 expected"), "{text}");
        let (depth, contact) = (Array2::zeros((320, 240)), GrayImage::new(320, 240));
        let mut touch = PerFinger::default();
        touch[Finger::Middle] = Some(TouchImages { depth_m: &depth, contact: &contact, sigma_m: 5e-5 });
        let text = message(&observation(vec![]), touch);
        assert!(text.starts_with("the DIGIT of the middle finger: its contact image is 320 x 240"), "{text}");
        assert!(message(&observation(vec![good(); 3]), PerFinger::default()).contains("3 cameras"));
        let mut broken = observation(vec![]);
        broken.joints[3] = f64::NAN;
        assert!(message(&broken, PerFinger::default()).contains("joint angle"));
    }
}
