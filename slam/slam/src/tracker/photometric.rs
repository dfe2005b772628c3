//! Brightness: points of the surface look alike in an earlier frame and in a later one.
//!
//! Each texel of the earlier image is projected into the later one, and the difference of the brightness is a residual (direct alignment:
//! Engel, Koltun and Cremers, "Direct sparse odometry", 2018). It needs fewer pixels than places that are searched for, and less motion.

use nalgebra as na;

use super::icp::Posed;
use super::{apply, to_na};
use crate::scan::{Texel, View};
use mvt_frames::se3::Twist;
use mvt_graph::system::{Loss, System, along};

/// Noise of the brightness and its changes with the light, one standard deviation, grey levels.
const GREY_SIGMA: f64 = 6.0;
/// The same in proportion to the contrast of a place.
const CONTRAST_SIGMA: f64 = 0.25;
/// Cost grows with the logarithm from this many standard deviations on.
const ROBUST_SIGMAS: f64 = 2.0;

/// Fewer texels than these say nothing about a pose.
const FEWEST_COMPARED: usize = 40;
/// Frames whose brightness correlates by this much show the same places.
pub(super) const AGREES: f64 = 0.7;

/// How the brightness of two frames is compared.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Comparison {
    /// Resolution of the images: 0 is the finest.
    pub level: usize,
    /// All texels together weigh as much as so many independent ones.
    pub independent: f64,
}

/// A texel of an earlier frame in a later one.
struct Compared {
    /// Brightness there and here, grey levels.
    expected: f64,
    value: f64,
    /// Derivative of the value by the disturbance of the later pose.
    slope: Twist,
}

/// The texels of `then` that the later frame shows.
fn compared(then: Posed<'_>, now: Posed<'_>, level: usize) -> Vec<Compared> {
    let back = [then.pose, now.pose].map(na::Isometry3::inverse);
    let now_from_then = now.pose * back[0];
    let scale = f64::from(1_u32 << level);
    let mut compared = Vec::new();
    for view in &now.scan.views {
        let Some(picture) = view.texels() else { continue };
        let same = |other: &&View| other.sensor() == view.sensor();
        let Some(earlier) = then.scan.views.iter().find(same).and_then(View::texels) else { continue };
        let Some(contrasts) = picture.levels.get(level) else { continue };
        compared.extend(earlier.texels.iter().filter_map(|&Texel { channel, point, normal, values }| {
            let expected = values[level]?;
            let moved = apply(&now_from_then, point);
            if !picture.faces(moved, apply(&now_from_then, point + normal) - moved) {
                return None;
            }
            let (pixel, [along_u, along_v]) = picture.lens.project_with_slopes(to_na(moved))?;
            let at = picture.to_level([pixel.x as f32, pixel.y as f32], level);
            let (value, [by_u, by_v]) = contrasts.get(channel)?.sample(at)?;
            let slope = (along_u * f64::from(by_u) + along_v * f64::from(by_v)) / scale;
            let material = back[0] * na::Point3::from(to_na(point));
            let slope = along(back[1].rotation * slope, material.coords);
            Some(Compared { expected: f64::from(expected), value: f64::from(value), slope })
        }));
    }
    compared
}

/// Adds the differences of brightness at the texels of `then`.
pub(super) fn add(
    system: &mut System,
    then: (Option<usize>, Posed<'_>),
    now: (Option<usize>, Posed<'_>),
    comparison: Comparison,
) {
    let compared = compared(then.1, now.1, comparison.level);
    let share = (comparison.independent / compared.len().max(1) as f64).min(1.0);
    for Compared { expected, value, slope } in compared {
        let sigma = GREY_SIGMA.hypot(CONTRAST_SIGMA * expected);
        let j = slope / sigma;
        system.add((value - expected) / sigma, &[(now.0, j), (then.0, -j)], share, Loss::Cauchy(ROBUST_SIGMAS));
    }
}

/// Correlation of the brightness of earlier frames with that of a later one at the texels that both show, -1 to 1; `None` if these are few.
pub(super) fn correlation<'a>(thens: impl IntoIterator<Item = Posed<'a>>, now: Posed<'_>, level: usize) -> Option<f64> {
    let [mut product, mut there, mut here] = [0.0; 3];
    let mut count = 0;
    for then in thens {
        for Compared { expected, value, .. } in compared(then, now, level) {
            (product, there, here) = (product + expected * value, there + expected * expected, here + value * value);
            count += 1;
        }
    }
    (count >= FEWEST_COMPARED && there * here > 0.0).then(|| product / (there * here).sqrt())
}
