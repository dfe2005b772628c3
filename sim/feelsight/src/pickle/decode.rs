//! The restricted decoder: a stack machine over an arena of nodes that refer to one another by index.

mod calls;

use std::borrow::Cow;
use std::collections::HashMap;

use super::{PickleError, PickleValue};
use crate::array::{Array, Kind};
use calls::Global;

/// Greatest number of operations, and of values in the result: 40 times those of a log of 30 s, in less than 300 MB of
/// memory.
const MAX_OPERATIONS: usize = 4_000_000;
/// Greatest number of bytes of arrays and strings that are allocated while decoding, and again in the result.
const MAX_BYTES: usize = 256 << 20;
/// Greatest nesting of the result.
const MAX_DEPTH: usize = 64;

/// Decodes a pickle of plain data.
///
/// # Errors
/// [`PickleError`] for everything else; see the [module](super).
pub fn from_bytes(data: &[u8]) -> Result<PickleValue, PickleError> {
    let mut machine = Machine {
        data,
        at: 0,
        nodes: Vec::new(),
        stack: Vec::new(),
        marks: Vec::new(),
        memo: HashMap::new(),
        bytes: 0,
    };
    let root = machine.run().map_err(|error| if was_converted(data) { PickleError::TextMode } else { error })?;
    Budget { nodes: &machine.nodes, values: MAX_OPERATIONS, bytes: MAX_BYTES }.value(root, 0)
}

/// Returns whether the line ends of a pickle were converted: in other files most bytes 10 follow other bytes than 13.
fn was_converted(data: &[u8]) -> bool {
    let ends = |pair: &[u8]| pair[1] == b'\n';
    data.windows(2).any(ends) && data.windows(2).filter(|pair| ends(pair)).all(|pair| pair[0] == b'\r')
}

/// Index of a node.
type Id = u32;

