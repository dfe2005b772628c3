//! Objects by name, with their warnings shown.

use anyhow::Result;
use mvt_objects::{Object, catalogue};

/// Loads an object and shows the warnings about its mesh.
pub fn load_object(name: &str) -> Result<Object> {
    let mut warnings = Vec::new();
    let object = catalogue::load(name, &mut warnings);
    for warning in warnings {
        tracing::warn!("{warning}");
    }
    Ok(object?)
}

/// The object of a run that names none.
const OBJECT: &str = "077_rubiks_cube";
/// A similar object that needs no download.
const OFFLINE_OBJECT: &str = "rubiks_cube_small";

/// Loads the Rubik's cube, or a procedural cube with a warning if its mesh cannot be downloaded. Returns its name, too.
///
/// # Errors
/// If neither can be loaded.
pub fn default_object() -> Result<(String, Object)> {
    match load_object(OBJECT) {
        Ok(object) => Ok((OBJECT.to_owned(), object)),
        Err(error) => {
            tracing::warn!("{error:#}");
            tracing::warn!("the procedural object {OFFLINE_OBJECT} replaces {OBJECT}");
            Ok((OFFLINE_OBJECT.to_owned(), load_object(OFFLINE_OBJECT)?))
        }
    }
}
