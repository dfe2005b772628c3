//! A live connection as a source of frames.

use std::collections::{BTreeSet, VecDeque};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, anyhow, bail};
use mvt_bag::{RosCamera, RosPose};
use mvt_calibration::Calibration;
use mvt_frames::camera::PosedCamera;
use mvt_frames::{Camera, Isometry, Object, World};
use mvt_gaits::directive::Directive;
use mvt_gaits::feedback::EstimatedPlace;
use mvt_perceive::{Perception, PerceptionSetup, Seen};
use mvt_robot::hand::Hand;
use mvt_run::report::{LiveRecord, SharedLiveRecord};
use mvt_run::source::{Pictures, Sensed, Source};

use crate::bus::Bus;
use crate::clock::LiveClock;
use crate::driver::Driver;
use crate::feed::Feed;
use crate::observer::Observer;
use crate::pairing::{FramePart, PairedFrame, SILENCE_NS};
use crate::recorder::LiveRecorder;
use crate::setup::RosSetup;

/// How long a call waits before it looks whether the run shall end.
const WAIT: Duration = Duration::from_millis(50);
/// Frames whose stamps are kept for the publisher: more than the pipeline holds.
const STAMPS: usize = 16;

/// Where published poses belong: the stamp of each frame, and the motion to the coordinates in which they are published.
#[derive(Debug, Default)]
pub(crate) struct LivePlace {
    /// Number and stamp of the newest frames.
    stamps: VecDeque<(u64, i64)>,
    /// Frame of poses.
    pub frame: String,
    /// Takes the coordinates of the world to those of the frame.
    pub frame_from_world: nalgebra::Isometry3<f64>,
}

impl LivePlace {
    fn push(&mut self, number: u64, stamp_ns: i64) {
        if self.stamps.len() == STAMPS {
            self.stamps.pop_front();
        }
        self.stamps.push_back((number, stamp_ns));
    }

    /// Returns the stamp of a frame, nanoseconds.
    pub fn stamp_ns(&self, number: u64) -> Option<i64> {
        self.stamps.iter().find(|(of, _)| *of == number).map(|(_, stamp_ns)| *stamp_ns)
    }
}

/// State that source and publisher share.
#[derive(Default)]
pub(crate) struct Link {
    place: Mutex<LivePlace>,
    pub record: SharedLiveRecord,
    pub clock: Arc<LiveClock>,
    /// Moves the hand; `None` if nothing is sent.
    pub driver: OnceLock<Driver>,
}

impl Link {
    /// Starts with nothing, and the clock of the computer or of a simulator.
    pub fn new(is_simulated: bool) -> Self {
        Self { clock: Arc::new(LiveClock::new(is_simulated)), ..Self::default() }
    }

    pub fn place(&self) -> MutexGuard<'_, LivePlace> {
        self.place.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn record(&self) -> MutexGuard<'_, LiveRecord> {
        self.record.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// How a live source is used.
pub struct LiveOptions<'a> {
    /// The hand; [`Hand::none`] without one.
    pub hand: Arc<Hand>,
    /// Where the camera stands in the rig, if there is one.
    pub camera: Option<PosedCamera>,
    /// Networks and settings.
    pub perception: PerceptionSetup<'a>,
    /// Longest duration, seconds.
    pub duration_s: Option<f64>,
    /// Ends the source when it is set.
    pub stop: Arc<AtomicBool>,
    /// Folder of the log that is recorded meanwhile, and the object's name in it.
    pub record: Option<(&'a Path, &'a str)>,
}

/// Topics of ROS 2 as a source: the newest frame is delivered, and what is late is dropped and counted.
pub struct RosSource {
    feed: Feed,
    observer: Observer,
    recorder: Option<LiveRecorder>,
    perception: Perception,
    hand: Arc<Hand>,
    camera: PosedCamera,
    link: Arc<Link>,
    world_frame: Option<String>,
    duration_s: Option<f64>,
    stop: Arc<AtomicBool>,
    frames: u64,
    /// When the newest frame was delivered, or the source was opened.
    newest: Instant,
    first: Option<Instant>,
    is_silent: bool,
    /// A directive ended the run.
    is_stopped: bool,
    told: BTreeSet<String>,
    reason: &'static str,
}

