//! The random numbers of a source, which depend on the source and on the run's seed alone.

use std::convert::Infallible;

use rand::TryRng;
use rand::rand_core::utils::fill_bytes_via_next_word;

/// The generator SplitMix64 (Steele, Lea and Flood 2014, OOPSLA, 453): a counter whose values are mixed. So a
/// source's numbers need no preparation, and a processor can compute several at the same time.
#[derive(Debug, Clone)]
pub(super) struct PhotonRng(u64);

/// The counter's step: 2^64 divided by the golden ratio.
const STEP: u64 = 0x9e37_79b9_7f4a_7c15;

#[inline(always)]
fn mixed(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A number that follows from some others.
pub(super) fn hash(values: impl IntoIterator<Item = u64>) -> u64 {
    values
        .into_iter()
        .fold(STEP, |sum, value| mixed(sum.wrapping_add(STEP) ^ value))
}

impl PhotonRng {
    /// The numbers of a source, which follow from the run's seed, from its data and from the number of equal
    /// sources before it.
    pub(super) fn new(from: [u64; 4]) -> Self {
        Self(hash(from))
    }

    #[inline(always)]
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(STEP);
        mixed(self.0)
    }

    /// Computes the next words, but does not count them as used.
    #[inline(always)]
    pub(super) fn look_ahead(&self, words: &mut [u64]) {
        for (place, word) in (1..).zip(words) {
            *word = mixed(self.0.wrapping_add(STEP.wrapping_mul(place)));
        }
    }

    /// Counts some words as used.
    #[inline(always)]
    pub(super) fn skip(&mut self, words: usize) {
        self.0 = self.0.wrapping_add(STEP.wrapping_mul(words as u64));
    }
}

/// Random words that were computed together.
pub(super) struct RandomWords<'a> {
    words: &'a [u64],
    /// The number of words that were used.
    pub(super) used: usize,
}

impl<'a> RandomWords<'a> {
    #[inline(always)]
    pub(super) fn new(words: &'a [u64]) -> Self {
        Self { words, used: 0 }
    }

    #[inline(always)]
    pub(super) fn next(&mut self) -> u64 {
        let word = self.words[self.used];
        self.used += 1;
        word
    }

    /// A number from 0 to 1, without 1.
    #[inline(always)]
    pub(super) fn uniform(&mut self) -> f64 {
        (self.next() >> 11) as f64 * (0.5 * f64::EPSILON)
    }
}

impl TryRng for PhotonRng {
    type Error = Infallible;

    #[inline(always)]
    fn try_next_u32(&mut self) -> Result<u32, Infallible> {
        Ok((self.next() >> 32) as u32)
    }

    #[inline(always)]
    fn try_next_u64(&mut self) -> Result<u64, Infallible> {
        Ok(self.next())
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Infallible> {
        fill_bytes_via_next_word(bytes, || self.try_next_u64())
    }
}
