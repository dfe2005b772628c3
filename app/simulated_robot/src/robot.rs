//! The loop of a simulated robot.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::{Context as _, Result};
use mvt_frames::camera::PosedCamera;
use mvt_gaits::clock::{FRAME_HZ, PHYSICS_HZ};
use mvt_gaits::controller::Controller;
use mvt_gaits::directive::Directive;
use mvt_gaits::gait::Gait;
use mvt_objects::object::Object;
use mvt_physics::episode::{Episode, EpisodeConfig, EpisodeOutcome, EpisodeState, Randomisation, Tally};
use mvt_render::observer::{Observer, ObserverOptions, ObserverScratch};
use mvt_render::touch::{TouchConfig, TouchOptions};
use mvt_robot::hand::{Hand, JointAngles};
use mvt_ros::{Bus, CommandCodec, Delivery, Inlet, RosSetup};
use mvt_simulated::recorder::Noise;
use serde::Serialize;

use crate::broadcast::{ImageBroadcast, StateBroadcast};
use crate::pace::Pace;

/// Joint angles per second, as the driver of an Allegro publishes them.
const JOINTS_HZ: u32 = 100;
/// Time without a command after which the hand is said to hold, nanoseconds.
const SILENCE_NS: i64 = 500_000_000;
/// Commands that wait to be obeyed; the newest counts.
const COMMANDS: usize = 16;
/// Lag from which on a computer does not keep up.
const BEHIND: Duration = Duration::from_millis(100);

/// What is simulated.
#[derive(Debug, Clone)]
pub struct RobotSettings {
    /// The hand, with its touch sensors.
    pub hand: Arc<Hand>,
    /// Decides the start, the tilt of the palm and the torque limit.
    pub gait: Gait,
    /// A policy, whose contract decides the drives of the joints.
    pub mover: Option<Box<dyn Controller>>,
    /// The camera.
    pub camera: PosedCamera,
    /// Seed of the start and of all noise.
    pub seed: u64,
    /// Longest duration from the first command on, seconds.
    pub duration_s: f64,
    /// Noise of the images.
    pub noise: Noise,
    /// Simulated seconds per second.
    pub speed: f64,
}

/// What became of a simulated robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RobotOutcome {
    /// The episode from the first command on.
    #[serde(flatten)]
    pub episode: EpisodeOutcome,
    /// Frames that were published.
    pub frames: u64,
    /// Commands that were obeyed.
    pub commands: u64,
    /// Commands that could not be read, or were not for this hand.
    pub refused: u64,
    /// How often no command came for half a second.
    pub silences: u64,
    /// Simulated seconds per second.
    pub speed: f64,
}

/// Frame that is to be rendered.
struct RobotFrame {
    number: u32,
    stamp_ns: i64,
    state: EpisodeState,
}

/// The command topic, and what is known of it.
struct Commands {
    topic: String,
    codec: CommandCodec,
    inlet: Inlet,
    /// Stamp of the newest command, nanoseconds; `None` before the first.
    newest_ns: Option<i64>,
    is_silent: bool,
    told: Option<String>,
    is_shared: bool,
    obeyed: u64,
    refused: u64,
    silences: u64,
}

impl Commands {
    /// Returns the newest targets that have arrived.
    fn take(&mut self, now_ns: i64) -> Option<JointAngles> {
        let mut newest = None;
        while let Some(message) = self.inlet.take() {
            match self.codec.decode(&message) {
                Ok(targets) => {
                    self.obeyed += 1;
                    newest = Some(targets);
                }
                Err(fault) => {
                    self.refused += 1;
                    if self.told.as_ref() != Some(&fault) {
                        tracing::warn!("{}: a command is not obeyed: {fault}", self.topic);
                        self.told = Some(fault);
                    }
                }
            }
        }
        if self.inlet.is_mixed() && !self.is_shared {
            self.is_shared = true;
            tracing::warn!("{}: more than one publisher commands the hand: stop all but one", self.topic);
        }
        if newest.is_some() {
            self.newest_ns = Some(now_ns);
            if std::mem::take(&mut self.is_silent) {
                tracing::warn!("{}: commands arrive again", self.topic);
            }
        } else if !self.is_silent && self.newest_ns.is_some_and(|newest_ns| now_ns - newest_ns > SILENCE_NS) {
            self.is_silent = true;
            self.silences += 1;
            tracing::warn!("{}: no command for 0.5 s: the hand holds its last targets", self.topic);
        }
        newest
    }
}

/// A simulated robot.
pub struct SimulatedRobot {
    episode: Episode,
    observer: Observer,
    states: StateBroadcast,
    images: ImageBroadcast,
    commands: Commands,
    pace: Pace,
    is_simulated_time: bool,
    /// The topics end with it.
    _bus: Bus,
}

