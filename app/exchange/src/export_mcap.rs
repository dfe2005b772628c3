//! A log as an MCAP file.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use mvt_feelsight::{ImageFiles, Log, SCENE_FILE};
use mvt_files::output::PartialFile;
use mvt_frames::camera::PosedCamera;
use mvt_frames::{Isometry, Object, World};
use mvt_robot::hand::{JointAngles, PerPad, TouchPad};

use crate::error::ExchangeError;
use crate::foxglove::{
    CAMERA_CALIBRATION, COMPRESSED_IMAGE, FRAME_TRANSFORMS, JOINT_STATES, RAW_IMAGE, calibration, compressed,
    joint_states, optical, raw_image, time_ns, timestamp, transform, transforms,
};
use crate::protobuf::Message;
use crate::record::{RECORD_FILE, record_of};
use crate::writer::{Channel, Mcap, MessageSink as _};

/// Contents of an exported file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Exported {
    /// Number of frames.
    pub frames: usize,
    /// Number of channels.
    pub channels: usize,
    /// Size of the file, bytes.
    pub bytes: u64,
}

/// Writes a log as an MCAP file with Foxglove's protobuf schemas. `advance` is called after each frame.
///
/// | channel | schema | contents |
/// |---|---|---|
/// | `/tf` | FrameTransforms | frames of all cameras and touch sensors, and `object`, the true pose where it is known, in `world` |
/// | `/hand/joints` | JointStates | angles, rad |
/// | `/camera/NAME/color`, `/labels` | CompressedImage | files of the log, unchanged |
/// | `/camera/NAME/depth` | RawImage, 32FC1 | metres along the optical axis, 0 where nothing was measured |
/// | `/camera/NAME/calibration` | CameraCalibration | pinhole model |
/// | `/touch/PAD/image`, `/depth`, `/contact` | CompressedImage | files of the log, unchanged |
///
/// Times are nanoseconds since the log's own zero. scene.json is attached, and data.pkl, which has times and poses to the last bit, unless a lens
/// distorts. The preview is left out.
///
/// # Errors
/// [`ExchangeError`]; an incomplete file never has the name `out`.
pub fn export_mcap(
    log: &Log,
    out: &Path,
    overwrite: bool,
    mut advance: impl FnMut(),
) -> Result<Exported, ExchangeError> {
    write_mcap(out, overwrite, |file, io| {
        let channels = Channels::new(file, log).map_err(io)?;
        for (number, frame) in log.frames()?.enumerate() {
            let frame = frame?.observation;
            let depths = frame.cameras.iter().map(|rgbd| rgbd.depth_m.iter().copied().collect()).collect();
            let files = log.image_files(number)?;
            let object_pose = log.object_poses().get(number).copied().flatten();
            let instant = Instant { time_s: frame.time_s, joints: frame.joints, object_pose, depths, files };
            for (channel, message) in channels.messages(log, instant) {
                file.push(channel, time_ns(frame.time_s), &message.into_bytes()).map_err(io)?;
            }
            advance();
        }
        if let Some(scene) = log.scene_file()? {
            file.attach(SCENE_FILE, "application/json", &scene).map_err(io)?;
        }
        if let Some(record) = record_of(log) {
            file.attach(RECORD_FILE, "application/octet-stream", &record).map_err(io)?;
        }
        Ok(log.len())
    })
}

/// Writes a file that appears whole or not at all. `write` adds channels and messages, and returns the number of frames; its second
/// argument names the file in an error of the operating system.
pub(crate) fn write_mcap(
    out: &Path,
    overwrite: bool,
    write: impl FnOnce(
        &mut Mcap<BufWriter<&mut File>>,
        &dyn Fn(std::io::Error) -> ExchangeError,
    ) -> Result<usize, ExchangeError>,
) -> Result<Exported, ExchangeError> {
    let io = |reason: std::io::Error| match reason.kind() {
        std::io::ErrorKind::AlreadyExists => ExchangeError::Exists(out.to_path_buf()),
        _ => ExchangeError::Io { path: out.to_path_buf(), reason },
    };
    if !overwrite {
        mvt_files::output::refuse_existing(out).map_err(io)?;
    }
    let mut partial = PartialFile::create(out).map_err(io)?;
    let mut file = Mcap::new(BufWriter::new(partial.file()), "mambavitact").map_err(io)?;
    let frames = write(&mut file, &io)?;
    let channels = file.channel_count();
    let bytes = file.finish().map_err(io)?;
    if overwrite { partial.replace() } else { partial.finish() }.map_err(io)?;
    Ok(Exported { frames, channels, bytes })
}

