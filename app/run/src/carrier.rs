//! Masks that a sequence does not give, carried by the estimate of the frame before.

use glam::{Mat3A, Vec3, Vec3A};
use mvt_field::shape::Shape as _;
use mvt_frames::depth::{CameraDepth, GivenLabels, Label};
use mvt_robot::hand::Hand;
use mvt_robot::hand::solid::HandSolid;
use mvt_robot::observation::{Observation, Percept};
use mvt_segmentation::{CarriedMask, KnownSurface, MaskCarrier, SegmentationConfig, labelled};
use mvt_slam::Estimate;
use mvt_slam::map::Map;
use mvt_slam::scan::Measurement;
use ndarray::Array2;

use crate::estimator::Estimator;

/// Least confidence of an estimate from whose frame a carrier learns.
const LEARN_ABOVE: f64 = 0.85;

/// Labels the first camera of frames without a mask, and learns from the others what the object looks like.
pub struct LabelCarrier {
    carrier: MaskCarrier,
    config: SegmentationConfig,
    /// Nothing: there is no hand.
    hand: HandSolid,
    /// Whether the labels of the newest frame are worth learning.
    is_sound: bool,
}

impl LabelCarrier {
    /// Knows no object yet.
    pub fn new(config: SegmentationConfig) -> Self {
        let hand = HandSolid::new(&Hand::none(), &[]);
        Self { carrier: MaskCarrier::default(), config, hand, is_sound: false }
    }

    /// Carries the mask into a frame without one, by the estimator that took the frames before, and labels its pixels. Without a mask that is
    /// convincing all pixels stay unsure.
    pub fn carry(&mut self, percept: &mut Percept, estimator: Option<&Estimator>) -> Option<CarriedMask> {
        self.is_sound = false;
        let time_s = percept.time_s;
        let camera = percept.cameras.first_mut()?.as_mut()?;
        let estimator = estimator?;
        let camera_from_world = camera.world_from_camera.inverse();
        let mut pose = camera_from_world * estimator.predicted(time_s)?;
        let surface = estimator.map().map(MapSurface::new);
        let surface: &dyn KnownSurface = surface.as_ref().map_or(&NoSurface, |surface| surface);
        if estimator.is_tracking() {
            let rough = self.labelled(camera, self.carrier.roughly(camera, pose));
            let cameras = [Some(rough)];
            let measured = Measurement { time_s, cameras: &cameras, touch: &[], obstacles: &[] };
            if let Some((found, _)) = estimator.glance(&estimator.scan(&measured)) {
                pose = camera_from_world * found;
            }
        }
        let carried = self.carrier.carry(camera, pose, surface);
        self.is_sound = carried.is_some();
        let carried = carried.or_else(|| {
            let mask = (!estimator.is_tracking()).then(|| self.carrier.search(camera, time_s)).flatten()?;
            Some(CarriedMask { mask, ..CarriedMask::default() })
        })?;
        *camera = self.labelled(camera, carried.mask.clone());
        for (label, _) in camera.labels.iter_mut().zip(&carried.contested).filter(|(_, contested)| **contested) {
            *label = Label::Unsure;
        }
        Some(carried)
    }

    fn labelled(&self, camera: &CameraDepth, mask: Array2<bool>) -> CameraDepth {
        let CameraDepth { intrinsics, world_from_camera, depth_m, .. } = camera;
        let mask = GivenLabels::Mask(mask);
        let labels = labelled(depth_m, &mask, intrinsics, *world_from_camera, &self.hand, &self.config);
        CameraDepth { labels, ..camera.clone() }
    }

    /// Learns from a frame at its estimated pose, if both can be trusted. `is_given` says that its mask was given.
    pub fn learn(&mut self, percept: &Percept, estimate: &Estimate, is_given: bool) {
        let is_trusted = estimate.state.is_tracking() && estimate.confidence >= LEARN_ABOVE;
        let Some(camera) = percept.cameras.first().and_then(Option::as_ref) else { return };
        if is_trusted && (is_given || self.is_sound) {
            self.carrier.learn(camera, camera.world_from_camera.inverse() * estimate.pose, is_given);
        }
    }
}

/// Marks all pixels of cameras without labels as unsure, until a mask is carried into them. Returns whether there are such cameras.
pub fn leave_labels_open(observation: &mut Observation) -> bool {
    let mut are_open = false;
    for camera in observation.cameras.iter_mut().filter(|camera| camera.labels.is_none() && !camera.depth_m.is_empty())
    {
        camera.labels = Some(GivenLabels::Labels(Array2::from_elem(camera.depth_m.dim(), Label::Unsure)));
        are_open = true;
    }
    are_open
}

/// The surface of a map, in the frame of the model.
struct MapSurface<'a> {
    map: &'a Map,
    rotation: Mat3A,
    translation: Vec3A,
}

impl<'a> MapSurface<'a> {
    fn new(map: &'a Map) -> Self {
        let (rotation, translation) = map.field_from_model().to_f32();
        Self { map, rotation, translation }
    }

    fn in_field(&self, point: Vec3) -> Vec3 {
        (self.rotation * Vec3A::from(point) + self.translation).into()
    }
}

impl KnownSurface for MapSurface<'_> {
    fn distances_m(&self, points: &[Vec3]) -> Vec<f32> {
        let points: Vec<Vec3> = points.iter().map(|point| self.in_field(*point)).collect();
        let is_known: Vec<bool> = points.iter().map(|point| self.map.space().is_near_surface(*point)).collect();
        let known: Vec<Vec3> = points.iter().zip(&is_known).filter(|(_, known)| **known).map(|(p, _)| *p).collect();
        let mut found = vec![0.0; known.len()];
        self.map.distances(&known, &mut found);
        let mut found = found.into_iter();
        is_known.iter().map(|known| if *known { found.next() } else { None }.unwrap_or(f32::INFINITY)).collect()
    }
}

/// No map.
struct NoSurface;

impl KnownSurface for NoSurface {
    fn distances_m(&self, points: &[Vec3]) -> Vec<f32> {
        vec![f32::INFINITY; points.len()]
    }
}
