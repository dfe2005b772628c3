//! Trials in which a known shape is lost on purpose.

use std::collections::HashSet;
use std::fmt::Write as _;

use anyhow::{Context as _, Result};
use mvt_frames::Isometry;
use mvt_gaits::clock::FRAME_HZ;
use mvt_metrics::FAILURE_M;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::{Episode, EvaluateArguments, Key, Keyed, Tell, follow, key, setup, simulated};
use mvt_run::config::RunConfig;
use mvt_run::estimator::{Mode, random_motion};
use mvt_run::pipeline::FrameResult;
use mvt_run::report::TrackState;
use mvt_run::source::Modality;
use mvt_run::truth::Truth;
use mvt_simulated::Fault;

/// Kind of a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FaultKind {
    /// The object is moved by 3 cm and turned by 40 degrees, in random directions.
    Teleport,
    /// The cameras deliver nothing for 2 s.
    Blank,
    /// Both at once.
    Both,
    /// The cameras are turned by 4 degrees and moved by 1 cm, in random directions, and stay there.
    Bump,
    /// The joint readings stand still for 2 s.
    Frozen,
}

impl FaultKind {
    const ALL: [FaultKind; 5] =
        [FaultKind::Teleport, FaultKind::Blank, FaultKind::Both, FaultKind::Bump, FaultKind::Frozen];

    fn name(self) -> &'static str {
        match self {
            Self::Teleport => "teleport",
            Self::Blank => "blank",
            Self::Both => "both",
            Self::Bump => "bump",
            Self::Frozen => "frozen",
        }
    }
}

const DISTANCE_M: f64 = 0.03;
const ANGLE_DEG: f64 = 40.0;
const BUMP_M: f64 = 0.01;
const BUMP_DEG: f64 = 4.0;
const FAULT_FRAMES: usize = 2 * FRAME_HZ as usize;
/// When the fault comes, seconds, drawn from this range.
const FAULT_S: std::ops::Range<f64> = 3.0..6.0;
/// Frames that are scored after the fault.
const WATCHED: usize = 6 * FRAME_HZ as usize;
/// So many frames in a row make a recovery, not a coincidence.
const STEADY: usize = 5;

/// A trial. Frames count at 30 per second.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Trial {
    #[serde(flatten)]
    key: Key,
    /// Number of the frame at which the fault begins.
    fault_frame: usize,
    /// How far the object truly moved between the frame before the fault and the first one of it, mm.
    moved_mm: f64,
    /// The object fell off the hand before the watch was over: the trial says little.
    dropped: bool,
    /// The error at the frame before, mm: a fault cannot be blamed for an earlier error.
    before_mm: f64,
    /// The largest error from the fault on, mm.
    worst_mm: f64,
    /// Frames from the first error above 10 mm until the tracker declared the object lost; `None` if it never did.
    declared_after: Option<usize>,
    /// Whether the error ever exceeded 10 mm.
    astray: bool,
    /// Frames from the end of the fault until the error was below 10 mm for five frames in a row; `None` if it never was.
    recovered_after: Option<usize>,
}

impl Keyed for Trial {
    fn key(&self) -> &Key {
        &self.key
    }
}

/// The trials of an episode; returns the keys of all, done before or not.
pub fn trials(
    arguments: &EvaluateArguments,
    episode: &Episode<'_>,
    config: &RunConfig,
    done: &HashSet<Key>,
    tell: Tell<'_, Trial>,
) -> Result<HashSet<Key>> {
    let mut keys = HashSet::new();
    for &modality in &arguments.modalities {
        for fault in FaultKind::ALL.into_iter().filter(|&fault| fault == FaultKind::Teleport || modality.has_vision()) {
            let key = key(arguments.duration, episode, Mode::Pose, modality, fault.name(), config);
            if !done.contains(&key) {
                tell(trial(episode, config, modality, fault, key.clone())?)?;
            }
            keys.insert(key);
        }
    }
    Ok(keys)
}

