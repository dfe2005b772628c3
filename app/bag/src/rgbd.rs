//! RGB-D frames of a bag.

use std::collections::BTreeMap;
use std::path::Path;

use image::RgbImage;
use mvt_frames::camera::Intrinsics;
use mvt_frames::{Camera, Isometry, MeshFile, World};
use nalgebra::Isometry3;
use ndarray::Array2;

use crate::bag::{Bag, BagPlace};
use crate::camera::{RosCamera, RosPicture};
use crate::error::{BagError, FILE, RosError};
use crate::lens::RosLens;
use crate::messages::RosCameraInfo;
use crate::survey::{Shot, Shots, Survey, nearest, period_ns};
use crate::topics::{Chosen, IMAGE, RgbdTopics, choose};
use crate::tree::between;

/// Time between frames if there is only one, nanoseconds.
const PERIOD_NS: i64 = 33_000_000;
/// Joints and poses of the object are interpolated over gaps up to this, nanoseconds.
const GAP_NS: i64 = 500_000_000;

/// RGB-D frame of a bag.
#[derive(Debug, Clone)]
pub struct BagFrame {
    /// Stamp of the depth image, nanoseconds; when it was recorded if images state no time.
    pub stamp_ns: i64,
    /// Seconds since the first frame.
    pub time_s: f64,
    /// Colours without distortion, of the size of depth.
    pub color: RgbImage,
    /// Depth along the optical axis without distortion, metres, 0 where nothing was measured.
    pub depth_m: Array2<f32>,
    /// Where the object is visible, of the size of depth; `None` in a frame without a mask.
    pub mask: Option<Array2<bool>>,
    /// Pinhole model of both images.
    pub intrinsics: Intrinsics,
    /// Pose of the camera, if the transforms tell it.
    pub world_from_camera: Option<Isometry<Camera, World>>,
    /// True pose of the object, if a topic states it.
    pub camera_from_object: Option<Isometry<MeshFile, Camera>>,
    /// Positions of the joints at the stamp, radians or metres. Joints without messages around it are absent.
    pub joints: BTreeMap<String, f64>,
}

/// Images of one frame.
#[derive(Debug, Clone, Copy)]
struct Triple {
    time_ns: i64,
    color: BagPlace,
    depth: BagPlace,
    mask: Option<BagPlace>,
}

/// Bag as a sequence of RGB-D frames.
#[derive(Debug)]
pub struct RgbdBag {
    bag: Bag,
    chosen: Chosen,
    stated: RgbdTopics,
    frames: Vec<Triple>,
    survey: Survey,
    camera: RosCamera,
    /// Frames of the world and of the camera, if transforms lead from one to the other.
    ends: Option<[String; 2]>,
}

impl RgbdBag {
    /// Opens a bag; `bag.toml` beside it may name the topics.
    ///
    /// # Errors
    /// [`BagError`] if a file cannot be read, a topic is missing or in doubt, no colours belong to a depth image, or the first frame has a
    /// fault.
    pub fn open(path: &Path) -> Result<Self, BagError> {
        Self::open_with(path, &RgbdTopics::beside(path)?)
    }

