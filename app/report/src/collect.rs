//! Finds runs and tables of runs below folders.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::fs;
use std::path::{Path, PathBuf};

use mvt_files::input;
use mvt_recording::{About, FOLDER};
use mvt_run::report::{FrameRow, TrackState, file, read_trajectory};
use rayon::prelude::*;

use crate::ReportError;
use crate::row::{ErrorCurve, INFINITE_MM, ReportRow};

/// Largest file of a run, and largest table, that is read, bytes.
const LARGEST_FILE: u64 = 256 << 20;
const LARGEST_TABLE: u64 = 2 << 30;
/// Folders are searched so deep.
const DEEPEST: usize = 12;
/// Most points of an error curve.
const CURVE_POINTS: usize = 150;
/// Times from here on are damaged, seconds.
const LONGEST_S: f64 = 1e6;
/// Name of the file with the settings of a run, whose first line is the command that repeats it.
const CONFIG: &str = "config.toml";

/// Runs below some folders.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RunCollection {
    /// Names of the folders, as given.
    pub folders: Vec<PathBuf>,
    /// The runs, in the order of their identities.
    pub rows: Vec<ReportRow>,
    /// The skipped files, a line each.
    pub warnings: Vec<String>,
}

/// A folder of a run or a table, as it was found.
enum Found {
    Run(PathBuf),
    Table(PathBuf),
}

impl RunCollection {
    /// Reads all runs and tables (`*.jsonl`) in and below folders. Links to folders are not followed. Files that are
    /// damaged or no results of runs are left out with a warning.
    ///
    /// # Errors
    /// If a folder cannot be read, or there is no run in any.
    pub fn read(folders: &[PathBuf]) -> Result<Self, ReportError> {
        let mut found = Vec::new();
        let mut warnings = Vec::new();
        for folder in folders {
            search(folder, 0, &mut found, &mut warnings)
                .map_err(|error| ReportError::Io { path: folder.clone(), error })?;
        }
        let mut known = HashSet::new();
        found.retain(|(Found::Run(path) | Found::Table(path))| {
            known.insert(fs::canonicalize(path).unwrap_or_else(|_| path.clone()))
        });
        let read: Vec<(Vec<ReportRow>, Vec<String>)> = found
            .par_iter()
            .map(|found| match found {
                Found::Run(folder) => match run(folder) {
                    Ok((row, warnings)) => (vec![row], warnings),
                    Err(problem) => (vec![], vec![format!("{} is skipped: {problem}", folder.display())]),
                },
                Found::Table(path) => table(path),
            })
            .collect();
        let mut rows = Vec::new();
        for (more, complaints) in read {
            rows.extend(more);
            warnings.extend(complaints);
        }
        if rows.is_empty() {
            return Err(ReportError::NoRuns { folders: folders.to_vec(), reason: warnings.into_iter().next() });
        }
        let mut collection = Self { folders: folders.to_vec(), rows, warnings };
        collection.merge();
        collection.name_settings();
        Ok(collection)
    }

    /// Orders the rows and leaves out runs that occur twice, and lines of runs whose folder is there.
    fn merge(&mut self) {
        let order = |row: &ReportRow| (row.id.clone(), row.settings.clone(), row.folder.is_none(), row.folder.clone());
        self.rows.sort_by_cached_key(order);
        let is_same =
            |a: &ReportRow, b: &ReportRow| a.frames == b.frames && a.add_s == b.add_s && a.f_score == b.f_score;
        let mut kept: Vec<ReportRow> = Vec::with_capacity(self.rows.len());
        let mut twice = 0;
        for row in std::mem::take(&mut self.rows) {
            let start = kept.partition_point(|other| other.id < row.id);
            let others = kept.get_mut(start..).unwrap_or_default();
            // Folders and lines of the same run describe its settings in other words.
            let is_twin = |other: &ReportRow| match other.folder.is_some() == row.folder.is_some() {
                true => other.settings == row.settings,
                false => is_same(other, &row),
            };
            let Some(other) = others.iter_mut().find(|other| is_twin(other)) else {
                kept.push(row);
                continue;
            };
            if !is_same(other, &row) {
                twice += 1;
            } else if other.folder.is_none() && row.folder.is_some() {
                *other = ReportRow { hidden: other.hidden.or(row.hidden), ..row };
            } else {
                other.hidden = other.hidden.or(row.hidden);
            }
        }
        self.rows = kept;
        if twice > 0 {
            self.warnings.push(format!(
                "{twice} runs are left out, because a run with the same object, seed, sensors and settings has other \
                 results; give sweeps that should be compared as DIR and --against DIR"
            ));
        }
        let cut_off = self.rows.iter().filter(|row| !row.is_complete).count();
        if cut_off > 0 {
            self.warnings
                .push(format!("{cut_off} runs did not come to their end; they are listed, but no figure counts them"));
        }
    }

