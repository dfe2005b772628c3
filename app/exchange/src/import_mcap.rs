//! An MCAP file as a log.

use std::collections::HashMap;
use std::fmt;
use std::path::Path;
use std::sync::Arc;

use mvt_bag::mcap::{McapRecord, scan};
use mvt_feelsight::hand::world_from_base;
use mvt_feelsight::{LogAssembler, LogCamera, LogImage, SCENE_FILE, SceneFile, Timeline};
use mvt_frames::camera::PosedCamera;
use mvt_frames::{Camera, HandBase, Isometry, Object, World};
use mvt_robot::hand::{Hand, JointAngles};
use nalgebra::Isometry3;
use serde::Serialize;

use crate::clock::{Aligned, Judged, Stamps, nearest, number_at, period, pose_at, reach};
use crate::error::{Defect, ExchangeError};
use crate::foxglove::optical;
use crate::joints::beyond_range;
use crate::mapping::{CameraMapping, Mapping, PinholeMapping, PoseMapping};
use crate::messages::{Decoded, decode};
use crate::pictures::{depth_of, file_of, touch_size};
use crate::plausibility::DepthCheck;
use crate::record::{agrees, put};
use crate::skips::Skips;
use crate::survey::{CameraModel, Role, Survey, Used, survey, topics};

/// Shortest time between two frames, nanoseconds: no camera is as fast.
const SHORTEST_NS: i64 = 500_000;
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
/// The frames are the depth images of the first camera; without cameras, the images of the first touch sensor. Each frame takes the nearest image of
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
    // Why: notes/decisions/exchange.md, "A file is read more than once, record by record".
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
    let cameras = cameras(&mapping, &survey, &mut plan.notes)?;
    let distances: Vec<f64> = cameras.iter().map(|camera| distance_m(&camera.camera, &mapping.hand.hand())).collect();
    let hand = scene.as_ref().map_or_else(|| mapping.hand(), |scene| Arc::clone(&scene.hand));
    let mut writer = LogAssembler::create(out, hand, cameras)?;
    let mut images = Images::new(&mapping, &survey, &plan);
    images.write(source, &mut writer, progress)?;
    let Images { checks, skips, .. } = images;
    for (k, (camera, check)) in mapping.cameras.iter().zip(checks).enumerate() {
        if survey.of_role(Role::Depth(k)).is_some() {
            plan.notes.extend(check.verdict(&camera.name, distances.get(k).copied().unwrap_or_default())?);
        }
    }
    plan.notes.splice(0..0, survey.notes.iter().cloned().chain(survey.skips.notes()).chain(skips.notes()));
    let object_name = match (&mapping.object.name, &scene) {
        (Some(name), _) => name.clone(),
        (None, Some(scene)) => scene.object.name.clone(),
        (None, None) => "object".to_owned(),
    };
    let Plan { times_s, joints, object_poses, channels, notes, .. } = plan;
    let frames = times_s.len();
    let names = mapping.cameras.iter().map(|camera| camera.name.as_str());
    let record = survey.record.filter(|record| agrees(record, &times_s, &joints, names));
    writer.finish(Timeline { object_name, times_s, joints, object_poses, scene, live: None })?;
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
    /// Frame of each message of a topic with images, by the topic's place and the message's number.
    frames_of: HashMap<usize, Vec<Option<usize>>>,
    channels: Vec<ImportedChannel>,
    notes: Vec<String>,
}

fn is_image(role: Role) -> bool {
    matches!(role, Role::Image(_) | Role::Depth(_))
}

/// The frames before their messages are chosen, nanoseconds.
struct Frames {
    clock: Judged,
    times: Vec<i64>,
    period: i64,
}

