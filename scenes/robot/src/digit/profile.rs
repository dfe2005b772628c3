//! Descriptions of touch sensors of the DIGIT's kind, in files that anybody can write.

use std::path::{Path, PathBuf};

use mvt_frames::camera::Intrinsics;
use mvt_settings::{Limit as _, Nested, SettingError, settings};
use serde::{Deserialize, Serialize};

use super::body::SensorBody;
use super::gel::{GelSurface, GelView};
use super::markers::MarkerPattern;
use super::{FOV_Y_DEG, HEIGHT, WIDTH};

settings! {
    /// How the gel of a real sensor looks: the light of three LEDs close to the gel, and the camera's image of it. Directions, lengths and
    /// levels are those of the image and the gel's centre.
    #[derive(Copy)]
    pub struct Appearance {
        /// Direction towards the red, green and blue LED in the image, degrees; 0 is right and 90 is down.
        pub led_angles_deg: [f64; 3] = [-47.0, -163.0, 77.0], -360.0..=360.0;
        /// Distance of the LEDs from the centre of the gel, along the gel, millimetres.
        pub led_distance_mm: f64 = 11.0, 4.0..=100.0;
        /// Elevation of the LEDs over the gel, seen from its centre, degrees.
        pub led_elevation_deg: f64 = 18.0, 5.0..=80.0;
        /// Change of red, green and blue per unit of slope towards the LED, grey levels.
        pub sensitivity: [f32; 3] = [125.0, 110.0, 125.0], 1.0..=1000.0;
        /// Mean red, green and blue of an untouched image under the light for which `sensitivity` is stated, grey levels.
        pub untouched_levels: [f32; 3] = [97.0, 101.0, 95.0], 1.0..=255.0;
        /// Contrast of such an image: the standard deviation of the logarithm of its levels over the gel, mean of red, green and blue. It shows
        /// another response of a camera. 0: unknown.
        pub untouched_contrast: f32 = 0.38, 0.0..=3.0;
        /// Sensitivity is multiplied by the untouched level, relative to its mean, to the power of this.
        pub background_exponent: [f32; 3] = [1.0, 1.5, 0.3], 0.0..=4.0;
        /// Levels grow as light to the power of 1 / response.
        pub response: f32 = 1.0, 0.5..=3.0;
        /// Share of an LED's light that is missing where the gel casts a shadow.
        pub cast_shadow: f32 = 0.8, 0.0..=1.0;
        /// Standard deviation of the blur, pixels.
        pub blur_px: f32 = 1.8, 0.0..=4.0;
        /// Standard deviation of the noise, grey levels.
        pub noise_grey: f32 = 1.8, 0.0..=28.0;
    }
}

// Why: notes/decisions/touch.md, "A profile describes a sensor wholly, and each pad of a hand has one".
/// A touch sensor: its camera's view of the gel, the softness and look of the gel, and its body. A key that a file lacks has the value of
/// TACTO's DIGIT, which is the default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensorProfile {
    /// Width and height of its images, pixels.
    pub size_px: [usize; 2],
    /// Places of the corners of its images in those that its camera delivers, pixels from the left and from the top: top left, top right, bottom right
    /// and bottom left. Without them the camera's images are whole.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub corners_px: Option<[[f64; 2]; 4]>,
    /// Images that its camera delivers per second.
    pub frame_hz: f64,
    /// Vertical field of view of the camera, degrees.
    pub fov_y_deg: f64,
    /// Distance from the camera to the apex of the gel, which lies on the camera's axis, millimetres.
    pub apex_mm: f64,
    /// Size of the pad along the columns and rows of its images, millimetres.
    pub size_mm: [f64; 2],
    /// Difference in depth between the apex of the gel and the corners of the pad, millimetres; 0 for a flat gel.
    pub bulge_mm: f64,
    /// Distance beyond a contact over which the gel's indentation fades to 1/e, millimetres. 0: the gel does not deform around a contact.
    pub reach_mm: f32,
    /// Indentation of the gel at the border of a contact, millimetres: beyond it the gel bends without touching. Light presses have less.
    pub flank_mm: f32,
    /// Normal force on the gel over the volume that is pressed in where it touches, newtons per cubic millimetre.
    pub stiffness_n_per_mm3: f32,
    /// Standard deviation of the stiffness, as a share of it.
    pub stiffness_deviation: f32,
    /// Weights of the network that reads its images, relative to the file of the profile. Without it: those that are shipped.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights: Option<PathBuf>,
    /// How the gel looks. Without it: as TACTO renders it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub appearance: Option<Appearance>,
    /// Dots on the gel, by whose motion shear is seen. Without it: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub markers: Option<MarkerPattern>,
    /// Its body on a hand.
    pub body: SensorBody,
}