    /// Appends a hash of the settings to the variant where runs of one kind have several settings.
    fn name_settings(&mut self) {
        let mut of_kind = BTreeMap::<_, BTreeSet<String>>::new();
        for row in &self.rows {
            of_kind.entry(row.id.kind.clone()).or_default().insert(row.settings.clone());
        }
        for row in &mut self.rows {
            if of_kind.get(&row.id.kind).is_some_and(|settings| settings.len() > 1) {
                let hash: String = row.settings.chars().take(8).collect();
                row.id.kind.variant = format!("{} #{hash}", row.id.kind.variant);
            }
        }
        self.rows.sort_by(|a, b| a.id.cmp(&b.id));
    }

    /// Returns the complete runs by kind.
    pub fn kinds(&self) -> BTreeMap<&crate::row::RunKind, Vec<&ReportRow>> {
        let mut kinds = BTreeMap::<_, Vec<&ReportRow>>::new();
        for row in self.rows.iter().filter(|row| row.is_complete) {
            kinds.entry(&row.id.kind).or_default().push(row);
        }
        kinds
    }
}

/// Finds runs and tables in and below a folder, in the order of their names.
fn search(folder: &Path, depth: usize, found: &mut Vec<Found>, warnings: &mut Vec<String>) -> std::io::Result<()> {
    let mut entries: Vec<fs::DirEntry> = fs::read_dir(folder)?.collect::<Result<_, _>>()?;
    entries.sort_by_key(fs::DirEntry::file_name);
    if entries.iter().any(|entry| entry.file_name() == file::SUMMARY || entry.file_name() == FOLDER) {
        found.push(Found::Run(folder.to_path_buf()));
        return Ok(());
    }
    for entry in entries {
        let path = entry.path();
        if entry.file_name().to_string_lossy().starts_with('.') {
            continue;
        }
        if entry.file_type()?.is_dir() {
            // A folder that this user may not read hides no others.
            if depth == DEEPEST {
                warnings.push(format!("{} is skipped, because it lies too deep", path.display()));
            } else if let Err(error) = search(&path, depth + 1, found, warnings) {
                warnings.push(format!("{} is skipped: {error}", path.display()));
            }
        } else if path.extension().is_some_and(|extension| extension == "jsonl") {
            found.push(Found::Table(path));
        }
    }
    Ok(())
}

/// Reads the lines of a table. Of lines that are no results, the first is named.
fn table(path: &Path) -> (Vec<ReportRow>, Vec<String>) {
    let text = match input::read_text(path, LARGEST_TABLE) {
        Ok(text) => text,
        Err(error) => return (vec![], vec![format!("{} is skipped: {error}", path.display())]),
    };
    let mut rows = Vec::new();
    let mut first: Option<String> = None;
    let mut skipped = 0;
    for (number, line) in (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty()) {
        match ReportRow::of_line(line) {
            Ok(row) => rows.push(row),
            Err(error) => {
                skipped += 1;
                first.get_or_insert_with(|| format!("line {number}: {error}"));
            }
        }
    }
    let warning = first.map(|first| match rows.len() {
        0 => format!("{} is skipped, because its lines are no results of runs ({first})", path.display()),
        _ => format!("{}: {skipped} lines are skipped, because they are no results of runs ({first})", path.display()),
    });
    (rows, warning.into_iter().collect())
}

