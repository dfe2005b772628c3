//! Writer of Parquet files: plain, uncompressed pages, of the few types that data sets of LeRobot need.
//! The format is that of <https://parquet.apache.org/docs/file-format>.

// Why: notes/decisions/exchange.md, "Parquet is written by us and read by the crate `parquet`".

use std::io::{self, Write};

const MAGIC: &[u8] = b"PAR1";

/// Values of one column in the rows of a group.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Cells {
    Integers(Vec<i64>),
    Singles(Vec<f32>),
    Doubles(Vec<f64>),
    /// As many numbers in each row as the column says.
    SingleLists(Vec<f32>),
    DoubleLists(Vec<f64>),
    Texts(Vec<String>),
    /// A list of one text in each row.
    TextLists(Vec<String>),
    /// Image files and their names, as Hugging Face's `Image` stores them.
    Images(Vec<(Vec<u8>, String)>),
}

/// Column of a file.
#[derive(Debug, Clone)]
pub(crate) struct Column {
    pub name: String,
    /// Numbers in a row, for lists of numbers.
    pub width: usize,
}

/// Thrift's compact protocol, in which all that describes the data is written.
#[derive(Debug, Clone, Default)]
struct Thrift {
    bytes: Vec<u8>,
    last: i16,
}

const I32: u8 = 5;
const I64: u8 = 6;
const BINARY: u8 = 8;
const LIST: u8 = 9;
const STRUCT: u8 = 12;

impl Thrift {
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }

    fn zigzag(&mut self, value: i64) {
        self.varint(((value << 1) ^ (value >> 63)) as u64);
    }

    fn head(&mut self, field: i16, kind: u8) {
        // Fields are few and written in order, so that the short form is enough.
        self.bytes.push(((field - self.last) as u8) << 4 | kind);
        self.last = field;
    }

    fn i32(mut self, field: i16, value: i64) -> Self {
        self.head(field, I32);
        self.zigzag(value);
        self
    }

    fn i64(mut self, field: i16, value: u64) -> Self {
        self.head(field, I64);
        self.zigzag(value as i64);
        self
    }

    fn counted(&mut self, text: &[u8]) {
        self.varint(text.len() as u64);
        self.bytes.extend(text);
    }

    fn text(mut self, field: i16, text: &str) -> Self {
        self.head(field, BINARY);
        self.counted(text.as_bytes());
        self
    }

    fn of(mut self, field: i16, inner: Self) -> Self {
        self.head(field, STRUCT);
        self.bytes.extend(inner.end());
        self
    }

    fn list(mut self, field: i16, kind: u8, elements: &[Vec<u8>]) -> Self {
        self.head(field, LIST);
        match u8::try_from(elements.len()) {
            Ok(count @ 0..15) => self.bytes.push(count << 4 | kind),
            _ => {
                self.bytes.push(0xf0 | kind);
                self.varint(elements.len() as u64);
            }
        }
        self.bytes.extend(elements.concat());
        self
    }

    fn end(mut self) -> Vec<u8> {
        self.bytes.push(0);
        self.bytes
    }
}

/// Physical types, repetitions and meanings, by their numbers in the format.
const INT64: i64 = 2;
const FLOAT: i64 = 4;
const DOUBLE: i64 = 5;
const BYTE_ARRAY: i64 = 6;
const REQUIRED: i64 = 0;
const REPEATED: i64 = 2;
const UTF8: i64 = 0;
const LIST_OF: i64 = 3;

/// A leaf of the schema with its values in a page.
struct Leaf {
    path: Vec<String>,
    kind: i64,
    values: usize,
    /// Repetition and definition levels, then the values.
    page: Vec<u8>,
}

fn group(name: &str, children: usize, meaning: Option<i64>, repetition: i64) -> Vec<u8> {
    let group = Thrift::default().i32(3, repetition).text(4, name).i32(5, children as i64);
    meaning.map_or(group.clone(), |meaning| group.i32(6, meaning)).end()
}

fn leaf(name: &str, kind: i64, is_text: bool) -> Vec<u8> {
    let leaf = Thrift::default().i32(1, kind).i32(3, REQUIRED).text(4, name);
    if is_text { leaf.i32(6, UTF8).end() } else { leaf.end() }
}

