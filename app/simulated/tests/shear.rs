//! Shear that is seen in rendered images, against the formula of FOTS and against MuJoCo.

#![expect(clippy::unwrap_used, reason = "a failed assumption is a failed test")]

use mvt_frames::{Isometry, Object as ObjectFrame};
use mvt_gaits::gait;
use mvt_objects::catalogue;
use mvt_physics::episode::{Episode, EpisodeConfig, Randomisation};
use mvt_physics::shear::stiffness_n_per_m;
use mvt_render::rays::RayMesh;
use mvt_render::touch::{Background, GelPress, NoiseKey, TouchConfig, TouchFrame, TouchOptions, TouchRenderer};
use mvt_robot::digit::markers::GelShear;
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::{Hand, Side};
use mvt_shear::{ShearError, ShearField, ShearSensor};
use nalgebra as na;

struct Sensor {
    profile: SensorProfile,
    renderer: TouchRenderer,
    reader: ShearSensor,
    frame: TouchFrame,
}

impl Sensor {
    fn new(name: &str) -> Self {
        let profile = SensorProfile::load(name).unwrap();
        let options = TouchOptions {
            background: Background::Synthetic { seed: 5 },
            ..TouchOptions::of_profile(&profile, TouchConfig::Fork)
        };
        let renderer = TouchRenderer::new(&options).unwrap();
        let reader = ShearSensor::new(&profile, &renderer.empty()).unwrap();
        Self { profile, renderer, reader, frame: TouchFrame::default() }
    }

    fn feel(&mut self, object: &RayMesh, press: GelPress, frame: u32) -> Result<ShearField, ShearError> {
        let noise = NoiseKey { seed: 3, pad: 1, frame };
        self.renderer.render_dragged(object, press, Some(noise), &mut self.frame);
        let indentation_mm = self.profile.gel_view().indentation_of(self.frame.depth_m()).unwrap();
        self.reader.see(self.frame.calibrated(), self.frame.contact(), &indentation_mm)
    }
}

/// Less the motion of an undragged gel, which is dilation, the formula needs the middle of the contact alone, here that of a ball.
#[test]
fn seen_motion_is_that_of_fots_within_a_tenth() {
    let mut ball = catalogue::load("055_baseball", &mut Vec::new()).unwrap().mesh;
    let radius_m = 6e-3;
    let scale = radius_m / (0.5 * ball.extents_m().x);
    ball.vertices.iter_mut().for_each(|vertex| *vertex *= scale);
    let ball = RayMesh::new(&ball);
    for name in ["digit_markers", "gelsight_mini_markers"] {
        let mut sensor = Sensor::new(name);
        let gel = sensor.profile.gel_surface();
        // The ball dents the apex by 0.5 mm.
        let pose = Isometry::<ObjectFrame, _>::translation(0.022 - 0.0005 + f64::from(radius_m), 0.0, 0.0);
        let still = GelPress { gel_from_object: pose, shear: GelShear::default() };
        let at_rest = sensor.feel(&ball, still, 0).unwrap();
        let fit = at_rest.fit.unwrap();
        let [right, down] = fit.shear.displacement_mm;
        assert!(right.hypot(down) < 0.02 && fit.shear.twist_rad.abs() < 0.02 && fit.residual_mm < 0.05, "{fit:?}");

        let shear = GelShear { displacement_mm: [0.7, -0.4], twist_rad: 0.15 };
        let dragged = sensor.feel(&ball, GelPress { gel_from_object: pose, shear }, 1).unwrap();
        let fit = dragged.fit.unwrap();
        let [right, down] = fit.shear.displacement_mm;
        assert!((right - 0.7).hypot(down + 0.4) < 0.08, "{name}: {fit:?}");
        assert!((fit.shear.twist_rad - 0.15).abs() < 0.03, "{name}: {fit:?}");
        // Where dilation is small.
        let (mut square, mut missed) = (0.0, 0.0);
        for dot in &dragged.dots {
            let [x, y] = gel.place_mm(&sensor.profile.intrinsics(), dot.untouched_px);
            let g = |x: f64, y: f64, decay_px: f64| (-decay_px * 19.58 * 19.58 * (x * x + y * y)).exp();
            if x.hypot(y) < 4.0 {
                continue;
            }
            let shear = g(x + 0.7, y - 0.4, 0.000_21);
            let (sx, sy) = (x + 0.7 * shear, y - 0.4 * shear);
            let (turned, twist) = (g(sx, sy, 0.000_38), 0.15_f64);
            let expected = [
                sx + turned * (sx * twist.cos() - sy * twist.sin() - sx) - x,
                sy + turned * (sx * twist.sin() + sy * twist.cos() - sy) - y,
            ];
            square += expected[0].powi(2) + expected[1].powi(2);
            let Some(still) = at_rest.dots.iter().find(|still| still.untouched_px == dot.untouched_px) else {
                continue;
            };
            let moved = [0, 1].map(|axis| dot.moved_mm[axis] - still.moved_mm[axis]);
            missed += (moved[0] - expected[0]).powi(2) + (moved[1] - expected[1]).powi(2);
        }
        let share = (missed / square).sqrt();
        assert!(share < 0.1, "{name}: {share}");
    }
}

