//! Points of the object that cameras and touch sensors have seen so far, in its coordinates, from the recorded images and the
//! estimated poses.

// Why: notes/decisions/viewing.md, "The viewer computes colours from images and estimated poses".

use std::collections::{BTreeSet, HashMap};

use glam::{IVec3, Mat3A, Vec3A};
use image::Rgb;
use mvt_frames::camera::Intrinsics;
use mvt_frames::depth::Label;
use mvt_frames::{Camera, Isometry, Object, World};

use mvt_picture::palette;
use mvt_picture::raster::{self, Colour};
use mvt_recording::{FrameImages, RecordedMoment, Recording, RecordingError};

/// Edge of the cells in which points are gathered, metres.
const CELL_M: f32 = 0.002;
/// Places farther than this from every point count as not seen, metres.
const REACH_M: f32 = 0.005;
/// Every Nth row and column of a camera image and of a touch image gives a point.
const CAMERA_STRIDE: usize = 3;
const TOUCH_STRIDE: usize = 6;
/// Most images that are used. A longer run uses every second, fourth, ... image.
const MOST_IMAGES: usize = 48;
/// Number of sightings that gives full confidence.
const SURE: f32 = 12.0;

/// Sums over the points of a cell.
#[derive(Debug, Clone, Copy, Default)]
struct Cell {
    /// Sum of the points, metres, and of their colours.
    points: Vec3A,
    colours: Colour,
    count: f32,
    /// Number and sum of the points that a touch sensor saw.
    touched: f32,
    touched_points: Vec3A,
    /// Number of images that saw the cell, and the last of them.
    sightings: f32,
    last: usize,
}

/// Sensor that saw a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SeenBy {
    /// A camera.
    Vision,
    /// A touch sensor.
    Touch,
    /// No sensor: the field extrapolates.
    Nothing,
}

impl SeenBy {
    /// Returns its colour.
    pub fn colour(self) -> Rgb<u8> {
        match self {
            Self::Vision => palette::VISION,
            Self::Touch => palette::TOUCH,
            Self::Nothing => palette::UNSEEN,
        }
    }
}

/// Points that were seen up to a moment.
#[derive(Default)]
pub struct SeenPoints {
    cells: HashMap<IVec3, Cell>,
    /// Moments whose images are used.
    seen: BTreeSet<usize>,
    /// Every Nth image is used.
    every: usize,
}

/// Evidence for a place on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Sensor that saw it.
    pub by: SeenBy,
    /// Its colour, where a camera saw it.
    pub colour: Option<Colour>,
    /// Confidence, 0 to 1.
    pub confidence: f32,
}

impl SeenPoints {
    /// Adds the images up to a moment and removes those of later moments.
    ///
    /// # Errors
    /// [`RecordingError`] if images cannot be read. Earlier images are added.
    pub fn advance(&mut self, recording: &Recording, moment: usize) -> Result<(), RecordingError> {
        let images = recording.image_moments(moment);
        let every = images.len().div_ceil(MOST_IMAGES).max(1).next_power_of_two();
        let wanted: BTreeSet<usize> = images.into_iter().step_by(every).collect();
        if every != self.every || !self.seen.is_subset(&wanted) {
            *self = Self { every, ..Self::default() };
        }
        let new: Vec<usize> = wanted.difference(&self.seen).copied().collect();
        for moment in new {
            // Marked first: a damaged image is tried once.
            self.seen.insert(moment);
            if let Some(images) = recording.images(moment)? {
                self.add(recording, moment, &images);
            }
        }
        Ok(())
    }

    /// Returns the number of images that are used.
    pub fn images(&self) -> usize {
        self.seen.len()
    }

    fn add(&mut self, recording: &Recording, index: usize, images: &FrameImages) {
        let Some((moment, pose)) = recording.moments().get(index).zip(recording.pose(index)) else { return };
        let object_from_world = pose.inverse();
        for (camera, seen) in recording.about().cameras.iter().zip(&images.cameras) {
            let Some(seen) = seen else { continue };
            let object_from_camera = object_from_world * camera.pose;
            let is_object = |row, column| seen.labels.get((row, column)) == Some(&Label::Object);
            for (point, (x, y)) in
                points(&seen.depth_m, &camera.intrinsics, object_from_camera, CAMERA_STRIDE, is_object)
            {
                let colour = seen.colour.get_pixel_checked(x, y).map(|&rgb| raster::colour(rgb));
                self.put(index, point, colour);
            }
        }
        self.touch(recording, index, moment, images, object_from_world);
    }

    fn touch(
        &mut self,
        recording: &Recording,
        index: usize,
        moment: &RecordedMoment,
        images: &FrameImages,
        object_from_world: Isometry<World, Object>,
    ) {
        let gels = recording.about().hand.gel_views();
        let poses = recording.about().hand.world_from_touch_cameras(&moment.joints);
        for ((felt, gel), world_from_camera) in images.touch.iter().zip(gels.iter()).zip(poses) {
            let Some(felt) = felt else { continue };
            let object_from_camera = object_from_world * world_from_camera;
            for (point, _) in gel.touched_points(&felt.indentation_mm, &felt.contact, TOUCH_STRIDE) {
                let point = (object_from_camera * point).coords();
                self.put(index, Vec3A::new(point.x as f32, point.y as f32, point.z as f32), None);
            }
        }
    }

