//! Times of the messages of several sensors, brought to one clock and to the frames of a log.

use nalgebra::Isometry3;

// Why: notes/decisions/exchange.md, "Clocks are compared by the median of recording time less stated time".
/// Sensors whose clocks differ by less are on one clock, and the difference is the time of transport, nanoseconds.
const ONE_CLOCK_NS: i64 = 250_000_000;
/// A message whose time deviates by more from its neighbours' distance to the recording's clock has a wrong time, nanoseconds.
const WRONG_NS: u64 = 500_000_000;
/// A clock whose distance to the recording's clock changes by more at once was set, nanoseconds.
const SET_NS: u64 = 250_000_000;
/// Most and fewest messages on each side of a message to which its distance is compared.
const NEAR: usize = 10;
const FEWEST: usize = 2;
/// Times are a clock's if at most one of so many messages repeats a time.
const REPEATS: usize = 20;
/// A clock that runs slower than this share of another one counts in another unit.
const OTHER_UNIT: f64 = 0.02;
/// A frame takes the nearest message if it is not farther than this share of the time between two messages.
const REACH: f64 = 0.75;
/// Values are interpolated over gaps of this multiple of the reach: one lost message.
const GAP: i64 = 3;

/// Times of the messages of a channel, nanoseconds.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Stamps {
    /// When each message was recorded.
    recorded: Vec<i64>,
    /// The stated time of each message; 0 if it states none.
    stated: Vec<i64>,
}

impl Stamps {
    /// Bytes that a message takes here.
    pub const SIZE: u64 = 16;

    pub fn push(&mut self, recorded_ns: u64, stated_ns: u64) {
        let signed = |ns| i64::try_from(ns).unwrap_or(i64::MAX);
        self.recorded.push(signed(recorded_ns));
        self.stated.push(signed(stated_ns));
    }

    pub fn len(&self) -> usize {
        self.recorded.len()
    }

    /// Returns whether a message with these times belongs to the last one.
    pub fn is_last(&self, recorded_ns: u64, stated_ns: u64) -> bool {
        let is = |list: &[i64], ns: u64| list.last().is_some_and(|last| i64::try_from(ns) == Ok(*last));
        is(&self.stated, stated_ns) && (stated_ns > 0 || is(&self.recorded, recorded_ns))
    }

    /// Chooses the clock of the channel.
    ///
    /// # Errors
    /// A sentence if no clock tells the messages apart.
    pub fn judge(&self) -> Result<Judged, String> {
        let count = self.len();
        let different = [different(&self.stated), different(&self.recorded)];
        let is_clock = |different: usize| different > 1 && (count - different) <= (count / REPEATS).max(1);
        let [is_stated, is_recorded] = different.map(|times| is_clock(times) || count < 2);
        if different.iter().all(|times| *times < 2) && count > 1 {
            return Err(format!("its {count} messages have one and the same time"));
        }
        if !is_stated && (is_recorded || different[1] > different[0]) {
            let what = if self.stated.iter().all(|time| *time == 0) {
                format!("its {count} messages state no time")
            } else {
                format!("its {count} messages state only {} different times", different[0])
            };
            return Ok(self.recorded(&what));
        }
        let speeds = [self.speed(), self.speed_of_steps()];
        if is_recorded && speeds.iter().all(|speed| speed.is_some_and(|speed| speed < OTHER_UNIT)) {
            return Ok(self.recorded("its own times are in another unit"));
        }
        // Recordings that were converted have the times of the conversion.
        let is_compressed = speeds.iter().all(|speed| speed.is_none_or(|speed| speed > 1.0 / OTHER_UNIT));
        if (count > 1 && different[1] < 2) || (count > FEWEST && is_compressed) {
            return Ok(Judged { times: self.stated.clone(), offset: None, is_recorded: false, note: None });
        }
        if self.drifts() {
            return Ok(self.stated(self.stated.clone(), None));
        }
        if is_recorded && self.is_coarse() {
            return Ok(self.recorded("its own times are rounded"));
        }
        Ok(self.without_steps())
    }

