//! Triangles, lines and points with a depth buffer, on the CPU. It needs no graphics driver, so that pictures are the
//! same on every machine, and it is faster than the software drivers of machines without a graphics card.
//!
//! Everything becomes triangles in screen coordinates, which are sorted into bands of rows; one thread draws each band.
//! The first of equally near triangles wins, so that the picture does not depend on the number of threads.

// Why: notes/decisions/viewing.md, "Our own rasteriser".

use glam::{Mat3A, Vec2, Vec3, Vec3A};
use image::{Rgb, RgbImage};
use mvt_frames::camera::Intrinsics;
use mvt_mesh::Mesh;
use rayon::prelude::*;

use crate::cut_plane::{CutPlane, fan, split};
use crate::occlusion::DepthBuffer;

/// Rows of a band.
const BAND: usize = 24;
/// Distance of the near plane, metres. Geometry in front of it is cut off.
const NEAR_M: f32 = 0.005;
/// Lines and points hide surfaces that are nearer by less than this share of their distance, because they often lie on
/// a surface.
const LINE_BIAS: f32 = 0.004;

/// Share of the nearness of a block's nearest pixel above which another pixel shows the same surface.
const SAME_SURFACE: f32 = 0.97;
/// Width of highlights: the power of the cosine between the normal and the middle of light and eye.
const GLOSS: i32 = 24;

/// Colour of three numbers from 0 to 255.
pub type Colour = Vec3A;

/// Converts a colour for the rasteriser.
pub fn colour(rgb: Rgb<u8>) -> Colour {
    let [r, g, b] = rgb.0.map(f32::from);
    Vec3A::new(r, g, b)
}

/// Mesh with the normals that its lighting needs.
#[derive(Debug, Clone, Default)]
pub struct LitMesh {
    vertices: Vec<Vec3A>,
    normals: Vec<Vec3A>,
    faces: Vec<[u32; 3]>,
    /// Whether it encloses a volume, so that faces seen from behind are hidden.
    is_closed: bool,
}

impl LitMesh {
    /// Prepares a mesh. Faces with an invalid vertex index are left out.
    pub fn new(mesh: &Mesh) -> Self {
        let vertices: Vec<Vec3A> = mesh.vertices.iter().copied().map(Vec3A::from).collect();
        let is_whole = |face: &&[u32; 3]| face.iter().all(|&corner| (corner as usize) < vertices.len());
        let faces: Vec<[u32; 3]> = mesh.faces.iter().filter(is_whole).copied().collect();
        let mut normals = vec![Vec3A::ZERO; vertices.len()];
        for face in &faces {
            let [a, b, c] = face.map(|corner| vertices[corner as usize]);
            // The length grows with the area, so that large faces weigh more.
            let normal = (b - a).cross(c - a);
            face.iter().for_each(|&corner| normals[corner as usize] += normal);
        }
        normals.iter_mut().for_each(|normal| *normal = normal.normalize_or_zero());
        let is_closed = faces.len() == mesh.faces.len() && mesh.edges().watertight();
        Self { vertices, normals, faces, is_closed }
    }

    /// Returns the vertices.
    pub fn vertices(&self) -> &[Vec3A] {
        &self.vertices
    }

    /// Returns the outward unit normals of the vertices; zero for a vertex without faces.
    pub fn normals(&self) -> &[Vec3A] {
        &self.normals
    }
}

/// Vertex on the screen.
#[derive(Debug, Clone, Copy)]
struct Corner {
    /// Column and row.
    at: Vec2,
    /// One over the depth along the optical axis, 1/m: linear over the screen.
    nearness: f32,
    colour: Colour,
}

/// Triangles that are drawn together.
#[derive(Default)]
struct Batch {
    corners: Vec<Corner>,
    faces: Vec<[u32; 3]>,
    /// Faces that reach into each band.
    bands: Vec<Vec<u32>>,
}

impl Batch {
    fn clear(&mut self) {
        self.corners.clear();
        self.faces.clear();
    }

