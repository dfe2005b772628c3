//! depth.npz: the depth images of a camera, written and read one frame at a time.
//!
//! The file has the format of `numpy.savez_compressed(depth=..., depth_scale=...)`: a zip archive of two .npy files.
//! Thirty seconds of 640 x 480 are 1.1 GB before compression, so neither writer nor reader holds more than one frame.
//!
//! Each frame is deflated alone ([`DeflatedFrame`], on any thread) and ends on a byte boundary. The frames are joined
//! to one stream, and their checksums are combined, so the bytes depend neither on the number of threads nor on timing.
//! The .npy header stands before the frames and holds their number. It is a block without compression, which is
//! overwritten at the end.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;

use flate2::read::DeflateDecoder;
use flate2::{Compress, Compression, FlushCompress};

use crate::array::{Array, Kind};
use crate::npy;

const DEPTH: &str = "depth.npy";
const SCALE: &str = "depth_scale.npy";
/// Offsets of the compressed and the plain size in a local header's ZIP64 field, which follows the name.
const LOCAL_HEADER: usize = 30;
/// A block without compression: its type, its length and the complement of the length.
const STORED_BLOCK: [u8; 5] = [0, npy::HEADER_LENGTH as u8, 0, !(npy::HEADER_LENGTH as u8), 0xff];
/// An empty last block with fixed codes.
const LAST_BLOCK: [u8; 2] = [3, 0];

/// Reason why a depth.npz is refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NpzError {
    /// Reading failed, or the compressed data are damaged.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// The archive is damaged.
    #[error("not a readable zip archive: {0}")]
    Zip(#[from] zip::result::ZipError),
    /// An array in it is refused.
    #[error("{0}")]
    Npy(#[from] npy::NpyError),
    /// The contents have the wrong type, shape or size.
    #[error("{0}")]
    Defect(String),
}

/// Part of a deflate stream that ends on a byte boundary and does not refer to earlier bytes.
#[derive(Debug, Clone)]
pub struct DeflatedFrame {
    data: Vec<u8>,
    checksum: crc32fast::Hasher,
    values: usize,
}

impl DeflatedFrame {
    /// Compresses an image, fast rather than small: most of a depth image is noise to a compressor.
    ///
    /// # Errors
    /// Those of the compressor, which do not occur in practice, since its parameters are valid.
    pub fn new(values: impl ExactSizeIterator<Item = f32>) -> io::Result<Self> {
        let mut plain = Vec::with_capacity(4 * values.len());
        values.for_each(|value| plain.extend_from_slice(&value.to_le_bytes()));
        let mut checksum = crc32fast::Hasher::new();
        checksum.update(&plain);
        // `write::DeflateEncoder::flush` loses data with this backend once its buffer is full, hence the bare
        // compressor.
        let mut compressor = Compress::new(Compression::fast(), false);
        let mut data = Vec::with_capacity(plain.len() / 2 + 1024);
        loop {
            let rest = &plain[compressor.total_in() as usize..];
            // This flushes and does not end the stream: other frames follow. The flush is complete if room is left.
            compressor.compress_vec(rest, &mut data, FlushCompress::Sync)?;
            if data.len() < data.capacity() {
                break;
            }
            data.reserve(plain.len() / 4 + 1024);
        }
        Ok(Self { data, checksum, values: plain.len() / 4 })
    }

    /// Returns the number of its bytes.
    pub(crate) fn size(&self) -> usize {
        self.data.len()
    }

    /// Gives back the memory that is not filled.
    pub(crate) fn shrink(mut self) -> Self {
        self.data.shrink_to_fit();
        self
    }
}

/// Writer of depth.npz.
pub struct NpzWriter {
    file: BufWriter<File>,
    height: usize,
    width: usize,
    frames: usize,
    checksum: crc32fast::Hasher,
    compressed: u64,
}

impl NpzWriter {
    /// Creates the file for images of this size.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn create(path: &Path, height: usize, width: usize) -> io::Result<Self> {
        let mut file = BufWriter::with_capacity(1 << 20, File::options().write(true).create_new(true).open(path)?);
        file.write_all(&local_header(DEPTH, Method::Deflated, Sizes::default()))?;
        file.write_all(&STORED_BLOCK)?;
        file.write_all(&[0; npy::HEADER_LENGTH])?;
        let compressed = (STORED_BLOCK.len() + npy::HEADER_LENGTH) as u64;
        Ok(Self { file, height, width, frames: 0, checksum: crc32fast::Hasher::new(), compressed })
    }

    /// Appends an image.
    ///
    /// # Errors
    /// Those of the file system, and `InvalidInput` for an image of another size.
    pub fn push(&mut self, frame: &DeflatedFrame) -> io::Result<()> {
        if frame.values != self.height * self.width {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "a depth image of another size"));
        }
        self.file.write_all(&frame.data)?;
        self.compressed += frame.data.len() as u64;
        self.checksum.combine(&frame.checksum);
        self.frames += 1;
        Ok(())
    }

    /// Writes the headers, whose numbers are known only now, and syncs the file to its disk.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn finish(mut self, depth_scale: f64) -> io::Result<()> {
        self.file.write_all(&LAST_BLOCK)?;
        let header = npy::header("<f4", &format!("({}, {}, {})", self.frames, self.height, self.width));
        let mut checksum = crc32fast::Hasher::new();
        checksum.update(&header);
        checksum.combine(&self.checksum);
        let depth = Sizes {
            checksum: checksum.finalize(),
            compressed: self.compressed + LAST_BLOCK.len() as u64,
            plain: (npy::HEADER_LENGTH + 4 * self.frames * self.height * self.width) as u64,
        };

        let mut scale = npy::header("<f8", "()").to_vec();
        scale.extend(depth_scale.to_le_bytes());
        let size = scale.len() as u64;
        let sizes = Sizes { checksum: crc32fast::hash(&scale), compressed: size, plain: size };
        let scale_at = self.file.stream_position()?;
        self.file.write_all(&local_header(SCALE, Method::Stored, sizes))?;
        self.file.write_all(&scale)?;

        let directory_at = self.file.stream_position()?;
        self.file.write_all(&directory_entry(DEPTH, Method::Deflated, depth, 0))?;
        self.file.write_all(&directory_entry(SCALE, Method::Stored, sizes, scale_at))?;
        let end_at = self.file.stream_position()?;
        self.file.write_all(&end_of_directory(2, directory_at, end_at))?;

        self.file.seek(SeekFrom::Start(0))?;
        let local = local_header(DEPTH, Method::Deflated, depth);
        self.file.write_all(&local)?;
        self.file.write_all(&STORED_BLOCK)?;
        self.file.write_all(&header)?;
        self.file.flush()?;
        self.file.get_ref().sync_all()
    }
}

