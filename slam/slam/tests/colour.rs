//! What colours tell that depth does not: the turn of a ball.

#![expect(clippy::unwrap_used, reason = "a failed assumption is a failed test")]

use crate::synthetic::{self, BRICK, Sensed, Solid, blotches, seen, seen_painted};
use mvt_field::exact::KnownShape;
use mvt_frames::depth::Label;
use mvt_frames::image::{Rgb, RgbImage};
use mvt_frames::{Isometry, Model, World};
use mvt_slam::scan::Measurement;
use mvt_slam::{Estimate, Slam, SlamConfig};

type Pose = Isometry<Model, World>;

const BALL: Solid = Solid::Ball(0.035);

/// A ball that spins about an axis askew by `degrees`.
fn spun(degrees: f64) -> Pose {
    let axis = [0.2, -0.3, 0.93].map(|x| x * degrees);
    Isometry::new(synthetic::pose([0.0; 3], axis).untyped())
}

fn config(colour_weight: f64) -> SlamConfig {
    let mut config = SlamConfig::default();
    (config.tracker.colour_weight, config.tracker.texel_weight) = (colour_weight, colour_weight.min(1.0));
    config
}

fn known(solid: Solid, start: Pose, colour_weight: f64) -> Slam {
    let shape = KnownShape::new(&solid, solid.bounds());
    let builder = Slam::builder().config(config(colour_weight)).seed(1);
    builder.shape(shape, solid.bounds(), Some(start)).build().unwrap()
}

/// Degrees between the rotation of an estimate, against that of the first, and the true one.
fn off_deg(estimates: &[Estimate], k: usize, truth: impl Fn(usize) -> Pose) -> f64 {
    let turn = |first: Pose, now: Pose| now.untyped().rotation * first.untyped().rotation.inverse();
    turn(estimates[0].pose, estimates[k].pose).angle_to(&turn(truth(0), truth(k))).to_degrees()
}

fn follow(slam: &mut Slam, frames: usize, sense: impl Fn(usize) -> Sensed) -> Vec<Estimate> {
    (0..frames).map(|k| slam.observe(&sense(k).measured())).collect()
}

/// Three degrees per frame, with jerks of ten.
fn jerking(k: usize) -> Pose {
    spun(3.0 * k as f64 + 7.0 * (k / 10) as f64)
}

#[test]
fn the_spin_of_a_painted_ball_is_found_and_without_colours_it_is_not() {
    let sense = |k| seen_painted(k, BALL, jerking(k), blotches);
    let with = follow(&mut known(BALL, jerking(0), 1.0), 60, sense);
    let without = follow(&mut known(BALL, jerking(0), 0.0), 60, sense);
    let [with, without] = [&with, &without].map(|estimates| off_deg(estimates, 59, jerking));
    assert!(with < 3.0, "{with} degrees off");
    assert!(without > 90.0, "{without} degrees off without colours");
}

#[test]
fn an_unknown_ball_has_no_drift_after_a_whole_turn() {
    let turning = |k: usize| spun(4.0 * k as f64);
    let mut slam = Slam::builder().config(config(1.0)).seed(1).build().unwrap();
    let estimates = follow(&mut slam, 100, |k| seen_painted(k, BALL, turning(k), blotches));
    let (half, whole) = (off_deg(&estimates, 45, turning), off_deg(&estimates, 99, turning));
    assert!(half < 6.0 && whole < 3.0, "{half} and {whole} degrees off");
}

#[test]
fn light_that_changes_is_no_motion() {
    // A lamp that dims and a camera that opens its aperture.
    let sense = |k: usize| {
        let mut sensed = seen_painted(k, BALL, jerking(k), blotches);
        let image = sensed.cameras[0].as_mut().unwrap().colour.as_mut().unwrap();
        let gain = if k % 8 < 4 { 0.7 } else { 1.0 };
        image.pixels_mut().for_each(|Rgb(rgb)| *rgb = rgb.map(|c| (gain * f64::from(c) + 20.0).min(255.0) as u8));
        sensed
    };
    let estimates = follow(&mut known(BALL, jerking(0), 1.0), 60, sense);
    let off = off_deg(&estimates, 59, jerking);
    assert!(off < 2.0, "{off} degrees off");
}