    fn sort(&mut self, height: usize) {
        self.bands.resize_with(height.div_ceil(BAND), Vec::new);
        self.bands.iter_mut().for_each(Vec::clear);
        for (k, face) in (0u32..).zip(&self.faces) {
            let rows = face.map(|corner| self.corners[corner as usize].at.y);
            let low = rows[0].min(rows[1]).min(rows[2]).max(0.0);
            let high = rows[0].max(rows[1]).max(rows[2]).min(height as f32 - 1.0);
            // Written so that NaN fails. Between two rows there is no pixel.
            if high.floor() >= low.ceil() {
                for band in low.ceil() as usize / BAND..=high as usize / BAND {
                    self.bands[band].push(k);
                }
            }
        }
    }
}

/// Rasteriser of pictures. It reuses its memory from one picture to the next.
#[derive(Default)]
pub struct Rasteriser {
    image: RgbImage,
    /// One over the depth of the nearest surface, 1/m; 0 for the background.
    nearness: Vec<f32>,
    solid: Batch,
    glass: Batch,
    pinhole: Option<Pinhole>,
    paper: Colour,
}

#[derive(Clone, Copy)]
struct Pinhole {
    focal: Vec2,
    centre: Vec2,
}

/// Pose of a mesh and whether it is translucent.
#[derive(Clone, Copy)]
pub struct MeshPlacement {
    /// Rotation and translation from the mesh to the camera (OpenGL axes).
    pub camera_from_mesh: (Mat3A, Vec3A),
    /// Whether surfaces behind it shine through.
    pub is_glass: bool,
    /// Brightness of its highlights, 0 (chalk) to 1 (polished).
    pub shine: f32,
}

impl Rasteriser {
    /// Begins a picture of this camera on a background colour.
    pub fn begin(&mut self, camera: &Intrinsics, paper: Rgb<u8>) {
        let size = (camera.width as u32, camera.height as u32);
        if self.image.dimensions() != size {
            self.image = RgbImage::new(size.0, size.1);
        }
        self.nearness.clear();
        self.nearness.resize(camera.width * camera.height, 0.0);
        self.solid.clear();
        self.glass.clear();
        self.paper = colour(paper);
        let vector = |x: f64, y: f64| Vec2::new(x as f32, y as f32);
        self.pinhole = Some(Pinhole { focal: vector(camera.fx, camera.fy), centre: vector(camera.cx, camera.cy) });
    }

    /// Adds a mesh with a colour per vertex. The light comes from over the viewer's left shoulder and lights both sides
    /// of a face.
    pub fn surface(&mut self, surface: &LitMesh, colours: impl Fn(usize) -> Colour + Sync, placement: MeshPlacement) {
        let Some(pinhole) = self.pinhole else { return };
        let (rotation, translation) = placement.camera_from_mesh;
        let batch = if placement.is_glass { &mut self.glass } else { &mut self.solid };
        let first = batch.corners.len() as u32;
        let corner = |(k, (&vertex, &normal)): (usize, (&Vec3A, &Vec3A))| {
            let point = rotation * vertex + translation;
            pinhole.corner(point, lit(colours(k), placement.shine, rotation * normal, point))
        };
        let vertices = surface.vertices.par_iter().with_min_len(4096).zip(&surface.normals).enumerate();
        batch.corners.par_extend(vertices.map(corner));
        let corners = &batch.corners[first as usize..];
        if corners.iter().all(|corner| (0.0..1.0 / NEAR_M).contains(&corner.nearness)) {
            let is_seen = |face: &&[u32; 3]| {
                let [a, b, c] = face.map(|corner| corners[corner as usize].at);
                // Rows count downwards.
                !surface.is_closed || (b - a).perp_dot(c - a) < 0.0
            };
            batch.faces.extend(surface.faces.iter().filter(is_seen).map(|face| face.map(|corner| corner + first)));
            return;
        }
        for face in &surface.faces {
            let points = face.map(|corner| rotation * surface.vertices[corner as usize] + translation);
            let corners = face.map(|corner| batch.corners[(corner + first) as usize].colour);
            if points.iter().all(|point| -point.z >= NEAR_M) {
                batch.faces.push(face.map(|corner| corner + first));
            } else {
                cut(batch, pinhole, points, corners);
            }
        }
    }

