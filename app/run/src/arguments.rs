//! Arguments that several commands share.

use clap::ValueEnum;
use mvt_robot::hand::Side;

/// Side of the hand on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum HandSide {
    /// Left hand, as in FeelSight
    Left,
    /// Right hand, the mirror image
    Right,
}

impl HandSide {
    /// Returns the side.
    pub fn side(self) -> Side {
        match self {
            HandSide::Left => Side::Left,
            HandSide::Right => Side::Right,
        }
    }

    /// Returns its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            HandSide::Left => "left",
            HandSide::Right => "right",
        }
    }
}

/// Parses a duration in seconds, at most an hour: the snapshots of an hour fit into memory, those of a day do not.
pub fn duration(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 3600.0 => Ok(value),
        _ => Err("give a number of seconds greater than 0 and at most 3600".to_owned()),
    }
}