    fn recorded(&self, why: &str) -> Judged {
        let note = Some(format!("{why}: the times of recording are used"));
        Judged { times: self.recorded.clone(), offset: Some(0), is_recorded: true, note }
    }

    fn stated(&self, times: Vec<i64>, note: Option<String>) -> Judged {
        let offset = median(self.recorded.iter().zip(&times).map(|(r, s)| r.saturating_sub(*s)).collect());
        Judged { times, offset: Some(offset), is_recorded: false, note }
    }

    /// Returns how fast the stated times run, by the middle of the messages; `None` if the times of recording stand still.
    fn speed(&self) -> Option<f64> {
        let span = |times: &[i64]| {
            let mut times = times.to_vec();
            times.sort_unstable();
            let tenth = times.len() / 10;
            let (first, last) = (times.get(tenth)?, times.get(times.len().checked_sub(tenth + 1)?)?);
            Some(last.saturating_sub(*first) as f64)
        };
        let (stated, recorded) = (span(&self.stated)?, span(&self.recorded)?);
        (recorded > 0.0).then(|| stated / recorded)
    }

    /// Returns the same by the usual time between two messages.
    fn speed_of_steps(&self) -> Option<f64> {
        let step = |times: &[i64]| {
            let mut times = times.to_vec();
            times.sort_unstable();
            period(&times) as f64
        };
        let recorded = step(&self.recorded);
        (recorded > 0.0).then(|| step(&self.stated) / recorded)
    }

    /// Returns whether the stated times run evenly at another speed, as those of a recording that was played do.
    fn drifts(&self) -> bool {
        let Some(speed) = self.speed().filter(|speed| (speed - 1.0).abs() > 0.1) else { return false };
        let (stated, recorded) = (median(self.stated.clone()), median(self.recorded.clone()));
        let deviation =
            |(r, s): (&i64, &i64)| (s.saturating_sub(stated) as f64 - speed * r.saturating_sub(recorded) as f64).abs();
        let span = self.stated.iter().map(|s| s.abs_diff(stated)).max().unwrap_or(0) as f64;
        let even = self.recorded.iter().zip(&self.stated).filter(|pair| deviation(*pair) < 0.05 * span).count();
        even * 10 >= self.len() * 9
    }

    /// Returns whether the stated times are rounded to seconds or tenths, and those of recording are not.
    fn is_coarse(&self) -> bool {
        let delays = || self.recorded.iter().zip(&self.stated).map(|(r, s)| r.saturating_sub(*s));
        let (least, most) = (delays().min().unwrap_or(0), delays().max().unwrap_or(0));
        let is_rounded =
            |unit: i64| self.stated.iter().all(|time| time % unit == 0) && most.saturating_sub(least) > unit / 4;
        self.len() > FEWEST && [1_000_000_000, 100_000_000].into_iter().any(is_rounded)
    }

