//! Frames of a video or a camera, which the program ffmpeg decodes.

// Why: notes/decisions/touch.md, "Videos and cameras come through the program ffmpeg".

use std::io::{BufRead, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context as _, Result, bail, ensure};
use image::RgbImage;
use mvt_robot::digit::profile::SensorProfile;

use crate::window::GelWindow;

/// Place that frames come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum StreamSource {
    /// Video file.
    Video(PathBuf),
    /// Camera of the system, such as `/dev/video0`.
    Camera(PathBuf),
}

/// How fast a video is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// As fast as frames are used.
    Fastest,
    /// As fast as the film shows them.
    OfTheFilm,
}

impl std::fmt::Display for StreamSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Video(path) | Self::Camera(path) => path.display().fmt(f),
        }
    }
}

/// One frame leaves ffmpeg for each frame that it reads, whatever their times are: all get a number as their time, at a steady rate.
const EACH_FRAME_ONCE: [&str; 4] = ["-vf", "settb=1/60,setpts=N", "-r", "60"];
/// Largest frame, pixels.
const LARGEST_FRAME: usize = 20_000_000;
/// Longest word in the head of a frame: a number, with some room.
const LONGEST_WORD: u64 = 16;
/// Length of ffmpeg's messages that is kept, bytes.
const LONGEST_MESSAGE: u64 = 1 << 14;

/// Frames that may wait.
const WAITING: usize = 8;
/// After this time without a frame it is checked whether the stream is to be left.
const PATIENCE: Duration = Duration::from_millis(100);

/// Frames in their order, which ffmpeg decodes while earlier ones are used.
pub struct VideoStream {
    source: StreamSource,
    ffmpeg: Child,
    frames: Receiver<RgbImage>,
    /// Returns why a frame could not be read.
    reader: Option<JoinHandle<Option<anyhow::Error>>>,
    messages: Option<JoinHandle<Vec<u8>>>,
}

impl StreamSource {
    /// Starts ffmpeg on this source, which shows a sensor with this profile. A video is read as fast as possible or at the rate of its frames; a
    /// camera has its own rate.
    ///
    /// # Errors
    /// If there is no such file or camera, or ffmpeg cannot be started.
    pub fn open(&self, pace: Pace, profile: &SensorProfile) -> Result<VideoStream> {
        let mut command = Command::new("ffmpeg");
        command.args(["-nostdin", "-loglevel", "error"]);
        if pace == Pace::OfTheFilm && matches!(self, Self::Video(_)) {
            command.arg("-re");
        }
        match self {
            Self::Video(path) => {
                mvt_files::input::open(path).with_context(|| format!("cannot read the video {}", path.display()))?;
                // A name is never taken for an address.
                let mut file = std::ffi::OsString::from("file:");
                file.push(path);
                command.arg("-i").arg(file);
            }
            Self::Camera(path) => {
                ensure!(
                    is_device(path),
                    "{} is no camera: connect it, and give its device, such as /dev/video0",
                    path.display()
                );
                command.args(["-f", "v4l2"]);
                // A camera that lacks this mode delivers its nearest one. Of one that sees more than the gel, the size is its own.
                if profile.corners_px.is_none() {
                    // Cameras deliver images that are wider than tall, however the sensor is mounted.
                    let [a, b] = profile.size_px;
                    command.args(["-video_size", &format!("{}x{}", a.max(b), a.min(b))]);
                }
                command.args(["-framerate", &profile.frame_hz.to_string(), "-i"]).arg(path);
            }
        }
        command.args(["-map", "0:v:0"]).args(EACH_FRAME_ONCE).args(["-f", "image2pipe", "-c:v", "ppm", "-"]);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // Ctrl-C stops this program, which ends ffmpeg itself.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut ffmpeg = command
            .spawn()
            .context("cannot start ffmpeg, which decodes videos and cameras; install it, for example with `apt-get install ffmpeg`")?;
        let (sender, frames) = mpsc::sync_channel(WAITING);
        let window = GelWindow::of(profile);
        let read = move |output| send_frames(output, window.as_ref(), &sender);
        let reader = ffmpeg.stdout.take().map(|output| std::thread::spawn(move || read(output)));
        let messages = ffmpeg.stderr.take().map(|messages| std::thread::spawn(|| first_messages(messages)));
        Ok(VideoStream { source: self.clone(), ffmpeg, frames, reader, messages })
    }
}

