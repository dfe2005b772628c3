//! Preview film of a log: camera and touch side by side.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};

use image::imageops::{self, FilterType};
use image::{Rgb, RgbImage};
use mvt_robot::observation::Observation;

use crate::error::LogError;

/// Width of a preview, pixels: the camera at half its size, then two columns of touch images.
pub(super) const WIDTH: u32 = CAMERA.0 + 2 * TOUCH.0;
/// Height of a preview, pixels.
pub(super) const HEIGHT: u32 = CAMERA.1;
const CAMERA: (u32, u32) = (320, 240);
const TOUCH: (u32, u32) = (90, 120);
/// A GIF holds every Nth frame, at half the size: it hardly compresses between frames.
const GIF_EVERY: usize = 5;
/// Speed of the choice of colours, 1 (best) to 30 (fastest).
const GIF_SPEED: i32 = 10;

/// Returns a picture of the preview: the first camera on the left, the touch images on the right, row by row in a square
/// grid.
pub(super) fn tile(observation: &Observation) -> RgbImage {
    let mut tile = RgbImage::from_pixel(WIDTH, HEIGHT, Rgb([0; 3]));
    if let Some(camera) = observation.cameras.first() {
        imageops::replace(&mut tile, &shrink(&camera.color, CAMERA), 0, 0);
    }
    let columns = (2..).find(|n: &u32| (n * n) as usize >= observation.touch.len()).unwrap_or(2);
    let (width, height) = (2 * TOUCH.0 / columns, 2 * TOUCH.1 / columns);
    for (k, image) in (0..).zip(&observation.touch) {
        let (x, y) = (CAMERA.0 + k % columns * width, k / columns * height);
        imageops::replace(&mut tile, &shrink(image, (width, height)), i64::from(x), i64::from(y));
    }
    tile
}

/// Shrinks an image: each new pixel is the mean of the four pixels around its middle. This suffices at factors near 2,
/// in a tenth of the time of a real filter.
fn shrink(image: &RgbImage, (width, height): (u32, u32)) -> RgbImage {
    let (from_width, from_height) = image.dimensions();
    if from_width < 2 || from_height < 2 {
        return RgbImage::new(width, height);
    }
    let corner = |i: u32, to: u32, from: u32| (((2 * i + 1) * from / (2 * to)).clamp(1, from - 1) - 1) as usize;
    let columns: Vec<usize> = (0..width).map(|x| 3 * corner(x, width, from_width)).collect();
    let row_bytes = 3 * from_width as usize;
    let mut small = RgbImage::new(width, height);
    for (y, row) in (0..).zip(small.chunks_exact_mut(3 * width as usize)) {
        let two_rows = &image.as_raw()[corner(y, height, from_height) * row_bytes..][..2 * row_bytes];
        let (upper, lower) = two_rows.split_at(row_bytes);
        for (&x, pixel) in columns.iter().zip(row.as_chunks_mut::<3>().0) {
            let (upper, lower) = (&upper[x..x + 6], &lower[x..x + 6]);
            let sum =
                |c: usize| [upper[c], upper[c + 3], lower[c], lower[c + 3]].into_iter().map(u16::from).sum::<u16>();
            *pixel = [0, 1, 2].map(|c| (sum(c) / 4) as u8);
        }
    }
    small
}

/// Writer of `<object>.mp4` through ffmpeg, or of `<object>.gif` if ffmpeg is not installed. A failure is only a
/// warning: the preview is not part of the data. An interruption of ffmpeg is an error at the end, since another try may succeed, and
/// a log that is made twice shall have the same files.
pub(super) enum Preview {
    Film {
        ffmpeg: Child,
        path: PathBuf,
    },
    Animation {
        encoder: gif::Encoder<BufWriter<File>>,
        rate_hz: f64,
        frames: usize,
        path: PathBuf,
    },
    /// It takes no more pictures.
    Ended,
    /// The same, and a signal has ended ffmpeg.
    Interrupted {
        path: PathBuf,
    },
}

