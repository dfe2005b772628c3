//! An episode of a data set of LeRobot as a log.

use std::path::{Path, PathBuf};

use mvt_feelsight::npz::NpzReader;
use mvt_feelsight::{LogAssembler, LogCamera, LogImage, SCENE_FILE, SceneFile, Timeline};
use mvt_frames::camera::PosedCamera;
use mvt_frames::{Camera, Isometry, Object, World};
use mvt_robot::hand::{Finger, JOINTS, JointAngles};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use serde_json::Value;

use crate::error::{Defect, ExchangeError};
use crate::extras::{self, MAPPING_FILE};
use crate::foxglove::optical;
use crate::import_mcap::{Imported, ImportedChannel, in_world};
use crate::mapping::{CameraMapping, Mapping, PinholeMapping, PoseMapping};
use crate::messages::Picture;
use crate::pictures::{depth_of, file_of};
use crate::record::{RECORD_FILE, agrees, put};
use crate::table::{Cell, read_rows};

/// Greatest size of a file that describes the data, bytes.
const LARGEST: u64 = 256 << 20;
/// Files of a kind, at most.
const MOST_FILES: usize = 100_000;

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

/// Description of a data set.
struct DataSet {
    folder: PathBuf,
    info: Value,
    fps: f64,
}

/// Where the rows of an episode are.
struct Place {
    file: PathBuf,
    length: usize,
}

impl DataSet {
    fn open(folder: &Path) -> Result<Self, Defect> {
        let text = mvt_files::input::read_text(&folder.join("meta/info.json"), LARGEST).map_err(|error| {
            format!("meta/info.json cannot be read: {error}; give the folder of a data set of LeRobot")
        })?;
        let info: Value = serde_json::from_str(&text).map_err(|error| format!("meta/info.json is invalid: {error}"))?;
        let version = info.get("codebase_version").and_then(Value::as_str).unwrap_or("unknown");
        if !version.starts_with("v3.") {
            return Err(format!("its version is {version}; convert it to v3.0 with LeRobot first").into());
        }
        let fps = info.get("fps").and_then(Value::as_f64).filter(|fps| (1e-3..=1e5).contains(fps));
        let fps = fps.ok_or_else(|| "meta/info.json states no valid fps".to_owned())?;
        Ok(Self { folder: folder.to_path_buf(), info, fps })
    }

    /// Finds an episode in the tables of episodes.
    fn place(&self, episode: usize) -> Result<Place, Defect> {
        let columns = ["episode_index", "data/chunk_index", "data/file_index", "length"];
        let mut found = None;
        let mut episodes = 0;
        for path in files(&self.folder.join("meta/episodes")) {
            read_rows(&path, &columns, &mut |cells| -> Result<bool, Defect> {
                let numbers: Option<Vec<usize>> = cells.iter().map(|cell| whole(cell.as_ref())).collect();
                let Some([number, chunk, file, length]) = numbers.as_deref() else {
                    return Err(format!("{}: a row lacks one of {}", path.display(), columns.join(", ")).into());
                };
                episodes += 1;
                if *number == episode {
                    found = Some([*chunk, *file, *length]);
                }
                Ok(found.is_none())
            })?;
            if found.is_some() {
                break;
            }
        }
        let Some([chunk, file, length]) = found else {
            return Err(format!("it has {episodes} episodes, and none has the number {episode}").into());
        };
        let pattern = self.info.get("data_path").and_then(Value::as_str);
        let pattern = pattern.unwrap_or("data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet");
        let name = pattern
            .replace("{chunk_index:03d}", &format!("{chunk:03}"))
            .replace("{file_index:03d}", &format!("{file:03}"));
        if name.contains(['{', '\\']) || name.starts_with('/') || name.split('/').any(|part| part == "..") {
            return Err(format!("meta/info.json has the data_path {pattern:?}, which is not that of v3.0").into());
        }
        Ok(Place { file: self.folder.join(name), length })
    }

    /// Returns the places of the mapping's joints in a row of angles.
    fn order(&self, mapping: &Mapping) -> Result<Vec<usize>, String> {
        let column = &mapping.hand.joints;
        let feature = self.feature(column)?;
        // Names are a list, or lists under names of their own.
        let names = feature
            .get("names")
            .map_or(&Value::Null, |names| names.as_object().and_then(|groups| groups.values().next()).unwrap_or(names));
        let names: Vec<&str> = names.as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        let place = |name: &String| names.iter().position(|known| known == name);
        if let Some(order) = mapping.hand.names.iter().map(place).collect::<Option<Vec<_>>>() {
            return Ok(order);
        }
        let missing = mapping.hand.names.iter().find(|name| place(name).is_none());
        Err(format!(
            "{column} has no joint {:?} among {}; give hand.names in the mapping",
            missing.map_or("", String::as_str),
            names.iter().take(20).copied().collect::<Vec<_>>().join(", ")
        ))
    }

