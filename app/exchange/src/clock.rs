//! Times of the messages of several sensors, brought to one clock and to the frames of a log.

use nalgebra::Isometry3;

/// Sensors whose clocks differ by less are on one clock, and the difference is the time of transport, nanoseconds.
const ONE_CLOCK_NS: i64 = 250_000_000;
/// A clock that deviates by more from its usual distance to the recording's clock jumps, nanoseconds.
const JUMP_NS: i64 = 500_000_000;
/// A frame takes the nearest message if it is not farther than this share of the time between two messages.
const REACH: f64 = 0.75;

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

    /// Returns the usual difference between the times of recording and those that are stated, and whether the stated times jump.
    fn offset(&self) -> (i64, bool) {
        let delays: Vec<i64> = self.recorded.iter().zip(&self.stated).map(|(r, s)| r.saturating_sub(*s)).collect();
        let offset = median(delays.clone());
        let jumps = delays.iter().any(|delay| delay.abs_diff(offset) > JUMP_NS as u64);
        (offset, jumps)
    }

    /// Brings the times to the clock of `reference`.
    pub fn aligned(&self, reference: &Self) -> Aligned {
        let ((offset, jumps), (reference_offset, reference_jumps)) = (self.offset(), reference.offset());
        let base = if reference_jumps { 0 } else { reference_offset };
        if jumps {
            return Aligned {
                times: self.recorded.iter().map(|t| t.saturating_sub(base)).collect(),
                shift: base,
                jumps,
            };
        }
        let distance = offset.saturating_sub(base);
        let shift = if distance.abs() < ONE_CLOCK_NS { 0 } else { distance };
        Aligned { times: self.stated.iter().map(|t| t.saturating_add(shift)).collect(), shift, jumps }
    }
}

/// Times of a channel on the clock of another.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Aligned {
    /// Nanoseconds.
    pub times: Vec<i64>,
    /// Offset that was added to the stated times, nanoseconds.
    pub shift: i64,
    /// Whether the stated times jump, so that those of recording were taken.
    pub jumps: bool,
}

impl Aligned {
    /// Returns the usual time between two messages, nanoseconds; 0 of a single one.
    pub fn period(&self) -> i64 {
        median(self.times.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect())
    }

    /// Returns whether the times never decrease.
    pub fn is_sorted(&self) -> bool {
        self.times.is_sorted()
    }
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
    match (after > 0 && near(before), near(after)) {
        (true, true) => {
            let (first, second) = (*times.get(before)?, *times.get(after)?);
            Some((before, after, at.abs_diff(first) as f64 / second.abs_diff(first) as f64))
        }
        (true, false) => Some((before, before, 0.0)),
        (false, true) => Some((after, after, 0.0)),
        (false, false) => None,
    }
}

/// Returns numbers at a time, linearly between two readings; `None` farther than `reach` from all.
pub(crate) fn numbers_at<const N: usize>(times: &[i64], values: &[[f64; N]], at: i64, reach: i64) -> Option<[f64; N]> {
    let (first, second, weight) = around(times, at, reach)?;
    let (a, b) = (values.get(first)?, values.get(second)?);
    Some(std::array::from_fn(|k| if first == second { a[k] } else { a[k] + weight * (b[k] - a[k]) }))
}

/// As [`numbers_at`], for a pose.
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

    #[test]
    fn another_clock_is_shifted_and_the_time_of_transport_is_not() {
        let camera = stamps(&[(100_030, 100_000), (100_063, 100_033), (100_096, 100_066)]);
        // The same clock, with less delay.
        let joints = stamps(&[(100_005, 100_004), (100_015, 100_014)]);
        assert_eq!(joints.aligned(&camera).times, [100_004 * MS as i64, 100_014 * MS as i64]);
        // A clock that began with its device, 99.9 s later, with some jitter in transport.
        let touch = stamps(&[(100_010, 110), (100_028, 126), (100_042, 142)]);
        let aligned = touch.aligned(&camera);
        assert_eq!(aligned.shift, 99_870 * MS as i64);
        assert_eq!(aligned.times, [99_980, 99_996, 100_012].map(|ms| ms * MS as i64));
        assert_eq!(aligned.period(), 16 * MS as i64);
    }

    #[test]
    fn a_clock_that_jumps_is_replaced_by_that_of_the_recording() {
        let camera = stamps(&[(1000, 1000), (1033, 1033)]);
        let touch = stamps(&[(1001, 500), (1034, 533), (1067, 5_000_566), (1100, 5_000_600)]);
        let aligned = touch.aligned(&camera);
        assert!(aligned.jumps && aligned.is_sorted());
        assert_eq!(aligned.times, [1001, 1034, 1067, 1100].map(|ms| ms * MS as i64));
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
        let values = [[0.0], [1.0], [3.0], [4.0]];
        assert_eq!(numbers_at(&times, &values, 100, 75), Some([1.0]));
        assert_eq!(numbers_at(&times, &values, 150, 75), Some([2.0]));
        assert_eq!(numbers_at(&times, &values, 250, 75), Some([3.0]), "the next reading is too far");
        assert_eq!(numbers_at(&times, &values, 600, 75), None);
        assert_eq!(numbers_at(&times, &values, -50, 75), Some([0.0]));
        assert_eq!(numbers_at::<1>(&[], &[], 0, 75), None);
        let turned = |angle| Isometry3::rotation(nalgebra::Vector3::z() * angle);
        let half = pose_at(&[0, 100], &[turned(0.0), turned(1.0)], 50, 75).unwrap();
        assert!(half.rotation.angle_to(&turned(0.5).rotation) < 1e-12);
    }
}
