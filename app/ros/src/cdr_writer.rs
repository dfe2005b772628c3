//! Writer of CDR, the encoding of messages in ROS 2 (XCDR1, little endian).

/// Values of a CDR message, one after the other. Padding is zero.
///
/// ```
/// let mut writer = mvt_ros::CdrWriter::new();
/// writer.u8(7).text("hi").f64s(&[2.5]);
/// let mut reader = mvt_bag::CdrReader::new(writer.message())?;
/// assert_eq!((reader.u8()?, reader.text()?, reader.f64s()?), (7, "hi", vec![2.5]));
/// # Ok::<(), mvt_bag::CdrError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CdrWriter {
    message: Vec<u8>,
}

/// Bytes before the values: they name the encoding, and alignment counts from behind them.
const HEAD: [u8; 4] = [0, 1, 0, 0];

impl Default for CdrWriter {
    fn default() -> Self {
        Self { message: HEAD.to_vec() }
    }
}

macro_rules! numbers {
    ($($(#[$doc:meta])* $name:ident: $type:ty;)*) => {$(
        $(#[$doc])*
        pub fn $name(&mut self, value: $type) -> &mut Self {
            let body = self.message.len() - HEAD.len();
            let padding = body.next_multiple_of(size_of::<$type>()) - body;
            self.message.extend(std::iter::repeat_n(0, padding));
            self.message.extend(value.to_le_bytes());
            self
        }
    )*};
}

impl CdrWriter {
    /// Starts a message.
    pub fn new() -> Self {
        Self::default()
    }

    numbers! {
        /// Writes a byte.
        u8: u8;
        /// Writes a whole number of 32 bits.
        u32: u32;
        /// Writes a whole number of 32 bits with a sign.
        i32: i32;
        /// Writes a number of 32 bits with fractions.
        f32: f32;
        /// Writes a number of 64 bits with fractions.
        f64: f64;
    }

    /// Writes the number of elements of a list.
    pub fn count(&mut self, count: usize) -> &mut Self {
        // A message of 4 GB is never written.
        self.u32(u32::try_from(count).unwrap_or(u32::MAX))
    }

    /// Writes a text, which ends with a zero byte.
    pub fn text(&mut self, text: &str) -> &mut Self {
        self.count(text.len() + 1);
        self.message.extend(text.as_bytes());
        self.u8(0)
    }

    /// Writes a list of bytes.
    pub fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.count(bytes.len());
        self.message.extend(bytes);
        self
    }

    /// Writes a fixed number of numbers.
    pub fn array(&mut self, numbers: &[f64]) -> &mut Self {
        for number in numbers {
            self.f64(*number);
        }
        self
    }

    /// Writes a list of numbers.
    pub fn f64s(&mut self, numbers: &[f64]) -> &mut Self {
        self.count(numbers.len()).array(numbers)
    }

    /// Returns the message, with the four bytes that name its encoding.
    pub fn message(&self) -> &[u8] {
        &self.message
    }

    /// Returns the message.
    pub fn into_message(self) -> Vec<u8> {
        self.message
    }
}
