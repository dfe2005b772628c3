//! The scene in three dimensions: painted by a thread of its own, turned by the pointer.

use std::sync::Arc;
use std::time::{Duration, Instant};

use eframe::egui::{self, ColorImage, Context, PointerButton, Pos2, Rect, Sense, TextureHandle, TextureOptions, Ui};
use nalgebra::Vector3;

use super::legend;
use super::shared::Shared;
use super::studio::{Craft, Studio};
use super::style;
use crate::{Eye, Layers, Preset, Scene, Theme};
use mvt_recording::Recording;

/// How often a recording that grows is looked at, at most.
const POLL: Duration = Duration::from_millis(150);
/// A run that goes on is left alone for so many times what a picture of it took; sensors' pictures and the window take as much again.
const SHARE: u32 = 20;
/// Slower pictures are coarser while the view moves.
const SLOW: Duration = Duration::from_millis(33);

/// A picture that is wanted.
#[derive(Debug, Clone, PartialEq)]
struct Order {
    moment: usize,
    /// A longer recording may have another shape for the same moment.
    revision: u64,
    layers: Layers,
    eye: Eye,
    theme: Theme,
    size: [usize; 2],
}

/// A picture.
struct Painted {
    image: ColorImage,
    spent: Duration,
    warning: Option<String>,
}

struct Painter {
    shared: Arc<Shared>,
    scene: Scene,
    looked: Instant,
    /// Time that the last picture took.
    spent: Duration,
}

impl Craft for Painter {
    type Order = Order;
    type Product = Painted;

    fn make(&mut self, order: Order) -> Painted {
        let begun = Instant::now();
        // Who always paints is never idle.
        self.idle();
        let recording = self.shared.read();
        let image = self.scene.paint(&recording, order.moment, &order.layers, &order.eye, &order.theme, order.size);
        let image = ColorImage::from_rgb(order.size, image);
        self.spent = begun.elapsed();
        tracing::trace!("moment {} at {:?} painted in {:?}", order.moment, order.size, self.spent);
        Painted { image, spent: self.spent, warning: self.scene.warning().map(str::to_owned) }
    }

    /// Looks whether the run has gone on, if it is time to, and wakes the window if it has.
    fn idle(&mut self) -> (Option<Duration>, bool) {
        let pause = POLL.max(SHARE * self.spent);
        let waited = self.looked.elapsed();
        if waited < pause {
            return (self.shared.is_growing().then(|| pause - waited), false);
        }
        self.looked = Instant::now();
        let has_news = self.shared.refresh();
        (self.shared.is_growing().then_some(pause), has_news)
    }
}

/// The view with what it needs from frame to frame.
pub struct View {
    /// From where.
    pub eye: Eye,
    studio: Studio<Painter>,
    texture: Option<TextureHandle>,
    spent: Duration,
    /// What could not be painted.
    warning: Option<String>,
    /// Where the object was when it was last followed.
    followed: Option<Vector3<f64>>,
}

impl View {
    /// A view of a recording. The thread that paints also looks whether the run goes on.
    pub fn new(ctx: &Context, shared: Arc<Shared>) -> Self {
        let studio = Studio::new(ctx.clone(), || Painter {
            shared,
            scene: Scene::new(),
            looked: Instant::now(),
            spent: Duration::ZERO,
        });
        Self { eye: Eye::default(), studio, texture: None, spent: Duration::ZERO, warning: None, followed: None }
    }

    /// Back to where it began.
    pub fn reset(&mut self) {
        self.eye = Eye::new(Preset::Oblique);
    }

    /// Whether a picture is under way.
    #[cfg(test)]
    pub fn is_busy(&self) -> bool {
        self.studio.is_busy()
    }

    /// Fills the rest of `ui`.
    pub fn ui(&mut self, ui: &mut Ui, recording: &Recording, moment: usize, layers: Layers, follow: bool) {
        let size = ui.available_size().max(egui::vec2(16.0, 16.0));
        let (rect, response) = ui.allocate_exact_size(size, Sense::click_and_drag());
        let object = recording.pose(moment).map(|pose| pose.untyped().translation.vector);
        self.follow(object.filter(|_| follow));
        if response.double_clicked()
            && let Some(object) = object
        {
            self.eye.follow(object);
        }
        let is_moving = self.turn(ui, rect, &response);
        let scale = if is_moving && self.spent > SLOW { 0.5 } else { 1.0 };
        let pixels = |points: f32| ((points * ui.pixels_per_point() * scale) as usize).clamp(16, 4096);
        self.studio.order(Order {
            moment,
            revision: recording.revision(),
            layers,
            eye: self.eye,
            theme: style::theme(ui.ctx()),
            size: [pixels(rect.width()), pixels(rect.height())],
        });
        if let Some(painted) = self.studio.take() {
            self.warning = painted.warning;
            // The first makes what is kept, a coarse one is quick because it is coarse, and one that was held up is not to make all
            // others coarse.
            if self.texture.is_some() && scale == 1.0 {
                self.spent = (self.spent + painted.spent) / 2;
            }
            match &mut self.texture {
                Some(texture) => texture.set(painted.image, TextureOptions::LINEAR),
                None => self.texture = Some(ui.ctx().load_texture("scene", painted.image, TextureOptions::LINEAR)),
            }
        }
        if let Some(texture) = &self.texture {
            let whole = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
            ui.painter().image(texture.id(), rect, whole, egui::Color32::WHITE);
        }
        legend::paint(ui, rect, recording, &layers, &self.eye);
        if let Some(warning) = &self.warning {
            let colour = style::colour(style::theme(ui.ctx()).lost);
            let font = egui::TextStyle::Body.resolve(ui.style());
            let words = ui.painter().layout(warning.clone(), font, colour, rect.width() - 16.0);
            ui.painter().galley(rect.left_top() + egui::vec2(8.0, 8.0), words, colour);
        }
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, "The scene in three dimensions"));
    }

    /// Moves with the object.
    fn follow(&mut self, object: Option<Vector3<f64>>) {
        if let Some((now, before)) = object.zip(self.followed) {
            self.eye.follow(self.eye.target + (now - before));
        }
        self.followed = object;
    }

    /// What the pointer asks for; whether it asks for anything.
    fn turn(&mut self, ui: &Ui, rect: Rect, response: &egui::Response) -> bool {
        /// Across the view by half a turn.
        const RADIANS: f64 = std::f64::consts::PI;
        let delta = response.drag_delta();
        let (right, down) = (f64::from(delta.x), f64::from(delta.y));
        let is_shift = ui.input(|input| input.modifiers.shift);
        let is_pan = response.dragged_by(PointerButton::Secondary)
            || response.dragged_by(PointerButton::Middle)
            || (is_shift && response.dragged_by(PointerButton::Primary));
        if is_pan {
            self.eye.pan([right, down], rect.height() as usize);
        } else if response.dragged() {
            let radians = RADIANS / f64::from(rect.height().max(1.0));
            self.eye.orbit(-right * radians, down * radians);
        }
        let mut scroll = 0.0;
        if response.hovered() {
            let (wheel, pinch) = ui.input(|input| (input.smooth_scroll_delta().y, input.zoom_delta()));
            scroll = f64::from(wheel);
            self.eye.zoom((-scroll / 300.0).exp() / f64::from(pinch));
        }
        response.dragged() || scroll != 0.0
    }
}
