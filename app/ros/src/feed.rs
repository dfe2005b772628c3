//! The thread that receives: it opens subscriptions as their topics appear, and keeps the newest messages of each.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use mvt_bag::{CdrReader, RosCameraInfo, RosHeader, RosTransform, TransformTree};
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::TouchPad;
use mvt_run::report::LiveTopicRecord;

use crate::bus::{Bus, Delivery, Inlet, LiveTopic, Waiter};
use crate::clock::LiveClock;
use crate::error::LiveError;
use crate::outgoing::TRANSFORMS;
use crate::pairing::{FrameCounts, PairedFrame, Pairing, SILENCE_NS, StampFault, StreamNeed, StreamRule};
use crate::sensors::{CAMERA_INFO, CLOCK, IMAGE, JOINT_STATE, POSE};
use crate::setup::RosSetup;
use crate::touch_camera;

/// Types that are read, beside those of sensors.
const COMPRESSED_IMAGE: &str = "sensor_msgs/msg/CompressedImage";

/// How often new topics are looked for.
const LOOK: Duration = Duration::from_millis(100);
/// Topics that do not come within this time are named.
const PATIENCE: Duration = Duration::from_secs(2);
/// How long transforms are kept, nanoseconds.
const KEEP_TRANSFORMS_NS: i64 = 10_000_000_000;
/// Images of a topic that wait to be received: more are too old, fewer lose some while this thread sleeps.
const IMAGES: usize = 8;
/// Small messages of a topic that wait to be received.
const VALUES: usize = 256;
/// Topic of a simulator's time.
pub(crate) const CLOCK_TOPIC: &str = "/clock";
/// Topics of transforms, and whether they hold at all times.
const TRANSFORM_TOPICS: [(&str, bool); 2] = [("/tf", false), ("/tf_static", true)];

/// What a topic delivers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Delivers {
    /// Messages of the stream of this number.
    Stream(usize),
    CameraInfo,
    Transforms {
        always: bool,
    },
    Clock,
}

/// A topic that is read.
struct Wanted {
    topic: String,
    delivers: Delivers,
    types: &'static [&'static str],
    delivery: Delivery,
    inlet: Option<Inlet>,
}

/// Streams of frames and their numbers.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct StreamNumbers {
    pub color: Option<usize>,
    pub masks: Option<usize>,
    pub joints: Option<usize>,
    pub truth: Option<usize>,
    /// By pad; `None` without a topic.
    pub touch: Vec<Option<usize>>,
}

/// What has arrived.
struct Arrived {
    pairing: Pairing<Vec<u8>>,
    camera_info: Option<RosCameraInfo>,
    /// Frame of the depth images; `None` before the first.
    depth_frame: Option<String>,
    /// Streams of compressed images.
    compressed: BTreeSet<usize>,
    transforms: TransformTree,
    topics: Vec<LiveTopicRecord>,
}

