//! Weights on disk: safetensors, with the architecture and the provenance as JSON in the metadata.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::fmt::Display;
use std::path::{Path, PathBuf};

use half::{bf16, f16};
use mvt_files::{input, output, seal};
use mvt_robot::digit::profile::Appearance;
use safetensors::tensor::{Dtype, SafeTensors, View};
use serde::{Deserialize, Serialize};

use super::architecture::Architecture;
use super::image_size::ImageSizeError;

/// Largest file that is read, bytes; the largest network is far smaller.
const MAX_BYTES: u64 = 4 << 30;
/// Shipped weights of `default`, trained on images of simulated DIGITs.
const SHIPPED: &[u8] = include_bytes!("../../weights/default.safetensors");
const SHIPPED_HALF: &[u8] = include_bytes!("../../weights/half.safetensors");
const SHIPPED_DIGIT: &[u8] = include_bytes!("../../weights/digit.safetensors");
/// Key of the header in the metadata.
const KEY: &str = "mambavitact";

/// Numbers with a shape, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct WeightTensor {
    /// Sides.
    pub shape: Vec<usize>,
    /// As many numbers as the product of the sides.
    pub values: Vec<f32>,
}

impl WeightTensor {
    /// Returns zeros of the same shape.
    #[must_use]
    pub fn zeros(&self) -> Self {
        Self { shape: self.shape.clone(), values: vec![0.0; self.values.len()] }
    }
}

/// Origin of weights.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Provenance {
    /// Seed of the training.
    pub seed: u64,
    /// Completed steps of the optimiser.
    pub step: u64,
    /// SHA-256 of the description of the data, hexadecimal.
    pub data: String,
    /// Configuration of the training.
    pub training: serde_json::Value,
}

/// Weights of a network: all tensors of its architecture, with finite numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    architecture: Architecture,
    provenance: Provenance,
    input_size: Option<[usize; 2]>,
    trained_for: Option<Appearance>,
    tensors: BTreeMap<String, WeightTensor>,
}

/// Number format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// 32 bits.
    F32,
    /// The upper 16 bits of those, rounded.
    Bf16,
}

/// Reason that weights cannot be used or stored.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WeightsError {
    /// The file cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        source: std::io::Error,
    },
    /// The file does not hold weights of a touch network, is cut off, or has an invalid header.
    #[error("{}: not the weights of a touch network: {message}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Fault.
        message: String,
    },
    /// A tensor does not fit the architecture, or a number is not finite.
    #[error("{}: tensor {tensor} of network {network}: {message}", path.display())]
    Tensor {
        /// The file or another source of the weights.
        path: PathBuf,
        /// Name of the architecture.
        network: &'static str,
        /// Name of the tensor.
        tensor: String,
        /// Fault and expectation.
        message: String,
    },
}

/// Header in the metadata.
#[derive(Serialize, Deserialize)]
struct Header {
    architecture: Architecture,
    provenance: Provenance,
    /// Files of 0.1 do not have it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    input_size: Option<[usize; 2]>,
    /// Files for DIGITs do not have it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    trained_for: Option<Appearance>,
}

impl Weights {
    /// Returns the weights that the crate ships: those of `default`, for images of a DIGIT (240 x 320 pixels).
    ///
    /// # Errors
    /// None in practice: a test reads the shipped file.
    pub fn shipped() -> Result<Self, WeightsError> {
        Self::from_bytes(SHIPPED, Path::new("the shipped weights"))
    }

    /// Returns the shipped weights of `default` that resize images to half their size: a quarter of the work of [`Weights::shipped`], and 15 %
    /// more error in contact. Runs use them.
    ///
    /// # Errors
    /// None in practice: a test reads the shipped file.
    pub fn shipped_half() -> Result<Self, WeightsError> {
        Self::from_bytes(SHIPPED_HALF, Path::new("the shipped weights for half the size"))
    }

    /// Returns the shipped weights of `default` that were trained on sensors like real DIGITs.
    ///
    /// # Errors
    /// None in practice: a test reads the shipped file.
    pub fn shipped_digit() -> Result<Self, WeightsError> {
        Self::from_bytes(SHIPPED_DIGIT, Path::new("the shipped weights for real DIGITs"))
    }

