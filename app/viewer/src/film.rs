//! Pictures as files: PNG, GIF or, through ffmpeg, MP4.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use anyhow::{Context as _, Result, anyhow, bail};
use color_quant::NeuQuant;
use image::RgbImage;
use rayon::prelude::*;

/// Colours of a GIF; the last index of 256 stands for what stays as it was.
const COLOURS: usize = 255;
const UNCHANGED: u8 = 255;
/// Every how many-th pixel decides about the colours: 1 (best) to 30.
const SAMPLING: i32 = 10;
/// Bits per channel by which colours are looked up.
const BITS: u32 = 6;

/// What a file is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// One picture.
    Png,
    /// A film that every browser shows.
    Gif,
    /// A film, smaller and finer.
    Mp4,
}

impl Format {
    /// By the name of the file.
    ///
    /// # Errors
    /// If it is none of them.
    pub fn of(path: &Path) -> Result<Self> {
        match path.extension().and_then(|extension| extension.to_str()).map(str::to_ascii_lowercase).as_deref() {
            Some("png") => Ok(Self::Png),
            Some("gif") => Ok(Self::Gif),
            Some("mp4") => Ok(Self::Mp4),
            _ => bail!("{}: give a name that ends in .gif, .mp4 or .png", path.display()),
        }
    }
}

/// A film that is being written.
pub enum Film {
    /// See [`Format::Gif`].
    Gif(Box<Gif>),
    /// See [`Format::Mp4`].
    Mp4(Mp4),
}

impl Film {
    /// Begins a film of pictures of this width and height. The colours of a GIF are those of `samples`.
    ///
    /// # Errors
    /// If the file cannot be made, or for an MP4, ffmpeg is not installed.
    pub fn create(path: &Path, format: Format, size: [u32; 2], rate_hz: f64, samples: &[RgbImage]) -> Result<Self> {
        match format {
            Format::Gif => Ok(Self::Gif(Box::new(Gif::create(path, size, rate_hz, samples)?))),
            Format::Mp4 => Ok(Self::Mp4(Mp4::create(path, size, rate_hz)?)),
            Format::Png => bail!("{}: a PNG is no film", path.display()),
        }
    }

    /// Appends a picture.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn push(&mut self, picture: &RgbImage) -> Result<()> {
        match self {
            Self::Gif(gif) => gif.push(picture),
            Self::Mp4(film) => film.push(picture),
        }
    }

    /// Ends the film.
    ///
    /// # Errors
    /// If it cannot be written to its end.
    pub fn finish(self) -> Result<()> {
        match self {
            Self::Gif(gif) => gif.finish(),
            Self::Mp4(film) => film.finish(),
        }
    }
}

/// A GIF with one palette. Each picture holds only what differs from the one before.
pub struct Gif {
    path: PathBuf,
    partial: PathBuf,
    encoder: gif::Encoder<BufWriter<File>>,
    /// Index of each colour, by its leading bits.
    indices: Vec<u8>,
    before: Vec<u8>,
    width: u16,
    height: u16,
    /// Hundredths of a second.
    delay: u16,
}

impl Gif {
    fn create(path: &Path, [width, height]: [u32; 2], rate_hz: f64, samples: &[RgbImage]) -> Result<Self> {
        let side = |side: u32| u16::try_from(side).map_err(|_| anyhow!("a GIF has at most 65535 pixels along a side"));
        let rgba: Vec<u8> =
            samples.iter().flat_map(|image| image.pixels()).flat_map(|p| [p[0], p[1], p[2], 255]).collect();
        let quantiser = NeuQuant::new(SAMPLING, COLOURS, &rgba);
        let mut palette = quantiser.color_map_rgb();
        palette.resize(3 * 256, 0);
        let (mask, half) = ((1 << BITS) - 1, 1 << (7 - BITS));
        let channel = |key: u32, place: u32| ((((key >> (BITS * place)) & mask) << (8 - BITS)) + half) as u8;
        let index = |key: u32| quantiser.index_of(&[channel(key, 2), channel(key, 1), channel(key, 0), 255]) as u8;
        let indices = (0..1u32 << (3 * BITS)).into_par_iter().map(index).collect();
        let partial = path.with_extension("gif.partial");
        let file = File::create(&partial).with_context(|| format!("cannot write {}", partial.display()))?;
        let (width, height) = (side(width)?, side(height)?);
        let mut encoder = gif::Encoder::new(BufWriter::new(file), width, height, &palette)?;
        encoder.set_repeat(gif::Repeat::Infinite)?;
        let delay = (100.0 / rate_hz).round().clamp(2.0, 1000.0) as u16;
        Ok(Self { path: path.to_path_buf(), partial, encoder, indices, before: Vec::new(), width, height, delay })
    }

