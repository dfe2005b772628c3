//! RVL, a code of depth images without loss (Wilson, Fast Lossless Depth Image Compression, 2017).

use ndarray::Array2;

/// Numbers in parts of 3 bits, highest nibble of 32-bit words first.
struct Nibbles<'a> {
    words: std::slice::Iter<'a, [u8; 4]>,
    word: u32,
    left: u32,
}

impl Nibbles<'_> {
    /// Reads a number; the top bit of a nibble says that another one follows.
    fn number(&mut self) -> Option<u32> {
        let (mut value, mut shift) = (0u32, 0);
        loop {
            if self.left == 0 {
                self.word = u32::from_le_bytes(*self.words.next()?);
                self.left = 8;
            }
            let nibble = self.word >> 28;
            self.word <<= 4;
            self.left -= 1;
            value |= (nibble & 7).checked_shl(shift)?;
            if nibble & 8 == 0 {
                return Some(value);
            }
            shift += 3;
        }
    }
}

/// Decodes an image: width and height, then runs of zeros and of differences.
pub(crate) fn decode(data: &[u8], most_pixels: usize) -> Result<Array2<u16>, String> {
    const CUT: &str = "the RVL data end before the image: record it again";
    let (words, _) = data.as_chunks::<4>();
    let [width, height, rest @ ..] = words else { return Err(CUT.to_owned()) };
    let [width, height] = [width, height].map(|word| u32::from_le_bytes(*word) as usize);
    let count = width.saturating_mul(height);
    if count == 0 || count > most_pixels {
        return Err(format!("an RVL image of {width} x {height} pixels is that of no camera"));
    }
    let mut nibbles = Nibbles { words: rest.iter(), word: 0, left: 0 };
    let mut levels: Vec<u16> = Vec::new();
    let mut previous = 0i32;
    while levels.len() < count {
        let zeros = nibbles.number().ok_or(CUT)? as usize;
        let values = nibbles.number().ok_or(CUT)? as usize;
        if zeros.saturating_add(values) > count - levels.len() || zeros + values == 0 {
            return Err("the RVL data do not fit the size of the image: they are damaged".to_owned());
        }
        levels.resize(levels.len() + zeros, 0);
        for _ in 0..values {
            let coded = nibbles.number().ok_or(CUT)?;
            let difference = (coded >> 1) as i32 ^ -((coded & 1) as i32);
            previous = previous.wrapping_add(difference);
            levels.push(previous as u16);
        }
    }
    Ok(Array2::from_shape_vec((height, width), levels).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Encodes as the paper's program does.
    fn encode(width: u32, height: u32, levels: &[u16]) -> Vec<u8> {
        let mut nibbles = Vec::new();
        let mut push = |mut value: u32| {
            loop {
                let part = value & 7;
                value >>= 3;
                nibbles.push(if value > 0 { part | 8 } else { part });
                if value == 0 {
                    break;
                }
            }
        };
        let (mut at, mut previous) = (0, 0i32);
        while at < levels.len() {
            let zeros = levels[at..].iter().take_while(|level| **level == 0).count();
            at += zeros;
            let values = levels[at..].iter().take_while(|level| **level != 0).count();
            push(zeros as u32);
            push(values as u32);
            for level in &levels[at..at + values] {
                let difference = i32::from(*level) - previous;
                push(((difference << 1) ^ (difference >> 31)) as u32);
                previous = i32::from(*level);
            }
            at += values;
        }
        let mut out = [width.to_le_bytes(), height.to_le_bytes()].concat();
        for eight in nibbles.chunks(8) {
            let word = (0..8).fold(0, |word, k| word << 4 | eight.get(k).copied().unwrap_or(0));
            out.extend(word.to_le_bytes());
        }
        out
    }

    proptest! {
        #[test]
        fn images_return(levels in prop::collection::vec(prop_oneof![Just(0u16), any::<u16>(), 1000..1010u16], 12)) {
            let image = decode(&encode(4, 3, &levels), 100).unwrap();
            prop_assert_eq!(image.dim(), (3, 4));
            prop_assert_eq!(image.into_raw_vec_and_offset().0, levels);
        }

        #[test]
        fn any_bytes_are_an_image_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..60)) {
            let mut data = [4u32.to_le_bytes(), 3u32.to_le_bytes()].concat();
            data.extend(&bytes);
            let _ = decode(&data, 100);
            let _ = decode(&bytes, 1 << 20);
        }
    }
}
