//! `score` scored 1 of 60 poses without a word when the times of one file were in milliseconds.

use std::fmt::Write as _;

use crate::workplace::Workplace;

const HEADER: &str = "time_s,x_m,y_m,z_m,qw,qx,qy,qz";
const SCORE: &str = "score --truth cube70 --pose pose.csv --truth-pose truth.csv";

/// 60 poses whose times are changed.
fn poses(header: &str, time: impl Fn(f64) -> f64, every: usize) -> String {
    let mut text = format!("{header}\n");
    for k in (0..60).step_by(every) {
        let _ = writeln!(text, "{},{},0.02,0.2,1,0,0,0", time(k as f64 / 30.0), 0.001 * k as f64);
    }
    text
}

#[test]
fn poses_of_few_common_times_are_refused_and_their_number_is_said() {
    let workplace = Workplace::new();
    workplace.write("truth.csv", poses(HEADER, |s| s, 1));
    for (time, part) in [
        (
            &(|s| 1e3 * s) as &dyn Fn(f64) -> f64,
            "1 of the 60 poses of pose.csv and the 60 of truth.csv are at the same time (within 1 ms); the times of the estimates seem to be in ms: name that column time_ms",
        ),
        (&|s| 1e9 * s, "seem to be in ns"),
        (&|s| s + 0.0015, "usually the nearest is 1.5 ms away"),
        (&|s| s + 1.7e9, "give times of the same clock"),
    ] {
        workplace.write("pose.csv", poses(HEADER, time, 1));
        let ended = workplace.run(SCORE);
        assert!(ended.code == Some(1) && ended.stderr.contains(part), "{ended:?}");
    }
    workplace.write("pose.csv", poses(&HEADER.replace("time_s", "time_ms"), |s| 1e3 * s, 1));
    assert!(workplace.run(SCORE).good().contains("60 frames"));
    workplace.write("pose.csv", poses(HEADER, |s| s, 10));
    let ended = workplace.run(SCORE);
    assert!(ended.stderr.contains("6 of the 6 poses of pose.csv and the 60 of truth.csv"), "{ended:?}");
}
