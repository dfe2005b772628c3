//! Paints the scene in three dimensions.

use std::path::PathBuf;
use std::sync::Arc;

use glam::{Mat3A, Vec3, Vec3A};
use image::{Rgb, RgbImage};
use mvt_frames::camera::{Intrinsics, PosedCamera};
use mvt_frames::{Camera, Isometry, Object, Point, World};
use mvt_objects::distance::MeshDistance;
use mvt_picture::cut_plane::{self, CutPlane};
use mvt_picture::draw;
use mvt_picture::palette::{self, Theme};
use mvt_picture::raster::{self, Colour, LitMesh, MeshPlacement, Rasteriser};
use mvt_recording::{RecordedMoment, RecordedShape, Recording};
use mvt_render::tessellation::tessellate;
use mvt_robot::hand::{Hand, PartSurface, Primitive};
use mvt_run::sdf_grid::SdfGrid;
use nalgebra as na;
use rayon::prelude::*;

use crate::eye::Eye;
use crate::layers::{Clouds, Colouring, Keyframes, Layers};
use crate::seen_points::{SeenBy, SeenPoints, Sighting};

/// Pixels along each side of a pixel of a fine picture.
const SAMPLES: usize = 2;
/// Highlights of the links, the housings of touch sensors and the gels.
const LINK_SHINE: f32 = 0.16;
const HOUSING_SHINE: f32 = 0.1;
const GEL_SHINE: f32 = 0.22;
/// Part of the trail that is drawn, frames, and its width at both ends, pixels.
const TRAIL_FRAMES: usize = 150;
const TRAIL_PX: [f32; 2] = [0.4, 2.4];
/// A part of the hand is translucent if it lies between the eye and a ball of this radius around the object, metres.
const OBJECT_RADIUS_M: f32 = 0.03;
/// Segments around the rounded parts of the hand.
const SEGMENTS: usize = 20;
/// Weight of the colour of translucent surfaces.
const GLASS_SHARE: f32 = 0.5;
/// Lengths of axes, of frusta and of the frusta of keyframes, metres.
const AXIS_M: f32 = 0.035;
const FRUSTUM_M: f32 = 0.06;
const KEYFRAME_M: f32 = 0.02;
/// Nodes along each side of a slice, and frames in which it sweeps through the object and back.
const SLICE_NODES: usize = 72;
const SLICE_FRAMES: usize = 240;
/// Share of the height of the shape at both ends that the slice does not reach.
const SLICE_MARGIN: f32 = 0.08;
/// Width of the line where the distance is 0, pixels.
const ZERO_LINE_PX: f32 = 2.5;

/// Painter of scenes. It keeps prepared meshes from one picture to the next.
#[derive(Default)]
pub struct ScenePainter {
    raster: Rasteriser,
    hand: Option<PreparedHand>,
    seen: SeenPoints,
    shown: Option<Shown>,
    truth: Option<Truth>,
    /// Problem of the last picture.
    warning: Option<String>,
}

/// The hand, prepared. Its fingers share shapes.
struct PreparedHand {
    hand: Arc<Hand>,
    /// Body, material and index of the shape of each part.
    parts: Vec<(usize, PartSurface, usize)>,
    shapes: Vec<LitMesh>,
}

/// An estimated shape, prepared.
struct Shown {
    of: Source,
    shape: Arc<RecordedShape>,
    surface: LitMesh,
    colours: Vec<Colour>,
    coloured: Option<Coloured>,
}

/// Recording from which a mesh was prepared.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Source {
    folder: PathBuf,
    process: u32,
    shape: usize,
}

/// Inputs of the colours of a shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Coloured {
    colouring: Colouring,
    surface: Rgb<u8>,
    /// Number of images that were used; 0 for colourings that need none.
    images: usize,
}

/// The true shape, prepared.
struct Truth {
    of: Source,
    surface: LitMesh,
    distance: Option<MeshDistance>,
}

