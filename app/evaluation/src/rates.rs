//! Runs with other numbers of frames per second, and with frames that do not arrive.

use std::collections::HashSet;

use anyhow::Result;
use mvt_gaits::clock::FRAME_HZ;
use mvt_simulated::Fault;

use super::{Episode, Key, Line, Tell, Trial, scored, simulated};

/// How frames come, beside all of 30 per second.
struct FrameRate {
    /// The variant in the results.
    name: &'static str,
    hz: u32,
    /// Share that does not arrive.
    dropped: f64,
}

const RATES: [FrameRate; 4] = [
    FrameRate { name: "10 Hz", hz: 10, dropped: 0.0 },
    FrameRate { name: "15 Hz", hz: 15, dropped: 0.0 },
    FrameRate { name: "60 Hz", hz: 60, dropped: 0.0 },
    FrameRate { name: "a third dropped", hz: FRAME_HZ, dropped: 1.0 / 3.0 },
];

/// The runs of an episode at all rates but the usual one; returns their keys, done before or not. The object moves the same in all of them.
pub fn runs(
    duration_s: f64,
    episode: &Episode<'_>,
    usual: &[Trial],
    done: &HashSet<Key>,
    tell: Tell<'_, Line>,
) -> Result<HashSet<Key>> {
    let mut keys = HashSet::new();
    for FrameRate { name, hz, dropped } in RATES {
        let of_rate = |trial: &Trial| {
            let key = Key { variant: name.to_owned(), ..trial.key.clone() };
            Trial { key, ..trial.clone() }
        };
        let mut trials: Vec<Trial> = usual.iter().map(of_rate).collect();
        keys.extend(trials.iter().map(|trial| trial.key.clone()));
        trials.retain(|trial| !done.contains(&trial.key));
        if let Some(first) = trials.first() {
            let fault = Fault { dropped, ..Fault::default() };
            let mut source = simulated(episode, duration_s, &first.config, fault)?;
            source.set_frame_rate(hz);
            scored(source, episode, &trials, tell)?;
        }
    }
    Ok(keys)
}