fn trial(episode: &Episode<'_>, config: &RunConfig, modality: Modality, fault: FaultKind, key: Key) -> Result<Trial> {
    let mut rng = ChaCha8Rng::seed_from_u64(episode.seed);
    rng.set_stream(fault as u64 + 1);
    let fault_frame = (rng.random_range(FAULT_S) * f64::from(FRAME_HZ)) as usize;
    let last = fault_frame + WATCHED;
    let moves = matches!(fault, FaultKind::Teleport | FaultKind::Both);
    let length = match fault {
        FaultKind::Teleport | FaultKind::Bump => 0,
        FaultKind::Blank | FaultKind::Both | FaultKind::Frozen => FAULT_FRAMES,
    };
    let span = fault_frame as u64..(fault_frame + length) as u64;
    let motion = Isometry::new(random_motion(DISTANCE_M, ANGLE_DEG.to_radians(), &mut rng));
    let bump = Isometry::new(random_motion(BUMP_M, BUMP_DEG.to_radians(), &mut rng));
    let trouble = Fault {
        displacement: moves.then_some((fault_frame as u64, motion)),
        blank: if fault == FaultKind::Frozen { 0..0 } else { span.clone() },
        bump: (fault == FaultKind::Bump).then_some((fault_frame as u64, bump)),
        frozen: if fault == FaultKind::Frozen { span } else { 0..0 },
        dropped: 0.0,
    };
    // Half a frame more, so that the last one is not lost to rounding.
    let mut source = simulated(episode, (last as f64 + 0.5) / f64::from(FRAME_HZ), config, trouble)?;
    let truth = Truth::new(episode.object.clone());
    let estimators = vec![setup(config, Mode::Pose, modality, episode.seed)];
    let (mut errors_m, mut lost, mut places) = (Vec::new(), Vec::new(), Vec::new());
    follow(&mut source, episode.object, Some(&truth), estimators, config.mesh_cell_mm, |results, sensed| {
        let Some(FrameResult { row, .. }) = results.first().and_then(Option::as_ref) else { return Ok(()) };
        places.push(sensed.truth.context("a simulated episode without truth")?.origin().coords());
        errors_m.push(row.add_s.map_or(f64::INFINITY, |e| e.one_directional_m));
        lost.push(row.state == TrackState::Lost);
        Ok(())
    })?;
    let ended = fault_frame + length;
    let after = errors_m.get(fault_frame..).unwrap_or_default();
    let astray = after.iter().position(|&e| e > FAILURE_M).map(|k| fault_frame + k);
    let declared = astray.and_then(|_| lost.iter().skip(fault_frame).position(|&lost| lost)).map(|k| fault_frame + k);
    let from = ended.max(astray.unwrap_or(ended));
    let steady = |k: &usize| {
        let errors = errors_m.get(*k..*k + STEADY).unwrap_or_default();
        errors.len() == STEADY && errors.iter().all(|&e| e < FAILURE_M)
    };
    let moved_m = places.windows(2).nth(fault_frame.saturating_sub(1)).map_or(0.0, |pair| (pair[1] - pair[0]).norm());
    Ok(Trial {
        key,
        fault_frame,
        moved_mm: moved_m * 1e3,
        dropped: errors_m.len() < last,
        before_mm: fault_frame.checked_sub(1).and_then(|k| errors_m.get(k)).map_or(f64::MAX, |e| e * 1e3),
        worst_mm: after.iter().copied().fold(0.0, f64::max) * 1e3,
        declared_after: declared.zip(astray).map(|(declared, astray)| declared.saturating_sub(astray)),
        astray: astray.is_some(),
        recovered_after: (from..errors_m.len()).find(steady).map(|k| k - ended),
    })
}

/// How the trials went, as Markdown.
pub fn table(trials: &[Trial]) -> String {
    const SOON: usize = 5;
    const WITHIN: usize = 2 * FRAME_HZ as usize;
    let mut text = "| cameras | modality | fault | trials | dropped | error above 10 mm | declared within 5 frames | \
                    never declared | below 10 mm within 2 s |\n|---|---|---|---|---|---|---|---|---|\n"
        .to_owned();
    let mut groups: Vec<(&str, &str, &str)> =
        trials.iter().map(|t| (t.key.cameras.as_str(), t.key.modality.name(), t.key.variant.as_str())).collect();
    groups.sort_unstable();
    groups.dedup();
    for (cameras, modality, fault) in groups {
        let of_group = || {
            trials.iter().filter(move |t| {
                (t.key.cameras.as_str(), t.key.modality.name(), t.key.variant.as_str()) == (cameras, modality, fault)
            })
        };
        let kept = || of_group().filter(|t| !t.dropped);
        let count = kept().count();
        let astray = kept().filter(|t| t.astray).count();
        let soon = kept().filter(|t| t.declared_after.is_some_and(|frames| frames <= SOON)).count();
        let never = kept().filter(|t| t.astray && t.declared_after.is_none()).count();
        let well = kept().filter(|t| !t.astray || t.recovered_after.is_some_and(|frames| frames <= WITHIN)).count();
        let _ = writeln!(
            text,
            "| {cameras} | {modality} | {fault} | {count} | {} | {astray} | {soon} of {astray} | {never} | {well} of {count} |",
            of_group().count() - count
        );
    }
    text
}
