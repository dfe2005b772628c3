//! Touch images of an object that is pressed into the gel: colour, depth and contact, as TACTO renders them.
//!
//! TACTO draws the gel and the rigid object that pokes through it; nothing deforms. Each pixel shows the nearer
//! surface, shaded by three LEDs. All of this has a closed form, and only pixels in contact differ from the untouched
//! gel, which is rendered once in [`TouchRenderer::new`]. With a background, the change from the untouched gel is
//! halved, blurred and added to the image of a real sensor. [`TouchOptions`] go beyond TACTO; their defaults reproduce
//! it. The [front page](crate) has an example.
//!
//! Constants that are named after TACTO come from its `config_digit.yml` (version 0.0.3); those of its fork from the
//! fork's own.

mod background;
mod calibrate;
mod gel_light;
mod light;
mod markers;
mod membrane;
mod noise;
mod raster;
mod shade;

use std::mem::take;

use image::RgbImage;
use mvt_frames::camera::Intrinsics;
use mvt_frames::{Gel, Isometry, NotRigid, Object};
use mvt_mesh::Mesh;
use mvt_robot::digit::gel::GelSurface;
use mvt_robot::digit::markers::{GelShear, MarkerPattern};
use mvt_robot::digit::profile::{Appearance, SensorProfile};
use mvt_robot::hand::{Hand, PerPad, TouchPad};
use mvt_robot::observation::TouchTruth;
use ndarray::{Array2, Array3};

use crate::rays::{MISS, RayMesh};
pub use background::synthetic_background;
use calibrate::Blur;
use gel_light::GelLight;
pub use light::{Light, Lights, Spot};
use markers::Markers;
pub use membrane::Membrane;
pub use noise::NoiseKey;
use noise::{Noise, SIGMA_MAX};
use raster::Raster;
use shade::{Row, Shader};

/// DIGIT configuration of TACTO: lights, noise and sensor frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum TouchConfig {
    /// The fork of TACTO behind YCB-Slide and FeelSight: green, red and blue spot lights, noise of 2 grey.
    Fork,
    /// TACTO 0.0.3: red, green and blue point lights, noise of 7 grey.
    Tacto,
}

impl TouchConfig {
    /// All configurations, in alphabetical order.
    pub const ALL: [Self; 2] = [Self::Fork, Self::Tacto];

    /// Returns the name, which [`str::parse`] reads.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fork => "fork",
            Self::Tacto => "tacto",
        }
    }

    /// Returns the pose of the configuration's sensor frame in the gel frame. TACTO 0.0.3 has the camera at z = 15 mm
    /// (`camera.position`), its fork at the origin.
    ///
    /// It takes TACTO's `T_sensor_object`, a pose in the sensor frame, to the object's pose in the gel frame.
    pub fn gel_from_sensor(self) -> Isometry<Gel, Gel> {
        match self {
            Self::Fork => Isometry::identity(),
            Self::Tacto => Isometry::translation(0.0, 0.0, -0.015),
        }
    }

    /// Returns the standard deviation of the configuration's image noise, grey levels (`noise.color.std`).
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

/// Untouched image to which the change by a press is added.
#[derive(Debug, Clone, PartialEq)]
pub enum Background {
    /// The rendered gel.
    Rendered,
    /// An image like that of a real DIGIT, see [`synthetic_background`].
    Synthetic {
        /// Seed of the image.
        seed: u64,
    },
    /// The untouched image of a real sensor, of the size of its images.
    Image(RgbImage),
}

/// Default contact threshold, metres: 0.2 times the least press depth of MidasTouch's protocol (0.5 mm), the share that
/// MidasTouch counts as contact.
const CONTACT_THRESHOLD_M: f32 = 1e-4;

/// With an [`Appearance`] a pixel touches where the object lies on the gel: where the gap between them is smaller than this, metres.
/// The rim that people see around a ball in a real image has this gap.
const CONTACT_GAP_M: f32 = 1.4e-5;

