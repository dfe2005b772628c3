//! Fields on disk: the configuration in the header, and the parameters as tensors.

use std::path::Path;

use super::{FEATURES, FieldError, NeuralField, Parameters};
use crate::tensors::{Contents, FileError, Tensor, write};

/// The parts of the network by name, with their shapes and their places in its array.
fn parts(field: &NeuralField) -> [(&'static str, Vec<usize>, std::ops::Range<usize>); 4] {
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
    field: &NeuralField,
    sets: &[(&str, &Parameters)],
    steps: Option<u64>,
) -> Result<(), FileError> {
    let config = serde_json::to_string(&field.config)
        .map_err(|error| FileError::Damaged { path: path.to_owned(), message: error.to_string() })?;
    // More steps than that take years.
    let steps = steps.map(|steps| u32::try_from(steps).unwrap_or(u32::MAX));
    let mut tensors: Vec<Tensor> = steps.map(|steps| Tensor::new("steps", vec![1], [steps])).into_iter().collect();
    for (prefix, parameters) in sets {
        let numbers = parameters.table.as_flattened();
        tensors.push(Tensor::new(
            format!("{prefix}grid"),
            vec![parameters.table.len(), FEATURES],
            numbers.iter().copied(),
        ));
        for (name, shape, range) in parts(field) {
            tensors.push(Tensor::new(format!("{prefix}{name}"), shape, parameters.network[range].iter().copied()));
        }
    }
    write(path, Some(("config", config)), &tensors)
}

/// The field in a file.
pub(super) fn field(contents: &Contents) -> Result<NeuralField, FieldError> {
    let config = serde_json::from_str(contents.entry("config")?)
        .map_err(|error| contents.damaged(format!("config: {error}")))?;
    let mut field = NeuralField::zeros(&config).map_err(|error| contents.damaged(format!("config: {error}")))?;
    field.parameters = parameters(contents, "", &field)?;
    Ok(field)
}

/// The optimiser's steps.
pub(super) fn steps(contents: &Contents) -> Result<u64, FileError> {
    let steps: Vec<u32> = contents.numbers("steps", Some(1), &[])?;
    Ok(steps.iter().map(|&steps| u64::from(steps)).sum())
}

/// The parameters whose tensors' names start with `prefix`, for `field`.
pub(super) fn parameters(contents: &Contents, prefix: &str, field: &NeuralField) -> Result<Parameters, FileError> {
    let mut parameters = Parameters::zeros(field.parameters.table.len(), field.layout);
    let grid = contents.numbers(&format!("{prefix}grid"), Some(parameters.table.len()), &[FEATURES])?;
    parameters.table.as_flattened_mut().copy_from_slice(&grid);
    for (name, shape, range) in parts(field) {
        let numbers = contents.numbers(&format!("{prefix}{name}"), Some(shape[0]), &shape[1..])?;
        parameters.network[range].copy_from_slice(&numbers);
    }
    Ok(parameters)
}
