//! The photons in the wings of sources, which are drawn pixel by pixel.

use ndarray::parallel::prelude::*;
use ndarray::{ArrayView2, ArrayViewMut2, Axis, Zip};
use psf_types::PixelRegion;
use rand_distr::{Distribution, Poisson};

use super::PhotonReport;
use super::random::PhotonRng;
use crate::ConvReal;

/// Makes the random numbers of pixels different from those of sources.
const OF_PIXELS: u64 = 0x57_49_4e_47_53;

/// Adds Poisson deviates to the counts of a region's pixels, whose means are `photons_per_flux` times `light`. Where
/// light is negative, they count as negative. The deviates depend on the seed and on the pixel of the frame.
pub(crate) fn add_photons_of_light<T: ConvReal>(
    light: ArrayView2<'_, T>,
    (photons_per_flux, seed): (f64, u64),
    region: PixelRegion,
    mut counts: ArrayViewMut2<'_, i32>,
    report: &mut PhotonReport,
) {
    let rows = counts.axis_iter_mut(Axis(0)).into_par_iter().enumerate();
    let of_rows: Vec<[f64; 3]> = rows
        .map(|(row, mut counts)| {
            let y = region.y0() + row as i64;
            let mut sums = [0.0; 3];
            let mut x = region.x0();
            Zip::from(&mut counts)
                .and(light.row(row))
                .for_each(|count, light| {
                    let mean = photons_per_flux * light.as_f64();
                    // A mean of 0 and one that is not finite have no deviates.
                    if let Ok(poisson) = Poisson::new(mean.abs()) {
                        let mut rng = PhotonRng::new([seed, OF_PIXELS, x as u64, y as u64]);
                        let photons: f64 = poisson.sample(&mut rng);
                        *count = count.saturating_add((photons * mean.signum()) as i32);
                        let of_pixel = [mean, photons, photons * mean.signum()];
                        sums.iter_mut().zip(of_pixel).for_each(|(sum, v)| *sum += v);
                    }
                    x += 1;
                });
            sums
        })
        .collect();
    for [mean, photons, counted] in of_rows {
        report.mean += mean;
        report.photons += photons as u64;
        report.counted += counted as i64;
    }
}
