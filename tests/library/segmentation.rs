//! Compares the labels of the segmentation with those of the renderer, under camera noise of NeuralFeels' level.

use mvt_frames::depth::Label;
use mvt_gaits::clock::FRAME_HZ;
use mvt_gaits::gait;
use mvt_objects::catalogue;
use mvt_physics::episode::{Episode, EpisodeConfig, Randomisation};
use mvt_render::camera::{CameraScratch, Renderer};
use mvt_render::depth_noise::{FrameId, disturb};
use mvt_robot::hand::solid::HandSolid;
use mvt_robot::hand::{Hand, Side};
use mvt_robot::rig::PLACEMENTS;
use mvt_segmentation::{SegmentationConfig, segment};

#[test]
fn pixels_labelled_object_show_the_object() {
    let (mut claimed, mut right, mut drawn, mut missed) = (0, 0, 0, 0);
    for (name, side) in [("rubiks_cube_small", Side::Left), ("mug", Side::Right)] {
        let object = catalogue::load(name, &mut Vec::new()).unwrap();
        let model = Hand::allegro(side);
        let (_, gait) = gait::choose("auto", &object, &model).unwrap();
        let config = EpisodeConfig {
            hand: model.clone(),
            gait: gait.clone(),
            seed: 3,
            duration_s: 3.0,
            randomisation: Randomisation::default(),
        };
        let mut episode = Episode::new(&object, &config).unwrap();
        let (renderer, mut scratch) = (Renderer::new(&model, &object), CameraScratch::default());
        let states = std::iter::from_fn(|| episode.next_frame()).step_by(FRAME_HZ as usize);
        for (frame, state) in (0..).zip(states) {
            let hand = HandSolid::new(&model, &state.scene.joints);
            for (index, placement) in (0..).zip(&PLACEMENTS) {
                let camera = placement.camera(&model);
                let truth = renderer.render(&camera, &state.scene.joints, state.scene.object_pose, &mut scratch);
                let depth = disturb(&truth.rgbd.depth_m, 5.0, FrameId { seed: 3, camera: index, frame });
                let found = segment(
                    &depth,
                    &camera.intrinsics,
                    camera.pose,
                    &hand,
                    model.grasp_centre(&state.scene.joints),
                    &SegmentationConfig::default(),
                );
                for (found, truth) in found.iter().zip(&truth.labels) {
                    claimed += u32::from(*found == Label::Object);
                    drawn += u32::from(*truth == Label::Object);
                    right += u32::from(*found == Label::Object && *truth == Label::Object);
                    missed += u32::from(*found == Label::Background && *truth == Label::Object);
                }
            }
        }
    }
    let of = |part: u32, whole: u32| f64::from(part) / f64::from(whole);
    assert!(drawn > 50_000, "{drawn}");
    assert!(of(right, claimed) > 0.999, "precision {}", of(right, claimed));
    assert!(of(right, drawn) > 0.8, "recall {}", of(right, drawn));
    // Background is free space: none of it may be the object.
    assert!(of(missed, drawn) < 1e-3, "object taken for background: {}", of(missed, drawn));
}
