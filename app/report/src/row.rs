//! A run as a row of numbers, from its summary or from a line of a table.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Deserialize;

/// Errors from here on mean that the pose was not a number, millimetres.
pub const INFINITE_MM: f64 = 1e6;

/// Identity of a run: runs of two sweeps with the same identity are compared.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RunIdentity {
    /// How the run was made.
    pub kind: RunKind,
    /// Name of the object.
    pub object: String,
    /// Seed of the episode.
    pub seed: u64,
    /// Seed of the estimator, less that of the episode.
    pub estimator_seed: u64,
}

/// How a run was made. Figures are averaged over the runs of one kind.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RunKind {
    /// Estimated quantities.
    pub mode: String,
    /// Sensors in use.
    pub modality: String,
    /// Names of the cameras with commas between; empty if they are unknown.
    pub cameras: String,
    /// Name of the variant, `full` for all factors. Ends in a hash of the settings where several occur.
    pub variant: String,
}

impl RunIdentity {
    /// Returns the identity without the hash of the settings.
    pub fn without_settings(&self) -> Self {
        let variant = self.kind.variant.split(" #").next().unwrap_or_default().to_owned();
        Self { kind: RunKind { variant, ..self.kind.clone() }, ..self.clone() }
    }
}

impl RunKind {
    /// Returns the name that people read.
    pub fn name(&self) -> String {
        // Factors are named only where some are missing.
        let variant = self.variant.strip_prefix(FULL).unwrap_or(&self.variant).trim_start();
        let parts = [self.mode.as_str(), &self.modality, &self.cameras, variant];
        parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(" · ")
    }
}

/// Name of the variant with all factors.
const FULL: &str = "full";

/// Errors of the pose over a run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ErrorCurve {
    /// Times in seconds with errors in millimetres, thinned out.
    pub points: Vec<[f64; 2]>,
    /// Spans of time in seconds in which the object was lost.
    pub lost: Vec<[f64; 2]>,
}

/// Run as a row of a report. Lengths are millimetres. A figure is `None` where it is unknown or infinite.
#[derive(Debug, Clone, PartialEq)]
pub struct ReportRow {
    /// Which run.
    pub id: RunIdentity,
    /// Hash of its settings.
    pub settings: String,
    /// Number of frames.
    pub frames: usize,
    /// How the run ended, in a word or two.
    pub end: String,
    /// Whether it came to its end. Figures leave out the others.
    pub is_complete: bool,
    /// Mean share of the object that the hand hides from the first camera.
    pub hidden: Option<f64>,
    /// F-score by threshold.
    pub f_score: BTreeMap<u32, f64>,
    /// F-score by threshold from ten times as many points.
    pub f_score_fine: BTreeMap<u32, f64>,
    /// Mean ADD-S.
    pub add_s: Option<f64>,
    /// Median ADD-S.
    pub add_s_median: Option<f64>,
    /// 95 % of the frames have at most this ADD-S.
    pub add_s_p95: Option<f64>,
    /// ADD-S of the last frame.
    pub add_s_final: Option<f64>,
    /// Mean ADD.
    pub add: Option<f64>,
    /// Mean angle between the estimated and the true rotation, degrees.
    pub rotation_deg: Option<f64>,
    /// Frames at which the object was lost.
    pub lost_frames: usize,
    /// Number of times that it was found again.
    pub recovered: usize,
    /// Whether the last error exceeds 10 mm although the object was not declared lost.
    pub is_undeclared: bool,
    /// Speed.
    pub frames_per_second: Option<f64>,
    /// Folder of the run, if the report was made of it.
    pub folder: Option<PathBuf>,
    /// Command that repeats the run.
    pub command: Option<String>,
    /// Errors over time.
    pub curve: ErrorCurve,
    /// Events with their times in seconds.
    pub events: Vec<(f64, String)>,
}

#[derive(Debug, Deserialize)]
struct ErrorsFile {
    mean: Option<f64>,
    median: Option<f64>,
    p95: Option<f64>,
    #[serde(rename = "final")]
    last: Option<f64>,
}