/// Levels of lists with so many elements in each row: the first element of a row has the repetition level 0, all others 1.
fn levels(rows: usize, width: usize) -> Vec<u8> {
    let (mut repetition, mut definition) = (Thrift::default(), Thrift::default());
    for _ in 0..rows {
        repetition.varint(1 << 1);
        repetition.bytes.push(0);
        if width > 1 {
            repetition.varint((width as u64 - 1) << 1);
            repetition.bytes.push(1);
        }
    }
    definition.varint(((rows * width) as u64) << 1);
    definition.bytes.push(1);
    let counted = |levels: Vec<u8>| [&(levels.len() as u32).to_le_bytes()[..], &levels].concat();
    [counted(repetition.bytes), counted(definition.bytes)].concat()
}

fn arrays<'a>(texts: impl Iterator<Item = &'a [u8]>) -> Vec<u8> {
    texts.flat_map(|text| [&(text.len() as u32).to_le_bytes()[..], text].concat()).collect()
}

impl Cells {
    /// Appends cells of the same type; those of another are left out.
    pub fn append(&mut self, more: Self) {
        match (self, more) {
            (Self::Integers(all), Self::Integers(more)) => all.extend(more),
            (Self::Singles(all) | Self::SingleLists(all), Self::Singles(more) | Self::SingleLists(more)) => {
                all.extend(more);
            }
            (Self::Doubles(all) | Self::DoubleLists(all), Self::Doubles(more) | Self::DoubleLists(more)) => {
                all.extend(more);
            }
            (Self::Texts(all) | Self::TextLists(all), Self::Texts(more) | Self::TextLists(more)) => all.extend(more),
            (Self::Images(all), Self::Images(more)) => all.extend(more),
            _ => {}
        }
    }

    /// Returns the elements of the schema that describe a column of this type.
    fn schema(&self, name: &str) -> Vec<Vec<u8>> {
        let list = |kind, is_text| {
            vec![
                group(name, 1, Some(LIST_OF), REQUIRED),
                group("list", 1, None, REPEATED),
                leaf("element", kind, is_text),
            ]
        };
        match self {
            Self::Integers(_) => vec![leaf(name, INT64, false)],
            Self::Singles(_) => vec![leaf(name, FLOAT, false)],
            Self::Doubles(_) => vec![leaf(name, DOUBLE, false)],
            Self::Texts(_) => vec![leaf(name, BYTE_ARRAY, true)],
            Self::SingleLists(_) => list(FLOAT, false),
            Self::DoubleLists(_) => list(DOUBLE, false),
            Self::TextLists(_) => list(BYTE_ARRAY, true),
            Self::Images(_) => {
                vec![group(name, 2, None, REQUIRED), leaf("bytes", BYTE_ARRAY, false), leaf("path", BYTE_ARRAY, true)]
            }
        }
    }

    /// Returns the leaves of the column.
    fn leaves(&self, Column { name, width }: &Column) -> Vec<Leaf> {
        let leaf = |rest: &[&str], kind, values, page| {
            let path = std::iter::once(name.as_str()).chain(rest.iter().copied()).map(str::to_owned).collect();
            Leaf { path, kind, values, page }
        };
        let listed = |kind, values: usize, width: usize, plain: Vec<u8>| {
            let page = [levels(values / width.max(1), width), plain].concat();
            vec![leaf(&["list", "element"], kind, values, page)]
        };
        let singles = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
        let doubles = |values: &[f64]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
        let texts = |texts: &[String]| arrays(texts.iter().map(String::as_bytes));
        match self {
            Self::Integers(values) => {
                vec![leaf(&[], INT64, values.len(), values.iter().flat_map(|value| value.to_le_bytes()).collect())]
            }
            Self::Singles(values) => vec![leaf(&[], FLOAT, values.len(), singles(values))],
            Self::Doubles(values) => vec![leaf(&[], DOUBLE, values.len(), doubles(values))],
            Self::Texts(values) => vec![leaf(&[], BYTE_ARRAY, values.len(), texts(values))],
            Self::SingleLists(values) => listed(FLOAT, values.len(), *width, singles(values)),
            Self::DoubleLists(values) => listed(DOUBLE, values.len(), *width, doubles(values)),
            Self::TextLists(values) => listed(BYTE_ARRAY, values.len(), 1, texts(values)),
            Self::Images(files) => vec![
                leaf(&["bytes"], BYTE_ARRAY, files.len(), arrays(files.iter().map(|(bytes, _)| bytes.as_slice()))),
                leaf(&["path"], BYTE_ARRAY, files.len(), arrays(files.iter().map(|(_, path)| path.as_bytes()))),
            ],
        }
    }
}

