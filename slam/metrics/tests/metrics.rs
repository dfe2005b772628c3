//! Compares the scores with closed forms, brute force and figures computed with NumPy (data/metrics_oracle.py).

#![allow(clippy::unwrap_used, clippy::float_cmp_const, reason = "a failed assumption in a test is a failed test")]

use glam::Vec3;
use mvt_frames::{Isometry, Object};
use mvt_mesh::Mesh;
use mvt_metrics::{
    FScore, ORIGINAL_THRESHOLDS_M, POINTS, PoseStatistics, THRESHOLDS_M, TrueSurface, mean_original, sample_surface,
    sample_surface_even,
};
use proptest::prelude::*;
use serde::Deserialize;

type Motion = Isometry<Object, Object>;

/// Returns a sphere of latitude and longitude quads about its centre.
fn sphere(radius_m: f32) -> Mesh {
    let (rows, columns) = (60_u32, 120_u32);
    let angle = |k: u32, of: u32, turn: f32| k as f32 / of as f32 * turn;
    let vertex = |row: u32, column: u32| {
        let (sin, cos) = angle(row, rows, std::f32::consts::PI).sin_cos();
        let (y, x) = angle(column, columns, std::f32::consts::TAU).sin_cos();
        radius_m * Vec3::new(sin * x, sin * y, cos)
    };
    let index = |row: u32, column: u32| row * columns + column % columns;
    let quad = |row: u32, column: u32| {
        let [a, b] = [index(row, column), index(row, column + 1)];
        let [c, d] = [index(row + 1, column), index(row + 1, column + 1)];
        [[a, c, d], [a, d, b]]
    };
    Mesh {
        vertices: (0..=rows).flat_map(|row| (0..columns).map(move |column| vertex(row, column))).collect(),
        faces: (0..rows).flat_map(|row| (0..columns).flat_map(move |column| quad(row, column))).collect(),
    }
}

/// Returns a square in the plane z = 0 about the origin.
fn square(side_m: f32) -> Mesh {
    let corner = |x: f32, y: f32| Vec3::new(x - 0.5, y - 0.5, 0.0) * side_m;
    Mesh {
        vertices: vec![corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)],
        faces: vec![[0, 1, 2], [0, 2, 3]],
    }
}

fn shift(x: f64, y: f64, z: f64) -> Motion {
    Motion::translation(x, y, z)
}

#[test]
fn concentric_spheres_are_as_far_apart_as_their_radii() {
    let truth = TrueSurface::new(&sphere(0.040), POINTS, 1);
    let score = truth.score(&sample_surface(&sphere(0.043), POINTS, 2), Motion::identity(), &THRESHOLDS_M);
    // The nearest of n samples of an area A lies beside the nearest point of the surface by A / (pi n) in the mean square, if the samples
    // are independent. Those of the estimate are; those of the truth are more even.
    let aside_m2 = |radius_m: f64| 4.0 * radius_m * radius_m / POINTS as f64;
    let completeness_m = (0.003_f64.powi(2) + aside_m2(0.043)).sqrt();
    assert!((score.completeness_m - completeness_m).abs() < 2e-5, "{} for {completeness_m}", score.completeness_m);
    let mesh_error_m = (0.003_f64.powi(2) + aside_m2(0.040)).sqrt();
    assert!((0.0030..mesh_error_m).contains(&score.mesh_error_m), "{} for {mesh_error_m}", score.mesh_error_m);
    let f: Vec<f64> = score.f_scores.iter().map(FScore::f).collect();
    assert_eq!(f[..2], [0.0, 0.0], "at 1 and 2 mm");
    assert_eq!(f[2..], [1.0, 1.0], "at 5 and 10 mm");
}

