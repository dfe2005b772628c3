//! Colour: places of the object's surface that an earlier frame and a later one both show.
//!
//! Around each place of the earlier image a square is cut out, warped as the predicted motion turns the surface, and moved over the later
//! image until both agree (Lucas and Kanade, from coarse to fine, with the slopes of the earlier image: Baker and Matthews, "Lucas-Kanade
//! 20 years on", 2004). Light does not turn with the object: contrast, brightness and its even slope across a square are free, and what
//! they could explain counts for nothing. The distance of the place that was found from where a pose puts it is a residual in pixels.

// Why: notes/decisions/estimation.md, "Colours are compared at places, against the frame before and two earlier views".

use glam::{Mat2, Vec2, Vec3};
use nalgebra as na;

use mvt_frames::se3::Twist;
use mvt_frames::{Field, Isometry, World, se3};

use super::{ROBUST_SIGMAS, apply, to_na};
use crate::earlier::EarlierView;
use crate::scan::{LEAST_COSINE, LEVELS, Lens, Level, Patch, Picture, Scan, View};
use mvt_graph::system::{Loss, System, along};

/// Half the side of a square, pixels of each resolution.
const RADIUS: usize = 4;
const SIDE: usize = 2 * RADIUS + 1;
const PIXELS: usize = SIDE * SIDE;
/// Steps per resolution; most squares need two or three.
const STEPS: usize = 6;
/// A step below this ends them, pixels of the resolution.
const SMALL_STEP_PX: f32 = 0.03;
/// A square that leaves its expected place by more than this is lost, pixels.
const FARTHEST_PX: f32 = 20.0;
/// Squares whose brightness deviates by less than this from an even slope show nothing, grey levels.
const LEAST_CONTRAST: f32 = 1.5;
/// Correlation of two squares, without even slopes, above which they show the same place.
const LEAST_CORRELATION: f32 = 0.85;
/// Standard deviation of brightness between images of one place, grey levels: noise, compression and errors of the warp.
const GREY_SIGMA: f32 = 4.0;
/// Places must agree with a common motion to so many standard deviations, or they are wrong.
const AGREES_SIGMAS: f64 = 4.0;
// Why: notes/decisions/estimation.md, "Colours move a pose only if most places agree on a motion, and depth does not speak against it".
/// Of the places that were found, this part must agree, and at least so many: else none is believed.
const LEAST_AGREEING: (f64, usize) = (0.5, 10);
/// Prior of the motion before colours are compared, one standard deviation, metres and radians: keeps directions that they do
/// not show.
const PRIOR_SIGMA: [f64; 2] = [0.005, 0.15];
/// If less than this part of the places of the frame before is found, poses turned by so much are tried, radians.
const ENOUGH: f64 = 0.4;
const SEARCH_RAD: f64 = 0.17;
/// From a pose that is off by more than this the squares are warped wrongly, radians; then they are compared again, so many times at most.
const NEAR_RAD: f64 = 0.02;
const ROUNDS: usize = 3;
/// Steps to the common motion.
const CONSENSUS_STEPS: usize = 8;

/// A place that was found again.
#[derive(Debug, Clone, Copy)]
struct Found {
    /// The place: in the world of the frame before, or in the model's frame.
    place: na::Point3<f64>,
    /// Where it was found, pixels.
    pixel: na::Vector2<f64>,
    /// Takes displacements in pixels to standard deviations.
    root: na::Matrix2<f64>,
}

/// Places of an earlier frame that a camera of a later one shows.
#[derive(Debug, Clone)]
pub(super) struct Tie {
    /// Whether the earlier frame is the one before, whose pose is free; else its pose is held.
    is_before: bool,
    lens: Lens,
    found: Vec<Found>,
}

impl Tie {
    /// Number of places.
    #[cfg(test)]
    pub fn len(&self) -> usize {
        self.found.len()
    }

    /// Moves places in the model's frame to another such frame: `correction` takes coordinates of the new one to the old.
    pub fn rebase(&mut self, correction: &na::Isometry3<f64>) {
        if !self.is_before {
            self.found.iter_mut().for_each(|found| found.place = correction.inverse() * found.place);
        }
    }

    /// The place in the model's frame.
    fn in_model(&self, found: &Found, before: &na::Isometry3<f64>) -> na::Point3<f64> {
        if self.is_before { before.inverse() * found.place } else { found.place }
    }

