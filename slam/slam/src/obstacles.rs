//! Bodies that the object cannot occupy.

use glam::Vec3;
use mvt_frames::{Isometry, Obstacle, Occupied, World};

/// Rigid bodies that the object cannot occupy, such as the links of a hand: each as points inside it, in the coordinates of the body.
/// Where the bodies are is part of every measurement.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Obstacles {
    bodies: Vec<Vec<Occupied>>,
}

impl Obstacles {
    /// Bodies by points inside them. Points should lie about 2.5 mm apart: a cell of the map's space.
    pub fn new(bodies: impl IntoIterator<Item = Vec<Occupied>>) -> Self {
        Self { bodies: bodies.into_iter().collect() }
    }

    /// Number of bodies.
    pub fn len(&self) -> usize {
        self.bodies.len()
    }

    /// Whether there is no body.
    pub fn is_empty(&self) -> bool {
        self.bodies.is_empty()
    }

    /// The points in the world with the bodies at these poses, in an order that does not depend on them. A body without a pose is
    /// left out.
    pub fn posed(&self, poses: &[Isometry<Obstacle, World>]) -> impl Iterator<Item = Occupied> {
        self.bodies.iter().zip(poses).flat_map(|(points, pose)| {
            let (rotation, translation) = pose.to_f32();
            points.iter().map(move |&Occupied { point, depth_m }| Occupied {
                point: (rotation * point) + Vec3::from(translation),
                depth_m,
            })
        })
    }
}
