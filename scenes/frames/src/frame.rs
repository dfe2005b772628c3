//! Coordinate frames as types.

use std::fmt;
use std::marker::PhantomData;
use std::ops::Mul;

use nalgebra as na;

/// Coordinate frame. Only the marker types of this crate implement it.
pub trait Frame: Copy + Send + Sync + 'static {
    /// Name, for messages.
    const NAME: &'static str;
}

macro_rules! frames {
    ($($(#[$doc:meta])* $name:ident)*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum $name {}
        impl Frame for $name {
            const NAME: &'static str = stringify!($name);
        }
    )*};
}

frames! {
    /// World: x along the fingers, z out of the palm, origin at the hand base. The hand is fixed in it; gravity may be
    /// tilted.
    World
    /// Base link of the hand, as in Allegro's URDF: z along the fingers, x out of the palm, origin at the knuckles.
    HandBase
    /// Sensor frame of TACTO: origin at the camera of the DIGIT, x out of the gel, z up in the image, y to the left in
    /// the image.
    Gel
    /// Camera with OpenGL axes: x right, y up, optical axis along -z.
    Camera
    /// Object: origin at the centre of its bounding box, z up as the object stands on the palm.
    Object
    /// The estimated shape: the frame from which estimated poses lead and in which meshes are given. With a known shape it is
    /// [`Object`]; otherwise the first frame of a run fixes it, and only a score, which knows the truth, can say how it lies in [`Object`].
    Model
    /// The neural field and its keyframes. It moves against [`Model`] by fractions of a millimetre as the first keyframe is refined.
    Field
    /// The body that carries a touch sensor, such as the fingertip link of an Allegro: x out of the gel, z along the finger.
    Pad
    /// A rigid body that the object cannot occupy, such as a link of a finger.
    Obstacle
    /// The coordinates in which an object's mesh was published; differs from [`Object`] by a rigid motion.
    MeshFile
}

/// Rigid motion that takes coordinates in `From` to coordinates in `To`.
pub struct Isometry<From, To> {
    inner: na::Isometry3<f64>,
    frames: PhantomData<(From, To)>,
}

impl<From: Frame, To: Frame> Isometry<From, To> {
    /// Attaches frames to a rotation and translation.
    pub fn new(inner: na::Isometry3<f64>) -> Self {
        Self { inner, frames: PhantomData }
    }

    /// Returns the motion between two frames that coincide.
    pub fn identity() -> Self {
        Self::new(na::Isometry3::identity())
    }

    /// Returns the motion between parallel frames; the origin of `From` is at (x, y, z) in `To`, metres.
    pub fn translation(x: f64, y: f64, z: f64) -> Self {
        Self::new(na::Isometry3::translation(x, y, z))
    }

    /// Converts a translation in metres and a quaternion (w, x, y, z). Normalises the quaternion.
    pub fn from_parts(translation_m: [f64; 3], quaternion_wxyz: [f64; 4]) -> Self {
        let [w, x, y, z] = quaternion_wxyz;
        let rotation = na::UnitQuaternion::from_quaternion(na::Quaternion::new(w, x, y, z));
        Self::new(na::Isometry3::from_parts(na::Vector3::from(translation_m).into(), rotation))
    }

    /// Converts a 4 x 4 row-major homogeneous matrix.
    ///
    /// # Errors
    /// [`NotRigid`] if a number is not finite, the last row is not 0 0 0 1, or the upper left part differs from a
    /// rotation by more than 1e-3.
    pub fn from_matrix(rows: &[[f64; 4]; 4]) -> Result<Self, NotRigid> {
        if rows.iter().flatten().any(|v| !v.is_finite()) {
            return Err(NotRigid("a number is not finite"));
        }
        if rows[3] != [0.0, 0.0, 0.0, 1.0] {
            return Err(NotRigid("the last row is not 0 0 0 1"));
        }
        let linear = na::Matrix3::from_fn(|r, c| rows[r][c]);
        if (linear * linear.transpose() - na::Matrix3::identity()).abs().max() > 1e-3 || linear.determinant() < 0.0 {
            return Err(NotRigid("the upper left 3 x 3 part is not a rotation"));
        }
        let rotation = na::UnitQuaternion::from_matrix(&linear);
        Ok(Self::new(na::Isometry3::from_parts(na::Translation3::new(rows[0][3], rows[1][3], rows[2][3]), rotation)))
    }

    /// Returns the 4 x 4 row-major homogeneous matrix.
    pub fn to_matrix(self) -> [[f64; 4]; 4] {
        let m = self.inner.to_homogeneous();
        std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]))
    }

    /// Returns the motion without its frames.
    pub fn untyped(self) -> na::Isometry3<f64> {
        self.inner
    }

    /// Returns the motion from `To` to `From`.
    pub fn inverse(self) -> Isometry<To, From> {
        Isometry::new(self.inner.inverse())
    }

    /// Returns the origin of `From` in `To`, metres.
    pub fn origin(self) -> Point<To> {
        Point::from(self.inner.translation.vector)
    }

    /// Returns the rotation as a quaternion (w, x, y, z).
    pub fn quaternion_wxyz(self) -> [f64; 4] {
        let q = self.inner.rotation;
        [q.w, q.i, q.j, q.k]
    }

    /// Returns rotation and translation in `f32`, for ray casting.
    pub fn to_f32(self) -> (glam::Mat3A, glam::Vec3A) {
        let r = self.inner.rotation.to_rotation_matrix().into_inner();
        let column = |c: usize| glam::DVec3::new(r[(0, c)], r[(1, c)], r[(2, c)]).as_vec3a();
        let t = self.inner.translation.vector;
        (glam::Mat3A::from_cols(column(0), column(1), column(2)), glam::DVec3::new(t.x, t.y, t.z).as_vec3a())
    }
}