impl Plan {
    fn new(mapping: &Mapping, survey: &Survey) -> Result<Self, Defect> {
        let used = |role| survey.of_role(role);
        let hand = mapping.hand.hand();
        let touch = || (0..hand.pads().len()).find_map(|pad| used(Role::Image(LogImage::Touch(pad))));
        let first = if mapping.cameras.is_empty() { touch() } else { used(Role::Depth(0)) };
        let first = first.ok_or_else(|| no_frames(mapping))?;
        let joints = used(Role::Joints).ok_or_else(|| {
            format!("there are no joint angles: no message of {}; name a topic in hand.joints", mapping.hand.joints)
        })?;
        let mut plan = Self {
            times_s: Vec::new(),
            joints: Vec::new(),
            object_poses: Vec::new(),
            frames_of: HashMap::new(),
            channels: Vec::new(),
            notes: Vec::new(),
        };
        let mut frames = plan.frames(first)?;
        plan.angles(&mut frames, joints, survey, hand.joints().len())?;
        plan.notes.extend(beyond_range(&plan.joints, &hand, mapping.hand.names()));
        plan.object(&frames, mapping, survey)?;
        for (place, used) in survey.used.iter().enumerate() {
            plan.channel(place, used, &frames)?;
        }
        plan.missing(mapping, survey);
        let frames = frames.times;
        let zero = frames.first().copied().filter(|first| *first >= CALENDAR_NS).unwrap_or_default();
        plan.times_s = frames.iter().map(|&at| (at - zero) as f64 / 1e9).collect();
        Ok(plan)
    }

    /// Returns the frames: the messages of the first sensor.
    fn frames(&mut self, first: &Used) -> Result<Frames, Defect> {
        let topic = &first.topic;
        let clock = judge(topic, &first.stamps)?;
        let mut times = clock.aligned(&clock).times;
        let all = times.len();
        times.dedup();
        let left_out = all - times.len();
        if left_out > 0 {
            self.notes.push(format!(
                "{left_out} of {all} images of {topic} are left out: they repeat the time of another one"
            ));
        }
        let period = period(&times);
        if times.len() > 2 && period < SHORTEST_NS {
            let words = format!("{topic}: {period} ns lie between two images; times must be in nanoseconds");
            return Err(words.into());
        }
        Ok(Frames { clock, times, period })
    }

    /// Interpolates the joint angles at the frames, and leaves out frames without.
    fn angles(&mut self, frames: &mut Frames, joints: &Used, survey: &Survey, count: usize) -> Result<(), Defect> {
        let aligned = judge(&joints.topic, &joints.stamps)?.aligned(&frames.clock);
        // Each joint has its own readings, which may come in several messages.
        let readings = |joint: usize| -> (Vec<i64>, Vec<f64>) {
            let rows = aligned.order.iter().zip(&aligned.times);
            let reading = |(row, time): (&usize, &i64)| {
                let angle = survey.joints.rows.get(*row)?.get(joint)?;
                (!angle.is_nan()).then_some((*time, *angle))
            };
            rows.filter_map(reading).unzip()
        };
        let readings: Vec<_> = (0..count).map(readings).collect();
        let all = frames.times.len();
        frames.times.retain(|&at| {
            let angle = |(times, values): &(Vec<i64>, Vec<f64>)| {
                number_at(times, values, at, reach(frames.period, period(times)))
            };
            let angles = readings.iter().map(angle).collect::<Option<JointAngles>>();
            let is_known = angles.is_some();
            self.joints.extend(angles);
            is_known
        });
        let left = frames.times.len();
        if left == 0 {
            return Err("no frame is near a message of the joint angles; their clocks differ".to_owned().into());
        }
        if left < all {
            self.notes.push(format!("{} of {all} frames are left out: they are far from all joint angles", all - left));
        }
        Ok(())
    }

    /// Interpolates the object's pose at the frames.
    fn object(&mut self, frames: &Frames, mapping: &Mapping, survey: &Survey) -> Result<(), Defect> {
        let (poses, moving) = survey.object_poses(root(mapping))?;
        self.notes.extend(moving.iter().map(|frame| moves(frame)));
        let object = judge("the object's pose", &survey.object_stamps)?.aligned(&frames.clock);
        if object.out_of_order > 0 {
            self.notes.push(format!(
                "the object's pose: {} of {} transforms are not in the order of time: all are sorted",
                object.out_of_order,
                poses.len()
            ));
        }
        let poses: Vec<_> = object.order.iter().filter_map(|&place| poses.get(place).copied()).collect();
        let reach = reach(frames.period, object.period());
        let pose = |&at: &i64| Some(Isometry::new(in_world(mapping, pose_at(&object.times, &poses, at, reach)?)));
        self.object_poses = frames.times.iter().map(pose).collect();
        Ok(())
    }