    /// Opens a bag with these topics.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_with(path: &Path, topics: &RgbdTopics) -> Result<Self, BagError> {
        let mut bag = Bag::open(path)?;
        let chosen = choose(&mut bag, topics)?;
        let survey = Survey::of(&mut bag, &chosen)?;
        let frames = paired(&mut bag, &survey, topics.slop_s)?;
        let depth_name = topic_name(&bag, chosen.depth);
        let color_name = topic_name(&bag, chosen.color);
        let lens = |info: &Option<RosCameraInfo>, topic: usize, image: &str| {
            let wrong = |reason: String| BagError::fault(path, format!("{}: {reason}", topic_name(&bag, topic)));
            let info = info.as_ref().ok_or_else(|| wrong("none of its messages is a camera model".to_owned()))?;
            RosLens::new(info, RosCamera::is_rectified(image)).map_err(|reason| wrong(reason.to_string()))
        };
        let depth_lens = lens(&survey.camera_info, chosen.camera_info, &depth_name)?;
        let color_lens = chosen.color_info.map(|topic| lens(&survey.color_info, topic, &color_name)).transpose()?;
        let mut camera = RosCamera::new(depth_lens, FILE);
        (camera.color_lens, camera.depth_unit_m, camera.object) = (color_lens, topics.depth_unit_m, topics.object);
        let mut opened = Self { bag, chosen, stated: topics.clone(), frames, survey, camera, ends: None };
        opened.note_registration();
        opened.find_ends();
        opened.frame(0)?;
        Ok(opened)
    }

    fn note_registration(&mut self) {
        let (color, depth) = (&self.survey.color.frame, &self.survey.depth.frame);
        if color != depth && !color.is_empty() && !depth.is_empty() {
            let note = format!(
                "colours are seen from {color} and depth from {depth}: they are taken as registered; record depth aligned to the colours if it is not"
            );
            self.bag.add_note(note);
        }
        if let Some(note) = self.camera.registration_note() {
            self.bag.add_note(note);
        }
    }

    /// Finds the frames between which the pose of the camera is looked up.
    fn find_ends(&mut self) {
        let tree = &self.survey.tree;
        let info_frame = self.survey.camera_info.as_ref().map(|info| info.header.frame.as_str()).unwrap_or_default();
        let camera = match self.survey.depth.frame.as_str() {
            "" => info_frame,
            frame => frame,
        };
        let world = self.stated.world_frame.as_deref().unwrap_or_else(|| tree.root_of(camera));
        if tree.is_empty() || (world == camera && self.stated.world_frame.is_none()) {
            return;
        }
        let ends = [world.to_owned(), camera.to_owned()];
        let failures: Vec<String> =
            self.frames.iter().filter_map(|frame| tree.look_up(world, camera, frame.time_ns).err()).collect();
        if let Some(first) = failures.first() {
            let (count, of) = (failures.len(), self.frames.len());
            self.bag.add_note(format!("the pose of the camera is unknown in {count} of {of} frames: {first}"));
        }
        self.ends = Some(ends);
    }

    /// Returns the bag.
    pub fn bag(&self) -> &Bag {
        &self.bag
    }

    /// Returns the names of the topics of colours, depth, camera model and, if there are some, masks.
    pub fn image_topics(&self) -> (String, String, String, Option<String>) {
        let name = |topic| topic_name(&self.bag, topic);
        let Chosen { color, depth, camera_info, masks, .. } = self.chosen;
        (name(color), name(depth), name(camera_info), masks.map(name))
    }

    /// Returns the number of frames.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Returns whether there are no frames: never, because such a bag is refused.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Returns notes on assumptions and omissions, in sentences.
    pub fn notes(&self) -> &[String] {
        self.bag.notes()
    }

    /// Returns the times of the frames, seconds since the first, rising.
    pub fn times_s(&self) -> impl Iterator<Item = f64> {
        let first = self.frames.first().map_or(0, |frame| frame.time_ns);
        self.frames.iter().map(move |frame| frame.time_ns.saturating_sub(first) as f64 * 1e-9)
    }

    /// Returns the stamps of the frames, nanoseconds, rising.
    pub fn stamps_ns(&self) -> impl Iterator<Item = i64> {
        self.frames.iter().map(|frame| frame.time_ns)
    }

    /// Returns which frames have a mask.
    pub fn has_mask(&self) -> impl Iterator<Item = bool> {
        self.frames.iter().map(|frame| frame.mask.is_some())
    }

    /// Returns the pinhole model of all frames.
    pub fn intrinsics(&self) -> Intrinsics {
        self.camera.lens.intrinsics
    }

    /// Returns the transforms of the bag.
    pub fn transforms(&self) -> &crate::TransformTree {
        &self.survey.tree
    }

    /// Returns the names of the joints.
    pub fn joint_names(&self) -> impl Iterator<Item = &str> {
        self.survey.joints.keys().map(String::as_str)
    }

    /// Returns the poses of the camera in the frames, where the transforms tell them.
    pub fn camera_poses(&self) -> impl Iterator<Item = Option<Isometry<Camera, World>>> {
        self.frames.iter().map(|frame| self.camera_pose(frame.time_ns))
    }

    /// Returns the true poses of the object in the frames, where a topic states them.
    pub fn object_poses(&self) -> impl Iterator<Item = Option<Isometry<MeshFile, Camera>>> {
        self.frames.iter().map(|frame| self.object_pose(frame.time_ns))
    }

    fn camera_pose(&self, time_ns: i64) -> Option<Isometry<Camera, World>> {
        let [world, camera] = self.ends.as_ref()?;
        let world_from_optical = self.survey.tree.look_up(world, camera, time_ns).ok()?;
        Some(Isometry::new(world_from_optical * RosCamera::optical_from_camera()))
    }

    fn object_pose(&self, time_ns: i64) -> Option<Isometry<MeshFile, Camera>> {
        let pose = self.survey.object.at(time_ns, GAP_NS, between)?;
        let (frame, camera) = (&self.survey.object_frame, &self.survey.depth.frame);
        let optical_from_frame = if frame == camera || frame.is_empty() {
            Isometry3::identity()
        } else {
            self.survey.tree.look_up(camera, frame, time_ns).ok()?
        };
        Some(Isometry::new(RosCamera::optical_from_camera() * optical_from_frame * pose))
    }

    fn joints(&self, time_ns: i64) -> BTreeMap<String, f64> {
        let line = |a: &f64, b: &f64, part: f64| a + part * (b - a);
        let at =
            |(name, track): (&String, &crate::tree::Track<f64>)| Some((name.clone(), track.at(time_ns, GAP_NS, line)?));
        self.survey.joints.iter().filter_map(at).collect()
    }

    /// Returns the frames from the first to the last.
    pub fn frames(&mut self) -> impl Iterator<Item = Result<BagFrame, BagError>> {
        (0..self.len()).map(|k| self.frame(k))
    }

    /// Reads a frame. Frames are read fastest in their order.
    ///
    /// # Errors
    /// [`BagError`] if there is no such frame, or one of its images is damaged or of another size than the camera model.
    pub fn frame(&mut self, k: usize) -> Result<BagFrame, BagError> {
        let Some(frame) = self.frames.get(k).copied() else {
            return Err(BagError::fault(self.bag.path(), format!("there is no frame {k}; there are {}", self.len())));
        };
        let depth_m = self.depth(frame.depth)?;
        let color = self.colours(frame.color)?;
        let mask = match (frame.mask, self.chosen.masks) {
            (Some(place), Some(topic)) => Some(self.mask(place, topic)?),
            _ => None,
        };
        let first_ns = self.frames.first().map_or(0, |frame| frame.time_ns);
        Ok(BagFrame {
            stamp_ns: frame.time_ns,
            time_s: frame.time_ns.saturating_sub(first_ns) as f64 * 1e-9,
            color,
            depth_m,
            mask,
            intrinsics: self.camera.lens.intrinsics,
            world_from_camera: self.camera_pose(frame.time_ns),
            camera_from_object: self.object_pose(frame.time_ns),
            joints: self.joints(frame.time_ns),
        })
    }

    /// Reads the image of a topic and converts it; `convert` also receives the name of the topic.
    fn image<T>(
        &mut self,
        place: BagPlace,
        topic: usize,
        convert: impl FnOnce(&mut RosCamera, &RosPicture<'_>, &str) -> Result<T, RosError>,
    ) -> Result<T, BagError> {
        let data = self.bag.read(place)?;
        let is_compressed = self.bag.topics().get(topic).is_some_and(|topic| topic.type_name != IMAGE);
        let name = topic_name(&self.bag, topic);
        let image = RosPicture::decode(&data, is_compressed);
        let converted = image.and_then(|image| convert(&mut self.camera, &image, &name));
        converted.map_err(|reason| self.wrong(topic, place, reason))
    }

    /// Returns a fault of an image.
    fn wrong(&self, topic: usize, place: BagPlace, reason: RosError) -> BagError {
        let path = self.bag.path().to_owned();
        BagError::Message { path, topic: topic_name(&self.bag, topic), log_ns: place.log_ns(), reason }
    }

    fn depth(&mut self, place: BagPlace) -> Result<Array2<f32>, BagError> {
        self.image(place, self.chosen.depth, |camera, image, _| camera.depth_m(image))
    }

    fn colours(&mut self, place: BagPlace) -> Result<RgbImage, BagError> {
        self.image(place, self.chosen.color, RosCamera::colours)
    }

    fn mask(&mut self, place: BagPlace, topic: usize) -> Result<Array2<bool>, BagError> {
        self.image(place, topic, RosCamera::mask)
    }

    /// Returns a mask that was drawn on a colour image of the bag without the distortion of the lens and in the size of depth, as that of a frame;
    /// `None` if it has another shape than depth.
    pub fn mask_over_depth(&mut self, drawn: Array2<bool>) -> Option<Array2<bool>> {
        self.camera.drawn_mask(drawn, &topic_name(&self.bag, self.chosen.color))
    }
}

