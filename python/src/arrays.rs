//! Arrays from and to NumPy. Every reader names the argument, the expected and the given value.

use image::RgbImage;
use mvt_frames::{Frame, Isometry};
use ndarray::{Array2, ArrayD};
use numpy::{Element, IntoPyArray as _, PyArray1, PyArrayDyn, PyArrayMethods as _};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;

use crate::errors::Kind;

/// Returns an argument as a NumPy array, with its dtype's kind and name.
fn as_array<'py>(value: &Bound<'py, PyAny>, name: &str) -> PyResult<(Bound<'py, PyAny>, String, String)> {
    static ASARRAY: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let py = value.py();
    let array = ASARRAY
        .import(py, "numpy", "asarray")?
        .call1((value,))
        .map_err(|error| Kind::Argument.error(format!("{name} is no array: {error}")))?;
    let dtype = array.getattr("dtype")?;
    let (kind, dtype) = (dtype.getattr("kind")?.extract()?, dtype.str()?.to_string());
    Ok((array, kind, dtype))
}

/// Returns the text of a shape, with N for any length.
fn shape_text(shape: &[Option<usize>]) -> String {
    let sides: Vec<String> = shape.iter().map(|side| side.map_or("N".to_owned(), |n| n.to_string())).collect();
    if let [one] = sides.as_slice() { format!("({one},)") } else { format!("({})", sides.join(", ")) }
}

fn read<T: Element + Copy>(
    value: &Bound<'_, PyAny>,
    name: &str,
    dtype: &str,
    kinds: &str,
    shape: &[Option<usize>],
) -> PyResult<ArrayD<T>> {
    let (array, kind, found) = as_array(value, name)?;
    let found_shape: Vec<usize> = array.getattr("shape")?.extract()?;
    let expected = shape_text(shape);
    let fits =
        found_shape.len() == shape.len() && shape.iter().zip(&found_shape).all(|(s, f)| s.is_none_or(|s| s == *f));
    if !fits || !kinds.contains(&kind) {
        let came = shape_text(&found_shape.iter().map(|&n| Some(n)).collect::<Vec<_>>());
        return Err(Kind::Argument
            .error(format!(
                "{name}: expected an array of dtype {dtype} and shape {expected}, got dtype {found} and shape {came}"
            ))
            .into());
    }
    let order = pyo3::types::PyDict::new(value.py());
    order.set_item("order", "C")?;
    order.set_item("copy", false)?;
    let array = array.call_method("astype", (dtype,), Some(&order))?.cast_into::<PyArrayDyn<T>>()?;
    // In the order of the indices. A copy of the array would keep NumPy's strides, which can be anything along a side of length 0 or 1.
    let values: Vec<T> = array.readonly().as_array().iter().copied().collect();
    Ok(ArrayD::from_shape_vec(found_shape, values).map_err(|error| Kind::Argument.error(format!("{name}: {error}")))?)
}

/// Reads finite numbers. `N` stands for any length of a side.
pub fn numbers(value: &Bound<'_, PyAny>, name: &str, shape: &[Option<usize>]) -> PyResult<ArrayD<f64>> {
    let array = read::<f64>(value, name, "float64", "fiu", shape)?;
    finite(array.iter().all(|x| x.is_finite()), name)?;
    Ok(array)
}

/// Reads finite numbers in 32 bits.
pub fn singles(value: &Bound<'_, PyAny>, name: &str, shape: &[Option<usize>]) -> PyResult<ArrayD<f32>> {
    let array = read::<f32>(value, name, "float32", "fiu", shape)?;
    finite(array.iter().all(|x| x.is_finite()), name)?;
    Ok(array)
}

fn finite(holds: bool, name: &str) -> PyResult<()> {
    if holds {
        return Ok(());
    }
    let text = format!("{name}: expected finite numbers, got NaN or infinity; write 0 where nothing was measured");
    Err(Kind::Argument.error(text).into())
}

/// Reads indices.
pub fn indices(value: &Bound<'_, PyAny>, name: &str, shape: &[Option<usize>]) -> PyResult<ArrayD<i64>> {
    read::<i64>(value, name, "int64", "iu", shape)
}

/// Reads truth values.
pub fn truths(value: &Bound<'_, PyAny>, name: &str, shape: &[Option<usize>]) -> PyResult<ArrayD<bool>> {
    read::<bool>(value, name, "bool", "b", shape)
}

/// Reads images of colours with the shape (N, height, width, 3), or one of (height, width, 3).
pub fn images(
    value: &Bound<'_, PyAny>,
    name: &str,
    count: Option<usize>,
    size: [Option<usize>; 2],
) -> PyResult<Vec<RgbImage>> {
    let array = bytes(value, name, &[count, size[0], size[1], Some(3)])?;
    let (height, width) = (array.shape()[1], array.shape()[2]);
    let pixels = array.into_raw_vec_and_offset().0;
    let images = pixels.chunks_exact((3 * height * width).max(1));
    Ok(images.filter_map(|part| RgbImage::from_raw(width as u32, height as u32, part.to_vec())).collect())
}