    /// Chooses the messages of a topic.
    fn channel(&mut self, place: usize, used: &Used, frames: &Frames) -> Result<(), String> {
        let topic = &used.topic;
        // Transforms of several senders have several clocks, and one pose of each frame is used.
        let is_timed = is_image(used.role) || used.role == Role::Joints;
        let aligned = match judge(topic, &used.stamps) {
            Ok(judged) => {
                self.notes.extend(judged.note.as_ref().filter(|_| is_timed).map(|note| format!("{topic}: {note}")));
                judged.aligned(&frames.clock)
            }
            Err(defect) if is_timed => return Err(defect),
            Err(_) => Aligned::default(),
        };
        if aligned.out_of_order > 0 && is_timed {
            self.notes.push(format!(
                "{topic}: {} of {} messages are not in the order of time: all are sorted",
                aligned.out_of_order,
                used.stamps.len()
            ));
        }
        let (mut farthest_ms, mut count) = (None, None);
        if is_image(used.role) {
            let chosen = nearest(&frames.times, &aligned.times, reach(frames.period, aligned.period()));
            let mut frames_of = vec![None; used.messages];
            let mut farthest = 0;
            for (frame, message) in chosen.iter().enumerate() {
                let Some(message) = *message else { continue };
                let number = aligned.order.get(message).and_then(|&number| used.numbers.get(number));
                if let (Some(number), Some(time), Some(at)) =
                    (number, aligned.times.get(message), frames.times.get(frame))
                {
                    if let Some(place) = frames_of.get_mut(*number) {
                        *place = Some(frame);
                    }
                    farthest = farthest.max(time.abs_diff(*at));
                }
            }
            let found = chosen.iter().flatten().count();
            if found * 2 < chosen.len() {
                self.notes.push(format!("only {found} of {} frames have an image of {topic}", chosen.len()));
            }
            farthest_ms = Some(farthest as f64 / 1e6);
            count = Some(found);
            self.frames_of.insert(place, frames_of);
        }
        let period = aligned.period();
        self.channels.push(ImportedChannel {
            topic: topic.clone(),
            messages: used.messages,
            rate_hz: if period > 0 { 1e9 / period as f64 } else { 0.0 },
            offset_ms: aligned.shift as f64 / 1e6,
            farthest_ms,
            frames: count,
        });
        Ok(())
    }

