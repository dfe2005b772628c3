//! The publishing side of a simulated robot.

use anyhow::{Result, bail};
use mvt_frames::camera::Intrinsics;
use mvt_frames::depth::Label;
use mvt_physics::episode::EpisodeState;
use mvt_render::observer::{Observer, ObserverScratch};
use mvt_robot::hand::Hand;
use mvt_ros::outgoing::OutgoingHeader;
use mvt_ros::sensors::{self, CAMERA_INFO, CLOCK, IMAGE, JOINT_STATE, POSE};
use mvt_ros::{Bus, Delivery, Outlet, RosSetup};

/// Frame of the images.
const OPTICAL: &str = "camera_optical";
/// Frame of the true pose, and of joint angles.
const WORLD: &str = "world";
/// Images that wait for slow receivers.
const IMAGES: usize = 8;
/// Small messages that wait for slow receivers.
const VALUES: usize = 64;
/// Label of the object in masks where none is stated.
const INSIDE: u8 = 255;
/// Metres per level of depth where it is not stated, as cameras have it.
const UNIT_M: f64 = 0.001;

/// Joint angles and time, which are published at their own rate.
pub(crate) struct StateBroadcast {
    names: Vec<String>,
    joints: Outlet,
    clock: Option<Outlet>,
}

/// Images of an instant.
pub(crate) struct ImageBroadcast {
    depth: Outlet,
    color: Option<Outlet>,
    info: Outlet,
    masks: Option<(Outlet, u8)>,
    truth: Option<Outlet>,
    /// By pad; `None` without a topic.
    touch: Vec<Option<Outlet>>,
    intrinsics: Intrinsics,
    unit_m: f64,
}

/// Messages are sent again where that is asked for; others, too, receive them.
fn delivery(depth: usize) -> Delivery {
    Delivery { reliable: true, latched: false, depth }
}

impl StateBroadcast {
    /// Announces the topics of a hand.
    pub fn announce(bus: &Bus, setup: &RosSetup, hand: &Hand) -> Result<Self> {
        let Some(topic) = &setup.joints else {
            bail!("a simulated robot needs the topic of its joint angles, `joints`")
        };
        let named = |name: &String| setup.joint_names.get(name).unwrap_or(name).clone();
        Ok(Self {
            names: hand.joints().iter().map(|joint| named(&joint.name)).collect(),
            joints: bus.speak(topic, JOINT_STATE, delivery(VALUES))?,
            // The time is not sent again: nobody needs an old one, and a reader that was killed would stop the clock.
            clock: setup
                .sim_time
                .then(|| bus.speak("/clock", CLOCK, Delivery { reliable: false, ..delivery(VALUES) }))
                .transpose()?,
        })
    }

    /// Publishes the time, and angles and velocities of the joints.
    pub fn send(&self, stamp_ns: i64, angles: &[f64], velocities: &[f64]) {
        if let Some(clock) = &self.clock {
            clock.send(sensors::clock(stamp_ns));
        }
        let header = OutgoingHeader { stamp_ns, frame: WORLD };
        self.joints.send(sensors::joint_state(header, &self.names, angles, velocities));
    }
}

impl ImageBroadcast {
    /// Announces the topics of a camera and of the pads.
    pub fn announce(bus: &Bus, setup: &RosSetup, hand: &Hand, intrinsics: Intrinsics) -> Result<Self> {
        let speak = |topic: &str, kind| bus.speak(topic, kind, delivery(IMAGES));
        let optional = |topic: &Option<String>, kind| topic.as_deref().map(|topic| speak(topic, kind)).transpose();
        let label = setup.object.map_or(Ok(INSIDE), u8::try_from);
        let Ok(label) = label else {
            bail!("object = {:?}: masks of a simulated robot have labels up to 255", setup.object)
        };
        let touch = hand.pads().iter().map(|pad| optional(&setup.touch.get(&pad.name).cloned(), IMAGE));
        Ok(Self {
            depth: speak(&setup.depth, IMAGE)?,
            color: optional(&setup.color, IMAGE)?,
            info: speak(&setup.camera_info, CAMERA_INFO)?,
            masks: optional(&setup.masks, IMAGE)?.map(|outlet| (outlet, label)),
            truth: optional(&setup.truth, POSE)?,
            touch: touch.collect::<Result<_, _>>()?,
            intrinsics,
            unit_m: setup.depth_unit_m.unwrap_or(UNIT_M),
        })
    }

    /// Renders a state and publishes its images; depth comes last, because frames wait for it.
    pub fn send(
        &self,
        observer: &Observer,
        scratch: &mut ObserverScratch,
        number: u32,
        stamp_ns: i64,
        state: &EpisodeState,
    ) {
        let (observation, truth) = observer.observe(number, &state.scene, scratch);
        let optical = OutgoingHeader { stamp_ns, frame: OPTICAL };
        if let Some(outlet) = &self.truth {
            let header = OutgoingHeader { stamp_ns, frame: WORLD };
            outlet.send(sensors::pose(header, &truth.object_pose.untyped()));
        }
        for (outlet, image) in self.touch.iter().zip(observation.touch.iter()) {
            if let Some(outlet) = outlet {
                outlet.send(sensors::color(optical, image));
            }
        }
        self.info.send(sensors::camera_info(optical, self.intrinsics));
        if let (Some((outlet, label)), Some(labels)) = (&self.masks, truth.labels.first()) {
            outlet.send(sensors::mask(optical, &labels.map(|of| *of == Label::Object), *label));
        }
        let Some(camera) = observation.cameras.first() else { return };
        if let Some(color) = &self.color {
            color.send(sensors::color(optical, &camera.color));
        }
        self.depth.send(sensors::depth(optical, &camera.depth_m, self.unit_m));
    }
}