#[derive(Clone, Copy)]
enum Method {
    Stored = 0,
    Deflated = 8,
}

#[derive(Clone, Copy, Default)]
struct Sizes {
    checksum: u32,
    compressed: u64,
    plain: u64,
}

/// Returns the common part of local header and directory entry: version, flags, method, date (1 January 1980) and
/// checksum.
fn common(method: Method, checksum: u32) -> Vec<u8> {
    let mut out = Vec::new();
    // 4.5 is the first version with ZIP64.
    for field in [45, 0, method as u16, 0, 0x21] {
        out.extend(u16::to_le_bytes(field));
    }
    out.extend(checksum.to_le_bytes());
    // Both sizes stand in the ZIP64 field.
    out.extend([0xff; 8]);
    out
}

fn local_header(name: &str, method: Method, sizes: Sizes) -> Vec<u8> {
    let mut out = b"PK\x03\x04".to_vec();
    out.extend(common(method, sizes.checksum));
    out.extend((name.len() as u16).to_le_bytes());
    out.extend(20u16.to_le_bytes());
    debug_assert_eq!(out.len(), LOCAL_HEADER);
    out.extend(name.as_bytes());
    out.extend([1, 0, 16, 0]);
    out.extend(sizes.plain.to_le_bytes());
    out.extend(sizes.compressed.to_le_bytes());
    out
}

fn directory_entry(name: &str, method: Method, sizes: Sizes, at: u64) -> Vec<u8> {
    let mut out = b"PK\x01\x02".to_vec();
    out.extend(45u16.to_le_bytes());
    out.extend(common(method, sizes.checksum));
    out.extend((name.len() as u16).to_le_bytes());
    out.extend(28u16.to_le_bytes());
    // No comment, first disk, no attributes; the offset stands in the ZIP64 field.
    out.extend([0; 10]);
    out.extend([0xff; 4]);
    out.extend(name.as_bytes());
    out.extend([1, 0, 24, 0]);
    for number in [sizes.plain, sizes.compressed, at] {
        out.extend(number.to_le_bytes());
    }
    out
}

