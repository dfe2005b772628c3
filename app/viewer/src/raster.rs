//! Triangles, lines and points with a depth buffer, on the processor: it needs no graphics driver, so that pictures are the same on any
//! machine, and it is faster than the graphics drivers of machines without graphics.
//!
//! Everything becomes triangles in screen coordinates, sorted into bands of rows; each band is drawn by one thread. Of equally near
//! triangles the first stays, so that the picture does not depend on the number of threads.

use glam::{Mat3A, Vec2, Vec3, Vec3A};
use image::{Rgb, RgbImage};
use mvt_frames::camera::Intrinsics;
use mvt_mesh::Mesh;
use rayon::prelude::*;

/// Rows of a band.
const BAND: usize = 24;
/// What is nearer to the eye is cut off, metres.
const NEAR_M: f32 = 0.005;
/// Lines and points win against surfaces that are nearer by less than this share of their distance: they often lie on them.
const LINE_BIAS: f32 = 0.004;

/// A colour as numbers from 0 to 255.
pub type Colour = Vec3A;

/// A colour as the rasteriser wants it.
pub fn colour(rgb: Rgb<u8>) -> Colour {
    let [r, g, b] = rgb.0.map(f32::from);
    Vec3A::new(r, g, b)
}

/// A mesh with what is needed to light it.
#[derive(Debug, Clone, Default)]
pub struct Surface {
    vertices: Vec<Vec3A>,
    normals: Vec<Vec3A>,
    faces: Vec<[u32; 3]>,
    /// Encloses a volume, so that no face is ever seen from behind.
    is_closed: bool,
}

impl Surface {
    /// Prepares a mesh; faces that name vertices which are not there are left out.
    pub fn new(mesh: &Mesh) -> Self {
        let vertices: Vec<Vec3A> = mesh.vertices.iter().copied().map(Vec3A::from).collect();
        let is_whole = |face: &&[u32; 3]| face.iter().all(|&corner| (corner as usize) < vertices.len());
        let faces: Vec<[u32; 3]> = mesh.faces.iter().filter(is_whole).copied().collect();
        let mut normals = vec![Vec3A::ZERO; vertices.len()];
        for face in &faces {
            let [a, b, c] = face.map(|corner| vertices[corner as usize]);
            // As long as the area: large faces count for more.
            let normal = (b - a).cross(c - a);
            face.iter().for_each(|&corner| normals[corner as usize] += normal);
        }
        normals.iter_mut().for_each(|normal| *normal = normal.normalize_or_zero());
        let is_closed = faces.len() == mesh.faces.len() && mesh.edges().watertight();
        Self { vertices, normals, faces, is_closed }
    }

    /// The vertices.
    pub fn vertices(&self) -> &[Vec3A] {
        &self.vertices
    }

    /// Unit normals of the vertices, outward; zero where there is none.
    pub fn normals(&self) -> &[Vec3A] {
        &self.normals
    }
}

/// A vertex on the screen.
#[derive(Debug, Clone, Copy)]
struct Corner {
    /// Column and row.
    at: Vec2,
    /// One over the depth along the optical axis, 1/m: linear over the screen.
    nearness: f32,
    colour: Colour,
}

/// What is drawn in one go.
#[derive(Default)]
struct Batch {
    corners: Vec<Corner>,
    faces: Vec<[u32; 3]>,
    /// By band, which faces reach into it.
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

/// Draws pictures; keeps its memory from one to the next.
#[derive(Default)]
pub struct Raster {
    image: RgbImage,
    /// One over the depth of what is seen, 1/m; 0 where nothing is.
    nearness: Vec<f32>,
    solid: Batch,
    glass: Batch,
    lens: Option<Lens>,
    paper: Colour,
}

#[derive(Clone, Copy)]
struct Lens {
    focal: Vec2,
    centre: Vec2,
}

/// Where a surface is and how it looks.
#[derive(Clone, Copy)]
pub struct Placement {
    /// Rotation and translation that take its coordinates to the camera's (OpenGL axes).
    pub camera_from_mesh: (Mat3A, Vec3A),
    /// Nothing of it hides what is behind it, which shines through.
    pub is_glass: bool,
}

impl Raster {
    /// Begins a picture as a camera sees it.
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
        self.lens = Some(Lens { focal: vector(camera.fx, camera.fy), centre: vector(camera.cx, camera.cy) });
    }

