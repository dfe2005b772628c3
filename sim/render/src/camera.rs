//! Colour, depth and segmentation of hand and object as a camera sees them, all from one cast.

use glam::{Vec3, Vec3A};
use image::{GrayImage, RgbImage};
use mvt_frames::camera::PosedCamera;
use mvt_frames::depth::{BACKGROUND, HAND, OBJECT};
use mvt_frames::{Isometry, Object as ObjectFrame, World};
use mvt_objects::object::Object;
use mvt_robot::hand;
use mvt_robot::hand::{JointAngles, Part, PartSurface, Side};
use mvt_robot::observation::Rgbd;
use ndarray::Array2;
use rayon::prelude::*;

use crate::rays::{Caster, Faces, Hits, Instance, MISS, RayMesh, Window};
use crate::tessellation::tessellate;

/// Segments of the hand's rounded parts: their meshes stray less than 0.01 mm from them.
const SEGMENTS: usize = 96;
/// Rows that one thread renders at a time; a whole number of tiles, so that the cut does not show in the bits.
const BAND_ROWS: usize = 48;

/// Renders one hand and one object.
#[derive(Debug)]
pub struct Renderer {
    side: Side,
    /// The parts of the hand, each with the index of its shape's mesh: fingers are alike, so many share one.
    parts: Vec<(Part, usize)>,
    shapes: Vec<RayMesh>,
    object: RayMesh,
    texture: Texture,
}

/// What a camera sees, and what only a simulator can tell about it.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Colour and true depth.
    pub rgbd: Rgbd,
    /// What each pixel shows: [`BACKGROUND`], [`HAND`] or [`OBJECT`].
    pub segmentation: GrayImage,
}

/// The working memory of one thread.
#[derive(Debug, Clone)]
pub struct Scratch {
    caster: Caster,
    hits: Hits,
}

impl Default for Scratch {
    fn default() -> Self {
        Self { caster: Caster::default(), hits: Hits::new(Window { columns: 0..0, rows: 0..0 }) }
    }
}

impl Renderer {
    /// Prepares the meshes, which takes some tenths of a second of CPU time.
    pub fn new(side: Side, object: &Object) -> Self {
        let mut shapes = Vec::new();
        let parts = hand::parts(side)
            .into_iter()
            .map(|part| {
                let known = shapes.iter().position(|&shape| shape == part.shape);
                let shape = known.unwrap_or_else(|| {
                    shapes.push(part.shape);
                    shapes.len() - 1
                });
                (part, shape)
            })
            .collect();
        let shapes = shapes.par_iter().map(|shape| RayMesh::new(&tessellate(shape, SEGMENTS))).collect();
        Self { side, parts, shapes, object: RayMesh::new(&object.mesh), texture: Texture::new(&object.name) }
    }

    /// Renders a frame on the calling thread.
    pub fn render(
        &self,
        camera: &PosedCamera,
        joints: &JointAngles,
        object_pose: Isometry<ObjectFrame, World>,
        scratch: &mut Scratch,
    ) -> Frame {
        let scene = self.pose(camera, joints, object_pose);
        let mut frame = Frame::new(camera);
        for mut band in frame.bands(camera.intrinsics.height) {
            scene.render(&mut band, scratch);
        }
        frame
    }

    /// Renders a frame on all threads of the current rayon pool; the same bits as [`Renderer::render`].
    pub fn render_parallel(
        &self,
        camera: &PosedCamera,
        joints: &JointAngles,
        object_pose: Isometry<ObjectFrame, World>,
    ) -> Frame {
        let scene = self.pose(camera, joints, object_pose);
        let mut frame = Frame::new(camera);
        let mut bands: Vec<Band<'_>> = frame.bands(BAND_ROWS).collect();
        bands.par_iter_mut().for_each_init(Scratch::default, |scratch, band| scene.render(band, scratch));
        frame
    }

