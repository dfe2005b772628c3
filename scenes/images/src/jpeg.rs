//! Check that no part of a JPEG file is lost.
//!
//! The codes of every block are read and counted, without pixels. A file is whole if each scan has exactly the blocks of its image, restart
//! markers come in order, and the scans carry all bits of all coefficients. Part of a file that is lost, added or replaced shifts the codes,
//! which then end too early or too late.

const ENDS_EARLY: &str = "its data end before the last pixel";
const NO_CODE: &str = "its data hold no valid code";
const SEGMENTS: &str = "a segment of its head is wrong";

type Checked<T> = Result<T, &'static str>;

/// Checks a JPEG file. Files of kinds that no decoder of ours reads (arithmetic, lossless, 12 bits) pass: the decoder refuses them.
pub(crate) fn check(file: &[u8]) -> Checked<()> {
    let mut frame: Option<Frame> = None;
    let mut tables = Tables::default();
    let mut restart_interval = 0;
    let mut at = 2;
    loop {
        let marker = marker(file, &mut at)?;
        match marker {
            0xd9 => {
                return if frame.is_some_and(|frame| frame.is_complete()) { Ok(()) } else { Err("scans are missing") };
            }
            // The start of another image, or a restart outside of a scan.
            0xd0..=0xd8 => return Err("an image starts or goes on where another segment is due"),
            _ => {}
        }
        let segment = segment(file, &mut at)?;
        match marker {
            0xc0..=0xc2 => {
                let head = Frame::read(segment, marker == 0xc2).ok_or(SEGMENTS)?;
                if frame.replace(head).is_some() {
                    return Err("it has two heads");
                }
            }
            0xc4 => tables.read(segment).ok_or(SEGMENTS)?,
            0xc3 | 0xc5..=0xcf => return Ok(()),
            0xdd => restart_interval = u32::from(*segment.first_chunk().map(u16_at).as_ref().ok_or(SEGMENTS)?),
            0xda => {
                let frame = frame.as_mut().ok_or(SEGMENTS)?;
                let scan = Scan::read(segment, frame).ok_or(SEGMENTS)?;
                let mut bits = Bits { file, at, held: 0, count: 0 };
                scan.check(frame, &tables, restart_interval, &mut bits)?;
                at = bits.at;
            }
            _ => {}
        }
    }
}

fn u16_at(bytes: &[u8; 2]) -> u16 {
    u16::from_be_bytes(*bytes)
}

/// Returns the marker at this place and goes past it. Any number of bytes 0xff may precede it.
fn marker(file: &[u8], at: &mut usize) -> Checked<u8> {
    if *file.get(*at).ok_or("its end is missing")? != 0xff {
        return Err("bytes lie between its segments");
    }
    while *file.get(*at).ok_or("its end is missing")? == 0xff {
        *at += 1;
    }
    *at += 1;
    Ok(file[*at - 1])
}

/// Returns the content of the segment at this place and goes past it.
fn segment<'a>(file: &'a [u8], at: &mut usize) -> Checked<&'a [u8]> {
    let rest = file.get(*at..).unwrap_or_default();
    let length = usize::from(rest.first_chunk().map(u16_at).ok_or("its end is missing")?);
    *at += length;
    rest.get(2.min(length)..length).ok_or("its end is missing")
}

/// Image of a file.
struct Frame {
    width: usize,
    height: usize,
    is_progressive: bool,
    components: Vec<Component>,
}

/// Colour of an image.
struct Component {
    id: u8,
    /// Blocks in a unit of all colours.
    across: usize,
    down: usize,
    /// Blocks in a row, with those that fill up the last unit.
    stride: usize,
    /// Coefficients of each block that are not 0, a bit each, in the order of the file. Only for progressive files, whose later scans
    /// depend on them.
    set: Vec<u64>,
    /// Coefficients of which the last bit was read.
    finished: u64,
}

