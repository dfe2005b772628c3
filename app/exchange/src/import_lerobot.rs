//! An episode of a data set of LeRobot as a log.

use std::path::Path;
use std::sync::Arc;

use mvt_feelsight::npz::NpzReader;
use mvt_feelsight::{LogAssembler, LogCamera, LogImage, SCENE_FILE, SceneFile, Timeline};
use mvt_frames::camera::PosedCamera;
use mvt_frames::{Camera, Isometry, Object, World};
use mvt_robot::hand::JointAngles;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

use crate::data_set::{DataSet, EpisodePlace, LARGEST, number_of, whole};
use crate::error::{Defect, ExchangeError};
use crate::extras::{self, MAPPING_FILE};
use crate::foxglove::optical;
use crate::import_mcap::{Imported, ImportedChannel, distance_m, in_world};
use crate::joints::{Readings, beyond_range};
use crate::mapping::{CameraMapping, Mapping, PinholeMapping, PoseMapping};
use crate::messages::Picture;
use crate::pictures::{depth_of, file_of, touch_size};
use crate::plausibility::DepthCheck;
use crate::record::{RECORD_FILE, agrees, put};
use crate::skips::Skips;
use crate::table::{Cell, read_rows};

/// At most one row of so many may have a time that does not increase.
const MOST_WRONG: usize = 10;

/// Writes an episode of a data set of LeRobot v3.0 in the folder `source` as a log in the folder `out`. Without a mapping file it must be an
/// export of this program. `progress` receives the number of frames that are done and of all frames.
///
/// The rows are the frames. Images may be files in the tables, and no videos.
///
/// # Errors
/// [`ExchangeError`]; an incomplete log never has the name `out`.
pub fn import_lerobot(
    source: &Path,
    episode: usize,
    mapping: Option<&Path>,
    out: &Path,
    mut progress: impl FnMut(usize, usize),
) -> Result<Imported, ExchangeError> {
    let extras = source.join(extras::folder(episode));
    let set = DataSet::open(source).map_err(|defect| defect.of(source))?;
    let (mapping, extras) = match mapping {
        Some(file) => (Mapping::read(file)?, None),
        None if extras.join(MAPPING_FILE).exists() => (Mapping::read(&extras.join(MAPPING_FILE))?, Some(extras)),
        None => {
            let words =
                format!("it has no episode {episode} that this program wrote; name the columns with --mapping FILE");
            return Err(Defect::Words(words).of(source));
        }
    };
    set.import(episode, &mapping, extras.as_deref(), out, &mut progress).map_err(|defect| defect.of(source))
}

