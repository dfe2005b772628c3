//! The thread that drives a hand: joint angles in, targets out.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use mvt_bag::RosJointState;
use mvt_robot::hand::Hand;
use mvt_run::report::CommandRecord;

use crate::bus::{Bus, Delivery, Inlet, Outlet, Waiter};
use crate::clock::LiveClock;
use crate::motion::Motion;
use crate::observer::{angles, velocities};
use crate::sensors::JOINT_STATE;
use crate::setup::RosSetup;
use crate::targets::{CommandCodec, CommandSetup};

/// Longest wait for joint angles before faults are looked for.
const WAIT: Duration = Duration::from_millis(5);
/// Joint angles that wait to be received.
const WAITING: usize = 64;
/// How often the subscribers of the command topic are looked for.
const LOOK: Duration = Duration::from_secs(2);
/// A motion that has not begun for so long is explained.
const PATIENCE: Duration = Duration::from_secs(5);
/// Longest time in which an ended hand comes to rest.
const REST: Duration = Duration::from_secs(3);

/// Drives a hand on a thread of its own.
pub(crate) struct Driver {
    shared: Arc<Shared>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

struct Shared {
    motion: Mutex<Motion>,
    /// Ends the motion.
    stop: Arc<AtomicBool>,
    is_over: AtomicBool,
}

impl Shared {
    fn motion(&self) -> MutexGuard<'_, Motion> {
        // A thread that panicked leaves a motion behind whose gate holds.
        self.motion.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The thread's side.
struct Driving {
    shared: Arc<Shared>,
    bus: Arc<Bus>,
    clock: Arc<LiveClock>,
    setup: RosSetup,
    command: CommandSetup,
    hand: Arc<Hand>,
    codec: CommandCodec,
    joints: Inlet,
    outlet: Outlet,
    waiter: Waiter,
    begun: Instant,
    looked: Instant,
    /// Listeners of the command topic, and whether its number was told.
    has_listeners: Option<bool>,
    is_explained: bool,
    told: Option<String>,
}

impl Driver {
    /// Announces the command topic and starts. Nothing is sent before joint angles and an estimate are fresh. `stop` ends the motion.
    ///
    /// # Errors
    /// If the network cannot be used, or the order of joints does not fit the hand.
    pub fn start(
        bus: Arc<Bus>,
        clock: Arc<LiveClock>,
        setup: &RosSetup,
        command: &CommandSetup,
        hand: &Arc<Hand>,
        motion: Motion,
        stop: Arc<AtomicBool>,
    ) -> anyhow::Result<Self> {
        let codec = CommandCodec::new(command, hand, &setup.joint_names).map_err(anyhow::Error::msg)?;
        let delivery = |reliable, depth| Delivery { reliable, latched: false, depth };
        let outlet = bus.speak(&command.topic, command.kind.name(), delivery(true, 1))?;
        let topic = setup.joints.as_deref().unwrap_or_default();
        let mut joints = bus.listen(topic, JOINT_STATE, delivery(false, WAITING))?;
        let mut waiter = Waiter::new()?;
        waiter.add(&mut joints)?;
        let shared = Arc::new(Shared { motion: Mutex::new(motion), stop, is_over: AtomicBool::new(false) });
        let now = Instant::now();
        let driving = Driving {
            shared: Arc::clone(&shared),
            bus,
            clock,
            setup: setup.clone(),
            command: command.clone(),
            hand: Arc::clone(hand),
            codec,
            joints,
            outlet,
            waiter,
            begun: now,
            looked: now,
            has_listeners: None,
            is_explained: false,
            told: None,
        };
        let thread = std::thread::spawn(move || driving.run());
        Ok(Self { shared, thread: Mutex::new(Some(thread)) })
    }

    /// Returns the motion, for estimates and directives.
    pub fn motion(&self) -> MutexGuard<'_, Motion> {
        self.shared.motion()
    }

    /// Ends the motion, waits until the hand is at rest, and returns the counts.
    pub fn finish(&self, reason: &str) -> CommandRecord {
        self.motion().end(reason);
        self.shared.is_over.store(true, Ordering::Relaxed);
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(thread) = thread {
            let _ = thread.join();
        }
        self.motion().record().clone()
    }
}

impl Drop for Driver {
    fn drop(&mut self) {
        self.finish("the run ended");
    }
}

impl Driving {
    fn run(mut self) {
        let mut ended: Option<Instant> = None;
        loop {
            self.waiter.wait(WAIT);
            self.receive();
            if self.shared.stop.load(Ordering::Relaxed) {
                self.shared.motion().end("the run was interrupted");
            }
            let steady_ns = i64::try_from(self.begun.elapsed().as_nanos()).unwrap_or(i64::MAX);
            let ((targets, note), is_at_rest) = {
                let mut motion = self.shared.motion();
                (motion.step(self.clock.now_ns(), steady_ns), motion.is_at_rest())
            };
            if let Some(targets) = targets {
                self.outlet.send(self.codec.encode(&targets));
            }
            if let Some(note) = note {
                tracing::warn!("{}: {note}", self.command.topic);
            }
            if self.shared.is_over.load(Ordering::Relaxed) {
                let since = *ended.get_or_insert_with(Instant::now);
                if is_at_rest || since.elapsed() > REST {
                    return;
                }
            }
            if self.looked.elapsed() > LOOK {
                self.looked = Instant::now();
                self.look();
            }
        }
    }

    /// Takes joint angles that have arrived.
    fn receive(&mut self) {
        while let Some(message) = self.joints.take() {
            let read = RosJointState::decode(&message).map_err(|reason| reason.to_string()).and_then(|state| {
                let joints = angles(&state, &self.hand, &self.setup.joint_names)?;
                let velocities = velocities(&state, &self.hand, &self.setup.joint_names);
                self.shared.motion().measured(state.header.stamp_ns, joints, velocities);
                Ok(())
            });
            if let Err(fault) = read
                && self.told.replace(fault.clone()).as_ref() != Some(&fault)
            {
                tracing::warn!("{}: {fault}", self.setup.joints.as_deref().unwrap_or_default());
            }
        }
    }

    /// Names what is wrong with the command topic, and why nothing was sent.
    fn look(&mut self) {
        let topic = &self.command.topic;
        let has_listeners = self.bus.listeners(topic) > 0;
        match self.has_listeners.replace(has_listeners) {
            None | Some(true) if !has_listeners => {
                tracing::warn!(
                    "{topic}: nobody subscribes, so that no command reaches a hand: start the hand's controller"
                );
            }
            Some(false) if has_listeners => tracing::warn!("{topic}: somebody subscribes"),
            _ => {}
        }
        let motion = self.shared.motion();
        if !self.is_explained && !motion.has_begun() && self.begun.elapsed() > PATIENCE {
            self.is_explained = true;
            if let Some(fault) = motion.stopped() {
                tracing::warn!("{topic}: nothing is sent yet: {fault}");
            }
        }
    }
}
