//! The hand is data: only entry points and formats name the one that is built in.

use std::path::Path;

use crate::nothing_offends;
use crate::sources::{code, rust_files};

/// Files and folders that may name the Allegro: the crates that define and load hands, formats that were made for it, its controllers, and
/// commands whose default it is.
const ALLOWED: [&str; 12] = [
    "scenes/robot",
    "sim/hands",
    "sim/feelsight",
    "sim/gaits/src/controller_file.rs",
    "sim/gaits/src/gait.rs",
    "app/exchange/src/mapping.rs",
    // The key of FeelSight's pickle.
    "app/exchange/src/record.rs",
    "app/environment/src/scene.rs",
    "app/evaluation",
    "app/sweep/src/work.rs",
    "src",
    "python",
];

#[test]
fn only_entry_points_and_formats_name_the_built_in_hand() {
    let folders = ["scenes", "sim", "perception", "slam", "app", "src", "python"];
    let files = folders.iter().flat_map(|folder| rust_files(Path::new(folder)));
    let sources = files.filter(|file| file.iter().any(|part| part == "src"));
    let others = sources.filter(|file| ALLOWED.iter().all(|allowed| !file.starts_with(allowed)));
    let names = |text: &str| ["allegro", "ALLEGRO", "Finger::", "JOINTS_PER"].iter().any(|name| text.contains(name));
    let offenders: Vec<String> =
        others.filter(|file| names(&code(file))).map(|file| file.display().to_string()).collect();
    nothing_offends("a hand is received as a value, and its joints and pads are counted", &offenders);
}
