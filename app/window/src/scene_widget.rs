//! The scene in three dimensions: a thread of its own paints it, and the pointer turns it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use eframe::egui::{self, ColorImage, Context, PointerButton, Pos2, Rect, Sense, TextureHandle, TextureOptions, Ui};
use mvt_picture::palette::Theme;
use mvt_recording::Recording;
use nalgebra::Vector3;

use super::latest_worker::{LatestWorker, Work};
use super::legend_overlay;
use super::scene_view::SceneView;
use super::shared_recording::SharedRecording;
use super::style;
use mvt_viewer::eye::{Eye, Preset};
use mvt_viewer::layers::Layers;
use mvt_viewer::paint::ScenePainter;

/// Least time between two checks whether the recording has grown.
const POLL: Duration = Duration::from_millis(150);
/// The viewer waits this many times the painting time of a picture before it checks again, so that it takes little time
/// from the run.
const SHARE: u32 = 20;
/// While the view moves, pictures that take longer are painted at half the resolution.
const SLOW: Duration = Duration::from_millis(33);

/// Request for a picture.
#[derive(Debug, Clone, PartialEq)]
struct SceneRequest {
    moment: usize,
    /// Later revisions of the recording may have another shape for the same moment.
    revision: u64,
    layers: Layers,
    eye: Eye,
    theme: Theme,
    size: [usize; 2],
    /// Without jagged edges and with ambient occlusion.
    is_fine: bool,
}

/// Picture with the time that it took.
struct Painted {
    image: ColorImage,
    is_fine: bool,
    spent: Duration,
    warning: Option<String>,
}

struct Painter {
    shared: Arc<SharedRecording>,
    scene: ScenePainter,
    looked: Instant,
    /// Time that the last picture took.
    spent: Duration,
}

impl Work for Painter {
    type Request = SceneRequest;
    type Output = Painted;

    fn run(&mut self, request: SceneRequest) -> Painted {
        let begun = Instant::now();
        // A thread that always paints is never idle.
        self.idle();
        let recording = self.shared.read();
        let SceneRequest { moment, layers, eye, theme, size, is_fine, .. } = &request;
        let image = if *is_fine {
            ColorImage::from_rgb(*size, &self.scene.paint_fine(&recording, *moment, layers, eye, theme, *size))
        } else {
            ColorImage::from_rgb(*size, self.scene.paint(&recording, *moment, layers, eye, theme, *size))
        };
        self.spent = begun.elapsed();
        tracing::trace!("moment {} at {:?} painted in {:?}", request.moment, request.size, self.spent);
        Painted { image, is_fine: request.is_fine, spent: self.spent, warning: self.scene.warning().map(str::to_owned) }
    }

    /// Checks from time to time whether the recording has grown, and wakes the window if it has.
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

/// Widget of the scene.
pub struct SceneWidget {
    worker: LatestWorker<Painter>,
    texture: Option<TextureHandle>,
    spent: Duration,
    /// Whether the shown picture is a fine one.
    #[cfg(test)]
    is_fine: bool,
    /// The content of the last frame of the window.
    last: Option<SceneRequest>,
    /// Problem of the last picture.
    warning: Option<String>,
    /// Position of the object when it was last followed, metres.
    followed: Option<Vector3<f64>>,
}

impl SceneWidget {
    /// Returns a widget for a recording. Its thread also checks whether the recording has grown.
    pub fn new(ctx: &Context, shared: Arc<SharedRecording>) -> Self {
        let worker = LatestWorker::new(ctx.clone(), || Painter {
            shared,
            scene: ScenePainter::new(),
            looked: Instant::now(),
            spent: Duration::ZERO,
        });
        Self {
            worker,
            texture: None,
            spent: Duration::ZERO,
            #[cfg(test)]
            is_fine: false,
            last: None,
            warning: None,
            followed: None,
        }
    }

    /// Whether a picture is being painted, or the fine one is still to come.
    #[cfg(test)]
    pub fn is_busy(&self) -> bool {
        self.worker.is_busy() || !self.is_fine
    }

