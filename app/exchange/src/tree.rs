//! The poses of frames in one another, as the transforms of a recording state them.

use std::collections::{HashMap, HashSet, VecDeque};

use nalgebra::Isometry3;

/// Motion of a frame that counts as moving, metres and radians.
const STILL_M: f64 = 1e-3;
const STILL_RAD: f64 = 2e-3;
/// Transforms without a pose that are kept for messages.
const MOST_BROKEN: usize = 64;

/// Transform between two frames.
#[derive(Debug)]
struct Edge {
    parent: String,
    child: String,
    /// The first pose of the child in its parent.
    pose: Isometry3<f64>,
    moves: bool,
}

/// Frames and the transforms between them.
#[derive(Debug, Default)]
pub(crate) struct Tree {
    edges: Vec<Edge>,
    places: HashMap<(String, String), usize>,
    /// Frames of transforms without a valid pose, and their defect.
    broken: Vec<(String, String)>,
}

/// Pose of a frame in another one.
#[derive(Debug, PartialEq)]
pub(crate) struct Route {
    pub pose: Isometry3<f64>,
    /// Frames between them that move.
    pub moving: Vec<String>,
}

impl Tree {
    /// Adds a transform. Returns the bytes that it takes.
    pub fn add(&mut self, parent: &str, child: &str, pose: Isometry3<f64>) -> u64 {
        let key = (parent.to_owned(), child.to_owned());
        if let Some(edge) = self.places.get(&key).and_then(|&place| self.edges.get_mut(place)) {
            let motion = edge.pose.inverse() * pose;
            edge.moves |= motion.translation.vector.norm() >= STILL_M || motion.rotation.angle() >= STILL_RAD;
            return 0;
        }
        self.places.insert(key, self.edges.len());
        self.edges.push(Edge { parent: parent.to_owned(), child: child.to_owned(), pose, moves: false });
        2 * (child.len() + parent.len()) as u64 + 512
    }

    /// Notes a transform that has no valid pose.
    pub fn add_broken(&mut self, child: &str, defect: &str) {
        if self.broken.len() < MOST_BROKEN {
            self.broken.push((child.to_owned(), defect.to_owned()));
        }
    }

    /// Returns the pose of a frame in another by the fewest transforms, whichever of the two is above the other.
    pub fn path(&self, frame: &str, root: &str) -> Result<Route, String> {
        let mut around: HashMap<&str, Vec<(&Edge, bool)>> = HashMap::new();
        for edge in &self.edges {
            around.entry(&edge.child).or_default().push((edge, true));
            around.entry(&edge.parent).or_default().push((edge, false));
        }
        let mut seen = HashSet::from([frame]);
        let mut next = VecDeque::from([(frame, Route { pose: Isometry3::identity(), moving: Vec::new() })]);
        while let Some((at, path)) = next.pop_front() {
            if at == root {
                return Ok(path);
            }
            for (edge, is_up) in around.get(at).into_iter().flatten() {
                let (to, pose) = if *is_up { (&edge.parent, edge.pose) } else { (&edge.child, edge.pose.inverse()) };
                if seen.insert(to) {
                    let mut moving = path.moving.clone();
                    moving.extend(edge.moves.then(|| edge.child.clone()));
                    next.push_back((to, Route { pose: pose * path.pose, moving }));
                }
            }
        }
        let broken = self.broken.iter().find(|(child, _)| seen.contains(child.as_str()) || child == root);
        let reason = match (broken, around.contains_key(frame), around.contains_key(root)) {
            (Some((_, defect)), ..) => defect.clone(),
            (None, false, _) => format!("no transform names {frame:?}"),
            (None, _, false) => format!("no transform names {root:?}"),
            _ => "they are in separate trees".to_owned(),
        };
        Err(format!("no transforms lead from {frame:?} to {root:?}: {reason}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_leads_up_and_down_the_tree() {
        let shift = |x: f64| Isometry3::translation(x, 0.0, 0.0);
        let mut tree = Tree::default();
        tree.add(
            "world",
            "palm",
            shift(1.0) * Isometry3::rotation(nalgebra::Vector3::z() * std::f64::consts::FRAC_PI_2),
        );
        tree.add("world", "tripod", shift(3.0));
        tree.add("tripod", "camera", shift(0.5));
        tree.add("tripod", "camera", shift(0.6));
        let path = tree.path("camera", "palm").unwrap();
        // 2.5 m in front of the palm, which is turned by a quarter.
        assert!((path.pose.translation.vector - nalgebra::Vector3::new(0.0, -2.5, 0.0)).norm() < 1e-12, "{path:?}");
        assert_eq!(path.moving, ["camera"]);
        assert!(tree.path("palm", "palm").unwrap().pose == Isometry3::identity());
        tree.add_broken("lens", "the transform camera -> lens has a rotation of length 0");
        assert!(tree.path("lens", "palm").unwrap_err().ends_with("a rotation of length 0"));
        assert!(tree.path("mug", "palm").unwrap_err().ends_with("no transform names \"mug\""));
        tree.add("x", "y", shift(1.0));
        assert!(tree.path("y", "palm").unwrap_err().ends_with("separate trees"));
    }
}
