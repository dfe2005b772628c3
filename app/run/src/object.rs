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
