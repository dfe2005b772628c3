//! The start page: settings of a new run, and recent runs.

use std::path::PathBuf;

use eframe::egui::{self, Align2, Context, FontId, Role, Sense, TextEdit, Ui, WidgetInfo};
use mvt_gaits::gait::{AUTO, SUITED, shipped};
use mvt_objects::catalogue;
use mvt_objects::catalogue::Entry;
use mvt_objects::random::RandomObject;

use super::WindowContents;
use super::layers_panel::choice;
use super::preferences::Preferences;
use super::style::{self, colour};
use super::thumbnails::Thumbnails;
use mvt_viewer::RecordingSource;
use mvt_viewer::captions;
use mvt_viewer::run_choices::RunChoices;

/// Request of the user.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum StartRequest {
    /// Start a run with the choices.
    Start,
    /// Show a run, a log or a comparison.
    Show(WindowContents),
    /// Play the recording that the program carries.
    Example,
}

/// The start page.
pub struct StartPage {
    entries: Vec<Entry>,
    thumbnails: Thumbnails,
    search: String,
    path: String,
    gaits: Vec<String>,
    /// Recent runs that are ticked for a comparison.
    compared: Vec<PathBuf>,
}

/// Size of a tile with its name, points.
const TILE: egui::Vec2 = egui::vec2(104.0, 118.0);

impl StartPage {
    /// Returns the page. A thread draws its pictures.
    pub fn new(ctx: &Context) -> Self {
        // Objects that need no download come first.
        let (made, fetched): (Vec<Entry>, Vec<Entry>) = catalogue::entries().partition(Entry::is_procedural);
        let entries: Vec<Entry> = made.into_iter().chain(fetched).collect();
        let gaits = [AUTO, SUITED].map(str::to_owned).into_iter().chain(shipped().keys().cloned()).collect();
        let thumbnails = Thumbnails::new(ctx, entries.clone());
        Self { entries, thumbnails, search: String::new(), path: String::new(), gaits, compared: Vec::new() }
    }

    /// Draws the pictures of objects whose meshes may have come since the page was last shown.
    pub fn look_again(&mut self, ctx: &Context) {
        self.thumbnails.look_again(ctx, &self.entries);
    }

    /// Whether pictures are missing.
    #[cfg(test)]
    pub fn is_busy(&self) -> bool {
        self.entries.iter().any(|entry| !self.thumbnails.has_come(entry.name))
    }

    /// Keeps only the objects that are on every machine.
    #[cfg(test)]
    pub fn keep_procedural(&mut self) {
        self.entries.retain(Entry::is_procedural);
    }