    /// Adds the residuals; `before` is the frame before with its index, if it is still there.
    pub fn add(
        &self,
        system: &mut System,
        before: Option<(Option<usize>, &na::Isometry3<f64>)>,
        now: (Option<usize>, &na::Isometry3<f64>),
        independent: f64,
    ) {
        // The pose of a held view stands in its places.
        let Some(before) = before.or((!self.is_before).then_some((None, now.1))) else { return };
        let earlier = if self.is_before { before.0 } else { None };
        let sum = self.sum(before.1, now.1, 1.0);
        let share = self.share(independent);
        system.add_relative(share * sum.cost, &(share * sum.hessian), &(share * sum.gradient), [now.0, earlier]);
    }

    /// The information about a pose, where the earlier one is held.
    pub fn information(&self, pose: &na::Isometry3<f64>, independent: f64) -> na::Matrix6<f64> {
        if self.is_before {
            return na::Matrix6::zeros();
        }
        self.share(independent) * self.sum(pose, pose, 1.0).hessian
    }

    /// Part of the cost that each place carries.
    fn share(&self, independent: f64) -> f64 {
        (independent / self.found.len().max(1) as f64).min(1.0)
    }

    /// Costs of all places, and their derivatives by the pose; costs grow with the logarithm from `scale` times [`ROBUST_SIGMAS`] on.
    fn sum(&self, before: &na::Isometry3<f64>, now: &na::Isometry3<f64>, scale: f64) -> Sum {
        let mut sum = Sum::default();
        for found in &self.found {
            let material = self.in_model(found, before);
            let Some((residual, rows)) = residual(&self.lens, found, now, material) else { continue };
            // Both coordinates of a place are wrong together.
            let (cost, weight) = Loss::Cauchy(ROBUST_SIGMAS * scale).at(residual.norm());
            sum.cost += cost;
            for (k, row) in rows.iter().enumerate() {
                sum.hessian += weight * row * row.transpose();
                sum.gradient += weight * residual[k] * row;
            }
        }
        sum
    }
}

/// Costs, their gradient and the Gauss-Newton Hessian by a pose.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    cost: f64,
    gradient: Twist,
    hessian: na::Matrix6<f64>,
}

/// Displacement of a place in standard deviations, and its derivatives by the disturbance of the pose.
fn residual(
    lens: &Lens,
    found: &Found,
    pose: &na::Isometry3<f64>,
    material: na::Point3<f64>,
) -> Option<(na::Vector2<f64>, [Twist; 2])> {
    let (pixel, slopes) = lens.project_with_slopes((pose * material).coords)?;
    let inside = slopes.map(|slope| pose.rotation.inverse() * slope);
    let root = &found.root;
    let row = |k: usize| along(inside[0] * root[(k, 0)] + inside[1] * root[(k, 1)], material.coords);
    Some((root * (pixel - found.pixel), [row(0), row(1)]))
}

/// A frame whose colours are compared, and the frame before it.
pub(super) struct Pair<'a> {
    pub now: &'a Scan,
    pub before: Option<(&'a Scan, na::Isometry3<f64>)>,
    pub sigma_px: f64,
}

/// The squares around a place at all resolutions; `None` where the picture ends or shows nothing.
type Squares = [Option<Square>; LEVELS];

/// The squares around the places of each view of a scan.
fn squares(scan: &Scan) -> Vec<Vec<Squares>> {
    let of = |picture: &Picture| -> Vec<Squares> {
        picture.patches.iter().map(|patch| std::array::from_fn(|level| Square::cut(picture, patch, level))).collect()
    };
    scan.views.iter().map(|view| view.picture().map(of).unwrap_or_default()).collect()
}

