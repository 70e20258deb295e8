//! Checks of the codes in compressed tiles, before CFITSIO decodes them.
//!
//! # RICE_1
//! A tile (Pence et al., FITS standard 4.0, section 10.4.1) consists of its first pixel, uncoded,
//! and then blocks of differences between successive pixels. CFITSIO checks only once per block
//! whether the bytes of the tile have ended, and may read beyond their end within a block. A block
//! begins with a code. Code 0 stands for a block of equal pixels. Code FS + 1 stands for
//! differences that are split into high bits and FS low bits. Such a difference is stored as a run
//! of zeros, whose length is the number in the high bits, then a one, then the FS low bits. The
//! largest code stands for differences that are stored uncoded.
//!
//! # PLIO_1
//! This algorithm stores a tile as a list of runs of equal pixels. CFITSIO does not check the
//! length of a list. A list consists of 16-bit words (Pence et al., FITS standard 4.0, section
//! 10.4.3). Its header holds its length and the place of the first instruction. The instructions
//! follow. One of them (`SH`, set high value) takes up two words.

use crate::error::IoError;
use crate::fits::hdu::Hdu;

/// The keywords `ZNAMEi` name the parameters of an algorithm. They are read up to this `i`.
const MOST_PARAMETERS: usize = 9;

/// The parameters of the `RICE_1` code of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Rice {
    /// Pixels per block.
    block: u64,
    /// Bits of an uncoded pixel or difference.
    pixel_bits: u64,
    /// Bits of the code at the start of a block.
    head_bits: u32,
    /// The code of blocks whose differences are uncoded.
    plain: u32,
}

impl Rice {
    /// Reads the parameters from the header of a table. Checks the block size and the bytes per
    /// pixel that CFITSIO will use. CFITSIO identifies these two mostly by the number `i` of their
    /// `ZVALi`, and almost never by the name in `ZNAMEi`.
    pub(crate) fn of(table: &Hdu) -> Result<Self, IoError> {
        let name = |number: usize| table.text(&format!("ZNAME{number}"));
        // A second parameter NOISEBIT marks an old convention, in which pixels have 4 bytes.
        let old = name(2).is_some_and(|name| name.trim() == "NOISEBIT");
        let first = table.structural("ZVAL1", Some(32))?;
        let second = if old {
            4
        } else {
            table.structural("ZVAL2", Some(4))?
        };
        // CFITSIO takes two such values as exchanged.
        let ((block_key, block), (width_key, width)) = if first < 16 && second > 8 {
            (("ZVAL2", second), ("ZVAL1", first))
        } else {
            (("ZVAL1", first), ("ZVAL2", second))
        };
        table.ensure(
            (1..=1024).contains(&block),
            block_key,
            "a block of RICE_1 has 1 to 1024 pixels",
        )?;
        table.ensure(
            [1, 2, 4, 8].contains(&width),
            width_key,
            "pixels of RICE_1 have 1, 2, 4 or 8 bytes",
        )?;
        for number in 1..=MOST_PARAMETERS {
            let taken = match name(number).as_deref().map(str::trim) {
                Some("BLOCKSIZE") => block,
                Some("BYTEPIX") => width,
                _ => continue,
            };
            let value = format!("ZVAL{number}");
            table.ensure(
                table.structural(&value, None)? == taken,
                &value,
                "BLOCKSIZE must be the first parameter and BYTEPIX the second: compress the original image again with fpack",
            )?;
        }
        Ok(Self::new(block as u64, width))
    }

    /// The parameters for blocks of `block` pixels. The numbers are taken from `ricecomp.c` in
    /// CFITSIO, which treats pixels of 8 bytes like pixels of 4 bytes.
    fn new(block: u64, pixel_bytes: i64) -> Self {
        let (pixel_bits, head_bits, plain) = match pixel_bytes {
            1 => (8, 3, 7),
            2 => (16, 4, 15),
            _ => (32, 5, 26),
        };
        Self {
            block,
            pixel_bits,
            head_bits,
            plain,
        }
    }

    /// Returns whether the bytes of a tile suffice for this many pixels and all codes are known.
    /// More bytes may follow.
    pub(crate) fn is_sound(&self, tile: &[u8], pixels: u64) -> bool {
        let mut bits = Bits {
            bytes: tile,
            at: self.pixel_bits,
        };
        let mut left = pixels;
        while left > 0 {
            let block = left.min(self.block);
            let Some(head) = bits.take(self.head_bits) else {
                return false;
            };
            if head == self.plain {
                bits.at += block * self.pixel_bits;
            } else if head > self.plain || (head > 0 && !bits.pass_codes(block, head - 1)) {
                return false;
            }
            if !bits.within() {
                return false;
            }
            left -= block;
        }
        true
    }
}

/// A reader of the bits of a tile, the highest bit of a byte first.
struct Bits<'a> {
    bytes: &'a [u8],
    /// Number of bits read so far.
    at: u64,
}