    /// Adds the part of a mesh on one side of a plane, as [`Rasteriser::surface`] does. Both sides of its faces are drawn,
    /// because one can look into it.
    pub fn cut_surface(
        &mut self,
        surface: &LitMesh,
        colours: impl Fn(usize) -> Colour + Sync,
        placement: MeshPlacement,
        plane: CutPlane,
    ) {
        let Some(pinhole) = self.pinhole else { return };
        let (rotation, translation) = placement.camera_from_mesh;
        let batch = if placement.is_glass { &mut self.glass } else { &mut self.solid };
        let corner = |(k, (&vertex, &normal)): (usize, (&Vec3A, &Vec3A))| {
            let point = rotation * vertex + translation;
            (plane.above_m(vertex), point, lit(colours(k), placement.shine, rotation * normal, point))
        };
        let vertices = surface.vertices.par_iter().with_min_len(4096).zip(&surface.normals).enumerate();
        let corners: Vec<(f32, Vec3A, Colour)> = vertices.map(corner).collect();
        for face in &surface.faces {
            let [a, b, c] = face.map(|corner| corners[corner as usize]);
            let [below, _] = split([a, b, c]);
            for triangle in fan(&below) {
                cut(batch, pinhole, triangle.map(|corner| corner.0), triangle.map(|corner| corner.1));
            }
        }
    }

    /// Adds an unlit triangle in the coordinates of the camera.
    pub fn flat(&mut self, points: [Vec3A; 3], colours: [Colour; 3], is_glass: bool) {
        let Some(pinhole) = self.pinhole else { return };
        cut(if is_glass { &mut self.glass } else { &mut self.solid }, pinhole, points, colours);
    }

    /// Adds a line between two points in the coordinates of the camera, `width` pixels wide.
    pub fn line(&mut self, mut ends: [Vec3A; 2], colour: Colour, width: f32) {
        let Some(pinhole) = self.pinhole else { return };
        if -ends[0].z < -ends[1].z {
            ends.swap(0, 1);
        }
        // The near end may be cut off.
        let [far, near] = ends;
        if !far.is_finite() || !near.is_finite() || -far.z <= NEAR_M {
            return;
        }
        let near = if -near.z < NEAR_M { far.lerp(near, (-far.z - NEAR_M) / (near.z - far.z)) } else { near };
        let [a, b] = [far, near].map(|point| pinhole.corner(point * (1.0 - LINE_BIAS), colour));
        let across = (b.at - a.at).perp().normalize_or(Vec2::X) * (0.5 * width);
        self.quad([(a, across), (b, across), (b, -across), (a, -across)]);
    }

    /// Adds a square dot around a point in the coordinates of the camera, `width` pixels wide.
    pub fn dot(&mut self, point: Vec3A, colour: Colour, width: f32) {
        let Some(pinhole) = self.pinhole else { return };
        if -point.z > NEAR_M {
            let (at, half) = (pinhole.corner(point * (1.0 - LINE_BIAS), colour), 0.5 * width);
            let around = [(-half, -half), (half, -half), (half, half), (-half, half)];
            self.quad(around.map(|(x, y)| (at, Vec2::new(x, y))));
        }
    }

    fn quad(&mut self, corners: [(Corner, Vec2); 4]) {
        let first = self.solid.corners.len() as u32;
        self.solid.corners.extend(corners.map(|(corner, by)| Corner { at: corner.at + by, ..corner }));
        self.solid.faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }

    /// Draws everything that was added and returns the picture. Only the nearest translucent surface of a pixel is
    /// drawn; `glass_share` is the weight of its colour, 0 to 1.
    pub fn finish(&mut self, glass_share: f32) -> &RgbImage {
        let (width, height) = (self.image.width() as usize, self.image.height() as usize);
        if width == 0 || height == 0 {
            return &self.image;
        }
        let Self { image, nearness, solid, glass, paper, .. } = self;
        solid.sort(height);
        glass.sort(height);
        let (solid, glass, paper) = (&*solid, &*glass, *paper);
        let pixels = image.par_chunks_mut(3 * width * BAND).zip(nearness.par_chunks_mut(width * BAND));
        pixels.enumerate().for_each_init(Vec::new, |colours: &mut Vec<Colour>, (band, (pixels, nearness))| {
            let top = band * BAND;
            colours.clear();
            colours.resize(nearness.len(), paper);
            for &face in &solid.bands[band] {
                let corners = solid.faces[face as usize].map(|corner| solid.corners[corner as usize]);
                fill(corners, width, top, nearness, colours, |below, above| *below = above);
            }
            if !glass.bands[band].is_empty() {
                // Drawn into a separate buffer, so that overlapping panes are blended once.
                let mut before = nearness.to_vec();
                let mut panes = vec![Vec3A::NAN; nearness.len()];
                for &face in &glass.bands[band] {
                    let corners = glass.faces[face as usize].map(|corner| glass.corners[corner as usize]);
                    fill(corners, width, top, &mut before, &mut panes, |below, above| *below = above);
                }
                for (below, pane) in colours.iter_mut().zip(panes).filter(|(_, pane)| !pane.is_nan()) {
                    *below += (pane - *below) * glass_share;
                }
            }
            for (pixel, colour) in pixels.as_chunks_mut::<3>().0.iter_mut().zip(&*colours) {
                *pixel = colour.to_array().map(|c| (c + 0.5) as u8);
            }
        });
        &self.image
    }

    /// Darkens the finished picture where surfaces hide the sky from one another (see [`crate::occlusion`]). Each block of `block` x
    /// `block` pixels is lit by its nearest pixel, so that a picture that will be shrunk by that factor takes no longer.
    pub fn occlude(&mut self, block: usize) -> &RgbImage {
        let (Some(pinhole), block, width) = (self.pinhole, block.max(1), self.image.width() as usize) else {
            return &self.image;
        };
        if width == 0 {
            return &self.image;
        }
        let nearness = self.nearness.as_slice();
        let depths = DepthBuffer { nearness, width, focal: pinhole.focal.x };
        self.image.par_chunks_mut(3 * width * block).enumerate().for_each(|(band, rows)| {
            let (top, height) = (band * block, rows.len() / (3 * width));
            for left in (0..width).step_by(block) {
                let block = || {
                    let columns = left..(left + block).min(width);
                    (0..height).flat_map(move |y| columns.clone().map(move |x| (x, y)))
                };
                let near = |(x, y): (usize, usize)| nearness[x + (top + y) * width];
                let Some((x, y)) = block().max_by(|&a, &b| near(a).total_cmp(&near(b))) else { continue };
                let nearest = near((x, y));
                let sky = depths.sky(x, top + y);
                if sky >= 1.0 {
                    continue;
                }
                // A surface behind an outline keeps its light.
                for (x, y) in block().filter(|&pixel| near(pixel) > SAME_SURFACE * nearest) {
                    let at = 3 * (x + y * width);
                    rows[at..at + 3].iter_mut().for_each(|c| *c = (f32::from(*c) * sky + 0.5) as u8);
                }
            }
        });
        &self.image
    }

    /// Returns the depth at a pixel (column, row), metres along the optical axis; `None` for the background.
    #[cfg(test)]
    fn depth_m(&self, x: usize, y: usize) -> Option<f32> {
        let nearness = self.nearness[x + y * self.image.width() as usize];
        (nearness > 0.0).then(|| 1.0 / nearness)
    }
}

impl Pinhole {
    fn corner(self, point: Vec3A, colour: Colour) -> Corner {
        let nearness = 1.0 / -point.z;
        let at = self.centre + Vec2::new(point.x, -point.y) * nearness * self.focal;
        Corner { at, nearness, colour }
    }
}

