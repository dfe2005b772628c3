//! live.json: what a log of a live run has beyond other logs.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::LogError;
use crate::io::read_at_most;
use crate::record::Matrix;

/// Name of this file, which lies beside data.pkl.
pub const LIVE_FILE: &str = "live.json";
/// Greatest size of the file, bytes: an hour of poses.
const LARGEST: u64 = 64 << 20;

/// Contents of live.json. Its presence says that the frames are to be used as the live run used them: nothing is known of later ones, and
/// segmentations are masks of the object.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct LiveFile {
    /// Frames that the run used and the log lacks, because the disk was too slow.
    pub left_out: u64,
    /// Pose of the first camera in each frame, camera to world, OpenGL axes, 4 x 4 row-major; empty if it was not measured.
    pub camera_poses: Vec<Matrix>,
}

impl LiveFile {
    /// Reads the file of a log; `None` without one.
    pub(crate) fn read(log: &Path) -> Result<Option<Self>, LogError> {
        let path = log.join(LIVE_FILE);
        if !path.exists() {
            return Ok(None);
        }
        let read = serde_json::from_slice(&read_at_most(&path, LARGEST)?);
        read.map(Some).map_err(|reason| LogError::Json { path, reason })
    }
}
