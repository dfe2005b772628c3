//! The measurements of one instant as rays: where they hit the object, and how far they passed through free space.

mod depth_sensor;
mod lens;
mod picture;
mod texels;

pub use depth_sensor::DepthSensor;
pub(crate) use lens::Lens;
pub use lens::Lookup;
pub use picture::Picture;
pub(crate) use picture::{LEAST_COSINE, LEVELS, Level, Patch};
pub(crate) use texels::Texel;
pub use texels::Texels;

use glam::Vec3;
use mvt_frames::depth::{CameraDepth, Label, TouchDepth};
use mvt_frames::{Isometry, Obstacle, Pad, World};
use mvt_settings::settings;
use ndarray::Array2;
use rand::SeedableRng as _;
use rand::seq::SliceRandom as _;
use rand_chacha::ChaCha8Rng;

settings! {
    /// Number of rays that are kept, and standard deviations of depth.
    pub struct ScanConfig {
        /// Rays kept per camera that hit the object.
        pub camera_hits: usize = 3000, 1..=1_000_000;
        /// Rays kept per camera that hit the object at its outline.
        pub camera_outline: usize = 400, 0..=1_000_000;
        /// Rays kept per camera that pass the object, half of them close to its outline.
        pub camera_misses: usize = 1500, 0..=1_000_000;
        /// Places kept per camera at which the colours of images are compared; 0 keeps none.
        pub colour_patches: usize = 120, 0..=10_000;
        /// Points kept per camera whose colours are compared pixel by pixel; 0 keeps none.
        pub texels: usize = 400, 0..=10_000;
        /// Rays kept per touching pad that hit the object.
        pub touch_hits: usize = 300, 1..=1_000_000;
        /// Rays kept per pad that end at the undisturbed gel.
        pub touch_misses: usize = 60, 0..=1_000_000;
        /// How cameras measure depth: `structured_light` or `stereo`, whose noise grows with the square of the distance, or
        /// `time_of_flight`, whose noise does not.
        pub depth_sensor: DepthSensor;
        /// Standard deviation of a camera's depth by structured light or stereo, metres per square metre of depth. The default is the
        /// disparity noise and rounding of Redwood's model at five times its level (0.144 pixels of disparity over 35.13 pixel metres).
        pub camera_sigma_per_m2: f32 = 0.0041, 1e-6..=1.0;
        /// Standard deviation of the pixel to which a camera's depth belongs, pixels.
        pub camera_jitter_px: f32 = 1.25, 0.0..=100.0;
        /// Pixels within this of another label belong to the outline.
        pub outline_px: usize = 3, 1..=20;
        /// Rays that pass within so many pixels of the object's are kept before others; 0 keeps any.
        pub near_misses_px: usize = 0, 0..=1000;
        /// Columns and rows by which a camera's depth is displaced on average, pixels. Redwood's model reads even pixels only.
        pub camera_shift_px: [f32; 2] = [0.0, 0.0], -100.0..=100.0;
        /// Whether background pixels, most of them without a return, count as rays through free space.
        pub far_is_free: bool = true;
    }
}

impl ScanConfig {
    /// Returns the standard deviation of a camera's depth along the optical axis, metres.
    pub fn camera_sigma_m(&self, depth_m: f32) -> f32 {
        self.depth_sensor.sigma_m(depth_m, self.camera_sigma_per_m2)
    }
}

/// The measurements of one instant. All of it is borrowed.
#[derive(Debug, Clone, Copy)]
pub struct Measurement<'a> {
    /// Seconds since the start.
    pub time_s: f64,
    /// One depth image per camera, in the same order at every instant; `None` from a camera that delivered nothing.
    pub cameras: &'a [Option<CameraDepth>],
    /// One depth image per touch sensor, in the same order at every instant; `None` from a sensor that delivered nothing.
    pub touch: &'a [Option<TouchDepth>],
    /// Poses of the [`Obstacles`](crate::Obstacles), in their order.
    pub obstacles: &'a [Isometry<Obstacle, World>],
}

/// Which sensor measured a ray, by its index among those of its kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sensor {
    /// A camera.
    Camera(usize),
    /// A touch sensor.
    Touch(usize),
}

/// A ray that hit the object. World frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Unit direction from the sensor.
    pub direction: Vec3,
    /// Distance from the sensor to the surface along the ray, metres.
    pub range_m: f32,
    /// Unit outward normal of the measured surface; zero where neighbours do not give one.
    pub normal: Vec3,
    /// Cosine between the ray and the normal, 0.2 to 1; 0.6 where there is no normal.
    pub cosine: f32,
    /// Standard deviation of the measured surface along its normal, metres.
    pub sigma_m: f32,
}