impl RosSource {
    /// Subscribes, and waits until the camera model and a depth image have arrived.
    ///
    /// # Errors
    /// If the network cannot be used, the camera is not calibrated, or `stop` is set before.
    pub(crate) fn open(
        bus: Arc<Bus>,
        setup: &RosSetup,
        file: &Path,
        options: LiveOptions<'_>,
        link: Arc<Link>,
    ) -> Result<Self> {
        let LiveOptions { hand, camera, perception, duration_s, stop, record } = options;
        let pads: Vec<String> = hand.pads().iter().map(|pad| pad.name.clone()).collect();
        if let Some((key, pad)) = setup.touch_pads().find(|(_, pad)| !pads.contains(*pad)) {
            bail!("{}: {key}.{pad} is no pad of {}; its pads are {}", file.display(), hand.name(), pads.join(", "));
        }
        if let Some(joint) = setup.joint_names.keys().find(|joint| hand.joints().iter().all(|of| of.name != **joint)) {
            bail!(
                "{}: joint_names.{joint} is no joint of {}; `mambavitact hand check` lists them",
                file.display(),
                hand.name()
            );
        }
        if let Some(note) = Bus::buffer_note() {
            tracing::warn!("{note}");
        }
        let feed = Feed::start(bus, Arc::clone(&link.clock), setup, hand.pads())?;
        let (info, depth_frame) = loop {
            if stop.load(Ordering::Relaxed) {
                bail!(
                    "no camera model and depth image arrived before the end: `mambavitact ros topics` lists what is there"
                );
            }
            if let Some(known) = feed.camera_info().zip(feed.depth_frame()) {
                break known;
            }
            std::thread::sleep(WAIT / 10);
        };
        let observer = Observer::new(setup, Arc::clone(&hand), info, feed.numbers.clone(), &file.display().to_string())
            .map_err(|fault| anyhow!("{fault}"))?;
        let intrinsics = observer.lens().intrinsics;
        let camera = match camera {
            Some(camera) => PosedCamera { intrinsics, ..camera },
            None => PosedCamera { name: "camera".to_owned(), intrinsics, pose: Isometry::identity() },
        };
        let unit_m = setup.depth_unit_m.unwrap_or(RosCamera::UNIT_M);
        let recorder = record
            .map(|(folder, object)| LiveRecorder::create(folder, &hand, &camera, object, unit_m))
            .transpose()
            .context("--record")?;
        let perception = Perception::new(Arc::clone(&hand), vec![camera.clone()], &perception);
        let is_in_camera = hand.is_none() && setup.world_frame.is_none();
        let optical = RosCamera::optical_from_camera();
        let own = if is_in_camera { depth_frame } else { "world".to_owned() };
        let frame = setup.publish.frame.clone().or_else(|| setup.world_frame.clone()).unwrap_or(own);
        *link.place() = LivePlace {
            stamps: VecDeque::new(),
            frame,
            frame_from_world: if is_in_camera { optical } else { nalgebra::Isometry3::identity() },
        };
        Ok(Self {
            feed,
            observer,
            recorder,
            perception,
            hand,
            camera,
            link,
            world_frame: setup.world_frame.clone(),
            duration_s,
            stop,
            frames: 0,
            newest: Instant::now(),
            first: None,
            is_silent: false,
            is_stopped: false,
            told: BTreeSet::new(),
            reason: "",
        })
    }

    /// The camera, as it stands in the rig.
    pub fn camera(&self) -> &PosedCamera {
        &self.camera
    }

    /// Starts from a calibration that was measured before.
    ///
    /// # Errors
    /// If a number of it is invalid.
    pub fn start_from(&mut self, calibration: &Calibration) -> Result<()> {
        Ok(self.perception.start_from(calibration)?)
    }

    fn warn(&mut self, topic: &str, text: &str) {
        // Numbers in a text differ from frame to frame.
        let kind = text.split(|c: char| c.is_ascii_digit()).next().unwrap_or_default();
        if self.told.insert(format!("{topic} {kind}")) {
            tracing::warn!("{topic}: {text}; such frames are left out");
        }
    }

    /// Whether the time is over, also if nothing arrives any more.
    fn is_over(&self) -> bool {
        let after = |first: Instant, seconds: f64| first.elapsed().as_secs_f64() > seconds;
        self.first.zip(self.duration_s).is_some_and(|(first, seconds)| after(first, seconds))
    }

    /// Says once that nothing arrives, and once that it does again.
    fn note_silence(&mut self) {
        let silence = Duration::from_nanos(SILENCE_NS.unsigned_abs());
        if !self.is_silent && self.newest.elapsed() > silence {
            self.is_silent = true;
            let silent = self.feed.silent();
            let which = if silent.is_empty() {
                "all topics deliver, but their stamps are apart by more than slop_s".to_owned()
            } else {
                format!("nothing arrives on {}", silent.join(", "))
            };
            tracing::warn!("no frame for 1 s: {which}");
        }
    }

    fn pose(&self, stamp_ns: i64) -> Result<Option<Isometry<Camera, World>>, String> {
        let Some(world) = &self.world_frame else { return Ok(None) };
        let world_from_optical = self.feed.look_up(world, &self.feed.depth_frame().unwrap_or_default(), stamp_ns)?;
        Ok(Some(Isometry::new(world_from_optical * RosCamera::optical_from_camera())))
    }