fn topic_name(bag: &Bag, topic: usize) -> String {
    bag.topics().get(topic).map(|topic| topic.name.clone()).unwrap_or_default()
}

/// Pairs images by their stamps. Adds notes to the bag.
fn paired(bag: &mut Bag, survey: &Survey, slop_s: Option<f64>) -> Result<Vec<Triple>, BagError> {
    let all: [(&str, &Shots); 3] = [("colours", &survey.color), ("depth", &survey.depth), ("masks", &survey.masks)];
    let by_log = all.iter().find(|(_, shots)| shots.lack_stamps());
    if let Some((what, _)) = by_log {
        bag.add_note(format!("the images of {what} state no time: the times of recording are used"));
    }
    let [color, depth, masks] = all.map(|(what, shots)| {
        let (shots, left_out) = shots.in_time(by_log.is_some());
        if left_out > 0 {
            bag.add_note(format!("{left_out} images of {what} that are not newer than the one before are left out"));
        }
        shots
    });
    let period = [&color, &depth].into_iter().filter_map(|shots| period_ns(shots)).min().unwrap_or(PERIOD_NS);
    let slop_ns = slop_s.map_or(period / 2, |slop_s| (slop_s * 1e9) as i64).unsigned_abs();
    let near = |shots: &[Shot], time_ns: i64| {
        nearest(shots, time_ns)
            .filter(|at| shots.get(*at).is_some_and(|shot| shot.time_ns.abs_diff(time_ns) <= slop_ns))
    };
    let mut frames = Vec::new();
    let mut unused = 0;
    for shot in &depth {
        let at = near(&color, shot.time_ns).filter(|at| *at >= unused);
        let Some((at, colours)) = at.and_then(|at| Some((at, color.get(at)?))) else { continue };
        unused = at + 1;
        let mask = near(&masks, colours.time_ns).and_then(|at| masks.get(at)).map(|mask| mask.place);
        frames.push(Triple { time_ns: shot.time_ns, color: colours.place, depth: shot.place, mask });
    }
    let slop_ms = slop_ns as f64 * 1e-6;
    if frames.is_empty() {
        let apart = |shot: &Shot| Some(color.get(nearest(&color, shot.time_ns)?)?.time_ns.abs_diff(shot.time_ns));
        let fault = match depth.iter().filter_map(apart).min() {
            Some(least) => format!(
                "no colour image lies within {slop_ms:.1} ms of a depth image; the nearest is {:.1} ms away: set slop_s in bag.toml, or the clocks of the cameras",
                least as f64 * 1e-6
            ),
            None => "there are no colour images, or no depth images, that can be used".to_owned(),
        };
        return Err(BagError::fault(bag.path(), fault));
    }
    if frames.len() < depth.len() {
        let (count, of) = (frames.len(), depth.len());
        bag.add_note(format!(
            "{count} of {of} depth images have colours within {slop_ms:.1} ms; the others are left out"
        ));
    }
    let masked = frames.iter().filter(|frame| frame.mask.is_some()).count();
    if masked < frames.len() && !masks.is_empty() {
        bag.add_note(format!("{masked} of {} frames have a mask within {slop_ms:.1} ms", frames.len()));
    }
    Ok(frames)
}