/// A ray that met nothing of the object. World frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Miss {
    /// Unit direction from the sensor.
    pub direction: Vec3,
    /// Free from the sensor to here, metres.
    pub free_m: f32,
}

/// The rays of one sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Where the sensor is, world frame, metres.
    pub origin: Vec3,
    /// Rays that hit the object, in random order: any leading part is a fair sample.
    pub hits: Vec<Hit>,
    /// Rays that passed it, in random order, first those close to its outline.
    pub misses: Vec<Miss>,
    /// The part that only cameras or only touch sensors have.
    pub detail: Detail,
}

/// The part of a view that only cameras or only touch sensors have.
#[derive(Debug, Clone, PartialEq)]
pub enum Detail {
    /// A camera.
    Camera {
        /// Its index among the cameras.
        index: usize,
        /// Rays that hit the object at its outline, before the background, in random order. Displaced pixels make their surface
        /// uncertain, but nothing else tells how far a face that is seen from the front reaches.
        outline: Vec<Hit>,
        /// Finds hits by where they are seen. `None` if the camera is invalid.
        lookup: Option<Lookup>,
        /// Its colours; `None` without a colour image, and in a keyframe that was read from a file.
        picture: Option<Box<Picture>>,
        /// Its texels; `None` likewise.
        texels: Option<Box<Texels>>,
    },
    /// A touch sensor.
    Touch {
        /// Its index among the touch sensors.
        index: usize,
        /// The pad that sticks to the object. `None` in a keyframe that was read from a file: only the tracker's newest frames need it.
        pad: Option<PadState>,
    },
}

/// A pad at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PadState {
    /// Where the pad is.
    pub world_from_pad: Isometry<Pad, World>,
    /// Pixels of the touch image where the object presses, of which the hits are a sample.
    pub pressed_px: usize,
}

impl View {
    /// Which sensor this is.
    pub fn sensor(&self) -> Sensor {
        match self.detail {
            Detail::Camera { index, .. } => Sensor::Camera(index),
            Detail::Touch { index, .. } => Sensor::Touch(index),
        }
    }

    /// Whether the sensor is a camera.
    pub fn is_camera(&self) -> bool {
        matches!(self.detail, Detail::Camera { .. })
    }

    /// Rays that hit the object at its outline; empty for a touch sensor.
    pub fn outline(&self) -> &[Hit] {
        match &self.detail {
            Detail::Camera { outline, .. } => outline,
            Detail::Touch { .. } => &[],
        }
    }

    /// Finds hits by where they are seen; cameras alone have it, as they stand still.
    pub fn lookup(&self) -> Option<&Lookup> {
        match &self.detail {
            Detail::Camera { lookup, .. } => lookup.as_ref(),
            Detail::Touch { .. } => None,
        }
    }

    /// Its colours, where a camera has some.
    pub fn picture(&self) -> Option<&Picture> {
        match &self.detail {
            Detail::Camera { picture, .. } => picture.as_deref(),
            Detail::Touch { .. } => None,
        }
    }

    /// Its texels, where a camera has some.
    pub(crate) fn texels(&self) -> Option<&Texels> {
        match &self.detail {
            Detail::Camera { texels, .. } => texels.as_deref(),
            Detail::Touch { .. } => None,
        }
    }

    /// Where a ray hit, world frame, metres.
    pub fn point(&self, hit: &Hit) -> Vec3 {
        self.origin + hit.direction * hit.range_m
    }
}

/// The rays of all sensors at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    /// Number of the frame.
    pub frame: usize,
    /// Seconds since the start.
    pub time_s: f64,
    /// Poses of the obstacles, in their order.
    pub obstacles: Vec<Isometry<Obstacle, World>>,
    /// One view per sensor that delivered something, cameras first.
    pub views: Vec<View>,
}

/// A pixel without depth counts as background only if all within this many pixels have none: displaced pixels fray edges by so much.
const BACKGROUND_MARGIN_PX: usize = 4;
/// Reach of the differences that give normals, pixels: long enough for a normal under noise of a millimetre.
const NORMAL_REACH_PX: usize = 5;
/// A step in depth above this over that reach is an edge and no surface, metres.
const NORMAL_STEP_M: f32 = 0.012;
/// A ray without a return is free this far, metres: past every object in the hand.
const FAR_M: f32 = 1.0;
/// Pixels by which the contact of a touch image is narrowed: at its rim object and gel blend.
const CONTACT_RIM_PX: usize = 2;

