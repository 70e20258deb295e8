//! Mutations that damage a good FITS file, and the limits within which a reader must refuse the
//! result.

use std::ops::Range;
use std::path::Path;
use std::time::{Duration, Instant};

use super::{Scratch, chain, names};

const BLOCK: usize = 2880;
const RECORD: usize = 80;
/// The longest time for a refusal.
const PATIENCE: Duration = Duration::from_secs(1);
/// The largest memory for a refusal, with room for the test itself and its threads.
const MEMORY_BYTES: u64 = 256 << 20;

/// A damaged file.
pub(crate) struct Mutation {
    pub(crate) name: String,
    pub(crate) bytes: Vec<u8>,
}

fn mutation(name: impl Into<String>, bytes: Vec<u8>) -> Mutation {
    Mutation {
        name: name.into(),
        bytes,
    }
}

/// The positions of an HDU's header and data.
struct Parts {
    header: Range<usize>,
    data: Range<usize>,
    bitpix: i64,
}

fn number(header: &[u8], keyword: &str) -> Option<i64> {
    let record = header.chunks(RECORD).find(|r| is_card(r, keyword))?;
    let text = std::str::from_utf8(&record[10..]).ok()?;
    text.split('/').next()?.trim().parse().ok()
}

fn is_card(record: &[u8], keyword: &str) -> bool {
    record.starts_with(format!("{keyword:<8}=").as_bytes())
}

fn parts(good: &[u8]) -> Vec<Parts> {
    let (mut at, mut found) = (0, Vec::new());
    while at < good.len() {
        let end = (at..good.len())
            .step_by(RECORD)
            .find(|&i| good[i..].starts_with(b"END     "))
            .expect("a header ends");
        let data = (end + 1).next_multiple_of(BLOCK);
        let header = &good[at..end];
        let axes = number(header, "NAXIS").expect("NAXIS");
        let values: i64 = (1..=axes)
            .map(|i| number(header, &format!("NAXIS{i}")).expect("NAXISn"))
            .product();
        let bitpix = number(header, "BITPIX").expect("BITPIX");
        let bytes = if axes == 0 { 0 } else { values * bitpix.abs() / 8 } as usize;
        found.push(Parts {
            header: at..data,
            data: data..data + bytes,
            bitpix,
        });
        at = (data + bytes).next_multiple_of(BLOCK);
    }
    found
}

/// The file cut at every block, in the middle of every block, and one byte short. Cuts at the end
/// of an HDU are omitted, since the remaining file is valid.
pub(crate) fn cut(good: &[u8]) -> Vec<Mutation> {
    let ends: Vec<usize> = parts(good)
        .iter()
        .map(|p| p.data.end.next_multiple_of(BLOCK))
        .collect();
    (0..good.len())
        .step_by(BLOCK)
        .flat_map(|block| [block, block + BLOCK / 2, block + BLOCK - 1])
        .filter(|length| !ends.contains(length))
        .map(|length| mutation(format!("cut to {length} bytes"), good[..length].to_vec()))
        .collect()
}

/// Replaces the first card with this keyword by another record.
pub(crate) fn replaced(good: &[u8], keyword: &str, record: &str) -> Mutation {
    let mut bytes = good.to_vec();
    let at = (0..good.len())
        .step_by(RECORD)
        .find(|&i| is_card(&good[i..], keyword))
        .unwrap_or_else(|| panic!("no card {keyword}"));
    bytes[at..at + RECORD].copy_from_slice(format!("{record:<80}").as_bytes());
    mutation(format!("{keyword} replaced by {record:?}"), bytes)
}

/// Gives the first card with this keyword another value.
pub(crate) fn with_value(good: &[u8], keyword: &str, value: &str) -> Mutation {
    replaced(good, keyword, &format!("{keyword:<8}= {value}"))
}