    fn push(&mut self, picture: &RgbImage) -> Result<()> {
        let key = |[r, g, b]: &[u8; 3]| {
            let [r, g, b] = [r, g, b].map(|c| usize::from(*c) >> (8 - BITS));
            r << (2 * BITS) | g << BITS | b
        };
        let now: Vec<u8> =
            picture.as_raw().as_chunks::<3>().0.par_iter().map(|pixel| self.indices[key(pixel)]).collect();
        let (width, height) = (usize::from(self.width), usize::from(self.height));
        if now.len() != width * height {
            bail!("a picture of {} x {} in a film of {width} x {height}", picture.width(), picture.height());
        }
        let mut frame = gif::Frame { delay: self.delay, dispose: gif::DisposalMethod::Keep, ..gif::Frame::default() };
        if self.before.is_empty() {
            (frame.width, frame.height) = (self.width, self.height);
            frame.buffer = now.clone().into();
        } else {
            let differs = |row: usize, column: usize| now[row * width + column] != self.before[row * width + column];
            let rows: Vec<usize> = (0..height).filter(|&y| (0..width).any(|x| differs(y, x))).collect();
            // A picture without pixels is none: where nothing differs, one pixel that stays.
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
        self.encoder.write_frame(&frame).with_context(|| format!("cannot write {}", self.partial.display()))
    }

    fn finish(self) -> Result<()> {
        let Self { path, partial, encoder, .. } = self;
        encoder.into_inner()?.flush()?;
        std::fs::rename(&partial, &path).with_context(|| format!("cannot write {}", path.display()))
    }
}

/// A film that ffmpeg encodes.
pub struct Mp4 {
    path: PathBuf,
    ffmpeg: Child,
    /// ffmpeg's H.264 wants even sizes.
    size: [u32; 2],
}

impl Mp4 {
    fn create(path: &Path, size: [u32; 2], rate_hz: f64) -> Result<Self> {
        let [width, height] = size.map(|side| side & !1);
        let ffmpeg = Command::new("ffmpeg")
            .args(["-nostdin", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"])
            .args(["-s", &format!("{width}x{height}"), "-r", &rate_hz.to_string(), "-i", "-"])
            .args(["-pix_fmt", "yuv420p", "-movflags", "+faststart", "-y"])
            .arg(path)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .spawn();
        match ffmpeg {
            Ok(ffmpeg) => Ok(Self { path: path.to_path_buf(), ffmpeg, size: [width, height] }),
            Err(error) => bail!(
                "{}: an MP4 needs ffmpeg, which cannot be started ({error}); install it, or give a name that ends in .gif",
                path.display()
            ),
        }
    }

    fn push(&mut self, picture: &RgbImage) -> Result<()> {
        let [width, height] = self.size;
        let picture = image::imageops::crop_imm(picture, 0, 0, width, height).to_image();
        let pipe = self.ffmpeg.stdin.as_mut().context("ffmpeg does not listen")?;
        pipe.write_all(&picture).with_context(|| format!("{}: ffmpeg has ended", self.path.display()))
    }

    fn finish(mut self) -> Result<()> {
        drop(self.ffmpeg.stdin.take());
        let status = self.ffmpeg.wait()?;
        if status.success() { Ok(()) } else { bail!("{}: ffmpeg ended with {status}", self.path.display()) }
    }
}

impl Drop for Mp4 {
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
    fn a_gif_shows_what_was_pushed() {
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
        let mut film = Film::create(&path, Format::Gif, [160, 120], 10.0, &pictures[..2]).unwrap();
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
        let of = |name: &str| Format::of(Path::new(name)).ok();
        assert_eq!(
            [of("a/b.GIF"), of("x.mp4"), of("x.png")],
            [Some(Format::Gif), Some(Format::Mp4), Some(Format::Png)]
        );
        assert_eq!([of("x"), of("x.avi"), of(".gif")], [None; 3]);
    }
}
