//! FeelSight logs: the layout and encodings of NeuralFeels' data set, written so that its own loaders read them, and read back.
//!
//! ```text
//! <log>/
//!   data.pkl                                   times, joints, poses, intrinsics (Python pickle)
//!   scene.json                                 everything else about the episode; only in logs of this program
//!   <object>.mp4 or .gif                       a preview
//!   allegro/<finger>/image/<i>.jpg             DIGIT colours, 240 x 320
//!   allegro/<finger>/depth/<i>.jpg             simulated only: height over the plane 22 mm from the camera, 0.03 mm per level
//!   allegro/<finger>/mask/<i>.jpg              simulated only: 255 in contact
//!   realsense/<camera>/image/<i>.jpg           colours
//!   realsense/<camera>/seg/<i>.jpg             simulated only: 0 background, 127 hand, 255 object
//!   realsense/<camera>/depth.npz               depth [N, H, W]: negative camera z, metres, 0 = nothing; depth_scale
//! ```
//!
//! LogFrames are numbered from 0 without padding. Masks, segmentations and touch depths are PNG images in spite of their names.

pub mod array;
mod error;
mod frame;
mod inspect;
pub mod npz;
mod partial;
pub mod pickle;
mod picture;
mod preview;
mod reader;
mod record;
mod scene;
mod sheet;
mod writer;

pub use error::LogError;
pub use frame::EncodedFrame;
pub use inspect::{CameraSummary, ContactDistance, LogSummary, inspect, inspect_against};
pub use partial::{LogSensor, PartialFrame, PartialFrames, TouchPart};
pub use reader::{Log, LogFrame, LogFrames};
pub use record::DigitInfo;
pub use scene::{EpisodeEnd, FORMAT_VERSION, SCENE_FILE, SceneFile, SceneObject};
pub use sheet::{ContactSheet, Moment, Timeline, contact_sheet};
pub use writer::{LogMeta, LogWriter};
