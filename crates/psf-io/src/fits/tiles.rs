//! Checks the tiles of a compressed image before CFITSIO unpacks them. CFITSIO does not check their
//! lengths or their unpacked sizes. If these are wrong, CFITSIO writes beyond its buffers or leaves
//! them uninitialised.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek};

use flate2::bufread::GzDecoder;

use crate::error::{IoError, IoErrorKind, Place, unreadable};
use crate::fits::card::Card;
use crate::fits::columns::{Column, columns};
use crate::fits::hdu::{Hdu, HduKind};
use crate::fits::tile_codes::{Rice, is_sound_plio};

const BUFFER: usize = 1 << 13;
/// Size of the buffer for reading tiles, in bytes. Most tiles lie one after the other, so one read
/// of the file serves several tiles.
const HEAP_BUFFER: usize = 1 << 16;

/// An image may always take this many bytes (16 MiB), even if its tiles are small.
const ALWAYS_ALLOWED: u64 = 16 << 20;
/// In addition, an image may take this many bytes for each byte of its table. Pixels of 32 bits
/// stay below this ratio in PLIO, because a word (2 bytes) stores a run of at most 4095 pixels. The
/// other algorithms compress less.
const ALLOWED_PER_BYTE: u64 = 8192;
/// The supported algorithms. CFITSIO also knows `HCOMPRESS_1`, but it writes beyond its memory when
/// such data are damaged.
const ALGORITHMS: &[&str] = &["RICE_1", "RICE_ONE", "GZIP_1", "GZIP_2", PLIO];
/// The algorithm for masks, which stores them as lists of runs.
pub(crate) const PLIO: &str = "PLIO_1";

/// The keywords that CFITSIO needs to unpack the tiles.
const KEYWORDS: &[&str] = &[
    "ZIMAGE", "ZCMPTYPE", "ZBITPIX", "ZNAXIS", "ZQUANTIZ", "ZDITHER0", "ZBLANK", "ZSCALE", "ZZERO",
    "TFIELDS", "THEAP",
];
/// Further such keywords, without the number at their end.
const NUMBERED: &[&str] = &[
    "ZNAXIS", "ZTILE", "ZNAME", "ZVAL", "TTYPE", "TFORM", "TNULL", "TSCAL", "TZERO", "TDIM",
];

/// Makes the table that holds the tiles of a compressed image count as the image. Other HDUs stay
/// unchanged. The header of the table is checked, and the size that it claims for the image is
/// limited by the bytes of the table.
pub(crate) fn count_as_image(hdu: &mut Hdu) -> Result<(), IoError> {
    const ALGORITHM: &str = "must be RICE_1, GZIP_1, GZIP_2 or PLIO_1: run funpack first";
    const BITPIX: &str = "must be 8, 16, 32, -32 or -64";
    const NOT_NONE: &str = "must not be NONE if the pixels are whole numbers";
    const IMAGE_SIZE: &str = "the image would be larger than its tiles can hold";
    const TILE_SIZE: &str = "a tile would be larger than the table can hold";
    if !hdu.is_tiled() {
        return Ok(());
    }
    let table = &*hdu;
    for keyword in table.header.iter().map(Card::keyword) {
        let stem = keyword.trim_end_matches(|c: char| c.is_ascii_digit());
        if KEYWORDS.contains(&keyword.as_str()) || (stem != keyword && NUMBERED.contains(&stem)) {
            table.ensure_one_value(&keyword)?;
        }
    }
    let algorithm = table.text("ZCMPTYPE").unwrap_or_default();
    table.ensure(ALGORITHMS.contains(&algorithm.trim()), "ZCMPTYPE", ALGORITHM)?;
    // CFITSIO uses ZDITHER0 and the parameters of RICE_1 as indices or divisors without a check.
    let dither = table.structural("ZDITHER0", Some(1))?;
    table.ensure((1..=10_000).contains(&dither), "ZDITHER0", "must be 1 to 10000")?;
    if algorithm.trim().starts_with("RICE") {
        Rice::of(table)?;
    }
    let bitpix = table.structural("ZBITPIX", None)?;
    // CFITSIO does not unpack whole numbers of 64 bits, and would leave its buffers uninitialised.
    table.ensure([8, 16, 32, -32, -64].contains(&bitpix), "ZBITPIX", BITPIX)?;
    // With `NONE`, CFITSIO would read the bits of whole numbers as floats.
    let none = table.text("ZQUANTIZ").is_some_and(|how| how.trim() == "NONE");
    table.ensure(bitpix < 0 || !none, "ZQUANTIZ", NOT_NONE)?;
    let count = table.structural("ZNAXIS", None)?;
    // CFITSIO's limit for compressed images.
    table.ensure((1..=6).contains(&count), "ZNAXIS", "must be 1 to 6")?;
    let (mut axes, mut tile, mut tiles) = (Vec::new(), Vec::new(), 1_usize);
    for axis in 1..=count {
        let positive = |keyword: &str, default| {
            let length = table.structural(keyword, default)?;
            usize::try_from(length)
                .ok()
                .filter(|&length| length > 0 && i32::try_from(length).is_ok())
                .ok_or_else(|| table.header_error(keyword, "must be above 0 and below 2^31"))
        };
        let length = positive(&format!("ZNAXIS{axis}"), None)?;
        // By default each row of the image is a tile.
        let default = if axis == 1 { length } else { 1 };
        let across = positive(&format!("ZTILE{axis}"), Some(default as i64))?;
        tiles = tiles
            .checked_mul(length.div_ceil(across))
            .ok_or_else(|| table.header_error("ZTILE1", "there would be too many tiles"))?;
        axes.push(length);
        tile.push(across);
    }
    let allowed = ALWAYS_ALLOWED.saturating_add(table.data_length.saturating_mul(ALLOWED_PER_BYTE));
    let fits = |lengths: &[usize]| {
        let pixels = lengths
            .iter()
            .try_fold(1_u64, |product, &n| product.checked_mul(n as u64));
        pixels
            .and_then(|pixels| pixels.checked_mul(bitpix.unsigned_abs() / 8))
            .is_some_and(|bytes| bytes <= allowed)
    };
    table.ensure(fits(&axes), "ZNAXIS", IMAGE_SIZE)?;
    table.ensure(fits(&tile), "ZTILE1", TILE_SIZE)?;
    let agrees = table.axes.get(1) == Some(&tiles);
    table.ensure(agrees, "NAXIS2", "must be the number of tiles")?;
    (hdu.kind, hdu.bitpix, hdu.axes) = (HduKind::Image, bitpix, axes);
    Ok(())
}

