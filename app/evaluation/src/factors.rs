//! Factors of the tracker and of the map that an ablation leaves out in turn.

use anyhow::Result;
use mvt_run::config::RunConfig;
use mvt_run::estimator::Mode;
use mvt_run::source::Modality;

use super::EvaluateArguments;

/// The variant with all factors.
pub const FULL: &str = "full";

// Why: notes/decisions/settings.md, "Factors that the ablation does not justify".
/// Settings that are 0 in an ablation.
const FACTORS: [&str; 16] = [
    "slam.tracker.camera_weight",
    "slam.tracker.touch_weight",
    "slam.tracker.free_space_weight",
    "slam.tracker.icp_weight",
    "slam.tracker.colour_weight",
    "slam.tracker.texel_weight",
    "slam.tracker.velocity_weight",
    "slam.tracker.contact_weight",
    "slam.tracker.penetration_weight",
    "slam.tracker.outline_points",
    "slam.map.refined_per_s",
    "slam.map.loop_turn_deg",
    "slam.map.hand_part",
    "slam.map.inside_weight",
    "slam.map.core_weight",
    "slam.field.eikonal_weight",
];

/// Whether a factor has any effect.
pub fn matters(factor: &str, mode: Mode, modality: Modality) -> bool {
    match factor {
        "slam.tracker.camera_weight"
        | "slam.tracker.icp_weight"
        | "slam.tracker.colour_weight"
        | "slam.tracker.texel_weight"
        | "slam.tracker.free_space_weight"
        | "slam.tracker.outline_points" => mode != Mode::Map && modality.has_vision(),
        "slam.tracker.touch_weight" | "slam.tracker.contact_weight" => mode != Mode::Map && modality.has_touch(),
        "slam.map.refined_per_s" | "slam.map.loop_turn_deg" => mode == Mode::Slam,
        _ if factor.starts_with("slam.map.") || factor.starts_with("slam.field.") => mode != Mode::Pose,
        _ => mode != Mode::Map,
    }
}

/// The settings of each variant by its name: those asked for, and each with a factor at 0.
pub fn variants(arguments: &EvaluateArguments) -> Result<Vec<(&'static str, RunConfig)>> {
    let load =
        |set: &[String]| -> Result<RunConfig> { Ok(RunConfig::default().changed(arguments.config.as_deref(), set)?) };
    let mut variants = vec![(FULL, load(&arguments.set)?)];
    if arguments.ablate {
        for factor in FACTORS {
            let set = [arguments.set.as_slice(), &[format!("{factor}=0")]].concat();
            variants.push((factor, load(&set)?));
        }
    }
    Ok(variants)
}