/// Starts ffmpeg for a film of pictures that come through its standard input.
fn film(mut ffmpeg: Command, path: &Path, rate_hz: f64) -> std::io::Result<Child> {
    // Whoever presses Ctrl-C stops the program, which finishes its log first.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut ffmpeg, 0);
    ffmpeg
        .args(["-nostdin", "-loglevel", "fatal", "-f", "rawvideo", "-pix_fmt", "rgb24"])
        .args(["-s", &format!("{WIDTH}x{HEIGHT}"), "-r", &rate_hz.to_string(), "-i", "-"])
        // With one thread the film has the same bytes on any number of cores.
        .args(["-pix_fmt", "yuv420p", "-threads", "1", "-y"])
        .arg(path)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
}

/// Whether a signal has ended ffmpeg: it catches those that a job receives when it is cancelled, ends its film early and returns 255.
fn is_interruption(status: ExitStatus) -> bool {
    status.code().is_none_or(|code| code == 255)
}

/// Closes the pipe and waits for ffmpeg, which has received all pictures or refused one. A film that is not whole is removed.
fn end(ffmpeg: &mut Child, path: &Path, has_all: bool) -> Preview {
    drop(ffmpeg.stdin.take());
    let status = ffmpeg.wait();
    if has_all && status.as_ref().is_ok_and(ExitStatus::success) {
        return Preview::Ended;
    }
    // The folder of the log is removed with it if this fails.
    let _ = fs::remove_file(path);
    match status {
        Ok(status) if is_interruption(status) => Preview::Interrupted { path: path.to_owned() },
        Ok(status) => Preview::failed(Path::new("ffmpeg"), &status.to_string()),
        Err(error) => Preview::failed(Path::new("ffmpeg"), &error.to_string()),
    }
}

impl Preview {
    /// Starts a preview beside data.pkl.
    pub fn create(folder: &Path, object: &str, rate_hz: f64) -> Self {
        let path = folder.join(format!("{object}.mp4"));
        if let Ok(ffmpeg) = film(Command::new("ffmpeg"), &path, rate_hz) {
            return Self::Film { ffmpeg, path };
        }
        let path = folder.join(format!("{object}.gif"));
        let encoder = File::create(&path).map_err(gif::EncodingError::from).and_then(|file| {
            let mut encoder = gif::Encoder::new(BufWriter::new(file), WIDTH as u16 / 2, HEIGHT as u16 / 2, &[])?;
            encoder.set_repeat(gif::Repeat::Infinite)?;
            Ok(encoder)
        });
        match encoder {
            Ok(encoder) => Self::Animation { encoder, rate_hz, frames: 0, path },
            Err(error) => Self::failed(&path, &error.to_string()),
        }
    }

    fn failed(path: &Path, reason: &str) -> Self {
        tracing::warn!("no preview: {}: {reason}", path.display());
        Self::Ended
    }

    /// Appends a picture.
    pub fn push(&mut self, tile: &RgbImage) {
        match self {
            Self::Film { ffmpeg, path } => {
                let written = ffmpeg.stdin.as_mut().map_or(Ok(()), |pipe| pipe.write_all(tile));
                if written.is_err() {
                    *self = end(ffmpeg, path, false);
                }
            }
            Self::Animation { encoder, rate_hz, frames, path } => {
                *frames += 1;
                if *frames % GIF_EVERY != 1 {
                    return;
                }
                let small = imageops::resize(tile, WIDTH / 2, HEIGHT / 2, FilterType::Triangle);
                let (width, height) = (small.width() as u16, small.height() as u16);
                let mut frame = gif::Frame::from_rgb_speed(width, height, &small, GIF_SPEED);
                frame.delay = (100.0 * GIF_EVERY as f64 / *rate_hz).round() as u16;
                if let Err(error) = encoder.write_frame(&frame) {
                    *self = Self::failed(path, &error.to_string());
                }
            }
            Self::Ended | Self::Interrupted { .. } => {}
        }
    }

