//! Messages in the lowest line of a page.

use std::time::Duration;

use eframe::egui::{Context, Ui};
use mvt_recording::Recording;

use super::shared_recording::SharedRecording;
use super::style::{self, colour};

/// Time for which a message is shown, seconds.
const NOTICE_S: f64 = 8.0;

/// The newest message, which disappears after some seconds.
#[derive(Default)]
pub struct Notice {
    /// The message, and until when it is shown, in seconds of the window.
    shown: Option<(String, f64)>,
}

impl Notice {
    /// Shows a message.
    pub fn show(&mut self, ctx: &Context, text: String) {
        self.shown = Some((text, ctx.input(|input| input.time) + NOTICE_S));
        ctx.request_repaint_after(Duration::from_secs_f64(NOTICE_S));
    }

    /// Removes an old message.
    pub fn update(&mut self, ctx: &Context) {
        let now_s = ctx.input(|input| input.time);
        self.shown.take_if(|(_, until_s)| *until_s <= now_s);
    }

    /// Draws the message.
    pub fn ui(&self, ui: &mut Ui) {
        if let Some((text, _)) = &self.shown {
            ui.strong(text);
        }
    }
}

/// Draws the problem of a recording, or else its last warning.
pub fn problem(ui: &mut Ui, shared: &SharedRecording, recording: &Recording) {
    let lost = colour(style::theme(ui.ctx()).lost);
    if let Some(problem) = shared.problem() {
        ui.colored_label(lost, problem);
    } else if let Some(warning) = recording.warnings().last() {
        ui.colored_label(lost, warning).on_hover_text(recording.warnings().join("\n"));
    }
}