impl Scan {
    /// Draws rays from the images of an instant. The result depends on the images, the number of the frame and the seed alone.
    pub fn new(frame: usize, measured: &Measurement<'_>, config: &ScanConfig, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(frame as u64);
        let mut views = Vec::new();
        for (index, camera) in measured.cameras.iter().enumerate() {
            if let Some(camera) = camera {
                views.push(camera_view(index, camera, config, &mut rng));
            }
        }
        for (index, touch) in measured.touch.iter().enumerate() {
            if let Some(touch) = touch {
                views.push(touch_view(index, touch, config, &mut rng));
            }
        }
        Self { frame, time_s: measured.time_s, obstacles: measured.obstacles.to_vec(), views }
    }

    /// Whether a camera delivered colours.
    pub(crate) fn has_picture(&self) -> bool {
        self.views.iter().any(|view| view.picture().is_some() || view.texels().is_some())
    }

    /// The scan as one with which later frames are compared, without what they do not look at: it would be most of a keyframe's memory.
    pub(crate) fn earlier(&self) -> Self {
        let mut earlier = self.clone();
        for view in &mut earlier.views {
            if let Detail::Camera { texels: Some(texels), .. } = &mut view.detail {
                texels.levels = Vec::new();
            }
        }
        earlier
    }

    /// Number of rays that hit the object.
    pub fn hits(&self) -> usize {
        self.views.iter().map(|view| view.hits.len()).sum()
    }
}

fn camera_view(index: usize, image: &CameraDepth, config: &ScanConfig, rng: &mut ChaCha8Rng) -> View {
    // Why: notes/decisions/estimation.md, "Outline points and rays beside the outline".
    let lens = Lens::new(&image.intrinsics, image.world_from_camera, config.camera_shift_px);
    let (height, width) = image.depth_m.dim();
    let mut object = Vec::new();
    let mut outline = Vec::new();
    let mut beside = Vec::new();
    let mut passed = Vec::new();
    let rim = config.outline_px;
    let labels = image.labels.as_standard_layout();
    let labels = labels.as_slice().unwrap_or_default();
    // Without a label for each pixel nothing is known.
    let labelled = if image.labels.dim() == (height, width) { height } else { 0 };
    for v in rim..labelled.saturating_sub(rim) {
        let [above, here, below] = [v - rim, v, v + rim].map(|v| &labels[v * width..(v + 1) * width]);
        for u in rim..width.saturating_sub(rim) {
            let around = || [here[u - rim], here[u + rim], above[u], below[u]];
            let is_sample = u % 2 == 0 && v % 2 == 0;
            match here[u] {
                Label::Object => {
                    let around = around();
                    if around == [Label::Object; 4] {
                        object.push((u, v));
                    } else if around.iter().all(|&l| l == Label::Object || l == Label::Background) {
                        outline.push((u, v));
                    }
                }
                // Every fourth pixel is enough to draw from.
                Label::Hand if is_sample && image.depth_m[(v, u)] > 0.0 && image.depth_m[(v, u)].is_finite() => {
                    passed.push((u, v));
                }
                Label::Background
                    if config.far_is_free && image.depth_m[(v, u)] <= 0.0 && around().contains(&Label::Object) =>
                {
                    beside.push((u, v));
                }
                Label::Background if config.far_is_free && is_sample => passed.push((u, v)),
                _ => {}
            }
        }
    }
    let hit = |&(u, v): &(usize, usize), is_outline: bool| {
        let z = image.depth_m[(v, u)];
        let (direction, length) = lens.ray(u as f32, v as f32);
        let normal = if is_outline { Vec3::ZERO } else { lens.fitted_normal(&image.depth_m, u, v) };
        let cosine = if normal == Vec3::ZERO { 0.6 } else { (-normal.dot(direction)).clamp(0.2, 1.0) };
        let along = config.camera_sigma_m(z) * cosine;
        let sideways = if is_outline { 1.0 } else { (1.0 - cosine * cosine).sqrt() };
        let sigma_m = along.hypot(config.camera_jitter_px * z / lens.focal_px * sideways);
        (z > 0.0 && z.is_finite()).then_some(Hit { direction, range_m: z * length, normal, cosine, sigma_m })
    };
    let (chosen, _) = object.partial_shuffle(rng, config.camera_hits);
    let hits: Vec<Hit> = chosen.iter().filter_map(|pixel| hit(pixel, false)).collect();
    let (chosen, _) = outline.partial_shuffle(rng, config.camera_outline);
    let outline = chosen.iter().filter_map(|pixel| hit(pixel, true)).collect();
    let mut misses = Vec::new();
    let (chosen, _) = beside.partial_shuffle(rng, config.camera_misses / 2);
    misses.extend(chosen.iter().map(|&(u, v)| Miss { direction: lens.ray(u as f32, v as f32).0, free_m: FAR_M }));
    // Most of an image is far from the object: draw until enough is found.
    passed.shuffle(rng);
    if let Some([left, top, right, bottom]) = picture::bounds(image).filter(|_| config.near_misses_px > 0) {
        let reach = config.near_misses_px;
        let (columns, rows) = (left.saturating_sub(reach)..=right + reach, top.saturating_sub(reach)..=bottom + reach);
        passed.sort_by_key(|(u, v)| !(columns.contains(u) && rows.contains(v)));
    }
    for (u, v) in passed {
        if misses.len() >= config.camera_misses {
            break;
        }
        let z = image.depth_m[(v, u)];
        let (direction, length) = lens.ray(u as f32, v as f32);
        if z > 0.0 {
            misses.push(Miss { direction, free_m: z * length });
        } else if is_empty_around(&image.depth_m, u, v, BACKGROUND_MARGIN_PX) {
            misses.push(Miss { direction, free_m: FAR_M });
        }
    }
    let origin = lens.origin;
    let lookup = Some(Lookup::new(lens, width, height, origin, &hits));
    let picture = match config.colour_patches {
        0 => None,
        places => Picture::new(image, places).map(Box::new),
    };
    let texels = Texels::new(image, config.texels).map(Box::new);
    View { origin, hits, misses, detail: Detail::Camera { index, outline, lookup, picture, texels } }
}

