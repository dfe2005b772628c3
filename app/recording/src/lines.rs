//! Lines of a recording's tables, and about.json and end.json, as they are serialised.

use mvt_feelsight::hand::{restored, stored};
use mvt_frames::camera::{Intrinsics, PosedCamera};
use mvt_frames::{Frame, Isometry};
use mvt_metrics::AddS;
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::{Hand, HandDescription, JointAngles, PerPad, Side};
use serde::{Deserialize, Serialize};

use super::{About, BlockPlace, RecordedMoment, Touching};
use mvt_run::estimator::Mode;
use mvt_run::report::{Deviation, FrameRow, ShapePoint, StageMs, TrackState};
use mvt_run::source::Modality;

/// Largest valid coordinate, metres.
const FARTHEST_M: f64 = 100.0;

/// Translation in metres and quaternion (w, x, y, z).
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Pose([f64; 7]);

impl Pose {
    fn of<A: Frame, B: Frame>(pose: Isometry<A, B>) -> Self {
        let ([x, y, z], [qw, qx, qy, qz]) = (pose.origin().coords().into(), pose.quaternion_wxyz());
        Self([x, y, z, qw, qx, qy, qz])
    }

    fn isometry<A: Frame, B: Frame>(self) -> Result<Isometry<A, B>, &'static str> {
        let [x, y, z, q @ ..] = self.0;
        let length = q.iter().map(|c| c * c).sum::<f64>();
        let is_near = [x, y, z].iter().all(|c| c.abs() <= FARTHEST_M);
        // Written so that NaN fails.
        if !(is_near && (0.25..4.0).contains(&length)) {
            return Err("invalid pose");
        }
        Ok(Isometry::from_parts([x, y, z], q))
    }
}

#[derive(Debug, Serialize, Deserialize)]
struct Camera {
    name: String,
    intrinsics: Intrinsics,
    pose: Pose,
}

/// about.json.
#[derive(Debug, Serialize, Deserialize)]
pub struct AboutFile {
    object: String,
    seed: u64,
    mode: String,
    modality: Modality,
    side: Side,
    /// Of another hand than the Allegro with TACTO's DIGITs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    hand: Option<HandDescription>,
    cameras: Vec<Camera>,
    /// Of recordings in which the hand has no profiles; of all its touch sensors.
    #[serde(default, skip_serializing)]
    touch_fov_y_deg: Option<f64>,
    #[serde(default, skip_serializing)]
    touch_bulge_mm: Option<f64>,
    frames: usize,
    process: u32,
    /// BlockPlace of the true shape in shapes.bin.
    truth: Option<BlockPlace>,
}

/// Part of about.json that every version has.
#[derive(Debug, Serialize, Deserialize)]
pub struct VersionFile {
    pub version: u32,
    #[serde(flatten)]
    pub rest: serde_json::Value,
}

impl AboutFile {
    pub fn new(about: &About, truth: Option<BlockPlace>) -> Self {
        let camera = |camera: &PosedCamera| Camera {
            name: camera.name.clone(),
            intrinsics: camera.intrinsics,
            pose: Pose::of(camera.pose),
        };
        Self {
            object: about.object.clone(),
            seed: about.seed,
            mode: about.mode.map_or(LOG, Mode::name).to_owned(),
            modality: about.modality,
            side: about.hand.side(),
            hand: stored(&about.hand).cloned(),
            cameras: about.cameras.iter().map(camera).collect(),
            touch_fov_y_deg: None,
            touch_bulge_mm: None,
            frames: about.frames,
            process: about.process,
            truth,
        }
    }

    pub fn about(self, version: u32) -> Result<(About, Option<BlockPlace>), String> {
        let camera = |Camera { name, intrinsics, pose }: Camera| {
            let k = intrinsics;
            let is_right = [k.fx, k.fy].iter().all(|f| (1.0..1e5).contains(f))
                && [k.cx, k.cy].iter().all(|c| c.abs() < 1e5)
                && [k.width, k.height].iter().all(|side| (1..=4096).contains(side));
            if is_right {
                Ok(PosedCamera { name, intrinsics, pose: pose.isometry()? })
            } else {
                Err("invalid camera intrinsics")
            }
        };
        let cameras = self.cameras.into_iter().map(camera).collect::<Result<_, &str>>()?;
        // A name may hold line ends.
        let hand = restored(self.side, self.hand).map_err(|error| error.to_string().replace(char::is_control, " "))?;
        let hand = if self.touch_fov_y_deg.is_none() && self.touch_bulge_mm.is_none() {
            hand
        } else {
            let mut profile = SensorProfile::tacto();
            profile.fov_y_deg = self.touch_fov_y_deg.unwrap_or(profile.fov_y_deg);
            profile.bulge_mm = self.touch_bulge_mm.unwrap_or(profile.bulge_mm);
            profile.validate().map_err(|error| format!("touch sensors: {error}"))?;
            hand.with_profile(&profile)
        };
        let about = About {
            version,
            object: self.object,
            seed: self.seed,
            mode: mode_of(&self.mode)?,
            modality: self.modality,
            hand,
            cameras,
            frames: self.frames,
            process: self.process,
        };
        Ok((about, self.truth))
    }
}