    /// Returns the true pose of the object, if it is published.
    fn truth(&self, frame: &PairedFrame<Vec<u8>>) -> Option<Isometry<Object, World>> {
        match frame.parts.get(self.feed.numbers.truth?)? {
            FramePart::One(one) => Some(Isometry::new(RosPose::decode(&one.item).ok()?.pose)),
            _ => None,
        }
    }

    /// Perceives a frame; `None` if it cannot be used.
    fn sensed(&mut self, frame: &PairedFrame<Vec<u8>>) -> Option<Sensed> {
        let begun = Instant::now();
        let depth = self.feed.topics().first().map(|topic| topic.topic.clone()).unwrap_or_default();
        match self.feed.camera_info().map(|info| self.observer.update(info)) {
            Some(Ok(true)) => tracing::warn!("{depth}: its camera model changed; the new one is used"),
            Some(Err(fault)) => {
                self.warn(&depth, &fault);
                return None;
            }
            _ => {}
        }
        let pose = match self.pose(frame.stamp_ns) {
            Ok(pose) => pose,
            Err(fault) => {
                self.warn("/tf", &fault);
                return None;
            }
        };
        let feed = &self.feed;
        let observation = match self.observer.observe(frame, |number| feed.is_compressed(number), pose) {
            Ok(observation) => observation,
            Err((topic, fault)) => {
                self.warn(&topic, &fault);
                return None;
            }
        };
        let recorded = self.recorder.is_some().then(|| observation.clone());
        let Seen { percept, touch_images, warnings } = match self.perception.see(self.frames, observation, None) {
            Ok(seen) => seen,
            Err(fault) => {
                self.warn(&depth, &fault.to_string());
                return None;
            }
        };
        if let Some(driver) = self.link.driver.get() {
            driver.motion().feel(&percept.touch);
        }
        if let (Some(recorder), Some(observation)) = (&mut self.recorder, recorded) {
            recorder.push(frame.stamp_ns, frame.time_ns, observation);
        }
        let number = self.frames;
        self.frames += 1;
        self.link.place().push(number, frame.stamp_ns);
        Some(Sensed {
            frame: number,
            percept,
            truth: self.truth(frame),
            pictures: Pictures { touch: touch_images, ..Pictures::default() },
            sense_ms: begun.elapsed().as_secs_f64() * 1e3,
            hidden: None,
            carried: None,
            warnings,
            events: Vec::new(),
        })
    }

    fn update_record(&self, is_unusable: bool) {
        let (counts, topics) = (self.feed.frames(), self.feed.topics());
        let mut record = self.link.record();
        record.unusable += u64::from(is_unusable);
        (record.frames, record.late, record.unpaired) = (self.frames, counts.late, counts.unpaired);
        record.topics = topics;
        record.log = self.recorder.as_ref().map(LiveRecorder::counts);
    }
}

impl Source for RosSource {
    fn next(&mut self) -> Result<Option<Sensed>> {
        loop {
            let is_over = self.is_over();
            if is_over || self.is_stopped || self.stop.load(Ordering::Relaxed) {
                self.reason = match is_over {
                    true => "the time was over",
                    false if self.is_stopped => "the goal was reached",
                    false => "the connection was ended",
                };
                if let Some(driver) = self.link.driver.get() {
                    driver.motion().end(self.reason);
                }
                if let Some(recorder) = &mut self.recorder {
                    recorder.finish();
                }
                self.update_record(false);
                return Ok(None);
            }
            let Some(frame) = self.feed.next(WAIT) else {
                self.note_silence();
                continue;
            };
            if std::mem::take(&mut self.is_silent) {
                tracing::warn!("frames arrive again");
            }
            self.newest = Instant::now();
            self.first.get_or_insert(self.newest);
            let sensed = self.sensed(&frame);
            self.update_record(sensed.is_none());
            if sensed.is_some() {
                return Ok(sensed);
            }
        }
    }

    fn direct(&mut self, directive: Directive) -> Result<()> {
        self.is_stopped |= directive == Directive::Stop;
        self.link.driver.get().map_or(Ok(()), |driver| driver.motion().direct(&directive)).map_err(|e| anyhow!("{e}"))
    }

    fn needs_place(&self) -> bool {
        self.link.driver.get().is_some_and(|driver| driver.motion().needs_place())
    }

    fn see(&mut self, place: EstimatedPlace) {
        if let Some(driver) = self.link.driver.get() {
            driver.motion().see(place);
        }
    }

    fn hand(&self) -> &Arc<Hand> {
        &self.hand
    }

    fn frame_count(&self) -> usize {
        0
    }

    fn end(&self) -> (String, bool) {
        (self.reason.to_owned(), true)
    }

    fn calibration(&self) -> Option<Calibration> {
        self.perception.calibration()
    }
}
