//! Frames of a FeelSight log, ours or published, whole or with parts missing.

use std::collections::HashSet;
use std::mem::Discriminant;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Result, anyhow, bail, ensure};
use image::RgbImage;
use mvt_calibration::{Calibration, CalibrationError};
use mvt_feelsight::{Log, LogSensor, PartialFrame, PartialFrames, TouchPart};
use mvt_frames::camera::PosedCamera;
use mvt_frames::depth::{GivenLabels, Label};
use mvt_frames::{Camera, Isometry, MeshFile, Object, World};
use mvt_perceive::{LabelSource, Perception, PerceptionConfig, PerceptionSetup, Seen, true_press};
use mvt_render::depth_noise;
use mvt_render::depth_noise::FrameId;
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::{Hand, PerPad};
use mvt_robot::observation::{Observation, Rgbd, SensorName};
use mvt_robot::rig::Placement;
use ndarray::Array2;

use super::{Modality, Pictures, Sensed, Source, TouchArguments};

/// A log, read frame by frame.
pub struct LogSource {
    folder: PathBuf,
    /// The hand of the log, or with other touch sensors.
    hand: Arc<Hand>,
    frames: PartialFrames,
    next: u32,
    last_s: Option<f64>,
    /// Frames from this time on are left out.
    until_s: f64,
    cameras: Vec<PosedCamera>,
    perception: Perception,
    /// Their numbers in the log.
    chosen: Vec<usize>,
    /// Multiple of Redwood's noise that is added to true depth.
    camera_noise: Option<f64>,
    /// From the coordinates in which the log has the object to ours.
    object_from_log: Isometry<Object, Object>,
    /// Whether the labels of the log are read in place of labelling from the hand's geometry.
    reads_labels: bool,
    /// Whether the pictures of a frame, by its number, are wanted.
    wants_pictures: fn(u64) -> bool,
    /// Whether the estimation uses the colours of the cameras, so that those of all frames are read.
    uses_colours: bool,
    told: HashSet<(Option<LogSensor>, Discriminant<FrameDefect>)>,
    warnings: Vec<String>,
}

/// A defect of a frame.
enum FrameDefect {
    Unreadable,
    NoNumbers,
    Time,
    Colours,
    Labels,
}

impl LogSource {
    /// Opens a log. `cameras` are names or directions; without any the first camera is taken. `camera_noise` (a multiple of Redwood's
    /// level, 0 for none) is added to depths that are true, as NeuralFeels' loader does. Unless `touch` chooses the
    /// log's true indentation, networks read its touch images, from which each sensor's untouched image is subtracted. The sensors are those of
    /// the log, or the given one.
    ///
    /// # Errors
    /// If the log cannot be used at all, has no such camera, or nothing that the modality needs.
    pub fn open(
        folder: &Path,
        cameras: Option<&str>,
        modality: Modality,
        camera_noise: f64,
        touch: &TouchArguments,
        config: PerceptionConfig,
    ) -> Result<Self> {
        let log = Log::open_tolerant(folder)?;
        let mut warnings: Vec<String> = log.notes().to_vec();
        let hand = touch.equipped(log.hand())?;
        if log.scene().is_some() && hand != *log.hand() {
            warnings.push(format!(
                "{}: the log was made with other touch sensors than --touch-profile; leave it out to use those of the log",
                folder.display()
            ));
        }
        let weights = touch.weights(&hand)?.filter(|_| modality.has_touch());
        let reads_labels = config.segmentation.labels == LabelSource::Given && modality.has_vision();
        ensure!(
            !reads_labels || log.has_labels(),
            "{}: there are no labels of all images (seg/); leave out segmentation.labels=given to label from the hand's geometry",
            folder.display()
        );
        let names: Vec<&str> = log.cameras().iter().map(|camera| camera.name.as_str()).collect();
        let chosen = match cameras {
            _ if !modality.has_vision() => Vec::new(),
            None => vec![0],
            Some(list) => indices(folder, &names, list)?,
        };
        let posed: Vec<PosedCamera> = chosen.iter().filter_map(|&k| log.cameras().get(k).cloned()).collect();
        let is_simulated = (0..log.hand().pads().len()).any(|pad| log.has_touch_truth(pad));
        let recorded_noise = match log.scene() {
            Some(scene) => scene.noise.get("camera_depth_multiple_of_redwood").copied().unwrap_or(0.0),
            None => {
                if is_simulated {
                    0.0
                } else {
                    1.0
                }
            }
        };
        let mut perception =
            Perception::new(Arc::clone(&hand), posed.clone(), &PerceptionSetup { weights: weights.as_ref(), config });
        let touch = match perception.reads_touch_images() {
            _ if !modality.has_touch() => TouchPart::None,
            false => TouchPart::Truth,
            true => TouchPart::Images,
        };
        // A live run knew none of the later images.
        if touch == TouchPart::Images && log.live().is_none() {
            for (pad, of) in hand.pads().iter().enumerate() {
                perception.learn_untouched(pad, &spread_images(&log, pad, &of.profile))?;
            }
        }
        let frames = log.into_partial_frames(&chosen, touch);
        if !frames.has_sensor() {
            let reason = match frames.defects().first() {
                Some((_, defect)) => defect.to_string(),
                None if perception.reads_touch_images() => format!("{}: there are no touch images", folder.display()),
                None => format!("{}: there is no true touch depth", folder.display()),
            };
            bail!("{reason}; --modality {}", modality.name());
        }
        warnings.dedup();
        Ok(Self {
            folder: folder.to_path_buf(),
            hand,
            frames,
            next: 0,
            last_s: None,
            until_s: f64::INFINITY,
            cameras: posed,
            perception,
            chosen,
            camera_noise: (camera_noise > 0.0 && recorded_noise == 0.0).then_some(camera_noise),
            object_from_log: Isometry::identity(),
            reads_labels,
            wants_pictures: |_| true,
            uses_colours: true,
            told: HashSet::new(),
            warnings,
        })
    }

