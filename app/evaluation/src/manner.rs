//! Object, hand and controller: arguments that several commands share.

use anyhow::Result;
use clap::Args;
use mvt_gaits::controller_file::ChosenController;
use mvt_hands::{LoadedHand, load_rig};
use mvt_objects::object::Object;
use mvt_robot::hand::ALLEGRO_DIGIT;
use mvt_run::arguments::HandSide;
use mvt_run::controller::choose_controller;
use mvt_run::object::load_object;

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
    /// Motion of the fingers: a name that `controllers` lists, the path of a controller file (.toml) or of a learnt policy
    /// (.onnx, .safetensors; see docs/policies.md), or `suited` or `auto` to choose by the object's shape; they refuse an object
    /// that may fall. `auto` plays shapes that are not in the catalogue with the learnt policy `corrected`, which corrects the
    /// suited motion. `tumble_back:8,cubelet:8` plays one for 8 s, then the other, then the first again: the hand opens, the palm is
    /// levelled and tilted anew, and the hand closes
    #[arg(long, alias = "gait", value_name = "NAME|FILE", default_value = "auto")]
    pub controller: String,
    /// Hand with its touch sensors: a name that `rigs` lists, or the path of a hand file (.toml), see docs/rigs.md
    #[arg(long, value_name = "NAME|FILE", default_value = ALLEGRO_DIGIT)]
    pub rig: String,
    /// Side of the hand allegro_digit; FeelSight and its loaders assume the left one [default: left, or that of the hand file]
    #[arg(long, value_enum)]
    pub side: Option<HandSide>,
}

impl Subject {
    /// Loads the object, shows the warnings about it and chooses the controller of a rig.
    pub fn load(&self, rig: &LoadedHand) -> Result<(Object, ChosenController)> {
        let object = load_object(&self.object)?;
        let controller = choose_controller(&self.manner.controller, &object, &rig.hand)?;
        Ok((object, controller))
    }
}

impl Manner {
    /// Loads the rig and shows the warnings about it.
    pub fn rig(&self) -> Result<LoadedHand> {
        Ok(load_rig(&self.rig, self.side.map(HandSide::side))?)
    }
}
