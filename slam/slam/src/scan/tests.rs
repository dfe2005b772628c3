use mvt_frames::{Camera, Isometry, Point, World};
use nalgebra as na;

use super::*;
use crate::synthetic::{BRICK, GEL_M, PLACE_M, Sensed, Solid, camera, feel, frame, pose, see, seen};

const RADIUS_M: f64 = 0.03;
const BALL: Solid = Solid::Ball(RADIUS_M);

fn scan_of(depth: &Sensed) -> Scan {
    Scan::new(0, &depth.measured(), &ScanConfig::default(), 1)
}

fn ball() -> Scan {
    scan_of(&seen(0, BALL, pose([0.0; 3], [0.0; 3])))
}

fn in_solid(p: Vec3) -> na::Vector3<f64> {
    crate::tracker::to_na(p) - na::Vector3::from(PLACE_M)
}

#[test]
fn hits_lie_on_the_ball_and_normals_point_out_of_it() {
    let scan = ball();
    let view = &scan.views[0];
    assert_eq!(view.sensor(), Sensor::Camera(0));
    assert!(view.hits.len() > 2000, "{} hits", view.hits.len());
    let mut with_normal = 0;
    for hit in &view.hits {
        let p = in_solid(view.point(hit));
        assert!(BALL.distance(p).abs() < 1e-6, "{} m off the surface", BALL.distance(p));
        assert!((hit.direction.length() - 1.0).abs() < 1e-6);
        if hit.normal != Vec3::ZERO {
            with_normal += 1;
            let truth = p.normalize();
            let cosine = -truth.dot(&crate::tracker::to_na(hit.direction));
            // Differences over ten pixels see a chord where the surface falls away.
            let tolerance_deg = if cosine > 0.5 { 3.0 } else { 25.0 };
            let off = truth.angle(&crate::tracker::to_na(hit.normal)).to_degrees();
            assert!(off < tolerance_deg, "normal {off} degrees off at cosine {cosine}");
            if cosine > 0.5 {
                assert!((f64::from(hit.cosine) - cosine).abs() < 0.05);
            }
        }
    }
    assert!(with_normal > view.hits.len() * 9 / 10, "{with_normal} normals of {}", view.hits.len());
}

#[test]
fn displaced_depth_is_put_back() {
    let mut displaced = seen(0, BALL, pose([0.0; 3], [0.0; 3]));
    let image = displaced.cameras[0].as_mut().unwrap();
    let (depth_m, labels) = (image.depth_m.clone(), image.labels.clone());
    for ((v, u), z) in depth_m.indexed_iter().filter(|((v, u), _)| v + 2 < depth_m.nrows() && u + 3 < depth_m.ncols()) {
        (image.depth_m[(v + 2, u + 3)], image.labels[(v + 2, u + 3)]) = (*z, labels[(v, u)]);
    }
    let config = ScanConfig { camera_shift_px: [3.0, 2.0], ..ScanConfig::default() };
    let scan = Scan::new(0, &displaced.measured(), &config, 1);
    assert!(scan.hits() > 2000, "{} hits", scan.hits());
    for hit in &scan.views[0].hits {
        let off_m = BALL.distance(in_solid(scan.views[0].point(hit)));
        assert!(off_m.abs() < 1e-5, "{off_m} m off the surface");
    }
}

#[test]
fn faces_of_a_block_have_their_normals_to_a_tenth_of_a_degree() {
    let truth = pose([0.0; 3], [20.0, 10.0, 35.0]);
    let scan = scan_of(&seen(0, BRICK, truth));
    let view = &scan.views[0];
    let mut exact = 0;
    for hit in view.hits.iter().filter(|hit| hit.normal != Vec3::ZERO) {
        let n = truth.untyped().rotation.inverse() * crate::tracker::to_na(hit.normal);
        exact += usize::from(n.amax() > 0.1f64.to_radians().cos());
    }
    assert!(exact > view.hits.len() * 6 / 10, "{exact} of {}", view.hits.len());
}

