//! Behaviour of the touch renderer that TACTO's images do not show.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use glam::Vec3;
use image::RgbImage;
use mvt_frames::{Gel, Isometry, Object};
use mvt_mesh::Mesh;
use mvt_objects::catalogue;
use mvt_render::rays::RayMesh;
use mvt_render::touch::{
    Background, Lights, Membrane, NoiseKey, TouchConfig, TouchError, TouchFrame, TouchOptions, TouchRenderer,
    render_contact,
};
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::digit::{HEIGHT, WIDTH, gel, intrinsics};
use rand::SeedableRng;

/// A box of 12 triangles that do not share vertices, so that its faces are flat.
fn slab(half: Vec3) -> Mesh {
    let mut mesh = Mesh::default();
    for (axis, sign) in (0..3).flat_map(|axis| [(axis, -1.0), (axis, 1.0)]) {
        let mut right = Vec3::ZERO;
        let mut up = Vec3::ZERO;
        let mut out = Vec3::ZERO;
        (right[(axis + 1) % 3], up[(axis + 2) % 3], out[axis]) = (sign, 1.0, sign);
        let first = mesh.vertices.len() as u32;
        for (r, u) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
            mesh.vertices.push((out + right * r + up * u) * half);
        }
        mesh.faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    mesh
}

fn rotated(axis: nalgebra::Vector3<f64>, position: [f64; 3]) -> Isometry<Object, Gel> {
    Isometry::new(nalgebra::Isometry3::new(position.into(), axis))
}

fn renderer(options: &TouchOptions) -> TouchRenderer {
    TouchRenderer::new(options).unwrap()
}

fn rendered(options: &TouchOptions, mesh: &Mesh, pose: Isometry<Object, Gel>, noise: Option<NoiseKey>) -> TouchFrame {
    let mut frame = TouchFrame::default();
    renderer(options).render(&RayMesh::new(mesh), pose, noise, &mut frame);
    frame
}

/// A large tilted face reaches behind the camera; in view its depth is that of its plane.
#[test]
fn a_face_that_reaches_behind_the_camera_is_an_exact_plane() {
    let tilt = 0.5;
    let pose = rotated(nalgebra::Vector3::new(0.0, tilt, 0.0), [0.0315, 0.0, 0.0]);
    let mesh = slab(Vec3::new(0.01, 0.2, 0.2));
    let frame = rendered(&TouchOptions::new(TouchConfig::Fork), &mesh, pose, None);
    // The face towards the camera, x = -10 mm in the slab.
    let normal = nalgebra::Vector3::new(tilt.cos(), 0.0, -tilt.sin());
    let offset = 0.0315 * normal.x - 0.01;
    let mut touched = 0;
    for (v, u) in (0..HEIGHT).flat_map(|v| (0..WIDTH).map(move |u| (v, u))) {
        let point = SensorProfile::tacto().gel_surface().point(&intrinsics(), u as f64, v as f64).coords();
        let plane = offset / normal.dot(&(point / point.x));
        let expected = if plane > 0.0 { point.x.min(plane) } else { point.x };
        touched += usize::from(expected < point.x - 1e-4);
        let depth = f64::from(frame.depth_m()[(v, u)]);
        assert!((depth - expected).abs() < 1e-7, "({u}, {v}): {depth}, not {expected}");
        let pressed = frame.contact()[(v, u)];
        assert!(pressed == (point.x - expected > 1e-4) || (point.x - expected - 1e-4).abs() < 1e-7);
    }
    assert!(touched > 10_000, "only {touched} pixels touch");
}

#[test]
fn an_object_behind_the_gel_or_without_a_place_leaves_no_trace() {
    let options = TouchOptions::new(TouchConfig::Fork);
    let cube = slab(Vec3::splat(0.01));
    let away = Isometry::translation(0.0321, 0.0, 0.0);
    let nan = Isometry::translation(f64::NAN, 0.0, 0.0);
    let identity = Isometry::identity();
    for (mesh, pose) in [(&cube, away), (&cube, nan), (&Mesh::default(), identity), (&cube, identity)] {
        let frame = rendered(&options, mesh, pose, None);
        assert_eq!(*frame.depth_m(), renderer(&options).gel_depth_m());
        assert_eq!(frame.raw(), frame.calibrated(), "the empty gel over the empty gel");
        assert!(!frame.contact().iter().any(|&touches| touches));
    }
}

