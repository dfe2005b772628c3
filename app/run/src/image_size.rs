//! Size of an image as an argument.

use std::fmt;
use std::str::FromStr;

/// Width and height of an image, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImageSize {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl FromStr for ImageSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |text: &str| text.parse::<u32>().ok().filter(|side| (1..=2048).contains(side));
        let (width, height) = text.split_once('x').unwrap_or((text, text));
        side(width)
            .zip(side(height))
            .map(|(width, height)| Self { width, height })
            .ok_or_else(|| "give WIDTHxHEIGHT or one side, 1 to 2048 pixels, such as 240x320 or 224".to_owned())
    }
}

impl fmt::Display for ImageSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

impl ImageSize {
    /// Rows and columns.
    pub fn rows_and_columns(self) -> [usize; 2] {
        [self.height as usize, self.width as usize]
    }
}