    /// Adds a point with its colour; a point without a colour was touched.
    fn put(&mut self, image: usize, point: Vec3A, colour: Option<Colour>) {
        let cell = self.cells.entry(key(point)).or_default();
        if cell.sightings == 0.0 || cell.last != image {
            cell.sightings += 1.0;
            cell.last = image;
        }
        match colour {
            Some(colour) => {
                cell.points += point;
                cell.colours += colour;
                cell.count += 1.0;
            }
            None => {
                cell.touched += 1.0;
                cell.touched_points += point;
            }
        }
    }

    /// Returns the evidence for a place in the coordinates of the object. Its colour is a mean over the points within 5
    /// mm, weighted by nearness.
    pub fn at(&self, place: Vec3A) -> Sighting {
        const CELLS: i32 = (REACH_M / CELL_M) as i32 + 1;
        let middle = key(place);
        let (mut colours, mut weights, mut sightings) = (Vec3A::ZERO, 0.0, 0.0f32);
        let mut nearest = (REACH_M, SeenBy::Nothing);
        for z in -CELLS..=CELLS {
            for y in -CELLS..=CELLS {
                for x in -CELLS..=CELLS {
                    let Some(cell) = self.cells.get(&(middle + IVec3::new(x, y, z))) else { continue };
                    let mut near = |sum: Vec3A, count: f32, by: SeenBy| {
                        let distance = (sum / count).distance(place);
                        if count > 0.0 && distance < nearest.0 {
                            nearest = (distance, by);
                        }
                        distance
                    };
                    // First, so that touch wins where a camera sees the same point, too.
                    near(cell.touched_points, cell.touched, SeenBy::Touch);
                    let distance = near(cell.points, cell.count, SeenBy::Vision);
                    if cell.count > 0.0 && distance < REACH_M {
                        let weight = (-0.5 * (distance / CELL_M).powi(2)).exp();
                        colours += cell.colours / cell.count * weight;
                        weights += weight;
                    }
                    sightings = sightings.max(cell.sightings);
                }
            }
        }
        let by = nearest.1;
        let confidence = if by == SeenBy::Nothing { 0.0 } else { (sightings / SURE).min(1.0) };
        Sighting { by, colour: (weights > 0.0).then(|| colours / weights), confidence }
    }

    /// Returns the mean points of all cells with the sensor that saw them.
    pub fn points(&self) -> impl Iterator<Item = (Vec3A, SeenBy)> {
        let of = |cell: &Cell| {
            let seen = (cell.count > 0.0).then(|| (cell.points / cell.count, SeenBy::Vision));
            let touched = (cell.touched > 0.0).then(|| (cell.touched_points / cell.touched, SeenBy::Touch));
            seen.into_iter().chain(touched)
        };
        self.cells.values().flat_map(of)
    }
}

fn key(point: Vec3A) -> IVec3 {
    // The cast saturates.
    (point / CELL_M).floor().as_ivec3().clamp(IVec3::splat(-1_000_000), IVec3::splat(1_000_000))
}

/// Returns the points of a depth image in the coordinates of the object, with their pixels.
fn points(
    depth_m: &ndarray::Array2<f32>,
    camera: &Intrinsics,
    object_from_camera: Isometry<Camera, Object>,
    stride: usize,
    is_wanted: impl Fn(usize, usize) -> bool,
) -> Vec<(Vec3A, (u32, u32))> {
    let (rotation, translation): (Mat3A, Vec3A) = object_from_camera.to_f32();
    let (rows, columns) = depth_m.dim();
    let mut found = Vec::new();
    for row in (0..rows).step_by(stride) {
        for column in (0..columns).step_by(stride) {
            let z = depth_m[(row, column)];
            if z > 0.0 && is_wanted(row, column) {
                let p = camera.unproject(column as f64, row as f64, f64::from(z)).coords();
                let point = Vec3A::new(p.x as f32, p.y as f32, p.z as f32);
                found.push((rotation * point + translation, (column as u32, row as u32)));
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_knows_which_sensor_saw_it() {
        let mut observed = SeenPoints::default();
        let red = Vec3A::new(200.0, 10.0, 10.0);
        for image in 0..6 {
            observed.put(image, Vec3A::new(0.02, 0.0, 0.0), Some(red));
            observed.put(image, Vec3A::new(-0.02, 0.0, 0.0), None);
        }
        let near = observed.at(Vec3A::new(0.021, 0.001, 0.0));
        assert_eq!((near.by, near.confidence), (SeenBy::Vision, 0.5));
        assert!(near.colour.unwrap().distance(red) < 1e-3);
        let touched = observed.at(Vec3A::new(-0.021, 0.0, 0.001));
        assert_eq!((touched.by, touched.colour), (SeenBy::Touch, None));
        let far = observed.at(Vec3A::new(0.02, 0.0055, 0.0));
        assert_eq!((far.by, far.confidence), (SeenBy::Nothing, 0.0));
        assert_eq!(observed.points().count(), 2);
    }
}
