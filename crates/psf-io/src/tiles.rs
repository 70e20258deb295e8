//! The tiles of a compressed image, checked before CFITSIO follows them: it takes their lengths and what they unpack to on trust, writes
//! beyond its buffers or leaves them as they were where these are wrong.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek};

use flate2::bufread::GzDecoder;

use crate::columns::{Column, columns};
use crate::hdu::Hdu;
use crate::plio;
use crate::rice::Rice;
use crate::tiled::PLIO;
use crate::{Card, CardValue, IoError};

const BUFFER: usize = 1 << 13;
/// What is read ahead of the tiles, which mostly lie one after the other.
const HEAP_BUFFER: usize = 1 << 16;

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
    Rice(Rice),
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
    /// The file for the rows, and once more for the tiles: each goes on where it was.
    table: Places,
    packed: Places,
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
        let algorithm = match hdu.text("ZCMPTYPE").as_deref().map(str::trim) {
            Some(PLIO) => Algorithm::Plio,
            Some("GZIP_1" | "GZIP_2") => Algorithm::Gzip,
            _ => Algorithm::Rice(Rice::of(hdu)?),
        };
        let element = if algorithm == Algorithm::Plio { b'I' } else { b'B' };
        let compressed = descriptors(hdu, &columns, "COMPRESSED_DATA", Some(element))?
            .ok_or_else(|| hdu.header_error("TTYPE1", "there is no column COMPRESSED_DATA"))?;
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
        let places = |buffer| Places::open(hdu, buffer).map_err(|e| failed(hdu, e));
        Ok(Self {
            hdu,
            table: places(BUFFER)?,
            packed: places(HEAP_BUFFER)?,
            algorithm,
            unquantised: hdu.bitpix < 0 && (none || !(has("ZSCALE") || has("ZZERO"))),
            tile: tile.collect::<Result<_, _>>()?,
            row_bytes,
            rows,
            heap,
            compressed,
            uncompressed: descriptors(hdu, &columns, "UNCOMPRESSED_DATA", None)?,
            zipped: descriptors(hdu, &columns, "GZIP_COMPRESSED_DATA", Some(b'B'))?,
        })
    }

    fn check(&mut self, row: usize) -> Result<(), IoError> {
        let pixels = self.pixels(row);
        let pixel_bytes = self.hdu.bitpix.unsigned_abs() / 8;
        let (count, start) = self.descriptor(row, self.compressed)?;
        let sound = if count > 0 {
            match self.algorithm {
                Algorithm::Plio => !self.unquantised && plio::is_sound(&self.bytes(row, start, count, 2)?),
                Algorithm::Rice(rice) => {
                    !self.unquantised && rice.is_sound(&self.bytes(row, start, count, 1)?, pixels)
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
        let place = (row * self.row_bytes + column.place) as u64;
        let read = self.table.seek(place).and_then(|file| file.read_exact(bytes));
        read.map_err(|e| failed(self.hdu, e))?;
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
        let read = self
            .packed
            .seek(start)
            .and_then(|file| file.read_exact(&mut bytes));
        read.map_err(|e| failed(self.hdu, e))?;
        Ok(bytes)
    }

    /// Whether a gzip stream holds as many bytes; it is read no further.
    fn unpacks_to(&mut self, start: u64, count: u64, expected: u64) -> Result<bool, IoError> {
        if !self.holds(start, count, 1) {
            return Ok(false);
        }
        let file = self.packed.seek(start).map_err(|e| failed(self.hdu, e))?;
        let mut stream = GzDecoder::new(file.take(count));
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

    fn broken(&self, tile: usize) -> IoError {
        IoError::Tile {
            path: self.hdu.source().path().to_owned(),
            hdu: self.hdu.index,
            tile,
        }
    }
}

fn failed(hdu: &Hdu, source: io::Error) -> IoError {
    IoError::Read {
        path: hdu.source().path().to_owned(),
        source,
    }
}

/// The data of an HDU, in which places are sought.
struct Places {
    file: BufReader<File>,
    /// Where the data start.
    start: u64,
}

impl Places {
    fn open(hdu: &Hdu, buffer: usize) -> io::Result<Self> {
        let file = File::open(hdu.source().file())?;
        Ok(Self {
            file: BufReader::with_capacity(buffer, file),
            start: hdu.data_start,
        })
    }

    /// Goes to a byte of the data, and keeps what has been read ahead.
    fn seek(&mut self, at: u64) -> io::Result<&mut BufReader<File>> {
        let ahead = i128::from(self.start) + i128::from(at) - i128::from(self.file.stream_position()?);
        let ahead = i64::try_from(ahead).map_err(|_| io::ErrorKind::InvalidInput)?;
        self.file.seek_relative(ahead)?;
        Ok(&mut self.file)
    }
}

/// The column of this name, which must not be there twice. Where elements are told, it holds them as they are: CFITSIO would convert others,
/// and follow what has not been checked.
fn descriptors(
    hdu: &Hdu,
    columns: &[Column],
    name: &str,
    element: Option<u8>,
) -> Result<Option<Descriptors>, IoError> {
    let mut place = 0;
    let mut found = None;
    for (index, column) in columns.iter().enumerate() {
        if column.name.eq_ignore_ascii_case(name) {
            let keyword = |stem: &str| format!("{stem}{}", index + 1);
            let width = match column.code {
                b'P' => 4,
                b'Q' => 8,
                _ => {
                    return Err(hdu.header_error(
                        &keyword("TFORM"),
                        "tiles have lengths of their own: P or Q is needed",
                    ));
                }
            };
            if column.bytes() != Some(2 * width) || found.is_some() {
                return Err(hdu.header_error(
                    &keyword("TTYPE"),
                    "there must be one such column, with one tile a row",
                ));
            }
            if element.is_some_and(|element| column.element() != Some(element)) {
                return Err(hdu.header_error(
                    &keyword("TFORM"),
                    "compressed tiles are of bytes (1PB, 1QB), or of 16-bit words in PLIO_1 (1PI, 1QI)",
                ));
            }
            for (stem, neutral) in [("TSCAL", 1.0), ("TZERO", 0.0)] {
                if element.is_some() && !is_number(hdu, &keyword(stem), neutral) {
                    return Err(hdu.header_error(&keyword(stem), "compressed tiles are not scaled"));
                }
            }
            found = Some(Descriptors { place, width });
        }
        place += column.bytes().expect("columns have been added up");
    }
    Ok(found)
}

/// Whether the keyword has this value, or is not there.
fn is_number(hdu: &Hdu, keyword: &str, expected: f64) -> bool {
    match hdu.header.get(keyword).map(Card::value) {
        None => true,
        Some(Some(CardValue::Real(value))) => value == expected,
        Some(Some(CardValue::Integer(value))) => value as f64 == expected,
        Some(_) => false,
    }
}