impl Pair<'_> {
    /// The pose near `start` on which most colours agree, with the places that do; `None` if too few agree. `alike` gives the earlier
    /// views that are like one at a pose.
    pub fn follow(
        &self,
        start: &na::Isometry3<f64>,
        alike: &dyn Fn(Isometry<Field, World>) -> Vec<EarlierView>,
    ) -> Option<(na::Isometry3<f64>, Vec<Tie>)> {
        let cut = self.before.map(|(scan, _)| squares(scan)).unwrap_or_default();
        let (before, pose) = match self.before {
            Some((scan, pose)) => (pose, self.search((scan, &cut), &pose, start)?),
            None => (*start, *start),
        };
        let mut ties = self.compare(&pose, &cut, &alike(Isometry::new(pose)));
        let agreed = agree(&mut ties, &pose, &before)?;
        Some((agreed, ties))
    }

    /// The pose on which most places that the frame before shows agree: around `start`, or, where few are found from there, around turns
    /// of it.
    fn search(
        &self,
        (scan, cut): (&Scan, &[Vec<Squares>]),
        before: &na::Isometry3<f64>,
        start: &na::Isometry3<f64>,
    ) -> Option<na::Isometry3<f64>> {
        let tried: usize = scan.views.iter().filter_map(View::picture).map(|picture| picture.patches.len()).sum();
        let turn = |k: usize, sign: f64| {
            let turn = na::Vector3::ith(k, sign * SEARCH_RAD);
            na::Isometry3::rotation(turn)
        };
        let turns = (0..3).flat_map(|k| [turn(k, 1.0), turn(k, -1.0)]);
        let starts = [*start, *before].into_iter().chain(turns.map(|turn| start * turn));
        let mut best: Option<(usize, na::Isometry3<f64>)> = None;
        for mut pose in starts {
            let mut count = 0;
            // From a pose that is nearer more places are found.
            for _ in 0..ROUNDS {
                let mut ties = self.compare(&pose, cut, &[]);
                let Some(agreed) = agree(&mut ties, &pose, before) else { break };
                count = ties.iter().map(|tie| tie.found.len()).sum();
                let turned = pose.rotation.angle_to(&agreed.rotation);
                pose = agreed;
                if turned < NEAR_RAD {
                    break;
                }
            }
            if count > best.map_or(0, |(count, _)| count) {
                best = Some((count, pose));
            }
            if best.is_some_and(|(count, _)| count as f64 > ENOUGH * tried as f64) {
                break;
            }
        }
        best.map(|(_, pose)| pose)
    }

    /// Compares with the frame before, whose squares are `cut`, and with earlier views.
    fn compare(&self, pose: &na::Isometry3<f64>, cut: &[Vec<Squares>], kept: &[EarlierView]) -> Vec<Tie> {
        let mut ties = Vec::new();
        let cuts: Vec<_> = kept.iter().map(|view| squares(&view.scan)).collect();
        let before = self.before.map(|(scan, pose)| (scan, cut, pose, true));
        let kept = kept.iter().zip(&cuts);
        let kept = kept.map(|(view, cut)| (view.scan.as_ref(), cut.as_slice(), view.pose.untyped(), false));
        for (scan, squares, then_pose, is_before) in before.into_iter().chain(kept) {
            for view in &self.now.views {
                let Some(now) = view.picture() else { continue };
                let same = |(other, _): &(&View, &Vec<Squares>)| other.sensor() == view.sensor();
                let Some((then, squares)) = scan.views.iter().zip(squares).find(same) else { continue };
                let Some(then) = then.picture() else { continue };
                let now_from_then = pose * then_pose.inverse();
                let found = then.patches.iter().zip(squares).filter_map(|(patch, squares)| {
                    let (pixel, root) = find(patch, squares, now, &now_from_then, self.sigma_px as f32)?;
                    let place = na::Point3::from(to_na(patch.point));
                    let place = if is_before { place } else { then_pose.inverse() * place };
                    Some(Found { place, pixel, root })
                });
                ties.push(Tie { is_before, lens: now.lens.clone(), found: found.collect() });
            }
        }
        ties
    }
}

