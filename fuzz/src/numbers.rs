//! Numbers that are difficult for readers.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Numbers as text, for headers and tables.
const WORDS: &[&str] = &[
    "0",
    "1",
    "-1",
    "2",
    "3",
    "7",
    "8",
    "16",
    "32",
    "64",
    "-32",
    "-64",
    "100",
    "255",
    "256",
    "999",
    "1000",
    "4096",
    "65535",
    "65536",
    "16777216",
    "99999999",
    "2147483647",
    "2147483648",
    "-2147483648",
    "4294967296",
    "4611686018427387904",
    "9223372036854775807",
    "-9223372036854775808",
    "9223372036854775808",
    "0.0",
    "-0.0",
    "0.5",
    "1.5",
    "1e-300",
    "1e-45",
    "1e38",
    "1e39",
    "1e300",
    "1e308",
    "1E999",
    "-1E999",
    "nan",
    "inf",
    "-inf",
    "NaN",
    "1d5",
    "",
    "T",
    "F",
    "''",
    "'1'",
    "(1,2)",
    "1e",
    "+",
    "-",
    "0x10",
    "1_000",
    "359.999",
    "-90",
    "90.0000001",
    "180",
];

/// One of [`WORDS`], or a small number.
pub(crate) fn word(rng: &mut ChaCha8Rng) -> String {
    if rng.random_range(0..3) == 0 {
        rng.random_range(-3_i32..40).to_string()
    } else {
        pick(WORDS, rng).to_string()
    }
}

/// A random element of a list.
pub(crate) fn pick<'a, T>(list: &'a [T], rng: &mut ChaCha8Rng) -> &'a T {
    &list[rng.random_range(0..list.len())]
}

/// A random index into data of a length, or `None` if it is 0.
pub(crate) fn place(length: usize, rng: &mut ChaCha8Rng) -> Option<usize> {
    (length > 0).then(|| rng.random_range(0..length))
}

/// Changes a byte or a bit.
pub(crate) fn change_byte(data: &mut [u8], rng: &mut ChaCha8Rng) {
    if let Some(at) = place(data.len(), rng) {
        if rng.random::<bool>() {
            data[at] ^= 1 << rng.random_range(0..8);
        } else {
            data[at] = rng.random();
        }
    }
}

/// Overwrites a big-endian number of 1, 2, 4 or 8 bytes with a value at an edge of its type.
pub(crate) fn change_value(data: &mut [u8], rng: &mut ChaCha8Rng) {
    let width = *pick(&[1, 2, 4, 8], rng);
    let Some(places) = (data.len() / width).checked_sub(1) else {
        return;
    };
    let at = rng.random_range(0..=places) * width;
    let value: u64 = match rng.random_range(0..6) {
        0 => 0,
        1 => u64::MAX,
        // The largest and the smallest signed value.
        2 => u64::MAX >> (65 - 8 * width as u32),
        3 => 1 << (8 * width - 1),
        // Near a power of two, or small.
        4 => (1_u64 << rng.random_range(0..8 * width)).wrapping_sub(rng.random_range(0..3)),
        _ => rng.random_range(0..2000),
    };
    let nan = f64::NAN.to_bits().to_be_bytes();
    let bytes = value.to_be_bytes();
    let source = if width == 8 && rng.random_range(0..8) == 0 {
        &nan
    } else {
        &bytes
    };
    data[at..at + width].copy_from_slice(&source[8 - width..]);
}
