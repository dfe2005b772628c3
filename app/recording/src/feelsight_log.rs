//! Presents a FeelSight log as a recording.

use mvt_perceive::true_press;
use mvt_run::source::Modality;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use mvt_feelsight::{Log, TouchPart};
use mvt_frames::Isometry;
use mvt_frames::camera::PosedCamera;
use mvt_mesh::Mesh;
use mvt_robot::digit::gel::GelView;
use mvt_robot::hand::PerPad;
use mvt_robot::hand::solid::HandSolid;
use mvt_robot::observation::TouchTruth;
use mvt_run::object::load_object;
use mvt_run::report::{FrameRow, StageMs, TrackState};
use mvt_segmentation::{SegmentationConfig, segment};
use ndarray::Array2;

use super::{About, CameraImages, FrameImages, RecordedMoment, RecordingError, TouchImages, Touching, VERSION, images};

/// Images of a log. A background thread reads the contacts and the camera depths, which lie in one compressed file;
/// other images are read on request.
pub struct LogImages {
    log: Log,
    strides: Vec<usize>,
    background: Arc<Background>,
    /// Number of frames whose contacts were added to the moments.
    with_contacts: usize,
}

/// Data that the background thread reads, frame by frame.
#[derive(Default)]
struct Background {
    frames: Mutex<Vec<Read>>,
    /// The thread has ended.
    is_complete: AtomicBool,
    /// The thread should end.
    is_unwanted: AtomicBool,
}

impl Background {
    fn frames(&self) -> MutexGuard<'_, Vec<Read>> {
        self.frames.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Data of a frame.
struct Read {
    /// Thinned depth of every camera, packed. Unpacked, three cameras and 30 s would take a gigabyte.
    depths: Vec<Option<Vec<u8>>>,
    touching: PerPad<Option<Touching>>,
}

impl Drop for LogImages {
    fn drop(&mut self) {
        self.background.is_unwanted.store(true, Ordering::Relaxed);
    }
}

/// Log with its description, its frames, the true surface and the warnings.
type Opened = (LogImages, About, Vec<RecordedMoment>, Option<Mesh>, Vec<String>);

impl LogImages {
    /// Opens a log.
    pub fn open(folder: &Path) -> Result<Opened, RecordingError> {
        let log = Log::open_tolerant(folder)?;
        let mut warnings = log.notes().to_vec();
        let strides: Vec<usize> = log.cameras().iter().map(|camera| images::stride(&camera.intrinsics)).collect();
        let name = log.scene().map_or(log.object_name(), |scene| &scene.object.mesh).to_owned();
        let object = load_object(&name)
            .map_err(|error| warnings.push(format!("{error:#}; continuing without the true shape")))
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
            mode: None,
            modality: Modality::Vitac,
            hand: Arc::clone(log.hand()),
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
            RecordedMoment {
                row: FrameRow {
                    frame: k as u64,
                    time_s: log.times_s()[k],
                    state: TrackState::Tracking,
                    confidence: 1.0,
                    deviation: None,
                    estimate: truth.unwrap_or_else(Isometry::identity),
                    truth,
                    add_s: None,
                    add_m: None,
                    stage_ms: StageMs::default(),
                },
                joints: log.joints()[k].clone(),
                touching: log.hand().per_pad(|_| None),
                is_keyframe: false,
                is_estimated: false,
                images: None,
            }
        };
        let moments = (0..log.len()).map(moment).collect();
        let background = Arc::new(Background::default());
        let (others, hand, thinning) = (Arc::clone(&background), Arc::clone(log.hand()), strides.clone());
        // A second reader, because the first one serves images.
        let frames =
            Log::open_tolerant(folder)?.into_partial_frames(&(0..strides.len()).collect::<Vec<_>>(), TouchPart::Truth);
        thread::spawn(move || {
            for frame in frames {
                if others.is_unwanted.load(Ordering::Relaxed) {
                    return;
                }
                let depths = frame.cameras.into_iter().zip(&thinning).map(|(depth_m, &stride)| {
                    let depth_m = images::thinned_array(&depth_m?, stride);
                    images::pack_depth(&depth_m.mapv(|z| if z.is_finite() { z } else { 0.0 })).ok()
                });
                let depths = depths.collect();
                let touching =
                    |(truth, gel): (Option<TouchTruth>, &GelView)| Touching::of(&true_press(&truth?, gel)?, gel, None);
                let touched = frame.touch_truth.into_iter().zip(hand.gel_views().iter());
                let read = Read { depths, touching: touched.map(touching).collect() };
                others.frames().push(read);
            }
            others.is_complete.store(true, Ordering::Relaxed);
        });
        Ok((
            Self { log, strides, background, with_contacts: 0 },
            about,
            moments,
            object.map(|object| object.mesh),
            warnings,
        ))
    }

