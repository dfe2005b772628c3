//! Compiles the kernels as C++, once with 32-bit floats and once with bf16.

use std::fs;
use std::path::Path;

fn main() {
    let out = std::env::var("OUT_DIR").unwrap_or_default();
    println!("cargo::rerun-if-changed=../src/kernels");
    println!("cargo::rerun-if-changed=src/emulator.cpp");
    let kernels = kernels(Path::new("../src/kernels"));
    let entry = |(name, waits): &(String, bool)| format!("    {{\"{name}\", run<{name}>, {waits}}},\n");
    let table: String = kernels.iter().map(entry).collect();
    if let Err(error) = fs::write(Path::new(&out).join("table.inc"), table) {
        println!("cargo::error=the table of kernels cannot be written: {error}");
    }
    for (library, arithmetic) in [("emulated_f32", None), ("emulated_bf16", Some("BF16"))] {
        let mut build = cc::Build::new();
        build.cpp(true).std("c++17").file("src/emulator.cpp").include(&out).include("../src/kernels");
        // Every kernel runs in every test: unoptimised code would take minutes.
        build.opt_level(2).debug(false).warnings(false).define("ENTRY", library);
        if let Some(name) = arithmetic {
            build.define(name, None);
        }
        build.compile(library);
    }
}

/// Returns the kernels in the files of a folder, and whether their threads wait for each other.
fn kernels(folder: &Path) -> Vec<(String, bool)> {
    let mut kernels: Vec<(String, bool)> = Vec::new();
    let files = fs::read_dir(folder).into_iter().flatten().flatten();
    for text in files.filter_map(|file| fs::read_to_string(file.path()).ok()) {
        let first = kernels.len();
        for line in text.lines() {
            let kernel = line.strip_prefix("KERNEL ");
            let name = kernel.map(|line| line.strip_prefix("__launch_bounds__(THREADS) ").unwrap_or(line));
            if let Some((name, _)) = name.and_then(|line| line.split_once('(')) {
                kernels.push((name.to_owned(), false));
            } else if ["__syncthreads", "block_sum", "warp_", "__shfl"].iter().any(|call| line.contains(call))
                && let Some((_, waits)) = kernels[first..].last_mut()
            {
                *waits = true;
            }
        }
    }
    kernels.sort();
    kernels
}
