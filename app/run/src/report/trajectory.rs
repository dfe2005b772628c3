//! `trajectory.csv`: a run frame by frame.

use std::fmt::Write as _;

use mvt_frames::{Frame, Isometry, Object, World};
use mvt_metrics::AddS;
use mvt_slam::Deviation;

use super::table::{TextTable, known_as, number as table_number};
use super::{Coordinates, FrameRow, StageMs, TrackState};

/// The columns, in the order in which they are written. Lengths are metres but where the name says mm, quaternions are (w, x, y, z).
const COLUMNS: [&str; 29] = [
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
    "add_mm",
    "rotation_deg",
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
const ADD: usize = 23;
const STAGES: usize = 25;

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
    /// A position that is far beyond any room.
    #[error(
        "the object is {0} m from the origin; give x_m, y_m and z_m in metres, or name the columns x_mm, y_mm and z_mm"
    )]
    TooFar(u64),
    /// The first line has numbers and no names.
    #[error("the file has no header; give one with at least time_s, x_m, y_m, z_m, qw, qx, qy and qz")]
    NoHeader,
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
        append(&mut text, row.add_m.map(|add_m| [add_m * 1e3]));
        append(&mut text, row.rotation_error_rad().map(|angle_rad| [angle_rad.to_degrees()]));
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
/// confidence 1 and the stages took no time. Files of TUM and EuRoC and of spreadsheets with semicolons and decimal commas are read, too.
///
/// # Errors
/// The error names the line and what is wrong with it.
pub fn read_trajectory(text: &str) -> Result<Vec<FrameRow>, TrajectoryError> {
    if text.trim().is_empty() {
        return Err(TrajectoryError { line: 1, defect: TrajectoryDefect::Empty });
    }
    let no_header = |line| TrajectoryError { line, defect: TrajectoryDefect::NoHeader };
    let TextTable { names, line: first, rows: lines } = TextTable::read(text).map_err(no_header)?;
    let places = places(&names).map_err(|defect| TrajectoryError { line: first, defect })?;
    let time_factor = time_factor(&lines, places[TIME]);
    let mut rows: Vec<FrameRow> = Vec::new();
    let mut odd_lengths = 0;
    for (line, values) in lines {
        let at_line = |defect| TrajectoryError { line, defect };
        if values.len() != names.len() {
            return Err(at_line(TrajectoryDefect::ValueCount { found: values.len(), expected: names.len() }));
        }
        let cells = places.map(|place| place.and_then(|(k, _)| values.get(k)).map_or("", String::as_str));
        let mut factors = places.map(|place| place.and_then(|(_, factor)| factor).unwrap_or(1.0));
        factors[TIME] = time_factor;
        let cells = Cells { texts: cells, factors };
        let row = row(&cells, rows.len()).map_err(at_line)?;
        if rows.last().is_some_and(|before| row.time_s <= before.time_s) {
            return Err(at_line(TrajectoryDefect::TimeOrder));
        }
        odd_lengths += usize::from((cells.length(ESTIMATE + 3) - 1.0).abs() > LENGTH_TOLERANCE);
        rows.push(row);
    }
    if odd_lengths > 0 {
        tracing::warn!(
            "{odd_lengths} of {} quaternions do not have the length 1 and are scaled to it; check that the columns are qw, qx, qy and qz",
            rows.len()
        );
    }
    let mut distances: Vec<f64> = rows.iter().map(|row| row.estimate.origin().coords().norm()).collect();
    distances.sort_unstable_by(f64::total_cmp);
    match distances.get(distances.len() / 2) {
        None => Err(TrajectoryError { line: first, defect: TrajectoryDefect::Empty }),
        Some(&usual) if usual > FARTHEST_M => {
            Err(TrajectoryError { line: first, defect: TrajectoryDefect::TooFar(usual.round() as u64) })
        }
        Some(_) => Ok(rows),
    }
}

/// Greatest difference of a quaternion's length from 1 that rounding to three digits leaves.
const LENGTH_TOLERANCE: f64 = 2e-3;
/// Greatest usual distance from the origin, metres: a hand's object in millimetres is farther.
const FARTHEST_M: f64 = 10.0;

/// Returns the coordinates that the poses of a file take to the world, as its column `coordinates` states them; `None` if it does not.
pub fn stated_coordinates(text: &str) -> Option<Coordinates> {
    let table = TextTable::read(text).ok()?;
    let (place, _) = places(&table.names).ok()?[COORDINATES]?;
    let (_, first) = table.rows.first()?;
    Coordinates::from_name(first.get(place)?)
}

/// Where each of our columns stands in a file, and by what its numbers are multiplied, where its name says that.
type Places = [Option<(usize, Option<f64>)>; COLUMNS.len()];

