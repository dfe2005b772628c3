//! Text of mesh files, whatever the system that wrote it.

use std::borrow::Cow;
use std::str::FromStr;

/// Number of characters of a faulty line that a message quotes.
const QUOTED: usize = 60;

/// Returns the bytes of a file without a byte order mark, and UTF-16 as UTF-8. Other bytes stay unchanged.
pub(crate) fn decoded(bytes: &[u8]) -> Cow<'_, [u8]> {
    let utf16 = |units: &[u8], unit: fn([u8; 2]) -> u16| {
        let units = units.chunks_exact(2).filter_map(|pair| pair.try_into().ok()).map(unit);
        let text: String = char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect();
        Cow::Owned(text.into_bytes())
    };
    match bytes {
        [0xef, 0xbb, 0xbf, rest @ ..] => Cow::Borrowed(rest),
        [0xff, 0xfe, rest @ ..] => utf16(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => utf16(rest, u16::from_be_bytes),
        _ => Cow::Borrowed(bytes),
    }
}

/// Lines that end with LF, CR LF or CR, numbered from 1.
#[derive(Clone)]
pub(crate) struct Lines<'a> {
    /// Bytes after the lines that were returned.
    pub(crate) rest: &'a [u8],
    /// Number of the line that was returned last.
    pub(crate) number: usize,
}

impl<'a> Lines<'a> {
    pub(crate) fn new(rest: &'a [u8]) -> Self {
        Self { rest, number: 0 }
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        if self.rest.is_empty() {
            return None;
        }
        self.number += 1;
        let end = self.rest.iter().position(|&byte| matches!(byte, b'\n' | b'\r')).unwrap_or(self.rest.len());
        let (line, rest) = self.rest.split_at(end);
        self.rest = rest.strip_prefix(b"\r\n").or_else(|| rest.get(1..)).unwrap_or_default();
        Some(line)
    }
}

/// Returns the words of a line.
pub(crate) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
}

/// Returns the number that a word spells; `None` if it spells none.
pub(crate) fn number<T: FromStr>(word: &[u8]) -> Option<T> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

/// Returns the start of a line, quoted for a message.
pub(crate) fn quoted(line: &[u8]) -> String {
    let printable = |c: char| if c.is_control() { ' ' } else { c };
    let text: String = String::from_utf8_lossy(line).trim().chars().take(QUOTED).map(printable).collect();
    format!("\"{text}\"")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_every_system_are_counted() {
        let lines: Vec<&[u8]> = Lines::new(b"a\nb\r\nc\rd\n\ne").collect();
        assert_eq!(lines, [&b"a"[..], b"b", b"c", b"d", b"", b"e"]);
        let utf16 =
            |bytes: fn(u16) -> [u8; 2]| [0xfeff, 0x76, 0x20, 0xfc].iter().flat_map(|&unit| bytes(unit)).collect();
        let both: [Vec<u8>; 2] = [utf16(u16::to_le_bytes), utf16(u16::to_be_bytes)];
        for bytes in &both {
            assert_eq!(&*decoded(bytes), "v ü".as_bytes());
        }
    }
}