#[test]
fn grazing_hits_are_less_certain() {
    let scan = ball();
    let mean = |low: f32, high: f32| {
        let chosen = scan.views[0].hits.iter().filter(|h| h.normal != Vec3::ZERO && (low..high).contains(&h.cosine));
        let sigmas: Vec<f32> = chosen.map(|h| h.sigma_m).collect();
        assert!(sigmas.len() > 50);
        sigmas.iter().sum::<f32>() / sigmas.len() as f32
    };
    let bands = [mean(0.95, 1.01), mean(0.7, 0.8), mean(0.4, 0.5)];
    assert!(bands.is_sorted(), "{bands:?}");
    assert!(bands[2] > 1.5 * bands[0], "{bands:?}");
    // Head-on only the depth's own noise is left.
    let config = ScanConfig::default();
    let facing = scan.views[0].hits.iter().max_by(|a, b| a.cosine.total_cmp(&b.cosine)).unwrap();
    let expected = config.camera_sigma_per_m2 * facing.range_m.powi(2);
    assert!((facing.sigma_m / expected - 1.0).abs() < 0.1, "{} {expected}", facing.sigma_m);
    for hit in scan.views[0].outline() {
        assert!(hit.sigma_m > bands[0], "an outline is uncertain sideways whichever way its surface faces");
    }
}

#[test]
fn outline_is_the_silhouette() {
    let scan = ball();
    let view = &scan.views[0];
    assert!(view.outline().len() > 100, "{}", view.outline().len());
    let origin = in_solid(view.origin);
    let silhouette = (RADIUS_M / origin.norm()).asin();
    let pixel = 1.0 / camera().0.fx;
    let off_axis = |hit: &Hit| (-origin).angle(&crate::tracker::to_na(hit.direction));
    for hit in view.outline() {
        let short = (silhouette - off_axis(hit)) / pixel;
        assert!(
            (-0.1..ScanConfig::default().outline_px as f64 * 1.5 + 1.0).contains(&short),
            "{short} pixels within the silhouette"
        );
    }
    for hit in &view.hits {
        // A corner of the diamond that must be filled may come nearer than its reach.
        assert!((silhouette - off_axis(hit)) / pixel > 0.6 * ScanConfig::default().outline_px as f64);
    }
}

#[test]
fn misses_pass_the_solid() {
    let truth = pose([0.0; 3], [20.0, 10.0, 35.0]);
    let scan = scan_of(&seen(0, BRICK, truth));
    let view = &scan.views[0];
    assert!(view.misses.len() > 1000);
    let inside = truth.untyped().inverse();
    for miss in &view.misses {
        for step in 0..200 {
            let p = view.origin + miss.direction * (miss.free_m * step as f32 / 200.0);
            let p = inside * na::Point3::from(crate::tracker::to_na(p));
            assert!(BRICK.distance(p.coords) > -1e-6, "a free ray runs through the solid");
        }
    }
    // The first half keeps to the outline: within three pixels of it, and pixels are 0.6 mm wide there.
    let nearest = |miss: &Miss| {
        let along = (0..400).map(|i| view.origin + miss.direction * (0.2 + 0.001 * i as f32));
        let distance = |p| BRICK.distance((inside * na::Point3::from(crate::tracker::to_na(p))).coords);
        along.map(distance).fold(f64::INFINITY, f64::min)
    };
    let close = view.misses.iter().take(300).filter(|miss| nearest(miss) < 0.003).count();
    assert_eq!(close, 300);
}