    /// Draws the page with the problem of the last request.
    pub fn ui(&mut self, ui: &mut Ui, preferences: &mut Preferences, problem: Option<&str>) -> Option<StartRequest> {
        self.thumbnails.update(ui.ctx());
        ui.heading("A hand turns an object and estimates its shape and pose");
        ui.weak("Choose an object and sensors for a new run, or open a recent run.");
        if let Some(problem) = problem {
            ui.colored_label(colour(style::theme(ui.ctx()).lost), problem);
        }
        ui.add_space(4.0);
        if ui.available_width() > 760.0 {
            let mut request = None;
            egui::Panel::right("settings").resizable(false).exact_size(300.0).show(ui, |ui| {
                egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| request = self.settings(ui, preferences));
            });
            egui::CentralPanel::no_frame().show(ui, |ui| self.objects(ui, &mut preferences.choices));
            request
        } else {
            // A narrow window or large text puts one below the other.
            let scroll = egui::ScrollArea::vertical().auto_shrink(false);
            scroll
                .show(ui, |ui| {
                    let request = self.settings(ui, preferences);
                    ui.separator();
                    ui.allocate_ui(egui::vec2(ui.available_width(), 420.0), |ui| {
                        self.objects(ui, &mut preferences.choices);
                    });
                    request
                })
                .inner
        }
    }

    fn objects(&mut self, ui: &mut Ui, choices: &mut RunChoices) {
        ui.horizontal(|ui| {
            let label = ui.strong("Object");
            ui.add(TextEdit::singleline(&mut self.search).hint_text("search, or random:SEED").desired_width(180.0))
                .labelled_by(label.id);
            ui.label(&choices.object);
        });
        let wanted = self.search.to_lowercase();
        let found: Vec<&Entry> = self.entries.iter().filter(|entry| entry.name.contains(&wanted)).collect();
        if found.is_empty() {
            ui.weak("No object in the catalogue has this name.");
            if catalogue::mesh_path(&self.search).is_some() && ui.button("Use it as the path of a mesh").clicked() {
                choices.object.clone_from(&self.search);
            }
            if let Some(Ok(_)) = RandomObject::from_name(&self.search)
                && ui.button("Use this random object").clicked()
            {
                choices.object.clone_from(&self.search);
            }
        }
        egui::ScrollArea::vertical().id_salt("objects").auto_shrink(false).show(ui, |ui| {
            ui.horizontal_wrapped(|ui| {
                for entry in found {
                    if self.tile(ui, entry, choices.object == entry.name) {
                        choices.object = entry.name.to_owned();
                    }
                }
            });
        });
    }

    fn tile(&self, ui: &mut Ui, entry: &Entry, is_chosen: bool) -> bool {
        let (rect, response) = ui.allocate_exact_size(TILE, Sense::click());
        let name = entry.name;
        response.widget_info(|| WidgetInfo::selected(Role::RadioButton, true, is_chosen, name));
        let is_here = self.thumbnails.is_here(name);
        if ui.is_rect_visible(rect) {
            let theme = style::theme(ui.ctx());
            let fill = match (is_chosen, response.hovered() || response.has_focus()) {
                (true, _) => ui.visuals().selection.bg_fill,
                (false, true) => ui.visuals().widgets.hovered.weak_bg_fill,
                (false, false) => ui.visuals().extreme_bg_color,
            };
            ui.painter().rect_filled(rect, 4.0, fill);
            let square = egui::Rect::from_min_size(rect.min + egui::vec2(12.0, 4.0), egui::Vec2::splat(80.0));
            match self.thumbnails.get(name) {
                Some(texture) => egui::Image::new(texture).paint_at(ui, square),
                None => {
                    let text = if is_here { "" } else { "downloaded\non first use" };
                    let font = FontId::proportional(11.0);
                    ui.painter().text(square.center(), Align2::CENTER_CENTER, text, font, colour(theme.faint));
                }
            }
            let layout = |text: &str| {
                let font = FontId::proportional(11.0);
                ui.painter().layout(text.to_owned(), font, colour(theme.ink), TILE.x - 8.0)
            };
            let words = layout(&name.replace('_', " "));
            let corner =
                egui::pos2(rect.center().x - 0.5 * words.size().x, rect.bottom() - 3.0 - words.size().y.min(30.0));
            ui.painter().with_clip_rect(rect).galley(corner, words, colour(theme.ink));
        }
        let hint = if is_here { name.to_owned() } else { format!("{name}: its mesh is downloaded on first use") };
        response.on_hover_text(hint).clicked()
    }

    fn settings(&mut self, ui: &mut Ui, preferences: &mut Preferences) -> Option<StartRequest> {
        let choices = &mut preferences.choices;
        let mut request = None;
        ui.strong("Run");
        named_choice(ui, "Mode", &mut choices.mode, &RunChoices::modes());
        named_choice(ui, "Sensors", &mut choices.modality, &RunChoices::modalities());
        let gaits: Vec<&str> = self.gaits.iter().map(String::as_str).collect();
        let mut gait = gaits.iter().copied().find(|&gait| gait == choices.gait).unwrap_or(AUTO);
        choice(ui, "Controller", &mut gait, &gaits, |gait| match gait {
            AUTO => "what moves the object best".to_owned(),
            SUITED => "gait that suits the object".to_owned(),
            gait => format!("gait {gait}"),
        });
        if gait != choices.gait {
            gait.clone_into(&mut choices.gait);
        }
        let label = ui.label("Duration");
        ui.add(egui::Slider::new(&mut choices.duration_s, 1.0..=120.0).step_by(1.0).suffix(" s")).labelled_by(label.id);
        ui.horizontal(|ui| {
            let label = ui.label("Seed");
            ui.add(egui::DragValue::new(&mut choices.seed)).labelled_by(label.id);
        });
        let label = ui.label("Folder of the runs");
        let mut folder = choices.folder.display().to_string();
        let field = TextEdit::singleline(&mut folder).desired_width(f32::INFINITY);
        if ui.add(field).labelled_by(label.id).changed() {
            choices.folder = PathBuf::from(folder);
        }
        ui.add_space(6.0);
        let start = egui::Button::new(egui::RichText::new("Start").size(16.0));
        if ui
            .add_sized([120.0, 30.0], start)
            .on_hover_text("Simulates and estimates the run and shows it; it goes on when the window is closed")
            .clicked()
        {
            request = Some(StartRequest::Start);
        }
        ui.separator();
        ui.strong("Recent runs");
        request = self.recent(ui, preferences).map(StartRequest::Show).or(request);
        if ui.link("example of the program").on_hover_text("Five seconds that come with the program").clicked() {
            request = Some(StartRequest::Example);
        }
        ui.separator();
        let label = ui.strong("Folder of a run or log");
        ui.add(TextEdit::singleline(&mut self.path).desired_width(f32::INFINITY)).labelled_by(label.id);
        ui.horizontal(|ui| {
            let path = PathBuf::from(self.path.trim());
            let is_given = !path.as_os_str().is_empty();
            if ui.add_enabled(is_given, egui::Button::new("Open run")).clicked() {
                request = Some(StartRequest::Show(WindowContents::Recording(RecordingSource::Run(path.clone()))));
            }
            if ui.add_enabled(is_given, egui::Button::new("Open log")).clicked() {
                request = Some(StartRequest::Show(WindowContents::Recording(RecordingSource::Log(path))));
            }
        });
        request
    }
}