impl ScenePainter {
    /// Returns a painter without prepared meshes.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the problem of the last picture, in words.
    pub fn warning(&self) -> Option<&str> {
        self.warning.as_deref()
    }

    /// Paints a moment of a recording; `size` is width and height in pixels. A recording without moments gives an empty
    /// picture.
    pub fn paint(
        &mut self,
        recording: &Recording,
        moment: usize,
        layers: &Layers,
        eye: &Eye,
        theme: &Theme,
        size: [usize; 2],
    ) -> &RgbImage {
        let layers = &layers.of(recording);
        self.warning = None;
        self.raster.begin(&eye.intrinsics(size), theme.paper);
        let moment = moment.min(recording.moments().len().saturating_sub(1));
        if let Some(now) = recording.moments().get(moment) {
            let view = View { eye: eye.pose().inverse(), pose: recording.pose(moment) };
            self.prepare(recording, moment, layers, theme);
            if layers.hand {
                self.hand(&recording.about().hand, &now.joints, &view, theme);
            }
            self.objects(recording, moment, layers, &view, theme);
            self.lines(recording, moment, layers, &view, theme);
        }
        self.raster.finish(GLASS_SHARE)
    }

    /// Paints a moment as [`ScenePainter::paint`] does, without jagged edges and with ambient occlusion. Takes several
    /// times as long.
    pub fn paint_fine(
        &mut self,
        recording: &Recording,
        moment: usize,
        layers: &Layers,
        eye: &Eye,
        theme: &Theme,
        size: [usize; 2],
    ) -> RgbImage {
        self.paint(recording, moment, layers, eye, theme, size.map(|side| side * SAMPLES));
        draw::shrink(self.raster.occlude(SAMPLES), SAMPLES as u32)
    }

    /// Reads and colours the shapes, and gathers the seen points, unless they are kept from the last picture.
    fn prepare(&mut self, recording: &Recording, moment: usize, layers: &Layers, theme: &Theme) {
        let source = |shape: usize| Source {
            folder: recording.folder().to_path_buf(),
            process: recording.about().process,
            shape,
        };
        if let Some(mesh) = recording.true_mesh() {
            let of = source(0);
            if self.truth.as_ref().is_none_or(|truth| truth.of != of) {
                self.truth = Some(Truth { of, surface: LitMesh::new(mesh), distance: MeshDistance::new(mesh) });
            }
        } else {
            self.truth = None;
        }
        if layers.needs_seen_points() {
            let is_other = self.shown.as_ref().is_some_and(|shown| shown.of.folder != recording.folder());
            if is_other {
                self.seen = SeenPoints::default();
            }
            self.warning = self.seen.advance(recording, moment).err().map(|error| error.to_string());
        }
        let Some(index) = recording.shape_at(moment) else {
            self.shown = None;
            return;
        };
        let of = source(index);
        if self.shown.as_ref().is_none_or(|shown| shown.of != of) {
            self.shown = match recording.shape(moment) {
                Ok(shape) => shape.map(|shape| Shown {
                    of,
                    surface: LitMesh::new(&shape.mesh),
                    colours: Vec::new(),
                    coloured: None,
                    shape,
                }),
                Err(error) => {
                    self.warning = Some(error.to_string());
                    None
                }
            };
        }
        let seen = &self.seen;
        if let Some(shown) = &mut self.shown {
            let coloured = Coloured {
                colouring: layers.colouring,
                surface: theme.surface,
                images: if layers.needs_seen_points() { seen.images() } else { 0 },
            };
            if layers.mesh && shown.coloured != Some(coloured) {
                shown.coloured = Some(coloured);
                let truth = self.truth.as_ref().and_then(|truth| truth.distance.as_ref());
                shown.colours = vertex_colours(recording, shown, coloured, seen, truth);
            }
        }
    }

