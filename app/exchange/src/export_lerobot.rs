//! Logs as a data set of LeRobot, version 3.0.

use std::collections::BTreeMap;
use std::fs;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mvt_feelsight::image::{ImageBuffer, ImageFormat, Luma, RgbImage};
use mvt_feelsight::{Log, LogFrame};
use mvt_files::output::PartialFile;
use mvt_frames::{Isometry, Object, World};
use mvt_recording::Recording;
use mvt_robot::hand::Hand;
use mvt_robot::ndarray::Array2;
use serde_json::{Value, json};

use crate::error::ExchangeError;
use crate::extras;
use crate::parquet::{Cells, Column, Parquet};
use crate::statistics::Statistics;

/// Rows that are held before they are written.
const GROUP: usize = 32;
/// Files in a folder, as LeRobot has it.
const FILES_IN_CHUNK: usize = 1000;
/// Step of camera depth, metres.
const DEPTH_STEP_M: f64 = 1e-4;
/// Numbers of a pose: x, y, z in metres, then the quaternion w, x, y, z.
const POSE: usize = 7;

/// Contents of an exported data set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ExportedDataSet {
    /// Number of episodes: one for each log.
    pub episodes: usize,
    /// Number of frames of all episodes.
    pub frames: usize,
}

/// Writes logs as a data set of LeRobot v3.0 in the folder `out`, which must not exist or be empty. `advance` is called after each frame.
///
/// | column | contents |
/// |---|---|
/// | `observation.images.NAME` | colours of a camera: the JPEG file of the log |
/// | `observation.images.NAME_depth` | depth of a camera: PNG with 16 bits, steps of 0.1 mm, 0 where nothing was measured |
/// | `observation.images.touch_PAD` | image of a touch sensor: the file of the log |
/// | `observation.state` | joint angles, rad |
/// | `action` | joint angles of the next frame, rad |
/// | `observation.object_pose` | x, y, z in metres and quaternion w, x, y, z in the world; only if every frame has it |
/// | `observation.estimate_pose` | the same numbers of the estimated pose, with `runs` |
/// | `observation.estimate_confidence` | part of the measurements that agree with the estimate, 0 to 1, with `runs` |
/// | `observation.time_s` | time of the log, seconds; `timestamp` is frame_index by fps |
///
/// `runs` are folders of runs with the logs, one for each log in their order, or none: their estimates become columns.
///
/// With `exact_depth` the depth files of the logs are copied beside the tables, so that an import has depth to the bit. Compact logs need none.
///
/// # Errors
/// [`ExchangeError`] if a log cannot be read, the logs have other cameras or rates, or a file cannot be written. `meta/info.json`, without which
/// no data set can be loaded, is written last.
pub fn export_lerobot(
    logs: &[PathBuf],
    runs: &[PathBuf],
    out: &Path,
    exact_depth: bool,
    mut advance: impl FnMut(),
) -> Result<ExportedDataSet, ExchangeError> {
    let is_vacant = fs::read_dir(out).map_or(true, |mut entries| entries.next().is_none());
    if !is_vacant {
        return Err(ExchangeError::Exists(out.to_path_buf()));
    }
    let opened = logs.iter().map(|path| Log::open(path)).collect::<Result<Vec<_>, _>>()?;
    let layout = Layout { has_estimates: !runs.is_empty(), ..Layout::of(&opened)? };
    if layout.has_estimates && runs.len() != logs.len() {
        let defect = format!("there are {} runs for {} logs; give one for each log", runs.len(), logs.len());
        return Err(ExchangeError::Source { path: out.to_path_buf(), defect });
    }
    let mut set = DataSet {
        out,
        layout,
        exact_depth,
        statistics: BTreeMap::new(),
        frames: 0,
        episodes: Vec::new(),
        tasks: Vec::new(),
    };
    for (k, log) in opened.iter().enumerate() {
        let estimates = runs.get(k).map(|run| estimates(run, log)).transpose()?;
        set.episode(log, estimates.as_deref(), &mut advance)?;
    }
    set.finish()
}

/// What all logs of a data set have in common.
struct Layout {
    fps: u32,
    hand: Arc<Hand>,
    has_poses: bool,
    has_estimates: bool,
    /// Name, height and width of each camera, and whether it has colours.
    cameras: Vec<(String, usize, usize, bool)>,
    /// Names of the pads whose sensors have images, with rows and columns.
    touch: Vec<(String, [usize; 2])>,
}

