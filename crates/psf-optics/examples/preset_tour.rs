//! Draws the presets over the field and prints time, flux, size and the difference between
//! neighbouring PSFs.
//!
//! `cargo run --release -p psf-optics --example preset_tour`

use std::time::Instant;

use psf_optics::Telescope;
use psf_types::{Position, PsfSource};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for (name, telescope) in [
        ("survey_2m", Telescope::survey_2m()),
        ("wide_field_lens", Telescope::wide_field_lens()),
    ] {
        let field = telescope.field();
        let at = |u: f64, v: f64| {
            Position::new(
                (field.nx() - 1) as f64 * (u + 1.0) / 2.0,
                (field.ny() - 1) as f64 * (v + 1.0) / 2.0,
            )
        };
        telescope.draw(at(0.0, 0.0)?)?;
        let draws = 20;
        let start = Instant::now();
        for i in 0..draws {
            telescope.draw(at(f64::from(i) / f64::from(draws), 0.3)?)?;
        }
        println!(
            "{name}: {:.1} ms per PSF on one core",
            start.elapsed().as_secs_f64() * 1e3 / f64::from(draws)
        );
        let (mut sum, mut count, mut largest) = (0.0, 0.0, 0f64);
        for v in [1.0, 0.5, 0.0, -0.5, -1.0] {
            for u in [-1.0, -0.5, 0.0, 0.5, 1.0] {
                let stamp = telescope.draw(at(u, v)?)?;
                let step = 2.0 / 70.0;
                let other = telescope.draw(at(if u < 1.0 { u + step } else { u - step }, v)?)?;
                let above = telescope.draw(at(u, if v < 1.0 { v + step } else { v - step })?)?;
                let norm = |a: f64| a.sqrt();
                let sum2 = stamp.values().iter().map(|v| v * v).sum::<f64>();
                let d = |o: &psf_types::Stamp| {
                    norm(
                        stamp
                            .values()
                            .iter()
                            .zip(o.values())
                            .map(|(a, b)| (a - b).powi(2))
                            .sum::<f64>()
                            / sum2,
                    )
                };
                for d in [d(&other), d(&above)] {
                    (sum, count, largest) = (sum + d * d, count + 1.0, largest.max(d));
                }
                let peak = stamp.values().iter().copied().fold(0.0, f64::max);
                // The FWHM of the round Gaussian with the same flux and peak, as a rough size.
                let fwhm = (4.0 * std::f64::consts::LN_2 / std::f64::consts::PI * stamp.flux() / peak).sqrt();
                print!(
                    "  {:.4} {fwhm:.2}px {:.1}% {:.1}% |",
                    stamp.flux(),
                    100.0 * d(&other),
                    100.0 * d(&above)
                );
            }
            println!();
        }
        println!(
            "  neighbours of a 71 x 71 grid: r.m.s. {:.2}%, largest {:.2}%",
            100.0 * f64::sqrt(sum / count),
            100.0 * largest
        );
    }
    Ok(())
}
