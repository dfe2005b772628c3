//! pyrender's metallic-roughness shading of the gel, one image row at a time.
//!
//! TACTO strips every texture, so gel and objects share one material: the one that pyrender's `Mesh.from_trimesh` takes
//! by default. For a light at distance r the radiance is n.l / r^2 times [(1 - F) c_d / pi + F G D / (4 n.l n.v +
//! 0.001)] with Schlick's F, Smith's G and the GGX density D, as in pyrender's fragment shader `mesh.frag`.

use std::f32::consts::PI;

use mvt_frames::camera::Intrinsics;
use mvt_robot::digit::gel::GelSurface;
use nalgebra::Vector3;

use super::light::{Light, Lights};

/// Base colour of the material, the same in all channels (`baseColorFactor`).
const BASE: f32 = 0.3;
/// Metallic factor (`metallicFactor`).
const METALLIC: f32 = 0.2;
/// Roughness factor (`roughnessFactor`).
const ROUGHNESS: f32 = 0.8;
/// Diffuse colour over pi.
const DIFFUSE: f32 = BASE * 0.96 * (1.0 - METALLIC) / PI;
/// Reflectance at normal incidence.
const F0: f32 = 0.04 * (1.0 - METALLIC) + BASE * METALLIC;
/// Smith's k.
const K: f32 = (ROUGHNESS + 1.0) * (ROUGHNESS + 1.0) / 8.0;
/// Squared GGX width.
const ALPHA2: f32 = ROUGHNESS * ROUGHNESS * ROUGHNESS * ROUGHNESS;

/// Surface of one image row: depth along the optical axis in metres and normals towards the camera, of any length.
#[derive(Default)]
pub(super) struct Row {
    pub depth: Vec<f32>,
    pub normal: [Vec<f32>; 3],
    /// Inverse length of the ray (1, y, z).
    inverse_ray: Vec<f32>,
    radiance: [Vec<f32>; 3],
}

impl Row {
    /// Makes room for rows of `width` pixels.
    pub fn resize(&mut self, width: usize) {
        let Self { depth, normal, inverse_ray, radiance } = self;
        for lane in [depth, inverse_ray].into_iter().chain(normal).chain(radiance) {
            lane.resize(width, 0.0);
        }
    }
}

/// Light in the layout of the shader.
struct Lamp {
    position: [f32; 3],
    radiant: [f32; 3],
    /// Beam direction, and scale and offset of its fall-off; scale 0 and offset 1 shine in every direction.
    direction: [f32; 3],
    falloff: [f32; 2],
}

impl From<&Light> for Lamp {
    fn from(light: &Light) -> Self {
        let single = |v: Vector3<f64>| [v.x as f32, v.y as f32, v.z as f32];
        let (direction, falloff) = light.spot.map_or((Vector3::zeros(), [0.0, 1.0]), |spot| {
            let scale = 1.0 / (1.0 - spot.outer_rad.cos());
            (spot.direction, [scale as f32, (-spot.outer_rad.cos() * scale) as f32])
        });
        Self {
            position: single(light.position_m),
            radiant: light.radiant().map(|c| c as f32),
            direction: single(direction),
            falloff,
        }
    }
}

/// Shader of the rows of a touch image.
pub(super) struct Shader {
    pub camera: Intrinsics,
    pub gel: GelSurface,
    lamps: [Lamp; 3],
    gamma: Gamma,
    /// Ray of pixel (u, v): (1, y_slope[u], z_slope[v]) times depth, in the gel frame.
    pub y_slope: Vec<f32>,
    pub z_slope: Vec<f32>,
}

impl Shader {
    pub fn new(lights: &Lights, camera: Intrinsics, gel: GelSurface) -> Self {
        Self {
            camera,
            gel,
            lamps: std::array::from_fn(|i| Lamp::from(&lights.0[i])),
            gamma: Gamma::new(),
            y_slope: (0..camera.width).map(|u| (-(u as f64 - camera.cx) / camera.fx) as f32).collect(),
            z_slope: (0..camera.height).map(|v| (-(v as f64 - camera.cy) / camera.fy) as f32).collect(),
        }
    }

    /// Returns the point at a depth that pixel (u, v) shows, metres in the gel frame.
    #[inline(always)]
    pub fn point(&self, u: usize, v: usize, depth: f32) -> [f32; 3] {
        [depth, depth * self.y_slope[u], depth * self.z_slope[v]]
    }

    /// Writes the 8-bit colours of the columns of row `v` for which `shown` holds; `columns` bounds them.
    #[inline(always)]
    pub fn shade(
        &self,
        v: usize,
        columns: std::ops::Range<usize>,
        row: &mut Row,
        shown: impl Fn(usize) -> bool,
        rgb: &mut [u8],
    ) {
        self.prepare(v, columns.clone(), row);
        for lamp in &self.lamps {
            self.add_lamp(lamp, v, columns.clone(), row);
        }
        for (u, pixel) in rgb.chunks_exact_mut(3).enumerate().take(columns.end).skip(columns.start) {
            if shown(u) {
                for (byte, radiance) in pixel.iter_mut().zip(&row.radiance) {
                    *byte = self.gamma.encode(radiance[u]);
                }
            }
        }
    }