#[test]
fn an_image_without_the_dots_is_refused() {
    let mut sensor = Sensor::new("digit_markers");
    let plain = plain_digit();
    let untouched = Isometry::translation(1.0, 0.0, 0.0);
    let far = RayMesh::new(&catalogue::load("cube70", &mut Vec::new()).unwrap().mesh);
    let press = GelPress { gel_from_object: untouched, shear: GelShear::default() };
    assert_eq!(sensor.feel(&far, press, 0).unwrap().fit, None);
    let (contact, indentation_mm) = Default::default();
    let error = sensor.reader.see(&plain, &contact, &indentation_mm).unwrap_err();
    assert!(matches!(error, ShearError::Lost { found: 0..=10, expected: 72 }), "{error}");
    let error = ShearSensor::new(&sensor.profile, &plain).unwrap_err();
    assert!(error.to_string().contains("of the 72 dots"), "{error}");
}

/// Returns the untouched image of a DIGIT without dots.
fn plain_digit() -> image::RgbImage {
    let options = TouchOptions {
        background: Background::Synthetic { seed: 5 },
        ..TouchOptions::of_profile(&SensorProfile::load("digit").unwrap(), TouchConfig::Fork)
    };
    TouchRenderer::new(&options).unwrap().empty()
}

fn correlation(pairs: &[[f64; 2]]) -> f64 {
    let mean = |k: usize| pairs.iter().map(|pair| pair[k]).sum::<f64>() / pairs.len() as f64;
    let means = [mean(0), mean(1)];
    let moment =
        |i: usize, j: usize| -> f64 { pairs.iter().map(|pair| (pair[i] - means[i]) * (pair[j] - means[j])).sum() };
    moment(0, 1) / (moment(0, 0) * moment(1, 1)).sqrt()
}

/// A cube that the hand turns: the images show the shear that follows from MuJoCo's slip and friction.
#[test]
fn shear_in_the_hand_agrees_with_mujoco() {
    let object = catalogue::load("cube70", &mut Vec::new()).unwrap();
    let hand = Hand::allegro(Side::Left);
    let gait = gait::choose("auto", &object, &hand).unwrap().1.clone();
    let config =
        EpisodeConfig { hand: hand.clone(), gait, seed: 4, duration_s: 4.0, randomisation: Randomisation::default() };
    let mut episode = Episode::new(&object, &config).unwrap();
    let mut sensor = Sensor::new("digit_markers");
    let rays = RayMesh::new(&object.mesh);
    let (mut of_slip, mut of_force) = (Vec::new(), Vec::new());
    let mut number = 0;
    while let Some(state) = episode.next_frame() {
        number += 1;
        for (pad, world_from_gel) in hand.world_from_gels(&state.scene.joints).into_iter().enumerate() {
            let gel_from_object = world_from_gel.inverse() * state.scene.object_pose;
            let shear = state.scene.shear[pad];
            let field = sensor.feel(&rays, GelPress { gel_from_object, shear }, number).unwrap();
            // Contacts at the border show too little.
            let touching = sensor.frame.contact().iter().filter(|touches| **touches).count();
            let Some(fit) = field.fit.filter(|_| touching > 500) else { continue };
            let friction = world_from_gel.untyped().rotation.inverse() * na::Vector3::from(state.pads[pad].friction_n);
            for (axis, friction_n) in [-friction.y, -friction.z].into_iter().enumerate() {
                of_slip.push([fit.shear.displacement_mm[axis], shear.displacement_mm[axis]]);
                of_force.push([
                    1e-3 * stiffness_n_per_m(state.pads[pad].force_n) * fit.shear.displacement_mm[axis],
                    friction_n,
                ]);
            }
        }
    }
    assert!(of_slip.len() > 100, "{} touches", of_slip.len());
    let (slip, force) = (correlation(&of_slip), correlation(&of_force));
    assert!(slip > 0.9, "{slip}");
    // MuJoCo's friction turns at once, a soft gel after a millimetre.
    assert!(force > 0.5, "{force}");
    let off = of_slip.iter().map(|[seen, there]| (seen - there).powi(2)).sum::<f64>();
    assert!((off / of_slip.len() as f64).sqrt() < 0.08, "root mean square {} mm", (off / of_slip.len() as f64).sqrt());
}
