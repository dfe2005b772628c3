//! Exponential and logarithm of rigid motions.
//!
//! A twist is (v, w): translation in metres, then rotation vector in radians. `exp` is the exponential of the group
//! SE(3), so `exp(log(X)) = X` for every rigid motion, also near a half turn: the rotation vector comes from the
//! quaternion and not from the trace (Sola, Deray and Atchuthan, "A micro Lie theory for state estimation in robotics",
//! 2018, appendix D).

use nalgebra as na;

/// Twist: translation (m), then rotation vector (rad).
pub type Twist = na::Vector6<f64>;

/// Angle (rad) below which the closed forms lose digits to cancellation and their series are exact to machine
/// precision.
const SMALL: f64 = 1e-4;

/// Returns the rigid motion that a twist makes in unit time.
pub fn exp(twist: &Twist) -> na::Isometry3<f64> {
    let (v, w) = split(twist);
    let rotation = na::UnitQuaternion::from_scaled_axis(w);
    na::Isometry3::from_parts((left_jacobian(w) * v).into(), rotation)
}

/// Returns the twist whose exponential is this motion; its rotation is at most a half turn.
pub fn log(motion: &na::Isometry3<f64>) -> Twist {
    let w = rotation_vector(&motion.rotation);
    let v = inverse_left_jacobian(w) * motion.translation.vector;
    Twist::new(v.x, v.y, v.z, w.x, w.y, w.z)
}

/// Returns the rotation vector of a rotation, of length at most pi.
fn rotation_vector(rotation: &na::UnitQuaternion<f64>) -> na::Vector3<f64> {
    let q = if rotation.w < 0.0 { -rotation.into_inner() } else { rotation.into_inner() };
    let axis = q.imag();
    let sine = axis.norm();
    // atan2 keeps all digits both near zero and near pi.
    let half_angle = sine.atan2(q.w);
    if sine < 1e-12 { 2.0 * axis } else { axis * (2.0 * half_angle / sine) }
}

fn split(twist: &Twist) -> (na::Vector3<f64>, na::Vector3<f64>) {
    (twist.fixed_rows::<3>(0).into_owned(), twist.fixed_rows::<3>(3).into_owned())
}

/// Returns the matrix that takes the v of a twist to the translation of its exponential.
fn left_jacobian(w: na::Vector3<f64>) -> na::Matrix3<f64> {
    let (angle, skew) = (w.norm(), w.cross_matrix());
    let (a, b) = if angle < SMALL {
        (0.5 - angle * angle / 24.0, 1.0 / 6.0 - angle * angle / 120.0)
    } else {
        ((1.0 - angle.cos()) / (angle * angle), (angle - angle.sin()) / angle.powi(3))
    };
    na::Matrix3::identity() + a * skew + b * skew * skew
}

/// Returns the inverse of [`left_jacobian`] in closed form.
fn inverse_left_jacobian(w: na::Vector3<f64>) -> na::Matrix3<f64> {
    let (angle, skew) = (w.norm(), w.cross_matrix());
    let b = if angle < SMALL {
        1.0 / 12.0 + angle * angle / 720.0
    } else {
        // 1/angle^2 - (1 + cos)/(2 angle sin), with (1 + cos)/sin = cot(angle / 2), finite at pi.
        1.0 / (angle * angle) - 1.0 / (2.0 * angle * (0.5 * angle).tan())
    };
    na::Matrix3::identity() - 0.5 * skew + b * skew * skew
}

/// Returns the matrix that changes the frame of a twist: `motion * exp(t) * motion^-1 = exp(adjoint(motion) * t)`.
pub fn adjoint(motion: &na::Isometry3<f64>) -> na::Matrix6<f64> {
    let rotation = motion.rotation.to_rotation_matrix().into_inner();
    let mut matrix = na::Matrix6::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    matrix.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    matrix.fixed_view_mut::<3, 3>(0, 3).copy_from(&(motion.translation.vector.cross_matrix() * rotation));
    matrix
}