    /// Returns the stated times, or those of recording if the clock was set between two messages. Single wrong times are replaced.
    fn without_steps(&self) -> Judged {
        let mut order: Vec<usize> = (0..self.len()).collect();
        order.sort_by_key(|&k| self.recorded.get(k));
        let sorted = |times: &[i64]| order.iter().filter_map(|&k| times.get(k).copied()).collect::<Vec<i64>>();
        let (recorded, stated) = (sorted(&self.recorded), sorted(&self.stated));
        let delays: Vec<i64> = recorded.iter().zip(&stated).map(|(r, s)| r.saturating_sub(*s)).collect();
        let usual =
            |from: usize, to: usize| median(delays.get(from..to.min(delays.len())).unwrap_or_default().to_vec());
        let noise = median(delays.windows(2).map(|pair| pair[1].saturating_sub(pair[0]).saturating_abs()).collect());
        for k in FEWEST..delays.len().saturating_sub(FEWEST - 1) {
            let step = usual(k.saturating_sub(NEAR), k).abs_diff(usual(k, k + NEAR));
            let back = stated[k - 1].saturating_sub(stated[k]);
            let least =
                recorded[k].abs_diff(recorded[k - 1]).max(3 * noise.unsigned_abs()).max((back / 2).unsigned_abs());
            let goes_back = back > 0 && step > least;
            let is_here = delays[k].abs_diff(delays[k - 1]) > step / 2 && (step > SET_NS || goes_back);
            // Messages that were recorded late, and together, come back to the usual distance.
            if is_here && usual(0, k).abs_diff(usual(k, delays.len())) > step / 2 {
                return self.recorded(&format!("its clock jumps by {:.2} s", step as f64 / 1e9));
            }
        }
        let (mut times, mut replaced) = (self.stated.clone(), 0);
        for (k, (&place, &delay)) in order.iter().zip(&delays).enumerate() {
            let near = usual(k.saturating_sub(NEAR), k + NEAR);
            let is_between =
                k > 0 && stated[k - 1] <= stated[k] && stated.get(k + 1).is_some_and(|next| stated[k] <= *next);
            if delay.abs_diff(near) > WRONG_NS && !is_between && self.len() > FEWEST {
                replaced += 1;
                if let Some(time) = times.get_mut(place) {
                    *time = recorded[k].saturating_sub(near);
                }
            }
        }
        let note = (replaced > 0).then(|| {
            format!(
                "{replaced} of {} messages state no time or a wrong one: the time of recording is used for them",
                self.len()
            )
        });
        self.stated(times, note)
    }
}

/// Returns the number of different values.
fn different(times: &[i64]) -> usize {
    times.iter().collect::<std::collections::HashSet<_>>().len()
}

/// The times of a channel by the clock that was chosen for it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Judged {
    /// Nanoseconds.
    times: Vec<i64>,
    /// Usual distance of the recording's clock; `None` if that stands still.
    offset: Option<i64>,
    /// Whether they are the times of recording.
    is_recorded: bool,
    /// The replaced times, in a sentence.
    pub note: Option<String>,
}

impl Judged {
    /// Brings the times to the clock of `reference`.
    pub fn aligned(&self, reference: &Self) -> Aligned {
        let base = reference.offset.unwrap_or(0);
        let shift = match self.offset {
            // The reference's times are those of recording without the time of its transport.
            Some(_) if self.is_recorded => base.saturating_neg(),
            Some(offset) if reference.offset.is_some() => {
                let distance = offset.saturating_sub(base);
                if distance.abs() < ONE_CLOCK_NS { 0 } else { distance }
            }
            _ => 0,
        };
        let times: Vec<i64> = self.times.iter().map(|time| time.saturating_add(shift)).collect();
        let mut latest = i64::MIN;
        let out_of_order = times.iter().filter(|time| {
            let is_late = **time < latest;
            latest = latest.max(**time);
            is_late
        });
        let out_of_order = out_of_order.count();
        let mut order: Vec<usize> = (0..times.len()).collect();
        order.sort_by_key(|&k| times.get(k));
        let times = order.iter().filter_map(|&k| times.get(k).copied()).collect();
        Aligned { times, order, shift, out_of_order }
    }
}

/// Times of a channel on the clock of another, in their order.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Aligned {
    /// Nanoseconds.
    pub times: Vec<i64>,
    /// The number of each message in the channel.
    pub order: Vec<usize>,
    /// Offset that was added to the channel's times, nanoseconds.
    pub shift: i64,
    /// Messages that come after a later one.
    pub out_of_order: usize,
}

impl Aligned {
    /// Returns the usual time between two messages, nanoseconds; 0 of a single one.
    pub fn period(&self) -> i64 {
        period(&self.times)
    }
}

/// Returns the usual time between two of these times, nanoseconds; 0 of a single one.
pub(crate) fn period(times: &[i64]) -> i64 {
    median(times.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect())
}

fn median(mut values: Vec<i64>) -> i64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0 } else { *values.select_nth_unstable(middle).1 }
}

/// Returns how far a message may be from a frame, with these usual times between frames and between messages.
pub(crate) fn reach(frames_ns: i64, messages_ns: i64) -> i64 {
    (REACH * frames_ns.max(messages_ns) as f64) as i64
}