#[test]
fn lookup_finds_a_hit_where_it_is_seen() {
    let scan = ball();
    let view = &scan.views[0];
    let lookup = view.lookup().unwrap();
    let mut itself = 0;
    for (i, hit) in view.hits.iter().enumerate() {
        let found = lookup.at(view.point(hit)).expect("the cell of a hit is never empty");
        // Two hits may share a cell; then one of them stands for both.
        let apart = (view.hits[found].direction - hit.direction).length() / (1.0 / camera().0.fx as f32);
        assert!(apart < 4.0 * 2f32.sqrt() + 0.1, "{apart} pixels apart");
        itself += usize::from(found == i);
        // The same line of sight, farther away.
        assert_eq!(lookup.at(view.origin + hit.direction * 0.8), Some(found));
    }
    assert!(itself * 9 > view.hits.len(), "{itself}");
    assert_eq!(lookup.at(view.origin - view.hits[0].direction * 0.3), None, "behind the camera");
    assert_eq!(lookup.at(view.origin + Vec3::new(5.0, 0.0, 0.1)), None, "outside the image");
    assert_eq!(lookup.at(Vec3::NAN), None);
}

#[test]
fn frame_and_seed_alone_choose_the_rays() {
    let depth = seen(0, BRICK, pose([0.0; 3], [20.0, 10.0, 35.0]));
    let few = ScanConfig { camera_hits: 200, camera_outline: 50, camera_misses: 100, ..ScanConfig::default() };
    let scan = |frame, seed| Scan::new(frame, &depth.measured(), &few, seed);
    assert_eq!(scan(3, 7), scan(3, 7));
    assert_ne!(scan(3, 7).views[0].hits, scan(4, 7).views[0].hits);
    assert_ne!(scan(3, 7).views[0].hits, scan(3, 8).views[0].hits);
    let view = &scan(3, 7).views[0];
    assert_eq!([view.hits.len(), view.outline().len(), view.misses.len()], [200, 50, 100]);
}

#[test]
fn cameras_that_see_nothing() {
    let (intrinsics, at) = camera();
    let empty = see(Solid::Ball(0.0), pose([0.0; 3], [0.0; 3]), (intrinsics, at));
    let scan = scan_of(&frame(0.5, vec![None, Some(empty.clone())]));
    assert_eq!(scan.hits(), 0);
    assert_eq!(scan.views.len(), 1);
    assert_eq!(scan.views[0].sensor(), Sensor::Camera(1), "a camera keeps its number when another fails");
    assert!(scan.views[0].outline().is_empty());
    assert!(scan.views[0].misses.len() > 1000, "all of it is free");

    let blind = CameraDepth { depth_m: Array2::zeros((240, 320)), ..see(BALL, pose([0.0; 3], [0.0; 3]), camera()) };
    let scan = scan_of(&frame(0.5, vec![Some(blind)]));
    assert_eq!(scan.hits(), 0, "an object without depth has no surface");
    assert!(scan.views[0].outline().is_empty());

    let mut tiny = empty;
    tiny.depth_m = Array2::zeros((0, 0));
    tiny.labels = Array2::default((0, 0));
    tiny.intrinsics = mvt_frames::camera::Intrinsics { width: 0, height: 0, ..intrinsics };
    assert_eq!(scan_of(&frame(0.0, vec![Some(tiny)])).hits(), 0);
    assert_eq!(scan_of(&frame(0.0, Vec::new())).views.len(), 0);
}

#[test]
fn no_number_of_a_scan_is_nan_whatever_the_depth() {
    let mut image = see(BALL, pose([0.0; 3], [0.0; 3]), camera());
    for ((v, u), z) in image.depth_m.indexed_iter_mut() {
        match (u * 7 + v * 3) % 11 {
            0 => *z = f32::NAN,
            1 => *z = 0.0,
            2 => *z = -*z,
            _ => {}
        }
    }
    let scan = scan_of(&frame(0.0, vec![Some(image)]));
    let view = &scan.views[0];
    assert!(view.hits.len() > 1000);
    for hit in view.hits.iter().chain(view.outline()) {
        let numbers = [hit.range_m, hit.cosine, hit.sigma_m];
        assert!(numbers.iter().all(|x| x.is_finite() && *x > 0.0), "{hit:?}");
        assert!(hit.direction.is_finite() && hit.normal.is_finite());
        assert!(BALL.distance(in_solid(view.point(hit))).abs() < 1e-6);
    }
    assert!(view.misses.iter().all(|miss| miss.direction.is_finite() && miss.free_m.is_finite()));
}