/// Returns whether a path leads to a device that delivers bytes.
fn is_device(path: &Path) -> bool {
    #[cfg(unix)]
    return std::fs::metadata(path).is_ok_and(|data| std::os::unix::fs::FileTypeExt::is_char_device(&data.file_type()));
    #[cfg(not(unix))]
    path.exists()
}

/// Reads all messages, so that ffmpeg never waits, and returns the first of them.
fn first_messages(mut messages: ChildStderr) -> Vec<u8> {
    let mut kept = Vec::new();
    let read = messages.by_ref().take(LONGEST_MESSAGE).read_to_end(&mut kept);
    if read.is_ok() {
        let _ = std::io::copy(&mut messages, &mut std::io::sink());
    }
    kept
}

/// Sends all frames until nobody receives them any more. Returns why one could not be read.
fn send_frames(
    output: ChildStdout,
    window: Option<&GelWindow>,
    sender: &SyncSender<RgbImage>,
) -> Option<anyhow::Error> {
    let mut output = BufReader::new(output);
    let mut next = || match (read_frame(&mut output)?, window) {
        (Some(frame), Some(window)) => window.cut(&frame).map(Some),
        (frame, _) => Ok(frame),
    };
    loop {
        match next() {
            Ok(Some(frame)) => sender.send(frame).ok()?,
            Ok(None) => return None,
            Err(error) => return Some(error),
        }
    }
}

impl VideoStream {
    /// Returns `least` to `most` frames: waits for the least number, and takes those that are there. Returns fewer at the end and after
    /// `stop` is set.
    pub fn receive(&self, least: usize, most: usize, stop: &AtomicBool) -> Vec<RgbImage> {
        let mut images = Vec::new();
        while images.len() < most && !stop.load(Ordering::Relaxed) {
            let is_enough = images.len() >= least;
            match self.frames.recv_timeout(if is_enough { Duration::ZERO } else { PATIENCE }) {
                Ok(image) => images.push(image),
                Err(RecvTimeoutError::Timeout) if !is_enough => {}
                Err(_) => break,
            }
        }
        images
    }

    /// Waits for the end of ffmpeg after the last frame, and warns if a video is damaged or cut off. `read` is the number of frames that were
    /// received.
    ///
    /// # Errors
    /// If there was no frame, or a camera has ended, for example because it was unplugged.
    pub fn finish(mut self, read: usize) -> Result<()> {
        let broken = self.reader.take().and_then(|thread| thread.join().ok()).flatten();
        let status = self.ffmpeg.wait().context("cannot wait for ffmpeg")?;
        let messages = self.messages.take().and_then(|thread| thread.join().ok()).unwrap_or_default();
        let message = last_message(&String::from_utf8_lossy(&messages));
        let reason = message.or_else(|| broken.map(|error| format!("{error:#}")));
        let reason = reason.or_else(|| (!status.success()).then(|| format!("ffmpeg has failed ({status})")));
        match (&self.source, reason) {
            (StreamSource::Video(path), reason) if read == 0 => {
                let reason = reason.unwrap_or_else(|| "it has no frames".to_owned());
                bail!("{} is no video that ffmpeg can read: {reason}", path.display())
            }
            (StreamSource::Video(path), Some(reason)) => {
                tracing::warn!("{} is damaged or cut off, {read} frames could be read: {reason}", path.display());
                Ok(())
            }
            (StreamSource::Video(_), None) => Ok(()),
            (StreamSource::Camera(path), reason) => {
                let reason = reason.unwrap_or_else(|| "it delivers no more frames".to_owned());
                let path = path.display();
                if read == 0 {
                    bail!("cannot read the camera {path}: {reason}; connect it, and end other programs that use it")
                }
                bail!("the camera {path} was lost after {read} frames: {reason}; connect it again")
            }
        }
    }
}

