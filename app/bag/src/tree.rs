//! Poses over time: of frames in their parents, and of frames in one another.

use std::collections::HashMap;

use nalgebra::Isometry3;

use crate::messages::RosTransform;

/// A pose is kept for so long before its first and behind its last time, nanoseconds: two periods at 20 Hz.
const REACH_NS: i64 = 100_000_000;
/// Most frames between a frame and the root: a tree that is deeper is a circle.
const DEEPEST: usize = 200;

/// Values over time, in the order of time.
#[derive(Debug, Clone)]
pub(crate) struct Track<T> {
    samples: Vec<(i64, T)>,
    is_sorted: bool,
}

impl<T> Default for Track<T> {
    fn default() -> Self {
        Self { samples: Vec::new(), is_sorted: true }
    }
}

impl<T: Copy> Track<T> {
    pub fn push(&mut self, time_ns: i64, value: T) {
        self.is_sorted &= self.samples.last().is_none_or(|(last_ns, _)| *last_ns <= time_ns);
        self.samples.push((time_ns, value));
    }

    pub fn sort(&mut self) {
        if !self.is_sorted {
            self.samples.sort_by_key(|(time_ns, _)| *time_ns);
            self.is_sorted = true;
        }
    }

    pub fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    /// Drops samples before a time, but not the newest one.
    fn forget_before(&mut self, time_ns: i64) {
        if let Some(newest_ns) = self.samples.iter().map(|(sample_ns, _)| *sample_ns).max() {
            self.samples.retain(|(sample_ns, _)| *sample_ns >= time_ns.min(newest_ns));
        }
    }

    /// Returns the value at a time, between two samples by `between`; `None` far from all samples.
    pub fn at(&self, time_ns: i64, most_gap_ns: i64, between: impl Fn(&T, &T, f64) -> T) -> Option<T> {
        let next = self.samples.partition_point(|(sample_ns, _)| *sample_ns < time_ns);
        let before = next.checked_sub(1).and_then(|k| self.samples.get(k));
        match (before, self.samples.get(next)) {
            (_, Some((next_ns, value))) if *next_ns == time_ns => Some(*value),
            (Some((a_ns, a)), Some((b_ns, b))) if b_ns.saturating_sub(*a_ns) <= most_gap_ns => {
                Some(between(a, b, time_ns.saturating_sub(*a_ns) as f64 / b_ns.saturating_sub(*a_ns) as f64))
            }
            (a, b) => {
                // Which is nearer.
                let apart = |sample: &&(i64, T)| sample.0.saturating_sub(time_ns).saturating_abs();
                let nearest = [a, b].into_iter().flatten().min_by_key(apart)?;
                (apart(&nearest) <= REACH_NS).then_some(nearest.1)
            }
        }
    }
}

/// Returns the pose at a part of the way between two.
pub(crate) fn between(a: &Isometry3<f64>, b: &Isometry3<f64>, part: f64) -> Isometry3<f64> {
    let rotation =
        a.rotation.try_slerp(&b.rotation, part, 1e-9).unwrap_or(if part < 0.5 { a.rotation } else { b.rotation });
    Isometry3::from_parts(a.translation.vector.lerp(&b.translation.vector, part).into(), rotation)
}

/// Pose of a frame in its parent.
#[derive(Debug, Clone)]
struct Edge {
    parent: String,
    /// The pose that holds at all times.
    fixed: Option<Isometry3<f64>>,
    track: Track<Isometry3<f64>>,
}

/// Tree of coordinate frames, as `/tf` and `/tf_static` state it.
#[derive(Debug, Clone, Default)]
pub struct TransformTree {
    edges: HashMap<String, Edge>,
    /// Frames with two parents; the first counts.
    torn: Vec<String>,
}

impl TransformTree {
    /// Adds a transform at a time. One of `/tf_static` holds at all times.
    pub fn add(&mut self, transform: &RosTransform, time_ns: i64, is_static: bool) {
        let parent = &transform.header.frame;
        let edge = self.edges.entry(transform.child.clone()).or_insert_with(|| Edge {
            parent: parent.clone(),
            fixed: None,
            track: Track::default(),
        });
        if edge.parent != *parent {
            if !self.torn.contains(&transform.child) {
                self.torn.push(transform.child.clone());
            }
        } else if is_static {
            edge.fixed = Some(transform.parent_from_child);
        } else {
            edge.track.push(time_ns, transform.parent_from_child);
        }
    }

    /// Sorts the transforms by time; call it before the first look-up.
    pub fn sort(&mut self) {
        self.edges.values_mut().for_each(|edge| edge.track.sort());
    }

    /// Forgets poses before a time, nanoseconds, so that a tree that is fed for hours does not grow. The newest pose of each frame stays.
    pub fn forget_before(&mut self, time_ns: i64) {
        self.edges.values_mut().for_each(|edge| edge.track.forget_before(time_ns));
    }

    /// Returns frames with two parents, of which the first counts.
    pub fn torn(&self) -> &[String] {
        &self.torn
    }

    /// Returns whether no transform is known.
    pub fn is_empty(&self) -> bool {
        self.edges.is_empty()
    }

    /// Returns whether a frame is known.
    pub fn has(&self, frame: &str) -> bool {
        self.edges.contains_key(frame) || self.edges.values().any(|edge| edge.parent == frame)
    }

    /// Returns the frame from which all above a frame leads.
    pub fn root_of<'a>(&'a self, frame: &'a str) -> &'a str {
        self.above(frame).last().unwrap_or(frame)
    }