    /// Reads pictures only of frames whose number satisfies `wanted`; without this call, of all. The colours of cameras are read for
    /// all frames if the estimation `uses_colours`.
    pub fn limit_pictures(&mut self, wanted: fn(u64) -> bool, uses_colours: bool) {
        (self.wants_pictures, self.uses_colours) = (wanted, uses_colours);
    }

    /// Starts from a calibration that was measured before, in place of the given one.
    ///
    /// # Errors
    /// If a number of it is invalid.
    pub fn start_from(&mut self, calibration: &Calibration) -> Result<(), CalibrationError> {
        self.perception.start_from(calibration)
    }

    /// Ends after this time.
    pub fn limit(&mut self, duration_s: f64) {
        self.until_s = self.log().times_s()[0] + duration_s;
    }

    /// The log.
    pub fn log(&self) -> &Log {
        self.frames.log()
    }

    /// Seed of the episode; 0 where it is unknown.
    pub fn seed(&self) -> u64 {
        self.log().scene().map_or(0, |scene| scene.seed)
    }

    /// The object as the log names it: a name in the catalogue, or the path of a mesh.
    pub fn object(&self) -> &str {
        self.log().scene().map_or(self.log().object_name(), |scene| &scene.object.mesh)
    }

    /// Says how the published mesh, whose poses a log without scene.json holds, lies in the object's frame.
    pub fn set_object_from_file(&mut self, object_from_file: Isometry<MeshFile, Object>) {
        if self.log().scene().is_none() {
            self.object_from_log = Isometry::new(object_from_file.untyped());
        }
    }

    /// Keeps a warning unless there was one of the kind from this sensor.
    fn warn(&mut self, sensor: Option<LogSensor>, defect: &FrameDefect, text: impl FnOnce() -> String) {
        if self.told.insert((sensor, std::mem::discriminant(defect))) {
            self.warnings.push(text());
        }
    }

    fn name(&self, sensor: LogSensor) -> SensorName {
        match sensor {
            LogSensor::Touch(pad) => {
                SensorName::Touch(self.log().hand().pads().get(pad).map_or_else(String::new, |pad| pad.name.clone()))
            }
            LogSensor::Camera(k) => {
                SensorName::Camera(self.log().cameras().get(k).map_or_else(String::new, |c| c.name.clone()))
            }
        }
    }

    /// The cameras that are read.
    pub fn cameras(&self) -> &[PosedCamera] {
        &self.cameras
    }

    /// Touch images of a frame for recordings; `touch` are those that were read already, if any. An image that cannot be read is left
    /// out: nothing depends on it.
    fn pictures(&self, number: u32, touch: PerPad<RgbImage>) -> Pictures {
        if !(self.wants_pictures)(u64::from(number)) {
            return Pictures::default();
        }
        let (log, index) = (self.log(), number as usize);
        let is_felt = self.perception.reads_touch_images();
        Pictures {
            touch: match is_felt {
                true => touch,
                false => log.hand().per_pad(|pad| log.touch_image(pad, index).unwrap_or_default()),
            },
            true_indentation_mm: match is_felt {
                true => log.hand().per_pad(|pad| {
                    self.hand.gel_views().get(pad)?.indentation_of(&log.touch_truth(pad, index).ok()?.depth_m)
                }),
                false => PerPad::default(),
            },
            forces_n: None,
        }
    }