#[test]
fn touch_hits_where_the_gel_is_pressed() {
    // The sensor looks along -z of its camera at a ball whose nearest point is 1 mm behind the gel's surface.
    let sensor = Isometry::<Camera, World>::translation(0.0, 0.0, PLACE_M[2] + RADIUS_M + f64::from(GEL_M) - 0.001);
    let touch = feel(BALL, pose([0.0; 3], [0.0; 3]), sensor);
    let mut depth = frame(0.0, Vec::new());
    depth.touch = vec![None, None, Some(touch)];
    let scan = scan_of(&depth);
    let view = &scan.views[0];
    assert_eq!(view.sensor(), Sensor::Touch(2));
    assert!(view.hits.len() > 100 && view.misses.len() > 20, "{} {}", view.hits.len(), view.misses.len());
    let Detail::Touch { pad: Some(pad), .. } = view.detail else { panic!("a touch sensor without a pad") };
    assert!(pad.pressed_px > view.hits.len(), "the hits are a sample");
    for hit in &view.hits {
        let p = in_solid(view.point(hit));
        assert!(BALL.distance(p).abs() < 1e-6);
        assert!(p.angle(&crate::tracker::to_na(hit.normal)).to_degrees() < 5.0);
        assert_eq!(hit.sigma_m, 0.0003);
    }
    for miss in &view.misses {
        let end = view.origin + miss.direction * miss.free_m;
        let depth = -(sensor.inverse() * Point::<World>::from(crate::tracker::to_na(end))).coords().z;
        assert!((depth - f64::from(GEL_M)).abs() < 1e-6, "an untouched gel is free up to its surface");
    }
}

#[test]
fn normals_of_fitted_planes_withstand_noise() {
    let truth = pose([0.0; 3], [0.0; 3]);
    let mut sensed = seen(0, Solid::Ball(RADIUS_M), truth);
    let mut state = 1u32;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32 - 0.5
    };
    // Half a millimetre at a pitch of 0.7 mm.
    let depth_m = &mut sensed.cameras[0].as_mut().unwrap().depth_m;
    depth_m.iter_mut().filter(|z| **z > 0.0).for_each(|z| *z += 0.0017 * noise());
    let view = &Scan::new(0, &sensed.measured(), &ScanConfig::default(), 1).views[0];
    let hits = view.hits.iter().filter(|hit| hit.normal != Vec3::ZERO && hit.cosine > 0.5);
    let off: Vec<f64> =
        hits.map(|hit| crate::tracker::to_na(hit.normal).angle(&in_solid(view.point(hit))).to_degrees()).collect();
    assert!(off.len() > 500, "{}", off.len());
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    // Differences of two depths have 9 degrees here.
    assert!(mean < 3.0, "{mean} degrees");
}

#[test]
fn rays_that_pass_near_are_kept_first() {
    let sensed = seen(0, BRICK, pose([0.0; 3], [20.0, 10.0, 35.0]));
    let mut image = sensed.cameras[0].clone().unwrap();
    // A wall behind everything, of which most is far from the brick.
    image.depth_m.iter_mut().filter(|z| **z <= 0.0).for_each(|z| *z = 0.9);
    let walled = frame(0.0, vec![Some(image)]);
    let near = |near_misses_px: usize| {
        let config = ScanConfig { near_misses_px, camera_misses: 300, ..ScanConfig::default() };
        let view = &Scan::new(0, &walled.measured(), &config, 1).views[0];
        let to_middle = (crate::tracker::to_vec(na::Vector3::from(PLACE_M)) - view.origin).normalize();
        view.misses.iter().filter(|miss| miss.direction.dot(to_middle) > 0.97).count()
    };
    assert!(near(20) == 300 && near(0) < 250, "{} {}", near(20), near(0));
}
