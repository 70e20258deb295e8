//! Mutations of FITS files: cards, values, blocks. The result still consists of blocks and is often
//! as long as its headers say, so that readers do not stop at the beginning.

use std::ops::Range;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::LARGEST;
use crate::numbers::{change_byte, change_value, pick, place, word};

const BLOCK: usize = 2880;
const RECORD: usize = 80;

/// Keywords that define the structure or change the meaning of others.
const KEYWORDS: &[&str] = &[
    "BITPIX", "NAXIS", "NAXIS1", "NAXIS2", "NAXIS3", "NAXIS4", "PCOUNT", "GCOUNT", "GROUPS", "TFIELDS",
    "THEAP", "TFORM1", "TFORM2", "TFORM3", "TTYPE1", "TTYPE2", "TTYPE3", "TNULL1", "TSCAL1", "TZERO1",
    "TDIM1", "BSCALE", "BZERO", "BLANK", "EXTNAME", "EXTVER", "XTENSION", "CONTINUE", "LONGSTRN", "ZIMAGE",
    "ZCMPTYPE", "ZBITPIX", "ZNAXIS", "ZNAXIS1", "ZNAXIS2", "ZNAXIS3", "ZTILE1", "ZTILE2", "ZTILE3", "ZNAME1",
    "ZVAL1", "ZNAME2", "ZVAL2", "ZQUANTIZ", "ZDITHER0", "ZBLANK", "ZSCALE", "ZZERO", "ZMASKCMP", "ZTENSION",
    "FZTILELN", "FZALGOR", "POLNAXIS", "POLDEG1", "PSFNAXIS", "PSFAXIS1", "PSFAXIS3", "PSF_SAMP", "NCOMP",
    "OVERSAMP", "CENX", "FIELDNX", "CTYPE1", "CTYPE2", "CRPIX1", "CDELT1", "CD1_1", "PV1_1", "PV2_3",
    "A_ORDER", "A_2_0", "LONPOLE", "CUNIT1",
];
/// Values for keywords that hold strings.
const TEXTS: &[&str] = &[
    "'1D'",
    "'D'",
    "'0D'",
    "'2E'",
    "'1I'",
    "'1J'",
    "'1K'",
    "'1B'",
    "'1L'",
    "'1X'",
    "'12A'",
    "'1C'",
    "'1M'",
    "'1PB(9)'",
    "'1PI(9)'",
    "'1PJ(9)'",
    "'1PE(9)'",
    "'1QB(9)'",
    "'0PB'",
    "'2PB(4)'",
    "'99999999D'",
    "'2147483647B'",
    "'-1D'",
    "'RICE_1'",
    "'GZIP_1'",
    "'GZIP_2'",
    "'PLIO_1'",
    "'HCOMPRESS_1'",
    "'NOCOMPRESS'",
    "'RICE_ONE'",
    "'NO_DITHER'",
    "'SUBTRACTIVE_DITHER_1'",
    "'SUBTRACTIVE_DITHER_2'",
    "'NONE'",
    "'COMPRESSED_DATA'",
    "'GZIP_COMPRESSED_DATA'",
    "'UNCOMPRESSED_DATA'",
    "'ZSCALE'",
    "'ZZERO'",
    "'ZBLANK'",
    "'BLOCKSIZE'",
    "'BYTEPIX'",
    "'NOISEBIT'",
    "'X'",
    "'Y'",
    "'A'",
    "'FLUX'",
    "'IMAGE   '",
    "'BINTABLE'",
    "'TABLE   '",
    "'RA---TAN'",
    "'DEC--TAN'",
    "'RA---TPV'",
    "'DEC--TAN-SIP'",
    "'RA---ZPN'",
    "'POSITIONS'",
    "'COEFFS'",
    "'it''s&'",
    "'unclosed",
    "'deg'",
    "'arcsec'",
    "'um'",
    "'polynomial=8'",
    "'idw=1e9'",
];

/// One mutation.
pub(crate) fn mutate(data: &mut Vec<u8>, rng: &mut ChaCha8Rng) {
    let hdus = hdus(data);
    let Some(hdu) = place(hdus.len(), rng).map(|i| hdus[i].clone()) else {
        return change_byte(data, rng);
    };
    match rng.random_range(0..20) {
        0..=7 => change_card(&mut data[hdu.header], rng),
        8 => exchange_cards(&mut data[hdu.header], rng),
        9 => copy_card(&mut data[hdu.header], rng),
        10 | 11 => overwrite_card(&mut data[hdu.header], rng),
        12..=14 => change_value(&mut data[hdu.data], rng),
        15 | 16 => change_byte(&mut data[hdu.data], rng),
        17 => change_byte(&mut data[hdu.header], rng),
        18 => change_blocks(data, hdu, rng),
        _ => data.truncate(place(data.len(), rng).unwrap_or(0)),
    }
    if rng.random_range(0..3) > 0 {
        fill_up(data);
    }
}

/// The ranges of an HDU's cards and data.
#[derive(Clone)]
struct Parts {
    header: Range<usize>,
    data: Range<usize>,
}

