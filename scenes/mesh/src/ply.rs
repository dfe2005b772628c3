//! Reader for Stanford PLY: text, binary little-endian and binary big-endian. Allocates memory for the data in the
//! file, never for the counts in the header.

use glam::Vec3;

use crate::error::Defect;
use crate::mesh::Mesh;
use crate::polygon;
use crate::text::{self, Lines};
use crate::warning::Finding;

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Text,
    LittleEndian,
    BigEndian,
}

#[derive(Clone, Copy)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Scalar {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "int64" | "long" => Self::I64,
            "uint64" | "ulong" => Self::U64,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }
}

enum Kind {
    Scalar(Scalar),
    List { length: Scalar, item: Scalar },
}

struct Property {
    name: String,
    kind: Kind,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

pub(super) fn parse(bytes: &[u8]) -> Result<(Mesh, Vec<Finding>), Defect> {
    let bytes = text::decoded(bytes);
    let (encoding, elements, body) = header(&bytes)?;
    let mut source =
        Source { encoding, rest: if encoding == Encoding::Text { &[] } else { body.rest }, lines: body, surplus: None };
    let mut vertices = Vec::new();
    // All corners one after the other, and the number of corners of each polygon.
    let (mut corners, mut counts) = (Vec::new(), Vec::new());
    for element in &elements {
        match element.name.as_str() {
            "vertex" => read_vertices(element, &mut source, &mut vertices)?,
            "face" => read_faces(element, &mut source, &mut corners, &mut counts)?,
            "tristrips" => return Err(syntax("triangle strips are not supported; export faces")),
            _ => each(element, &mut source, &[], |_, _| {})?,
        }
    }
    let mut mesh = Mesh { vertices, faces: Vec::new() };
    let mut rest = corners.as_slice();
    for count in counts {
        let (polygon, others) = rest.split_at(count);
        polygon::triangulate(&mesh.vertices, polygon, &mut mesh.faces)?;
        rest = others;
    }
    let surplus = source.surplus.map(|(line, count)| Finding::SurplusNumbers { line, count });
    Ok((mesh, surplus.into_iter().collect()))
}

fn syntax(what: &str) -> Defect {
    Defect::Syntax(what.to_owned())
}

/// Reads the header. Returns the lines after it, too.
fn header(bytes: &[u8]) -> Result<(Encoding, Vec<Element>, Lines<'_>), Defect> {
    let mut lines = Lines::new(bytes);
    if !lines.next().is_some_and(|line| line.trim_ascii().eq_ignore_ascii_case(b"ply")) {
        return Err(syntax("a PLY file begins with \"ply\""));
    }
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    loop {
        let line = lines.next().ok_or_else(|| syntax("the header has no end"))?;
        let bad = || syntax(&format!("line {}: {} is invalid in a header", lines.number, text::quoted(line)));
        let scalar = |name: &str| Scalar::named(name).ok_or_else(bad);
        let line_text = String::from_utf8_lossy(line);
        let words: Vec<&str> = line_text.split_ascii_whitespace().collect();
        let property = match *words {
            ["end_header"] => break,
            [] | ["comment" | "obj_info", ..] => continue,
            ["format", name, "1.0" | "1"] => {
                encoding = Some(match name {
                    "ascii" => Encoding::Text,
                    "binary_little_endian" => Encoding::LittleEndian,
                    "binary_big_endian" => Encoding::BigEndian,
                    _ => return Err(bad()),
                });
                continue;
            }
            ["element", name, count] => {
                let count = count.parse().map_err(|_| bad())?;
                elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
                continue;
            }
            // Some programs write names with spaces.
            ["property", "list", length, item, name, ..] => {
                let kind = Kind::List { length: scalar(length)?, item: scalar(item)? };
                Property { name: name.to_owned(), kind }
            }
            ["property", kind, name, ..] => Property { name: name.to_owned(), kind: Kind::Scalar(scalar(kind)?) },
            _ => return Err(bad()),
        };
        elements.last_mut().ok_or_else(bad)?.properties.push(property);
    }
    let encoding = encoding.ok_or_else(|| syntax("the header names no format"))?;
    // After a header whose lines end with CR alone, LF is the first byte of the data.
    let start = bytes.len() - lines.rest.len();
    if let (false, Some(b'\n'), Some(body)) =
        (bytes[..start - 1].contains(&b'\n'), bytes.get(start - 1), bytes.get(start - 1..))
        && encoding != Encoding::Text
    {
        lines.rest = body;
    }
    Ok((encoding, elements, lines))
}

/// The numbers of the body, one after the other.
struct Source<'a> {
    encoding: Encoding,
    /// Lines of a text, each with one entry.
    lines: Lines<'a>,
    /// Bytes that were not read: of the current line of a text, else of the whole body.
    rest: &'a [u8],
    /// First line of a text with more numbers than its entry has, and the number of such lines.
    surplus: Option<(usize, usize)>,
}

