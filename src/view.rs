//! `view`: a run or a log, looked at.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::str::FromStr;

use anyhow::{Context as _, Result, bail};
use clap::{Args, ValueEnum};
use mvt_picture::film::{Film, FilmFormat};
use mvt_picture::palette::Theme;
use mvt_recording::Recording;
use mvt_run::io::print_line;
use mvt_run::progress;
use mvt_viewer::eye::DISTANCE_M;
use mvt_viewer::window;
use mvt_viewer::window::RecordingSource;
use mvt_viewer::{Clouds, Colouring, Dashboard, DashboardLayout, Eye, Keyframes, Layers, Preset};

/// Look at a run, finished or still going, or at a raw log; or make a film of it
///
/// Without --run and --log there is a page on which a run is chosen and started.
///
/// With --record neither a display nor a graphics card is needed.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Folder of a run
    #[arg(long, value_name = "DIR", conflicts_with = "log")]
    run: Option<PathBuf>,
    /// A FeelSight log
    #[arg(long, value_name = "LOGDIR")]
    log: Option<PathBuf>,
    /// Make a picture (.png) or a film (.gif, or .mp4 with ffmpeg) instead of opening a window
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    #[command(flatten)]
    recorded: Recorded,
}

/// What is recorded, and how it looks.
#[derive(Debug, Clone, Args)]
struct Recorded {
    /// What is on the picture
    #[arg(long, value_enum, default_value_t = DashboardLayout::All, requires = "record")]
    layout: DashboardLayout,
    /// Width and height, pixels
    #[arg(long, default_value = "1280x720", requires = "record")]
    size: Size,
    /// The frame of a picture, counted from 0; the last one unless given
    #[arg(long, value_name = "N", requires = "record")]
    frame: Option<usize>,
    /// A film has every how many-th frame
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=1000), requires = "record")]
    every: u16,
    /// Pictures per second; as many as make a film as long as the run unless given
    #[arg(long, value_name = "HZ", requires = "record")]
    rate: Option<f64>,
    /// Colours of the page
    #[arg(long, value_enum, default_value_t = Paper::Light, requires = "record")]
    theme: Paper,
    /// What the colours of the surface stand for
    #[arg(long, value_enum, default_value_t, requires = "record")]
    colour: Colouring,
    /// What is shown
    #[arg(long, value_enum, value_delimiter = ',', default_value = "mesh,hand,axes,trail", requires = "record")]
    show: Vec<Layer>,
    /// From where
    #[arg(long, value_enum, default_value_t = Preset::Oblique, requires = "record")]
    from: Preset,
    /// Distance of the eye, metres
    #[arg(long, value_name = "METRES", default_value_t = DISTANCE_M, requires = "record")]
    distance: f64,
}

/// Width and height of a picture.
#[derive(Debug, Clone, Copy)]
struct Size([u32; 2]);

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |text: &str| text.parse().ok().filter(|side| (160..=4096).contains(side));
        let size = text.split_once(['x', 'X']).and_then(|(width, height)| Some([side(width)?, side(height)?]));
        size.map(Self).ok_or_else(|| "it must be width x height in pixels from 160 to 4096, as in 1280x720".to_owned())
    }
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Paper {
    Light,
    Dark,
}

#[derive(Debug, Clone, Copy, PartialEq, ValueEnum)]
enum Layer {
    /// The estimated surface
    Mesh,
    /// The true surface, translucent
    Truth,
    /// The hand
    Hand,
    /// Axes of the estimated and the true pose
    Axes,
    /// Where the object has been
    Trail,
    /// What the cameras see
    Frusta,
    /// Points that cameras and touch have measured
    Clouds,
    /// Where keyframes were taken
    Keyframes,
    /// A slice through the signed distances
    Slice,
    /// The box around the estimated surface
    Bounds,
}

