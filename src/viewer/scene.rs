//! The scene in three dimensions, painted.

use image::RgbImage;

use super::{Eye, Theme};
use crate::recording::Recording;

/// What the colours of the estimated surface stand for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Colouring {
    /// The object's own colours, as cameras saw them.
    TrueColour,
    /// Which way it faces.
    Normals,
    /// How far it is from the true surface.
    #[default]
    Error,
    /// Which sensor saw it.
    Sensor,
    /// How often it was seen.
    Confidence,
}

/// Which measured points are shown.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Clouds {
    /// None.
    #[default]
    None,
    /// The cameras'.
    Vision,
    /// The DIGITs'.
    Touch,
    /// All.
    Both,
}

/// Which keyframes are shown.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Keyframes {
    /// None.
    #[default]
    None,
    /// The newest.
    Latest,
    /// All so far.
    All,
}

/// What is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layers {
    /// The estimated surface.
    pub mesh: bool,
    /// Its colours.
    pub colouring: Colouring,
    /// The true surface, translucent.
    pub truth: bool,
    /// The hand.
    pub hand: bool,
    /// Axes of the estimated and of the true pose.
    pub axes: bool,
    /// Where the object has been.
    pub trail: bool,
    /// What the cameras see.
    pub frusta: bool,
    /// Measured points.
    pub clouds: Clouds,
    /// Keyframes.
    pub keyframes: Keyframes,
    /// A slice through the signed distances.
    pub slice: bool,
    /// The box around the estimated surface.
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

/// Paints scenes and keeps what takes time to make.
#[derive(Default)]
pub struct Scene {
    image: RgbImage,
}

impl Scene {
    /// Knows nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Paints a moment of a recording. A recording without moments gives an empty picture.
    pub fn paint(
        &mut self,
        _recording: &Recording,
        _moment: usize,
        _layers: &Layers,
        _eye: &Eye,
        theme: &Theme,
        [width, height]: [usize; 2],
    ) -> &RgbImage {
        self.image = RgbImage::from_pixel(width as u32, height as u32, theme.paper);
        &self.image
    }
}
