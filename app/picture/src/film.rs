//! Films: GIF, and MP4 through the program ffmpeg.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};

use color_quant::NeuQuant;
use image::RgbImage;
use mvt_files::output::PartialFile;

/// Colours of a GIF; the last of 256 indices marks pixels that do not change.
const COLOURS: usize = 255;
const UNCHANGED: u8 = 255;
/// Every Nth pixel of the samples is used to choose the colours: 1 (best) to 30 (fastest).
const SAMPLING: i32 = 10;
/// Leading bits per channel that select a colour in the table.
const BITS: u32 = 6;

/// Why a film cannot be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FilmError {
    /// The name of the file has another extension.
    #[error("{0}: unknown format; give a name that ends in .gif, .mp4 or .png")]
    UnknownFormat(PathBuf),
    /// A PNG holds one picture.
    #[error("{0}: a PNG cannot hold a film; give a name that ends in .gif or .mp4")]
    NotAFilm(PathBuf),
    /// A GIF has at most 65535 pixels along a side.
    #[error("a GIF of {0} x {1} pixels is too large; at most 65535 pixels fit along a side")]
    TooLarge(u32, u32),
    /// The samples, from which the colours of a GIF are chosen, have no pixel.
    #[error("a GIF needs at least one sample picture to choose its colours")]
    NoSamples,
    /// A picture has another size than the film.
    #[error("a picture of {found:?} pixels does not fit a film of {expected:?} pixels")]
    OtherSize {
        /// Width and height of the picture, pixels.
        found: [u32; 2],
        /// Width and height of the film, pixels.
        expected: [u32; 2],
    },
    /// The encoder of GIFs fails, for example because the disk is full.
    #[error("cannot encode the GIF: {0}")]
    Gif(#[from] gif::EncodingError),
    /// A file cannot be written.
    #[error("cannot write {path}: {error}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The reason.
        error: io::Error,
    },
    /// ffmpeg cannot be started.
    #[error("{path}: cannot start ffmpeg, which encodes MP4 ({error}); install it, or give a name that ends in .gif")]
    NoFfmpeg {
        /// The film.
        path: PathBuf,
        /// The reason.
        error: io::Error,
    },
    /// ffmpeg has ended before the film, or with an error.
    #[error("{path}: ffmpeg has failed{}", .status.map(|status| format!(" ({status})")).unwrap_or_default())]
    Ffmpeg {
        /// The film.
        path: PathBuf,
        /// How ffmpeg has ended, where it is known.
        status: Option<ExitStatus>,
    },
}

/// Format of a picture or film.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum FilmFormat {
    /// One picture.
    Png,
    /// A film that every browser plays.
    Gif,
    /// A smaller film with finer colours.
    Mp4,
}

impl FilmFormat {
    /// Returns the format that the extension of a file name stands for.
    ///
    /// # Errors
    /// [`FilmError::UnknownFormat`] for other extensions.
    pub fn of(path: &Path) -> Result<Self, FilmError> {
        match path.extension().and_then(|extension| extension.to_str()).map(str::to_ascii_lowercase).as_deref() {
            Some("png") => Ok(Self::Png),
            Some("gif") => Ok(Self::Gif),
            Some("mp4") => Ok(Self::Mp4),
            _ => Err(FilmError::UnknownFormat(path.to_path_buf())),
        }
    }
}

/// Film that is being written to a file, which appears under its name only when it is complete.
pub struct Film {
    kind: Kind,
    path: PathBuf,
    place: PartialFile,
    overwrite: bool,
}

enum Kind {
    Gif(Box<GifWriter<BufWriter<File>>>),
    Mp4(Mp4Writer),
}

