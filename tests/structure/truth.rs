//! The controller of a run knows no true pose, and every source of frames goes through one perception.

use std::path::Path;

use crate::nothing_offends;
use crate::sources::{code, rust_files};

#[test]
fn the_true_place_of_the_object_never_reaches_a_run() {
    let of = ["app/run/src", "app/simulated/src/simulated.rs", "app/evaluation/src", "src/run", "src/run.rs", "slam"];
    let files = of.iter().flat_map(|place| rust_files(Path::new(place)));
    let shows_it = |text: &str| ["RehearsedPlace", "Rehearsal", ".rehearse("].iter().any(|name| text.contains(name));
    // `hand score` has no camera to estimate from: there the true place gets the errors of an estimate.
    let offenders = files.filter(|file| !file.ends_with("played.rs") && shows_it(&code(file)));
    let offenders: Vec<String> = offenders.map(|file| file.display().to_string()).collect();
    nothing_offends("runs know an estimate of the object's place, not the true one", &offenders);
}

#[test]
fn perception_is_assembled_once() {
    let parts = ["Calibrator::new", "Feeler::new", "TouchSensors::new", "set_colours("];
    let folders = ["app", "src", "python", "slam", "sim"];
    let files = folders.iter().flat_map(|folder| rust_files(Path::new(folder)));
    let assembles = |text: &str| parts.iter().any(|part| text.contains(part));
    let offenders: Vec<String> =
        files.filter(|file| assembles(&code(file))).map(|file| file.display().to_string()).collect();
    nothing_offends("mvt-perceive alone turns observations into percepts", &offenders);
}
