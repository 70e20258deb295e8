//! The tiles of a compressed image, checked before CFITSIO follows them: it takes their lengths and what they unpack to on trust, writes
//! beyond its buffers or leaves them as they were where these are wrong.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};

use flate2::bufread::GzDecoder;

use crate::IoError;
use crate::columns::{Column, columns};
use crate::hdu::Hdu;
use crate::plio;
use crate::tiled::PLIO;

/// RICE_1 takes no fewer bits for a block of pixels.
const RICE_BITS_PER_BLOCK: u64 = 3;
const BUFFER: usize = 1 << 13;

/// Checks the tiles of an image in tiles; other images pass.
pub(crate) fn check(hdu: &Hdu) -> Result<(), IoError> {
    if !hdu.is_tiled() {
        return Ok(());
    }
    let mut tiles = Tiles::open(hdu)?;
    (0..tiles.rows).try_for_each(|row| tiles.check(row))
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Algorithm {
    /// With the pixels of a block.
    Rice(u64),
    Gzip,
    Plio,
}

/// A column of descriptors (number of elements, place in the heap).
#[derive(Clone, Copy)]
struct Descriptors {
    /// Bytes from the start of a row.
    place: usize,
    /// Bytes of each of the two numbers.
    width: usize,
}

struct Tiles<'a> {
    hdu: &'a Hdu,
    file: BufReader<File>,
    algorithm: Algorithm,
    /// Whether floats are kept as they are.
    unquantised: bool,
    /// `ZTILE1` first.
    tile: Vec<usize>,
    row_bytes: usize,
    rows: usize,
    /// Where the heap starts, from the start of the data.
    heap: u64,
    compressed: Descriptors,
    uncompressed: Option<Descriptors>,
    zipped: Option<Descriptors>,
}

impl<'a> Tiles<'a> {
    fn open(hdu: &'a Hdu) -> Result<Self, IoError> {
        let length = |keyword: &str, default| {
            let value = hdu.structural(keyword, default)?;
            usize::try_from(value).map_err(|_| hdu.header_error(keyword, "must not be negative"))
        };
        let (row_bytes, rows) = (length("NAXIS1", None)?, length("NAXIS2", None)?);
        let columns = columns(hdu, row_bytes)?;
        let compressed = descriptors(hdu, &columns, "COMPRESSED_DATA")?
            .ok_or_else(|| hdu.header_error("TTYPE1", "there is no column COMPRESSED_DATA"))?;
        let algorithm = match hdu.text("ZCMPTYPE").as_deref().map(str::trim) {
            Some(PLIO) => Algorithm::Plio,
            Some("GZIP_1" | "GZIP_2") => Algorithm::Gzip,
            // Which of the two parameters is the block has been checked; the larger bound serves.
            _ => Algorithm::Rice(length("ZVAL1", Some(32))?.max(length("ZVAL2", Some(4))?) as u64),
        };
        let has = |name: &str| {
            columns
                .iter()
                .any(|column| column.name.eq_ignore_ascii_case(name))
        };
        let none = hdu.text("ZQUANTIZ").is_some_and(|how| how.trim() == "NONE");
        let table = row_bytes as u64 * rows as u64;
        let heap = match hdu.structural("THEAP", Some(table as i64))? {
            heap if heap >= 0 && heap as u64 >= table => heap as u64,
            _ => return Err(hdu.header_error("THEAP", "must lie behind the rows")),
        };
        let tile = (1..=hdu.axes.len()).map(|axis| {
            let default = if axis == 1 { hdu.axes[0] } else { 1 };
            length(&format!("ZTILE{axis}"), Some(default as i64))
        });
        let file = File::open(hdu.source().file()).map_err(|source| IoError::Read {
            path: hdu.source().path().to_owned(),
            source,
        })?;
        Ok(Self {
            hdu,
            file: BufReader::new(file),
            algorithm,
            unquantised: hdu.bitpix < 0 && (none || !(has("ZSCALE") || has("ZZERO"))),
            tile: tile.collect::<Result<_, _>>()?,
            row_bytes,
            rows,
            heap,
            compressed,
            uncompressed: descriptors(hdu, &columns, "UNCOMPRESSED_DATA")?,
            zipped: descriptors(hdu, &columns, "GZIP_COMPRESSED_DATA")?,
        })
    }

