//! Objects by name: the 78 of YCB, and the procedural and random ones, which need no download. Also loads the user's
//! mesh files by path.

use std::fmt;
use std::path::{Path, PathBuf};

use mvt_frames::{Isometry, MeshFile, Object as ObjectFrame};
use mvt_mesh::{Finding, Format, Mesh, MeshError, MeshWarning};
use mvt_pinned::DownloadProgress;

use crate::assets::{AssetsError, Library, PinnedMesh, YCB};
use crate::decompose::{self, NoHull};
use crate::object::Object;
use crate::procedural;
use crate::procedural::random::{InvalidSeed, RandomObject};
use crate::stand::stand;

mod ycb;

pub use ycb::MassSource;
use ycb::Ycb;

#[derive(Debug, Clone, Copy)]
enum Source {
    Ycb(Ycb),
    Procedural(procedural::Recipe),
}

/// Object of the catalogue.
#[derive(Debug, Clone, Copy)]
pub struct Entry {
    /// Name.
    pub name: &'static str,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Source of the mass.
    pub mass_source: MassSource,
    source: Source,
}

impl Entry {
    /// Returns whether this crate makes the shape, so that the object needs no download.
    pub fn is_procedural(&self) -> bool {
        matches!(self.source, Source::Procedural(_))
    }

    /// Makes or reads the object. Fetches the YCB meshes if they are missing.
    ///
    /// # Errors
    /// [`CatalogueError`] if the mesh cannot be fetched or read.
    pub fn load(&self, warnings: &mut Vec<CatalogueWarning>) -> Result<Object, CatalogueError> {
        match self.source {
            Source::Procedural(recipe) => {
                procedural::build(self.name, self.mass_kg, recipe).map_err(no_hull(self.name))
            }
            Source::Ycb(ycb) => {
                let bytes = ycb.file()?;
                if ycb.mass_source == MassSource::Placeholder {
                    warnings.push(CatalogueWarning::PlaceholderMass { name: ycb.name, mass_kg: ycb.mass_kg });
                }
                ycb.object(&bytes, warnings)
            }
        }
    }

    /// Makes or reads only the mesh. Saves the decomposition into convex pieces, which takes most of the time of
    /// [`Self::load`].
    ///
    /// # Errors
    /// [`CatalogueError`] if the mesh cannot be fetched or read.
    pub fn mesh(&self, warnings: &mut Vec<CatalogueWarning>) -> Result<Mesh, CatalogueError> {
        match self.source {
            Source::Procedural(recipe) => Ok(recipe().mesh),
            Source::Ycb(ycb) => Ok(ycb.mesh(&ycb.file()?, warnings)?.0),
        }
    }

    /// Returns only the mesh, upright and not repaired, for pictures; `None` if the mesh would need a download.
    pub fn mesh_without_download(&self) -> Option<Mesh> {
        match self.source {
            Source::Procedural(recipe) => Some(recipe().mesh),
            Source::Ycb(ycb) => {
                let bytes = ycb_library().ok()?.read(ycb.name).ok()?;
                let (raw, _) = mvt_mesh::read_bytes(&bytes, Format::Stl, self.name).ok()?;
                Some(stand(&raw, ycb.up).0)
            }
        }
    }
}

impl Ycb {
    /// Reads the mesh file. Fetches the library if the file is missing.
    fn file(&self) -> Result<Vec<u8>, CatalogueError> {
        let library = ycb_library()?;
        match library.read(self.name) {
            Err(AssetsError::Missing { .. }) => {
                library.fetch(&YCB, DownloadProgress::Shown, &mut |_, _| {})?;
                Ok(library.read(self.name)?)
            }
            other => Ok(other?),
        }
    }

    /// Reads, repairs and stands the mesh. Warns only about visible repairs: two of the pinned files lose a part, while
    /// the few collapsed slivers in 20 of them are not reported.
    fn mesh(
        &self,
        stl: &[u8],
        warnings: &mut Vec<CatalogueWarning>,
    ) -> Result<(Mesh, Isometry<MeshFile, ObjectFrame>), CatalogueError> {
        let (raw, _) = mvt_mesh::read_bytes(stl, Format::Stl, self.name)?;
        let (clean, found) = mvt_mesh::repair(&raw, self.name)?;
        let visible = |finding| matches!(finding, Finding::Components { area_share, .. } if area_share > 1e-3);
        warnings.extend(found.into_iter().filter(|warning| visible(warning.finding)).map(CatalogueWarning::Mesh));
        Ok(stand(&clean, self.up))
    }

