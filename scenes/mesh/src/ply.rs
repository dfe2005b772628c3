//! Reader for Stanford PLY: text, binary little-endian and binary big-endian. Allocates memory for the data in the
//! file, never for the counts in the header.

use glam::Vec3;

use crate::error::Defect;
use crate::mesh::Mesh;

/// Number of corners of the largest polygon that is accepted; a longer list is damage.
const MAX_CORNERS: u64 = 1024;

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
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
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

pub(super) fn parse(bytes: &[u8]) -> Result<Mesh, Defect> {
    let (encoding, elements, body) = header(bytes)?;
    let mut values = Values { encoding, rest: body };
    let mut mesh = Mesh::default();
    for element in &elements {
        match element.name.as_str() {
            "vertex" => vertices(element, &mut values, &mut mesh)?,
            "face" => faces(element, &mut values, &mut mesh)?,
            "tristrips" => return Err(syntax("triangle strips are not supported; export faces")),
            _ => each(element, &mut values, |_, _| {})?,
        }
    }
    Ok(mesh)
}

fn syntax(what: &str) -> Defect {
    Defect::Syntax(what.to_owned())
}

fn header(bytes: &[u8]) -> Result<(Encoding, Vec<Element>, &[u8]), Defect> {
    let mut rest = bytes;
    let mut lines = std::iter::from_fn(|| {
        let end = rest.iter().position(|&byte| byte == b'\n')?;
        let (line, after) = rest.split_at(end);
        rest = after.get(1..).unwrap_or_default();
        Some(String::from_utf8_lossy(line).trim().to_owned())
    });
    if lines.next().as_deref() != Some("ply") {
        return Err(syntax("a PLY file begins with \"ply\""));
    }
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    loop {
        let line = lines.next().ok_or_else(|| syntax("the header has no end"))?;
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let bad = || syntax(&format!("header line \"{}\" is invalid", line.chars().take(80).collect::<String>()));
        let scalar = |name: &str| Scalar::named(name).ok_or_else(bad);
        let property = match *words {
            ["end_header"] => break,
            [] | ["comment" | "obj_info", ..] => continue,
            ["format", name, "1.0"] => {
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
            ["property", "list", length, item, name] => {
                let kind = Kind::List { length: scalar(length)?, item: scalar(item)? };
                Property { name: name.to_owned(), kind }
            }
            ["property", kind, name] => Property { name: name.to_owned(), kind: Kind::Scalar(scalar(kind)?) },
            _ => return Err(bad()),
        };
        elements.last_mut().ok_or_else(bad)?.properties.push(property);
    }
    let encoding = encoding.ok_or_else(|| syntax("the header names no format"))?;
    Ok((encoding, elements, rest))
}

/// Reads the numbers of the body one after the other.
struct Values<'a> {
    encoding: Encoding,
    rest: &'a [u8],
}

impl Values<'_> {
    fn next(&mut self, scalar: Scalar) -> Option<f64> {
        if self.encoding == Encoding::Text {
            let text = self.rest.trim_ascii_start();
            let end = text.iter().position(u8::is_ascii_whitespace).unwrap_or(text.len());
            let (word, rest) = text.split_at(end);
            self.rest = rest;
            return std::str::from_utf8(word).ok()?.parse().ok();
        }
        macro_rules! number {
            ($t:ty) => {{
                let (bytes, rest) = self.rest.split_first_chunk()?;
                self.rest = rest;
                let big = self.encoding == Encoding::BigEndian;
                f64::from(if big { <$t>::from_be_bytes(*bytes) } else { <$t>::from_le_bytes(*bytes) })
            }};
        }
        Some(match scalar {
            Scalar::I8 => number!(i8),
            Scalar::U8 => number!(u8),
            Scalar::I16 => number!(i16),
            Scalar::U16 => number!(u16),
            Scalar::I32 => number!(i32),
            Scalar::U32 => number!(u32),
            Scalar::F32 => number!(f32),
            Scalar::F64 => number!(f64),
        })
    }
}

/// Reads every entry of an element and calls `take` with the index and the numbers of each property. An entry has at
/// least one byte, so the loop over a hostile count ends with the file.
fn each(element: &Element, values: &mut Values<'_>, mut take: impl FnMut(usize, &[f64])) -> Result<(), Defect> {
    if element.properties.is_empty() && element.count > 0 {
        return Err(syntax(&format!("element \"{}\" has no properties", element.name)));
    }
    let mut list = Vec::new();
    for entry in 0..element.count {
        let cut_off = || Defect::WrongLength {
            promised: format!("{} of element \"{}\"", element.count, element.name),
            held: format!("{entry}"),
        };
        for (place, property) in element.properties.iter().enumerate() {
            list.clear();
            let (length, item) = match property.kind {
                Kind::Scalar(item) => (1, item),
                Kind::List { length, item } => (values.next(length).ok_or_else(cut_off)? as u64, item),
            };
            if length > MAX_CORNERS {
                return Err(syntax(&format!("a list has {length} entries; the limit is {MAX_CORNERS}")));
            }
            for _ in 0..length {
                list.push(values.next(item).ok_or_else(cut_off)?);
            }
            take(place, &list);
        }
    }
    Ok(())
}

fn vertices(element: &Element, values: &mut Values<'_>, mesh: &mut Mesh) -> Result<(), Defect> {
    let place = |name: &str| {
        let found = element.properties.iter().position(|p| p.name == name && matches!(p.kind, Kind::Scalar(_)));
        found.ok_or_else(|| syntax(&format!("the vertices have no {name}")))
    };
    let axes = [place("x")?, place("y")?, place("z")?];
    let last = element.properties.len() - 1;
    let mut position = [0.0_f32; 3];
    each(element, values, |place, numbers| {
        for (axis, &at) in axes.iter().enumerate() {
            if let (true, [number]) = (at == place, numbers) {
                position[axis] = *number as f32;
            }
        }
        if place == last {
            mesh.vertices.push(Vec3::from_array(position));
        }
    })
}

fn faces(element: &Element, values: &mut Values<'_>, mesh: &mut Mesh) -> Result<(), Defect> {
    let is_corners = |p: &Property| {
        matches!(p.name.as_str(), "vertex_indices" | "vertex_index") && matches!(p.kind, Kind::List { .. })
    };
    let corners = element.properties.iter().position(is_corners);
    let corners = corners.ok_or_else(|| syntax("the faces have no list vertex_indices"))?;
    each(element, values, |place, numbers| {
        // A negative or fractional index becomes one out of range, which repair reports.
        let index = |number: f64| if number >= 0.0 && number.fract() == 0.0 { number as u32 } else { u32::MAX };
        if let (true, [first, fan @ ..]) = (place == corners, numbers) {
            mesh.faces.extend(fan.windows(2).map(|edge| [index(*first), index(edge[0]), index(edge[1])]));
        }
    })
}
