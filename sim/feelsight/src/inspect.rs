//! Check of a whole log.

use std::fmt;
use std::path::Path;

use mvt_frames::camera::PosedCamera;
use mvt_frames::depth::Label;
use mvt_frames::{Isometry, Object, Point};
use mvt_robot::hand::PerPad;
use mvt_robot::hand::solid::HandSolid;
use ndarray::Array2;
use rayon::prelude::*;
use serde::Serialize;

use crate::error::LogError;
use crate::frame::finger_poses;
use crate::hand::pad_name;
use crate::reader::Log;

/// Greatest difference between a recorded pose of a touch sensor and forward kinematics: metres, and elements of the rotation.
const KINEMATICS_TOLERANCE: f64 = 1e-6;
/// Number of frames in which camera depth is compared with the surface.
const CAMERA_FRAMES: usize = 12;
/// Every Nth pixel that shows the object is compared with the surface.
const CAMERA_STRIDE: usize = 37;
/// Median distance from the true surface above which a camera's pose is doubted, metres. Exact depth lies within 0.1 mm of it, and depth
/// with five times Redwood's noise within 2 mm.
const CAMERA_FIT_M: f64 = 0.004;
/// Every Nth pixel in contact is compared with the surface.
const CONTACT_STRIDE: usize = 17;

/// Summary of a log, from all of its files.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct LogSummary {
    /// Name of the object.
    pub object: String,
    /// Number of frames.
    pub frames: usize,
    /// Time of the last frame, seconds.
    pub duration_s: f64,
    /// Mean frames per second.
    pub rate_hz: f64,
    /// Whether the episode lasted for its planned time; `None` without scene.json.
    pub complete: Option<bool>,
    /// Reason of the episode's end; `None` without scene.json.
    pub reason: Option<String>,
    /// Cameras.
    pub cameras: Vec<CameraSummary>,
    /// Fraction of frames in which each pad has contact; `None` without labels.
    pub contact_fraction: Option<PerPad<f64>>,
    #[serde(skip)]
    pads: Vec<String>,
    /// Fraction of frames in which any pad has contact; `None` without labels.
    pub any_contact_fraction: Option<f64>,
    /// Largest difference between an element of a touch sensor's recorded pose and forward kinematics; `None` without recorded
    /// poses. In logs without scene.json it is only informative, since their recorded poses are not documented.
    pub kinematics_deviation: Option<f64>,
    /// Distance of points in contact from the surface of the object; `None` without labels, contact or a surface.
    pub contact_distance: Option<SurfaceDistance>,
    /// Defects that were tolerated in a log of another program.
    pub notes: Vec<String>,
}

/// Camera of a log.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CameraSummary {
    /// Name.
    pub name: String,
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Fraction of pixels with a depth.
    pub depth_fraction: f64,
    /// Mean number of pixels that show the object; `None` without segmentation.
    pub object_pixels: Option<f64>,
    /// Distance of the measured points of the object from its surface at the true pose; `None` without segmentation, pose or surface. A
    /// camera that is not where the log says leads to millimetres and more.
    pub surface_distance: Option<SurfaceDistance>,
    /// Distance of the measured points that show the hand from its model at the recorded joint angles; `None` without segmentation or
    /// without such points. A camera that is not where the log says, or wrong joint angles, lead to millimetres and more.
    pub hand_distance: Option<SurfaceDistance>,
}

/// Distances of measured points from the surface of the object, metres.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SurfaceDistance {
    /// Number of points.
    pub points: usize,
    /// Mean of the absolute distances.
    pub mean_m: f64,
    /// Median of the absolute distances.
    pub median_m: f64,
    /// 95th percentile of the absolute distances.
    pub p95_m: f64,
}

/// Facts from the images of one frame.
struct FrameFacts {
    contact: Option<PerPad<bool>>,
    object_pixels: Option<Vec<usize>>,
    distances: Vec<f64>,
}

/// Reads a whole log and checks counts, sizes, levels, poses, times, checksums and kinematics.
///
/// # Errors
/// The first defect, with its file.
pub fn inspect(folder: &Path) -> Result<LogSummary, LogError> {
    inspect_surface(folder, None)
}

