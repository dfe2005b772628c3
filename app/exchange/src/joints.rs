//! Joint angles of a source in the hand's order.

use std::f64::consts::PI;

use mvt_robot::hand::{Hand, JointAngles, JointMotion};

/// Greatest absolute angle of a hand whose joints reach two thirds of it at most, radians. Wrong units exceed it.
const LARGEST_RAD: f64 = PI;
/// Angles beyond a joint's range by more are those of another joint or unit, radians, or metres of a sliding joint.
const BEYOND: f64 = 0.5;
/// One message of so many may have an angle beyond the greatest one.
const RARE: usize = 50;

/// Angles as they come: numbers that are no angles, and the joints that are named.
#[derive(Debug, Default)]
pub(crate) struct Readings {
    pub rows: Vec<JointAngles>,
    count: usize,
    /// Readings with an angle beyond the greatest one, and the first of these.
    beyond: usize,
    first: Option<String>,
    /// Joints of the first message without a joint of the hand.
    others: Option<String>,
}

/// Returns the greatest absolute angle that a reading of a hand may have.
fn largest(hand: &Hand) -> f64 {
    hand.ranges().iter().flatten().fold(LARGEST_RAD, |most, limit| most.max(1.5 * limit.abs()))
}

impl Readings {
    /// Returns a message in the hand's order, NaN where a joint has no valid angle, and the defects; `None` without any angle of the hand.
    pub fn row(
        &mut self,
        joints: &[(&str, Option<f64>)],
        names: &[String],
        hand: &Hand,
    ) -> (Option<JointAngles>, Vec<String>) {
        self.count += 1;
        let (mut row, mut defects) = (vec![f64::NAN; names.len()], Vec::new());
        let largest = largest(hand);
        let (mut is_beyond, mut is_named) = (false, false);
        for (angle, name) in row.iter_mut().zip(names) {
            let Some((_, position)) = joints.iter().find(|(known, _)| known == name) else { continue };
            is_named = true;
            match *position {
                None => defects.push(format!("joint {name:?} has no position")),
                Some(position) if !position.is_finite() => {
                    defects.push(format!("the position of joint {name:?} is not finite"));
                }
                Some(position) if position.abs() > largest => {
                    is_beyond = true;
                    self.first.get_or_insert_with(|| format!("{position} of joint {name:?}"));
                    defects.push(format!("joint {name:?} is beyond {largest:.2} rad"));
                }
                Some(position) => *angle = position,
            }
        }
        self.beyond += usize::from(is_beyond);
        if joints.is_empty() {
            defects.push("it has no joints".to_owned());
        } else if !is_named {
            let known: Vec<&str> = joints.iter().map(|(name, _)| *name).take(20).collect();
            let known = known.join(", ");
            defects.push(format!("it has none of the hand's joints: {known}"));
            self.others.get_or_insert(known);
        }
        (row.iter().any(|angle| !angle.is_nan()).then_some(row), defects)
    }

    /// Returns why these angles are not those of the hand.
    pub fn defect(&self, names: &[String], hand: &Hand) -> Option<String> {
        if let Some(first) = self.first.as_ref().filter(|_| self.beyond > (self.count / RARE).max(1)) {
            let (beyond, count, largest) = (self.beyond, self.count, largest(hand));
            return Some(format!(
                "{beyond} of {count} readings have angles beyond {largest:.2} rad, first {first}; give radians, not degrees"
            ));
        }
        let missing =
            (0..names.len()).find(|&k| self.rows.iter().all(|row| row.get(k).is_none_or(|angle| angle.is_nan())));
        let name = names.get(missing?)?;
        Some(match &self.others {
            Some(others) => format!("there is no joint {name:?} among {others}; give hand.names in the mapping"),
            None => format!("no message has a valid position of joint {name:?}; give hand.names in the mapping"),
        })
    }
}

