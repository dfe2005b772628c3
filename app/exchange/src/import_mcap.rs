//! An MCAP file as a log.

use std::collections::HashMap;
use std::fmt;
use std::path::Path;

use mvt_feelsight::{LogAssembler, LogCamera, LogImage, SCENE_FILE, SceneFile, Timeline};
use mvt_frames::camera::PosedCamera;
use mvt_frames::{Camera, HandBase, Isometry, Object, World};
use mvt_robot::hand::{Finger, JointAngles, world_from_base};
use nalgebra::Isometry3;
use serde::Serialize;

use crate::clock::{Aligned, Stamps, nearest, numbers_at, pose_at, reach};
use crate::error::{Defect, ExchangeError};
use crate::foxglove::optical;
use crate::mapping::{CameraMapping, Mapping, PinholeMapping, PoseMapping};
use crate::messages::{Decoded, decode};
use crate::pictures::{depth_of, file_of};
use crate::reader::{Record, scan};
use crate::record::{agrees, put};
use crate::survey::{CameraModel, Role, Survey, Used, survey, topics};

/// Times from this on are those of a calendar and not of a recording, nanoseconds: a day.
const CALENDAR_NS: i64 = 86_400_000_000_000;

/// Contents of an imported recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Imported {
    /// Number of frames of the log.
    pub frames: usize,
    /// The channels that were used, in their order in the file.
    pub channels: Vec<ImportedChannel>,
    /// Missing and replaced data, in sentences.
    pub notes: Vec<String>,
}

/// Channel of a recording, and how it fits the frames.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ImportedChannel {
    /// Topic.
    pub topic: String,
    /// Number of messages.
    pub messages: usize,
    /// Messages per second; 0 of a single one.
    pub rate_hz: f64,
    /// Offset that was added to the channel's own times, milliseconds: the distance of its clock from that of the frames. 0 on one clock.
    pub offset_ms: f64,
    /// Greatest distance between a frame and its message, milliseconds; `None` if it is interpolated or constant.
    pub farthest_ms: Option<f64>,
    /// Frames that have a message of this channel; `None` if it is interpolated or constant.
    pub frames: Option<usize>,
}

impl fmt::Display for Imported {
    /// Writes a table of the channels, and the number of frames.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let widest = self.channels.iter().map(|channel| channel.topic.len()).max().unwrap_or(0);
        writeln!(f, "{:widest$}  messages       Hz  offset ms  farthest ms  frames", "topic")?;
        for ImportedChannel { topic, messages, rate_hz, offset_ms, farthest_ms, frames } in &self.channels {
            let farthest = farthest_ms.map_or_else(|| "-".to_owned(), |ms| format!("{ms:.1}"));
            let count = frames.map_or_else(|| "-".to_owned(), |count| count.to_string());
            writeln!(f, "{topic:widest$}  {messages:8}  {rate_hz:7.1}  {offset_ms:9.1}  {farthest:>11}  {count:>6}")?;
        }
        write!(f, "{} frames", self.frames)
    }
}

/// Writes an MCAP file as a log in the folder `out`. Without a mapping file it must be an export of this program. `progress` receives the
/// number of frames that are done and of all frames.
///
/// The frames are the depth images of the first camera; without cameras, the images of the first DIGIT. Each frame takes the nearest image of
/// every other sensor, and a message serves one frame. Joint angles and the object's pose are interpolated. Memory does not grow with the
/// images of the file.
///
/// # Errors
/// [`ExchangeError`]; an incomplete log never has the name `out`.
pub fn import_mcap(
    source: &Path,
    mapping: Option<&Path>,
    out: &Path,
    mut progress: impl FnMut(usize, usize),
) -> Result<Imported, ExchangeError> {
    let given = mapping.map(Mapping::read).transpose()?;
    import(source, given, out, &mut progress).map_err(|defect| defect.of(source))
}

fn import(
    source: &Path,
    given: Option<Mapping>,
    out: &Path,
    progress: &mut impl FnMut(usize, usize),
) -> Result<Imported, Defect> {
    let mapping = match given {
        Some(mapping) => mapping,
        None => Mapping::of_our_export(topics(source)?.iter().map(String::as_str)),
    };
    if mapping.hand.time.is_some() {
        return Err("hand.time is for data sets; messages have times of their own: remove it".to_owned().into());
    }
    let survey = survey(source, &mapping)?;
    let mut plan = Plan::new(&mapping, &survey)?;
    let scene = scene(&survey, &mapping)?;
    let mut writer = LogAssembler::create(out, cameras(&mapping, &survey, &mut plan.notes)?)?;
    write_images(source, &mapping, &survey, &plan, &mut writer, progress)?;
    let object_name = match (&mapping.object.name, &scene) {
        (Some(name), _) => name.clone(),
        (None, Some(scene)) => scene.object.name.clone(),
        (None, None) => "object".to_owned(),
    };
    let Plan { times_s, joints, object_poses, channels, notes, .. } = plan;
    let frames = times_s.len();
    let side = scene.as_ref().map_or(mapping.hand.side, |scene| scene.hand);
    let names = mapping.cameras.iter().map(|camera| camera.name.as_str());
    let record = survey.record.filter(|record| agrees(record, &times_s, &joints, names));
    writer.finish(Timeline { object_name, side, times_s, joints, object_poses, scene })?;
    if let Some(record) = record {
        // Both are complete logs.
        put(&record, out).map_err(|error| format!("cannot write {}: {error}", out.display()))?;
    }
    Ok(Imported { frames, channels, notes })
}

