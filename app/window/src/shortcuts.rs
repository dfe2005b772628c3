//! Keyboard shortcuts. One table serves the help and the window.

use eframe::egui::{self, Context, Key, Modifiers, Ui};

use mvt_viewer::eye::Preset;
use mvt_viewer::layers::{Clouds, Colouring, Keyframes, Layers};

/// Command of a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum KeyCommand {
    /// A key of the timeline, and whether it makes a large step.
    Time(Key, bool),
    /// Plays slower or faster.
    Speed(i32),
    /// Changes a layer.
    Layer(LayerSwitch),
    /// Looks from a preset direction.
    Look(Preset),
    /// Orbits by steps to the right and up.
    Orbit([i8; 2]),
    /// Moves nearer by steps.
    Near(i8),
    /// Resets the camera.
    Reset,
    /// Starts or stops following the object.
    Follow,
    /// Opens or closes a panel.
    Panel(PanelSwitch),
    /// Writes a picture of the window.
    Screenshot,
    /// Writes the mesh.
    Export,
    /// Light or dark.
    Appearance,
    /// Opens or closes the help.
    Help,
    /// Closes the window.
    Quit,
}

/// Layer of the scene that a key changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LayerSwitch {
    /// The estimated surface.
    Mesh,
    /// The next colouring.
    Colouring,
    /// The true surface.
    Truth,
    /// The hand.
    Hand,
    /// Axes.
    Axes,
    /// The trail.
    Trail,
    /// The cameras.
    Frusta,
    /// The next choice of points.
    Clouds,
    /// The next choice of keyframes.
    Keyframes,
    /// The slice.
    Slice,
    /// The box.
    Bounds,
}

/// Panel that a key opens or closes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PanelSwitch {
    /// Layers of the scene.
    Layers,
    /// Images of the sensors.
    Sensors,
    /// Curves.
    Plots,
}

impl LayerSwitch {
    /// Shows or hides the layer, or selects the next choice.
    pub fn toggle(self, layers: &mut Layers) {
        match self {
            Self::Mesh => layers.mesh ^= true,
            Self::Truth => layers.truth ^= true,
            Self::Hand => layers.hand ^= true,
            Self::Axes => layers.axes ^= true,
            Self::Trail => layers.trail ^= true,
            Self::Frusta => layers.frusta ^= true,
            Self::Slice => layers.slice ^= true,
            Self::Bounds => layers.bounds ^= true,
            Self::Colouring => layers.colouring = after(&Colouring::ALL, layers.colouring),
            Self::Clouds => layers.clouds = after(&Clouds::ALL, layers.clouds),
            Self::Keyframes => layers.keyframes = after(&Keyframes::ALL, layers.keyframes),
        }
    }
}

fn after<T: Copy + PartialEq>(all: &[T], current: T) -> T {
    all.iter().copied().cycle().skip_while(|&other| other != current).nth(1).unwrap_or(current)
}

/// Key with its command.
type Binding = (Modifiers, Key, KeyCommand);

/// Names of keys, their commands, and the help text. Letters are those of NeuralFeels where it has the same function.
const KEYS: [(&str, &[Binding], &str); 31] = {
    use KeyCommand::{
        Appearance, Export, Follow, Help, Layer as Show, Look, Near, Orbit, Panel as Open, Quit, Reset, Screenshot,
        Speed, Time,
    };
    const NONE: Modifiers = Modifiers::NONE;
    const SHIFT: Modifiers = Modifiers::SHIFT;
    const ALT: Modifiers = Modifiers::ALT;
    [
        ("Space", &[(NONE, Key::Space, Time(Key::Space, false))], "play, pause"),
        (
            "Left, Right",
            &[
                (NONE, Key::ArrowLeft, Time(Key::ArrowLeft, false)),
                (NONE, Key::ArrowRight, Time(Key::ArrowRight, false)),
            ],
            "one frame back, on",
        ),
        (
            "Shift + Left, Right",
            &[
                (SHIFT, Key::ArrowLeft, Time(Key::ArrowLeft, true)),
                (SHIFT, Key::ArrowRight, Time(Key::ArrowRight, true)),
            ],
            "30 frames back, on",
        ),
        (
            "Home, End",
            &[(NONE, Key::Home, Time(Key::Home, false)), (NONE, Key::End, Time(Key::End, false))],
            "first, last frame",
        ),
        ("[ ]", &[(NONE, Key::OpenBracket, Speed(-1)), (NONE, Key::CloseBracket, Speed(1))], "slower, faster"),
        ("M", &[(NONE, Key::M, Show(LayerSwitch::Mesh))], "mesh"),
        ("C", &[(NONE, Key::C, Show(LayerSwitch::Colouring))], "next colouring of the mesh"),
        ("G", &[(NONE, Key::G, Show(LayerSwitch::Truth))], "ground truth"),
        ("A", &[(NONE, Key::A, Show(LayerSwitch::Hand))], "Allegro hand"),
        ("O", &[(NONE, Key::O, Show(LayerSwitch::Axes))], "axes of the poses"),
        ("T", &[(NONE, Key::T, Show(LayerSwitch::Trail))], "trail"),
        ("R", &[(NONE, Key::R, Show(LayerSwitch::Frusta))], "cameras (RealSense)"),
        ("P", &[(NONE, Key::P, Show(LayerSwitch::Clouds))], "next choice of points"),
        ("K", &[(NONE, Key::K, Show(LayerSwitch::Keyframes))], "next choice of keyframes"),
        ("V", &[(NONE, Key::V, Show(LayerSwitch::Slice))], "slice through the signed distances"),
        ("B", &[(NONE, Key::B, Show(LayerSwitch::Bounds))], "bounding box"),
        ("1", &[(NONE, Key::Num1, Look(Preset::Oblique))], "look obliquely"),
        (
            "2, 3",
            &[(NONE, Key::Num2, Look(Preset::Front)), (NONE, Key::Num3, Look(Preset::Back))],
            "look from the front, the back",
        ),
        (
            "4, 5",
            &[(NONE, Key::Num4, Look(Preset::Left)), (NONE, Key::Num5, Look(Preset::Right))],
            "look from the left, the right",
        ),
        ("6", &[(NONE, Key::Num6, Look(Preset::Top))], "look from above"),
        (
            "Alt + arrows",
            &[
                (ALT, Key::ArrowLeft, Orbit([-1, 0])),
                (ALT, Key::ArrowRight, Orbit([1, 0])),
                (ALT, Key::ArrowUp, Orbit([0, 1])),
                (ALT, Key::ArrowDown, Orbit([0, -1])),
            ],
            "turn the view",
        ),
        ("PgUp, PgDn", &[(NONE, Key::PageUp, Near(1)), (NONE, Key::PageDown, Near(-1))], "nearer, farther"),
        ("0", &[(NONE, Key::Num0, Reset)], "reset the camera"),
        ("F", &[(NONE, Key::F, Follow)], "follow the object"),
        ("L", &[(NONE, Key::L, Open(PanelSwitch::Layers))], "panel: layers"),
        ("I", &[(NONE, Key::I, Open(PanelSwitch::Sensors))], "panel: sensor images"),
        ("U", &[(NONE, Key::U, Open(PanelSwitch::Plots))], "panel: curves"),
        ("S", &[(NONE, Key::S, Screenshot)], "screenshot of the window"),
        ("E", &[(NONE, Key::E, Export)], "export the mesh"),
        ("D", &[(NONE, Key::D, Appearance)], "dark or light"),
        ("H or F1, Q", &[(NONE, Key::H, Help), (NONE, Key::F1, Help), (NONE, Key::Q, Quit)], "this help, quit"),
    ]
};

