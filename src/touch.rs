//! `touch`: networks that turn touch images into indentation and contact, and images for them.

mod data;
mod describe;
mod evaluate;
mod render;
#[cfg(feature = "train")]
mod train;
#[cfg(not(feature = "train"))]
#[path = "touch/train_missing.rs"]
mod train;

use anyhow::Result;
use clap::Subcommand;
use mvt_sensor::{
    TouchCalibrateArguments, TouchPredictArguments, TouchUnitsArguments, TouchWeighArguments, calibrate, predict,
    units, weigh,
};

use crate::signals::stop_on_signals;

pub use data::{TouchDataArguments, run as data};
pub use describe::{TouchDescribeArguments, architecture, run as describe};
pub use evaluate::{TouchEvaluateArguments, run as evaluate};
pub use render::{TouchRenderArguments, run as render};
pub use train::{TouchTrainArguments, run as train};

/// Train, score and describe touch networks; render touch images
#[derive(Debug, Subcommand)]
pub enum TouchCommand {
    Train(TouchTrainArguments),
    Predict(TouchPredictArguments),
    Calibrate(TouchCalibrateArguments),
    Weigh(TouchWeighArguments),
    Data(TouchDataArguments),
    Evaluate(TouchEvaluateArguments),
    Units(TouchUnitsArguments),
    Render(TouchRenderArguments),
    Describe(TouchDescribeArguments),
}

/// Describe touch networks; the name of version 0.1.0 for `touch describe`
#[derive(Debug, Subcommand)]
pub enum NetworkCommand {
    Describe(TouchDescribeArguments),
}

/// Runs the command.
pub fn run(command: &TouchCommand) -> Result<()> {
    match command {
        TouchCommand::Train(arguments) => train(arguments),
        TouchCommand::Predict(arguments) => predict(arguments, stop_on_signals),
        TouchCommand::Calibrate(arguments) => calibrate(arguments),
        TouchCommand::Weigh(arguments) => weigh(arguments),
        TouchCommand::Data(arguments) => data(arguments),
        TouchCommand::Evaluate(arguments) => evaluate(arguments),
        TouchCommand::Units(arguments) => units(arguments),
        TouchCommand::Render(arguments) => render(arguments),
        TouchCommand::Describe(arguments) => describe(arguments),
    }
}