impl SimulatedRobot {
    /// Draws the start, joins the network and announces the topics.
    ///
    /// # Errors
    /// If MuJoCo refuses the object, the setup does not fit the hand, or the network cannot be used.
    pub fn new(object: &Object, settings: &RobotSettings, setup: &RosSetup) -> Result<Self> {
        let RobotSettings { hand, camera, noise, seed, .. } = settings;
        let config = EpisodeConfig {
            hand: Arc::clone(hand),
            gait: settings.gait.clone(),
            seed: *seed,
            duration_s: settings.duration_s,
            randomisation: Randomisation::default(),
        };
        // It never moves the hand: the commands do.
        let episode = match settings.mover.clone() {
            Some(mover) => Episode::moved_by(object, &config, mover)?,
            None => Episode::new(object, &config)?,
        };
        let options = ObserverOptions {
            hand: Arc::clone(hand),
            cameras: vec![camera.clone()],
            touch: TouchOptions::of_hand(hand, TouchConfig::Fork, None),
            touch_noise: noise.touch,
            camera_depth_noise: noise.camera_depth,
            seed: *seed,
        };
        let observer = Observer::new(object, options)?;
        let command =
            setup.command.as_ref().context("a simulated robot needs the table [ros.command], see docs/live.md")?;
        let bus = Bus::join(setup.domain(), &setup.addresses)?;
        let codec = CommandCodec::new(command, hand, &setup.joint_names).map_err(anyhow::Error::msg)?;
        let delivery = Delivery { reliable: false, latched: false, depth: COMMANDS };
        Ok(Self {
            episode,
            observer,
            states: StateBroadcast::announce(&bus, setup, hand)?,
            images: ImageBroadcast::announce(&bus, setup, hand, camera.intrinsics)?,
            commands: Commands {
                topic: command.topic.clone(),
                codec,
                inlet: bus.listen(&command.topic, command.kind.name(), delivery)?,
                newest_ns: None,
                is_silent: false,
                told: None,
                is_shared: false,
                obeyed: 0,
                refused: 0,
                silences: 0,
            },
            pace: Pace::new(settings.speed, setup.sim_time),
            is_simulated_time: setup.sim_time,
            _bus: bus,
        })
    }

    /// Runs until the object falls, the duration after the first command is over, or `stop` is set.
    ///
    /// # Errors
    /// If the thread that renders fails.
    pub fn run(mut self, stop: &AtomicBool) -> Result<RobotOutcome> {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let begun_ns = i64::try_from(since.as_nanos()).unwrap_or(i64::MAX);
        let Self { episode, observer, states, images, commands, pace, is_simulated_time, _bus } = &mut self;
        let is_simulated_time = *is_simulated_time;
        let mut tally = Tally::default();
        let mut frames = 0;
        std::thread::scope(|scope| {
            // Physics and joint angles go on while a frame is rendered, but not by more than a frame.
            let (sender, receiver) = sync_channel::<RobotFrame>(1);
            let (observer, images) = (&*observer, &*images);
            scope.spawn(move || render(observer, images, &receiver));
            frames = steps(episode, &mut tally, (states, commands, pace), (begun_ns, is_simulated_time), &sender, stop);
        });
        Ok(RobotOutcome {
            episode: tally.outcome(episode),
            frames,
            commands: commands.obeyed,
            refused: commands.refused,
            silences: commands.silences,
            speed: pace.reached(),
        })
    }
}

fn render(observer: &Observer, images: &ImageBroadcast, frames: &Receiver<RobotFrame>) {
    let mut scratch = ObserverScratch::default();
    for RobotFrame { number, stamp_ns, state } in frames {
        images.send(observer, &mut scratch, number, stamp_ns, &state);
    }
}

/// Steps the episode; returns the number of frames.
fn steps(
    episode: &mut Episode,
    tally: &mut Tally,
    (states, commands, pace): (&StateBroadcast, &mut Commands, &mut Pace),
    (begun_ns, is_simulated_time): (i64, bool),
    frames: &SyncSender<RobotFrame>,
    stop: &AtomicBool,
) -> u64 {
    const STEP_NS: f64 = 1e9 / PHYSICS_HZ as f64;
    let hand = Arc::clone(episode.hand());
    let mut targets: Option<JointAngles> = None;
    let (mut number, mut is_behind) = (0_u32, false);
    for tick in 0_u32.. {
        pace.wait(f64::from(tick) / f64::from(PHYSICS_HZ));
        if !is_simulated_time && !is_behind && pace.lag() > BEHIND {
            is_behind = true;
            tracing::warn!(
                "the computer does not keep up with real time, so that stamps are old: set sim_time = true in the file and give --speed, such as 0.3"
            );
        }
        if stop.load(Ordering::Relaxed) {
            // Stopping has no name that could be unknown.
            let _ = episode.direct(Directive::Stop);
        }
        let stamp_ns = begun_ns.saturating_add((f64::from(tick) * STEP_NS) as i64);
        if let Some(newest) = commands.take(stamp_ns) {
            if targets.is_none() {
                tracing::warn!("{}: the first command has come, the episode begins", commands.topic);
            }
            // Joints stop at their ends.
            targets = Some(hand.within_ranges(&newest));
        }
        if tick.is_multiple_of(PHYSICS_HZ / JOINTS_HZ) {
            let simulation = episode.simulation();
            states.send(stamp_ns, &simulation.joints(), &simulation.joint_velocities());
        }
        if tick.is_multiple_of(PHYSICS_HZ / FRAME_HZ) {
            let state = episode.state();
            if targets.is_some() {
                tally.add(&state);
            }
            if frames.send(RobotFrame { number, stamp_ns, state }).is_err() {
                break;
            }
            number += 1;
        }
        // Why: notes/decisions/live.md, "A simulated robot rests until its first command".
        if let Some(targets) = &targets {
            episode.advance(1, Some(targets));
        }
        if episode.end().is_some() {
            break;
        }
    }
    u64::from(number)
}