#[test]
fn the_error_of_a_lifted_plane_is_its_height() {
    let truth = TrueSurface::new(&square(0.1), POINTS, 0);
    let error = truth.add_s(shift(0.0, 0.0, -0.007));
    assert!((error.one_directional_m - 0.007).abs() < 1e-8, "{error:?}");
    assert!((error.symmetric_m - 0.007).abs() < 1e-8, "{error:?}");
}

/// Of a square of side s, moved by d < s in its plane, a share d / s sticks out, by d / 2 on average. The rest lies on samples that are
/// about half a spacing away.
#[test]
fn of_a_plane_that_slides_only_the_part_outside_counts() {
    let (side, slid) = (0.1, 0.02);
    let truth = TrueSurface::new(&square(side as f32), POINTS, 0);
    let error = truth.add_s(shift(slid, 0.0, 0.0)).one_directional_m;
    let out = slid * slid / (2.0 * side);
    assert!((out..out + 0.0006).contains(&error), "{error} for {out}");
    // A tenth of the points yields the same, except for chance.
    let sample = TrueSurface::new(&square(side as f32), POINTS / 10, 0);
    let quick = truth.add_s_of(&sample, shift(slid, 0.0, 0.0)).one_directional_m;
    assert!((quick - error).abs() < 4e-4, "{quick} for {error}");
}

#[test]
fn half_a_shape_is_precise_and_incomplete() {
    // Two patches of 10 mm whose edges are 40 mm apart.
    let patch = |x: f32| sample_surface(&square(0.01), 500, 3).into_iter().map(move |p| p + x * Vec3::X);
    let truth = TrueSurface::of_points(patch(0.0).chain(patch(0.05)).collect());
    // After half a turn about the first patch, this patch lies on itself, and the second is 45 mm from it on average.
    let error = truth.add_s(Motion::from_parts([0.0; 3], [0.0, 0.0, 0.0, 1.0]));
    assert!((error.one_directional_m - 0.0225).abs() < 1e-3, "{error:?}");
    let score = truth.score(&patch(0.0).collect::<Vec<_>>(), Motion::identity(), &[0.005]);
    assert_eq!(score.f_scores[0].precision, 1.0);
    assert_eq!(score.f_scores[0].recall, 0.5);
    assert!((score.f_scores[0].f() - 2.0 / 3.0).abs() < 1e-12);
    assert!(score.mesh_error_m < 1e-7 && (score.completeness_m - 0.0225).abs() < 1e-3, "{score:?}");
}

#[test]
fn the_true_pose_has_no_error_and_the_true_shape_every_point() {
    let truth = TrueSurface::new(&sphere(0.035), POINTS, 5);
    assert_eq!(truth.add_s(Motion::identity()).symmetric_m, 0.0);
    let score = truth.score(truth.points(), Motion::identity(), &ORIGINAL_THRESHOLDS_M);
    assert_eq!((score.mesh_error_m, score.completeness_m), (0.0, 0.0));
    assert!(score.f_scores.iter().all(|f| f.f() == 1.0));
}

#[test]
fn shapes_that_share_nothing_score_0_and_nothing_is_nan() {
    let truth = TrueSurface::new(&square(0.05), 1000, 0);
    let disjoint = truth.score(truth.points(), shift(1.0, 0.0, 0.0), &THRESHOLDS_M);
    assert!(disjoint.f_scores.iter().all(|f| f.f() == 0.0), "{disjoint:?}");
    let nothing = truth.score(&[], Motion::identity(), &THRESHOLDS_M);
    assert!(nothing.f_scores.iter().all(|f| f.f() == 0.0) && nothing.mesh_error_m == f64::INFINITY, "{nothing:?}");
    // The error of an invalid pose is infinite; so is the error against an empty truth.
    assert_eq!(truth.add_s(Motion::from_parts([0.0; 3], [0.0; 4])).symmetric_m, f64::INFINITY);
    assert_eq!(TrueSurface::of_points(Vec::new()).add_s(Motion::identity()).symmetric_m, f64::INFINITY);
    assert!(sample_surface(&Mesh::default(), 10, 0).is_empty());
    let collapsed =
        Mesh { vertices: vec![Vec3::NAN, Vec3::ZERO, Vec3::X], faces: vec![[0, 1, 2], [1, 1, 2], [0, 1, 9]] };
    assert!(sample_surface_even(&collapsed, 10, 0).is_empty());
}