/// The pose with which most places agree, from `start`. Places that do not agree are removed. `None` if too few agree, and then
/// nothing is left of the ties.
fn agree(ties: &mut Vec<Tie>, start: &na::Isometry3<f64>, before: &na::Isometry3<f64>) -> Option<na::Isometry3<f64>> {
    let mut pose = *start;
    let size = |tie: &Tie, found: &Found, pose: &na::Isometry3<f64>| {
        residual(&tie.lens, found, pose, tie.in_model(found, before)).map(|(residual, _)| residual.norm())
    };
    let mut sizes: Vec<f64> =
        ties.iter().flat_map(|tie| tie.found.iter().filter_map(move |found| size(tie, found, start))).collect();
    if sizes.len() < LEAST_AGREEING.1 {
        ties.clear();
        return None;
    }
    let middle = sizes.len() / 2;
    let mut scale = sizes.select_nth_unstable_by(middle, f64::total_cmp).1.max(1.0);
    for _ in 0..CONSENSUS_STEPS {
        let mut system = System::new(1);
        for tie in ties.iter() {
            let sum = tie.sum(before, &pose, scale);
            system.add_relative(sum.cost, &sum.hessian, &sum.gradient, [Some(0), None]);
        }
        let moved = se3::log(&(start.inverse() * pose));
        for row in 0..6 {
            let s = 1.0 / PRIOR_SIGMA[row / 3];
            let mut j = Twist::zeros();
            j[row] = s;
            system.add(moved[row] * s, &[(Some(0), j)], 1.0, Loss::Square);
        }
        let Some(step) = system.step(1e-6) else { break };
        pose *= se3::exp(&step.fixed_rows::<6>(0).into_owned());
        scale = (scale / 2.0).max(1.0);
    }
    let tried = sizes.len();
    for tie in ties.iter_mut() {
        let kept = tie.found.iter().filter(|found| size(tie, found, &pose).is_some_and(|size| size < AGREES_SIGMAS));
        tie.found = kept.copied().collect();
    }
    let agreeing: usize = ties.iter().map(|tie| tie.found.len()).sum();
    if agreeing < LEAST_AGREEING.1 || (agreeing as f64) < LEAST_AGREEING.0 * tried as f64 {
        ties.clear();
        return None;
    }
    Some(pose)
}

/// Looks for a place of an earlier picture in a later one. Returns where it is, and the root of the information about that.
fn find(
    patch: &Patch,
    squares: &Squares,
    now: &Picture,
    now_from_then: &na::Isometry3<f64>,
    sigma_px: f32,
) -> Option<(na::Vector2<f64>, na::Matrix2<f64>)> {
    const STEP_PX: f32 = 4.0;
    let point = apply(now_from_then, patch.point);
    let normal = apply(now_from_then, patch.point + patch.normal) - point;
    if normal.dot((now.lens.origin - point).normalize_or_zero()) < LEAST_COSINE {
        return None;
    }
    let project = |point: Vec3| now.lens.project(point).map(Vec2::from);
    let expected = project(point)?;
    let side = |step: Vec3| Some((project(apply(now_from_then, patch.point + step * STEP_PX))? - expected) / STEP_PX);
    let warp = Mat2::from_cols(side(patch.steps[0])?, side(patch.steps[1])?);
    if !(0.3..3.0).contains(&warp.determinant()) {
        return None;
    }
    let mut at = expected;
    let mut finest = None;
    for level in (0..LEVELS).rev() {
        let (Some(square), Some(image)) = (squares.get(level).and_then(Option::as_ref), now.level(level)) else {
            continue;
        };
        let scale = (1_u32 << level) as f32;
        for _ in 0..STEPS {
            let step = square.step(&warped(image, now.to_level(at.into(), level), warp)?);
            at -= warp * step * scale;
            if (at - expected).length() > FARTHEST_PX || !at.is_finite() {
                return None;
            }
            if step.length() < SMALL_STEP_PX {
                break;
            }
        }
        finest = Some((square, image, level, scale));
    }
    // The coarsest resolution alone is too coarse.
    let (square, image, level, scale) = finest.filter(|(_, _, level, _)| *level + 1 < LEVELS)?;
    let seen = warped(image, now.to_level(at.into(), level), warp)?;
    if square.correlation(&seen) < LEAST_CORRELATION || !now.shows_object(at.into()) {
        return None;
    }
    let information = square.information.map(|x| x / (scale * scale));
    Some((na::Vector2::new(f64::from(at.x), f64::from(at.y)), root(information, warp, sigma_px)?))
}

/// A square of a picture with all that its comparison with another needs.
struct Square {
    values: [f32; PIXELS],
    /// The values without their even slope.
    bare: [f32; PIXELS],
    /// Slopes by column and row, less what light could explain.
    slopes: [[f32; PIXELS]; 2],
    /// Sums of their squares and of their product: (xx, xy, yy).
    information: [f32; 3],
    inverse: Mat2,
}

