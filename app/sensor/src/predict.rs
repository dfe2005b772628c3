//! `touch predict`: indentation and contact from images, a video or a camera.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context as _, Result, bail};
use clap::{ArgGroup, Args};
use mvt_robot::digit::profile::SensorProfile;
use mvt_run::device::DeviceArguments;
use mvt_run::io::print_line;
use mvt_run::progress;
use mvt_touch::contact::ContactConfig;
use mvt_viewer::live::{LiveEnd, LiveView};
use mvt_viewer::window_program::WindowProgram;
use rayon::prelude::*;

use crate::images::{SensorImages, SensorState, engine, read};
use crate::predictor::{Predictor, Reading};
use crate::stream::{Pace, StreamSource};

/// Turn images, a video or a camera of a touch sensor into indentation and contact
///
/// DIR receives for each image ID.png or ID_img.png: ID_indentation_mm.npy (32-bit floats, 320 x 240, millimetres),
/// ID_contact.png (white where an object touches) and ID_picture.png (image, indentation and contact side by side); and
/// predictions.csv with a line per image: area in contact, deepest indentation, volume pressed in, normal force with its
/// standard deviation, and from 0 to 1 how far the reading can be trusted. For a profile with markers there are also the displacement of the gel
/// at the contact (millimetres to the right and downwards), its twist, its dilation, the motion of the dots that these do
/// not explain, and ID_shear.png with an arrow at each dot, three times as long as its motion.
///
/// Images of other sizes are resized. Images of a sensor that lies on its side or stands on its head are turned, and
/// images in BGR order are put into RGB order, each with a warning: the light of the LEDs shows it.
///
/// Frames of a video or a camera are read in their order by the program ffmpeg, which must be installed. --json prints a
/// line per frame as soon as it is read, and --out is optional: ID is the number of the frame, from 000000 on. A camera
/// is read until Ctrl-C. --view shows each frame as soon as it is read, in a window that needs a display with OpenGL;
/// when it is closed, the command ends.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("source").required(true).args(["images", "video", "camera"]))]
pub struct TouchPredictArguments {
    /// Images (.png, .jpg), or folders of them; the file untouched.png and files ID_untouched.png are left out
    #[arg(long, value_name = "PATH", num_args = 1.., requires = "out")]
    images: Vec<PathBuf>,
    /// Video of a touch sensor, in any format that ffmpeg reads
    #[arg(long, value_name = "FILE")]
    video: Option<PathBuf>,
    /// Touch sensor that is connected, such as /dev/video0; it is asked for 60 frames/s of 320 x 240 pixels
    #[arg(long, value_name = "DEVICE")]
    camera: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArguments,
    /// Number of frames after which a video or a camera is left
    #[arg(long, value_name = "N", conflicts_with = "images", value_parser = clap::value_parser!(u64).range(1..))]
    frames: Option<u64>,
    /// Image of the sensor that touches nothing; without it, the median of all images is used, which needs contacts at
    /// different places, and of a video or camera the median of the first 10 frames, which must show no contact
    #[arg(long, value_name = "FILE")]
    untouched: Option<PathBuf>,
    /// Sensor: digit (a real DIGIT), digit_markers (with dots on its gel), tacto (as TACTO renders a DIGIT), gelsight_mini,
    /// gelsight_mini_markers, or the path of a profile (.toml)
    #[arg(long, value_name = "NAME", default_value = "digit")]
    profile: String,
    /// Weights of the network (.safetensors); without it, the shipped ones for the profile
    #[arg(long, value_name = "FILE")]
    weights: Option<PathBuf>,
    /// Least indentation of a pixel in contact, millimetres
    #[arg(long, value_name = "MM", default_value_t = ContactConfig::default().threshold_mm)]
    threshold_mm: f32,
    /// Least probability of contact of a pixel in contact, between 0 and 1
    #[arg(long, value_name = "SHARE", default_value_t = 0.5)]
    probability: f32,
    /// Show a video, at its own rate, or a camera in a window
    #[arg(long, conflicts_with = "images")]
    view: bool,
    /// Folder for the results; earlier ones in it are moved to DIR.1, DIR.2 and so on
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Write into a folder that contains other files
    #[arg(long, requires = "out")]
    overwrite: bool,
    /// Print JSON instead of words: a list, or a line per frame of a video or camera
    #[arg(long)]
    json: bool,
}