    /// Returns the weights of `default` that were trained on sensors like a GelSight Mini. They are a file: in the folder `weights` beside the
    /// program, or in the sources from which it was built.
    ///
    /// # Errors
    /// [`WeightsError`] if the file is in neither place, or damaged.
    pub fn shipped_gelsight_mini() -> Result<Self, WeightsError> {
        const NAME: &str = "gelsight_mini.safetensors";
        let program = std::env::current_exe().unwrap_or_default();
        let beside = program.parent().unwrap_or(Path::new("")).join("weights").join(NAME);
        let sources = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/weights")).join(NAME);
        if let Some(path) = [&beside, &sources].into_iter().find(|path| path.exists()) {
            return Self::read(path);
        }
        let reason = "it is missing; copy it there from perception/touch/weights of the sources";
        Err(WeightsError::Io { path: beside, source: std::io::Error::new(std::io::ErrorKind::NotFound, reason) })
    }

    /// Builds weights from tensors by name; errors name `source`.
    ///
    /// # Errors
    /// [`WeightsError`] if the architecture is invalid, or a tensor is missing, surplus, of the wrong shape or not finite.
    pub fn new(
        architecture: Architecture,
        provenance: Provenance,
        tensors: BTreeMap<String, WeightTensor>,
        source: &Path,
    ) -> Result<Self, WeightsError> {
        let path = || source.to_owned();
        architecture.check().map_err(|error| WeightsError::File { path: path(), message: error.to_string() })?;
        let network = architecture.name();
        let wrong =
            |tensor: &str, message| WeightsError::Tensor { path: path(), network, tensor: tensor.to_owned(), message };
        let expected: BTreeMap<String, Vec<usize>> = architecture.tensors().into_iter().collect();
        for (name, shape) in &expected {
            let tensor = tensors.get(name).ok_or_else(|| wrong(name, format!("is missing; its shape is {shape:?}")))?;
            if tensor.shape != *shape || tensor.values.len() != shape.iter().product::<usize>() {
                let message = format!("is {:?}; the architecture needs {shape:?}", tensor.shape);
                return Err(wrong(name, message));
            }
            if let Some(index) = tensor.values.iter().position(|value| !value.is_finite()) {
                let message = format!("{shape:?} holds {} at index {index}", tensor.values[index]);
                return Err(wrong(name, message));
            }
        }
        if let Some((name, tensor)) = tensors.iter().find(|(name, _)| !expected.contains_key(*name)) {
            return Err(wrong(name, format!("{:?} does not belong to the architecture", tensor.shape)));
        }
        Ok(Self { architecture, provenance, input_size: None, trained_for: None, tensors })
    }

    /// Reads weights from a file.
    ///
    /// # Errors
    /// [`WeightsError`] if the file cannot be read, does not hold weights, or its tensors do not fit its architecture.
    pub fn read(path: &Path) -> Result<Self, WeightsError> {
        let io = |source| WeightsError::Io { path: path.to_owned(), source };
        Self::from_bytes(&input::read(path, MAX_BYTES).map_err(io)?, path)
    }

    /// Reads weights from the bytes of a file; errors name `source`.
    ///
    /// # Errors
    /// As for [`Weights::read`].
    pub fn from_bytes(bytes: &[u8], source: &Path) -> Result<Self, WeightsError> {
        let damaged = |message: String| WeightsError::File { path: source.to_owned(), message };
        seal::check(bytes).map_err(|broken| damaged(broken.to_string()))?;
        let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(|error| damaged(error.to_string()))?;
        let header = metadata.metadata().as_ref().and_then(|metadata| metadata.get(KEY));
        let header = header.ok_or_else(|| damaged(format!("there is no {KEY} in its metadata")))?;
        let Header { architecture, provenance, input_size, trained_for } =
            serde_json::from_str(header).map_err(|error| damaged(format!("metadata {KEY}: {error}")))?;
        let file = SafeTensors::deserialize(bytes).map_err(|error| damaged(error.to_string()))?;
        let network = architecture.name();
        let mut tensors = BTreeMap::new();
        for (name, view) in file.tensors() {
            let values = match view.dtype() {
                Dtype::F32 => view.data().as_chunks().0.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect(),
                Dtype::BF16 => {
                    view.data().as_chunks().0.iter().map(|&bytes| bf16::from_le_bytes(bytes).to_f32()).collect()
                }
                Dtype::F16 => {
                    view.data().as_chunks().0.iter().map(|&bytes| f16::from_le_bytes(bytes).to_f32()).collect()
                }
                other => {
                    let message = format!("is {other:?} of {:?}; F32, F16 or BF16 expected", view.shape());
                    return Err(WeightsError::Tensor { path: source.to_owned(), network, tensor: name, message });
                }
            };
            tensors.insert(name, WeightTensor { shape: view.shape().to_vec(), values });
        }
        Self::new(architecture, provenance, tensors, source)?
            .for_sensor(trained_for)
            .with_input_size(input_size)
            .map_err(|error| damaged(error.to_string()))
    }