    /// Adds a surface, lit from over the viewer's left shoulder from either side, with a colour per vertex.
    pub fn surface(&mut self, surface: &Surface, colours: impl Fn(usize) -> Colour + Sync, placement: Placement) {
        let Some(lens) = self.lens else { return };
        let (rotation, translation) = placement.camera_from_mesh;
        let batch = if placement.is_glass { &mut self.glass } else { &mut self.solid };
        let first = batch.corners.len() as u32;
        let corner = |(k, (&vertex, &normal)): (usize, (&Vec3A, &Vec3A))| {
            let point = rotation * vertex + translation;
            lens.corner(point, lit(colours(k), rotation * normal, point))
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
                cut(batch, lens, points, corners);
            }
        }
    }

    /// Adds a triangle of the camera's coordinates without light.
    pub fn flat(&mut self, points: [Vec3A; 3], colours: [Colour; 3], is_glass: bool) {
        let Some(lens) = self.lens else { return };
        cut(if is_glass { &mut self.glass } else { &mut self.solid }, lens, points, colours);
    }

    /// Adds a line between two points of the camera's coordinates, `width` pixels wide.
    pub fn line(&mut self, mut ends: [Vec3A; 2], colour: Colour, width: f32) {
        let Some(lens) = self.lens else { return };
        if -ends[0].z < -ends[1].z {
            ends.swap(0, 1);
        }
        // From the far end on; the near one may be cut.
        let [far, near] = ends;
        if !far.is_finite() || !near.is_finite() || -far.z <= NEAR_M {
            return;
        }
        let near = if -near.z < NEAR_M { far.lerp(near, (-far.z - NEAR_M) / (near.z - far.z)) } else { near };
        let [a, b] = [far, near].map(|point| lens.corner(point * (1.0 - LINE_BIAS), colour));
        let across = (b.at - a.at).perp().normalize_or(Vec2::X) * (0.5 * width);
        self.quad([(a, across), (b, across), (b, -across), (a, -across)]);
    }

    /// Adds a square dot around a point of the camera's coordinates, `width` pixels wide.
    pub fn dot(&mut self, point: Vec3A, colour: Colour, width: f32) {
        let Some(lens) = self.lens else { return };
        if -point.z > NEAR_M {
            let (at, half) = (lens.corner(point * (1.0 - LINE_BIAS), colour), 0.5 * width);
            let around = [(-half, -half), (half, -half), (half, half), (-half, half)];
            self.quad(around.map(|(x, y)| (at, Vec2::new(x, y))));
        }
    }

    fn quad(&mut self, corners: [(Corner, Vec2); 4]) {
        let first = self.solid.corners.len() as u32;
        self.solid.corners.extend(corners.map(|(corner, by)| Corner { at: corner.at + by, ..corner }));
        self.solid.faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }

    /// Draws everything that was added. Of what is glass the nearest is seen, and through it what is behind, with this share of its
    /// own colour.
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
                // Drawn apart, so that what lies behind one another is laid over once.
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

    /// The picture that was drawn last.
    pub fn image(&self) -> &RgbImage {
        &self.image
    }

    /// Depth of what is seen at a pixel (column, row), metres along the optical axis; none where nothing is.
    #[cfg(test)]
    fn depth_m(&self, x: usize, y: usize) -> Option<f32> {
        let nearness = self.nearness[x + y * self.image.width() as usize];
        (nearness > 0.0).then(|| 1.0 / nearness)
    }
}

impl Lens {
    fn corner(self, point: Vec3A, colour: Colour) -> Corner {
        let nearness = 1.0 / -point.z;
        let at = self.centre + Vec2::new(point.x, -point.y) * nearness * self.focal;
        Corner { at, nearness, colour }
    }
}

/// A colour in the light: some from everywhere, most from over the left shoulder, some from the eye.
fn lit(colour: Colour, normal: Vec3A, point: Vec3A) -> Colour {
    const LIGHT: Vec3A = Vec3A::new(-0.35, 0.55, 0.76);
    let normal = if normal.dot(point) > 0.0 { -normal } else { normal };
    let brightness = 0.42 + 0.43 * normal.dot(LIGHT).max(0.0) + 0.17 * normal.z.abs();
    (colour * brightness).min(Vec3A::splat(255.0))
}

/// Adds what of a triangle lies beyond the near plane.
fn cut(batch: &mut Batch, lens: Lens, points: [Vec3A; 3], colours: [Colour; 3]) {
    let first = batch.corners.len() as u32;
    let mut count = 0;
    for k in 0..3 {
        let ([p, q], [a, b]) = ([points[k], points[(k + 1) % 3]], [colours[k], colours[(k + 1) % 3]]);
        let [is_beyond, next_is] = [p, q].map(|point| -point.z >= NEAR_M);
        if is_beyond {
            batch.corners.push(lens.corner(p, a));
            count += 1;
        }
        if is_beyond != next_is {
            let along = (-NEAR_M - p.z) / (q.z - p.z);
            batch.corners.push(lens.corner(p.lerp(q, along), a.lerp(b, along)));
            count += 1;
        }
    }
    batch.faces.extend((2..count).map(|k| [first, first + k - 1, first + k]));
}