struct Shared {
    arrived: Mutex<Arrived>,
    signal: Condvar,
    stop: Arc<AtomicBool>,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Arrived> {
        // A thread that panicked leaves messages behind, which are valid one by one.
        self.arrived.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Receives the topics of a setup until it is dropped.
pub(crate) struct Feed {
    shared: Arc<Shared>,
    clock: Arc<LiveClock>,
    threads: Vec<JoinHandle<()>>,
    /// Which stream is which.
    pub numbers: StreamNumbers,
}

impl Drop for Feed {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// A touch sensor of this computer that is read.
struct WantedCamera {
    /// Serial number, or device.
    name: String,
    /// Number of its stream.
    stream: usize,
    profile: SensorProfile,
}

/// Everything that a setup names.
type AllWanted = (Vec<Wanted>, Vec<WantedCamera>, Vec<StreamRule>, StreamNumbers);

/// Returns the topics and touch sensors of a setup with the rules of their streams.
fn wanted(setup: &RosSetup, pads: &[TouchPad]) -> AllWanted {
    const IMAGES_OF: &[&str] = &[IMAGE, COMPRESSED_IMAGE];
    let (mut topics, mut rules, mut numbers) = (Vec::new(), Vec::new(), StreamNumbers::default());
    let delivery = |depth| Delivery { reliable: setup.reliable, latched: false, depth };
    let mut stream = |topic: &String, types, need, is_between| {
        let number = rules.len();
        rules.push(StreamRule { name: topic.clone(), need, is_between });
        let delivery = delivery(if is_between { VALUES } else { IMAGES });
        topics.push(Wanted { topic: topic.clone(), delivers: Delivers::Stream(number), types, delivery, inlet: None });
        number
    };
    stream(&setup.depth, IMAGES_OF, StreamNeed::Always, false);
    numbers.color = setup.color.as_ref().map(|topic| stream(topic, IMAGES_OF, StreamNeed::WhileAlive, false));
    // Without a hand nothing else says where the object is.
    let need = if setup.rig.is_none() { StreamNeed::Always } else { StreamNeed::WhileAlive };
    numbers.masks = setup.masks.as_ref().map(|topic| stream(topic, IMAGES_OF, need, false));
    numbers.joints = setup.joints.as_ref().map(|topic| stream(topic, &[JOINT_STATE], StreamNeed::Always, true));
    numbers.touch = pads
        .iter()
        .map(|pad| setup.touch.get(&pad.name).map(|topic| stream(topic, IMAGES_OF, StreamNeed::WhileAlive, false)))
        .collect();
    numbers.truth = setup.truth.as_ref().map(|topic| stream(topic, &[POSE], StreamNeed::WhileAlive, false));
    let mut cameras = Vec::new();
    for (pad, number) in pads.iter().zip(&mut numbers.touch) {
        let Some(name) = setup.touch_cameras.get(&pad.name) else { continue };
        *number = Some(rules.len());
        cameras.push(WantedCamera { name: name.clone(), stream: rules.len(), profile: pad.profile.clone() });
        let name = format!("touch sensor {name}");
        rules.push(StreamRule { name, need: StreamNeed::WhileAlive, is_between: false });
    }
    topics.push(Wanted {
        topic: setup.camera_info.clone(),
        delivers: Delivers::CameraInfo,
        types: &[CAMERA_INFO],
        delivery: delivery(IMAGES),
        inlet: None,
    });
    if setup.sim_time {
        topics.push(Wanted {
            topic: CLOCK_TOPIC.to_owned(),
            delivers: Delivers::Clock,
            types: &[CLOCK],
            delivery: Delivery { reliable: false, latched: false, depth: VALUES },
            inlet: None,
        });
        // What arrives together is younger than the clock that arrived with it.
        topics.rotate_right(1);
    }
    if setup.world_frame.is_some() {
        topics.extend(TRANSFORM_TOPICS.map(|(topic, always)| Wanted {
            topic: topic.to_owned(),
            delivers: Delivers::Transforms { always },
            types: &[TRANSFORMS],
            // Transforms that hold at all times were sent before we came.
            delivery: Delivery { reliable: true, latched: always, depth: VALUES },
            inlet: None,
        }));
    }
    (topics, cameras, rules, numbers)
}

impl Feed {
    /// Starts to receive. Touch images belong to these pads; the clock is set if it is that of a simulator.
    pub fn start(bus: Arc<Bus>, clock: Arc<LiveClock>, setup: &RosSetup, pads: &[TouchPad]) -> Result<Self, LiveError> {
        let (topics, cameras, rules, numbers) = wanted(setup, pads);
        let arrived = Arrived {
            pairing: Pairing::new(rules, setup.slop_ns(), clock.now_ns()),
            camera_info: None,
            depth_frame: None,
            compressed: BTreeSet::new(),
            transforms: TransformTree::default(),
            topics: Vec::new(),
        };
        let shared = Arc::new(Shared { arrived: Mutex::new(arrived), signal: Condvar::new(), stop: Arc::default() });
        let mut threads = Vec::new();
        for WantedCamera { name, stream, profile } in &cameras {
            let (others, clock, stream) = (Arc::clone(&shared), Arc::clone(&clock), *stream);
            let frame = name.clone();
            let take = move |image: &image::RgbImage| {
                let stamp_ns = clock.now_ns();
                let message = touch_camera::message(stamp_ns, &frame, image);
                // Stamps of our own clock need no warning.
                let _ = others.lock().pairing.push(stream, stamp_ns, stamp_ns, message);
                others.signal.notify_all();
            };
            threads.push(touch_camera::read(name.clone(), profile.clone(), Arc::clone(&shared.stop), Box::new(take)));
        }
        let receiver = Receiver {
            bus,
            shared: Arc::clone(&shared),
            topics,
            cameras,
            waiter: Waiter::new()?,
            told: BTreeSet::new(),
            begun: Instant::now(),
            clock: Arc::clone(&clock),
        };
        threads.push(std::thread::spawn(move || receiver.run()));
        Ok(Self { shared, clock, threads, numbers })
    }

    /// Returns the newest complete frame that was not returned before; waits for one at most so long.
    pub fn next(&self, most: Duration) -> Option<PairedFrame<Vec<u8>>> {
        let mut arrived = self.shared.lock();
        let frame = arrived.pairing.take(self.clock.now_ns());
        if frame.is_some() {
            return frame;
        }
        (arrived, _) = self.shared.signal.wait_timeout(arrived, most).unwrap_or_else(PoisonError::into_inner);
        arrived.pairing.take(self.clock.now_ns())
    }

    /// Returns the camera model, if it has arrived.
    pub fn camera_info(&self) -> Option<RosCameraInfo> {
        self.shared.lock().camera_info.clone()
    }

    /// Returns the coordinate frame of the depth images; `None` before the first.
    pub fn depth_frame(&self) -> Option<String> {
        self.shared.lock().depth_frame.clone()
    }

    /// Returns whether the images of a stream are compressed.
    pub fn is_compressed(&self, stream: usize) -> bool {
        self.shared.lock().compressed.contains(&stream)
    }

    /// Looks up a transform at a time; a sentence if it is unknown.
    pub fn look_up(&self, to: &str, from: &str, time_ns: i64) -> Result<mvt_bag::nalgebra::Isometry3<f64>, String> {
        let mut arrived = self.shared.lock();
        arrived.transforms.sort();
        arrived.transforms.look_up(to, from, time_ns)
    }

    /// Returns the topics with their counts.
    pub fn topics(&self) -> Vec<LiveTopicRecord> {
        self.shared.lock().topics.clone()
    }

    /// Returns what became of depth images.
    pub fn frames(&self) -> FrameCounts {
        self.shared.lock().pairing.frames()
    }

    /// Returns the topics that have delivered nothing for a second.
    pub fn silent(&self) -> Vec<String> {
        if self.clock.stands() {
            return vec![CLOCK_TOPIC.to_owned()];
        }
        let since_ns = self.clock.now_ns().saturating_sub(SILENCE_NS);
        self.shared.lock().pairing.silent(since_ns).into_iter().map(str::to_owned).collect()
    }
}

/// The receiving thread.
struct Receiver {
    bus: Arc<Bus>,
    shared: Arc<Shared>,
    topics: Vec<Wanted>,
    cameras: Vec<WantedCamera>,
    waiter: Waiter,
    /// Warnings that were given: by topic and kind, so that each is given once.
    told: BTreeSet<(String, &'static str)>,
    begun: Instant,
    clock: Arc<LiveClock>,
}

impl Receiver {
    fn run(mut self) {
        let mut looked: Option<std::time::Instant> = None;
        while !self.shared.stop.load(Ordering::Relaxed) {
            if looked.is_none_or(|looked| looked.elapsed() >= LOOK) {
                self.look();
                looked = Some(std::time::Instant::now());
            }
            self.waiter.wait(LOOK / 2);
            if self.receive() {
                self.shared.signal.notify_all();
            }
        }
    }

    fn warn(&mut self, topic: &str, kind: &'static str, text: impl FnOnce() -> String) {
        if self.told.insert((topic.to_owned(), kind)) {
            tracing::warn!("{topic}: {}", text());
        }
    }

    /// Opens subscriptions of topics that have appeared, and names what is wrong with the others.
    fn look(&mut self) {
        let seen: BTreeMap<String, LiveTopic> =
            self.bus.topics().into_iter().map(|topic| (topic.name.clone(), topic)).collect();
        let mut missing = Vec::new();
        for k in 0..self.topics.len() {
            let Some(Wanted { topic, types, delivery, delivers, inlet }) = self.topics.get(k) else { continue };
            let (name, types, mut delivery, delivers) = (topic.clone(), *types, *delivery, *delivers);
            let Some(topic) = seen.get(&name) else {
                if inlet.is_none() {
                    missing.push(name);
                }
                continue;
            };
            if topic.publishers > 1 && !matches!(delivers, Delivers::Transforms { .. }) {
                self.warn(&name, "publishers", || {
                    format!("it has {} publishers, whose messages are mixed: stop all but one", topic.publishers)
                });
            }
            if self.topics.get(k).is_some_and(|wanted| wanted.inlet.is_some()) {
                continue;
            }
            let Some(type_name) = topic.types.iter().find(|name| types.contains(&name.as_str())) else {
                self.warn(&name, "type", || {
                    format!(
                        "its type is {}, but {} is needed: name another topic",
                        topic.types.join(", "),
                        types.join(" or ")
                    )
                });
                continue;
            };
            if delivery.reliable && !topic.is_reliable {
                delivery.reliable = false;
                self.warn(&name, "reliability", || "its publisher does not send lost messages again".to_owned());
            }
            match self.bus.listen(&name, type_name, delivery).and_then(|mut inlet| {
                self.waiter.add(&mut inlet)?;
                Ok(inlet)
            }) {
                Ok(inlet) => {
                    if let Delivers::Stream(number) = delivers
                        && type_name == COMPRESSED_IMAGE
                    {
                        self.shared.lock().compressed.insert(number);
                    }
                    if let Some(wanted) = self.topics.get_mut(k) {
                        wanted.inlet = Some(inlet);
                    }
                }
                Err(error) => self.warn(&name, "open", || error.to_string()),
            }
        }
        if self.begun.elapsed() > PATIENCE && !missing.is_empty() {
            let missing = missing.join(", ");
            self.warn(&missing, "missing", || missing_in_words(&seen));
        }
        let mut arrived = self.shared.lock();
        arrived.transforms.forget_before(self.clock.now_ns().saturating_sub(KEEP_TRANSFORMS_NS));
    }

    /// Takes all messages that have arrived; returns whether there were any.
    fn receive(&mut self) -> bool {
        let mut messages = Vec::new();
        for wanted in &mut self.topics {
            if let Some(inlet) = &mut wanted.inlet {
                while let Some(message) = inlet.take() {
                    messages.push((wanted.topic.clone(), wanted.delivers, message));
                }
            }
        }
        let is_any = !messages.is_empty();
        for (topic, delivers, message) in messages {
            if let Err((kind, fault)) = self.accept(delivers, message) {
                self.warn(&topic, kind, || fault);
            }
        }
        let mut arrived = self.shared.lock();
        let lost = |wanted: &Wanted| wanted.inlet.as_ref().map_or(0, Inlet::lost);
        let topics = self.topics.iter().filter_map(|wanted| match wanted.delivers {
            Delivers::Stream(number) => Some((number, lost(wanted))),
            _ => None,
        });
        // What a camera loses is not known.
        let streams: Vec<(usize, u64)> = topics.chain(self.cameras.iter().map(|camera| (camera.stream, 0))).collect();
        arrived.topics = streams.into_iter().filter_map(|(of, lost)| record(of, lost, &arrived.pairing)).collect();
        is_any
    }

    fn accept(&mut self, delivers: Delivers, message: Vec<u8>) -> Result<(), (&'static str, String)> {
        let unreadable = |reason: mvt_bag::RosError| ("unreadable", format!("a message is dropped: {reason}"));
        match delivers {
            Delivers::Stream(number) => {
                let RosHeader { stamp_ns, frame } = RosHeader::decode(&message).map_err(unreadable)?;
                if !self.clock.is_known() {
                    return Ok(());
                }
                let mut arrived = self.shared.lock();
                if number == 0 {
                    arrived.depth_frame = Some(frame);
                }
                arrived.pairing.push(number, stamp_ns, self.clock.now_ns(), message).map_err(|fault| {
                    let kind = match fault {
                        StampFault::Zero => "zero",
                        StampFault::Backwards => "backwards",
                        StampFault::Jump => "jump",
                        StampFault::Future | StampFault::Past => "clock",
                    };
                    (kind, fault.to_string())
                })
            }
            Delivers::CameraInfo => {
                let info = RosCameraInfo::decode(&message).map_err(unreadable)?;
                self.shared.lock().camera_info = Some(info);
                Ok(())
            }
            Delivers::Transforms { always } => {
                let transforms = RosTransform::decode(&message).map_err(unreadable)?;
                let mut arrived = self.shared.lock();
                for transform in &transforms {
                    arrived.transforms.add(transform, transform.header.stamp_ns, always);
                }
                Ok(())
            }
            Delivers::Clock => {
                // The message is a stamp.
                let mut reader = CdrReader::new(&message).map_err(|reason| unreadable(reason.into()))?;
                let stamp = reader.i32().and_then(|seconds| Ok((seconds, reader.u32()?)));
                let (seconds, nanoseconds) = stamp.map_err(|reason| unreadable(reason.into()))?;
                let reading_ns = i64::from(seconds) * 1_000_000_000 + i64::from(nanoseconds);
                if !self.clock.is_known() {
                    self.shared.lock().pairing.begin(reading_ns);
                }
                self.clock.set(reading_ns);
                Ok(())
            }
        }
    }
}

/// Says that topics do not come, and what is seen instead.
fn missing_in_words(seen: &BTreeMap<String, LiveTopic>) -> String {
    if seen.is_empty() {
        return "no publisher: no topic is seen at all; compare domain, addresses and firewall with those of the publishers".to_owned();
    }
    let seen: Vec<&str> = seen.keys().map(String::as_str).collect();
    format!("no publisher; these topics are seen: {}", seen.join(", "))
}

fn record(stream: usize, lost: u64, pairing: &Pairing<Vec<u8>>) -> Option<LiveTopicRecord> {
    let (name, counts) = pairing.streams().nth(stream)?;
    let span_ns = counts.newest_arrival_ns.zip(counts.first_arrival_ns).map_or(0, |(newest, first)| newest - first);
    let hz = if span_ns > 0 { (counts.received - 1) as f64 / (span_ns as f64 * 1e-9) } else { 0.0 };
    Some(LiveTopicRecord { topic: name.to_owned(), received: counts.received, lost, refused: counts.refused, hz })
}
