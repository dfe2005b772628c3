//! Labels of camera pixels: from depth and the hand's joint angles alone, or from what is known beforehand.

use std::ops::Range;

use glam::{DVec3, Vec3A};
use mvt_frames::camera::Intrinsics;
use mvt_frames::depth::{GivenLabels, Label, extent};
use mvt_frames::{Camera, Isometry, Point, World};
use mvt_robot::hand::solid::HandSolid;
use mvt_settings::{Unlimited, settings};
use ndarray::{Array2, ArrayView2, Axis, Slice, Zip, s};
use serde::{Deserialize, Serialize};

settings! {
    /// Thresholds that separate object, hand and background.
    #[derive(Copy)]
    pub struct SegmentationConfig {
        /// Where labels come from: `geometry`, that of the hand, or `given`, with the images of a log.
        pub labels: LabelSource;
        /// A point nearer to the hand than this belongs to the hand, metres. The margin covers the noise along and across a point's ray.
        pub margin_m: f32 = 0.0025, 0.0..=0.1;
        /// A point farther from the middle of the grasp than this is background, metres. Without a hand there is no limit.
        pub reach_m: f32 = 0.2, 0.0..=10.0;
        /// A point lower than this in the world is background, metres. The default is the outer side of the palm.
        pub lowest_m: f32 = -0.03, -10.0..=10.0;
        /// Pixels this near to an edge, along rows and columns, are unsure. The edges of a depth camera fray, but displaced pixels seldom
        /// lie between others: with 1, noise of the original's level leaves 6 of 100 000 object pixels wrong.
        pub edge_px: usize = 1, 0..=100;
        /// Depths that differ by more than this within `edge_px` form an edge, metres.
        pub jump_m: f32 = 0.02, 0.0..=10.0;
    }
}

/// Where labels come from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LabelSource {
    /// From depth and the geometry of the hand.
    #[default]
    Geometry,
    /// With each image: masks of the object, or images of labels.
    Given,
}

impl Unlimited for LabelSource {}

/// Edge of the square tiles of pixels that are compared with the hand together.
const TILE: usize = 8;

/// Labels the pixels of a depth image; where the object's pixels meet others they are [`Label::Unsure`]. Depth is metres along the
/// optical axis; where it is not positive and finite, nothing was measured. `grasp` is where the hand holds objects; without it a point at
/// any distance may be the object's.
pub fn segment(
    depth_m: &Array2<f32>,
    intrinsics: &Intrinsics,
    world_from_camera: Isometry<Camera, World>,
    hand: &HandSolid,
    grasp: Option<Point<World>>,
    config: &SegmentationConfig,
) -> Array2<Label> {
    // Why: notes/decisions/estimation.md, "Segmentation from depth and the hand alone".
    let (height, width) = depth_m.dim();
    let rays = Rays::new(intrinsics, world_from_camera);
    let grasp = grasp.map(|point| {
        let point = point.coords();
        DVec3::new(point.x, point.y, point.z).as_vec3a()
    });
    let is_in_reach = |p: Vec3A| grasp.is_none_or(|grasp| p.distance_squared(grasp) < config.reach_m * config.reach_m);
    let mut labels = Array2::from_elem((height, width), Label::Background);
    // The depth of pixels that may show the object, infinite elsewhere.
    let mut object = Array2::from_elem((height, width), f32::INFINITY);
    let mut points = Vec::with_capacity(TILE * TILE);
    for (top, left) in (0..height).step_by(TILE).flat_map(|v| (0..width).step_by(TILE).map(move |u| (v, u))) {
        points.clear();
        for v in top..(top + TILE).min(height) {
            for u in left..(left + TILE).min(width) {
                let depth = depth_m[[v, u]];
                if depth > 0.0 && depth.is_finite() {
                    points.push(([v, u], depth, rays.point(u, v, depth)));
                }
            }
        }
        if points.is_empty() {
            continue;
        }
        let hand = near(hand, &points, config.margin_m);
        for &(pixel, depth, p) in &points {
            if hand.is_within(p.into(), config.margin_m) {
                labels[pixel] = Label::Hand;
            } else if is_in_reach(p) && p.z > config.lowest_m {
                (labels[pixel], object[pixel]) = (Label::Object, depth);
            }
        }
    }
    mark_edges(&mut labels, &object, config);
    labels
}