    /// The depth of a chosen camera, with noise where it is true; empty where it was not delivered.
    fn depth(&mut self, number: u32, k: usize, depth_m: Option<Array2<f32>>) -> Array2<f32> {
        let depth_m = depth_m.unwrap_or_default();
        let wrong = depth_m.iter().filter(|z| !z.is_finite()).count();
        if wrong > 0 {
            let name = self.cameras[k].name.clone();
            self.warn(Some(LogSensor::Camera(k)), &FrameDefect::NoNumbers, || {
                format!("frame {number}: {wrong} depths of camera {name} are not numbers and count as not measured")
            });
        }
        match self.camera_noise {
            Some(multiple) => {
                let id = FrameId { seed: self.seed(), camera: k as u32, frame: number };
                depth_noise::disturb(&depth_m, multiple, id)
            }
            None => depth_m,
        }
    }

    /// The colours of the log's camera `k`; empty where they are missing.
    fn colour(&mut self, number: u32, k: usize) -> RgbImage {
        if !self.log().has_colours(k) {
            return RgbImage::default();
        }
        self.log().colour(k, number as usize).unwrap_or_else(|error| {
            self.warn(Some(LogSensor::Camera(k)), &FrameDefect::Colours, || {
                format!("frame {number}: {error}; such frames are used without these colours")
            });
            RgbImage::default()
        })
    }

    /// The labels of the log's camera `k`, if they are read. A live run had masks, in some frames.
    fn labels(&mut self, number: u32, k: usize) -> Option<GivenLabels> {
        if self.log().live().is_some() {
            let labels = self.log().labels(k, number as usize).ok()?;
            return Some(GivenLabels::Mask(labels.mapv(|label| label == Label::Object)));
        }
        let labels = self.reads_labels.then(|| self.log().labels(k, number as usize))?;
        match labels {
            Ok(labels) => Some(GivenLabels::Labels(labels)),
            Err(error) => {
                self.warn(Some(LogSensor::Camera(k)), &FrameDefect::Labels, || {
                    format!("frame {number}: {error}; such frames are used without this camera")
                });
                None
            }
        }
    }

    /// The pose of the log's camera `k` in a frame, where a live run measured it.
    fn measured_pose(&self, number: u32, k: usize) -> Result<Option<Isometry<Camera, World>>> {
        let poses = self.log().live().filter(|_| k == 0).map(|live| live.camera_poses.as_slice()).unwrap_or_default();
        let pose = poses.get(number as usize).map(Isometry::from_matrix).transpose();
        pose.map_err(|reason| anyhow!("{}: frame {number}: the pose of the camera is {reason}", self.folder.display()))
    }

    /// Runs perception on a frame.
    fn sensed(&mut self, number: u32, frame: PartialFrame, begun: Instant) -> Result<Sensed> {
        for (sensor, error) in frame.defects {
            let name = self.name(sensor);
            self.warn(Some(sensor), &FrameDefect::Unreadable, || {
                format!("frame {number}: {name} is missing: {error}; such frames are used without it")
            });
        }
        let depths_m = frame.cameras.into_iter().enumerate().map(|(k, depth_m)| self.depth(number, k, depth_m));
        let depths_m: Vec<Array2<f32>> = depths_m.collect();
        let wants_colours = self.uses_colours || (self.wants_pictures)(u64::from(number));
        let colours: Vec<RgbImage> = match wants_colours {
            true => self.chosen.clone().into_iter().map(|k| self.colour(number, k)).collect(),
            false => Vec::new(),
        };
        let (mut colours, mut cameras) = (colours.into_iter(), Vec::new());
        for (k, mut depth_m) in self.chosen.clone().into_iter().zip(depths_m) {
            let labels = self.labels(number, k);
            if self.reads_labels && labels.is_none() {
                depth_m = Array2::default((0, 0));
            }
            let world_from_camera = self.measured_pose(number, k)?;
            cameras.push(Rgbd { color: colours.next().unwrap_or_default(), depth_m, labels, world_from_camera });
        }
        let observation = Observation {
            time_s: frame.time_s,
            joints: frame.joints,
            touch: frame.touch_images.into_iter().map(Option::unwrap_or_default).collect(),
            cameras,
        };
        let truths = frame.touch_truth.iter().zip(self.hand.gel_views().iter());
        let presses = truths.map(|(truth, gel)| true_press(truth.as_ref()?, gel)).collect();
        let presses = (!self.perception.reads_touch_images()).then_some(presses);
        // Why: notes/decisions/calibration.md, "A log's joints are interpolated to the time of the images, with the next reading".
        let after = number as usize + 1;
        let log = self.frames.log();
        if log.live().is_none()
            && let (Some(&time_s), Some(joints)) = (log.times_s().get(after), log.joints().get(after))
        {
            self.perception.set_next_joints(time_s, joints.clone());
        }
        let seen = self.perception.see(u64::from(number), observation, presses);
        let Seen { percept, touch_images, warnings } =
            seen.map_err(|error| anyhow!("{}: frame {number}: {error}", self.folder.display()))?;
        self.warnings.extend(warnings);
        let truth = frame.object_pose.map(|pose| pose * self.object_from_log.inverse());
        let warnings = std::mem::take(&mut self.warnings);
        let sense_ms = begun.elapsed().as_secs_f64() * 1e3;
        let pictures = self.pictures(number, touch_images);
        Ok(Sensed {
            frame: u64::from(number),
            percept,
            truth,
            carried: None,
            pictures,
            sense_ms,
            hidden: None,
            warnings,
            events: Vec::new(),
        })
    }
}

