//! Forces of fingertips that together carry an object.

use std::f64::consts::TAU;

use nalgebra as na;

/// Contact of a fingertip with an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Contact {
    /// Where they touch, metres.
    pub(crate) point: na::Point3<f64>,
    /// Unit normal into the object.
    pub(crate) normal: na::Vector3<f64>,
}

/// Coefficient of friction that a grasp may need; gels have at least 0.89.
const FRICTION: f64 = 0.8;
/// Least force along the normal with which each fingertip presses, newtons.
const LEAST_N: f64 = 0.12;
/// Greatest force of a fingertip, newtons.
const MOST_N: f64 = 2.5;
/// Force and torque that may be left over, relative to the weight.
const LEFT_OVER: f64 = 0.03;
/// Lever at which a torque counts as a force, metres: the radius of an object that fits.
const LEVER_M: f64 = 0.035;
/// Edges of the pyramid that stands for the cone of friction.
const EDGES: usize = 6;
/// Weight of the forces themselves, so that the smallest of all solutions is found.
const RIDGE: f64 = 1e-4;
/// Sweeps over all unknowns; the forces change by less than a thousandth in further ones.
const SWEEPS: usize = 300;

/// Returns the force of each contact on the object, newtons, so that they balance its weight and the torque about its centre of
/// mass with friction, or `None` if they cannot. The sum of their squares is as small as possible.
pub(crate) fn balance(contacts: &[Contact], centre: na::Point3<f64>, weight_n: f64) -> Option<Vec<na::Vector3<f64>>> {
    let wrench = |contact: &Contact, force: na::Vector3<f64>| {
        let torque = (contact.point - centre).cross(&force) / LEVER_M;
        na::Vector6::new(force.x, force.y, force.z, torque.x, torque.y, torque.z)
    };
    let mut missing = na::Vector6::new(0.0, 0.0, weight_n, 0.0, 0.0, 0.0);
    let mut edges = Vec::with_capacity(contacts.len() * EDGES);
    for contact in contacts {
        missing -= wrench(contact, contact.normal * LEAST_N);
        let aside = if contact.normal.z.abs() < 0.9 { na::Vector3::z() } else { na::Vector3::x() };
        let first = contact.normal.cross(&aside).normalize();
        let second = contact.normal.cross(&first);
        for edge in 0..EDGES {
            let (sin, cos) = (TAU * edge as f64 / EDGES as f64).sin_cos();
            edges.push(contact.normal + (first * cos + second * sin) * FRICTION);
        }
    }
    let columns: Vec<na::Vector6<f64>> = edges
        .iter()
        .zip(contacts.iter().flat_map(|contact| std::iter::repeat_n(contact, EDGES)))
        .map(|(edge, contact)| wrench(contact, *edge))
        .collect();
    let sizes = nonnegative_least_squares(&columns, missing);
    let left: na::Vector6<f64> = missing - columns.iter().zip(&sizes).map(|(c, x)| c * *x).sum::<na::Vector6<f64>>();
    let force = |(k, contact): (usize, &Contact)| {
        let own = k * EDGES..(k + 1) * EDGES;
        contact.normal * LEAST_N + own.map(|i| edges[i] * sizes[i]).sum::<na::Vector3<f64>>()
    };
    let forces: Vec<na::Vector3<f64>> = contacts.iter().enumerate().map(force).collect();
    (left.norm() <= LEFT_OVER * weight_n && forces.iter().all(|force| force.norm() <= MOST_N)).then_some(forces)
}

/// Returns the numbers from 0 on with which the columns add up to `sum` best, by descent along one of them after the other.
fn nonnegative_least_squares(columns: &[na::Vector6<f64>], sum: na::Vector6<f64>) -> Vec<f64> {
    let mut sizes = vec![0.0; columns.len()];
    let mut left = sum;
    for _ in 0..SWEEPS {
        for (column, size) in columns.iter().zip(&mut sizes) {
            let step = (column.dot(&left) - RIDGE * *size) / (column.norm_squared() + RIDGE);
            let new = f64::max(*size + step, 0.0);
            left -= column * (new - *size);
            *size = new;
        }
    }
    sizes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn contact(x: f64, y: f64, z: f64) -> Contact {
        let point = na::Point3::new(x, y, z);
        Contact { point, normal: -point.coords.normalize() }
    }

    #[test]
    fn opposite_fingers_carry_half_the_weight_each() {
        let contacts = [contact(0.035, 0.0, 0.0), contact(-0.035, 0.0, 0.0)];
        let forces = balance(&contacts, na::Point3::origin(), 1.0).unwrap();
        for force in &forces {
            assert!((force.z - 0.5).abs() < 0.02, "{force}");
            assert!(force.z <= FRICTION * force.x.abs() + 1e-9, "{force}");
        }
        assert!((forces[0].x + forces[1].x).abs() < 0.02);
    }

    #[test]
    fn fingers_below_carry_and_those_above_do_not() {
        let cup = [[1.0, 0.0], [-0.5, 0.8], [-0.5, -0.8]].map(|[x, y]| contact(0.02 * x, 0.02 * y, -0.03));
        assert!(balance(&cup, na::Point3::origin(), 1.0).is_some());
        let lid = [[1.0, 0.0], [-0.5, 0.8], [-0.5, -0.8]].map(|[x, y]| contact(0.01 * x, 0.01 * y, 0.03));
        assert_eq!(balance(&lid, na::Point3::origin(), 1.0), None);
    }

    #[test]
    fn an_object_that_is_too_heavy_or_off_balance_is_not_carried() {
        let contacts = [contact(0.035, 0.0, 0.0), contact(-0.035, 0.0, 0.0)];
        assert_eq!(balance(&contacts, na::Point3::origin(), 20.0), None);
        assert_eq!(balance(&contacts, na::Point3::new(0.0, 0.03, 0.0), 1.0), None);
    }
}
