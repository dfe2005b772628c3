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
    /// Errors of the averaged weights on objects that the training does not use.
    pub validation: Errors,
    /// The same on other presses of the objects that it uses.
    pub training: Errors,
}

/// Errors of a network on some images.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Errors {
    /// Mean absolute error over the pixels in contact.
    pub contact_mae_mm: f64,
    /// Root mean square error over all pixels.
    pub rmse_mm: f64,
    /// Mean absolute error over all pixels.
    pub mae_mm: f64,
    /// Mean over the images of the intersection over union of contact.
    pub iou: f64,
}

const HEADER: &str = "step,images_per_s,loss,gradient,rate,contact_mae_mm,rmse_mm,iou,mae_mm,\
                      training_contact_mae_mm,training_rmse_mm,training_iou,training_mae_mm";

impl Row {
    fn to_csv(self) -> String {
        let Self { step, images_per_s, loss, gradient, rate, validation, training } = self;
        let errors = |errors: Errors| {
            let Errors { contact_mae_mm, rmse_mm, mae_mm, iou } = errors;
            format!("{contact_mae_mm},{rmse_mm},{iou},{mae_mm}")
        };
        let (validation, training) = (errors(validation), errors(training));
        format!("{step},{images_per_s:.2},{loss},{gradient},{rate},{validation},{training}")
    }

    fn from_csv(line: &str) -> Option<Self> {
        let numbers: Vec<f64> = line.split(',').map(|cell| cell.parse().ok()).collect::<Option<_>>()?;
        let [step, images_per_s, loss, gradient, rate, contact_mae_mm, rmse_mm, iou, ref rest @ ..] = *numbers else {
            return None;
        };
        let [mae_mm, training @ ..] = match *rest {
            [mae_mm, contact_mae_mm, rmse_mm, iou, training_mae_mm] => {
                [mae_mm, contact_mae_mm, rmse_mm, iou, training_mae_mm]
            }
            // Curves of 0.1.0 have no more columns.
            [] => [f64::NAN; 5],
            _ => return None,
        };
        let errors = |[contact_mae_mm, rmse_mm, iou, mae_mm]: [f64; 4]| Errors { contact_mae_mm, rmse_mm, mae_mm, iou };
        Some(Self {
            step: step as u64,
            images_per_s,
            loss: loss as f32,
            gradient: gradient as f32,
            rate: rate as f32,
            validation: errors([contact_mae_mm, rmse_mm, iou, mae_mm]),
            training: errors(training),
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
        self.rows.iter().all(|other| row.validation.contact_mae_mm < other.validation.contact_mae_mm)
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
    type Value = fn(&Errors) -> f64;
    const PANELS: [(&str, Value); 4] = [
        ("contact MAE, mm", |errors| errors.contact_mae_mm),
        ("RMSE, mm", |errors| errors.rmse_mm),
        ("MAE, mm", |errors| errors.mae_mm),
        ("1 - IoU", |errors| 1.0 - errors.iou),
    ];
    let end = rows.last().map_or(1, |row| row.step) as f64;
    let line = |name: &str, colour: usize, value: &dyn Fn(&Row) -> f64| {
        let values = rows.iter().map(|row| (row.step as f64, value(row)));
        let points = values.filter(|(_, v)| *v > 0.0 && v.is_finite()).collect();
        ChartLine { name: name.to_owned(), colour: CURVES[colour], points }
    };
    let panel = |title: &str, lines: Vec<ChartLine>| {
        let values = || lines.iter().flat_map(|line| line.points.iter().map(|point| point.1));
        let bottom = values().fold(f64::INFINITY, f64::min).clamp(1e-6, 1e6) * 0.9;
        let top = values().fold(0.0, f64::max).clamp(bottom * 1.2, 1e7) * 1.1;
        ChartPanel {
            title: title.to_owned(),
            span: 0.0..end,
            unit: "steps".to_owned(),
            scale: ChartScale::Log { bottom, top },
            lines,
            lanes: Vec::new(),
            shaded: Vec::new(),
            cursor: None,
        }
    };
    let mut panels = vec![panel("loss", vec![line("", 0, &|row| f64::from(row.loss))])];
    panels.extend(PANELS.map(|(title, value)| {
        let validation = line("other objects", 0, &|row| value(&row.validation));
        panel(title, vec![validation, line("objects of the training", 1, &|row| value(&row.training))])
    }));
    chart::svg("training", &panels, &Theme::LIGHT)
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
            validation: Errors { contact_mae_mm, rmse_mm: 0.2, mae_mm: 0.05, iou: 0.8 },
            training: Errors { contact_mae_mm: 0.1, rmse_mm: 0.15, mae_mm: 0.04, iou: 0.9 },
        };
        let mut curve = Curve::open(folder.path(), 0).unwrap();
        for (step, error) in [(10, 0.5), (20, 0.3), (30, 0.4)] {
            curve.push(row(step, error)).unwrap();
        }
        let resumed = Curve::open(folder.path(), 20).unwrap();
        assert_eq!(resumed.rows, [row(10, 0.5), row(20, 0.3)]);
        assert!(resumed.is_best(&row(30, 0.2)) && !resumed.is_best(&row(30, 0.35)));
        assert!(std::fs::read_to_string(folder.path().join("curve.svg")).unwrap().contains("contact MAE"));
        let older =
            "step,images_per_s,loss,gradient,rate,contact_mae_mm,rmse_mm,iou\n10,10.00,0.5,1.5,0.001,0.5,0.2,0.8\n";
        std::fs::write(folder.path().join("curve.csv"), older).unwrap();
        let older = Curve::open(folder.path(), 10).unwrap();
        assert!(older.rows[0].validation.iou == 0.8 && older.rows[0].training.iou.is_nan());
        std::fs::write(folder.path().join("curve.csv"), "step\nten").unwrap();
        assert!(Curve::open(folder.path(), 20).is_err());
    }
}