impl Layout {
    fn of(logs: &[Log]) -> Result<Self, ExchangeError> {
        let cameras = |log: &Log| {
            let one = |(k, camera): (usize, &mvt_frames::camera::PosedCamera)| {
                (camera.name.clone(), camera.intrinsics.height, camera.intrinsics.width, log.has_colours(k))
            };
            log.cameras().iter().enumerate().map(one).collect::<Vec<_>>()
        };
        let touch = |log: &Log| {
            let felt = log.hand().pads().iter().enumerate().filter(|(k, _)| log.has_touch_images(*k));
            felt.map(|(_, pad)| (pad.name.clone(), pad.profile.shape())).collect::<Vec<_>>()
        };
        // The hands of the logs may be a left and a right one.
        let joints = |log: &Log| log.hand().joints().iter().map(|joint| joint.name.clone()).collect::<Vec<_>>();
        let refused = |log: &Log, defect: String| ExchangeError::Source { path: log.folder().to_path_buf(), defect };
        let Some(first) = logs.first() else {
            return Err(ExchangeError::Source { path: PathBuf::new(), defect: "give one log or more".to_owned() });
        };
        let (expected, fps) = (cameras(first), rate(first));
        for log in logs {
            if cameras(log) != expected || touch(log) != touch(first) || joints(log) != joints(first) {
                return Err(refused(
                    log,
                    "its cameras, touch sensors or joints are not those of the first log; export it alone".to_owned(),
                ));
            }
            let found = rate(log);
            if (found - fps).abs() > 0.01 * fps || fps.round() < 1.0 {
                return Err(refused(log, format!("it has {found:.1} frames per second and the first log {fps:.1}")));
            }
        }
        let has_poses = logs.iter().all(|log| log.object_poses().iter().all(Option::is_some));
        Ok(Self {
            fps: fps.round() as u32,
            hand: Arc::clone(first.hand()),
            has_poses,
            has_estimates: false,
            cameras: expected,
            touch: touch(first),
        })
    }

    /// Returns the columns of the data, in their order, with what info.json says of each.
    fn features(&self) -> Vec<(Column, Value)> {
        let image = |name: String, height: usize, width: usize, channels: usize, info: Value| {
            let names = ["height", "width", "channels"];
            let value = json!({"dtype": "image", "shape": [height, width, channels], "names": names, "info": info});
            (Column { name, width: 1 }, value)
        };
        let numbers = |name: &str, dtype: &str, width: usize, names: Value| {
            (Column { name: name.to_owned(), width }, json!({"dtype": dtype, "shape": [width], "names": names}))
        };
        let mut features = Vec::new();
        for (name, height, width, has_colours) in &self.cameras {
            if *has_colours {
                features.push(image(format!("observation.images.{name}"), *height, *width, 3, Value::Null));
            }
            let depth = json!({"is_depth_map": true, "depth_unit": DEPTH_STEP_M});
            features.push(image(format!("observation.images.{name}_depth"), *height, *width, 1, depth));
        }
        for (pad, [rows, columns]) in &self.touch {
            features.push(image(extras::touch_column(pad), *rows, *columns, 3, Value::Null));
        }
        let joints: Vec<&str> = self.hand.joints().iter().map(|joint| joint.name.as_str()).collect();
        features.push(numbers("observation.state", "float32", joints.len(), json!(joints)));
        features.push(numbers("action", "float32", joints.len(), json!(joints)));
        let pose = |name: &str| numbers(name, "float64", POSE, json!(["x", "y", "z", "qw", "qx", "qy", "qz"]));
        if self.has_poses {
            features.push(pose("observation.object_pose"));
        }
        if self.has_estimates {
            features.push(pose("observation.estimate_pose"));
            features.push(numbers("observation.estimate_confidence", "float32", 1, Value::Null));
        }
        features.push(numbers("observation.time_s", "float64", 1, Value::Null));
        features.push(numbers("timestamp", "float32", 1, Value::Null));
        for name in ["frame_index", "episode_index", "index", "task_index"] {
            features.push(numbers(name, "int64", 1, Value::Null));
        }
        features
    }
}

/// Pose of the object and confidence, which a run estimated in a frame.
type Estimated = (Vec<f64>, f64);

/// Returns the estimates of a run, one for each frame of the log.
fn estimates(run: &Path, log: &Log) -> Result<Vec<Estimated>, ExchangeError> {
    let recording = Recording::open(run)?;
    let moments = recording.moments();
    // The times of a recording are rounded.
    const SAME_S: f64 = 1e-6;
    let mut times = moments.iter().zip(log.times_s());
    let of_log = moments.len() == log.len() && times.all(|(moment, time)| (moment.row.time_s - time).abs() < SAME_S);
    if !of_log {
        let defect =
            format!("it is no run of the whole log {}; make one with `mambavitact run --log`", log.folder().display());
        return Err(ExchangeError::Source { path: run.to_path_buf(), defect });
    }
    Ok(moments.iter().map(|moment| (numbers(moment.row.estimate), moment.row.confidence)).collect())
}

