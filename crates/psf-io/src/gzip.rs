//! FITS files compressed as a whole by gzip.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::Path;

use flate2::read::MultiGzDecoder;

use crate::fits_source::FitsSource;
use crate::hdu::Hdu;
use crate::scanner::{BLOCK, HeaderRecords};
use crate::unfinished::{Temporary, entries};
use crate::{HeaderCards, IoError};

/// What every gzip file starts with.
pub(crate) const GZIP: &[u8] = b"\x1f\x8b";
/// A file may unpack to this many bytes whatever its own size (1 GiB), as masks of one value do ...
const ALWAYS_ALLOWED: u64 = 1 << 30;
/// ... and to so many bytes more for each of its own: images shrink to a half or a tenth, those of few values to a hundredth.
const ALLOWED_PER_BYTE: u64 = 100;
const BUFFER: usize = 1 << 16;

/// The first bytes of what a gzip file holds, at most `count`.
pub(crate) fn first_bytes(path: &Path, count: usize) -> Result<Vec<u8>, IoError> {
    let mut unpacker = Unpacker::open(path)?;
    let mut bytes = vec![0; count];
    let length = unpacker.read_up_to(&mut bytes)?;
    bytes.truncate(length);
    Ok(bytes)
}

/// Unpacks a FITS file to a temporary one. Headers are read on the way: what would be larger than allowed, or holds less than its headers
/// say, is refused before it fills the disk.
pub(crate) fn unpack(path: &Path) -> Result<Temporary, IoError> {
    let source = FitsSource::plain(path);
    let failed = |source| IoError::Unpacking {
        path: path.to_owned(),
        source,
    };
    let mut unpacker = Unpacker::open(path)?;
    let mut entries = entries();
    let copy = tempfile::Builder::new()
        .prefix("psfield-")
        .suffix(".fits")
        .tempfile()
        .map_err(failed)?;
    let (file, copy) = copy.into_parts();
    let copy = entries.keep(copy, None);
    drop(entries);
    let mut out = BufWriter::with_capacity(BUFFER, file);
    let mut buffer = vec![0; BUFFER];
    let mut index = 0;
    loop {
        let mut header = HeaderRecords::new(path, index);
        let mut block = [0; BLOCK as usize];
        loop {
            let start = unpacker.done;
            let length = unpacker.read_up_to(&mut block)?;
            let hdu_starts = header.is_empty() && index > 0;
            if hdu_starts && !block[..length].starts_with(b"XTENSION") {
                // What follows the last HDU belongs to none; it is read for gzip's check sum alone.
                unpacker.drain(&mut buffer)?;
                out.flush().map_err(failed)?;
                return Ok(copy);
            }
            if length < block.len() {
                return Err(unpacker.truncated(index, start + BLOCK));
            }
            out.write_all(&block).map_err(failed)?;
            if header.push(&block)? {
                break;
            }
        }
        let hdu = Hdu::new(&source, index, HeaderCards::from_records(header.into_records()))?;
        let length = hdu.padded_length()?;
        let end = unpacker.done.saturating_add(length);
        unpacker.check(end)?;
        let mut left = length;
        while left > 0 {
            let part = &mut buffer[..left.min(BUFFER as u64) as usize];
            let got = unpacker.read_up_to(part)?;
            if got < part.len() {
                return Err(unpacker.truncated(index, end));
            }
            out.write_all(part).map_err(failed)?;
            left -= got as u64;
        }
        index += 1;
    }
}

/// The stream of what a gzip file holds, and how far it has been read.
struct Unpacker<'a> {
    path: &'a Path,
    stream: MultiGzDecoder<BufReader<File>>,
    done: u64,
    /// Bytes of the compressed file.
    length: u64,
}

impl<'a> Unpacker<'a> {
    fn open(path: &'a Path) -> Result<Self, IoError> {
        let failed = |source| IoError::Read {
            path: path.to_owned(),
            source,
        };
        let file = File::open(path).map_err(failed)?;
        let length = file.metadata().map_err(failed)?.len();
        Ok(Self {
            path,
            stream: MultiGzDecoder::new(BufReader::new(file)),
            done: 0,
            length,
        })
    }

    /// Fills the buffer, or as much of it as there is left.
    fn read_up_to(&mut self, buffer: &mut [u8]) -> Result<usize, IoError> {
        let mut filled = 0;
        while filled < buffer.len() {
            match self.stream.read(&mut buffer[filled..]) {
                Ok(0) => break,
                Ok(length) => filled += length,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(source) => {
                    return Err(IoError::Gzip {
                        path: self.path.to_owned(),
                        at: self.done + filled as u64,
                        source,
                    });
                }
            }
        }
        self.done += filled as u64;
        Ok(filled)
    }

    /// Reads to the end.
    fn drain(&mut self, buffer: &mut [u8]) -> Result<(), IoError> {
        while self.read_up_to(buffer)? > 0 {
            self.check(self.done)?;
        }
        Ok(())
    }

    /// Whether the file may unpack to so many bytes.
    fn check(&self, bytes: u64) -> Result<(), IoError> {
        let allowed = ALWAYS_ALLOWED.saturating_add(self.length.saturating_mul(ALLOWED_PER_BYTE));
        if bytes <= allowed {
            return Ok(());
        }
        Err(IoError::UnpacksTooLarge {
            path: self.path.to_owned(),
            length: self.length,
            allowed,
        })
    }

    fn truncated(&self, hdu: usize, needed: u64) -> IoError {
        IoError::Truncated {
            path: self.path.to_owned(),
            hdu,
            needed,
            length: self.done,
        }
    }
}