#[test]
fn a_reused_frame_holds_nothing_of_the_last_one() {
    let options = TouchOptions { membrane: Some(Membrane { reach_m: 2e-4 }), ..TouchOptions::new(TouchConfig::Tacto) };
    let (cube, key) = (slab(Vec3::splat(0.01)), NoiseKey { seed: 3, pad: 1, frame: 9 });
    let turned = |z| rotated(nalgebra::Vector3::new(0.4, 0.2, 0.1), [0.033, 0.001, z]);
    for options in [options.clone(), TouchOptions { membrane: None, ..options }] {
        let renderer = renderer(&options);
        let (object, mut frame) = (RayMesh::new(&cube), TouchFrame::default());
        for z in [0.0, 0.006, 1.0, -0.004] {
            renderer.render(&object, turned(z), Some(key), &mut frame);
            let fresh = rendered(&options, &cube, turned(z), Some(key));
            assert_eq!(frame.raw(), fresh.raw());
            assert_eq!(frame.calibrated(), fresh.calibrated());
            assert_eq!(frame.depth_m(), fresh.depth_m());
            assert_eq!(frame.contact(), fresh.contact());
        }
    }
}

#[test]
fn taken_images_are_those_of_the_frame_and_do_not_change_the_next_one() {
    let renderer = renderer(&TouchOptions::new(TouchConfig::Fork));
    let (object, mut frame) = (RayMesh::new(&slab(Vec3::splat(0.01))), TouchFrame::default());
    let render = |y, frame: &mut TouchFrame| {
        let key = NoiseKey { seed: 3, pad: 1, frame: 9 };
        renderer.render(&object, Isometry::translation(0.0315, y, 0.0), Some(key), frame);
    };
    for y in [0.0, 0.004] {
        let mut fresh = TouchFrame::default();
        render(y, &mut fresh);
        render(y, &mut frame);
        let (image, truth) = frame.take();
        assert_eq!((&image, &truth.depth_m, &truth.contact), (fresh.calibrated(), fresh.depth_m(), fresh.contact()));
        assert!(frame.calibrated().is_empty() && frame.depth_m().is_empty() && frame.contact().is_empty());
    }
}

/// TACTO truncates twice: the mean falls by half a grey level, and the spread is that of the Gaussian and of the
/// rounding.
#[test]
fn noise_has_tactos_bias_and_spread() {
    let pose = Isometry::translation(0.0315, 0.0, 0.0);
    let background = Background::Synthetic { seed: 5 };
    for config in TouchConfig::ALL {
        let options = TouchOptions { background: background.clone(), ..TouchOptions::new(config) };
        let clean = rendered(&options, &slab(Vec3::splat(0.01)), pose, None);
        let noisy = rendered(&options, &slab(Vec3::splat(0.01)), pose, Some(NoiseKey { seed: 1, pad: 2, frame: 3 }));
        assert_eq!(clean.raw(), noisy.raw());
        let pairs = clean.calibrated().as_raw().iter().zip(noisy.calibrated().as_raw());
        let differences: Vec<f64> =
            pairs.filter(|(c, _)| (35..220).contains(*c)).map(|(c, n)| f64::from(*n) - f64::from(*c)).collect();
        let count = differences.len() as f64;
        let mean = differences.iter().sum::<f64>() / count;
        let sigma = (differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / count).sqrt();
        let expected = (f64::from(config.noise_sigma()).powi(2) + 1.0 / 12.0).sqrt();
        assert!((mean + 0.5).abs() < 5.0 * expected / count.sqrt(), "{config:?}: mean {mean}");
        assert!((sigma / expected - 1.0).abs() < 0.01, "{config:?}: sigma {sigma}, not {expected}");
    }
}

#[test]
fn a_membrane_rounds_the_rim_alone() {
    let cube = slab(Vec3::splat(0.004));
    let pose = Isometry::translation(0.025, 0.0, 0.0);
    let stiff = rendered(&TouchOptions::new(TouchConfig::Fork), &cube, pose, None);
    let options = TouchOptions { membrane: Some(Membrane { reach_m: 2e-4 }), ..TouchOptions::new(TouchConfig::Fork) };
    let soft = rendered(&options, &cube, pose, None);
    let gel_depth = renderer(&options).gel_depth_m();
    let mut rounded = 0;
    for (i, ((&soft, &stiff), &gel)) in soft.depth_m().iter().zip(stiff.depth_m()).zip(&gel_depth).enumerate() {
        assert!(soft <= stiff + 1e-8, "pixel {i}: the gel is pushed back, never forward");
        rounded += usize::from(soft < gel - 1e-5 && stiff == gel);
    }
    assert!((100..5000).contains(&rounded), "{rounded} pixels beyond the rim give way");
    assert_eq!(soft.raw().get_pixel(0, 0), stiff.raw().get_pixel(0, 0));
    let steepest = |frame: &TouchFrame| {
        let row = frame.depth_m().row(HEIGHT / 2);
        row.windows(2).into_iter().map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f32::max)
    };
    assert!(steepest(&soft) < 0.5 * steepest(&stiff), "{} of {} m per pixel", steepest(&soft), steepest(&stiff));
}