    /// Whether the background thread has read a frame.
    pub fn is_read(&self, frame: usize) -> bool {
        self.background.is_complete.load(Ordering::Relaxed) || frame < self.background.frames().len()
    }

    /// Whether all frames were read and their contacts added.
    pub fn is_complete(&self) -> bool {
        self.background.is_complete.load(Ordering::Relaxed) && self.with_contacts == self.background.frames().len()
    }

    /// Waits until all frames were read.
    pub fn finish(&self) {
        while !self.background.is_complete.load(Ordering::Relaxed) {
            thread::sleep(Duration::from_millis(20));
        }
    }

    /// Adds newly read contacts to the moments. Returns whether there were any.
    pub fn add_contacts(&mut self, moments: &mut [RecordedMoment]) -> bool {
        let before = self.with_contacts;
        let frames = self.background.frames();
        for (moment, read) in moments.iter_mut().zip(&*frames).skip(before) {
            moment.touching = read.touching.clone();
        }
        self.with_contacts = frames.len();
        self.with_contacts > before
    }

    /// Returns the images of a frame that can be read.
    pub fn images(&self, frame: usize) -> FrameImages {
        let depths = self.background.frames().get(frame).map(|read| read.depths.clone()).unwrap_or_default();
        let joints = self.log.joints().get(frame).cloned().unwrap_or_default();
        let (solid, grasp) = (HandSolid::new(self.log.hand(), &joints), self.log.hand().grasp_centre(&joints));
        let camera = |(k, (camera, &stride)): (usize, (&PosedCamera, &usize))| {
            let colour = self.log.colour(k, frame).map(|colour| images::thinned(&colour, stride)).unwrap_or_default();
            let packed = depths.get(k).and_then(Option::as_ref);
            let depth_m = packed.and_then(|packed| images::unpack_depth(packed).ok()).unwrap_or_default();
            let labels = if depth_m.is_empty() {
                Array2::default((0, 0))
            } else {
                let intrinsics = images::shrunk(&camera.intrinsics);
                segment(&depth_m, &intrinsics, camera.pose, &solid, grasp, &SegmentationConfig::default())
            };
            Some(CameraImages { colour, depth_m, labels })
        };
        let cameras = self.log.cameras().iter().zip(&self.strides).enumerate().map(camera).collect();
        let touch = self.log.hand().per_pad(|pad| {
            let image = self.log.touch_image(pad, frame).ok();
            let truth = self.log.touch_truth(pad, frame).ok();
            if image.is_none() && truth.is_none() {
                return None;
            }
            let press =
                truth.zip(self.log.hand().gel_views().get(pad)).and_then(|(truth, gel)| true_press(&truth, gel));
            let (indentation_mm, contact) =
                press.map_or_else(Default::default, |press| (press.indentation_mm, press.contact));
            Some(TouchImages { image: image.unwrap_or_default(), indentation_mm, contact, true_indentation_mm: None })
        });
        FrameImages { frame, cameras, touch }
    }
}