/// Returns the message of each frame: the nearest one within reach. A message serves only the frame to which it is nearest, so that nothing
/// old is shown twice. Both lists increase.
pub(crate) fn nearest(frames: &[i64], messages: &[i64], reach: i64) -> Vec<Option<usize>> {
    let mut chosen: Vec<Option<usize>> = Vec::with_capacity(frames.len());
    let mut next = 0;
    let distance = |frame: usize, message: usize| match (frames.get(frame), messages.get(message)) {
        (Some(frame), Some(message)) => frame.abs_diff(*message),
        _ => u64::MAX,
    };
    for frame in 0..frames.len() {
        while next + 1 < messages.len() && distance(frame, next + 1) <= distance(frame, next) {
            next += 1;
        }
        let mut message = (distance(frame, next) <= reach as u64).then_some(next);
        let rival = chosen.last().copied().flatten();
        if message.is_some() && rival == message {
            if distance(frame - 1, next) <= distance(frame, next) {
                message = None;
            } else if let Some(last) = chosen.last_mut() {
                *last = None;
            }
        }
        chosen.push(message);
    }
    chosen
}

/// Returns the two values around a time with the weight of the second one; `None` farther than `reach` from all. Times increase.
fn around(times: &[i64], at: i64, reach: i64) -> Option<(usize, usize, f64)> {
    let after = times.partition_point(|&time| time < at);
    let before = after.saturating_sub(1);
    let near = |k: usize| times.get(k).is_some_and(|time| time.abs_diff(at) <= reach as u64);
    if times.get(after) == Some(&at) {
        return Some((after, after, 0.0));
    }
    if let (true, Some(first), Some(second)) = (after > 0, times.get(before), times.get(after))
        && ((near(before) && near(after)) || second.abs_diff(*first) <= reach.saturating_mul(GAP) as u64)
    {
        return Some((before, after, at.abs_diff(*first) as f64 / second.abs_diff(*first) as f64));
    }
    match (after > 0 && near(before), near(after)) {
        (true, _) => Some((before, before, 0.0)),
        (false, true) => Some((after, after, 0.0)),
        (false, false) => None,
    }
}

/// Returns a number at a time, linearly between two readings; `None` farther than `reach` from all.
pub(crate) fn number_at(times: &[i64], values: &[f64], at: i64, reach: i64) -> Option<f64> {
    let (first, second, weight) = around(times, at, reach)?;
    let (a, b) = (values.get(first)?, values.get(second)?);
    Some(if first == second { *a } else { a + weight * (b - a) })
}