/// Line of a table that `evaluate` writes.
#[derive(Debug, Deserialize)]
struct TableLine {
    object: String,
    seed: u64,
    cameras: String,
    mode: String,
    modality: String,
    #[serde(default)]
    estimator_seed: u64,
    variant: String,
    #[serde(default)]
    settings: String,
    frames: usize,
    #[serde(default)]
    end: String,
    hidden: Option<f64>,
    f_score: BTreeMap<u32, f64>,
    #[serde(default)]
    f_score_fine: BTreeMap<u32, f64>,
    add_s_mm: Option<ErrorsFile>,
    #[serde(default)]
    add_mm: Option<ErrorsFile>,
    #[serde(default)]
    rotation_deg: Option<ErrorsFile>,
    lost_frames: usize,
    #[serde(default)]
    recovered: usize,
    #[serde(default)]
    undeclared: bool,
    frames_per_second: Option<f64>,
}

/// Part of summary.json that a report shows.
#[derive(Debug, Deserialize)]
struct SummaryFile {
    complete: bool,
    object: String,
    seed: u64,
    mode: String,
    modality: String,
    frames: usize,
    #[serde(default)]
    f_score: Option<BTreeMap<u32, f64>>,
    #[serde(default)]
    f_score_fine: Option<BTreeMap<u32, f64>>,
    #[serde(default)]
    add_s_mm: Option<ErrorsFile>,
    #[serde(default)]
    add_mm: Option<ErrorsFile>,
    #[serde(default)]
    rotation_deg: Option<ErrorsFile>,
    #[serde(default)]
    failed: Option<bool>,
    #[serde(default)]
    hidden: Option<f64>,
    #[serde(default)]
    lost_frames: usize,
    #[serde(default)]
    recovered: usize,
    #[serde(default)]
    frames_per_second: Option<f64>,
    #[serde(default)]
    events: Vec<EventOfSummary>,
}

#[derive(Debug, Deserialize)]
struct EventOfSummary {
    time_s: f64,
    text: String,
}

impl ReportRow {
    /// Reads a line of a table.
    ///
    /// # Errors
    /// If the line is no result of a run.
    pub fn of_line(line: &str) -> Result<Self, serde_json::Error> {
        let line: TableLine = serde_json::from_str(line)?;
        let kind = RunKind { cameras: line.cameras, mode: line.mode, modality: line.modality, variant: line.variant };
        let id = RunIdentity { kind, object: line.object, seed: line.seed, estimator_seed: line.estimator_seed };
        let row = Self {
            settings: line.settings,
            end: line.end,
            hidden: line.hidden,
            f_score: line.f_score,
            f_score_fine: line.f_score_fine,
            recovered: line.recovered,
            is_undeclared: line.undeclared,
            frames_per_second: line.frames_per_second,
            ..Self::empty(id, line.frames, line.lost_frames)
        };
        Ok(row.with_errors([line.add_s_mm, line.add_mm, line.rotation_deg]))
    }

    /// Reads summary.json. Cameras, settings and the content of other files remain empty.
    ///
    /// # Errors
    /// If the text is no summary of a run.
    pub fn of_summary(text: &str) -> Result<Self, serde_json::Error> {
        let file: SummaryFile = serde_json::from_str(text)?;
        let kind =
            RunKind { cameras: String::new(), mode: file.mode, modality: file.modality, variant: FULL.to_owned() };
        let id = RunIdentity { kind, object: file.object, seed: file.seed, estimator_seed: 0 };
        let row = Self {
            end: if file.complete { "" } else { "interrupted" }.to_owned(),
            is_complete: file.complete,
            hidden: file.hidden,
            f_score: file.f_score.unwrap_or_default(),
            f_score_fine: file.f_score_fine.unwrap_or_default(),
            recovered: file.recovered,
            is_undeclared: file.failed.unwrap_or(false),
            frames_per_second: file.frames_per_second,
            events: file.events.into_iter().map(|event| (event.time_s, event.text)).collect(),
            ..Self::empty(id, file.frames, file.lost_frames)
        };
        Ok(row.with_errors([file.add_s_mm, file.add_mm, file.rotation_deg]))
    }

