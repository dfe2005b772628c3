//! A run in words.

use std::path::Path;

use crate::io::shell_word;
use crate::report::{KNOWN_RAD, SURE_M, Summary, file};

/// Returns speed and scores of a run, the folder of its results, and what to look at next; `benchmark` are the scores as benchmarks have them, in
/// words.
pub fn in_words(summary: &Summary, out: &Path, benchmark: Option<&str>) -> String {
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"));
    let f = |mm: u32| number(summary.shape.f_score.as_ref().and_then(|scores| scores.get(&mm).copied()));
    let add_s = summary.add_s_mm;
    let mut text = format!(
        "{} ({} {}, seed {}): {} frames, {:.1} s, at {:.1} frames/s \
         (sense {:.1}, track {:.1}, map {:.1}, mesh {:.1} ms)\n",
        summary.object,
        summary.mode,
        summary.modality,
        summary.seed,
        summary.frames,
        summary.simulated_s,
        summary.frames_per_second,
        summary.stage_ms.sense,
        summary.stage_ms.track,
        summary.stage_ms.map,
        summary.stage_ms.mesh
    );
    if let Some(live) = &summary.live {
        text += &live.to_string();
    }
    match (summary.deviation_mm, summary.deviation_deg) {
        (Some(mm), Some(deg)) => {
            let rotation = match deg.to_radians() <= KNOWN_RAD {
                true => format!("rotation to {deg:.1} degrees"),
                // The surface lies where it is stated: only a turn that does not move it can be unknown.
                false if mm <= SURE_M * 1e3 => "a turn about its axis unknown".to_owned(),
                false => "rotation unknown".to_owned(),
            };
            text += &format!(
                "last pose: position known to {mm:.1} mm, {rotation}; {:.0} % of the frames sure (at most 2.5 mm)\n",
                100.0 * summary.sure_frames
            );
        }
        _ => text += "last pose: lost\n",
    }
    if let Some(e) = add_s {
        text += &format!(
            "pose error (ADD-S), mm: mean {:.2}, median {:.2}, p95 {:.2}, final {:.2}; \
             lost {} frames, recovered {} times\n",
            e.mean, e.median, e.p95, e.last, summary.lost_frames, summary.recovered
        );
        if let Some((add, rotation)) = summary.add_mm.zip(summary.rotation_deg) {
            text += &format!(
                "ADD, mm: mean {:.2}, final {:.2}; rotation, degrees: mean {:.1}, final {:.1}, stated as known in {:.0} % of the frames\n",
                add.mean,
                add.last,
                rotation.mean,
                rotation.last,
                100.0 * rotation.known
            );
        }
        text += &format!("shape (F-score) at 1, 2, 5 and 10 mm: {}, {}, {}, {}\n", f(1), f(2), f(5), f(10));
        if let Some(observed) = &summary.observed {
            text += &format!(
                "{:.0} % of the surface was measured; F-score of this part at 5 mm: {}\n",
                100.0 * observed.share,
                number(observed.f_score.get(&5).copied())
            );
        }
    }
    if let Some(scores) = benchmark {
        text += &format!("{scores}\n");
    }
    text += &format!("results in {}\n", out.display());
    let path = |name: &str| out.join(name).display().to_string();
    if out.join(file::TURNTABLE).exists() {
        text += &format!("next: open {} and {},\n", path(file::TURNTABLE), path(file::CURVES));
        text +=
            &format!("      or look at the run with `mambavitact view --run {}`", shell_word(&out.to_string_lossy()));
    } else {
        text += &format!("next: look at the run with `mambavitact view --run {}`", shell_word(&out.to_string_lossy()));
    }
    text
}