impl Bits<'_> {
    /// Returns whether all bits read so far exist.
    fn within(&self) -> bool {
        self.at <= 8 * self.bytes.len() as u64
    }

    /// Returns a word that starts with the next bits, and the number of its bits that may be used,
    /// 56 to 63. Bits beyond the end of the tile are zero.
    #[inline]
    fn ahead(&self) -> (u64, u32) {
        let (byte, bit) = ((self.at / 8) as usize, (self.at % 8) as u32);
        let mut next = [0; 8];
        if let Some(bytes) = self.bytes.get(byte..byte + 8) {
            next.copy_from_slice(bytes);
        } else {
            let rest = self.bytes.get(byte..).unwrap_or_default();
            next[..rest.len()].copy_from_slice(rest);
        }
        let word = u64::from_be_bytes(next);
        (word << bit, u64::BITS - 1 - bit)
    }

    /// Reads a number of `count` bits. Returns `None` if the tile has fewer bits left.
    fn take(&mut self, count: u32) -> Option<u32> {
        let (word, _) = self.ahead();
        self.at += u64::from(count);
        self.within().then_some((word >> (u64::BITS - count)) as u32)
    }

    /// Skips `count` coded differences. Each is a run of bits 0, a bit 1, and `low` further bits.
    /// Returns false if the tile ends before the bit 1 of the last difference. The further bits of
    /// the last difference may lie beyond the end, so the caller must test this by
    /// [`within`](Self::within).
    fn pass_codes(&mut self, count: u64, low: u32) -> bool {
        let (mut left, per_word) = (count, codes_per_word(low));
        while left > 0 {
            let (mut word, length) = self.ahead();
            let (mut passed, then) = (0, left.saturating_sub(per_word));
            loop {
                // Setting the lowest bit does no harm, because it is not one of the `length` usable
                // bits.
                let zeros = (word | 1).leading_zeros();
                if passed + zeros >= length {
                    // The run of zeros may continue in the next word.
                    passed = passed.max(length);
                    break;
                }
                left -= 1;
                passed += zeros + 1 + low;
                if left == then {
                    break;
                }
                word = word << (low + 1) << zeros;
            }
            self.at += u64::from(passed);
            if left > 0 && !self.within() {
                return false;
            }
        }
        true
    }
}

/// The number of coded differences that fit into almost every word of [`Bits::ahead`]. A difference
/// is counted as two bits 0 (a typical run), a bit 1, and `low` further bits. A loop of this fixed
/// length is easy for the processor to predict.
fn codes_per_word(low: u32) -> u64 {
    u64::from((56 / (low + 3)).max(1))
}

/// The code of `SH`, the only instruction that takes up two words.
const USES_NEXT_WORD: i16 = 1;

/// Returns whether the instructions of a `PLIO_1` list stay within its words.
pub(crate) fn is_sound_plio(list: &[u8]) -> bool {
    let word = |number: usize| {
        let bytes = list.get(2 * number..2 * number + 2)?;
        Some(i16::from_be_bytes([bytes[0], bytes[1]]))
    };
    let words = list.len() / 2;
    // The third word is the length in a short list, and zero or negative in a long one.
    let Some(short) = word(2) else {
        return false;
    };
    let length = if short > 0 {
        i64::from(short)
    } else {
        let (Some(start), Some(low), Some(high)) = (word(1), word(3), word(4)) else {
            return false;
        };
        if start < 0 {
            return false;
        }
        (i64::from(high) << 15) + i64::from(low)
    };
    // CFITSIO would leave the pixels of an empty list uninitialised.
    let Some(length) = usize::try_from(length).ok().filter(|&length| length > 0) else {
        return false;
    };
    let ends_open = length == words && word(words - 1).is_some_and(|last| last / 4096 == USES_NEXT_WORD);
    length <= words && !ends_open
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_that_leave_their_words_are_refused() {
        let list = |words: &[i16]| {
            words
                .iter()
                .flat_map(|word| word.to_be_bytes())
                .collect::<Vec<_>>()
        };
        assert!(is_sound_plio(&list(&[0, 7, -100, 8, 0, 0, 0, 0x4005])));
        assert!(is_sound_plio(&list(&[0, 0, 4, 0x4005])));
        for bad in [
            &[][..],
            &[0, 7],
            &[0, 7, -100, 9, 0, 0, 0, 0x4005],
            &[0, 7, -100, 8, 1, 0, 0, 0x4005],
            &[0, -7, -100, 8, 0, 0, 0, 0x4005],
            &[0, 7, -100, 8, 0, 0, 0, 0x1005],
            &[0, 0, 5, 0x4005],
            &[0, 7, -100, 0, 0, 0, 0, 0x4005],
        ] {
            assert!(!is_sound_plio(&list(bad)), "{bad:?}");
        }
    }
}