/// Removes each of these cards in turn.
pub(crate) fn without(good: &[u8], keywords: &[&str]) -> Vec<Mutation> {
    keywords
        .iter()
        .map(|keyword| replaced(good, keyword, "COMMENT nothing here"))
        .collect()
}

/// Gives each of these cards values of wrong types. Numbers also become strings, and strings become
/// numbers.
pub(crate) fn wrong_types(good: &[u8], numbers: &[&str], texts: &[&str]) -> Vec<Mutation> {
    let of = |keywords: &[&str], values: &[&str]| -> Vec<Mutation> {
        keywords
            .iter()
            .flat_map(|keyword| values.iter().map(|value| with_value(good, keyword, value)))
            .collect()
    };
    let mut all = of(numbers, &["'4'", "T", "", "(1.0, 2.0)", "nan", "1E999"]);
    all.extend(of(texts, &["4", "T", "", "'"]));
    all
}

/// Makes every axis of every HDU, and other numbers that its size depends on, much larger than the
/// file.
pub(crate) fn huge_sizes(good: &[u8]) -> Vec<Mutation> {
    const SIZES: [&str; 4] = [
        "99999999",
        "2147483647",
        "4611686018427387904",
        "9223372036854775807",
    ];
    let mut all = Vec::new();
    for part in parts(good) {
        for at in part.header.step_by(RECORD) {
            let keyword = String::from_utf8_lossy(&good[at..at + 8]).trim().to_owned();
            let sized = keyword == "PCOUNT" || keyword.starts_with("NAXIS") && keyword != "NAXIS";
            for size in SIZES.iter().filter(|_| sized) {
                let mut bytes = good.to_vec();
                let record = format!("{:<80}", format!("{keyword:<8}= {size}"));
                bytes[at..at + RECORD].copy_from_slice(record.as_bytes());
                all.push(mutation(format!("{keyword} = {size}"), bytes));
            }
        }
    }
    all
}

/// Sets the first or last value of every HDU of floats to NaN or an infinity.
pub(crate) fn not_finite(good: &[u8]) -> Vec<Mutation> {
    let mut all = Vec::new();
    for (i, part) in parts(good).iter().enumerate() {
        let value: fn(f64) -> Vec<u8> = match part.bitpix {
            -32 => |v| (v as f32).to_be_bytes().to_vec(),
            -64 => |v| v.to_be_bytes().to_vec(),
            _ => continue,
        };
        for bad in [f64::NAN, f64::INFINITY] {
            let value = value(bad);
            for at in [part.data.start, part.data.end - value.len()] {
                let mut bytes = good.to_vec();
                bytes[at..at + value.len()].copy_from_slice(&value);
                all.push(mutation(format!("{bad} in HDU {i} at byte {at}"), bytes));
            }
        }
    }
    all
}

/// Asserts that every damaged file is refused quickly, with a text that names the file, and with
/// little memory.
pub(crate) fn assert_refused<T: std::fmt::Debug>(
    mutations: Vec<Mutation>,
    read: impl Fn(&Path) -> Result<T, psf_io::IoError>,
) {
    let scratch = Scratch::new();
    let before = peak_memory_bytes();
    for Mutation { name, bytes } in mutations {
        let path = scratch.put("spoilt.fits", &bytes);
        let start = Instant::now();
        let outcome = read(&path);
        let seconds = start.elapsed();
        let error = match outcome {
            Ok(value) => panic!("{name}: read as {value:?}"),
            Err(error) => error,
        };
        assert!(
            names(&error, &path) && chain(&error).len() > 40,
            "{name}: {error}"
        );
        assert!(seconds < PATIENCE, "{name}: {seconds:?}");
    }
    if let (Some(before), Some(after)) = (before, peak_memory_bytes()) {
        assert!(after - before < MEMORY_BYTES, "{} bytes more", after - before);
    }
}

/// The largest memory that this process has mapped, if the system reports it.
fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmPeak:"))?;
    let kilobytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kilobytes * 1024)
}
