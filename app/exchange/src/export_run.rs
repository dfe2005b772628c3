//! A run as an MCAP file.

use std::path::Path;

use mvt_recording::Recording;

use crate::error::ExchangeError;
use crate::export_mcap::{Exported, write_mcap};
use crate::run_messages::RunMessages;

/// Writes the recording of a run as an MCAP file with Foxglove's protobuf schemas. `advance` is called after each frame.
///
/// | channel | schema | contents |
/// |---|---|---|
/// | `/tf` | FrameTransforms | frames of all cameras and touch sensors, `estimate`, the estimated pose of the object, and `object`, the true one where it is known, in `world` |
/// | `/hand/joints` | JointStates | angles, rad |
/// | `/camera/NAME/color`, `/depth`, `/points`, `/calibration` | CompressedImage, RawImage, PointCloud, CameraCalibration | of the recorded images: every third frame, reduced; depth in metres |
/// | `/touch/PAD/image`, `/depth` | CompressedImage, RawImage | images of the touch sensors, and the depth that the tracker received, metres |
/// | `/estimate/mesh` | SceneUpdate | the shape whenever it grew, in the frame `estimate` |
/// | `/estimate/state` | mambavitact.Estimate | whether the tracker trusts the pose, its stated deviation, and ADD-S where the truth is known |
/// | `/estimate/scores` | mambavitact.ShapeScores | scores of the shape, where the true one is known |
/// | `/truth/mesh` | SceneUpdate | the true shape, where it is known, in the frame `object` |
/// | `/events` | Log | events and warnings |
///
/// # Errors
/// [`ExchangeError`]; an incomplete file never has the name `out`.
pub fn export_run(
    recording: &Recording,
    out: &Path,
    overwrite: bool,
    mut advance: impl FnMut(),
) -> Result<Exported, ExchangeError> {
    write_mcap(out, overwrite, |file, io| {
        let mut messages = RunMessages::new(file, recording).map_err(io)?;
        for number in 0..recording.moments().len() {
            messages.moment(recording, number, true, file, io)?;
            advance();
        }
        Ok(recording.moments().len())
    })
}