/// Reason why a matrix is not a rigid motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("not a rigid motion: {0}")]
pub struct NotRigid(&'static str);

impl<A: Frame, B: Frame, C: Frame> Mul<Isometry<A, B>> for Isometry<B, C> {
    type Output = Isometry<A, C>;
    fn mul(self, first: Isometry<A, B>) -> Isometry<A, C> {
        Isometry::new(self.inner * first.inner)
    }
}

impl<A: Frame, B: Frame> Mul<Point<A>> for Isometry<A, B> {
    type Output = Point<B>;
    fn mul(self, point: Point<A>) -> Point<B> {
        Point::from((self.inner * na::Point3::from(point.coords)).coords)
    }
}

impl<A: Frame, B: Frame> Mul<Vector<A>> for Isometry<A, B> {
    type Output = Vector<B>;
    fn mul(self, vector: Vector<A>) -> Vector<B> {
        Vector::from(self.inner.rotation * vector.coords)
    }
}

impl<From, To> Clone for Isometry<From, To> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<From, To> Copy for Isometry<From, To> {}
impl<From, To> PartialEq for Isometry<From, To> {
    fn eq(&self, other: &Self) -> bool {
        self.inner == other.inner
    }
}
impl<From: Frame, To: Frame> fmt::Debug for Isometry<From, To> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "Isometry<{}, {}> {:?} {:?}",
            From::NAME,
            To::NAME,
            self.origin().coords().as_slice(),
            self.quaternion_wxyz()
        )
    }
}

macro_rules! triple {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        pub struct $name<F> {
            coords: na::Vector3<f64>,
            frame: PhantomData<F>,
        }
        impl<F: Frame> $name<F> {
            /// Attaches a frame to coordinates in metres.
            pub fn new(x: f64, y: f64, z: f64) -> Self {
                Self::from(na::Vector3::new(x, y, z))
            }
            /// Returns the coordinates without their frame, metres.
            pub fn coords(self) -> na::Vector3<f64> {
                self.coords
            }
        }
        impl<F> From<na::Vector3<f64>> for $name<F> {
            fn from(coords: na::Vector3<f64>) -> Self {
                Self { coords, frame: PhantomData }
            }
        }
        impl<F> Clone for $name<F> {
            fn clone(&self) -> Self {
                *self
            }
        }
        impl<F> Copy for $name<F> {}
        impl<F> PartialEq for $name<F> {
            fn eq(&self, other: &Self) -> bool {
                self.coords == other.coords
            }
        }
        impl<F: Frame> fmt::Debug for $name<F> {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!(stringify!($name), "<{}> {:?}"), F::NAME, self.coords.as_slice())
            }
        }
    };
}

triple! {
    /// Place, which rotation and translation move. Metres.
    Point
}
triple! {
    /// Direction or displacement, which only rotation changes. Metres.
    Vector
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matrix_round_trip_and_inverse() {
        let pose = Isometry::<Object, World>::from_parts([0.1, -0.2, 0.3], [0.5, -0.5, 0.5, 0.5]);
        let again = Isometry::<Object, World>::from_matrix(&pose.to_matrix()).unwrap();
        let p = Point::<Object>::new(1.0, 2.0, 3.0);
        assert!(((pose * p).coords() - (again * p).coords()).norm() < 1e-12);
        assert!(((pose.inverse() * (pose * p)).coords() - p.coords()).norm() < 1e-12);
        // The quaternion (0.5, -0.5, 0.5, 0.5) takes x to -z.
        let x = (pose * Vector::<Object>::new(1.0, 0.0, 0.0)).coords();
        assert!((x - na::Vector3::new(0.0, 0.0, -1.0)).norm() < 1e-12, "{x}");
    }

    #[test]
    fn matrices_that_are_no_pose_are_refused() {
        let mut m = Isometry::<Object, World>::identity().to_matrix();
        m[0][0] = -1.0;
        assert!(Isometry::<Object, World>::from_matrix(&m).is_err(), "a mirror image");
        m[0][0] = f64::NAN;
        assert!(Isometry::<Object, World>::from_matrix(&m).is_err());
        m[0][0] = 1.0;
        m[3][0] = 1.0;
        assert!(Isometry::<Object, World>::from_matrix(&m).is_err());
    }
}