impl Frame {
    fn read(segment: &[u8], is_progressive: bool) -> Option<Self> {
        let (&[_, h1, h0, w1, w0, count], rest) = segment.split_first_chunk()?;
        let (width, height) = (usize::from(u16_at(&[w1, w0])), usize::from(u16_at(&[h1, h0])));
        let mut components = Vec::new();
        for &[id, sampling, _] in rest.as_chunks().0.iter().take(usize::from(count)) {
            let (across, down) = (usize::from(sampling >> 4), usize::from(sampling & 15));
            if !(1..=4).contains(&across) || !(1..=4).contains(&down) {
                return None;
            }
            components.push(Component { id, across, down, stride: 0, set: Vec::new(), finished: 0 });
        }
        let mut frame = Self { width, height, is_progressive, components };
        let (columns, rows) = frame.units();
        for component in &mut frame.components {
            component.stride = columns * component.across;
            if is_progressive {
                component.set = vec![0; component.stride * rows * component.down];
            }
        }
        Some(frame)
    }

    /// Returns the largest sampling factors.
    fn sampling(&self) -> (usize, usize) {
        let of = |side: fn(&Component) -> usize| self.components.iter().map(side).max().unwrap_or(1);
        (of(|c| c.across), of(|c| c.down))
    }

    /// Returns columns and rows of units of all colours.
    fn units(&self) -> (usize, usize) {
        let (across, down) = self.sampling();
        (self.width.div_ceil(8 * across), self.height.div_ceil(8 * down))
    }

    fn is_complete(&self) -> bool {
        self.components.iter().all(|component| component.finished == u64::MAX)
    }
}

/// Table of codes: the symbol of each code by its first bits, or by its length and number.
struct Codes {
    /// Length and symbol of codes of at most 8 bits, by the next 8 bits. 0 where the code is longer.
    short: Box<[(u8, u8); 256]>,
    /// Of each length: one past its last code, left-aligned in 16 bits, and what leads from a code to the place of its symbol.
    long: [(u32, i32); 17],
    symbols: Vec<u8>,
}

impl Codes {
    fn new(counts: &[u8; 16], symbols: &[u8]) -> Option<Self> {
        let mut short = Box::new([(0, 0); 256]);
        let mut long = [(0, 0); 17];
        let (mut code, mut place) = (0_u32, 0_usize);
        for length in 1..=16 {
            let count = usize::from(counts[length - 1]);
            long[length].1 = place as i32 - code as i32;
            for &symbol in symbols.get(place..place + count)? {
                if code >> length != 0 {
                    return None;
                }
                if length <= 8 {
                    let first = (code as usize) << (8 - length);
                    short.get_mut(first..first + (1 << (8 - length)))?.fill((length as u8, symbol));
                }
                code += 1;
            }
            place += count;
            long[length].0 = code << (16 - length);
            code <<= 1;
        }
        Some(Self { short, long, symbols: symbols.to_vec() })
    }
}

/// Tables of codes for the first coefficient and for the others.
#[derive(Default)]
struct Tables([[Option<Codes>; 4]; 2]);

impl Tables {
    fn read(&mut self, mut segment: &[u8]) -> Option<()> {
        while let Some((&kind, rest)) = segment.split_first() {
            let (counts, rest) = rest.split_first_chunk::<16>()?;
            let (symbols, rest) = rest.split_at_checked(counts.iter().map(|n| usize::from(*n)).sum())?;
            let slot = self.0.get_mut(usize::from(kind >> 4))?.get_mut(usize::from(kind & 15))?;
            *slot = Some(Codes::new(counts, symbols)?);
            segment = rest;
        }
        Some(())
    }

    fn get(&self, class: usize, slot: u8) -> Checked<&Codes> {
        let slot = self.0[class].get(usize::from(slot)).and_then(Option::as_ref);
        slot.ok_or("it has no table of codes; convert it with another program")
    }
}

