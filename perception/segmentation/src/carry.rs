//! Masks of an object that are carried from frame to frame, where none is given.

mod earlier;
mod outline;
mod pixels;

use std::collections::VecDeque;

use glam::Vec3;
use mvt_frames::depth::{CameraDepth, Label};
use mvt_frames::{Camera, Isometry, Model};
use ndarray::Array2;

use crate::colours::Colours;
use earlier::Earlier;
use outline::{blurred, drop_specks, fill, grow, smoothed};
use pixels::{Pixels, are_alike, area_m2, beside, pixels, region, step_m, tolerance_m, window};

/// The surface of an object as far as it is known, in the frame of its estimated model, metres.
pub trait KnownSurface {
    /// Signed distances from the surface, negative inside; not finite where no surface was seen.
    fn distances_m(&self, points: &[Vec3]) -> Vec<f32>;
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
    /// The same when a mask was given last.
    given_colours: Colours,
    /// Colours of the object and of all else.
    everywhere: Colours,
    /// Evidence per cell around the model's origin: above 0 the object was seen in it, below 0 something else.
    cells: Vec<i8>,
    /// Points of the object in the newest frame that was learnt, model frame, with their colours.
    newest: Vec<(Vec3, Option<[u8; 3]>)>,
    /// The newest frame whose mask was given.
    given: Option<Earlier>,
    /// Frames before the newest between which the object moved, the newest last.
    earlier: VecDeque<Earlier>,
    /// Usual area of the object across the rays, square metres.
    area_m2: f32,
}

/// Cells along an edge of the cube in which evidence is kept.
const CELLS: usize = 128;
/// Edge of a cell, metres: some pixels wide.
const CELL_M: f32 = 0.004;
/// Most evidence of a cell.
const MOST: i8 = 40;
/// Evidence of a pixel of a given mask; one of a carried mask has at most 3.
const GIVEN: i8 = 15;
/// Motion that the prediction of a pose may miss, metres.
const MISSED_M: f32 = 0.025;
/// The mask of a frame reaches at most so far beyond what the frames before showed, pixels.
const GROWTH_PX: usize = 10;
/// Surroundings whose cells and colours are learnt, pixels around the object.
const AROUND_PX: usize = 40;
/// What is farther from the object along the optical axis does not touch it, metres.
const TOUCHING_M: f32 = 0.08;
/// Share of the colours that is kept from frame to frame, of what may touch the object and of all else: they change.
const TOUCHING_KEPT: f32 = 0.95;
const ELSEWHERE_KEPT: f32 = 0.98;
/// Frames that are kept to see what lay still, and the motion of the object between them, metres and radians.
const EARLIER: usize = 4;
const APART_M: f64 = 0.015;
const APART_RAD: f64 = 0.2;
/// Every Nth row and column of the rest of the image is learnt.
const ELSEWHERE_STRIDE: usize = 4;
/// A mask needs so many pixels, and this share of the usual area.
const LEAST_PX: usize = 40;
const LEAST_AREA: f32 = 0.04;
/// Below this share of agreement the object is lost.
const LEAST_SURE: f32 = 0.5;
/// Weights of what speaks for the object at a pixel: the learnt surface, the newest points, earlier frames that rule it out, and a unit of evidence.
const SURFACE: f32 = 2.5;
const NEWEST: f32 = 1.5;
const RULED_OUT: f32 = -4.0;
/// The same of a surface before that of the object, which hides it.
const NEARER: f32 = -2.5;
const EVIDENCE: f32 = 0.3;
/// From this weight of evidence on the object is known to have been seen in a place.
const KNOWN: f32 = 3.0;
/// Most that evidence and colours weigh.
const MOST_EVIDENCE: f32 = 5.0;
const MOST_COLOUR: f32 = 2.0;
/// Most that a colour weighs against the object where the object was last seen in another: something lies on it.
const MOST_AGAINST: f32 = 6.0;
/// Most that a colour weighs against the object where the object was last seen in it.
const EXPECTED: f32 = -1.0;
/// Below these odds a colour is foreign to the object.
const FOREIGN: f32 = -1.0;
/// It stays open whose it is if no more than this does.
const CONTESTED_ABOVE: f32 = -2.3;
/// Areas of a lost object that are plausible, by the usual one.
const PLAUSIBLE: std::ops::Range<f32> = 0.2..1.7;
/// Mean logarithm of the odds of the colours around a pixel of a lost object.
const COLOURED: f32 = 0.5;
/// Of the regions that may show a lost object each is offered so long, seconds.
const OFFERED_S: f64 = 0.2;

