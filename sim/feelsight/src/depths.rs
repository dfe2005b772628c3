//! Depth images of a camera in order, from either layout.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::compact::CompactFrames;
use crate::error::LogError;
use crate::npz::NpzReader;

/// Reader of the depth images of a camera.
pub(crate) enum DepthReader {
    /// depth.npz.
    Npz(PathBuf, NpzReader),
    /// Images in frames.zip.
    Archive {
        /// The archive.
        frames: Arc<CompactFrames>,
        /// Name of the camera.
        camera: String,
        /// Its width and height.
        size: (usize, usize),
        /// Folder of the images, for messages.
        path: PathBuf,
        /// Number of the next image.
        next: usize,
    },
}

impl DepthReader {
    /// Opens a depth.npz whose images have this width and height.
    pub fn npz(path: PathBuf, (w, h): (usize, usize)) -> Result<Self, LogError> {
        let reader = NpzReader::open(&path).map_err(LogError::npz(&path))?;
        let [_, height, width] = reader.shape();
        if (width, height) != (w, h) {
            return Err(LogError::defect(
                path,
                format!("its images are {width} x {height} pixels and those of the camera {w} x {h}"),
            ));
        }
        Ok(Self::Npz(path, reader))
    }

    /// Begins with the first image of a camera in an archive.
    pub fn archive(frames: Arc<CompactFrames>, camera: &str, size: (usize, usize)) -> Self {
        let path = frames.archive.path(&format!("realsense/{camera}/depth"));
        Self::Archive { frames, camera: camera.to_owned(), size, path, next: 0 }
    }

    /// Returns the file, for messages.
    pub fn path(&self) -> &Path {
        match self {
            Self::Npz(path, _) | Self::Archive { path, .. } => path,
        }
    }

    /// Returns the number of images.
    pub fn count(&self) -> usize {
        match self {
            Self::Npz(_, reader) => reader.shape()[0],
            Self::Archive { frames, camera, .. } => frames.archive.count(&format!("realsense/{camera}/depth")),
        }
    }

    /// Reads the next image, row by row, metres; `None` after the last one. In front of a camera of this program depth is negative.
    pub fn read(&mut self) -> Result<Option<Vec<f32>>, LogError> {
        if let Self::Npz(path, reader) = self {
            return reader.read().map_err(LogError::npz(&*path));
        }
        let count = self.count();
        let Self::Archive { frames, camera, size, next, .. } = self else { return Ok(None) };
        if *next >= count {
            return Ok(None);
        }
        let mut depth = frames.depth_m(camera, *next, *size)?;
        depth.iter_mut().filter(|depth| **depth > 0.0).for_each(|depth| *depth = -*depth);
        *next += 1;
        Ok(Some(depth))
    }

    /// Skips the next image.
    pub fn skip(&mut self) -> Result<(), LogError> {
        match self {
            Self::Npz(path, reader) => reader.skip().map_err(LogError::npz(&*path)),
            Self::Archive { next, .. } => {
                *next += 1;
                Ok(())
            }
        }
    }
}
