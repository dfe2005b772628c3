//! Shear, twist and dilation that explain the motion of dots.

use mvt_robot::digit::markers::{GelMotion, GelShear};
use nalgebra::{Matrix4, Vector4};

/// What explains the motion of the dots of one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShearFit {
    /// Middle of the contact, millimetres to the right and downwards from the middle of the gel.
    pub centre_mm: [f64; 2],
    /// Displacement and turn of the gel at the contact.
    pub shear: GelShear,
    /// Spread of the gel around the contact, 1 for the gel of FOTS under the same indentation; 0 if no dot lies in the contact.
    pub dilation: f64,
    /// Root mean square of the residual motion of the dots, millimetres.
    pub residual_mm: f64,
}

/// Steps of the solver, which starts at rest; motions of 1 mm need four.
const STEPS: usize = 8;
/// Deviations from this on weigh less than half, millimetres: dots are found to some hundredths.
const ROBUST_MM: f64 = 0.06;
/// Step of the finite differences, millimetres and radians.
const STEP: f64 = 1e-5;
/// Keeps numbers that nothing measures at rest.
const DAMPING: f64 = 1e-6;

/// Returns the motion of a gel with a dilation.
fn motion(centre_mm: [f64; 2], shear: GelShear, dilation: f64, pressed: &[([f64; 2], f64)]) -> GelMotion {
    GelMotion { centre_mm, shear, pressed: pressed.iter().map(|(place, mm)| (*place, dilation * mm)).collect() }
}

impl ShearFit {
    /// Returns the motion that the fit describes.
    pub(crate) fn motion(&self, pressed: &[([f64; 2], f64)]) -> GelMotion {
        motion(self.centre_mm, self.shear, self.dilation, pressed)
    }
}

/// Fits the motion of dots, each given by its place on the unloaded gel and the place where it is, millimetres. `pressed` are the places in
/// contact with their indentation, millimetres.
pub(crate) fn fit(motions: &[([f64; 2], [f64; 2])], centre_mm: [f64; 2], pressed: &[([f64; 2], f64)]) -> ShearFit {
    let model = |x: &Vector4<f64>| {
        motion(centre_mm, GelShear { displacement_mm: [x[0], x[1]], twist_rad: x[2] }, x[3], pressed)
    };
    let residuals = |x: &Vector4<f64>| -> Vec<[f64; 2]> {
        let model = model(x);
        let off = |(from, to): &([f64; 2], [f64; 2])| {
            let expected = model.moved(*from);
            [to[0] - expected[0], to[1] - expected[1]]
        };
        motions.iter().map(off).collect()
    };
    let mut x = Vector4::zeros();
    for _ in 0..STEPS {
        let left = residuals(&x);
        let slopes: [Vec<[f64; 2]>; 4] = std::array::from_fn(|k| {
            let mut disturbed = x;
            disturbed[k] += STEP;
            residuals(&disturbed)
        });
        let (mut hessian, mut gradient) = (Matrix4::identity() * DAMPING, Vector4::zeros());
        for (i, left_mm) in left.iter().enumerate() {
            // As Cauchy's, so that a dot that is taken for its neighbour hardly counts.
            let weight = 1.0 / (1.0 + (left_mm[0].powi(2) + left_mm[1].powi(2)) / ROBUST_MM.powi(2));
            for (axis, &here) in left_mm.iter().enumerate() {
                let j = Vector4::from_fn(|k, _| (here - slopes[k][i][axis]) / STEP);
                hessian += weight * j * j.transpose();
                gradient += weight * j * here;
            }
        }
        let Some(step) = hessian.cholesky().map(|solver| solver.solve(&gradient)) else { break };
        x += step;
    }
    let left = residuals(&x);
    let square: f64 = left.iter().map(|off| off[0] * off[0] + off[1] * off[1]).sum();
    ShearFit {
        centre_mm,
        shear: model(&x).shear,
        dilation: x[3],
        residual_mm: (square / left.len().max(1) as f64).sqrt(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvt_robot::digit::markers::MarkerPattern;

    #[test]
    fn drawn_motions_are_found_beside_wrong_dots() {
        let pressed = vec![([0.3, -0.7], 0.6), ([1.2, 0.1], 0.4)];
        let shear = GelShear { displacement_mm: [0.8, -0.5], twist_rad: 0.25 };
        let centre_mm = [0.5, -0.4];
        let motion = GelMotion { centre_mm, shear, pressed: pressed.clone() };
        let mut motions: Vec<_> = MarkerPattern::default().places_mm().map(|p| (p, motion.moved(p))).collect();
        let exact = fit(&motions, centre_mm, &pressed);
        assert!(exact.residual_mm < 1e-6 && (exact.dilation - 1.0).abs() < 1e-4, "{exact:?}");
        for (found, drawn) in [
            (exact.shear.displacement_mm[0], 0.8),
            (exact.shear.displacement_mm[1], -0.5),
            (exact.shear.twist_rad, 0.25),
        ] {
            assert!((found - drawn).abs() < 1e-4, "{exact:?}");
        }
        for wrong in [27, 28, 36, 44] {
            motions[wrong].1[0] += 0.9;
        }
        let robust = fit(&motions, centre_mm, &pressed);
        let [x, y] = robust.shear.displacement_mm;
        assert!((x - 0.8).hypot(y + 0.5) < 0.05 && (robust.shear.twist_rad - 0.25).abs() < 0.03, "{robust:?}");
        assert!(robust.residual_mm > 0.1, "the wrong dots show");
    }

    #[test]
    fn what_no_dot_shows_stays_at_rest() {
        let places: Vec<_> = MarkerPattern::default().places_mm().map(|p| (p, p)).collect();
        let still = fit(&places, [0.0, 0.0], &[]);
        assert_eq!((still.shear, still.dilation, still.residual_mm), (GelShear::default(), 0.0, 0.0));
        assert_eq!(fit(&[], [0.0, 0.0], &[]).shear, GelShear::default());
    }
}