    fn feature(&self, column: &str) -> Result<&Value, String> {
        let features = self.info.get("features").and_then(Value::as_object);
        let known =
            || features.map(|all| all.keys().take(40).cloned().collect::<Vec<_>>().join(", ")).unwrap_or_default();
        let feature = features
            .and_then(|all| all.get(column))
            .ok_or_else(|| format!("it has no column {column:?}; its columns are {}", known()))?;
        if feature.get("dtype").and_then(Value::as_str) == Some("video") {
            return Err(format!(
                "{column} is a video, which cannot be imported; convert it to images with LeRobot first"
            ));
        }
        Ok(feature)
    }

    fn import(
        &self,
        episode: usize,
        mapping: &Mapping,
        extras: Option<&Path>,
        out: &Path,
        progress: &mut impl FnMut(usize, usize),
    ) -> Result<Imported, Defect> {
        let Place { file, length } = self.place(episode)?;
        let order = self.order(mapping)?;
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
        let mut writer = LogAssembler::create(out, cameras)?;
        let mut exact = exact_depths(extras, sizes.len())?;
        let mut log = Rows::default();
        read_rows(&file, &names, &mut |mut cells| -> Result<bool, Defect> {
            let at = |place: usize| cells.get(place).and_then(Option::as_ref);
            let numbers = (whole(at(0)), whole(at(1)));
            let (Some(of), Some(number)) = numbers else {
                return Err("a row has no episode_index or no frame_index".to_owned().into());
            };
            if of != episode {
                return Ok(log.joints.is_empty());
            }
            let frame = log.joints.len();
            let named = |column: &str, defect: &str| Defect::Words(format!("{column}: frame {frame}: {defect}"));
            log.joints.push(
                angles(at(2), &order)
                    .ok_or_else(|| named(&mapping.hand.joints, "it has not a finite number for each joint"))?,
            );
            let time = match time_at {
                None => Some(number as f64 / self.fps),
                Some(place) => at(place).and_then(number_of).filter(|time| time.is_finite()),
            };
            let time = time.ok_or_else(|| named("time", "it is no finite number"))?;
            if log.times_s.last().is_some_and(|last| *last >= time) {
                return Err(named("time", "it does not increase"));
            }
            log.times_s.push(time);
            log.poses.push(match pose_at.and_then(at) {
                None => None,
                Some(cell) => Some(Isometry::new(in_world(
                    mapping,
                    pose(cell).ok_or_else(|| {
                        named("the object's pose", "it is not x, y, z and a quaternion w, x, y, z of length 1")
                    })?,
                ))),
            });
            for (&(column, image), cell) in images.0.iter().zip(cells.drain(first_image..)) {
                let Some(Cell::Bytes(bytes)) = cell else { return Err(named(column, "it has no image file")) };
                let picture = Picture { data: &bytes, ..Picture::default() };
                match image {
                    Kind::Depth(k) => {
                        let (unit_m, size) = sizes.get(k).copied().unwrap_or_default();
                        let depth_m = match exact.get_mut(k).and_then(Option::as_mut) {
                            Some(reader) => next_depth(reader, size).map_err(|d| named(&extras::depth_file(k), &d))?,
                            None => depth_of(&picture, unit_m, size).map_err(|defect| named(column, &defect))?,
                        };
                        writer.push_depth(k, &depth_m)?;
                    }
                    Kind::File(image) => {
                        let turn = match image {
                            LogImage::Touch(finger) => mapping.touch.of(finger),
                            _ => None,
                        };
                        let file = file_of(&picture, image, turn).map_err(|defect| named(column, &defect))?;
                        writer.image(image, frame, &file, Path::new(column))?;
                    }
                }
            }
            progress(frame + 1, length);
            Ok(true)
        })?;
        let frames = log.joints.len();
        if frames != length || frames == 0 {
            return Err(format!("episode {episode} has {frames} rows, and the table of episodes says {length}").into());
        }
        self.finish(mapping, extras, out, log, writer, &images)
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
        let Rows { times_s, joints, poses } = log;
        let frames = joints.len();
        let read = |name: &str| mvt_files::input::read(&extras?.join(name), LARGEST).ok();
        let scene: Option<SceneFile> = read(SCENE_FILE).and_then(|bytes| serde_json::from_slice(&bytes).ok());
        // Damage may have changed it.
        let cameras = || mapping.cameras.iter().map(|camera| &camera.name);
        let scene = scene.filter(|scene| scene.hand == mapping.hand.side && scene.cameras.iter().eq(cameras()));
        let object_name = mapping.object.name.clone().unwrap_or_else(|| "object".to_owned());
        let names = mapping.cameras.iter().map(|camera| camera.name.as_str());
        let record = read(RECORD_FILE).filter(|record| agrees(record, &times_s, &joints, names));
        let mut notes =
            vec!["labels and true touch depth are not part of a data set: `run` labels pixels itself".to_owned()];
        for finger in Finger::ALL.into_iter().filter(|finger| mapping.touch.of(*finger).is_none()) {
            notes.push(format!("finger {} has no touch images: it is used without touch", finger.name()));
        }
        let unknown = poses.iter().filter(|pose| pose.is_none()).count();
        if unknown > 0 {
            notes.push(format!(
                "the true pose of the object is unknown in {unknown} of {frames} frames: they have no scores"
            ));
        }
        writer.finish(Timeline {
            object_name,
            side: mapping.hand.side,
            times_s,
            joints,
            object_poses: poses,
            scene,
        })?;
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

/// Returns the next depth image, of so many pixels.
fn next_depth(reader: &mut NpzReader, pixels: usize) -> Result<Vec<f32>, String> {
    let depth = reader.read().map_err(|error| error.to_string())?.filter(|depth| depth.len() == pixels);
    // The log has its camera's z, which is negative in front of it.
    let depth = depth.ok_or("it has too few images, or images of another size")?;
    Ok(depth.into_iter().map(f32::abs).collect())
}

/// Parts of an episode that are kept until its end.
#[derive(Default)]
struct Rows {
    times_s: Vec<f64>,
    joints: Vec<JointAngles>,
    poses: Vec<Option<Isometry<Object, World>>>,
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
        for finger in Finger::ALL {
            let Some(touch) = mapping.touch.of(finger) else { continue };
            columns.push((&touch.image, Kind::File(LogImage::Touch(finger))));
            let truth = [(&touch.depth, LogImage::TouchDepth(finger)), (&touch.contact, LogImage::Contact(finger))];
            columns
                .extend(truth.into_iter().filter_map(|(column, image)| Some((column.as_deref()?, Kind::File(image)))));
        }
        Self(columns)
    }
}

/// Unit of depth of a camera, metres, and its number of pixels.
type DepthSize = (f64, usize);

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
        let pixels = intrinsics.width * intrinsics.height;
        let camera = PosedCamera { name: name.clone(), intrinsics, pose };
        Ok((LogCamera { camera, distortion: None }, (*depth_unit_m, pixels)))
    };
    mapping.cameras.iter().map(one).collect()
}