impl Recorded {
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
            keyframes: if has(Layer::Keyframes) { Keyframes::All } else { Keyframes::None },
            slice: has(Layer::Slice),
            bounds: has(Layer::Bounds),
        }
    }

    fn eye(&self) -> Eye {
        let mut eye = Eye::new(self.from);
        eye.zoom(self.distance / eye.distance_m);
        eye
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let place = match (&arguments.run, &arguments.log) {
        (Some(folder), _) => Some(RecordingSource::Run(folder.clone())),
        (None, Some(folder)) => Some(RecordingSource::Log(folder.clone())),
        (None, None) => None,
    };
    match (&arguments.record, &place) {
        (None, place) => window::open(place.as_ref()).with_context(|| match place {
            Some(RecordingSource::Run(folder)) => without_window("run", folder),
            Some(RecordingSource::Log(folder)) => without_window("log", folder),
            None => without_window("run", Path::new("DIR")),
        }),
        (Some(file), Some(place)) => record(&mut place.open()?, file, &arguments.recorded),
        (Some(_), None) => bail!("give --run DIR or --log LOGDIR: there is nothing to record on the start page"),
    }
}

/// Returns the command that needs no window.
fn without_window(option: &str, folder: &Path) -> String {
    format!("`mambavitact view --{option} {} --record out.gif` needs no window", folder.display())
}

/// Opens a window on a run in a process of its own, so that neither waits for the other nor ends with it.
pub fn watch(run: &Path) -> Result<()> {
    let program = std::env::current_exe().context("cannot find this program")?;
    Command::new(program)
        .args(["view", "--run"])
        .arg(run)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .context("cannot start the viewer")?;
    Ok(())
}

/// Makes a picture or a film.
fn record(recording: &mut Recording, file: &Path, recorded: &Recorded) -> Result<()> {
    let format = FilmFormat::of(file)?;
    for warning in recording.warnings() {
        tracing::warn!("{warning}");
    }
    recording.finish_reading();
    let moments = recording.moments();
    let Some(last) = moments.len().checked_sub(1) else {
        bail!("{} has no frame yet", recording.folder().display());
    };
    let size = recorded.size.0;
    let theme = match recorded.theme {
        Paper::Light => Theme::LIGHT,
        Paper::Dark => Theme::DARK,
    };
    let eye = recorded.eye();
    let mut page = Dashboard::new(recorded.layout, size, recorded.layers(), theme);
    if format == FilmFormat::Png {
        let moment = recorded.frame.unwrap_or(last);
        if moment > last {
            bail!("--frame {moment}: the last one is {last}");
        }
        let picture = page.paint(recording, moment, &eye);
        return picture.save(file).with_context(|| format!("cannot write {}", file.display()));
    }
    if recorded.frame.is_some() {
        bail!("--frame is for a picture, a .png file");
    }
    let shown: Vec<usize> = (0..=last).step_by(usize::from(recorded.every)).collect();
    let length_s = moments[last].row.time_s - moments[0].row.time_s;
    let rate_hz = match recorded.rate {
        Some(rate_hz) if (0.1..=60.0).contains(&rate_hz) => rate_hz,
        Some(rate_hz) => bail!("--rate {rate_hz}: it must be from 0.1 to 60"),
        None if length_s > 0.0 => (last as f64 / length_s / f64::from(recorded.every)).clamp(0.1, 60.0),
        None => 10.0,
    };
    // A GIF's colours are chosen before its first picture.
    let samples = match format {
        FilmFormat::Gif => [0, 1, 3].map(|share| page.paint(recording, last * share / 3, &eye)).to_vec(),
        _ => Vec::new(),
    };
    let mut film = Film::create(file, format, size, rate_hz, &samples)?;
    let bar = progress::bar(shown.len() as u64, "film");
    for moment in shown {
        film.push(&page.paint(recording, moment, &eye))?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    film.finish()?;
    let bytes = std::fs::metadata(file)?.len();
    print_line(&format!("{:.1} MB in {}", bytes as f64 / 1e6, file.display()))
}