#[test]
fn lights_move_with_the_generator_and_only_with_it() {
    let draw = |strength, seed| {
        Lights::perturbed(TouchConfig::Fork, strength, &mut rand_chacha::ChaCha8Rng::seed_from_u64(seed))
    };
    assert_eq!(draw(0.0, 1), Lights::of(TouchConfig::Fork));
    assert_eq!(draw(1.0, 1), draw(1.0, 1));
    assert_ne!(draw(1.0, 1), draw(1.0, 2));
    let empty = |lights| {
        rendered(
            &TouchOptions { lights, ..TouchOptions::new(TouchConfig::Fork) },
            &Mesh::default(),
            Isometry::identity(),
            None,
        )
    };
    let difference = |a: &TouchFrame, b: &TouchFrame| {
        let pairs = a.raw().as_raw().iter().zip(b.raw().as_raw());
        pairs.map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / (3 * WIDTH * HEIGHT) as f64
    };
    let shift = difference(&empty(draw(1.0, 1)), &empty(Lights::of(TouchConfig::Fork)));
    assert!((1.0..60.0).contains(&shift), "mean change of {shift} grey");
}

#[test]
fn options_out_of_range_are_refused() {
    let options = TouchOptions::new(TouchConfig::Fork);
    let refused = |options: TouchOptions| TouchRenderer::new(&options).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(refused(TouchOptions { noise_sigma: f32::NAN, ..options.clone() }).contains("sigma is NaN"));
    assert!(refused(TouchOptions { noise_sigma: 29.0, ..options.clone() }).contains("between 0 and 28"));
    assert!(refused(TouchOptions { contact_threshold_m: -1.0, ..options.clone() }).contains("threshold"));
    assert!(refused(TouchOptions { membrane: Some(Membrane { reach_m: 1.0 }), ..options.clone() }).contains("reach"));
    let background = Background::Image(image::RgbImage::new(320, 240));
    assert!(refused(TouchOptions { background, ..options }).contains("320 x 240"));
    assert_eq!("gelsight".parse::<TouchConfig>(), Err(TouchError::UnknownConfig("gelsight".to_owned())));
    assert_eq!("tacto".parse(), Ok(TouchConfig::Tacto));
    let mirror = [[-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    let error = render_contact(&Mesh::default(), &mirror, TouchConfig::Fork, Background::Rendered).unwrap_err();
    assert!(error.to_string().contains("not a rotation"), "{error}");
}

/// A ball of 6 mm in the profile of a real DIGIT has what images of real ones show: the gel gives way beyond the contact, each colour changes
/// along its own direction, and as strongly.
#[test]
fn a_ball_on_a_real_sensor_shows_flank_direction_and_gain() {
    let [digit, mini] = ["digit", "gelsight_mini"].map(|name| check_ball(&SensorProfile::load(name).unwrap()));
    // Dark sides of a DIGIT fall into shadow, bright sides do not. The LEDs of a GelSight Mini stand higher.
    let [(darkest, brightest), (darker, _)] = [digit, mini].map(|(low, high)| (95 - low, high - 95));
    assert!(darkest < brightest && darkest < darker, "{darkest}, {brightest} and {darker}");
}

/// Checks flank, directions and gains, and returns the least and the greatest level on an even background of 95.
fn check_ball(profile: &SensorProfile) -> (u8, u8) {
    let appearance = profile.appearance.unwrap();
    let background = RgbImage::from_pixel(WIDTH as u32, HEIGHT as u32, image::Rgb([95; 3]));
    let options = TouchOptions {
        background: Background::Image(background),
        ..TouchOptions::of_profile(profile, TouchConfig::Fork)
    };
    let mut ball = catalogue::find("ball").unwrap().mesh_without_download().unwrap();
    let radius_m = 0.003;
    let scale = 2.0 * radius_m / ball.extents_m().max_element();
    ball.vertices.iter_mut().for_each(|vertex| *vertex *= scale);
    let pose = Isometry::translation(gel::APEX_M + f64::from(radius_m) - 5e-4, 0.0, 0.0);
    let frame = rendered(&options, &ball, pose, None);
    let indentation_mm = 1e3 * (renderer(&options).gel_depth_m() - frame.depth_m());

    let pitch_mm = 1e3 * gel::APEX_M / options.camera.fx;
    let at = |mm: f64| f64::from(indentation_mm[(HEIGHT / 2, WIDTH / 2 + (mm / pitch_mm).round() as usize)]);
    let contact_px = frame.contact().iter().filter(|&&touches| touches).count() as f64;
    let contact_mm = (contact_px / std::f64::consts::PI).sqrt() * pitch_mm;
    // The flank is about a / R times the fade length high, and fades over it.
    let (reach_mm, rim) = (f64::from(profile.reach_mm), at(contact_mm));
    assert!((0.6..1.4).contains(&contact_mm), "{contact_mm} mm");
    let fade = at(contact_mm + reach_mm) / rim;
    assert!((0.2..0.45).contains(&fade), "{fade} of {rim} mm is left after {reach_mm} mm");

    // Least squares of each colour's change over the slopes to the right and down, where no LED is shadowed.
    for c in 0..3 {
        let (mut normal, mut right) = (nalgebra::Matrix2::<f64>::zeros(), nalgebra::Vector2::zeros());
        for (v, u) in (20..HEIGHT - 20).flat_map(|v| (20..WIDTH - 20).map(move |u| (v, u))) {
            let at = |v: usize, u: usize| f64::from(indentation_mm[(v, u)]);
            // Over the width of the blur.
            let slope =
                nalgebra::Vector2::new(at(v, u + 2) - at(v, u - 2), at(v + 2, u) - at(v - 2, u)) / (4.0 * pitch_mm);
            if (0.03..0.15).contains(&slope.norm()) {
                let change = f64::from(frame.calibrated().get_pixel(u as u32, v as u32).0[c]) - 95.0;
                normal += slope * slope.transpose();
                right += slope * change;
            }
        }
        // The gel's surface faces the LED where the indentation falls towards it.
        let towards = -(normal.lu().solve(&right).unwrap());
        let turned =
            (towards.y.atan2(towards.x).to_degrees() - appearance.led_angles_deg[c] + 540.0).rem_euclid(360.0) - 180.0;
        assert!(turned.abs() < 20.0, "colour {c}: {turned} degrees beside its LED");
        let gain = towards.norm() / f64::from(appearance.sensitivity[c]);
        assert!((0.7..1.3).contains(&gain), "colour {c}: {gain} of its sensitivity");
    }
    frame.calibrated().iter().fold((95, 95), |(low, high), &x| (x.min(low), x.max(high)))
}

/// A press on a flat gel looks the same at each place, and light of each LED comes from its side. On a DIGIT's gel the same ball beside the middle
/// is in a deeper place.
#[test]
fn a_flat_gel_is_the_same_everywhere() {
    let mut ball = catalogue::find("ball").unwrap().mesh_without_download().unwrap();
    let scale = 0.006 / ball.extents_m().max_element();
    ball.vertices.iter_mut().for_each(|vertex| *vertex *= scale);
    let press = |name: &str, side_m: f64| {
        let profile = SensorProfile::load(name).unwrap();
        let background = RgbImage::from_pixel(WIDTH as u32, HEIGHT as u32, image::Rgb([95; 3]));
        let options = TouchOptions {
            background: Background::Image(background),
            ..TouchOptions::of_profile(&profile, TouchConfig::Fork)
        };
        let pose = Isometry::translation(gel::APEX_M + 0.0025, side_m, 0.0);
        let frame = rendered(&options, &ball, pose, None);
        let gel_m = renderer(&options).gel_depth_m();
        let deepest_mm = 1e3 * (&gel_m - frame.depth_m()).fold(0.0_f32, |a, &b| a.max(b));
        (frame, deepest_mm)
    };
    let (middle, deepest_mm) = press("gelsight_mini", 0.0);
    let (_, beside_mm) = press("gelsight_mini", 0.004);
    assert!((deepest_mm - 0.5).abs() < 0.01 && (beside_mm - 0.5).abs() < 0.02, "{deepest_mm} and {beside_mm} mm");
    let (_, on_digit_mm) = press("digit", 0.004);
    assert!(on_digit_mm < 0.35, "{on_digit_mm} mm");
    // Red comes from the right, green from below, blue from the left.
    let change = |du: i32, dv: i32| {
        let pixel = middle.calibrated().get_pixel((WIDTH as i32 / 2 + du) as u32, (HEIGHT as i32 / 2 + dv) as u32);
        pixel.0.map(|level| i32::from(level) - 95)
    };
    let r = 16;
    for (c, (du, dv)) in [(r, 0), (0, r), (-r, 0)].into_iter().enumerate() {
        let (lit, dark) = (change(du, dv)[c], change(-du, -dv)[c]);
        assert!(lit > 12 && dark < -10, "colour {c}: {lit} towards its LED and {dark} away from it");
    }
}
