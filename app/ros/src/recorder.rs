//! Records the frames of a live run without loss, on a thread of its own, so that the run never waits for the disk.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use anyhow::{Context as _, Result};
use image::{ExtendedColorType, RgbImage};
use mvt_feelsight::{LiveFile, LogAssembler, LogCamera, LogImage, Timeline};
use mvt_frames::camera::PosedCamera;
use mvt_frames::depth::GivenLabels;
use mvt_images::fast_png;
use mvt_rgbd::{RgbdWriter, WrittenFrame};
use mvt_robot::hand::Hand;
use mvt_robot::observation::Observation;
use mvt_run::report::LiveLogRecord;

/// Frames that wait for the disk: a second at 30 Hz, some 100 MB of RGB-D with four touch sensors.
const WAITING: usize = 32;

/// Counts that the threads share.
#[derive(Debug, Default)]
struct Counts {
    written: AtomicU64,
    left_out: AtomicU64,
}

/// Frame on its way to the disk.
struct Kept {
    stamp_ns: i64,
    time_ns: i64,
    observation: Observation,
}

/// Recorder of a log: of a FeelSight log with a hand, of an RGB-D sequence without one.
pub(crate) struct LiveRecorder {
    folder: PathBuf,
    counts: Arc<Counts>,
    /// `None` after the end.
    frames: Option<SyncSender<Kept>>,
    thread: Option<JoinHandle<Result<()>>>,
    is_told: bool,
}

impl LiveRecorder {
    /// Begins a log in a folder that does not exist or is empty. Depth that is a whole multiple of `depth_unit_m`, metres, takes least space.
    ///
    /// # Errors
    /// If the folder holds anything or cannot be written.
    pub fn create(
        folder: &Path,
        hand: &Arc<Hand>,
        camera: &PosedCamera,
        object: &str,
        depth_unit_m: f64,
    ) -> Result<Self> {
        let sink = if hand.is_none() {
            Sink::Sequence(RgbdWriter::create(folder, &camera.intrinsics, depth_unit_m)?, None)
        } else {
            let cameras = vec![LogCamera { camera: camera.clone(), distortion: None }];
            let timeline = Timeline {
                object_name: object.to_owned(),
                times_s: Vec::new(),
                joints: Vec::new(),
                object_poses: Vec::new(),
                scene: None,
                live: None,
            };
            Sink::Log(Box::new((LogAssembler::create(folder, Arc::clone(hand), cameras)?, timeline)), Vec::new())
        };
        let counts = Arc::new(Counts::default());
        let (frames, receiver) = sync_channel(WAITING);
        let others = Arc::clone(&counts);
        let thread = std::thread::Builder::new().name("log".to_owned());
        let thread = thread.spawn(move || sink.record(&receiver, &others)).context("cannot start a thread")?;
        Ok(Self { folder: folder.to_owned(), counts, frames: Some(frames), thread: Some(thread), is_told: false })
    }

    /// Takes a frame. It is left out and counted if too many wait for the disk, or the disk is full.
    pub fn push(&mut self, stamp_ns: i64, time_ns: i64, observation: Observation) {
        let Some(frames) = &self.frames else { return };
        if frames.try_send(Kept { stamp_ns, time_ns, observation }).is_ok() {
            return;
        }
        self.counts.left_out.fetch_add(1, Ordering::Relaxed);
        if !std::mem::replace(&mut self.is_told, true) {
            tracing::warn!(
                "{}: the disk or the processor is too slow for the log; frames are left out of it, not of the run",
                self.folder.display()
            );
        }
    }

    /// Returns how many frames are written and left out so far.
    pub fn counts(&self) -> LiveLogRecord {
        LiveLogRecord {
            frames: self.counts.written.load(Ordering::Relaxed),
            left_out: self.counts.left_out.load(Ordering::Relaxed),
        }
    }

    /// Waits until all frames are on the disk, and completes the log.
    pub fn finish(&mut self) {
        if self.frames.take().is_none() {
            return;
        }
        if let Some(Err(reason)) = self.thread.take().and_then(|thread| thread.join().ok()) {
            tracing::error!("the log cannot be completed: {reason:#}");
        }
        let LiveLogRecord { frames, left_out } = self.counts();
        if left_out > 0 {
            let all = frames + left_out;
            tracing::warn!(
                "{}: the log lacks {left_out} of the {all} frames of the run: `run --log` on it does not repeat the estimate",
                self.folder.display()
            );
        }
    }
}

impl Drop for LiveRecorder {
    fn drop(&mut self) {
        self.finish();
    }
}