fn end_of_directory(entries: u64, directory_at: u64, end_at: u64) -> Vec<u8> {
    let mut out = b"PK\x06\x06".to_vec();
    out.extend(44u64.to_le_bytes());
    out.extend([45, 0, 45, 0]);
    out.extend([0; 8]);
    for number in [entries, entries, end_at - directory_at, directory_at] {
        out.extend(number.to_le_bytes());
    }
    // The locator of the record above, and the record of old readers, which points to the locator.
    out.extend(b"PK\x06\x07\0\0\0\0");
    out.extend(end_at.to_le_bytes());
    out.extend(1u32.to_le_bytes());
    out.extend(b"PK\x05\x06\0\0\0\0");
    out.extend([0xff; 12]);
    out.extend([0; 2]);
    out
}

/// Member of the archive, decompressed while it is read.
struct Member {
    data: Box<dyn Read + Send>,
    size: u64,
    checksum: u32,
}

fn member(path: &Path, name: &str) -> Result<Member, NpzError> {
    let mut archive = zip::ZipArchive::new(BufReader::new(mvt_files::input::open(path)?))?;
    let index = archive
        .index_for_name(name)
        .ok_or_else(|| NpzError::Defect(format!("it has no array {:?}", name.trim_end_matches(".npy"))))?;
    let entry = archive.by_index_raw(index)?;
    let (compressed, size, checksum) = (entry.compressed_size(), entry.size(), entry.crc32());
    let method = entry.compression();
    let start = entry.data_start();
    drop(entry);
    let mut file = archive.into_inner();
    file.seek(SeekFrom::Start(start.ok_or_else(|| NpzError::Defect("a member without data".into()))?))?;
    let raw = file.take(compressed);
    let data: Box<dyn Read + Send> = match method {
        zip::CompressionMethod::Stored => Box::new(raw),
        zip::CompressionMethod::DEFLATE => Box::new(DeflateDecoder::new(raw)),
        other => return Err(NpzError::Defect(format!("it is compressed by {other}, which NumPy does not use"))),
    };
    Ok(Member { data, size, checksum })
}

/// Reader of the images of depth.npz, in order.
pub struct NpzReader {
    data: Box<dyn Read + Send>,
    header: npy::Header,
    scale: f64,
    next: usize,
    /// Raw bytes of one image.
    raw: Vec<u8>,
    checksum: crc32fast::Hasher,
    expected_checksum: u32,
}

impl NpzReader {
    /// Greatest width and height, pixels: larger sizes are refused before memory is allocated.
    pub const MAX_SIDE: usize = 4096;

    /// Opens the file and reads everything but the images.
    ///
    /// # Errors
    /// [`NpzError`] if it has no array `depth` of three axes, or the number of bytes does not match the shape.
    pub fn open(path: &Path) -> Result<Self, NpzError> {
        let scale = depth_scale(path)?;
        let Member { mut data, size, checksum: expected_checksum } = member(path, DEPTH)?;
        let mut start = Vec::new();
        let (header, length) = npy::Header::read(Tee { from: &mut data, seen: &mut start })?;
        let &[frames, height, width] = header.shape.as_slice() else {
            return Err(NpzError::Defect(format!("depth has the shape {:?} and not three axes", header.shape)));
        };
        if header.fortran_order {
            return Err(NpzError::Defect("depth is in Fortran order; save it with numpy.ascontiguousarray".into()));
        }
        if height.max(width) > Self::MAX_SIDE {
            return Err(NpzError::Defect(format!("depth images of {width} x {height} pixels are too large")));
        }
        let bytes = height * width * header.kind.size();
        let expected = (bytes as u64).checked_mul(frames as u64).and_then(|images| images.checked_add(length));
        if expected != Some(size) {
            return Err(NpzError::Defect(format!("depth is {size} bytes long, which does not fit {:?}", header.shape)));
        }
        let mut checksum = crc32fast::Hasher::new();
        checksum.update(&start);
        Ok(Self { data, header, scale, next: 0, raw: vec![0; bytes], checksum, expected_checksum })
    }

    /// Returns the number of images, their height and their width.
    pub fn shape(&self) -> [usize; 3] {
        [self.header.shape[0], self.header.shape[1], self.header.shape[2]]
    }