fn places(names: &[String]) -> Result<Places, TrajectoryDefect> {
    let mut places = [None; COLUMNS.len()];
    for (column, place) in COLUMNS.into_iter().zip(&mut places) {
        let mut found = (0..).zip(names).filter(|&(_, name)| name == column).map(|(k, _)| (k, Some(1.0)));
        *place = found.next();
        if found.next().is_some() {
            return Err(TrajectoryDefect::ColumnTwice(column));
        }
    }
    for (k, name) in names.iter().enumerate() {
        let Some((column, factor)) = known_as(name) else { continue };
        let place = COLUMNS.iter().position(|ours| *ours == column).and_then(|ours| places.get_mut(ours));
        // A column of our own name comes first.
        if let Some(place) = place.filter(|place| place.is_none()) {
            *place = Some((k, factor));
        }
    }
    let needed = [TIME].into_iter().chain(ESTIMATE..TRUTH);
    match needed.into_iter().find(|&k| places[k].is_none()) {
        Some(missing) => Err(TrajectoryDefect::NoColumn(COLUMNS[missing])),
        None => Ok(places),
    }
}

/// Nanoseconds lie this far apart at least, between frames of one of the fastest cameras.
const NANOSECONDS: f64 = 1e5;

/// Poses of a hand's object do not lie farther apart, seconds.
const LONG_STEP_S: f64 = 5.0;

/// Returns by what times are multiplied. Without a unit in the column's name, the usual step shows whether they are nanoseconds.
fn time_factor(lines: &[(usize, Vec<String>)], place: Option<(usize, Option<f64>)>) -> f64 {
    let Some((column, factor)) = place else { return 1.0 };
    let times: Vec<f64> = lines.iter().filter_map(|(_, cells)| table_number(cells.get(column)?)).collect();
    let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_unstable_by(f64::total_cmp);
    let step = steps.get(steps.len() / 2).copied().unwrap_or_default();
    let factor = factor.unwrap_or(if step >= NANOSECONDS { 1e-9 } else { 1.0 });
    if factor * step >= LONG_STEP_S {
        tracing::warn!(
            "the poses lie {:.0} s apart; if that are milliseconds or nanoseconds, name the column time_ms or time_ns",
            factor * step
        );
    }
    factor
}

fn row(cells: &Cells<'_>, index: usize) -> Result<FrameRow, TrajectoryDefect> {
    let frame = match cells.texts[0] {
        "" => index as u64,
        text => text.parse().map_err(|_| cells.defect(0, "a whole number"))?,
    };
    let state = match cells.texts[STATE] {
        "" | "tracking" => TrackState::Tracking,
        "lost" => TrackState::Lost,
        "relocalised" => TrackState::Relocalised,
        _ => return Err(cells.defect(STATE, "tracking, lost or relocalised")),
    };
    let estimate = cells.pose(ESTIMATE)?.ok_or(cells.defect(ESTIMATE, "a number"))?;
    let deviation = cells.numbers::<2>(DEVIATION, |x| x >= 0.0, "a number from 0 on")?;
    let add_s = cells.numbers::<2>(ADD_S, |x| x >= 0.0, "a number from 0 on")?;
    let add = cells.numbers::<1>(ADD, |x| x >= 0.0, "a number from 0 on")?;
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
        add_m: add.map(|[mm]| mm * 1e-3),
        stage_ms: StageMs { sense, track, map, mesh },
    })
}

/// The values of a line in our order, empty where it has none.
struct Cells<'a> {
    texts: [&'a str; COLUMNS.len()],
    /// By what numbers are multiplied.
    factors: [f64; COLUMNS.len()],
}

impl Cells<'_> {
    fn defect(&self, column: usize, expected: &'static str) -> TrajectoryDefect {
        let value = self.texts[column].chars().take(40).collect();
        TrajectoryDefect::Value { column: COLUMNS[column], value, expected }
    }

    /// `N` numbers from a column on; `None` if all are empty.
    fn numbers<const N: usize>(
        &self,
        first: usize,
        is_right: fn(f64) -> bool,
        expected: &'static str,
    ) -> Result<Option<[f64; N]>, TrajectoryDefect> {
        let cells = &self.texts[first..first + N];
        if cells.iter().all(|cell| cell.is_empty()) {
            return Ok(None);
        }
        let mut numbers = [0.0; N];
        for (k, number) in numbers.iter_mut().enumerate() {
            if cells[k].is_empty() {
                return Err(TrajectoryDefect::Incomplete(COLUMNS[first + k]));
            }
            let value = table_number(cells[k]).map(|x| x * self.factors[first + k]).filter(|&x| is_right(x));
            *number = value.ok_or_else(|| self.defect(first + k, expected))?;
        }
        Ok(Some(numbers))
    }

    /// Length of the quaternion from a column on.
    fn length(&self, first: usize) -> f64 {
        let parts = self.texts[first..first + 4].iter().filter_map(|text| table_number(text));
        parts.map(|part| part * part).sum::<f64>().sqrt()
    }

    fn pose(&self, first: usize) -> Result<Option<Isometry<Object, World>>, TrajectoryDefect> {
        let Some([x, y, z, q @ ..]) = self.numbers::<7>(first, f64::is_finite, "a finite number")? else {
            return Ok(None);
        };
        if !self.length(first + 3).is_normal() {
            return Err(TrajectoryDefect::NoRotation(COLUMNS[first + 3]));
        }
        Ok(Some(Isometry::from_parts([x, y, z], q)))
    }
}