/// Does the same as [`inspect`], and compares the pixels in contact with the object: `distance_m` returns the signed
/// distance of a point from its surface. Swapped pads or joints lead to distances of centimetres.
///
/// # Errors
/// As [`inspect`]; distances are reported, not judged.
pub fn inspect_against(
    folder: &Path,
    distance_m: &(dyn Fn(Point<Object>) -> f64 + Sync),
) -> Result<LogSummary, LogError> {
    inspect_surface(folder, Some(distance_m))
}

type Surface<'a> = &'a (dyn Fn(Point<Object>) -> f64 + Sync);

fn inspect_surface(folder: &Path, surface: Option<Surface<'_>>) -> Result<LogSummary, LogError> {
    let log = Log::open(folder)?;
    let kinematics_deviation = kinematics(&log)?;
    let facts = (0..log.len()).into_par_iter().map(|i| frame_facts(&log, i, surface)).collect::<Result<Vec<_>, _>>()?;
    let depths = (0..log.cameras().len()).into_par_iter().map(|camera| depth_facts(&log, camera, surface));
    let depths = depths.collect::<Result<Vec<_>, _>>()?;
    let mut notes = log.notes().to_vec();
    for (camera, DepthFacts { distances, hand_distances, .. }) in log.cameras().iter().zip(&depths) {
        if let Some(median_m) =
            surface_distance(hand_distances.clone()).map(|d| d.median_m).filter(|&m| m > CAMERA_FIT_M)
        {
            notes.push(format!(
                "camera {} sees the hand {:.1} mm (median) beside its model: its pose or the joint angles are wrong; `mambavitact calibrate --log LOG` measures both",
                camera.name,
                1e3 * median_m
            ));
        }
        if let Some(median_m) = surface_distance(distances.clone()).map(|d| d.median_m).filter(|&m| m > CAMERA_FIT_M) {
            notes.push(format!(
                "camera {} sees the object {:.1} mm (median) beside its true surface: its pose or that of the object is wrong",
                camera.name,
                1e3 * median_m
            ));
        }
    }

    let frames = log.len() as f64;
    let camera = |(i, camera): (usize, &PosedCamera)| {
        let object = facts.iter().map(|f| f.object_pixels.as_ref().and_then(|pixels| pixels.get(i).copied()));
        CameraSummary {
            name: camera.name.clone(),
            width: camera.intrinsics.width,
            height: camera.intrinsics.height,
            depth_fraction: depths[i].fraction,
            surface_distance: surface_distance(depths[i].distances.clone()),
            hand_distance: surface_distance(depths[i].hand_distances.clone()),
            object_pixels: object.sum::<Option<usize>>().map(|pixels| pixels as f64 / frames),
        }
    };
    let fraction = |touches: &dyn Fn(&PerPad<bool>) -> bool| {
        let frames_with = facts.iter().map(|f| f.contact.as_ref().map(|c| usize::from(touches(c))));
        frames_with.sum::<Option<usize>>().map(|n| n as f64 / frames)
    };
    let duration_s = log.times_s().last().copied().unwrap_or_default();
    Ok(LogSummary {
        object: log.object_name().to_owned(),
        frames: log.len(),
        duration_s,
        rate_hz: match log.times_s() {
            [first, .., last] if last > first => (frames - 1.0) / (last - first),
            _ => 0.0,
        },
        complete: log.scene().map(|scene| scene.end.complete),
        reason: log.scene().map(|scene| scene.end.reason.clone()),
        cameras: log.cameras().iter().enumerate().map(camera).collect(),
        contact_fraction: (0..log.hand().pads().len()).map(|pad| fraction(&|contact| contact[pad])).collect(),
        pads: log.hand().pads().iter().map(|pad| pad.name.clone()).collect(),
        any_contact_fraction: fraction(&|contact| contact.0.contains(&true)),
        kinematics_deviation,
        contact_distance: surface_distance(facts.iter().flat_map(|f| f.distances.iter().copied()).collect()),
        notes,
    })
}