/// Checks the tiles of a compressed image. Any other image passes.
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

/// A column of descriptors, one per tile. A descriptor holds the number of elements of the tile and
/// their position in the heap, the part of the data after the rows of the table.
#[derive(Clone, Copy)]
struct Descriptors {
    /// Offset in bytes from the start of a row.
    place: usize,
    /// Length in bytes of each of the two numbers.
    width: usize,
}

struct Tiles<'a> {
    hdu: &'a Hdu,
    /// Reads the rows of the table.
    table: Places,
    /// Reads the tiles in the heap. It opens the file a second time, so that each of the two
    /// readers keeps its position.
    packed: Places,
    algorithm: Algorithm,
    /// True if the pixels are floats that are stored without quantisation.
    unquantised: bool,
    /// The lengths of a tile along the axes, `ZTILE1` first.
    tile: Vec<usize>,
    row_bytes: usize,
    rows: usize,
    /// Position of the first byte of the heap, counted from the start of the data.
    heap: u64,
    compressed: Descriptors,
    uncompressed: Option<Descriptors>,
    zipped: Option<Descriptors>,
}

impl<'a> Tiles<'a> {
    fn open(hdu: &'a Hdu) -> Result<Self, IoError> {
        let row_bytes = hdu.structural_count("NAXIS1", None)?;
        let rows = hdu.structural_count("NAXIS2", None)?;
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
            _ => return Err(hdu.header_error("THEAP", "the heap must start after the rows")),
        };
        let tile = (1..=hdu.axes.len()).map(|axis| {
            let default = if axis == 1 { hdu.axes[0] } else { 1 };
            hdu.structural_count(&format!("ZTILE{axis}"), Some(default as i64))
        });
        let places = |buffer| Places::open(hdu, buffer).map_err(unreadable(hdu.path()));
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
                Algorithm::Plio => !self.unquantised && is_sound_plio(&self.bytes(row, start, count, 2)?),
                Algorithm::Rice(rice) => {
                    !self.unquantised && rice.is_sound(&self.bytes(row, start, count, 1)?, pixels)
                }
                // Quantised floats are whole numbers of 32 bits.
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

    /// Number of pixels in a tile. Tiles at the far edges may be smaller.
    fn pixels(&self, row: usize) -> u64 {
        let mut rest = row;
        let lengths = self.hdu.axes.iter().zip(&self.tile).map(|(&length, &across)| {
            let along = rest % length.div_ceil(across);
            rest /= length.div_ceil(across);
            across.min(length - along * across) as u64
        });
        lengths.product()
    }

