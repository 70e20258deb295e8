//! Reads the headers of a FITS file one after the other, and unpacks gzip files.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;

use flate2::read::MultiGzDecoder;

use crate::error::{IoError, IoErrorKind, Place, unreadable};
use crate::fits::card::{RECORD, Record};
use crate::fits::hdu::{BLOCK, FitsSource, Hdu};
use crate::fits::header_cards::HeaderCards;
use crate::fits::tiles;
use crate::output::temporary::{Temporary, entries};

/// If a header has no END in this many blocks (20 MB), the END counts as missing.
const HEADER_BLOCK_LIMIT: usize = 7000;

/// A block of a file.
type Block = [u8; BLOCK as usize];

/// Reads a header up to the block with its END, and makes its HDU. `next` reads a block.
fn read_header(
    source: &FitsSource,
    hdu: usize,
    mut next: impl FnMut(&mut Block) -> Result<(), IoError>,
) -> Result<Hdu, IoError> {
    let mut records: Vec<Record> = Vec::new();
    let mut block = [0; BLOCK as usize];
    for _ in 0..HEADER_BLOCK_LIMIT {
        next(&mut block)?;
        for record in block.chunks_exact(RECORD) {
            if record.starts_with(b"END     ") {
                let mut hdu = Hdu::new(source, hdu, HeaderCards::from_records(records))?;
                tiles::count_as_image(&mut hdu)?;
                return Ok(hdu);
            }
            records.push(record.try_into().expect("80 bytes"));
        }
    }
    let keyword = "END".to_owned();
    let problem = format!(
        "the keyword is missing in the first {HEADER_BLOCK_LIMIT} blocks of 2880 bytes: longer headers are not read"
    );
    Err(IoError::new(source.path(), IoErrorKind::Header, problem).at(Place::Keyword { hdu, keyword }))
}

/// Reads the headers of a file one after the other.
pub(crate) struct Scanner<'a> {
    source: &'a FitsSource,
    file: File,
    length: u64,
    offset: u64,
}

impl<'a> Scanner<'a> {
    pub(crate) fn open(source: &'a FitsSource) -> Result<Self, IoError> {
        let failed = unreadable(source.path());
        let file = File::open(source.file()).map_err(failed)?;
        let length = file.metadata().map_err(failed)?.len();
        Ok(Self {
            source,
            file,
            length,
            offset: 0,
        })
    }

    /// Returns whether another HDU starts at the current offset. Anything else that follows
    /// (padding, special records) is ignored.
    pub(crate) fn next_hdu_starts(&mut self, hdu: usize) -> Result<bool, IoError> {
        if hdu == 0 {
            return Ok(true);
        }
        if self.offset >= self.length {
            return Ok(false);
        }
        let failed = unreadable(self.source.path());
        let mut start = Vec::new();
        self.file.seek(SeekFrom::Start(self.offset)).map_err(failed)?;
        (&self.file).take(8).read_to_end(&mut start).map_err(failed)?;
        Ok(b"XTENSION".starts_with(&start))
    }

    /// Reads the header at the current offset and moves the offset to the end of the HDU's data.
    pub(crate) fn read_hdu(&mut self, index: usize) -> Result<Hdu, IoError> {
        let failed = unreadable(self.source.path());
        self.file.seek(SeekFrom::Start(self.offset)).map_err(failed)?;
        let mut hdu = read_header(self.source, index, |block| {
            self.offset = self.checked_end(index, BLOCK)?;
            self.file.read_exact(block).map_err(failed)
        })?;
        hdu.data_start = self.offset;
        self.offset = self.checked_end(index, hdu.padded_length()?)?;
        Ok(hdu)
    }

    /// The offset after the next `count` bytes, which the file must have.
    fn checked_end(&self, index: usize, count: u64) -> Result<u64, IoError> {
        let end = self.offset.saturating_add(count);
        if end > self.length {
            return Err(truncated(self.source.path(), index, end, self.length));
        }
        Ok(end)
    }
}

/// The error for an HDU in a file that ends too early, after `length` bytes.
fn truncated(path: &Path, hdu: usize, needed: u64, length: u64) -> IoError {
    let message = format!(
        "the file is cut short: at least {needed} bytes are needed, but there are {length}. Fetch or write it again"
    );
    IoError::new(path, IoErrorKind::Damaged, message).at(Place::Hdu(hdu))
}

/// The first bytes of every gzip file.
pub(crate) const GZIP: &[u8] = b"\x1f\x8b";
/// A gzip file of any size may unpack to this many bytes (1 GiB), because an image whose pixels are
/// all equal shrinks to almost nothing.
const ALWAYS_ALLOWED: u64 = 1 << 30;
/// In addition, a gzip file may unpack to this many bytes for each of its own bytes. Images shrink
/// to a half or a tenth, and images with few different values to a hundredth.
const ALLOWED_PER_BYTE: u64 = 100;
const BUFFER: usize = 1 << 16;

