//! Masks of an object that are carried from frame to frame, where none is given.

use std::collections::VecDeque;

use glam::{Mat3A, Vec3, Vec3A};
use mvt_frames::camera::Intrinsics;
use mvt_frames::depth::{CameraDepth, Label};
use mvt_frames::{Camera, Isometry, Model};
use ndarray::Array2;

use crate::colours::Colours;

/// The surface of an object as far as it is known, in the frame of its estimated model, metres.
pub trait KnownSurface {
    /// Signed distances from the surface, negative inside; not finite where no surface was seen.
    fn distances_m(&self, points: &[Vec3]) -> Vec<f32>;
    /// Whether a sensor looked through the point.
    fn is_seen_empty(&self, point: Vec3) -> bool;
}

/// A mask that was carried into a frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CarriedMask {
    /// Where the object is visible; empty if it was not found.
    pub mask: Array2<bool>,
    /// Pixels beside the mask that may show the object or what touches it; as large as `mask`, or empty.
    pub contested: Array2<bool>,
    /// How sure it is: of the pixels that should show the object and that nothing hides, the share that shows a surface there, 0 to 1.
    pub sure: f32,
}

/// Carries masks by what is known of an object: the surface that was learnt, the points that it showed last, the space in which it was seen and
/// in which something else was, and its colours.
#[derive(Debug, Clone)]
pub struct MaskCarrier {
    /// Colours of the object and of what may touch it.
    touching: Colours,
    /// Colours of the object and of all else.
    everywhere: Colours,
    /// Evidence per cell around the model's origin: above 0 the object was seen in it, below 0 something else.
    cells: Vec<i8>,
    /// Points of the object in the newest frame that was learnt, model frame, with their colours.
    newest: Vec<(Vec3, Option<[u8; 3]>)>,
    /// That frame, without its colours.
    before: Option<CameraDepth>,
    /// The newest frame whose mask was given, likewise.
    given: Option<CameraDepth>,
    /// Usual area of the object across the rays, square metres.
    area_m2: f32,
}

/// Cells along an edge of the cube in which evidence is kept.
const CELLS: usize = 128;
/// Edge of a cell, metres: some pixels wide.
const CELL_M: f32 = 0.004;
/// Most evidence of a cell.
const MOST: i8 = 40;
/// Evidence of a pixel of a given mask; one of a carried mask has 1.
const GIVEN: i8 = 15;
/// Tolerance of depths near a surface: of the pose, metres, and by the sensor, metres per square metre of depth.
const TOLERANCE: [f32; 2] = [0.0015, 0.006];
/// Motion that the prediction of a pose may miss, metres.
const MISSED_M: f32 = 0.025;
/// The mask of a frame reaches at most so far beyond what the frames before showed, pixels.
const GROWTH_PX: usize = 10;
/// Pixels without depth that are as near to the object as this may show it, pixels.
const HOLE_PX: usize = 3;
/// Surroundings whose cells and colours are learnt, pixels around the object.
const AROUND_PX: usize = 40;
/// What is farther from the object along the optical axis does not touch it, metres.
const TOUCHING_M: f32 = 0.08;
/// Share of the colours that is kept from frame to frame, of what may touch the object and of all else: they change.
const TOUCHING_KEPT: f32 = 0.95;
const ELSEWHERE_KEPT: f32 = 0.98;
/// Every Nth row and column of the rest of the image is learnt.
const ELSEWHERE_STRIDE: usize = 4;
/// Fewer pixels that hang together are a speck.
const SPECK_PX: usize = 8;
/// A mask needs so many pixels, and this share of the usual area.
const LEAST_PX: usize = 40;
const LEAST_AREA: f32 = 0.04;
/// Below this share of agreement the object is lost.
const LEAST_SURE: f32 = 0.5;
/// Weights of what speaks for the object at a pixel: the learnt surface, the newest points, looked-through space, and of a unit of evidence.
const SURFACE: f32 = 2.5;
const NEWEST: f32 = 1.5;
const EMPTY: f32 = -4.0;
/// The same of a surface before that of the object, which hides it.
const NEARER: f32 = -2.5;
const EVIDENCE: f32 = 0.3;
/// From this weight of evidence on the object is known to have been seen in a place.
const KNOWN: f32 = 3.0;
/// Most that evidence and colours weigh.
const MOST_EVIDENCE: f32 = 5.0;
const MOST_COLOUR: f32 = 2.0;
/// Most that a colour weighs against the object where the object was last seen in another: something lies on it.
const MOST_OTHER: f32 = 8.0;
/// Levels of red, green and blue that differ by less are alike.
const ALIKE_LEVELS: u8 = 30;
/// A pixel beside the object belongs to it if no more than this speaks against it.
const GROWS_ABOVE: f32 = -0.2;
/// It stays open whose it is if no more than this does.
const CONTESTED_ABOVE: f32 = -2.3;
/// Areas of a lost object that are plausible, by the usual one.
const PLAUSIBLE: std::ops::Range<f32> = 0.2..1.7;
/// Mean logarithm of the odds of the colours around a pixel of a lost object.
const COLOURED: f32 = 0.5;
/// Of the regions that may show a lost object each is offered so long, seconds.
const OFFERED_S: f64 = 0.2;

