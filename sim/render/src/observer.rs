//! Rendered touch and camera images of a state of the scene, with the ground truth.

use image::RgbImage;
use mvt_frames::camera::PosedCamera;
use mvt_frames::{Camera, Isometry};
use mvt_objects::object::Object;
use mvt_robot::digit;
use mvt_robot::hand::{PerFinger, Side, world_from_tip};
use mvt_robot::observation::{GroundTruth, Observation, SceneState, TouchTruth};

use crate::camera;
use crate::depth_noise::{self, FrameId};
use crate::rays::RayMesh;
use crate::touch::{GelPress, NoiseKey, TouchError, TouchFrame, TouchOptions, TouchRenderer};

/// Options of an [`Observer`].
#[derive(Debug, Clone, PartialEq)]
pub struct ObserverOptions {
    /// Which hand.
    pub side: Side,
    /// The cameras, in the order of the observations.
    pub cameras: Vec<PosedCamera>,
    /// Options of each DIGIT.
    pub touch: PerFinger<TouchOptions>,
    /// Whether touch images have noise.
    pub touch_noise: bool,
    /// Redwood-style noise on camera depth, as a multiple of its level (see [`depth_noise::disturb`]); `None` for true
    /// depth.
    pub camera_depth_noise: Option<f64>,
    /// Seed of all noise.
    pub seed: u64,
}

/// Renderer of all sensors of a hand. It is immutable, so that all threads share one; its images depend on the state
/// and the number of the frame alone.
pub struct Observer {
    options: ObserverOptions,
    object: RayMesh,
    touch: PerFinger<TouchRenderer>,
    camera: camera::Renderer,
}

/// Working memory of an [`Observer`]: reuse it from frame to frame, one per thread.
#[derive(Default)]
pub struct ObserverScratch {
    touch: TouchFrame,
    camera: camera::CameraScratch,
}

impl Observer {
    /// Prepares the rendering of an object.
    ///
    /// # Errors
    /// [`TouchError`] if a touch option is out of range.
    pub fn new(object: &Object, options: ObserverOptions) -> Result<Self, TouchError> {
        let [index, middle, ring, thumb] = options.touch.0.each_ref().map(TouchRenderer::new);
        Ok(Self {
            object: RayMesh::new(&object.mesh),
            touch: PerFinger([index?, middle?, ring?, thumb?]),
            camera: camera::Renderer::new(options.side, object),
            options,
        })
    }

    /// Turns and moves all cameras in their own frames, as by a bump.
    pub fn move_cameras(&mut self, change: Isometry<Camera, Camera>) {
        for camera in &mut self.options.cameras {
            camera.pose = camera.pose * change;
        }
    }

    /// Returns the untouched image of each DIGIT, without noise.
    pub fn untouched_images(&self) -> PerFinger<RgbImage> {
        PerFinger::from_fn(|finger| self.touch[finger].empty())
    }

    /// Renders a state as frame number `frame`.
    pub fn observe(&self, frame: u32, state: &SceneState, scratch: &mut ObserverScratch) -> (Observation, GroundTruth) {
        let mut touch_truth = PerFinger::from_fn(|_| TouchTruth::default());
        let touch = PerFinger::from_fn(|finger| {
            let world_from_gel = world_from_tip(self.options.side, finger, &state.joints) * digit::tip_from_gel();
            let gel_from_object = world_from_gel.inverse() * state.object_pose;
            let key = NoiseKey { seed: self.options.seed, finger: finger as u32, frame };
            let noise = self.options.touch_noise.then_some(key);
            let press = GelPress { gel_from_object, shear: state.shear[finger] };
            self.touch[finger].render_dragged(&self.object, press, noise, &mut scratch.touch);
            let (image, truth) = scratch.touch.take();
            touch_truth[finger] = truth;
            image
        });
        let (cameras, labels) = (0..)
            .zip(&self.options.cameras)
            .map(|(i, camera)| {
                let rendered = self.camera.render(camera, &state.joints, state.object_pose, &mut scratch.camera);
                let mut rgbd = rendered.rgbd;
                if let Some(multiplier) = self.options.camera_depth_noise {
                    let id = FrameId { seed: self.options.seed, camera: i, frame };
                    rgbd.depth_m = depth_noise::disturb(&rgbd.depth_m, multiplier, id);
                }
                (rgbd, rendered.labels)
            })
            .unzip();
        let observation = Observation { time_s: state.time_s, joints: state.joints, touch, cameras };
        (
            observation,
            GroundTruth { object_pose: state.object_pose, touch: touch_truth, shear: Some(state.shear), labels },
        )
    }

    /// Returns the share of the object that the hand hides from the first camera in the state that `truth` describes
    /// (see [`camera::Renderer::hidden_share`]). Returns `None` if there are no cameras, too.
    pub fn hidden_share(&self, truth: &GroundTruth, scratch: &mut ObserverScratch) -> Option<f64> {
        let (camera, labels) = self.options.cameras.first().zip(truth.labels.first())?;
        self.camera.hidden_share(camera, truth.object_pose, labels, &mut scratch.camera)
    }
}