impl Source for LogSource {
    fn next(&mut self) -> Result<Option<Sensed>> {
        let begun = Instant::now();
        while let Some(frame) = self.frames.next() {
            let number = self.next;
            self.next += 1;
            if self.last_s.is_some_and(|last_s| frame.time_s <= last_s) {
                self.warn(None, &FrameDefect::Time, || {
                    format!(
                        "frame {number}: its time is not after the time of the frame before; such frames are skipped"
                    )
                });
                continue;
            }
            if frame.time_s >= self.until_s {
                break;
            }
            self.last_s = Some(frame.time_s);
            return self.sensed(number, frame, begun).map(Some);
        }
        Ok(None)
    }

    fn hand(&self) -> &Arc<Hand> {
        &self.hand
    }

    fn frame_count(&self) -> usize {
        self.log().times_s().iter().filter(|&&time_s| time_s < self.until_s).count()
    }

    fn end(&self) -> (String, bool) {
        ("the log ended".to_owned(), true)
    }

    fn calibration(&self) -> Option<Calibration> {
        self.perception.calibration()
    }
}

/// Number of images, spread over a log, from which a sensor's untouched image is estimated.
const UNTOUCHED_FROM: usize = 31;
/// In a shorter log an object may stay at one place of a gel, seconds.
const UNTOUCHED_SPAN_S: f64 = 10.0;

/// Images of a sensor over a log's length; empty if too few can be read, or the log is too short and the sensor can be read without.
fn spread_images(log: &Log, pad: usize, profile: &SensorProfile) -> Vec<RgbImage> {
    let times_s = log.times_s();
    let span_s = times_s.last().zip(times_s.first()).map_or(0.0, |(last, first)| last - first);
    if span_s < UNTOUCHED_SPAN_S && profile.appearance.is_none() {
        return Vec::new();
    }
    let every = times_s.len().div_ceil(UNTOUCHED_FROM).max(1);
    let size = profile.size_px.map(|px| px as u32).into();
    let images = (0..times_s.len()).step_by(every).filter_map(|i| log.touch_image(pad, i).ok());
    let images: Vec<RgbImage> = images.filter(|image| image.dimensions() == size).collect();
    if images.len() > UNTOUCHED_FROM / 2 { images } else { Vec::new() }
}

/// Indices of the cameras in a comma-separated list of names, or of directions from which a log was made.
fn indices(folder: &Path, names: &[&str], list: &str) -> Result<Vec<usize>> {
    let mut indices = Vec::new();
    for name in list.split(',').map(str::trim) {
        let direction = Placement::parse_list(name).ok().and_then(|mut places| places.pop());
        let wanted = direction.as_ref().map_or(name, |place| &place.name);
        match names.iter().position(|known| *known == wanted) {
            Some(k) if indices.contains(&k) => {}
            Some(k) => indices.push(k),
            None => bail!("{}: there is no camera {name:?}; there are {}", folder.display(), names.join(", ")),
        }
    }
    Ok(indices)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_of_a_log_are_chosen_by_name_or_direction() {
        let chosen = |list| indices(Path::new("log"), &["az30el-35", "occlusion-000", "side"], list);
        assert_eq!(chosen("side, 30/-35,side").unwrap(), [2, 0]);
        assert_eq!(chosen("occlusion-000,az30el-35").unwrap(), [1, 0]);
        for wrong in ["front-left", "30/35", ""] {
            let error = chosen(wrong).unwrap_err().to_string();
            assert!(error.contains("there are az30el-35, occlusion-000, side"), "{error}");
        }
    }
}
