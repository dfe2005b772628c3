//! The shown moment: playing, stepping, scrubbing, and following a run that goes on.

use eframe::egui::{self, Key, Pos2, Rect, Response, Sense, Stroke, Ui, WidgetInfo};
use mvt_recording::{RecordedMoment, Recording, Status};
use mvt_run::report::TrackState;

use super::icons::{self, Icon};
use super::style::{self, colour};

/// Speeds of playback; 1 is real time.
pub const SPEEDS: [f64; 6] = [0.1, 0.25, 0.5, 1.0, 2.0, 4.0];

/// Playback of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Playback {
    time_s: f64,
    /// Whether it plays.
    pub is_playing: bool,
    /// Whether it shows the newest frame.
    pub is_live: bool,
}

impl Playback {
    /// Returns a playback that follows a run that goes on, or stands at the last frame.
    pub fn new(recording: &Recording) -> Self {
        let time_s = recording.moments().last().map_or(0.0, |moment| moment.row.time_s);
        Self { time_s, is_playing: false, is_live: recording.status() == Status::Running }
    }

    /// Returns the index of the shown moment: the last one at or before the time.
    pub fn moment(&self, moments: &[RecordedMoment]) -> usize {
        let last = moments.len().saturating_sub(1);
        if self.is_live {
            return last;
        }
        moment_at(moments, self.time_s)
    }

    /// Shows a moment. The last moment of a run that goes on starts to follow it.
    pub fn show(&mut self, moments: &[RecordedMoment], moment: usize, is_running: bool) {
        let moment = moment.min(moments.len().saturating_sub(1));
        self.time_s = moments.get(moment).map_or(0.0, |moment| moment.row.time_s);
        self.is_live = is_running && moment + 1 >= moments.len();
        if self.is_live {
            self.is_playing = false;
        }
    }

    /// Shows the moment at or before a time.
    pub fn seek(&mut self, moments: &[RecordedMoment], time_s: f64) {
        self.show(moments, moment_at(moments, time_s), false);
    }

    /// Steps forward or back by some moments.
    pub fn step(&mut self, moments: &[RecordedMoment], by: isize, is_running: bool) {
        self.is_playing = false;
        let moment = self.moment(moments).saturating_add_signed(by);
        self.show(moments, moment, is_running);
    }

    /// Starts or stops playing; from the end, it starts at the beginning.
    pub fn toggle(&mut self, moments: &[RecordedMoment]) {
        self.is_playing = !self.is_playing;
        if self.is_playing && self.moment(moments) + 1 >= moments.len() {
            self.time_s = moments.first().map_or(0.0, |moment| moment.row.time_s);
        }
        self.is_live = false;
    }

    /// Advances the time by seconds of the window.
    pub fn advance(&mut self, moments: &[RecordedMoment], seconds: f64, speed: f64, is_running: bool) {
        let Some(last) = moments.last() else { return };
        if self.is_live {
            self.time_s = last.row.time_s;
            self.is_live = is_running;
        } else if self.is_playing {
            self.time_s += seconds * speed;
            if self.time_s >= last.row.time_s {
                self.time_s = last.row.time_s;
                self.is_playing = false;
                // Playback that reaches the newest frame follows the run.
                self.is_live = is_running;
            }
        }
    }

    /// Draws the track and the row of controls.
    pub fn ui(&mut self, ui: &mut Ui, recording: &Recording, speed: &mut f64) {
        let moments = recording.moments();
        let is_running = recording.status() == Status::Running;
        ui.add_enabled_ui(!moments.is_empty(), |ui| {
            self.track(ui, recording);
            ui.horizontal(|ui| {
                let moment = self.moment(moments);
                if icons::button(ui, Icon::First, "To the first frame (Home)").clicked() {
                    self.show(moments, 0, false);
                }
                if icons::button(ui, Icon::Back, "One frame back (Left)").clicked() {
                    self.step(moments, -1, is_running);
                }
                let (icon, words) =
                    if self.is_playing { (Icon::Pause, "Pause (Space)") } else { (Icon::Play, "Play (Space)") };
                if icons::button(ui, icon, words).clicked() {
                    self.toggle(moments);
                }
                if icons::button(ui, Icon::On, "One frame on (Right)").clicked() {
                    self.step(moments, 1, is_running);
                }
                if icons::button(ui, Icon::Last, "To the last frame (End)").clicked() {
                    self.show(moments, usize::MAX, is_running);
                }
                let label = ui.label("Speed");
                egui::ComboBox::from_id_salt("speed")
                    .selected_text(speed_text(*speed))
                    .width(64.0)
                    .show_ui(ui, |ui| {
                        for choice in SPEEDS {
                            ui.selectable_value(speed, choice, speed_text(choice));
                        }
                    })
                    .response
                    .labelled_by(label.id);
                if is_running && ui.selectable_label(self.is_live, "Live").on_hover_text("Follow the run").clicked() {
                    self.show(moments, usize::MAX, true);
                }
                let row = moments.get(moment).map(|moment| &moment.row);
                let time_s = row.map_or(0.0, |row| row.time_s);
                let end_s = moments.last().map_or(0.0, |moment| moment.row.time_s);
                ui.monospace(format!("{time_s:6.2} of {end_s:.2} s"));
                let (number, count) = ((moment + 1).min(moments.len()), recording.about().frames.max(moments.len()));
                let words = egui::RichText::new(format!("frame {number} of {count}")).weak();
                ui.add(egui::Label::new(words).truncate());
            });
        });
    }