#[test]
fn a_finger_that_passes_is_not_followed() {
    // It has blotches of its own, and moves against the spin.
    let sense = |k: usize| {
        let mut sensed = seen_painted(k, BALL, jerking(k), blotches);
        let camera = sensed.cameras[0].as_mut().unwrap();
        let left = 90 + (2 * k) % 100;
        for (v, u) in (0..240).flat_map(|v| (left..left + 45).map(move |u| (v, u))) {
            camera.depth_m[(v, u)] = 0.25;
            camera.labels[(v, u)] = Label::Hand;
            let grey = if (u - left) / 5 % 2 == v / 5 % 2 { 40 } else { 220 };
            camera.colour.as_mut().unwrap().put_pixel(u as u32, v as u32, Rgb([grey; 3]));
        }
        sensed
    };
    let estimates = follow(&mut known(BALL, jerking(0), 1.0), 60, sense);
    let off = off_deg(&estimates, 59, jerking);
    assert!(off < 2.0, "{off} degrees off");
}

/// Shading stands still while a solid without paint turns: it must not hold the solid.
#[test]
fn shading_is_no_colour() {
    let truth = |k: usize| Isometry::new(synthetic::pose([0.0; 3], [20.0, 10.0, 3.0 * k as f64]).untyped());
    let worst = |colour_weight: f64| {
        let mut slam = known(BRICK, truth(0), colour_weight);
        let estimates = follow(&mut slam, 60, |k| seen_painted(k, BRICK, truth(k), |_| 0.8));
        (0..60).map(|k| off_deg(&estimates, k, truth)).fold(0.0, f64::max)
    };
    let (with, without) = (worst(1.0), worst(0.0));
    // Of 177 degrees.
    assert!(with < without + 0.2, "{with} degrees off, {without} without colours");
}

/// The part of an estimate that does not depend on a clock, to the bit.
fn bits(estimates: &[Estimate]) -> Vec<([u64; 7], u64)> {
    let of = |e: &Estimate| {
        let ([w, x, y, z], t) = (e.pose.quaternion_wxyz(), e.pose.origin().coords());
        ([w, x, y, z, t.x, t.y, t.z].map(f64::to_bits), e.confidence.to_bits())
    };
    estimates.iter().map(of).collect()
}

fn run(colour_weight: f64, threads: usize, sense: impl Fn(usize) -> Sensed + Send + Sync) -> Vec<([u64; 7], u64)> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let mut config = config(colour_weight);
        config.map.first_steps = 40;
        let mut slam = Slam::builder().config(config).seed(1).build().unwrap();
        bits(&follow(&mut slam, 12, sense))
    })
}

#[test]
fn without_colours_nothing_changes() {
    let plain = run(1.0, 1, |k| seen(k, BALL, jerking(k)));
    let off = run(0.0, 1, |k| seen_painted(k, BALL, jerking(k), blotches));
    let of_another_size = run(1.0, 1, |k| {
        let mut sensed = seen_painted(k, BALL, jerking(k), blotches);
        sensed.cameras[0].as_mut().unwrap().colour = Some(RgbImage::new(64, 48));
        sensed
    });
    assert!(plain == off && plain == of_another_size);
    let with = run(1.0, 1, |k| seen_painted(k, BALL, jerking(k), blotches));
    assert_ne!(plain, with);
    assert_eq!(with, run(1.0, 3, |k| seen_painted(k, BALL, jerking(k), blotches)), "whatever the number of threads");
    // No camera, and a frame of nothing.
    let nothing = run(1.0, 1, |k| if k < 6 { seen_painted(k, BALL, jerking(k), blotches) } else { blind(k) });
    assert_eq!(nothing[..6], with[..6]);
}

fn blind(k: usize) -> Sensed {
    synthetic::frame(k as f64 / 30.0, vec![None])
}

#[test]
fn a_saved_map_has_no_colours_and_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let mut slam = Slam::builder().config(config(1.0)).seed(1).build().unwrap();
    follow(&mut slam, 6, |k| seen_painted(k, BRICK, spun(k as f64), blotches));
    slam.map().unwrap().save(folder.path()).unwrap();
    let map =
        mvt_slam::map::Map::load(folder.path(), SlamConfig::default().map, mvt_slam::Obstacles::default()).unwrap();
    let mut slam = Slam::builder().config(config(1.0)).seed(2).map(map).build().unwrap();
    let empty = Measurement { time_s: 0.0, cameras: &[], touch: &[], obstacles: &[] };
    slam.observe(&empty);
    let estimates = follow(&mut slam, 20, |k| seen_painted(k + 1, BRICK, spun(5.0), blotches));
    assert!(estimates.last().unwrap().state.is_tracking());
}
