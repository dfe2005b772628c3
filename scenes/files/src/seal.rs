//! Checksums of safetensors files.
//!
//! The metadata of a sealed file begin with the entry `"checksum"`: the CRC-32 of the whole file, in which the eight digits of the checksum
//! count as zeros. Readers of safetensors that do not know it see one more entry.

/// Beginning of the header of a sealed file, up to the digits of the checksum.
const SEALED: &str = r#"{"__metadata__":{"checksum":""#;
/// Beginning of a header with metadata.
const METADATA: &[u8] = br#"{"__metadata__":{"#;
/// The digits when the checksum is computed.
const ZEROS: &str = "00000000";
/// Place of the digits in the file. The length of the header comes before it.
const DIGITS: std::ops::Range<usize> = 8 + SEALED.len()..8 + SEALED.len() + ZEROS.len();
/// Tensors begin at multiples of so many bytes.
const ALIGNMENT: usize = 8;

/// The checksum of a file is wrong: the file was damaged after it was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the checksum is wrong")]
pub struct BrokenSeal;

/// Returns a safetensors file with its checksum. Bytes that are no such file are returned as they are.
pub fn seal(file: Vec<u8>) -> Vec<u8> {
    let Some((header, tensors)) = split(&file).filter(|(header, _)| header.starts_with(b"{\"")) else { return file };
    let mut sealed = format!("{SEALED}{ZEROS}\"").into_bytes();
    match header.strip_prefix(METADATA) {
        Some(rest) if rest.starts_with(b"}") => sealed.extend(rest),
        Some(rest) => sealed.extend([b",", rest].concat()),
        None => sealed.extend([b"},", &header[1..]].concat()),
    }
    sealed.truncate(sealed.trim_ascii_end().len());
    sealed.resize(sealed.len().next_multiple_of(ALIGNMENT), b' ');
    let mut file = [&(sealed.len() as u64).to_le_bytes(), sealed.as_slice(), tensors].concat();
    let checksum = checksum(&file);
    file[DIGITS].copy_from_slice(checksum.as_bytes());
    file
}

/// Checks a file. A file without a checksum is valid: version 0.1.0 wrote none.
///
/// # Errors
/// [`BrokenSeal`] if the checksum is wrong.
pub fn check(file: &[u8]) -> Result<(), BrokenSeal> {
    let is_sealed = split(file).is_some_and(|(header, _)| header.starts_with(SEALED.as_bytes()));
    let is_right = || file.get(DIGITS) == Some(checksum(file).as_bytes());
    if !is_sealed || is_right() { Ok(()) } else { Err(BrokenSeal) }
}

/// Returns the header and the tensors.
fn split(file: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = file.split_first_chunk::<8>()?;
    rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)
}

fn checksum(file: &[u8]) -> String {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(file.get(..DIGITS.start).unwrap_or_default());
    hasher.update(ZEROS.as_bytes());
    hasher.update(file.get(DIGITS.end..).unwrap_or_default());
    format!("{:08x}", hasher.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use safetensors::SafeTensors;
    use safetensors::tensor::{Dtype, TensorView};
    use std::collections::HashMap;

    /// A file with one tensor, by the crate that everybody reads such files with.
    fn file(metadata: &[(&str, &str)]) -> Vec<u8> {
        let tensor = TensorView::new(Dtype::U8, vec![9], b"some data").unwrap();
        let metadata = metadata.iter().map(|(key, value)| (key.to_string(), value.to_string()));
        let metadata: HashMap<_, _> = metadata.collect();
        safetensors::serialize([("a", tensor)], (!metadata.is_empty()).then_some(metadata)).unwrap()
    }

    #[test]
    fn a_sealed_file_has_the_same_contents() {
        for metadata in [&[][..], &[("config", r#"{"checksum":"1","a":[2]}"#)]] {
            let sealed = seal(file(metadata));
            assert_eq!(check(&sealed), Ok(()));
            let (_, header) = SafeTensors::read_metadata(&sealed).unwrap();
            let entries = header.metadata().clone().unwrap();
            assert_eq!(entries.len(), metadata.len() + 1);
            assert!(metadata.iter().all(|(key, value)| entries[*key] == *value));
            let read = SafeTensors::deserialize(&sealed).unwrap();
            assert_eq!(read.tensor("a").unwrap().data(), b"some data");
        }
    }

    #[test]
    fn every_flipped_bit_behind_the_beginning_is_found() {
        let sealed = seal(file(&[("config", "1")]));
        for bit in 8 * DIGITS.start..8 * sealed.len() {
            let mut damaged = sealed.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(check(&damaged), Err(BrokenSeal), "{bit}");
        }
    }

    #[test]
    fn a_file_without_a_checksum_is_valid() {
        assert_eq!(check(&file(&[("a", "b")])), Ok(()));
        assert_eq!(check(b""), Ok(()));
    }

    proptest! {
        #[test]
        fn any_bytes_are_taken_without_a_panic(bytes: Vec<u8>, length in 0u64..80, header in "\\PC{0,40}") {
            for header in [header.clone(), format!("{SEALED}{header}"), format!("{{\"{header}")] {
                let file = [&length.to_le_bytes()[..], header.as_bytes(), &bytes].concat();
                let _ = check(&file);
                prop_assert_eq!(check(&seal(file)).is_ok() || length < 40, true);
            }
        }
    }
}