    /// Returns the weights of a network that resizes images to these rows and columns before it sees them; with `None` it sees them at their own
    /// size.
    ///
    /// # Errors
    /// [`ImageSizeError`] if a side is out of range.
    pub fn with_input_size(self, input_size: Option<[usize; 2]>) -> Result<Self, ImageSizeError> {
        if let Some([height, width]) = input_size {
            ImageSizeError::check(width, height)?;
        }
        Ok(Self { input_size, ..self })
    }

    /// Returns the weights of a network that was trained for sensors which look so; with `None` for DIGITs.
    #[must_use]
    pub fn for_sensor(self, trained_for: Option<Appearance>) -> Self {
        Self { trained_for, ..self }
    }

    /// Returns the look of the sensors that the network was trained for, unless they are DIGITs.
    pub fn trained_for(&self) -> Option<&Appearance> {
        self.trained_for.as_ref()
    }

    /// Returns the rows and columns to which the network resizes images, if it does.
    pub fn input_size(&self) -> Option<[usize; 2]> {
        self.input_size
    }

    /// Writes the weights. The file appears whole or not at all.
    ///
    /// # Errors
    /// [`WeightsError::Io`] if the file cannot be written.
    pub fn write(&self, path: &Path, precision: Precision) -> Result<(), WeightsError> {
        let damaged = |message: String| WeightsError::File { path: path.to_owned(), message };
        let header = Header {
            architecture: self.architecture.clone(),
            provenance: self.provenance.clone(),
            input_size: self.input_size,
            trained_for: self.trained_for,
        };
        let header = serde_json::to_string(&header).map_err(|error| damaged(error.to_string()))?;
        write_tensors(path, &self.tensors, precision, [KEY, &header])
    }

    /// Returns the network of the weights.
    pub fn architecture(&self) -> &Architecture {
        &self.architecture
    }

    /// Returns the origin of the weights.
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// Returns all tensors by name, as [`Architecture::tensors`] lists them.
    pub fn tensors(&self) -> &BTreeMap<String, WeightTensor> {
        &self.tensors
    }

    /// Returns the values of a tensor; an empty slice if the architecture has no such tensor.
    pub fn values(&self, name: &str) -> &[f32] {
        self.tensors.get(name).map_or(&[], |tensor| &tensor.values)
    }
}

/// Writes tensors by name to a safetensors file with a checksum; the metadata holds one key with its value. The file appears whole or not
/// at all.
///
/// # Errors
/// [`WeightsError`] if the file cannot be written.
pub fn write_tensors<'a>(
    path: &Path,
    tensors: impl IntoIterator<Item = (impl AsRef<str> + Ord + Display, &'a WeightTensor)>,
    precision: Precision,
    metadata: [&str; 2],
) -> Result<(), WeightsError> {
    let [key, value] = metadata.map(str::to_owned);
    let tensors = tensors.into_iter().map(|(name, tensor)| (name, Stored { tensor, precision }));
    let bytes = safetensors::serialize(tensors, Some(HashMap::from([(key, value)])))
        .map_err(|error| WeightsError::File { path: path.to_owned(), message: error.to_string() })?;
    output::replace(path, &seal::seal(bytes)).map_err(|source| WeightsError::Io { path: path.to_owned(), source })
}

/// Tensor in the precision of the file.
struct Stored<'a> {
    tensor: &'a WeightTensor,
    precision: Precision,
}