/// Bits of a scan.
struct Bits<'a> {
    file: &'a [u8],
    at: usize,
    held: u64,
    count: u32,
}

impl Bits<'_> {
    /// Returns the next byte of the scan, or nothing before a marker or the file's end.
    fn byte(&mut self) -> Option<u8> {
        let byte = *self.file.get(self.at)?;
        if byte == 0xff {
            if self.file.get(self.at + 1) != Some(&0) {
                return None;
            }
            self.at += 1;
        }
        self.at += 1;
        Some(byte)
    }

    fn fill(&mut self) {
        while self.count <= 48 {
            let Some(byte) = self.byte() else { break };
            self.held = self.held << 8 | u64::from(byte);
            self.count += 8;
        }
    }

    /// Returns the next 16 bits, zeros after the last, and leaves them.
    fn peek(&mut self) -> u32 {
        if self.count < 16 {
            self.fill();
        }
        let bits = if self.count < 16 { self.held << (16 - self.count) } else { self.held >> (self.count - 16) };
        (bits & 0xffff) as u32
    }

    /// Returns the next 0 to 16 bits.
    fn take(&mut self, n: u8) -> Checked<u32> {
        let bits = self.peek() >> (16 - n.min(16));
        self.count = self.count.checked_sub(u32::from(n)).ok_or(ENDS_EARLY)?;
        Ok(bits)
    }

    fn symbol(&mut self, codes: &Codes) -> Checked<u8> {
        let bits = self.peek();
        let (length, symbol) = codes.short[(bits >> 8) as usize];
        if length > 0 {
            self.take(length)?;
            return Ok(symbol);
        }
        for length in 9..=16_u8 {
            let (end, to_place) = codes.long[usize::from(length)];
            if bits < end {
                let code = self.take(length)?;
                return codes.symbols.get((code as i32 + to_place) as usize).copied().ok_or(NO_CODE);
            }
        }
        Err(if self.count < 16 { ENDS_EARLY } else { NO_CODE })
    }

    /// Goes past the bits that fill up the last byte, to a marker. Zeros may precede it.
    fn end(&mut self) -> Checked<()> {
        let mut left = self.held & ((1 << (self.count & !7)) - 1);
        (self.held, self.count) = (0, 0);
        while left == 0 {
            left = match self.byte() {
                Some(byte) => u64::from(byte),
                None => return Ok(()),
            };
        }
        Err("it has data after the last pixel")
    }
}

/// Some coefficients of some colours.
struct Scan {
    /// Place of each colour in the frame, and its two tables.
    colours: Vec<(usize, u8, u8)>,
    first: u8,
    last: u8,
    /// True for a scan that adds a bit to coefficients of an earlier one.
    refines: bool,
    is_final: bool,
}

impl Scan {
    fn read(segment: &[u8], frame: &Frame) -> Option<Self> {
        let (&count, rest) = segment.split_first()?;
        let (list, &[first, last, bit]) =
            rest.split_at_checked(2 * usize::from(count)).and_then(|(a, b)| Some((a, b.first_chunk()?)))?;
        let mut colours = Vec::new();
        for &[id, slots] in list.as_chunks().0 {
            colours.push((frame.components.iter().position(|c| c.id == id)?, slots >> 4, slots & 15));
        }
        if !frame.is_progressive {
            return Some(Self { colours, first: 0, last: 63, refines: false, is_final: true });
        }
        let is_possible = first <= last && last <= 63 && if first == 0 { last == 0 } else { count == 1 };
        is_possible.then_some(Self { colours, first, last, refines: bit >> 4 != 0, is_final: bit & 15 == 0 })
    }

