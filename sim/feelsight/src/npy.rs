//! .npy files: one numeric array each, in NumPy's format.

use std::io::{self, BufReader, Read};
use std::path::Path;

use crate::array::{Array, Kind};

/// Length of the headers that are written: NumPy pads to multiples of 64.
pub(crate) const HEADER_LENGTH: usize = 128;

/// Reason why an array is refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NpyError {
    /// Reading failed.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// The header is not in NumPy's format, or the number of bytes does not fit it.
    #[error("{0}")]
    Defect(String),
}

/// Returns the contents of the file of an array with at most three axes.
pub fn to_bytes(array: &Array) -> Vec<u8> {
    let axes: String = array.shape().iter().map(|n| format!("{n}, ")).collect();
    // A byte has no order.
    let order = if array.kind().size() == 1 { '|' } else { '<' };
    let header = header(&format!("{order}{}", array.kind().code()), &format!("({})", axes.trim_end()));
    [&header, array.bytes()].concat()
}

/// Reads an array.
///
/// # Errors
/// [`NpyError`] if the file cannot be read, its header is not in NumPy's format, or the number of bytes does not fit the shape.
pub fn read(path: &Path) -> Result<Array, NpyError> {
    let mut file = BufReader::new(mvt_files::input::open(path)?);
    let (Header { kind, big_endian, fortran_order, shape }, _) = Header::read(&mut file)?;
    let bytes = shape.iter().try_fold(kind.size() as u64, |bytes, &n| bytes.checked_mul(n as u64));
    let mut data = Vec::new();
    // One byte more than expected shows that the file is too long.
    file.take(bytes.unwrap_or(0).saturating_add(1)).read_to_end(&mut data)?;
    Array::from_raw(kind, big_endian, fortran_order, shape, &data).map_err(NpyError::Defect)
}

/// Returns a header of format 1.0, padded with spaces to its fixed length.
pub(crate) fn header(descr: &str, shape: &str) -> [u8; HEADER_LENGTH] {
    let mut out = [b' '; HEADER_LENGTH];
    out[..8].copy_from_slice(b"\x93NUMPY\x01\x00");
    out[8..10].copy_from_slice(&(HEADER_LENGTH as u16 - 10).to_le_bytes());
    let dict = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    // Three numbers of at most 20 digits leave room.
    let end = (10 + dict.len()).min(HEADER_LENGTH - 1);
    out[10..end].copy_from_slice(&dict.as_bytes()[..end - 10]);
    out[HEADER_LENGTH - 1] = b'\n';
    out
}

/// Contents of a header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Header {
    pub kind: Kind,
    pub big_endian: bool,
    pub fortran_order: bool,
    pub shape: Vec<usize>,
}

impl Header {
    /// Reads a header of format 1.0 to 3.0 and leaves the reader at the data. Returns the header and its length.
    pub fn read(mut from: impl Read) -> Result<(Self, u64), NpyError> {
        let defect = || NpyError::Defect("the array is not in NumPy's format".into());
        let mut start = [0; 8];
        from.read_exact(&mut start)?;
        let width = match start {
            [0x93, b'N', b'U', b'M', b'P', b'Y', 1, _] => 2,
            [0x93, b'N', b'U', b'M', b'P', b'Y', 2 | 3, _] => 4,
            _ => return Err(defect()),
        };
        let mut length = [0; 4];
        from.read_exact(&mut length[..width])?;
        let length = u32::from_le_bytes(length);
        // NumPy refuses longer headers, too.
        if length > 10_000 {
            return Err(defect());
        }
        let mut text = vec![0; length as usize];
        from.read_exact(&mut text)?;
        let text = String::from_utf8(text).map_err(|_| defect())?;
        let header = Self::parse(&text).ok_or_else(|| {
            NpyError::Defect(format!("an array of an unknown type: {}", text.trim_end().escape_debug()))
        })?;
        Ok((header, 8 + width as u64 + u64::from(length)))
    }

    /// Parses a header: a Python dictionary with exactly three keys.
    fn parse(text: &str) -> Option<Self> {
        let after = |key: &str| {
            let (_, rest) = text.split_once(&format!("'{key}'"))?;
            Some(rest.trim_start().strip_prefix(':')?.trim_start())
        };
        let (code, _) = after("descr")?.strip_prefix('\'')?.split_once('\'')?;
        let big_endian = code.starts_with('>');
        let kind = Kind::from_code(code.trim_start_matches(['<', '>', '|', '=']))?;
        let fortran_order = match after("fortran_order")? {
            rest if rest.starts_with("True") => true,
            rest if rest.starts_with("False") => false,
            _ => return None,
        };
        let (shape, _) = after("shape")?.strip_prefix('(')?.split_once(')')?;
        // Python 2 wrote lengths as 3L.
        let axes = shape.split(',').map(|n| n.trim().trim_end_matches('L')).filter(|n| !n.is_empty());
        let shape = axes.map(str::parse).collect::<Result<_, _>>().ok()?;
        Some(Self { kind, big_endian, fortran_order, shape })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_of_numpy() {
        let parse = |text| Header::parse(text).map(|h| (h.kind, h.big_endian, h.fortran_order, h.shape));
        assert_eq!(
            parse("{'descr': '<f4', 'fortran_order': False, 'shape': (3, 480, 640), }  \n"),
            Some((Kind::F32, false, false, vec![3, 480, 640]))
        );
        assert_eq!(
            parse("{'descr': '>u2', 'fortran_order': True, 'shape': (7L,), }"),
            Some((Kind::U16, true, true, vec![7]))
        );
        assert_eq!(parse("{'descr': '|O', 'fortran_order': False, 'shape': (), }"), None);
        assert_eq!(parse("{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (), }"), None);
        assert_eq!(parse("{'descr': '<f4', 'shape': (1,)}"), None);
    }

    #[test]
    fn a_file_gives_its_array_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        for array in [
            Array::from_f32(vec![2, 3], [0.5, -1.0, f32::MAX, 0.0, 1e-20, 7.0]),
            Array::from_u8(vec![2, 1, 2], vec![0, 255, 3, 4]),
            Array::from_f64(vec![2], [1.0, 2.0]),
            Array::from_f64(vec![], [1.0]),
        ] {
            std::fs::write(&path, to_bytes(&array)).unwrap();
            assert_eq!(read(&path).unwrap(), array);
        }
    }

    #[test]
    fn a_file_of_the_wrong_length_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let whole = [&header("<f4", "(2, 2)")[..], &[0; 16]].concat();
        for length in [0, 5, 100, 128, 143] {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(read(&path).is_err(), "{length}");
        }
        std::fs::write(&path, [&whole[..], &[0]].concat()).unwrap();
        assert!(read(&path).is_err());
        std::fs::write(&path, header("<f4", "(4294967296, 4294967296, 4294967296)")).unwrap();
        assert!(read(&path).is_err());
    }
}
