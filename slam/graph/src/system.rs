//! A robust least-squares problem over the poses of a window, and its Gauss-Newton step.
//!
//! Every residual is a number divided by its standard deviation, so that its square is its weight. A pose is disturbed on the
//! right, in the model's frame: T <- T exp(d), d = (v, w).

use nalgebra as na;

use mvt_frames::se3;
use mvt_frames::se3::Twist;

/// The normal equations H d = -g over `n` poses, six numbers each.
#[derive(Debug, Clone)]
pub struct System {
    /// H, the sum of weighted J J^T.
    pub hessian: na::DMatrix<f64>,
    /// g, the sum of weighted J r.
    pub gradient: na::DVector<f64>,
    /// The sum of the robust costs.
    pub cost: f64,
}

/// How a residual's cost grows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// With the square.
    Square,
    /// With the square up to about this many standard deviations, then with the logarithm (Cauchy).
    Cauchy(f64),
}

impl Loss {
    /// Cost of a residual, and the weight with which it enters the normal equations.
    pub fn at(self, residual: f64) -> (f64, f64) {
        match self {
            Loss::Square => (0.5 * residual * residual, 1.0),
            Loss::Cauchy(scale) => {
                let x = 1.0 + (residual / scale).powi(2);
                (0.5 * scale * scale * x.ln(), 1.0 / x)
            }
        }
    }
}

/// The derivative of a residual by one pose of the window; `None` for a pose that is held.
pub type Block = (Option<usize>, Twist);

impl System {
    /// An empty problem over `poses` poses.
    pub fn new(poses: usize) -> Self {
        Self { hessian: na::DMatrix::zeros(6 * poses, 6 * poses), gradient: na::DVector::zeros(6 * poses), cost: 0.0 }
    }

    /// Adds a residual (in standard deviations) with its derivatives; `share` scales its cost.
    pub fn add(&mut self, residual: f64, blocks: &[Block], share: f64, loss: Loss) {
        let (cost, weight) = loss.at(residual);
        self.cost += share * cost;
        let weight = share * weight;
        for (i, a) in blocks {
            let Some(i) = *i else { continue };
            let weighted = a * weight;
            let mut rows = self.gradient.fixed_rows_mut::<6>(6 * i);
            rows += weighted * residual;
            for (j, b) in blocks {
                let Some(j) = *j else { continue };
                let mut block = self.hessian.fixed_view_mut::<6, 6>(6 * i, 6 * j);
                for (mut column, b) in block.column_iter_mut().zip(b.iter()) {
                    column += weighted * *b;
                }
            }
        }
    }

    /// Adds residuals that depend on how two poses differ: `hessian` and `gradient` are those by the first pose, and a disturbance of
    /// the second has the opposite effect.
    pub fn add_relative(
        &mut self,
        cost: f64,
        hessian: &na::Matrix6<f64>,
        gradient: &Twist,
        [first, second]: [Option<usize>; 2],
    ) {
        self.cost += cost;
        for (a, sign) in [(first, 1.0), (second, -1.0)] {
            let Some(a) = a else { continue };
            let mut rows = self.gradient.fixed_rows_mut::<6>(6 * a);
            rows += sign * gradient;
            for (b, other) in [(first, 1.0), (second, -1.0)] {
                let Some(b) = b else { continue };
                let mut block = self.hessian.fixed_view_mut::<6, 6>(6 * a, 6 * b);
                block += sign * other * hessian;
            }
        }
    }

    /// The step of Levenberg and Marquardt with this damping, relative to the diagonal; `None` if it has none.
    pub fn step(&self, damping: f64) -> Option<na::DVector<f64>> {
        let mut damped = self.hessian.clone();
        for i in 0..damped.nrows() {
            // The floor keeps directions that nothing measures where they are.
            damped[(i, i)] += damping * damped[(i, i)] + 1e-6;
        }
        let step = damped.cholesky()?.solve(&-&self.gradient);
        step.iter().all(|x| x.is_finite()).then_some(step)
    }
}

