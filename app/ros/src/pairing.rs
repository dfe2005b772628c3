//! Pairing of messages by their stamps, without a network: what is late is dropped and counted, and nothing queues.

use std::collections::VecDeque;

/// A stream that is silent for longer is not waited for, nanoseconds: the drivers of cameras pause for less.
pub const SILENCE_NS: i64 = 1_000_000_000;
/// Stamps that run back by more are those of a clock that was set or of a recording that began anew, nanoseconds.
const JUMP_NS: i64 = 1_000_000_000;
/// Stamps so far before or behind our clock are those of another clock, nanoseconds.
const SKEW_NS: i64 = 1_000_000_000;
/// Images of a stream that wait for their partners: half a second at 30 Hz, some 25 MB of colours.
const MOST_IMAGES: usize = 16;
/// Values of a stream that wait: half a second at 500 Hz.
const MOST_VALUES: usize = 256;
/// A value so near to the stamp of a frame is taken for that of the frame, nanoseconds.
const NEAR_NS: i64 = 2_000_000;
/// Values farther apart are not interpolated, nanoseconds.
const GAP_NS: i64 = 200_000_000;

/// What a frame needs of a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StreamNeed {
    /// No frame is without it.
    Always,
    /// A frame waits for it as long as it delivers.
    WhileAlive,
}

/// How a stream takes part in frames.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StreamRule {
    /// Name, for messages.
    pub name: String,
    /// What a frame needs of it.
    pub need: StreamNeed,
    /// Whether a frame receives the messages on either side of its stamp, for values between them, in place of the nearest message.
    pub is_between: bool,
}

/// Reason why a message is not used, or is used with a warning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
#[non_exhaustive]
pub enum StampFault {
    /// No stamp.
    #[error("its stamps are 0, so that it cannot be paired: let the driver set header.stamp")]
    Zero,
    /// Not newer than the message before.
    #[error("a message is not newer than the one before and is dropped: are there two publishers?")]
    Backwards,
    /// The clock was set back.
    #[error("its stamps jumped back by more than 1 s: the frames go on from here")]
    Jump,
    /// Stamps of another clock in the future; the message is used.
    #[error(
        "its stamps lie in the future: synchronise the clocks of the computers (chrony or NTP); latency is not known"
    )]
    Future,
    /// Stamps of another clock in the past; the message is used.
    #[error(
        "its stamps are more than 1 s old: synchronise the clocks of the computers, or it is a recording; latency is not known"
    )]
    Past,
}

/// Message with its stamp.
#[derive(Debug, Clone, PartialEq)]
pub struct Stamped<T> {
    /// Stamp of its header, nanoseconds.
    pub stamp_ns: i64,
    /// The message.
    pub item: T,
}

/// Message or messages of a stream for a frame.
#[derive(Debug, Clone, PartialEq)]
pub enum FramePart<T> {
    /// Nothing: the stream is silent.
    Missing,
    /// The message of the frame, or a value near to it.
    One(Stamped<T>),
    /// The messages before and behind the stamp of the frame.
    Between(Stamped<T>, Stamped<T>),
}

/// Frame: the messages that belong together.
#[derive(Debug, Clone, PartialEq)]
pub struct PairedFrame<T> {
    /// Stamp of the first stream's message, nanoseconds.
    pub stamp_ns: i64,
    /// Time since the first frame, nanoseconds; rises also where stamps jump back.
    pub time_ns: i64,
    /// The parts, in the order of the streams.
    pub parts: Vec<FramePart<T>>,
}

/// Counts of a stream.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StreamCounts {
    /// Messages that arrived.
    pub received: u64,
    /// Messages that were dropped because of their stamp.
    pub refused: u64,
    /// When the newest message arrived, nanoseconds; `None` before the first.
    pub newest_arrival_ns: Option<i64>,
    /// When the first one arrived, nanoseconds.
    pub first_arrival_ns: Option<i64>,
}

/// Counts of the first stream's messages by what became of them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct FrameCounts {
    /// Delivered as frames.
    pub delivered: u64,
    /// Complete, but a newer frame was complete as well when the next one was asked for.
    pub late: u64,
    /// Without partners when a newer frame was complete, or when there was no room.
    pub unpaired: u64,
}