impl StartPage {
    /// Draws the recent runs. Returns what should be shown.
    fn recent(&mut self, ui: &mut Ui, preferences: &mut Preferences) -> Option<WindowContents> {
        let run = |folder: &PathBuf| RecordingSource::Run(folder.clone());
        let (mut shown, mut forgotten) = (None, None);
        self.compared.retain(|folder| preferences.recent.contains(folder));
        for (k, folder) in preferences.recent.iter().enumerate() {
            let name = captions::folder(folder);
            ui.horizontal(|ui| {
                let mut is_compared = self.compared.contains(folder);
                let tick = ui.checkbox(&mut is_compared, "").on_hover_text("Tick two runs to compare them");
                tick.widget_info(|| WidgetInfo::selected(Role::CheckBox, true, is_compared, format!("compare {name}")));
                if tick.changed() {
                    self.compared.retain(|other| other != folder);
                    if is_compared {
                        self.compared.push(folder.clone());
                    }
                }
                if ui.link(&name).on_hover_text(folder.display().to_string()).clicked() {
                    shown = Some(WindowContents::Recording(run(folder)));
                }
                let forget = ui.small_button("forget");
                if forget.on_hover_text(format!("Removes {name} from this list; its files stay")).clicked() {
                    forgotten = Some(k);
                }
            });
        }
        if let Some(k) = forgotten {
            preferences.recent.remove(k);
        }
        if preferences.recent.len() > 1 {
            let both = match self.compared.as_slice() {
                [a, b] => Some([run(a), run(b)]),
                _ => None,
            };
            let button = ui.add_enabled(both.is_some(), egui::Button::new("Compare two runs"));
            if button.on_disabled_hover_text("Tick two of the runs").clicked() {
                shown = both.map(WindowContents::Comparison);
            }
        }
        shown
    }
}

/// Draws a choice of a name with its meaning.
fn named_choice(ui: &mut Ui, label: &str, value: &mut String, all: &[(&'static str, String)]) {
    let names: Vec<&str> = all.iter().map(|(name, _)| *name).collect();
    let mut name = names.iter().copied().find(|name| name == value).or(names.first().copied()).unwrap_or_default();
    let meaning = |name: &str| all.iter().find(|(other, _)| *other == name).map_or("", |(_, meaning)| meaning.as_str());
    choice(ui, label, &mut name, &names, |name| format!("{name}: {}", meaning(name).to_lowercase()));
    if name != value {
        name.clone_into(value);
    }
}