    fn hand(&mut self, hand: &Arc<Hand>, joints: &[f64], view: &View, theme: &Theme) {
        if self.hand.as_ref().is_none_or(|prepared| prepared.hand != *hand) {
            let (mut shapes, mut placed) = (Vec::<&Primitive>::new(), Vec::new());
            for (body, part) in hand.parts() {
                let known = shapes.iter().position(|&shape| *shape == part.shape);
                placed.push((body, part.surface, known.unwrap_or(shapes.len())));
                if known.is_none() {
                    shapes.push(&part.shape);
                }
            }
            let surfaces = shapes.iter().map(|shape| LitMesh::new(&tessellate(shape, SEGMENTS))).collect();
            self.hand = Some(PreparedHand { hand: Arc::clone(hand), parts: placed, shapes: surfaces });
        }
        let Some(PreparedHand { parts, shapes, .. }) = &self.hand else { return };
        let poses = hand.body_poses(joints);
        for (body, material, shape) in parts {
            let (colour, shine) = match material {
                PartSurface::Link => (theme.link, LINK_SHINE),
                PartSurface::Housing => (theme.digit, HOUSING_SHINE),
                PartSurface::Gel(_) => (theme.gel, GEL_SHINE),
            };
            let colour = raster::colour(colour);
            let pose = Isometry::<Object, World>::new(poses[*body]);
            let surface = &shapes[*shape];
            let is_glass = *material != PartSurface::Link && view.hides_object(surface, pose);
            self.raster.surface(surface, |_| colour, MeshPlacement { is_glass, shine, ..view.solid(pose) });
        }
    }

    fn objects(&mut self, recording: &Recording, moment: usize, layers: &Layers, view: &View, theme: &Theme) {
        let Self { raster, shown, truth, .. } = self;
        let true_pose = recording.moments().get(moment).and_then(|moment| moment.row.truth);
        // A log has no estimate: the true shape is shown instead.
        let is_log = recording.moments().get(moment).is_some_and(|moment| moment.estimate().is_none());
        if let Some((truth, pose)) = truth.as_ref().zip(true_pose).filter(|_| layers.truth || is_log) {
            let tint = raster::colour(theme.truth);
            let placement = MeshPlacement { is_glass: !is_log, ..view.solid(pose) };
            raster.surface(&truth.surface, |_| tint, placement);
        }
        let (Some(shown), Some(pose)) = (shown, view.pose) else { return };
        let cut = layers.slice.then(|| cut_plane(&shown.shape, moment, view.camera_from_object(pose)));
        if layers.mesh {
            let plain = raster::colour(theme.surface);
            let colour = |k: usize| shown.colours.get(k).copied().unwrap_or(plain);
            match cut.filter(|_| shown.shape.sdf.is_some()) {
                Some(plane) => raster.cut_surface(&shown.surface, colour, view.solid(pose), plane),
                None => raster.surface(&shown.surface, colour, view.solid(pose)),
            }
        }
        if let (Some(plane), Some(sdf)) = (cut, &shown.shape.sdf) {
            slice(raster, sdf, plane, view.camera_from_object(pose), raster::colour(theme.ink));
        }
    }