    /// Ends the film.
    ///
    /// # Errors
    /// [`LogError::Interrupted`] if a signal has ended ffmpeg.
    pub fn finish(mut self) -> Result<(), LogError> {
        match &mut self {
            Self::Film { ffmpeg, path } => self = end(ffmpeg, path, true),
            Self::Animation { encoder, path, .. } => {
                if let Err(error) = encoder.get_mut().flush() {
                    tracing::warn!("no preview: {}: {error}", path.display());
                }
            }
            Self::Ended | Self::Interrupted { .. } => {}
        }
        match &self {
            Self::Interrupted { path } => Err(LogError::Interrupted { path: path.clone() }),
            _ => Ok(()),
        }
    }
}

impl Drop for Preview {
    fn drop(&mut self) {
        if let Self::Film { ffmpeg, .. } = self {
            drop(ffmpeg.stdin.take());
            let _ = ffmpeg.wait();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shrinking_averages_four_pixels() {
        let image = RgbImage::from_fn(8, 6, |x, y| Rgb([10 * x as u8, 20 * y as u8, 7]));
        let small = shrink(&image, (4, 3));
        assert_eq!((small.get_pixel(0, 0), small.get_pixel(3, 2)), (&Rgb([5, 10, 7]), &Rgb([65, 90, 7])));
        assert_eq!(shrink(&image, (3, 4)).dimensions(), (3, 4));
        assert_eq!(shrink(&image, (20, 20)).get_pixel(19, 19), &Rgb([65, 90, 7]));
        assert_eq!(shrink(&RgbImage::new(1, 1), (2, 2)), RgbImage::new(2, 2));
    }

    #[test]
    fn a_film_that_was_interrupted_is_no_film() {
        let folder = tempfile::tempdir().unwrap();
        let of = |script: &str| {
            let mut ffmpeg = Command::new("sh");
            // The arguments of ffmpeg are those of the script.
            ffmpeg.args(["-c", script, "sh"]);
            let path = folder.path().join("film.mp4");
            fs::write(&path, "half").unwrap();
            let mut preview = Preview::Film { ffmpeg: film(ffmpeg, &path, 30.0).unwrap(), path: path.clone() };
            let tile = RgbImage::new(WIDTH, HEIGHT);
            // Pictures fill the pipe until it is closed.
            (0..3).for_each(|_| preview.push(&tile));
            (preview.finish().map_err(|error| error.to_string()), path.exists())
        };
        assert_eq!(of("cat >/dev/null"), (Ok(()), true));
        // ffmpeg that received a signal ends so, or it was killed.
        for script in ["exit 255", "cat >/dev/null; exit 255", "kill -KILL $$"] {
            let (ended, is_there) = of(script);
            assert!(ended.clone().unwrap_err().contains("interrupted") && !is_there, "{script}: {ended:?}");
        }
        // Its own failure costs the preview, and no more.
        for script in ["exit 1", "exit 0", "cat >/dev/null; exit 1"] {
            assert_eq!(of(script), (Ok(()), false), "{script}");
        }
    }

    #[test]
    fn a_film_has_the_same_bytes_on_any_number_of_cores() {
        let folder = tempfile::tempdir().unwrap();
        let noise: Vec<u8> =
            (0..10 * WIDTH * HEIGHT * 3).map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        let film_on = |cores: &str| {
            let path = folder.path().join(format!("{cores}.mp4"));
            let mut bound = Command::new("taskset");
            bound.args(["-c", cores, "ffmpeg"]);
            let mut child = film(bound, &path, 30.0).ok()?;
            // Fails where there is no ffmpeg.
            let _ = child.stdin.take()?.write_all(&noise);
            child.wait().ok()?.success().then(|| std::fs::read(path).unwrap())
        };
        match film_on("0").zip(film_on("0,1")) {
            Some((one, two)) => assert!(one == two && !one.is_empty(), "{} and {} bytes", one.len(), two.len()),
            None => {
                assert!(std::env::var_os("REQUIRE_ALL").is_none(), "taskset or ffmpeg is missing");
                let _ = writeln!(std::io::stderr(), "SKIPPED: taskset or ffmpeg is missing");
            }
        }
    }
}
