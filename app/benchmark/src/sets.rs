//! Sequences of a data set, and the meshes of their objects.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use mvt_files::input::is_litter;
use mvt_run::source::RgbdSequence;

/// Folders are searched to this depth below the data set.
const DEPTH: usize = 4;

/// Sequence of a data set.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Member {
    /// Path below the data set with `/`, or the name of the data set if it is a sequence itself.
    pub name: String,
    pub path: PathBuf,
}

/// Returns the sequences below a folder, sorted by name.
pub(crate) fn members(folder: &Path) -> Result<Vec<Member>> {
    if RgbdSequence::is_here(folder) {
        let whole = folder.canonicalize().with_context(|| folder.display().to_string())?;
        let name = whole.file_name().map_or_else(|| "sequence".to_owned(), |name| name.to_string_lossy().into_owned());
        return Ok(vec![Member { name, path: folder.to_owned() }]);
    }
    let mut found = Vec::new();
    search(folder, "", DEPTH, &mut found)?;
    if found.is_empty() {
        bail!("{}: there is no RGB-D sequence below it; docs/rgbd.md describes the layouts", folder.display());
    }
    found.sort();
    Ok(found)
}

fn search(folder: &Path, name: &str, depth: usize, found: &mut Vec<Member>) -> Result<()> {
    for entry in folder.read_dir().with_context(|| folder.display().to_string())? {
        let entry = entry.with_context(|| folder.display().to_string())?;
        let (path, own) = (entry.path(), entry.file_name());
        // A link may lead back to a folder above it; the depth ends that.
        if is_litter(&own) || own.to_string_lossy().starts_with('.') || !path.is_dir() {
            continue;
        }
        let own = own.to_string_lossy();
        let name = if name.is_empty() { own.into_owned() } else { format!("{name}/{own}") };
        if RgbdSequence::is_here(&path) {
            found.push(Member { name, path });
        } else if depth > 1 {
            search(&path, &name, depth - 1, found)?;
        }
    }
    Ok(())
}

/// Places of the mesh of an object in a folder of meshes.
const PLACES: [&str; 8] = [
    "NAME.obj",
    "NAME.ply",
    "NAME.stl",
    "NAME/textured.obj",
    "NAME/textured_simple.obj",
    "NAME/google_16k/textured.obj",
    "NAME/google_16k/nontextured.ply",
    "NAME/google_16k/nontextured.stl",
];

/// Returns the mesh of an object: a file in a folder of meshes, or else the name itself, which the catalogue may know. Meshes of BOP are in millimetres.
pub(crate) fn mesh_of(name: &str, meshes: Option<&Path>, layout: &str) -> Result<String> {
    let Some(folder) = meshes else { return Ok(name.to_owned()) };
    let stem = Path::new(name).file_stem().and_then(|stem| stem.to_str()).unwrap_or(name);
    let files = PLACES.iter().map(|place| folder.join(place.replace("NAME", stem)));
    let Some(found) = files.into_iter().find(|path| path.is_file()) else {
        bail!("--meshes {}: there is neither {stem}.obj nor {stem}/textured.obj", folder.display());
    };
    let unit = if layout == "BOP" { ":mm" } else { "" };
    Ok(format!("{}{unit}", found.display()))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn sequences_are_found_below_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        assert!(members(folder.path()).unwrap_err().to_string().contains("no RGB-D sequence"));
        for name in ["b/rgb", "b/depth", "a/train/rgb", "a/train/depth", ".x/rgb", ".x/depth", "none"] {
            fs::create_dir_all(folder.path().join(name)).unwrap();
        }
        let names = |path: &Path| members(path).unwrap().into_iter().map(|member| member.name).collect::<Vec<_>>();
        assert_eq!(names(folder.path()), ["a/train", "b"]);
        assert_eq!(names(&folder.path().join("b")), ["b"]);
    }

    #[test]
    fn meshes_are_found_by_the_name_of_the_object() {
        let folder = tempfile::tempdir().unwrap();
        let of = |name: &str, layout: &str| mesh_of(name, Some(folder.path()), layout);
        assert!(of("025_mug", "HO3D").unwrap_err().to_string().contains("025_mug/textured.obj"));
        fs::create_dir(folder.path().join("025_mug")).unwrap();
        fs::write(folder.path().join("025_mug/textured.obj"), "").unwrap();
        fs::write(folder.path().join("obj_000005.ply"), "").unwrap();
        assert!(of("025_mug", "HO3D").unwrap().ends_with("025_mug/textured.obj"));
        assert!(of("obj_000005", "BOP").unwrap().ends_with("obj_000005.ply:mm"));
        assert_eq!(mesh_of("025_mug", None, "HO3D").unwrap(), "025_mug");
    }
}
