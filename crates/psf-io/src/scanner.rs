//! The headers of a FITS file, one after the other.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use crate::card::{RECORD, Record};
use crate::fits_source::FitsSource;
use crate::hdu::Hdu;
use crate::{HeaderCards, IoError};

/// FITS files are made of blocks of this many bytes.
pub(crate) const BLOCK: u64 = 2880;
/// A header longer than this many blocks (20 MB) has lost its END.
const HEADER_BLOCK_LIMIT: usize = 7000;

/// The records of a header, block by block.
pub(crate) struct HeaderRecords<'a> {
    path: &'a Path,
    hdu: usize,
    records: Vec<Record>,
    blocks: usize,
}

impl<'a> HeaderRecords<'a> {
    pub(crate) fn new(path: &'a Path, hdu: usize) -> Self {
        Self {
            path,
            hdu,
            records: Vec::new(),
            blocks: 0,
        }
    }

    /// Whether no block has come yet.
    pub(crate) fn is_empty(&self) -> bool {
        self.blocks == 0
    }

    /// Takes the next block; true when the header ends in it.
    pub(crate) fn push(&mut self, block: &[u8; BLOCK as usize]) -> Result<bool, IoError> {
        self.blocks += 1;
        for record in block.chunks_exact(RECORD) {
            if record.starts_with(b"END     ") {
                return Ok(true);
            }
            self.records.push(record.try_into().expect("80 bytes"));
        }
        if self.blocks < HEADER_BLOCK_LIMIT {
            return Ok(false);
        }
        Err(IoError::Header {
            path: self.path.to_owned(),
            hdu: self.hdu,
            keyword: "END".to_owned(),
            problem: "the header does not end",
        })
    }

    /// The records without END.
    pub(crate) fn into_records(self) -> Vec<Record> {
        self.records
    }
}

/// Walks over a file, header by header.
pub(crate) struct Scanner<'a> {
    source: &'a FitsSource,
    file: File,
    length: u64,
    offset: u64,
}

impl<'a> Scanner<'a> {
    pub(crate) fn open(source: &'a FitsSource) -> Result<Self, IoError> {
        let failed = |error| IoError::Read {
            path: source.path().to_owned(),
            source: error,
        };
        let file = File::open(source.file()).map_err(failed)?;
        let length = file.metadata().map_err(failed)?.len();
        Ok(Self {
            source,
            file,
            length,
            offset: 0,
        })
    }

    fn failed(&self, source: std::io::Error) -> IoError {
        IoError::Read {
            path: self.source.path().to_owned(),
            source,
        }
    }

    /// Whether another HDU starts here; what is not one (padding, records of old) is left alone.
    pub(crate) fn next_hdu_starts(&mut self, hdu: usize) -> Result<bool, IoError> {
        if hdu == 0 {
            return Ok(true);
        }
        if self.offset >= self.length {
            return Ok(false);
        }
        let mut start = Vec::new();
        self.file
            .seek(SeekFrom::Start(self.offset))
            .map_err(|e| self.failed(e))?;
        (&self.file)
            .take(8)
            .read_to_end(&mut start)
            .map_err(|e| self.failed(e))?;
        Ok(b"XTENSION".starts_with(&start))
    }

    /// Reads the header at the offset and moves the offset behind the data.
    pub(crate) fn read_hdu(&mut self, index: usize) -> Result<Hdu, IoError> {
        let header = self.read_header(index)?;
        let mut hdu = Hdu::new(self.source, index, header)?;
        hdu.data_start = self.offset;
        let needed = self.offset.saturating_add(hdu.padded_length()?);
        if needed > self.length {
            return Err(self.truncated(index, needed));
        }
        self.offset = needed;
        Ok(hdu)
    }

    fn read_header(&mut self, index: usize) -> Result<HeaderCards, IoError> {
        self.file
            .seek(SeekFrom::Start(self.offset))
            .map_err(|e| self.failed(e))?;
        let mut header = HeaderRecords::new(self.source.path(), index);
        let mut block = [0; BLOCK as usize];
        loop {
            if self.offset + BLOCK > self.length {
                return Err(self.truncated(index, self.offset + BLOCK));
            }
            self.file.read_exact(&mut block).map_err(|e| self.failed(e))?;
            self.offset += BLOCK;
            if header.push(&block)? {
                return Ok(HeaderCards::from_records(header.into_records()));
            }
        }
    }

    fn truncated(&self, hdu: usize, needed: u64) -> IoError {
        IoError::Truncated {
            path: self.source.path().to_owned(),
            hdu,
            needed,
            length: self.length,
        }
    }
}
