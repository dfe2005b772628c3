//! Lets the binaries find libmujoco: beside themselves when shipped, in the target folder when built here.

fn main() {
    println!("cargo::rerun-if-changed=search_path.rs");
    if let Ok(dir) = std::env::var("DEP_MUJOCO_LIBDIR") {
        println!("cargo::rustc-link-arg=-Wl,-rpath,$ORIGIN:{dir}");
    }
}
