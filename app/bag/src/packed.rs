//! Data compressed with Zstandard or LZ4, with limits: a few bytes may decompress to many.

use std::io::{self, Read};

use ruzstd::decoding::{FrameDecoder, StreamingDecoder};

/// Greatest ratio of decompressed to compressed bytes: even depth images without any depth have less.
const RATIO: u64 = 2000;
/// Decompressed bytes that are allowed for any input.
pub(crate) const SMALL: u64 = 4 << 20;
/// Greatest window of Zstandard, bytes: that of its levels 1 to 19. The decoder allocates it at once.
const WINDOW: u64 = 8 << 20;
/// First bytes of data that Zstandard compressed. No message in CDR starts so.
const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// Returns the most decompressed bytes that come of so many.
pub(crate) fn most(packed: u64) -> u64 {
    packed.saturating_mul(RATIO).saturating_add(SMALL)
}

/// Returns the plain contents of data compressed with Zstandard.
///
/// # Errors
/// If the data do not start as Zstandard does, or need more memory than its usual levels.
pub fn zstd<R: Read>(packed: R) -> io::Result<impl Read> {
    let mut decoder = FrameDecoder::new();
    decoder.set_max_window_size(WINDOW);
    StreamingDecoder::new_with_decoder(packed, decoder).map_err(io::Error::other)
}

/// Returns whether data start as Zstandard does.
pub(crate) fn is_zstd(data: &[u8]) -> bool {
    data.starts_with(&ZSTD)
}

/// Reads at most `limit` bytes; more are an error if `is_whole`. Needs memory in proportion to what comes.
pub(crate) fn read(from: impl Read, expected: usize, limit: u64, is_whole: bool) -> io::Result<Vec<u8>> {
    let mut plain = Vec::with_capacity(expected);
    from.take(limit.saturating_add(u64::from(is_whole))).read_to_end(&mut plain)?;
    if is_whole && plain.len() as u64 > limit {
        return Err(io::Error::other("it decompresses to more bytes than any recording has"));
    }
    Ok(plain)
}

/// Returns a message, or its first `head` bytes, without its own compression.
pub(crate) fn message(data: &[u8], head: Option<usize>) -> io::Result<Vec<u8>> {
    if is_zstd(data) {
        let plain = zstd(data)?;
        let limit = most(data.len() as u64);
        return read(plain, 0, head.map_or(limit, |head| head as u64), head.is_none());
    }
    Ok(data.get(..head.unwrap_or(data.len())).unwrap_or(data).to_vec())
}

/// Writes the plain contents of a file that Zstandard compressed, of so many bytes.
pub(crate) fn unpack(packed: impl io::BufRead, size: u64, to: &mut impl io::Write) -> io::Result<u64> {
    let mut packed = packed;
    let (mut written, limit) = (0, most(size));
    while !packed.fill_buf()?.is_empty() {
        let plain = zstd(&mut packed)?;
        written += io::copy(&mut plain.take(limit.saturating_add(1) - written), to)?;
        if written > limit {
            return Err(io::Error::other("it decompresses to more bytes than any recording has"));
        }
    }
    Ok(written)
}

#[cfg(test)]
mod tests {
    use ruzstd::encoding::{CompressionLevel, compress_to_vec};

    use super::*;

    #[test]
    fn messages_are_decompressed_whole_or_in_part_and_bombs_are_refused() {
        let plain: Vec<u8> = (0..100_000u32).flat_map(|k| (k / 7).to_le_bytes()).collect();
        let packed = compress_to_vec(plain.as_slice(), CompressionLevel::Fastest);
        assert!(is_zstd(&packed) && message(&packed, None).unwrap() == plain);
        assert_eq!(message(&packed, Some(30)).unwrap(), plain[..30]);
        assert_eq!(message(&plain, Some(30)).unwrap(), plain[..30]);
        assert_eq!(message(&plain[..3], Some(30)).unwrap(), plain[..3]);
        let mut twice = Vec::new();
        unpack([packed.as_slice(), &packed].concat().as_slice(), 2 * packed.len() as u64, &mut twice).unwrap();
        assert!(twice == plain.repeat(2));

        let bomb = compress_to_vec(vec![0; 64 << 20].as_slice(), CompressionLevel::Fastest);
        assert!(most(bomb.len() as u64) < 64 << 20, "{}", bomb.len());
        for error in
            [message(&bomb, None).map(drop), unpack(bomb.as_slice(), bomb.len() as u64, &mut io::sink()).map(drop)]
        {
            assert!(error.unwrap_err().to_string().contains("more bytes than any recording has"));
        }
    }
}
