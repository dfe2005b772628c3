//! The measurements of one instant: checked, then labelled.

use mvt_frames::camera::PosedCamera;
use mvt_frames::depth::{CameraDepth, GivenLabels};
use mvt_frames::{Point, World};
use mvt_robot::hand::Hand;
use mvt_robot::hand::solid::HandSolid;
use mvt_robot::observation::{Observation, SensorError, SensorName, check_size};
use mvt_segmentation::{LabelSource, SegmentationConfig, segment};
use ndarray::Array2;

/// Checks the numbers of an observation and the sizes of its camera images.
///
/// # Errors
/// [`SensorError`] if a depth image or its labels have another size than their camera's, if labels are to be given and are not, if there are more
/// images than cameras, if the number of joint angles
/// or touch images is not that of the hand, or if the time or a joint angle is not finite.
pub(crate) fn check(
    observation: &Observation,
    hand: &Hand,
    cameras: &[PosedCamera],
    labels: LabelSource,
) -> Result<(), SensorError> {
    if !observation.time_s.is_finite() {
        return Err(SensorError::NotFinite("the time of the observation"));
    }
    check_count(hand, "joint angles", hand.joints().len(), observation.joints.len())?;
    check_per_pad(hand, "touch images", &observation.touch)?;
    if observation.joints.iter().any(|angle| !angle.is_finite()) {
        return Err(SensorError::NotFinite("a joint angle"));
    }
    let (expected, found) = (cameras.len(), observation.cameras.len());
    if found > expected {
        return Err(SensorError::Cameras { expected, found });
    }
    let images = observation.cameras.iter().zip(cameras).filter(|(rgbd, _)| !rgbd.depth_m.is_empty());
    for (rgbd, camera) in images {
        let expected = [camera.intrinsics.width, camera.intrinsics.height];
        let found = [rgbd.depth_m.ncols(), rgbd.depth_m.nrows()];
        let name = || SensorName::Camera(camera.name.clone());
        check_size(name, "depth", expected, found)?;
        match (&rgbd.labels, labels) {
            (Some(given), _) => check_size(name, "label", expected, given.size())?,
            (None, LabelSource::Given) => return Err(SensorError::NoLabels(name())),
            (None, LabelSource::Geometry) => {}
        }
    }
    Ok(())
}

/// Compares the number of values per pad with that of the hand; no values are those of sensors that delivered nothing.
///
/// # Errors
/// [`SensorError::Hand`] if they differ.
pub(crate) fn check_per_pad<T>(hand: &Hand, what: &'static str, values: &[T]) -> Result<(), SensorError> {
    if values.is_empty() { Ok(()) } else { check_count(hand, what, hand.pads().len(), values.len()) }
}

fn check_count(hand: &Hand, what: &'static str, expected: usize, found: usize) -> Result<(), SensorError> {
    if expected == found {
        return Ok(());
    }
    Err(SensorError::Hand { what, hand: hand.name().to_owned(), expected, found })
}

