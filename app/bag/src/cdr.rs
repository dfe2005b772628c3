//! Reader of CDR, the encoding of messages in ROS 2 (XCDR1, either byte order).

/// Reason why bytes are not a CDR message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CdrError {
    /// The message ends before one of its values.
    #[error("the message ends at byte {length}, before a value of {size} bytes at byte {at}: it was cut off")]
    Short {
        /// Where the value starts.
        at: usize,
        /// Its size, bytes.
        size: usize,
        /// Size of the message, bytes.
        length: usize,
    },
    /// A list states more elements than the message can hold.
    #[error(
        "a list at byte {at} states {count} elements, more than the message holds: it is damaged or of another type"
    )]
    Count {
        /// Where the list starts.
        at: usize,
        /// Stated number of elements.
        count: u32,
    },
    /// The first bytes name another encoding.
    #[error("the encoding 0x{0:04x} is unknown; record with plain CDR, the default of ROS 2")]
    Encoding(u16),
    /// A text is not UTF-8.
    #[error("the text at byte {0} is not UTF-8: the message is damaged or of another type")]
    Text(usize),
}

/// Bytes before the values; they name the encoding.
const HEAD: usize = 4;

/// Values of a CDR message, one after the other. Padding may hold any bytes, and any bytes may follow the last value.
#[derive(Debug, Clone)]
pub struct CdrReader<'a> {
    /// The values; alignment counts from their start.
    body: &'a [u8],
    at: usize,
    is_big_endian: bool,
}

