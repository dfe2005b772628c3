//! The globals that a pickle may name, and the results of their calls.

use std::borrow::Cow;

use super::{Id, MAX_BYTES, Machine, Node, latin1};
use crate::array::{Array, Kind};
use crate::pickle::PickleError;

/// Global that plain data and NumPy arrays need.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Global {
    NdArray,
    Dtype,
    Reconstruct,
    FromBuffer,
    Scalar,
    Encode,
    OrderedDict,
    Bytes,
}

impl Global {
    fn from_name(module: &str, name: &str) -> Option<Self> {
        Some(match (module, name) {
            ("numpy", "ndarray") => Self::NdArray,
            ("numpy", "dtype") => Self::Dtype,
            ("numpy.core.multiarray" | "numpy._core.multiarray", "_reconstruct") => Self::Reconstruct,
            ("numpy.core.multiarray" | "numpy._core.multiarray", "scalar") => Self::Scalar,
            ("numpy.core.numeric" | "numpy._core.numeric", "_frombuffer") => Self::FromBuffer,
            ("_codecs", "encode") => Self::Encode,
            ("collections", "OrderedDict") => Self::OrderedDict,
            ("builtins" | "__builtin__", "bytes" | "bytearray") => Self::Bytes,
            _ => return None,
        })
    }
}

impl<'a> Machine<'a> {
    pub(super) fn global(&mut self, module: &str, name: &str) -> Result<(), PickleError> {
        let printable = |s: &str| s.chars().take(80).collect::<String>().escape_debug().to_string();
        let global = Global::from_name(module, name)
            .ok_or_else(|| PickleError::Refused(format!("{}.{}", printable(module), printable(name))))?;
        self.push(Node::Global(global));
        Ok(())
    }

    /// Counts bytes that are allocated and not borrowed.
    pub(super) fn charge(&mut self, bytes: usize) -> Result<(), PickleError> {
        self.bytes = self.bytes.saturating_add(bytes);
        if self.bytes > MAX_BYTES { Err(PickleError::TooLarge("more than 256 MiB of data")) } else { Ok(()) }
    }

    fn tuple(&self, id: Id) -> Result<&[Id], PickleError> {
        if let Node::Tuple(items) = self.node(id) { Ok(items) } else { Err(self.malformed("a tuple is missing")) }
    }