/// Pixels of a camera in the frame of the model.
struct Pixels<'a> {
    image: &'a CameraDepth,
    rotation: Mat3A,
    origin: Vec3A,
}

impl<'a> Pixels<'a> {
    fn new(image: &'a CameraDepth, model_from_camera: Isometry<Camera, Model>) -> Self {
        let (rotation, origin) = model_from_camera.to_f32();
        Self { image, rotation, origin }
    }

    /// The measured depth of a pixel, metres.
    fn depth_m(&self, at: (usize, usize)) -> Option<f32> {
        self.image.depth_m.get(at).copied().filter(|depth| *depth > 0.0 && depth.is_finite())
    }

    fn point(&self, (v, u): (usize, usize), depth_m: f32) -> Vec3 {
        let Intrinsics { fx, fy, cx, cy, .. } = self.image.intrinsics;
        let ray = Vec3A::new(((u as f64 - cx) / fx) as f32, (-(v as f64 - cy) / fy) as f32, -1.0);
        (self.origin + self.rotation * (ray * depth_m)).into()
    }

    /// The pixel and the depth at which a point of the model is seen.
    fn project(&self, point: Vec3) -> Option<((f32, f32), f32)> {
        let p = self.rotation.transpose() * (Vec3A::from(point) - self.origin);
        let depth = -p.z;
        let Intrinsics { fx, fy, cx, cy, .. } = self.image.intrinsics;
        let place = (cy as f32 - fy as f32 * p.y / depth, cx as f32 + fx as f32 * p.x / depth);
        (depth > 0.01).then_some((place, depth))
    }

    fn colour(&self, (v, u): (usize, usize)) -> Option<[u8; 3]> {
        let colour = self.image.colour.as_ref()?;
        (colour.width() as usize > u && colour.height() as usize > v).then(|| colour.get_pixel(u as u32, v as u32).0)
    }

    /// Depths at which points of the model are seen, metres, and their colours, drawn as squares that reach `reach` pixels; infinite elsewhere.
    fn drawn(&self, points: &[(Vec3, Option<[u8; 3]>)], reach: isize) -> Array2<(f32, Option<[u8; 3]>)> {
        let mut depths = Array2::from_elem(self.image.depth_m.dim(), (f32::INFINITY, None));
        let projected = points.iter().filter_map(|(point, colour)| Some((self.project(*point)?, *colour)));
        for (((v, u), depth), colour) in projected {
            let (v, u) = (v.round() as isize, u.round() as isize);
            for (dv, du) in (-reach..=reach).flat_map(|dv| (-reach..=reach).map(move |du| (dv, du))) {
                let at = usize::try_from(v + dv).ok().zip(usize::try_from(u + du).ok());
                if let Some(drawn) = at.and_then(|at| depths.get_mut(at)).filter(|drawn| depth < drawn.0) {
                    *drawn = (depth, colour);
                }
            }
        }
        depths
    }
}

fn tolerance_m(depth_m: f32) -> f32 {
    TOLERANCE[0] + TOLERANCE[1] * depth_m * depth_m
}

/// Area that a pixel covers across its ray, square metres.
fn area_m2(intrinsics: &Intrinsics, depth_m: f32) -> f32 {
    depth_m * depth_m / (intrinsics.fx * intrinsics.fy) as f32
}

/// Number of the cell in which a point lies; `None` outside of all.
fn cell(point: Vec3) -> Option<usize> {
    let at = point / CELL_M + CELLS as f32 / 2.0;
    let is_inside = at.min_element() >= 0.0 && at.max_element() < CELLS as f32;
    is_inside.then(|| (at.x as usize * CELLS + at.y as usize) * CELLS + at.z as usize)
}

