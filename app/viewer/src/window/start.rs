//! The first page: what is to be turned and how, and the runs of before.

use std::path::PathBuf;

use eframe::egui::{self, Align2, Context, FontId, Role, Sense, TextEdit, Ui, WidgetInfo};
use mvt_objects::catalogue;
use mvt_objects::catalogue::Entry;

use super::launch::Choices;
use super::layers_panel::choice;
use super::preferences::Preferences;
use super::style::{self, colour};
use super::thumbnails::Thumbnails;

/// What somebody wants.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Wish {
    /// A run as chosen.
    Start,
    /// To look at a run.
    Open(PathBuf),
    /// To look at a raw log.
    OpenLog(PathBuf),
}

/// The page.
pub struct Start {
    entries: Vec<Entry>,
    thumbnails: Thumbnails,
    search: String,
    path: String,
    gaits: Vec<String>,
}

/// A tile with its name below, points.
const TILE: egui::Vec2 = egui::vec2(104.0, 118.0);

impl Start {
    /// The page, whose pictures come later.
    pub fn new(ctx: &Context) -> Self {
        // What needs no download comes first.
        let (made, fetched): (Vec<Entry>, Vec<Entry>) = catalogue::entries().partition(Entry::is_procedural);
        let entries: Vec<Entry> = made.into_iter().chain(fetched).collect();
        let gaits = std::iter::once("auto".to_owned()).chain(mvt_gaits::gait::shipped().keys().cloned()).collect();
        let thumbnails = Thumbnails::new(ctx, entries.clone());
        Self { entries, thumbnails, search: String::new(), path: String::new(), gaits }
    }

    /// Whether pictures are still to come.
    #[cfg(test)]
    pub fn is_busy(&self) -> bool {
        self.entries.iter().any(|entry| !self.thumbnails.has_come(entry.name))
    }

    /// Leaves out objects that may or may not be on this machine.
    #[cfg(test)]
    pub fn keep_procedural(&mut self) {
        self.entries.retain(Entry::is_procedural);
    }

    /// Draws the page. `problem` is what went wrong before.
    pub fn ui(&mut self, ui: &mut Ui, preferences: &mut Preferences, problem: Option<&str>) -> Option<Wish> {
        self.thumbnails.update(ui.ctx());
        ui.heading("A hand turns an object, and learns its shape and pose");
        ui.weak("Choose what is turned and how it is sensed, or look at a run of before.");
        if let Some(problem) = problem {
            ui.colored_label(colour(style::theme(ui.ctx()).lost), problem);
        }
        ui.add_space(4.0);
        if ui.available_width() > 760.0 {
            let mut wish = None;
            egui::Panel::right("settings").resizable(false).exact_size(300.0).show(ui, |ui| {
                egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| wish = self.settings(ui, preferences));
            });
            egui::CentralPanel::no_frame().show(ui, |ui| self.objects(ui, &mut preferences.choices));
            wish
        } else {
            // One below the other where the window is narrow or text is large.
            let scroll = egui::ScrollArea::vertical().auto_shrink(false);
            scroll
                .show(ui, |ui| {
                    let wish = self.settings(ui, preferences);
                    ui.separator();
                    ui.allocate_ui(egui::vec2(ui.available_width(), 420.0), |ui| {
                        self.objects(ui, &mut preferences.choices);
                    });
                    wish
                })
                .inner
        }
    }

    fn objects(&mut self, ui: &mut Ui, choices: &mut Choices) {
        ui.horizontal(|ui| {
            let label = ui.strong("Object");
            ui.add(TextEdit::singleline(&mut self.search).hint_text("search").desired_width(180.0))
                .labelled_by(label.id);
            ui.label(&choices.object);
        });
        let wanted = self.search.to_lowercase();
        let found: Vec<&Entry> = self.entries.iter().filter(|entry| entry.name.contains(&wanted)).collect();
        if found.is_empty() {
            ui.weak("No object of the catalogue has such a name.");
            if catalogue::is_path(&self.search) && ui.button("Use it as the path of a mesh").clicked() {
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
                    let text = if is_here { "" } else { "fetched when\nit is chosen" };
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
        let hint = if is_here { name.to_owned() } else { format!("{name}: its mesh is fetched first") };
        response.on_hover_text(hint).clicked()
    }

    fn settings(&mut self, ui: &mut Ui, preferences: &mut Preferences) -> Option<Wish> {
        let choices = &mut preferences.choices;
        let mut wish = None;
        ui.strong("Run");
        named_choice(ui, "Mode", &mut choices.mode, &Choices::modes());
        named_choice(ui, "Sensors", &mut choices.modality, &Choices::modalities());
        let gaits: Vec<&str> = self.gaits.iter().map(String::as_str).collect();
        let mut gait = gaits.iter().copied().find(|&gait| gait == choices.gait).unwrap_or("auto");
        choice(ui, "Controller", &mut gait, &gaits, |gait| match gait {
            "auto" => "gait that suits the object".to_owned(),
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
            .on_hover_text("Simulates, estimates and shows it; closing the window does not end it")
            .clicked()
        {
            wish = Some(Wish::Start);
        }
        ui.separator();
        ui.strong("Recent runs");
        if preferences.recent.is_empty() {
            ui.weak("None yet.");
        }
        let mut forgotten = None;
        for (k, folder) in preferences.recent.iter().enumerate() {
            let name =
                folder.file_name().map_or_else(|| folder.display().to_string(), |n| n.to_string_lossy().into_owned());
            ui.horizontal(|ui| {
                if ui.link(&name).on_hover_text(folder.display().to_string()).clicked() {
                    wish = Some(Wish::Open(folder.clone()));
                }
                if ui
                    .small_button("forget")
                    .on_hover_text(format!("Takes {name} off this list; its files stay"))
                    .clicked()
                {
                    forgotten = Some(k);
                }
            });
        }
        if let Some(k) = forgotten {
            preferences.recent.remove(k);
        }
        ui.separator();
        let label = ui.strong("Folder of a run or log");
        ui.add(TextEdit::singleline(&mut self.path).desired_width(f32::INFINITY)).labelled_by(label.id);
        ui.horizontal(|ui| {
            let path = PathBuf::from(self.path.trim());
            let is_given = !path.as_os_str().is_empty();
            if ui.add_enabled(is_given, egui::Button::new("Open run")).clicked() {
                wish = Some(Wish::Open(path.clone()));
            }
            if ui.add_enabled(is_given, egui::Button::new("Open log")).clicked() {
                wish = Some(Wish::OpenLog(path));
            }
        });
        wish
    }
}

/// A choice among names that have meanings.
fn named_choice(ui: &mut Ui, label: &str, value: &mut String, all: &[(&'static str, String)]) {
    let names: Vec<&str> = all.iter().map(|(name, _)| *name).collect();
    let mut name = names.iter().copied().find(|name| name == value).or(names.first().copied()).unwrap_or_default();
    let meaning = |name: &str| all.iter().find(|(other, _)| *other == name).map_or("", |(_, meaning)| meaning.as_str());
    choice(ui, label, &mut name, &names, |name| format!("{name}: {}", meaning(name).to_lowercase()));
    if name != value {
        name.clone_into(value);
    }
}