impl DataSet {
    fn import(
        &self,
        episode: usize,
        mapping: &Mapping,
        extras: Option<&Path>,
        out: &Path,
        progress: &mut impl FnMut(usize, usize),
    ) -> Result<Imported, Defect> {
        let EpisodePlace { file, length } = self.place(episode)?;
        let mut notes = Vec::new();
        let (width, order) = self.order(mapping, &mut notes)?;
        let images = Columns::new(mapping);
        let mut names = vec!["episode_index", "frame_index", &mapping.hand.joints];
        for column in mapping.hand.time.iter().chain(&mapping.object.frame) {
            self.feature(column)?;
        }
        for (column, _) in &images.0 {
            self.feature(column)?;
        }
        let pose_at = mapping.object.frame.as_deref().map(|column| {
            names.push(column);
            names.len() - 1
        });
        let time_at = mapping.hand.time.as_deref().map(|column| {
            names.push(column);
            names.len() - 1
        });
        let first_image = names.len();
        names.extend(images.0.iter().map(|(column, _)| *column));

        let (cameras, sizes): (Vec<_>, Vec<_>) = cameras(mapping)?.into_iter().unzip();
        let distances: Vec<f64> =
            cameras.iter().map(|camera| distance_m(&camera.camera, &mapping.hand.hand())).collect();
        let hand = mapping.hand();
        let mut writer = LogAssembler::create(out, Arc::clone(&hand), cameras)?;
        let mut exact = exact_depths(extras, sizes.len())?;
        let mut log = Rows { checks: sizes.iter().map(|_| DepthCheck::default()).collect(), notes, ..Rows::default() };
        let joint_names = mapping.hand.names();
        read_rows(&file, &names, &mut |mut cells| -> Result<bool, Defect> {
            let at = |place: usize| cells.get(place).and_then(Option::as_ref);
            let numbers = (whole(at(0)), whole(at(1)));
            let (Some(of), Some(number)) = numbers else {
                return Err("a row has no episode_index or no frame_index".to_owned().into());
            };
            if of != episode {
                return Ok(log.count == 0);
            }
            log.count += 1;
            let (place, frame) = (format!("frame {number}"), log.times_s.len());
            let row = match angles(at(2), width, &order) {
                Err(defect) => Err((&mapping.hand.joints, defect)),
                Ok(angles) => {
                    let named =
                        joint_names.iter().map(String::as_str).zip(angles.into_iter().map(Some)).collect::<Vec<_>>();
                    let (row, defects) = log.joints.row(&named, joint_names, &hand);
                    match (row, defects.into_iter().next()) {
                        (Some(row), None) => Ok(row),
                        (_, defect) => Err((&mapping.hand.joints, defect.unwrap_or_default())),
                    }
                }
            };
            let time = match time_at {
                None => Some(number as f64 / self.fps),
                Some(place) => at(place).and_then(number_of).filter(|time| time.is_finite()),
            };
            let later = time.filter(|time| log.times_s.last().is_none_or(|last| last < time));
            let time_column = mapping.hand.time.as_ref().unwrap_or(&log.frame_index);
            let later = later.ok_or_else(|| {
                let defect = if time.is_none() { "it is no finite number" } else { "the time does not increase" };
                (time_column, defect.to_owned())
            });
            log.wrong_times += usize::from(later.is_err());
            let depths = next_depths(&mut exact, &sizes)?;
            let (row, time_s) = match row.and_then(|row| Ok((row, later?))) {
                Ok(row) => row,
                Err((column, defect)) => {
                    log.skips.add(column, place, defect);
                    return Ok(true);
                }
            };
            log.joints.rows.push(row);
            log.times_s.push(time_s);
            let pose_of = |cell| pose(cell).map(|pose| Isometry::new(in_world(mapping, pose)));
            let found = pose_at.and_then(at).and_then(pose_of);
            if let (None, Some(column)) = (found, &mapping.object.frame) {
                let defect = "it is not x, y, z and a quaternion w, x, y, z of length 1".to_owned();
                log.skips.add(column, place.clone(), defect);
            }
            log.poses.push(found);
            for (&(column, image), cell) in images.0.iter().zip(cells.drain(first_image..)) {
                let skipped = match cell {
                    Some(Cell::Bytes(bytes)) => {
                        let picture = Picture { data: &bytes, ..Picture::default() };
                        log.image(mapping, &picture, image, frame, (&depths, &sizes), &mut writer, column)?
                    }
                    _ => Some("it has no image file".to_owned()),
                };
                if let Some(defect) = skipped {
                    log.skips.add(column, place.clone(), defect);
                }
            }
            progress(frame + 1, length);
            Ok(true)
        })?;
        if log.count != length || length == 0 {
            let words = format!("episode {episode} has {} rows, and the table of episodes says {length}", log.count);
            return Err(words.into());
        }
        self.check(mapping, &images, &log)?;
        for ((camera, check), distance_m) in mapping.cameras.iter().zip(&log.checks).zip(distances) {
            log.notes.extend(check.verdict(&camera.name, distance_m)?);
        }
        self.finish(mapping, extras, out, log, writer, &images)
    }

    /// Refuses an episode of which a column cannot be used.
    fn check(&self, mapping: &Mapping, images: &Columns<'_>, log: &Rows) -> Result<(), Defect> {
        let joints = &mapping.hand.joints;
        if log.wrong_times * MOST_WRONG > log.count {
            let (column, wrong) = (mapping.hand.time.as_ref().unwrap_or(&log.frame_index), log.wrong_times);
            return Err(format!(
                "{column}: the time does not increase in {wrong} of {} rows; leave hand.time out to count frames by fps, since 32 bits are too few for times since 1970",
                log.count
            )
            .into());
        }
        if log.times_s.is_empty() || log.skips.count(joints) * 2 > log.count {
            let first = log.skips.first(joints).unwrap_or_default();
            let defect = log.joints.defect(mapping.hand.names(), &mapping.hand.hand());
            return Err(match defect.filter(|defect| defect.contains("radians")) {
                Some(defect) => format!("{joints}: {defect}"),
                None => format!("{joints}: most of its rows cannot be used; first {first}"),
            }
            .into());
        }
        let columns = images.0.iter().map(|(column, _)| *column).chain(mapping.object.frame.as_deref());
        for column in columns {
            if let Some(first) = log.skips.first(column).filter(|_| log.skips.count(column) == log.times_s.len()) {
                return Err(format!("{column}: none of its rows can be used; first {first}").into());
            }
        }
        let mut steps: Vec<f64> = log.times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        steps.sort_by(f64::total_cmp);
        match (steps.get(steps.len() / 2), &mapping.hand.time) {
            (Some(step), Some(column)) if !(0.05..=20.0).contains(&(step * self.fps)) => Err(format!(
                "{column}: {step} s lie between two frames, and fps is {}; times must be in seconds",
                self.fps
            )
            .into()),
            _ => Ok(()),
        }
    }

