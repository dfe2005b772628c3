//! Frames of a FeelSight log, ours or published, whole or with parts missing.

use std::collections::HashSet;
use std::mem::Discriminant;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, anyhow, bail};
use image::RgbImage;
use mvt_calibration::{Calibrated, Calibration, CalibrationConfig, CalibrationError, Calibrator};
use mvt_feelsight::{Log, LogSensor, PartialFrame, PartialFrames, TouchPart};
use mvt_frames::camera::PosedCamera;
use mvt_frames::{Isometry, MeshFile, Object};
use mvt_render::depth_noise;
use mvt_render::depth_noise::FrameId;
use mvt_robot::digit;
use mvt_robot::digit::gel::GelView;
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::{Finger, PerFinger, Side};
use mvt_robot::observation::SensorName;
use mvt_robot::rig::Placement;
use mvt_segmentation::{SegmentationConfig, percept};

use super::touch::{TouchNetwork, true_press};
use super::{Modality, Pictures, Sensed, Source};

/// A log, read frame by frame.
pub struct LogSource {
    folder: PathBuf,
    frames: PartialFrames,
    next: u32,
    last_s: Option<f64>,
    /// Frames from this time on are left out.
    until_s: f64,
    cameras: Vec<PosedCamera>,
    calibrator: Calibrator,
    /// Their numbers in the log.
    chosen: Vec<usize>,
    /// Multiple of Redwood's noise that is added to true depth.
    camera_noise: Option<f64>,
    segmentation: SegmentationConfig,
    gel: GelView,
    /// The touch network; without it the log's true indentation is used.
    network: Option<TouchNetwork>,
    /// From the coordinates in which the log has the object to ours.
    object_from_log: Isometry<Object, Object>,
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
}

impl LogSource {
    /// Opens a log. `cameras` are names or directions; without any the first camera is taken. `camera_noise` (a multiple of Redwood's
    /// level, 0 for none) is added to depths that are true, as NeuralFeels' loader does. `network` reads the log's touch
    /// images, from which each sensor's untouched image is subtracted; without it the log's true indentation is used.
    /// `calibration` says whether the poses of the cameras and the joint angles are refined.
    ///
    /// # Errors
    /// If the log cannot be used at all, has no such camera, or nothing that the modality needs.
    pub fn open(
        folder: &Path,
        cameras: Option<&str>,
        modality: Modality,
        camera_noise: f64,
        segmentation: SegmentationConfig,
        mut network: Option<TouchNetwork>,
        calibration: CalibrationConfig,
    ) -> Result<Self> {
        let log = Log::open_tolerant(folder)?;
        let mut warnings: Vec<String> = log.notes().to_vec();
        let names: Vec<&str> = log.cameras().iter().map(|camera| camera.name.as_str()).collect();
        let chosen = match cameras {
            _ if !modality.has_vision() => Vec::new(),
            None => vec![0],
            Some(list) => indices(folder, &names, list)?,
        };
        let posed: Vec<PosedCamera> = chosen.iter().filter_map(|&k| log.cameras().get(k).cloned()).collect();
        let is_simulated = Finger::ALL.into_iter().any(|finger| log.has_touch_truth(finger));
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
        let touch = match network {
            _ if !modality.has_touch() => TouchPart::None,
            None => TouchPart::Truth,
            Some(_) => TouchPart::Images,
        };
        if let Some(network) = network.as_mut().filter(|_| modality.has_touch()) {
            for finger in Finger::ALL {
                network.learn_empty(finger, &spread_images(&log, finger))?;
            }
        }
        let calibrator = Calibrator::new(calibration, log.side(), posed.clone());
        let frames = log.into_partial_frames(&chosen, touch);
        if !frames.has_sensor() {
            let reason = match frames.defects().first() {
                Some((_, defect)) => defect.to_string(),
                None if network.is_some() => format!("{}: there are no touch images", folder.display()),
                None => format!("{}: there is no true touch depth", folder.display()),
            };
            bail!("{reason}; --modality {}", modality.name());
        }
        warnings.dedup();
        Ok(Self {
            folder: folder.to_path_buf(),
            frames,
            next: 0,
            last_s: None,
            until_s: f64::INFINITY,
            cameras: posed,
            calibrator,
            chosen,
            network,
            camera_noise: (camera_noise > 0.0 && recorded_noise == 0.0).then_some(camera_noise),
            segmentation,
            object_from_log: Isometry::identity(),
            gel: GelView::tacto().clone(),
            wants_pictures: |_| true,
            uses_colours: true,
            told: HashSet::new(),
            warnings,
        })
    }

    /// Says which touch sensors the log was made with; without it, TACTO's.
    pub fn wear(&mut self, profile: &SensorProfile) {
        self.gel = profile.gel_view();
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
        self.calibrator.start_from(calibration)
    }

    /// Ends after this time.
    pub fn limit(&mut self, duration_s: f64) {
        self.until_s = self.log().times_s()[0] + duration_s;
    }

    /// The log.
    pub fn log(&self) -> &Log {
        self.frames.log()
    }