/// Images that the network sees in one call.
const BATCH: usize = 16;
/// Frames of which the median is the untouched image if none is given.
const FIRST_FRAMES: usize = 10;

/// Runs `touch predict`. `listen` returns a flag that ends a video or camera once it is set.
///
/// # Errors
/// If images, a video, a camera or the profile cannot be read, a camera is lost, no window can be opened, or the results cannot be written.
pub fn predict(arguments: &TouchPredictArguments, listen: impl FnOnce() -> Result<Arc<AtomicBool>>) -> Result<()> {
    arguments.device.choose()?;
    let profile = SensorProfile::load(&arguments.profile)?;
    let &TouchPredictArguments { threshold_mm, probability, .. } = arguments;
    // The table has the plausibility of each image; whoever reads it decides.
    let config = ContactConfig { threshold_mm, probability, least_plausibility: 0.0, ..ContactConfig::default() };
    config.validate().context("--threshold-mm, --probability")?;
    let mut predictor = Predictor::new(engine(&profile, arguments.weights.as_deref())?, &profile, config);
    let video = arguments.video.clone().map(StreamSource::Video);
    match video.or_else(|| arguments.camera.clone().map(StreamSource::Camera)) {
        Some(source) if arguments.view => {
            let stop = listen()?;
            watch(&source, &stop, |view| predict_stream(arguments, &mut predictor, &source, &stop, Some(view)))
        }
        Some(source) => predict_stream(arguments, &mut predictor, &source, &*listen()?, None),
        None => predict_images(arguments, &mut predictor),
    }
}

const NO_WINDOW: &str = "without --view no window is needed";

/// Runs `work` beside a window, and ends it when the window is closed. The window stays open after the work, and says how it has ended.
fn watch(source: &StreamSource, stop: &AtomicBool, work: impl FnOnce(&LiveView) -> Result<()> + Send) -> Result<()> {
    let program = WindowProgram::find().context(NO_WINDOW)?;
    let mut window = program.command_of_sensor(&source.to_string()).spawn().map_err(|e| program.cannot_start(e))?;
    let input = window.stdin.take();
    let view = LiveView::default();
    std::thread::scope(|scope| {
        scope.spawn(|| input.into_iter().for_each(|mut input| view.write_to(&mut input)));
        let worker = scope.spawn(|| {
            let done = work(&view);
            view.end(match &done {
                _ if stop.load(Ordering::Relaxed) => LiveEnd::Closing,
                Ok(()) => LiveEnd::Complete(format!("{source} has ended.")),
                Err(error) => LiveEnd::Trouble(format!("{error:#}")),
            });
            done
        });
        let closed = window.wait();
        stop.store(true, Ordering::Relaxed);
        let done = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        match closed {
            Ok(status) if status.success() => done,
            // The window has said why.
            Ok(_) => done.and_then(|()| bail!("the window was lost; {NO_WINDOW}")),
            Err(error) => done.and(Err(error).context("cannot wait for the window")),
        }
    })
}

fn predict_images(arguments: &TouchPredictArguments, predictor: &mut Predictor) -> Result<()> {
    let SensorImages { ids, images, untouched } =
        SensorImages::read(&arguments.images, arguments.untouched.as_deref(), &predictor.profile, &predictor.engine)?;
    predictor.set_untouched(&untouched)?;
    claim(arguments, predictor)?;
    let bar = progress::bar(images.len() as u64, "images");
    let mut lines = Vec::with_capacity(images.len());
    for (ids, images) in ids.chunks(BATCH).zip(images.chunks(BATCH)) {
        lines.extend(predictor.predict(ids, images)?.into_iter().map(|reading| reading.line));
        bar.inc(images.len() as u64);
    }
    bar.finish_and_clear();
    let table = predictor.write_table(&lines)?;
    warn_of_lost_dots(lines.iter().filter(|line| line.has_lost_dots()).count());
    if arguments.json {
        return print_line(&serde_json::to_string_pretty(&lines)?);
    }
    let touching = lines.iter().filter(|line| line.press.area_mm2 > 0.0).count();
    print_line(&format!("{touching} of {} images show contact{table}", lines.len()))
}