/// Reads the folder of a run.
fn run(folder: &Path) -> Result<(ReportRow, Vec<String>), String> {
    let mut warnings = Vec::new();
    let path = folder.join(file::SUMMARY);
    let text = input::read_text(&path, LARGEST_FILE).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => {
            "it has no summary.json, because its run ended before the first frame".to_owned()
        }
        _ => format!("summary.json: {error}"),
    })?;
    let mut row = ReportRow::of_summary(&text).map_err(|error| format!("summary.json: {error}"))?;
    row.folder = Some(folder.to_path_buf());
    // Runs of other programs have no recording, and their cameras are unknown.
    if let Ok(about) = About::read(folder) {
        let names: Vec<&str> = about.cameras.iter().map(|camera| camera.name.as_str()).collect();
        row.id.kind.cameras = names.join(",");
    }
    if let Ok(text) = input::read_text(&folder.join(CONFIG), LARGEST_FILE) {
        let (first, rest) = text.split_once('\n').unwrap_or((&text, ""));
        row.command = first.strip_prefix("# ").map(str::to_owned);
        row.settings = format!("{:08x}", crc32fast::hash((without_episode(first) + rest).as_bytes()));
    }
    let path = folder.join(file::TRAJECTORY);
    match input::read_text(&path, LARGEST_FILE)
        .map_err(|error| error.to_string())
        .and_then(|text| read_trajectory(&text).map_err(|error| error.to_string()))
    {
        Ok(frames) => {
            row.curve = curve(&frames);
            row.is_undeclared &= frames.last().is_some_and(|frame| frame.state != TrackState::Lost);
        }
        Err(problem) => warnings.push(format!("{}: {problem}; its errors over time are missing", path.display())),
    }
    Ok((row, warnings))
}

/// Returns the command of a run without its object, seed and log, which are no settings.
fn without_episode(command: &str) -> String {
    let mut is_kept = true;
    let keeps = |word: &&str| {
        // A value with spaces has several words.
        if word.starts_with("--") {
            is_kept = !["--object", "--seed", "--log"].contains(word);
        }
        is_kept
    };
    command.split(' ').filter(keeps).collect()
}