/// Returns a note on the joint that is farthest beyond its range in these frames.
pub(crate) fn beyond_range(angles: &[JointAngles], hand: &Hand, names: &[String]) -> Option<String> {
    let mut worst: Option<(f64, usize)> = None;
    for row in angles {
        for (k, (angle, joint)) in row.iter().zip(hand.joints()).enumerate() {
            let [low, high] = joint.range;
            let excess = (low - angle).max(angle - high);
            if excess > worst.map_or(BEYOND, |(excess, _)| excess) {
                worst = Some((excess, k));
            }
        }
    }
    let (excess, k) = worst?;
    let (name, joint) = (names.get(k)?, hand.joints().get(k)?);
    let ([low, high], unit) = (joint.range, if joint.motion == JointMotion::Hinge { "rad" } else { "m" });
    Some(format!(
        "joint {name:?} is up to {excess:.2} {unit} beyond its range of {low} to {high} {unit}: check that angles are in radians, hand.names and hand.side"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names() -> Vec<String> {
        (0..16).map(|k| format!("j{k}")).collect()
    }

    fn hand() -> std::sync::Arc<Hand> {
        Hand::allegro(mvt_robot::hand::Side::Left)
    }

    #[test]
    fn a_message_gives_the_angles_that_it_has() {
        let names = names();
        let mut readings = Readings::default();
        let full: Vec<(&str, Option<f64>)> = names.iter().map(|name| (name.as_str(), Some(0.1))).collect();
        let (row, defects) = readings.row(&full, &names, &hand());
        assert_eq!((row, defects.len()), (Some(vec![0.1; 16]), 0));
        for (joints, is_some, said) in [
            (vec![], false, "no joints"),
            (vec![("arm", Some(0.0))], false, "none of the hand's joints: arm"),
            (vec![("j0", Some(f64::NAN)), ("j1", Some(0.2))], true, "\"j0\" is not finite"),
            (vec![("j0", None), ("j1", Some(0.2))], true, "\"j0\" has no position"),
            (vec![("j0", Some(45.0)), ("j1", Some(0.2))], true, "\"j0\" is beyond 3.14 rad"),
        ] {
            let (row, defects) = readings.row(&joints, &names, &hand());
            assert_eq!((row.is_some(), defects.len()), (is_some, 1));
            assert!(
                row.as_ref().is_none_or(|row| row[0].is_nan() && row[1] == 0.2) && defects[0].contains(said),
                "{defects:?}"
            );
        }
        readings.rows.push(vec![0.1; 16]);
        assert_eq!(readings.defect(&names, &hand()), None, "one wrong angle is rare");
        readings.row(&[("j0", Some(45.0))], &names, &hand());
        assert!(
            readings
                .defect(&names, &hand())
                .unwrap()
                .contains("2 of 7 readings have angles beyond 3.14 rad, first 45 of joint \"j0\"")
        );
    }

    #[test]
    fn joints_that_never_come_and_angles_beyond_the_range_are_named() {
        let names = names();
        let mut readings = Readings::default();
        readings.rows.push((0..16).map(|k| if k == 9 { f64::NAN } else { 0.1 }).collect());
        assert!(readings.defect(&names, &hand()).unwrap().contains("no message has a valid position of joint \"j9\""));
        let angles = [vec![0.3; 16], (0..16).map(|k| if k == 4 { -2.5 } else { 0.3 }).collect()];
        let note = beyond_range(&angles, &hand(), &names).unwrap();
        assert!(note.starts_with("joint \"j4\" is up to 2.03 rad beyond its range of -0.47 to 0.47 rad"), "{note}");
        assert_eq!(beyond_range(&angles[..1], &hand(), &names), None);
        // A sliding joint, and one that turns round and round.
        let mut description = hand().description().clone();
        description.joints[4].motion = JointMotion::Slide;
        description.joints[5].range = [-20.0, 20.0];
        let hand = Hand::new(description).unwrap();
        assert!(beyond_range(&angles, &hand, &names).unwrap().contains("2.03 m beyond its range of -0.47 to 0.47 m"));
        let mut readings = Readings::default();
        assert_eq!(readings.row(&[("j5", Some(25.0)), ("j0", Some(35.0))], &names, &hand).1.len(), 1);
    }
}
