//! Object, hand and controller: arguments that several commands share.

use crate::object::load_object;
use anyhow::{Result, bail};
use clap::{Args, ValueEnum};
use mvt_gaits::controller_file::{self, ChosenController};
use mvt_objects::object::Object;
use mvt_robot::hand::Side;

/// Object, hand and controller.
#[derive(Debug, Clone, Args)]
pub struct Subject {
    /// Object: a name that `assets list` shows, random:SEED for a shape that the number decides, or the path of a mesh (OBJ,
    /// STL or PLY) in metres; another unit stands behind the path, as in can.obj:cm
    #[arg(long)]
    pub object: String,
    /// Hand and controller.
    #[command(flatten)]
    pub manner: Manner,
}

/// Hand and controller.
#[derive(Debug, Clone, Args)]
pub struct Manner {
    /// Motion of the fingers: a name that `controllers` lists, the path of a controller file, or `auto` to choose by the
    /// object's shape; it refuses an object that may fall. `tumble_back:8,cubelet:8` plays one for 8 s, then the other, then
    /// the first again: the hand opens, the palm is levelled and tilted anew, and the hand closes
    #[arg(long, alias = "gait", value_name = "NAME|FILE", default_value = "auto")]
    pub controller: String,
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
    /// Returns the hand.
    pub fn side(self) -> Side {
        match self {
            Hand::Left => Side::Left,
            Hand::Right => Side::Right,
        }
    }

    /// Returns its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Hand::Left => "left",
            Hand::Right => "right",
        }
    }
}

impl Subject {
    /// Loads the object, shows the warnings about it and chooses the controller.
    pub fn load(&self) -> Result<(Object, ChosenController)> {
        let object = load_object(&self.object)?;
        let controller = self.manner.choose(&object)?;
        Ok((object, controller))
    }

    /// Returns the hand.
    pub fn side(&self) -> Side {
        self.manner.side()
    }
}

impl Manner {
    /// Chooses the controller for an object, and warns if the object does not have the size for which it was tuned.
    ///
    /// # Errors
    /// If there is no such controller, or the choice is left to `auto` and the object may fall.
    pub fn choose(&self, object: &Object) -> Result<ChosenController> {
        let chosen = controller_file::choose_all(&self.controller, object, self.side())?;
        match &chosen.misfit {
            Some(misfit) if chosen.falls => {
                bail!("{misfit}; to try it all the same, name a controller, such as --controller shared")
            }
            Some(misfit) => tracing::warn!("{misfit}"),
            None => (),
        }
        Ok(chosen)
    }

    /// Returns the hand.
    pub fn side(&self) -> Side {
        self.side.side()
    }
}

/// Parses a duration in seconds, at most an hour: the snapshots of an hour fit into memory, those of a day do not.
pub fn duration(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 3600.0 => Ok(value),
        _ => Err("give a number of seconds greater than 0 and at most 3600".to_owned()),
    }
}