/// The frames of a log, and which message each takes.
struct Plan {
    times_s: Vec<f64>,
    joints: Vec<JointAngles>,
    object_poses: Vec<Option<Isometry<Object, World>>>,
    /// Frame of each message of a channel that has one.
    frames_of: HashMap<u16, Vec<Option<usize>>>,
    channels: Vec<ImportedChannel>,
    notes: Vec<String>,
}

fn is_image(role: Role) -> bool {
    matches!(role, Role::Image(_) | Role::Depth(_))
}

impl Plan {
    fn new(mapping: &Mapping, survey: &Survey) -> Result<Self, Defect> {
        let used = |role| survey.channel_of(role);
        let touch = || Finger::ALL.into_iter().find_map(|finger| used(Role::Image(LogImage::Touch(finger))));
        let first = if mapping.cameras.is_empty() { touch() } else { used(Role::Depth(0)) };
        let first = first.ok_or_else(|| no_frames(mapping))?;
        let reference = &first.stamps;
        let joints = used(Role::Joints).ok_or_else(|| {
            format!("there are no joint angles: no message of {}; name a topic in hand.joints", mapping.hand.joints)
        })?;

        let mut frames = in_time(&first.record.topic, reference, reference)?.times;
        frames.dedup();
        let period = Aligned { times: frames.clone(), shift: 0, jumps: false }.period();
        let aligned_joints = in_time(&joints.record.topic, &joints.stamps, reference)?;
        let joints_reach = reach(period, aligned_joints.period());
        let all = frames.len();
        let mut angles = Vec::new();
        frames.retain(|&at| {
            let found = numbers_at(&aligned_joints.times, &survey.joints, at, joints_reach);
            angles.extend(found);
            found.is_some()
        });
        let mut notes = Vec::new();
        if frames.is_empty() {
            return Err("no frame is near a message of the joint angles; their clocks differ".to_owned().into());
        }
        if frames.len() < all {
            notes.push(format!(
                "{} of {all} frames are left out: they are far from all joint angles",
                all - frames.len()
            ));
        }

        let root = mapping.hand.base.as_ref().unwrap_or(&mapping.hand.world);
        let object = in_time("the object's pose", &survey.object_stamps, reference)?;
        let object_reach = reach(period, object.period());
        let poses = survey.object_poses(root)?;
        let pose =
            |&at: &i64| Some(Isometry::new(in_world(mapping, pose_at(&object.times, &poses, at, object_reach)?)));
        let object_poses: Vec<_> = frames.iter().map(pose).collect();

        let mut plan = Self {
            times_s: Vec::new(),
            joints: angles,
            object_poses,
            frames_of: HashMap::new(),
            channels: Vec::new(),
            notes,
        };
        for (&id, used) in &survey.channels {
            plan.channel(id, used, reference, &frames, period)?;
        }
        plan.missing(mapping, survey);
        let zero = frames.first().copied().filter(|first| *first >= CALENDAR_NS).unwrap_or_default();
        plan.times_s = frames.iter().map(|&at| (at - zero) as f64 / 1e9).collect();
        Ok(plan)
    }

    /// Chooses the messages of a channel.
    fn channel(&mut self, id: u16, used: &Used, reference: &Stamps, frames: &[i64], period: i64) -> Result<(), String> {
        let topic = &used.record.topic;
        let aligned = in_time(topic, &used.stamps, reference)?;
        if aligned.jumps {
            self.notes.push(format!("the clock of {topic} jumps: the times of recording are used"));
        }
        let (mut farthest_ms, mut count) = (None, None);
        if is_image(used.role) {
            let chosen = nearest(frames, &aligned.times, reach(period, aligned.period()));
            let mut frames_of = vec![None; aligned.times.len()];
            let mut farthest = 0;
            for (frame, message) in chosen.iter().enumerate() {
                let Some(message) = *message else { continue };
                if let (Some(place), Some(time), Some(at)) =
                    (frames_of.get_mut(message), aligned.times.get(message), frames.get(frame))
                {
                    *place = Some(frame);
                    farthest = farthest.max(time.abs_diff(*at));
                }
            }
            farthest_ms = Some(farthest as f64 / 1e6);
            count = Some(chosen.iter().flatten().count());
            self.frames_of.insert(id, frames_of);
        }
        let period = aligned.period();
        self.channels.push(ImportedChannel {
            topic: topic.clone(),
            messages: used.stamps.len(),
            rate_hz: if period > 0 { 1e9 / period as f64 } else { 0.0 },
            offset_ms: aligned.shift as f64 / 1e6,
            farthest_ms,
            frames: count,
        });
        Ok(())
    }