/// Thins out the errors of frames to means over equal stretches.
fn curve(frames: &[FrameRow]) -> ErrorCurve {
    let errors: Vec<[f64; 2]> = frames
        .iter()
        .filter_map(|row| Some([row.time_s, 1e3 * row.add_s?.one_directional_m]))
        .filter(|[time_s, error_mm]| time_s.abs() < LONGEST_S && (0.0..INFINITE_MM).contains(error_mm))
        .collect();
    let stretch = errors.len().div_ceil(CURVE_POINTS).max(1);
    let mean =
        |points: &[[f64; 2]]| [0, 1].map(|k| points.iter().map(|point| point[k]).sum::<f64>() / points.len() as f64);
    let points = errors.chunks(stretch).map(mean).collect();
    let spans = frames.chunk_by(|a, b| (a.state == TrackState::Lost) == (b.state == TrackState::Lost));
    let lost = spans
        .filter(|span| span.first().is_some_and(|row| row.state == TrackState::Lost))
        .filter_map(|span| Some([span.first()?.time_s, span.last()?.time_s]))
        .collect();
    ErrorCurve { points, lost }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: &str = r#"{"object":"OBJECT","seed":1,"cameras":"side","mode":"slam","modality":"vitac","variant":"full","settings":"SETTINGS",
        "frames":120,"end":"","hidden":0.3,"f_score":{"5":0.95},"add_s_mm":{"mean":MEAN,"median":1,"p95":2,"final":1},"lost_frames":0,"frames_per_second":30}"#;

    fn line(object: &str, settings: &str, mean: &str) -> String {
        LINE.replace('\n', "").replace("OBJECT", object).replace("SETTINGS", settings).replace("MEAN", mean) + "\n"
    }

    const SUMMARY: &str = r#"{"complete":true,"object":"ball","seed":1,"mode":"slam","modality":"vitac","frames":120,
        "f_score":{"5":0.95},"add_s_mm":{"mean":1.25,"median":1,"p95":2,"final":1},"lost_frames":0,"events":[]}"#;

    #[test]
    fn tables_and_runs_are_found_at_any_depth() {
        let home = tempfile::tempdir().unwrap();
        let at = |name: &str| home.path().join(name);
        fs::create_dir_all(at("a/b")).unwrap();
        fs::create_dir_all(at("a/run/recording")).unwrap();
        fs::create_dir_all(at("cut/recording")).unwrap();
        fs::create_dir_all(at("other")).unwrap();
        fs::write(at("a/b/runs.jsonl"), line("mug", "1", "2") + &line("can", "1", "3") + "{\"object\":\"cu").unwrap();
        fs::write(at("a/run/summary.json"), SUMMARY).unwrap();
        // Inside a run nothing is a table.
        fs::write(at("a/run/recording/frames.jsonl"), "{}\n").unwrap();
        fs::write(at("other/faults.jsonl"), "{}\n{}\n").unwrap();
        fs::write(at("summary.txt"), "").unwrap();
        let found = RunCollection::read(&[home.path().to_path_buf()]).unwrap();
        let objects: Vec<&str> = found.rows.iter().map(|row| row.id.object.as_str()).collect();
        assert_eq!(objects, ["ball", "can", "mug"]);
        let warned = found.warnings.join("\n");
        for expected in [
            "runs.jsonl: 1 lines are skipped",
            "line 3: EOF",
            "faults.jsonl is skipped",
            "no summary.json",
            "trajectory.csv",
        ] {
            assert!(warned.contains(expected), "{expected}: {warned}");
        }
        assert_eq!(found.warnings.len(), 4, "{warned}");
        // The same folder given twice holds the same runs.
        let twice = RunCollection::read(&[home.path().to_path_buf(), at("a")]).unwrap();
        assert_eq!(twice.rows, found.rows);
    }

    #[test]
    fn runs_of_other_objects_and_logs_have_the_same_settings() {
        let command = |log: &str, seed: u64, mode: &str| {
            without_episode(&format!("mambavitact run --object ball --log {log} --seed {seed} --mode {mode}"))
        };
        assert_eq!(command("logs/a/00", 1, "slam"), command("'my logs/b/01'", 2, "slam"));
        assert_ne!(command("logs/a/00", 1, "slam"), command("logs/a/00", 1, "pose"));
    }

    #[test]
    fn folders_without_runs_are_errors() {
        let home = tempfile::tempdir().unwrap();
        let read = |path: &Path| RunCollection::read(&[path.to_path_buf()]).unwrap_err().to_string();
        assert!(read(home.path()).contains("no run"), "{}", read(home.path()));
        assert!(read(&home.path().join("none")).contains("No such file"));
        fs::write(home.path().join("summary.json"), SUMMARY.replace("1.25", "NaN")).unwrap();
        assert!(read(home.path()).contains("summary.json: expected value"), "{}", read(home.path()));
    }

    #[test]
    fn equal_runs_are_counted_once_and_settings_are_told_apart() {
        let home = tempfile::tempdir().unwrap();
        let at = |name: &str| home.path().join(name);
        // The same run as a folder and as a line, which knows the hidden part.
        fs::create_dir_all(at("run")).unwrap();
        fs::write(at("run/summary.json"), SUMMARY).unwrap();
        fs::write(at("a.jsonl"), line("ball", "1", "1.25").replace("\"side\"", "\"\"")).unwrap();
        let found = RunCollection::read(&[home.path().to_path_buf()]).unwrap();
        assert_eq!((found.rows.len(), found.rows[0].hidden), (1, Some(0.3)));
        assert!(found.rows[0].folder.is_some());

        // Two settings are two kinds; the same settings with another result are refused.
        fs::remove_dir_all(at("run")).unwrap();
        fs::write(at("a.jsonl"), line("ball", "1", "1") + &line("ball", "2", "2") + &line("ball", "2", "3")).unwrap();
        let found = RunCollection::read(&[home.path().to_path_buf()]).unwrap();
        let kinds: Vec<String> = found.kinds().keys().map(|kind| kind.name()).collect();
        assert_eq!(kinds, ["slam · vitac · side · #1", "slam · vitac · side · #2"]);
        assert!(found.warnings[0].starts_with("1 runs are left out"), "{:?}", found.warnings);
    }
}
