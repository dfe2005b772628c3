//! Coordinates of meshes and poses, which their files state.

use std::io::Read as _;
use std::path::Path;

use clap::ValueEnum;
use mvt_files::input;

/// Coordinates in which a mesh is given, or which poses take to the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Coordinates {
    /// Coordinates of the file of the true object's mesh, as in FeelSight logs
    File,
    /// Coordinates of this program's runs: centred and upright
    Object,
    /// Coordinates of the field of a run
    #[value(skip)]
    Field,
}

/// Head of a file in which its coordinates are stated, bytes.
const HEAD: u64 = 4096;

impl Coordinates {
    /// All coordinates.
    const ALL: [Self; 3] = [Self::File, Self::Object, Self::Field];

    /// Returns the name, as it stands in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::File => "file",
            Self::Object => "object",
            Self::Field => "field",
        }
    }

    /// Returns the coordinates of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|coordinates| coordinates.name() == name)
    }

    /// Returns the coordinates that a mesh file (PLY or OBJ) states in a comment `coordinates NAME`; `None` if it states none.
    pub fn of_mesh_file(path: &Path) -> Option<Self> {
        let mut head = Vec::new();
        input::open(&mvt_mesh::split_unit(path).0).ok()?.take(HEAD).read_to_end(&mut head).ok()?;
        let head = String::from_utf8_lossy(&head);
        let comment = |line: &str| -> Option<Self> {
            let text = line.strip_prefix("comment ").or_else(|| line.strip_prefix("# "))?;
            Self::from_name(text.strip_prefix("coordinates ")?.trim())
        };
        head.lines().take_while(|line| line.trim() != "end_header").find_map(comment)
    }
}
