//! Messages of a robot's sensors, as bytes: what a simulated robot publishes.

use image::RgbImage;
use mvt_bag::nalgebra::Isometry3;
use mvt_frames::camera::Intrinsics;
use ndarray::Array2;

use crate::cdr_writer::CdrWriter;
use crate::outgoing::{OutgoingHeader, write_pose};

/// Type of an uncompressed image.
pub const IMAGE: &str = "sensor_msgs/msg/Image";
/// Type of a camera model.
pub const CAMERA_INFO: &str = "sensor_msgs/msg/CameraInfo";
/// Type of joint angles.
pub const JOINT_STATE: &str = "sensor_msgs/msg/JointState";
/// Type of a pose.
pub const POSE: &str = "geometry_msgs/msg/PoseStamped";
/// Type of the time of a simulator.
pub const CLOCK: &str = "rosgraph_msgs/msg/Clock";

fn image(header: OutgoingHeader<'_>, encoding: &str, [width, height]: [usize; 2], bytes: &[u8]) -> Vec<u8> {
    let mut writer = CdrWriter::new();
    header.write(&mut writer);
    writer.count(height).count(width).text(encoding).u8(0).count(bytes.len() / height.max(1)).bytes(bytes);
    writer.into_message()
}

/// Returns an `Image` in colour, rgb8.
pub fn color(header: OutgoingHeader<'_>, image_: &RgbImage) -> Vec<u8> {
    image(header, "rgb8", [image_.width() as usize, image_.height() as usize], image_.as_raw())
}

/// Returns an `Image` of depth along the optical axis in levels of `unit_m`, 16UC1. Depth that no level holds becomes 0, which means
/// unknown.
pub fn depth(header: OutgoingHeader<'_>, depth_m: &Array2<f32>, unit_m: f64) -> Vec<u8> {
    let level = |depth_m: &f32| {
        let level = (f64::from(*depth_m) / unit_m).round();
        if (1.0..=f64::from(u16::MAX)).contains(&level) { level as u16 } else { 0 }
    };
    let bytes: Vec<u8> = depth_m.iter().flat_map(|depth_m| level(depth_m).to_le_bytes()).collect();
    let (height, width) = depth_m.dim();
    image(header, "16UC1", [width, height], &bytes)
}

/// Returns an `Image` of a mask with 0 and `label`, mono8.
pub fn mask(header: OutgoingHeader<'_>, inside: &Array2<bool>, label: u8) -> Vec<u8> {
    let bytes: Vec<u8> = inside.iter().map(|inside| if *inside { label } else { 0 }).collect();
    let (height, width) = inside.dim();
    image(header, "mono8", [width, height], &bytes)
}

/// Returns the `CameraInfo` of a camera without distortion.
pub fn camera_info(header: OutgoingHeader<'_>, intrinsics: Intrinsics) -> Vec<u8> {
    let Intrinsics { width, height, fx, fy, cx, cy } = intrinsics;
    let mut writer = CdrWriter::new();
    header.write(&mut writer);
    writer.count(height).count(width).text("plumb_bob").f64s(&[0.0; 5]);
    writer.array(&[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    writer.array(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    writer.array(&[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]);
    // No binning, the whole image, not rectified anew.
    writer.u32(0).u32(0).u32(0).u32(0).u32(0).u32(0).u8(0);
    writer.into_message()
}

/// Returns a `JointState` of joints with these names: angles, radians, and velocities, rad/s.
pub fn joint_state(header: OutgoingHeader<'_>, names: &[String], angles: &[f64], velocities: &[f64]) -> Vec<u8> {
    let mut writer = CdrWriter::new();
    header.write(&mut writer);
    writer.count(names.len());
    for name in names {
        writer.text(name);
    }
    writer.f64s(angles).f64s(velocities).f64s(&[]);
    writer.into_message()
}

/// Returns a `PoseStamped`.
pub fn pose(header: OutgoingHeader<'_>, pose: &Isometry3<f64>) -> Vec<u8> {
    let mut writer = CdrWriter::new();
    header.write(&mut writer);
    write_pose(&mut writer, pose);
    writer.into_message()
}

/// Returns a `Clock`.
pub fn clock(stamp_ns: i64) -> Vec<u8> {
    let mut writer = CdrWriter::new();
    OutgoingHeader { stamp_ns, frame: "" }.write_stamp(&mut writer);
    writer.into_message()
}

#[cfg(test)]
mod tests {
    use mvt_bag::{RosCameraInfo, RosImage, RosJointState, RosLens, RosPose};

    use super::*;

    const HEADER: OutgoingHeader<'_> = OutgoingHeader { stamp_ns: 12_000_000_345, frame: "optical" };

    #[test]
    fn what_is_written_is_read_back() {
        let depth_m = Array2::from_shape_fn((3, 5), |(row, column)| 0.1 * row as f32 + 0.01 * column as f32);
        let message = depth(HEADER, &depth_m, 0.001);
        let image = RosImage::decode(&message).unwrap();
        assert_eq!((image.header.stamp_ns, image.header.frame.as_str()), (12_000_000_345, "optical"));
        let read = image.depth_m(0.001).unwrap();
        assert!(read.dim() == (3, 5) && read.iter().zip(&depth_m).all(|(a, b)| (a - b).abs() < 6e-4));
        let picture = RgbImage::from_fn(4, 3, |x, y| image::Rgb([x as u8, y as u8, 7]));
        assert_eq!(RosImage::decode(&color(HEADER, &picture)).unwrap().colours().unwrap(), picture);
        let inside = Array2::from_shape_fn((3, 5), |(row, _)| row == 1);
        let labels = RosImage::decode(&mask(HEADER, &inside, 255)).unwrap().labels().unwrap();
        assert!(labels.iter().zip(&inside).all(|(label, inside)| *label == if *inside { 255 } else { 0 }));
        let intrinsics = Intrinsics { width: 640, height: 480, fx: 600.0, fy: 601.0, cx: 319.5, cy: 239.0 };
        let info = RosCameraInfo::decode(&camera_info(HEADER, intrinsics)).unwrap();
        assert_eq!(RosLens::new(&info, false).unwrap().intrinsics, intrinsics);
        let place = Isometry3::translation(1.0, 2.0, 3.0);
        assert_eq!(RosPose::decode(&pose(HEADER, &place)).unwrap().pose, place);
        let names = ["a".to_owned(), "b".to_owned()];
        let state = RosJointState::decode(&joint_state(HEADER, &names, &[0.1, 0.2], &[1.0, 2.0])).unwrap();
        assert_eq!(state.positions, [("a".to_owned(), 0.1), ("b".to_owned(), 0.2)]);
        assert_eq!(state.velocities, [("a".to_owned(), 1.0), ("b".to_owned(), 2.0)]);
    }

    #[test]
    fn depth_beyond_the_levels_is_unknown() {
        let depth_m = Array2::from_shape_vec((1, 4), vec![f32::NAN, -1.0, 70.0, 65.0]).unwrap();
        let message = depth(HEADER, &depth_m, 0.001);
        let read = RosImage::decode(&message).unwrap().depth_m(0.001).unwrap();
        assert_eq!(read.iter().map(|m| *m > 0.0).collect::<Vec<_>>(), [false, false, false, true]);
    }
}