#[test]
fn a_point_at_a_threshold_is_outside() {
    let truth = TrueSurface::of_points(vec![Vec3::ZERO]);
    let estimate = vec![Vec3::X * 2.0_f32.powi(-7)];
    let score = truth.score(&estimate, Motion::identity(), &[2.0_f64.powi(-7), 2.0_f64.powi(-7) + 1e-9]);
    assert_eq!([0, 1].map(|k| score.f_scores[k].f()), [0.0, 1.0]);
}

#[test]
fn samples_follow_the_area() {
    // Of the two squares, one has four times the area of the other.
    let mut mesh = square(0.1);
    let small = square(0.05);
    mesh.faces.extend(small.faces.iter().map(|face| face.map(|v| v + 4)));
    mesh.vertices.extend(small.vertices.iter().map(|&v| v + Vec3::Z));
    for points in [sample_surface(&mesh, 20_000, 4), sample_surface_even(&mesh, 20_000, 4)] {
        assert_eq!(points.len(), 20_000);
        let upper = points.iter().filter(|p| p.z > 0.5).count() as f64 / 20_000.0;
        // Four standard deviations of a fair draw.
        assert!((upper - 0.2).abs() < 0.0114, "{upper}");
        let centre = points.iter().filter(|p| p.z < 0.5).sum::<Vec3>() / (20_000.0 * 0.8);
        assert!(centre.length() < 0.001, "{centre}");
    }
    assert_eq!(sample_surface(&mesh, 100, 9), sample_surface(&mesh, 100, 9));
    assert_ne!(sample_surface(&mesh, 100, 9), sample_surface(&mesh, 100, 8));
}

#[test]
fn a_surface_that_lies_on_itself_gets_its_points_in_time() {
    let mut mesh = square(0.1);
    mesh.faces = mesh.faces.repeat(10_000);
    assert_eq!(sample_surface_even(&mesh, 5000, 0).len(), 5000);
}

#[test]
fn even_samples_keep_their_distance() {
    let points = sample_surface_even(&square(0.1), 1000, 0);
    let closest = points
        .iter()
        .enumerate()
        .flat_map(|(i, p)| points[..i].iter().map(move |q| p.distance(*q)))
        .fold(f32::INFINITY, f32::min);
    let promised = (0.01_f32 / 3000.0).sqrt();
    assert!((promised..1.1 * promised).contains(&closest), "{closest} for {promised}");
}

proptest! {
    #[test]
    fn nearest_points_are_those_of_brute_force(
        sizes in (0_usize..80, 1_usize..80),
        seed in any::<u64>(),
        cell in prop::sample::select(vec![0.0_f32, 1e-4, 0.02]),
        offset in -0.2_f64..0.2,
        turn in -1.0_f64..1.0,
    ) {
        // On a grid (cell > 0) many points coincide.
        let cloud = |n: usize, seed: u64| -> Vec<Vec3> {
            let snapped = |p: Vec3| if cell > 0.0 { (p / cell).round() * cell } else { p };
            sample_surface(&sphere(0.04), n, seed).into_iter().map(snapped).collect()
        };
        let (estimate, truth) = (cloud(sizes.0, seed), cloud(sizes.1, seed.wrapping_add(1)));
        let motion = Motion::from_parts([offset, 0.01, 0.0], [1.0, turn, 0.3, -turn]);
        let (rotation, translation) = motion.to_f32();
        let moved: Vec<Vec3> = estimate.iter().map(|&p| Vec3::from(rotation * glam::Vec3A::from(p) + translation)).collect();
        let brute = |points: &[Vec3], to: &[Vec3]| {
            let nearest = |p: &Vec3| to.iter().map(|q| p.distance(*q)).fold(f32::INFINITY, f32::min);
            points.iter().map(|p| f64::from(nearest(p))).sum::<f64>() / points.len() as f64
        };
        let score = TrueSurface::of_points(truth.clone()).score(&estimate, motion, &[]);
        if moved.is_empty() {
            prop_assert_eq!(score.mesh_error_m, f64::INFINITY);
        } else {
            prop_assert!((score.mesh_error_m - brute(&moved, &truth)).abs() < 1e-7);
            prop_assert!((score.completeness_m - brute(&truth, &moved)).abs() < 1e-7);
        }
    }
}

