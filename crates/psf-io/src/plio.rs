//! The lists of runs of `PLIO_1` tiles, checked before CFITSIO follows them: it takes their lengths on trust.
//!
//! A list is of 16-bit words (Pence et al., FITS standard 4.0, section 10.4.3): its length and the place of its first instruction in a
//! header, then instructions, one of which (`SH`, set high value) takes the word after it.

/// The instruction that takes the next word.
const SET_HIGH: i16 = 1;

/// Whether a list stays within its words.
pub(crate) fn is_sound(list: &[u8]) -> bool {
    let word = |number: usize| {
        let bytes = list.get(2 * number..2 * number + 2)?;
        Some(i16::from_be_bytes([bytes[0], bytes[1]]))
    };
    let words = list.len() / 2;
    // The third word is the length in short lists, and not positive in long ones.
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
    // CFITSIO leaves the pixels of an empty list as they were in memory.
    let Some(length) = usize::try_from(length).ok().filter(|&length| length > 0) else {
        return false;
    };
    let ends_open = length == words && word(words - 1).is_some_and(|last| last / 4096 == SET_HIGH);
    length <= words && !ends_open
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_that_leave_their_words_are_told() {
        let list = |words: &[i16]| {
            words
                .iter()
                .flat_map(|word| word.to_be_bytes())
                .collect::<Vec<_>>()
        };
        assert!(is_sound(&list(&[0, 7, -100, 8, 0, 0, 0, 0x4005])));
        assert!(is_sound(&list(&[0, 0, 4, 0x4005])));
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
            assert!(!is_sound(&list(bad)), "{bad:?}");
        }
    }
}