    fn check(&self, frame: &mut Frame, tables: &Tables, restart_interval: u32, bits: &mut Bits<'_>) -> Checked<()> {
        let (most_across, most_down) = frame.sampling();
        let (mut columns, mut rows) = frame.units();
        if let [(one, ..)] = self.colours[..] {
            // A scan of one colour leaves out the blocks that fill up the last unit.
            let component = &frame.components[one];
            columns = (frame.width * component.across).div_ceil(8 * most_across);
            rows = (frame.height * component.down).div_ceil(8 * most_down);
        }
        let is_alone = self.colours.len() == 1;
        let (mut done, mut restarts, mut empty_blocks) = (0, 0, 0);
        for row in 0..rows {
            for column in 0..columns {
                if restart_interval > 0 && done > 0 && done % restart_interval == 0 {
                    bits.end()?;
                    if marker(bits.file, &mut bits.at)? != 0xd0 + restarts {
                        return Err("a part between its restart markers is missing");
                    }
                    restarts = (restarts + 1) % 8;
                    if empty_blocks > 0 {
                        return Err(NO_CODE);
                    }
                }
                done += 1;
                for &(index, dc, ac) in &self.colours {
                    let component = &mut frame.components[index];
                    let (across, down) = if is_alone { (1, 1) } else { (component.across, component.down) };
                    for y in row * down..(row + 1) * down {
                        for x in column * across..(column + 1) * across {
                            // Files that are not progressive need no memory of their blocks.
                            let mut unused = 0;
                            let set = component.set.get_mut(y * component.stride + x).unwrap_or(&mut unused);
                            self.block(tables, (dc, ac), set, &mut empty_blocks, bits)?;
                        }
                    }
                }
            }
        }
        if empty_blocks > 0 {
            return Err(NO_CODE);
        }
        bits.end()?;
        let coefficients = (u64::MAX >> (63 - (self.last - self.first))) << self.first;
        for &(index, ..) in self.colours.iter().filter(|_| self.is_final) {
            frame.components[index].finished |= coefficients;
        }
        Ok(())
    }

    /// Reads the codes of a block. `empty_blocks` counts those blocks in a row that have no codes of their own.
    fn block(
        &self,
        tables: &Tables,
        (dc, ac): (u8, u8),
        set: &mut u64,
        empty_blocks: &mut u32,
        bits: &mut Bits<'_>,
    ) -> Checked<()> {
        let mut k = self.first;
        if k == 0 {
            let length = if self.refines { 1 } else { bits.symbol(tables.get(0, dc)?)? };
            if length > 15 {
                return Err(NO_CODE);
            }
            bits.take(length)?;
            k = 1;
        }
        if k > self.last {
            return Ok(());
        }
        let codes = tables.get(1, ac)?;
        while *empty_blocks == 0 && k <= self.last {
            let symbol = bits.symbol(codes)?;
            let (mut zeros, length) = (symbol >> 4, symbol & 15);
            if length == 0 && zeros < 15 {
                // Several blocks without codes in a row exist in progressive files alone, whose scans do not begin at the first coefficient.
                if self.first == 0 && zeros > 0 {
                    return Err(NO_CODE);
                }
                *empty_blocks = (1 << zeros) + bits.take(zeros)?;
                break;
            }
            if self.refines && length > 1 {
                return Err(NO_CODE);
            }
            bits.take(length)?;
            // Coefficients that were set earlier receive a bit and are not counted.
            while k <= self.last {
                if self.refines && *set >> k & 1 == 1 {
                    bits.take(1)?;
                } else if zeros == 0 {
                    break;
                } else {
                    zeros -= 1;
                }
                k += 1;
            }
            if length > 0 {
                if k > self.last {
                    return Err(NO_CODE);
                }
                *set |= 1 << k;
            }
            k += 1;
        }
        if *empty_blocks > 0 {
            if self.refines {
                for _ in 0..(*set >> k & (u64::MAX >> (63 - (self.last - k.min(self.last))))).count_ones() {
                    bits.take(1)?;
                }
            }
            *empty_blocks -= 1;
        }
        Ok(())
    }
}