impl Drop for VideoStream {
    fn drop(&mut self) {
        // It fails only if ffmpeg has ended.
        let _ = self.ffmpeg.kill();
        let _ = self.ffmpeg.wait();
    }
}

/// Returns the last message of ffmpeg without the part and the file that it names.
fn last_message(messages: &str) -> Option<String> {
    let line = messages.lines().map(str::trim).rfind(|line| !line.is_empty())?;
    let line = match line.strip_prefix('[').and_then(|line| line.split_once("] ")) {
        Some((_, message)) => message,
        None => line,
    };
    Some(
        line.rsplit_once(": ")
            .filter(|(path, _)| path.contains('/') || path.starts_with("file:"))
            .map_or(line, |(_, message)| message)
            .to_owned(),
    )
}

/// Reads a frame as a portable pixmap: P6, width, height, the greatest level and the pixels. Returns `None` at the end.
fn read_frame(input: &mut impl BufRead) -> Result<Option<RgbImage>> {
    if input.fill_buf().context("cannot read from ffmpeg")?.is_empty() {
        return Ok(None);
    }
    ensure!(word(input)? == "P6", "ffmpeg delivers no frames");
    let mut number = || -> Result<usize> { word(input)?.parse().context("ffmpeg delivers no frames") };
    let (width, height, greatest) = (number()?, number()?, number()?);
    ensure!(greatest == 255, "ffmpeg delivers no frames of 8 bits per colour");
    let count = width.saturating_mul(height);
    ensure!((1..=LARGEST_FRAME).contains(&count), "frames of {width} x {height} pixels are too large");
    let mut pixels = vec![0; 3 * count];
    input.read_exact(&mut pixels).context("the last frame is cut off")?;
    Ok(RgbImage::from_raw(width as u32, height as u32, pixels))
}

/// Reads a word and the space behind it.
fn word(input: &mut impl BufRead) -> Result<String> {
    let mut word = String::new();
    for byte in input.take(LONGEST_WORD).bytes() {
        let byte = byte.context("cannot read from ffmpeg")?;
        if byte.is_ascii_whitespace() {
            break;
        }
        word.push(char::from(byte));
    }
    Ok(word)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_read_until_they_are_cut_off() {
        let mut input: &[u8] = b"P6\n2 1\n255\n123456P6 1 1 255 a";
        let frame = read_frame(&mut input).unwrap().unwrap();
        assert_eq!((frame.dimensions(), frame.as_raw().as_slice()), ((2, 1), &b"123456"[..]));
        assert!(read_frame(&mut input).unwrap_err().to_string().contains("cut off"));
        assert!(read_frame(&mut &b""[..]).unwrap().is_none());
        for other in
            ["P5 1 1 255 abc", "P6 1 1 65535 abcdef", "P6 0 1 255 ", "P6 99999 99999 255 ", "P6 -1 1 255 ", "P6"]
        {
            assert!(read_frame(&mut other.as_bytes()).is_err(), "{other}");
        }
    }

    #[test]
    fn messages_of_ffmpeg_are_reasons() {
        let reason = |messages: &str| last_message(messages).unwrap_or_default();
        assert_eq!(
            reason("[mov,mp4 @ 0x1] moov atom not found\nfile:a b.mp4: Invalid data found\n"),
            "Invalid data found"
        );
        assert_eq!(reason("[matroska,webm @ 0x55] File ended prematurely\n\n"), "File ended prematurely");
        assert_eq!(reason("/dev/video0: No such device\n"), "No such device");
        assert_eq!(last_message("\n"), None);
    }
}