/// Options of a [`TouchRenderer`].
#[derive(Debug, Clone, PartialEq)]
pub struct TouchOptions {
    /// The camera. Default: that of TACTO's DIGIT.
    pub camera: Intrinsics,
    /// Surface of the undeformed gel. Default: that of a DIGIT.
    pub gel: GelSurface,
    /// How the gel of a real sensor looks; it replaces `lights`, and contact is where the object lies on the gel. Default: `None`.
    pub appearance: Option<Appearance>,
    /// The LEDs of TACTO. Default: those of the configuration; [`Lights::perturbed`] draws others for training.
    pub lights: Lights,
    /// The untouched image. Default: the rendered gel.
    pub background: Background,
    /// Standard deviation of the noise in grey levels, 0 to 28, for frames that ask for noise. Default: that of the
    /// configuration.
    pub noise_sigma: f32,
    /// Indentation above which a pixel counts as contact, metres, compared with the unrounded depth. Default: 0.1 mm.
    pub contact_threshold_m: f32,
    /// Deformation of the gel around the object. Default: `None`, as in TACTO, whose gel does not deform.
    pub membrane: Option<Membrane>,
    /// Dots on the gel, which a background must not show. Default: `None`.
    pub markers: Option<MarkerPattern>,
}

impl TouchOptions {
    /// Returns the options with which the renderer reproduces TACTO in this configuration.
    pub fn new(config: TouchConfig) -> Self {
        let tacto = SensorProfile::tacto();
        Self {
            camera: tacto.intrinsics(),
            gel: tacto.gel_surface(),
            appearance: None,
            lights: Lights::of(config),
            background: Background::Rendered,
            noise_sigma: config.noise_sigma(),
            contact_threshold_m: CONTACT_THRESHOLD_M,
            membrane: None,
            markers: None,
        }
    }

    /// Returns the options of the sensors of a hand, each with a synthetic background of its own unless one is given for all.
    pub fn of_hand(hand: &Hand, config: TouchConfig, background: Option<&RgbImage>) -> PerPad<Self> {
        let options = |(pad, of): (usize, &TouchPad)| {
            let synthetic = Background::Synthetic { seed: pad as u64 };
            let background = background.map_or(synthetic, |image| Background::Image(image.clone()));
            Self { background, ..Self::of_profile(&of.profile, config) }
        };
        hand.pads().iter().enumerate().map(options).collect()
    }

    /// Returns the options of a sensor. For the profile of TACTO they are those of TACTO's configuration.
    pub fn of_profile(profile: &SensorProfile, config: TouchConfig) -> Self {
        let tacto = Self::new(config);
        Self {
            camera: profile.intrinsics(),
            gel: profile.gel_surface(),
            appearance: profile.appearance,
            noise_sigma: profile.appearance.map_or(tacto.noise_sigma, |appearance| appearance.noise_grey),
            membrane: (profile.reach_mm > 0.0).then_some(Membrane { reach_m: 1e-3 * profile.reach_mm }),
            markers: profile.markers,
            ..tacto
        }
    }
}

