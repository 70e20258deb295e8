//! The photon transfer curve: an observer's measurement of the detector from pairs of flat fields.

mod common;

use common::{detector, flat, moments};

/// Relative error of the gain. The variances of 1e6 pixels have an error of 1.4e-3 each, their mean
/// over eight levels about 1e-3.
const GAIN: f64 = 4e-3;
/// Relative error of the read noise from a pair of bias frames. Expected: 1e-3.
const READ_NOISE: f64 = 5e-3;

#[test]
fn gain_and_read_noise_come_out_of_pairs_of_flats() {
    let (gain, read_noise, bias) = (2.3, 6.0, 300.0);
    let ccd = detector(|d| {
        d.photon_noise = true;
        d.response_rms = 0.01;
        d.full_well_e = Some(60000.0);
        d.read_noise_e = read_noise;
        d.gain_e_per_adu = Some(gain);
        d.bias_adu = Some(bias);
        d.bits = Some(16);
    });
    // The difference of two flats has no fixed pattern, and twice the variance.
    let pair = |level: f64, seed: u64| {
        let [a, b] = [seed, seed + 1].map(|seed| ccd.expose(&flat(level), seed).unwrap().into_counts());
        let mean = moments(a.pixels()).mean;
        let single = moments(a.pixels()).variance;
        let difference = &a.pixels() - &b.pixels();
        (mean - bias, moments(difference.view()).variance / 2.0, single)
    };
    let (_, floor, _) = pair(0.0, 100);
    let (mut ratios, mut levels) = (0.0, 0.0);
    for (k, level) in [500.0, 1e3, 2e3, 5e3, 1e4, 2e4, 3e4, 4e4].into_iter().enumerate() {
        let (signal, variance, single) = pair(level, 2 * k as u64);
        // The relative error of the variance is the same at every level, so all levels get equal
        // weight.
        ratios += (variance - floor) / signal;
        levels += 1.0;
        // A single flat shows the response: its variance grows with the square of the signal.
        let pattern = (single - variance) / (signal * signal);
        if level >= 1e4 {
            assert!(
                (pattern.sqrt() - 0.01).abs() < 2e-4,
                "response {}",
                pattern.sqrt()
            );
        }
    }
    let measured = levels / ratios;
    assert!((measured / gain - 1.0).abs() < GAIN, "gain {measured}");
    // A converter adds a variance of 1/12 ADU^2.
    let noise = gain * (floor - 1.0 / 12.0).sqrt();
    assert!(
        (noise / read_noise - 1.0).abs() < READ_NOISE,
        "read noise {noise}"
    );
    // Beyond the full well the variance falls to that of the read noise.
    let (signal, variance, _) = pair(7e4, 50);
    assert!((signal - 60000.0 / gain).abs() < 0.1);
    assert!((variance / floor - 1.0).abs() < 2.0 * READ_NOISE);
}
