//! `trajectory.csv`: a run frame by frame.

use std::fmt::Write as _;

use mvt_frames::{Frame, Isometry, Object, World};
use mvt_metrics::AddS;
use mvt_slam::Deviation;

use super::{Coordinates, FrameRow, StageMs, TrackState};

/// The columns, in the order in which they are written. Lengths are metres but where the name says mm, quaternions are (w, x, y, z).
const COLUMNS: [&str; 27] = [
    "frame",
    "time_s",
    "state",
    "confidence",
    "deviation_mm",
    "deviation_deg",
    "coordinates",
    "x_m",
    "y_m",
    "z_m",
    "qw",
    "qx",
    "qy",
    "qz",
    "true_x_m",
    "true_y_m",
    "true_z_m",
    "true_qw",
    "true_qx",
    "true_qy",
    "true_qz",
    "add_s_mm",
    "add_s_symmetric_mm",
    "sense_ms",
    "track_ms",
    "map_ms",
    "mesh_ms",
];
const TIME: usize = 1;
const STATE: usize = 2;
const CONFIDENCE: usize = 3;
const DEVIATION: usize = 4;
const COORDINATES: usize = 6;
const ESTIMATE: usize = 7;
const TRUTH: usize = 14;
const ADD_S: usize = 21;
const STAGES: usize = 23;

/// Why a trajectory could not be read. Lines count from 1.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {defect}")]
pub struct TrajectoryError {
    /// Line of the file.
    pub line: usize,
    /// The defect.
    pub defect: TrajectoryDefect,
}

/// A defect of a line of a trajectory.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TrajectoryDefect {
    /// The header lacks a column that cannot be done without.
    #[error("the header has no column {0}; there must be time_s, x_m, y_m, z_m, qw, qx, qy and qz")]
    NoColumn(&'static str),
    /// The header has a column twice.
    #[error("the header has column {0} twice")]
    ColumnTwice(&'static str),
    /// A line with more or fewer values than the header has columns.
    #[error("{found} values, but the header has {expected} columns")]
    ValueCount {
        /// Values of the line.
        found: usize,
        /// Columns of the header.
        expected: usize,
    },
    /// A value that does not fit its column.
    #[error("{column} is \"{value}\", not {expected}")]
    Value {
        /// Name of the column.
        column: &'static str,
        /// The value, cut to 40 characters.
        value: String,
        /// The expected content.
        expected: &'static str,
    },
    /// A quaternion that is no rotation.
    #[error("the quaternion from {0} on is no rotation: its length is 0 or infinite")]
    NoRotation(&'static str),
    /// A true pose, or an error, of which only a part is there.
    #[error("{0} is empty, but its neighbours are not")]
    Incomplete(&'static str),
    /// Time stands still or runs back.
    #[error("time_s is not greater than on the line before")]
    TimeOrder,
    /// There are no poses.
    #[error("the file has no poses")]
    Empty,
}

/// Writes the rows as text: a header, then a line for each frame. Where the truth is not known its columns are empty. Numbers are
/// written in full, so that they are read as the same but for the last bit of rotations and errors.
pub fn write_trajectory(rows: &[FrameRow]) -> String {
    let mut text = COLUMNS.join(",");
    text.push('\n');
    for row in rows {
        let state = match row.state {
            TrackState::Tracking => "tracking",
            TrackState::Lost | TrackState::Waiting => "lost",
            TrackState::Relocalised => "relocalised",
        };
        let coordinates = Coordinates::Object.name();
        let _ = write!(text, "{},{},{state},{}", row.frame, row.time_s, row.confidence);
        append(&mut text, row.deviation.map(|d| [d.surface_m * 1e3, d.angle_rad.to_degrees()]));
        let _ = write!(text, ",{coordinates}");
        let add_s = row.add_s.map(|e| [e.one_directional_m * 1e3, e.symmetric_m * 1e3]);
        let StageMs { sense, track, map, mesh } = row.stage_ms;
        append(&mut text, Some(pose_numbers(row.estimate)));
        append(&mut text, row.truth.map(pose_numbers));
        append(&mut text, add_s);
        append(&mut text, Some([sense, track, map, mesh]));
        text.push('\n');
    }
    text
}

fn append<const N: usize>(text: &mut String, values: Option<[f64; N]>) {
    for k in 0..N {
        let _ = match values {
            Some(values) => write!(text, ",{}", values[k]),
            None => write!(text, ","),
        };
    }
}

/// Returns a pose as x, y, z and the quaternion w, x, y, z.
pub fn pose_numbers<A: Frame, B: Frame>(pose: Isometry<A, B>) -> [f64; 7] {
    let ([x, y, z], [qw, qx, qy, qz]) = (pose.origin().coords().into(), pose.quaternion_wxyz());
    [x, y, z, qw, qx, qy, qz]
}

/// Reads a trajectory: ours, or anybody's that has at least time and pose. Columns are found by their names in the first line, in any
/// order; those that are not known here are passed over. Of a missing column, frames are numbered from 0, the state is tracking, the
/// confidence 1 and the stages took no time.
///
/// # Errors
/// The error names the line and what is wrong with it.
pub fn read_trajectory(text: &str) -> Result<Vec<FrameRow>, TrajectoryError> {
    let mut lines = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty());
    let Some((first, header)) = lines.next() else {
        return Err(TrajectoryError { line: 1, defect: TrajectoryDefect::Empty });
    };
    let (places, width) = places(header).map_err(|defect| TrajectoryError { line: first, defect })?;
    let mut rows: Vec<FrameRow> = Vec::new();
    for (line, values) in lines {
        let at_line = |defect| TrajectoryError { line, defect };
        let values: Vec<&str> = values.split(',').map(str::trim).collect();
        if values.len() != width {
            return Err(at_line(TrajectoryDefect::ValueCount { found: values.len(), expected: width }));
        }
        let cells = places.map(|place| place.and_then(|k| values.get(k)).copied().unwrap_or(""));
        let row = row(&Cells(cells), rows.len()).map_err(at_line)?;
        if rows.last().is_some_and(|before| row.time_s <= before.time_s) {
            return Err(at_line(TrajectoryDefect::TimeOrder));
        }
        rows.push(row);
    }
    if rows.is_empty() { Err(TrajectoryError { line: first, defect: TrajectoryDefect::Empty }) } else { Ok(rows) }
}

/// Returns the coordinates that the poses of a file take to the world, as its column `coordinates` states them; `None` if it does not.
pub fn stated_coordinates(text: &str) -> Option<Coordinates> {
    let mut lines = text.lines().filter(|line| !line.trim().is_empty());
    let (places, _) = places(lines.next()?).ok()?;
    let first: Vec<&str> = lines.next()?.split(',').map(str::trim).collect();
    Coordinates::from_name(first.get(places[COORDINATES]?)?)
}

/// Where each of our columns stands in a file, and how many the file has.
fn places(header: &str) -> Result<([Option<usize>; COLUMNS.len()], usize), TrajectoryDefect> {
    // A spreadsheet may have put a byte order mark in front.
    let names: Vec<&str> = header.trim_start_matches('\u{feff}').split(',').map(str::trim).collect();
    let mut places = [None; COLUMNS.len()];
    for (column, place) in COLUMNS.into_iter().zip(&mut places) {
        let mut found = (0..).zip(&names).filter(|&(_, &name)| name == column).map(|(k, _)| k);
        *place = found.next();
        if found.next().is_some() {
            return Err(TrajectoryDefect::ColumnTwice(column));
        }
    }
    let needed = [TIME].into_iter().chain(ESTIMATE..TRUTH);
    match needed.into_iter().find(|&k| places[k].is_none()) {
        Some(missing) => Err(TrajectoryDefect::NoColumn(COLUMNS[missing])),
        None => Ok((places, names.len())),
    }
}

fn row(cells: &Cells<'_>, index: usize) -> Result<FrameRow, TrajectoryDefect> {
    let frame = match cells.0[0] {
        "" => index as u64,
        text => text.parse().map_err(|_| cells.defect(0, "a whole number"))?,
    };
    let state = match cells.0[STATE] {
        "" | "tracking" => TrackState::Tracking,
        "lost" => TrackState::Lost,
        "relocalised" => TrackState::Relocalised,
        _ => return Err(cells.defect(STATE, "tracking, lost or relocalised")),
    };
    let estimate = cells.pose(ESTIMATE)?.ok_or(cells.defect(ESTIMATE, "a number"))?;
    let deviation = cells.numbers::<2>(DEVIATION, |x| x >= 0.0, "a number from 0 on")?;
    let add_s = cells.numbers::<2>(ADD_S, |x| x >= 0.0, "a number from 0 on")?;
    let stages = cells.numbers::<4>(STAGES, f64::is_finite, "a number")?;
    let [sense, track, map, mesh] = stages.unwrap_or_default();
    let confidence = cells.numbers::<1>(CONFIDENCE, f64::is_finite, "a number")?;
    let time = cells.numbers::<1>(TIME, f64::is_finite, "a number")?;
    Ok(FrameRow {
        frame,
        time_s: time.ok_or(cells.defect(TIME, "a number"))?[0],
        state,
        confidence: confidence.map_or(1.0, |[confidence]| confidence),
        deviation: deviation.map(|[mm, deg]| Deviation { surface_m: mm * 1e-3, angle_rad: deg.to_radians() }),
        estimate,
        truth: cells.pose(TRUTH)?,
        add_s: add_s.map(|[one, symmetric]| AddS { one_directional_m: one * 1e-3, symmetric_m: symmetric * 1e-3 }),
        stage_ms: StageMs { sense, track, map, mesh },
    })
}

/// The values of a line in our order, empty where it has none.
struct Cells<'a>([&'a str; COLUMNS.len()]);

