//! A small recording: a cube turns on the spot, is lost and found again, and the index finger touches it for a while.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use image::{Rgb, RgbImage};
use mvt_frames::camera::{Intrinsics, PosedCamera};
use mvt_frames::depth::{CameraDepth, Label};
use mvt_frames::{Isometry, Object, World};
use mvt_mesh::Mesh;
use mvt_metrics::AddS;
use mvt_objects::catalogue;
use mvt_render::rays::{Caster, Faces, Hits, Instance, MISS, PixelWindow, RayMesh};
use mvt_robot::digit;
use mvt_robot::digit::profile::SensorProfile;
use mvt_robot::hand::{Hand, PerPad, Side};
use mvt_robot::observation::{Percept, Press};
use mvt_robot::rig::PLACEMENTS;
use nalgebra::{Isometry3, Vector3};
use ndarray::Array2;

use mvt_recording::{About, FOLDER, RecordingWriter, VERSION};
use mvt_run::estimator::Mode;
use mvt_run::pipeline::{MeshedShape, Progress};
use mvt_run::report::{Event, FrameRow, ShapePoint, StageMs, TrackState};
use mvt_run::sdf_grid::SdfGrid;
use mvt_run::source::{Modality, Pictures, Sensed};

/// Frames, 30 in a second.
pub const FRAMES: u64 = 36;
/// Frames in which the object is lost.
const LOST: std::ops::Range<u64> = 14..20;
/// Frames in which the index finger touches.
const TOUCHING: std::ops::Range<u64> = 6..27;

/// Records the first `frames` frames into the folder of a run; the run goes on until `finish` of the writer
/// is called, or the writer is dropped.
pub fn record(folder: &Path, frames: u64) -> RecordingWriter {
    record_as(folder, frames, Some(Mode::Slam))
}

/// Records as [`record`] does, in a mode; without one nothing is estimated, as in a log.
pub fn record_as(folder: &Path, frames: u64, mode: Option<Mode>) -> RecordingWriter {
    record_with(&Hand::allegro(Side::Left), folder, frames, mode)
}

/// Records as [`record_as`] does, with another hand, whose first pad touches.
pub fn record_with(hand: &Arc<Hand>, folder: &Path, frames: u64, mode: Option<Mode>) -> RecordingWriter {
    let cube = catalogue::find("cube70").unwrap().mesh_without_download().unwrap();
    let placement = PLACEMENTS.into_iter().find(|placement| placement.name == "side").unwrap();
    let camera = placement.camera(&Hand::allegro(Side::Left));
    let about = About {
        version: VERSION,
        object: "cube70".to_owned(),
        seed: 7,
        mode,
        modality: Modality::Vitac,
        hand: Arc::clone(hand),
        cameras: vec![camera.clone()],
        frames: FRAMES as usize,
        process: std::process::id(),
    };
    let writer = RecordingWriter::create(folder, &about, Some(&cube)).unwrap();
    let rays = RayMesh::new(&cube);
    for frame in 0..frames {
        let row = row(frame);
        let sensed = Box::new(sensed(hand, &row, &camera, &rays));
        writer.frame(&row, frame % 10 == 0, sensed);
        if frame == LOST.start {
            let event = Event { time_s: row.time_s, text: "lost the object".to_owned() };
            writer.receive(Progress::Event(&event));
        }
        if frame % 12 == 11 {
            writer.receive(Progress::Shape(0, &shape(&cube, frame)));
        }
        // A faster source would lose images.
        wait_for(folder, frame + 1);
    }
    writer
}