/// Returns the numbers of a pose.
fn numbers(pose: Isometry<Object, World>) -> Vec<f64> {
    let origin = pose.origin().coords();
    [origin.x, origin.y, origin.z].into_iter().chain(pose.quaternion_wxyz()).collect()
}

/// Returns the usual number of frames per second.
fn rate(log: &Log) -> f64 {
    let mut steps: Vec<f64> = log.times_s().windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_unstable_by(f64::total_cmp);
    steps.get(steps.len() / 2).map_or(30.0, |step| 1.0 / step)
}

/// An episode in the list of episodes.
struct Episode {
    task: usize,
    length: usize,
    from: usize,
}

/// A data set that is being written.
struct DataSet<'a> {
    out: &'a Path,
    layout: Layout,
    exact_depth: bool,
    statistics: BTreeMap<String, Statistics>,
    frames: usize,
    episodes: Vec<Episode>,
    tasks: Vec<String>,
}

impl DataSet<'_> {
    fn write(
        &self,
        file: &str,
        write: impl FnOnce(BufWriter<&mut fs::File>) -> std::io::Result<()>,
    ) -> Result<(), ExchangeError> {
        let path = self.out.join(file);
        let written = || {
            path.parent().map_or(Ok(()), fs::create_dir_all)?;
            let mut partial = PartialFile::create(&path)?;
            write(BufWriter::new(partial.file()))?;
            partial.finish()
        };
        written().map_err(|reason| ExchangeError::Io { path: path.clone(), reason })
    }

    /// Writes the frames of a log.
    fn episode(
        &mut self,
        log: &Log,
        estimates: Option<&[Estimated]>,
        advance: &mut impl FnMut(),
    ) -> Result<(), ExchangeError> {
        let number = self.episodes.len();
        let text = format!("turn the object {} in the hand", log.object_name());
        let task = self.tasks.iter().position(|known| *known == text).unwrap_or(self.tasks.len());
        if task == self.tasks.len() {
            self.tasks.push(text);
        }
        let features = self.layout.features();
        let path = self.out.join(data_file(number));
        let io = |reason| ExchangeError::Io { path: path.clone(), reason };
        path.parent().map_or(Ok(()), fs::create_dir_all).map_err(io)?;
        let mut partial = PartialFile::create(&path).map_err(io)?;
        let columns: Vec<Column> = features.into_iter().map(|(column, _)| column).collect();
        let mut file = Parquet::new(BufWriter::new(partial.file()), columns.clone()).map_err(io)?;
        let sampled = sampled(log.len());
        let mut rows: Vec<Vec<Cells>> = Vec::new();
        for (k, frame) in log.frames()?.enumerate() {
            let estimate = estimates.and_then(|estimates| estimates.get(k));
            let row = self.row(log, k, &frame?, estimate, [number, self.frames + k, task], sampled.contains(&k))?;
            rows.push(row);
            if rows.len() == GROUP || k + 1 == log.len() {
                file.push(rows.len(), &joined(std::mem::take(&mut rows))).map_err(io)?;
            }
            advance();
        }
        file.finish(&[]).map_err(io)?;
        partial.finish().map_err(io)?;
        let extra = |name: &str| extras::folder(number).join(name).to_string_lossy().into_owned();
        for (name, bytes) in extras::files(log, self.layout.has_poses)? {
            self.write(&extra(name), |mut file| std::io::Write::write_all(&mut file, &bytes))?;
        }
        let depths = if self.exact_depth { extras::depths(log) } else { Vec::new() };
        for (name, source) in depths {
            self.write(&extra(&name), |mut file| {
                std::io::copy(&mut mvt_files::input::open(&source)?, &mut file).map(drop)
            })?;
        }
        self.episodes.push(Episode { task, length: log.len(), from: self.frames });
        self.frames += log.len();
        Ok(())
    }

    /// Returns the cells of a frame in the order of the columns.
    fn row(
        &mut self,
        log: &Log,
        k: usize,
        frame: &LogFrame,
        estimate: Option<&Estimated>,
        [episode, index, task]: [usize; 3],
        is_sampled: bool,
    ) -> Result<Vec<Cells>, ExchangeError> {
        let observation = &frame.observation;
        let files = log.image_files(k)?;
        let absent = |sensor: &str| ExchangeError::Source {
            path: log.folder().to_path_buf(),
            defect: format!(
                "frame {k} has no image of {sensor}, and LeRobot needs one in each frame; export the log as MCAP"
            ),
        };
        let mut cells = Vec::new();
        let image = |bytes: Vec<u8>| {
            let ending = if bytes.starts_with(b"\x89PNG") { "png" } else { "jpg" };
            Cells::Images(vec![(bytes, format!("frame-{k:06}.{ending}"))])
        };
        for ((name, _, _, has_colours), (rgbd, file)) in
            self.layout.cameras.iter().zip(observation.cameras.iter().zip(files.colours))
        {
            let key = format!("observation.images.{name}");
            if let Some(file) = file {
                if is_sampled {
                    sample(self.statistics.entry(key).or_default(), &rgbd.color);
                }
                cells.push(image(file));
            } else if *has_colours {
                return Err(absent(name));
            }
            let depth = depth_file(&rgbd.depth_m)
                .map_err(|defect| ExchangeError::Source { path: log.folder().to_path_buf(), defect })?;
            cells.push(image(depth));
        }
        let touch = log.hand().pads().iter().zip(files.touch).zip(&observation.touch);
        for (k, ((pad, file), picture)) in touch.enumerate() {
            let Some(file) = file else {
                if log.has_touch_images(k) {
                    return Err(absent(&format!("the touch sensor {}", pad.name)));
                }
                continue;
            };
            if is_sampled {
                sample(self.statistics.entry(extras::touch_column(&pad.name)).or_default(), picture);
            }
            cells.push(image(file));
        }
        let single = |values: &[f64]| values.iter().map(|&value| value as f32).collect::<Vec<_>>();
        let action = log.joints().get(k + 1).unwrap_or(&observation.joints);
        let timestamp = (k as f64 / f64::from(self.layout.fps)) as f32;
        let pose = log.object_poses().get(k).copied().flatten().filter(|_| self.layout.has_poses);
        let mut number = |key: &str, values: &[f64]| self.statistics.entry(key.to_owned()).or_default().add(values);
        number("observation.state", &observation.joints);
        number("action", action);
        number("observation.time_s", &[observation.time_s]);
        number("timestamp", &[f64::from(timestamp)]);
        cells.push(Cells::SingleLists(single(&observation.joints)));
        cells.push(Cells::SingleLists(single(action)));
        if let Some(pose) = pose.map(numbers) {
            number("observation.object_pose", &pose);
            cells.push(Cells::DoubleLists(pose));
        }
        if let Some((pose, confidence)) = estimate {
            number("observation.estimate_pose", pose);
            number("observation.estimate_confidence", &[*confidence]);
            cells.push(Cells::DoubleLists(pose.clone()));
            cells.push(Cells::Singles(vec![*confidence as f32]));
        }
        cells.push(Cells::Doubles(vec![observation.time_s]));
        cells.push(Cells::Singles(vec![timestamp]));
        for (key, value) in [("frame_index", k), ("episode_index", episode), ("index", index), ("task_index", task)] {
            number(key, &[value as f64]);
            cells.push(Cells::Integers(vec![value as i64]));
        }
        Ok(cells)
    }

    /// Writes what describes the data; last what makes them a data set.
    fn finish(self) -> Result<ExportedDataSet, ExchangeError> {
        let column = |name: &str| Column { name: name.to_owned(), width: 1 };
        let count = self.tasks.len();
        self.write("meta/tasks.parquet", |file| {
            let mut table = Parquet::new(file, vec![column("task_index"), column("__index_level_0__")])?;
            table.push(count, &[Cells::Integers((0..count as i64).collect()), Cells::Texts(self.tasks.clone())])?;
            table.finish(&[("pandas", pandas_index().to_string())])
        })?;
        let of = |value: &dyn Fn(usize, &Episode) -> usize| {
            Cells::Integers(self.episodes.iter().enumerate().map(|(k, episode)| value(k, episode) as i64).collect())
        };
        let task = |episode: &Episode| self.tasks.get(episode.task).cloned().unwrap_or_default();
        let columns = [
            ("episode_index", of(&|k, _| k)),
            ("tasks", Cells::TextLists(self.episodes.iter().map(task).collect())),
            ("length", of(&|_, episode| episode.length)),
            ("data/chunk_index", of(&|k, _| k / FILES_IN_CHUNK)),
            ("data/file_index", of(&|k, _| k % FILES_IN_CHUNK)),
            ("dataset_from_index", of(&|_, episode| episode.from)),
            ("dataset_to_index", of(&|_, episode| episode.from + episode.length)),
            ("meta/episodes/chunk_index", of(&|_, _| 0)),
            ("meta/episodes/file_index", of(&|_, _| 0)),
        ];
        self.write("meta/episodes/chunk-000/file-000.parquet", |file| {
            let (names, cells): (Vec<_>, Vec<_>) =
                columns.into_iter().map(|(name, cells)| (column(name), cells)).unzip();
            let mut table = Parquet::new(file, names)?;
            table.push(self.episodes.len(), &cells)?;
            table.finish(&[])
        })?;
        let pretty = |value: &Value| serde_json::to_vec_pretty(value).map_err(std::io::Error::other);
        let statistics: serde_json::Map<String, Value> =
            self.statistics.iter().map(|(key, of)| (key.clone(), of.to_json())).collect();
        self.write("meta/stats.json", |mut file| {
            std::io::Write::write_all(&mut file, &pretty(&Value::Object(statistics))?)
        })?;
        let features: serde_json::Map<String, Value> =
            self.layout.features().into_iter().map(|(column, value)| (column.name, value)).collect();
        let info = json!({
            "codebase_version": "v3.0",
            "robot_type": self.layout.hand.name(),
            "total_episodes": self.episodes.len(),
            "total_frames": self.frames,
            "total_tasks": count,
            "chunks_size": FILES_IN_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self.layout.fps,
            "splits": {"train": format!("0:{}", self.episodes.len())},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": null,
            "features": features,
        });
        self.write("meta/info.json", |mut file| std::io::Write::write_all(&mut file, &pretty(&info)?))?;
        Ok(ExportedDataSet { episodes: self.episodes.len(), frames: self.frames })
    }
}