impl Cells<'_> {
    fn defect(&self, column: usize, expected: &'static str) -> TrajectoryDefect {
        let value = self.0[column].chars().take(40).collect();
        TrajectoryDefect::Value { column: COLUMNS[column], value, expected }
    }

    /// `N` numbers from a column on; `None` if all are empty.
    fn numbers<const N: usize>(
        &self,
        first: usize,
        is_right: fn(f64) -> bool,
        expected: &'static str,
    ) -> Result<Option<[f64; N]>, TrajectoryDefect> {
        let cells = &self.0[first..first + N];
        if cells.iter().all(|cell| cell.is_empty()) {
            return Ok(None);
        }
        let mut numbers = [0.0; N];
        for (k, number) in numbers.iter_mut().enumerate() {
            if cells[k].is_empty() {
                return Err(TrajectoryDefect::Incomplete(COLUMNS[first + k]));
            }
            *number = cells[k].parse().ok().filter(|&x| is_right(x)).ok_or_else(|| self.defect(first + k, expected))?;
        }
        Ok(Some(numbers))
    }

    fn pose(&self, first: usize) -> Result<Option<Isometry<Object, World>>, TrajectoryDefect> {
        let Some([x, y, z, q @ ..]) = self.numbers::<7>(first, f64::is_finite, "a finite number")? else {
            return Ok(None);
        };
        let length = q.iter().map(|c| c * c).sum::<f64>().sqrt();
        if !length.is_normal() {
            return Err(TrajectoryDefect::NoRotation(COLUMNS[first + 3]));
        }
        Ok(Some(Isometry::from_parts([x, y, z], q)))
    }
}
