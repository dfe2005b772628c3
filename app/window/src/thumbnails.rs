//! Small pictures of the objects of the catalogue, which a thread draws one after the other.

use std::collections::HashMap;
use std::sync::mpsc::{self, Receiver};
use std::thread;

use eframe::egui::{Color32, ColorImage, Context, TextureHandle, TextureOptions};
use glam::{Vec3, Vec3A};
use mvt_frames::camera::{Intrinsics, look_at};
use mvt_frames::{Isometry, Object, World};
use mvt_mesh::Mesh;
use mvt_objects::catalogue::Entry;
use mvt_render::rays::{Caster, Faces, Hits, Instance, MISS, PixelWindow, RayMesh};
use nalgebra::Vector3;

/// Side of a picture, pixels.
const SIDE: usize = 128;

/// Pictures by name of the object.
pub struct Thumbnails {
    done: HashMap<&'static str, Option<TextureHandle>>,
    coming: Receiver<(&'static str, Option<ColorImage>)>,
}

impl Thumbnails {
    /// Starts the thread that draws.
    pub fn new(ctx: &Context, entries: Vec<Entry>) -> Self {
        Self { done: HashMap::new(), coming: draw(ctx, entries) }
    }

    /// Draws the pictures that were missing, once the thread has finished.
    pub fn look_again(&mut self, ctx: &Context, entries: &[Entry]) {
        self.update(ctx);
        let is_missing = |entry: &&Entry| self.done.get(entry.name).is_some_and(Option::is_none);
        let missing: Vec<Entry> = entries.iter().filter(is_missing).copied().collect();
        if self.done.len() == entries.len() && !missing.is_empty() {
            self.coming = draw(ctx, missing);
        }
    }

    /// Takes finished pictures.
    pub fn update(&mut self, ctx: &Context) {
        for (name, picture) in self.coming.try_iter() {
            let texture = picture.map(|picture| ctx.load_texture(name, picture, TextureOptions::LINEAR));
            self.done.insert(name, texture);
        }
    }

    /// Returns the picture of an object, if it has one and it is finished.
    pub fn get(&self, name: &str) -> Option<&TextureHandle> {
        self.done.get(name)?.as_ref()
    }

    /// Whether the thread has handled an object.
    #[cfg(test)]
    pub fn has_come(&self, name: &str) -> bool {
        self.done.contains_key(name)
    }

    /// Whether the object's mesh is on this machine, or not yet known to be missing.
    pub fn is_here(&self, name: &str) -> bool {
        self.done.get(name).is_none_or(Option::is_some)
    }
}

/// Starts a thread that draws pictures.
fn draw(ctx: &Context, entries: Vec<Entry>) -> Receiver<(&'static str, Option<ColorImage>)> {
    let (sender, coming) = mpsc::channel();
    let ctx = ctx.clone();
    thread::spawn(move || {
        for entry in entries {
            let picture = entry.mesh_without_download().as_ref().and_then(picture);
            // Nobody waits for pictures any more.
            if sender.send((entry.name, picture)).is_err() {
                return;
            }
            ctx.request_repaint();
        }
    });
    coming
}

/// Draws a mesh from obliquely above on a transparent background.
fn picture(mesh: &Mesh) -> Option<ColorImage> {
    const FOV_RAD: f64 = 0.4;
    let [low, high] = mesh.bounds_m().map(Vec3::as_dvec3);
    let radius_m = 0.5 * (high - low).length();
    if !radius_m.is_finite() || radius_m <= 0.0 {
        return None;
    }
    let centre = 0.5 * (low + high);
    let target = Vector3::new(centre.x, centre.y, centre.z);
    let out = Vector3::new(0.75, 0.45, 0.5).normalize() * (radius_m / (0.5 * FOV_RAD).sin());
    let world_from_camera = look_at(target + out, target, Vector3::z());
    let camera_from_mesh = world_from_camera.inverse() * Isometry::<Object, World>::identity();
    let rays = RayMesh::new(mesh);
    let instance = Instance::new(&rays, camera_from_mesh);
    let intrinsics = Intrinsics::from_fov_y(SIDE, SIDE, FOV_RAD);
    let mut hits = Hits::new(PixelWindow::whole(&intrinsics));
    Caster::default().cast(&[instance], &intrinsics, Faces::Both, &mut hits);
    let light = instance.mesh_from_camera() * Vec3A::new(-0.35, 0.6, 0.75).normalize();
    let colour = |&triangle: &u32| {
        let face = (triangle != MISS).then(|| mesh.faces.get(rays.face(triangle) as usize)).flatten();
        let corners = face.and_then(|face| {
            let [a, b, c] = face.map(|k| mesh.vertices.get(k as usize).copied());
            Some([a?, b?, c?])
        });
        let Some([a, b, c]) = corners else { return Color32::TRANSPARENT };
        let normal = Vec3A::from((b - a).cross(c - a).normalize_or_zero());
        let brightness = 0.4 + 0.6 * normal.dot(light).abs();
        let [r, g, b] = [152.0, 178.0, 206.0].map(|c: f32| (c * brightness) as u8);
        Color32::from_rgb(r, g, b)
    };
    let pixels = hits.triangle().iter().map(colour).collect();
    Some(ColorImage::new([SIDE, SIDE], pixels))
}