/// The four pixels beside one.
fn beside((v, u): (usize, usize), (rows, columns): (usize, usize)) -> impl Iterator<Item = (usize, usize)> {
    [(-1, 0), (1, 0), (0, -1), (0, 1)].into_iter().filter_map(move |(dv, du): (isize, isize)| {
        let (v, u) = (v.checked_add_signed(dv)?, u.checked_add_signed(du)?);
        (v < rows && u < columns).then_some((v, u))
    })
}

/// The pixels that hang together with one; `takes` says whether a pixel takes in one beside it, and must not do so twice.
fn region(
    start: (usize, usize),
    dim: (usize, usize),
    mut takes: impl FnMut((usize, usize), (usize, usize)) -> bool,
) -> Vec<(usize, usize)> {
    let (mut region, mut next) = (vec![start], 0);
    while let Some(&at) = region.get(next) {
        next += 1;
        region.extend(beside(at, dim).filter(|other| takes(at, *other)));
    }
    region
}

/// Rows and columns of the pixels that are set, and of those `reach` around them, each from and to before.
fn window(dim: (usize, usize), pixels: impl Iterator<Item = (usize, usize)>, reach: usize) -> Option<[usize; 4]> {
    let bounds = pixels.fold(None, |bounds: Option<[usize; 4]>, (v, u)| {
        let [top, bottom, left, right] = bounds.unwrap_or([v, v, u, u]);
        Some([top.min(v), bottom.max(v), left.min(u), right.max(u)])
    });
    let [top, bottom, left, right] = bounds?;
    let (top, left) = (top.saturating_sub(reach), left.saturating_sub(reach));
    Some([top, (bottom + reach + 1).min(dim.0), left, (right + reach + 1).min(dim.1)])
}

fn pixels([top, bottom, left, right]: [usize; 4]) -> impl Iterator<Item = (usize, usize)> {
    (top..bottom).flat_map(move |v| (left..right).map(move |u| (v, u)))
}

impl Default for MaskCarrier {
    fn default() -> Self {
        Self {
            touching: Colours::new(TOUCHING_KEPT),
            everywhere: Colours::new(ELSEWHERE_KEPT),
            cells: vec![0; CELLS.pow(3)],
            newest: Vec::new(),
            before: None,
            given: None,
            area_m2: 0.0,
        }
    }
}

impl MaskCarrier {
    /// Learns from a frame whose labels are right, at the pose of the model in the camera. `is_given` says that its mask was given.
    pub fn learn(&mut self, image: &CameraDepth, camera_from_model: Isometry<Model, Camera>, is_given: bool) {
        let seen = Pixels::new(image, camera_from_model.inverse());
        let dim = image.depth_m.dim();
        let object = |at: &(usize, usize)| image.labels.get(*at) == Some(&Label::Object);
        let all = [0, dim.0, 0, dim.1];
        let Some(near) = window(dim, pixels(all).filter(object), AROUND_PX) else { return };
        let unit = if is_given { GIVEN } else { 1 };
        let mut area = 0.0;
        self.newest.clear();
        self.touching.fade();
        self.everywhere.fade();
        let mut depths: Vec<f32> = pixels(near).filter(object).filter_map(|at| seen.depth_m(at)).collect();
        let middle = depths.len() / 2;
        if depths.is_empty() {
            return;
        }
        let middle_m = *depths.select_nth_unstable_by(middle, f32::total_cmp).1;
        for at in pixels(near) {
            let (Some(depth_m), Some(&label)) = (seen.depth_m(at), image.labels.get(at)) else { continue };
            let is_object = label == Label::Object;
            if label == Label::Unsure {
                continue;
            }
            let point = seen.point(at, depth_m);
            if is_object {
                self.newest.push((point, seen.colour(at)));
                area += area_m2(&image.intrinsics, depth_m);
            }
            if let Some(cell) = cell(point).and_then(|cell| self.cells.get_mut(cell)) {
                *cell = cell.saturating_add(if is_object { unit } else { -unit }).clamp(-MOST, MOST);
            }
            if let Some(colour) = seen.colour(at) {
                if is_object || (depth_m - middle_m).abs() < TOUCHING_M {
                    self.touching.add(colour, is_object);
                }
                self.everywhere.add(colour, is_object);
            }
        }
        for at in pixels(all).filter(|(v, u)| v % ELSEWHERE_STRIDE == 0 && u % ELSEWHERE_STRIDE == 0) {
            if let Some(colour) = seen.colour(at).filter(|_| !object(&at)) {
                self.everywhere.add(colour, false);
            }
        }
        self.area_m2 = self.area_m2.max(area);
        let CameraDepth { intrinsics, world_from_camera, depth_m, labels, .. } = image;
        self.before = Some(CameraDepth {
            intrinsics: *intrinsics,
            world_from_camera: *world_from_camera,
            depth_m: depth_m.clone(),
            labels: labels.clone(),
            colour: None,
        });
        if is_given {
            self.given.clone_from(&self.before);
        }
    }

