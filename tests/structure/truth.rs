//! The controller of a run knows no true pose.

use std::path::Path;

use crate::nothing_offends;
use crate::sources::{code, rust_files};

#[test]
fn the_true_place_of_the_object_never_reaches_a_run() {
    let places = ["app/run/src", "app/live/src/live.rs", "app/evaluation/src", "src/run", "src/run.rs", "slam"];
    let files = places.iter().flat_map(|place| rust_files(Path::new(place)));
    let shows_it = |text: &str| ["RehearsedPlace", "Rehearsal", ".rehearse("].iter().any(|name| text.contains(name));
    let offenders: Vec<String> =
        files.filter(|file| shows_it(&code(file))).map(|file| file.display().to_string()).collect();
    nothing_offends("runs know an estimate of the object's place, not the true one", &offenders);
}