    /// Share of the pixels that the object alone would fill in which something stands before it: `segmentation` is what the camera
    /// sees of hand and object at that pose. None where the object is out of view.
    pub fn hidden_share(
        &self,
        camera: &PosedCamera,
        object_pose: Isometry<ObjectFrame, World>,
        segmentation: &GrayImage,
        Scratch { caster, hits }: &mut Scratch,
    ) -> Option<f64> {
        let k = &camera.intrinsics;
        hits.reset(Window { columns: 0..k.width, rows: 0..k.height });
        caster.cast(&[Instance::new(&self.object, camera.pose.inverse() * object_pose)], k, Faces::Both, hits);
        let alone = hits.triangle().iter().filter(|&&triangle| triangle != MISS).count();
        let seen = segmentation.pixels().filter(|pixel| pixel.0 == [OBJECT]).count();
        (alone > 0).then(|| 1.0 - seen as f64 / alone as f64)
    }

    fn pose<'a>(
        &'a self,
        camera: &'a PosedCamera,
        joints: &JointAngles,
        object_pose: Isometry<ObjectFrame, World>,
    ) -> PosedScene<'a> {
        let camera_from_world = camera.pose.inverse();
        let object = Instance::new(&self.object, camera_from_world * object_pose);
        let hand = self.parts.iter().map(|(part, shape)| {
            let pose = Isometry::<ObjectFrame, World>::new(part.body.pose(self.side, joints));
            Instance::new(&self.shapes[*shape], camera_from_world * pose)
        });
        let (axes, _) = camera_from_world.to_f32();
        let light = axes * KEY_LIGHT.normalize();
        PosedScene { renderer: self, camera, instances: std::iter::once(object).chain(hand).collect(), light }
    }
}

/// Where the key light stands, as a direction in the world: over the fingers, to the left.
const KEY_LIGHT: Vec3A = Vec3A::new(0.5, 0.35, 0.8);

/// A rendered band of rows.
struct Band<'a> {
    first_row: usize,
    color: &'a mut [u8],
    depth: &'a mut [f32],
    segmentation: &'a mut [u8],
}

impl Frame {
    fn new(camera: &PosedCamera) -> Self {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        Self {
            rgbd: Rgbd { color: RgbImage::new(width as u32, height as u32), depth_m: Array2::zeros((height, width)) },
            segmentation: GrayImage::from_pixel(width as u32, height as u32, image::Luma([BACKGROUND])),
        }
    }

    fn bands(&mut self, rows: usize) -> impl Iterator<Item = Band<'_>> {
        let area = (rows * self.segmentation.width() as usize).max(1);
        let depth = self.rgbd.depth_m.as_slice_mut().unwrap_or_default().chunks_mut(area);
        let color = self.rgbd.color.chunks_mut(3 * area);
        color
            .zip(depth)
            .zip(self.segmentation.chunks_mut(area))
            .enumerate()
            .map(move |(k, ((color, depth), segmentation))| Band { first_row: k * rows, color, depth, segmentation })
    }
}

/// A hand and an object before a camera. Instance 0 is the object, the others are the parts of the hand.
struct PosedScene<'a> {
    renderer: &'a Renderer,
    camera: &'a PosedCamera,
    instances: Vec<Instance<'a>>,
    /// Towards the key light, in the camera's frame.
    light: Vec3A,
}

