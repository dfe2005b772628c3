//! Brightness: points of the surface look alike in an earlier frame and in a later one.
//!
//! Each texel of the earlier image is projected into the later one, and the difference of the brightness is a residual (direct alignment:
//! Engel, Koltun and Cremers, "Direct sparse odometry", 2018). It needs fewer pixels than places that are searched for, and less motion.

use nalgebra as na;

use super::icp::Posed;
use super::system::{Loss, System, along};
use super::{apply, to_na};
use crate::scan::{Texel, View};

/// Noise of the brightness and its changes with the light, one standard deviation, grey levels.
const GREY_SIGMA: f64 = 6.0;
/// The same in proportion to the contrast of a place.
const CONTRAST_SIGMA: f64 = 0.25;
/// Cost grows with the logarithm from this many standard deviations on.
const ROBUST_SIGMAS: f64 = 2.0;

/// How the brightness of two frames is compared.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Comparison {
    /// Resolution of the images: 0 is the finest.
    pub level: usize,
    /// All texels together weigh as much as so many independent ones.
    pub independent: f64,
}

/// Adds the differences of brightness at the texels of `then`. Returns how many of them the later frame shows.
pub(super) fn add(
    system: &mut System,
    then: (Option<usize>, Posed<'_>),
    now: (Option<usize>, Posed<'_>),
    comparison: Comparison,
) -> usize {
    let ((index_then, then), (index_now, now)) = (then, now);
    let now_from_then = now.pose * then.pose.inverse();
    let mut compared = Vec::new();
    for view in &now.scan.views {
        let Some(picture) = view.texels() else { continue };
        let same = |other: &&View| other.sensor() == view.sensor();
        let Some(earlier) = then.scan.views.iter().find(same).and_then(View::texels) else { continue };
        let level = comparison.level;
        let Some(contrast) = picture.levels.get(level) else { continue };
        let scale = f64::from(1_u32 << level);
        compared.extend(earlier.texels.iter().filter_map(|&Texel { point, normal, values }| {
            let expected = values[level]?;
            let moved = apply(&now_from_then, point);
            if !picture.faces(moved, apply(&now_from_then, point + normal) - moved) {
                return None;
            }
            let (pixel, [along_u, along_v]) = picture.lens.project_with_slopes(to_na(moved))?;
            let at = picture.to_level([pixel.x as f32, pixel.y as f32], level);
            let (value, [by_u, by_v]) = contrast.sample(at)?;
            let sigma = GREY_SIGMA.hypot(CONTRAST_SIGMA * f64::from(expected));
            let slope = (along_u * f64::from(by_u) + along_v * f64::from(by_v)) / (scale * sigma);
            let material = then.pose.inverse() * na::Point3::from(to_na(point));
            let j = along(now.pose.rotation.inverse() * slope, material.coords);
            Some((f64::from(value - expected) / sigma, j))
        }));
    }
    let share = (comparison.independent / compared.len().max(1) as f64).min(1.0);
    for &(residual, j) in &compared {
        system.add(residual, &[(index_now, j), (index_then, -j)], share, Loss::Cauchy(ROBUST_SIGMAS));
    }
    compared.len()
}
