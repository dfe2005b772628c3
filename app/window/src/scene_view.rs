//! View of the scenes of a page: the camera and the layers. Both belong to the page, so that a layer that is hidden in
//! one recording is not missing in the next.

use super::preferences::{Panels, Preferences};
use super::shortcuts::{KeyCommand, PanelSwitch};
use super::timeline::SPEEDS;
use mvt_viewer::eye::Eye;
use mvt_viewer::layers::{Colouring, Layers};

/// Angle by which a key orbits, radians.
const ORBIT_RAD: f64 = std::f64::consts::PI / 12.0;
/// Factor of the distance for a key.
const NEARER: f64 = 0.9;

/// Camera and layers of the scenes of a page.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneView {
    /// Camera.
    pub eye: Eye,
    /// Camera to which a reset returns.
    pub home: Eye,
    /// Parts of the scene that are shown.
    pub layers: Layers,
}

impl SceneView {
    /// Returns the view of a new page.
    pub fn new(colouring: Colouring) -> Self {
        let eye = Eye::default();
        Self { eye, home: eye, layers: Layers { colouring, ..Layers::default() } }
    }

    /// Resets the camera.
    pub fn reset(&mut self) {
        self.eye = self.home;
    }

    /// Executes the command of a key that changes the view or the preferences; ignores others.
    pub fn command(&mut self, command: KeyCommand, preferences: &mut Preferences) {
        match command {
            KeyCommand::Speed(by) => {
                let current = SPEEDS.iter().position(|&speed| speed == preferences.speed).unwrap_or(3);
                let next = current.saturating_add_signed(by as isize).min(SPEEDS.len() - 1);
                preferences.speed = SPEEDS.get(next).copied().unwrap_or(1.0);
            }
            KeyCommand::Layer(layer) => {
                layer.toggle(&mut self.layers);
                preferences.colouring = self.layers.colouring;
            }
            KeyCommand::Look(preset) => self.eye.look_from(preset),
            KeyCommand::Orbit([right, up]) => {
                self.eye.orbit(f64::from(right) * ORBIT_RAD, f64::from(up) * ORBIT_RAD);
            }
            KeyCommand::Near(steps) => self.eye.zoom(NEARER.powi(steps.into())),
            KeyCommand::Reset => self.reset(),
            KeyCommand::Follow => preferences.follow = !preferences.follow,
            KeyCommand::Panel(panel) => panel.toggle(&mut preferences.panels),
            KeyCommand::Time(..)
            | KeyCommand::Screenshot
            | KeyCommand::Export
            | KeyCommand::Appearance
            | KeyCommand::Help
            | KeyCommand::Quit => {}
        }
    }
}

impl PanelSwitch {
    /// Opens or closes the panel.
    fn toggle(self, panels: &mut Panels) {
        let flag = match self {
            Self::Layers => &mut panels.layers,
            Self::Sensors => &mut panels.sensors,
            Self::Plots => &mut panels.plots,
        };
        *flag = !*flag;
    }
}