/// Reads a video or a camera until its end, the last frame that is wanted, or `stop`.
fn predict_stream(
    arguments: &TouchPredictArguments,
    predictor: &mut Predictor,
    source: &StreamSource,
    stop: &AtomicBool,
    view: Option<&LiveView>,
) -> Result<()> {
    let untouched = arguments.untouched.as_deref().map(|path| read(path, &predictor.profile)).transpose()?;
    let most = arguments.frames.map_or(usize::MAX, |most| usize::try_from(most).unwrap_or(usize::MAX));
    let pace = if view.is_some() { Pace::OfTheFilm } else { Pace::Fastest };
    let stream = source.open(pace, &predictor.profile)?;
    let first = FIRST_FRAMES.min(most);
    let mut images = stream.receive(first, first, stop);
    if images.is_empty() {
        return if stop.load(Ordering::Relaxed) { Ok(()) } else { stream.finish(0) };
    }
    if untouched.is_none() {
        tracing::warn!(
            "there is no --untouched image; the median of the first {} frames is used, which must show no contact",
            images.len()
        );
    }
    let SensorState { layout, untouched } =
        SensorState::of(untouched, &mut images, &predictor.profile, &predictor.engine)?;
    predictor.set_untouched(&untouched)?;
    claim(arguments, predictor)?;
    let bar = progress::counter("frames");
    let begun = Instant::now();
    let (mut lines, mut done, mut touching, mut lost) = (Vec::new(), 0, 0, 0);
    let mut rate = FrameRate::new(begun);
    while !images.is_empty() {
        let ids: Vec<String> = (done..done + images.len()).map(|frame| format!("{frame:06}")).collect();
        let readings = predictor.predict(&ids, &images)?;
        rate.add(images.len());
        if let Some(((view, reading), image)) = view.zip(readings.last()).zip(images.last()) {
            view.show(reading.live(image, rate.hz()));
        }
        for Reading { line, .. } in readings {
            lost += usize::from(line.has_lost_dots());
            touching += usize::from(line.press.area_mm2 > 0.0);
            if arguments.json {
                print_line(&serde_json::to_string(&line)?)?;
            }
            if predictor.writes() {
                lines.push(line);
            }
        }
        done += images.len();
        bar.inc(images.len() as u64);
        // All frames that wait, so that all cores work, and no more, so that none waits for a later one.
        images = stream.receive(1, BATCH.min(most - done), stop);
        images.par_iter_mut().for_each(|image| *image = layout.upright(image, predictor.profile.size_px));
    }
    let rate_hz = done as f64 / begun.elapsed().as_secs_f64();
    bar.finish_and_clear();
    let table = predictor.write_table(&lines)?;
    warn_of_lost_dots(lost);
    if done < most && !stop.load(Ordering::Relaxed) {
        stream.finish(done)?;
    }
    if arguments.json {
        return Ok(());
    }
    print_line(&format!("{touching} of {done} frames show contact, {rate_hz:.0} frames/s{table}"))
}

fn warn_of_lost_dots(images: usize) {
    if images > 0 {
        tracing::warn!(
            "the dots of the untouched image are not found in {images} images: their shear is unknown and written as 0"
        );
    }
}

/// Frames per second over about the last second.
struct FrameRate {
    since: Instant,
    frames: usize,
    hz: f64,
}

impl FrameRate {
    fn new(now: Instant) -> Self {
        Self { since: now, frames: 0, hz: 0.0 }
    }

    fn add(&mut self, frames: usize) {
        self.frames += frames;
        let elapsed_s = self.since.elapsed().as_secs_f64();
        if elapsed_s >= 1.0 || self.hz == 0.0 {
            self.hz = self.frames as f64 / elapsed_s.max(1e-3);
        }
        if elapsed_s >= 1.0 {
            *self = Self { since: Instant::now(), frames: 0, hz: self.hz };
        }
    }

    fn hz(&self) -> f64 {
        self.hz
    }
}

/// Claims the folder of the results, if there is one.
fn claim(arguments: &TouchPredictArguments, predictor: &mut Predictor) -> Result<()> {
    arguments.out.clone().map_or(Ok(()), |out| predictor.write_into(out, arguments.overwrite))
}
