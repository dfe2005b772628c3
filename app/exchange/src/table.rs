//! Rows of Parquet files that other programs wrote.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;

use ::parquet::file::reader::{FileReader, SerializedFileReader};
use ::parquet::record::reader::TreeBuilder;
use ::parquet::record::{Field, Row};
use ::parquet::schema::types::{SchemaDescriptor, Type};

use crate::pages::RowGroup;

/// Longest metadata at the end of a file, bytes.
const LONGEST_FOOTER: u64 = 64 << 20;
/// Rows that are in memory together: a row of images is large.
const BATCH: usize = 8;

/// Value of a cell.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Cell {
    Number(f64),
    Numbers(Vec<f64>),
    Bytes(Vec<u8>),
}

/// Calls `row` for each row of a file with the cells of these columns, `None` for a column or cell that does not exist, until it returns false.
pub(crate) fn read_rows<E: From<String>>(
    path: &Path,
    columns: &[&str],
    row: &mut dyn FnMut(Vec<Option<Cell>>) -> Result<bool, E>,
) -> Result<(), E> {
    let words = |error: &dyn std::fmt::Display| one_line(path, error);
    let file = mvt_files::input::open(path).map_err(|error| words(&error))?;
    check_footer(&file).map_err(|error| words(&error))?;
    // The crate checks most of the file. Other errors end here.
    let guarded = |error| {
        words(&match error {
            Some(error) => error,
            None => "it is damaged".to_owned(),
        })
    };
    let pages = Arc::new(file.try_clone().map_err(|error| words(&error))?);
    let reader = guard(|| SerializedFileReader::new(file)).map_err(guarded)?;
    let schema = reader.metadata().file_metadata().schema();
    let wanted: Vec<_> = schema.get_fields().iter().filter(|field| columns.contains(&field.name())).cloned().collect();
    let projection = Type::group_type_builder("schema").with_fields(wanted).build().map_err(|error| words(&error))?;
    let described = Arc::new(SchemaDescriptor::new(Arc::new(projection)));
    for about in reader.metadata().row_groups() {
        let group = RowGroup::new(Arc::clone(&pages), about);
        let builder = TreeBuilder::new().with_batch_size(BATCH);
        let mut rows = guard(|| builder.as_iter(Arc::clone(&described), &group)).map_err(guarded)?;
        while let Some(found) = guard(|| rows.next().transpose()).map_err(guarded)? {
            if !row(cells(found, columns))? {
                return Ok(());
            }
        }
    }
    Ok(())
}

fn one_line(path: &Path, error: &dyn std::fmt::Display) -> String {
    let text = error.to_string();
    format!("{}: {}", path.display(), text.lines().next().unwrap_or("it is damaged"))
}

/// Runs a part of the reader, and turns a panic into an error without words.
fn guard<T, E: std::fmt::Display>(part: impl FnOnce() -> Result<T, E>) -> Result<T, Option<String>> {
    match catch_unwind(AssertUnwindSafe(part)) {
        Ok(result) => result.map_err(|error| Some(error.to_string())),
        Err(_) => Err(None),
    }
}

/// Refuses a file whose end claims metadata that no file has.
fn check_footer(mut file: &std::fs::File) -> std::io::Result<()> {
    use std::io::{Error, ErrorKind, Read as _, Seek as _, SeekFrom};
    let refused = || Error::new(ErrorKind::InvalidData, "it is no Parquet file, or it is cut off");
    let size = file.seek(SeekFrom::End(0))?;
    if size < 12 {
        return Err(refused());
    }
    file.seek(SeekFrom::End(-8))?;
    let mut end = [0; 8];
    file.read_exact(&mut end)?;
    let [a, b, c, d, magic @ ..] = end;
    let length = u64::from(u32::from_le_bytes([a, b, c, d]));
    file.seek(SeekFrom::Start(0))?;
    if &magic != b"PAR1" || length > LONGEST_FOOTER || length + 12 > size { Err(refused()) } else { Ok(()) }
}

/// Returns the cells of the columns in their order.
fn cells(row: Row, columns: &[&str]) -> Vec<Option<Cell>> {
    let mut found: Vec<Option<Cell>> = vec![None; columns.len()];
    for (name, field) in row.into_columns() {
        for (place, _) in found.iter_mut().zip(columns).filter(|(_, column)| **column == name) {
            *place = cell(&field);
        }
    }
    found
}

fn cell(field: &Field) -> Option<Cell> {
    match field {
        Field::Bytes(bytes) => Some(Cell::Bytes(bytes.data().to_vec())),
        Field::ListInternal(list) => {
            list.elements().iter().map(number).collect::<Option<Vec<f64>>>().map(Cell::Numbers)
        }
        // An image of LeRobot: its file and its name.
        Field::Group(group) => {
            group.get_column_iter().find(|(name, _)| *name == "bytes").and_then(|(_, field)| cell(field))
        }
        other => number(other).map(Cell::Number),
    }
}

fn number(field: &Field) -> Option<f64> {
    Some(match *field {
        Field::Bool(value) => f64::from(u8::from(value)),
        Field::Byte(value) => f64::from(value),
        Field::Short(value) => f64::from(value),
        Field::Int(value) => f64::from(value),
        Field::Long(value) => value as f64,
        Field::UByte(value) => f64::from(value),
        Field::UShort(value) => f64::from(value),
        Field::UInt(value) => f64::from(value),
        Field::ULong(value) => value as f64,
        Field::Float16(value) => f64::from(f32::from(value)),
        Field::Float(value) => f64::from(value),
        Field::Double(value) => value,
        _ => return None,
    })
}