    fn finish(
        &self,
        mapping: &Mapping,
        extras: Option<&Path>,
        out: &Path,
        log: Rows,
        writer: LogAssembler,
        images: &Columns<'_>,
    ) -> Result<Imported, Defect> {
        let Rows { times_s, joints: Readings { rows: joints, .. }, poses, skips, mut notes, .. } = log;
        let (frames, hand) = (joints.len(), mapping.hand());
        let read = |name: &str| mvt_files::input::read(&extras?.join(name), LARGEST).ok();
        let scene: Option<SceneFile> = read(SCENE_FILE).and_then(|bytes| serde_json::from_slice(&bytes).ok());
        // Damage may have changed it.
        let cameras = || mapping.cameras.iter().map(|camera| &camera.name);
        let scene = scene.filter(|scene| scene.hand == hand && scene.cameras.iter().eq(cameras()));
        let object_name = mapping.object.name.clone().unwrap_or_else(|| "object".to_owned());
        let names = mapping.cameras.iter().map(|camera| camera.name.as_str());
        let record = read(RECORD_FILE).filter(|record| agrees(record, &times_s, &joints, names));
        notes.extend(skips.notes());
        notes.extend(beyond_range(&joints, &hand, mapping.hand.names()));
        notes.push("labels and true touch depth are not part of a data set: `run` labels pixels itself".to_owned());
        for (_, pad) in hand.pads().iter().enumerate().filter(|(k, _)| mapping.touch(*k).is_none()) {
            notes.push(format!("pad {} has no touch images: it is used without touch", pad.name));
        }
        let unknown = poses.iter().filter(|pose| pose.is_none()).count();
        if unknown > 0 {
            notes.push(format!(
                "the true pose of the object is unknown in {unknown} of {frames} frames: they have no scores"
            ));
        }
        writer.finish(Timeline { object_name, times_s, joints, object_poses: poses, scene, live: None })?;
        if let Some(record) = record {
            put(&record, out).map_err(|error| format!("cannot write {}: {error}", out.display()))?;
        }
        let channel = |topic: &str| ImportedChannel {
            topic: topic.to_owned(),
            messages: frames,
            rate_hz: self.fps,
            offset_ms: 0.0,
            farthest_ms: Some(0.0),
            frames: Some(frames),
        };
        let columns = std::iter::once(mapping.hand.joints.as_str()).chain(images.0.iter().map(|(column, _)| *column));
        Ok(Imported { frames, channels: columns.map(channel).collect(), notes })
    }
}

/// Opens the exact depths of the cameras that have them.
fn exact_depths(extras: Option<&Path>, cameras: usize) -> Result<Vec<Option<NpzReader>>, String> {
    let open = |camera| {
        let name = extras::depth_file(camera);
        let path = extras.map(|folder| folder.join(&name)).filter(|path| path.exists());
        path.map(|path| NpzReader::open(&path).map_err(|error| format!("{name}: {error}"))).transpose()
    };
    (0..cameras).map(open).collect()
}

/// Returns the next exact depth image of each camera that has them.
fn next_depths(exact: &mut [Option<NpzReader>], sizes: &[DepthSize]) -> Result<Vec<Option<Vec<f32>>>, String> {
    let next = |(camera, (reader, (_, (width, height)))): (usize, (&mut Option<NpzReader>, &DepthSize))| {
        let Some(reader) = reader else { return Ok(None) };
        let named = |defect: String| format!("{}: {defect}", extras::depth_file(camera));
        let depth = reader.read().map_err(|error| named(error.to_string()))?;
        // The log has its camera's z, which is negative in front of it.
        let depth = depth.filter(|depth| depth.len() == width * height);
        let depth = depth.ok_or_else(|| named("it has too few images, or images of another size".to_owned()))?;
        Ok(Some(depth.into_iter().map(f32::abs).collect()))
    };
    exact.iter_mut().zip(sizes).enumerate().map(next).collect()
}

/// Parts of an episode that are kept until its end.
struct Rows {
    /// Number of rows, with those that are skipped.
    count: usize,
    /// Rows whose time does not increase.
    wrong_times: usize,
    /// Name of the column that counts frames.
    frame_index: String,
    times_s: Vec<f64>,
    joints: Readings,
    poses: Vec<Option<Isometry<Object, World>>>,
    checks: Vec<DepthCheck>,
    skips: Skips,
    notes: Vec<String>,
}

impl Default for Rows {
    fn default() -> Self {
        Self {
            count: 0,
            wrong_times: 0,
            frame_index: "frame_index".to_owned(),
            times_s: Vec::new(),
            joints: Readings::default(),
            poses: Vec::new(),
            checks: Vec::new(),
            skips: Skips::default(),
            notes: Vec::new(),
        }
    }
}

