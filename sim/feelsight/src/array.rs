//! Numeric arrays of pickles, npz files and npy files.

use half::f16;

/// Type of an array's elements.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[allow(missing_docs)]
pub enum Kind {
    Bool,
    I8,
    I16,
    I32,
    I64,
    U8,
    U16,
    U32,
    U64,
    F16,
    F32,
    F64,
}

const KINDS: [(Kind, &str); 12] = [
    (Kind::Bool, "b1"),
    (Kind::I8, "i1"),
    (Kind::I16, "i2"),
    (Kind::I32, "i4"),
    (Kind::I64, "i8"),
    (Kind::U8, "u1"),
    (Kind::U16, "u2"),
    (Kind::U32, "u4"),
    (Kind::U64, "u8"),
    (Kind::F16, "f2"),
    (Kind::F32, "f4"),
    (Kind::F64, "f8"),
];

impl Kind {
    /// Returns the type for NumPy's code without byte order, such as "f4"; `None` for strings, objects, records,
    /// complex numbers, dates.
    pub fn from_code(code: &str) -> Option<Self> {
        KINDS.iter().find(|(_, c)| *c == code).map(|(kind, _)| *kind)
    }

    /// Returns NumPy's code without byte order.
    pub fn code(self) -> &'static str {
        KINDS[self as usize].1
    }

    /// Returns the bytes per element.
    pub fn size(self) -> usize {
        match self {
            Kind::Bool | Kind::I8 | Kind::U8 => 1,
            Kind::I16 | Kind::U16 | Kind::F16 => 2,
            Kind::I32 | Kind::U32 | Kind::F32 => 4,
            Kind::I64 | Kind::U64 | Kind::F64 => 8,
        }
    }

    /// Decodes one little-endian element, rounded to `f64`. `bytes` must hold [`Kind::size`] bytes; missing ones count
    /// as zero.
    pub fn decode(self, bytes: &[u8]) -> f64 {
        let mut raw = [0; 8];
        for (to, from) in raw.iter_mut().zip(&bytes[..bytes.len().min(self.size())]) {
            *to = *from;
        }
        let [a, b, c, d, ..] = raw;
        match self {
            Kind::Bool => f64::from(u8::from(a != 0)),
            Kind::I8 => f64::from(i8::from_le_bytes([a])),
            Kind::I16 => f64::from(i16::from_le_bytes([a, b])),
            Kind::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Kind::I64 => i64::from_le_bytes(raw) as f64,
            Kind::U8 => f64::from(a),
            Kind::U16 => f64::from(u16::from_le_bytes([a, b])),
            Kind::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Kind::U64 => u64::from_le_bytes(raw) as f64,
            Kind::F16 => f64::from(f16::from_le_bytes([a, b])),
            Kind::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Kind::F64 => f64::from_le_bytes(raw),
        }
    }
}

/// Array in C order with little-endian elements.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Array {
    kind: Kind,
    shape: Vec<usize>,
    data: Vec<u8>,
}

impl Array {
    /// Creates an array from elements in either byte order and in C or Fortran order.
    ///
    /// # Errors
    /// A sentence if `data` does not hold exactly the elements of `shape`, or there are more than 32 axes.
    pub fn from_raw(
        kind: Kind,
        big_endian: bool,
        fortran_order: bool,
        shape: Vec<usize>,
        data: &[u8],
    ) -> Result<Self, String> {
        let size = kind.size();
        let bytes = shape.iter().try_fold(size, |product, &n| product.checked_mul(n));
        if shape.len() > 32 || bytes != Some(data.len()) {
            return Err(format!("an array of shape {shape:?} and type {} holds {} bytes", kind.code(), data.len()));
        }
        let mut data = data.to_vec();
        if big_endian {
            data.chunks_exact_mut(size).for_each(<[u8]>::reverse);
        }
        if fortran_order && shape.len() > 1 {
            data = to_c_order(&data, size, &shape);
        }
        Ok(Self { kind, shape, data })
    }

    /// Creates an array of `f64`. The shape's product must be the number of values.
    pub fn from_f64(shape: Vec<usize>, values: impl IntoIterator<Item = f64>) -> Self {
        let data: Vec<u8> = values.into_iter().flat_map(f64::to_le_bytes).collect();
        debug_assert_eq!(data.len(), 8 * shape.iter().product::<usize>());
        Self { kind: Kind::F64, shape, data }
    }

    /// Creates an array of `f32`. The shape's product must be the number of values.
    pub fn from_f32(shape: Vec<usize>, values: impl IntoIterator<Item = f32>) -> Self {
        let data: Vec<u8> = values.into_iter().flat_map(f32::to_le_bytes).collect();
        debug_assert_eq!(data.len(), 4 * shape.iter().product::<usize>());
        Self { kind: Kind::F32, shape, data }
    }

    /// Creates an array of bytes. The shape's product must be their number.
    pub fn from_u8(shape: Vec<usize>, data: Vec<u8>) -> Self {
        debug_assert_eq!(data.len(), shape.iter().product::<usize>());
        Self { kind: Kind::U8, shape, data }
    }

    /// Returns the type of the elements.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// Returns the length of each axis; empty for a scalar.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Returns the elements in C order, little-endian.
    pub fn bytes(&self) -> &[u8] {
        &self.data
    }

    /// Iterates over the elements in C order, rounded to `f64`.
    pub fn to_f64(&self) -> impl Iterator<Item = f64> {
        self.data.chunks_exact(self.kind.size()).map(|bytes| self.kind.decode(bytes))
    }
}

/// Reorders elements from Fortran order (first axis fastest) to C order (last axis fastest).
fn to_c_order(data: &[u8], size: usize, shape: &[usize]) -> Vec<u8> {
    let strides: Vec<usize> = shape
        .iter()
        .scan(size, |stride, &n| {
            let this = *stride;
            *stride *= n;
            Some(this)
        })
        .collect();
    let mut out = Vec::with_capacity(data.len());
    let mut index = vec![0; shape.len()];
    let mut from = 0;
    for _ in 0..data.len() / size {
        out.extend_from_slice(&data[from..from + size]);
        for axis in (0..shape.len()).rev() {
            index[axis] += 1;
            from += strides[axis];
            if index[axis] < shape[axis] {
                break;
            }
            from -= strides[axis] * shape[axis];
            index[axis] = 0;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fortran_order_and_big_endian_are_undone() {
        // np.asfortranarray([[1, 2, 3], [4, 5, 6]]) as '>i2': columns first.
        let raw: Vec<u8> = [1i16, 4, 2, 5, 3, 6].into_iter().flat_map(i16::to_be_bytes).collect();
        let array = Array::from_raw(Kind::I16, true, true, vec![2, 3], &raw).unwrap();
        assert_eq!(array.to_f64().collect::<Vec<_>>(), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    }

    #[test]
    fn wrong_sizes_are_refused() {
        assert!(Array::from_raw(Kind::F64, false, false, vec![2], &[0; 8]).is_err());
        assert!(Array::from_raw(Kind::F64, false, false, vec![usize::MAX, 2], &[]).is_err());
        assert!(Array::from_raw(Kind::F64, false, false, vec![0, usize::MAX], &[]).is_ok(), "empty");
    }
}
