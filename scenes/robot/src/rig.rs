//! Camera placements around the hand, and the camera rig of the occlusion study.

use std::borrow::Cow;

use mvt_frames::camera::{Intrinsics, PosedCamera, look_at};
use nalgebra::Vector3;

use crate::hand::Hand;

/// Place around the hand from which a camera looks at the grasp.
#[derive(Debug, Clone, PartialEq)]
pub struct Placement {
    /// Name in logs, also of the folder.
    pub name: Cow<'static, str>,
    /// Direction from the palm to the camera, from the fingers towards +y of a right hand, degrees.
    pub azimuth_deg: f64,
    /// Angle above the palm plane, degrees.
    pub elevation_deg: f64,
}

/// Distance of the named cameras from the palm's centre, metres.
pub const DISTANCE_M: f64 = 0.35;
/// Radius of the occlusion rig, metres (NeuralFeels, supplement).
pub const RIG_RADIUS_M: f64 = 0.5;

/// The named placements, after the RealSense cameras around the hand of NeuralFeels. On average the hand hides 42 % of
/// the object from `front-left`, 1 % from `back-right`, 3 % from `top-down` and 11 % from `side`.
pub const PLACEMENTS: [Placement; 4] = [
    Placement { name: Cow::Borrowed("front-left"), azimuth_deg: 330.0, elevation_deg: 35.0 },
    Placement { name: Cow::Borrowed("back-right"), azimuth_deg: 150.0, elevation_deg: 35.0 },
    Placement { name: Cow::Borrowed("top-down"), azimuth_deg: 0.0, elevation_deg: 90.0 },
    Placement { name: Cow::Borrowed("side"), azimuth_deg: 90.0, elevation_deg: 45.0 },
];

/// Text that is neither a name of [`PLACEMENTS`] nor a direction.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "unknown camera {0:?}; the cameras are {names}, or azimuth/elevation in degrees (-360 to 360 and -90 to 90), as in 330/35",
    names = PLACEMENTS.map(|p| p.name).join(", ")
)]
pub struct UnknownCamera(String);

impl Placement {
    /// Reads a comma-separated list of placements and drops repetitions. An item is a name of [`PLACEMENTS`], or a
    /// direction as azimuth/elevation in degrees, which gets a name like `az330el35`.
    ///
    /// # Errors
    /// [`UnknownCamera`] for any other item, also for an empty one.
    pub fn parse_list(list: &str) -> Result<Vec<Self>, UnknownCamera> {
        let mut placements = Vec::new();
        for name in list.split(',').map(str::trim) {
            let known = PLACEMENTS.into_iter().find(|p| p.name == name);
            let placement = known.or_else(|| Self::free(name)).ok_or_else(|| UnknownCamera(name.to_owned()))?;
            if !placements.contains(&placement) {
                placements.push(placement);
            }
        }
        Ok(placements)
    }

    /// Reads a direction as azimuth/elevation, degrees.
    fn free(text: &str) -> Option<Self> {
        let (azimuth, elevation) = text.split_once('/')?;
        let (azimuth_deg, elevation_deg): (f64, f64) = (azimuth.parse().ok()?, elevation.parse().ok()?);
        let possible = (-360.0..=360.0).contains(&azimuth_deg) && (-90.0..=90.0).contains(&elevation_deg);
        possible.then(|| Self { name: format!("az{azimuth_deg}el{elevation_deg}").into(), azimuth_deg, elevation_deg })
    }

    /// Returns the direction from the grasp to the camera around a right hand, a unit vector in the world.
    pub fn direction(&self) -> Vector3<f64> {
        Self::direction_of(self.azimuth_deg, self.elevation_deg)
    }

    /// Returns the unit vector in the world that points to an azimuth and elevation.
    pub fn direction_of(azimuth_deg: f64, elevation_deg: f64) -> Vector3<f64> {
        let (azimuth, elevation) = (azimuth_deg.to_radians(), elevation_deg.to_radians());
        Vector3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin())
    }

    /// Returns the camera at this place around a hand; around a left hand it is mirrored. Around a hand that moves, it is that of joint angles 0.
    pub fn camera(&self, hand: &Hand) -> PosedCamera {
        let centre = hand.palm_centre_m().map_or_else(|| grasp_centre(hand), Vector3::from);
        around_hand(self.name.clone().into_owned(), hand, centre, DISTANCE_M * self.direction())
    }
}

/// Returns the cameras of the occlusion study: `count` places spread evenly (a Fibonacci lattice, from top to bottom)
/// over a sphere around the grasp, all looking at its centre. The cameras below see only the back of the hand: full
/// occlusion.
pub fn occlusion_rig(count: usize, hand: &Hand) -> Vec<PosedCamera> {
    let golden_angle = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let place = |k: usize| {
        let height = 1.0 - (2 * k + 1) as f64 / count as f64;
        let (sin, cos) = (golden_angle * k as f64).sin_cos();
        let around = (1.0 - height * height).sqrt();
        RIG_RADIUS_M * Vector3::new(around * cos, around * sin, height)
    };
    (0..count).map(|k| around_hand(format!("occlusion-{k:03}"), hand, grasp_centre(hand), place(k))).collect()
}

