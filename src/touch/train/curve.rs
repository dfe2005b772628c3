//! `curve.csv` and `curve.svg`: errors over the steps of a training.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use mvt_files::{input, output};
use mvt_picture::chart::{self, ChartLine, ChartPanel, ChartScale};
use mvt_picture::palette::{CURVES, Theme};

/// Largest curve.csv that is read, bytes.
const LARGEST_FILE: u64 = 64 << 20;

/// Result of one validation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// Number of steps so far.
    pub step: u64,
    /// Training images per second since the last row, including rendering.
    pub images_per_s: f64,
    /// Mean loss of the steps since the last row.
    pub loss: f32,
    /// Norm of the last step's gradient before clipping.
    pub gradient: f32,
    /// Learning rate of the last step.
    pub rate: f32,
    /// Mean absolute error of the averaged weights over the pixels in contact of the validation images.
    pub contact_mae_mm: f64,
    /// Their root mean square error over all pixels.
    pub rmse_mm: f64,
    /// Mean over the images of the intersection over union of contact.
    pub iou: f64,
}

const HEADER: &str = "step,images_per_s,loss,gradient,rate,contact_mae_mm,rmse_mm,iou";

impl Row {
    fn to_csv(self) -> String {
        let Self { step, images_per_s, loss, gradient, rate, contact_mae_mm, rmse_mm, iou } = self;
        format!("{step},{images_per_s:.2},{loss},{gradient},{rate},{contact_mae_mm},{rmse_mm},{iou}")
    }

    fn from_csv(line: &str) -> Option<Self> {
        let mut cells = line.split(',');
        let mut number = || cells.next()?.parse::<f64>().ok();
        Some(Self {
            step: number()? as u64,
            images_per_s: number()?,
            loss: number()? as f32,
            gradient: number()? as f32,
            rate: number()? as f32,
            contact_mae_mm: number()?,
            rmse_mm: number()?,
            iou: number()?,
        })
    }
}

/// The rows so far and the folder that they are written to.
pub struct Curve {
    folder: PathBuf,
    rows: Vec<Row>,
}

impl Curve {
    /// Reads the curve in a folder up to a step; returns an empty one for step 0.
    pub fn open(folder: &Path, step: u64) -> Result<Self> {
        let path = folder.join("curve.csv");
        let mut rows = Vec::new();
        if step > 0 {
            let text =
                input::read_text(&path, LARGEST_FILE).with_context(|| format!("cannot read {}", path.display()))?;
            for line in text.lines().skip(1) {
                let row = Row::from_csv(line)
                    .with_context(|| format!("{}: {line:?} is not a row of a curve", path.display()))?;
                rows.push(row);
            }
            rows.retain(|row| row.step <= step);
        }
        Ok(Self { folder: folder.to_owned(), rows })
    }

    /// Returns whether the error in contact of a row is smaller than that of all rows so far.
    pub fn is_best(&self, row: &Row) -> bool {
        self.rows.iter().all(|other| row.contact_mae_mm < other.contact_mae_mm)
    }

    /// Adds a row and rewrites both files.
    pub fn push(&mut self, row: Row) -> Result<()> {
        self.rows.push(row);
        let lines = self.rows.iter().map(|row| row.to_csv() + "\n");
        let csv = format!("{HEADER}\n{}", lines.collect::<String>());
        for (name, text) in [("curve.csv", csv), ("curve.svg", svg(&self.rows))] {
            let path = self.folder.join(name);
            output::replace(&path, text.as_bytes()).with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }
}

/// Returns the loss and the errors over the steps as SVG, on logarithmic axes.
fn svg(rows: &[Row]) -> String {
    type Value = fn(&Row) -> f64;
    const PANELS: [(&str, Value); 4] = [
        ("loss", |row| f64::from(row.loss)),
        ("contact MAE, mm", |row| row.contact_mae_mm),
        ("RMSE, mm", |row| row.rmse_mm),
        ("1 - IoU", |row| 1.0 - row.iou),
    ];
    let end = rows.last().map_or(1, |row| row.step) as f64;
    let panel = |(name, value): (&str, Value)| {
        let values = rows.iter().map(|row| (row.step as f64, value(row)));
        let points: Vec<(f64, f64)> = values.filter(|(_, v)| *v > 0.0 && v.is_finite()).collect();
        let values = || points.iter().map(|point| point.1);
        let bottom = values().fold(f64::INFINITY, f64::min).clamp(1e-6, 1e6) * 0.9;
        let top = values().fold(0.0, f64::max).clamp(bottom * 1.2, 1e7) * 1.1;
        ChartPanel {
            title: name.to_owned(),
            span: 0.0..end,
            unit: "steps".to_owned(),
            scale: ChartScale::Log { bottom, top },
            lines: vec![ChartLine { name: String::new(), colour: CURVES[0], points }],
            lanes: Vec::new(),
            shaded: Vec::new(),
            cursor: None,
        }
    };
    chart::svg("training", &PANELS.map(panel), &Theme::LIGHT)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_resumed_curve_continues_at_its_step() {
        let folder = tempfile::tempdir().unwrap();
        let row = |step, contact_mae_mm| Row {
            step,
            images_per_s: 10.0,
            loss: 0.5,
            gradient: 1.5,
            rate: 1e-3,
            contact_mae_mm,
            rmse_mm: 0.2,
            iou: 0.8,
        };
        let mut curve = Curve::open(folder.path(), 0).unwrap();
        for (step, error) in [(10, 0.5), (20, 0.3), (30, 0.4)] {
            curve.push(row(step, error)).unwrap();
        }
        let resumed = Curve::open(folder.path(), 20).unwrap();
        assert_eq!(resumed.rows, [row(10, 0.5), row(20, 0.3)]);
        assert!(resumed.is_best(&row(30, 0.2)) && !resumed.is_best(&row(30, 0.35)));
        assert!(std::fs::read_to_string(folder.path().join("curve.svg")).unwrap().contains("contact MAE"));
        std::fs::write(folder.path().join("curve.csv"), "step\nten").unwrap();
        assert!(Curve::open(folder.path(), 20).is_err());
    }
}