    fn empty(id: RunIdentity, frames: usize, lost_frames: usize) -> Self {
        Self {
            id,
            settings: String::new(),
            frames,
            end: String::new(),
            is_complete: true,
            hidden: None,
            f_score: BTreeMap::new(),
            f_score_fine: BTreeMap::new(),
            add_s: None,
            add_s_median: None,
            add_s_p95: None,
            add_s_final: None,
            add: None,
            rotation_deg: None,
            lost_frames,
            recovered: 0,
            is_undeclared: false,
            frames_per_second: None,
            folder: None,
            command: None,
            curve: ErrorCurve::default(),
            events: Vec::new(),
        }
    }

    /// Fills in the errors, and leaves out numbers that no run has.
    fn with_errors(mut self, [add_s, add, rotation]: [Option<ErrorsFile>; 3]) -> Self {
        let is_share = |share: &f64| (0.0..=1.0).contains(share);
        self.f_score.retain(|_, share| is_share(share));
        self.f_score_fine.retain(|_, share| is_share(share));
        self.hidden = self.hidden.filter(is_share);
        self.frames_per_second = self.frames_per_second.filter(|speed| (0.0..1e6).contains(speed));
        self.events.retain(|(time_s, _)| time_s.is_finite());
        let known = |error: Option<f64>| error.filter(|error| (0.0..INFINITE_MM).contains(error));
        self.add = add.and_then(|errors| known(errors.mean));
        self.rotation_deg = rotation.and_then(|errors| known(errors.mean));
        if let Some(ErrorsFile { mean, median, p95, last }) = add_s {
            self.add_s = known(mean);
            self.add_s_median = known(median);
            self.add_s_p95 = known(p95);
            self.add_s_final = known(last);
        }
        self
    }

    /// Returns the mean error by which runs are ordered, millimetres; infinite if it is unknown.
    pub fn badness(&self) -> f64 {
        self.add_s.unwrap_or(f64::INFINITY)
    }

    /// Returns the share of the frames at which the object was lost.
    pub fn lost_share(&self) -> Option<f64> {
        (self.frames > 0).then(|| self.lost_frames as f64 / self.frames as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As `evaluate` has written it.
    const LINE: &str = r#"{"object":"077_rubiks_cube","seed":1,"cameras":"side","mode":"slam","modality":"vitac","estimator_seed":0,
        "variant":"full","settings":"ab","frames":120,"end":"the time is over","hidden":0.31,"f_score":{"1":0.5,"5":0.95},
        "f_score_fine":{"1":0.6},"add_s_mm":{"mean":1.5,"median":1.4,"p95":2.0,"final":1.7976931348623157e308},
        "add_s_symmetric_mm":null,"lost_frames":3,"recovered":1,"undeclared":false,"frames_per_second":31.5}"#;

    #[test]
    fn lines_of_tables_are_read() {
        let row = ReportRow::of_line(LINE).unwrap();
        assert_eq!(row.id.kind.name(), "slam · vitac · side");
        assert_eq!((row.id.object.as_str(), row.id.seed, row.frames), ("077_rubiks_cube", 1, 120));
        assert_eq!((row.hidden, row.f_score.get(&5), row.add_s), (Some(0.31), Some(&0.95), Some(1.5)));
        // Infinite errors are unknown, and such a run is the worst.
        assert_eq!(row.add_s_final, None);
        assert_eq!(ReportRow { add_s: None, ..row.clone() }.badness(), f64::INFINITY);
        assert_eq!(row.lost_share(), Some(0.025));
    }

    #[test]
    fn other_lines_and_summaries_are_errors() {
        for text in ["", "[]", "{}", "NaN", r#"{"object":1}"#, &LINE.replace("1.5", "NaN"), &LINE[..200]] {
            assert!(ReportRow::of_line(text).is_err(), "{text}");
            assert!(ReportRow::of_summary(text).is_err(), "{text}");
        }
        let nothing_seen = r#"{"complete":false,"object":"a","seed":0,"mode":"slam","modality":"tac","frames":0,
            "add_s_mm":{"mean":null,"median":null,"p95":null,"final":null}}"#;
        let row = ReportRow::of_summary(nothing_seen).unwrap();
        assert_eq!((row.add_s, row.is_complete, row.lost_share()), (None, false, None));
        let hidden =
            ReportRow::of_summary(&nothing_seen.replace(r#""frames":0"#, r#""frames":30,"hidden":0.25"#)).unwrap();
        assert_eq!((row.hidden, hidden.hidden), (None, Some(0.25)));
    }
}