/// Returns the derivative of `log(motion * exp(d))` by d at d = 0, for `twist = log(motion)`.
pub fn inverse_right_jacobian(twist: &Twist) -> na::Matrix6<f64> {
    let (v, w) = split(twist);
    let mut bracket = na::Matrix6::zeros();
    bracket.fixed_view_mut::<3, 3>(0, 0).copy_from(&w.cross_matrix());
    bracket.fixed_view_mut::<3, 3>(3, 3).copy_from(&w.cross_matrix());
    bracket.fixed_view_mut::<3, 3>(0, 3).copy_from(&v.cross_matrix());
    // Series of x / (1 - exp(-x)), with Bernoulli's numbers over the factorials as coefficients: exact to 1e-9 for
    // rotations up to one radian.
    const EVEN: [f64; 6] = [
        1.0 / 12.0,
        -1.0 / 720.0,
        1.0 / 30_240.0,
        -1.0 / 1_209_600.0,
        1.0 / 47_900_160.0,
        -691.0 / 1_307_674_368_000.0,
    ];
    let square = bracket * bracket;
    let (mut sum, mut power) = (na::Matrix6::identity() + 0.5 * bracket, na::Matrix6::identity());
    for coefficient in EVEN {
        power *= square;
        sum += coefficient * power;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    fn difference(a: &na::Isometry3<f64>, b: &na::Isometry3<f64>) -> f64 {
        (a.to_homogeneous() - b.to_homogeneous()).abs().max()
    }

    /// The exponential as the limit of many small steps: independent of the closed forms.
    fn by_squaring(twist: &Twist) -> na::Matrix4<f64> {
        let (v, w) = split(twist);
        let mut generator = na::Matrix4::zeros();
        generator.fixed_view_mut::<3, 3>(0, 0).copy_from(&w.cross_matrix());
        generator.fixed_view_mut::<3, 1>(0, 3).copy_from(&v);
        let step = generator / f64::from(1 << 20);
        let mut m = na::Matrix4::identity() + step + step * step / 2.0;
        for _ in 0..20 {
            m *= m;
        }
        m
    }

    #[test]
    fn exponential_is_the_limit_of_small_steps() {
        for angle in [0.0, 1e-9, 9e-5, 1.1e-4, 0.3, 2.0, PI - 1e-9, PI, 4.0] {
            let axis = na::Vector3::new(0.48, -0.6, 0.64) * angle;
            let twist = Twist::new(0.1, -0.2, 0.05, axis.x, axis.y, axis.z);
            assert!((exp(&twist).to_homogeneous() - by_squaring(&twist)).abs().max() < 1e-8, "angle {angle}");
        }
    }

    #[test]
    fn logarithm_near_a_half_turn() {
        for short_of_pi in [1e-3, 1e-6, 1e-9, 1e-13, 0.0] {
            for axis in [na::Vector3::new(1.0, 0.0, 0.0), na::Vector3::new(-0.48, 0.6, 0.64)] {
                let w = axis * (PI - short_of_pi);
                let motion = exp(&Twist::new(0.3, 0.2, -0.1, w.x, w.y, w.z));
                assert!(difference(&exp(&log(&motion)), &motion) < 1e-12, "{short_of_pi}");
                assert!((log(&motion).fixed_rows::<3>(3).norm() - (PI - short_of_pi)).abs() < 1e-9);
            }
        }
    }

    proptest! {
        #[test]
        fn log_inverts_exp(v in prop::array::uniform3(-0.5..0.5), axis in prop::array::uniform3(-1.0..1.0f64), size in 0..12i32) {
            let direction = na::Vector3::from(axis).try_normalize(1e-9).unwrap_or_else(na::Vector3::x);
            let w = direction * 3.0 * 10f64.powi(-size);
            let twist = Twist::new(v[0], v[1], v[2], w.x, w.y, w.z);
            prop_assert!((log(&exp(&twist)) - twist).norm() < 1e-10);
            let inverse = exp(&-twist);
            prop_assert!(difference(&(exp(&twist) * inverse), &na::Isometry3::identity()) < 1e-12);
            let other = exp(&Twist::new(0.1, 0.2, 0.3, 0.5, -0.4, 0.9));
            let carried = exp(&(adjoint(&other) * twist));
            prop_assert!(difference(&(other * exp(&twist) * other.inverse()), &carried) < 1e-10);
        }
    }
}