/// Returns the largest deviation of recorded poses of touch sensors from forward kinematics.
fn kinematics(log: &Log) -> Result<Option<f64>, LogError> {
    let Some(recorded) = log.finger_poses() else { return Ok(None) };
    let mut largest = 0.0f64;
    for (i, (recorded, joints)) in recorded.iter().zip(log.joints()).enumerate() {
        let expected = finger_poses(log.hand(), joints);
        for (pad, (recorded, expected)) in recorded.iter().zip(&expected).enumerate() {
            let recorded = Isometry::<mvt_frames::Camera, mvt_frames::World>::from_matrix(recorded)
                .map(|pose| (log.world() * pose).to_matrix());
            let deviation = match recorded {
                Ok(recorded) => {
                    let pairs = recorded.iter().flatten().zip(expected.iter().flatten());
                    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
                }
                Err(_) => f64::INFINITY,
            };
            largest = largest.max(deviation);
            if deviation > KINEMATICS_TOLERANCE && log.scene().is_some() {
                let defect = format!(
                    "allegro.finger_poses of frame {i}, {}: {deviation:.2e} from forward kinematics",
                    pad_name(log.hand(), pad)
                );
                return Err(LogError::defect(log.folder().join("data.pkl"), defect));
            }
        }
    }
    Ok(Some(largest))
}

fn frame_facts(log: &Log, i: usize, surface: Option<Surface<'_>>) -> Result<FrameFacts, LogError> {
    let images = log.images(i)?;
    let mut distances = Vec::new();
    if let (Some(truth), Some(distance_m), Some(object_pose)) = (&images.touch_truth, surface, log.object_poses()[i]) {
        let pads = truth.iter().zip(log.hand().pads());
        for ((touch, pad), camera) in pads.zip(log.hand().world_from_touch_cameras(&log.joints()[i])) {
            let intrinsics = pad.profile.intrinsics();
            let object_from_camera = object_pose.inverse() * camera;
            let pixels = touch.contact.indexed_iter().filter(|(_, touches)| **touches);
            distances.extend(pixels.step_by(CONTACT_STRIDE).map(|((v, u), _)| {
                let depth_m = touch.depth_m[(v, u)];
                distance_m(object_from_camera * intrinsics.unproject(u as f64, v as f64, f64::from(depth_m)))
            }));
        }
    }
    let object_pixels = |labels: &Array2<Label>| labels.iter().filter(|&&label| label == Label::Object).count();
    Ok(FrameFacts {
        contact: images.touch_truth.map(|truth| truth.map(|t| t.contact.iter().any(|&touches| touches))),
        object_pixels: images.labels.map(|cameras| cameras.iter().map(object_pixels).collect()),
        distances,
    })
}

/// Facts from the depths of one camera.
struct DepthFacts {
    /// Fraction of pixels with a depth.
    fraction: f64,
    /// Signed distances of some points of the object from its surface, metres.
    distances: Vec<f64>,
    /// Signed distances of some points of the hand from its model, metres.
    hand_distances: Vec<f64>,
}

/// Reads all depths of a camera, and so checks their checksum.
fn depth_facts(log: &Log, camera: usize, surface: Option<Surface<'_>>) -> Result<DepthFacts, LogError> {
    let every = log.len().div_ceil(CAMERA_FRAMES);
    let mut sampled = Vec::new();
    let mut read = || {
        let mut reader = log.depths(camera)?;
        let (mut valid, mut pixels) = (0usize, 0usize);
        for frame in 0.. {
            let Some(values) = reader.read()? else { break };
            if log.scene().is_some() && !values.iter().all(|&z| z <= 0.0 && z.is_finite()) {
                return Err(LogError::defect(reader.path(), "a depth is positive or not finite"));
            }
            valid += values.iter().filter(|&&z| z != 0.0 && z.is_finite()).count();
            pixels += values.len();
            if frame < log.len() && frame % every == 0 {
                sampled.push((frame, values));
            }
        }
        Ok(valid as f64 / pixels.max(1) as f64)
    };
    let fraction = read()?;
    let (mut distances, mut hand_distances) = (Vec::new(), Vec::new());
    for (frame, values) in sampled {
        let Some(labels) = log.images(frame)?.labels.and_then(|mut labels| labels.get_mut(camera).map(std::mem::take))
        else {
            continue;
        };
        let PosedCamera { intrinsics, pose, .. } = &log.cameras()[camera];
        let measured = |wanted: Label| {
            let pixels = labels.indexed_iter().zip(&values);
            let measured = pixels.filter(move |((_, label), z)| **label == wanted && **z != 0.0 && z.is_finite());
            // Logs hold the camera's z, which is negative in front of it.
            measured
                .step_by(CAMERA_STRIDE)
                .map(|(((v, u), _), &z)| intrinsics.unproject(u as f64, v as f64, f64::from(z.abs())))
        };
        if let (Some(distance_m), Some(object_pose)) = (surface, log.object_poses()[frame]) {
            let object_from_camera = object_pose.inverse() * *pose;
            distances.extend(measured(Label::Object).map(|point| distance_m(object_from_camera * point)));
        }
        let hand = HandSolid::new(log.hand(), &log.joints()[frame]);
        hand_distances.extend(measured(Label::Hand).map(|point| {
            let [x, y, z] = (*pose * point).coords().map(|x| x as f32).into();
            f64::from(hand.distance(glam::Vec3::new(x, y, z)))
        }));
    }
    Ok(DepthFacts { fraction, distances, hand_distances })
}

