//! Encoding of one frame. It takes most of the time and needs no order, so that frames can be encoded on all threads.

use image::{GrayImage, RgbImage};
use mvt_frames::camera::PosedCamera;
use mvt_frames::depth::Label;
use mvt_frames::{Isometry, MeshFile, Object};
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::{Hand, JointAngles, PerPad};
use mvt_robot::observation::{GroundTruth, Observation, Rgbd, TouchTruth};
use ndarray::Array2;

use crate::error::LogError;
use crate::frames::{self, EncodedImages, RawCamera, RawFrame, RawTouch};
use crate::levels;
use crate::preview;
use crate::record::{DigitInfo, Matrix};
use crate::scene::LogMeta;

/// Encoded frame of a log. Its bytes depend on the frame alone.
#[derive(Debug, Clone)]
pub struct EncodedFrame {
    pub(super) time_s: f64,
    pub(super) joints: JointAngles,
    /// Published mesh to world.
    pub(super) object_pose: Matrix,
    pub(super) finger_poses: Vec<Matrix>,
    pub(super) images: EncodedImages,
    pub(super) preview: RgbImage,
}

impl EncodedFrame {
    /// Encodes the observation and the ground truth of one instant.
    ///
    /// Touch depth is the height over the plane of the gel's apex (22 mm from the camera of a DIGIT), in steps of 0.03 mm, for the whole pad: object
    /// or untouched gel. TACTO's height maps and the networks trained on them use the same encoding. Loaders multiply
    /// it by the contact mask and take level 0 for no contact, so a pixel in contact has at least level 1.
    ///
    /// # Errors
    /// [`LogError::Frame`] if the images, cameras or sizes differ from those of the log.
    pub fn encode(observation: &Observation, truth: &GroundTruth, meta: &LogMeta) -> Result<Self, LogError> {
        let time_s = observation.time_s;
        encode(observation, truth, meta).map_err(|defect| LogError::Frame { time_s, defect })
    }
}

fn encode(observation: &Observation, truth: &GroundTruth, meta: &LogMeta) -> Result<EncodedFrame, String> {
    // Why: notes/decisions/simulation.md, "Logs store poses of the published mesh".
    let object_from_file = Isometry::<MeshFile, Object>::from_matrix(&meta.scene.object.object_from_file)
        .map_err(|e| format!("object_from_file is {e}"))?;
    if !observation.time_s.is_finite() || observation.joints.iter().any(|q| !q.is_finite()) {
        return Err("its time or a joint angle is not finite".into());
    }
    let cameras = meta.cameras.len();
    if observation.cameras.len() != cameras || truth.labels.len() != cameras {
        return Err(format!("it has {} cameras and the log {cameras}", observation.cameras.len()));
    }
    let hand = &meta.scene.hand;
    for (what, found, expected) in [
        ("joint angles", observation.joints.len(), hand.joints().len()),
        ("touch images", observation.touch.len(), hand.pads().len()),
        ("true touch depths", truth.touch.len(), hand.pads().len()),
    ] {
        if found != expected {
            return Err(format!("it has {found} {what} and hand {} {expected}", hand.name()));
        }
    }
    let touch = observation.touch.iter().zip(truth.touch.iter());
    let touch = touch
        .zip(hand.pads())
        .map(|((image, truth), pad)| raw_touch(image, truth, &pad.profile).map_err(|e| format!("{}: {e}", pad.name)));
    let touch = touch.collect::<Result<PerPad<_>, _>>()?;
    let cameras = observation.cameras.iter().zip(&truth.labels).zip(&meta.cameras);
    let cameras = cameras
        .map(|((rgbd, labels), camera)| raw_camera(rgbd, labels, camera).map_err(|e| format!("{}: {e}", camera.name)));
    let raw = RawFrame { touch, cameras: cameras.collect::<Result<_, _>>()? };
    Ok(EncodedFrame {
        time_s: observation.time_s,
        joints: observation.joints.clone(),
        object_pose: (truth.object_pose * object_from_file).to_matrix(),
        finger_poses: finger_poses(hand, &observation.joints),
        images: frames::encode(&raw, hand, meta.untouched.as_ref())?,
        preview: preview::tile(observation),
    })
}

/// Returns the poses of the cameras of the touch sensors in the world.
pub(super) fn finger_poses(hand: &Hand, joints: &[f64]) -> Vec<Matrix> {
    hand.world_from_touch_cameras(joints).iter().map(|pose| pose.to_matrix()).collect()
}

fn check(what: &str, size: (usize, usize), expected: (usize, usize)) -> Result<(), String> {
    if size == expected {
        return Ok(());
    }
    Err(format!("{what} is {} x {} and not {} x {}", size.0, size.1, expected.0, expected.1))
}

fn image_size(dimensions: (u32, u32)) -> (usize, usize) {
    (dimensions.0 as usize, dimensions.1 as usize)
}

fn raw_touch(image: &RgbImage, truth: &TouchTruth, profile: &SensorProfile) -> Result<RawTouch, String> {
    let size = profile.size_px.into();
    check("the image", image_size(image.dimensions()), size)?;
    let (rows, columns) = truth.contact.dim();
    check("the contact mask", (columns, rows), size)?;
    let (rows, columns) = truth.depth_m.dim();
    check("the depth", (columns, rows), size)?;
    let info = DigitInfo::published().of(profile);
    let level = |(&depth, &touches): (&f32, &bool)| info.level(depth).max(u8::from(touches));
    let levels = truth.depth_m.iter().zip(&truth.contact).map(level).collect();
    let levels = GrayImage::from_raw(image.width(), image.height(), levels).ok_or("the depth has holes")?;
    let mask = levels::image_of(&truth.contact, |&touches| if touches { 255 } else { 0 });
    Ok(RawTouch { image: Some(image.clone()), labels: Some((levels, mask)) })
}

fn raw_camera(rgbd: &Rgbd, labels: &Array2<Label>, camera: &PosedCamera) -> Result<RawCamera, String> {
    let size = (camera.intrinsics.width, camera.intrinsics.height);
    check("the image", image_size(rgbd.color.dimensions()), size)?;
    let (rows, columns) = labels.dim();
    check("the segmentation", (columns, rows), size)?;
    let (rows, columns) = rgbd.depth_m.dim();
    check("the depth", (columns, rows), size)?;
    Ok(RawCamera {
        name: camera.name.clone(),
        size,
        image: Some(rgbd.color.clone()),
        segmentation: Some(levels::image_of(labels, |label| label.grey())),
        depth_m: rgbd.depth_m.iter().map(|&depth| if depth > 0.0 { depth } else { 0.0 }).collect(),
    })
}
