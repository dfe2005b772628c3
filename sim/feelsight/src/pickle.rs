//! Python pickles of plain data, read and written without Python.
//!
//! [`from_bytes`] is a restricted decoder: it knows numbers, strings, lists, tuples, dictionaries and NumPy arrays in
//! every protocol from 0 to 5, and refuses every other global by name. A pickle is a program, but this decoder never
//! calls a function that it names. It also limits operations, depth and memory, so a hostile file does no harm.

mod decode;
mod encode;

pub use decode::from_bytes;
pub use encode::to_bytes;

use super::array::Array;

/// Python value.
#[derive(Debug, Clone, PartialEq)]
pub enum PickleValue {
    /// `None`
    None,
    /// `bool`
    Bool(bool),
    /// `int`, at most 64 bits.
    Int(i64),
    /// `float`
    Float(f64),
    /// `str`
    Str(String),
    /// `bytes` or `bytearray`
    Bytes(Vec<u8>),
    /// `list`
    List(Vec<PickleValue>),
    /// `tuple`
    Tuple(Vec<PickleValue>),
    /// `dict`, in order. A key that is set twice occurs twice; the last one counts.
    Dict(Vec<(PickleValue, PickleValue)>),
    /// `numpy.ndarray` of numbers
    Array(Array),
}

impl PickleValue {
    /// Creates a dictionary with string keys.
    pub fn dict<const N: usize>(items: [(&str, PickleValue); N]) -> Self {
        Self::Dict(items.into_iter().map(|(key, value)| (key.into(), value)).collect())
    }

    /// Returns the value of a string key of a dictionary.
    pub fn get(&self, key: &str) -> Option<&PickleValue> {
        let PickleValue::Dict(items) = self else { return None };
        items.iter().rev().find(|(k, _)| matches!(k, PickleValue::Str(s) if s == key)).map(|(_, value)| value)
    }

    /// Returns the text of a `str`.
    pub fn as_str(&self) -> Option<&str> {
        if let PickleValue::Str(s) = self { Some(s) } else { None }
    }

    /// Returns the shape and the elements, in C order, of a number, an array, or nested lists and tuples of equal
    /// shapes.
    pub fn to_tensor(&self) -> Option<(Vec<usize>, Vec<f64>)> {
        match self {
            PickleValue::Bool(b) => Some((vec![], vec![f64::from(u8::from(*b))])),
            PickleValue::Int(i) => Some((vec![], vec![*i as f64])),
            PickleValue::Float(x) => Some((vec![], vec![*x])),
            PickleValue::Array(array) => Some((array.shape().to_vec(), array.to_f64().collect())),
            PickleValue::List(items) | PickleValue::Tuple(items) => {
                let mut inner: Option<Vec<usize>> = None;
                let mut elements = Vec::new();
                for item in items {
                    let (shape, values) = item.to_tensor()?;
                    if inner.get_or_insert_with(|| shape.clone()) != &shape {
                        return None;
                    }
                    elements.extend(values);
                }
                let mut shape = inner.unwrap_or_default();
                shape.insert(0, items.len());
                Some((shape, elements))
            }
            _ => None,
        }
    }

    /// Returns a single number, also from an array of one element.
    pub fn to_number(&self) -> Option<f64> {
        let (_, elements) = self.to_tensor()?;
        if let [number] = elements[..] { Some(number) } else { None }
    }
}

impl From<&str> for PickleValue {
    fn from(s: &str) -> Self {
        Self::Str(s.to_owned())
    }
}

impl From<f64> for PickleValue {
    fn from(x: f64) -> Self {
        Self::Float(x)
    }
}

impl From<Array> for PickleValue {
    fn from(array: Array) -> Self {
        Self::Array(array)
    }
}

/// Reason why a pickle is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PickleError {
    /// The data end before the pickle ends.
    #[error("the pickle is cut off at byte {0}")]
    Truncated(usize),
    /// The pickle refers to a global that is neither plain data nor a NumPy array.
    #[error(
        "it refers to {0}, which is neither plain data nor a NumPy array; nothing was executed; save it without such values"
    )]
    Refused(String),
    /// An opcode is unknown or not needed for plain data.
    #[error("opcode 0x{opcode:02x} at byte {at} does not belong to plain data")]
    Opcode {
        /// The opcode.
        opcode: u8,
        /// Offset of the opcode, bytes.
        at: usize,
    },
    /// Line ends were converted.
    #[error(
        "it was converted to text with line ends of Windows (CRLF), which damages a pickle; copy it again as a binary file"
    )]
    TextMode,
    /// A part of the pickle is malformed.
    #[error("{defect} (at byte {at})")]
    Malformed {
        /// The defect.
        defect: String,
        /// Offset, bytes.
        at: usize,
    },
    /// The pickle is larger than that of any log.
    #[error("{0}: no log needs as much")]
    TooLarge(&'static str),
}