    /// Draws the scene into the rest of `ui`. The pointer turns the camera of `view`.
    pub fn ui(&mut self, ui: &mut Ui, recording: &Recording, moment: usize, view: &mut SceneView, follow: bool) {
        let size = ui.available_size().max(egui::vec2(16.0, 16.0));
        let (rect, response) = ui.allocate_exact_size(size, Sense::click_and_drag());
        let object = recording.pose(moment).map(|pose| pose.untyped().translation.vector);
        let has_hand = !recording.about().hand.is_none();
        if !has_hand && self.followed.is_none() && object.is_some() {
            view.home = Eye::of(recording, Preset::Oblique).at(recording, moment);
            view.reset();
        }
        self.follow(&mut view.eye, object.filter(|_| follow || !has_hand));
        if response.double_clicked()
            && let Some(object) = object
        {
            view.eye.follow(object);
        }
        let is_moving = turn(&mut view.eye, ui, rect, &response);
        let scale = if is_moving && self.spent > SLOW { 0.5 } else { 1.0 };
        let pixels = |points: f32| ((points * ui.pixels_per_point() * scale) as usize).clamp(16, 4096);
        let mut request = SceneRequest {
            moment,
            revision: recording.revision(),
            layers: view.layers,
            eye: view.eye,
            theme: style::theme(ui.ctx()),
            size: [pixels(rect.width()), pixels(rect.height())],
            is_fine: false,
        };
        // A picture that stays is painted again, finely. The first one is shown at once.
        let is_still = !is_moving && self.texture.is_some() && self.last.as_ref() == Some(&request);
        self.last = Some(request.clone());
        request.is_fine = is_still;
        self.worker.request(request);
        if let Some(painted) = self.worker.take() {
            self.warning = painted.warning;
            #[cfg(test)]
            {
                self.is_fine = painted.is_fine;
            }
            // A mean over full pictures without the first, which prepares the meshes: one slow picture does not make
            // all others coarse.
            if self.texture.is_some() && scale == 1.0 && !painted.is_fine {
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
        legend_overlay::paint(ui, rect, recording, &view.layers, &view.eye);
        if let Some(warning) = &self.warning {
            let colour = style::colour(style::theme(ui.ctx()).lost);
            let font = egui::TextStyle::Body.resolve(ui.style());
            let words = ui.painter().layout(warning.clone(), font, colour, rect.width() - 16.0);
            ui.painter().galley(rect.left_top() + egui::vec2(8.0, 8.0), words, colour);
        }
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, "The scene in three dimensions"));
    }

    /// Moves the camera with the object.
    fn follow(&mut self, eye: &mut Eye, object: Option<Vector3<f64>>) {
        if let Some((now, before)) = object.zip(self.followed) {
            eye.follow(eye.target + (now - before));
        }
        self.followed = object;
    }
}

/// Applies the pointer to the camera; returns whether the camera moves.
fn turn(eye: &mut Eye, ui: &Ui, rect: Rect, response: &egui::Response) -> bool {
    /// Points of the wheel that change the distance by a factor of e. A click is 40 to 60, so that five
    /// clicks bring the eye nearer by a third.
    const ZOOM_POINTS: f64 = 700.0;
    /// A drag across the height of the view is half a turn.
    const RADIANS: f64 = std::f64::consts::PI;
    let delta = response.drag_delta();
    let (right, down) = (f64::from(delta.x), f64::from(delta.y));
    let is_shift = ui.input(|input| input.modifiers.shift);
    let is_pan = response.dragged_by(PointerButton::Secondary)
        || response.dragged_by(PointerButton::Middle)
        || (is_shift && response.dragged_by(PointerButton::Primary));
    if is_pan {
        eye.pan([right, down], rect.height() as usize);
    } else if response.dragged() {
        let radians = RADIANS / f64::from(rect.height().max(1.0));
        eye.orbit(-right * radians, down * radians);
    }
    let mut scroll = 0.0;
    if response.hovered() {
        let (wheel, pinch) = ui.input(|input| (input.smooth_scroll_delta().y, input.zoom_delta()));
        scroll = f64::from(wheel);
        eye.zoom((-scroll / ZOOM_POINTS).exp() / f64::from(pinch));
    }
    response.dragged() || scroll != 0.0
}