/// Where the pixels of a camera look, in the world.
struct Rays {
    eye: Vec3A,
    /// Ray of pixel (0, 0) per metre of depth, and its change from column to column and row to row.
    corner: Vec3A,
    column: Vec3A,
    row: Vec3A,
}

impl Rays {
    fn new(k: &Intrinsics, world_from_camera: Isometry<Camera, World>) -> Self {
        let (axes, eye) = world_from_camera.to_f32();
        let corner = k.unproject(0.0, 0.0, 1.0).coords();
        Self {
            eye,
            corner: axes * DVec3::new(corner.x, corner.y, corner.z).as_vec3a(),
            column: axes * Vec3A::X / k.fx as f32,
            row: axes * Vec3A::NEG_Y / k.fy as f32,
        }
    }

    fn point(&self, u: usize, v: usize, depth_m: f32) -> Vec3A {
        self.eye + depth_m * (self.corner + u as f32 * self.column + v as f32 * self.row)
    }
}

/// Labels the pixels of a depth image from what is known of them beforehand. Where the object's pixels meet others they are
/// [`Label::Unsure`], as those that show the object and were not measured. `depth_m` and the labels have the same size.
///
/// Outside of a mask, a pixel that is not farther than the object may be reaches counts as [`Label::Hand`], whatever stands there: only the
/// space before it is free. What is farther, or lies behind the pixels of the object beside it, was looked through. Where nothing was measured, the space is free only if the hand's geometry
/// says that no finger stands there; without a hand it is unsure.
pub fn labelled(
    depth_m: &Array2<f32>,
    given: &GivenLabels,
    intrinsics: &Intrinsics,
    world_from_camera: Isometry<Camera, World>,
    hand: &HandSolid,
    config: &SegmentationConfig,
) -> Array2<Label> {
    let is_measured = |depth: f32| depth > 0.0 && depth.is_finite();
    let mut object = Array2::from_elem(depth_m.dim(), f32::INFINITY);
    let mut labels = match given {
        GivenLabels::Labels(labels) => labels.clone(),
        GivenLabels::Mask(mask) => {
            let rays = Rays::new(intrinsics, world_from_camera);
            let far_m = far_side_m(depth_m, mask, intrinsics);
            let nothing = if hand.is_empty() { Label::Unsure } else { Label::Background };
            let mut labels = Array2::from_shape_fn(depth_m.dim(), |at| match depth_m[at] {
                _ if mask[at] => Label::Object,
                depth if !is_measured(depth) => nothing,
                depth if depth <= far_m => Label::Hand,
                depth if hand.is_within(rays.point(at.1, at.0, depth).into(), config.margin_m) => Label::Hand,
                _ => Label::Background,
            });
            if hand.is_empty() {
                look_past_outline(&mut labels, depth_m, config.jump_m);
            }
            labels
        }
    };
    Zip::from(&mut labels).and(&mut object).and(depth_m).for_each(|label, object, &depth| {
        if *label == Label::Object {
            if is_measured(depth) { *object = depth } else { *label = Label::Unsure }
        }
    });
    mark_edges(&mut labels, &object, config);
    labels
}

/// The depth behind which nothing of the object is to be expected, metres: that of its farthest visible parts and as much again as it is
/// wide. Nothing is far where nothing of it was measured.
fn far_side_m(depth_m: &Array2<f32>, mask: &Array2<bool>, intrinsics: &Intrinsics) -> f32 {
    let mut depths: Vec<f32> = Vec::new();
    let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
    for (((v, u), _), &depth) in mask.indexed_iter().filter(|(_, inside)| **inside).map(|at| (at, &depth_m[at.0])) {
        if depth > 0.0 && depth.is_finite() {
            depths.push(depth);
            (low, high) = ([low[0].min(u), low[1].min(v)], [high[0].max(u), high[1].max(v)]);
        }
    }
    // Some pixels of a mask show the background.
    let Some(last) = depths.len().checked_sub(1) else { return f32::INFINITY };
    let farthest_m = *depths.select_nth_unstable_by(last * 19 / 20, f32::total_cmp).1;
    let across = |k: usize, focal_px: f64| (high[k] - low[k] + 1) as f32 / focal_px as f32;
    farthest_m * (1.0 + across(0, intrinsics.fx).max(across(1, intrinsics.fy)))
}