    /// Whether the surface at a pixel already lay there in the newest frame that was learnt or given, and was not the object's.
    fn lay_still(&self, image: &CameraDepth, (v, u): (usize, usize), depth_m: f32) -> bool {
        let point = image.world_from_camera * image.intrinsics.unproject(u as f64, v as f64, f64::from(depth_m));
        self.before.iter().chain(&self.given).any(|before| {
            let point = before.world_from_camera.inverse() * point;
            let Some((u, v)) = before.intrinsics.project(point) else { return false };
            let at = (v.round().max(0.0) as usize, u.round().max(0.0) as usize);
            let is_other = before.labels.get(at).is_some_and(|label| matches!(label, Label::Background | Label::Hand));
            let then_m = before.depth_m.get(at).copied().unwrap_or(0.0);
            is_other && then_m > 0.0 && (then_m + point.coords().z as f32).abs() < 1.2 * tolerance_m(depth_m)
        })
    }

    /// What the colour of a pixel says: nothing against the object where it is the colour in which the object was last seen there.
    fn colour_score(&self, seen: &Pixels<'_>, at: (usize, usize), drawn: &Array2<(f32, Option<[u8; 3]>)>) -> f32 {
        let Some(colour) = seen.colour(at) else { return 0.0 };
        let odds = self.touching.log_odds(colour).min(MOST_COLOUR);
        let is_alike = |other: [u8; 3]| (0..3).all(|k| colour[k].abs_diff(other[k]) < ALIKE_LEVELS);
        let around =
            (0..9).filter_map(|k| drawn.get(((at.0 + k / 3).checked_sub(1)?, (at.1 + k % 3).checked_sub(1)?))?.1);
        let (mut is_shown, mut is_expected) = (false, false);
        for other in around {
            (is_shown, is_expected) = (true, is_expected || is_alike(other));
        }
        match (is_shown, is_expected) {
            (_, true) => odds.max(0.0),
            (true, false) => odds.max(-MOST_OTHER),
            (false, false) => odds.max(-MOST_COLOUR),
        }
    }

    /// Returns the pixels that may show the object near the predicted pose of the model in the camera, a little too many: enough to find the
    /// pose.
    pub fn roughly(&self, image: &CameraDepth, camera_from_model: Isometry<Model, Camera>) -> Array2<bool> {
        let seen = Pixels::new(image, camera_from_model.inverse());
        let drawn = seen.drawn(&self.newest, 2);
        Array2::from_shape_fn(drawn.dim(), |at| {
            seen.depth_m(at).is_some_and(|depth_m| (depth_m - drawn[at].0).abs() < MISSED_M)
        })
    }

