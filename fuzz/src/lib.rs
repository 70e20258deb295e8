//! What the readers of psfield do with spoilt files.
//!
//! A *target* ([`targets`]) is a function from bytes to a panic or none: it reads the bytes in the ways of one format and checks that
//! every refusal names the file, that no read takes longer than a second of processor time or much memory ([`limits`]), and that what
//! was read can be written and read again. The same functions serve
//!
//! * `cargo fuzz`, which is led by the coverage of the Rust code (`fuzz_targets/`), and
//! * `seeded-run`, which needs nothing but Rust and a C compiler: as many cases as told, each a pure function of a seed and its number, led by
//!   nothing. `.ci/run` uses it.
//!
//! Both spoil files with [`mutate`], which knows FITS and text: random bytes alone would hardly get past a header. They start from
//! [`seeds`], small files by psfield's own writers and by the tests' file makers.

#![allow(
    clippy::cast_possible_truncation,
    reason = "bytes are cut from random numbers"
)]

mod fits;
pub mod limits;
mod numbers;
pub mod seeds;
#[path = "../../crates/psf-io/tests/support/mod.rs"]
mod support;
pub mod targets;
mod text;

pub use targets::{TARGETS, Target};

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A file is not made larger than this by mutations.
pub const LARGEST: usize = 1 << 17;
/// The most mutations of one case.
const MOST_MUTATIONS: usize = 5;

/// Spoils a file: FITS as FITS, gzip byte by byte, the rest as text.
pub fn mutate(data: &mut Vec<u8>, rng: &mut ChaCha8Rng) {
    for _ in 0..rng.random_range(1..=MOST_MUTATIONS) {
        if data.starts_with(b"SIMPLE") {
            fits::mutate(data, rng);
        } else if data.starts_with(&[0x1f, 0x8b]) {
            numbers::change_byte(data, rng);
        } else {
            text::mutate(data, rng);
        }
    }
    data.truncate(LARGEST);
}

/// A target of `cargo fuzz`: libFuzzer's own mutations for every fourth case, [`mutate`] for the rest.
#[cfg(feature = "libfuzzer")]
#[macro_export]
macro_rules! fuzz {
    ($target:path) => {
        libfuzzer_sys::fuzz_target!(|data: &[u8]| {
            $target(data);
        });
        libfuzzer_sys::fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
            match $crate::mutated(&data[..size], max_size, seed) {
                Some(changed) => {
                    data[..changed.len()].copy_from_slice(&changed);
                    changed.len()
                }
                None => libfuzzer_sys::fuzzer_mutate(data, size, max_size),
            }
        });
    };
}

/// A spoilt copy that is no longer than `max_size`; `None` for every fourth seed.
pub fn mutated(data: &[u8], max_size: usize, seed: u32) -> Option<Vec<u8>> {
    use rand::SeedableRng;
    let mut rng = ChaCha8Rng::seed_from_u64(u64::from(seed));
    if rng.random_range(0..4) == 0 {
        return None;
    }
    let mut changed = data.to_vec();
    mutate(&mut changed, &mut rng);
    changed.truncate(max_size);
    Some(changed)
}
