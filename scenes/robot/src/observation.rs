//! The record of a robot at one instant, and, apart from it, the truth that only a simulator knows.

use std::fmt;

use image::RgbImage;
use mvt_frames::depth::{CameraDepth, GivenLabels, Label};
use ndarray::Array2;

use crate::digit::markers::GelShear;
use crate::hand::{JointAngles, PerPad};
use mvt_frames::{Camera, Isometry, Object, World};

/// Colour and depth of one camera at one instant. Arrays are indexed (row, column).
#[derive(Debug, Clone, PartialEq)]
pub struct Rgbd {
    /// Colour image; empty where there is none.
    pub color: RgbImage,
    /// Depth along the optical axis, metres, positive in front of the camera; 0 where nothing was measured, and an empty image from a camera
    /// that delivered nothing.
    pub depth_m: Array2<f32>,
    /// What is known of the pixels beforehand; without it, they are labelled from the depth and the hand's geometry.
    pub labels: Option<GivenLabels>,
    /// Where the camera is, if it moves and that is known; without it, where it stands in the rig.
    pub world_from_camera: Option<Isometry<Camera, World>>,
}

/// The record of a robot at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// Seconds since the start of the episode.
    pub time_s: f64,
    /// Joint angles as the encoders give them.
    pub joints: JointAngles,
    /// One touch image per pad; empty from a sensor that delivered nothing.
    pub touch: PerPad<RgbImage>,
    /// One colour and depth image per camera, in the order of the log's cameras.
    pub cameras: Vec<Rgbd>,
}

/// Hand and object at one instant, as a simulator knows them: all that rendering needs.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneState {
    /// Seconds since the start of the episode.
    pub time_s: f64,
    /// Joint angles.
    pub joints: JointAngles,
    /// Pose of the object.
    pub object_pose: Isometry<Object, World>,
    /// How the object has dragged each gel along.
    pub shear: PerPad<GelShear>,
}

/// The truth that only a simulator knows. Deliberately not a part of [`Observation`]: perception and tracking never receive it.
#[derive(Debug, Clone, PartialEq)]
pub struct GroundTruth {
    /// Pose of the object.
    pub object_pose: Isometry<Object, World>,
    /// True depth and contact of each touch sensor.
    pub touch: PerPad<TouchTruth>,
    /// How the object has dragged each gel along; `None` in a log, which does not store it.
    pub shear: Option<PerPad<GelShear>>,
    /// What every pixel of each camera shows, in the order of [`Observation::cameras`]; never [`Label::Unsure`].
    pub labels: Vec<Array2<Label>>,
}

/// The measurement of a perfect touch sensor. Arrays are indexed (row, column).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TouchTruth {
    /// Depth along the axis of the sensor's camera to the nearer of gel and object, metres.
    pub depth_m: Array2<f32>,
    /// Where the object presses into the gel.
    pub contact: Array2<bool>,
}

/// How an object presses into the gel of a touch sensor. Arrays are indexed (row, column).
#[derive(Debug, Clone, PartialEq)]
pub struct Press {
    /// How far the gel is pressed in, millimetres along the axis of the sensor's camera; 0 where it is not.
    pub indentation_mm: Array2<f32>,
    /// Where the object lies on the gel.
    pub contact: Array2<bool>,
    /// Standard deviation of the indentation in contact, millimetres.
    pub sigma_mm: f32,
}

/// What perception makes of an [`Observation`]: the measurements of one instant in metres.
#[derive(Debug, Clone, PartialEq)]
pub struct Percept {
    /// Seconds since the start of the episode.
    pub time_s: f64,
    /// Joint angles of the hand, which give its surface and the poses of the pads.
    pub joints: JointAngles,
    /// One depth image per camera; `None` from a camera that delivered nothing.
    pub cameras: Vec<Option<CameraDepth>>,
    /// One press per pad, which may be without contact; `None` from a sensor that delivered nothing.
    pub touch: PerPad<Option<Press>>,
}

impl Percept {
    /// Gives each camera its colour image, in their order; an empty one is none. A camera that measured no depth has no use for one.
    pub fn set_colours(&mut self, colours: impl IntoIterator<Item = RgbImage>) {
        for (camera, colour) in self.cameras.iter_mut().zip(colours) {
            if let Some(camera) = camera {
                camera.colour = (!colour.is_empty()).then_some(colour);
            }
        }
    }
}

/// A sensor, for messages.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SensorName {
    /// A camera by its name.
    Camera(String),
    /// The sensor of the pad of this name.
    Touch(String),
}

impl fmt::Display for SensorName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SensorName::Camera(name) => write!(f, "camera {name}"),
            SensorName::Touch(pad) => write!(f, "the touch sensor {pad}"),
        }
    }
}

/// Why an observation cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SensorError {
    /// An image has another size than its sensor.
    #[error(
        "{sensor}: its {image} image is {} x {} pixels; {} x {} expected: was it recorded with other settings?",
        found[0], found[1], expected[0], expected[1]
    )]
    Size {
        /// Whose image.
        sensor: SensorName,
        /// Which image.
        image: &'static str,
        /// Width and height expected, pixels.
        expected: [usize; 2],
        /// Width and height found, pixels.
        found: [usize; 2],
    },
    /// More camera images than cameras.
    #[error("the observation holds images of {found} cameras, but the poses of only {expected} are known")]
    Cameras {
        /// Cameras known.
        expected: usize,
        /// Images found.
        found: usize,
    },
    /// Another number of joint angles or touch images than the hand has.
    #[error("the observation has {found} {what}; hand {hand} has {expected}: was it recorded with another hand?")]
    Hand {
        /// What was counted.
        what: &'static str,
        /// Name of the hand.
        hand: String,
        /// Number that the hand has.
        expected: usize,
        /// Number found.
        found: usize,
    },
    /// Labels are to be given with each image, and there are none.
    #[error(
        "{0}: there are no labels with its image, but segmentation.labels is given; set it to geometry to label from the hand's geometry"
    )]
    NoLabels(SensorName),
    /// An observation is not newer than the one before.
    #[error(
        "the observation of {time_s} s does not come after that of {newest_s} s: give observations in the order of their times, in seconds"
    )]
    Time {
        /// Its time, seconds.
        time_s: f64,
        /// Time of the one before, seconds.
        newest_s: f64,
    },
    /// The time or a joint angle is not a finite number.
    #[error("{0} is not a finite number")]
    NotFinite(&'static str),
}

/// Compares the size of an image, width and height, with the one expected.
///
/// # Errors
/// [`SensorError::Size`] if they differ.
pub fn check_size(
    sensor: impl Fn() -> SensorName,
    image: &'static str,
    expected: [usize; 2],
    found: [usize; 2],
) -> Result<(), SensorError> {
    if expected == found { Ok(()) } else { Err(SensorError::Size { sensor: sensor(), image, expected, found }) }
}
