use std::collections::BTreeMap;
use std::path::Path;

use image::Rgb;

use super::*;
use crate::network::{Architecture, Provenance, Pyramid, WeightTensor, Weights};
use crate::untouched::EVEN;
use mvt_products::Instructions;
use mvt_robot::digit;
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::Side;

/// A network that sees `2 relu(r)` millimetres and a logit of `40 relu(r) - 10` where the level r of red, from -1 to 1, is at the even
/// row and column of a square of four pixels.
fn engine() -> Engine {
    let pyramid = Pyramid { widths: [1, 1, 1, 1], depth: 0, ..Pyramid::default() };
    let architecture = Architecture::Default(pyramid);
    let tensors = architecture.tensors().into_iter().map(|(name, shape)| {
        let mut values = vec![0.0; shape.iter().product()];
        match name.as_str() {
            // Red, in the middle of the window.
            "stem.weight" => values[4] = 1.0,
            "head.weight" => (0..8).for_each(|out| values[9 * out + 4] = if out % 2 == 0 { 2.0 } else { 40.0 }),
            "head.bias" => (0..8).filter(|out| out % 2 == 1).for_each(|out| values[out] = -10.0),
            _ => {}
        }
        (name, WeightTensor { shape, values })
    });
    let tensors: BTreeMap<_, _> = tensors.collect();
    Engine::new(
        &Weights::new(architecture, Provenance::default(), tensors, Path::new("test")).unwrap(),
        Instructions::best(),
    )
}

/// Colours of the usual light that vary over the gel, with a red square of this level and side in the middle.
fn picture(level: u8, side: u32) -> RgbImage {
    RgbImage::from_fn(digit::WIDTH as u32, digit::HEIGHT as u32, |u, v| {
        let is_red = u.abs_diff(120) < side / 2 && v.abs_diff(160) < side / 2;
        Rgb([if is_red { level } else { 100 }, 70 + (u / 4) as u8, 135 - (v / 4) as u8])
    })
}

/// The pad that the tests press.
const MIDDLE: usize = 1;

fn four(config: ContactConfig) -> Feeler {
    let (hand, engine) = (Hand::allegro(Side::Left), Arc::new(engine()));
    Feeler::new(&hand, hand.per_pad(|_| Arc::clone(&engine)), config)
}

/// The contact on the middle pad.
fn feel(feeler: &mut Feeler, image: &RgbImage) -> (f32, bool, Option<Press>) {
    let felt = feeler.feel(&[&RgbImage::default(), image]).unwrap();
    assert_eq!(felt.len(), 4);
    assert!(felt[0].is_none() && felt[2].is_none(), "a pad without an image feels");
    let Felt { press, plausibility, asked, .. } = felt[MIDDLE].clone().unwrap();
    (plausibility, asked, press)
}

#[test]
fn a_contact_is_felt_where_it_is() {
    let mut feeler = four(ContactConfig::default());
    let (plausibility, asked, felt) = feel(&mut feeler, &picture(191, 60));
    assert!(asked && plausibility > 0.9, "{plausibility}");
    let Press { indentation_mm, contact, sigma_mm } = felt.unwrap();
    // 191 is level 0.498.
    assert!((indentation_mm[[160, 120]] - 0.996).abs() < 5e-3);
    assert!(indentation_mm[[20, 20]].abs() < 1e-4);
    assert_eq!((contact[[160, 120]], contact[[20, 20]]), (true, false));
    assert!((sigma_mm - 0.05).abs() < 1e-6);
}

#[test]
fn what_the_untouched_sensor_shows_is_taken_off() {
    let mut felt = Vec::new();
    // Sensors with a more or less reddish spot.
    for level in [100, 150] {
        let mut feeler = four(ContactConfig::default());
        feeler.set_untouched(MIDDLE, &picture(level, 60)).unwrap();
        let (_, asked, untouched) = feel(&mut feeler, &picture(level, 60));
        let Press { indentation_mm, contact, .. } = untouched.unwrap();
        assert!(!asked, "the network was asked about an untouched sensor");
        assert!(!contact.iter().any(|&touches| touches));
        assert_eq!(indentation_mm[[160, 120]], 0.0);
        let (_, asked, touched) = feel(&mut feeler, &picture(level + 100, 60));
        assert!(asked);
        felt.push(touched.unwrap());
    }
    let indentation_mm = felt[0].indentation_mm[[160, 120]];
    let seen = f32::from(EVEN) + 100.0;
    assert!((indentation_mm - (seen - 127.5) / 127.5 * 2.0).abs() < 0.01, "{indentation_mm}");
    assert!(felt[0] == felt[1], "the contact depends on the sensor");
}

