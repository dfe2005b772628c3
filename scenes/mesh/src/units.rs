//! Units of mesh files, which no format states.

use std::path::{Path, PathBuf};

/// Units that may stand behind the name of a file, as in `can.obj:cm`, and their lengths in metres.
const UNITS: [(&str, f64); 6] = [("m", 1.0), ("dm", 0.1), ("cm", 0.01), ("mm", 1e-3), ("um", 1e-6), ("in", 0.0254)];

/// Splits the unit off the name of a file. Returns the path, and the length of the unit in metres if one was given.
pub fn split_unit(path: &Path) -> (PathBuf, Option<f64>) {
    let unit = || {
        let (file, unit) = path.to_str()?.rsplit_once(':')?;
        let (_, metres) = UNITS.into_iter().find(|(name, _)| *name == unit)?;
        Some((PathBuf::from(file), Some(metres)))
    };
    unit().unwrap_or_else(|| (path.to_owned(), None))
}