impl Film {
    /// Begins a film of this width and height in pixels. The colours of a GIF are chosen from `samples`, which an MP4
    /// does not need. An existing file is replaced only with `overwrite`.
    ///
    /// # Errors
    /// [`FilmError`] if the file cannot be created, or if an MP4 is wanted and ffmpeg is not installed.
    pub fn create(
        path: &Path,
        format: FilmFormat,
        size: [u32; 2],
        rate_hz: f64,
        samples: &[RgbImage],
        overwrite: bool,
    ) -> Result<Self, FilmError> {
        let io = |error| FilmError::Io { path: path.to_path_buf(), error };
        let mut place = PartialFile::create(path).map_err(io)?;
        let kind = match format {
            FilmFormat::Gif => {
                let file = place.file().try_clone().map_err(io)?;
                Kind::Gif(Box::new(GifWriter::new(BufWriter::new(file), size, rate_hz, samples)?))
            }
            FilmFormat::Mp4 => Kind::Mp4(Mp4Writer::create(place.partial_path(), size, rate_hz)?),
            FilmFormat::Png => return Err(FilmError::NotAFilm(path.to_path_buf())),
        };
        Ok(Self { kind, path: path.to_path_buf(), place, overwrite })
    }

    /// Appends a picture.
    ///
    /// # Errors
    /// [`FilmError`] if the picture has another size or cannot be written.
    pub fn push(&mut self, picture: &RgbImage) -> Result<(), FilmError> {
        match &mut self.kind {
            Kind::Gif(writer) => writer.push(picture),
            Kind::Mp4(writer) => writer.push(picture),
        }
    }

    /// Ends the film.
    ///
    /// # Errors
    /// [`FilmError`] if the rest of the film cannot be written.
    pub fn finish(self) -> Result<(), FilmError> {
        match self.kind {
            Kind::Gif(writer) => writer.finish().map(drop)?,
            Kind::Mp4(writer) => writer.finish()?,
        }
        let placed = if self.overwrite { self.place.replace() } else { self.place.finish() };
        placed.map_err(|error| FilmError::Io { path: self.path, error })
    }
}

/// Writer of GIFs with one palette. Each picture after the first holds only the rectangle that differs from the one
/// before.
pub struct GifWriter<W: Write> {
    encoder: gif::Encoder<W>,
    palette: NeuQuant,
    /// Index of each colour in the palette, by its leading bits; found when a picture first has it.
    indices: Vec<Option<u8>>,
    before: Vec<u8>,
    width: u16,
    height: u16,
    /// Hundredths of a second.
    delay: u16,
}

impl<W: Write> GifWriter<W> {
    /// Begins a GIF of this width and height in pixels, which repeats for ever. The palette is chosen from the colours
    /// of `samples`.
    ///
    /// # Errors
    /// [`FilmError`] if the size is too large, there is no sample, or the header cannot be written.
    pub fn new(writer: W, [width, height]: [u32; 2], rate_hz: f64, samples: &[RgbImage]) -> Result<Self, FilmError> {
        let side = |side: u32| u16::try_from(side).map_err(|_| FilmError::TooLarge(width, height));
        let (width, height) = (side(width)?, side(height)?);
        let rgba: Vec<u8> =
            samples.iter().flat_map(|image| image.pixels()).flat_map(|p| [p[0], p[1], p[2], 255]).collect();
        if rgba.is_empty() {
            return Err(FilmError::NoSamples);
        }
        let palette = NeuQuant::new(SAMPLING, COLOURS, &rgba);
        let mut colours = palette.color_map_rgb();
        colours.resize(3 * 256, 0);
        let mut encoder = gif::Encoder::new(writer, width, height, &colours)?;
        encoder.set_repeat(gif::Repeat::Infinite)?;
        let delay = (100.0 / rate_hz).round().clamp(2.0, 1000.0) as u16;
        let indices = vec![None; 1 << (3 * BITS)];
        Ok(Self { encoder, palette, indices, before: Vec::new(), width, height, delay })
    }

