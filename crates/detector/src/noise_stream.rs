//! Random numbers that depend on the seed, the step and the row alone.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// A step of the chain that draws random numbers. The numbers are part of the results: they must not change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Step {
    Photons = 1,
    ReadNoise = 2,
    Response = 3,
    BadPixels = 4,
    BadColumns = 5,
}

/// Rows are counted below this, far beyond any frame.
const ROW_BITS: u32 = 56;

/// The stream of a row in a step. Streams of one seed never overlap, whatever they are used for.
pub(crate) fn noise_stream(seed: u64, step: Step, row: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(((step as u64) << ROW_BITS) | row as u64);
    rng
}

#[cfg(test)]
mod tests {
    use rand::RngExt;

    use super::*;

    #[test]
    fn streams_differ_by_seed_step_and_row() {
        let first = |seed, step, row| noise_stream(seed, step, row).random::<u64>();
        let all = [
            first(1, Step::Photons, 0),
            first(2, Step::Photons, 0),
            first(1, Step::ReadNoise, 0),
            first(1, Step::Response, 0),
            first(1, Step::BadPixels, 0),
            first(1, Step::BadColumns, 0),
            first(1, Step::Photons, 1),
            first(1, Step::Photons, 1 << 40),
        ];
        for (i, a) in all.iter().enumerate() {
            assert!(!all[..i].contains(a), "stream {i}");
        }
        assert_eq!(all[0], first(1, Step::Photons, 0));
    }
}
