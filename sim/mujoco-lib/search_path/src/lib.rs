//! For the build scripts of packages with a program, a test or an example that links libmujoco.
//!
//! ```
//! // In `main` of build.rs, in a package that depends on `mvt-mujoco-lib`.
//! mvt_mujoco_search_path::set();
//! ```

#![expect(clippy::print_stdout, reason = "Cargo reads the output of a build script")]

/// Sets the run-time search path of libmujoco: the folder of the program, the folder `lib` beside it, then the folder from which the build
/// has linked it: the user's cache, or MUJOCO_LIB_DIR.
pub fn set() {
    // Cargo itself runs a build script again when it or the folder of libmujoco changes. Without a line of this kind it would at every change.
    println!("cargo::rerun-if-env-changed=MUJOCO_LIB_DIR");
    if let Ok(dir) = std::env::var("DEP_MUJOCO_LIBDIR") {
        println!("cargo::rustc-link-arg=-Wl,-rpath,$ORIGIN:$ORIGIN/../lib:{dir}");
    }
}