/// Writer of a Parquet file, group by group.
pub(crate) struct Parquet<W> {
    file: W,
    length: u64,
    columns: Vec<Column>,
    schema: Vec<Vec<u8>>,
    groups: Vec<Vec<u8>>,
    rows: u64,
}

impl<W: Write> Parquet<W> {
    /// Begins a file with these columns.
    pub fn new(mut file: W, columns: Vec<Column>) -> io::Result<Self> {
        file.write_all(MAGIC)?;
        Ok(Self { file, length: MAGIC.len() as u64, columns, schema: Vec::new(), groups: Vec::new(), rows: 0 })
    }

    /// Writes rows, column by column in the order of the file.
    pub fn push(&mut self, rows: usize, cells: &[Cells]) -> io::Result<()> {
        let (mut chunks, start) = (Vec::new(), self.length);
        if self.schema.is_empty() {
            self.schema.push(group("schema", self.columns.len(), None, REQUIRED));
            let described = cells.iter().zip(&self.columns).flat_map(|(cells, column)| cells.schema(&column.name));
            self.schema.extend(described);
        }
        for Leaf { path, kind, values, page } in
            cells.iter().zip(&self.columns).flat_map(|(cells, column)| cells.leaves(column))
        {
            let (size, at) = (page.len() as i64, self.length);
            // Plain values, levels as runs.
            let numbers = Thrift::default().i32(1, values as i64).i32(2, 0).i32(3, 3).i32(4, 3);
            let header = Thrift::default().i32(1, 0).i32(2, size).i32(3, size).of(5, numbers).end();
            self.file.write_all(&header)?;
            self.file.write_all(&page)?;
            let size = (header.len() + page.len()) as u64;
            self.length += size;
            let integers = |values: &[i64]| {
                let one = |&value: &i64| {
                    let mut one = Thrift::default();
                    one.zigzag(value);
                    one.bytes
                };
                values.iter().map(one).collect::<Vec<_>>()
            };
            let names = path.iter().map(|name| {
                let mut one = Thrift::default();
                one.counted(name.as_bytes());
                one.bytes
            });
            let about = Thrift::default()
                .i32(1, kind)
                .list(2, I32, &integers(&[0, 3]))
                .list(3, BINARY, &names.collect::<Vec<_>>())
                .i32(4, 0)
                .i64(5, values as u64)
                .i64(6, size)
                .i64(7, size)
                .i64(9, at);
            chunks.push(Thrift::default().i64(2, at).of(3, about).end());
        }
        let group = Thrift::default().list(1, STRUCT, &chunks).i64(2, self.length - start).i64(3, rows as u64);
        self.groups.push(group.end());
        self.rows += rows as u64;
        Ok(())
    }

    /// Completes the file. `notes` are keys and values that readers know.
    pub fn finish(mut self, notes: &[(&str, String)]) -> io::Result<()> {
        let pair = |(key, value): &(&str, String)| Thrift::default().text(1, key).text(2, value).end();
        let about = Thrift::default().i32(1, 2).list(2, STRUCT, &self.schema).i64(3, self.rows);
        let about = about.list(4, STRUCT, &self.groups).list(5, STRUCT, &notes.iter().map(pair).collect::<Vec<_>>());
        let footer = about.text(6, "mambavitact").end();
        self.file.write_all(&footer)?;
        self.file.write_all(&(footer.len() as u32).to_le_bytes())?;
        self.file.write_all(MAGIC)?;
        self.file.flush()
    }
}