    /// Returns the mask of a frame at the pose of the model in the camera; `None` if too little of the object is seen there, or another surface.
    pub fn carry(
        &self,
        image: &CameraDepth,
        camera_from_model: Isometry<Model, Camera>,
        surface: &dyn KnownSurface,
    ) -> Option<CarriedMask> {
        let seen = Pixels::new(image, camera_from_model.inverse());
        let dim = image.depth_m.dim();
        let drawn = seen.drawn(&self.newest, 1);
        let expected = || drawn.indexed_iter().filter(|(_, drawn)| drawn.0.is_finite()).map(|(at, _)| at);
        let near = window(dim, expected(), GROWTH_PX)?;
        let (mut agree, mut passed) = (0_usize, 0_usize);
        // A point is drawn wider than it is, to leave no holes.
        let is_inner = |at: (usize, usize)| beside(at, dim).all(|other| drawn[other].0.is_finite());
        for at in expected().filter(|at| is_inner(*at)) {
            let Some(depth_m) = seen.depth_m(at) else { continue };
            let off_m = depth_m - drawn[at].0;
            match tolerance_m(depth_m) + MISSED_M / 4.0 {
                tolerance if off_m.abs() < tolerance => agree += 1,
                tolerance if off_m > tolerance => passed += 1,
                _ => {}
            }
        }
        let sure = agree as f32 / (agree + passed).max(1) as f32;
        if sure < LEAST_SURE || agree < LEAST_PX {
            return None;
        }
        let places: Vec<((usize, usize), f32)> = pixels(near).filter_map(|at| Some((at, seen.depth_m(at)?))).collect();
        let points: Vec<Vec3> = places.iter().map(|&(at, depth_m)| seen.point(at, depth_m)).collect();
        let distances_m = surface.distances_m(&points);
        // What speaks for the object at the pixels around it, and where a surface is known.
        let mut scores = Array2::from_elem(dim, f32::NEG_INFINITY);
        let mut evidences = Array2::zeros(dim);
        let mut mask = Array2::from_elem(dim, false);
        for ((&(at, depth_m), &point), distance_m) in places.iter().zip(&points).zip(distances_m) {
            let tolerance = tolerance_m(depth_m);
            let is_surface = distance_m.abs() < tolerance;
            let is_newest = (depth_m - drawn[at].0).abs() < 1.5 * tolerance && is_inner(at);
            let evidence = cell(point).map_or(0.0, |cell| EVIDENCE * f32::from(self.cells[cell]));
            let known = match (is_surface, is_newest) {
                _ if evidence < KNOWN && self.lay_still(image, at, depth_m) => EMPTY,
                (false, false) if depth_m < drawn[at].0 && drawn[at].0.is_finite() => NEARER,
                (false, false) if surface.is_seen_empty(point) => EMPTY,
                (false, false) => 0.0,
                _ => SURFACE * f32::from(is_surface) + NEWEST * f32::from(is_newest),
            };
            let score = known + evidence.clamp(-MOST_EVIDENCE, MOST_EVIDENCE) + self.colour_score(&seen, at, &drawn);
            evidences[at] = evidence;
            // Nothing is open where the object cannot be; where only a colour or an earlier mask speaks against it, it may.
            scores[at] = match known {
                known if known < 0.0 => score.min(CONTESTED_ABOVE),
                _ => score.max(0.9 * CONTESTED_ABOVE),
            };
            mask[at] = known > 0.0 && score > 0.0;
        }
        drop_specks(&mut mask, &evidences);
        let contested = grow(&seen, &scores, &mut mask);
        fill(&seen, &self.touching, near, &mut mask);
        let area = places.iter().filter(|(at, _)| mask[*at]).map(|(_, depth_m)| area_m2(&image.intrinsics, *depth_m));
        (area.sum::<f32>() > LEAST_AREA * self.area_m2).then_some(CarriedMask { mask, contested, sure })
    }

    /// Returns a region of the image that may show a lost object by its colours and size; one after the other as time goes on. `None` if there is
    /// none, or there are no colours.
    pub fn search(&self, image: &CameraDepth, time_s: f64) -> Option<Array2<bool>> {
        let seen = Pixels::new(image, Isometry::identity());
        let dim = image.depth_m.dim();
        image.colour.as_ref()?;
        let odds = Array2::from_shape_fn(dim, |at| {
            seen.colour(at).map_or(0.0, |colour| self.everywhere.log_odds(colour)).clamp(-MOST_COLOUR, MOST_COLOUR)
        });
        let odds = blurred(&odds, 3);
        let mut regions = Vec::new();
        let mut is_taken = Array2::from_elem(dim, false);
        for start in pixels([0, dim.0, 0, dim.1]) {
            let is_like = |at: (usize, usize)| odds[at] > 0.0 && seen.depth_m(at).is_some();
            if is_taken[start] || odds[start] <= COLOURED || !is_like(start) {
                continue;
            }
            is_taken[start] = true;
            let region = region(start, dim, |at, other| {
                let depth_m = image.depth_m[at];
                let continues = is_like(other) && (image.depth_m[other] - depth_m).abs() < step_m(depth_m);
                continues && !std::mem::replace(&mut is_taken[other], true)
            });
            let area: f32 = region.iter().map(|at| area_m2(&image.intrinsics, image.depth_m[*at])).sum();
            if region.len() >= LEAST_PX && PLAUSIBLE.contains(&(area / self.area_m2)) {
                let odds: f32 = region.iter().map(|at| odds[*at]).sum();
                regions.push((odds, region));
            }
        }
        regions.sort_by(|a, b| b.0.total_cmp(&a.0));
        regions.truncate(3);
        let turn = (time_s / OFFERED_S) as usize % regions.len().max(1);
        let (_, region) = regions.get(turn)?;
        let mut mask = Array2::from_elem(dim, false);
        region.iter().for_each(|at| mask[*at] = true);
        Some(mask)
    }
}