impl Rows {
    /// Writes an image of a frame. Returns why it is skipped.
    fn image(
        &mut self,
        mapping: &Mapping,
        picture: &Picture<'_>,
        image: Kind,
        frame: usize,
        (exact, sizes): (&[Option<Vec<f32>>], &[DepthSize]),
        writer: &mut LogAssembler,
        column: &str,
    ) -> Result<Option<String>, Defect> {
        let of_camera = |camera: usize| sizes.get(camera).copied().unwrap_or_default();
        match image {
            Kind::Depth(k) => {
                let (unit_m, size) = of_camera(k);
                let depth_m = match exact.get(k).cloned().flatten() {
                    Some(depth_m) => Ok(depth_m),
                    None => depth_of(picture, unit_m, size),
                };
                writer.depth(k, frame, depth_m.as_deref().ok())?;
                if let (Ok(depth_m), Some(check)) = (&depth_m, self.checks.get_mut(k)) {
                    check.add(depth_m);
                }
                Ok(depth_m.err())
            }
            Kind::File(image) => {
                let (turn, size) = match image {
                    LogImage::Touch(pad) => (mapping.touch(pad), touch_size(writer.hand(), pad)),
                    LogImage::TouchDepth(pad) | LogImage::Contact(pad) => (None, touch_size(writer.hand(), pad)),
                    LogImage::Colours(k) | LogImage::Labels(k) => (None, of_camera(k).1),
                };
                match file_of(picture, image, turn, size) {
                    Ok(file) => {
                        writer.image(image, frame, &file, Path::new(column))?;
                        Ok(None)
                    }
                    Err(defect) => Ok(Some(defect)),
                }
            }
        }
    }
}

/// The target of a column of images.
#[derive(Clone, Copy)]
enum Kind {
    Depth(usize),
    File(LogImage),
}

/// Columns of images.
struct Columns<'a>(Vec<(&'a str, Kind)>);

impl<'a> Columns<'a> {
    fn new(mapping: &'a Mapping) -> Self {
        let mut columns = Vec::new();
        for (k, camera) in mapping.cameras.iter().enumerate() {
            columns.push((camera.depth.as_str(), Kind::Depth(k)));
            let files = [(&camera.colours, LogImage::Colours(k)), (&camera.labels, LogImage::Labels(k))];
            columns
                .extend(files.into_iter().filter_map(|(column, image)| Some((column.as_deref()?, Kind::File(image)))));
        }
        for pad in 0..mapping.hand.hand().pads().len() {
            let Some(touch) = mapping.touch(pad) else { continue };
            columns.push((&touch.image, Kind::File(LogImage::Touch(pad))));
            let truth = [(&touch.depth, LogImage::TouchDepth(pad)), (&touch.contact, LogImage::Contact(pad))];
            columns
                .extend(truth.into_iter().filter_map(|(column, image)| Some((column.as_deref()?, Kind::File(image)))));
        }
        Self(columns)
    }
}

/// Unit of depth of a camera, metres, and its width and height.
type DepthSize = (f64, (usize, usize));

/// Returns the cameras of the log, each with unit and size of its depth.
fn cameras(mapping: &Mapping) -> Result<Vec<(LogCamera, DepthSize)>, String> {
    let one = |camera: &CameraMapping| {
        let CameraMapping { name, intrinsics, pose, depth_unit_m, .. } = camera;
        let (Some(intrinsics), Some(pose)) =
            (intrinsics.map(PinholeMapping::intrinsics), pose.and_then(PoseMapping::isometry))
        else {
            return Err(format!("camera {name}: give intrinsics and pose in the mapping; a data set has none"));
        };
        let pose = Isometry::<Camera, World>::new(in_world(mapping, pose)) * optical();
        let size = (intrinsics.width, intrinsics.height);
        let camera = PosedCamera { name: name.clone(), intrinsics, pose };
        Ok((LogCamera { camera, distortion: None }, (*depth_unit_m, size)))
    };
    mapping.cameras.iter().map(one).collect()
}

fn angles(cell: Option<&Cell>, width: usize, order: &[usize]) -> Result<JointAngles, String> {
    let numbers = match cell {
        Some(Cell::Numbers(numbers)) if numbers.len() == width => numbers,
        _ => return Err(format!("it has not {width} numbers")),
    };
    Ok(order.iter().map(|place| numbers.get(*place).copied().unwrap_or(f64::NAN)).collect())
}

fn pose(cell: &Cell) -> Option<Isometry3<f64>> {
    let Cell::Numbers(numbers) = cell else { return None };
    let &[x, y, z, qw, qx, qy, qz] = numbers.as_slice() else { return None };
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    let is_pose = (quaternion.norm() - 1.0).abs() < 1e-3 && [x, y, z].iter().all(|value| value.is_finite());
    is_pose.then(|| Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(quaternion)))
}
