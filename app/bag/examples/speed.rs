//! Measures how fast the RGB-D frames of a bag are read, on one core.
//!
//! ```text
//! python app/bag/tests/make_bags.py --large target/bags
//! cargo run --release -p mvt-bag --example speed -- target/bags/plain target/bags/lz4 target/bags/zstd target/bags/db3
//! ```

#![allow(clippy::print_stdout, reason = "the output of the example")]

use std::path::Path;
use std::time::Instant;

use mvt_bag::{BagError, RgbdBag};

/// Frames per second that are wanted.
const WANTED_HZ: f64 = 100.0;

/// Returns the greatest memory of this process, MiB, where the system tells it.
fn peak_mib() -> Option<f64> {
    let status = mvt_files::input::read_text(Path::new("/proc/self/status"), 1 << 20).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()? / 1024.0)
}

fn main() -> Result<(), BagError> {
    for path in std::env::args_os().skip(1) {
        let path = Path::new(&path);
        let begun = Instant::now();
        let mut bag = RgbdBag::open(path)?;
        let opened_s = begun.elapsed().as_secs_f64();
        let begun = Instant::now();
        let mut pixels = 0;
        for frame in bag.frames() {
            pixels += frame?.depth_m.len();
        }
        let read_s = begun.elapsed().as_secs_f64();
        let (count, frame_hz) = (bag.len() as f64, bag.len() as f64 / read_s);
        println!(
            "{}: opened in {opened_s:.2} s; {count} frames of {:.0} pixels at {frame_hz:.0} frames/s, {:.1} times the wanted {WANTED_HZ}; with opening {:.0} frames/s; memory {:.0} MiB at most",
            path.display(),
            pixels as f64 / count,
            frame_hz / WANTED_HZ,
            count / (read_s + opened_s),
            peak_mib().unwrap_or(f64::NAN),
        );
    }
    Ok(())
}