    fn object(&self, stl: &[u8], warnings: &mut Vec<CatalogueWarning>) -> Result<Object, CatalogueError> {
        let (mesh, object_from_file) = self.mesh(stl, warnings)?;
        let collision = decompose::pieces(&mesh).map_err(no_hull(self.name))?;
        Ok(Object { name: self.name.to_owned(), mesh, exact: None, object_from_file, collision, mass_kg: self.mass_kg })
    }
}

/// Returns every object: first YCB, then the procedural ones, each group sorted by name.
pub fn entries() -> impl Iterator<Item = Entry> {
    let ycb = ycb::OBJECTS.iter().map(|&ycb| Entry {
        name: ycb.name,
        mass_kg: ycb.mass_kg,
        mass_source: ycb.mass_source,
        source: Source::Ycb(ycb),
    });
    let made = procedural::RECIPES.iter().map(|&(name, mass_kg, recipe)| Entry {
        name,
        mass_kg,
        mass_source: MassSource::Chosen,
        source: Source::Procedural(recipe),
    });
    ycb.chain(made)
}

/// Returns the mesh files of YCB.
pub fn ycb_files() -> impl Iterator<Item = PinnedMesh> {
    ycb::OBJECTS.iter().map(|ycb| PinnedMesh { name: ycb.name, sha256: ycb.sha256 })
}

/// Returns the library of the YCB meshes: the folder that [`FOLDER_VAR`](crate::assets::FOLDER_VAR) names, else the
/// cache. Reads no file.
///
/// # Errors
/// If there is no cache folder.
pub fn ycb_library() -> Result<Library, AssetsError> {
    Library::in_cache("ycb", ycb_files().collect())
}

/// Name that is not in the catalogue.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "unknown object \"{name}\"; choose a name (the nearest are {}), random:SEED, or a path to an .obj, .stl or .ply file",
    nearest.join(", ")
)]
pub struct UnknownObject {
    /// The unknown name.
    pub name: String,
    /// The most similar names, best first.
    pub nearest: Vec<&'static str>,
}

/// Finds an object by its name.
///
/// # Errors
/// [`UnknownObject`] with the nearest names.
pub fn find(name: &str) -> Result<Entry, UnknownObject> {
    entries().find(|entry| entry.name == name).ok_or_else(|| {
        let wanted = name.to_lowercase();
        let mut scored: Vec<(f64, &str)> = entries().map(|entry| (likeness(&wanted, entry.name), entry.name)).collect();
        scored.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(b.1)));
        UnknownObject { name: name.to_owned(), nearest: scored.into_iter().take(3).map(|(_, name)| name).collect() }
    })
}

/// Returns the similarity of two names. Users leave out the number, so it also compares the name without its number,
/// and a part of a name counts nearly as much as the whole.
fn likeness(wanted: &str, name: &str) -> f64 {
    let short = name.trim_start_matches(|c: char| c.is_ascii_digit() || c == '_');
    let contains = if !wanted.is_empty() && name.contains(wanted) { 0.95 } else { 0.0 };
    strsim::jaro_winkler(wanted, name).max(strsim::jaro_winkler(wanted, short)).max(contains)
}

/// Warning about a loaded object.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum CatalogueWarning {
    /// A mesh was repaired, or has a fault.
    Mesh(MeshWarning),
    /// The mass is a placeholder.
    PlaceholderMass {
        /// Name of the object.
        name: &'static str,
        /// Mass, kg.
        mass_kg: f64,
    },
    /// [`estimated_mass_kg`] gave the mass of a user's mesh.
    EstimatedMass {
        /// Path of the mesh file.
        file: String,
        /// Mass, kg.
        mass_kg: f64,
    },
}

impl fmt::Display for CatalogueWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Mesh(warning) => warning.fmt(f),
            Self::PlaceholderMass { name, mass_kg } => {
                write!(f, "{name}: no mass is published; using {:.0} g", mass_kg * 1e3)
            }
            Self::EstimatedMass { file, mass_kg } => {
                write!(f, "{file}: a mesh has no mass; using {:.0} g, from 0.5 g/cm^3 of its hull", mass_kg * 1e3)
            }
        }
    }
}