/// Where frames are written.
enum Sink {
    /// The sequence, and the stamp of time 0, nanoseconds.
    Sequence(RgbdWriter, Option<i64>),
    /// The log, and the poses of the camera.
    Log(Box<(LogAssembler, Timeline)>, Vec<[[f64; 4]; 4]>),
}

impl Sink {
    /// Writes frames until one cannot be written, counts the others, and completes the log.
    fn record(mut self, frames: &Receiver<Kept>, counts: &Counts) -> Result<()> {
        let mut has_failed = false;
        for frame in frames {
            match if has_failed { Ok(false) } else { self.write(frame).map(|()| true) } {
                Ok(true) => counts.written.fetch_add(1, Ordering::Relaxed),
                Ok(false) => counts.left_out.fetch_add(1, Ordering::Relaxed),
                Err(reason) => {
                    tracing::error!("the log ends here, and the run goes on: {reason:#}");
                    has_failed = true;
                    counts.left_out.fetch_add(1, Ordering::Relaxed)
                }
            };
        }
        if let Self::Log(log, camera_poses) = self {
            let (assembler, mut timeline) = *log;
            if !timeline.times_s.is_empty() {
                timeline.live = Some(LiveFile { left_out: counts.left_out.load(Ordering::Relaxed), camera_poses });
                assembler.finish(timeline)?;
            }
        }
        Ok(())
    }