/// The first bytes of the unpacked content of a gzip file, at most `count`.
pub(crate) fn first_bytes(path: &Path, count: usize) -> Result<Vec<u8>, IoError> {
    let mut unpacker = Unpacker::open(path)?;
    let mut bytes = vec![0; count];
    let length = unpacker.read_up_to(&mut bytes)?;
    bytes.truncate(length);
    Ok(bytes)
}

/// Unpacks a FITS file to a temporary file. The headers are checked while it is unpacked, so a file
/// that is too large, or too short for its headers, is refused before it fills the disk.
pub(crate) fn unpack(path: &Path) -> Result<Temporary, IoError> {
    let source = FitsSource::new(path, None);
    let failed = |source| {
        const UNPACKING: &str =
            "cannot unpack to the temporary folder: set TMPDIR to a writable folder with enough space";
        IoError::new(path, IoErrorKind::Write, UNPACKING).because(source)
    };
    let mut unpacker = Unpacker::open(path)?;
    let mut entries = entries();
    let copy = tempfile::Builder::new()
        .prefix("psfield-")
        .suffix(".fits")
        .tempfile()
        .map_err(failed)?;
    let (file, copy) = copy.into_parts();
    let copy = Temporary::new(copy, None, &mut entries);
    drop(entries);
    let mut out = BufWriter::with_capacity(BUFFER, file);
    let mut buffer = vec![0; BUFFER];
    let mut index = 0;
    loop {
        let mut first = [0; BLOCK as usize];
        let length = unpacker.read_up_to(&mut first)?;
        if index > 0 && !first[..length].starts_with(b"XTENSION") {
            // No other HDU follows. The rest is not copied, but it is read all the same,
            // because gzip checks its checksum at the end.
            unpacker.drain(&mut buffer)?;
            out.flush().map_err(failed)?;
            return Ok(copy);
        }
        let mut first = Some((first, length));
        let hdu = read_header(&source, index, |block| {
            let length = match first.take() {
                None => unpacker.read_up_to(block)?,
                Some((first, length)) => {
                    *block = first;
                    length
                }
            };
            if length < block.len() {
                let needed = unpacker.done - length as u64 + BLOCK;
                return Err(truncated(path, index, needed, unpacker.done));
            }
            out.write_all(block).map_err(failed)
        })?;
        let length = hdu.padded_length()?;
        let end = unpacker.done.saturating_add(length);
        unpacker.check(end)?;
        let mut left = length;
        while left > 0 {
            let part = &mut buffer[..left.min(BUFFER as u64) as usize];
            let got = unpacker.read_up_to(part)?;
            if got < part.len() {
                return Err(truncated(path, index, end, unpacker.done));
            }
            out.write_all(part).map_err(failed)?;
            left -= got as u64;
        }
        index += 1;
    }
}

/// The stream of the unpacked content of a gzip file.
struct Unpacker<'a> {
    path: &'a Path,
    stream: MultiGzDecoder<BufReader<File>>,
    /// Number of unpacked bytes so far.
    done: u64,
    /// Length of the compressed file in bytes.
    length: u64,
}

impl<'a> Unpacker<'a> {
    fn open(path: &'a Path) -> Result<Self, IoError> {
        let failed = unreadable(path);
        let file = File::open(path).map_err(failed)?;
        let length = file.metadata().map_err(failed)?.len();
        Ok(Self {
            path,
            stream: MultiGzDecoder::new(BufReader::new(file)),
            done: 0,
            length,
        })
    }

    /// Fills the buffer, or as much of it as the stream still has bytes for.
    fn read_up_to(&mut self, buffer: &mut [u8]) -> Result<usize, IoError> {
        let mut filled = 0;
        while filled < buffer.len() {
            match self.stream.read(&mut buffer[filled..]) {
                Ok(0) => break,
                Ok(length) => filled += length,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(source) => {
                    let message = format!(
                        "the gzip data are damaged or cut short after {} unpacked bytes: fetch or write the file again",
                        self.done + filled as u64
                    );
                    return Err(IoError::new(self.path, IoErrorKind::Damaged, message).because(source));
                }
            }
        }
        self.done += filled as u64;
        Ok(filled)
    }

    /// Reads the rest of the stream.
    fn drain(&mut self, buffer: &mut [u8]) -> Result<(), IoError> {
        while self.read_up_to(buffer)? > 0 {
            self.check(self.done)?;
        }
        Ok(())
    }

    /// Returns an error if `bytes` unpacked bytes are more than a file of this length is allowed to
    /// give.
    fn check(&self, bytes: u64) -> Result<(), IoError> {
        let allowed = ALWAYS_ALLOWED.saturating_add(self.length.saturating_mul(ALLOWED_PER_BYTE));
        if bytes <= allowed {
            return Ok(());
        }
        let message = format!(
            "{} bytes of gzip data would unpack to more than {allowed} bytes: if the file is really so large, run gunzip first",
            self.length
        );
        Err(IoError::new(self.path, IoErrorKind::Limit, message))
    }
}