/// Reason why options or a pose are refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TouchError {
    /// The name of a configuration is unknown.
    #[error("unknown touch configuration {0:?}: choose fork or tacto")]
    UnknownConfig(String),
    /// A pose is not a rigid motion.
    #[error("T_sensor_object is {0}")]
    Pose(#[from] NotRigid),
    /// The background has another size than the sensor's images.
    #[error("the background is {width} x {height} pixels; this sensor's images are {} wide and {} high: resize it", expected[0], expected[1])]
    BackgroundSize {
        /// Width and height of the sensor's images, pixels.
        expected: [usize; 2],
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

/// One touch image with its ground truth, and the working memory of the renderer: reuse it from frame to frame. It is empty before the
/// first rendering.
#[derive(Default)]
pub struct TouchFrame {
    raw: RgbImage,
    calibrated: RgbImage,
    depth_m: Array2<f32>,
    contact: Array2<bool>,
    raster: Raster,
    row: Row,
    blur: Blur,
    smoothing: membrane::Scratch,
    lighting: gel_light::Scratch,
}

impl TouchFrame {
    /// Returns the image as TACTO's shader renders it: no background, no noise. With an [`Appearance`] it shows the untouched gel.
    pub fn raw(&self) -> &RgbImage {
        &self.raw
    }

    /// Returns the image that the sensor would record: on its background, and with noise if the rendering got a noise
    /// key.
    pub fn calibrated(&self) -> &RgbImage {
        &self.calibrated
    }

    /// Returns the depth along the camera's axis to the nearer of gel and object, metres, indexed (row, column).
    pub fn depth_m(&self) -> &Array2<f32> {
        &self.depth_m
    }

    /// Returns where the object touches: where it presses into the gel by more than the threshold or, with an [`Appearance`], where it
    /// lies on the gel.
    pub fn contact(&self) -> &Array2<bool> {
        &self.contact
    }

    /// Moves the calibrated image, the depth and the contact out of the frame, without a copy. They are empty until the
    /// next rendering.
    pub fn take(&mut self) -> (RgbImage, TouchTruth) {
        let truth = TouchTruth { depth_m: take(&mut self.depth_m), contact: take(&mut self.contact) };
        (take(&mut self.calibrated), truth)
    }

    /// Makes room for the images of a camera: replaces those that were taken, or that were of another sensor.
    fn resize(&mut self, camera: &Intrinsics) {
        let &Intrinsics { width, height, .. } = camera;
        for image in [&mut self.raw, &mut self.calibrated] {
            if image.dimensions() != (width as u32, height as u32) {
                *image = RgbImage::new(width as u32, height as u32);
            }
        }
        if self.depth_m.dim() != (height, width) {
            self.contact = Array2::default((height, width));
            self.depth_m = Array2::zeros((height, width));
        }
        self.row.resize(width);
    }
}

/// Renderer of touch images. It is immutable, so that all threads share one; each thread brings its own [`TouchFrame`].
pub struct TouchRenderer {
    shader: Shader,
    light: Option<GelLight>,
    noise: Option<Noise>,
    contact_threshold_m: f32,
    membrane: Option<Membrane>,
    markers: Option<Markers>,
    /// Depth of the untouched gel and its inverse, its colours, and the background, row by row.
    gel_depth: Vec<f32>,
    gel_inverse_depth: Vec<f32>,
    empty: Vec<u8>,
    background: Vec<u8>,
}

impl TouchRenderer {
    /// Renders the untouched gel.
    ///
    /// # Errors
    /// [`TouchError`] if the background has another size than the sensor's images or a number is out of range.
    pub fn new(options: &TouchOptions) -> Result<Self, TouchError> {
        let TouchOptions { camera, gel, appearance, lights, background, noise_sigma, .. } = options;
        let TouchOptions { contact_threshold_m, membrane, markers, .. } = options;
        in_range("the noise's sigma", *noise_sigma, 0.0, SIGMA_MAX)?;
        in_range("the contact threshold in metres", *contact_threshold_m, 0.0, gel.apex_m() as f32)?;
        if let Some(membrane) = membrane {
            in_range("the membrane's reach in metres", membrane.reach_m, 0.0, membrane::REACH_MAX_M)?;
        }
        let shader = Shader::new(lights, *camera, *gel);
        let (gel_depth, empty) = render_empty(&shader);
        let size = [camera.width, camera.height];
        let background = match background {
            Background::Rendered => empty.clone(),
            Background::Synthetic { seed } => synthetic_background(size, *seed).into_raw(),
            Background::Image(image) if image.dimensions() == (size[0] as u32, size[1] as u32) => {
                image.as_raw().clone()
            }
            Background::Image(image) => {
                return Err(TouchError::BackgroundSize {
                    expected: size,
                    width: image.width(),
                    height: image.height(),
                });
            }
        };
        let blur_px = appearance.map_or(0.0, |appearance| appearance.blur_px);
        let light = appearance
            .as_ref()
            .map(|appearance| GelLight::new(appearance, &image_of(camera, background.clone()), &gel_depth, &shader));
        Ok(Self {
            shader,
            light,
            noise: (*noise_sigma > 0.0).then(|| Noise::new(*noise_sigma)),
            contact_threshold_m: *contact_threshold_m,
            membrane: *membrane,
            markers: markers.as_ref().map(|pattern| Markers::new(pattern, *camera, *gel, blur_px)),
            gel_inverse_depth: gel_depth.iter().map(|d| 1.0 / d).collect(),
            gel_depth,
            empty,
            background,
        })
    }

    /// Returns the untouched image, without noise.
    pub fn empty(&self) -> RgbImage {
        let mut image = image_of(&self.shader.camera, self.background.clone());
        if let Some(markers) = &self.markers {
            markers.paint_untouched(&mut image);
        }
        image
    }

    /// Returns the depth of the untouched gel, metres, indexed (row, column).
    pub fn gel_depth_m(&self) -> Array2<f32> {
        let Intrinsics { width, height, .. } = self.shader.camera;
        Array2::from_shape_fn((height, width), |(v, u)| self.gel_depth[v * width + u])
    }

    /// Renders an object at a pose into `frame`, with noise on the calibrated image if a key is given.
    ///
    /// Only the outside of the object is visible; a camera inside the object sees the gel.
    pub fn render(
        &self,
        object: &RayMesh,
        gel_from_object: Isometry<Object, Gel>,
        noise: Option<NoiseKey>,
        frame: &mut TouchFrame,
    ) {
        self.render_dragged(object, GelPress { gel_from_object, shear: GelShear::default() }, noise, frame);
    }

    /// Renders as [`TouchRenderer::render`] does an object that drags the gel along, which moves the dots of a gel that has some.
    pub fn render_dragged(&self, object: &RayMesh, press: GelPress, noise: Option<NoiseKey>, frame: &mut TouchFrame) {
        frame.resize(&self.shader.camera);
        pulp::Arch::new().dispatch(Rendering { renderer: self, object, press, noise, frame });
    }
}

/// An object at a gel, and how it has dragged the gel along.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GelPress {
    /// Pose of the object.
    pub gel_from_object: Isometry<Object, Gel>,
    /// Displacement of the gel at the contact.
    pub shear: GelShear,
}

/// Rendering of one frame. It is compiled once per instruction set: its loops use the widest vectors of the machine.
struct Rendering<'a> {
    renderer: &'a TouchRenderer,
    object: &'a RayMesh,
    press: GelPress,
    noise: Option<NoiseKey>,
    frame: &'a mut TouchFrame,
}