#[derive(Deserialize)]
struct Oracle {
    truth: Vec<[f32; 3]>,
    estimate: Vec<[f32; 3]>,
    thresholds_m: Vec<f64>,
    cases: Vec<Case>,
    run: Run,
}

#[derive(Deserialize)]
struct Case {
    translation_m: [f64; 3],
    quaternion_wxyz: [f64; 4],
    one_directional_m: f64,
    symmetric_m: f64,
    precision: Vec<f64>,
    recall: Vec<f64>,
    f: Vec<f64>,
    mesh_error_m: f64,
    completeness_m: f64,
}

#[derive(Deserialize)]
struct Run {
    times_s: Vec<f64>,
    errors_m: Vec<f64>,
    #[serde(flatten)]
    statistics: PoseStatistics,
}

fn oracle() -> Oracle {
    serde_json::from_str(include_str!("data/metrics_oracle.json")).unwrap()
}

#[test]
fn scores_are_those_of_numpy() {
    let oracle = oracle();
    let points = |rows: &[[f32; 3]]| rows.iter().map(|&row| Vec3::from(row)).collect::<Vec<_>>();
    let truth = TrueSurface::of_points(points(&oracle.truth));
    for case in &oracle.cases {
        let motion = Motion::from_parts(case.translation_m, case.quaternion_wxyz);
        let pose = truth.add_s(motion);
        let shape = truth.score(&points(&oracle.estimate), motion, &oracle.thresholds_m);
        for (ours, theirs) in [
            (pose.one_directional_m, case.one_directional_m),
            (pose.symmetric_m, case.symmetric_m),
            (shape.mesh_error_m, case.mesh_error_m),
            (shape.completeness_m, case.completeness_m),
        ] {
            assert!((ours - theirs).abs() < 1e-7, "{ours} {theirs}");
        }
        for (k, ours) in shape.f_scores.iter().enumerate() {
            for (ours, theirs) in
                [(ours.precision, case.precision[k]), (ours.recall, case.recall[k]), (ours.f(), case.f[k])]
            {
                assert!((ours - theirs).abs() < 1e-9, "threshold {k}: {ours} {theirs}");
            }
        }
    }
}

#[test]
fn statistics_are_those_of_numpy() {
    let Run { times_s, errors_m, statistics: expected } = oracle().run;
    let errors: Vec<(f64, f64)> = times_s.into_iter().zip(errors_m).collect();
    let ours = PoseStatistics::new(&errors).unwrap();
    for (ours, theirs) in [
        (ours.mean_m, expected.mean_m),
        (ours.median_m, expected.median_m),
        (ours.p95_m, expected.p95_m),
        (ours.final_m, expected.final_m),
        (ours.mean_original_m.unwrap(), expected.mean_original_m.unwrap()),
    ] {
        assert!((ours - theirs).abs() < 1e-12, "{ours} {theirs}");
    }
}