/// Steps in depth from a pixel to the next on a surface that is seen under up to 75 degrees, and noise, metres.
fn step_m(depth_m: f32) -> f32 {
    0.004 * depth_m + 0.004 * depth_m * depth_m
}

/// Removes regions that are too small, and those apart from the best known one in whose place the object was seldom seen.
fn drop_specks(mask: &mut Array2<bool>, evidence: &Array2<f32>) {
    let dim = mask.dim();
    let mut left = mask.clone();
    let mut regions: Vec<Vec<(usize, usize)>> = Vec::new();
    for (start, _) in mask.indexed_iter().filter(|(_, inside)| **inside) {
        if !std::mem::replace(&mut left[start], false) {
            continue;
        }
        regions.push(region(start, dim, |_, other| std::mem::replace(&mut left[other], false)));
    }
    let known = |region: &Vec<(usize, usize)>| region.iter().map(|at| evidence[*at]).sum::<f32>();
    let best = regions.iter().map(known).max_by(f32::total_cmp).unwrap_or(0.0);
    for region in regions {
        let (known, count) = (known(&region), region.len());
        if count < SPECK_PX || known < best && known < KNOWN * count as f32 {
            region.iter().for_each(|at| mask[*at] = false);
        }
    }
}

/// Adds pixels that continue the surface of the mask and against which nothing speaks. Returns the pixels that continue it although something does,
/// but for those that were looked through or that stand nearer.
fn grow(seen: &Pixels<'_>, scores: &Array2<f32>, mask: &mut Array2<bool>) -> Array2<bool> {
    let dim = mask.dim();
    let mut contested = Array2::from_elem(dim, false);
    let mut edge: VecDeque<((usize, usize), usize)> =
        mask.indexed_iter().filter(|(_, inside)| **inside).map(|(at, _)| (at, 0)).collect();
    while let Some((at, steps)) = edge.pop_front() {
        let Some(depth_m) = seen.depth_m(at).filter(|_| steps < GROWTH_PX) else { continue };
        for other in beside(at, dim) {
            let continues = || seen.depth_m(other).is_some_and(|other_m| (other_m - depth_m).abs() < step_m(depth_m));
            if mask[other] || contested[other] || scores[other] <= CONTESTED_ABOVE || !continues() {
                continue;
            }
            let is_object = scores[other] > GROWS_ABOVE;
            if is_object {
                mask[other] = true;
            } else {
                contested[other] = true;
            }
            edge.push_back((other, steps + 1));
        }
    }
    contested
}

/// Adds pixels without depth inside of the mask, and those beside it that have the object's colours.
fn fill(seen: &Pixels<'_>, colours: &Colours, near: [usize; 4], mask: &mut Array2<bool>) {
    for _ in 0..HOLE_PX {
        let before = mask.clone();
        for at in pixels(near).filter(|at| !before[*at]) {
            let around = beside(at, before.dim()).filter(|other| before[*other]).count();
            if around == 0 {
                continue;
            }
            let is_like = seen.colour(at).is_some_and(|colour| colours.log_odds(colour) > 0.5);
            let is_hole = seen.depth_m(at).is_none();
            mask[at] = around == 4 || is_hole && (around == 3 || is_like);
        }
    }
}

/// Means over squares that reach `reach` pixels.
fn blurred(image: &Array2<f32>, reach: usize) -> Array2<f32> {
    let along = |image: &Array2<f32>| {
        let (rows, columns) = image.dim();
        let mut result = Array2::zeros((columns, rows));
        for v in 0..rows {
            for u in 0..columns {
                let (from, to) = (u.saturating_sub(reach), (u + reach + 1).min(columns));
                let sum: f32 = (from..to).map(|u| image[(v, u)]).sum();
                result[(u, v)] = sum / (to - from) as f32;
            }
        }
        result
    };
    along(&along(image))
}

#[cfg(test)]
mod tests;