    /// Draws the time as a slider with events and spans in which the object is lost.
    fn track(&mut self, ui: &mut Ui, recording: &Recording) -> Response {
        const HEIGHT: f32 = 22.0;
        let theme = style::theme(ui.ctx());
        let moments = recording.moments();
        let size = egui::vec2(ui.available_width(), HEIGHT);
        let (rect, mut response) = ui.allocate_exact_size(size, Sense::click_and_drag());
        let bar = Rect::from_center_size(rect.center(), egui::vec2(rect.width() - 16.0, 6.0));
        let span = moments.first().zip(moments.last()).map(|(first, last)| (first.row.time_s, last.row.time_s));
        let Some((begin_s, end_s)) = span else {
            ui.painter().rect_filled(bar, 3.0, colour(theme.faint).gamma_multiply(0.3));
            response.widget_info(|| WidgetInfo::slider(false, 0.0, "Time"));
            return response;
        };
        let length_s = (end_s - begin_s).max(1e-9);
        let x = |time_s: f64| bar.left() + ((time_s - begin_s) / length_s).clamp(0.0, 1.0) as f32 * bar.width();
        if let Some(pointer) = response.interact_pointer_pos() {
            let share = ((pointer.x - bar.left()) / bar.width()).clamp(0.0, 1.0);
            self.is_playing = false;
            // Half a frame more selects the nearest frame.
            let half_s = 0.5 * length_s / moments.len() as f64;
            self.seek(moments, begin_s + f64::from(share) * length_s + half_s);
            response.mark_changed();
        }
        let moment = self.moment(moments);
        let now_s = moments.get(moment).map_or(begin_s, |moment| moment.row.time_s);
        let painter = ui.painter();
        painter.rect_filled(bar, 3.0, colour(theme.faint).gamma_multiply(0.35));
        let played = Rect::from_min_max(bar.min, Pos2::new(x(now_s), bar.max.y));
        painter.rect_filled(played, 3.0, colour(theme.estimate));
        for (from_s, to_s) in lost_spans(moments) {
            let lost =
                Rect::from_x_y_ranges(x(from_s)..=x(to_s).max(x(from_s) + 2.0), bar.top() - 3.0..=bar.bottom() + 3.0);
            painter.rect_filled(lost, 0.0, colour(theme.lost).gamma_multiply(0.8));
        }
        for event in recording.events() {
            painter.vline(x(event.time_s), rect.top()..=rect.top() + 5.0, Stroke::new(1.5, colour(theme.ink)));
        }
        let knob = Pos2::new(x(now_s), bar.center().y);
        let stroke = Stroke::new(2.0, colour(if response.has_focus() { theme.ink } else { theme.estimate }));
        painter.circle(knob, 7.0, colour(theme.paper), stroke);
        response.widget_info(|| WidgetInfo::slider(ui.is_enabled(), now_s, "Time"));
        let near = |pointer: Pos2| recording.events().iter().find(|event| (x(event.time_s) - pointer.x).abs() < 4.0);
        if let Some(event) = response.hover_pos().and_then(near) {
            response = response.on_hover_text_at_pointer(format!("{:.2} s: {}", event.time_s, event.text));
        }
        response
    }

    /// Executes a key of the timeline.
    pub fn key(&mut self, key: Key, is_far: bool, moments: &[RecordedMoment], is_running: bool) {
        let far = if is_far { 30 } else { 1 };
        match key {
            Key::Space => self.toggle(moments),
            Key::ArrowRight => self.step(moments, far, is_running),
            Key::ArrowLeft => self.step(moments, -far, is_running),
            Key::Home => self.show(moments, 0, false),
            Key::End => self.show(moments, usize::MAX, is_running),
            _ => {}
        }
    }
}

fn speed_text(speed: f64) -> String {
    format!("{speed} x")
}

/// Returns the index of the last moment at or before a time, or 0.
pub fn moment_at(moments: &[RecordedMoment], time_s: f64) -> usize {
    moments.partition_point(|moment| moment.row.time_s <= time_s).saturating_sub(1)
}

/// Returns the spans in which the object was lost, seconds.
fn lost_spans(moments: &[RecordedMoment]) -> Vec<(f64, f64)> {
    let runs = moments.chunk_by(|a, b| (a.row.state == TrackState::Lost) == (b.row.state == TrackState::Lost));
    let lost = runs.filter(|run| run.first().is_some_and(|moment| moment.row.state == TrackState::Lost));
    lost.filter_map(|run| Some((run.first()?.row.time_s, run.last()?.row.time_s))).collect()
}