    fn check(&mut self, row: usize) -> Result<(), IoError> {
        let pixels = self.pixels(row);
        let pixel_bytes = self.hdu.bitpix.unsigned_abs() / 8;
        let (count, start) = self.descriptor(row, self.compressed)?;
        let sound = if count > 0 {
            match self.algorithm {
                Algorithm::Plio => !self.unquantised && plio::is_sound(&self.bytes(row, start, count, 2)?),
                Algorithm::Rice(block) => {
                    let most = (count.saturating_mul(8) / RICE_BITS_PER_BLOCK).saturating_mul(block);
                    !self.unquantised && self.holds(start, count, 1) && pixels <= most
                }
                // Floats become whole numbers of 32 bits when they are quantised.
                Algorithm::Gzip => {
                    let bytes = if self.hdu.bitpix > 0 || self.unquantised {
                        pixel_bytes
                    } else {
                        4
                    };
                    self.unpacks_to(start, count, pixels * bytes)?
                }
            }
        } else if let Some(column) = self.uncompressed {
            self.descriptor(row, column)?.0 == pixels
        } else if let Some(column) = self.zipped {
            let (count, start) = self.descriptor(row, column)?;
            self.hdu.bitpix < 0 && self.unpacks_to(start, count, pixels * pixel_bytes)?
        } else {
            false
        };
        if sound { Ok(()) } else { Err(self.broken(row)) }
    }

    /// Pixels of a tile; those at the far edges may be smaller.
    fn pixels(&self, row: usize) -> u64 {
        let mut rest = row;
        let lengths = self.hdu.axes.iter().zip(&self.tile).map(|(&length, &across)| {
            let along = rest % length.div_ceil(across);
            rest /= length.div_ceil(across);
            across.min(length - along * across) as u64
        });
        lengths.product()
    }

    /// How many elements the heap has for a row, and from which byte of the data on.
    fn descriptor(&mut self, row: usize, column: Descriptors) -> Result<(u64, u64), IoError> {
        let mut bytes = [0; 16];
        let bytes = &mut bytes[..2 * column.width];
        self.seek((row * self.row_bytes + column.place) as u64)?;
        self.file.read_exact(bytes).map_err(|e| self.failed(e))?;
        let number = |bytes: &[u8]| bytes.iter().fold(0_u64, |n, &byte| (n << 8) | u64::from(byte));
        let (count, place) = bytes.split_at(column.width);
        Ok((number(count), self.heap.saturating_add(number(place))))
    }

    /// Whether the data go on as far as that.
    fn holds(&self, start: u64, count: u64, width: u64) -> bool {
        start.saturating_add(count.saturating_mul(width)) <= self.hdu.data_length
    }

    fn bytes(&mut self, row: usize, start: u64, count: u64, width: u64) -> Result<Vec<u8>, IoError> {
        if !self.holds(start, count, width) {
            return Err(self.broken(row));
        }
        let mut bytes = vec![0; (count * width) as usize];
        self.seek(start)?;
        self.file.read_exact(&mut bytes).map_err(|e| self.failed(e))?;
        Ok(bytes)
    }

    /// Whether a gzip stream holds as many bytes; it is read no further.
    fn unpacks_to(&mut self, start: u64, count: u64, expected: u64) -> Result<bool, IoError> {
        if !self.holds(start, count, 1) {
            return Ok(false);
        }
        self.seek(start)?;
        let mut stream = GzDecoder::new((&mut self.file).take(count));
        let (mut buffer, mut unpacked) = ([0; BUFFER], 0);
        while unpacked <= expected {
            match stream.read(&mut buffer) {
                Ok(0) => return Ok(unpacked == expected),
                Ok(length) => unpacked += length as u64,
                Err(_) => return Ok(false),
            }
        }
        Ok(false)
    }

    /// Goes to a byte of the data.
    fn seek(&mut self, at: u64) -> Result<(), IoError> {
        let at = self.hdu.data_start.saturating_add(at);
        self.file
            .seek(SeekFrom::Start(at))
            .map(drop)
            .map_err(|e| self.failed(e))
    }

    fn failed(&self, source: std::io::Error) -> IoError {
        IoError::Read {
            path: self.hdu.source().path().to_owned(),
            source,
        }
    }

    fn broken(&self, tile: usize) -> IoError {
        IoError::Tile {
            path: self.hdu.source().path().to_owned(),
            hdu: self.hdu.index,
            tile,
        }
    }
}

/// The column of this name, which must not be there twice.
fn descriptors(hdu: &Hdu, columns: &[Column], name: &str) -> Result<Option<Descriptors>, IoError> {
    let mut place = 0;
    let mut found = None;
    for (index, column) in columns.iter().enumerate() {
        if column.name.eq_ignore_ascii_case(name) {
            let width = match column.code {
                b'P' => 4,
                b'Q' => 8,
                _ => {
                    let keyword = format!("TFORM{}", index + 1);
                    return Err(
                        hdu.header_error(&keyword, "tiles have lengths of their own: P or Q is needed")
                    );
                }
            };
            if column.bytes() != Some(2 * width) || found.is_some() {
                let keyword = format!("TTYPE{}", index + 1);
                return Err(hdu.header_error(&keyword, "there must be one such column, with one tile a row"));
            }
            found = Some(Descriptors { place, width });
        }
        place += column.bytes().expect("columns have been added up");
    }
    Ok(found)
}