macro_rules! numbers {
    ($($(#[$doc:meta])* $name:ident: $type:ty;)*) => {$(
        $(#[$doc])*
        ///
        /// # Errors
        /// If the message ends before.
        pub fn $name(&mut self) -> Result<$type, CdrError> {
            const SIZE: usize = size_of::<$type>();
            self.align(SIZE);
            let bytes = self.take(SIZE)?;
            let bytes = bytes.first_chunk::<SIZE>().copied().unwrap_or_default();
            Ok(if self.is_big_endian { <$type>::from_be_bytes(bytes) } else { <$type>::from_le_bytes(bytes) })
        }
    )*};
}

impl<'a> CdrReader<'a> {
    /// Starts at the head of a message.
    ///
    /// # Errors
    /// If it is shorter than its head, or has another encoding.
    pub fn new(message: &'a [u8]) -> Result<Self, CdrError> {
        let Some((head, body)) = message.split_first_chunk::<HEAD>() else {
            return Err(CdrError::Short { at: 0, size: HEAD, length: message.len() });
        };
        let is_big_endian = match [head[0], head[1]] {
            [0, 0] => true,
            [0, 1] => false,
            other => return Err(CdrError::Encoding(u16::from_be_bytes(other))),
        };
        Ok(Self { body, at: 0, is_big_endian })
    }

    fn align(&mut self, size: usize) {
        self.at = self.at.next_multiple_of(size);
    }

    fn take(&mut self, size: usize) -> Result<&'a [u8], CdrError> {
        let taken = self.at.checked_add(size).and_then(|end| self.body.get(self.at..end));
        let Some(bytes) = taken else {
            return Err(CdrError::Short { at: self.at + HEAD, size, length: self.body.len() + HEAD });
        };
        self.at += size;
        Ok(bytes)
    }

    numbers! {
        /// Reads a byte.
        u8: u8;
        /// Reads a whole number of 32 bits.
        u32: u32;
        /// Reads a whole number of 32 bits with a sign.
        i32: i32;
        /// Reads a number of 64 bits with fractions.
        f64: f64;
    }

    /// Reads the number of elements of a list. An element has at least `least` bytes.
    ///
    /// # Errors
    /// If the message cannot hold so many.
    pub fn count(&mut self, least: usize) -> Result<usize, CdrError> {
        let count = self.u32()?;
        let left = self.body.len().saturating_sub(self.at);
        match (count as usize).checked_mul(least) {
            Some(bytes) if bytes <= left => Ok(count as usize),
            _ => Err(CdrError::Count { at: self.at + HEAD - 4, count }),
        }
    }

    /// Reads a list of bytes.
    ///
    /// # Errors
    /// If the message ends before.
    pub fn bytes(&mut self) -> Result<&'a [u8], CdrError> {
        let count = self.count(1)?;
        self.take(count)
    }

    /// Reads a text, which ends with a zero byte.
    ///
    /// # Errors
    /// If the message ends before, or it is not UTF-8.
    pub fn text(&mut self) -> Result<&'a str, CdrError> {
        let bytes = self.bytes()?;
        let bytes = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        std::str::from_utf8(bytes).map_err(|_| CdrError::Text(self.at + HEAD - bytes.len()))
    }

    /// Reads a list of numbers.
    ///
    /// # Errors
    /// If the message ends before.
    pub fn f64s(&mut self) -> Result<Vec<f64>, CdrError> {
        let count = self.count(8)?;
        (0..count).map(|_| self.f64()).collect()
    }

    /// Reads a fixed number of numbers.
    ///
    /// # Errors
    /// If the message ends before.
    pub fn array<const N: usize>(&mut self) -> Result<[f64; N], CdrError> {
        let mut array = [0.0; N];
        for value in &mut array {
            *value = self.f64()?;
        }
        Ok(array)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn values_are_aligned_in_either_byte_order_and_padding_is_skipped() {
        // A byte, padding that is not zero, a number, a text, padding, a list of one number, and bytes behind it.
        let little = [
            &[0, 1, 0, 0, 7, 0xaa, 0xaa, 0xaa][..],
            &5u32.to_le_bytes(),
            &3u32.to_le_bytes(),
            b"ab\0\xaa",
            &1u32.to_le_bytes(),
            &[0xaa; 4],
            &2.5f64.to_le_bytes(),
            &[9; 5],
        ]
        .concat();
        let big = [
            &[0, 0, 0, 0, 7, 0xaa, 0xaa, 0xaa][..],
            &5u32.to_be_bytes(),
            &3u32.to_be_bytes(),
            b"ab\0\xaa",
            &1u32.to_be_bytes(),
            &[0xaa; 4],
            &2.5f64.to_be_bytes(),
        ]
        .concat();
        for message in [&little, &big] {
            let mut reader = CdrReader::new(message).unwrap();
            assert_eq!(
                (reader.u8(), reader.u32(), reader.text(), reader.f64s()),
                (Ok(7), Ok(5), Ok("ab"), Ok(vec![2.5]))
            );
        }
    }

    #[test]
    fn what_is_cut_or_longer_than_the_message_is_an_error() {
        assert_eq!(CdrReader::new(&[0, 1]).unwrap_err(), CdrError::Short { at: 0, size: 4, length: 2 });
        assert_eq!(CdrReader::new(&[0, 7, 0, 0]).unwrap_err(), CdrError::Encoding(7));
        let reader = |bytes: &'static [u8]| CdrReader::new(bytes).unwrap();
        assert_eq!(reader(&[0, 1, 0, 0, 1]).u32(), Err(CdrError::Short { at: 4, size: 4, length: 5 }));
        let long = &[0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff, 1, 2];
        assert_eq!(reader(long).bytes(), Err(CdrError::Count { at: 4, count: u32::MAX }));
        assert_eq!(reader(long).f64s(), Err(CdrError::Count { at: 4, count: u32::MAX }));
        assert_eq!(reader(&[0, 1, 0, 0, 2, 0, 0, 0, 0xff, 0]).text(), Err(CdrError::Text(9)));
    }

    proptest! {
        #[test]
        fn any_bytes_are_values_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..80), calls in prop::collection::vec(0..6, 0..20)) {
            let Ok(mut reader) = CdrReader::new(&bytes) else { return Ok(()) };
            for call in calls {
                let done = match call {
                    0 => reader.u8().is_ok(),
                    1 => reader.f64().is_ok(),
                    2 => reader.text().is_ok(),
                    3 => reader.f64s().is_ok_and(|list| list.len() * 8 <= bytes.len()),
                    4 => reader.bytes().is_ok_and(|list| list.len() <= bytes.len()),
                    _ => reader.array::<3>().is_ok(),
                };
                prop_assert!(done || reader.at <= bytes.len() + 8);
            }
        }
    }
}
