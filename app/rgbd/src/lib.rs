//! RGB-D sequences of an object without a hand: folders that other programs and data sets use.
//!
//! [`RgbdRecording::open`] recognises a folder by its files:
//!
//! | layout | files |
//! |---|---|
//! | BundleSDF, FoundationPose, YCBInEOAT | `rgb/ depth/ masks/ cam_K.txt`, `annotated_poses/` if there is a truth |
//! | a scene of BOP | `rgb/ depth/ mask_visib/ scene_camera.json scene_gt.json` |
//! | a sequence of HO3D | `rgb/ depth/ meta/*.pkl`, `masks/` or `seg/` |
//! | TUM | `rgb.txt depth.txt groundtruth.txt`, `cam_K.txt`, `masks/` |
//! | any other | `rgbd.toml` with the patterns of the files |
//!
//! `rgbd.toml` may also add to a recognised layout what it lacks:
//!
//! ```toml
//! color = "data/*-color.png"       # one * in the name; files with the same part belong together
//! depth = "data/*-depth.png"       # 16-bit PNG, or .npy
//! masks = "data/*-label.png"       # 0 and 1, 0 and 255, alpha, or labels
//! object = 12                      # the label of the object, or its obj_id in BOP
//! intrinsics = [1066.8, 1067.5, 313.0, 241.3]   # fx, fy, cx, cy of the colour images, pixels
//! depth_unit_m = 0.0001            # metres per level; 0.001 without it
//! live = true                      # of a run --ros --record: all frames are used as that run used them
//! carry_masks = true               # carry masks into frames without one; by default if fewer than half have one
//! frame_hz = 30.0                  # for files that are numbered
//! camera_poses = "data/*.pose.txt" # 4 x 4, camera to world, OpenCV axes
//! mesh = "mug.obj"                 # mesh of the object, or its name in the catalogue, for scores
//! object_poses = "poses/*.txt"     # 4 x 4, object to camera, OpenCV axes: the truth, for scores
//! ```
//!
//! ```no_run
//! let recording = mvt_rgbd::RgbdRecording::open("mustard0".as_ref())?;
//! for k in 0..recording.len() {
//!     let frame = recording.frame(k)?;
//!     println!("{:.2} s: {:?} pixels of depth", frame.time_s, frame.depth_m.dim());
//! }
//! # Ok::<(), mvt_rgbd::RgbdError>(())
//! ```

mod bop;
mod description;
mod error;
mod folders;
mod ho3d;
mod masks;
mod parts;
mod pattern;
mod pixels;
mod recording;
mod registration;
mod text;
mod tum;
mod writer;

pub use error::RgbdError;
pub use masks::{RgbdMasks, are_carried, masks_note};
pub use mvt_frames;
pub use ndarray;
pub use recording::{RgbdFrame, RgbdLayout, RgbdRecording, check_first_mask, object_distance_m};
pub use registration::{UNREGISTERED, are_colours_registered};
pub use text::read_pose_in_camera;
pub use writer::{RgbdWriter, WrittenFrame};