    /// Returns a frame and all above it, up to the root.
    fn above<'a>(&'a self, frame: &'a str) -> impl Iterator<Item = &'a str> {
        std::iter::successors(Some(frame), |frame| self.edges.get(*frame).map(|edge| edge.parent.as_str()))
            .take(DEEPEST)
    }

    /// Returns the motion from a frame to one above it at a time.
    fn up<'a>(&'a self, frame: &'a str, to: &str, time_ns: i64) -> Result<Isometry3<f64>, String> {
        let mut pose = Isometry3::identity();
        for child in self.above(frame).take_while(|frame| *frame != to) {
            let Some(edge) = self.edges.get(child) else { continue };
            let step = edge.fixed.or_else(|| edge.track.at(time_ns, i64::MAX, between));
            let Some(step) = step else {
                return Err(format!("no transform {} -> {child} was recorded near the time", edge.parent));
            };
            pose = step * pose;
        }
        Ok(pose)
    }

    /// Returns the motion that takes coordinates in one frame to those in another at a time, nanoseconds.
    ///
    /// # Errors
    /// A sentence if no transforms lead from one to the other, or none was recorded near the time.
    pub fn look_up(&self, to: &str, from: &str, time_ns: i64) -> Result<Isometry3<f64>, String> {
        if to == from {
            return Ok(Isometry3::identity());
        }
        let above: Vec<&str> = self.above(to).collect();
        let Some(common) = self.above(from).find(|frame| above.contains(frame)) else {
            let unknown = [to, from].into_iter().find(|frame| !self.has(frame));
            let reason = unknown
                .map_or("they are in separate trees".to_owned(), |frame| format!("no transform names {frame:?}"));
            return Err(format!("no transforms lead from {from:?} to {to:?}: {reason}"));
        };
        Ok(self.up(to, common, time_ns)?.inverse() * self.up(from, common, time_ns)?)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Vector3};
    use proptest::prelude::*;

    use super::*;
    use crate::RosHeader;

    fn transform(parent: &str, child: &str, pose: Isometry3<f64>) -> RosTransform {
        let header = RosHeader { stamp_ns: 0, frame: parent.to_owned() };
        RosTransform { header, child: child.to_owned(), parent_from_child: pose }
    }

    fn shift(x: f64) -> Isometry3<f64> {
        Isometry3::translation(x, 0.0, 0.0)
    }

    #[test]
    fn poses_lead_up_and_down_the_tree_and_between_times() {
        let mut tree = TransformTree::default();
        let turned = Isometry3::rotation(Vector3::z() * std::f64::consts::FRAC_PI_2);
        tree.add(&transform("map", "base", shift(1.0) * turned), 0, true);
        tree.add(&transform("map", "camera", shift(4.0)), 2_000_000_000, false);
        tree.add(&transform("map", "camera", shift(3.0)), 1_000_000_000, false);
        tree.add(&transform("camera", "optical", shift(0.5)), 0, true);
        tree.sort();
        let pose = tree.look_up("base", "optical", 1_500_000_000).unwrap();
        // At 1.5 s the optical frame is at 4 m, 3 m from the base, which is turned by a quarter.
        assert!((pose.translation.vector - Vector3::new(0.0, -3.0, 0.0)).norm() < 1e-12, "{pose}");
        assert!(tree.look_up("map", "optical", 2_050_000_000).is_ok());
        assert!(tree.look_up("map", "optical", 2_150_000_000).unwrap_err().contains("near the time"));
        assert!(tree.look_up("map", "mug", 0).unwrap_err().contains("names \"mug\""));
        assert_eq!(tree.root_of("optical"), "map");
        tree.add(&transform("odom", "camera", shift(9.0)), 0, false);
        assert_eq!(tree.torn(), ["camera"]);
    }

    #[test]
    fn what_is_old_is_forgotten_but_the_newest_pose() {
        let mut tree = TransformTree::default();
        for k in 0..5 {
            tree.add(&transform("map", "camera", shift(k as f64)), k * 1_000_000_000, false);
        }
        tree.forget_before(3_000_000_000);
        tree.sort();
        assert!(tree.look_up("map", "camera", 2_000_000_000).is_err());
        assert!(tree.look_up("map", "camera", 3_500_000_000).is_ok());
        tree.forget_before(i64::MAX);
        assert!(tree.look_up("map", "camera", 4_000_000_000).is_ok());
    }

    #[test]
    fn a_circle_ends() {
        let mut tree = TransformTree::default();
        tree.add(&transform("a", "b", shift(1.0)), 0, true);
        tree.add(&transform("b", "a", shift(1.0)), 0, true);
        assert!(tree.look_up("c", "a", 0).is_err());
        let _ = tree.look_up("b", "a", 0);
    }

    proptest! {
        #[test]
        fn a_look_up_and_its_reverse_cancel(x in -1.0..1.0, angle in -3.0..3.0, time in 0i64..1000) {
            let mut tree = TransformTree::default();
            let pose = shift(x) * Isometry3::rotation(Vector3::y() * angle);
            tree.add(&transform("map", "a", pose), 0, false);
            tree.add(&transform("map", "a", pose * pose), 1000, false);
            tree.add(&transform("a", "b", pose), 0, true);
            let both = tree.look_up("b", "map", time).unwrap() * tree.look_up("map", "b", time).unwrap();
            prop_assert!(both.translation.vector.norm() < 1e-9 && both.rotation.angle() < 1e-9);
        }
    }
}