impl Square {
    /// `None` where the picture ends or shows nothing.
    fn cut(picture: &Picture, patch: &Patch, level: usize) -> Option<Self> {
        const WIDE: usize = SIDE + 2;
        let image = picture.level(level)?;
        let [u, v] = picture.to_level(patch.pixel, level);
        let reach = RADIUS as f32 + 1.0;
        if !image.holds([u, v], reach) {
            return None;
        }
        let wide: [f32; WIDE * WIDE] =
            std::array::from_fn(|i| image.sample([u - reach + (i % WIDE) as f32, v - reach + (i / WIDE) as f32]));
        let at = |i: usize| (i / SIDE + 1) * WIDE + i % SIDE + 1;
        let values = std::array::from_fn(|i| wide[at(i)]);
        let bare = without_slope(&values);
        let contrast = dot(&bare, &bare);
        if contrast < PIXELS as f32 * LEAST_CONTRAST * LEAST_CONTRAST {
            return None;
        }
        let slope = |reach: usize| -> [f32; PIXELS] {
            let slope = without_slope(&std::array::from_fn(|i| 0.5 * (wide[at(i) + reach] - wide[at(i) - reach])));
            let part = dot(&slope, &bare) / contrast;
            std::array::from_fn(|i| slope[i] - part * bare[i])
        };
        let slopes = [slope(1), slope(WIDE)];
        let information = [dot(&slopes[0], &slopes[0]), dot(&slopes[0], &slopes[1]), dot(&slopes[1], &slopes[1])];
        // Along an edge nothing is known: there it stays.
        let [xx, xy, yy] = information;
        let floor = 0.25 * PIXELS as f32;
        let inverse = Mat2::from_cols_array(&[xx + floor, xy, xy, yy + floor]).inverse();
        Some(Self { values, bare, slopes, information, inverse })
    }

    /// The displacement of this square, in its own pixels, that explains how another differs from it.
    fn step(&self, seen: &[f32; PIXELS]) -> Vec2 {
        let difference: [f32; PIXELS] = std::array::from_fn(|i| seen[i] - self.values[i]);
        self.inverse * Vec2::new(dot(&self.slopes[0], &difference), dot(&self.slopes[1], &difference))
    }

    fn correlation(&self, seen: &[f32; PIXELS]) -> f32 {
        let seen = without_slope(seen);
        dot(&self.bare, &seen) / (dot(&self.bare, &self.bare) * dot(&seen, &seen)).sqrt().max(1e-6)
    }
}

/// The square of an image around a place, warped.
fn warped(image: &Level, centre: [f32; 2], warp: Mat2) -> Option<[f32; PIXELS]> {
    let reach = RADIUS as f32 * (warp.x_axis.abs() + warp.y_axis.abs()).max_element();
    if !image.holds(centre, reach) {
        return None;
    }
    let centre = Vec2::from(centre);
    Some(std::array::from_fn(|i| {
        let [x, y] = [i % SIDE, i / SIDE].map(|k| k as f32 - RADIUS as f32);
        image.sample((centre + warp * Vec2::new(x, y)).into())
    }))
}

/// Values less their mean and even slopes.
fn without_slope(values: &[f32; PIXELS]) -> [f32; PIXELS] {
    let offset = |k: usize| k as f32 - RADIUS as f32;
    let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
    for (i, value) in values.iter().enumerate() {
        sum += value;
        x += value * offset(i % SIDE);
        y += value * offset(i / SIDE);
    }
    // Sum of the squares of all offsets along a side.
    let squares: f32 = (0..PIXELS).map(|i| offset(i % SIDE).powi(2)).sum();
    let (mean, x, y) = (sum / PIXELS as f32, x / squares, y / squares);
    std::array::from_fn(|i| values[i] - mean - x * offset(i % SIDE) - y * offset(i / SIDE))
}

fn dot(a: &[f32; PIXELS], b: &[f32; PIXELS]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The root of the information about a displacement in the later image, from that about one in the earlier.
fn root([xx, xy, yy]: [f32; 3], warp: Mat2, sigma_px: f32) -> Option<na::Matrix2<f64>> {
    let back = warp.inverse();
    let information = back.transpose() * Mat2::from_cols_array(&[xx, xy, xy, yy]) * back;
    let [a, b, c] = [information.x_axis.x, information.x_axis.y, information.y_axis.y].map(f64::from);
    let eigen = na::Matrix2::new(a, b, b, c).symmetric_eigen();
    let (grey, floor) = (f64::from(GREY_SIGMA).powi(2), f64::from(sigma_px).powi(2));
    // Noise of the brightness, and what no image shows better than.
    let precision = eigen.eigenvalues.map(|value| 1.0 / (grey / value.max(1e-3) + floor).sqrt());
    let root = na::Matrix2::from_diagonal(&precision) * eigen.eigenvectors.transpose();
    root.iter().all(|x| x.is_finite()).then_some(root)
}
