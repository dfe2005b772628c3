//! The wire format of protocol buffers, as far as ONNX files need it.

/// Value of a field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum WireValue<'a> {
    Number(u64),
    Fixed32([u8; 4]),
    Bytes(&'a [u8]),
}

/// Fields of a message, in order.
pub(crate) struct WireFields<'a>(&'a [u8]);

impl<'a> WireFields<'a> {
    pub(crate) fn new(message: &'a [u8]) -> Self {
        Self(message)
    }

    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let &[byte] = self.take(1)? else { return None };
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }

    fn field(&mut self) -> Option<(u64, WireValue<'a>)> {
        let key = self.varint()?;
        let value = match key & 7 {
            0 => WireValue::Number(self.varint()?),
            1 => WireValue::Bytes(self.take(8)?),
            2 => {
                let length = usize::try_from(self.varint()?).ok()?;
                WireValue::Bytes(self.take(length)?)
            }
            5 => WireValue::Fixed32(self.take(4)?.try_into().ok()?),
            _ => return None,
        };
        Some((key >> 3, value))
    }
}

/// Returns a packed list of whole numbers.
pub(crate) fn packed(list: &[u8]) -> Result<Vec<u64>, String> {
    let mut rest = WireFields::new(list);
    let mut numbers = Vec::new();
    while !rest.0.is_empty() {
        numbers.push(rest.varint().ok_or_else(damaged)?);
    }
    Ok(numbers)
}

fn damaged() -> String {
    "it is damaged, or not an ONNX file".to_owned()
}

impl<'a> Iterator for WireFields<'a> {
    /// A field, or an error at bytes that are none; nothing follows it.
    type Item = Result<(u64, WireValue<'a>), String>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.0.is_empty() {
            return None;
        }
        let field = self.field().ok_or_else(damaged);
        if field.is_err() {
            self.0 = &[];
        }
        Some(field)
    }
}

impl<'a> WireValue<'a> {
    /// Returns the bytes of a message, text or list.
    pub(crate) fn bytes(self) -> Result<&'a [u8], String> {
        match self {
            Self::Bytes(bytes) => Ok(bytes),
            _ => Err("it is damaged: a field has another type".to_owned()),
        }
    }

    /// Returns a text.
    pub(crate) fn text(self) -> Result<String, String> {
        String::from_utf8(self.bytes()?.to_vec()).map_err(|_| "it is damaged: a text is not UTF-8".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_read_and_damage_is_reported() {
        // Field 1 = 300, field 2 = "ab".
        let message = [0x08, 0xac, 0x02, 0x12, 0x02, b'a', b'b'];
        let fields: Vec<_> = WireFields::new(&message).map(Result::unwrap).collect();
        assert_eq!(fields, [(1, WireValue::Number(300)), (2, WireValue::Bytes(b"ab"))]);
        assert!(WireFields::new(&message[..6]).any(|field| field.is_err()));
        assert!(WireFields::new(&[0xff; 20]).any(|field| field.is_err()));
    }
}