impl Source<'_> {
    /// Begins the next entry. `None` at the end of a text.
    fn begin(&mut self) -> Option<()> {
        if self.encoding == Encoding::Text {
            self.rest = self.lines.find(|line| !line.trim_ascii().is_empty())?;
        }
        Some(())
    }

    /// Ends an entry. The rest of its line is ignored.
    fn end(&mut self) {
        if self.encoding == Encoding::Text && !self.rest.trim_ascii().is_empty() {
            self.surplus.get_or_insert((self.lines.number, 0)).1 += 1;
        }
    }

    fn word(&mut self) -> Option<&[u8]> {
        let text = self.rest.trim_ascii_start();
        let end = text.iter().position(u8::is_ascii_whitespace).unwrap_or(text.len());
        let (word, rest) = text.split_at(end);
        self.rest = rest;
        if word.is_empty() { None } else { Some(word) }
    }

    /// Reads a number. `None` if there is none.
    fn next(&mut self, scalar: Scalar) -> Option<f64> {
        if self.encoding == Encoding::Text {
            return text::number(self.word()?);
        }
        macro_rules! number {
            ($t:ty) => {{
                let (bytes, rest) = self.rest.split_first_chunk()?;
                self.rest = rest;
                let big = self.encoding == Encoding::BigEndian;
                (if big { <$t>::from_be_bytes(*bytes) } else { <$t>::from_le_bytes(*bytes) }) as f64
            }};
        }
        Some(match scalar {
            Scalar::I8 => number!(i8),
            Scalar::U8 => number!(u8),
            Scalar::I16 => number!(i16),
            Scalar::U16 => number!(u16),
            Scalar::I32 => number!(i32),
            Scalar::U32 => number!(u32),
            Scalar::I64 => number!(i64),
            Scalar::U64 => number!(u64),
            Scalar::F32 => number!(f32),
            Scalar::F64 => number!(f64),
        })
    }

    /// Skips numbers, which need not be valid in a text.
    fn skip(&mut self, scalar: Scalar, count: u64) -> Option<()> {
        if self.encoding == Encoding::Text {
            return (0..count).try_for_each(|_| self.word().map(drop));
        }
        let bytes = usize::try_from(count).ok()?.checked_mul(scalar.bytes())?;
        self.rest = self.rest.get(bytes..)?;
        Some(())
    }

    /// Reads the numbers of a property into `numbers`, or skips them.
    fn read(&mut self, kind: &Kind, is_needed: bool, numbers: &mut Vec<f64>) -> Option<()> {
        numbers.clear();
        let (count, item) = match *kind {
            Kind::Scalar(item) => (1, item),
            Kind::List { length, item } => {
                let count = self.next(length).filter(|count| *count >= 0.0 && count.fract() == 0.0)?;
                (count as u64, item)
            }
        };
        if !is_needed {
            return self.skip(item, count);
        }
        (0..count).try_for_each(|_| {
            numbers.push(self.next(item)?);
            Some(())
        })
    }
}

/// Reads every entry of an element and calls `take` with the place and the numbers of each needed property. An entry has at
/// least one byte, so the loop over a hostile count ends with the file.
fn each(
    element: &Element,
    source: &mut Source<'_>,
    needed: &[usize],
    mut take: impl FnMut(usize, &[f64]),
) -> Result<(), Defect> {
    if element.properties.is_empty() && element.count > 0 {
        return Err(syntax(&format!("element \"{}\" has no properties", element.name)));
    }
    let mut numbers = Vec::new();
    for entry in 0..element.count {
        let cut_off = || Defect::WrongLength {
            promised: format!("{} of element \"{}\"", element.count, element.name),
            held: format!("{entry}"),
        };
        source.begin().ok_or_else(cut_off)?;
        let line = source.rest;
        for (place, property) in element.properties.iter().enumerate() {
            let is_needed = needed.contains(&place);
            source.read(&property.kind, is_needed, &mut numbers).ok_or_else(|| match source.encoding {
                Encoding::Text => syntax(&format!(
                    "line {}: {} has no valid {:?} of element \"{}\"; an entry is one line of numbers with decimal points",
                    source.lines.number,
                    text::quoted(line),
                    property.name,
                    element.name
                )),
                _ => cut_off(),
            })?;
            if is_needed {
                take(place, &numbers);
            }
        }
        source.end();
    }
    Ok(())
}

fn read_vertices(element: &Element, source: &mut Source<'_>, vertices: &mut Vec<Vec3>) -> Result<(), Defect> {
    let place = |name: &str| {
        let found = element.properties.iter().position(|p| p.name == name && matches!(p.kind, Kind::Scalar(_)));
        found.ok_or_else(|| syntax(&format!("the vertices have no {name}")))
    };
    let axes = [place("x")?, place("y")?, place("z")?];
    let last = axes.into_iter().max();
    let mut position = [0.0_f32; 3];
    each(element, source, &axes, |place, numbers| {
        for (axis, &at) in axes.iter().enumerate() {
            if let (true, [number]) = (at == place, numbers) {
                position[axis] = *number as f32;
            }
        }
        if Some(place) == last {
            vertices.push(Vec3::from_array(position));
        }
    })
}

/// Reads the corners of all faces, one after the other, and their number for each face.
fn read_faces(
    element: &Element,
    source: &mut Source<'_>,
    corners: &mut Vec<u32>,
    counts: &mut Vec<usize>,
) -> Result<(), Defect> {
    let is_corners = |p: &Property| {
        matches!(p.name.as_str(), "vertex_indices" | "vertex_index" | "vertex_indexes")
            && matches!(p.kind, Kind::List { .. })
    };
    let place = element.properties.iter().position(is_corners);
    let place = place.ok_or_else(|| syntax("the faces have no list vertex_indices"))?;
    each(element, source, &[place], |_, numbers| {
        // A negative or fractional index becomes one out of range, which repair reports.
        let index = |&number: &f64| if number >= 0.0 && number.fract() == 0.0 { number as u32 } else { u32::MAX };
        corners.extend(numbers.iter().map(index));
        counts.push(numbers.len());
    })
}
