//! `mesh.gif`: the estimated surface turns beside the true one, coloured by its error.

use std::f64::consts::TAU;

use anyhow::Result;
use glam::{Vec3, Vec3A};
use image::{Rgb, RgbImage};
use mvt_frames::camera::{Intrinsics, look_at};
use mvt_frames::{Camera, Isometry, Object, World};
use mvt_mesh::Mesh;
use mvt_mesh::SignedDistance;
use mvt_objects::distance::MeshDistance;
use mvt_objects::object::Object as TrueObject;
use mvt_picture::film::GifWriter;
use mvt_picture::palette::{self, ERROR_SCALE_M, Theme};
use mvt_picture::raster::{self, Colour, LitMesh, MeshPlacement, Rasteriser};
use mvt_picture::{draw, text};
use nalgebra::Vector3;
use rayon::prelude::*;

/// Views of one turn.
const VIEWS: u32 = 48;
/// Views per second.
const RATE_HZ: f64 = 12.5;
/// Every Nth view is used to choose the colours.
const SAMPLED: usize = 12;
/// Side of either picture, pixels.
const SIDE: u32 = 240;
/// Samples per pixel along either side.
const SAMPLES: u32 = 2;
/// Height of the strip with the scale, pixels.
const STRIP: u32 = 34;
const FOV_RAD: f64 = 0.5;
const ELEVATION_RAD: f64 = 0.45;
const PAPER: Rgb<u8> = Theme::LIGHT.paper;
const INK: Rgb<u8> = Theme::LIGHT.ink;
const TRUE_COLOUR: Rgb<u8> = Rgb([176, 186, 196]);

/// Animation of an estimated surface beside the true one.
#[derive(Debug)]
pub struct Turntable<'a> {
    /// The estimated surface.
    pub estimate: &'a Mesh,
    /// Error of each of its vertices, metres; see [`vertex_errors_m`].
    pub errors_m: &'a [f32],
    /// Motion that aligns the estimated surface with the true one.
    pub object_from_estimate: Isometry<Object, Object>,
    /// The true surface.
    pub truth: &'a Mesh,
}

/// Returns the distance of each vertex from the surface of an object, metres, positive on both sides.
pub fn vertex_errors_m(
    estimate: &Mesh,
    object_from_estimate: Isometry<Object, Object>,
    truth: &TrueObject,
) -> Vec<f32> {
    let of_mesh = if truth.exact.is_none() { MeshDistance::new(&truth.mesh) } else { None };
    let surface = truth.exact.as_deref().or(of_mesh.as_ref().map(|mesh| mesh as &dyn SignedDistance));
    let Some(surface) = surface else { return vec![f32::INFINITY; estimate.vertices.len()] };
    let error = |v: &Vec3| {
        let [x, y, z] = v.to_array().map(f64::from);
        surface.distance_m(object_from_estimate * mvt_frames::Point::new(x, y, z)).abs() as f32
    };
    estimate.vertices.par_iter().map(error).collect()
}

impl Turntable<'_> {
    /// Returns the animation as a GIF, 480 x 274 pixels, one turn in about four seconds. It is the same for any number
    /// of threads.
    ///
    /// # Errors
    /// If the encoder fails.
    pub fn gif(&self) -> Result<Vec<u8>> {
        let views = self.views();
        let samples: Vec<RgbImage> = views.iter().step_by(SAMPLED).cloned().collect();
        let mut gif = GifWriter::new(Vec::new(), [2 * SIDE, SIDE + STRIP], RATE_HZ, &samples)?;
        for view in &views {
            gif.push(view)?;
        }
        Ok(gif.finish()?)
    }

    fn views(&self) -> Vec<RgbImage> {
        let [estimate, truth] = [self.estimate, self.truth].map(CreasedMesh::new);
        let backdrop = backdrop();
        // The true object fills the picture; parts of the estimate far from it may be cut off.
        let [low, high] = self.truth.bounds_m().map(Vec3::as_dvec3);
        let (centre, radius_m) = (0.5 * (low + high), (0.5 * (high - low).length()).max(1e-3));
        let distance_m = 1.08 * radius_m / (0.5 * FOV_RAD).sin();
        let error_colour = |vertex: usize| {
            raster::colour(palette::surface_error(self.errors_m.get(vertex).copied().unwrap_or(f32::INFINITY)))
        };
        let true_colour = raster::colour(TRUE_COLOUR);
        let view = |raster: &mut Rasteriser, k: u32| {
            let (sin, cos) = (TAU * f64::from(k) / f64::from(VIEWS)).sin_cos();
            let out = Vector3::new(ELEVATION_RAD.cos() * cos, ELEVATION_RAD.cos() * sin, ELEVATION_RAD.sin());
            let target = Vector3::new(centre.x, centre.y, centre.z);
            let world_from_camera = look_at(target + distance_m * out, target, Vector3::z());
            let camera_from_object = world_from_camera.inverse() * Isometry::<Object, World>::identity();
            let mut image = backdrop.clone();
            estimate.draw(raster, camera_from_object * self.object_from_estimate, error_colour, &mut image, 0);
            truth.draw(raster, camera_from_object, |_| true_colour, &mut image, SIDE);
            image
        };
        (0..VIEWS).into_par_iter().map_init(Rasteriser::default, view).collect()
    }
}

