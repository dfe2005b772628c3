//! The wire format of protocol buffers, for messages whose fields are written or read one after the other.

/// Bytes of a message.
#[derive(Debug, Clone, Default)]
pub(crate) struct Message(Vec<u8>);

/// How a value is encoded.
enum Wire {
    Varint = 0,
    Eight = 1,
    Counted = 2,
    Four = 5,
}

impl Message {
    pub fn into_bytes(self) -> Vec<u8> {
        self.0
    }

    fn bare_varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    fn tag(&mut self, field: u32, wire: Wire) {
        self.bare_varint(u64::from(field) << 3 | wire as u64);
    }

    pub fn varint(mut self, field: u32, value: u64) -> Self {
        self.tag(field, Wire::Varint);
        self.bare_varint(value);
        self
    }

    pub fn fixed32(mut self, field: u32, value: u32) -> Self {
        self.tag(field, Wire::Four);
        self.0.extend(value.to_le_bytes());
        self
    }

    pub fn double(mut self, field: u32, value: f64) -> Self {
        self.tag(field, Wire::Eight);
        self.0.extend(value.to_le_bytes());
        self
    }

    pub fn bytes(mut self, field: u32, value: &[u8]) -> Self {
        self.tag(field, Wire::Counted);
        self.bare_varint(value.len() as u64);
        self.0.extend(value);
        self
    }

    pub fn text(self, field: u32, value: &str) -> Self {
        self.bytes(field, value.as_bytes())
    }

    pub fn message(self, field: u32, value: &Self) -> Self {
        self.bytes(field, &value.0)
    }

    /// A repeated number, packed.
    pub fn doubles(self, field: u32, values: &[f64]) -> Self {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.bytes(field, &bytes)
    }
}

/// Value of a field that was read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Value<'a> {
    /// Integer, or a fixed number of four or eight bytes as its bits.
    Number(u64),
    /// Text, bytes, a message, or packed numbers.
    Bytes(&'a [u8]),
}

/// Fields of a message, in their order. It ends at the first defect, which [`Fields::is_whole`] tells from the end.
#[derive(Debug, Clone)]
pub(crate) struct Fields<'a> {
    rest: &'a [u8],
    is_whole: bool,
}

impl<'a> Fields<'a> {
    pub fn of(message: &'a [u8]) -> Self {
        Self { rest: message, is_whole: true }
    }

    /// Returns whether no defect was met.
    pub fn is_whole(&self) -> bool {
        self.is_whole
    }

    fn bare_varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let (&byte, rest) = self.rest.split_first()?;
            self.rest = rest;
            value |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Some(value);
            }
        }
        None
    }

    fn bytes(&mut self, count: u64) -> Option<&'a [u8]> {
        let (bytes, rest) = self.rest.split_at_checked(usize::try_from(count).ok()?)?;
        self.rest = rest;
        Some(bytes)
    }

    fn field(&mut self) -> Option<(u64, Value<'a>)> {
        let tag = self.bare_varint()?;
        let number = |bytes: &[u8]| bytes.iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte));
        let value = match tag & 7 {
            0 => Value::Number(self.bare_varint()?),
            1 => Value::Number(number(self.bytes(8)?)),
            2 => {
                let count = self.bare_varint()?;
                Value::Bytes(self.bytes(count)?)
            }
            5 => Value::Number(number(self.bytes(4)?)),
            _ => return None,
        };
        Some((tag >> 3, value))
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = (u64, Value<'a>);

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        let field = self.field();
        if field.is_none() {
            (self.rest, self.is_whole) = (&[], false);
        }
        field
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_those_of_the_specification() {
        // The examples of the encoding's documentation: 150 in field 1, "testing" in field 2, and the former as a message in field 3.
        assert_eq!(Message::default().varint(1, 150).into_bytes(), [0x08, 0x96, 0x01]);
        let text = Message::default().text(2, "testing").into_bytes();
        assert_eq!(text, [&[0x12, 0x07][..], b"testing"].concat());
        let inner = Message::default().varint(1, 150);
        assert_eq!(Message::default().message(3, &inner).into_bytes(), [0x1a, 0x03, 0x08, 0x96, 0x01]);
        assert_eq!(Message::default().fixed32(2, 1).into_bytes(), [0x15, 1, 0, 0, 0]);
        assert_eq!(Message::default().double(1, 1.0).into_bytes(), [0x09, 0, 0, 0, 0, 0, 0, 0xf0, 0x3f]);
    }

    #[test]
    fn what_is_written_is_read() {
        let message = Message::default().varint(1, u64::MAX).text(20, "names").double(3, -1.5).fixed32(4, 7);
        let bytes = message.into_bytes();
        let mut fields = Fields::of(&bytes);
        let expected = [
            (1, Value::Number(u64::MAX)),
            (20, Value::Bytes(b"names")),
            (3, Value::Number((-1.5_f64).to_bits())),
            (4, Value::Number(7)),
        ];
        assert!(fields.by_ref().eq(expected) && fields.is_whole());
        for cut in [bytes.len() - 1, bytes.len() - 6, 5] {
            let mut fields = Fields::of(&bytes[..cut]);
            fields.by_ref().for_each(drop);
            assert!(!fields.is_whole(), "{cut}");
        }
    }
}