    /// The index of a colour in the palette.
    fn index(&mut self, colour: [u8; 3]) -> u8 {
        let [r, g, b] = colour.map(|c| c >> (8 - BITS));
        let key = usize::from(r) << (2 * BITS) | usize::from(g) << BITS | usize::from(b);
        *self.indices[key].get_or_insert_with(|| {
            let middle = |c: u8| (c << (8 - BITS)) + (1 << (7 - BITS));
            self.palette.index_of(&[middle(r), middle(g), middle(b), 255]) as u8
        })
    }

    /// Appends a picture.
    ///
    /// # Errors
    /// [`FilmError`] if the picture has another size or cannot be written.
    pub fn push(&mut self, picture: &RgbImage) -> Result<(), FilmError> {
        let expected = [self.width, self.height].map(u32::from);
        let found = [picture.width(), picture.height()];
        if found != expected {
            return Err(FilmError::OtherSize { found, expected });
        }
        let now: Vec<u8> = picture.as_raw().as_chunks::<3>().0.iter().map(|colour| self.index(*colour)).collect();
        let (width, height) = (usize::from(self.width), usize::from(self.height));
        let mut frame = gif::Frame { delay: self.delay, dispose: gif::DisposalMethod::Keep, ..gif::Frame::default() };
        if self.before.is_empty() {
            (frame.width, frame.height) = (self.width, self.height);
            frame.buffer = now.clone().into();
        } else {
            let differs = |row: usize, column: usize| now[row * width + column] != self.before[row * width + column];
            let rows: Vec<usize> = (0..height).filter(|&y| (0..width).any(|x| differs(y, x))).collect();
            // A frame needs a pixel: equal pictures give one unchanged pixel.
            let (top, bottom) = (rows.first().copied().unwrap_or(0), rows.last().copied().unwrap_or(0));
            let is_wanted = |&x: &usize| rows.iter().any(|&y| differs(y, x));
            let left = (0..width).find(is_wanted).unwrap_or(0);
            let right = (0..width).rev().find(is_wanted).unwrap_or(0);
            let pixel = |y: usize, x: usize| if differs(y, x) { now[y * width + x] } else { UNCHANGED };
            frame.buffer =
                (top..=bottom).flat_map(|y| (left..=right).map(move |x| (y, x))).map(|(y, x)| pixel(y, x)).collect();
            (frame.left, frame.top) = (left as u16, top as u16);
            (frame.width, frame.height) = ((right - left + 1) as u16, (bottom - top + 1) as u16);
            frame.transparent = Some(UNCHANGED);
        }
        self.before = now;
        Ok(self.encoder.write_frame(&frame)?)
    }

    /// Ends the GIF and returns the writer.
    ///
    /// # Errors
    /// [`FilmError`] if the end cannot be written.
    pub fn finish(self) -> Result<W, FilmError> {
        let mut writer = self.encoder.into_inner()?;
        writer.flush().map_err(gif::EncodingError::from)?;
        Ok(writer)
    }
}

/// Pipe to ffmpeg, which encodes an MP4 (H.264).
pub struct Mp4Writer {
    path: PathBuf,
    ffmpeg: Child,
    /// Even numbers, as H.264 requires.
    size: [u32; 2],
}

