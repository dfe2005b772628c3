//! Live ROS 2 without a ROS installation: topics in as frames, results out as topics.
//!
//! [`RosSetup`] is the table `[ros]` of the user's TOML file. [`LiveConnection`] joins the network over RustDDS, subscribes to the topics that
//! it names, and gives a [`RosSource`] of frames and a publisher of poses, transforms, meshes, contacts and diagnostics. Messages are decoded by
//! mvt-bag, whose bags hold the same bytes, and encoded by [`CdrWriter`]. [`Pairing`] is the rule by which messages become frames; it knows
//! no network:
//!
//! ```
//! use mvt_ros::RosSetup;
//!
//! let setup = RosSetup::parse(
//!     r#"
//!     [ros]
//!     depth = "/camera/aligned_depth_to_color/image_raw"
//!     color = "/camera/color/image_raw"
//!     camera_info = "/camera/aligned_depth_to_color/camera_info"
//!     masks = "/masks"
//!     "#,
//! )?;
//! assert_eq!(setup.slop_ns(), 16_000_000);
//! # Ok::<(), String>(())
//! ```

// Why: notes/decisions/live.md, "`ros` apart from `bag` and `run`, and `simulated_robot` apart from `ros`".

mod bus;
mod cdr_writer;
mod clock;
pub mod command;
mod connection;
mod contacts;
mod driver;
mod error;
mod feed;
mod gate;
mod listing;
mod motion;
mod observer;
pub mod outgoing;
mod pairing;
mod publisher;
mod recorder;
pub mod sensors;
mod setup;
mod source;
mod targets;
mod touch_camera;

pub use bus::{Bus, Delivery, Inlet, LiveTopic, Outlet, Waiter};
pub use cdr_writer::CdrWriter;
pub use clock::LiveClock;
pub use connection::{LiveConnection, LiveDrive, LiveHand, LiveRun, suited};
pub use error::LiveError;
pub use gate::{CommandGate, CommandLimits, DriveFault, Passed, SafeTargets};
pub use listing::{TopicRate, list_topics};
pub use pairing::{
    FrameCounts, FramePart, PairedFrame, Pairing, StampFault, Stamped, StreamCounts, StreamNeed, StreamRule,
};
pub use publisher::RosPublisher;
pub use setup::{PublishSetup, RosSetup, domain_of_environment};
pub use source::{LiveOptions, RosSource};
pub use targets::{CommandCodec, CommandSetup, CommandType, OnStop};
pub use {mvt_calibration, mvt_frames, mvt_gaits, mvt_perceive, mvt_robot, mvt_run, nalgebra};