    /// Notes the parts that this log lacks.
    fn missing(&mut self, mapping: &Mapping, survey: &Survey) {
        let has = |image| survey.channel_of(Role::Image(image)).is_some();
        for (k, CameraMapping { name, .. }) in mapping.cameras.iter().enumerate() {
            if survey.channel_of(Role::Depth(k)).is_none() {
                self.notes.push(format!("camera {name} has no depth: all of it counts as not measured"));
            }
            if !has(LogImage::Colours(k)) {
                self.notes.push(format!("camera {name} has no colours: pictures of it stay empty"));
            }
            if !has(LogImage::Labels(k)) {
                self.notes.push(format!("camera {name} has no labels: `run` labels its pixels itself"));
            }
        }
        for finger in Finger::ALL {
            if !has(LogImage::Touch(finger)) {
                self.notes.push(format!("finger {} has no touch images: it is used without touch", finger.name()));
            }
        }
        let truth = [LogImage::TouchDepth, LogImage::Contact];
        if Finger::ALL.into_iter().any(|finger| truth.iter().any(|of| !has(of(finger)))) {
            self.notes.push("there is no true touch depth: use --touch-depth network, the default".to_owned());
        }
        self.notes.push("untouched images of the DIGITs are estimated as the median of their images".to_owned());
        let unknown = self.object_poses.iter().filter(|pose| pose.is_none()).count();
        if unknown > 0 {
            let of = self.object_poses.len();
            self.notes.push(format!(
                "the true pose of the object is unknown in {unknown} of {of} frames: they have no scores"
            ));
        }
        for camera in (0..mapping.cameras.len()).filter_map(|k| camera_frame(mapping, survey, k)) {
            if survey.moving.contains(&camera) {
                self.notes.push(format!("the frame {camera} moves: its first pose is used throughout"));
            }
        }
    }
}

fn no_frames(mapping: &Mapping) -> String {
    match mapping.cameras.first() {
        Some(camera) => format!("there is no frame: no message of {}, the depth of the first camera", camera.depth),
        None => "there is no sensor: give a mapping that names cameras or touch images (--mapping FILE)".to_owned(),
    }
}

/// Returns the times of a channel on the clock of the frames.
fn in_time(topic: &str, stamps: &Stamps, reference: &Stamps) -> Result<Aligned, String> {
    let aligned = stamps.aligned(reference);
    if aligned.is_sorted() {
        Ok(aligned)
    } else {
        Err(format!("{topic}: its messages are not in the order of time; sort the file with `mcap sort`"))
    }
}

/// Returns a pose in the world of one in the root of the mapping's poses.
pub(crate) fn in_world(mapping: &Mapping, pose: Isometry3<f64>) -> Isometry3<f64> {
    match mapping.hand.base {
        Some(_) => Isometry::<HandBase, World>::untyped(world_from_base()) * pose,
        None => pose,
    }
}

/// Returns the frame of a camera in the transforms.
fn camera_frame(mapping: &Mapping, survey: &Survey, camera: usize) -> Option<String> {
    let given = mapping.cameras.get(camera)?.frame.clone();
    given.or_else(|| Some(survey.model(camera)?.frame.clone()))
}

/// Returns the cameras of the log.
fn cameras(mapping: &Mapping, survey: &Survey, notes: &mut Vec<String>) -> Result<Vec<LogCamera>, Defect> {
    let root = mapping.hand.base.as_ref().unwrap_or(&mapping.hand.world);
    let mut cameras = Vec::new();
    for (k, camera) in mapping.cameras.iter().enumerate() {
        let name = &camera.name;
        let (intrinsics, distortion) = match (camera.intrinsics, survey.model(k)) {
            (Some(given), _) => (given.intrinsics(), None),
            (None, Some(CameraModel { intrinsics, distortion, .. })) => (*intrinsics, *distortion),
            (None, None) => {
                return Err(format!(
                    "camera {name} has no calibration; name a topic in calibration, or give intrinsics"
                )
                .into());
            }
        };
        let pose = match (camera.pose.and_then(PoseMapping::isometry), camera_frame(mapping, survey, k)) {
            (Some(pose), _) => pose,
            (None, Some(frame)) => {
                survey.pose(&frame, root).map_err(|defect| format!("camera {name}: {defect}; give its pose"))?
            }
            (None, None) => return Err(format!("camera {name} has no frame; give frame or pose").into()),
        };
        let pose = Isometry::<Camera, World>::new(in_world(mapping, pose)) * optical();
        if distortion.is_some() {
            notes.push(format!("the lens of camera {name} distorts: readers straighten its images"));
        }
        cameras.push(LogCamera { camera: PosedCamera { name: name.clone(), intrinsics, pose }, distortion });
    }
    Ok(cameras)
}