    fn lines(&mut self, recording: &Recording, moment: usize, layers: &Layers, view: &View, theme: &Theme) {
        let Self { raster, shown, seen, .. } = self;
        let moments = recording.moments();
        let until = moments.get(..=moment).unwrap_or(moments);
        let from_world = view.camera_from_world();
        let estimate = raster::colour(theme.estimate);
        if layers.trail {
            let of_truth = until.iter().map(|moment| moment.row.truth);
            let of_estimate = until.iter().map(RecordedMoment::estimate);
            let first = until.len().saturating_sub(TRAIL_FRAMES);
            trail(raster, of_truth.skip(first), raster::colour(theme.truth), from_world);
            trail(raster, of_estimate.skip(first), estimate, from_world);
        }
        if layers.axes
            && let Some(now) = until.last()
        {
            let mut axes = |pose: Isometry<Object, World>, length: f32, width: f32| {
                let camera_from_object = view.camera_from_object(pose);
                for (axis, colour) in [Vec3::X, Vec3::Y, Vec3::Z].into_iter().zip(palette::AXES) {
                    let ends = [Vec3::ZERO, axis * length].map(|point| raster::place(camera_from_object, point));
                    // Drawn over everything, because they begin inside the object.
                    raster.line(ends.map(forward), raster::colour(colour), width);
                }
            };
            now.row.truth.into_iter().for_each(|pose| axes(pose, 1.25 * AXIS_M, 1.2));
            now.estimate().into_iter().for_each(|pose| axes(pose, AXIS_M, 3.0));
        }
        if layers.frusta {
            let tint = raster::colour(theme.faint);
            for camera in &recording.about().cameras {
                frustum(raster, camera, from_world, FRUSTUM_M, tint);
            }
        }
        let Some(pose) = view.pose else { return };
        let camera_from_object = view.camera_from_object(pose);
        if let (true, Some(shown)) = (layers.bounds, shown) {
            cuboid(raster, shown.shape.mesh.bounds_m(), camera_from_object, raster::colour(theme.faint));
        }
        keyframes(raster, recording, moment, layers.keyframes, camera_from_object, raster::colour(theme.keyframe));
        let wanted = |by: SeenBy| match layers.clouds {
            Clouds::None => false,
            Clouds::Vision => by == SeenBy::Vision,
            Clouds::Touch => by == SeenBy::Touch,
            Clouds::Both => true,
        };
        if layers.clouds != Clouds::None {
            for (point, by) in seen.points().filter(|(_, by)| wanted(*by)) {
                let at = camera_from_object.0 * point + camera_from_object.1;
                raster.dot(at, raster::colour(by.colour()), if by == SeenBy::Touch { 3.0 } else { 2.0 });
            }
        }
    }
}

/// Poses of the eye and of the object.
struct View {
    eye: Isometry<World, Camera>,
    pose: Option<Isometry<Object, World>>,
}

impl View {
    fn camera_from_world(&self) -> (Mat3A, Vec3A) {
        self.eye.to_f32()
    }

    fn camera_from_object(&self, pose: Isometry<Object, World>) -> (Mat3A, Vec3A) {
        (self.eye * pose).to_f32()
    }

    /// Whether a part of the hand lies between the eye and the object.
    fn hides_object(&self, surface: &LitMesh, pose: Isometry<Object, World>) -> bool {
        let Some(object) = self.pose else { return false };
        let (rotation, translation) = self.camera_from_object(pose);
        let centre = self.camera_from_object(object).1;
        surface.vertices().iter().any(|&vertex| {
            let point = rotation * vertex + translation;
            // Where the ray through the point comes closest to the object's centre.
            let along = centre.dot(point) / point.length_squared().max(f32::MIN_POSITIVE);
            along > 1.0 && (point * along - centre).length() < OBJECT_RADIUS_M
        })
    }

    fn solid(&self, pose: Isometry<Object, World>) -> MeshPlacement {
        MeshPlacement { camera_from_mesh: self.camera_from_object(pose), is_glass: false, shine: 0.0 }
    }
}

/// Moves a point along its ray close to the eye, so that nothing hides it.
fn forward(point: Vec3A) -> Vec3A {
    point * (0.02 / (-point.z).max(0.02))
}

