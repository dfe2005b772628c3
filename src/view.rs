//! `view`: a window, a picture or a film of a run or a log.

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::str::FromStr;
use std::sync::atomic::Ordering;

use anyhow::{Context as _, Result, bail};
use clap::{Args, ValueEnum};
use mvt_exchange::FoxgloveArguments;
use mvt_picture::film::{Film, FilmFormat};
use mvt_picture::palette::Theme;
use mvt_recording::Recording;
use mvt_run::io::{check_named, png, print_line, write_named};
use mvt_run::progress;
use mvt_viewer::window_program::WindowProgram;
use mvt_viewer::{
    Clouds, Colouring, Dashboard, DashboardLayout, Eye, Keyframes, Layers, Preset, RecordingSource, WindowContents,
};

use crate::signals::stop_on_signals;

/// Show a run or a log in a window, or write a picture or film of it
///
/// The run may be finished, still going, or have crashed. Two runs are compared side by side. Without a folder the
/// window opens on a page that starts runs, or plays an example if there was no run yet.
///
/// The window needs a display with OpenGL; H shows its keys. --record needs neither a display nor a graphics card.
#[derive(Debug, Args)]
pub struct ViewArguments {
    /// Folder of a run, or folders of two runs to compare
    #[arg(value_name = "RUN", num_args = 0..=2, conflicts_with_all = ["run", "log"])]
    runs: Vec<PathBuf>,
    /// Folder of a run
    #[arg(long, value_name = "DIR", conflicts_with = "log")]
    run: Option<PathBuf>,
    /// Folder of a FeelSight log
    #[arg(long, value_name = "LOGDIR")]
    log: Option<PathBuf>,
    /// Write a picture (.png) or a film (.gif, or .mp4 if ffmpeg is installed) instead of opening a window
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    #[command(flatten)]
    foxglove: FoxgloveArguments,
    /// Replace an existing picture or film
    #[arg(long, requires = "record")]
    overwrite: bool,
    #[command(flatten)]
    recorded: RecordArguments,
}

/// Contents and appearance of a picture or film.
#[derive(Debug, Clone, Args)]
struct RecordArguments {
    /// Parts of the picture
    #[arg(long, value_enum, default_value_t = DashboardLayout::All, requires = "record")]
    layout: DashboardLayout,
    /// Width and height in pixels, 160 to 4096 each
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1280x720", requires = "record")]
    size: Size,
    /// Frame to show on a picture, counted from 0 [default: the last one]
    #[arg(long, value_name = "N", requires = "record")]
    frame: Option<usize>,
    /// Record every Nth frame
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=1000), requires = "record")]
    every: u16,
    /// Pictures per second of a film, 0.1 to 60 [default: the speed of the run]
    #[arg(long, value_name = "HZ", requires = "record")]
    rate: Option<f64>,
    /// Background
    #[arg(long, value_enum, default_value_t = ThemeChoice::Light, requires = "record")]
    theme: ThemeChoice,
    /// Quantity that colours the estimated surface
    #[arg(long, value_enum, default_value_t, requires = "record")]
    colour: Colouring,
    /// Layers of the scene, separated by commas
    #[arg(
        long,
        value_name = "LAYERS",
        value_enum,
        value_delimiter = ',',
        default_value = "mesh,hand,axes,trail",
        requires = "record"
    )]
    show: Vec<Layer>,
    /// Direction to look from
    #[arg(long, value_enum, default_value_t = Preset::Oblique, requires = "record")]
    from: Preset,
    /// Distance of the eye, metres [default: 0.4 from a hand; without one, where the object fills the picture]
    #[arg(long, value_name = "METRES", requires = "record")]
    distance: Option<f64>,
}

/// Width and height of a picture.
#[derive(Debug, Clone, Copy)]
struct Size([u32; 2]);

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |text: &str| text.parse().ok().filter(|side| (160..=4096).contains(side));
        let size = text.split_once(['x', 'X']).and_then(|(width, height)| Some([side(width)?, side(height)?]));
        size.map(Self).ok_or_else(|| "give WIDTHxHEIGHT, 160 to 4096 pixels each, such as 1280x720".to_owned())
    }
}

/// Background on the command line.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum ThemeChoice {
    /// White
    Light,
    /// Dark grey
    Dark,
}

/// Layer of the scene on the command line.
#[derive(Debug, Clone, Copy, PartialEq, ValueEnum)]
enum Layer {
    /// The estimated surface
    Mesh,
    /// The true surface, translucent (if it is known)
    Truth,
    /// The hand
    Hand,
    /// Axes of the estimated and of the true pose
    Axes,
    /// Path of the object
    Trail,
    /// Viewing volumes of the cameras
    Frusta,
    /// Points that cameras and touch sensors measured
    Clouds,
    /// Cameras of the newest five keyframes
    Keyframes,
    /// Cameras of all keyframes
    AllKeyframes,
    /// Slice through the signed distances
    Slice,
    /// Box around the estimated surface
    Bounds,
}

impl RecordArguments {
    fn layers(&self) -> Layers {
        let has = |layer| self.show.contains(&layer);
        Layers {
            mesh: has(Layer::Mesh),
            colouring: self.colour,
            truth: has(Layer::Truth),
            hand: has(Layer::Hand),
            axes: has(Layer::Axes),
            trail: has(Layer::Trail),
            frusta: has(Layer::Frusta),
            clouds: if has(Layer::Clouds) { Clouds::Both } else { Clouds::None },
            keyframes: match (has(Layer::AllKeyframes), has(Layer::Keyframes)) {
                (true, _) => Keyframes::All,
                (false, true) => Keyframes::Latest,
                (false, false) => Keyframes::None,
            },
            slice: has(Layer::Slice),
            bounds: has(Layer::Bounds),
        }
    }