impl PosedScene<'_> {
    fn render(&self, band: &mut Band<'_>, Scratch { caster, hits }: &mut Scratch) {
        let k = &self.camera.intrinsics;
        let rows = band.first_row..band.first_row + band.depth.len() / k.width.max(1);
        hits.reset(Window { columns: 0..k.width, rows });
        caster.cast(&self.instances, k, Faces::Both, hits);
        let (u, v) = hits.barycentric();
        for (pixel, color) in band.color.chunks_exact_mut(3).enumerate() {
            let row = band.first_row + pixel / k.width;
            let triangle = hits.triangle()[pixel];
            if triangle == MISS {
                color.fill(background(row, k.height));
                continue;
            }
            let instance = hits.instance()[pixel] as usize;
            band.depth[pixel] = hits.depth()[pixel];
            band.segmentation[pixel] = if instance == 0 { OBJECT } else { HAND };
            let placed = &self.instances[instance];
            let mesh = placed.mesh();
            let albedo = match instance.checked_sub(1) {
                None => self.renderer.texture.albedo(mesh.point(triangle, u[pixel], v[pixel])),
                Some(part) => surface_albedo(self.renderer.parts[part].0.surface),
            };
            let normal = placed.mesh_from_camera().transpose() * mesh.smooth_normal(triangle, u[pixel], v[pixel]);
            let towards_camera = -Vec3A::new(
                ((pixel % k.width) as f64 - k.cx) as f32 / k.fx as f32,
                -(row as f64 - k.cy) as f32 / k.fy as f32,
                -1.0,
            )
            .normalize();
            color.copy_from_slice(&shade(albedo, normal, self.light, towards_camera));
        }
    }
}

/// Key light, a weaker light at the camera, and light from everywhere; then the display's gamma.
fn shade(albedo: Vec3, normal: Vec3A, light: Vec3A, towards_camera: Vec3A) -> [u8; 3] {
    let facing = normal.dot(towards_camera);
    // A surface seen from behind (an open mesh) is lit as its front would be.
    let normal = if facing < 0.0 { -normal } else { normal };
    let brightness = 0.22 + 0.55 * normal.dot(light).max(0.0) + 0.28 * facing.abs();
    (albedo * brightness).to_array().map(|c| (c.clamp(0.0, 1.0).sqrt() * 255.0).round() as u8)
}

/// Linear albedo of the hand's materials.
fn surface_albedo(surface: PartSurface) -> Vec3 {
    match surface {
        PartSurface::Link => Vec3::new(0.05, 0.05, 0.055),
        PartSurface::Digit => Vec3::new(0.55, 0.56, 0.58),
        PartSurface::Gel => Vec3::new(0.75, 0.33, 0.09),
    }
}

/// A neutral wall that darkens towards the bottom.
fn background(row: usize, height: usize) -> u8 {
    (205 - 70 * row / height.max(1)) as u8
}

/// A solid texture in the object's own coordinates, so that turning can be seen: two colours in soft cells of some
/// centimetres, with finer mottling. Colours and offsets follow from the object's name.
#[derive(Debug, Clone, Copy)]
struct Texture {
    colors: [Vec3; 2],
    offset: Vec3A,
}

impl Texture {
    /// Cells per metre.
    const COARSE: f32 = 40.0;
    const FINE: f32 = 130.0;

    fn new(name: &str) -> Self {
        // FNV-1a: a few independent bytes from a name, the same everywhere.
        let hash =
            name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
        let byte = |k: u32| f32::from((hash >> (8 * k)) as u8) / 256.0;
        Self {
            colors: [hue(byte(0)), hue(byte(0) + 0.25 + 0.5 * byte(1)).lerp(Vec3::ONE, 0.35)],
            offset: Vec3A::new(byte(2), byte(3), byte(4)),
        }
    }

    fn albedo(&self, p: Vec3A) -> Vec3 {
        let cell = wave(p * Self::COARSE + self.offset).clamp(-0.08, 0.08) / 0.16 + 0.5;
        let mottle = 1.0 + 0.25 * wave(p * Self::FINE + self.offset);
        self.colors[0].lerp(self.colors[1], cell) * 0.7 * mottle
    }
}

/// Product of three triangle waves of period 2, between -1 and 1.
fn wave(p: Vec3A) -> f32 {
    let t = ((p * 0.5).fract_gl() - 0.5).abs() * 4.0 - 1.0;
    t.x * t.y * t.z
}

/// A saturated colour; hue counts full circles.
fn hue(turns: f32) -> Vec3 {
    let channel = |shift: f32| (((turns + shift).fract() * 6.0 - 3.0).abs() - 1.0).clamp(0.08, 1.0);
    Vec3::new(channel(0.0), channel(2.0 / 3.0), channel(1.0 / 3.0))
}