impl pulp::WithSimd for Rendering<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Self { renderer, object, press: GelPress { gel_from_object, shear }, noise, frame } = self;
        let TouchRenderer { shader, light, membrane, gel_depth, gel_inverse_depth, empty, background, .. } = renderer;
        let TouchFrame { raw, calibrated, depth_m, contact, raster, row, blur, smoothing, lighting } = frame;
        let Intrinsics { width, .. } = shader.camera;
        let pixels = |v: usize| v * width..(v + 1) * width;
        let raw: &mut [u8] = raw;
        raw.copy_from_slice(empty);
        calibrated.copy_from_slice(background);
        contact.fill(false);
        depth_m.as_slice_mut().unwrap_or_default().copy_from_slice(gel_depth);

        let mut rows = raster.draw(object, gel_from_object.to_f32(), gel_inverse_depth, shader);
        if !rows.is_empty() {
            let calibrated: &mut [u8] = calibrated;
            let contact = contact.as_slice_mut().unwrap_or_default();
            let depth_m = depth_m.as_slice_mut().unwrap_or_default();
            for v in rows.clone() {
                raster.depth(v, &gel_depth[pixels(v)], &mut depth_m[pixels(v)]);
            }
            if let Some(membrane) = membrane {
                rows = membrane.relax(&shader.camera, shader.gel, rows, gel_depth, depth_m, smoothing);
            }
            if let Some(light) = light {
                light.cast(gel_depth, depth_m, shader, lighting);
            }
            for v in rows.clone() {
                let (gel, depth, facets) = (&gel_depth[pixels(v)], &depth_m[pixels(v)], raster.facets(v));
                let rgb = &mut raw[3 * v * width..3 * (v + 1) * width];
                row.depth.copy_from_slice(depth);
                let columns = raster.normals(v, shader, row);
                if let Some(light) = light {
                    let on_object =
                        |u: usize| facets[u] != MISS && !membrane::is_indented(raster.depth_at(u, v), depth[u]);
                    membrane::normals(v, depth_m, shader, |u| !on_object(u), row);
                    light.shade(v, row, shader, |u| membrane::is_indented(gel[u], depth[u]), lighting);
                    for (u, touches) in contact[pixels(v)].iter_mut().enumerate() {
                        *touches = facets[u] != MISS && raster.depth_at(u, v) - depth[u] < CONTACT_GAP_M;
                    }
                    continue;
                }
                if membrane.is_some() {
                    let off_object = |u: usize| membrane::is_indented(raster.depth_at(u, v), depth[u]);
                    membrane::normals(v, depth_m, shader, off_object, row);
                    shader.shade(v, 0..width, row, |u| membrane::is_indented(gel[u], depth[u]), rgb);
                } else if let Some(columns) = columns {
                    shader.shade(v, columns, row, |u| facets[u] != MISS, rgb);
                }
                for ((touches, gel), depth) in contact[pixels(v)].iter_mut().zip(gel).zip(depth) {
                    *touches = gel - depth > renderer.contact_threshold_m;
                }
            }
            match light {
                Some(light) => light.overlay(width, rows, lighting, background, calibrated),
                None => blur.overlay(width, rows, [raw, empty, background], calibrated),
            }
        }
        if let Some(markers) = &renderer.markers {
            markers.paint(shear, gel_depth, depth_m, contact, calibrated);
        }
        if let Some((noise, key)) = renderer.noise.as_ref().zip(noise) {
            noise.add(key, calibrated);
        }
    }
}

