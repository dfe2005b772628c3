//! Layers of the scene.

use clap::ValueEnum;
use mvt_recording::Recording;
use serde::{Deserialize, Serialize};

/// Meaning of the colours of the estimated surface.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Colouring {
    /// The object's own colours, as the cameras saw them.
    #[value(name = "true")]
    TrueColour,
    /// Direction of the surface.
    Normals,
    /// Distance from the true surface.
    #[default]
    Error,
    /// Sensor that saw the surface.
    Sensor,
    /// How often the surface was seen.
    Confidence,
}

/// Measured points that are shown.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Clouds {
    /// No points.
    #[default]
    None,
    /// Points of the cameras.
    Vision,
    /// Points of the touch sensors.
    Touch,
    /// All points.
    Both,
}

/// Keyframes that are shown.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Keyframes {
    /// No keyframes.
    #[default]
    None,
    /// The newest few keyframes.
    Latest,
    /// All keyframes so far.
    All,
}

/// Parts of the scene that are shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layers {
    /// The estimated surface.
    pub mesh: bool,
    /// Meaning of its colours.
    pub colouring: Colouring,
    /// The true surface, translucent.
    pub truth: bool,
    /// The hand.
    pub hand: bool,
    /// Axes of the estimated and of the true pose.
    pub axes: bool,
    /// Past positions of the object.
    pub trail: bool,
    /// Fields of view of the cameras.
    pub frusta: bool,
    /// Measured points.
    pub clouds: Clouds,
    /// Keyframes.
    pub keyframes: Keyframes,
    /// A slice through the signed distances, which sweeps through the object with time.
    pub slice: bool,
    /// The bounding box of the estimated surface.
    pub bounds: bool,
}

impl Default for Layers {
    fn default() -> Self {
        Self {
            mesh: true,
            colouring: Colouring::default(),
            truth: false,
            hand: true,
            axes: true,
            trail: true,
            frusta: false,
            clouds: Clouds::None,
            keyframes: Keyframes::None,
            slice: false,
            bounds: false,
        }
    }
}

impl Layers {
    /// Returns the layers as a recording can show them: where the true surface is unknown, the object's own colours take the place of errors.
    pub(crate) fn of(&self, recording: &Recording) -> Self {
        match self.colouring {
            Colouring::Error if recording.true_mesh().is_none() => Self { colouring: Colouring::TrueColour, ..*self },
            _ => *self,
        }
    }

    /// Whether a layer needs the points that were seen so far.
    pub(crate) fn needs_seen_points(&self) -> bool {
        let by_colour = matches!(self.colouring, Colouring::TrueColour | Colouring::Sensor | Colouring::Confidence);
        self.mesh && by_colour || self.clouds != Clouds::None
    }
}

impl Colouring {
    /// All colourings.
    pub const ALL: [Self; 5] = [Self::TrueColour, Self::Normals, Self::Error, Self::Sensor, Self::Confidence];

    /// Returns its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::TrueColour => "true colour",
            Self::Normals => "normals",
            Self::Error => "error",
            Self::Sensor => "sensor that saw it",
            Self::Confidence => "confidence",
        }
    }
}

impl Clouds {
    /// All choices.
    pub const ALL: [Self; 4] = [Self::None, Self::Vision, Self::Touch, Self::Both];

    /// Returns its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Vision => "vision",
            Self::Touch => "touch",
            Self::Both => "both",
        }
    }
}

impl Keyframes {
    /// All choices.
    pub const ALL: [Self; 3] = [Self::None, Self::Latest, Self::All];

    /// Returns its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Latest => "the newest five",
            Self::All => "all",
        }
    }

    /// Returns the number of keyframes that are shown at most.
    pub(crate) fn most(self) -> usize {
        match self {
            Self::None => 0,
            Self::Latest => 5,
            Self::All => usize::MAX,
        }
    }
}
