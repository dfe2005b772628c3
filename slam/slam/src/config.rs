//! Everything that can be set, and within which limits.

use serde::{Deserialize, Serialize};

use crate::{map, scan, tracker};
use mvt_field::field::{self, FieldError};

/// Everything that can be set.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Rays drawn from images.
    pub scan: scan::Config,
    /// Pose.
    pub tracker: tracker::Config,
    /// The field.
    pub field: field::Config,
    /// How the field is taught.
    pub map: map::Config,
    /// When a pose is no longer believed.
    pub trust: Trust,
}

/// When a pose is no longer believed, and when it is again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Trust {
    /// Below this confidence a frame counts against the pose.
    pub doubt_below: f64,
    /// After as many such frames in a row the object is lost.
    pub lost_after: usize,
    /// From this confidence on, a frame teaches the field.
    pub learn_above: f64,
    /// A pose found again must have this confidence.
    pub found_above: f64,
    /// No object moves farther than this from where it was expected within a frame, metres and radians: a pose that does is
    /// believed only with the confidence of one that is found again.
    pub surprise: [f64; 2],
    /// Where half of the points are farther than this from the surface at the pose that the motion so far leads to, in standard
    /// deviations, the poses around it are tried.
    pub jerk_sigmas: f64,
    /// While lost, frames between two searches.
    pub search_every: usize,
}

impl Default for Trust {
    fn default() -> Self {
        Self {
            doubt_below: 0.7,
            lost_after: 3,
            learn_above: 0.85,
            found_above: 0.85,
            surprise: [0.02, 0.8],
            jerk_sigmas: 2.0,
            search_every: 3,
        }
    }
}

/// A setting that is out of range.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// A number is too small or too large.
    #[error("{key} is {value}, must be {low} to {high}")]
    Range {
        /// The setting, with dots between levels.
        key: &'static str,
        /// Its value.
        value: f64,
        /// Least value.
        low: f64,
        /// Greatest value.
        high: f64,
    },
    /// The parts of a batch are more than the whole.
    #[error("map.band_part, before_part, passed_part and hand_part sum to {0}, must be at most 1")]
    Parts(f32),
    /// A setting of the field.
    #[error("{0}")]
    Field(#[from] FieldError),
}