/// Returns the point at which the hand holds objects, metres in the world; the origin without a hand.
fn grasp_centre(hand: &Hand) -> Vector3<f64> {
    hand.grasp_centre(&[]).map_or_else(Vector3::zeros, mvt_frames::Point::coords)
}

/// Returns a camera of 640 x 480 pixels and 45 degrees vertical field of view. `offset` is its distance from `centre` at a right hand, metres.
fn around_hand(name: String, hand: &Hand, centre: Vector3<f64>, mut offset: Vector3<f64>) -> PosedCamera {
    offset.y *= hand.side().sign();
    let intrinsics = Intrinsics::from_fov_y(640, 480, 45f64.to_radians());
    PosedCamera { name, intrinsics, pose: look_at(centre + offset, grasp_centre(hand), Vector3::z()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::Side;
    use mvt_frames::{Point, Vector, World};

    #[test]
    fn side_camera_stands_where_it_was_measured() {
        let camera = PLACEMENTS[3].camera(&Hand::allegro(Side::Right));
        assert!((camera.pose.origin().coords() - Vector3::new(-0.0475, 0.2475, 0.2586)).norm() < 1e-4);
        let target = camera.pose.inverse() * Point::new(-0.0475, 0.0, 0.0561);
        let (u, v) = camera.intrinsics.project(target).unwrap();
        assert!((u - 319.5).abs() < 1e-6 && (v - 239.5).abs() < 1e-6, "aims at ({u}, {v})");
        // +z of the world points up in the image.
        assert!((camera.pose.inverse() * Vector::<World>::new(0.0, 0.0, 1.0)).coords().y > 0.5);
    }

    #[test]
    fn left_hand_has_the_mirror_image_of_every_camera() {
        let all = |side| {
            let hand = Hand::allegro(side);
            PLACEMENTS.iter().map(|p| p.camera(&hand)).chain(occlusion_rig(50, &hand)).collect::<Vec<_>>()
        };
        for (right, left) in all(Side::Right).iter().zip(all(Side::Left)) {
            let point = Vector3::new(0.01, 0.03, 0.02);
            let mirrored = point.component_mul(&Vector3::new(1.0, -1.0, 1.0));
            let r = right.intrinsics.project(right.pose.inverse() * Point::from(point)).unwrap();
            let l = left.intrinsics.project(left.pose.inverse() * Point::from(mirrored)).unwrap();
            if right.name == "top-down" {
                // Mirroring swaps its image upside down or left to right; it is the same camera.
                assert_eq!(right.pose, left.pose);
            } else {
                assert!((r.0 + l.0 - 639.0).abs() < 1e-6 && (r.1 - l.1).abs() < 1e-6, "{}: {r:?} {l:?}", right.name);
            }
        }
    }

    #[test]
    fn rig_is_even() {
        let hand = Hand::allegro(Side::Right);
        let rig = occlusion_rig(200, &hand);
        let directions: Vec<_> =
            rig.iter().map(|c| (c.pose.origin().coords() - grasp_centre(&hand)) / RIG_RADIUS_M).collect();
        assert!(directions.iter().sum::<Vector3<f64>>().norm() / 200.0 < 0.01);
        for (k, a) in directions.iter().enumerate() {
            assert!((a.norm() - 1.0).abs() < 1e-12);
            let next = directions.iter().enumerate().filter(|(j, _)| *j != k).map(|(_, b)| (a - b).norm());
            // 200 discs of equal area would have a radius of 0.14.
            assert!(next.fold(f64::INFINITY, f64::min) > 0.2);
        }
        assert!(occlusion_rig(0, &Hand::none()).is_empty());
    }

    #[test]
    fn lists_of_names() {
        let names =
            |list| Placement::parse_list(list).map(|l| l.into_iter().map(|p| p.name.into_owned()).collect::<Vec<_>>());
        assert_eq!(names("side, front-left,side").unwrap(), ["side", "front-left"]);
        let error = names("side,leftish").unwrap_err().to_string();
        assert!(
            error
                .starts_with("unknown camera \"leftish\"; the cameras are front-left, back-right, top-down, side, or "),
            "{error}"
        );
        assert!(names("").is_err());
    }

    #[test]
    fn a_direction_is_a_camera() {
        let free = Placement::parse_list("330/35,-7.5/-20").unwrap();
        assert_eq!(
            free[0].camera(&Hand::allegro(Side::Left)).pose,
            PLACEMENTS[0].camera(&Hand::allegro(Side::Left)).pose
        );
        assert_eq!((&*free[0].name, &*free[1].name), ("az330el35", "az-7.5el-20"));
        assert!(free[1].camera(&Hand::allegro(Side::Left)).pose.origin().coords().z < 0.0111);
        for wrong in ["330", "330/", "/35", "330/35/1", "NaN/35", "330/91", "361/0", "inf/0", "left/35"] {
            let error = Placement::parse_list(wrong).unwrap_err().to_string();
            assert!(error.contains(wrong) && error.contains("azimuth/elevation"), "{error}");
        }
    }
}