#[derive(Debug)]
struct Stream<T> {
    rule: StreamRule,
    waiting: VecDeque<Stamped<T>>,
    newest_ns: Option<i64>,
    counts: StreamCounts,
}

/// Pairs the messages of streams by their stamps. The first stream leads: each of its messages may become a frame.
///
/// ```
/// use mvt_ros::{Pairing, StreamNeed, StreamRule};
///
/// let rule = |name: &str| StreamRule { name: name.to_owned(), need: StreamNeed::Always, is_between: false };
/// let mut pairing = Pairing::new(vec![rule("depth"), rule("colours")], 16_000_000, 0);
/// for k in 1..=3 {
///     pairing.push(0, k * 33_000_000, 0, "depth")?;
///     pairing.push(1, k * 33_000_000 + 5_000_000, 0, "colours")?;
/// }
/// // The newest frame is delivered; the two before it are late.
/// assert_eq!(pairing.take(0).map(|frame| frame.stamp_ns), Some(99_000_000));
/// assert_eq!(pairing.frames().late, 2);
/// # Ok::<(), mvt_ros::StampFault>(())
/// ```
#[derive(Debug)]
pub struct Pairing<T> {
    streams: Vec<Stream<T>>,
    slop_ns: i64,
    /// When the pairing began: streams have this long to begin.
    begun_ns: i64,
    frames: FrameCounts,
    /// Time of the newest frame.
    newest_time_ns: Option<i64>,
    /// What is added to stamps to give times.
    offset_ns: Option<i64>,
}

/// Time between frames where it is unknown, nanoseconds.
const PERIOD_NS: i64 = 33_000_000;

impl<T: Clone> Pairing<T> {
    /// Starts at a time of our clock. Stamps of one frame differ by at most `slop_ns`.
    pub fn new(rules: Vec<StreamRule>, slop_ns: i64, now_ns: i64) -> Self {
        let stream = |rule| Stream { rule, waiting: VecDeque::new(), newest_ns: None, counts: StreamCounts::default() };
        Self {
            streams: rules.into_iter().map(stream).collect(),
            slop_ns,
            begun_ns: now_ns,
            frames: FrameCounts::default(),
            newest_time_ns: None,
            offset_ns: None,
        }
    }

    /// Sets the time at which the pairing begins.
    pub fn begin(&mut self, now_ns: i64) {
        self.begun_ns = now_ns;
    }

    /// Takes a message of a stream that arrived now. There may be both: a message that is used, and a warning.
    ///
    /// # Errors
    /// [`StampFault`] if the message is dropped, or if its stamp deserves a warning.
    pub fn push(&mut self, stream: usize, stamp_ns: i64, now_ns: i64, item: T) -> Result<(), StampFault> {
        let Some(of) = self.streams.get_mut(stream) else { return Ok(()) };
        of.counts.received += 1;
        of.counts.newest_arrival_ns = Some(now_ns);
        of.counts.first_arrival_ns.get_or_insert(now_ns);
        if stamp_ns <= 0 {
            of.counts.refused += 1;
            return Err(StampFault::Zero);
        }
        let mut fault = if stamp_ns > now_ns.saturating_add(SKEW_NS) {
            Some(StampFault::Future)
        } else if stamp_ns < now_ns.saturating_sub(SKEW_NS) {
            Some(StampFault::Past)
        } else {
            None
        };
        if let Some(newest_ns) = of.newest_ns.filter(|newest_ns| stamp_ns <= *newest_ns) {
            if newest_ns.saturating_sub(stamp_ns) < JUMP_NS {
                of.counts.refused += 1;
                return Err(StampFault::Backwards);
            }
            of.waiting.clear();
            if stream == 0 {
                // Times go on behind the newest frame.
                self.offset_ns = self.newest_time_ns.map(|time_ns| time_ns + PERIOD_NS - stamp_ns);
            }
            fault = Some(StampFault::Jump);
        }
        of.newest_ns = Some(stamp_ns);
        let most = if of.rule.is_between { MOST_VALUES } else { MOST_IMAGES };
        if of.waiting.len() == most {
            of.waiting.pop_front();
            self.frames.unpaired += u64::from(stream == 0);
        }
        of.waiting.push_back(Stamped { stamp_ns, item });
        fault.map_or(Ok(()), Err)
    }

