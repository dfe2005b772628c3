//! A FeelSight log, looked at as if it were a recording.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use image::GrayImage;
use ndarray::Array2;
use perception::{SegmentationConfig, segment};
use scenes::camera::PosedCamera;
use scenes::frame::Isometry;
use scenes::hand::PerFinger;
use scenes::hand::solid::HandSolid;
use scenes::mesh::Mesh;
use sim::feelsight::{Log, TouchPart};

use super::{About, CameraImages, FingerImages, Images, Moment, RecordingError, VERSION, images};
use crate::report::{FrameRow, StageMs, TrackState};
use crate::subject::load_object;

/// Images of a log. Depths lie in one compressed file and are read in the background; the rest is read when it is asked for.
pub struct LogImages {
    log: Log,
    strides: Vec<usize>,
    depths: Arc<Depths>,
}

/// Thinned depths of every camera, frame by frame.
#[derive(Default)]
struct Depths {
    frames: Mutex<Vec<Vec<Option<Array2<f32>>>>>,
    /// Nothing comes any more.
    is_complete: AtomicBool,
    /// Nobody wants more.
    is_unwanted: AtomicBool,
}

impl Drop for LogImages {
    fn drop(&mut self) {
        self.depths.is_unwanted.store(true, Ordering::Relaxed);
    }
}

/// A log with what is known of it at once: what it is, its frames, the true surface, and what was amiss.
type Opened = (LogImages, About, Vec<Moment>, Option<Mesh>, Vec<String>);

impl LogImages {
    /// Opens a log.
    pub fn open(folder: &Path) -> Result<Opened, RecordingError> {
        let log = Log::open_tolerant(folder)?;
        let mut warnings = log.notes().to_vec();
        let strides: Vec<usize> = log.cameras().iter().map(|camera| images::stride(&camera.intrinsics)).collect();
        let name = log.scene().map_or(log.object_name(), |scene| &scene.object.mesh).to_owned();
        let object = load_object(&name)
            .map_err(|error| warnings.push(format!("{error:#}; going on without the true shape")))
            .ok();
        // A log without scene.json has the poses of the published mesh.
        let object_from_log = match (&object, log.scene()) {
            (Some(object), None) => Isometry::new(object.object_from_file.untyped()),
            _ => Isometry::identity(),
        };
        let about = About {
            version: VERSION,
            object: name,
            seed: log.scene().map_or(0, |scene| scene.seed),
            mode: "log".to_owned(),
            modality: "vitac".to_owned(),
            side: log.side(),
            cameras: log
                .cameras()
                .iter()
                .map(|camera| PosedCamera { intrinsics: images::shrunk(&camera.intrinsics), ..camera.clone() })
                .collect(),
            frames: log.len(),
            process: std::process::id(),
        };
        let moment = |k: usize| {
            let truth = log.object_poses()[k].map(|pose| pose * object_from_log.inverse());
            Moment {
                row: FrameRow {
                    frame: k as u64,
                    time_s: log.times_s()[k],
                    state: TrackState::Tracking,
                    confidence: 1.0,
                    estimate: truth.unwrap_or_else(Isometry::identity),
                    truth,
                    add_s: None,
                    stage_ms: StageMs::default(),
                },
                joints: log.joints()[k],
                fingers: PerFinger::default(),
                is_keyframe: false,
                is_estimated: false,
                images: None,
            }
        };
        let moments = (0..log.len()).map(moment).collect();
        let depths = Arc::new(Depths::default());
        let (others, thinning) = (Arc::clone(&depths), strides.clone());
        // A second reader: the first one serves images.
        let frames =
            Log::open_tolerant(folder)?.into_partial_frames(&(0..strides.len()).collect::<Vec<_>>(), TouchPart::None);
        thread::spawn(move || {
            for frame in frames {
                if others.is_unwanted.load(Ordering::Relaxed) {
                    return;
                }
                let thin = |(depth, &stride): (Option<Array2<f32>>, &usize)| {
                    depth.map(|depth_m| {
                        images::thinned_depth(&depth_m, stride).mapv(|z| if z.is_finite() { z.max(0.0) } else { 0.0 })
                    })
                };
                let depths = frame.cameras.into_iter().zip(&thinning).map(thin).collect();
                others.frames.lock().unwrap_or_else(PoisonError::into_inner).push(depths);
            }
            others.is_complete.store(true, Ordering::Relaxed);
        });
        Ok((Self { log, strides, depths }, about, moments, object.map(|object| object.mesh), warnings))
    }

    /// Whether all there is of a frame's images has been read.
    pub fn is_read(&self, frame: usize) -> bool {
        self.depths.is_complete.load(Ordering::Relaxed) || frame < self.depths().len()
    }

    /// Waits for the last of them.
    pub fn finish(&self) {
        while !self.depths.is_complete.load(Ordering::Relaxed) {
            thread::sleep(Duration::from_millis(20));
        }
    }

    fn depths(&self) -> std::sync::MutexGuard<'_, Vec<Vec<Option<Array2<f32>>>>> {
        self.depths.frames.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The images of a frame as far as they can be read.
    pub fn images(&self, frame: usize) -> Images {
        let depths = self.depths().get(frame).cloned().unwrap_or_default();
        let joints = self.log.joints().get(frame).copied().unwrap_or_default();
        let hand = HandSolid::new(self.log.side(), &joints);
        let camera = |(k, (camera, &stride)): (usize, (&PosedCamera, &usize))| {
            let colour = self.log.colour(k, frame).map(|colour| images::thinned(&colour, stride)).unwrap_or_default();
            let depth_m = depths.get(k).cloned().flatten().unwrap_or_default();
            let segmentation = if depth_m.is_empty() {
                GrayImage::default()
            } else {
                let intrinsics = images::shrunk(&camera.intrinsics);
                segment(&depth_m, &intrinsics, camera.pose, &hand, &SegmentationConfig::default())
            };
            Some(CameraImages { colour, depth_m, segmentation })
        };
        let cameras = self.log.cameras().iter().zip(&self.strides).enumerate().map(camera).collect();
        let touch = PerFinger::from_fn(|finger| {
            let image = self.log.touch_image(finger, frame).ok();
            let truth = self.log.touch_truth(finger, frame).ok();
            if image.is_none() && truth.is_none() {
                return None;
            }
            let truth = truth.unwrap_or_default();
            Some(FingerImages {
                image: image.unwrap_or_default(),
                depth_m: truth.depth_m,
                contact: truth.contact,
                true_depth_m: None,
            })
        });
        Images { frame, cameras, touch }
    }
}