/// Lights a colour: ambient light, most light from over the left shoulder, and some from the eye. Highlights are white (Blinn 1977).
fn lit(colour: Colour, shine: f32, normal: Vec3A, point: Vec3A) -> Colour {
    const LIGHT: Vec3A = Vec3A::new(-0.35, 0.55, 0.76);
    let normal = if normal.dot(point) > 0.0 { -normal } else { normal };
    let brightness = 0.42 + 0.43 * normal.dot(LIGHT).max(0.0) + 0.17 * normal.z.abs();
    let mut shone = colour * brightness;
    if shine > 0.0 {
        let middle = (LIGHT.normalize_or_zero() - point.normalize_or_zero()).normalize_or_zero();
        shone += Vec3A::splat(255.0 * shine * normal.dot(middle).max(0.0).powi(GLOSS));
    }
    shone.min(Vec3A::splat(255.0))
}

/// Adds the part of a triangle beyond the near plane.
fn cut(batch: &mut Batch, pinhole: Pinhole, points: [Vec3A; 3], colours: [Colour; 3]) {
    let first = batch.corners.len() as u32;
    let mut count = 0;
    for k in 0..3 {
        let ([p, q], [a, b]) = ([points[k], points[(k + 1) % 3]], [colours[k], colours[(k + 1) % 3]]);
        let [is_beyond, next_is] = [p, q].map(|point| -point.z >= NEAR_M);
        if is_beyond {
            batch.corners.push(pinhole.corner(p, a));
            count += 1;
        }
        if is_beyond != next_is {
            let along = (-NEAR_M - p.z) / (q.z - p.z);
            batch.corners.push(pinhole.corner(p.lerp(q, along), a.lerp(b, along)));
            count += 1;
        }
    }
    batch.faces.extend((2..count).map(|k| [first, first + k - 1, first + k]));
}

/// Draws a triangle into the band whose first row is `top`.
fn fill(
    [a, b, c]: [Corner; 3],
    width: usize,
    top: usize,
    nearness: &mut [f32],
    colours: &mut [Colour],
    lay: impl Fn(&mut Colour, Colour),
) {
    let area = (b.at - a.at).perp_dot(c.at - a.at);
    let low = a.at.min(b.at).min(c.at).ceil().max(Vec2::new(0.0, top as f32));
    let bottom = (top + nearness.len() / width) as f32 - 1.0;
    let high = a.at.max(b.at).max(c.at).floor().min(Vec2::new(width as f32 - 1.0, bottom));
    // Written so that NaN fails.
    if !(area.abs() > 1e-9 && low.x <= high.x && low.y <= high.y) {
        return;
    }
    // The weights of the second and third corner, and all that they interpolate, are linear over the screen.
    let scale = 1.0 / area;
    let (step_b, step_c) = ((c.at - a.at) * scale, (b.at - a.at) * scale);
    let (by_b, by_c) = (b.nearness - a.nearness, c.nearness - a.nearness);
    for y in low.y as usize..=high.y as usize {
        let row = (y - top) * width;
        for x in low.x as usize..=high.x as usize {
            let from_a = Vec2::new(x as f32, y as f32) - a.at;
            let (v, w) = (from_a.perp_dot(step_b), step_c.perp_dot(from_a));
            if v < 0.0 || w < 0.0 || v + w > 1.0 {
                continue;
            }
            let near = a.nearness + v * by_b + w * by_c;
            if near > nearness[row + x] {
                nearness[row + x] = near;
                lay(&mut colours[row + x], a.colour + (b.colour - a.colour) * v + (c.colour - a.colour) * w);
            }
        }
    }
}