fn twist(v: na::Vector3<f64>, w: na::Vector3<f64>) -> Twist {
    Twist::new(v.x, v.y, v.z, w.x, w.y, w.z)
}

/// Derivative of direction . (T m) by the disturbance of T, for `direction` turned into the model's frame and the model point m.
pub fn along(direction: na::Vector3<f64>, point: na::Vector3<f64>) -> Twist {
    twist(direction, point.cross(&direction))
}

/// Change of motion over three frames: Log(T1^-1 T2) - k Log(T0^-1 T1), with its derivatives by the disturbances of T0, T1 and T2.
/// With `keep` k below 1, motion that nothing measures dies away.
pub fn velocity(t: [&na::Isometry3<f64>; 3], keep: f64) -> (Twist, [na::Matrix6<f64>; 3]) {
    let (first, second) = (t[0].inverse() * t[1], t[1].inverse() * t[2]);
    let (a, b) = (se3::log(&first), se3::log(&second));
    let (da, db) = (se3::inverse_right_jacobian(&a), se3::inverse_right_jacobian(&b));
    let back = |m: &na::Isometry3<f64>| se3::adjoint(&m.inverse());
    (b - keep * a, [keep * da * back(&first), -db * back(&second) - keep * da, db])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn motion(t: [f64; 6]) -> na::Isometry3<f64> {
        se3::exp(&Twist::from(t))
    }

    /// Central differences of a function of one disturbed pose.
    fn slopes(pose: &na::Isometry3<f64>, f: impl Fn(&na::Isometry3<f64>) -> f64) -> Twist {
        const STEP: f64 = 1e-6;
        Twist::from_fn(|i, _| {
            let mut d = Twist::zeros();
            d[i] = STEP;
            (f(&(pose * se3::exp(&d))) - f(&(pose * se3::exp(&-d)))) / (2.0 * STEP)
        })
    }

    proptest! {
        #[test]
        fn derivatives_are_those_of_finite_differences(
            poses in prop::array::uniform3(prop::array::uniform6(-0.3..0.3f64)),
            p in prop::array::uniform3(-0.05..0.05f64),
            d in prop::array::uniform3(-1.0..1.0f64),
        ) {
            let t = poses.map(motion);
            let (p, d) = (na::Vector3::from(p), na::Vector3::from(d));

            let m = t[0].rotation.inverse() * d;
            let expected = slopes(&t[0], |t| d.dot(&(t * na::Point3::from(p)).coords));
            prop_assert!((along(m, p) - expected).norm() < 1e-8);

            let (_, jacobians) = velocity([&t[0], &t[1], &t[2]], 0.7);
            for k in 0..3 {
                for row in 0..6 {
                    let expected = slopes(&t[k], |disturbed| {
                        let mut t = t;
                        t[k] = *disturbed;
                        velocity([&t[0], &t[1], &t[2]], 0.7).0[row]
                    });
                    let j = jacobians[k].row(row).transpose();
                    prop_assert!((j - expected).norm() < 1e-5, "pose {k}, row {row}: {j} {expected}");
                }
            }
        }
    }

    #[test]
    fn step_reaches_the_minimum_of_a_quadratic() {
        let mut system = System::new(2);
        let target = na::DVector::from_fn(12, |i, _| i as f64 - 5.0);
        for i in 0..12 {
            let mut row = Twist::zeros();
            row[i % 6] = 100.0;
            system.add(-100.0 * target[i], &[(Some(i / 6), row)], 1.0, Loss::Square);
        }
        assert!((system.step(0.0).unwrap() - target).norm() < 1e-6);
    }

    #[test]
    fn weights_are_the_slopes_of_the_costs() {
        for loss in [Loss::Square, Loss::Cauchy(2.0)] {
            for r in [-7.0, -0.5, 0.3, 4.0] {
                let slope = (loss.at(r + 1e-6).0 - loss.at(r - 1e-6).0) / 2e-6;
                assert!((slope - loss.at(r).1 * r).abs() < 1e-6);
            }
        }
    }
}
