//! Bodies of a hand: where they are, their masses, and the primitives for collisions and rendering.

use mvt_frames::{Frame, Isometry};
use serde::{Deserialize, Serialize};

use super::hull::Hull;
use crate::digit::body::SensorBody;

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

impl SensorBody {
    /// Returns the housing and the gel, which is that of the pad of this index, in the gel frame.
    pub fn parts(&self, pad: usize) -> Vec<Part> {
        let half = |size: [f64; 3]| size.map(|side| side / 2.0);
        let (centre, orientation_wxyz) = (self.gel_centre_m, UPRIGHT);
        let housing =
            Primitive::Box { centre: self.housing_centre_m, half: half(self.housing_size_m), orientation_wxyz };
        let gel = match half(self.gel_size_m) {
            semi if self.is_domed => Primitive::Ellipsoid { centre, semi, orientation_wxyz },
            half => Primitive::Box { centre, half, orientation_wxyz },
        };
        vec![
            Part { surface: PartSurface::Housing, shape: housing },
            Part { surface: PartSurface::Gel(pad), shape: gel },
        ]
    }

    /// Returns the mass in the gel frame.
    pub fn inertial(&self) -> Inertial {
        let Self { mass_kg, mass_centre_m, inertia_kg_m2, .. } = *self;
        Inertial { mass_kg, centre_m: mass_centre_m, orientation_wxyz: UPRIGHT, diagonal: inertia_kg_m2 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::digit::profile::SensorProfile;

    #[test]
    fn gels_end_at_the_apex_and_stand_out_of_their_housing() {
        for name in ["digit", "gelsight_mini"] {
            let profile = SensorProfile::load(name).unwrap();
            let parts = profile.body.parts(2);
            let front = |part: &Part| match &part.shape {
                Primitive::Box { centre, half, .. } => centre[0] + half[0],
                Primitive::Ellipsoid { centre, semi, .. } => centre[0] + semi[0],
                other => panic!("{other:?}"),
            };
            assert_eq!(parts[1].surface, PartSurface::Gel(2));
            assert!((front(&parts[1]) - 1e-3 * profile.apex_mm).abs() < 0.3e-3);
            assert!(front(&parts[0]) < front(&parts[1]) - 2e-3);
        }
    }

    #[test]
    fn half_sizes_are_exact() {
        let [housing, gel] = [0, 1].map(|part| SensorBody::default().parts(0)[part].shape.clone());
        assert!(matches!(housing, Primitive::Box { half: [0.009_75, 0.0115, 0.0155], .. }));
        assert!(matches!(gel, Primitive::Ellipsoid { semi: [0.009, 0.0128, 0.0165], .. }));
    }
}