impl Default for SensorProfile {
    fn default() -> Self {
        Self {
            size_px: [WIDTH, HEIGHT],
            corners_px: None,
            // The fast mode of a DIGIT.
            frame_hz: 60.0,
            fov_y_deg: FOV_Y_DEG,
            apex_mm: 22.0,
            size_mm: [20.0, 30.0],
            // TACTO's `curvatureMax`.
            bulge_mm: 5.0,
            reach_mm: 0.0,
            flank_mm: 0.0,
            // A silicone of 0.3 MPa, 3 mm thick, on a hard back: pressure over indentation is modulus / (1 - 0.45^2) / thickness. Gels differ by half.
            stiffness_n_per_mm3: 0.13,
            stiffness_deviation: 0.5,
            weights: None,
            appearance: None,
            markers: None,
            body: SensorBody::default(),
        }
    }
}

/// Names and files of the profiles that the program brings along.
const SHIPPED: [(&str, &str); 5] = [
    ("digit", include_str!("profiles/digit.toml")),
    ("digit_markers", include_str!("profiles/digit_markers.toml")),
    ("gelsight_mini", include_str!("profiles/gelsight_mini.toml")),
    ("gelsight_mini_markers", include_str!("profiles/gelsight_mini_markers.toml")),
    ("tacto", include_str!("profiles/tacto.toml")),
];

/// Largest file of a profile that is read, bytes.
const LARGEST_FILE: u64 = 1 << 16;

/// Reason that a profile cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProfileError {
    /// There is no profile of this name, and no file.
    #[error(
        "there is no sensor profile {0:?}: choose digit, digit_markers, gelsight_mini, gelsight_mini_markers or tacto, or give the path of a \
         file that ends in .toml"
    )]
    Unknown(String),
    /// The file cannot be read.
    #[error("cannot read the sensor profile {path}: {reason}")]
    Read {
        /// Path of the file.
        path: String,
        /// Reason of the operating system.
        reason: std::io::Error,
    },
    /// The file is no profile.
    #[error("{path} is no sensor profile: {reason}")]
    Format {
        /// Path of the file.
        path: String,
        /// Reason of the parser.
        reason: Box<toml::de::Error>,
    },
    /// A value is out of range.
    #[error("sensor profile {path}: {reason}")]
    Range {
        /// Path of the file.
        path: String,
        /// The value.
        reason: SettingError,
    },
}

impl SensorProfile {
    /// Returns the profile of TACTO's DIGIT.
    pub fn tacto() -> Self {
        Self::default()
    }

    /// Returns whether it is the profile of TACTO's DIGIT.
    pub fn is_tacto(&self) -> bool {
        *self == Self::default()
    }

    /// Returns the profile of a name (`digit`, `digit_markers`, `gelsight_mini`, `gelsight_mini_markers`, `tacto`) or of a file whose path ends in `.toml`.
    ///
    /// # Errors
    /// [`ProfileError`] if there is no such profile, or the file is invalid.
    pub fn load(name_or_path: &str) -> Result<Self, ProfileError> {
        let text = match SHIPPED.into_iter().find(|(name, _)| *name == name_or_path) {
            Some((_, text)) => text.to_owned(),
            None if name_or_path.ends_with(".toml") => {
                mvt_files::input::read_text(Path::new(name_or_path), LARGEST_FILE)
                    .map_err(|reason| ProfileError::Read { path: name_or_path.to_owned(), reason })?
            }
            None => return Err(ProfileError::Unknown(name_or_path.to_owned())),
        };
        let mut profile: Self = toml::from_str(&text)
            .map_err(|reason| ProfileError::Format { path: name_or_path.to_owned(), reason: Box::new(reason) })?;
        profile.validate().map_err(|reason| ProfileError::Range { path: name_or_path.to_owned(), reason })?;
        // Absolute, so that the profile can be written to another file.
        let beside = |weights: PathBuf| Path::new(name_or_path).with_file_name(weights);
        profile.weights = profile.weights.map(beside).map(|path| std::path::absolute(&path).unwrap_or(path));
        Ok(profile)
    }