/// The mode of a raw log, in which nothing is estimated.
const LOG: &str = "log";

fn mode_of(name: &str) -> Result<Option<Mode>, &'static str> {
    match [Mode::Slam, Mode::Pose, Mode::Map].into_iter().find(|mode| mode.name() == name) {
        None if name != LOG => Err("unknown mode"),
        mode => Ok(mode),
    }
}

#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum State {
    Tracking,
    Lost,
    Relocalised,
}

/// Line of frames.jsonl.
#[derive(Debug, Serialize, Deserialize)]
pub struct FrameLine {
    frame: u64,
    time_s: f64,
    state: State,
    confidence: f64,
    /// Of surface and angle, metres and radians. Recordings of 0.1 have none.
    #[serde(default)]
    deviation: Option<[f64; 2]>,
    estimate: Pose,
    truth: Option<Pose>,
    add_s_m: Option<[f64; 2]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    add_m: Option<f64>,
    /// Sense, track, map and mesh.
    stage_ms: [f64; 4],
    joints: JointAngles,
    /// By pad.
    fingers: PerPad<Option<Touching>>,
    keyframe: bool,
    images: Option<BlockPlace>,
}

impl FrameLine {
    pub fn new(moment: &RecordedMoment) -> Self {
        let RecordedMoment { row, joints, touching, is_keyframe, images, .. } = moment;
        let StageMs { sense, track, map, mesh } = row.stage_ms;
        Self {
            frame: row.frame,
            time_s: row.time_s,
            state: match row.state {
                TrackState::Tracking => State::Tracking,
                TrackState::Lost | TrackState::Waiting => State::Lost,
                TrackState::Relocalised => State::Relocalised,
            },
            confidence: row.confidence,
            deviation: row.deviation.map(|d| [d.surface_m, d.angle_rad]),
            estimate: Pose::of(row.estimate),
            truth: row.truth.map(Pose::of),
            add_s_m: row.add_s.map(|error| [error.one_directional_m, error.symmetric_m]),
            add_m: row.add_m,
            stage_ms: [sense, track, map, mesh],
            joints: joints.clone(),
            fingers: touching.clone(),
            keyframe: *is_keyframe,
            images: *images,
        }
    }

    pub fn moment(self, hand: &Hand) -> Result<RecordedMoment, String> {
        let counts =
            [("joint angles", self.joints.len(), hand.joints().len()), ("pads", self.fingers.len(), hand.pads().len())];
        for (what, found, expected) in counts {
            if found != expected {
                return Err(format!("{found} {what}; hand {} has {expected}", hand.name()));
            }
        }
        if self.joints.iter().any(|angle| angle.abs() > 100.0) || self.time_s.abs() > 1e6 {
            return Err("invalid joint angle or time".to_owned());
        }
        let [sense, track, map, mesh] = self.stage_ms;
        let add_s = |[one_directional_m, symmetric_m]: [f64; 2]| AddS { one_directional_m, symmetric_m };
        Ok(RecordedMoment {
            row: FrameRow {
                frame: self.frame,
                time_s: self.time_s,
                state: match self.state {
                    State::Tracking => TrackState::Tracking,
                    State::Lost => TrackState::Lost,
                    State::Relocalised => TrackState::Relocalised,
                },
                confidence: self.confidence,
                deviation: self.deviation.map(|[surface_m, angle_rad]| Deviation { surface_m, angle_rad }),
                estimate: self.estimate.isometry()?,
                truth: self.truth.map(Pose::isometry).transpose()?,
                add_s: self.add_s_m.map(add_s),
                add_m: self.add_m,
                stage_ms: StageMs { sense, track, map, mesh },
            },
            joints: self.joints,
            touching: self.fingers,
            is_keyframe: self.keyframe,
            is_estimated: true,
            images: self.images,
        })
    }
}

/// Line of shapes.jsonl.
#[derive(Debug, Serialize, Deserialize)]
pub struct ShapeLine {
    pub frame: u64,
    pub point: Option<ShapePoint>,
    pub place: BlockPlace,
}

/// Line of events.jsonl.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EventLine {
    Event { time_s: f64, text: String },
    Warning(String),
}

/// end.json.
#[derive(Debug, Serialize, Deserialize)]
pub struct EndFile {
    pub complete: bool,
}