    fn text(&self, id: Id) -> Option<Cow<'a, str>> {
        match self.node(id) {
            Node::Str(text) => Some(text.clone()),
            Node::Py2Str(bytes) => Some(latin1(bytes).into()),
            _ => None,
        }
    }

    fn shape(&self, id: Id) -> Result<Vec<usize>, PickleError> {
        self.tuple(id)?
            .iter()
            .map(|&n| match self.node(n) {
                Node::Int(n) => usize::try_from(*n).ok(),
                _ => None,
            })
            .collect::<Option<_>>()
            .ok_or_else(|| self.malformed("a shape holds something other than lengths"))
    }

    fn array(
        &mut self,
        kind: Kind,
        big_endian: bool,
        fortran: bool,
        shape: Vec<usize>,
        data: Id,
    ) -> Result<Array, PickleError> {
        let length = match self.node(data) {
            Node::Bytes(bytes) | Node::Py2Str(bytes) => bytes.len(),
            _ => return Err(self.malformed("the data of an array are not bytes")),
        };
        self.charge(length)?;
        let (Node::Bytes(bytes) | Node::Py2Str(bytes)) = self.node(data) else {
            return Err(self.malformed("the data of an array are not bytes"));
        };
        Array::from_raw(kind, big_endian, fortran, shape, bytes).map_err(|defect| self.malformed(defect))
    }

    pub(super) fn call(&mut self, callable: Id, arguments: Id) -> Result<Node<'a>, PickleError> {
        let Node::Global(callable) = *self.node(callable) else {
            return Err(self.malformed("a call of a value that is not a function"));
        };
        let arguments = self.tuple(arguments)?.to_vec();
        match (callable, arguments.as_slice()) {
            (Global::Reconstruct, &[class, ..]) if matches!(self.node(class), Node::Global(Global::NdArray)) => {
                Ok(Node::Array(None))
            }
            (Global::Dtype, &[code, ..]) => {
                let code = self.text(code).ok_or_else(|| self.malformed("a data type without its code"))?;
                let (big_endian, plain) = match code.as_bytes().first() {
                    Some(b'>') => (true, &code[1..]),
                    Some(b'<' | b'|' | b'=') => (false, &code[1..]),
                    _ => (false, &*code),
                };
                let kind = Kind::from_code(plain)
                    .ok_or_else(|| PickleError::Refused(format!("an array of type {}", code.escape_debug())))?;
                Ok(Node::Dtype { kind, big_endian })
            }
            (Global::Scalar, &[dtype, data]) => {
                let Node::Dtype { kind, big_endian } = *self.node(dtype) else {
                    return Err(self.malformed("a scalar without its type"));
                };
                let array = self.array(kind, big_endian, false, vec![], data)?;
                Ok(match kind {
                    Kind::Bool => Node::Bool(kind.decode(array.bytes()) != 0.0),
                    Kind::F16 | Kind::F32 | Kind::F64 => Node::Float(kind.decode(array.bytes())),
                    Kind::I64 | Kind::U64 => self.long(array.bytes())?,
                    _ => Node::Int(kind.decode(array.bytes()) as i64),
                })
            }
            (Global::FromBuffer, &[data, dtype, shape, order]) => {
                let Node::Dtype { kind, big_endian } = *self.node(dtype) else {
                    return Err(self.malformed("a buffer without its type"));
                };
                let fortran = self.text(order).is_some_and(|order| order == "F");
                let shape = self.shape(shape)?;
                Ok(Node::Array(Some(self.array(kind, big_endian, fortran, shape, data)?)))
            }
            (Global::Encode | Global::Bytes, &[text, ..]) => {
                // Python writes bytes as Latin-1 text in protocols 0 to 2.
                let bytes = match self.node(text) {
                    Node::Str(text) => text.chars().map(|c| u8::try_from(u32::from(c)).ok()).collect::<Option<_>>(),
                    Node::Bytes(bytes) if callable == Global::Bytes => Some(bytes.to_vec()),
                    _ => None,
                };
                let bytes: Vec<u8> =
                    bytes.ok_or_else(|| self.malformed("bytes from a value that is not Latin-1 text"))?;
                self.charge(bytes.len())?;
                Ok(Node::Bytes(bytes.into()))
            }
            (Global::Bytes, []) => Ok(Node::Bytes(Vec::new().into())),
            (Global::OrderedDict, []) => Ok(Node::Dict(Vec::new())),
            (Global::OrderedDict, &[items]) => {
                let Node::List(items) = self.node(items) else {
                    return Err(self.malformed("an OrderedDict without its items"));
                };
                let pair = |&item: &Id| match self.node(item) {
                    Node::List(pair) | Node::Tuple(pair) => {
                        <[Id; 2]>::try_from(pair.as_slice()).ok().map(|[key, value]| (key, value))
                    }
                    _ => None,
                };
                let pairs = items.iter().map(pair).collect::<Option<_>>();
                Ok(Node::Dict(pairs.ok_or_else(|| self.malformed("an OrderedDict without its items"))?))
            }
            _ => Err(self.malformed("a call with unexpected arguments")),
        }
    }

    /// Sets the state of the object on top of the stack.
    pub(super) fn build(&mut self, state: Id) -> Result<(), PickleError> {
        let object = self.top()?;
        let state = self.tuple(state)?.to_vec();
        match (self.node(object), state.as_slice()) {
            // (version, byte order, subtype, names, fields, size, alignment, flags)
            (&Node::Dtype { kind, .. }, &[_, order, subtype, names, fields, ..]) => {
                if [subtype, names, fields].iter().any(|&id| !matches!(self.node(id), Node::None)) {
                    return Err(PickleError::Refused("an array of records".into()));
                }
                let big_endian = self.text(order).is_some_and(|order| order == ">");
                self.nodes[object as usize] = Node::Dtype { kind, big_endian };
            }
            // (version, shape, data type, Fortran order, data); the oldest pickles have no version.
            (Node::Array(_), &[_, shape, dtype, fortran, data] | &[shape, dtype, fortran, data]) => {
                let Node::Dtype { kind, big_endian } = *self.node(dtype) else {
                    return Err(self.malformed("an array without its type"));
                };
                let fortran = matches!(self.node(fortran), Node::Bool(true) | Node::Int(1));
                let shape = self.shape(shape)?;
                let array = self.array(kind, big_endian, fortran, shape, data)?;
                self.nodes[object as usize] = Node::Array(Some(array));
            }
            _ => return Err(self.malformed("a state for a value without state")),
        }
        Ok(())
    }
}