/// Pixels beside the object that lie behind it are its background, pixels.
const BESIDE_PX: usize = 6;

/// Relabels the pixels beside the object from [`Label::Hand`] to [`Label::Background`] where they lie farther than the object's pixels around
/// them: nothing hides the object there, so that its outline is seen.
fn look_past_outline(labels: &mut Array2<Label>, depth_m: &Array2<f32>, jump_m: f32) {
    let mut object = depth_m.clone();
    Zip::from(&mut object).and(&*labels).for_each(|depth, label| {
        if *label != Label::Object || *depth <= 0.0 {
            *depth = f32::NEG_INFINITY;
        }
    });
    let Some([rows, columns]) = bounds(&object, BESIDE_PX) else { return };
    let window = s![rows, columns];
    let farthest = windowed(&object.slice(&window), BESIDE_PX, |a, b| if a > b { a } else { b });
    Zip::from(labels.slice_mut(&window)).and(depth_m.slice(&window)).and(&farthest).for_each(
        |label, &depth, &object| {
            if *label == Label::Hand && object.is_finite() && depth > object + jump_m {
                *label = Label::Background;
            }
        },
    );
}

/// The part of the hand that can be within `margin_m` of any of the points.
fn near(hand: &HandSolid, points: &[([usize; 2], f32, Vec3A)], margin_m: f32) -> HandSolid {
    let low = points.iter().fold(Vec3A::INFINITY, |low, (_, _, p)| low.min(*p));
    let high = points.iter().fold(Vec3A::NEG_INFINITY, |high, (_, _, p)| high.max(*p));
    hand.cropped(((low + high) / 2.0).into(), (high - low).length() / 2.0 + margin_m)
}

/// Makes pixels unsure where the object meets another class or its own depth jumps. Such an edge has too great a range of depths
/// in a window, other classes counting as infinitely far.
fn mark_edges(labels: &mut Array2<Label>, object: &Array2<f32>, config: &SegmentationConfig) {
    let reach = config.edge_px;
    let Some([rows, columns]) = bounds(object, reach) else { return };
    let object = object.slice(s![rows.clone(), columns.clone()]);
    let (nearest, farthest) = (
        windowed(&object, reach, |a, b| if a < b { a } else { b }),
        windowed(&object, reach, |a, b| if a > b { a } else { b }),
    );
    Zip::from(labels.slice_mut(s![rows, columns])).and(&nearest).and(&farthest).for_each(|label, near, far| {
        // Without an object in the window the difference is no number.
        if *label != Label::Hand && far - near > config.jump_m {
            *label = Label::Unsure;
        }
    });
}

/// Rows and columns of the finite pixels and of those within `reach` of them; `None` if there is no such pixel.
fn bounds(image: &Array2<f32>, reach: usize) -> Option<[Range<usize>; 2]> {
    let [left, top, right, bottom] = extent(image, |depth| depth.is_finite())?;
    let around = |first: usize, last: usize, length: usize| first.saturating_sub(reach)..(last + 1 + reach).min(length);
    Some([around(top, bottom, image.nrows()), around(left, right, image.ncols())])
}