/// One instant of a log.
struct Instant {
    time_s: f64,
    joints: JointAngles,
    object_pose: Option<Isometry<Object, World>>,
    /// Depths of each camera, metres, row by row.
    depths: Vec<Vec<f32>>,
    files: ImageFiles,
}

/// The channels of a log.
struct Channels {
    tf: Channel,
    joints: Channel,
    cameras: Vec<CameraChannels>,
    touch: PerPad<TouchChannels>,
}

struct CameraChannels {
    frame: String,
    color: Channel,
    labels: Channel,
    depth: Channel,
    calibration: Channel,
}

struct TouchChannels {
    frame: String,
    image: Channel,
    depth: Channel,
    contact: Channel,
}

impl Channels {
    fn new<W: Write>(file: &mut Mcap<W>, log: &Log) -> std::io::Result<Self> {
        let mut channel = |topic: &str, of| file.channel(topic, of);
        let tf = channel("/tf", &FRAME_TRANSFORMS)?;
        let joints = channel("/hand/joints", &JOINT_STATES)?;
        let mut cameras = Vec::new();
        for PosedCamera { name, .. } in log.cameras() {
            cameras.push(CameraChannels {
                frame: format!("camera/{name}"),
                color: channel(&format!("/camera/{name}/color"), &COMPRESSED_IMAGE)?,
                labels: channel(&format!("/camera/{name}/labels"), &COMPRESSED_IMAGE)?,
                depth: channel(&format!("/camera/{name}/depth"), &RAW_IMAGE)?,
                calibration: channel(&format!("/camera/{name}/calibration"), &CAMERA_CALIBRATION)?,
            });
        }
        let mut touch = PerPad(Vec::new());
        for TouchPad { name, .. } in log.hand().pads() {
            touch.0.push(TouchChannels {
                frame: format!("touch/{name}"),
                image: channel(&format!("/touch/{name}/image"), &COMPRESSED_IMAGE)?,
                depth: channel(&format!("/touch/{name}/depth"), &COMPRESSED_IMAGE)?,
                contact: channel(&format!("/touch/{name}/contact"), &COMPRESSED_IMAGE)?,
            });
        }
        Ok(Self { tf, joints, cameras, touch })
    }

    /// Returns the messages of an instant.
    fn messages(&self, log: &Log, instant: Instant) -> Vec<(Channel, Message)> {
        let Instant { time_s, joints, object_pose, depths, files } = instant;
        let ImageFiles { colours, labels, touch, touch_truth, .. } = files;
        let stamp = timestamp(time_ns(time_s));
        let mut messages = Vec::new();
        let mut poses = Vec::new();
        for (channels, camera) in self.cameras.iter().zip(log.cameras()) {
            poses.push(transform(&stamp, &channels.frame, camera.pose * optical()));
            messages.push((channels.calibration, calibration(&stamp, &channels.frame, &camera.intrinsics)));
        }
        for ((channels, file), (depth, camera)) in
            self.cameras.iter().zip(&colours).zip(depths.iter().zip(log.cameras()))
        {
            messages.extend(file.as_ref().map(|file| (channels.color, compressed(&stamp, &channels.frame, file))));
            messages.push((channels.depth, raw_image(&stamp, &channels.frame, camera.intrinsics.width, depth)));
        }
        for (channels, file) in self.cameras.iter().zip(labels.iter().flatten()) {
            messages.push((channels.labels, compressed(&stamp, &channels.frame, file)));
        }
        for ((pad, channels), pose) in self.touch.iter().enumerate().zip(log.hand().world_from_touch_cameras(&joints)) {
            poses.push(transform(&stamp, &channels.frame, pose * optical()));
            let image = touch.get(pad).and_then(Option::as_ref);
            messages.extend(image.map(|file| (channels.image, compressed(&stamp, &channels.frame, file))));
            if let Some([depth, contact]) = touch_truth.as_ref().and_then(|truth| truth.get(pad)) {
                messages.push((channels.depth, compressed(&stamp, &channels.frame, depth)));
                messages.push((channels.contact, compressed(&stamp, &channels.frame, contact)));
            }
        }
        poses.extend(object_pose.map(|pose| transform(&stamp, "object", pose)));
        let poses = transforms(&poses);
        let states = joint_states(&stamp, log.hand(), &joints);
        messages.extend([(self.tf, poses), (self.joints, states)]);
        messages
    }
}