    /// Returns the factor of all values, metres. Its sign has no meaning.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// Reads the next image, row by row, and multiplies it by the scale; `None` after the last one. The last image is
    /// returned only if the checksum of all images is right.
    ///
    /// # Errors
    /// [`NpzError`] if the data are damaged or end early.
    pub fn read(&mut self) -> Result<Option<Vec<f32>>, NpzError> {
        if !self.advance()? {
            return Ok(None);
        }
        let npy::Header { kind, big_endian, .. } = self.header;
        if big_endian {
            self.raw.chunks_exact_mut(kind.size()).for_each(<[u8]>::reverse);
        }
        Ok(Some(match kind {
            // The most common type, and exact if the scale is 1.
            Kind::F32 => {
                let (values, _) = self.raw.as_chunks();
                values.iter().map(|&bytes| (f64::from(f32::from_le_bytes(bytes)) * self.scale) as f32).collect()
            }
            _ => self.raw.chunks_exact(kind.size()).map(|bytes| (kind.decode(bytes) * self.scale) as f32).collect(),
        }))
    }

    /// Skips the next image.
    ///
    /// # Errors
    /// As [`NpzReader::read`].
    pub fn skip(&mut self) -> Result<(), NpzError> {
        self.advance().map(|_| ())
    }

    fn advance(&mut self) -> Result<bool, NpzError> {
        let frames = self.header.shape[0];
        if self.next == frames {
            return Ok(false);
        }
        self.data.read_exact(&mut self.raw)?;
        self.checksum.update(&self.raw);
        self.next += 1;
        if self.next == frames {
            let surplus = io::copy(&mut self.data.by_ref().take(1), &mut io::sink())?;
            if surplus != 0 || self.checksum.clone().finalize() != self.expected_checksum {
                return Err(NpzError::Defect("the checksum of depth is wrong".into()));
            }
        }
        Ok(true)
    }
}

/// Reads the number `depth_scale`; 1 if the archive does not have it.
fn depth_scale(path: &Path) -> Result<f64, NpzError> {
    let mut data = match member(path, SCALE) {
        Ok(Member { data, .. }) => data,
        Err(NpzError::Defect(_)) => return Ok(1.0),
        Err(other) => return Err(other),
    };
    let (header, _) = npy::Header::read(&mut data)?;
    let size = header.kind.size();
    let defect = || NpzError::Defect("depth_scale is not one finite number".into());
    if header.shape.iter().any(|&length| length != 1) {
        return Err(defect());
    }
    let mut raw = vec![0; size];
    data.read_exact(&mut raw)?;
    let array = Array::from_raw(header.kind, header.big_endian, false, vec![], &raw).map_err(NpzError::Defect)?;
    array.to_f64().next().filter(|scale| scale.is_finite() && *scale != 0.0).ok_or_else(defect)
}

/// Reader that keeps a copy of the bytes.
struct Tee<'a, R> {
    from: R,
    seen: &'a mut Vec<u8>,
}

impl<R: Read> Read for Tee<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.from.read(buffer)?;
        self.seen.extend_from_slice(&buffer[..n]);
        Ok(n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_of_real_size_come_back_in_order() {
        // Hard to compress, so that every buffer overflows.
        let image =
            |seed: u32| (0..480 * 640u32).map(move |i| ((i.wrapping_mul(2_654_435_761) ^ seed) >> 8) as f32 / -3e7);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.npz");
        let mut writer = NpzWriter::create(&path, 480, 640).unwrap();
        (0..4).for_each(|seed| writer.push(&DeflatedFrame::new(image(seed)).unwrap()).unwrap());
        assert!(writer.push(&DeflatedFrame::new([0.0].into_iter()).unwrap()).is_err());
        writer.finish(1.0).unwrap();
        let mut reader = NpzReader::open(&path).unwrap();
        assert_eq!((reader.shape(), reader.scale()), ([4, 480, 640], 1.0));
        for seed in 0..4 {
            assert!(reader.read().unwrap().unwrap().into_iter().eq(image(seed)), "{seed}");
        }
        assert!(reader.read().unwrap().is_none());
    }

    #[test]
    fn a_scale_of_countless_numbers_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.npz");
        for (shape, is_right) in [("()", true), ("(1, 1)", true), ("(9223372036854775808, 2)", false), ("(0,)", false)]
        {
            let mut archive = zip::ZipWriter::new(File::create(&path).unwrap());
            archive.start_file(SCALE, zip::write::SimpleFileOptions::default()).unwrap();
            archive.write_all(&npy::header("<f8", shape)).unwrap();
            archive.write_all(&0.5_f64.to_le_bytes()).unwrap();
            archive.finish().unwrap();
            assert_eq!(depth_scale(&path).is_ok_and(|scale| scale == 0.5), is_right, "{shape}");
        }
    }
}