    /// Which hand.
    pub fn side(&self) -> Side {
        self.log().side()
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
            LogSensor::Touch(finger) => SensorName::Touch(finger),
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
    fn pictures(&self, number: u32, touch: PerFinger<RgbImage>) -> Pictures {
        if !(self.wants_pictures)(u64::from(number)) {
            return Pictures::default();
        }
        let (log, index) = (self.log(), number as usize);
        let is_felt = self.network.is_some();
        Pictures {
            touch: match is_felt {
                true => touch,
                false => PerFinger::from_fn(|finger| log.touch_image(finger, index).unwrap_or_default()),
            },
            true_touch_m: match is_felt {
                true => PerFinger::from_fn(|finger| Some(log.touch_truth(finger, index).ok()?.depth_m)),
                false => PerFinger::default(),
            },
            forces_n: None,
        }
    }

    /// Runs perception on a frame.
    fn sensed(&mut self, number: u32, frame: PartialFrame, begun: Instant) -> Result<Sensed> {
        for (sensor, error) in frame.defects {
            let name = self.name(sensor);
            self.warn(Some(sensor), &FrameDefect::Unreadable, || {
                format!("frame {number}: {name} is missing: {error}; such frames are used without it")
            });
        }
        let seed = self.seed();
        let mut depths_m = Vec::new();
        for (k, depth_m) in frame.cameras.into_iter().enumerate() {
            let depth_m = depth_m.unwrap_or_default();
            let wrong = depth_m.iter().filter(|z| !z.is_finite()).count();
            if wrong > 0 {
                let name = self.cameras[k].name.clone();
                self.warn(Some(LogSensor::Camera(k)), &FrameDefect::NoNumbers, || {
                    format!("frame {number}: {wrong} depths of camera {name} are not numbers and count as not measured")
                });
            }
            let id = FrameId { seed, camera: k as u32, frame: number };
            let depth_m = match self.camera_noise {
                Some(multiple) => depth_noise::disturb(&depth_m, multiple, id),
                None => depth_m,
            };
            depths_m.push(Some(depth_m));
        }
        let images = PerFinger(frame.touch_images.0.map(Option::unwrap_or_default));
        let side = self.side();
        let mut touch = match &mut self.network {
            None => PerFinger::from_fn(|finger| true_press(frame.touch_truth[finger].as_ref()?, &self.gel)),
            Some(network) => network.feel(u64::from(number), &images, &mut self.warnings)?,
        };
        let after = number as usize + 1;
        let next = self.log().times_s().get(after).copied().zip(self.log().joints().get(after).copied());
        let calibrated = self.calibrator.observe(frame.time_s, &frame.joints, next, &depths_m);
        calibrated.skip(&mut depths_m);
        if calibrated.is_frozen {
            touch = PerFinger::default();
        }
        let Calibrated { joints, cameras, warnings, .. } = calibrated;
        self.warnings.extend(warnings);
        let mut percept = percept(frame.time_s, joints, depths_m, touch, &cameras, side, &self.segmentation)
            .map_err(|error| anyhow!("{}: frame {number}: {error}", self.folder.display()))?;
        if self.uses_colours || (self.wants_pictures)(u64::from(number)) {
            let mut colours = Vec::new();
            for k in self.chosen.clone() {
                let colour = if self.log().has_colours(k) {
                    self.log().colour(k, number as usize)
                } else {
                    Ok(RgbImage::default())
                };
                colours.push(colour.unwrap_or_else(|error| {
                    self.warn(Some(LogSensor::Camera(k)), &FrameDefect::Colours, || {
                        format!("frame {number}: {error}; such frames are used without these colours")
                    });
                    RgbImage::default()
                }));
            }
            percept.set_colours(colours);
        }
        let truth = frame.object_pose.map(|pose| pose * self.object_from_log.inverse());
        let warnings = std::mem::take(&mut self.warnings);
        let sense_ms = begun.elapsed().as_secs_f64() * 1e3;
        let pictures = self.pictures(number, images);
        Ok(Sensed {
            frame: u64::from(number),
            percept,
            truth,
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

    fn gel(&self) -> &GelView {
        &self.gel
    }

    fn frame_count(&self) -> usize {
        self.log().times_s().iter().filter(|&&time_s| time_s < self.until_s).count()
    }

    fn end(&self) -> (String, bool) {
        ("the log ended".to_owned(), true)
    }

    fn calibration(&self) -> Option<Calibration> {
        self.calibrator.refined()
    }
}

/// Number of images, spread over a log, from which a sensor's untouched image is estimated.
const UNTOUCHED_FROM: usize = 31;
/// In a shorter log an object may stay at one place of a gel, seconds.
const UNTOUCHED_SPAN_S: f64 = 10.0;

/// Images of a sensor over a log's length; empty if the log is too short or too few can be read.
fn spread_images(log: &Log, finger: Finger) -> Vec<RgbImage> {
    let times_s = log.times_s();
    let span_s = times_s.last().zip(times_s.first()).map_or(0.0, |(last, first)| last - first);
    if span_s < UNTOUCHED_SPAN_S {
        return Vec::new();
    }
    let every = times_s.len().div_ceil(UNTOUCHED_FROM).max(1);
    let size = (digit::WIDTH as u32, digit::HEIGHT as u32);
    let images = (0..times_s.len()).step_by(every).filter_map(|i| log.touch_image(finger, i).ok());
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
