//! Colour, depth and segmentation images of a hand and an object, all from one cast of rays.

use std::sync::Arc;

use glam::{Vec3, Vec3A};
use image::RgbImage;
use mvt_frames::camera::PosedCamera;
use mvt_frames::depth::Label;
use mvt_frames::{Isometry, Object as ObjectFrame, World};
use mvt_objects::object::Object;
use mvt_robot::hand::{Hand, PartSurface, Primitive};
use mvt_robot::observation::Rgbd;
use ndarray::Array2;
use pulp::Arch;
use rayon::prelude::*;

use crate::rays::{Caster, Faces, Hits, Instance, MISS, PixelWindow, RayMesh};
use crate::tessellation::tessellate;

/// Segments around the hand's rounded parts: their meshes deviate by up to 0.03 mm, a twentieth of the noise of a depth camera at 0.4 m. Twice as
/// many take half as long again.
const SEGMENTS: usize = 48;

/// Renderer of one hand and one object.
#[derive(Debug)]
pub struct Renderer {
    hand: Arc<Hand>,
    /// The parts of the hand.
    parts: Vec<PosedPart>,
    shapes: Vec<RayMesh>,
    object: RayMesh,
    texture: Texture,
}

/// Part of a hand: its body, its material and the mesh of its shape, by index. Parts of the same shape share a mesh.
#[derive(Debug)]
struct PosedPart {
    body: usize,
    surface: PartSurface,
    shape: usize,
}

/// Images of one camera, with the labels that only a simulator knows.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RenderedView {
    /// Colour and true depth.
    pub rgbd: Rgbd,
    /// What each pixel shows; never [`Label::Unsure`]. As large as the depth.
    pub labels: Array2<Label>,
}

/// Working memory of one thread: reuse it from view to view.
#[derive(Debug, Clone)]
pub struct CameraScratch {
    caster: Caster,
    hits: Hits,
}

impl Default for CameraScratch {
    fn default() -> Self {
        Self { caster: Caster::default(), hits: Hits::new(PixelWindow { columns: 0..0, rows: 0..0 }) }
    }
}

impl Renderer {
    /// Prepares the meshes in some tenths of a second of CPU time.
    pub fn new(hand: &Arc<Hand>, object: &Object) -> Self {
        let mut shapes: Vec<&Primitive> = Vec::new();
        let parts = hand
            .parts()
            .map(|(body, part)| {
                let known = shapes.iter().position(|shape| **shape == part.shape);
                let shape = known.unwrap_or_else(|| {
                    shapes.push(&part.shape);
                    shapes.len() - 1
                });
                PosedPart { body, surface: part.surface, shape }
            })
            .collect();
        let shapes = shapes.par_iter().map(|shape| RayMesh::new(&tessellate(shape, SEGMENTS))).collect();
        let (object, texture) = (RayMesh::new(&object.mesh), Texture::new(&object.name));
        Self { hand: Arc::clone(hand), parts, shapes, object, texture }
    }

    /// Renders the view of a camera on the calling thread.
    pub fn render(
        &self,
        camera: &PosedCamera,
        joints: &[f64],
        object_pose: Isometry<ObjectFrame, World>,
        scratch: &mut CameraScratch,
    ) -> RenderedView {
        let mut view = RenderedView::new(camera);
        self.pose(camera, joints, object_pose).render(&mut view, scratch);
        view
    }

    /// Returns the share of the object's pixels that the hand covers. `labels` are those of the
    /// view at that pose. Returns `None` if the object is out of view.
    pub fn hidden_share(
        &self,
        camera: &PosedCamera,
        object_pose: Isometry<ObjectFrame, World>,
        labels: &Array2<Label>,
        CameraScratch { caster, hits }: &mut CameraScratch,
    ) -> Option<f64> {
        let k = &camera.intrinsics;
        hits.reset(PixelWindow::whole(k));
        caster.cast(&[Instance::new(&self.object, camera.pose.inverse() * object_pose)], k, Faces::Both, hits);
        let alone = hits.triangle().iter().filter(|&&triangle| triangle != MISS).count();
        let seen = labels.iter().filter(|&&label| label == Label::Object).count();
        (alone > 0).then(|| 1.0 - seen as f64 / alone as f64)
    }

    fn pose<'a>(
        &'a self,
        camera: &'a PosedCamera,
        joints: &[f64],
        object_pose: Isometry<ObjectFrame, World>,
    ) -> PosedScene<'a> {
        let camera_from_world = camera.pose.inverse();
        let object = Instance::new(&self.object, camera_from_world * object_pose);
        let poses = self.hand.body_poses(joints);
        let hand = self.parts.iter().map(|part| {
            let pose = Isometry::<ObjectFrame, World>::new(poses[part.body]);
            Instance::new(&self.shapes[part.shape], camera_from_world * pose)
        });
        let (axes, _) = camera_from_world.to_f32();
        let light = axes * KEY_LIGHT.normalize();
        PosedScene { renderer: self, camera, instances: std::iter::once(object).chain(hand).collect(), light }
    }
}

/// Direction towards the key light in the world: above the fingers, to the left.
const KEY_LIGHT: Vec3A = Vec3A::new(0.5, 0.35, 0.8);

impl RenderedView {
    fn new(camera: &PosedCamera) -> Self {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        Self {
            rgbd: Rgbd {
                color: RgbImage::new(width as u32, height as u32),
                depth_m: Array2::zeros((height, width)),
                labels: None,
                world_from_camera: None,
            },
            labels: Array2::default((height, width)),
        }
    }
}