/// Labels the pixels of each camera. `depths_m` and `given` labels are in the order of `cameras`; a depth is `None` from a camera that delivered
/// nothing, as from cameras without an entry. `grasp` is where the hand holds objects. Depths that are negative, infinite or NaN count as not measured.
pub(crate) fn labelled(
    depths_m: Vec<Option<Array2<f32>>>,
    given: &[Option<GivenLabels>],
    cameras: &[PosedCamera],
    hand: &HandSolid,
    grasp: Option<Point<World>>,
    config: &SegmentationConfig,
) -> Vec<Option<CameraDepth>> {
    let mut depths_m = depths_m.into_iter();
    let label = |(k, camera): (usize, &PosedCamera)| {
        let PosedCamera { intrinsics, pose, .. } = camera;
        let mut depth_m = depths_m.next().flatten()?;
        depth_m.mapv_inplace(|depth| if depth.is_finite() && depth >= 0.0 { depth } else { 0.0 });
        let labels = match given.get(k).and_then(Option::as_ref) {
            Some(given) => mvt_segmentation::labelled(&depth_m, given, intrinsics, *pose, hand, config),
            None => segment(&depth_m, intrinsics, *pose, hand, grasp, config),
        };
        Some(CameraDepth { intrinsics: *intrinsics, world_from_camera: *pose, depth_m, labels, colour: None })
    };
    cameras.iter().enumerate().map(label).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use image::RgbImage;
    use mvt_frames::depth::Label;
    use mvt_robot::digit::profile::SensorProfile;
    use mvt_robot::hand::{HandDescription, JointAngles, PerPad, Side};
    use mvt_robot::observation::{Percept, Press, Rgbd};
    use mvt_robot::rig::PLACEMENTS;
    use mvt_touch::network::Weights;

    use super::*;
    use crate::{Perception, PerceptionConfig, PerceptionError, PerceptionSetup};

    fn hand() -> Arc<Hand> {
        Hand::allegro(Side::Left)
    }

    fn cameras(hand: &Hand) -> Vec<PosedCamera> {
        PLACEMENTS[2..].iter().map(|p| p.camera(hand)).collect()
    }

    /// Perception that takes joints and cameras as given.
    fn perception(hand: &Arc<Hand>) -> Perception {
        let mut config = PerceptionConfig::default();
        config.calibration.refine = false;
        let setup = PerceptionSetup { weights: None, config };
        Perception::new(Arc::clone(hand), cameras(hand), &setup)
    }

    fn press() -> Press {
        Press {
            indentation_mm: Array2::zeros((320, 240)),
            contact: Array2::from_elem((320, 240), false),
            sigma_mm: 0.05,
        }
    }

    fn observation(depths_m: Vec<Array2<f32>>, joints: JointAngles) -> Observation {
        let cameras = depths_m
            .into_iter()
            .map(|depth_m| Rgbd { color: Default::default(), depth_m, labels: None, world_from_camera: None })
            .collect();
        Observation { time_s: 1.5, joints, touch: PerPad::default(), cameras }
    }

    fn made(depths_m: Vec<Array2<f32>>, joints: JointAngles) -> Result<Percept, PerceptionError> {
        let touch = hand().per_pad(|pad| (pad == 3).then(press));
        Ok(perception(&hand()).see(0, observation(depths_m, joints), Some(touch))?.percept)
    }

    #[test]
    fn whole_percept() {
        let percept = made(vec![Array2::from_elem((480, 640), 0.3); 2], vec![0.1; 16]).unwrap();
        assert_eq!((percept.time_s, percept.joints), (1.5, vec![0.1; 16]));
        let top = percept.cameras[0].as_ref().unwrap();
        assert_eq!(top.labels[[240, 320]], Label::Object);
        assert_eq!(top.world_from_camera, cameras(&hand())[0].pose);
        assert!(percept.touch[3].is_some() && percept.touch[2].is_none());
    }

    #[test]
    fn a_silent_camera_is_none() {
        let percept = made(vec![Array2::zeros((0, 0))], vec![0.1; 16]).unwrap();
        assert_eq!(percept.cameras, [None, None]);
    }

    #[test]
    fn invalid_depth_is_not_measured() {
        let mut depth = Array2::from_elem((480, 640), 0.3);
        (depth[[0, 0]], depth[[240, 320]], depth[[7, 5]]) = (f32::NAN, f32::INFINITY, -0.3);
        let percept = made(vec![depth], vec![0.1; 16]).unwrap();
        let camera = percept.cameras[0].as_ref().unwrap();
        assert_eq!([(0, 0), (240, 320), (7, 5)].map(|at| camera.depth_m[at]), [0.0; 3]);
        assert_ne!(camera.labels[[240, 320]], Label::Object);
    }

    #[test]
    fn wrong_sizes_name_the_sensor() {
        let message = |depths_m, joints| made(depths_m, joints).unwrap_err().to_string();
        let good = || Array2::zeros((480, 640));
        let text = message(vec![good(), Array2::zeros((640, 480))], vec![0.1; 16]);
        assert!(text.starts_with("camera side: its depth image is 480 x 640 pixels; 640 x 480 expected"), "{text}");
        assert!(message(vec![good(), good(), good()], vec![0.1; 16]).contains("3 cameras"));
        let mut joints = vec![0.1; 16];
        joints[3] = f64::NAN;
        assert!(message(Vec::new(), joints).contains("joint angle"));
    }

    /// An Allegro of which `change` leaves a part.
    fn changed(change: fn(&mut HandDescription)) -> Arc<Hand> {
        let mut description = hand().description().clone();
        change(&mut description);
        Hand::new(description).unwrap()
    }

    fn two_pads() -> Arc<Hand> {
        changed(|of| {
            of.bodies.truncate(11);
            of.joints.truncate(8);
            of.pads.truncate(2);
            of.apart.clear();
        })
    }

    #[test]
    fn a_hand_may_have_two_pads() {
        let hand = two_pads();
        let weights = Arc::new(Weights::shipped().unwrap());
        let weights = hand.per_pad(|_| Arc::clone(&weights));
        let setup = PerceptionSetup { weights: Some(&weights), config: PerceptionConfig::default() };
        let mut perception = Perception::new(Arc::clone(&hand), Vec::new(), &setup);
        let black = || RgbImage::new(240, 320);
        let touch = PerPad(vec![RgbImage::default(), black()]);
        let seen = perception.see(7, Observation { touch, ..observation(Vec::new(), vec![0.1; 8]) }, None).unwrap();
        assert_eq!((seen.percept.touch.0, seen.touch_images.len()), (vec![None, None], 2));
        let names_it = |text: &String| text.contains("touch sensor middle");
        assert!(seen.warnings.len() == 2 && seen.warnings.iter().all(names_it), "{:?}", seen.warnings);
        let later = |time_s| Observation { time_s, ..observation(Vec::new(), vec![0.1; 8]) };
        let seen = perception.see(8, later(2.0), None).unwrap();
        assert_eq!(seen.percept.touch.0, [None, None]);
        let given = PerPad(vec![Some(press()), None]);
        let seen = perception.see(9, later(3.0), Some(given.clone())).unwrap();
        assert_eq!(seen.percept.touch, given);
        // There is no pad 2.
        perception.set_untouched(2, &black()).unwrap();
        perception.learn_untouched(2, &[black()]).unwrap();
    }

    /// A network for real sensors takes their raw images for presses.
    #[test]
    fn real_sensors_are_read_once_their_untouched_image_is_known() {
        let hand = two_pads().with_profile(&SensorProfile::load("digit").unwrap());
        let weights = Arc::new(Weights::shipped_digit().unwrap());
        let weights = hand.per_pad(|_| Arc::clone(&weights));
        let setup = PerceptionSetup { weights: Some(&weights), config: PerceptionConfig::default() };
        let mut perception = Perception::new(Arc::clone(&hand), Vec::new(), &setup);
        // Light falls from the left.
        let lit = |u: u32, _: u32| {
            image::Rgb([97.0, 101.0, 95.0].map(|mean: f64| (mean * (1.55 - f64::from(u) / 217.0)) as u8))
        };
        let mut warnings = Vec::new();
        let mut felt = Vec::new();
        for frame in 0..12 {
            let touch = PerPad(vec![RgbImage::from_fn(240, 320, lit), RgbImage::default()]);
            let time_s = frame as f64 / 30.0;
            let observed = Observation { time_s, touch, ..observation(Vec::new(), vec![0.1; 8]) };
            let seen = perception.see(frame, observed, None).unwrap();
            warnings.extend(seen.warnings);
            felt.push(seen.percept.touch[0].clone());
        }
        assert!(felt[..9].iter().all(Option::is_none) && felt[9..].iter().all(Option::is_some), "{felt:?}");
        assert!(felt[9..].iter().flatten().all(|press| !press.contact.iter().any(|touches| *touches)));
        let estimated = warnings.iter().filter(|warning| warning.contains("estimated from the first 10 images"));
        assert_eq!(estimated.count(), 1, "{warnings:?}");
    }

    #[test]
    fn observations_of_another_hand_are_refused() {
        let see = |joints, images, presses| {
            let touch = PerPad::from_fn(images, |_| RgbImage::default());
            let observation = Observation { touch, ..observation(Vec::new(), vec![0.1; joints]) };
            let presses = PerPad::from_fn(presses, |_| None);
            perception(&two_pads()).see(0, observation, Some(presses))
        };
        assert!(see(8, 2, 2).is_ok() && see(8, 0, 0).is_ok());
        let message = |joints, images, presses| see(joints, images, presses).unwrap_err().to_string();
        let text = message(16, 2, 2);
        assert!(text.contains("has 16 joint angles; hand allegro_digit has 8"), "{text}");
        assert!(message(8, 4, 2).contains("has 4 touch images; hand allegro_digit has 2"));
        assert!(message(8, 2, 1).contains("has 1 presses; hand allegro_digit has 2"));
    }

    #[test]
    fn a_hand_may_have_no_joints() {
        let hand = changed(|of| of.joints.clear());
        let depth_m = Array2::from_elem((480, 640), 0.35);
        let percept = perception(&hand).see(0, observation(vec![depth_m], Vec::new()), None).unwrap().percept;
        assert_eq!((percept.joints.len(), percept.touch.len()), (0, 4));
        let labels = &percept.cameras[0].as_ref().unwrap().labels;
        assert!([Label::Object, Label::Hand, Label::Background].iter().all(|label| labels.iter().any(|l| l == label)));
    }

    #[test]
    fn labels_that_are_given_are_used() {
        let mut config = PerceptionConfig::default();
        (config.calibration.refine, config.segmentation.labels) = (false, LabelSource::Given);
        let setup = PerceptionSetup { weights: None, config };
        let see = |labels, setup: &PerceptionSetup<'_>| {
            let mut observation = observation(vec![Array2::from_elem((480, 640), 0.3)], vec![0.1; 16]);
            observation.cameras[0].labels = labels;
            Perception::new(hand(), cameras(&hand()), setup).see(0, observation, None)
        };
        let mask =
            |width| Array2::from_shape_fn((480, width), |(v, u)| (200..280).contains(&v) && (300..340).contains(&u));
        let seen = see(Some(GivenLabels::Mask(mask(640))), &setup).unwrap();
        let labels = &seen.percept.cameras[0].as_ref().unwrap().labels;
        assert_eq!([(240, 320), (240, 290), (40, 40)].map(|at| labels[at]), [Label::Object, Label::Hand, Label::Hand]);
        let refused = see(None, &setup).unwrap_err().to_string();
        assert!(refused.contains("camera top-down: there are no labels") && refused.contains("geometry"), "{refused}");
        let refused = see(Some(GivenLabels::Mask(mask(320))), &setup).unwrap_err().to_string();
        assert!(refused.contains("its label image is 320 x 480 pixels; 640 x 480 expected"), "{refused}");
    }

    #[test]
    fn a_frame_that_is_not_newer_is_refused() {
        let mut perception = perception(&hand());
        let mut see = |time_s| {
            let observation = Observation { time_s, ..observation(Vec::new(), vec![0.1; 16]) };
            perception.see(0, observation, None).map(|_| ()).map_err(|error| error.to_string())
        };
        assert!(see(1.5).is_ok() && see(1.51).is_ok());
        for older_s in [1.51, 1.2] {
            assert!(see(older_s).unwrap_err().contains("does not come after that of 1.51 s"), "{older_s}");
        }
        assert!(see(1.6).is_ok());
    }

    #[test]
    fn there_may_be_no_hand() {
        let none = Hand::none();
        let setup = PerceptionSetup { weights: None, config: PerceptionConfig::default() };
        let mut perception = Perception::new(Arc::clone(&none), cameras(&none), &setup);
        for k in 0..3 {
            let depth_m = Array2::from_elem((480, 640), 0.3);
            let observation = Observation { time_s: f64::from(k), ..observation(vec![depth_m], Vec::new()) };
            let seen = perception.see(0, observation, None).unwrap();
            assert!(seen.warnings.is_empty() && seen.percept.touch.is_empty());
            let camera = seen.percept.cameras[0].as_ref().unwrap();
            assert!(camera.labels.iter().all(|&label| label == Label::Object));
        }
        assert_eq!(perception.calibration(), None);
    }
}
