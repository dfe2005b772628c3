//! Rendered touch and camera images of a state of the scene, with the ground truth.

use std::sync::Arc;

use image::RgbImage;
use mvt_frames::camera::PosedCamera;
use mvt_frames::{Camera, Isometry};
use mvt_objects::object::Object;
use mvt_robot::hand::{Hand, PerPad};
use mvt_robot::observation::{GroundTruth, Observation, SceneState, TouchTruth};

use crate::camera;
use crate::depth_noise::{self, FrameId};
use crate::rays::RayMesh;
use crate::touch::{GelPress, NoiseKey, TouchError, TouchFrame, TouchOptions, TouchRenderer};

/// Options of an [`Observer`].
#[derive(Debug, Clone, PartialEq)]
pub struct ObserverOptions {
    /// The hand.
    pub hand: Arc<Hand>,
    /// The cameras, in the order of the observations.
    pub cameras: Vec<PosedCamera>,
    /// Options of the touch sensor of each pad.
    pub touch: PerPad<TouchOptions>,
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
    touch: PerPad<TouchRenderer>,
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
        Ok(Self {
            object: RayMesh::new(&object.mesh),
            touch: options.touch.iter().map(TouchRenderer::new).collect::<Result<_, _>>()?,
            camera: camera::Renderer::new(&options.hand, object),
            options,
        })
    }

    /// Turns and moves all cameras in their own frames, as by a bump.
    pub fn move_cameras(&mut self, change: Isometry<Camera, Camera>) {
        for camera in &mut self.options.cameras {
            camera.pose = camera.pose * change;
        }
    }

    /// Returns the untouched image of each touch sensor, without noise.
    pub fn untouched_images(&self) -> PerPad<RgbImage> {
        self.touch.map(TouchRenderer::empty)
    }

    /// Renders a state as frame number `frame`.
    pub fn observe(&self, frame: u32, state: &SceneState, scratch: &mut ObserverScratch) -> (Observation, GroundTruth) {
        let world_from_gels = self.options.hand.world_from_gels(&state.joints);
        let sensors = (0..).zip(self.touch.iter().zip(world_from_gels));
        let (touch, touch_truth): (Vec<RgbImage>, Vec<TouchTruth>) = sensors
            .map(|(pad, (renderer, world_from_gel))| {
                let gel_from_object = world_from_gel.inverse() * state.object_pose;
                let noise = self.options.touch_noise.then_some(NoiseKey { seed: self.options.seed, pad, frame });
                let shear = state.shear.get(pad as usize).copied().unwrap_or_default();
                let press = GelPress { gel_from_object, shear };
                renderer.render_dragged(&self.object, press, noise, &mut scratch.touch);
                scratch.touch.take()
            })
            .unzip();
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
        let observation =
            Observation { time_s: state.time_s, joints: state.joints.clone(), touch: PerPad(touch), cameras };
        (
            observation,
            GroundTruth {
                object_pose: state.object_pose,
                touch: PerPad(touch_truth),
                shear: Some(state.shear.clone()),
                labels,
            },
        )
    }

    /// Returns the share of the object that the hand hides from the first camera in the state that `truth` describes
    /// (see [`camera::Renderer::hidden_share`]). Returns `None` if there are no cameras, too.
    pub fn hidden_share(&self, truth: &GroundTruth, scratch: &mut ObserverScratch) -> Option<f64> {
        let (camera, labels) = self.options.cameras.first().zip(truth.labels.first())?;
        self.camera.hidden_share(camera, truth.object_pose, labels, &mut scratch.camera)
    }
}