/// `pick` over the square window of `reach` pixels to each side of every pixel, as far as the image goes.
fn windowed(image: &ArrayView2<'_, f32>, reach: usize, pick: impl Fn(f32, f32) -> f32) -> Array2<f32> {
    let along = |image: &ArrayView2<'_, f32>, axis: Axis| {
        let mut result = image.to_owned();
        for shift in 1..=reach.min(image.len_of(axis).saturating_sub(1)) {
            let (ahead, behind) = (Slice::from(shift..), Slice::from(..image.len_of(axis) - shift));
            for (at, from) in [(behind, ahead), (ahead, behind)] {
                Zip::from(result.slice_axis_mut(axis, at))
                    .and(image.slice_axis(axis, from))
                    .for_each(|r, &v| *r = pick(*r, v));
            }
        }
        result
    };
    along(&along(image, Axis(0)).view(), Axis(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvt_frames::camera::PosedCamera;
    use mvt_robot::hand::{Hand, Side};
    use mvt_robot::rig::PLACEMENTS;

    const JOINTS: [f64; 16] = [0.0, 0.5, 0.6, 0.5, 0.0, 0.5, 0.6, 0.5, 0.0, 0.5, 0.6, 0.5, 1.2, 0.3, 0.4, 0.4];

    /// Depth of a ball and the hand's solid from the side camera, by marching along every ray: independent of any renderer.
    fn scene(ball: Vec3A, radius: f32) -> (Array2<f32>, Array2<Label>, PosedCamera) {
        let mut camera = PLACEMENTS[3].camera(&Hand::allegro(Side::Right));
        camera.intrinsics = Intrinsics::from_fov_y(320, 240, 45f64.to_radians());
        let hand = HandSolid::new(&Hand::allegro(Side::Right), &JOINTS);
        let rays = Rays::new(&camera.intrinsics, camera.pose);
        let mut truth = Array2::from_elem((240, 320), Label::Background);
        let depth = Array2::from_shape_fn((240, 320), |(v, u)| {
            let mut depth = 0.1;
            for _ in 0..200 {
                let p = rays.point(u, v, depth);
                let (to_ball, to_hand) = (p.distance(ball) - radius, hand.distance(p.into()));
                if to_ball.min(to_hand) < 2e-5 {
                    truth[[v, u]] = if to_ball < to_hand { Label::Object } else { Label::Hand };
                    return depth;
                }
                depth += to_ball.min(to_hand) / rays.point(u, v, 1.0).distance(rays.eye);
                if depth > 1.0 {
                    break;
                }
            }
            0.0
        });
        (depth, truth, camera)
    }

    /// The labels that a camera's image gets with the default settings; the grasp is that of an Allegro.
    fn found(depth: &Array2<f32>, camera: &PosedCamera, hand: &HandSolid) -> Array2<Label> {
        let grasp = Hand::allegro(Side::Right).grasp_centre(&[]);
        segment(depth, &camera.intrinsics, camera.pose, hand, grasp, &SegmentationConfig::default())
    }

    fn shows(labels: &Array2<Label>, u: usize, v: usize) -> Label {
        labels[[v, u]]
    }

    #[test]
    fn exact_depth_gives_exact_classes_but_for_the_edges() {
        let (depth, truth, camera) = scene(Vec3A::new(-0.0475, 0.0, 0.05), 0.03);
        let hand = HandSolid::new(&Hand::allegro(Side::Right), &JOINTS);
        let found = found(&depth, &camera, &hand);
        let mut object = [0, 0];
        for ((v, u), &true_label) in truth.indexed_iter() {
            let label = shows(&found, u, v);
            match true_label {
                Label::Hand => assert_eq!(label, Label::Hand, "({u}, {v})"),
                Label::Object => {
                    object[0] += 1;
                    object[1] += usize::from(label == Label::Object);
                }
                _ => assert!([Label::Background, Label::Unsure].contains(&label), "({u}, {v}): {label:?}"),
            }
            if label == Label::Object {
                assert_eq!(true_label, Label::Object);
            }
        }
        assert!(object[0] > 1000 && 10 * object[1] > 7 * object[0], "{object:?}");
    }

    #[test]
    fn edges_are_unsure_for_as_many_pixels_as_configured() {
        // A wall of the object in the middle of nothing, with a step down the middle.
        let camera = PLACEMENTS[2].camera(&Hand::allegro(Side::Right));
        let nothing = HandSolid::new(&Hand::allegro(Side::Right), &[0.0; 16]);
        let depth = Array2::from_shape_fn((480, 640), |(v, u)| match (u, v) {
            (300..320, 200..240) => 0.25,
            (320..340, 200..240) => 0.28,
            _ => 0.0,
        });
        let config = SegmentationConfig { edge_px: 3, ..SegmentationConfig::default() };
        let grasp = Hand::allegro(Side::Right).grasp_centre(&[]);
        let found = segment(&depth, &camera.intrinsics, camera.pose, &nothing, grasp, &config);
        let row: Vec<Label> = (290..350).map(|u| shows(&found, u, 220)).collect();
        let runs: Vec<(Label, usize)> = row.chunk_by(|a, b| a == b).map(|run| (run[0], run.len())).collect();
        let expected = [
            (Label::Background, 7),
            (Label::Unsure, 6),
            (Label::Object, 14),
            (Label::Unsure, 6),
            (Label::Object, 14),
            (Label::Unsure, 6),
            (Label::Background, 7),
        ];
        assert_eq!(runs, expected);
        assert_eq!(
            [196, 197, 202, 203, 236, 237, 242, 243].map(|v| shows(&found, 310, v)),
            [
                Label::Background,
                Label::Unsure,
                Label::Unsure,
                Label::Object,
                Label::Object,
                Label::Unsure,
                Label::Unsure,
                Label::Background
            ]
        );
    }

    #[test]
    fn tables_arms_and_holes_are_background() {
        let camera = PLACEMENTS[2].camera(&Hand::allegro(Side::Left));
        let hand = HandSolid::new(&Hand::allegro(Side::Left), &[0.0; 16]);
        let of = |depth| {
            let depth = Array2::from_elem((480, 640), depth);
            found(&depth, &camera, &hand)
        };
        for depth in [0.0, -0.3, f32::NAN, f32::INFINITY, 0.42, 1.0, 0.1] {
            assert!(of(depth).iter().all(|&label| label == Label::Background), "{depth}");
        }
        // At the height of the palm's surface: the palm is the hand's, other points are not.
        let label = of(0.35);
        let palm = camera.intrinsics.project(camera.pose.inverse() * Point::new(-0.0475, 0.0, 0.0111)).unwrap();
        assert_eq!(shows(&label, palm.0 as usize, palm.1 as usize), Label::Hand);
        assert!(label.iter().any(|&label| label == Label::Object));
    }

    #[test]
    fn without_a_hand_all_that_is_not_low_may_be_the_object() {
        let (none, config) = (Hand::none(), SegmentationConfig::default());
        let camera = PLACEMENTS[2].camera(&none);
        let solid = HandSolid::new(&none, &[]);
        let of = |depth| {
            let depth = Array2::from_elem((480, 640), depth);
            segment(&depth, &camera.intrinsics, camera.pose, &solid, none.grasp_centre(&[]), &config)
        };
        // The camera is 0.35 m above the origin.
        assert!(of(0.1).iter().all(|&label| label == Label::Object));
        assert!(of(0.39).iter().all(|&label| label == Label::Background));
    }

    /// A wall of an object 40 px wide at 0.3 m, something nearer to its left, a table as far to its right, a wall of the room above, and nothing below.
    fn masked(hand: &HandSolid) -> Array2<Label> {
        let camera = PLACEMENTS[2].camera(&Hand::allegro(Side::Right));
        let depth = Array2::from_shape_fn((480, 640), |(v, u)| match (v, u) {
            (210, 310) => 0.0,
            (200..240, 300..340) => 0.3,
            (200..240, ..300) => 0.2,
            (200..240, 340..) => 0.31,
            (..200, _) => 0.9,
            _ => 0.0,
        });
        let mask = Array2::from_shape_fn((480, 640), |(v, u)| (200..240).contains(&v) && (300..340).contains(&u));
        let config = SegmentationConfig::default();
        labelled(&depth, &GivenLabels::Mask(mask), &camera.intrinsics, camera.pose, hand, &config)
    }

    #[test]
    fn outside_of_a_mask_only_what_was_looked_through_is_background() {
        let of = |labels: &Array2<Label>| {
            [(220, 320), (210, 310), (220, 100), (220, 500), (100, 320), (400, 320)].map(|at| labels[at])
        };
        let none = HandSolid::new(&Hand::none(), &[]);
        let [object, hole, before, beside, behind, nothing] = of(&masked(&none));
        assert_eq!([object, hole], [Label::Object, Label::Unsure]);
        assert_eq!([before, beside, behind, nothing], [Label::Hand, Label::Hand, Label::Background, Label::Unsure]);
        // The hand is known, so that nothing else stands where nothing was measured.
        let hand = HandSolid::new(&Hand::allegro(Side::Right), &JOINTS);
        assert_eq!(of(&masked(&hand))[5], Label::Background);
    }

    #[test]
    fn the_edges_of_a_mask_are_unsure() {
        let labels = masked(&HandSolid::new(&Hand::none(), &[]));
        let row: Vec<Label> = (297..304).map(|u| labels[(220, u)]).collect();
        let [hand, unsure, object] = [Label::Hand, Label::Unsure, Label::Object];
        assert_eq!(row, [hand, hand, hand, unsure, object, object, object]);
    }

    #[test]
    fn beside_the_object_what_lies_behind_it_is_background() {
        let camera = PLACEMENTS[2].camera(&Hand::none());
        let none = HandSolid::new(&Hand::none(), &[]);
        let config = SegmentationConfig { edge_px: 0, ..SegmentationConfig::default() };
        // A finger before the object to its left, a table behind it to its right, the ground on which it stands below.
        let depth = Array2::from_shape_fn((480, 640), |(v, u)| match (v, u) {
            (200..240, 300..340) | (240.., _) => 0.3,
            (_, ..300) => 0.28,
            _ => 0.34,
        });
        let mask = Array2::from_shape_fn((480, 640), |(v, u)| (200..240).contains(&v) && (300..340).contains(&u));
        let given = GivenLabels::Mask(mask);
        let labels = labelled(&depth, &given, &camera.intrinsics, camera.pose, &none, &config);
        let found = [(220, 298), (220, 341), (242, 320)].map(|at| labels[at]);
        assert_eq!(found, [Label::Hand, Label::Background, Label::Hand]);
    }

    #[test]
    fn given_labels_stay_but_for_edges_and_holes_and_empty_masks_show_nothing() {
        let camera = PLACEMENTS[2].camera(&Hand::none());
        let none = HandSolid::new(&Hand::none(), &[]);
        let config = SegmentationConfig::default();
        let depth = Array2::from_shape_fn((480, 640), |(v, _)| if v == 250 { 0.0 } else { 0.3 });
        let given = Array2::from_shape_fn((480, 640), |(_, u)| match u {
            ..200 => Label::Hand,
            200..400 => Label::Object,
            _ => Label::Background,
        });
        let of = |given| labelled(&depth, &given, &camera.intrinsics, camera.pose, &none, &config);
        let labels = of(GivenLabels::Labels(given.clone()));
        let kept = labels.indexed_iter().filter(|(at, label)| given[*at] == **label).count();
        assert!(kept > 480 * 640 - 3000, "{kept}");
        assert_eq!(
            [(100, 300), (250, 300), (100, 400)].map(|at| labels[at]),
            [Label::Object, Label::Unsure, Label::Unsure]
        );
        let labels = of(GivenLabels::Mask(Array2::from_elem((480, 640), false)));
        assert!(labels.iter().all(|label| [Label::Hand, Label::Unsure].contains(label)), "all may stand before it");
    }

    #[test]
    fn rays_agree_with_the_pinhole_model() {
        let camera = PLACEMENTS[0].camera(&Hand::allegro(Side::Left));
        let p = Rays::new(&camera.intrinsics, camera.pose).point(600, 31, 0.4);
        let q = (camera.pose * camera.intrinsics.unproject(600.0, 31.0, 0.4)).coords();
        assert!((p.as_dvec3() - DVec3::new(q.x, q.y, q.z)).length() < 5e-7);
    }

    #[test]
    fn images_of_any_size_keep_it() {
        let camera = PLACEMENTS[0].camera(&Hand::allegro(Side::Left));
        let hand = HandSolid::new(&Hand::allegro(Side::Left), &[0.0; 16]);
        for (height, width) in [(0, 0), (1, 1), (3, 17), (9, 8)] {
            let depth = Array2::from_elem((height, width), 0.35);
            let found = found(&depth, &camera, &hand);
            assert_eq!(found.dim(), (height, width));
        }
    }
}