/// Number of the cell in which a point lies; `None` outside of all.
fn cell(point: Vec3) -> Option<usize> {
    let at = point / CELL_M + CELLS as f32 / 2.0;
    let is_inside = at.min_element() >= 0.0 && at.max_element() < CELLS as f32;
    is_inside.then(|| (at.x as usize * CELLS + at.y as usize) * CELLS + at.z as usize)
}

impl Default for MaskCarrier {
    fn default() -> Self {
        Self {
            touching: Colours::new(TOUCHING_KEPT),
            given_colours: Colours::new(TOUCHING_KEPT),
            everywhere: Colours::new(ELSEWHERE_KEPT),
            cells: vec![0; CELLS.pow(3)],
            newest: Vec::new(),
            given: None,
            earlier: VecDeque::new(),
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
            let point = seen.point(at, depth_m);
            let colour = seen.colour(at);
            if is_object {
                self.newest.push((point, colour));
                area += area_m2(&image.intrinsics, depth_m);
            }
            let vote = match (is_given, is_object) {
                (true, true) => GIVEN,
                (true, false) => -GIVEN,
                (false, _) => self.vote(&seen, at, depth_m, point, label),
            };
            if let Some(cell) = cell(point).and_then(|cell| self.cells.get_mut(cell)) {
                *cell = cell.saturating_add(vote).clamp(-MOST, MOST);
            }
            let Some(colour) = colour.filter(|_| label != Label::Unsure) else { continue };
            // What was foreign beside a given mask does not become the object's by being carried.
            if is_object && !is_given && self.given_colours.log_odds(colour) < FOREIGN {
                continue;
            }
            if is_object || (depth_m - middle_m).abs() < TOUCHING_M {
                self.touching.add(colour, is_object);
            }
            self.everywhere.add(colour, is_object);
        }
        for at in pixels(all).filter(|(v, u)| v % ELSEWHERE_STRIDE == 0 && u % ELSEWHERE_STRIDE == 0) {
            if let Some(colour) = seen.colour(at).filter(|_| !object(&at)) {
                self.everywhere.add(colour, false);
            }
        }
        self.area_m2 = self.area_m2.max(area);
        let earlier = || Earlier { image: image.clone(), camera_from_model };
        if is_given {
            self.given = Some(earlier());
            self.given_colours = self.touching.clone();
        }
        let world_from_model = image.world_from_camera * camera_from_model;
        let has_moved = self.earlier.back().is_none_or(|last| {
            let moved = (last.image.world_from_camera * last.camera_from_model).inverse() * world_from_model;
            let moved = moved.untyped();
            moved.translation.vector.norm() > APART_M || moved.rotation.angle() > APART_RAD
        });
        if has_moved {
            self.earlier.push_back(earlier());
            if self.earlier.len() > EARLIER {
                self.earlier.pop_front();
            }
        }
    }

    /// What a pixel of a carried frame says of its place on the object. It depends on colour and motion more than on the mask, so that a wrong mask does
    /// not prove itself.
    fn vote(&self, seen: &Pixels<'_>, at: (usize, usize), depth_m: f32, point: Vec3, label: Label) -> i8 {
        let decided = match label {
            Label::Object => 1,
            Label::Unsure => 0,
            _ => -1,
        };
        if self.rules_out(seen, at, depth_m, point) {
            return -2;
        }
        let odds = seen.colour(at).map_or(0.0, |colour| self.touching.log_odds(colour));
        decided + odds.clamp(-2.0, 2.0).round() as i8
    }

