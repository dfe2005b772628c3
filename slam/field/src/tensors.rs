//! Named arrays of numbers on disk: safetensors files with texts in the header.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use mvt_files::{input, output, seal};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};

/// Largest file that is read; the largest that is written is far below.
const MAX_BYTES: u64 = 4 << 30;

/// A file that could not be written, or that has another content than expected.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FileError {
    /// The file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not safetensors, is cut off, or its header lacks something.
    #[error("{}: {message}; it was written by something else, or is damaged", path.display())]
    Damaged {
        /// Which file.
        path: PathBuf,
        /// The defect.
        message: String,
    },
    /// A tensor is missing, or does not fit the header and the other tensors.
    #[error("{}: tensor {tensor} {message}", path.display())]
    Tensor {
        /// Which file.
        path: PathBuf,
        /// Which tensor.
        tensor: String,
        /// Its defect.
        message: String,
    },
}

/// A kind of number that a tensor can hold.
pub trait Number: Copy + Into<f64> {
    /// The type in a safetensors file.
    const DTYPE: Dtype;
    /// Bytes of a number.
    const BYTES: usize;
    /// Appends the number, little-endian.
    fn write(self, out: &mut Vec<u8>);
    /// Of exactly [`Number::BYTES`] bytes; `None` for any other length.
    fn read(bytes: &[u8]) -> Option<Self>;
}

macro_rules! number {
    ($kind:ty, $dtype:expr) => {
        impl Number for $kind {
            const DTYPE: Dtype = $dtype;
            const BYTES: usize = size_of::<$kind>();
            fn write(self, out: &mut Vec<u8>) {
                out.extend(self.to_le_bytes());
            }
            fn read(bytes: &[u8]) -> Option<Self> {
                Some(Self::from_le_bytes(bytes.try_into().ok()?))
            }
        }
    };
}

number!(f32, Dtype::F32);
number!(f64, Dtype::F64);
number!(u32, Dtype::U32);

/// A tensor as it goes to the file.
pub struct Tensor {
    name: String,
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Tensor {
    /// `numbers` row by row.
    pub fn new<N: Number>(name: impl Into<String>, shape: Vec<usize>, numbers: impl IntoIterator<Item = N>) -> Self {
        let mut bytes = Vec::with_capacity(shape.iter().product::<usize>() * N::BYTES);
        numbers.into_iter().for_each(|number| number.write(&mut bytes));
        Self { name: name.into(), dtype: N::DTYPE, shape, bytes }
    }
}

/// Writes a file under another name first, so that one that is cut off never has its own. The header has one text at most: of more,
/// the order would differ from run to run, and with it the bytes.
pub fn write(path: &Path, text: Option<(&str, String)>, tensors: &[Tensor]) -> Result<(), FileError> {
    let damaged = |message: String| FileError::Damaged { path: path.to_owned(), message };
    let views = tensors
        .iter()
        .map(|t| TensorView::new(t.dtype, t.shape.clone(), &t.bytes).map(|view| (t.name.as_str(), view)))
        .collect::<Result<Vec<_>, _>>()
        .map_err(|error| damaged(error.to_string()))?;
    let header = text.map(|(key, text)| HashMap::from([(key.to_owned(), text)]));
    let bytes = safetensors::serialize(views, header).map_err(|error| damaged(error.to_string()))?;
    let io = |source| FileError::Io { path: path.to_owned(), source };
    output::replace(path, &seal::seal(bytes)).map_err(io)
}

/// A file that was read and whose header makes sense.
pub struct Contents {
    path: PathBuf,
    bytes: Vec<u8>,
    header: HashMap<String, String>,
}

impl Contents {
    /// Reads a file.
    ///
    /// # Errors
    /// If it cannot be read or is not a safetensors file.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let io = |source| FileError::Io { path: path.to_owned(), source };
        let damaged = |message: String| FileError::Damaged { path: path.to_owned(), message };
        let bytes = input::read(path, MAX_BYTES).map_err(io)?;
        seal::check(&bytes).map_err(|broken| damaged(broken.to_string()))?;
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|error| damaged(error.to_string()))?;
        let header = header.metadata().clone().unwrap_or_default();
        // Checked once here, so that tensors are read from a whole file.
        SafeTensors::deserialize(&bytes).map_err(|error| damaged(error.to_string()))?;
        Ok(Self { path: path.to_owned(), bytes, header })
    }

    /// Returns the size of the file, bytes.
    pub fn size_bytes(&self) -> usize {
        self.bytes.len()
    }

    /// A text of the header.
    pub fn entry(&self, key: &str) -> Result<&str, FileError> {
        let missing = || self.damaged(format!("there is no {key} in the header"));
        self.header.get(key).map(String::as_str).ok_or_else(missing)
    }

    /// Whether the file holds a tensor of this name.
    pub fn has(&self, name: &str) -> bool {
        SafeTensors::deserialize(&self.bytes).is_ok_and(|file| file.tensor(name).is_ok())
    }

    /// The error of a damaged file.
    pub fn damaged(&self, message: String) -> FileError {
        FileError::Damaged { path: self.path.clone(), message }
    }

    /// The error about a tensor that does not fit.
    pub fn wrong(&self, tensor: &str, message: String) -> FileError {
        FileError::Tensor { path: self.path.clone(), tensor: tensor.to_owned(), message }
    }

    /// Returns the numbers of a tensor, all finite. The first dimension may have any size if `rows` is `None`.
    pub fn numbers<N: Number>(&self, name: &str, rows: Option<usize>, rest: &[usize]) -> Result<Vec<N>, FileError> {
        let file = SafeTensors::deserialize(&self.bytes).map_err(|error| self.damaged(error.to_string()))?;
        let tensor = file.tensor(name).map_err(|error| self.wrong(name, error.to_string()))?;
        let (dtype, shape) = (tensor.dtype(), tensor.shape());
        let fits = shape.split_first().is_some_and(|(&n, tail)| rows.is_none_or(|rows| rows == n) && tail == rest);
        if dtype != N::DTYPE || !fits {
            let rows = rows.map_or_else(|| "any number".to_owned(), |rows| rows.to_string());
            return Err(
                self.wrong(name, format!("is {:?}; {:?} of {rows} x {rest:?} is asked for", (dtype, shape), N::DTYPE))
            );
        }
        let numbers: Vec<N> = tensor.data().chunks_exact(N::BYTES).filter_map(N::read).collect();
        match numbers.iter().position(|&number| !number.into().is_finite()) {
            Some(at) => Err(self.wrong(name, format!("has {} at position {at}", numbers[at].into()))),
            None => Ok(numbers),
        }
    }
}
