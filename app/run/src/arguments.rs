//! Object, hand and gait: arguments that several commands share.

use crate::object::load_object;
use anyhow::Result;
use clap::{Args, ValueEnum};
use mvt_gaits::gait;
use mvt_gaits::gait::Gait;
use mvt_objects::object::Object;
use mvt_robot::hand::Side;

/// Object, hand and gait.
#[derive(Debug, Clone, Args)]
pub struct Subject {
    /// Object: a name that `assets list` shows, random:SEED for a shape that the number decides, or the path of a mesh in
    /// metres (OBJ, STL or PLY)
    #[arg(long)]
    pub object: String,
    /// Hand and gait.
    #[command(flatten)]
    pub manner: Manner,
}

/// Hand and gait.
#[derive(Debug, Clone, Args)]
pub struct Manner {
    /// Motion of the fingers: the name of a gait, or `auto` to choose one by the object's shape
    #[arg(long, default_value = "auto")]
    pub gait: String,
    /// Hand; FeelSight and its loaders assume the left one
    #[arg(long, value_enum, default_value_t = Hand::Left)]
    pub side: Hand,
}

/// Hand on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Hand {
    /// Left hand, as in FeelSight
    Left,
    /// Right hand, the mirror image
    Right,
}

impl Hand {
    /// Returns its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Hand::Left => "left",
            Hand::Right => "right",
        }
    }
}

impl Subject {
    /// Loads the object, shows the warnings about its mesh and chooses the gait.
    pub fn load(&self) -> Result<(Object, &'static str, &'static Gait)> {
        let object = load_object(&self.object)?;
        let (name, gait) = gait::choose(&self.manner.gait, &object)?;
        Ok((object, name, gait))
    }

    /// Returns the hand.
    pub fn side(&self) -> Side {
        self.manner.side()
    }
}

impl Manner {
    /// Returns the hand.
    pub fn side(&self) -> Side {
        match self.side {
            Hand::Left => Side::Left,
            Hand::Right => Side::Right,
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