fn vertex_colours(
    recording: &Recording,
    shown: &Shown,
    coloured: Coloured,
    seen: &SeenPoints,
    truth: Option<&MeshDistance>,
) -> Vec<Colour> {
    let plain = raster::colour(coloured.surface);
    let vertices = shown.surface.vertices();
    let by_sight =
        |of: &(dyn Fn(Sighting) -> Colour + Sync)| vertices.par_iter().map(|&vertex| of(seen.at(vertex))).collect();
    match coloured.colouring {
        Colouring::Normals => {
            shown.surface.normals().iter().map(|normal| raster::colour(palette::normal(normal.to_array()))).collect()
        }
        Colouring::Error => {
            // The shape was scored with the pose of its own frame.
            let frame = shown.shape.frame;
            let then = recording.moments().iter().rev().find(|moment| moment.row.frame <= frame);
            let motion = then.and_then(|moment| Some(moment.row.truth?.inverse() * moment.estimate()?));
            let Some((motion, truth)) = motion.zip(truth) else { return vec![plain; vertices.len()] };
            let colour = |vertex: &Vec3A| {
                let [x, y, z] = vertex.to_array().map(f64::from);
                let error_m = mvt_mesh::SignedDistance::distance_m(truth, motion * Point::new(x, y, z));
                raster::colour(palette::surface_error(error_m as f32))
            };
            vertices.par_iter().map(colour).collect()
        }
        Colouring::TrueColour => by_sight(&|sight| sight.colour.unwrap_or(plain)),
        Colouring::Sensor => by_sight(&|sight| raster::colour(sight.by.colour())),
        Colouring::Confidence => by_sight(&|sight| raster::colour(palette::confidence(sight.confidence))),
    }
}

/// Returns the plane of the slice, which sweeps through the shape and back. The part towards the eye is cut off.
fn cut_plane(shape: &RecordedShape, moment: usize, (rotation, translation): (Mat3A, Vec3A)) -> CutPlane {
    let [low, high] = shape.mesh.bounds_m();
    // Begins in the middle.
    let phase = ((moment + SLICE_FRAMES / 4) % SLICE_FRAMES) as f32 / SLICE_FRAMES as f32;
    let share = SLICE_MARGIN + (1.0 - 2.0 * SLICE_MARGIN) * (1.0 - (2.0 * phase - 1.0).abs());
    let height_m = low.z + (high.z - low.z) * share;
    let eye = rotation.transpose() * -translation;
    let side = if eye.z > height_m { 1.0 } else { -1.0 };
    CutPlane { normal: Vec3A::Z * side, offset_m: side * height_m }
}

/// Draws the signed distances in a plane: solid inside the shape, translucent outside, and a line at distance 0.
fn slice(raster: &mut Rasteriser, sdf: &SdfGrid, plane: CutPlane, camera_from_object: (Mat3A, Vec3A), line: Colour) {
    let size = Vec3::from(sdf.counts.map(|count| count as f32 - 1.0)) * sdf.cell_m;
    let height_m = plane.normal.z * plane.offset_m;
    let node = |x: usize, y: usize| {
        let share = Vec3::new(x as f32, y as f32, 0.0) / (SLICE_NODES - 1) as f32;
        let point = (sdf.low + size * share).min(sdf.low + size).with_z(height_m);
        let distance_m = sdf.distance_m(point)?;
        let colour = raster::colour(palette::signed_distance(distance_m));
        Some((distance_m, raster::place(camera_from_object, point), colour))
    };
    for y in 1..SLICE_NODES {
        for x in 1..SLICE_NODES {
            let corners = [node(x - 1, y - 1), node(x, y - 1), node(x, y), node(x - 1, y)];
            let [Some(a), Some(b), Some(c), Some(d)] = corners else { continue };
            for corners in [[a, b, c], [a, c, d]] {
                let [inside, outside] = cut_plane::split(corners);
                for (polygon, is_glass) in [(&inside, false), (&outside, true)] {
                    for triangle in cut_plane::fan(polygon) {
                        raster.flat(triangle.map(|corner| corner.0), triangle.map(|corner| corner.1), is_glass);
                    }
                }
                // Both polygons share the corners at distance 0.
                let mut shared = inside.iter().filter(|corner| outside.contains(corner)).map(|corner| corner.0);
                if let (Some(from), Some(to)) = (shared.next(), shared.next()) {
                    raster.line([from, to], line, ZERO_LINE_PX);
                }
            }
        }
    }
}

