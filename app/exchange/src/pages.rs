//! Pages of Parquet files in the compressions that other programs choose. The crate `parquet` reads them only with C code or a second copy of a
//! decoder.

use std::fs::File;
use std::io::Read;
use std::sync::Arc;

use ::parquet::basic::Compression;
use ::parquet::bloom_filter::Sbbf;
use ::parquet::column::page::{Page, PageMetadata, PageReader};
use ::parquet::errors::{ParquetError, Result};
use ::parquet::file::metadata::RowGroupMetaData;
use ::parquet::file::reader::RowGroupReader;
use ::parquet::file::serialized_reader::SerializedPageReader;
use ::parquet::record::reader::RowIter;
use ::parquet::schema::types::Type;
use mvt_bag::zstd;

/// Greatest size of a page, bytes: a page of images is larger than others.
const LARGEST: u64 = 256 << 20;

/// Group of rows of a file.
pub(crate) struct RowGroup<'a> {
    file: Arc<File>,
    about: &'a RowGroupMetaData,
}

impl<'a> RowGroup<'a> {
    pub fn new(file: Arc<File>, about: &'a RowGroupMetaData) -> Self {
        Self { file, about }
    }
}

impl RowGroupReader for RowGroup<'_> {
    fn metadata(&self) -> &RowGroupMetaData {
        self.about
    }

    fn num_columns(&self) -> usize {
        self.about.num_columns()
    }

    fn get_column_page_reader(&self, column: usize) -> Result<Box<dyn PageReader>> {
        let about = self.about.column(column);
        let rows = self.about.num_rows() as usize;
        let compression = about.compression();
        let open = |about| SerializedPageReader::new(Arc::clone(&self.file), about, rows, None);
        if matches!(compression, Compression::UNCOMPRESSED | Compression::SNAPPY) {
            return Ok(Box::new(open(about)?));
        }
        // The pages come as they are in the file.
        let packed = about.clone().into_builder().set_compression(Compression::UNCOMPRESSED).build()?;
        Ok(Box::new(Pages { packed: open(&packed)?, compression }))
    }

    fn get_column_bloom_filter(&self, _: usize) -> Option<&Sbbf> {
        None
    }

    fn get_row_iter(&self, projection: Option<Type>) -> Result<RowIter<'_>> {
        RowIter::from_row_group(projection, self)
    }
}

/// Pages of a column.
struct Pages {
    packed: SerializedPageReader<File>,
    compression: Compression,
}

/// Returns plain bytes; the first ones are not compressed.
fn plain(compression: Compression, bytes: &[u8], first: usize) -> Result<Vec<u8>> {
    let (first, packed) = bytes.split_at_checked(first).ok_or_else(|| ParquetError::General("a page is cut".into()))?;
    let mut plain = first.to_vec();
    if packed.is_empty() {
        return Ok(plain);
    }
    let failed = |error: &dyn std::fmt::Display| ParquetError::General(error.to_string());
    let mut read = |from: &mut dyn Read| from.take(LARGEST).read_to_end(&mut plain).map_err(|error| failed(&error));
    match compression {
        Compression::ZSTD(_) => read(&mut zstd(packed).map_err(|error| failed(&error))?),
        Compression::GZIP(_) => read(&mut flate2::read::MultiGzDecoder::new(packed)),
        Compression::BROTLI(_) => read(&mut brotli_decompressor::Decompressor::new(packed, 1 << 14)),
        other => Err(ParquetError::General(format!(
            "its compression {other} is unknown; write it with snappy, gzip, zstd or brotli"
        ))),
    }?;
    if plain.len() as u64 >= LARGEST { Err(ParquetError::General("a page is too large".into())) } else { Ok(plain) }
}

impl Iterator for Pages {
    type Item = Result<Page>;

    fn next(&mut self) -> Option<Self::Item> {
        self.get_next_page().transpose()
    }
}

impl PageReader for Pages {
    fn get_next_page(&mut self) -> Result<Option<Page>> {
        let mut page = self.packed.get_next_page()?;
        let packed = match &mut page {
            Some(Page::DataPage { buf, .. } | Page::DictionaryPage { buf, .. }) => Some((buf, 0)),
            Some(Page::DataPageV2 { buf, def_levels_byte_len, rep_levels_byte_len, is_compressed: true, .. }) => {
                Some((buf, def_levels_byte_len.saturating_add(*rep_levels_byte_len)))
            }
            _ => None,
        };
        if let Some((buf, levels)) = packed {
            *buf = plain(self.compression, buf, levels as usize)?.into();
        }
        Ok(page)
    }

    fn peek_next_page(&mut self) -> Result<Option<PageMetadata>> {
        self.packed.peek_next_page()
    }

    fn skip_next_page(&mut self) -> Result<()> {
        self.packed.skip_next_page()
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use ::parquet::basic::{BrotliLevel, GzipLevel, ZstdLevel};

    use super::*;

    #[test]
    fn bytes_are_plain_whatever_their_compression() {
        let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        gzip.write_all(b"hello").unwrap();
        let levels = (ZstdLevel::default(), GzipLevel::default(), BrotliLevel::default());
        for (compression, packed) in [
            // A frame with one block that is not compressed.
            (Compression::ZSTD(levels.0), b"\x28\xb5\x2f\xfd\x00\x58\x29\x00\x00hello".to_vec()),
            (Compression::GZIP(levels.1), gzip.finish().unwrap()),
            // A block that is not compressed, and an empty last one.
            (Compression::BROTLI(levels.2), b"\x0b\x02\x80hello\x03".to_vec()),
        ] {
            assert_eq!(plain(compression, &packed, 0).unwrap(), b"hello", "{compression}");
            let led = [b"12", packed.as_slice()].concat();
            assert_eq!(plain(compression, &led, 2).unwrap(), b"12hello", "{compression}");
            assert_eq!(plain(compression, b"12", 2).unwrap(), b"12");
            assert!(plain(compression, &packed[..packed.len() / 2], 0).is_err(), "{compression}");
            assert!(plain(compression, b"1", 2).is_err());
        }
        assert!(plain(Compression::LZO, b"12", 0).unwrap_err().to_string().contains("LZO is unknown"));
    }
}