    /// Whether an earlier frame rules out that a pixel shows the object.
    fn rules_out(&self, seen: &Pixels<'_>, at: (usize, usize), depth_m: f32, in_model: Vec3) -> bool {
        self.earlier.iter().chain(&self.given).any(|earlier| earlier.rules_out(seen, at, depth_m, in_model))
    }

    /// What the colour of a pixel says: nothing against the object where it is the colour in which the object was last seen there.
    fn colour_score(&self, seen: &Pixels<'_>, at: (usize, usize), drawn: &Array2<(f32, Option<[u8; 3]>)>) -> f32 {
        let Some(colour) = seen.colour(at) else { return 0.0 };
        let odds = self.touching.log_odds(colour).clamp(-MOST_AGAINST, MOST_COLOUR);
        let around =
            (0..9).filter_map(|k| drawn.get(((at.0 + k / 3).checked_sub(1)?, (at.1 + k % 3).checked_sub(1)?))?.1);
        let (mut is_shown, mut is_expected) = (false, false);
        for other in around {
            (is_shown, is_expected) = (true, is_expected || are_alike(colour, other));
        }
        match (is_shown, is_expected) {
            (_, true) => odds.max(EXPECTED),
            (true, false) => odds,
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
        let mut is_known = Array2::from_elem(dim, false);
        let mut opens = Array2::from_elem(dim, false);
        for ((&(at, depth_m), &point), distance_m) in places.iter().zip(&points).zip(distances_m) {
            let tolerance = tolerance_m(depth_m);
            let is_surface = distance_m.abs() < tolerance;
            let is_newest = (depth_m - drawn[at].0).abs() < 1.5 * tolerance && is_inner(at);
            let evidence = cell(point).map_or(0.0, |cell| EVIDENCE * f32::from(self.cells[cell]));
            let is_ruled_out = evidence < KNOWN && self.rules_out(&seen, at, depth_m, point);
            let is_nearer = !is_surface && !is_newest && depth_m < drawn[at].0 && drawn[at].0.is_finite();
            let known = match (is_surface, is_newest) {
                _ if is_ruled_out => RULED_OUT,
                _ if is_nearer => NEARER,
                (false, false) => 0.0,
                _ => SURFACE * f32::from(is_surface) + NEWEST * f32::from(is_newest),
            };
            let colour = self.colour_score(&seen, at, &drawn);
            opens[at] = !is_ruled_out && !is_nearer && colour > CONTESTED_ABOVE;
            evidences[at] = evidence;
            scores[at] = known + evidence.clamp(-MOST_EVIDENCE, MOST_EVIDENCE) + colour;
            is_known[at] = known > 0.0;
        }
        let scores = smoothed(&seen, near, &scores);
        let mut mask = Array2::from_shape_fn(dim, |at| is_known[at] && scores[at] > 0.0);
        drop_specks(&mut mask, &evidences);
        let contested = grow(&seen, &scores, &opens, &mut mask);
        fill(&seen, &self.touching, near, &mut mask);
        let area = places.iter().filter(|(at, _)| mask[*at]).map(|(_, depth_m)| area_m2(&image.intrinsics, *depth_m));
        (area.sum::<f32>() > LEAST_AREA * self.area_m2).then_some(CarriedMask { mask, contested, sure })
    }

    /// Returns a region of the image that may show a lost object by its colours and size, and that did not lie there before; one after the other as
    /// time goes on. `None` if there is none, or there are no colours.
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
            let is_like = |at: (usize, usize)| {
                let lay_still = |depth_m| {
                    self.earlier.iter().chain(&self.given).any(|earlier| earlier.lay_still(&seen, at, depth_m))
                };
                odds[at] > 0.0 && seen.depth_m(at).is_some_and(|depth_m| !lay_still(depth_m))
            };
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

#[cfg(test)]
mod tests;
