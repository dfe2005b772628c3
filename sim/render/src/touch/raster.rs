//! Triangles of the object drawn over the gel's depth: a pixel shows the object where it is nearer than the gel.
//!
//! A pixel's ray is (1, y, z) times depth in the gel frame. Three quantities of a triangle are linear in y and z: the
//! edge functions, the inverse of the depth at which the ray meets its plane, and the interpolated normal up to its
//! length. So no clipping is needed. Edge functions of the two triangles at an edge are exactly opposite: a closed mesh
//! has no gaps.

// Why: notes/decisions/simulation.md, "Touch images are rasterised, camera images ray-cast".

use std::ops::Range;

use glam::{Mat3A, Vec3A, Vec4};

use super::shade::{Row, Shader};
use crate::rays::{MISS, RayMesh};

/// Least distance from the camera's plane at which corners are projected, metres: a nearer one may be anywhere in the
/// image.
const NEAR_M: f32 = 1e-3;
/// Margin around the projection of a triangle, pixels, against rounding.
const MARGIN_PX: f32 = 0.01;

/// Nearest surface at each pixel, and working memory.
#[derive(Default)]
pub(super) struct Raster {
    /// Pixels of a row.
    width: usize,
    /// Inverse of the depth, 1/m.
    inverse_depth: Vec<f32>,
    /// Index of the facet, or [`MISS`] for the gel.
    facet: Vec<u32>,
    /// For each visible triangle the matrix m that gives its smooth normal, of any length, on a ray: m (1, y, z).
    facets: Vec<Mat3A>,
    candidates: Vec<u32>,
    stack: Vec<u32>,
}

/// Linear function of a ray.
#[derive(Clone, Copy)]
struct Linear(Vec3A);

impl Linear {
    /// Returns its value at y = 0 in a row, and its slope in y.
    #[inline(always)]
    fn along_row(self, z_slope: f32) -> (f32, f32) {
        (self.0.x + self.0.z * z_slope, self.0.y)
    }
}

impl Raster {
    /// Draws the outside of an object over the gel. Returns the rows in which the object may be visible.
    #[inline(always)]
    pub fn draw(
        &mut self,
        object: &RayMesh,
        (rotation, translation): (Mat3A, Vec3A),
        gel_inverse_depth: &[f32],
        shader: &Shader,
    ) -> Range<usize> {
        let Self { width, inverse_depth, facet, facets, candidates, stack } = self;
        *width = shader.camera.width;
        inverse_depth.clear();
        inverse_depth.extend_from_slice(gel_inverse_depth);
        facet.clear();
        facet.resize(gel_inverse_depth.len(), MISS);
        facets.clear();
        let (mut first, mut end) = (shader.camera.height, 0);
        object.find_inside(&view_volume(shader, rotation, translation), stack, candidates);
        for &triangle in candidates.iter() {
            let p = object.corners(triangle).map(|corner| rotation * corner + translation);
            let normal = (p[1] - p[0]).cross(p[2] - p[0]);
            let height = normal.dot(p[0]);
            // The triangle faces away from the camera, or is not finite.
            if height >= 0.0 || height.is_nan() {
                continue;
            }
            let Some((columns, lines)) = bounds(shader, p) else { continue };
            // 2 p x q, precise also for short edges.
            let edge = |p: Vec3A, q: Vec3A| (p + q).cross(q - p);
            let edges = [edge(p[2], p[1]), edge(p[0], p[2]), edge(p[1], p[0])];
            let inverse = Linear(normal / height);
            let name = facets.len() as u32;
            let mut shows = false;
            for v in lines.clone() {
                let span = v * *width + columns.start..v * *width + columns.end;
                let (depths, names) = (&mut inverse_depth[span.clone()], &mut facet[span]);
                let y_slopes = &shader.y_slope[columns.clone()];
                let [(a, da), (b, db), (c, dc)] = edges.map(|e| Linear(e).along_row(shader.z_slope[v]));
                let (d, dd) = inverse.along_row(shader.z_slope[v]);
                for ((&y, depth), at) in y_slopes.iter().zip(depths).zip(names) {
                    let here = d + dd * y;
                    let nearer = (a + da * y >= 0.0) & (b + db * y >= 0.0) & (c + dc * y >= 0.0) & (here > *depth);
                    *depth = if nearer { here } else { *depth };
                    *at = if nearer { name } else { *at };
                    shows |= nearer;
                }
            }
            if shows {
                (first, end) = (first.min(lines.start), end.max(lines.end));
                // The weight of a corner is the edge function of the opposite edge.
                let [a, b, c] = object.corner_normals(triangle);
                let weights = Mat3A::from_cols(edges[0], edges[1], edges[2]).transpose();
                facets.push(rotation * Mat3A::from_cols(a, b, c) * weights);
            }
        }
        first.min(end)..end
    }