impl Mp4Writer {
    /// Starts ffmpeg for a film of this width and height in pixels. An odd last row or column is cut off.
    ///
    /// # Errors
    /// [`FilmError::NoFfmpeg`] if ffmpeg cannot be started.
    pub fn create(path: &Path, size: [u32; 2], rate_hz: f64) -> Result<Self, FilmError> {
        let [width, height] = size.map(|side| side & !1);
        let mut ffmpeg = Command::new("ffmpeg");
        // Whoever presses Ctrl-C stops the program, which may finish its film first.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut ffmpeg, 0);
        let ffmpeg = ffmpeg
            .args(["-nostdin", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"])
            .args(["-s", &format!("{width}x{height}"), "-r", &rate_hz.to_string(), "-i", "-"])
            .args(["-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4", "-y"])
            .arg(path)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .spawn();
        let path = path.to_path_buf();
        match ffmpeg {
            Ok(ffmpeg) => Ok(Self { path, ffmpeg, size: [width, height] }),
            Err(error) => Err(FilmError::NoFfmpeg { path, error }),
        }
    }

    /// Appends a picture.
    ///
    /// # Errors
    /// [`FilmError`] if the picture has another size or ffmpeg has ended.
    pub fn push(&mut self, picture: &RgbImage) -> Result<(), FilmError> {
        let [width, height] = self.size;
        let found = [picture.width(), picture.height()];
        if found.map(|side| side & !1) != self.size {
            return Err(FilmError::OtherSize { found, expected: self.size });
        }
        let picture = image::imageops::crop_imm(picture, 0, 0, width, height).to_image();
        let written = self.ffmpeg.stdin.as_mut().map(|pipe| pipe.write_all(&picture));
        match written {
            Some(Ok(())) => Ok(()),
            _ => Err(FilmError::Ffmpeg { path: self.path.clone(), status: None }),
        }
    }

    /// Ends the film and waits for ffmpeg.
    ///
    /// # Errors
    /// [`FilmError::Ffmpeg`] if ffmpeg reports an error.
    pub fn finish(mut self) -> Result<(), FilmError> {
        drop(self.ffmpeg.stdin.take());
        let status = self.ffmpeg.wait().map_err(|error| FilmError::Io { path: self.path.clone(), error })?;
        if status.success() { Ok(()) } else { Err(FilmError::Ffmpeg { path: self.path.clone(), status: Some(status) }) }
    }
}

impl Drop for Mp4Writer {
    fn drop(&mut self) {
        drop(self.ffmpeg.stdin.take());
        let _ = self.ffmpeg.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::codecs::gif::GifDecoder;
    use image::{AnimationDecoder as _, Rgb};

    #[test]
    fn a_gif_shows_the_pictures_that_were_pushed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("film.gif");
        // A square that moves over stripes, once not at all.
        let picture = |at: u32| {
            RgbImage::from_fn(160, 120, |x, y| match (x.wrapping_sub(at) < 24 && (36..60).contains(&y), y / 24 % 2) {
                (true, _) => Rgb([204, 60, 20]),
                (false, 0) => Rgb([250, 250, 248]),
                _ => Rgb([40, 90, 180]),
            })
        };
        let pictures: Vec<RgbImage> = [12, 36, 36, 120].map(picture).to_vec();
        assert!(matches!(
            Film::create(&path, FilmFormat::Gif, [160, 120], 10.0, &[], false),
            Err(FilmError::NoSamples)
        ));
        let mut film = Film::create(&path, FilmFormat::Gif, [160, 120], 10.0, &pictures[..2], false).unwrap();
        pictures.iter().for_each(|picture| film.push(picture).unwrap());
        assert!(!path.exists(), "it appears when it is complete");
        assert!(film.push(&RgbImage::new(3, 3)).is_err());
        film.finish().unwrap();
        let file = std::io::BufReader::new(File::open(&path).unwrap());
        let frames = GifDecoder::new(file).unwrap().into_frames().collect_frames().unwrap();
        assert_eq!(frames.len(), pictures.len());
        for (frame, picture) in frames.iter().zip(&pictures) {
            let off =
                frame.buffer().pixels().zip(picture.pixels()).flat_map(|(a, b)| (0..3).map(|c| a[c].abs_diff(b[c])));
            let off = off.max();
            assert!(off < Some(12), "{off:?}");
            assert_eq!(frame.delay().numer_denom_ms(), (100, 1));
        }
    }

    #[test]
    fn formats_go_by_names() {
        let of = |name: &str| FilmFormat::of(Path::new(name)).ok();
        assert_eq!(
            [of("a/b.GIF"), of("x.mp4"), of("x.png")],
            [Some(FilmFormat::Gif), Some(FilmFormat::Mp4), Some(FilmFormat::Png)]
        );
        assert_eq!([of("x"), of("x.avi"), of(".gif")], [None; 3]);
    }
}
