//! Record of a run while it goes on: progress bar, partial results, and the final scores.

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::Result;
use indicatif::ProgressBar;
use mvt_mesh::Mesh;

use crate::io::write_file;
use crate::pipeline::{Finished, FrameResult, Progress};
use crate::report;
use crate::report::{Coordinates, RunRecord, Summary};
use crate::truth::Truth;

/// Time between two writes of the partial results: a killed run loses at most this much.
const WRITE_INTERVAL: Duration = Duration::from_secs(1);

/// Least confidence of a frame whose colours the mesh receives.
const COLOURED_ABOVE: f64 = 0.85;

/// Listener of a run that keeps its record, shows progress on a bar, and writes the partial results every second.
pub struct ProgressRecorder<'a> {
    out: &'a Path,
    record: RunRecord,
    bar: ProgressBar,
    begun: Instant,
    written: Instant,
    masks: report::CarriedMasks,
    colours: report::SurfaceColours,
    /// The first error of writing, which `finish` returns.
    failure: Option<anyhow::Error>,
}

impl<'a> ProgressRecorder<'a> {
    /// Starts a record in a folder.
    pub fn new(out: &'a Path, record: RunRecord, bar: ProgressBar) -> Self {
        let now = Instant::now();
        Self {
            out,
            record,
            bar,
            begun: now,
            written: now,
            masks: report::CarriedMasks::default(),
            colours: report::SurfaceColours::default(),
            failure: None,
        }
    }

    /// Receives one message of the pipeline.
    pub fn receive(&mut self, progress: &Progress<'_>) {
        match progress {
            Progress::Started { frames } => {
                self.begun = Instant::now();
                self.bar.set_length(*frames as u64);
            }
            Progress::Frame { results, sensed } => {
                self.record.hidden.extend(sensed.hidden);
                if let (Some(carried), Some(camera)) = (&sensed.carried, self.record.cameras.get(sensed.frame as usize))
                {
                    let written = self.masks.write(self.out, &camera.name, carried);
                    self.failure = self.failure.take().or(written.err());
                }
                let Some(FrameResult { row, scan, .. }) = results.first().and_then(Option::as_ref) else { return };
                if row.state.is_tracking() && row.confidence >= COLOURED_ABOVE {
                    sensed.percept.cameras.iter().flatten().for_each(|camera| self.colours.add(camera, row.estimate));
                }
                if let Some(truth) = row.truth {
                    self.record.observed.add(scan, truth);
                }
                self.record.frames.push(*row);
                self.record.simulated_s = row.time_s;
                self.show();
                if self.record.frames.len() == 1 || self.written.elapsed() >= WRITE_INTERVAL {
                    self.record.wall_s = self.begun.elapsed().as_secs_f64();
                    self.record.peak_memory_mb = report::peak_memory_mb();
                    if let Err(error) = report::write_partial(self.out, &self.record) {
                        self.failure.get_or_insert(error);
                    }
                    self.written = Instant::now();
                }
            }
            Progress::Shape(_, shape) => {
                self.record.shape.extend(shape.point);
                // A shape is meshed while later frames are estimated, so its time belongs to an earlier row.
                self.record.object_from_field = Some(shape.object_from_field);
                if let Some(row) = self.record.frames.iter_mut().rev().find(|row| row.frame == shape.frame) {
                    row.stage_ms.mesh += shape.mesh_ms;
                }
            }
            Progress::Choice(choice) => self.record.choices.push((*choice).clone()),
            Progress::Warning(text) => self.bar.suspend(|| tracing::warn!("{text}")),
            Progress::Event(event) => {
                self.record.events.push((*event).clone());
                self.bar.println(format!("{:6.2} s  {}", event.time_s, event.text));
            }
        }
    }

    fn show(&self) {
        let Some(row) = self.record.frames.last() else { return };
        let ms = self.begun.elapsed().as_secs_f64() * 1e3 / self.record.frames.len() as f64;
        let add_s = row.add_s.map_or_else(|| "-".to_owned(), |e| format!("{:.1} mm", e.one_directional_m * 1e3));
        let f5 = self.record.shape.last().map_or_else(|| "-".to_owned(), |point| format!("{:.2}", point.f5));
        let state = if row.state == report::TrackState::Lost { " lost" } else { "" };
        self.bar.set_message(format!("{ms:.0} ms  ADD-S {add_s}  F@5 {f5}  confidence {:.2}{state}", row.confidence));
        self.bar.inc(1);
    }

    /// Scores every frame with all points, writes all files and returns the summary.
    ///
    /// # Errors
    /// If a file could not be written, now or during the run.
    pub fn finish(mut self, finished: &Finished, mesh: Option<&Mesh>, truth: Option<&Truth>) -> Result<Summary> {
        let record = &mut self.record;
        record.wall_s = finished.wall_s;
        record.complete = finished.complete;
        record.calibration = finished.calibration.clone();
        record.peak_memory_mb = report::peak_memory_mb();
        if !finished.complete {
            // A user who interrupts a run may not wait for the scores.
            report::write_partial(self.out, record)?;
        }
        self.bar.set_message("scoring and writing files");
        if let Some(truth) = truth {
            let has_error: Vec<bool> = record.frames.iter().map(|row| row.add_s.is_some()).collect();
            record.frames = report::scored(std::mem::take(&mut record.frames), truth.original());
            for (row, has_error) in record.frames.iter_mut().zip(has_error) {
                row.add_s = row.add_s.filter(|_| has_error);
            }
        }
        record.peak_memory_mb = report::peak_memory_mb();
        let summary = match mesh.filter(|mesh| mesh.area_m2() > 0.0) {
            Some(mesh) => report::write(self.out, record, mesh, truth)?,
            None => {
                tracing::warn!("no mesh is written, because the object was never seen");
                report::write_partial(self.out, record)?
            }
        };
        if let Some((mesh, colours)) = mesh.and_then(|mesh| Some((mesh, self.colours.of(&mesh.vertices)?))) {
            write_file(self.out, report::file::GLB, &report::mesh_file::glb(mesh, Coordinates::Object, &colours)?)?;
        }
        if !record.cameras.is_empty() {
            report::write_camera_poses(self.out, &record.frames, &record.cameras)?;
        }
        self.masks.finish(self.out)?;
        self.bar.finish_and_clear();
        match self.failure {
            Some(failure) => Err(failure),
            None => Ok(summary),
        }
    }
}
