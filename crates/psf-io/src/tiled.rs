//! Images compressed by tiles: the header of the table that holds the tiles.

use crate::IoError;
use crate::hdu::Hdu;
use crate::rice::Rice;

/// An image may have this many bytes whatever the size of its tiles (16 MiB) ...
const ALWAYS_ALLOWED: u64 = 16 << 20;
/// ... and so many more for each byte of the table: the best that PLIO makes of a mask of one value.
const ALLOWED_PER_BYTE: u64 = 4096;
/// The algorithms that are read. CFITSIO also knows `HCOMPRESS_1`, but writes beyond its memory when such data are damaged.
const ALGORITHMS: &[&str] = &["RICE_1", "RICE_ONE", "GZIP_1", "GZIP_2", PLIO];
/// Masks as lists of runs.
pub(crate) const PLIO: &str = "PLIO_1";

/// What a compressed image is when unpacked.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct TiledImage {
    pub(crate) bitpix: i64,
    /// `ZNAXIS1` first.
    pub(crate) axes: Vec<usize>,
}

impl TiledImage {
    /// Reads and checks what the header of the table says, with the bytes of the table as the measure.
    pub(crate) fn of(table: &Hdu) -> Result<Self, IoError> {
        let algorithm = table.text("ZCMPTYPE");
        if !algorithm
            .as_deref()
            .is_some_and(|name| ALGORITHMS.contains(&name.trim()))
        {
            return Err(table.header_error(
                "ZCMPTYPE",
                "must be RICE_1, GZIP_1, GZIP_2 or PLIO_1: run funpack first",
            ));
        }
        // CFITSIO takes these as they come, and looks up or divides by them.
        if !(1..=10_000).contains(&table.structural("ZDITHER0", Some(1))?) {
            return Err(table.header_error("ZDITHER0", "must be 1 to 10000"));
        }
        if algorithm.is_some_and(|name| name.trim().starts_with("RICE")) {
            Rice::of(table)?;
        }
        let bitpix = table.structural("ZBITPIX", None)?;
        // Whole numbers of 64 bits, which CFITSIO does not write, would leave its buffers as they are.
        if ![8, 16, 32, -32, -64].contains(&bitpix) {
            return Err(table.header_error("ZBITPIX", "must be 8, 16, 32, -32 or -64"));
        }
        // CFITSIO would take the bits of whole numbers for floats.
        if bitpix > 0 && table.text("ZQUANTIZ").is_some_and(|how| how.trim() == "NONE") {
            return Err(table.header_error("ZQUANTIZ", "must not be NONE where pixels are whole numbers"));
        }
        let count = table.structural("ZNAXIS", None)?;
        // CFITSIO's limit for compressed images.
        if !(1..=6).contains(&count) {
            return Err(table.header_error("ZNAXIS", "must be 1 to 6"));
        }
        let (mut axes, mut tile, mut tiles) = (Vec::new(), Vec::new(), 1_usize);
        for axis in 1..=count {
            let positive = |keyword: &str, default| {
                let length = table.structural(keyword, default)?;
                usize::try_from(length)
                    .ok()
                    .filter(|&length| length > 0 && i32::try_from(length).is_ok())
                    .ok_or_else(|| table.header_error(keyword, "must be above 0, and below 2^31"))
            };
            let length = positive(&format!("ZNAXIS{axis}"), None)?;
            // Rows are tiles where nothing is said.
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
        if !fits(&axes) {
            return Err(table.header_error("ZNAXIS", "the image would be larger than its tiles can hold"));
        }
        if !fits(&tile) {
            return Err(table.header_error("ZTILE1", "a tile would be larger than the table can hold"));
        }
        if table.axes.get(1) != Some(&tiles) {
            return Err(table.header_error("NAXIS2", "must be the number of tiles"));
        }
        Ok(Self { bitpix, axes })
    }
}
