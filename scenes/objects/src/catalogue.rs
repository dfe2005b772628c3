//! The objects by name: the 78 of YCB, the procedural ones that need no download, and any mesh of the user's by path.

use std::fmt;
use std::path::Path;

use crate::assets::{self, Library, Pinned};
use crate::decompose::{self, NoHull};
use crate::object::Object;
use crate::procedural;
use crate::stand::stand;
use mvt_mesh::{Finding, Format, Mesh, MeshError};

mod ycb;

/// How well the mass of an object is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MassSource {
    /// Table I of the YCB paper (Calli et al. 2015).
    Paper,
    /// From secondary sources, not checked against a measurement.
    Unconfirmed,
    /// Nobody published one: 20 g stand in.
    Placeholder,
    /// Chosen for a procedural object.
    Chosen,
}

/// A YCB object: see [`ycb`].
#[derive(Debug, Clone, Copy)]
struct Ycb {
    name: &'static str,
    mass_kg: f64,
    mass_source: MassSource,
    /// Which direction of the file points up as the object stands on the palm.
    up: [f64; 3],
    sha256: &'static str,
}

#[derive(Debug, Clone, Copy)]
enum Source {
    Ycb(Ycb),
    Procedural(procedural::Recipe),
}

/// An object of the catalogue.
#[derive(Debug, Clone, Copy)]
pub struct Entry {
    /// Its name.
    pub name: &'static str,
    /// Its mass, kg.
    pub mass_kg: f64,
    /// Where the mass comes from.
    pub mass_source: MassSource,
    source: Source,
}

impl Entry {
    /// Whether it is made here, so that nothing is downloaded for it.
    pub fn is_procedural(&self) -> bool {
        matches!(self.source, Source::Procedural(_))
    }

    /// Makes or reads the object.
    ///
    /// # Errors
    /// [`Error`] if the mesh cannot be fetched or read.
    pub fn load(&self, warnings: &mut Vec<Warning>) -> Result<Object, Error> {
        match self.source {
            Source::Procedural(recipe) => Ok(procedural::build(self.name, self.mass_kg, recipe)?),
            Source::Ycb(ycb) => {
                let bytes = ycb.file()?;
                if ycb.mass_source == MassSource::Placeholder {
                    warnings.push(Warning::PlaceholderMass { name: ycb.name, mass_kg: ycb.mass_kg });
                }
                ycb.object(&bytes, warnings)
            }
        }
    }

    /// Makes or reads the object's mesh alone. That it is cut into convex pieces is what takes most of the time of [`Self::load`].
    ///
    /// # Errors
    /// [`Error`] if the mesh cannot be fetched or read.
    pub fn mesh(&self, warnings: &mut Vec<Warning>) -> Result<Mesh, Error> {
        match self.source {
            Source::Procedural(recipe) => Ok(recipe().mesh),
            Source::Ycb(ycb) => Ok(ycb.mesh(&ycb.file()?, warnings)?.0),
        }
    }

    /// Its surface alone, upright, if it can be had without a download: to be looked at, without masses and convex pieces.
    pub fn mesh_if_here(&self) -> Option<Mesh> {
        match self.source {
            Source::Procedural(recipe) => Some(recipe().mesh),
            Source::Ycb(ycb) => {
                let bytes = Library::ycb().ok()?.read(ycb.name).ok()?;
                let raw = mvt_mesh::read_bytes(&bytes, Format::Stl, self.name).ok()?;
                Some(stand(&raw, ycb.up).0)
            }
        }
    }
}

impl Ycb {
    /// The mesh as it is in the library, which is fetched if it is not there.
    fn file(&self) -> Result<Vec<u8>, Error> {
        let library = Library::ycb()?;
        match library.read(self.name) {
            Err(assets::Error::Missing { .. }) => {
                library.fetch(&assets::YCB, mvt_pinned::Progress::Shown, &mut |_, _| {})?;
                Ok(library.read(self.name)?)
            }
            other => Ok(other?),
        }
    }

    /// What is repaired in the pinned files is known: a few collapsed slivers in 20 of them, which is not worth a word. Two lose a
    /// part that can be seen, and that is.
    fn mesh(
        &self,
        stl: &[u8],
        warnings: &mut Vec<Warning>,
    ) -> Result<(Mesh, mvt_frames::Isometry<mvt_frames::MeshFile, mvt_frames::Object>), Error> {
        let raw = mvt_mesh::read_bytes(stl, Format::Stl, self.name)?;
        let (clean, found) = mvt_mesh::repair(&raw, self.name)?;
        let visible = |finding| matches!(finding, Finding::Components { area_share, .. } if area_share > 1e-3);
        warnings.extend(found.into_iter().filter(|warning| visible(warning.finding)).map(Warning::Mesh));
        Ok(stand(&clean, self.up))
    }