#[test]
fn the_last_image_without_contact_is_the_untouched_sensor() {
    let mut feeler = four(ContactConfig::default());
    assert!(feel(&mut feeler, &picture(100, 60)).1);
    assert!(!feel(&mut feeler, &picture(100, 60)).1, "an image that was seen without contact is looked at again");
    assert!(feel(&mut feeler, &picture(191, 60)).1);
    assert!(!feel(&mut feeler, &picture(100, 60)).1, "a touch has replaced the untouched sensor");
}

#[test]
fn contact_holds_on_and_lets_go() {
    let fading = ContactConfig { threshold_mm: 0.5, ..ContactConfig::default() };
    // Indentations of 0.56, 0.48 and 0.32 mm about the threshold of 0.5 mm and, once in contact, 0.35 mm; the probabilities are 0.76,
    // 0.39 and 0.03 about 0.5 and 0.35.
    let levels = [163, 158, 148].map(|level| picture(level, 60));
    let touches = |feeler: &mut Feeler, image: &RgbImage| feel(feeler, image).2.unwrap().contact[[160, 120]];
    let mut feeler = four(fading);
    assert_eq!([0, 1, 2, 1].map(|k| touches(&mut feeler, &levels[k])), [true, true, false, false]);
    let mut feeler = four(ContactConfig { hysteresis: 1.0, ..fading });
    assert_eq!([0, 1].map(|k| touches(&mut feeler, &levels[k])), [true, false]);
}

#[test]
fn specks_are_no_contact() {
    let feel_speck = |least_area| {
        let mut feeler = four(ContactConfig { least_area, ..ContactConfig::default() });
        feel(&mut feeler, &picture(191, 8)).2.unwrap().contact.iter().any(|&touches| touches)
    };
    assert_eq!([0.002, 0.0].map(feel_speck), [false, true]);
}

/// Nothing is made of images that no DIGIT takes.
#[test]
fn implausible_images_are_told_and_not_used() {
    let (width, height) = (digit::WIDTH as u32, digit::HEIGHT as u32);
    let noise =
        |u: u32, v: u32, c: u32| (u.wrapping_mul(2_654_435_761) ^ v.wrapping_mul(40_503) ^ c.wrapping_mul(977)) >> 7;
    for (image, what) in [
        (RgbImage::new(width, height), "black"),
        (RgbImage::from_pixel(width, height, Rgb([255; 3])), "saturated"),
        (RgbImage::from_pixel(width, height, Rgb([128; 3])), "flat"),
        (RgbImage::from_fn(width, height, |u, v| Rgb([0, 1, 2].map(|c| noise(u, v, c) as u8))), "noise"),
        (RgbImage::from_fn(width, height, |u, v| Rgb([(u + v) as u8 / 3, 40, u as u8])), "another sensor's"),
    ] {
        let mut feeler = four(ContactConfig::default());
        feeler.set_untouched(MIDDLE, &picture(100, 60)).unwrap();
        let (plausibility, asked, felt) = feel(&mut feeler, &image);
        assert!(plausibility < 0.5 && felt.is_none() && !asked, "{what}: {plausibility}");
        let (plausibility, _, felt) = feel(&mut feeler, &picture(191, 60));
        assert!(plausibility > 0.9 && felt.is_some(), "after a {what} image the sensor is not used any more");
    }
}

#[test]
fn answers_that_contradict_each_other_are_not_plausible() {
    let config = ContactConfig::default();
    let indentation_mm = Array2::from_shape_fn((64, 64), |(v, _)| if v < 32 { 1.0 } else { 0.0 });
    let mut contact = Array2::from_elem((64, 64), false);
    let agreement = |logits: &Array2<f32>, contact: &mut Array2<bool>| {
        decide(&config, 0.08, logits, &indentation_mm, contact).agreement
    };
    let same = indentation_mm.mapv(|mm| if mm > 0.5 { 5.0 } else { -5.0 });
    assert_eq!(agreement(&same, &mut contact), 1.0);
    assert_eq!(agreement(&-same, &mut contact), 0.0);
}

