//! Hands of users: a TOML file beside the untouched MJCF or URDF of the hand gives a [`Hand`](mvt_robot::hand::Hand).
//!
//! The TOML file says which link is the base and how it stands in the world, where the touch sensors are and which, how strong the joints are,
//! and where cameras stand. MuJoCo reads MJCF, the crate urdf-rs reads URDF. [`HandFile::load`] returns the hand with its cameras, and
//! warnings for all that was left out or looks wrong. It writes nothing, except that the files of hands that are
//! brought along are fetched into the user's cache on first use.
//!
//! ```
//! use mvt_hands::HandFile;
//!
//! let loaded = HandFile::load("tests/data/pincer.toml")?;
//! assert_eq!(loaded.hand.joints().len(), 3);
//! assert_eq!(loaded.hand.pads()[0].name, "left");
//! # Ok::<(), mvt_hands::HandFileError>(())
//! ```

// Its build script puts libmujoco on the link line.
use mvt_mujoco_lib as _;

mod assemble;
mod camera;
mod check;
mod error;
mod file;
mod leap;
mod load;
mod mjcf;
mod model;
mod rig;
mod shape;
mod urdf;

pub use error::HandFileError;
pub use file::{BaseLink, CameraMount, DriveChange, GraspMount, HandFile, JointChange, LoadedHand, PadMount};
pub use leap::{LEAP, leap_folder};
pub use rig::load_rig;
pub use {mvt_frames, mvt_robot};
