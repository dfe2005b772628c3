//! FeelSight logs, the format of NeuralFeels' data set: a writer whose logs NeuralFeels' own loaders read, a reader,
//! and a check.
//!
//! The crate reads logs of this workspace and of the published data set, whole ([`Log::open`]) or with missing and
//! damaged parts ([`Log::open_tolerant`]). It writes logs frame by frame ([`LogWriter`]) and checks all files of a log
//! ([`inspect`]). It needs neither Python nor NumPy, and never runs code of a pickle. It does not render, simulate or
//! draw: pictures of a log, such as contact sheets, are made elsewhere.
//!
//! ```text
//! <log>/
//!   data.pkl                               times, joints, poses, intrinsics (Python pickle)
//!   scene.json                             everything else about the episode; only in logs of this program
//!   live.json                              only in logs of live runs
//!   <object>.mp4 or .gif                   a preview
//!   allegro/<pad>/image/<i>.jpg            touch sensor's colours, 240 x 320
//!   allegro/<pad>/depth/<i>.jpg            simulated only: height over the plane 22 mm from the camera; 0.03 mm a level
//!   allegro/<pad>/mask/<i>.jpg             simulated only: 255 in contact
//!   realsense/<camera>/image/<i>.jpg       colours
//!   realsense/<camera>/seg/<i>.jpg         simulated only: 0 background, 127 hand, 255 object
//!   realsense/<camera>/depth.npz           depth [N, H, W]: negative camera z, metres, 0 = not measured; depth_scale
//! ```
//!
//! Frames are numbered from 0 without padding. Masks, segmentations and touch depths are PNG images in spite of their
//! names. The pads of an Allegro are index, middle, ring and thumb. Logs of other hands have the same layout with their own
//! pads and joints, and hold the description of the hand.
//!
//! Reading a log:
//!
//! ```no_run
//! let log = mvt_feelsight::Log::open("logs/077_rubiks_cube/00".as_ref())?;
//! println!("{} frames of {}", log.len(), log.object_name());
//! for frame in log.frames()? {
//!     let observation = frame?.observation;
//!     println!("{:.2} s: {} cameras", observation.time_s, observation.cameras.len());
//! }
//! # Ok::<(), mvt_feelsight::LogError>(())
//! ```
//!
//! The pickle, written and read back:
//!
//! ```
//! use mvt_feelsight::array::Array;
//! use mvt_feelsight::pickle::{self, PickleValue};
//!
//! let time = Array::from_f64(vec![3], [0.0, 0.04, 0.08]);
//! let bytes = pickle::to_bytes(&PickleValue::dict([("time", time.into()), ("object", "ball".into())]));
//!
//! let data = pickle::from_bytes(&bytes)?;
//! assert_eq!(data.get("object").and_then(PickleValue::as_str), Some("ball"));
//! let times_s = data.get("time").and_then(PickleValue::to_tensor);
//! assert_eq!(times_s, Some((vec![3], vec![0.0, 0.04, 0.08])));
//!
//! // A function is refused by its name and never called.
//! let refused = pickle::from_bytes(b"cos\nsystem\n(S'echo harm'\ntR.");
//! assert_eq!(refused, Err(pickle::PickleError::Refused("os.system".into())));
//! # Ok::<(), pickle::PickleError>(())
//! ```

mod archive;
pub mod array;
mod assembler;
mod compact;
mod convert;
mod depths;
mod disturb;
mod error;
mod format;
mod frame;
mod frames;
pub mod hand;
mod inspect;
mod io;
mod lens;
mod levels;
mod live;
pub mod npy;
pub mod npz;
mod partial;
pub mod pickle;
mod picture;
mod preview;
mod reader;
mod record;
mod scene;
mod writer;

pub use assembler::{LogAssembler, LogCamera, LogImage, Timeline};
pub use convert::convert;
pub use disturb::{DISTURBANCE_FILE, Disturbance, Disturbed, disturb};
pub use error::LogError;
pub use format::LogFormat;
pub use frame::EncodedFrame;
pub use inspect::{CameraSummary, LogSummary, SurfaceDistance, inspect, inspect_against};
pub use live::{LIVE_FILE, LiveFile};
pub use partial::{LogSensor, PartialFrame, PartialFrames, TouchPart};
pub use reader::{ImageFiles, Log, LogFrame, LogFrames};
pub use record::DigitInfo;
pub use scene::{EpisodeEnd, FORMAT_VERSION, LogMeta, SCENE_FILE, SceneFile, SceneObject};
pub use writer::LogWriter;
pub use {image, mvt_robot, ndarray};
