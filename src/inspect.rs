//! `inspect`: validates a log and sums it up.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Result;
use clap::Args;
use scenes::mesh::MeshDistance;
use scenes::object::SignedDistance;
use sim::feelsight::{self, Log};

use crate::simulate::print_line;
use crate::subject::load_object;

/// Check a FeelSight log and print a summary
///
/// Reads every file: counts, sizes, levels, poses, times and checksums must agree, and forward kinematics must give the
/// recorded poses of the DIGIT cameras. Where the object is known, pixels in contact are held against its surface. A bad log
/// gives exit code 1 and the reason.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folder of the log: the one that holds data.pkl
    log: PathBuf,
    /// Print one JSON object instead of words
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let summary = match known_surface(&arguments.log)? {
        Some(surface) => feelsight::inspect_against(&arguments.log, &|p| surface.distance_m(p))?,
        None => feelsight::inspect(&arguments.log)?,
    };
    if arguments.json { print_line(&serde_json::to_string(&summary)?) } else { print_line(&summary.to_string()) }
}

/// The surface of the object in a log of ours, where it can be had.
fn known_surface(folder: &Path) -> Result<Option<Arc<dyn SignedDistance>>> {
    let log = Log::open(folder)?;
    let Some(scene) = log.scene() else { return Ok(None) };
    match load_object(&scene.object.mesh) {
        Ok(object) => {
            let of_mesh =
                || MeshDistance::new(&object.mesh).map(|surface| Arc::new(surface) as Arc<dyn SignedDistance>);
            Ok(object.exact.clone().or_else(of_mesh))
        }
        Err(error) => {
            tracing::warn!("contact is not held against the object: {error:#}");
            Ok(None)
        }
    }
}
