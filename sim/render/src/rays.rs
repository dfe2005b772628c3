//! Ray casting of pinhole images over rigid triangle meshes.
//!
//! All rays of an image share an origin, which makes them cheap: a [`Caster`] sends tiles of 8 x 8 pixels through the
//! meshes' trees. A tile's frustum decides which nodes are visited, edge functions at the corners of its 4 x 4 blocks
//! decide which blocks a triangle can cover, and only then are single rays tested, as many at once as the machine has
//! lanes ([`Level`]). Every lane does the same operations in the same order, without fused multiply-add, so all levels
//! agree to the bit. Edge functions are exactly opposite for the two triangles of an edge, so a closed mesh has no pin
//! holes.
//!
//! The distance of a hit is its depth along the optical axis, not along the ray.

mod mesh;
mod tile;

use std::ops::Range;

use glam::{Mat3A, Vec3A};
use mvt_frames::camera::Intrinsics;
use mvt_frames::{Camera, Frame, Isometry};
use pulp::Simd;

pub use mesh::{RayHit, RayMesh};
use tile::{Job, View};

/// Marks a pixel of [`Hits`] whose ray hit nothing.
pub const MISS: u32 = u32::MAX;

/// Which sides of a triangle stop a ray.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Faces {
    /// Only sides seen counter-clockwise: the outside of a mesh.
    Front,
    /// Both sides.
    Both,
}

/// A mesh at a place.
#[derive(Debug, Clone, Copy)]
pub struct Instance<'a> {
    mesh: &'a RayMesh,
    mesh_from_camera: (Mat3A, Vec3A),
}

impl<'a> Instance<'a> {
    /// A mesh whose coordinates `camera_from_mesh` takes to those of the camera that looks at it.
    pub fn new<F: Frame>(mesh: &'a RayMesh, camera_from_mesh: Isometry<F, Camera>) -> Self {
        Self { mesh, mesh_from_camera: camera_from_mesh.inverse().to_f32() }
    }

    /// The mesh.
    pub fn mesh(&self) -> &'a RayMesh {
        self.mesh
    }

    /// Rotation that takes directions of the camera to directions of the mesh.
    pub fn mesh_from_camera(&self) -> Mat3A {
        self.mesh_from_camera.0
    }
}

/// A rectangle of pixels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Window {
    /// Columns.
    pub columns: Range<usize>,
    /// Rows.
    pub rows: Range<usize>,
}

impl Window {
    /// The whole image.
    pub fn whole(intrinsics: &Intrinsics) -> Self {
        Self { columns: 0..intrinsics.width, rows: 0..intrinsics.height }
    }

    /// Number of pixels.
    pub fn area(&self) -> usize {
        self.columns.len() * self.rows.len()
    }
}

/// What the rays of a window of an image hit. All slices are row-major over the window.
#[derive(Debug, Clone)]
pub struct Hits {
    window: Window,
    depth: Vec<f32>,
    instance: Vec<u32>,
    triangle: Vec<u32>,
    u: Vec<f32>,
    v: Vec<f32>,
}

impl Hits {
    /// No hits yet in a window.
    pub fn new(window: Window) -> Self {
        let mut hits =
            Self { window: window.clone(), depth: vec![], instance: vec![], triangle: vec![], u: vec![], v: vec![] };
        hits.reset(window);
        hits
    }

    /// Forgets all hits and takes another window. Allocates only where the window is larger than any before.
    pub fn reset(&mut self, window: Window) {
        let area = window.area();
        self.window = window;
        self.depth.clear();
        self.depth.resize(area, f32::INFINITY);
        self.triangle.clear();
        self.triangle.resize(area, MISS);
        // Undefined where nothing is hit: need not be cleared.
        self.instance.resize(area, MISS);
        self.u.resize(area, 0.0);
        self.v.resize(area, 0.0);
    }

    /// The window.
    pub fn window(&self) -> &Window {
        &self.window
    }

    /// Depth along the optical axis, metres; where nothing was hit the limit, which is infinite unless set.
    pub fn depth(&self) -> &[f32] {
        &self.depth
    }

    /// For each pixel the depth in metres from which on hits do not count.
    pub fn limit_mut(&mut self) -> &mut [f32] {
        &mut self.depth
    }

    /// Triangle of the mesh that was hit, or [`MISS`].
    pub fn triangle(&self) -> &[u32] {
        &self.triangle
    }

    /// Index of the instance that was hit; undefined where the triangle is [`MISS`].
    pub fn instance(&self) -> &[u32] {
        &self.instance
    }

    /// Weights of the triangle's second and third corner at the hit; undefined where the triangle is [`MISS`].
    pub fn barycentric(&self) -> (&[f32], &[f32]) {
        (&self.u, &self.v)
    }
}

/// An instruction set that the kernel can run on.
#[derive(Debug, Clone, Copy)]
pub struct Level(Set);

#[derive(Debug, Clone, Copy)]
enum Set {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2(pulp::x86::V3),
    #[cfg(target_arch = "x86_64")]
    Avx512(pulp::x86::V4),
}

impl Level {
    /// All levels that this machine has, slowest first.
    pub fn available() -> Vec<Self> {
        let mut levels = vec![Set::Portable];
        #[cfg(target_arch = "x86_64")]
        {
            levels.extend(pulp::x86::V3::try_new().map(Set::Avx2));
            levels.extend(pulp::x86::V4::try_new().map(Set::Avx512));
        }
        levels.into_iter().map(Self).collect()
    }

    /// The fastest level that this machine has.
    pub fn best() -> Self {
        Self::available().pop().unwrap_or(Self(Set::Portable))
    }

    /// Name for messages.
    pub fn name(self) -> &'static str {
        match self.0 {
            Set::Portable => "portable, 4 lanes",
            #[cfg(target_arch = "x86_64")]
            Set::Avx2(_) => "AVX2, 8 lanes",
            #[cfg(target_arch = "x86_64")]
            Set::Avx512(_) => "AVX-512, 16 lanes",
        }
    }
}

/// Casts the rays of pinhole images. Holds the scratch memory of one thread.
#[derive(Debug, Clone)]
pub struct Caster {
    level: Level,
    scratch: tile::Scratch,
}

impl Default for Caster {
    fn default() -> Self {
        Self::new(Level::best())
    }
}

impl Caster {
    /// A caster that uses a certain instruction set.
    pub fn new(level: Level) -> Self {
        Self { level, scratch: tile::Scratch::default() }
    }

    /// Casts a ray through each pixel of the window of `hits`, whose limits it respects: hits replace what lies behind
    /// them.
    ///
    /// Of equally near hits that on the triangle with the smaller index wins.
    pub fn cast(&mut self, instances: &[Instance<'_>], intrinsics: &Intrinsics, faces: Faces, hits: &mut Hits) {
        let scratch = &mut self.scratch;
        scratch.prepare(instances.iter().enumerate().filter_map(|(k, i)| View::new(i, k)), intrinsics, &hits.window);
        let job = Job { instances, faces, hits, scratch };
        match self.level.0 {
            Set::Portable => pulp::Scalar128b.vectorize(job),
            #[cfg(target_arch = "x86_64")]
            Set::Avx2(simd) => Simd::vectorize(simd, job),
            #[cfg(target_arch = "x86_64")]
            Set::Avx512(simd) => Simd::vectorize(simd, job),
        }
    }
}
