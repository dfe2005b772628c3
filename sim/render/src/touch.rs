//! What a DIGIT would record: colour, depth and contact of an object pressed into the gel, as TACTO renders them.
//!
//! TACTO draws the gel and the rigid object that pokes through it; nothing deforms. At each pixel the nearer surface shows,
//! shaded by three LEDs. All of that is closed-form, and only pixels in contact differ from the empty gel, which is rendered once
//! in [`TouchRenderer::new`]. With a background, the change over the empty gel is halved, blurred and laid over a real sensor's
//! image. [`TouchOptions`] go beyond TACTO; their defaults reproduce it.
//!
//! ```
//! use mvt_frames::Isometry;
//! use sim::rays::RayMesh;
//! use sim::touch::{TouchConfig, TouchFrame, TouchOptions, TouchRenderer};
//! # let mesh = mvt_mesh::Mesh::default();
//! let renderer = TouchRenderer::new(&TouchOptions::new(TouchConfig::Fork))?;
//! let (object, mut frame) = (RayMesh::new(&mesh), TouchFrame::default());
//! renderer.render(&object, Isometry::translation(0.041, 0.0, 0.0), None, &mut frame);
//! assert_eq!(frame.raw().dimensions(), (240, 320));
//! # Ok::<(), sim::touch::TouchError>(())
//! ```

mod background;
mod calibrate;
mod light;
mod membrane;
mod noise;
mod raster;
mod shade;

use std::ops::Range;

use image::{GrayImage, RgbImage};
use mvt_frames::{Gel, Isometry, NotRigid, Object};
use mvt_mesh::Mesh;
use mvt_robot::digit::{HEIGHT, WIDTH, gel};
use ndarray::{Array2, Array3};

use crate::rays::{MISS, RayMesh};
pub use background::synthetic_background;
use calibrate::Blur;
pub use light::{Light, Lights, Spot};
pub use membrane::Membrane;
pub use noise::NoiseKey;
use noise::{Noise, SIGMA_MAX};
use raster::Raster;
use shade::{Row, Shader};

/// Which of TACTO's DIGIT configurations lights the gel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum TouchConfig {
    /// The fork of TACTO behind YCB-Slide and FeelSight: green, red and blue spot lights, noise of 2 grey.
    Fork,
    /// TACTO 0.0.3: red, green and blue point lights, noise of 7 grey.
    Tacto,
}

impl TouchConfig {
    /// Both, in the order of their names on the command line.
    pub const ALL: [Self; 2] = [Self::Fork, Self::Tacto];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fork => "fork",
            Self::Tacto => "tacto",
        }
    }

    /// Pose of the configuration's sensor frame: TACTO 0.0.3 has the camera at z = 15 mm, its fork at the origin.
    ///
    /// A pose T_sensor_object given in the sensor's frame becomes the object's pose in the gel frame by this.
    pub fn gel_from_sensor(self) -> Isometry<Gel, Gel> {
        match self {
            Self::Fork => Isometry::identity(),
            Self::Tacto => Isometry::translation(0.0, 0.0, -0.015),
        }
    }

    /// Standard deviation of the configuration's image noise, grey levels.
    pub fn noise_sigma(self) -> f32 {
        match self {
            Self::Fork => 2.0,
            Self::Tacto => 7.0,
        }
    }
}

impl std::str::FromStr for TouchConfig {
    type Err = TouchError;

    fn from_str(name: &str) -> Result<Self, TouchError> {
        Self::ALL.into_iter().find(|c| c.name() == name).ok_or_else(|| TouchError::UnknownConfig(name.to_owned()))
    }
}

/// What the calibrated image is laid over.
#[derive(Debug, Clone, PartialEq)]
pub enum Background {
    /// The rendered empty gel.
    Rendered,
    /// An image like a real DIGIT's, see [`synthetic_background`].
    Synthetic {
        /// Which one.
        seed: u64,
    },
    /// The image of a real sensor that touches nothing, 240 wide and 320 high.
    Image(RgbImage),
}

/// How to render touch.
#[derive(Debug, Clone, PartialEq)]
pub struct TouchOptions {
    /// The LEDs. TACTO's by default; [`Lights::perturbed`] draws others for training.
    pub lights: Lights,
    /// What the calibrated image is laid over. The rendered empty gel by default.
    pub background: Background,
    /// Standard deviation of the noise in grey levels, 0 to 28, where a frame asks for noise. The configuration's by default.
    pub noise_sigma: f32,
    /// Indentation from which on a pixel counts as contact, metres, judged on the unrounded depth. By default 0.1 mm, which is
    /// MidasTouch's 0.2 times the press depth at the lighter end of its range (0.5 mm).
    pub contact_threshold_m: f32,
    /// How the gel gives way around the object. `None`, the default, is TACTO's gel, which does not.
    pub membrane: Option<Membrane>,
}