    fn object(&self, stl: &[u8], warnings: &mut Vec<Warning>) -> Result<Object, Error> {
        let (mesh, object_from_file) = self.mesh(stl, warnings)?;
        let collision = decompose::pieces(&mesh)?;
        Ok(Object { name: self.name.to_owned(), mesh, exact: None, object_from_file, collision, mass_kg: self.mass_kg })
    }
}

/// Every object, the procedural ones last, each group sorted by name.
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

/// The mesh files of YCB.
pub fn ycb_files() -> impl Iterator<Item = Pinned> {
    ycb::OBJECTS.iter().map(|ycb| Pinned { name: ycb.name, sha256: ycb.sha256 })
}

/// A name that is not in the catalogue.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no object \"{name}\"; the nearest names are {}. A path to an .obj, .stl or .ply file works too", nearest.join(", "))]
pub struct UnknownObject {
    /// The name that was asked for.
    pub name: String,
    /// Names that look like it, best first.
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

/// How alike two names are: people leave out the number, so a name is also compared without it, and a part of a name is
/// nearly as good as all of it.
fn likeness(wanted: &str, name: &str) -> f64 {
    let short = name.trim_start_matches(|c: char| c.is_ascii_digit() || c == '_');
    let contains = if !wanted.is_empty() && name.contains(wanted) { 0.95 } else { 0.0 };
    strsim::jaro_winkler(wanted, name).max(strsim::jaro_winkler(wanted, short)).max(contains)
}

/// Something the user should know about a loaded object.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Warning {
    /// What was repaired in a mesh, or found in it.
    Mesh(mvt_mesh::Warning),
    /// The mass is a stand-in.
    PlaceholderMass {
        /// The object.
        name: &'static str,
        /// The mass that is used, kg.
        mass_kg: f64,
    },
    /// The mass of a user's mesh was estimated by [`estimated_mass_kg`].
    EstimatedMass {
        /// The mesh.
        file: String,
        /// The mass that is used, kg.
        mass_kg: f64,
    },
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Mesh(warning) => warning.fmt(f),
            Self::PlaceholderMass { name, mass_kg } => {
                write!(f, "{name}: no mass was ever published; {:.0} g stand in", mass_kg * 1e3)
            }
            Self::EstimatedMass { file, mass_kg } => {
                write!(f, "{file}: a mesh has no mass; {:.0} g by 0.5 g/cm^3 of its hull", mass_kg * 1e3)
            }
        }
    }
}

/// Why an object could not be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// No such name.
    #[error(transparent)]
    Unknown(#[from] UnknownObject),
    /// The YCB meshes are not there and could not be fetched, or are damaged.
    #[error(transparent)]
    Assets(#[from] assets::Error),
    /// The mesh is unusable.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The mesh encloses nothing.
    #[error(transparent)]
    Hull(#[from] NoHull),
}

/// Whether a text stands for a mesh file rather than a name in the catalogue: it holds a path separator or ends as a mesh file does.
pub fn is_path(name_or_path: &str) -> bool {
    Format::from_path(Path::new(name_or_path)).is_some() || name_or_path.contains(std::path::is_separator)
}

/// Loads an object: by its name in the catalogue, or a mesh by path if [`is_path`] says so. YCB meshes are fetched the first time one is wanted. A user's mesh stands with z up as it is in the file.
///
/// # Errors
/// [`Error`], which names the object or file and says what is wrong.
pub fn load(name_or_path: &str, warnings: &mut Vec<Warning>) -> Result<Object, Error> {
    if is_path(name_or_path) {
        load_file(Path::new(name_or_path), warnings)
    } else {
        find(name_or_path)?.load(warnings)
    }
}

fn load_file(path: &Path, warnings: &mut Vec<Warning>) -> Result<Object, Error> {
    let file = path.display().to_string();
    let (clean, found) = mvt_mesh::repair(&mvt_mesh::read(path)?, &file)?;
    warnings.extend(found.into_iter().map(Warning::Mesh));
    let (mesh, object_from_file) = stand(&clean, [0.0, 0.0, 1.0]);
    let collision = decompose::pieces(&mesh)?;
    let mass_kg = estimated_mass_kg(decompose::hull_volume_m3(&mesh)?);
    warnings.push(Warning::EstimatedMass { file, mass_kg });
    let name = path.file_stem().map_or_else(|| "object".into(), |stem| stem.to_string_lossy().into_owned());
    Ok(Object { name, mesh, exact: None, object_from_file, collision, mass_kg })
}

/// The mass that is given to a user's mesh, kg: half the density of water in its hull, which is typical of YCB, between 20 g and
/// 500 g, which the hand can turn.
pub fn estimated_mass_kg(hull_volume_m3: f64) -> f64 {
    (500.0 * hull_volume_m3).clamp(0.02, 0.5)
}