/// Reason why an object cannot be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CatalogueError {
    /// The name is unknown.
    #[error(transparent)]
    Unknown(#[from] UnknownObject),
    /// The seed of a random object is invalid.
    #[error(transparent)]
    Seed(#[from] InvalidSeed),
    /// The YCB meshes are missing and cannot be fetched, or are damaged.
    #[error(transparent)]
    Assets(#[from] AssetsError),
    /// The mesh is unusable.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The path is that of a folder.
    #[error("{0} is a folder; give the path of an .obj, .stl or .ply file in it")]
    Folder(String),
    /// The mesh has no convex hull.
    #[error("{object}: {reason}")]
    Hull {
        /// The object's name or path.
        object: String,
        /// The defect.
        reason: NoHull,
    },
}

fn no_hull(object: &str) -> impl FnOnce(NoHull) -> CatalogueError {
    |reason| CatalogueError::Hull { object: object.to_owned(), reason }
}

/// Returns the file that a text names; `None` if it is not a path but a name of the catalogue. A path contains a separator or has the
/// ending of a mesh file. Behind it may stand the unit, which does not belong to the file: `can.obj:cm`.
pub fn mesh_path(name_or_path: &str) -> Option<PathBuf> {
    let path = Path::new(name_or_path);
    let is_path = Format::from_path(path).is_some() || name_or_path.contains(std::path::is_separator);
    is_path.then(|| mvt_mesh::split_unit(path).0)
}

/// Checks that a name, which is not a path, is that of an object. Loads nothing.
///
/// # Errors
/// [`CatalogueError::Unknown`] or [`CatalogueError::Seed`].
pub fn check(name: &str) -> Result<(), CatalogueError> {
    match RandomObject::from_name(name) {
        Some(random) => random.map(drop).map_err(CatalogueError::from),
        None => find(name).map(drop).map_err(CatalogueError::from),
    }
}

/// Loads only the mesh of an object by its name. Saves the decomposition into convex pieces, which takes most of the
/// time of [`load`].
///
/// # Errors
/// [`CatalogueError`], which names the object.
pub fn load_mesh(name: &str, warnings: &mut Vec<CatalogueWarning>) -> Result<Mesh, CatalogueError> {
    match RandomObject::from_name(name) {
        Some(random) => Ok(random?.mesh()),
        None => find(name)?.mesh(warnings),
    }
}

/// Loads an object by its name: that of the catalogue, or `random:SEED`; or a mesh file by its path (see [`mesh_path`]).
/// Fetches the YCB meshes on first use. The z axis of a user's mesh file points up.
///
/// # Errors
/// [`CatalogueError`], which names the object or file.
pub fn load(name_or_path: &str, warnings: &mut Vec<CatalogueWarning>) -> Result<Object, CatalogueError> {
    if Path::new(name_or_path).is_dir() && entries().all(|entry| entry.name != name_or_path) {
        return Err(CatalogueError::Folder(name_or_path.to_owned()));
    }
    if mesh_path(name_or_path).is_some() {
        load_file(Path::new(name_or_path), warnings)
    } else if let Some(random) = RandomObject::from_name(name_or_path) {
        random?.load().map_err(no_hull(name_or_path))
    } else {
        find(name_or_path)?.load(warnings)
    }
}

fn load_file(path: &Path, warnings: &mut Vec<CatalogueWarning>) -> Result<Object, CatalogueError> {
    let file = path.display().to_string();
    let (raw, found) = mvt_mesh::read(path)?;
    warnings.extend(found.into_iter().map(CatalogueWarning::Mesh));
    let (clean, found) = mvt_mesh::repair(&raw, &file)?;
    warnings.extend(found.into_iter().map(CatalogueWarning::Mesh));
    let (mesh, object_from_file) = stand(&clean, [0.0, 0.0, 1.0]);
    let collision = decompose::pieces(&mesh).map_err(no_hull(&file))?;
    let mass_kg = estimated_mass_kg(decompose::hull_volume_m3(&mesh).map_err(no_hull(&file))?);
    warnings.push(CatalogueWarning::EstimatedMass { file, mass_kg });
    let name = path.file_stem().map_or_else(|| "object".into(), |stem| plain_name(&stem.to_string_lossy()));
    Ok(Object { name, mesh, exact: None, object_from_file, collision, mass_kg })
}

/// Returns a name that can be that of a folder on every system: other characters than ASCII letters, digits, `-`, `_` and `.` become `_`.
fn plain_name(stem: &str) -> String {
    const LONGEST: usize = 100;
    let plain = |c: char| if c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.') { c } else { '_' };
    let name: String = stem.chars().take(LONGEST).map(plain).collect();
    if name.starts_with('.') || name.is_empty() { format!("_{}", name.trim_start_matches('.')) } else { name }
}

/// Estimates the mass of a user's mesh, kg: half the density of water in its hull, which is typical of YCB, limited to
/// 20 g to 500 g, which the hand can turn.
pub fn estimated_mass_kg(hull_volume_m3: f64) -> f64 {
    (500.0 * hull_volume_m3).clamp(0.02, 0.5)
}