impl Config {
    /// Whether a run can work with these settings.
    ///
    /// # Errors
    /// [`ConfigError`] that names the first setting that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        const ANY: f64 = 1e6;
        let Self { scan, tracker, field, map, trust } = self;
        let parts = map.band_part + map.before_part + map.passed_part + map.hand_part;
        let whole = |n: usize| n as f64;
        let single = |x: f32| f64::from(x);
        for (key, value, low, high) in [
            ("scan.camera_hits", whole(scan.camera_hits), 1.0, ANY),
            ("scan.touch_hits", whole(scan.touch_hits), 1.0, ANY),
            ("scan.camera_sigma_per_m2", single(scan.camera_sigma_per_m2), 1e-6, 1.0),
            ("scan.camera_jitter_px", single(scan.camera_jitter_px), 0.0, 100.0),
            ("scan.camera_shift_px", single(scan.camera_shift_px[0]), -100.0, 100.0),
            ("scan.camera_shift_px", single(scan.camera_shift_px[1]), -100.0, 100.0),
            ("tracker.window", whole(tracker.window), 1.0, 30.0),
            ("tracker.iterations", whole(tracker.iterations), 1.0, 1000.0),
            ("tracker.camera_points", whole(tracker.camera_points), 1.0, ANY),
            ("tracker.touch_points", whole(tracker.touch_points), 1.0, ANY),
            ("tracker.camera_weight", tracker.camera_weight, 0.0, ANY),
            ("tracker.touch_weight", tracker.touch_weight, 0.0, ANY),
            ("tracker.free_space_weight", tracker.free_space_weight, 0.0, ANY),
            ("tracker.icp_weight", tracker.icp_weight, 0.0, ANY),
            ("tracker.velocity_weight", tracker.velocity_weight, 0.0, ANY),
            ("tracker.contact_weight", tracker.contact_weight, 0.0, ANY),
            ("tracker.penetration_weight", tracker.penetration_weight, 0.0, ANY),
            ("tracker.camera_independent", tracker.camera_independent, 1e-3, ANY),
            ("tracker.touch_independent", tracker.touch_independent, 1e-3, ANY),
            ("tracker.velocity_kept", tracker.velocity_kept, 0.0, 1.0),
            ("tracker.velocity_sigma", tracker.velocity_sigma[0], 1e-6, 1.0),
            ("tracker.velocity_sigma", tracker.velocity_sigma[1], 1e-6, 10.0),
            ("tracker.slip_sigma_m", tracker.slip_sigma_m[0], 1e-6, 1.0),
            ("tracker.slip_sigma_m", tracker.slip_sigma_m[1], 0.0, 1.0),
            ("tracker.penetration_slack_m", single(tracker.penetration_slack_m), 0.0, 0.1),
            ("map.batch", whole(map.batch), 1.0, ANY),
            ("map.behind_m", single(map.behind_m), 1e-4, 0.05),
            ("map.free_reach_m", single(map.free_reach_m), 0.0, 1.0),
            ("map.current_part", single(map.current_part), 0.0, 1.0),
            ("map.touch_part", single(map.touch_part), 0.0, 1.0),
            ("map.band_part", single(map.band_part), 0.0, 1.0),
            ("map.before_part", single(map.before_part), 0.0, 1.0),
            ("map.passed_part", single(map.passed_part), 0.0, 1.0),
            ("map.hand_part", single(map.hand_part), 0.0, 1.0),
            ("map.free_weight", single(map.free_weight), 0.0, ANY),
            ("map.inside_weight", single(map.inside_weight), 0.0, ANY),
            ("map.core_weight", single(map.core_weight), 0.0, ANY),
            ("map.core_depth_m", single(map.core_depth_m), -1.0, 1.0),
            ("map.keyframe_turn_deg", map.keyframe_turn_deg, 0.0, 180.0),
            ("map.keyframe_distance_m", map.keyframe_distance_m, 0.0, 1.0),
            ("map.keyframe_interval_s", map.keyframe_interval_s, 0.0, ANY),
            ("map.keyframes", whole(map.keyframes), 4.0, ANY),
            ("map.refine_sigma", map.refine_sigma[0], 1e-6, 1.0),
            ("map.refine_sigma", map.refine_sigma[1], 1e-6, 10.0),
            ("map.loop_turn_deg", map.loop_turn_deg, 0.0, 180.0),
            ("map.surface_sigma_m", single(map.surface_sigma_m), 1e-6, 0.1),
            ("trust.doubt_below", trust.doubt_below, 0.0, 1.0),
            ("trust.lost_after", whole(trust.lost_after), 1.0, ANY),
            ("trust.learn_above", trust.learn_above, 0.0, 1.0),
            ("trust.found_above", trust.found_above, 0.0, 1.0),
            ("trust.surprise", trust.surprise[0], 1e-4, ANY),
            ("trust.surprise", trust.surprise[1], 1e-4, ANY),
            ("trust.jerk_sigmas", trust.jerk_sigmas, 0.1, ANY),
            ("trust.search_every", whole(trust.search_every), 1.0, ANY),
        ] {
            // Written so that NaN fails.
            if !(low..=high).contains(&value) {
                return Err(ConfigError::Range { key, value, low, high });
            }
        }
        // Half a thousandth: the parts are rounded numbers.
        if parts > 1.0005 {
            return Err(ConfigError::Parts(parts));
        }
        Ok(field.validate()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_fine_and_nonsense_is_named() {
        Config::default().validate().unwrap();
        let refused = |change: fn(&mut Config)| {
            let mut config = Config::default();
            change(&mut config);
            config.validate().unwrap_err().to_string()
        };
        assert_eq!(refused(|c| c.map.batch = 0), "map.batch is 0, must be 1 to 1000000");
        assert!(refused(|c| c.tracker.window = 0).starts_with("tracker.window is 0"));
        assert!(refused(|c| c.trust.surprise[1] = f64::NAN).starts_with("trust.surprise is NaN"));
        assert!(refused(|c| c.map.band_part = 0.9).contains("must be at most 1"));
        assert!(refused(|c| c.field.hidden = 7).contains("hidden"));
    }
}