#[test]
fn errors_that_the_original_leaves_out_count_here() {
    assert_eq!(PoseStatistics::new(&[]), None);
    let early = [(0.0, 0.001), (4.9, 0.002)];
    assert_eq!(mean_original(&early), None);
    let astray = PoseStatistics::new(&[(5.0, 0.002), (6.0, 0.2), (7.0, 0.06)]).unwrap();
    assert_eq!(astray.mean_original_m, Some(0.002));
    assert!(astray.failed() && astray.mean_m > 0.08, "{astray:?}");
    let undefined = PoseStatistics::new(&[(5.0, 0.002), (6.0, f64::NAN)]).unwrap();
    assert!(undefined.failed() && undefined.mean_m == f64::INFINITY && undefined.median_m == f64::INFINITY);
}

/// Evenly spaced points on a ball.
fn fibonacci(radius_m: f32, count: usize) -> Vec<Vec3> {
    let point = |k: usize| {
        let z = 1.0 - (2 * k + 1) as f32 / count as f32;
        let (sin, cos) = (2.399_963 * k as f32).sin_cos();
        radius_m * Vec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
    };
    (0..count).map(point).collect()
}

#[test]
fn the_lowest_fifth_of_a_ball_is_its_cap() {
    let radius_m = 0.03;
    let truth = TrueSurface::of_points(fibonacci(radius_m, 10_000));
    let lowest = truth.lowest(0.2);
    assert_eq!(lowest.points().len(), 2_000);
    // The area of a ball is uniform along each axis (Archimedes), so that a fifth of it lies below -0.6 r.
    let highest = lowest.points().iter().fold(f32::NEG_INFINITY, |high, p| high.max(p.z));
    assert!((highest + 0.6 * radius_m).abs() < 1e-4, "{highest}");
    // An estimate without all below -0.8 r misses half of it, but for a rim of 5 mm along the ball.
    let cut: Vec<Vec3> = fibonacci(radius_m, 10_000).into_iter().filter(|p| p.z > -0.8 * radius_m).collect();
    let recall = lowest.score(&cut, Isometry::<Object, Object>::identity(), &[0.005]).f_scores[0].recall;
    let rim = (0.8_f64.acos() - 2.0 * (0.005 / 2.0 / f64::from(radius_m)).asin()).cos() - 0.8;
    assert!((recall - (0.1 + 0.5 * rim) / 0.2).abs() < 0.01, "{recall} with a rim of {rim}");
    assert!(truth.lowest(0.0).points().is_empty());
}

#[test]
fn a_part_of_a_surface_is_scored_without_the_rest() {
    let still = Isometry::<Object, Object>::identity();
    let ball = fibonacci(0.03, 10_000);
    let truth = TrueSurface::of_points(ball.clone());
    let upper: Vec<Vec3> = ball.iter().copied().filter(|p| p.z > 0.0).collect();
    let [seen, rest] = truth.divided(&upper, 0.001);
    assert!((seen.points().len() + rest.points().len()) == 10_000 && (5_000..5_250).contains(&seen.points().len()));
    // The lower half of the estimate is far from the true one; only the rim of the upper half notices.
    let estimate: Vec<Vec3> = ball.iter().map(|&p| if p.z > 0.0 { p } else { p * 0.5 }).collect();
    let whole = truth.score(&estimate, still, &[0.002]).f_scores[0];
    let part = seen.score_beside(&rest, &estimate, still, &[0.002]).f_scores[0];
    assert!(whole.recall < 0.6 && whole.precision < 0.6, "{whole:?}");
    assert!(part.recall > 0.99 && part.precision > 0.99, "{part:?}");
    // A surface that does not exist, above the part that was seen, is not hidden by the division.
    let doubled: Vec<Vec3> = ball.iter().flat_map(|&p| [p, p * 1.5]).collect();
    let doubled = seen.score_beside(&rest, &doubled, still, &[0.002]).f_scores[0];
    assert!((doubled.precision - 0.5).abs() < 0.02, "{doubled:?}");
    let [none, all] = truth.divided(&[], 0.001);
    assert!(none.points().is_empty() && all.points().len() == 10_000);
}
