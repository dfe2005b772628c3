//! A live connection in numbers.

use std::fmt;
use std::sync::{Arc, Mutex};

use serde::Serialize;

/// What arrived over a live connection, what was dropped, and how old a frame was when its pose was known.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct LiveRecord {
    /// Frames that were estimated.
    pub frames: u64,
    /// Complete frames that were dropped because a newer one was there.
    pub late: u64,
    /// Depth images without colours, masks, joints or touch images of their time.
    pub unpaired: u64,
    /// Frames with a damaged image, or joints of another hand.
    pub unusable: u64,
    /// Time from the stamp of a frame to its published pose; `None` if the clocks differ.
    pub latency_ms: Option<LiveLatency>,
    /// The topics.
    pub topics: Vec<LiveTopicRecord>,
    /// The commands to the hand; `None` if nothing is sent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub commands: Option<CommandRecord>,
    /// The log that was recorded meanwhile; missing without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub log: Option<LiveLogRecord>,
}

/// Commands to a hand.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct CommandRecord {
    /// Targets that were sent.
    pub sent: u64,
    /// How often the hand held or opened because it could not follow the controller, with the reasons in words.
    pub stops: Vec<String>,
}

/// A log that a live run recorded.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct LiveLogRecord {
    /// Frames in the log.
    pub frames: u64,
    /// Frames that it lacks, because the disk was too slow or full.
    pub left_out: u64,
}

/// Time from the stamp of a frame to its published pose, milliseconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct LiveLatency {
    /// Half of the frames are at most so old.
    pub median: f64,
    /// 95 % of the frames are at most so old.
    pub p95: f64,
    /// The oldest.
    pub max: f64,
}

/// A topic of a live connection.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct LiveTopicRecord {
    /// Its name.
    pub topic: String,
    /// Messages that arrived.
    pub received: u64,
    /// Messages that the publisher numbered and that never arrived.
    pub lost: u64,
    /// Messages that were dropped because of their stamps.
    pub refused: u64,
    /// Messages that arrived, per second.
    pub hz: f64,
}

/// A record that is updated while the run goes on.
pub type SharedLiveRecord = Arc<Mutex<LiveRecord>>;

impl fmt::Display for LiveRecord {
    /// Writes one line for the frames and one for each topic.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { frames, late, unpaired, unusable, latency_ms, topics, commands, log } = self;
        write!(
            f,
            "live: {frames} frames used, {late} late, {unpaired} unpaired, {unusable} unusable; stamp to pose: "
        )?;
        match latency_ms {
            Some(ms) => writeln!(f, "{:.0} ms median, {:.0} ms p95", ms.median, ms.p95)?,
            None => writeln!(f, "unknown, because the clocks differ")?,
        }
        for LiveTopicRecord { topic, received, lost, refused, hz } in topics {
            writeln!(f, "  {topic}: {received} messages at {hz:.1} Hz, {lost} lost, {refused} refused")?;
        }
        if let Some(CommandRecord { sent, stops }) = commands {
            writeln!(f, "  {sent} commands sent; the hand stopped {} times", stops.len())?;
        }
        if let Some(LiveLogRecord { frames, left_out }) = log {
            writeln!(f, "  recorded: {frames} frames, {left_out} left out")?;
        }
        Ok(())
    }
}

impl LiveLatency {
    /// Returns the quantiles of times; `None` without any.
    pub fn of(mut times_ms: Vec<f64>) -> Option<Self> {
        times_ms.sort_by(f64::total_cmp);
        let at = |share: f64| times_ms.get(((times_ms.len() as f64 * share) as usize).min(times_ms.len() - 1)).copied();
        Some(Self { max: *times_ms.last()?, median: at(0.5)?, p95: at(0.95)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn latency_is_given_by_quantiles() {
        assert_eq!(LiveLatency::of(Vec::new()), None);
        let latency = LiveLatency::of((0..100).rev().map(f64::from).collect());
        assert_eq!(latency, Some(LiveLatency { median: 50.0, p95: 95.0, max: 99.0 }));
    }
}