    /// Whether a frame waits for a stream.
    fn is_awaited(&self, stream: &Stream<T>, now_ns: i64) -> bool {
        let since_ns = stream.counts.newest_arrival_ns.unwrap_or(self.begun_ns);
        stream.rule.need == StreamNeed::Always || now_ns.saturating_sub(since_ns) <= SILENCE_NS
    }

    /// The part of a stream for a frame of this stamp; `None` if it has not arrived.
    fn part(&self, stream: &Stream<T>, stamp_ns: i64) -> Option<FramePart<T>> {
        let next = stream.waiting.partition_point(|other| other.stamp_ns < stamp_ns);
        let after = stream.waiting.get(next);
        let before = next.checked_sub(1).and_then(|before| stream.waiting.get(before));
        let apart = |other: &&Stamped<T>| other.stamp_ns.saturating_sub(stamp_ns).saturating_abs();
        let nearest = [before, after].into_iter().flatten().min_by_key(apart)?;
        if !stream.rule.is_between {
            return (apart(&nearest) <= self.slop_ns).then(|| FramePart::One(nearest.clone()));
        }
        if apart(&nearest) <= NEAR_NS {
            return Some(FramePart::One(nearest.clone()));
        }
        let (before, after) = (before?, after?);
        (after.stamp_ns - before.stamp_ns <= GAP_NS).then(|| FramePart::Between(before.clone(), after.clone()))
    }

    /// The parts of a frame of this stamp; `None` if it waits for one.
    fn parts(&self, stamp_ns: i64, now_ns: i64) -> Option<Vec<FramePart<T>>> {
        let part = |stream| match self.part(stream, stamp_ns) {
            None if !self.is_awaited(stream, now_ns) => Some(FramePart::Missing),
            part => part,
        };
        self.streams.iter().map(part).collect()
    }

    /// Returns the newest complete frame, if one is complete that was not delivered. Older messages are dropped and counted.
    pub fn take(&mut self, now_ns: i64) -> Option<PairedFrame<T>> {
        let stamps: Vec<i64> = self.streams.first()?.waiting.iter().map(|message| message.stamp_ns).collect();
        let (at, stamp_ns, parts) = stamps
            .iter()
            .enumerate()
            .rev()
            .find_map(|(at, &stamp_ns)| Some((at, stamp_ns, self.parts(stamp_ns, now_ns)?)))?;
        let late = stamps.iter().take(at).filter(|&&older_ns| self.parts(older_ns, now_ns).is_some()).count();
        self.frames.late += late as u64;
        self.frames.unpaired += (at - late) as u64;
        self.frames.delivered += 1;
        for (number, stream) in self.streams.iter_mut().enumerate() {
            // A value may also be the one before the next frame.
            let keeps = |message: &Stamped<T>| match (number, stream.rule.is_between) {
                (0, _) => message.stamp_ns > stamp_ns,
                (_, true) => message.stamp_ns >= stamp_ns - GAP_NS,
                // A partner is used once.
                (_, false) => match parts.get(number) {
                    Some(FramePart::One(used)) => message.stamp_ns > used.stamp_ns,
                    _ => message.stamp_ns > stamp_ns,
                },
            };
            stream.waiting.retain(keeps);
        }
        let offset_ns = *self.offset_ns.get_or_insert(-stamp_ns);
        let time_ns = stamp_ns + offset_ns;
        self.newest_time_ns = Some(time_ns);
        Some(PairedFrame { stamp_ns, time_ns, parts })
    }

    /// Returns the counts of the streams, in their order, with their names.
    pub fn streams(&self) -> impl Iterator<Item = (&str, StreamCounts)> {
        self.streams.iter().map(|stream| (stream.rule.name.as_str(), stream.counts))
    }

    /// Returns what became of the first stream's messages.
    pub fn frames(&self) -> FrameCounts {
        self.frames
    }