enum Node<'a> {
    None,
    Bool(bool),
    Int(i64),
    Float(f64),
    Str(Cow<'a, str>),
    Bytes(Cow<'a, [u8]>),
    /// A `str` of Python 2: bytes or Latin-1 text, depending on its use.
    Py2Str(Cow<'a, [u8]>),
    List(Vec<Id>),
    Tuple(Vec<Id>),
    Dict(Vec<(Id, Id)>),
    Global(Global),
    Dtype {
        kind: Kind,
        big_endian: bool,
    },
    /// `None` between `_reconstruct` and the state that follows.
    Array(Option<Array>),
}

struct Machine<'a> {
    data: &'a [u8],
    at: usize,
    nodes: Vec<Node<'a>>,
    stack: Vec<Id>,
    /// Heights of the stack at each open MARK.
    marks: Vec<usize>,
    memo: HashMap<u32, Id>,
    /// Bytes that were allocated and not borrowed from the data.
    bytes: usize,
}

impl<'a> Machine<'a> {
    fn run(&mut self) -> Result<Id, PickleError> {
        for _ in 0..MAX_OPERATIONS {
            let at = self.at;
            let opcode = self.take(1)?[0];
            if opcode == b'.' {
                return self.pop();
            }
            if !(self.atom(opcode)? || self.container(opcode)? || self.machinery(opcode)?) {
                return Err(PickleError::Opcode { opcode, at });
            }
        }
        Err(PickleError::TooLarge("more than four million operations"))
    }

    fn malformed(&self, defect: impl Into<String>) -> PickleError {
        PickleError::Malformed { defect: defect.into(), at: self.at }
    }

    fn take(&mut self, n: usize) -> Result<&'a [u8], PickleError> {
        let end = self.at.checked_add(n).filter(|&end| end <= self.data.len());
        let taken = &self.data[self.at..end.ok_or(PickleError::Truncated(self.data.len()))?];
        self.at += n;
        Ok(taken)
    }

    /// Reads an unsigned little-endian number of up to eight bytes.
    fn number(&mut self, size: usize) -> Result<usize, PickleError> {
        let n = self.take(size)?.iter().rev().fold(0u64, |n, &byte| n << 8 | u64::from(byte));
        usize::try_from(n).map_err(|_| PickleError::TooLarge("a length beyond the address space"))
    }

    /// Reads bytes after their number, which takes `size` bytes.
    fn counted(&mut self, size: usize) -> Result<&'a [u8], PickleError> {
        let n = self.number(size)?;
        self.take(n)
    }

    /// Reads text up to a line feed.
    fn line(&mut self) -> Result<&'a str, PickleError> {
        let rest = &self.data[self.at..];
        let length = rest.iter().position(|&b| b == b'\n').ok_or(PickleError::Truncated(self.data.len()))?;
        self.at += length + 1;
        std::str::from_utf8(&rest[..length]).map_err(|_| self.malformed("a line is not text"))
    }

    fn utf8(&self, bytes: &'a [u8]) -> Result<Node<'a>, PickleError> {
        // Lone surrogates, which Python accepts, are refused.
        let text = std::str::from_utf8(bytes).map_err(|_| self.malformed("a string is not UTF-8"))?;
        Ok(Node::Str(text.into()))
    }

    fn add(&mut self, node: Node<'a>) -> Id {
        self.nodes.push(node);
        (self.nodes.len() - 1) as Id
    }

    fn push(&mut self, node: Node<'a>) {
        let id = self.add(node);
        self.stack.push(id);
    }

    fn pop(&mut self) -> Result<Id, PickleError> {
        // A MARK hides the objects below it.
        let floor = self.marks.last().copied().unwrap_or(0);
        if self.stack.len() <= floor {
            return Err(self.malformed("the stack is empty"));
        }
        self.stack.pop().ok_or_else(|| self.malformed("the stack is empty"))
    }

    fn top(&mut self) -> Result<Id, PickleError> {
        let id = self.pop()?;
        self.stack.push(id);
        Ok(id)
    }

    /// Pops the last MARK and everything above it.
    fn pop_mark(&mut self) -> Result<Vec<Id>, PickleError> {
        let height = self.marks.pop().ok_or_else(|| self.malformed("there is no mark"))?;
        Ok(self.stack.split_off(height.min(self.stack.len())))
    }

    fn node(&self, id: Id) -> &Node<'a> {
        // Ids come from `add` alone, and nodes are never removed.
        &self.nodes[id as usize]
    }

    /// Runs opcodes of numbers, strings and constants. Returns whether the opcode is one of them.
    fn atom(&mut self, opcode: u8) -> Result<bool, PickleError> {
        let node = match opcode {
            b'N' => Node::None,
            0x88 => Node::Bool(true),
            0x89 => Node::Bool(false),
            b'J' => Node::Int(i64::from(self.number(4)? as u32 as i32)),
            b'K' => Node::Int(self.number(1)? as i64),
            b'M' => Node::Int(self.number(2)? as i64),
            b'I' => match self.line()? {
                "00" => Node::Bool(false),
                "01" => Node::Bool(true),
                digits => self.decimal(digits)?,
            },
            b'L' => {
                let digits = self.line()?;
                self.decimal(digits.strip_suffix('L').unwrap_or(digits))?
            }
            0x8a => {
                let bytes = self.counted(1)?;
                self.long(bytes)?
            }
            0x8b => {
                let bytes = self.counted(4)?;
                self.long(bytes)?
            }
            b'F' => {
                let text = self.line()?.trim();
                Node::Float(text.parse().map_err(|_| self.malformed(format!("{text:?} is not a number")))?)
            }
            b'G' => {
                let bits = self.take(8)?.iter().fold(0u64, |n, &byte| n << 8 | u64::from(byte));
                Node::Float(f64::from_bits(bits))
            }
            b'X' => {
                let bytes = self.counted(4)?;
                self.utf8(bytes)?
            }
            0x8c => {
                let bytes = self.counted(1)?;
                self.utf8(bytes)?
            }
            0x8d => {
                let bytes = self.counted(8)?;
                self.utf8(bytes)?
            }
            b'V' => {
                let text = self.raw_unicode_escape()?;
                Node::Str(text.into())
            }
            b'T' => Node::Py2Str(self.counted(4)?.into()),
            b'U' => Node::Py2Str(self.counted(1)?.into()),
            b'S' => {
                let text = self.quoted()?;
                Node::Py2Str(text.into())
            }
            b'B' => Node::Bytes(self.counted(4)?.into()),
            b'C' => Node::Bytes(self.counted(1)?.into()),
            0x8e | 0x96 => Node::Bytes(self.counted(8)?.into()),
            _ => return Ok(false),
        };
        self.push(node);
        Ok(true)
    }

    fn decimal(&self, digits: &str) -> Result<Node<'a>, PickleError> {
        digits.trim().parse().map(Node::Int).map_err(|_| self.malformed(format!("{digits:?} is not a 64-bit integer")))
    }

    /// Decodes two's complement of any length, which must fit 64 bits.
    fn long(&self, bytes: &[u8]) -> Result<Node<'a>, PickleError> {
        let negative = bytes.last().is_some_and(|b| b & 0x80 != 0);
        let fill = if negative { 0xff } else { 0 };
        let mut raw = [fill; 8];
        for (i, &byte) in bytes.iter().enumerate() {
            match raw.get_mut(i) {
                Some(to) => *to = byte,
                None if byte == fill => {}
                None => return Err(self.malformed("an integer needs more than 64 bits")),
            }
        }
        let value = i64::from_le_bytes(raw);
        if (value < 0) != negative {
            return Err(self.malformed("an integer needs more than 64 bits"));
        }
        Ok(Node::Int(value))
    }

    /// Reads a line of Python's raw-unicode-escape: Latin-1 with `\uXXXX` and `\UXXXXXXXX`.
    fn raw_unicode_escape(&mut self) -> Result<String, PickleError> {
        let rest = &self.data[self.at..];
        let length = rest.iter().position(|&b| b == b'\n').ok_or(PickleError::Truncated(self.data.len()))?;
        self.at += length + 1;
        let mut text = String::with_capacity(length);
        let mut line = &rest[..length];
        while let Some((&byte, after)) = line.split_first() {
            let digits = match (byte, after.first()) {
                (b'\\', Some(b'u')) => 4,
                (b'\\', Some(b'U')) => 8,
                _ => {
                    text.push(char::from(byte));
                    line = after;
                    continue;
                }
            };
            let code = after.get(1..=digits).and_then(|hex| std::str::from_utf8(hex).ok());
            let code = code.and_then(|hex| u32::from_str_radix(hex, 16).ok()).and_then(char::from_u32);
            text.push(code.ok_or_else(|| self.malformed("a bad \\u escape"))?);
            line = &after[1 + digits..];
        }
        self.charge(text.len())?;
        Ok(text)
    }

    /// Reads a line with the `repr` of a Python 2 string.
    fn quoted(&mut self) -> Result<Vec<u8>, PickleError> {
        let line = self.line()?.as_bytes();
        let inner = match line {
            [b'\'', inner @ .., b'\''] | [b'"', inner @ .., b'"'] => inner,
            _ => return Err(self.malformed("a string without quotes")),
        };
        let mut text = Vec::with_capacity(inner.len());
        let mut bytes = inner.iter().copied();
        while let Some(byte) = bytes.next() {
            if byte != b'\\' {
                text.push(byte);
                continue;
            }
            let bad = || self.malformed("a bad escape");
            text.push(match bytes.next().ok_or_else(bad)? {
                b'n' => b'\n',
                b't' => b'\t',
                b'r' => b'\r',
                b'x' => {
                    let mut digit = || bytes.next().and_then(|b| char::from(b).to_digit(16));
                    let (high, low) = (digit().ok_or_else(bad)?, digit().ok_or_else(bad)?);
                    (high << 4 | low) as u8
                }
                plain @ (b'\\' | b'\'' | b'"') => plain,
                _ => return Err(bad()),
            });
        }
        self.charge(text.len())?;
        Ok(text)
    }

    /// Runs opcodes of lists, tuples and dictionaries. Returns whether the opcode is one of them.
    fn container(&mut self, opcode: u8) -> Result<bool, PickleError> {
        match opcode {
            b']' => self.push(Node::List(Vec::new())),
            b'l' => {
                let items = self.pop_mark()?;
                self.push(Node::List(items));
            }
            b'a' => {
                let item = self.pop()?;
                self.extend_list(&[item])?;
            }
            b'e' => {
                let items = self.pop_mark()?;
                self.extend_list(&items)?;
            }
            b')' => self.push(Node::Tuple(Vec::new())),
            b't' => {
                let items = self.pop_mark()?;
                self.push(Node::Tuple(items));
            }
            0x85..=0x87 => {
                let mut items = Vec::new();
                for _ in 0x84..opcode {
                    items.push(self.pop()?);
                }
                items.reverse();
                self.push(Node::Tuple(items));
            }
            b'}' => self.push(Node::Dict(Vec::new())),
            b'd' => {
                let items = self.pop_mark()?;
                let items = self.pairs(&items)?;
                self.push(Node::Dict(items));
            }
            b's' => {
                let value = self.pop()?;
                let key = self.pop()?;
                self.extend_dict(&[key, value])?;
            }
            b'u' => {
                let items = self.pop_mark()?;
                self.extend_dict(&items)?;
            }
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn extend_list(&mut self, items: &[Id]) -> Result<(), PickleError> {
        let list = self.top()?;
        if let Node::List(list) = &mut self.nodes[list as usize] {
            list.extend(items);
            return Ok(());
        }
        Err(self.malformed("items for a value that is not a list"))
    }

    fn pairs(&self, items: &[Id]) -> Result<Vec<(Id, Id)>, PickleError> {
        let (pairs, rest) = items.as_chunks::<2>();
        if !rest.is_empty() {
            return Err(self.malformed("a key without a value"));
        }
        Ok(pairs.iter().map(|&[key, value]| (key, value)).collect())
    }

    fn extend_dict(&mut self, items: &[Id]) -> Result<(), PickleError> {
        let pairs = self.pairs(items)?;
        let dict = self.top()?;
        if let Node::Dict(dict) = &mut self.nodes[dict as usize] {
            dict.extend(pairs);
            return Ok(());
        }
        Err(self.malformed("items for a value that is not a dictionary"))
    }

    /// Runs opcodes of the stack, the memo, globals and calls. Returns whether the opcode is one of them.
    fn machinery(&mut self, opcode: u8) -> Result<bool, PickleError> {
        match opcode {
            0x80 => {
                let protocol = self.number(1)?;
                if protocol > 5 {
                    return Err(self.malformed(format!("protocol {protocol} is unknown")));
                }
            }
            // FRAME and READONLY_BUFFER do not change the data.
            0x95 => {
                self.take(8)?;
            }
            0x98 => {}
            b'(' => self.marks.push(self.stack.len()),
            b'0' => {
                self.pop()?;
            }
            b'1' => {
                self.pop_mark()?;
            }
            b'2' => {
                let id = self.top()?;
                self.stack.push(id);
            }
            b'p' | b'q' | b'r' | 0x94 => {
                let index = match opcode {
                    b'p' => self.line_index()?,
                    b'q' => self.number(1)? as u32,
                    b'r' => self.number(4)? as u32,
                    _ => self.memo.len() as u32,
                };
                let id = self.top()?;
                self.memo.insert(index, id);
            }
            b'g' | b'h' | b'j' => {
                let index = match opcode {
                    b'g' => self.line_index()?,
                    b'h' => self.number(1)? as u32,
                    _ => self.number(4)? as u32,
                };
                let id = self.memo.get(&index).copied();
                self.stack.push(id.ok_or_else(|| self.malformed("a reference to an unknown value"))?);
            }
            b'c' => {
                let (module, name) = (self.line()?, self.line()?);
                self.global(module, name)?;
            }
            0x93 => {
                let (name, module) = (self.pop()?, self.pop()?);
                match (self.node(module), self.node(name)) {
                    (Node::Str(module), Node::Str(name)) => {
                        let (module, name) = (module.to_string(), name.to_string());
                        self.global(&module, &name)?;
                    }
                    _ => return Err(self.malformed("the name of a global is not a string")),
                }
            }
            b'R' => {
                let (arguments, callable) = (self.pop()?, self.pop()?);
                let node = self.call(callable, arguments)?;
                self.push(node);
            }
            b'b' => {
                let state = self.pop()?;
                self.build(state)?;
            }
            b'i' => {
                let (module, name) = (self.line()?, self.line()?);
                return Err(PickleError::Refused(format!("{module}.{name}")));
            }
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn line_index(&mut self) -> Result<u32, PickleError> {
        self.line()?.parse().map_err(|_| self.malformed("a bad memo index"))
    }
}

fn latin1(bytes: &[u8]) -> String {
    bytes.iter().copied().map(char::from).collect()
}

/// Copies nodes to values. A node may be referred to often, so its values and bytes are counted again.
struct Budget<'a> {
    nodes: &'a [Node<'a>],
    values: usize,
    bytes: usize,
}

impl Budget<'_> {
    fn value(&mut self, id: Id, depth: usize) -> Result<PickleValue, PickleError> {
        self.values = self.values.checked_sub(1).ok_or(PickleError::TooLarge("more than four million values"))?;
        // This also ends a list that contains itself.
        if depth > MAX_DEPTH {
            return Err(PickleError::TooLarge("more than 64 levels of nesting"));
        }
        let mut charge = |bytes: usize| {
            self.bytes = self.bytes.checked_sub(bytes).ok_or(PickleError::TooLarge("more than 256 MiB of data"))?;
            Ok(())
        };
        Ok(match &self.nodes[id as usize] {
            Node::None => PickleValue::None,
            Node::Bool(b) => PickleValue::Bool(*b),
            Node::Int(i) => PickleValue::Int(*i),
            Node::Float(x) => PickleValue::Float(*x),
            Node::Str(text) => {
                charge(text.len())?;
                PickleValue::Str(text.to_string())
            }
            Node::Py2Str(bytes) => {
                charge(2 * bytes.len())?;
                PickleValue::Str(latin1(bytes))
            }
            Node::Bytes(bytes) => {
                charge(bytes.len())?;
                PickleValue::Bytes(bytes.to_vec())
            }
            Node::Array(Some(array)) => {
                charge(array.bytes().len())?;
                PickleValue::Array(array.clone())
            }
            Node::List(items) => {
                PickleValue::List(items.iter().map(|&item| self.value(item, depth + 1)).collect::<Result<_, _>>()?)
            }
            Node::Tuple(items) => {
                PickleValue::Tuple(items.iter().map(|&item| self.value(item, depth + 1)).collect::<Result<_, _>>()?)
            }
            Node::Dict(items) => {
                let mut pair =
                    |&(key, value): &(Id, Id)| Ok((self.value(key, depth + 1)?, self.value(value, depth + 1)?));
                PickleValue::Dict(items.iter().map(&mut pair).collect::<Result<_, PickleError>>()?)
            }
            Node::Global(_) | Node::Dtype { .. } | Node::Array(None) => {
                return Err(PickleError::Refused("a function or type as a value".into()));
            }
        })
    }
}