/// As [`number_at`], for a pose.
pub(crate) fn pose_at(times: &[i64], values: &[Isometry3<f64>], at: i64, reach: i64) -> Option<Isometry3<f64>> {
    let (first, second, weight) = around(times, at, reach)?;
    let (a, b) = (values.get(first)?, values.get(second)?);
    if first == second { Some(*a) } else { a.try_lerp_slerp(b, weight, 1e-9) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn stamps(pairs: &[(u64, u64)]) -> Stamps {
        let mut stamps = Stamps::default();
        pairs.iter().for_each(|&(recorded, stated)| stamps.push(recorded * MS, stated * MS));
        stamps
    }

    fn aligned(stamps: &Stamps, reference: &Stamps) -> Aligned {
        stamps.judge().unwrap().aligned(&reference.judge().unwrap())
    }

    #[test]
    fn another_clock_is_shifted_and_the_time_of_transport_is_not() {
        let camera = stamps(&[(100_030, 100_000), (100_063, 100_033), (100_096, 100_066)]);
        // The same clock, with less delay.
        let joints = stamps(&[(100_005, 100_004), (100_015, 100_014)]);
        assert_eq!(aligned(&joints, &camera).times, [100_004 * MS as i64, 100_014 * MS as i64]);
        // A clock that began with its device, 99.9 s later, with some jitter in transport.
        let touch = stamps(&[(100_010, 110), (100_028, 126), (100_042, 142)]);
        let aligned = aligned(&touch, &camera);
        assert_eq!(aligned.shift, 99_870 * MS as i64);
        assert_eq!(aligned.times, [99_980, 99_996, 100_012].map(|ms| ms * MS as i64));
        assert_eq!(aligned.period(), 16 * MS as i64);
    }

    #[test]
    fn a_clock_that_jumps_is_replaced_by_that_of_the_recording() {
        let camera = stamps(&[(1000, 1000), (1033, 1033)]);
        let touch = stamps(&[(1001, 500), (1034, 533), (1067, 5_000_566), (1100, 5_000_600)]);
        let aligned = aligned(&touch, &camera);
        assert_eq!(aligned.times, [1001, 1034, 1067, 1100].map(|ms| ms * MS as i64));
    }

    /// Times of 90 messages that are recorded every 33 ms, 5 ms after the stated time.
    fn stated(time: impl Fn(u64) -> u64) -> Stamps {
        let mut stamps = Stamps::default();
        (0..90).for_each(|k| stamps.push((1_700_000_000_000 + 33 * k + 5) * MS, time(1_700_000_000_000 + 33 * k) * MS));
        stamps
    }

    #[test]
    fn times_that_are_no_clock_give_way_to_those_of_recording() {
        let good = stated(|ms| ms);
        let judged = |stamps: &Stamps| stamps.judge().unwrap();
        assert_eq!((judged(&good).is_recorded, &judged(&good).note), (false, &None));
        for (what, stamps, said) in [
            ("none", stated(|_| 0), "its 90 messages state no time"),
            ("constant", stated(|_| 1_700_000_000_000), "only 1 different times"),
            ("seconds", stated(|ms| ms / 1000 * 1000), "only 3 different times"),
            ("another unit", stated(|ms| ms / 1000), "only 3 different times"),
            ("nanoseconds alone", stated(|ms| ms % 1000), "jumps by 1.00 s"),
            ("set back", stated(|ms| if ms < 1_700_000_001_000 { ms } else { ms - 300 }), "jumps by 0.30 s"),
            ("set forward", stated(|ms| if ms < 1_700_000_001_000 { ms } else { ms + 300 }), "jumps by 0.30 s"),
            ("set back a little", stated(|ms| if ms < 1_700_000_001_000 { ms } else { ms - 80 }), "jumps by 0.08 s"),
        ] {
            let judged = judged(&stamps);
            let note = judged.note.clone().unwrap_or_default();
            assert!(judged.is_recorded && note.contains(said), "{what}: {judged:?}");
            let aligned = judged.aligned(&good.judge().unwrap());
            let expected = (0..90).map(|k| (1_700_000_000_000 + 33 * k) * MS as i64);
            assert!(aligned.times.iter().copied().eq(expected), "{what}");
        }
        let mut units = Stamps::default();
        (0..20).for_each(|k| units.push((1_700_000_000_000 + 33 * k) * MS, 1_700_000_000_000_000 + 33_000 * k));
        assert!(judged(&units).note.unwrap().contains("another unit"));
        // One message in five seconds, stated in whole seconds.
        let mut rounded = Stamps::default();
        (0..9).for_each(|k| rounded.push((5_000_000 + 5_130 * k) * MS, (5_000_000 + 5_130 * k) / 1000 * 1000 * MS));
        assert!(judged(&rounded).note.unwrap().contains("rounded"));
        let mut same = Stamps::default();
        (0..9).for_each(|_| same.push(0, 7));
        assert!(same.judge().unwrap_err().contains("one and the same time"));
    }

    #[test]
    fn times_of_recording_that_are_no_clock_do_not_matter() {
        let own = |recorded: &dyn Fn(u64) -> u64| {
            let mut stamps = Stamps::default();
            (0..90).for_each(|k| stamps.push(recorded(k), (2_000 + 33 * k) * MS));
            stamps
        };
        for (what, stamps) in [
            ("none", own(&|_| 0)),
            ("written at once", own(&|k| 1_700_000_000 * 1000 * MS + k)),
            ("played at double speed", own(&|k| (1_700_000_000 * 1000 + 16 * k) * MS)),
            ("a burst", own(&|k| (1_700_000_000 * 1000 + 33 * k.max(if k > 40 { 62 } else { 0 })) * MS)),
        ] {
            let aligned = aligned(&stamps, &stamps);
            assert!(
                aligned.times.iter().copied().eq((0..90).map(|k| (2_000 + 33 * k) * MS as i64)),
                "{what}: {aligned:?}"
            );
        }
    }

    #[test]
    fn messages_that_take_long_to_be_recorded_keep_their_times() {
        let mut late = Stamps::default();
        // Each takes 0 to 60 ms, so that they overtake one another.
        (0..90).for_each(|k| late.push((1_700_000_000_000 + 33 * k + k * k * 7919 % 61) * MS, (2_000 + 33 * k) * MS));
        let judged = late.judge().unwrap();
        assert!(!judged.is_recorded && judged.note.is_none(), "{judged:?}");
    }

    #[test]
    fn single_wrong_times_are_replaced_and_swapped_messages_are_sorted() {
        let wrong = stated(|ms| if ms == 1_700_000_000_330 { 0 } else { ms });
        let judged = wrong.judge().unwrap();
        assert!(judged.note.as_ref().unwrap().starts_with("1 of 90 messages"), "{judged:?}");
        let good = stated(|ms| ms);
        assert_eq!(judged.aligned(&judged).times, aligned(&good, &good).times);
        let swapped = stated(|ms| match ms {
            1_700_000_000_330 => ms + 33,
            1_700_000_000_363 => ms - 33,
            _ => ms,
        });
        let sorted = aligned(&swapped, &swapped);
        assert_eq!((sorted.out_of_order, &sorted.times), (1, &aligned(&good, &good).times));
        assert_eq!(sorted.order[9..13], [9, 11, 10, 12]);
    }

    #[test]
    fn a_message_serves_the_frame_to_which_it_is_nearest() {
        let frames = [0, 10, 20, 30, 40, 50];
        // Equal times, a slower sensor, a faster one, a gap.
        assert_eq!(nearest(&frames, &frames, 7), [0, 1, 2, 3, 4, 5].map(Some));
        assert_eq!(nearest(&frames, &[1, 21, 41], 15), [Some(0), None, Some(1), None, Some(2), None]);
        assert_eq!(nearest(&frames, &[0, 4, 9, 14, 19, 24, 29, 34, 39, 44, 49], 7), [0, 2, 4, 6, 8, 10].map(Some));
        assert_eq!(nearest(&frames, &[0, 11, 50], 7), [Some(0), Some(1), None, None, None, Some(2)]);
        assert_eq!(nearest(&frames, &[19], 15), [None, None, Some(0), None, None, None]);
        assert_eq!(nearest(&frames, &[0, 0, 0, 10], 7)[..2], [Some(2), Some(3)], "equal times");
        assert_eq!(nearest(&frames, &[], 7), [None; 6]);
    }

    #[test]
    fn joints_are_interpolated_between_readings() {
        let times = [0, 100, 200, 1000];
        let values = [0.0, 1.0, 3.0, 4.0];
        assert_eq!(number_at(&times, &values, 100, 75), Some(1.0));
        assert_eq!(number_at(&times, &values, 150, 75), Some(2.0));
        assert_eq!(number_at(&times, &values, 250, 75), Some(3.0), "the next reading is too far");
        assert_eq!(number_at(&times, &values, 600, 75), None);
        assert_eq!(number_at(&times, &values, -50, 75), Some(0.0));
        assert_eq!(number_at(&[0, 200], &[0.0, 1.0], 100, 75), Some(0.5), "one reading is lost");
        assert_eq!(number_at(&[], &[], 0, 75), None);
        let turned = |angle| Isometry3::rotation(nalgebra::Vector3::z() * angle);
        let half = pose_at(&[0, 100], &[turned(0.0), turned(1.0)], 50, 75).unwrap();
        assert!(half.rotation.angle_to(&turned(0.5).rotation) < 1e-12);
    }
}