impl TouchOptions {
    /// Exactly what TACTO does in this configuration.
    pub fn new(config: TouchConfig) -> Self {
        Self {
            lights: Lights::of(config),
            background: Background::Rendered,
            noise_sigma: config.noise_sigma(),
            contact_threshold_m: 1e-4,
            membrane: None,
        }
    }
}

/// Why options cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TouchError {
    /// No such configuration.
    #[error("unknown touch configuration {0:?}: choose fork or tacto")]
    UnknownConfig(String),
    /// A pose is not a rigid motion.
    #[error("T_sensor_object is {0}")]
    Pose(#[from] NotRigid),
    /// The background has another size than the sensor's images.
    #[error("the background is {width} x {height} pixels; a DIGIT's image is 240 wide and 320 high: resize it")]
    BackgroundSize {
        /// Its width, pixels.
        width: u32,
        /// Its height, pixels.
        height: u32,
    },
    /// An option lies outside its range.
    #[error("{option} is {value}; it must lie between {low} and {high}")]
    OutOfRange {
        /// Name of the option.
        option: &'static str,
        /// Value given.
        value: f32,
        /// Least value allowed.
        low: f32,
        /// Greatest value allowed.
        high: f32,
    },
}

/// One image of a DIGIT with its ground truth, and the memory that rendering needs: reuse it from frame to frame.
pub struct TouchFrame {
    raw: RgbImage,
    calibrated: RgbImage,
    depth_m: Array2<f32>,
    contact: GrayImage,
    raster: Raster,
    row: Row,
    blur: Blur,
    smoothing: membrane::Scratch,
}

impl Default for TouchFrame {
    fn default() -> Self {
        let image = || RgbImage::new(WIDTH as u32, HEIGHT as u32);
        Self {
            raw: image(),
            calibrated: image(),
            depth_m: Array2::zeros((HEIGHT, WIDTH)),
            contact: GrayImage::new(WIDTH as u32, HEIGHT as u32),
            raster: Raster::new(),
            row: Row::new(),
            blur: Blur::new(),
            smoothing: membrane::Scratch::default(),
        }
    }
}

impl TouchFrame {
    /// Straight from the shader: no background, no noise.
    pub fn raw(&self) -> &RgbImage {
        &self.raw
    }

    /// What the sensor would record: laid over the background, with noise where it was asked for.
    pub fn calibrated(&self) -> &RgbImage {
        &self.calibrated
    }

    /// Depth along the camera's axis to the nearer of gel and object, metres, 320 rows by 240 columns.
    pub fn depth_m(&self) -> &Array2<f32> {
        &self.depth_m
    }

    /// 255 where the object presses into the gel by more than the threshold, else 0.
    pub fn contact(&self) -> &GrayImage {
        &self.contact
    }
}

/// Renders what a DIGIT records. Immutable, so that one serves all threads; each thread brings its [`TouchFrame`].
pub struct TouchRenderer {
    shader: Shader,
    noise: Option<Noise>,
    contact_threshold_m: f32,
    membrane: Option<Membrane>,
    /// Depth of the empty gel and its inverse, its colours, and the background, all of 320 rows by 240 columns.
    gel_depth: Vec<f32>,
    gel_inverse_depth: Vec<f32>,
    empty: Vec<u8>,
    background: Vec<u8>,
}

impl TouchRenderer {
    /// Renders the empty gel.
    ///
    /// # Errors
    /// [`TouchError`] if the background has another size than a DIGIT's image or a number is out of range.
    pub fn new(options: &TouchOptions) -> Result<Self, TouchError> {
        let TouchOptions { lights, background, noise_sigma, contact_threshold_m, membrane } = options;
        in_range("the noise's sigma", *noise_sigma, 0.0, SIGMA_MAX)?;
        in_range("the contact threshold in metres", *contact_threshold_m, 0.0, gel::APEX_M as f32)?;
        if let Some(membrane) = membrane {
            in_range("the membrane's reach in metres", membrane.reach_m, 0.0, membrane::REACH_MAX_M)?;
        }
        let shader = Shader::new(lights);
        let (gel_depth, empty) = render_empty(&shader);
        let background = match background {
            Background::Rendered => empty.clone(),
            Background::Synthetic { seed } => synthetic_background(*seed).into_raw(),
            Background::Image(image) if image.dimensions() == (WIDTH as u32, HEIGHT as u32) => image.as_raw().clone(),
            Background::Image(image) => {
                return Err(TouchError::BackgroundSize { width: image.width(), height: image.height() });
            }
        };
        Ok(Self {
            shader,
            noise: (*noise_sigma > 0.0).then(|| Noise::new(*noise_sigma)),
            contact_threshold_m: *contact_threshold_m,
            membrane: *membrane,
            gel_inverse_depth: gel_depth.iter().map(|d| 1.0 / d).collect(),
            gel_depth,
            empty,
            background,
        })
    }

