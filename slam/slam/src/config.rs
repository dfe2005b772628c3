//! Settings of the estimator.

use mvt_settings::settings;

use crate::map::MapConfig;
use crate::scan::ScanConfig;
use crate::tracker::TrackerConfig;
use mvt_field::field::FieldConfig;

settings! {
    // Why: notes/decisions/settings.md, "Settings of the tracker and the map".
    /// Settings of the estimator.
    #[non_exhaustive]
    pub struct SlamConfig {
        /// Rays drawn from images.
        pub scan: ScanConfig, Nested;
        /// The tracker.
        pub tracker: TrackerConfig, Nested;
        /// The field.
        pub field: FieldConfig, Nested;
        /// The map and the training of the field.
        pub map: MapConfig, Nested;
        /// When a pose is trusted.
        pub trust: TrustConfig, Nested;
    }
}

impl SlamConfig {
    /// Settings for an object of 4 to 40 cm at 0.2 to 2 m that no hand of ours holds: a camera or a person moves it, by up to 15 mm and 10 degrees
    /// a frame at 30 Hz, and its shape is seen in some thousand pixels with a noise of millimetres.
    pub fn without_hand() -> Self {
        let mut config = Self::default();
        config.scan.outline_px = 2;
        config.scan.near_misses_px = 40;
        config.tracker.align_reach_m = 0.024;
        config.tracker.velocity_memory_s = 0.3;
        config.tracker.velocity_sigma_m_s = 0.4;
        config.tracker.velocity_sigma_rad_s = 5.0;
        config.trust.surprise_m_s = 2.0;
        config.trust.deviation_floor_m = 0.0005;
        config.field.half_extent_m = 0.12;
        config.field.truncation_m = 0.01;
        config.map.behind_m = 0.008;
        config.map.largest_half_extent_m = 0.25;
        config.map.mesh_guesses = false;
        config
    }
}

settings! {
    /// When a pose is trusted, and when it is trusted again.
    pub struct TrustConfig {
        /// Stated deviation of a pose against a shape that is learnt well, metres: resolution of the field, noise of the depth, the choice of the
        /// frame.
        pub deviation_floor_m: f64 = 0.0009, 0.0..=1.0;
        /// How wrong lengths may be that cameras measure, one standard deviation, as a part of them: this part of the way that the object has come,
        /// seen from the camera, since the shape was begun is added to the stated deviation. 0 for calibrated cameras.
        pub camera_scale_sigma: f64 = 0.0, 0.0..=1.0;
        /// Below this confidence a frame counts as doubtful.
        pub doubt_below: f64 = 0.7, 0.0..=1.0;
        /// If frames in a row are doubtful for this long, the object is lost, seconds. A single frame never loses it. The default is that of
        /// three frames at 30 Hz.
        pub lost_after_s: f64 = 0.06, 0.0..=1e6;
        /// From this confidence on, a frame trains the field.
        pub learn_above: f64 = 0.85, 0.0..=1.0;
        /// Least confidence of a pose that ends a search.
        pub found_above: f64 = 0.85, 0.0..=1.0;
        /// Greatest plausible distance between a pose and the pose predicted from the frame before, over the time between them, metres per
        /// second. A pose farther away needs the confidence found_above.
        pub surprise_m_s: f64 = 0.6, 1e-4..=1e6;
        /// Greatest plausible rotation between the two, radians per second.
        pub surprise_rad_s: f64 = 24.0, 1e-4..=1e6;
        /// If half of the points are farther than this from the surface at the predicted pose, in standard deviations, the tracker also
        /// tries poses around it.
        pub jerk_sigmas: f64 = 2.0, 0.1..=1e6;
        /// A confidence that is lower than usual by more than this is a surprise: poses farther away are tried, and no frame trains the field
        /// until one agrees as usual.
        pub surprise_confidence: f64 = 0.05, 0.0..=1.0;
        /// If frames in a row are surprising for longer than this, they are the usual ones, seconds.
        pub surprised_for_s: f64 = 0.66, 0.0..=1e6;
        /// While the object is lost, searches are at least so far apart, seconds. The default is that of every third frame at 30 Hz.
        pub search_interval_s: f64 = 0.09, 0.0..=1e6;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_fine_and_nonsense_is_named() {
        SlamConfig::default().validate().unwrap();
        let refused = |change: fn(&mut SlamConfig)| {
            let mut config = SlamConfig::default();
            change(&mut config);
            config.validate().unwrap_err().to_string()
        };
        assert_eq!(refused(|c| c.map.batch = 0), "map.batch must be from 1 to 1000000 (it is 0)");
        assert!(refused(|c| c.tracker.window = 0).starts_with("tracker.window must be from 1 to 30 (it is 0)"));
        assert!(
            refused(|c| c.trust.surprise_rad_s = f64::NAN)
                .starts_with("trust.surprise_rad_s must be from 0.0001 to 1000000")
        );
        assert!(refused(|c| c.map.band_part = 0.9).contains("must be at most 1"));
        assert!(refused(|c| c.field.hidden = 7).contains("hidden"));
        assert!(
            refused(|c| c.field.truncation_m = 0.1).contains("field.truncation_m must be at most half_extent_m, 0.075")
        );
    }
}
