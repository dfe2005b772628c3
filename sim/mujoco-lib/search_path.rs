//! Sets the run-time search path of libmujoco: the folder of the program, the folder `lib` beside it, then the folder from which the build
//! has linked it: the user's cache, or MUJOCO_LIB_DIR.

#![expect(clippy::print_stdout, reason = "Cargo reads the output of a build script")]

fn main() {
    // Cargo itself runs this again when this file or the folder of libmujoco changes. Without a line of this kind it would at every change.
    println!("cargo::rerun-if-env-changed=MUJOCO_LIB_DIR");
    if let Ok(dir) = std::env::var("DEP_MUJOCO_LIBDIR") {
        println!("cargo::rustc-link-arg=-Wl,-rpath,$ORIGIN:$ORIGIN/../lib:{dir}");
    }
}
