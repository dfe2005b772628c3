//! Links libmujoco 3.17.0. The build script downloads, verifies and links the library; this crate has no items of its
//! own.
//!
//! The variable `MUJOCO_LIB_DIR` names a folder with the library, which replaces the download.
//!
//! A package with a binary, a test or an example depends on this crate, and its build script prints a run-time search
//! path to `DEP_MUJOCO_LIBDIR`. Its library names the crate, so that the linker keeps it:
//!
//! ```
//! use mvt_mujoco_lib as _;
//! ```
