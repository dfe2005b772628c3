//! Table of the figures of two runs at one time.

use eframe::egui::{self, Color32, Ui};
use mvt_recording::Recording;
use mvt_run::report::TrackState;

use super::plots;
use super::timeline::moment_at;
use mvt_viewer::captions;

/// Figures of a run at a moment, in words; "-" for a missing one.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Figures {
    state: String,
    add_s_mm: String,
    mean_add_s_mm: String,
    rotation_deg: String,
    f2: String,
    f5: String,
    confidence: String,
}

impl Figures {
    /// Returns the figures at a time.
    fn at(recording: &Recording, now_s: f64) -> Self {
        let moments = recording.moments();
        let moment = moment_at(moments, now_s);
        let none = || "-".to_owned();
        let Some(now) = moments.get(moment).filter(|now| now.estimate().is_some()) else {
            return Self {
                state: "no estimate".to_owned(),
                add_s_mm: none(),
                mean_add_s_mm: none(),
                rotation_deg: none(),
                f2: none(),
                f5: none(),
                confidence: none(),
            };
        };
        let row = &now.row;
        let state = match row.state {
            // A run that is shorter than the other one.
            _ if moment + 1 == moments.len() && now_s > row.time_s + 0.05 => format!("ended at {:.2} s", row.time_s),
            TrackState::Lost => "lost".to_owned(),
            TrackState::Waiting => "waiting".to_owned(),
            TrackState::Relocalised => "found again".to_owned(),
            TrackState::Tracking => "tracking".to_owned(),
        };
        let errors = moments.get(..=moment).unwrap_or_default().iter().filter_map(|moment| moment.row.add_s);
        let (sum_m, count) = errors.fold((0.0, 0u32), |(sum, count), error| (sum + error.one_directional_m, count + 1));
        let add_s_mm = match row.add_s {
            Some(_) if captions::begins_errors(recording, moment) => "begins here".to_owned(),
            Some(error) => format!("{:.2}", error.one_directional_m * 1e3),
            None => none(),
        };
        let point = recording.shape_at(moment).and_then(|shape| recording.shapes().get(shape)?.point);
        let share = |share: Option<f64>| share.map_or_else(none, |share| format!("{share:.3}"));
        Self {
            state,
            add_s_mm,
            mean_add_s_mm: if count > 0 { format!("{:.2}", sum_m / f64::from(count) * 1e3) } else { none() },
            rotation_deg: row
                .rotation_error_rad()
                .map_or_else(none, |angle_rad| format!("{:.1}", angle_rad.to_degrees())),
            f2: share(point.map(|point| point.f2)),
            f5: share(point.map(|point| point.f5)),
            confidence: format!("{:.2}", row.confidence),
        }
    }
}

/// Draws the table.
pub fn ui(ui: &mut Ui, tints: [Color32; 2], recordings: [&Recording; 2], now_s: f64) {
    let [a, b] = recordings.map(|recording| Figures::at(recording, now_s));
    egui::Grid::new("figures").num_columns(3).striped(true).spacing([12.0, 3.0]).show(ui, |ui| {
        ui.label(format!("at {now_s:.2} s"));
        for (name, tint) in ["A", "B"].into_iter().zip(tints) {
            ui.horizontal(|ui| {
                plots::chip(ui, tint);
                ui.strong(name);
            });
        }
        ui.end_row();
        for (label, meaning, a, b) in [
            ("state", "What the tracker does", a.state, b.state),
            ("ADD-S, mm", "Error of the pose", a.add_s_mm, b.add_s_mm),
            (
                "mean ADD-S, mm",
                "Mean error of the pose from the beginning to this time",
                a.mean_add_s_mm,
                b.mean_add_s_mm,
            ),
            (
                "rotation error, degrees",
                "Angle between the estimated and the true rotation; a turn after which the object looks the same counts",
                a.rotation_deg,
                b.rotation_deg,
            ),
            ("F-score at 2 mm", "Share of the surface that is right within 2 mm, at the last mesh", a.f2, b.f2),
            ("F-score at 5 mm", "Share of the surface that is right within 5 mm, at the last mesh", a.f5, b.f5),
            ("confidence", "How far the tracker trusts the pose, 0 to 1", a.confidence, b.confidence),
        ] {
            ui.label(label).on_hover_text(meaning);
            ui.label(a);
            ui.label(b);
            ui.end_row();
        }
    });
}
