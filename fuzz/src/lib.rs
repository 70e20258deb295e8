//! Tests psfield's readers with damaged files.
//!
//! A *target* ([`targets`]) is a function from bytes that panics or returns. It reads the bytes as
//! one format, with every function that reads this format, and checks three things: every error
//! names the file, no read takes more than a second of processor time or much memory ([`limits`]),
//! and data that were read can be written and read again. Two programs use the targets:
//!
//! * `cargo fuzz` follows the coverage of the Rust code (`fuzz_targets/`).
//! * `seeded-run` needs only Rust and a C compiler. It runs a given number of cases without
//!   coverage. Each case is a pure function of a seed and its number. `.ci/run` uses it.
//!
//! Both damage files with [`mutate`], which knows FITS and text: random bytes would hardly get past
//! a header. They start from [`seeds`], small files made by psfield's writers and by the tests'
//! file makers.

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

/// Mutations do not make a file larger than this.
pub const LARGEST: usize = 1 << 17;
/// The largest number of mutations of one case.
const MOST_MUTATIONS: usize = 5;

/// Damages a file: FITS by its structure, gzip byte by byte, other files as text.
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

/// A target of `cargo fuzz`. libFuzzer mutates every fourth case, [`mutate`] the others.
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

/// A damaged copy of at most `max_size` bytes, or `None` for every fourth seed.
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