    /// What the sensor shows when it touches nothing, without noise.
    pub fn empty(&self) -> RgbImage {
        // The buffer has the image's size.
        RgbImage::from_raw(WIDTH as u32, HEIGHT as u32, self.background.clone()).unwrap_or_default()
    }

    /// Depth of the gel that touches nothing, metres, 320 rows by 240 columns.
    pub fn gel_depth_m(&self) -> Array2<f32> {
        Array2::from_shape_fn((HEIGHT, WIDTH), |(v, u)| self.gel_depth[v * WIDTH + u])
    }

    /// Renders an object at a pose into `frame`, with noise on the calibrated image if a key is given.
    ///
    /// Only the outside of the object is seen; a camera inside it sees the gel.
    pub fn render(
        &self,
        object: &RayMesh,
        gel_from_object: Isometry<Object, Gel>,
        noise: Option<NoiseKey>,
        frame: &mut TouchFrame,
    ) {
        pulp::Arch::new().dispatch(Rendering { renderer: self, object, gel_from_object, noise, frame });
    }
}

/// Rendering of one frame. Compiled once per instruction set: its loops become SIMD of the widest kind that the machine has.
struct Rendering<'a> {
    renderer: &'a TouchRenderer,
    object: &'a RayMesh,
    gel_from_object: Isometry<Object, Gel>,
    noise: Option<NoiseKey>,
    frame: &'a mut TouchFrame,
}

impl pulp::WithSimd for Rendering<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Self { renderer, object, gel_from_object, noise, frame } = self;
        let TouchRenderer { shader, membrane, gel_depth, gel_inverse_depth, empty, background, .. } = renderer;
        let TouchFrame { raw, calibrated, depth_m, contact, raster, row, blur, smoothing } = frame;
        let (raw, calibrated, contact): (&mut [u8], &mut [u8], &mut [u8]) = (raw, calibrated, contact);
        raw.copy_from_slice(empty);
        calibrated.copy_from_slice(background);
        contact.fill(0);
        let depth_m = depth_m.as_slice_mut().unwrap_or_default();
        depth_m.copy_from_slice(gel_depth);

        let mut rows = raster.draw(object, gel_from_object.to_f32(), gel_inverse_depth, shader);
        if !rows.is_empty() {
            for v in rows.clone() {
                raster.depth(v, &gel_depth[pixels(v)], &mut depth_m[pixels(v)]);
            }
            if let Some(membrane) = membrane {
                rows = membrane.relax(rows, gel_depth, depth_m, smoothing);
            }
            for v in rows.clone() {
                let (gel, depth, facets) = (&gel_depth[pixels(v)], &depth_m[pixels(v)], raster.facets(v));
                let rgb = &mut raw[3 * v * WIDTH..3 * (v + 1) * WIDTH];
                row.depth.copy_from_slice(depth);
                let columns = raster.normals(v, shader, row);
                if membrane.is_some() {
                    let off_object = |u: usize| membrane::is_indented(raster.depth_at(u, v), depth[u]);
                    membrane::normals(v, depth_m, shader, off_object, row);
                    shader.shade(v, 0..WIDTH, row, |u| membrane::is_indented(gel[u], depth[u]), rgb);
                } else if let Some(columns) = columns {
                    shader.shade(v, columns, row, |u| facets[u] != MISS, rgb);
                }
                for ((mask, gel), depth) in contact[pixels(v)].iter_mut().zip(gel).zip(depth) {
                    *mask = if gel - depth > renderer.contact_threshold_m { 255 } else { 0 };
                }
            }
            blur.overlay(rows, raw, empty, background, calibrated);
        }
        if let Some((noise, key)) = renderer.noise.as_ref().zip(noise) {
            noise.add(key, calibrated);
        }
    }
}

/// Where row `v` lies in an image of one value per pixel.
fn pixels(v: usize) -> Range<usize> {
    v * WIDTH..(v + 1) * WIDTH
}

