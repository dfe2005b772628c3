//! All colours: light and dark, and the maps that stand for numbers. All maps read the same for people who see red and green alike.

use image::Rgb;

/// The colours of everything that is not data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Theme {
    /// Behind everything.
    pub paper: Rgb<u8>,
    /// Behind groups of things.
    pub panel: Rgb<u8>,
    /// Text and lines.
    pub ink: Rgb<u8>,
    /// Text and lines that matter less.
    pub faint: Rgb<u8>,
    /// Links of the hand.
    pub link: Rgb<u8>,
    /// Housings of the DIGITs.
    pub digit: Rgb<u8>,
    /// Gels of the DIGITs.
    pub gel: Rgb<u8>,
    /// A surface without data.
    pub surface: Rgb<u8>,
    /// The true surface.
    pub truth: Rgb<u8>,
    /// The estimated trajectory.
    pub estimate: Rgb<u8>,
    /// Where a frame has been kept.
    pub keyframe: Rgb<u8>,
}

impl Theme {
    /// On white paper.
    pub const LIGHT: Self = Self {
        paper: Rgb([250, 250, 248]),
        panel: Rgb([238, 239, 240]),
        ink: Rgb([34, 38, 46]),
        faint: Rgb([138, 144, 152]),
        link: Rgb([112, 118, 126]),
        digit: Rgb([176, 180, 186]),
        gel: Rgb([226, 150, 84]),
        surface: Rgb([214, 216, 214]),
        truth: Rgb([86, 156, 112]),
        estimate: Rgb([40, 98, 178]),
        keyframe: Rgb([204, 121, 167]),
    };
    /// In the dark.
    pub const DARK: Self = Self {
        paper: Rgb([24, 26, 30]),
        panel: Rgb([36, 39, 44]),
        ink: Rgb([226, 228, 232]),
        faint: Rgb([128, 134, 142]),
        link: Rgb([92, 98, 106]),
        digit: Rgb([140, 144, 150]),
        gel: Rgb([216, 140, 74]),
        surface: Rgb([196, 198, 196]),
        truth: Rgb([104, 180, 132]),
        estimate: Rgb([110, 168, 240]),
        keyframe: Rgb([214, 137, 180]),
    };
}

/// Which sensor saw a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SeenBy {
    /// A camera.
    Vision,
    /// A DIGIT.
    Touch,
    /// None: the field has made it up.
    Nothing,
}

impl SeenBy {
    /// Its colour (Okabe and Ito's blue, vermilion and grey).
    pub fn colour(self) -> Rgb<u8> {
        match self {
            Self::Vision => Rgb([86, 180, 233]),
            Self::Touch => Rgb([213, 94, 0]),
            Self::Nothing => Rgb([170, 170, 170]),
        }
    }
}