    /// Makes normals unit vectors and radiance 0.
    #[inline(always)]
    fn prepare(&self, v: usize, columns: std::ops::Range<usize>, row: &mut Row) {
        let z_slope = self.z_slope[v];
        for channel in &mut row.radiance {
            channel.fill(0.0);
        }
        let Row { normal, inverse_ray, .. } = row;
        // Slices of one length, so that the loop has no checks of bounds.
        let [x, y, z] = normal.each_mut().map(|lane| &mut lane[columns.clone()]);
        let (inverse_ray, y_slopes) = (&mut inverse_ray[columns.clone()], &self.y_slope[columns.clone()]);
        for u in 0..columns.len() {
            let y_slope = y_slopes[u];
            inverse_ray[u] = 1.0 / (1.0 + y_slope * y_slope + z_slope * z_slope).sqrt();
            let inverse_length = 1.0 / (x[u] * x[u] + y[u] * y[u] + z[u] * z[u]).sqrt();
            x[u] *= inverse_length;
            y[u] *= inverse_length;
            z[u] *= inverse_length;
        }
    }

    /// Adds the light that one lamp sends to the camera. One straight loop without branches, so that it becomes SIMD.
    #[inline(always)]
    fn add_lamp(&self, lamp: &Lamp, v: usize, columns: std::ops::Range<usize>, row: &mut Row) {
        let z_slope = self.z_slope[v];
        let Row { depth, normal, inverse_ray, radiance } = row;
        let [normal_x, normal_y, normal_z] = normal.each_ref().map(|lane| &lane[columns.clone()]);
        let [red, green, blue] = radiance.each_mut().map(|lane| &mut lane[columns.clone()]);
        let (depth, inverse_ray) = (&depth[columns.clone()], &inverse_ray[columns.clone()]);
        let y_slopes = &self.y_slope[columns.clone()];
        for u in 0..columns.len() {
            let (d, y_slope) = (depth[u], y_slopes[u]);
            // View vector: back along the ray.
            let back = -inverse_ray[u];
            let view = [back, back * y_slope, back * z_slope];
            let to_lamp = [lamp.position[0] - d, lamp.position[1] - d * y_slope, lamp.position[2] - d * z_slope];
            let inverse_distance = 1.0 / dot(to_lamp, to_lamp).sqrt();
            let l = to_lamp.map(|c| c * inverse_distance);
            let n = [normal_x[u], normal_y[u], normal_z[u]];
            let (n_dot_l, n_dot_v) = (dot(n, l), dot(n, view));
            // The half vector h = l + v has length 2 (v.h).
            let v_dot_h = at_least(0.5 * (1.0 + dot(l, view)), 1e-12).sqrt();
            let n_dot_h = at_most(at_least((n_dot_l + n_dot_v) / (2.0 * v_dot_h), 0.0), 1.0);
            let (nl, nv) = (at_most(at_least(n_dot_l, 1e-3), 1.0), at_most(at_least(n_dot_v.abs(), 1e-3), 1.0));

            let grazing = at_least(1.0 - v_dot_h, 0.0);
            let grazing2 = grazing * grazing;
            let fresnel = F0 + (1.0 - F0) * (grazing2 * grazing2 * grazing);
            let smith = (nv * (1.0 - K) + K) * (nl * (1.0 - K) + K);
            let spread = n_dot_h * n_dot_h * (ALPHA2 - 1.0) + 1.0;
            let specular = fresnel * (nv * nl * ALPHA2) / (smith * (PI * spread * spread) * (4.0 * nl * nv + 1e-3));
            let beam = lamp.falloff[0] * at_least(-dot(lamp.direction, l), 0.0) + lamp.falloff[1];
            let beam = at_most(at_least(beam, 0.0), 1.0);
            let reflected =
                nl * (inverse_distance * inverse_distance) * (beam * beam) * ((1.0 - fresnel) * DIFFUSE + specular);

            red[u] += lamp.radiant[0] * reflected;
            green[u] += lamp.radiant[1] * reflected;
            blue[u] += lamp.radiant[2] * reflected;
        }
    }
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Returns the maximum in one instruction: `f32::max` also handles NaN, which does not occur here.
#[inline(always)]
fn at_least(a: f32, low: f32) -> f32 {
    if a > low { a } else { low }
}

#[inline(always)]
fn at_most(a: f32, high: f32) -> f32 {
    if a < high { a } else { high }
}

/// Table from radiance L to the 8-bit level round(255 L^(1/2.2)), over the leading bits of the float. With 10 bits of
/// mantissa the edges between levels are right to 0.06 of a level.
struct Gamma(Vec<u8>);

impl Gamma {
    /// Below 2^-20 every radiance gives level 0.
    const FIRST: u32 = (127 - 20) << 23;
    const DROPPED_BITS: u32 = 23 - 10;

    fn new() -> Self {
        let level = |i: u32| {
            let middle = f32::from_bits(Self::FIRST + (i << Self::DROPPED_BITS) + (1 << (Self::DROPPED_BITS - 1)));
            (255.0 * f64::from(middle).powf(1.0 / 2.2)).round() as u8
        };
        // The last entry is for 1.0 and more.
        Self((0..20 << 10).map(level).chain([255]).collect())
    }

    #[inline(always)]
    fn encode(&self, radiance: f32) -> u8 {
        let i = radiance.to_bits().saturating_sub(Self::FIRST) >> Self::DROPPED_BITS;
        // Negative numbers and NaN have large bits and would be white; neither occurs.
        self.0[(i as usize).min(self.0.len() - 1)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gamma_table_is_the_power_law_but_for_rounding_at_the_edges() {
        let gamma = Gamma::new();
        for i in 0..=100_000 {
            let radiance = i as f32 / 100_000.0;
            let exact = 255.0 * f64::from(radiance).powf(1.0 / 2.2);
            let coded = f64::from(gamma.encode(radiance));
            assert!((coded - exact).abs() < 0.57, "{radiance}: {coded}, exactly {exact}");
        }
        assert_eq!(gamma.encode(7.0), 255);
    }
}