    /// Number of elements that the heap holds for a row, and the position of their first byte,
    /// counted from the start of the data.
    fn descriptor(&mut self, row: usize, column: Descriptors) -> Result<(u64, u64), IoError> {
        let mut bytes = [0; 16];
        let bytes = &mut bytes[..2 * column.width];
        let place = (row * self.row_bytes + column.place) as u64;
        let read = self.table.seek(place).and_then(|file| file.read_exact(bytes));
        read.map_err(unreadable(self.hdu.path()))?;
        let number = |bytes: &[u8]| bytes.iter().fold(0_u64, |n, &byte| (n << 8) | u64::from(byte));
        let (count, place) = bytes.split_at(column.width);
        Ok((number(count), self.heap.saturating_add(number(place))))
    }

    /// Returns whether the data hold `count` elements of `width` bytes from `start` on.
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
        read.map_err(unreadable(self.hdu.path()))?;
        Ok(bytes)
    }

    /// Returns whether a gzip stream unpacks to exactly `expected` bytes. If the stream is longer,
    /// the rest is not unpacked.
    fn unpacks_to(&mut self, start: u64, count: u64, expected: u64) -> Result<bool, IoError> {
        if !self.holds(start, count, 1) {
            return Ok(false);
        }
        let file = self.packed.seek(start).map_err(unreadable(self.hdu.path()))?;
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
        const DAMAGED: &str = "the tile of the compressed image is damaged: fetch or write the file again";
        let hdu = self.hdu.index;
        self.hdu
            .error(IoErrorKind::Damaged, DAMAGED)
            .at(Place::Tile { hdu, tile })
    }
}

/// A reader that can jump to any position in the data of an HDU.
struct Places {
    file: BufReader<File>,
    /// Position of the start of the data in the file.
    start: u64,
}

impl Places {
    fn open(hdu: &Hdu, buffer: usize) -> io::Result<Self> {
        let file = File::open(hdu.source.file())?;
        Ok(Self {
            file: BufReader::with_capacity(buffer, file),
            start: hdu.data_start,
        })
    }

    /// Jumps to a byte of the data, and keeps the bytes that have been read ahead.
    fn seek(&mut self, at: u64) -> io::Result<&mut BufReader<File>> {
        let ahead = i128::from(self.start) + i128::from(at) - i128::from(self.file.stream_position()?);
        let ahead = i64::try_from(ahead).map_err(|_| io::ErrorKind::InvalidInput)?;
        self.file.seek_relative(ahead)?;
        Ok(&mut self.file)
    }
}

/// The descriptors in the column with this name, if there is one. Two such columns are an error. If
/// `element` is given, the tiles must hold unscaled elements of this type. CFITSIO would convert
/// other elements before it unpacks them, and nothing would check the converted values.
fn descriptors(
    hdu: &Hdu,
    columns: &[Column],
    name: &str,
    element: Option<u8>,
) -> Result<Option<Descriptors>, IoError> {
    const LENGTHS: &str = "the lengths of tiles vary: a format P or Q is needed";
    const ONE: &str = "there must be one such column, with one tile per row";
    const ELEMENTS: &str =
        "compressed tiles must hold bytes (1PB, 1QB), or 16-bit words for PLIO_1 (1PI, 1QI)";
    const SCALED: &str = "compressed tiles must not be scaled";
    let mut place = 0;
    let mut found = None;
    for (index, column) in columns.iter().enumerate() {
        if column.name.eq_ignore_ascii_case(name) {
            let keyword = |stem: &str| format!("{stem}{}", index + 1);
            let width = match column.code {
                b'P' => 4,
                b'Q' => 8,
                _ => return Err(hdu.header_error(&keyword("TFORM"), LENGTHS)),
            };
            let is_only = column.bytes() == Some(2 * width) && found.is_none();
            hdu.ensure(is_only, &keyword("TTYPE"), ONE)?;
            let as_is = element.is_none_or(|element| column.element() == Some(element));
            hdu.ensure(as_is, &keyword("TFORM"), ELEMENTS)?;
            for (stem, neutral) in [("TSCAL", 1.0), ("TZERO", 0.0)] {
                let keyword = keyword(stem);
                let scaled = hdu.header.get(&keyword).is_some() && hdu.value(&keyword) != Some(neutral);
                hdu.ensure(element.is_none() || !scaled, &keyword, SCALED)?;
            }
            found = Some(Descriptors { place, width });
        }
        place += column.bytes().expect("the widths were added up before");
    }
    Ok(found)
}