fn data_file(episode: usize) -> String {
    format!("data/chunk-{:03}/file-{:03}.parquet", episode / FILES_IN_CHUNK, episode % FILES_IN_CHUNK)
}

/// Returns the frames whose images stand for all in statistics: as many as LeRobot takes.
fn sampled(length: usize) -> Vec<usize> {
    let count = ((length as f64).powf(0.75) as usize).clamp(length.min(100), 10_000);
    let step = (length - 1) as f64 / (count.max(2) - 1) as f64;
    (0..count).map(|k| (k as f64 * step).round_ties_even() as usize).collect()
}

/// Adds the pixels of an image, as thin as LeRobot does.
fn sample(statistics: &mut Statistics, image: &RgbImage) {
    let (width, height) = image.dimensions();
    let longest = width.max(height);
    let every = if longest < 300 { 1 } else { (longest / 150).max(1) as usize };
    let rows = (0..height).step_by(every).flat_map(|y| (0..width).step_by(every).map(move |x| (x, y)));
    statistics.add_pixels(rows.map(|(x, y)| &image.get_pixel(x, y).0));
}

/// Returns depth as PNG with 16 bits.
fn depth_file(depth_m: &Array2<f32>) -> Result<Vec<u8>, String> {
    let (height, width) = depth_m.dim();
    let steps = |&depth: &f32| {
        let steps = (f64::from(depth) / DEPTH_STEP_M).round();
        if steps <= f64::from(u16::MAX) { steps as u16 } else { 0 }
    };
    let image = ImageBuffer::<Luma<u16>, _>::from_raw(
        width as u32,
        height as u32,
        depth_m.iter().map(steps).collect::<Vec<u16>>(),
    );
    let mut file = std::io::Cursor::new(Vec::new());
    let image = image.ok_or("the depth has holes")?;
    image.write_to(&mut file, ImageFormat::Png).map_err(|error| error.to_string())?;
    Ok(file.into_inner())
}

/// Joins the cells of rows, column by column.
fn joined(rows: Vec<Vec<Cells>>) -> Vec<Cells> {
    let mut rows = rows.into_iter();
    let mut all = rows.next().unwrap_or_default();
    for row in rows {
        all.iter_mut().zip(row).for_each(|(column, cells)| column.append(cells));
    }
    all
}

/// Returns what pandas writes of a table whose index has no name and holds texts.
fn pandas_index() -> Value {
    let described = |name: Value, field: &str, kind: &str, numpy: &str| json!({"name": name, "field_name": field, "pandas_type": kind, "numpy_type": numpy, "metadata": null});
    json!({
        "index_columns": ["__index_level_0__"],
        "column_indexes": [{"name": null, "field_name": null, "pandas_type": "unicode", "numpy_type": "object", "metadata": {"encoding": "UTF-8"}}],
        "columns": [
            described(json!("task_index"), "task_index", "int64", "int64"),
            described(Value::Null, "__index_level_0__", "unicode", "object"),
        ],
        "creator": {"library": "mambavitact", "version": env!("CARGO_PKG_VERSION")},
        "pandas_version": "2.0.0",
    })
}