/// An image by itself is the next image of a sensor that has seen only its untouched image.
#[test]
fn independent_images_do_not_change_one_another() {
    let (engine, config) = (engine(), ContactConfig::default());
    let mut sensor = TouchSensor::new(&engine, &SensorProfile::tacto());
    sensor.set_untouched(&engine, &picture(100, 60)).unwrap();
    let images = [picture(191, 60), picture(163, 40), picture(100, 60)];
    let each = sensor.feel_each(&engine, &config, &images).unwrap();
    for (felt, image) in each.iter().zip(&images) {
        assert_eq!(*felt, sensor.clone().feel(&engine, &config, image).unwrap());
    }
    assert!(sensor.feel_each(&engine, &config, &[RgbImage::new(3, 2)]).unwrap_err().to_string().contains("3 x 2"));
}

#[test]
fn images_of_another_size_are_refused() {
    let mut feeler = four(ContactConfig::default());
    let error =
        feeler.feel(&[&RgbImage::new(0, 0), &RgbImage::new(320, 240), &RgbImage::new(7, 7)]).unwrap_err().to_string();
    assert!(error.contains("middle") && error.contains("320 x 240") && error.contains("240 x 320"), "{error}");
}

/// The pads of a hand may have different sensors.
#[test]
fn each_sensor_has_its_own_size() {
    let mut description = Hand::allegro(Side::Left).description().clone();
    description.pads[MIDDLE].profile = SensorProfile { size_px: [128, 100], ..SensorProfile::tacto() };
    let (hand, engine) = (Hand::new(description).unwrap(), Arc::new(engine()));
    let mut feeler = Feeler::new(&hand, hand.per_pad(|_| Arc::clone(&engine)), ContactConfig::default());
    let small = image::imageops::crop_imm(&picture(191, 60), 50, 110, 128, 100).to_image();
    let felt = feeler.feel(&[&picture(191, 60), &small]).unwrap();
    let press = |pad: usize| felt[pad].as_ref().and_then(|felt| felt.press.as_ref()).unwrap();
    assert_eq!([press(0), press(1)].map(|press| press.contact.dim()), [(320, 240), (100, 128)]);
    assert!(press(0).contact[[160, 120]] && press(1).contact[[50, 70]] && !press(1).contact[[5, 5]]);
    let error = feeler.set_untouched(MIDDLE, &picture(100, 60)).unwrap_err().to_string();
    assert!(error.contains("middle") && error.contains("240 x 320") && error.contains("128 x 100"), "{error}");
}

/// On a gel that bends, what is pressed in beyond the contact is none; a light press has contact all the same.
#[test]
fn the_flank_of_a_gel_is_no_contact() {
    let profile = SensorProfile { flank_mm: 0.2, ..SensorProfile::tacto() };
    let engine = engine();
    let touching = |profile: &SensorProfile, middle: u8| {
        // A press of some depth within a ring that is pressed in by 0.18 mm.
        let image = RgbImage::from_fn(digit::WIDTH as u32, digit::HEIGHT as u32, |u, v| {
            let away = u.abs_diff(120).max(v.abs_diff(160));
            let level = [middle, 139, 100][(away / 20).min(2) as usize];
            Rgb([level, 70 + (u / 4) as u8, 135 - (v / 4) as u8])
        });
        let config = ContactConfig { probability: 0.001, ..ContactConfig::default() };
        let press = TouchSensor::new(&engine, profile).feel(&engine, &config, &image).unwrap().press.unwrap();
        [press.contact[[160, 120]], press.contact[[160, 150]]]
    };
    assert_eq!(touching(&SensorProfile::tacto(), 191), [true, true]);
    assert_eq!(touching(&profile, 191), [true, false]);
    assert_eq!(touching(&profile, 139), [true, true]);
}

#[test]
fn settings_without_sense_are_named() {
    ContactConfig::default().validate().unwrap();
    let probability = ContactConfig { probability: 1.5, ..ContactConfig::default() };
    assert!(probability.validate().unwrap_err().to_string().starts_with("probability must be from"));
    let sigma = ContactConfig { sigma_mm: f32::NAN, ..ContactConfig::default() };
    assert!(sigma.validate().unwrap_err().to_string().starts_with("sigma_mm"));
}
