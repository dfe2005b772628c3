//! Links libmujoco 3.17.0; everything happens in the build script.
//!
//! A package that owns a binary or a test depends on this crate, writes `use mujoco_lib as _;` in its library and has its own
//! build script print a run-time search path to `DEP_MUJOCO_LIBDIR`.
