//! Files of NumPy (format 1.0), read and written as its specification says: the program's own reader and writer are tested against it.

use std::fs;
use std::path::Path;

use ndarray::{Array, Array2, Dimension, IntoDimension as _, Ix2, Ix3};

/// Returns the array of 32-bit floats in a file.
pub fn read_f32(path: &Path) -> Array2<f32> {
    let (shape, data) = read::<Ix2>(path, "<f4");
    let values = data.chunks_exact(4).map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap())).collect();
    Array::from_shape_vec(shape, values).unwrap()
}

/// Returns the array of bytes in a file.
pub fn read_u8(path: &Path) -> Array<u8, Ix3> {
    let (shape, data) = read::<Ix3>(path, "|u1");
    Array::from_shape_vec(shape, data).unwrap()
}

/// Writes an array of 32-bit floats.
pub fn write_f32(path: &Path, array: &Array2<f32>) {
    let (rows, columns) = array.dim();
    let mut header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({rows}, {columns}), }}");
    // The data begins at a multiple of 64 bytes.
    let end = (10 + header.len() + 1).next_multiple_of(64);
    header.extend(std::iter::repeat_n(' ', end - 11 - header.len()));
    header.push('\n');
    let length = u16::try_from(header.len()).unwrap().to_le_bytes();
    let data: Vec<u8> = array.iter().flat_map(|value| value.to_le_bytes()).collect();
    fs::write(path, [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes(), &data].concat()).unwrap();
}

/// Returns the shape and the bytes of an array in C order of this type.
fn read<D: Dimension<Pattern: Sized>>(path: &Path, descr: &str) -> (D, Vec<u8>) {
    let bytes = fs::read(path).unwrap();
    assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00", "{}", path.display());
    let data = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    assert_eq!(data % 64, 0);
    let header = std::str::from_utf8(&bytes[10..data]).unwrap();
    assert!(header.contains(&format!("'descr': '{descr}'")) && header.contains("'fortran_order': False"), "{header}");
    let (_, shape) = header.split_once("'shape': (").unwrap();
    let (shape, _) = shape.split_once(')').unwrap();
    let sides: Vec<usize> = shape.split(',').filter_map(|side| side.trim().parse().ok()).collect();
    let mut dimension = D::zeros(sides.len());
    dimension.slice_mut().copy_from_slice(&sides);
    (dimension.into_dimension(), bytes[data..].to_vec())
}
