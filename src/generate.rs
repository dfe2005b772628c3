//! `generate`: data sets of FeelSight logs.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::{Args, value_parser};
use mvt_evaluation::manner::Manner;
use mvt_feelsight::LogFormat;
use mvt_files::folder::{ClaimedFolder, Earlier, MARK};
use mvt_frames::camera::PosedCamera;
use mvt_hands::LoadedHand;
use mvt_objects::catalogue;
use mvt_render::touch::TouchConfig;
use mvt_run::arguments::duration;
use mvt_run::io::{print_line, shell_word};
use mvt_run::object::load_object;
use mvt_run::progress;
use mvt_run::source::equipped;
use mvt_simulated::recorder::{NoiseLevel, Recorder, Settings};

/// Simulate episodes and write them as FeelSight logs
///
/// Each log is one episode in DIR/OBJECT/00, DIR/OBJECT/01 and so on. NeuralFeels' own loaders read it; scene.json
/// holds its settings, and the touch sensors where they are not TACTO's DIGITs: NeuralFeels' loaders take the images of any
/// other sensor for images of a DIGIT with TACTO's view.
///
/// A log appears under its name only when it is complete. After an interruption, the same command skips complete logs
/// and continues. Log k has the seed SEED + k; `simulate` with that seed plays the same episode.
#[derive(Debug, Args)]
pub struct GenerateArguments {
    /// Object: a name that `assets list` shows, random:SEED, the path of a mesh in metres, or `all` for the whole
    /// catalogue (repeatable)
    #[arg(long = "object", required = true)]
    objects: Vec<String>,
    /// Number of logs per object
    #[arg(long, default_value_t = 5, value_parser = value_parser!(u64).range(1..=100_000))]
    logs: u64,
    /// Duration of each log in seconds, at most 3600
    #[arg(long, default_value_t = 30.0, value_parser = duration)]
    duration: f64,
    /// Seed of the first log
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Folder for the data set
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Cameras, separated by commas: front-left, back-right, top-down, side, or azimuth/elevation in degrees such as
    /// 330/35
    #[arg(long, default_value = "front-left")]
    cameras: String,
    /// Render one episode from N views on a sphere, with a log per view, like FeelSight's occlusion set (instead of
    /// --logs)
    #[arg(long, value_name = "N", conflicts_with_all = ["logs", "cameras"], value_parser = value_parser!(u16).range(1..=1000))]
    occlusion_views: Option<u16>,
    /// Noise in the recorded images
    #[arg(long, value_enum, default_value_t = NoiseLevel::Touch)]
    noise: NoiseLevel,
    /// Lights of the DIGITs: `fork` as in FeelSight, or `tacto` as in TACTO 0.0.3
    #[arg(long, default_value = "fork")]
    touch_config: TouchConfig,
    /// Touch sensor of all pads: tacto, digit, digit_markers, gelsight_mini, gelsight_mini_markers, or the path of a profile
    /// (.toml) [default: that of each pad of the rig]
    #[arg(long, value_name = "NAME")]
    touch_profile: Option<String>,
    /// Untouched image of a real sensor, in the size of its images, as background of all touch images [default: a
    /// synthetic one]
    #[arg(long, value_name = "FILE")]
    background: Option<PathBuf>,
    #[command(flatten)]
    manner: Manner,
    /// Layout of the logs: FeelSight's, or `compact`, an eighth of the size; `convert` changes it
    #[arg(long, default_value_t, value_name = "FORMAT")]
    format: LogFormat,
    /// Number of threads; it does not change the result [default: one per core]
    #[arg(long, value_parser = value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Replace existing logs, and allow a folder that contains other files
    #[arg(long)]
    overwrite: bool,
}