fn wait_for(folder: &Path, frames: u64) {
    let lines = || {
        fs::read(folder.join(FOLDER).join("frames.jsonl"))
            .map_or(0, |text| text.iter().filter(|&&c| c == b'\n').count())
    };
    let deadline = Instant::now() + Duration::from_secs(60);
    while (lines() as u64) < frames {
        assert!(Instant::now() < deadline, "the writer does not write");
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn pose(frame: u64, offset_m: f64) -> Isometry<Object, World> {
    let grasp = Hand::allegro(Side::Left).grasp_centre(&[]).unwrap().coords();
    let translation = grasp + Vector3::x() * offset_m;
    Isometry::new(Isometry3::new(translation, Vector3::z() * (0.02 * frame as f64)))
}

fn row(frame: u64) -> FrameRow {
    let is_lost = LOST.contains(&frame);
    let error_m = match frame {
        0 => 0.0,
        _ if is_lost => 0.012,
        _ => 0.0008,
    };
    FrameRow {
        frame,
        time_s: frame as f64 / 30.0,
        state: match frame {
            _ if is_lost => TrackState::Lost,
            _ if frame == LOST.end => TrackState::Relocalised,
            _ => TrackState::Tracking,
        },
        confidence: if is_lost { 0.1 } else { 0.9 },
        deviation: None,
        estimate: pose(frame, error_m),
        truth: Some(pose(frame, 0.0)),
        add_s: Some(AddS { one_directional_m: error_m, symmetric_m: error_m }),
        add_m: Some(error_m),
        stage_ms: StageMs { sense: 8.0, track: 11.0 + (frame % 3) as f64, map: 14.0, mesh: 0.0 },
    }
}

fn sensed(hand: &Hand, row: &FrameRow, camera: &PosedCamera, cube: &RayMesh) -> Sensed {
    let joints = vec![0.3; hand.joints().len()];
    let (depth, colour) = seen(&camera.intrinsics, camera.pose.inverse() * pose(row.frame, 0.0), cube);
    let labels = depth.mapv(|z| if z > 0.0 { Label::Object } else { Label::Background });
    let touches = TOUCHING.contains(&row.frame);
    let is_pressed = move |x: u32, y: u32| touches && (x as f32 - 110.0).hypot(y as f32 - 150.0) < 45.0;
    let (width, height) = (digit::WIDTH as u32, digit::HEIGHT as u32);
    let touch = |pad: usize| {
        let depth_m = Array2::from_shape_fn((digit::HEIGHT, digit::WIDTH), |(y, x)| {
            if pad == 0 && is_pressed(x as u32, y as u32) { 0.0205 } else { 0.0217 }
        });
        Press {
            indentation_mm: SensorProfile::tacto().gel_view().indentation_of(&depth_m).unwrap(),
            contact: Array2::from_shape_fn((digit::HEIGHT, digit::WIDTH), |(y, x)| {
                pad == 0 && is_pressed(x as u32, y as u32)
            }),
            sigma_mm: 0.05,
        }
    };
    let image = |pad: usize| {
        RgbImage::from_fn(width, height, |x, y| {
            let light = if pad == 0 && is_pressed(x, y) { 60 } else { 0 };
            Rgb([90 + light, 100 + (x / 8) as u8, 110 + (y / 10) as u8])
        })
    };
    Sensed {
        frame: row.frame,
        percept: Percept {
            time_s: row.time_s,
            joints,
            cameras: vec![Some(CameraDepth {
                intrinsics: camera.intrinsics,
                world_from_camera: camera.pose,
                depth_m: depth,
                labels,
                colour: Some(colour),
            })],
            touch: hand.per_pad(|pad| Some(touch(pad))),
        },
        truth: row.truth,
        pictures: Pictures {
            touch: hand.per_pad(image),
            true_indentation_mm: PerPad::default(),
            forces_n: Some(hand.per_pad(|pad| if touches && pad == 0 { 1.4 } else { 0.0 })),
        },
        sense_ms: row.stage_ms.sense,
        hidden: None,
        carried: None,
        warnings: Vec::new(),
        events: Vec::new(),
    }
}

/// Returns depth and colours of the cube, which has a colour per face.
fn seen(
    intrinsics: &Intrinsics,
    camera_from_cube: Isometry<Object, mvt_frames::Camera>,
    cube: &RayMesh,
) -> (Array2<f32>, RgbImage) {
    let mut hits = Hits::new(PixelWindow::whole(intrinsics));
    Caster::default().cast(&[Instance::new(cube, camera_from_cube)], intrinsics, Faces::Front, &mut hits);
    let at = |x: usize, y: usize| y * intrinsics.width + x;
    let is_hit = |k: usize| hits.triangle()[k] != MISS;
    let depth = Array2::from_shape_fn((intrinsics.height, intrinsics.width), |(y, x)| {
        if is_hit(at(x, y)) { hits.depth()[at(x, y)] } else { 0.0 }
    });
    let colour = RgbImage::from_fn(intrinsics.width as u32, intrinsics.height as u32, |x, y| {
        let k = at(x as usize, y as usize);
        const FACES: [[u8; 3]; 3] = [[200, 60, 50], [60, 150, 80], [60, 90, 190]];
        if is_hit(k) { Rgb(FACES[(cube.face(hits.triangle()[k]) / 2 % 3) as usize]) } else { Rgb([225, 225, 222]) }
    });
    (depth, colour)
}

/// The cube as it is believed to be: a little too large.
fn shape(cube: &Mesh, frame: u64) -> MeshedShape {
    let mut mesh = cube.clone();
    mesh.vertices.iter_mut().for_each(|vertex| *vertex *= 1.02 + 0.2 / frame as f32);
    let low = glam::Vec3::splat(-0.048);
    let (nodes, cell_m) = (25u32, 0.004);
    let at = |k: u32| low.x + cell_m * k as f32;
    let side = |x: f32, y: f32, z: f32| (x.abs().max(y.abs()).max(z.abs()) - 0.036) / SdfGrid::STEP_M;
    let values = (0..nodes.pow(3)).map(|k| side(at(k % nodes), at(k / nodes % nodes), at(k / nodes / nodes)) as i8);
    let share = frame as f64 / FRAMES as f64;
    let point = ShapePoint {
        time_s: frame as f64 / 30.0,
        f5: share,
        f2: 0.7 * share,
        f1: 0.4 * share,
        f10: share.sqrt(),
        precision5: share,
        recall5: share,
    };
    let sdf = SdfGrid { low, cell_m, counts: [nodes; 3], values: values.collect() };
    MeshedShape { frame, mesh, sdf, point: Some(point), object_from_field: Isometry::identity(), mesh_ms: 20.0 }
}
