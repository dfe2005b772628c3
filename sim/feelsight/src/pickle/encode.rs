//! Encoder of protocol 4, which every Python since 3.4 reads.

use std::collections::HashMap;

use super::PickleValue;
use crate::array::{Array, Kind};

/// Pickles a value for Python 3 with NumPy 1 or 2.
pub fn to_bytes(value: &PickleValue) -> Vec<u8> {
    let mut encoder = Encoder { out: b"\x80\x04".to_vec(), memo: HashMap::new() };
    encoder.value(value);
    encoder.out.push(b'.');
    encoder.out
}

/// Part that repeats in a pickle and is written once.
#[derive(PartialEq, Eq, Hash)]
enum Shared {
    Reconstruct,
    NdArray,
    Dtype(Kind),
}

struct Encoder {
    out: Vec<u8>,
    memo: HashMap<Shared, u32>,
}

impl Encoder {
    fn value(&mut self, value: &PickleValue) {
        match value {
            PickleValue::None => self.out.push(b'N'),
            PickleValue::Bool(b) => self.out.push(if *b { 0x88 } else { 0x89 }),
            PickleValue::Int(i) => self.int(*i),
            PickleValue::Float(x) => {
                self.out.push(b'G');
                self.out.extend(x.to_be_bytes());
            }
            PickleValue::Str(s) => self.counted(0x8d, s.as_bytes()),
            PickleValue::Bytes(bytes) => self.counted(0x8e, bytes),
            PickleValue::List(items) => {
                self.out.extend(b"](");
                items.iter().for_each(|item| self.value(item));
                self.out.push(b'e');
            }
            PickleValue::Tuple(items) => {
                self.out.push(b'(');
                items.iter().for_each(|item| self.value(item));
                self.out.push(b't');
            }
            PickleValue::Dict(items) => {
                self.out.extend(b"}(");
                for (key, value) in items {
                    self.value(key);
                    self.value(value);
                }
                self.out.push(b'u');
            }
            PickleValue::Array(array) => self.array(array),
        }
    }

    /// Writes BINUNICODE8 or BINBYTES8.
    fn counted(&mut self, opcode: u8, bytes: &[u8]) {
        self.out.push(opcode);
        self.out.extend((bytes.len() as u64).to_le_bytes());
        self.out.extend(bytes);
    }

    fn int(&mut self, i: i64) {
        if let Ok(small) = i32::try_from(i) {
            self.out.push(b'J');
            self.out.extend(small.to_le_bytes());
        } else {
            self.out.extend([0x8a, 8]);
            self.out.extend(i.to_le_bytes());
        }
    }

    /// Writes an array like `ndarray.__reduce__`: `_reconstruct(ndarray, (0,), b"b")`, then the state (1, shape, dtype,
    /// False, data).
    fn array(&mut self, array: &Array) {
        // NumPy 2 keeps this name for the pickles of NumPy 1.
        self.shared(Shared::Reconstruct, |e| e.out.extend(b"cnumpy.core.multiarray\n_reconstruct\n"));
        self.out.push(b'(');
        self.shared(Shared::NdArray, |e| e.out.extend(b"cnumpy\nndarray\n"));
        self.out.extend(b"K\x00\x85C\x01btR(K\x01(");
        array.shape().iter().for_each(|&n| self.int(n as i64));
        self.out.push(b't');
        let kind = array.kind();
        self.shared(Shared::Dtype(kind), |e| {
            e.out.extend(b"cnumpy\ndtype\n(");
            e.value(&kind.code().into());
            let order = if kind.size() == 1 { "|" } else { "<" };
            e.out.extend(b"\x89\x88tR(K\x03");
            e.value(&order.into());
            e.out.extend(b"NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb");
        });
        self.out.push(0x89);
        self.counted(0x8e, array.bytes());
        self.out.extend(b"tb");
    }

    /// Writes a part the first time, and a reference to it later.
    fn shared(&mut self, key: Shared, write: impl FnOnce(&mut Self)) {
        if let Some(index) = self.memo.get(&key) {
            self.out.push(b'j');
            self.out.extend(index.to_le_bytes());
            return;
        }
        write(self);
        self.out.push(0x94);
        self.memo.insert(key, self.memo.len() as u32);
    }
}
