//! Fields on disk: safetensors with the configuration in the metadata.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, SafeTensors, View};

use super::{FEATURES, Field, FieldError, Parameters};

/// Largest file that is read: the largest configuration is far below.
const MAX_BYTES: u64 = 4 << 30;

/// A tensor of 32-bit numbers as it goes to the file.
struct Tensor<'a> {
    shape: Vec<usize>,
    numbers: &'a [f32],
}

impl View for Tensor<'_> {
    fn dtype(&self) -> Dtype {
        Dtype::F32
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        self.numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
    }

    fn data_len(&self) -> usize {
        size_of_val(self.numbers)
    }
}

/// The parts of the network by name, with their shapes and their places in its array.
fn parts(field: &Field) -> [(&'static str, Vec<usize>, std::ops::Range<usize>); 4] {
    let layout = field.layout;
    [
        ("hidden.weight", vec![layout.hidden, layout.inputs], 0..layout.biases()),
        ("hidden.bias", vec![layout.hidden], layout.biases()..layout.output()),
        ("output.weight", vec![1, layout.hidden], layout.output()..layout.output_bias()),
        ("output.bias", vec![1], layout.output_bias()..layout.parameters()),
    ]
}

/// Writes sets of parameters, the names of whose tensors start with a prefix each.
pub(super) fn save(
    path: &Path,
    field: &Field,
    sets: &[(&str, &Parameters)],
    steps: Option<u64>,
) -> Result<(), FieldError> {
    let damaged = |message: String| FieldError::File { path: path.to_owned(), message };
    let config = serde_json::to_string(&field.config).map_err(|error| damaged(error.to_string()))?;
    let mut metadata = HashMap::from([("config".to_owned(), config)]);
    metadata.extend(steps.map(|steps| ("steps".to_owned(), steps.to_string())));
    let mut tensors = Vec::new();
    for (prefix, parameters) in sets {
        let numbers = parameters.table.as_flattened();
        tensors.push((format!("{prefix}grid"), Tensor { shape: vec![parameters.table.len(), FEATURES], numbers }));
        for (name, shape, range) in parts(field) {
            tensors.push((format!("{prefix}{name}"), Tensor { shape, numbers: &parameters.network[range] }));
        }
    }
    let bytes = safetensors::serialize(tensors, Some(metadata)).map_err(|error| damaged(error.to_string()))?;

    let io = |source| FieldError::Io { path: path.to_owned(), source };
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    std::fs::write(&partial, bytes).map_err(io)?;
    std::fs::rename(&partial, path).map_err(io)
}

/// A file that was read and whose header makes sense.
pub(super) struct Contents {
    path: PathBuf,
    bytes: Vec<u8>,
    metadata: HashMap<String, String>,
}

impl Contents {
    pub(super) fn read(path: &Path) -> Result<Self, FieldError> {
        let io = |source| FieldError::Io { path: path.to_owned(), source };
        let size = std::fs::metadata(path).map_err(io)?.len();
        let damaged = |message: String| FieldError::File { path: path.to_owned(), message };
        if size > MAX_BYTES {
            return Err(damaged(format!("{size} bytes are more than any field has")));
        }
        let bytes = std::fs::read(path).map_err(io)?;
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|error| damaged(error.to_string()))?;
        let metadata = header.metadata().clone().unwrap_or_default();
        Ok(Self { path: path.to_owned(), bytes, metadata })
    }

    fn entry(&self, key: &str) -> Result<&str, FieldError> {
        let missing = || self.damaged(format!("there is no {key} in the metadata"));
        self.metadata.get(key).map(String::as_str).ok_or_else(missing)
    }

    fn damaged(&self, message: String) -> FieldError {
        FieldError::File { path: self.path.clone(), message }
    }

    pub(super) fn steps(&self) -> Result<u64, FieldError> {
        self.entry("steps")?.parse().map_err(|error| self.damaged(format!("steps: {error}")))
    }

    pub(super) fn field(&self) -> Result<Field, FieldError> {
        let config =
            serde_json::from_str(self.entry("config")?).map_err(|error| self.damaged(format!("config: {error}")))?;
        let mut field = Field::zeros(&config)?;
        field.parameters = self.parameters("", &field)?;
        Ok(field)
    }

    /// The parameters whose tensors' names start with `prefix`, for `field`.
    pub(super) fn parameters(&self, prefix: &str, field: &Field) -> Result<Parameters, FieldError> {
        let mut parameters = Parameters::zeros(field.parameters.table.len(), field.layout);
        let shape = [parameters.table.len(), FEATURES];
        self.tensor(&format!("{prefix}grid"), &shape, parameters.table.as_flattened_mut())?;
        for (name, shape, range) in parts(field) {
            self.tensor(&format!("{prefix}{name}"), &shape, &mut parameters.network[range])?;
        }
        Ok(parameters)
    }

    fn tensor(&self, name: &str, shape: &[usize], out: &mut [f32]) -> Result<(), FieldError> {
        let wrong = |message| FieldError::Tensor { path: self.path.clone(), tensor: name.to_owned(), message };
        let file = SafeTensors::deserialize(&self.bytes).map_err(|error| self.damaged(error.to_string()))?;
        let tensor = file.tensor(name).map_err(|error| wrong(error.to_string()))?;
        if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
            let found = (tensor.dtype(), tensor.shape());
            return Err(wrong(format!("is {found:?}; the configuration asks for F32 of {shape:?}")));
        }
        for (out, &bytes) in out.iter_mut().zip(tensor.data().as_chunks::<4>().0) {
            *out = f32::from_le_bytes(bytes);
        }
        if let Some(at) = out.iter().position(|number| !number.is_finite()) {
            return Err(wrong(format!("has {} at position {at}", out[at])));
        }
        Ok(())
    }
}