    /// Returns the names of the streams for which a frame waits and that have delivered nothing since `since_ns`.
    pub fn silent(&self, since_ns: i64) -> Vec<&str> {
        let is_silent = |stream: &&Stream<T>| stream.counts.newest_arrival_ns.unwrap_or(self.begun_ns) < since_ns;
        self.streams.iter().filter(is_silent).map(|stream| stream.rule.name.as_str()).collect()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const MS: i64 = 1_000_000;
    /// When the tests take place: a clock that was set.
    const NOW: i64 = 1_800_000_000_000 * MS;

    fn rule(name: &str, need: StreamNeed, is_between: bool) -> StreamRule {
        StreamRule { name: name.to_owned(), need, is_between }
    }

    fn rgbd() -> Pairing<u32> {
        let (always, alive) = (StreamNeed::Always, StreamNeed::WhileAlive);
        let rules = vec![rule("depth", always, false), rule("colours", alive, false), rule("joints", always, true)];
        Pairing::new(rules, 16 * MS, NOW)
    }

    #[test]
    fn a_frame_has_the_nearest_image_and_the_values_around_it() {
        let mut pairing = rgbd();
        pairing.push(0, NOW, NOW, 1).unwrap();
        pairing.push(1, NOW + 9 * MS, NOW, 2).unwrap();
        assert_eq!(pairing.take(NOW), None);
        pairing.push(2, NOW - 4 * MS, NOW, 3).unwrap();
        assert_eq!(pairing.take(NOW), None, "the joints behind the stamp are on their way");
        pairing.push(2, NOW + 6 * MS, NOW, 4).unwrap();
        let frame = pairing.take(NOW).unwrap();
        let stamped = |offset_ms: i64, item| Stamped { stamp_ns: NOW + offset_ms * MS, item };
        let parts = [
            FramePart::One(stamped(0, 1)),
            FramePart::One(stamped(9, 2)),
            FramePart::Between(stamped(-4, 3), stamped(6, 4)),
        ];
        assert_eq!((frame.stamp_ns, frame.time_ns, frame.parts.as_slice()), (NOW, 0, &parts[..]));
        // The same colours belong to no second frame, the same joints may.
        pairing.push(0, NOW + 5 * MS, NOW, 5).unwrap();
        assert_eq!(pairing.take(NOW), None);
    }

    #[test]
    fn images_apart_by_more_than_the_slop_make_no_frame_and_are_counted() {
        let mut pairing = rgbd();
        for k in 0..40 {
            let stamp_ns = NOW + k * 33 * MS;
            pairing.push(0, stamp_ns, stamp_ns, 0).unwrap();
            pairing.push(1, stamp_ns + 17 * MS, stamp_ns, 0).unwrap();
            pairing.push(2, stamp_ns, stamp_ns, 0).unwrap();
            // Depth is 16 ms before the next colours.
            if k > 0 {
                assert_eq!(pairing.take(stamp_ns).map(|frame| frame.stamp_ns), Some(stamp_ns));
            }
        }
        let mut apart = rgbd();
        for k in 0..40 {
            let stamp_ns = NOW + k * 100 * MS;
            apart.push(0, stamp_ns, stamp_ns, 0).unwrap();
            apart.push(1, stamp_ns + 50 * MS, stamp_ns, 0).unwrap();
            apart.push(2, stamp_ns, stamp_ns, 0).unwrap();
            assert_eq!(apart.take(stamp_ns), None);
        }
        assert_eq!(apart.frames(), FrameCounts { delivered: 0, late: 0, unpaired: 24 });
    }

    #[test]
    fn a_slow_user_receives_the_newest_frame_and_the_rest_is_counted() {
        let mut pairing = rgbd();
        let mut got = Vec::new();
        for k in 0..30 {
            let stamp_ns = NOW + k * 33 * MS;
            pairing.push(0, stamp_ns, stamp_ns, 0).unwrap();
            // Every fifth depth image is without colours.
            if k % 5 != 0 {
                pairing.push(1, stamp_ns, stamp_ns, 0).unwrap();
            }
            pairing.push(2, stamp_ns, stamp_ns, 0).unwrap();
            if k % 10 == 9 {
                got.push((pairing.take(stamp_ns).unwrap().stamp_ns - NOW) / (33 * MS));
            }
        }
        assert_eq!(got, [9, 19, 29]);
        assert_eq!(pairing.frames(), FrameCounts { delivered: 3, late: 21, unpaired: 6 });
    }

    #[test]
    fn a_stream_that_falls_silent_is_not_waited_for_unless_nothing_goes_without_it() {
        let mut pairing = rgbd();
        let later = NOW + 1_200 * MS;
        pairing.push(0, NOW, NOW, 0).unwrap();
        pairing.push(2, NOW, NOW, 0).unwrap();
        assert_eq!(pairing.take(NOW), None);
        assert_eq!(pairing.take(later).unwrap().parts[1], FramePart::Missing);
        pairing.push(0, later, later, 0).unwrap();
        assert_eq!(pairing.take(later), None);
        assert_eq!(pairing.silent(NOW + 1), ["colours", "joints"]);
    }

    #[test]
    fn stamps_that_are_zero_double_or_run_back_are_refused_in_words() {
        let mut pairing = rgbd();
        assert_eq!(pairing.push(0, 0, NOW, 0), Err(StampFault::Zero));
        assert_eq!(pairing.push(0, -5, NOW, 0), Err(StampFault::Zero));
        assert_eq!(pairing.push(0, NOW, NOW, 0), Ok(()));
        assert_eq!(pairing.push(0, NOW, NOW, 0), Err(StampFault::Backwards));
        assert_eq!(pairing.push(0, NOW - 20 * MS, NOW, 0), Err(StampFault::Backwards));
        let (name, counts) = pairing.streams().next().unwrap();
        assert_eq!((name, counts.received, counts.refused), ("depth", 5, 4));
        for fault in [StampFault::Zero, StampFault::Backwards, StampFault::Jump, StampFault::Future, StampFault::Past] {
            assert!(!fault.to_string().contains('\n'));
        }
    }

    #[test]
    fn stamps_of_another_clock_are_used_with_a_warning() {
        let mut pairing = rgbd();
        for (k, ahead_ns) in [(0, 5_000 * MS), (1, 5_000 * MS)] {
            let stamp_ns = NOW + ahead_ns + k * 33 * MS;
            assert_eq!(pairing.push(0, stamp_ns, NOW, 0), Err(StampFault::Future));
            let _ = pairing.push(1, stamp_ns, NOW, 0);
            let _ = pairing.push(2, stamp_ns, NOW, 0);
            assert_eq!(pairing.take(NOW).map(|frame| frame.time_ns), Some(k * 33 * MS));
        }
        // A simulator counts from its start.
        assert_eq!(rgbd().push(0, 12 * MS, NOW, 0), Err(StampFault::Past));
    }

    #[test]
    fn time_goes_on_when_a_recording_begins_anew() {
        let mut pairing = rgbd();
        let mut times_ms = Vec::new();
        for round in 0..2 {
            for k in 0..100 {
                let stamp_ns = NOW + k * 33 * MS;
                for stream in 0..3 {
                    let pushed = pairing.push(stream, stamp_ns, NOW, 0);
                    if round == 1 && k == 0 {
                        assert_eq!(pushed, Err(StampFault::Jump));
                    }
                }
                times_ms.extend(pairing.take(NOW).map(|frame| frame.time_ns / MS));
            }
        }
        assert_eq!(times_ms, (0..200).map(|k| k * 33).collect::<Vec<_>>());
    }

    proptest! {
        /// Any order of any stamps: frames have rising times, each image is used once, nothing grows, and nothing is lost from the counts.
        #[test]
        fn any_messages_keep_the_bounds(messages in prop::collection::vec((0usize..3, 0i64..3_000, any::<bool>()), 0..400)) {
            let mut pairing = rgbd();
            let (mut last_ns, mut depths) = (-1, 0);
            for (stream, stamp_ms, takes) in messages {
                let used = !matches!(
                    pairing.push(stream, NOW + stamp_ms * MS, NOW, 0),
                    Err(StampFault::Zero | StampFault::Backwards)
                );
                depths += u64::from(used && stream == 0);
                if takes && let Some(frame) = pairing.take(NOW) {
                    prop_assert!(frame.time_ns > last_ns, "{} after {last_ns}", frame.time_ns);
                    last_ns = frame.time_ns;
                    for part in &frame.parts {
                        if let FramePart::One(one) = part {
                            prop_assert!((one.stamp_ns - frame.stamp_ns).abs() <= 16 * MS);
                        }
                    }
                }
                prop_assert!(pairing.streams.iter().all(|stream| stream.waiting.len() <= MOST_VALUES));
            }
            let FrameCounts { delivered, late, unpaired } = pairing.frames();
            prop_assert!(delivered + late + unpaired <= depths);
        }
    }
}