fn touch_view(index: usize, image: &TouchDepth, config: &ScanConfig, rng: &mut ChaCha8Rng) -> View {
    let lens = Lens::new(&image.intrinsics, image.world_from_camera, [0.0; 2]);
    let (height, width) = image.depth_m.dim();
    let touches = |u: usize, v: usize| image.contact.get((v, u)).is_some_and(|&touches| touches);
    let mut touched = Vec::new();
    let mut free = Vec::new();
    const RIM: usize = CONTACT_RIM_PX;
    for v in RIM..height.saturating_sub(RIM) {
        for u in RIM..width.saturating_sub(RIM) {
            let around = [(u - RIM, v), (u + RIM, v), (u, v - RIM), (u, v + RIM)];
            if touches(u, v) {
                if around.iter().all(|&(u, v)| touches(u, v)) {
                    touched.push((u, v));
                }
            } else if u % 8 == 0 && v % 8 == 0 && !around.iter().any(|&(u, v)| touches(u, v)) {
                free.push((u, v));
            }
        }
    }
    let pressed_px = touched.len();
    let (chosen, _) = touched.partial_shuffle(rng, config.touch_hits);
    let hits = chosen
        .iter()
        .filter_map(|&(u, v)| {
            let z = image.depth_m[(v, u)];
            let (direction, length) = lens.ray(u as f32, v as f32);
            let normal = lens.difference_normal(&image.depth_m, u, v);
            let cosine = if normal == Vec3::ZERO { 0.6 } else { (-normal.dot(direction)).clamp(0.2, 1.0) };
            (z > 0.0 && z.is_finite()).then_some(Hit {
                direction,
                range_m: z * length,
                normal,
                cosine,
                sigma_m: image.sigma_m,
            })
        })
        .collect();
    let (chosen, _) = free.partial_shuffle(rng, config.touch_misses);
    let misses = chosen
        .iter()
        .filter_map(|&(u, v)| {
            let z = image.depth_m[(v, u)];
            let (direction, length) = lens.ray(u as f32, v as f32);
            (z > 0.0 && z.is_finite()).then_some(Miss { direction, free_m: z * length })
        })
        .collect();
    let pad = Some(PadState { world_from_pad: image.world_from_pad, pressed_px });
    View { origin: lens.origin, hits, misses, detail: Detail::Touch { index, pad } }
}

fn is_empty_around(depth_m: &Array2<f32>, u: usize, v: usize, margin: usize) -> bool {
    let (height, width) = depth_m.dim();
    let rows = v.saturating_sub(margin)..(v + margin + 1).min(height);
    rows.step_by(2)
        .all(|v| (u.saturating_sub(margin)..(u + margin + 1).min(width)).step_by(2).all(|u| depth_m[(v, u)] <= 0.0))
}

#[cfg(test)]
mod tests;