    /// Checks all values.
    ///
    /// # Errors
    /// [`SettingError`] names the first value that is out of range.
    pub fn validate(&self) -> Result<(), SettingError> {
        (32..=1024).check("size_px", &self.size_px)?;
        if let Some(corners) = &self.corners_px {
            corners.iter().try_for_each(|corner| (0.0..=20_000.0).check("corners_px", corner))?;
            if !is_convex(corners) {
                let range = "the corners of a convex figure, one after the other around it";
                return Err(SettingError::new("corners_px", format!("{corners:?}"), range));
            }
        }
        (1.0..=1000.0).check("frame_hz", &self.frame_hz)?;
        (20.0..=100.0).check("fov_y_deg", &self.fov_y_deg)?;
        (2.0..=100.0).check("apex_mm", &self.apex_mm)?;
        (2.0..=100.0).check("size_mm", &self.size_mm)?;
        (0.0..=8.0).check("bulge_mm", &self.bulge_mm)?;
        (0.0..=1.5).check("reach_mm", &self.reach_mm)?;
        (0.0..=5.0).check("flank_mm", &self.flank_mm)?;
        (1e-4..=100.0).check("stiffness_n_per_mm3", &self.stiffness_n_per_mm3)?;
        (0.0..=10.0).check("stiffness_deviation", &self.stiffness_deviation)?;
        // The gel comes nearest to the camera in the corners of the image. NaN: the corner shows no gel.
        let corner_m = self.gel_surface().point(&self.intrinsics(), 0.0, 0.0).coords().x;
        if corner_m.is_nan() || corner_m < 1e-3 {
            let range = "such that the gel fills the image, 1 mm or more before the camera";
            return Err(SettingError::new("bulge_mm", self.bulge_mm.to_string(), range));
        }
        self.appearance.as_ref().map_or(Ok(()), |appearance| Nested.check("appearance", appearance))?;
        if let Some(markers) = &self.markers {
            Nested.check("markers", markers)?;
            markers.check_on(self.size_mm).map_err(|error| error.within("markers"))?;
        }
        Nested.check("body", &self.body)
    }

    /// Returns by how much the change of red, green and blue must be multiplied to look as on the sensor that a network was trained for.
    /// Without an appearance nothing is multiplied.
    pub fn gains(&self, trained_for: &Appearance) -> [f32; 3] {
        let Some(appearance) = &self.appearance else { return [1.0; 3] };
        std::array::from_fn(|c| (trained_for.sensitivity[c] / appearance.sensitivity[c]).clamp(0.25, 4.0))
    }

    /// Returns the size of a pixel on the gel around the camera's axis, millimetres.
    pub fn pixel_mm(&self) -> f64 {
        self.apex_mm / self.intrinsics().fx
    }

    /// Returns the camera's view of the undeformed gel.
    pub fn gel_view(&self) -> GelView {
        GelView::new(self.intrinsics(), self.gel_surface())
    }

    /// Returns the surface of the undeformed gel.
    pub fn gel_surface(&self) -> GelSurface {
        GelSurface::new(self.apex_mm / 1e3, self.size_mm.map(|mm| mm / 1e3), self.bulge_mm / 1e3)
    }

    /// Returns the pinhole model of the camera.
    pub fn intrinsics(&self) -> Intrinsics {
        let [width, height] = self.size_px;
        Intrinsics::from_fov_y(width, height, self.fov_y_deg.to_radians())
    }

    /// Returns rows and columns of its images.
    pub fn shape(&self) -> [usize; 2] {
        let [width, height] = self.size_px;
        [height, width]
    }
}

