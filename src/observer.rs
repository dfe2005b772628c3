//! What the robot records of a state: rendered touch and camera images, and the ground truth beside them.

use scenes::camera::PosedCamera;
use scenes::digit;
use scenes::hand::{Finger, PerFinger, Side, world_from_tip};
use scenes::object::Object;
use scenes::observation::{GroundTruth, Observation, Rgbd, TouchTruth};

use crate::camera;
use crate::depth_noise::DepthNoise;
use crate::episode::Snapshot;
use crate::rays::RayMesh;
use crate::touch::{NoiseKey, TouchError, TouchFrame, TouchOptions, TouchRenderer};

/// How states are turned into images.
#[derive(Debug, Clone, PartialEq)]
pub struct ObserverOptions {
    /// Which hand.
    pub side: Side,
    /// The cameras, in the order of the observations.
    pub cameras: Vec<PosedCamera>,
    /// Each DIGIT.
    pub touch: PerFinger<TouchOptions>,
    /// Whether touch images have noise.
    pub touch_noise: bool,
    /// Noise of camera depth as a multiple of Redwood's; 0 for none.
    pub camera_depth_noise: f32,
    /// Seed of all noise.
    pub seed: u64,
}

/// Renders states. Immutable, so that one serves all threads; what it gives depends on the state and the frame's number alone.
pub struct Observer {
    options: ObserverOptions,
    object: RayMesh,
    touch: PerFinger<TouchRenderer>,
    camera: camera::Renderer,
}

/// The memory that rendering a frame needs: reuse it from frame to frame.
#[derive(Default)]
pub struct Scratch {
    touch: TouchFrame,
    camera: camera::Scratch,
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

    /// What is recorded of a state as frame number `frame`.
    pub fn observe(&self, frame: u64, state: &Snapshot, scratch: &mut Scratch) -> (Observation, GroundTruth) {
        let touch = Finger::ALL.map(|finger| self.touch(finger, frame, state, &mut scratch.touch));
        let [index, middle, ring, thumb] = touch;
        let (images, truths): (Vec<_>, Vec<_>) = [index, middle, ring, thumb].into_iter().unzip();
        let (cameras, segmentation) = self.options.cameras.iter().enumerate().map(|(i, camera)| {
            let camera::Frame { mut rgbd, segmentation } =
                self.camera.render(camera, &state.joints, state.object_pose, &mut scratch.camera);
            self.disturb(i as u64, frame, &mut rgbd);
            (rgbd, segmentation)
        });
        todo!()
    }
}