/// Returns the commands of the keys that were pressed since the last frame; empty while a text field has the focus.
pub fn pressed(ctx: &Context) -> Vec<KeyCommand> {
    if ctx.text_edit_focused() {
        return Vec::new();
    }
    ctx.input(|input| {
        let all = KEYS.iter().flat_map(|(_, keys, _)| keys.iter());
        let is_pressed =
            |&&(modifiers, key, _): &&Binding| input.modifiers.matches_exact(modifiers) && input.key_pressed(key);
        all.filter(is_pressed).map(|&(_, _, command)| command).collect()
    })
}

/// Returns the steps by which the zoom should grow: Ctrl with plus or minus.
pub fn zoom(ctx: &Context) -> i32 {
    use egui::gui_zoom::kb_shortcuts::{ZOOM_IN, ZOOM_IN_SECONDARY, ZOOM_OUT};
    ctx.input_mut(|input| {
        let is_in = input.consume_shortcut(&ZOOM_IN) || input.consume_shortcut(&ZOOM_IN_SECONDARY);
        i32::from(is_in) - i32::from(input.consume_shortcut(&ZOOM_OUT))
    })
}

/// Shows the table of keys over everything else. Returns whether it stays open.
pub fn help(ctx: &Context) -> bool {
    let modal = egui::Modal::new(egui::Id::unique("help")).show(ctx, |ui| {
        ui.set_max_width(620.0_f32.min(ctx.content_rect().width() - 40.0));
        ui.heading("Keys");
        let height = (ctx.content_rect().height() - 140.0).max(80.0);
        egui::ScrollArea::vertical().max_height(height).show(ui, table);
        ui.add_space(6.0);
        ui.label(
            "In the scene: drag to turn, drag with the right button or Shift to move, scroll to zoom, \
             double-click to look at the object.",
        );
        ui.label("Ctrl with + and - makes text and widgets larger and smaller.");
        ui.button("Close").clicked()
    });
    !(modal.inner || modal.should_close())
}

fn table(ui: &mut Ui) {
    let half = KEYS.len().div_ceil(2);
    ui.horizontal_top(|ui| {
        for (k, keys) in KEYS.chunks(half).enumerate() {
            egui::Grid::new(("keys", k)).num_columns(2).spacing([14.0, 3.0]).show(ui, |ui| {
                for (name, _, meaning) in keys {
                    ui.monospace(*name);
                    ui.label(*meaning);
                    ui.end_row();
                }
            });
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_key_has_two_commands() {
        let all: Vec<_> = KEYS.iter().flat_map(|(_, keys, _)| keys.iter()).collect();
        for (k, (modifiers, key, _)) in all.iter().enumerate() {
            assert!(all.iter().skip(k + 1).all(|other| (other.0, other.1) != (*modifiers, *key)), "{key:?}");
        }
    }

    #[test]
    fn choices_come_round() {
        let mut layers = Layers::default();
        for (layer, choices) in
            [(LayerSwitch::Colouring, Colouring::ALL.len()), (LayerSwitch::Clouds, Clouds::ALL.len())]
        {
            let before = layers;
            let seen: Vec<Layers> = (0..choices)
                .map(|_| {
                    layer.toggle(&mut layers);
                    layers
                })
                .collect();
            assert_eq!(layers, before);
            assert!(seen.iter().take(choices - 1).all(|other| *other != before));
        }
    }
}