/// Applies a rotation and a translation to a point.
pub fn place((rotation, translation): (Mat3A, Vec3A), point: Vec3) -> Vec3A {
    rotation * Vec3A::from(point) + translation
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvt_frames::camera::look_at;
    use mvt_frames::{Camera, Isometry, Object, World};
    use mvt_render::rays::{Caster, Faces, Hits, Instance, MISS, PixelWindow, RayMesh};
    use mvt_render::tessellation::tessellate;
    use mvt_robot::hand::{Primitive, UPRIGHT};
    use nalgebra::Vector3;

    const PAPER: Rgb<u8> = Rgb([250, 250, 248]);

    fn camera() -> Intrinsics {
        Intrinsics::from_fov_y(320, 240, 0.6)
    }

    fn placed(eye: [f64; 3]) -> Isometry<Object, Camera> {
        let pose = look_at(Vector3::from(eye), Vector3::zeros(), Vector3::z());
        pose.inverse() * Isometry::<Object, World>::identity()
    }

    fn solid(camera_from_mesh: (Mat3A, Vec3A)) -> MeshPlacement {
        MeshPlacement { camera_from_mesh, is_glass: false, shine: 0.0 }
    }

    fn shapes() -> [Mesh; 3] {
        [
            Primitive::Ellipsoid { centre: [0.0, 0.01, 0.0], semi: [0.03, 0.05, 0.02], orientation_wxyz: UPRIGHT },
            Primitive::Box { centre: [0.0, 0.0, 0.01], half: [0.04, 0.02, 0.03], orientation_wxyz: UPRIGHT },
            Primitive::Capsule { from: [-0.05, 0.0, 0.0], to: [0.05, 0.02, 0.0], radius: 0.02 },
        ]
        .map(|shape| tessellate(&shape, 48))
    }

    #[test]
    fn depth_is_that_of_rays() {
        for eye in [[0.3, 0.1, 0.2], [-0.1, -0.25, 0.05], [0.0, 0.12, -0.1]] {
            let (camera, pose) = (camera(), placed(eye));
            let mut raster = Rasteriser::default();
            raster.begin(&camera, PAPER);
            let shapes = shapes();
            for mesh in &shapes {
                raster.surface(&LitMesh::new(mesh), |_| Vec3A::ONE, solid(pose.to_f32()));
            }
            raster.finish(1.0);
            let meshes = shapes.each_ref().map(RayMesh::new);
            let instances = meshes.each_ref().map(|mesh| Instance::new(mesh, pose));
            let mut hits = Hits::new(PixelWindow::whole(&camera));
            Caster::default().cast(&instances, &camera, Faces::Both, &mut hits);
            let (mut seen, mut differ) = (0, 0);
            for (pixel, (&triangle, &depth_m)) in hits.triangle().iter().zip(hits.depth()).enumerate() {
                let drawn = raster.depth_m(pixel % camera.width, pixel / camera.width);
                match drawn {
                    Some(drawn) if triangle != MISS => {
                        seen += 1;
                        differ += usize::from((drawn - depth_m).abs() > 2e-5 * depth_m);
                    }
                    drawn => differ += usize::from(drawn.is_some() == (triangle == MISS)),
                }
            }
            // Rounding decides at outlines and edges alone.
            assert!(seen > 4000 && differ < seen / 200, "{differ} of {seen} pixels differ, seen from {eye:?}");
        }
    }

    #[test]
    fn a_plane_cuts_off_the_part_of_a_mesh_beyond_it() {
        let (camera, pose) = (camera(), placed([0.3, 0.1, 0.2]));
        let ball = LitMesh::new(&shapes()[0]);
        let drawn = |plane: Option<CutPlane>| {
            let mut raster = Rasteriser::default();
            raster.begin(&camera, PAPER);
            match plane {
                Some(plane) => raster.cut_surface(&ball, |_| Vec3A::ONE, solid(pose.to_f32()), plane),
                None => raster.surface(&ball, |_| Vec3A::ONE, solid(pose.to_f32())),
            }
            raster.finish(1.0);
            raster.nearness.iter().filter(|nearness| **nearness > 0.0).count()
        };
        let at = |offset_m: f32| drawn(Some(CutPlane { normal: Vec3A::Y, offset_m }));
        let whole = drawn(None);
        assert_eq!((at(1.0), at(-1.0)), (whole, 0));
        assert!(at(0.01) > whole / 4 && at(0.01) < whole, "{} of {whole}", at(0.01));
    }

    #[test]
    fn glass_is_blended_once_and_only_over_surfaces_behind_it() {
        let camera = camera();
        let mut raster = Rasteriser::default();
        let square = |z: f32| {
            let [a, b, c] = [Vec3A::new(-1.0, -1.0, z), Vec3A::new(1.0, -1.0, z), Vec3A::new(0.0, 2.0, z)];
            [a, b, c]
        };
        let grey = |level: f32| [Vec3A::splat(level); 3];
        let middle = |raster: &mut Rasteriser| raster.finish(0.5).get_pixel(160, 120).0;
        raster.begin(&camera, PAPER);
        raster.flat(square(-0.5), grey(100.0), false);
        raster.flat(square(-0.3), grey(200.0), true);
        raster.flat(square(-0.4), grey(0.0), true);
        assert_eq!(middle(&mut raster), [150; 3], "the nearest pane, once");
        raster.begin(&camera, PAPER);
        raster.flat(square(-0.5), grey(100.0), false);
        raster.flat(square(-0.6), grey(200.0), true);
        assert_eq!(middle(&mut raster), [100; 3], "a pane behind");
    }

    #[test]
    fn geometry_behind_the_eye_is_cut_off() {
        let camera = camera();
        let mut raster = Rasteriser::default();
        raster.begin(&camera, Rgb([0; 3]));
        // A floor that begins behind the eye and ends before it.
        let floor = [Vec3A::new(-9.0, -0.1, 1.0), Vec3A::new(9.0, -0.1, 1.0), Vec3A::new(0.0, -0.1, -5.0)];
        raster.flat(floor, [Vec3A::splat(200.0); 3], false);
        raster.line([Vec3A::new(0.0, 0.02, 1.0), Vec3A::new(0.0, 0.02, -1.0)], Vec3A::splat(90.0), 3.0);
        let image = raster.finish(1.0);
        assert_eq!(image.get_pixel(160, 239).0, [200; 3]);
        assert_eq!(image.get_pixel(20, 10).0, [0; 3]);
        assert_eq!(image.get_pixel(160, 100).0, [90; 3]);
        let ahead = raster.depth_m(160, 239).unwrap();
        assert!((0.1..0.4).contains(&ahead), "{ahead}");
    }

    #[test]
    fn numbers_that_are_not_finite_are_not_drawn_and_do_no_harm() {
        let camera = camera();
        let mut raster = Rasteriser::default();
        for size in [0, 1, 3] {
            raster.begin(&Intrinsics { width: size, height: size, ..camera }, PAPER);
            for wrong in [f32::NAN, f32::INFINITY, f32::MAX, 0.0, 1e-30] {
                let points = [Vec3A::new(wrong, 1.0, -1.0), Vec3A::new(0.0, wrong, -wrong), Vec3A::splat(-wrong)];
                raster.flat(points, [Vec3A::splat(wrong); 3], size == 1);
                raster.line([points[0], points[1]], Vec3A::ZERO, wrong);
                raster.dot(points[2], Vec3A::ZERO, wrong);
                let mesh = Mesh { vertices: points.map(Vec3::from).to_vec(), faces: vec![[0, 1, 2], [0, 1, 7]] };
                raster.surface(&LitMesh::new(&mesh), |_| Vec3A::ONE, solid((Mat3A::IDENTITY, Vec3A::ZERO)));
            }
            assert_eq!(raster.finish(0.5).width(), size as u32);
        }
    }

    #[test]
    fn the_picture_does_not_depend_on_the_number_of_threads() {
        let draw = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut raster = Rasteriser::default();
                raster.begin(&camera(), PAPER);
                for (k, mesh) in shapes().iter().enumerate() {
                    let tint = Vec3A::new(90.0, 60.0 * k as f32, 200.0);
                    let placement = MeshPlacement {
                        camera_from_mesh: placed([0.2, 0.1, 0.2]).to_f32(),
                        is_glass: k == 2,
                        shine: 0.5,
                    };
                    raster.surface(&LitMesh::new(mesh), |_| tint, placement);
                }
                raster.finish(0.4).clone()
            })
        };
        assert_eq!(draw(1), draw(3));
    }
}