/// Returns the Parquet files below a folder with folders, in the order of their names.
fn files(folder: &Path) -> Vec<PathBuf> {
    let list = |folder: &Path| {
        let mut all: Vec<PathBuf> = std::fs::read_dir(folder)
            .into_iter()
            .flatten()
            .filter_map(|entry| Some(entry.ok()?.path()))
            .take(MOST_FILES)
            .collect();
        all.sort();
        all
    };
    let is_table = |path: &PathBuf| path.extension().is_some_and(|end| end == "parquet");
    list(folder).iter().flat_map(|chunk| list(chunk)).filter(is_table).collect()
}

fn number_of(cell: &Cell) -> Option<f64> {
    match cell {
        Cell::Number(number) => Some(*number),
        Cell::Numbers(numbers) => numbers.first().copied().filter(|_| numbers.len() == 1),
        Cell::Bytes(_) => None,
    }
}

fn whole(cell: Option<&Cell>) -> Option<usize> {
    number_of(cell?).filter(|number| (0.0..1e15).contains(number)).map(|number| number as usize)
}

fn angles(cell: Option<&Cell>, order: &[usize]) -> Option<JointAngles> {
    let Some(Cell::Numbers(numbers)) = cell else { return None };
    let mut angles = [0.0; JOINTS];
    for (angle, place) in angles.iter_mut().zip(order) {
        *angle = numbers.get(*place).copied().filter(|angle| angle.is_finite())?;
    }
    Some(angles)
}

fn pose(cell: &Cell) -> Option<Isometry3<f64>> {
    let Cell::Numbers(numbers) = cell else { return None };
    let &[x, y, z, qw, qx, qy, qz] = numbers.as_slice() else { return None };
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    let is_pose = (quaternion.norm() - 1.0).abs() < 1e-3 && [x, y, z].iter().all(|value| value.is_finite());
    is_pose.then(|| Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(quaternion)))
}