    fn write(&mut self, Kept { stamp_ns, time_ns, observation }: Kept) -> Result<()> {
        let camera = observation.cameras.first().context("a frame has no camera")?;
        let mask = match &camera.labels {
            Some(GivenLabels::Mask(mask)) => Some(mask),
            _ => None,
        };
        match self {
            Self::Sequence(writer, begun_ns) => {
                // Stamps of a clock that was set back go on, as times do.
                let begun_ns = *begun_ns.get_or_insert(stamp_ns - time_ns);
                let stamp_ns = u64::try_from(begun_ns + time_ns).context("a stamp before 1970")?;
                Ok(writer.push(&WrittenFrame {
                    stamp_ns,
                    color: &camera.color,
                    depth_m: &camera.depth_m,
                    mask,
                    world_from_camera: camera.world_from_camera,
                    camera_from_object: None,
                })?)
            }
            Self::Log(log, camera_poses) => {
                let (assembler, timeline) = log.as_mut();
                let frame = timeline.times_s.len();
                let mut put = |image, pixels: &[u8], size, of| -> Result<()> {
                    Ok(assembler.image(image, frame, &fast_png(pixels, size, of)?, Path::new("a live image"))?)
                };
                let colours = std::iter::once((LogImage::Colours(0), &camera.color));
                let touch = observation.touch.iter().enumerate().map(|(pad, image)| (LogImage::Touch(pad), image));
                for (image, pixels) in colours.chain(touch).filter(|(_, pixels): &(_, &RgbImage)| !pixels.is_empty()) {
                    put(image, pixels.as_raw(), pixels.dimensions().into(), ExtendedColorType::Rgb8)?;
                }
                if let Some(mask) = mask {
                    let levels: Vec<u8> = mask.iter().map(|inside| if *inside { u8::MAX } else { 0 }).collect();
                    let size = [mask.ncols() as u32, mask.nrows() as u32];
                    put(LogImage::Labels(0), &levels, size, ExtendedColorType::L8)?;
                }
                let depth_m: Vec<f32> = camera.depth_m.iter().copied().collect();
                assembler.depth(0, frame, Some(&depth_m))?;
                camera_poses.extend(camera.world_from_camera.map(mvt_frames::Isometry::to_matrix));
                timeline.times_s.push(observation.time_s);
                timeline.joints.push(observation.joints);
                timeline.object_poses.push(None);
                Ok(())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use mvt_feelsight::Log;
    use mvt_frames::Isometry;
    use mvt_frames::camera::Intrinsics;
    use mvt_rgbd::RgbdRecording;
    use mvt_robot::hand::{PerPad, Side};
    use mvt_robot::observation::Rgbd;
    use ndarray::Array2;

    use super::*;

    fn camera() -> PosedCamera {
        let intrinsics = Intrinsics { width: 8, height: 6, fx: 9.0, fy: 9.0, cx: 3.5, cy: 2.5 };
        PosedCamera {
            name: "side".to_owned(),
            intrinsics,
            pose: Isometry::from_parts([0.3, 0.1, 0.2], [1.0, 0.0, 0.0, 0.0]),
        }
    }

    fn observation(hand: &Hand, time_s: f64) -> Observation {
        let touch = hand.per_pad(|pad| {
            let [width, height] = hand.pads()[pad].profile.size_px.map(|side| side as u32);
            // One sensor delivered nothing.
            if pad == 1 {
                RgbImage::default()
            } else {
                RgbImage::from_pixel(width, height, image::Rgb([9, pad as u8, 77]))
            }
        });
        let rgbd = Rgbd {
            color: RgbImage::from_fn(8, 6, |u, v| image::Rgb([u as u8, v as u8, 3])),
            depth_m: Array2::from_shape_fn((6, 8), |(v, u)| 0.1 * v as f32 + 0.013 * u as f32),
            labels: Some(GivenLabels::Mask(Array2::from_shape_fn((6, 8), |(v, u)| v > 2 && u > 2))),
            world_from_camera: None,
        };
        Observation { time_s, joints: vec![0.1; hand.joints().len()], touch, cameras: vec![rgbd] }
    }

    #[test]
    fn a_hand_gives_a_log_with_the_same_images() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("log");
        let hand = Hand::allegro(Side::Right);
        let mut recorder = LiveRecorder::create(&folder, &hand, &camera(), "cube70", 0.001).unwrap();
        let frames: Vec<Observation> = (0..3).map(|k| observation(&hand, 0.1 * f64::from(k))).collect();
        for (k, frame) in frames.iter().enumerate() {
            recorder.push(1000 + k as i64, k as i64, frame.clone());
        }
        recorder.finish();
        assert_eq!(recorder.counts(), LiveLogRecord { frames: 3, left_out: 0 });
        let log = Log::open_tolerant(&folder).unwrap();
        assert!(*log.hand() == hand, "the hand is another");
        assert_eq!((log.object_name(), log.cameras()[0].intrinsics), ("cube70", camera().intrinsics));
        let apart = log.cameras()[0].pose.inverse() * camera().pose;
        assert!(apart.origin().coords().norm() < 1e-12, "{apart:?}");
        assert_eq!(log.live(), Some(&LiveFile::default()));
        assert_eq!(log.times_s(), frames.iter().map(|frame| frame.time_s).collect::<Vec<_>>());
        for (k, frame) in frames.iter().enumerate() {
            assert_eq!(log.colour(0, k).unwrap(), frame.cameras[0].color);
            assert_eq!(log.touch_image(3, k).unwrap(), frame.touch[3]);
            assert!(log.touch_image(1, k).is_err(), "nothing was delivered");
            let Some(GivenLabels::Mask(mask)) = &frame.cameras[0].labels else { panic!("a mask was given") };
            let labels = log.labels(0, k).unwrap();
            assert!(
                labels.iter().zip(mask).all(|(label, inside)| (*label == mvt_frames::depth::Label::Object) == *inside)
            );
        }
        let mut partial = log.into_partial_frames(&[0], mvt_feelsight::TouchPart::None);
        assert_eq!(partial.next().unwrap().cameras[0].as_ref(), Some(&frames[0].cameras[0].depth_m));
        let refused = LiveRecorder::create(&folder, &hand, &camera(), "cube70", 0.001).err().unwrap().to_string();
        assert!(refused.contains("not empty"), "{refused}");
    }

    #[test]
    fn a_camera_alone_gives_a_sequence_whose_times_go_on_where_a_clock_was_set_back() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("sequence");
        let hand = Hand::none();
        let mut recorder = LiveRecorder::create(&folder, &hand, &camera(), "unknown", 0.001).unwrap();
        for (stamp_ns, time_ns) in [(7_000_000_000, 0), (7_100_000_000, 100_000_000), (3_000_000_000, 133_000_000)] {
            recorder.push(stamp_ns, time_ns, Observation { touch: PerPad::default(), ..observation(&hand, 0.0) });
        }
        recorder.finish();
        let recording = RgbdRecording::open(&folder).unwrap();
        assert_eq!(recording.times_s().collect::<Vec<_>>(), [0.0, 0.1, 0.133]);
        assert_eq!(recording.frame(2).unwrap().depth_m, observation(&hand, 0.0).cameras[0].depth_m);
    }

    #[test]
    fn a_disk_that_fails_ends_the_log_and_every_frame_is_counted() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("sequence");
        let hand = Hand::none();
        let mut recorder = LiveRecorder::create(&folder, &hand, &camera(), "unknown", 0.001).unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
        for k in 0..100 {
            recorder.push(k, k, Observation { touch: PerPad::default(), ..observation(&hand, 0.0) });
        }
        recorder.finish();
        let LiveLogRecord { frames, left_out } = recorder.counts();
        assert_eq!((frames, left_out), (0, 100));
    }
}
