//! Extracts libmujoco from its verified Python wheel (see the crate `mvt-pinned`) and adds it to the link line.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::{env, fs, io, process};

use mvt_pinned::{Archive, DownloadProgress};

const LIBRARY: &str = "libmujoco.so.3.17.0";

macro_rules! wheel {
    ($arch:literal, $sha256:literal) => {
        Archive {
            package: "mujoco",
            version: "3.17.0",
            file: concat!("mujoco-3.17.0-cp311-cp311-manylinux_2_27_", $arch, ".manylinux_2_28_", $arch, ".whl"),
            sha256: $sha256,
            pip_args: &[
                "--only-binary=:all:",
                "--python-version",
                "3.11",
                "--platform",
                concat!("manylinux_2_28_", $arch),
            ],
            override_var: "MUJOCO_WHEEL",
            cache: "mambavitact",
        }
    };
}

/// The pinned wheels. The wheels of every CPython version contain the same library, so one per architecture is enough.
const WHEELS: [(&str, Archive); 2] = [
    ("x86_64", wheel!("x86_64", "d66928d86a2d1b601bbaa4dc11db50214d17d5301bb8afd84721313b67ff0874")),
    ("aarch64", wheel!("aarch64", "91a70ed9979c383ff1f5c03f25cc2e1280a8254c1a8e558d5dd7f4184f01efc9")),
];

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    for variable in ["MUJOCO_WHEEL", "MUJOCO_LIB_DIR"] {
        println!("cargo::rerun-if-env-changed={variable}");
    }
    match library_dir() {
        Ok(dir) => {
            println!("cargo::rustc-link-search=native={}", dir.display());
            println!("cargo::metadata=LIBDIR={}", dir.display());
        }
        Err(error) => println!("cargo::error=libmujoco 3.17.0: {error}"),
    }
}

fn library_dir() -> Result<PathBuf, Box<dyn Error>> {
    if let Some(dir) = env::var_os("MUJOCO_LIB_DIR").map(PathBuf::from) {
        return if dir.join(LIBRARY).is_file() {
            Ok(dir)
        } else {
            Err(format!("MUJOCO_LIB_DIR={} contains no {LIBRARY}; name the folder of that file", dir.display()).into())
        };
    }
    let (os, arch) = (env::var("CARGO_CFG_TARGET_OS")?, env::var("CARGO_CFG_TARGET_ARCH")?);
    let wheel =
        WHEELS.iter().find(|(name, _)| os == "linux" && *name == arch).map(|(_, wheel)| wheel).ok_or_else(|| {
            format!("no wheel is pinned for {os} on {arch}; set MUJOCO_LIB_DIR to a folder with {LIBRARY}")
        })?;
    let archive = wheel.fetch(DownloadProgress::Hidden)?;
    // In the cache, because an installed program still needs the library when the target folder is gone.
    let dir = match mvt_pinned::cache_dir(wheel.cache) {
        Ok(cache) => cache.join(format!("mujoco-{}-{arch}", wheel.version)),
        Err(_) => PathBuf::from(env::var("OUT_DIR")?).join("lib"),
    };
    unpack(&archive, &dir)?;
    Ok(dir)
}

/// Writes the library to `dir`. The file gets its final name when it is complete, so that a killed build leaves no
/// partial library.
fn unpack(archive: &Path, dir: &Path) -> Result<(), Box<dyn Error>> {
    fs::create_dir_all(dir)?;
    let mut zip = zip::ZipArchive::new(fs::File::open(archive)?)?;
    let mut member = zip.by_name(&format!("mujoco/{LIBRARY}"))?;
    // Several builds may do this at once.
    let partial = dir.join(format!(".{LIBRARY}.{}.partial", process::id()));
    io::copy(&mut member, &mut fs::File::create(&partial)?)?;
    fs::rename(partial, dir.join(LIBRARY))?;
    Ok(())
}