    fn eye(&self, recording: &Recording) -> Eye {
        let mut eye = Eye::of(recording, self.from);
        if let Some(distance) = self.distance {
            eye.zoom(distance / eye.distance_m);
        }
        eye
    }
}

/// Runs the command.
pub fn run(arguments: &ViewArguments) -> Result<()> {
    let run = |folder: &PathBuf| RecordingSource::Run(folder.clone());
    let contents = match (arguments.runs.as_slice(), &arguments.run, &arguments.log) {
        ([a, b, ..], ..) => WindowContents::Comparison([run(a), run(b)]),
        ([folder], ..) | (_, Some(folder), _) => WindowContents::Recording(run(folder)),
        (_, None, Some(folder)) => WindowContents::Recording(RecordingSource::Log(folder.clone())),
        (_, None, None) => WindowContents::Start,
    };
    if let Some(view) = arguments.foxglove.listen(false)? {
        let WindowContents::Recording(RecordingSource::Run(folder)) = &contents else {
            bail!("--foxglove shows one run; give its folder")
        };
        return view.watch(folder, &*stop_on_signals()?);
    }
    match (&arguments.record, &contents) {
        (None, contents) => open_window(contents),
        (Some(file), WindowContents::Recording(source)) => {
            check_named(file, arguments.overwrite)?;
            record(&mut source.open()?, file, arguments.overwrite, &arguments.recorded)
        }
        (Some(_), WindowContents::Comparison(_)) => bail!("--record shows one run; give one folder"),
        (Some(_), WindowContents::Start) => bail!("--record needs --run DIR or --log LOGDIR"),
    }
}

/// Opens a window and returns when it is closed. On Unix the window's program takes the place of this one.
fn open_window(contents: &WindowContents) -> Result<()> {
    let program = WindowProgram::find().with_context(|| contents.without_window())?;
    let mut command = program.command(contents);
    #[cfg(unix)]
    {
        let problem = std::os::unix::process::CommandExt::exec(&mut command);
        Err(program.cannot_start(problem).into())
    }
    #[cfg(not(unix))]
    {
        let status = command.status().map_err(|problem| program.cannot_start(problem))?;
        if status.success() { Ok(()) } else { bail!("the window ended with {status}") }
    }
}

/// Opens a window on a run in a process of its own, so that neither waits for the other nor ends with it.
pub fn watch(program: &WindowProgram, run: &Path) -> Result<()> {
    let mut command = program.command(&WindowContents::Recording(RecordingSource::Run(run.to_owned())));
    command.stdin(Stdio::null()).stdout(Stdio::null());
    command.spawn().map_err(|problem| program.cannot_start(problem))?;
    Ok(())
}

/// Makes a picture or a film.
fn record(recording: &mut Recording, file: &Path, overwrite: bool, recorded: &RecordArguments) -> Result<()> {
    let format = FilmFormat::of(file)?;
    for warning in recording.warnings() {
        tracing::warn!("{warning}");
    }
    recording.finish_reading();
    let moments = recording.moments();
    let Some(last) = moments.len().checked_sub(1) else {
        bail!("{} does not contain a frame yet; wait for the run's first second", recording.folder().display());
    };
    let size = recorded.size.0;
    let theme = match recorded.theme {
        ThemeChoice::Light => Theme::LIGHT,
        ThemeChoice::Dark => Theme::DARK,
    };
    let eye = recorded.eye(recording);
    let mut page = Dashboard::new(recorded.layout, size, recorded.layers(), theme);
    if format == FilmFormat::Png {
        let moment = recorded.frame.unwrap_or(last);
        if moment > last {
            bail!("--frame {moment}: the last one is {last}");
        }
        write_named(file, &png(&page.paint(recording, moment, &eye))?, overwrite)?;
        return print_line(&format!("frame {moment} in {}", file.display()));
    }
    if recorded.frame.is_some() {
        bail!("--frame is for a picture; give --record a name that ends in .png, or leave --frame out");
    }
    let shown: Vec<usize> = (0..=last).step_by(usize::from(recorded.every)).collect();
    let length_s = moments[last].row.time_s - moments[0].row.time_s;
    let rate_hz = match recorded.rate {
        Some(rate_hz) if (0.1..=60.0).contains(&rate_hz) => rate_hz,
        Some(rate_hz) => bail!("--rate {rate_hz}: it must be from 0.1 to 60"),
        None if length_s > 0.0 => (last as f64 / length_s / f64::from(recorded.every)).clamp(0.1, 60.0),
        None => 10.0,
    };
    // The palette of a GIF is chosen from these samples before its first picture.
    let samples = match format {
        FilmFormat::Gif => [0, 1, 3].map(|share| page.paint(recording, last * share / 3, &eye)).to_vec(),
        _ => Vec::new(),
    };
    let stop = stop_on_signals()?;
    let mut film = Film::create(file, format, size, rate_hz, &samples, overwrite)?;
    let bar = progress::bar(shown.len() as u64, "film");
    for moment in shown {
        if stop.load(Ordering::Relaxed) {
            bail!("the film was interrupted, and {} was not written", file.display());
        }
        film.push(&page.paint(recording, moment, &eye))?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    film.finish()?;
    let bytes = std::fs::metadata(file)?.len();
    print_line(&format!("{:.1} MB in {}", bytes as f64 / 1e6, file.display()))
}