/// Reads one image of colours of any size.
pub fn image(value: &Bound<'_, PyAny>, name: &str, size: [Option<usize>; 2]) -> PyResult<RgbImage> {
    let array = bytes(value, name, &[size[0], size[1], Some(3)])?;
    let (height, width) = (array.shape()[0], array.shape()[1]);
    let image = RgbImage::from_raw(width as u32, height as u32, array.into_raw_vec_and_offset().0);
    Ok(image.ok_or_else(|| Kind::Argument.error(format!("{name}: the image is empty")))?)
}

/// Reads bytes: no other dtype is taken for colours.
pub fn bytes(value: &Bound<'_, PyAny>, name: &str, shape: &[Option<usize>]) -> PyResult<ArrayD<u8>> {
    let (_, _, found) = as_array(value, name)?;
    // Another dtype has no kind that fits.
    read::<u8>(value, name, "uint8", if found == "uint8" { "u" } else { "" }, shape)
}

/// Reads a plane of numbers in 32 bits.
pub fn plane(value: &Bound<'_, PyAny>, name: &str, size: [Option<usize>; 2]) -> PyResult<Array2<f32>> {
    let array = singles(value, name, &size)?;
    Ok(array.into_dimensionality().map_err(|error| Kind::Argument.error(format!("{name}: {error}")))?)
}

/// Reads a rigid motion as a 4 x 4 matrix.
pub fn motion<A: Frame, B: Frame>(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Isometry<A, B>> {
    let array = numbers(value, name, &[Some(4), Some(4)])?;
    let rows: [[f64; 4]; 4] = std::array::from_fn(|i| std::array::from_fn(|j| array[[i, j]]));
    Ok(Isometry::from_matrix(&rows).map_err(|error| Kind::Argument.error(format!("{name} is {error}")))?)
}

/// Returns a rigid motion as an array of shape (4, 4).
pub fn matrix<'py, A: Frame, B: Frame>(py: Python<'py>, motion: Isometry<A, B>) -> Bound<'py, PyArrayDyn<f64>> {
    shaped(py, motion.to_matrix().concat(), &[4, 4])
}

/// Returns numbers as an array of this shape, without a copy.
pub fn shaped<'py, T: Element>(py: Python<'py>, values: Vec<T>, shape: &[usize]) -> Bound<'py, PyArrayDyn<T>> {
    match ndarray::ArrayD::from_shape_vec(shape, values) {
        Ok(array) => array.into_pyarray(py),
        // Every caller passes as many values as the shape has.
        Err(_) => {
            ndarray::ArrayD::from_shape_fn(vec![0; shape.len()], |_| unreachable!("an empty array")).into_pyarray(py)
        }
    }
}

/// Returns the images of all touch sensors as an array of shape (pads, height, width, 3).
pub fn stacked<'py>(py: Python<'py>, images: &[RgbImage]) -> PyResult<Bound<'py, PyArrayDyn<u8>>> {
    let (width, height) = images.first().map_or((0, 0), RgbImage::dimensions);
    same_size(images.iter().map(|image| (image.height() as usize, image.width() as usize)))?;
    let pixels: Vec<&[u8]> = images.iter().map(|image| image.as_raw().as_slice()).collect();
    Ok(shaped(py, pixels.concat(), &[images.len(), height as usize, width as usize, 3]))
}

/// Checks that the touch sensors of a hand have one number of rows and columns, as one array needs, and returns it.
pub fn same_size(mut sizes: impl Iterator<Item = (usize, usize)>) -> PyResult<(usize, usize)> {
    let first = sizes.next().unwrap_or_default();
    match sizes.find(|size| *size != first) {
        None => Ok(first),
        Some(other) => {
            let text = format!(
                "the touch sensors of this hand have images of {first:?} and {other:?} pixels, which no one array holds"
            );
            Err(Kind::General.error(text).into())
        }
    }
}

/// Returns an image as an array of shape (height, width, 3), without a copy.
pub fn pixels(py: Python<'_>, image: RgbImage) -> Bound<'_, PyArrayDyn<u8>> {
    let shape = [image.height() as usize, image.width() as usize, 3];
    shaped(py, image.into_raw(), &shape)
}

/// Returns numbers as a one-dimensional array.
pub fn line<'py, T: Element>(py: Python<'py>, values: Vec<T>) -> Bound<'py, PyArray1<T>> {
    values.into_pyarray(py)
}
