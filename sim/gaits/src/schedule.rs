//! Schedules: controllers that follow one another in an episode, and the tilt of the palm between them.
//!
//! Controllers need the palm at different tilts. The arm tilts the hand, and the cameras move with the base of the hand;
//! in the world, whose axes follow the palm, gravity turns.

use mvt_robot::hand::JointAngles;
use nalgebra::Vector3;
use serde::Serialize;

use crate::gait::Gait;

/// Least duration of a part, seconds. The change to a controller takes two.
pub const SHORTEST_PART_S: f64 = 3.0;

/// Controller of a schedule.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScheduledGait {
    /// The motion.
    pub gait: Gait,
    /// Time from the change to this controller to the next change, seconds; at least [`SHORTEST_PART_S`].
    pub duration_s: f64,
}

/// Controllers that follow one another; after the last the first follows. Without parts, an episode keeps its controller.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Schedule(Vec<ScheduledGait>);

impl Schedule {
    /// Returns the schedule of these parts.
    pub fn new(parts: Vec<ScheduledGait>) -> Self {
        Self(parts)
    }

    /// Returns whether the controller never changes.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the number of changes from the start of an episode until a time, seconds.
    pub fn changes_until(&self, time_s: f64) -> usize {
        /// Less than a step of an episode.
        const ROUNDING_S: f64 = 1e-6;
        let cycle: f64 = self.0.iter().map(|part| part.duration_s).sum();
        if cycle < SHORTEST_PART_S {
            return 0;
        }
        let cycles = ((time_s + ROUNDING_S) / cycle).floor();
        let mut left = time_s + ROUNDING_S - cycles * cycle;
        let within = self.0.iter().take_while(|part| {
            left -= part.duration_s;
            left >= 0.0
        });
        cycles as usize * self.0.len() + within.count()
    }

    /// Returns the controller after so many changes; `None` without parts.
    pub fn gait_after(&self, changes: usize) -> Option<&Gait> {
        self.0.get(changes % self.0.len().max(1)).map(|part| &part.gait)
    }
}

// Why: notes/decisions/simulation.md, "Between two controllers the hand opens and the palm is levelled".
/// Turn of gravity during a change: the palm is levelled, so that the open hand keeps the object, and then tilted as the
/// next controller needs it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TiltChange {
    /// Gravity before, m/s^2.
    pub from: [f64; 3],
    /// Gravity afterwards, m/s^2.
    pub to: [f64; 3],
}

/// Times since the beginning of a change, seconds: the palm is level, the fingers begin to close and the palm to tilt, and
/// the palm has its new tilt.
const LEVEL_S: f64 = 0.6;
pub(crate) const CLOSING_AT_S: f64 = 1.0;
const TILTED_S: f64 = 2.0;

impl TiltChange {
    /// Returns gravity at a time since the beginning of the change, m/s^2.
    pub fn gravity(&self, elapsed_s: f64) -> [f64; 3] {
        let [from, to] = [self.from, self.to].map(Vector3::from);
        let level = Vector3::new(0.0, 0.0, -to.norm());
        let direction = if elapsed_s < CLOSING_AT_S {
            from.lerp(&level, smooth(elapsed_s / LEVEL_S))
        } else {
            level.lerp(&to, smooth((elapsed_s - CLOSING_AT_S) / (TILTED_S - CLOSING_AT_S)))
        };
        (direction * (to.norm() / direction.norm().max(f64::MIN_POSITIVE))).into()
    }

    /// Returns whether the palm has its new tilt at this time since the beginning, seconds.
    pub fn is_over(elapsed_s: f64) -> bool {
        elapsed_s >= TILTED_S
    }
}

/// Returns a smooth ramp from 0 to 1.
pub(crate) fn smooth(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Interpolates between targets; `t` is from 0 to 1.
pub(crate) fn blend(from: &[f64], to: &[f64], t: f64) -> JointAngles {
    from.iter().zip(to).map(|(from, to)| from * (1.0 - t) + to * t).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gait;

    #[test]
    fn parts_follow_one_another_in_a_circle() {
        let part = |name: &str, duration_s: f64| {
            let (_, gait) = gait::find(name).unwrap();
            ScheduledGait { gait: gait.clone(), duration_s }
        };
        let schedule = Schedule::new(vec![part("bal", 4.0), part("low", 3.0), part("cube", 3.0)]);
        let changes = [0.0, 3.99, 4.0, 7.0, 9.99, 10.0, 14.0, 25.0].map(|time_s| schedule.changes_until(time_s));
        assert_eq!(changes, [0, 0, 1, 2, 2, 3, 4, 7]);
        assert_eq!(schedule.gait_after(4), Some(gait::find("low").unwrap().1));
        assert_eq!((Schedule::default().changes_until(9.0), Schedule::default().gait_after(0)), (0, None));
    }

    #[test]
    fn the_palm_tilts_smoothly_over_level() {
        let [from, to] = ["cube", "tumble_back"].map(|name| gait::find(name).unwrap().1.gravity);
        let tilt = TiltChange { from, to };
        let at = |k: u32| Vector3::from(tilt.gravity(f64::from(k) / 300.0));
        assert!((at(0) - Vector3::from(from)).norm() < 1e-2 && (at(600) - Vector3::from(to)).norm() < 1e-12);
        assert!(at(250).xy().norm() < 1e-12);
        for k in 0..600 {
            // At most 1.5 times the mean rate over 0.6 s.
            assert!(at(k).angle(&at(k + 1)) < 1.6 * 0.45 / 180.0, "{k}");
            assert!((at(k).norm() - Vector3::from(to).norm()).abs() < 1e-9);
        }
    }
}