fn surface_distance(mut distances: Vec<f64>) -> Option<SurfaceDistance> {
    distances.iter_mut().for_each(|d| *d = d.abs());
    distances.sort_by(f64::total_cmp);
    let points = distances.len();
    let p95_m = *distances.get((points * 95 / 100).min(points.checked_sub(1)?))?;
    let median_m = *distances.get(points / 2)?;
    Some(SurfaceDistance { points, mean_m: distances.iter().sum::<f64>() / points as f64, median_m, p95_m })
}

impl fmt::Display for LogSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "object    {}", self.object)?;
        writeln!(f, "frames    {} in {:.2} s, {:.2} per second", self.frames, self.duration_s, self.rate_hz)?;
        if let (Some(complete), Some(reason)) = (self.complete, &self.reason) {
            writeln!(f, "episode   {}: {reason}", if complete { "complete" } else { "ended early" })?;
        }
        for camera in &self.cameras {
            write!(f, "camera    {}, {} x {}", camera.name, camera.width, camera.height)?;
            write!(f, ", depth on {:.1} % of pixels", 100.0 * camera.depth_fraction)?;
            match camera.object_pixels {
                Some(pixels) => writeln!(f, ", object on {pixels:.0} pixels")?,
                None => writeln!(f, ", no segmentation")?,
            }
            if let Some(SurfaceDistance { points, median_m, p95_m, .. }) = &camera.surface_distance {
                let (median, p95) = (1e3 * median_m, 1e3 * p95_m);
                writeln!(
                    f,
                    "          {points} points lie {median:.2} mm (median; 95 %: {p95:.2} mm) from the true surface"
                )?;
            }
            if let Some(SurfaceDistance { points, median_m, p95_m, .. }) = &camera.hand_distance {
                let (median, p95) = (1e3 * median_m, 1e3 * p95_m);
                writeln!(
                    f,
                    "          {points} points lie {median:.2} mm (median; 95 %: {p95:.2} mm) from the model of the hand"
                )?;
            }
        }
        match (&self.contact_fraction, self.any_contact_fraction) {
            (Some(pads), Some(any)) => {
                write!(f, "contact   {:.1} % of frames", 100.0 * any)?;
                for (name, fraction) in self.pads.iter().zip(pads) {
                    write!(f, ", {name} {:.1} %", 100.0 * fraction)?;
                }
                writeln!(f)?;
            }
            _ => writeln!(f, "contact   no labels")?,
        }
        match self.kinematics_deviation {
            Some(deviation) => {
                writeln!(f, "joints    recorded poses of touch sensors differ by {deviation:.1e} from kinematics")?;
            }
            None => writeln!(f, "joints    no recorded poses of touch sensors to check against")?,
        }
        if let Some(SurfaceDistance { points, mean_m, p95_m, .. }) = self.contact_distance {
            let (mean, p95) = (1e3 * mean_m, 1e3 * p95_m);
            writeln!(f, "surface   {points} points in contact, {mean:.3} mm off on average, 95 % within {p95:.3} mm")?;
        }
        for note in &self.notes {
            writeln!(f, "note      {note}")?;
        }
        Ok(())
    }
}