impl View for Stored<'_> {
    fn dtype(&self) -> Dtype {
        match self.precision {
            Precision::F32 => Dtype::F32,
            Precision::Bf16 => Dtype::BF16,
        }
    }

    fn shape(&self) -> &[usize] {
        &self.tensor.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        let values = self.tensor.values.iter();
        match self.precision {
            Precision::F32 => values.flat_map(|value| value.to_le_bytes()).collect(),
            Precision::Bf16 => values.flat_map(|&value| bf16::from_f32(value).to_le_bytes()).collect(),
        }
    }

    fn data_len(&self) -> usize {
        self.tensor.values.len() * if self.precision == Precision::F32 { 4 } else { 2 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::Pyramid;

    fn weights() -> Weights {
        let architecture =
            Architecture::Default(Pyramid { widths: [2, 3, 4, 16], depth: 1, state: 2, ..Pyramid::default() });
        let mut next = 0.0;
        let tensors = architecture.tensors().into_iter().map(|(name, shape)| {
            next += 0.37;
            let values = vec![next; shape.iter().product()];
            (name, WeightTensor { shape, values })
        });
        let provenance = Provenance { seed: 3, step: 7, data: "ab".to_owned(), training: serde_json::json!({"lr": 1}) };
        let tensors = tensors.collect();
        let weights = Weights::new(architecture, provenance, tensors, Path::new("memory")).unwrap();
        let weights = weights.for_sensor(Some(Appearance { led_distance_mm: 14.0, ..Appearance::default() }));
        weights.with_input_size(Some([160, 128])).unwrap()
    }

    #[test]
    fn input_sizes_are_checked() {
        for size in [[0, 16], [16, 2049]] {
            assert!(weights().with_input_size(Some(size)).is_err(), "{size:?}");
        }
        assert_eq!(Weights::shipped().unwrap().input_size(), None);
        assert_eq!(Weights::shipped_half().unwrap().input_size(), Some([160, 128]));
    }

    #[test]
    fn come_back_from_disk() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.safetensors");
        let weights = weights();
        weights.write(&path, Precision::F32).unwrap();
        assert_eq!(Weights::read(&path).unwrap(), weights);
        weights.write(&path, Precision::Bf16).unwrap();
        let rounded = Weights::read(&path).unwrap();
        assert_eq!((rounded.provenance(), rounded.input_size()), (weights.provenance(), weights.input_size()));
        for (name, tensor) in rounded.tensors() {
            let exact = weights.values(name);
            assert!(tensor.values.iter().zip(exact).all(|(a, b)| (a - b).abs() <= b.abs() / 256.0), "{name}");
        }
        assert!(!folder.path().join("weights.safetensors.part").exists());
    }

    #[test]
    fn misfits_are_named() {
        let weights = weights();
        let error = |change: &dyn Fn(&mut BTreeMap<String, WeightTensor>)| {
            let mut tensors = weights.tensors.clone();
            change(&mut tensors);
            let made = Weights::new(weights.architecture.clone(), Provenance::default(), tensors, Path::new("f.st"));
            made.unwrap_err().to_string()
        };
        let text = error(&|t| drop(t.remove("stem.bias")));
        assert!(text.contains("stem.bias") && text.contains("[2]") && text.contains("missing"), "{text}");
        let text = error(&|t| drop(t.insert("extra".into(), WeightTensor { shape: vec![1], values: vec![0.0] })));
        assert!(text.contains("extra") && text.contains("does not belong"), "{text}");
        let text = error(&|t| t.get_mut("norm.bias").unwrap().shape = vec![8, 2]);
        assert!(text.contains("[8, 2]") && text.contains("[16]"), "{text}");
        let text = error(&|t| t.get_mut("head.bias").unwrap().values[5] = f32::NAN);
        assert!(text.contains("head.bias") && text.contains("NaN at index 5"), "{text}");
    }

    #[test]
    fn damaged_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.safetensors");
        weights().write(&path, Precision::F32).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for end in [0, 7, 100, bytes.len() / 2, bytes.len() - 1] {
            assert!(Weights::from_bytes(&bytes[..end], &path).is_err(), "cut off at {end}");
        }
        let other = safetensors::serialize::<String, Stored<'_>, _>([], None).unwrap();
        assert!(Weights::from_bytes(&other, &path).unwrap_err().to_string().contains("metadata"));
        assert!(Weights::read(&folder.path().join("none")).unwrap_err().to_string().contains("none"));
    }
}