/// Draws a triangle into a band whose first row is `top`.
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
    // Weights of the second and third corner are linear over the screen, and so is what they weigh.
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

/// A point in the coordinates that a rotation and translation lead to.
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
    use mvt_robot::hand::Primitive;
    use nalgebra::Vector3;

    const PAPER: Rgb<u8> = Rgb([250, 250, 248]);

    fn camera() -> Intrinsics {
        Intrinsics::from_fov_y(320, 240, 0.6)
    }

    fn placed(eye: [f64; 3]) -> Isometry<Object, Camera> {
        let pose = look_at(Vector3::from(eye), Vector3::zeros(), Vector3::z());
        pose.inverse() * Isometry::<Object, World>::identity()
    }

    fn solid(camera_from_mesh: (Mat3A, Vec3A)) -> Placement {
        Placement { camera_from_mesh, is_glass: false }
    }

    fn shapes() -> [Mesh; 3] {
        [
            Primitive::Ellipsoid { centre: [0.0, 0.01, 0.0], semi: [0.03, 0.05, 0.02] },
            Primitive::Box { centre: [0.0, 0.0, 0.01], half: [0.04, 0.02, 0.03] },
            Primitive::Capsule { from: [-0.05, 0.0, 0.0], to: [0.05, 0.02, 0.0], radius: 0.02 },
        ]
        .map(|shape| tessellate(&shape, 48))
    }

    #[test]
    fn depth_is_that_of_rays() {
        for eye in [[0.3, 0.1, 0.2], [-0.1, -0.25, 0.05], [0.0, 0.12, -0.1]] {
            let (camera, pose) = (camera(), placed(eye));
            let mut raster = Raster::default();
            raster.begin(&camera, PAPER);
            let shapes = shapes();
            for mesh in &shapes {
                raster.surface(&Surface::new(mesh), |_| Vec3A::ONE, solid(pose.to_f32()));
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
    fn glass_is_laid_over_once_and_only_before_what_is_behind() {
        let camera = camera();
        let mut raster = Raster::default();
        let square = |z: f32| {
            let [a, b, c] = [Vec3A::new(-1.0, -1.0, z), Vec3A::new(1.0, -1.0, z), Vec3A::new(0.0, 2.0, z)];
            [a, b, c]
        };
        let grey = |level: f32| [Vec3A::splat(level); 3];
        let middle = |raster: &mut Raster| raster.finish(0.5).get_pixel(160, 120).0;
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
    fn what_is_behind_the_eye_is_cut_off() {
        let camera = camera();
        let mut raster = Raster::default();
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
    fn nothing_that_is_no_number_is_drawn_or_harms() {
        let camera = camera();
        let mut raster = Raster::default();
        for size in [0, 1, 3] {
            raster.begin(&Intrinsics { width: size, height: size, ..camera }, PAPER);
            for wrong in [f32::NAN, f32::INFINITY, f32::MAX, 0.0, 1e-30] {
                let points = [Vec3A::new(wrong, 1.0, -1.0), Vec3A::new(0.0, wrong, -wrong), Vec3A::splat(-wrong)];
                raster.flat(points, [Vec3A::splat(wrong); 3], size == 1);
                raster.line([points[0], points[1]], Vec3A::ZERO, wrong);
                raster.dot(points[2], Vec3A::ZERO, wrong);
                let mesh = Mesh { vertices: points.map(Vec3::from).to_vec(), faces: vec![[0, 1, 2], [0, 1, 7]] };
                raster.surface(&Surface::new(&mesh), |_| Vec3A::ONE, solid((Mat3A::IDENTITY, Vec3A::ZERO)));
            }
            assert_eq!(raster.finish(0.5).width(), size as u32);
        }
    }

    #[test]
    fn the_picture_does_not_depend_on_the_number_of_threads() {
        let draw = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut raster = Raster::default();
                raster.begin(&camera(), PAPER);
                for (k, mesh) in shapes().iter().enumerate() {
                    let tint = Vec3A::new(90.0, 60.0 * k as f32, 200.0);
                    let placement = Placement { camera_from_mesh: placed([0.2, 0.1, 0.2]).to_f32(), is_glass: k == 2 };
                    raster.surface(&Surface::new(mesh), |_| tint, placement);
                }
                raster.finish(0.4).clone()
            })
        };
        assert_eq!(draw(1), draw(3));
    }
}