/// Runs the command.
pub fn run(arguments: &GenerateArguments) -> Result<()> {
    // With 0, rayon chooses the number.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(arguments.jobs.map_or(0, usize::from)).build()?;
    let names: Vec<String> = if arguments.objects.iter().any(|name| name == "all") {
        catalogue::entries().map(|entry| entry.name.to_owned()).collect()
    } else {
        arguments.objects.clone()
    };
    let mut rig = arguments.manner.rig()?;
    rig.hand = equipped(&rig.hand, arguments.touch_profile.as_deref())?;
    let settings = Settings {
        controller: arguments.manner.controller.clone(),
        hand: rig.hand.clone(),
        duration_s: arguments.duration,
        noise: arguments.noise.into(),
        touch_config: arguments.touch_config,
        background: arguments.background.clone(),
    };
    // All names are checked before hours are spent on the first object.
    for name in &names {
        if let Some(file) = catalogue::mesh_path(name) {
            fs::metadata(file).with_context(|| format!("cannot read {name}"))?;
        } else {
            catalogue::check(name)?;
        }
    }
    let jobs = jobs(arguments, &rig)?;
    check_vacant(&arguments.out, arguments.overwrite)?;
    // That the folder contains only logs was just checked, also for data sets of version 0.1.0, which have no mark.
    let _claimed = ClaimedFolder::claim(&arguments.out, "generate", Earlier::Keep, true)?;
    let mut ended_early = 0;
    let mut first = None;
    for name in &names {
        let object = load_object(name)?;
        let recorder = Recorder::new(&object, name, &settings)?;
        recorder.misfit().into_iter().for_each(|misfit| tracing::warn!("{misfit}"));
        for (index, job) in jobs.iter().enumerate() {
            let folder = arguments.out.join(&object.name).join(format!("{index:02}"));
            first.get_or_insert_with(|| folder.clone());
            if !arguments.overwrite && folder.exists() {
                if recorder.made(&folder, arguments.format, job.seed, &job.cameras) {
                    tracing::info!("{} is complete", folder.display());
                    continue;
                }
                bail!("{} was made with other settings; choose another --out or give --overwrite", folder.display());
            }
            let bar = progress::bar(0, &format!("{} {index:02}", object.name));
            let end = pool.install(|| {
                recorder.record(job.seed, &job.cameras, &folder, arguments.format, arguments.overwrite, &bar)
            })?;
            bar.finish_and_clear();
            if !end.complete {
                ended_early += 1;
                tracing::warn!("{}: {}", folder.display(), end.reason);
            }
        }
    }
    if ended_early > 0 {
        tracing::warn!("{ended_early} logs are shorter than --duration; their scene.json gives the reason");
    }
    let logs = names.len() * jobs.len();
    print_line(&format!("{logs} log{} in {}", if logs == 1 { "" } else { "s" }, arguments.out.display()))?;
    let first = first.unwrap_or_default();
    print_line(&format!("next: check one with `mambavitact inspect {}`", shell_word(&first.to_string_lossy())))
}

/// One log to write.
struct Job {
    seed: u64,
    cameras: Vec<PosedCamera>,
}

fn jobs(arguments: &GenerateArguments, rig: &LoadedHand) -> Result<Vec<Job>> {
    if let Some(views) = arguments.occlusion_views {
        // NeuralFeels' loaders look for a camera of this name in every log, whatever its view.
        let view = |camera| PosedCamera { name: "front-left".to_owned(), ..camera };
        let job = |camera| Job { seed: arguments.seed, cameras: vec![view(camera)] };
        return Ok(mvt_robot::rig::occlusion_rig(views.into(), &rig.hand).into_iter().map(job).collect());
    }
    let cameras = rig.placed(&arguments.cameras)?;
    let job = |k| Job { seed: arguments.seed.wrapping_add(k), cameras: cameras.clone() };
    Ok((0..arguments.logs).map(job).collect())
}

/// Checks that a folder contains only logs, so that a mistyped --out does not receive 12,000 files per log.
fn check_vacant(out: &Path, overwrite: bool) -> Result<()> {
    if overwrite || !out.exists() {
        return Ok(());
    }
    let entries = |folder: &Path| -> Result<Vec<PathBuf>> {
        let list = fs::read_dir(folder).and_then(|list| list.map(|entry| Ok(entry?.path())).collect());
        list.with_context(|| format!("cannot read {}", folder.display()))
    };
    // A killed run leaves files whose names start with a dot.
    let unfinished = |path: &Path| path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
    for object in entries(out)?.into_iter().filter(|path| !path.ends_with(MARK)) {
        let only_logs = object.is_dir()
            && entries(&object)?.iter().all(|log| unfinished(log) || log.join(mvt_feelsight::SCENE_FILE).is_file());
        if !only_logs {
            bail!(
                "--out {} is not empty and {} is not a log; choose another --out or give --overwrite",
                out.display(),
                object.display()
            );
        }
    }
    Ok(())
}