/// Hand and object in front of a camera. Instance 0 is the object, the others are the parts of the hand.
struct PosedScene<'a> {
    renderer: &'a Renderer,
    camera: &'a PosedCamera,
    instances: Vec<Instance<'a>>,
    /// Towards the key light, in the camera's frame.
    light: Vec3A,
}

impl PosedScene<'_> {
    /// Renders into a view that has the camera's size, is black and shows the background everywhere.
    fn render(&self, view: &mut RenderedView, CameraScratch { caster, hits }: &mut CameraScratch) {
        let k = &self.camera.intrinsics;
        let RenderedView { rgbd, labels } = view;
        let depth = rgbd.depth_m.as_slice_mut().unwrap_or_default();
        let labels = labels.as_slice_mut().unwrap_or_default();
        hits.reset(PixelWindow::whole(k));
        caster.cast(&self.instances, k, Faces::Both, hits);
        // Compiled for the machine's own vectors; a closure that is not inlined would not be. The pixels are the same.
        let width = k.width.max(1);
        Arch::new().dispatch(
            #[inline(always)]
            || {
                let rows = rgbd.color.chunks_exact_mut(3 * width).zip(depth.chunks_exact_mut(width));
                for (row, ((colors, depth), labels)) in rows.zip(labels.chunks_exact_mut(width)).enumerate() {
                    self.render_row(row, hits, colors, depth, labels);
                }
            },
        );
    }

    /// Fills a row of the image from the hits of its rays.
    #[inline(always)]
    fn render_row(&self, row: usize, hits: &Hits, colors: &mut [u8], depth: &mut [f32], labels: &mut [Label]) {
        let k = &self.camera.intrinsics;
        let (u, v) = hits.barycentric();
        for (column, color) in colors.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let pixel = row * k.width + column;
            let triangle = hits.triangle()[pixel];
            if triangle == MISS {
                color.fill(background(row, k.height));
                continue;
            }
            let instance = hits.instance()[pixel] as usize;
            depth[column] = hits.depth()[pixel];
            labels[column] = if instance == 0 { Label::Object } else { Label::Hand };
            let placed = &self.instances[instance];
            let mesh = placed.mesh();
            let albedo = match instance.checked_sub(1) {
                None => self.renderer.texture.albedo(mesh.point(triangle, u[pixel], v[pixel])),
                Some(part) => surface_albedo(self.renderer.parts[part].surface),
            };
            let normal = placed.mesh_from_camera().transpose() * mesh.smooth_normal(triangle, u[pixel], v[pixel]);
            let towards_camera = -Vec3A::new(
                (column as f64 - k.cx) as f32 / k.fx as f32,
                -(row as f64 - k.cy) as f32 / k.fy as f32,
                -1.0,
            )
            .normalize();
            *color = shade(albedo, normal, self.light, towards_camera);
        }
    }
}

/// Adds the key light, a weaker light at the camera and ambient light, and takes the square root as gamma.
fn shade(albedo: Vec3, normal: Vec3A, light: Vec3A, towards_camera: Vec3A) -> [u8; 3] {
    let facing = normal.dot(towards_camera);
    // The back of a surface, visible where a mesh is open, is lit like its front.
    let normal = if facing < 0.0 { -normal } else { normal };
    let brightness = 0.22 + 0.55 * normal.dot(light).max(0.0) + 0.28 * facing.abs();
    // Half a level is added and the rest cut off: `round` is a call of the C library.
    (albedo * brightness).to_array().map(|c| (c.clamp(0.0, 1.0).sqrt() * 255.0 + 0.5) as u8)
}

/// Returns the linear albedo of a material of the hand: black links, grey housings, orange gels.
fn surface_albedo(surface: PartSurface) -> Vec3 {
    match surface {
        PartSurface::Link => Vec3::new(0.05, 0.05, 0.055),
        PartSurface::Housing => Vec3::new(0.55, 0.56, 0.58),
        PartSurface::Gel(_) => Vec3::new(0.75, 0.33, 0.09),
    }
}

/// Returns the grey level of a neutral wall that darkens towards the bottom.
fn background(row: usize, height: usize) -> u8 {
    (205 - 70 * row / height.max(1)) as u8
}

/// Solid texture in the object's own coordinates, which makes rotations visible: two colours in soft cells of some
/// centimetres, with finer mottling. Colours and offsets follow from the object's name.
#[derive(Debug, Clone, Copy)]
struct Texture {
    colors: [Vec3; 2],
    offset: Vec3A,
}

impl Texture {
    /// Frequency of the cells, half periods per metre.
    const COARSE: f32 = 40.0;
    /// Frequency of the mottling, half periods per metre.
    const FINE: f32 = 130.0;

    fn new(name: &str) -> Self {
        // FNV-1a: a few independent bytes from a name, the same on every machine.
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

/// Returns the product of three triangle waves of period 2, between -1 and 1.
fn wave(p: Vec3A) -> f32 {
    let t = ((p * 0.5).fract_gl() - 0.5).abs() * 4.0 - 1.0;
    t.x * t.y * t.z
}

/// Returns a saturated colour; its hue is given in full turns.
fn hue(turns: f32) -> Vec3 {
    let channel = |shift: f32| (((turns + shift).fract() * 6.0 - 3.0).abs() - 1.0).clamp(0.08, 1.0);
    Vec3::new(channel(0.0), channel(2.0 / 3.0), channel(1.0 / 3.0))
}
