//! Where touch sensors feel the object.

use mvt_robot::hand::Hand;
use mvt_robot::observation::Percept;
use nalgebra as na;

/// Every Nth row and column of a touch image gives a point: 0.5 mm on a DIGIT, so that four gels that are wholly pressed in fit a datagram of
/// 64 KB.
const STRIDE: usize = 10;

/// Returns the places at which gels are pressed in, x, y and z in a frame, and how far, all in metres.
pub(crate) fn contacts(hand: &Hand, percept: &Percept, frame_from_world: &na::Isometry3<f64>) -> Vec<[f32; 4]> {
    let mut points = Vec::new();
    let cameras = hand.world_from_touch_cameras(&percept.joints);
    for ((press, gel), world_from_camera) in percept.touch.iter().zip(hand.gel_views().iter()).zip(cameras) {
        let Some(press) = press else { continue };
        for (point, mm) in gel.touched_points(&press.indentation_mm, &press.contact, STRIDE) {
            let place = frame_from_world * na::Point3::from((world_from_camera * point).coords());
            points.push([place.x as f32, place.y as f32, place.z as f32, 1e-3 * mm]);
        }
    }
    points
}