/// Draws a path that becomes thinner with age.
fn trail(
    raster: &mut Rasteriser,
    poses: impl ExactSizeIterator<Item = Option<Isometry<Object, World>>>,
    colour: Colour,
    from_world: (Mat3A, Vec3A),
) {
    let mut last: Option<Vec3A> = None;
    let count = poses.len().max(1) as f32;
    for (k, pose) in poses.enumerate() {
        let here = pose.map(|pose| from_world.0 * pose.to_f32().1 + from_world.1);
        if let (Some(from), Some(to)) = (last, here) {
            let newness = (k + 1) as f32 / count;
            let [old, new] = TRAIL_PX;
            raster.line([from, to].map(forward), colour, old + (new - old) * newness.powi(2));
        }
        last = here;
    }
}

fn frustum(raster: &mut Rasteriser, camera: &PosedCamera, from_world: (Mat3A, Vec3A), length_m: f32, colour: Colour) {
    let (rotation, translation) = camera.pose.to_f32();
    let place = |point: Vec3A| from_world.0 * (rotation * point + translation) + from_world.1;
    pyramid(raster, &camera.intrinsics, place, length_m, colour);
}

/// Draws the edges of a camera's field of view up to a depth.
fn pyramid(
    raster: &mut Rasteriser,
    camera: &Intrinsics,
    place: impl Fn(Vec3A) -> Vec3A,
    length_m: f32,
    colour: Colour,
) {
    let (right, bottom) = (camera.width as f64 - 1.0, camera.height as f64 - 1.0);
    let corners = [(0.0, 0.0), (right, 0.0), (right, bottom), (0.0, bottom)].map(|(u, v)| {
        let p = camera.unproject(u, v, f64::from(length_m)).coords();
        place(Vec3A::new(p.x as f32, p.y as f32, p.z as f32))
    });
    let tip = place(Vec3A::ZERO);
    for k in 0..4 {
        raster.line([tip, corners[k]], colour, 1.5);
        raster.line([corners[k], corners[(k + 1) % 4]], colour, 1.5);
    }
}

fn cuboid(raster: &mut Rasteriser, [low, high]: [Vec3; 2], camera_from_object: (Mat3A, Vec3A), colour: Colour) {
    let corner = |k: usize| {
        let share = Vec3::from([k & 1, k >> 1 & 1, k >> 2].map(|side| side as f32));
        raster::place(camera_from_object, low + (high - low) * share)
    };
    for k in 0..8 {
        for bit in [1, 2, 4].into_iter().filter(|bit| k & bit == 0) {
            raster.line([corner(k), corner(k | bit)], colour, 1.2);
        }
    }
}

/// Draws the poses of the cameras, and of the pads that touched, relative to the object at each keyframe.
fn keyframes(
    raster: &mut Rasteriser,
    recording: &Recording,
    moment: usize,
    which: Keyframes,
    camera_from_object: (Mat3A, Vec3A),
    colour: Colour,
) {
    let moments = recording.moments();
    let kept = moments.get(..=moment).unwrap_or(moments).iter().rev().filter(|moment| moment.is_keyframe);
    let about = recording.about();
    for kept in kept.take(which.most()) {
        let Some(pose) = kept.estimate() else { continue };
        let mut draw_sensor = |camera: &Intrinsics, world_from_camera: na::Isometry3<f64>, length_m: f32| {
            let object_from_sensor =
                Isometry::<Camera, Object>::new(pose.untyped().inverse() * world_from_camera).to_f32();
            let place = |point: Vec3A| {
                camera_from_object.0 * (object_from_sensor.0 * point + object_from_sensor.1) + camera_from_object.1
            };
            pyramid(raster, camera, place, length_m, colour);
        };
        for camera in &about.cameras {
            draw_sensor(&camera.intrinsics, camera.pose.untyped(), KEYFRAME_M);
        }
        let poses = about.hand.world_from_touch_cameras(&kept.joints);
        let pads = kept.touching.iter().zip(about.hand.pads()).zip(poses);
        for ((_, pad), pose) in pads.filter(|((touching, _), _)| touching.is_some()) {
            draw_sensor(&pad.profile.intrinsics(), pose.untyped(), 0.5 * KEYFRAME_M);
        }
    }
}
