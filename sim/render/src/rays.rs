//! Ray casting of pinhole images over rigid triangle meshes.
//!
//! All rays of an image share an origin, which makes them cheap: a [`Caster`] sends tiles of 8 x 8 pixels through the
//! trees of the meshes. The frustum of a tile selects the nodes, edge functions at the corners of its 4 x 4 blocks
//! select the blocks that a triangle can cover, and only then are single rays tested, as many at once as the machine
//! has lanes ([`RayInstructions`]). Every lane does the same operations in the same order, without fused multiply-add,
//! so all instruction sets agree to the bit. Edge functions are exactly opposite for the two triangles of an edge, so a
//! closed mesh has no pin holes.
//!
//! The distance of a hit is its depth along the optical axis, not along the ray.

mod mesh;
mod tile;

use std::ops::Range;

use glam::{Mat3A, Vec3A};
use mvt_frames::camera::Intrinsics;
use mvt_frames::{Camera, Frame, Isometry};
use pulp::Simd;

pub use mesh::RayMesh;
use tile::{Job, View};

/// Triangle of a pixel of [`Hits`] whose ray missed.
pub const MISS: u32 = u32::MAX;

/// Sides of a triangle that stop a ray.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Faces {
    /// The side whose corners run counter-clockwise: the outside of a mesh.
    Front,
    /// Both sides.
    Both,
}

/// Mesh at a pose.
#[derive(Debug, Clone, Copy)]
pub struct Instance<'a> {
    mesh: &'a RayMesh,
    mesh_from_camera: (Mat3A, Vec3A),
}

impl<'a> Instance<'a> {
    /// Places a mesh; `camera_from_mesh` takes its coordinates to those of the camera.
    pub fn new<F: Frame>(mesh: &'a RayMesh, camera_from_mesh: Isometry<F, Camera>) -> Self {
        Self { mesh, mesh_from_camera: camera_from_mesh.inverse().to_f32() }
    }

    /// Returns the mesh.
    pub fn mesh(&self) -> &'a RayMesh {
        self.mesh
    }

    /// Returns the rotation that takes directions of the camera to directions of the mesh.
    pub fn mesh_from_camera(&self) -> Mat3A {
        self.mesh_from_camera.0
    }
}

/// Rectangle of pixels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PixelWindow {
    /// Columns.
    pub columns: Range<usize>,
    /// Rows.
    pub rows: Range<usize>,
}

impl PixelWindow {
    /// Returns the window of the whole image.
    pub fn whole(intrinsics: &Intrinsics) -> Self {
        Self { columns: 0..intrinsics.width, rows: 0..intrinsics.height }
    }

    /// Returns the number of pixels.
    pub fn area(&self) -> usize {
        self.columns.len() * self.rows.len()
    }
}

/// Hits and misses of the rays through a window of an image. All slices are row-major over the window.
#[derive(Debug, Clone)]
pub struct Hits {
    window: PixelWindow,
    depth: Vec<f32>,
    instance: Vec<u32>,
    triangle: Vec<u32>,
    u: Vec<f32>,
    v: Vec<f32>,
}

impl Hits {
    /// Creates a window without hits.
    pub fn new(window: PixelWindow) -> Self {
        let mut hits =
            Self { window: window.clone(), depth: vec![], instance: vec![], triangle: vec![], u: vec![], v: vec![] };
        hits.reset(window);
        hits
    }

    /// Drops all hits and sets another window. Allocates only if the window is larger than all before.
    pub fn reset(&mut self, window: PixelWindow) {
        let area = window.area();
        self.window = window;
        self.depth.clear();
        self.depth.resize(area, f32::INFINITY);
        self.triangle.clear();
        self.triangle.resize(area, MISS);
        // Undefined where a ray missed, so no need to clear them.
        self.instance.resize(area, MISS);
        self.u.resize(area, 0.0);
        self.v.resize(area, 0.0);
    }

    /// Returns the window.
    pub fn window(&self) -> &PixelWindow {
        &self.window
    }

    /// Returns the depth along the optical axis, metres; infinite where the ray missed.
    pub fn depth(&self) -> &[f32] {
        &self.depth
    }

    /// Returns the index of the triangle that was hit, or [`MISS`].
    pub fn triangle(&self) -> &[u32] {
        &self.triangle
    }

    /// Returns the index of the instance that was hit; undefined where the triangle is [`MISS`].
    pub fn instance(&self) -> &[u32] {
        &self.instance
    }

    /// Returns the weights of the triangle's second and third corner at the hit; undefined where the triangle is
    /// [`MISS`].
    pub fn barycentric(&self) -> (&[f32], &[f32]) {
        (&self.u, &self.v)
    }
}

/// Instruction set for the kernel of a [`Caster`].
#[derive(Debug, Clone, Copy)]
pub struct RayInstructions(Set);

#[derive(Debug, Clone, Copy)]
enum Set {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2(pulp::x86::V3),
    #[cfg(target_arch = "x86_64")]
    Avx512(pulp::x86::V4),
}

impl RayInstructions {
    /// Returns all instruction sets of this machine, slowest first.
    pub fn available() -> Vec<Self> {
        let mut sets = vec![Set::Portable];
        #[cfg(target_arch = "x86_64")]
        {
            sets.extend(pulp::x86::V3::try_new().map(Set::Avx2));
            sets.extend(pulp::x86::V4::try_new().map(Set::Avx512));
        }
        sets.into_iter().map(Self).collect()
    }

    /// Returns the fastest instruction set of this machine.
    pub fn best() -> Self {
        Self::available().pop().unwrap_or(Self(Set::Portable))
    }

    /// Returns the name for messages.
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

/// Ray caster for pinhole images, with the working memory of one thread.
#[derive(Debug, Clone)]
pub struct Caster {
    instructions: RayInstructions,
    scratch: tile::Scratch,
}

impl Default for Caster {
    fn default() -> Self {
        Self::new(RayInstructions::best())
    }
}

impl Caster {
    /// Creates a caster that uses this instruction set.
    pub fn new(instructions: RayInstructions) -> Self {
        Self { instructions, scratch: tile::Scratch::default() }
    }

    /// Casts a ray through each pixel of the window of `hits`. A hit replaces an earlier one only if it is nearer.
    ///
    /// Of two hits at the same depth, the triangle with the smaller index wins.
    pub fn cast(&mut self, instances: &[Instance<'_>], intrinsics: &Intrinsics, faces: Faces, hits: &mut Hits) {
        let scratch = &mut self.scratch;
        scratch.prepare(instances.iter().enumerate().filter_map(|(k, i)| View::new(i, k)), intrinsics, &hits.window);
        let job = Job { instances, faces, hits, scratch };
        match self.instructions.0 {
            Set::Portable => pulp::Scalar128b.vectorize(job),
            #[cfg(target_arch = "x86_64")]
            Set::Avx2(simd) => Simd::vectorize(simd, job),
            #[cfg(target_arch = "x86_64")]
            Set::Avx512(simd) => Simd::vectorize(simd, job),
        }
    }
}