/// HDUs, found by the text at the beginning of blocks. Sizes in headers are ignored.
fn hdus(data: &[u8]) -> Vec<Parts> {
    let starts: Vec<usize> = (0..data.len())
        .step_by(BLOCK)
        .filter(|&at| at == 0 || data[at..].starts_with(b"XTENSION"))
        .collect();
    let ends = starts.iter().skip(1).copied().chain([data.len()]);
    let parts = starts.iter().zip(ends).filter_map(|(&start, end)| {
        let cards = data[start..end]
            .chunks_exact(RECORD)
            .position(|record| record.starts_with(b"END     "))?;
        let header = start..start + cards * RECORD;
        let data = (header.end + RECORD).next_multiple_of(BLOCK).min(end)..end;
        Some(Parts { header, data })
    });
    parts.collect()
}

fn card<'a>(header: &'a mut [u8], rng: &mut ChaCha8Rng) -> Option<&'a mut [u8]> {
    let at = place(header.len() / RECORD, rng)? * RECORD;
    Some(&mut header[at..at + RECORD])
}

/// Gives a card another value.
fn change_card(header: &mut [u8], rng: &mut ChaCha8Rng) {
    let Some(card) = card(header, rng) else { return };
    let old = String::from_utf8_lossy(&card[10..]).trim().to_owned();
    let number = old
        .split('/')
        .next()
        .and_then(|text| text.trim().parse::<i64>().ok());
    let value = match (number, rng.random_range(0..6)) {
        (Some(n), 0) => n.wrapping_add(rng.random_range(-2..=2)).to_string(),
        (Some(n), 1) => n.wrapping_mul(rng.random_range(2..5)).to_string(),
        (Some(n), 2) => (n / 2).to_string(),
        (None, 0..=3) | (_, 5) => pick(TEXTS, rng).to_string(),
        _ => word(rng),
    };
    write(&mut card[8..], &format!("= {value:>20}"));
}

/// Overwrites a card with one of another keyword.
fn overwrite_card(header: &mut [u8], rng: &mut ChaCha8Rng) {
    let Some(card) = card(header, rng) else { return };
    let value = if rng.random_range(0..2) == 0 {
        pick(TEXTS, rng).to_string()
    } else {
        word(rng)
    };
    write(card, &format!("{:<8}= {value:>20}", pick(KEYWORDS, rng)));
}

fn exchange_cards(header: &mut [u8], rng: &mut ChaCha8Rng) {
    let count = header.len() / RECORD;
    if let (Some(a), Some(b)) = (place(count, rng), place(count, rng)) {
        for i in 0..RECORD {
            header.swap(a * RECORD + i, b * RECORD + i);
        }
    }
}

fn copy_card(header: &mut [u8], rng: &mut ChaCha8Rng) {
    let count = header.len() / RECORD;
    if let (Some(a), Some(b)) = (place(count, rng), place(count, rng)) {
        header.copy_within(a * RECORD..(a + 1) * RECORD, b * RECORD);
    }
}

/// Removes or repeats an HDU, or adds a block.
fn change_blocks(data: &mut Vec<u8>, hdu: Parts, rng: &mut ChaCha8Rng) {
    let whole = hdu.header.start..hdu.data.end;
    match rng.random_range(0..3) {
        0 if whole.start > 0 => drop(data.drain(whole)),
        1 if whole.start > 0 && data.len() + whole.len() <= LARGEST => data.extend_from_within(whole),
        _ => drop(data.splice(whole.end..whole.end, [rng.random::<u8>(); BLOCK])),
    }
}

/// Appends zeros if the last HDU is shorter than its header says and not too much is missing.
fn fill_up(data: &mut Vec<u8>) {
    let Some(last) = hdus(data).pop() else { return };
    let header = &data[last.header];
    let number = |keyword: &str| {
        let record = header
            .chunks_exact(RECORD)
            .find(|record| record.starts_with(format!("{keyword:<8}=").as_bytes()))?;
        let text = String::from_utf8_lossy(&record[10..]).into_owned();
        text.split('/').next()?.trim().parse::<i64>().ok()
    };
    let values = (1..=number("NAXIS").unwrap_or(0).min(9)).try_fold(1_i64, |product, axis| {
        product.checked_mul(number(&format!("NAXIS{axis}"))?)
    });
    let bytes = values
        .and_then(|values| values.checked_add(number("PCOUNT").unwrap_or(0)))
        .and_then(|values| values.checked_mul(number("BITPIX")?.checked_abs()? / 8));
    let end = bytes
        .and_then(|bytes| usize::try_from(bytes).ok())
        .and_then(|bytes| last.data.start.checked_add(bytes))
        .and_then(|end| end.checked_next_multiple_of(BLOCK));
    if let Some(end) = end.filter(|&end| end > data.len() && end <= LARGEST) {
        data.resize(end, 0);
    }
}

/// Writes a string into a field and fills the rest with blanks.
fn write(field: &mut [u8], text: &str) {
    let length = text.len().min(field.len());
    field[..length].copy_from_slice(&text.as_bytes()[..length]);
    field[length..].fill(b' ');
}