    /// Notes the parts that this log lacks.
    fn missing(&mut self, mapping: &Mapping, survey: &Survey) {
        let has = |image| survey.of_role(Role::Image(image)).is_some();
        for (k, CameraMapping { name, .. }) in mapping.cameras.iter().enumerate() {
            if survey.of_role(Role::Depth(k)).is_none() {
                self.notes.push(format!("camera {name} has no depth: all of it counts as not measured"));
            }
            if !has(LogImage::Colours(k)) {
                self.notes.push(format!("camera {name} has no colours: pictures of it stay empty"));
            }
            if !has(LogImage::Labels(k)) {
                self.notes.push(format!("camera {name} has no labels: `run` labels its pixels itself"));
            }
        }
        let hand = mapping.hand.hand();
        for (k, pad) in hand.pads().iter().enumerate() {
            if !has(LogImage::Touch(k)) {
                self.notes.push(format!("pad {} has no touch images: it is used without touch", pad.name));
            }
        }
        let truth = [LogImage::TouchDepth, LogImage::Contact];
        if (0..hand.pads().len()).any(|pad| truth.iter().any(|of| !has(of(pad)))) {
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
    }
}

fn no_frames(mapping: &Mapping) -> String {
    match mapping.cameras.first() {
        Some(camera) => format!("there is no frame: no message of {}, the depth of the first camera", camera.depth),
        None => "there is no sensor: give a mapping that names cameras or touch images (--mapping FILE)".to_owned(),
    }
}

/// Chooses the clock of a topic.
fn judge(topic: &str, stamps: &Stamps) -> Result<Judged, String> {
    stamps.judge().map_err(|defect| format!("{topic}: {defect}"))
}

/// Returns the frame of the mapping's poses.
fn root(mapping: &Mapping) -> &str {
    mapping.hand.base.as_ref().unwrap_or(&mapping.hand.world)
}

fn moves(frame: &str) -> String {
    format!("the frame {frame} moves: its first pose is used throughout")
}

/// Returns the distance of a camera from the hand's base, metres.
pub(crate) fn distance_m(camera: &PosedCamera, hand: &Hand) -> f64 {
    let base = world_from_base(hand).origin().coords();
    (camera.pose.origin().coords() - base).norm()
}

/// Returns a pose in the world of one in the root of the mapping's poses.
pub(crate) fn in_world(mapping: &Mapping, pose: Isometry3<f64>) -> Isometry3<f64> {
    match mapping.hand.base {
        Some(_) => Isometry::<HandBase, World>::untyped(world_from_base(&mapping.hand.hand())) * pose,
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
    let mut cameras = Vec::new();
    for (k, camera) in mapping.cameras.iter().enumerate() {
        let name = &camera.name;
        let (intrinsics, distortion) = match (camera.intrinsics, survey.model(k)) {
            (Some(given), _) => (given.intrinsics(), None),
            (None, Some(CameraModel { intrinsics, distortion, assumed_pinhole, .. })) => {
                if let Some(model) = assumed_pinhole {
                    notes.push(format!("the lens model {model:?} of camera {name} has no numbers: read as a pinhole"));
                }
                (*intrinsics, *distortion)
            }
            (None, None) => {
                let topic = camera.calibration.as_deref().unwrap_or_default();
                let why = match survey.skips.first(topic) {
                    Some(first) => format!("no message of {topic} is a calibration, first {first}; give intrinsics"),
                    None => "name a topic in calibration, or give intrinsics".to_owned(),
                };
                return Err(format!("camera {name} has no calibration: {why}").into());
            }
        };
        let pose = match (camera.pose.and_then(PoseMapping::isometry), camera_frame(mapping, survey, k)) {
            (Some(pose), _) => pose,
            (None, Some(frame)) => {
                let path = survey.tree.path(&frame, root(mapping));
                let path = path.map_err(|defect| format!("camera {name}: {defect}; give its pose"))?;
                notes.extend(path.moving.iter().map(|frame| moves(frame)));
                path.pose
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

/// The images of a file on their way into the log.
struct Images<'a> {
    mapping: &'a Mapping,
    survey: &'a Survey,
    plan: &'a Plan,
    /// Width and height of the cameras.
    sizes: Vec<(usize, usize)>,
    checks: Vec<DepthCheck>,
    skips: Skips,
}

impl<'a> Images<'a> {
    fn new(mapping: &'a Mapping, survey: &'a Survey, plan: &'a Plan) -> Self {
        let sizes = mapping.cameras.iter().enumerate().map(|(k, camera)| size(camera, survey, k)).collect();
        let checks = mapping.cameras.iter().map(|_| DepthCheck::default()).collect();
        Self { mapping, survey, plan, sizes, checks, skips: Skips::default() }
    }

    /// Writes the chosen images in the order in which they come. Those with defects are skipped and counted.
    fn write(
        &mut self,
        source: &Path,
        writer: &mut LogAssembler,
        progress: &mut impl FnMut(usize, usize),
    ) -> Result<(), Defect> {
        let Self { survey, plan, .. } = *self;
        for (camera, frame) in self.without_depth() {
            writer.depth(camera, frame, None)?;
        }
        let mut seen = vec![0; survey.used.len()];
        scan(source, &mut |record| -> Result<bool, Defect> {
            let (id, data) = match record {
                McapRecord::Channel(id, _) => {
                    return Ok(survey.of_channel(id).is_some_and(|(place, _)| plan.frames_of.contains_key(&place)));
                }
                McapRecord::Attachment(..) => return Ok(true),
                McapRecord::Message(id, _, data) => (id, data),
            };
            let Some((place, schema)) = survey.of_channel(id) else { return Ok(true) };
            let (Some(number), Some(used)) = (seen.get_mut(place), survey.used.get(place)) else { return Ok(true) };
            let frame = plan.frames_of.get(&place).and_then(|frames_of| frames_of.get(*number).copied().flatten());
            *number += 1;
            if let Some(frame) = frame {
                self.message(used, schema, frame, data, writer)?;
                if used.role == Role::Depth(0) {
                    progress(frame + 1, plan.joints.len());
                }
            }
            Ok(true)
        })?;
        for (place, frames_of) in &plan.frames_of {
            let Some(Used { topic, .. }) = survey.used.get(*place) else { continue };
            let chosen = frames_of.iter().flatten().count();
            if let Some(first) = self.skips.first(topic).filter(|_| chosen > 0 && self.skips.count(topic) == chosen) {
                return Err(format!("{topic}: none of its {chosen} images can be used; first {first}").into());
            }
        }
        Ok(())
    }

    /// Returns the cameras and frames for which no depth comes.
    fn without_depth(&self) -> Vec<(usize, usize)> {
        let frames = self.plan.joints.len();
        let of_camera = |camera: usize| {
            let mut missing = vec![true; frames];
            let place = self.survey.used.iter().position(|used| used.role == Role::Depth(camera));
            let frames_of = place.and_then(|place| self.plan.frames_of.get(&place));
            for frame in frames_of.into_iter().flatten().flatten() {
                missing.get_mut(*frame).into_iter().for_each(|missing| *missing = false);
            }
            (0..frames).filter(move |frame| missing.get(*frame) == Some(&true)).map(move |frame| (camera, frame))
        };
        (0..self.sizes.len()).flat_map(of_camera).collect()
    }

    /// Writes the image of a frame, or counts it as skipped.
    fn message(
        &mut self,
        used: &Used,
        schema: &str,
        frame: usize,
        data: &[u8],
        writer: &mut LogAssembler,
    ) -> Result<(), Defect> {
        let size = |camera: usize| self.sizes.get(camera).copied().unwrap_or_default();
        let Ok((_, Decoded::Image(picture))) = decode(schema, data) else { return Ok(()) };
        let skipped = match used.role {
            Role::Depth(k) => {
                let unit_m = self.mapping.cameras.get(k).map_or(0.0, |camera| camera.depth_unit_m);
                let depth_m = depth_of(&picture, unit_m, size(k));
                writer.depth(k, frame, depth_m.as_deref().ok())?;
                if let (Ok(depth_m), Some(check)) = (&depth_m, self.checks.get_mut(k)) {
                    check.add(depth_m);
                }
                depth_m.err()
            }
            Role::Image(image) => {
                let turn = match image {
                    LogImage::Touch(pad) => self.mapping.touch(pad),
                    _ => None,
                };
                let size = match image {
                    LogImage::Colours(k) | LogImage::Labels(k) => size(k),
                    LogImage::Touch(pad) | LogImage::TouchDepth(pad) | LogImage::Contact(pad) => {
                        touch_size(writer.hand(), pad)
                    }
                };
                match file_of(&picture, image, turn, size) {
                    Ok(file) => {
                        writer.image(image, frame, &file, Path::new(&used.topic))?;
                        None
                    }
                    Err(defect) => Some(defect),
                }
            }
            _ => None,
        };
        if let Some(defect) = skipped {
            self.skips.add(&used.topic, format!("frame {frame}"), defect);
        }
        Ok(())
    }
}

/// Returns width and height of a camera.
fn size(camera: &CameraMapping, survey: &Survey, number: usize) -> (usize, usize) {
    let model = survey.model(number).map(|model| model.intrinsics);
    let intrinsics = camera.intrinsics.map(PinholeMapping::intrinsics).or(model);
    intrinsics.map_or((0, 0), |intrinsics| (intrinsics.width, intrinsics.height))
}

#[cfg(test)]
mod tests;