/// Returns whether corners go around a convex figure that is not flat, either way.
fn is_convex(corners: &[[f64; 2]; 4]) -> bool {
    /// Least area of the triangle at a corner, twice, square pixels.
    const LEAST: f64 = 100.0;
    let turns: [f64; 4] = std::array::from_fn(|k| {
        let [[ax, ay], [bx, by], [cx, cy]] = [0, 1, 2].map(|next| corners[(k + next) % 4]);
        (bx - ax) * (cy - by) - (by - ay) * (cx - bx)
    });
    turns.iter().all(|turn| *turn > LEAST) || turns.iter().all(|turn| *turn < -LEAST)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::digit::gel::APEX_M;

    #[test]
    fn shipped_profiles_are_valid() {
        assert_eq!(SensorProfile::load("tacto").unwrap(), SensorProfile::tacto());
        let digit = SensorProfile::load("digit").unwrap();
        // 18.8 pixels per millimetre at the apex of the gel, as an edge of known length shows.
        let px_per_mm = digit.intrinsics().fx / (1e3 * APEX_M);
        assert!((px_per_mm - 18.8).abs() < 0.1, "{px_per_mm}");
        assert_eq!(digit.appearance, Some(Appearance::default()));
        assert_eq!(digit.gains(&Appearance::default()), [1.0; 3]);
        assert_eq!(digit.gel_surface(), SensorProfile::tacto().gel_surface());
        assert_eq!(SensorProfile::tacto().gel_surface(), GelSurface::new(APEX_M, [0.02, 0.03], 0.005));
        // Those with markers differ by their dots alone.
        for name in ["digit", "gelsight_mini"] {
            let marked = SensorProfile::load(&format!("{name}_markers")).unwrap();
            assert!(marked.markers.is_some());
            assert_eq!(SensorProfile { markers: None, ..marked }, SensorProfile::load(name).unwrap());
        }
        let mini = SensorProfile::load("gelsight_mini").unwrap();
        // A flat gel of which 15.2 x 20.3 mm are in view.
        let view = mini.gel_view();
        assert!(view.depth_m().iter().all(|depth_m| (depth_m - 0.022).abs() < 1e-8));
        let side_mm = |pixels: usize, focal_px: f64| 22.0 * pixels as f64 / focal_px;
        let [width, height] = [side_mm(WIDTH, mini.intrinsics().fx), side_mm(HEIGHT, mini.intrinsics().fy)];
        assert!((width - 0.0634 * 240.0).abs() < 0.02 && (height - 0.0634 * 320.0).abs() < 0.02, "{width} x {height}");
    }

    #[test]
    fn invalid_profiles_are_refused_with_the_reason() {
        let refused = |name: &str| SensorProfile::load(name).unwrap_err().to_string();
        assert!(refused("digitt").contains("choose digit, digit_markers"));
        assert!(refused("/nowhere/a.toml").contains("cannot read"));
        let invalid = |text: &str| toml::from_str::<SensorProfile>(text).map(|profile| profile.validate());
        assert!(invalid("fov_y_deg = 40.0\nreach_mm = 0.5\nrange = 1").is_err());
        for wrong in [
            "size_px = [0, 0]",
            "size_px = [240, 2000]",
            "frame_hz = 0.0",
            "corners_px = [[0.0, 0.0], [90.0, 90.0], [90.0, 0.0], [0.0, 90.0]]",
            "corners_px = [[0.0, 0.0], [90.0, 0.0], [90.0, nan], [0.0, 90.0]]",
            "apex_mm = -1.0",
            "apex_mm = nan",
            "size_mm = [20.0, inf]",
            "bulge_mm = nan",
        ] {
            let error = invalid(wrong).unwrap().unwrap_err();
            assert!(error.to_string().starts_with(wrong.split(' ').next().unwrap()), "{wrong}: {error}");
        }
        let beyond = invalid("apex_mm = 100.0\nbulge_mm = 0.1\nfov_y_deg = 100.0").unwrap().unwrap_err();
        assert!(beyond.to_string().contains("bulge_mm must be such that the gel fills the image"), "{beyond}");
        let error = invalid("[body]\nmass_kg = 0.0").unwrap().unwrap_err();
        assert!(error.to_string().contains("body.mass_kg"), "{error}");
        let error = invalid("size_mm = [8.0, 8.0]\n[markers]").unwrap().unwrap_err();
        assert!(error.to_string().contains("markers.columns"), "{error}");
        let error = invalid("fov_y_deg = 400.0\nreach_mm = 0.5").unwrap().unwrap_err();
        assert!(error.to_string().contains("fov_y_deg"), "{error}");
        let error = invalid("fov_y_deg = 40.0\nreach_mm = 0.5\n[appearance]\nblur_px = nan").unwrap().unwrap_err();
        assert!(error.to_string().contains("appearance.blur_px"), "{error}");
        let error = invalid("fov_y_deg = 40.0\nreach_mm = 0.5\n[markers]\npitch_mm = 0.01").unwrap().unwrap_err();
        assert!(error.to_string().contains("markers.pitch_mm"), "{error}");
    }
}