/// Depth and colours of the gel that touches nothing.
fn render_empty(shader: &Shader) -> (Vec<f32>, Vec<u8>) {
    let (mut depth, mut rgb) = (vec![0.0; WIDTH * HEIGHT], vec![0; 3 * WIDTH * HEIGHT]);
    let mut row = Row::new();
    for v in 0..HEIGHT {
        for u in 0..WIDTH {
            let point = gel::point(u as f64, v as f64);
            let normal = gel::normal(point).coords();
            row.depth[u] = point.coords().x as f32;
            for (lane, value) in row.normal.iter_mut().zip(normal.as_slice()) {
                lane[u] = *value as f32;
            }
        }
        depth[pixels(v)].copy_from_slice(&row.depth);
        shader.shade(v, 0..WIDTH, &mut row, |_| true, &mut rgb[3 * v * WIDTH..3 * (v + 1) * WIDTH]);
    }
    (depth, rgb)
}

/// One contact as arrays, shaped as TACTO returns it: 320 rows by 240 columns.
#[derive(Debug, Clone, PartialEq)]
pub struct ContactArrays {
    /// Straight from the shader: rows, columns, RGB.
    pub raw: Array3<u8>,
    /// Laid over the background: rows, columns, RGB.
    pub calibrated: Array3<u8>,
    /// Depth along the camera's axis, metres: rows, columns.
    pub depth_m: Array2<f32>,
}

/// Renders one contact of a mesh in its own coordinates, with smooth vertex normals and without noise.
/// `sensor_from_object` is TACTO's T_sensor_object, 4 x 4 and row-major, in the sensor frame of the configuration.
///
/// # Errors
/// [`TouchError`] if the matrix is not a rigid motion or the background has another size than a DIGIT's image.
pub fn render_contact(
    mesh: &Mesh,
    sensor_from_object: &[[f64; 4]; 4],
    config: TouchConfig,
    background: Background,
) -> Result<ContactArrays, TouchError> {
    let gel_from_object = config.gel_from_sensor() * Isometry::<Object, Gel>::from_matrix(sensor_from_object)?;
    let renderer = TouchRenderer::new(&TouchOptions { background, ..TouchOptions::new(config) })?;
    let mut frame = TouchFrame::default();
    renderer.render(&RayMesh::new(mesh), gel_from_object, None, &mut frame);
    let array = |image: &RgbImage| {
        Array3::from_shape_fn((HEIGHT, WIDTH, 3), |(v, u, c)| image.get_pixel(u as u32, v as u32).0[c])
    };
    Ok(ContactArrays { raw: array(&frame.raw), calibrated: array(&frame.calibrated), depth_m: frame.depth_m })
}

fn in_range(option: &'static str, value: f32, low: f32, high: f32) -> Result<(), TouchError> {
    // A comparison that NaN fails.
    if (low..=high).contains(&value) { Ok(()) } else { Err(TouchError::OutOfRange { option, value, low, high }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulp::Simd;

    /// No operation is fused and no sum reordered, so that every machine renders the same bits.
    #[test]
    fn every_instruction_set_renders_the_same_bits() {
        let corner = |x: f32, y: f32, z: f32| glam::Vec3::new(x, y, z) * 0.01;
        let mesh = Mesh {
            vertices: vec![
                corner(0.1, 0.0, 0.0),
                corner(1.0, 0.7, 0.2),
                corner(0.9, -0.8, 0.3),
                corner(1.1, 0.1, -1.3),
            ],
            faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        };
        let (object, pose) = (RayMesh::new(&mesh), Isometry::translation(0.02, 0.001, 0.002));
        for membrane in [None, Some(Membrane { reach_m: 2e-4 })] {
            let options = TouchOptions { membrane, ..TouchOptions::new(TouchConfig::Fork) };
            let renderer = TouchRenderer::new(&options).unwrap();
            let [mut best, mut plain] = [TouchFrame::default(), TouchFrame::default()];
            let noise = Some(NoiseKey { seed: 1, finger: 2, frame: 3 });
            renderer.render(&object, pose, noise, &mut best);
            let gel_from_object = pose;
            let job = Rendering { renderer: &renderer, object: &object, gel_from_object, noise, frame: &mut plain };
            pulp::Scalar128b.vectorize(job);
            assert!(best.contact().pixels().any(|p| p.0[0] == 255), "the object must be in view");
            assert_eq!(best.calibrated(), plain.calibrated());
            assert_eq!(best.depth_m().map(|d| d.to_bits()), plain.depth_m().map(|d| d.to_bits()));
        }
    }
}