    /// Returns the index of the facet at each pixel of row `v`, [`MISS`] for the gel.
    pub fn facets(&self, v: usize) -> &[u32] {
        &self.facet[v * self.width..(v + 1) * self.width]
    }

    /// Writes the depths of row `v`, metres.
    #[inline(always)]
    pub fn depth(&self, v: usize, gel_depth: &[f32], depth: &mut [f32]) {
        let inverse = &self.inverse_depth[v * self.width..(v + 1) * self.width];
        for (((depth, gel), inverse), &facet) in depth.iter_mut().zip(gel_depth).zip(inverse).zip(self.facets(v)) {
            *depth = if facet == MISS { *gel } else { 1.0 / inverse };
        }
    }

    /// Returns the depth at column `u` of row `v`, metres.
    #[inline(always)]
    pub fn depth_at(&self, u: usize, v: usize) -> f32 {
        1.0 / self.inverse_depth[v * self.width + u]
    }

    /// Fills in the object's interpolated vertex normals where it is visible in row `v`. Returns the columns from the
    /// first to the last such pixel, or `None` if it is not visible.
    #[inline(always)]
    pub fn normals(&self, v: usize, shader: &Shader, row: &mut Row) -> Option<Range<usize>> {
        let facets = self.facets(v);
        let start = facets.iter().position(|&f| f != MISS)?;
        let end = facets.iter().rposition(|&f| f != MISS)? + 1;
        let mut u = start;
        // Neighbours mostly show the same facet, so work on runs of it.
        while u < end {
            let name = facets[u];
            let run = u..u + facets[u..end].iter().take_while(|&&f| f == name).count();
            u = run.end;
            if name == MISS {
                continue;
            }
            let normal = &self.facets[name as usize];
            let base = normal.x_axis + normal.z_axis * shader.z_slope[v];
            for (axis, lane) in row.normal.iter_mut().enumerate() {
                for (value, y) in lane[run.clone()].iter_mut().zip(&shader.y_slope[run.clone()]) {
                    *value = base[axis] + normal.y_axis[axis] * y;
                }
            }
        }
        Some(start..end)
    }
}

/// Returns the planes, in the object's frame, around the space between camera and gel that is in view: inward normals
/// and offsets.
fn view_volume(Shader { camera, gel, .. }: &Shader, rotation: Mat3A, translation: Vec3A) -> [Vec4; 5] {
    // To the borders of the outermost pixels, half a pixel beyond their centres.
    let (y, z) = ((camera.width as f64 / 2.0 / camera.fx) as f32, (camera.height as f64 / 2.0 / camera.fy) as f32);
    let planes = [
        (Vec3A::NEG_X, gel.apex_m() as f32),
        (Vec3A::new(y, -1.0, 0.0), 0.0),
        (Vec3A::new(y, 1.0, 0.0), 0.0),
        (Vec3A::new(z, 0.0, -1.0), 0.0),
        (Vec3A::new(z, 0.0, 1.0), 0.0),
    ];
    let to_object = rotation.transpose();
    planes.map(|(normal, offset)| (to_object * normal).extend(normal.dot(translation) + offset))
}

/// Returns the columns and rows of the pixels that a triangle may cover; `None` if there are no such pixels or it lies
/// behind the gel.
#[inline(always)]
fn bounds(Shader { camera, gel, .. }: &Shader, p: [Vec3A; 3]) -> Option<(Range<usize>, Range<usize>)> {
    let nearest = p[0].x.min(p[1].x).min(p[2].x);
    if nearest > gel.apex_m() as f32 {
        return None;
    }
    if nearest < NEAR_M {
        return Some((0..camera.width, 0..camera.height));
    }
    let (f, cx, cy) = (camera.fx as f32, camera.cx as f32, camera.cy as f32);
    let pixels = |centre: f32, coordinates: [f32; 3], size: usize| {
        let at = |k: usize| centre - f * coordinates[k] / p[k].x;
        let (low, high) = (at(0).min(at(1)).min(at(2)), at(0).max(at(1)).max(at(2)));
        // Conversions saturate: a span left of the image starts at 0.
        let range = (low - MARGIN_PX).ceil() as usize..((high + MARGIN_PX).floor() + 1.0).min(size as f32) as usize;
        (!range.is_empty()).then_some(range)
    };
    let columns = pixels(cx, p.map(|p| p.y), camera.width)?;
    Some((columns, pixels(cy, p.map(|p| p.z), camera.height)?))
}
