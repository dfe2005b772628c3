//! Bags of ROS 2 without ROS: files of MCAP and SQLite as they were recorded.
//!
//! [`Bag`] lists topics and reads messages in the order of recording; only some chunks of the bag are in memory. It takes a file `.mcap` or
//! `.db3`, a folder with `metadata.yaml` and split files, and files or messages that Zstandard compressed. [`RosImage`] and its like decode
//! messages in CDR. [`RgbdBag`] pairs colours and depth by their stamps and adds masks, the pose of the camera, and joints:
//!
//! ```no_run
//! let mut bag = mvt_bag::RgbdBag::open("rosbag2_2026_11_27".as_ref())?;
//! for note in bag.notes() {
//!     eprintln!("note: {note}");
//! }
//! for frame in bag.frames() {
//!     let frame = frame?;
//!     println!("{:.3} s: {:?} pixels of depth, {} joints", frame.time_s, frame.depth_m.dim(), frame.joints.len());
//! }
//! # Ok::<(), mvt_bag::BagError>(())
//! ```
//!
//! Topics are found by their types, encodings and names. `bag.toml`, in the folder of the bag or beside its file, states what is in doubt:
//!
//! ```toml
//! color = "/camera/color/image_raw"
//! depth = "/camera/aligned_depth_to_color/image_raw"        # registered to the colours
//! camera_info = "/camera/aligned_depth_to_color/camera_info"
//! masks = "/masks"                   # 0 and 1, 0 and 255, or labels
//! object = 12                        # the label of the object
//! joints = "/joint_states"
//! object_pose = "/object/pose"       # geometry_msgs/msg/PoseStamped: the truth, for scores
//! world_frame = "map"                # poses of the camera are given in it
//! depth_unit_m = 0.001               # metres per level of 16 bits
//! slop_s = 0.016                     # greatest difference of stamps in a frame
//! ```
//!
//! What is left out or assumed stands in the notes of a bag. Messages are decoded from any bytes without a panic:
//!
//! ```
//! let error = mvt_bag::RosImage::decode(&[0, 1, 0, 0, 7]).unwrap_err();
//! assert_eq!(error.to_string(), "the message ends at byte 5, before a value of 4 bytes at byte 4: it was cut off");
//! ```

mod bag;
mod camera;
mod cdr;
mod db3;
mod error;
mod lens;
pub mod mcap;
mod messages;
mod packed;
mod parts;
mod pixels;
mod rgbd;
mod rvl;
mod survey;
mod topics;
mod tree;

pub use bag::{Bag, BagMessage, BagMessages, BagPlace, BagTopic};
pub use camera::{RosCamera, RosPicture};
pub use cdr::{CdrError, CdrReader};
pub use error::{BagError, RosError};
pub use lens::RosLens;
pub use messages::{RosCameraInfo, RosCompressedImage, RosHeader, RosImage, RosJointState, RosPose, RosTransform};
pub use packed::zstd;
pub use rgbd::{BagFrame, RgbdBag};
pub use topics::RgbdTopics;
pub use tree::TransformTree;
pub use {image, mvt_frames, nalgebra, ndarray};
