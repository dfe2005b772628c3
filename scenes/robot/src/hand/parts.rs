//! Bodies of a hand: where they are, their masses, and the primitives for collisions and rendering.

use mvt_frames::{Frame, Isometry};
use serde::{Deserialize, Serialize};

use super::hull::Hull;

/// No rotation, quaternion (w, x, y, z).
pub const UPRIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

/// Position and orientation in the coordinates of another body.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Placing {
    /// Position, metres.
    pub position_m: [f64; 3],
    /// Orientation, quaternion (w, x, y, z).
    #[serde(default = "upright")]
    pub orientation_wxyz: [f64; 4],
}

fn upright() -> [f64; 4] {
    UPRIGHT
}

impl Placing {
    /// Returns the place at a position, without rotation.
    pub const fn at(position_m: [f64; 3]) -> Self {
        Self { position_m, orientation_wxyz: UPRIGHT }
    }

    /// Returns the motion from what is placed to the body in which it is placed.
    pub fn isometry<From: Frame, To: Frame>(&self) -> Isometry<From, To> {
        Isometry::from_parts(self.position_m, self.orientation_wxyz)
    }
}

/// Rigid body of a hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Name, also in the MJCF.
    pub name: String,
    /// Index of the body that carries it; `None` for a body that is fixed in the world or moves against it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parent: Option<usize>,
    /// Where it is on its parent, or in the world, while its joint is at 0.
    pub place: Placing,
    /// Its mass; `None` for a body that nothing can push, such as the mount of an arm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inertial: Option<Inertial>,
    /// Its primitives.
    #[serde(default)]
    pub parts: Vec<Part>,
}

/// Mass, centre of mass and diagonal inertia of a body.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Inertial {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass in the body's frame, metres.
    pub centre_m: [f64; 3],
    /// Orientation of the principal axes in the body's frame, quaternion (w, x, y, z).
    #[serde(default = "upright")]
    pub orientation_wxyz: [f64; 4],
    /// Diagonal of the inertia tensor about the centre of mass, along the principal axes, kg m^2.
    pub diagonal: [f64; 3],
}

/// Primitive of a hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Part {
    /// Its material.
    pub surface: PartSurface,
    /// Its shape.
    pub shape: Primitive,
}

/// Material of a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PartSurface {
    /// Bare plastic.
    Link,
    /// The housing of a touch sensor.
    Housing,
    /// The gel of the pad of this index.
    Gel(usize),
}

/// Shape of a part in its body's frame, metres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Primitive {
    /// Box.
    Box {
        /// Centre.
        centre: [f64; 3],
        /// Half extents.
        half: [f64; 3],
        /// Orientation of its axes, quaternion (w, x, y, z).
        #[serde(default = "upright")]
        orientation_wxyz: [f64; 4],
    },
    /// All points within `radius` of the segment from `from` to `to`.
    Capsule {
        /// One end of the axis.
        from: [f64; 3],
        /// Other end of the axis.
        to: [f64; 3],
        /// Radius.
        radius: f64,
    },
    /// Ellipsoid.
    Ellipsoid {
        /// Centre.
        centre: [f64; 3],
        /// Semi-axes.
        semi: [f64; 3],
        /// Orientation of its axes, quaternion (w, x, y, z).
        #[serde(default = "upright")]
        orientation_wxyz: [f64; 4],
    },
    /// Convex hull of points.
    Hull(Hull),
}