/// Returns the image of a camera from its colours.
fn image_of(camera: &Intrinsics, rgb: Vec<u8>) -> RgbImage {
    // The buffer has the image's size.
    RgbImage::from_raw(camera.width as u32, camera.height as u32, rgb).unwrap_or_default()
}

/// Returns depth and colours of the untouched gel.
fn render_empty(shader: &Shader) -> (Vec<f32>, Vec<u8>) {
    let (gel, Intrinsics { width, height, .. }) = (shader.gel, shader.camera);
    let (mut depth, mut rgb) = (vec![0.0; width * height], vec![0; 3 * width * height]);
    let mut row = Row::default();
    row.resize(width);
    for v in 0..height {
        for u in 0..width {
            let point = gel.point(&shader.camera, u as f64, v as f64);
            let normal = gel.normal(point).coords();
            row.depth[u] = point.coords().x as f32;
            for (lane, value) in row.normal.iter_mut().zip(normal.as_slice()) {
                lane[u] = *value as f32;
            }
        }
        depth[v * width..(v + 1) * width].copy_from_slice(&row.depth);
        shader.shade(v, 0..width, &mut row, |_| true, &mut rgb[3 * v * width..3 * (v + 1) * width]);
    }
    (depth, rgb)
}

/// Images of one press as arrays in TACTO's shape: 320 rows by 240 columns.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ContactArrays {
    /// Without background: rows, columns, RGB.
    pub raw: Array3<u8>,
    /// On the background: rows, columns, RGB.
    pub calibrated: Array3<u8>,
    /// Depth along the camera's axis, metres: rows, columns.
    pub depth_m: Array2<f32>,
}

/// Renders one press of a mesh in its own coordinates, with smooth vertex normals and without noise.
/// `sensor_from_object` is TACTO's `T_sensor_object`, 4 x 4 and row-major, in the sensor frame of the configuration.
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
        let shape = (image.height() as usize, image.width() as usize, 3);
        Array3::from_shape_fn(shape, |(v, u, c)| image.get_pixel(u as u32, v as u32).0[c])
    };
    Ok(ContactArrays { raw: array(&frame.raw), calibrated: array(&frame.calibrated), depth_m: frame.depth_m })
}

fn in_range(option: &'static str, value: f32, low: f32, high: f32) -> Result<(), TouchError> {
    // NaN fails this comparison.
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
            let noise = Some(NoiseKey { seed: 1, pad: 2, frame: 3 });
            renderer.render(&object, pose, noise, &mut best);
            plain.resize(&renderer.shader.camera);
            let press = GelPress { gel_from_object: pose, shear: GelShear::default() };
            let job = Rendering { renderer: &renderer, object: &object, press, noise, frame: &mut plain };
            pulp::Scalar128b.vectorize(job);
            assert!(best.contact().iter().any(|&touches| touches), "the object must be in view");
            assert_eq!(best.calibrated(), plain.calibrated());
            assert_eq!(best.depth_m().map(|d| d.to_bits()), plain.depth_m().map(|d| d.to_bits()));
        }
    }
}