/// A mesh that is smooth except where it has an edge.
struct CreasedMesh {
    surface: LitMesh,
    /// The vertex of the mesh for each of the surface.
    vertices: Vec<usize>,
}

impl CreasedMesh {
    /// Faces that meet at an edge get vertices of their own there. Faces with an invalid vertex are left out.
    fn new(mesh: &Mesh) -> Self {
        /// Cosine of the smallest angle of an edge, 40 degrees.
        const EDGE: f32 = 0.77;
        let smooth = LitMesh::new(mesh);
        let mut vertices: Vec<usize> = (0..mesh.vertices.len()).collect();
        let is_whole = |face: &&[u32; 3]| face.iter().all(|&k| (k as usize) < mesh.vertices.len());
        let mut faces: Vec<[u32; 3]> = mesh.faces.iter().filter(is_whole).copied().collect();
        for face in &mut faces {
            let [a, b, c] = face.map(|k| Vec3A::from(mesh.vertices[k as usize]));
            let flat = (b - a).cross(c - a).normalize_or_zero();
            for corner in face {
                let vertex = *corner as usize;
                if smooth.normals()[vertex].dot(flat) <= EDGE {
                    *corner = vertices.len() as u32;
                    vertices.push(vertex);
                }
            }
        }
        let creased = Mesh { vertices: vertices.iter().map(|&vertex| mesh.vertices[vertex]).collect(), faces };
        Self { surface: LitMesh::new(&creased), vertices }
    }

    /// Draws it into the square that begins at column `left`.
    fn draw(
        &self,
        raster: &mut Rasteriser,
        camera_from_mesh: Isometry<Object, Camera>,
        colour: impl Fn(usize) -> Colour + Sync,
        image: &mut RgbImage,
        left: u32,
    ) {
        let side = (SIDE * SAMPLES) as usize;
        raster.begin(&Intrinsics::from_fov_y(side, side, FOV_RAD), PAPER);
        let placement = MeshPlacement { camera_from_mesh: camera_from_mesh.to_f32(), is_glass: false, shine: 0.0 };
        raster.surface(&self.surface, |k| colour(self.vertices[k]), placement);
        let square = draw::shrink(raster.finish(0.0), SAMPLES);
        for (x, y, pixel) in square.enumerate_pixels().filter(|(.., pixel)| **pixel != PAPER) {
            image.put_pixel(left + x, y, *pixel);
        }
    }
}

/// Draws the parts that all views share: names and scale.
fn backdrop() -> RgbImage {
    let mut image = RgbImage::from_pixel(2 * SIDE, SIDE + STRIP, PAPER);
    let size = 15.0;
    for (left, name) in [(0, "estimate"), (SIDE, "truth")] {
        text::write(&mut image, (left + 8, 6), size, INK, name);
    }
    let (bar_left, bar_width, top) = (SIDE / 2 + 40, SIDE, SIDE + 4);
    for (x, y) in (0..bar_width).flat_map(|x| (0..10).map(move |y| (x, y))) {
        let error_m = ERROR_SCALE_M * x as f32 / (bar_width - 1) as f32;
        image.put_pixel(bar_left + x, top + y, palette::surface_error(error_m));
    }
    let full_scale_mm = (ERROR_SCALE_M * 1e3).round() as u32;
    for mm in 0..=full_scale_mm {
        let label = if mm == full_scale_mm { format!("{mm}+") } else { mm.to_string() };
        let x = bar_left + mm * (bar_width - 1) / full_scale_mm;
        let half = text::width(size, &label) / 2;
        text::write(&mut image, (x.saturating_sub(half), top + 11), size, INK, &label);
    }
    text::write(&mut image, (bar_left - 78, top - 4), size, INK, "error, mm");
    image
}
