//! A ball before a wall.

use image::{Rgb, RgbImage};
use mvt_frames::Isometry;
use mvt_frames::camera::Intrinsics;

use super::*;

const RADIUS_M: f32 = 0.05;
const WALL_M: f32 = 0.9;

/// A ball around the model's origin.
struct Ball;

impl KnownSurface for Ball {
    fn distances_m(&self, points: &[Vec3]) -> Vec<f32> {
        points.iter().map(|point| point.length() - RADIUS_M).collect()
    }
}

/// A red ball before a white wall, with its mask; a brown board hides columns from `board` on.
fn scene(ball: Vec3, board: usize) -> (CameraDepth, Array2<bool>) {
    let intrinsics = Intrinsics::from_fov_y(160, 120, 40_f64.to_radians());
    let mut mask = Array2::from_elem((120, 160), false);
    let mut colour = RgbImage::new(160, 120);
    let depth_m = Array2::from_shape_fn((120, 160), |(v, u)| {
        let p = intrinsics.unproject(u as f64, v as f64, 1.0).coords();
        let ray = Vec3::new(p.x as f32, p.y as f32, p.z as f32);
        let (a, b, c) = (ray.length_squared(), ray.dot(ball), ball.length_squared() - RADIUS_M * RADIUS_M);
        let root = b * b - a * c;
        let (depth_m, shown) = match root {
            _ if u >= board => (0.3, [120, 80, 50]),
            root if root > 0.0 => {
                mask[(v, u)] = true;
                ((b - root.sqrt()) / a, [200, 30, 30])
            }
            _ => (WALL_M, [230; 3]),
        };
        colour.put_pixel(u as u32, v as u32, Rgb(shown));
        depth_m
    });
    let labels = Array2::from_shape_fn((120, 160), |at| match depth_m[at] {
        _ if mask[at] => Label::Object,
        depth_m if depth_m < 0.5 => Label::Hand,
        _ => Label::Background,
    });
    let world_from_camera = Isometry::identity();
    (CameraDepth { intrinsics, world_from_camera, depth_m, labels, colour: Some(colour) }, mask)
}

fn at(ball: Vec3) -> Isometry<Model, Camera> {
    Isometry::translation(f64::from(ball.x), f64::from(ball.y), f64::from(ball.z))
}

fn agreement(a: &Array2<bool>, b: &Array2<bool>) -> f64 {
    let count = |of: fn(bool, bool) -> bool| a.iter().zip(b).filter(|(a, b)| of(**a, **b)).count() as f64;
    count(|a, b| a && b) / count(|a, b| a || b)
}

fn learnt() -> (MaskCarrier, Vec3) {
    let start = Vec3::new(0.0, 0.0, -0.6);
    let mut carrier = MaskCarrier::default();
    carrier.learn(&scene(start, 160).0, at(start), true);
    (carrier, start)
}

#[test]
fn a_mask_follows_the_object_and_leaves_out_what_stands_before_it() {
    let (carrier, start) = learnt();
    let moved = start + Vec3::new(0.02, 0.01, 0.015);
    for board in [160, 86] {
        let (image, mask) = scene(moved, board);
        let rough = carrier.roughly(&image, at(start));
        assert!(agreement(&rough, &mask) > 0.5);
        let carried = carrier.carry(&image, at(moved), &Ball).unwrap();
        let iou = agreement(&carried.mask, &mask);
        assert!(iou > 0.95 && carried.sure > 0.9, "{iou} {}", carried.sure);
    }
}

#[test]
fn an_object_that_is_gone_or_hidden_has_no_mask() {
    let (carrier, start) = learnt();
    assert_eq!(carrier.carry(&scene(Vec3::new(0.0, 0.0, 2.0), 160).0, at(start), &Ball), None);
    assert_eq!(carrier.carry(&scene(start, 0).0, at(start), &Ball), None);
    assert_eq!(MaskCarrier::default().carry(&scene(start, 160).0, at(start), &Ball), None);
}

#[test]
fn a_lost_object_is_searched_for_by_its_colours() {
    let (carrier, start) = learnt();
    let (image, mask) = scene(start + Vec3::new(-0.15, 0.05, 0.0), 160);
    let found = carrier.search(&image, 0.0).unwrap();
    assert!(agreement(&found, &mask) > 0.6);
    assert_eq!(carrier.search(&scene(start, 0).0, 0.0), None);
    assert_eq!(carrier.search(&CameraDepth { colour: None, ..image }, 0.0), None);
}

#[test]
fn what_lay_there_before_is_no_lost_object() {
    let start = Vec3::new(0.0, 0.0, -0.6);
    let (other, shows_other) = scene(start + Vec3::new(0.15, 0.05, 0.0), 160);
    // Another ball of the same colour, which stays where it is.
    let with_other = |ball: Vec3| {
        let (mut image, mask) = scene(ball, 160);
        for (at, _) in shows_other.indexed_iter().filter(|(_, shows)| **shows) {
            (image.depth_m[at], image.labels[at]) = (other.depth_m[at], Label::Background);
            if let Some(colour) = &mut image.colour {
                colour.put_pixel(at.1 as u32, at.0 as u32, Rgb([200, 30, 30]));
            }
        }
        (image, mask)
    };
    let mut carrier = MaskCarrier::default();
    carrier.learn(&with_other(start).0, at(start), true);
    assert_eq!(carrier.search(&with_other(Vec3::new(0.0, 0.0, 2.0)).0, 0.0), None);
    let (image, mask) = with_other(start + Vec3::new(-0.15, 0.05, 0.0));
    for time_s in [0.0, OFFERED_S] {
        assert!(agreement(&carrier.search(&image, time_s).unwrap(), &mask) > 0.6, "there is one region");
    }
}

/// Puts a block beside the ball, left of it and as far away, over the wall.
fn put_block(image: &mut CameraDepth, mask: &Array2<bool>, ball: Vec3, shown: [u8; 3]) {
    let left = |at: (usize, usize)| (1..20).any(|k| mask.get((at.0, at.1 + k)).is_some_and(|inside| *inside));
    for at in mask.indexed_iter().filter(|(at, inside)| !**inside && left(*at)).map(|(at, _)| at) {
        image.depth_m[at] = -ball.z;
        image.labels[at] = Label::Hand;
        if let Some(colour) = &mut image.colour {
            colour.put_pixel(at.1 as u32, at.0 as u32, Rgb(shown));
        }
    }
}

#[test]
fn what_comes_to_the_object_is_not_taken_for_it_even_in_its_colour() {
    let (carrier, start) = learnt();
    let (mut image, mask) = scene(start, 160);
    put_block(&mut image, &mask, start, [200, 30, 30]);
    let iou = agreement(&carrier.carry(&image, at(start), &Ball).unwrap().mask, &mask);
    assert!(iou > 0.9, "{iou}");
}

#[test]
fn a_wrong_mask_does_not_prove_itself() {
    let start = Vec3::new(0.0, 0.0, -0.6);
    let mut carrier = MaskCarrier::default();
    let (mut image, mask) = scene(start, 160);
    put_block(&mut image, &mask, start, [40, 60, 200]);
    carrier.learn(&image, at(start), true);
    for label in image.labels.iter_mut().filter(|label| **label == Label::Hand) {
        *label = Label::Object;
    }
    (0..20).for_each(|_| carrier.learn(&image, at(start), false));
    let iou = agreement(&carrier.carry(&image, at(start), &Ball).unwrap().mask, &mask);
    assert!(iou > 0.95, "{iou}");
}