/// Returns scene.json with the cameras of this log.
fn scene(survey: &Survey, mapping: &Mapping) -> Result<Option<SceneFile>, String> {
    let Some(bytes) = &survey.scene else { return Ok(None) };
    let mut scene: SceneFile =
        serde_json::from_slice(bytes).map_err(|error| format!("{SCENE_FILE} in it is invalid: {error}"))?;
    scene.cameras = mapping.cameras.iter().map(|camera| camera.name.clone()).collect();
    Ok(Some(scene))
}

/// Writes the chosen images in the order in which they come.
fn write_images(
    source: &Path,
    mapping: &Mapping,
    survey: &Survey,
    plan: &Plan,
    writer: &mut LogAssembler,
    progress: &mut impl FnMut(usize, usize),
) -> Result<(), Defect> {
    let frames = plan.joints.len();
    let sizes: Vec<usize> = mapping.cameras.iter().enumerate().map(|(k, camera)| pixels(camera, survey, k)).collect();
    let mut missing = Missing { pushed: vec![0; sizes.len()], sizes };
    let mut seen: HashMap<u16, usize> = HashMap::new();
    scan(source, &mut |record| -> Result<bool, Defect> {
        match record {
            Record::Channel(id, _) => Ok(plan.frames_of.contains_key(&id)),
            Record::Attachment(..) => Ok(true),
            Record::Message(id, _, data) => {
                let number = seen.entry(id).or_default();
                let frame = plan.frames_of.get(&id).and_then(|frames_of| frames_of.get(*number).copied().flatten());
                *number += 1;
                let (Some(frame), Some(used)) = (frame, survey.channels.get(&id)) else { return Ok(true) };
                let topic = &used.record.topic;
                let named = |defect: String| Defect::Words(format!("{topic}: frame {frame}: {defect}"));
                let (_, decoded) = decode(&used.record.schema, data).map_err(named)?;
                let Decoded::Image(picture) = decoded else { return Ok(true) };
                match used.role {
                    Role::Depth(k) => {
                        let Some(camera) = mapping.cameras.get(k) else { return Ok(true) };
                        missing.until(k, frame, writer)?;
                        let depth_m = depth_of(&picture, camera.depth_unit_m, missing.size(k)).map_err(named)?;
                        writer.push_depth(k, &depth_m)?;
                        missing.pushed(k);
                        if k == 0 {
                            progress(frame + 1, frames);
                        }
                    }
                    Role::Image(image) => {
                        let turn = match image {
                            LogImage::Touch(finger) => mapping.touch.of(finger),
                            _ => None,
                        };
                        let file = file_of(&picture, image, turn).map_err(named)?;
                        writer.image(image, frame, &file, Path::new(topic))?;
                    }
                    _ => {}
                }
                Ok(true)
            }
        }
    })?;
    (0..mapping.cameras.len()).try_for_each(|k| missing.until(k, frames, writer))
}

/// Pixels of a camera.
fn pixels(camera: &CameraMapping, survey: &Survey, number: usize) -> usize {
    let model = survey.model(number).map(|model| model.intrinsics);
    let intrinsics = camera.intrinsics.map(PinholeMapping::intrinsics).or(model);
    intrinsics.map_or(0, |intrinsics| intrinsics.width * intrinsics.height)
}

/// Frames in which a camera has no depth.
struct Missing {
    /// Depth images of each camera that are written.
    pushed: Vec<usize>,
    sizes: Vec<usize>,
}

impl Missing {
    fn size(&self, camera: usize) -> usize {
        self.sizes.get(camera).copied().unwrap_or_default()
    }

    fn pushed(&mut self, camera: usize) {
        if let Some(count) = self.pushed.get_mut(camera) {
            *count += 1;
        }
    }

    /// Writes empty depths up to a frame.
    fn until(&mut self, camera: usize, frame: usize, writer: &mut LogAssembler) -> Result<(), Defect> {
        while self.pushed.get(camera).is_some_and(|&count| count < frame) {
            writer.push_depth(camera, &vec![0.0; self.size(camera)])?;
            self.pushed(camera);
        }
        Ok(())
    }
}
