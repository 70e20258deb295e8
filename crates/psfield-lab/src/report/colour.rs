//! Stars of several temperatures in a bandpass, compared with the optics.

use ndarray::Array2;
use psf_optics::Telescope;
use psf_types::{Position, PsfSource};
use psfield::spectra::{Bandpass, Spectrum};
use rayon::prelude::*;
use serde::Serialize;

use crate::LabError;
use crate::bench::{bandpass, psf_of_wavelengths};
use crate::plot::{Axis, Chart, Curve, Marker};
use crate::report::document::{Section, short};
use crate::report::scenes::true_psfs;
use crate::report::{ObjectRow, Target};

/// Wavelengths in micrometres of the samples.
const WAVELENGTHS_UM: [f64; 9] = [0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85];
/// Number of wavelengths of the true PSF.
const TRUE_WAVELENGTHS: usize = 100;
/// Temperatures in kelvin: the lowest, the highest, and how many.
const TEMPERATURES: (f64, f64, usize) = (2500.0, 20_000.0, 13);
/// Names of the positions, and their distances from the middle of the frame in x and in y, in units
/// of the distance of the corners.
const PLACES: [(&str, f64); 3] = [("centre", 0.0), ("half-way", 0.5), ("corner", 0.96)];
/// Target for the largest relative error of the FWHM.
const FWHM_ERROR: f64 = 1e-3;
/// Target for the largest difference of the ellipticity.
const ELLIPTICITY_DIFFERENCE: f64 = 1e-3;

/// PSFs of stars with the spectra of black bodies, seen in one bandpass, compared with the truth.
///
/// The model is fitted to samples at a few wavelengths and gives the PSF of each spectrum
/// ([`for_spectra`](psfield::Psf::for_spectra)). The true PSF is the sum of the PSFs of the optics
/// at many wavelengths, each weighted with the detected photons, at the position of the star.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ColourComparison {
    /// First and last wavelength of the bandpass, in micrometres.
    pub bandpass_um: [f64; 2],
    /// Wavelengths of the samples, in micrometres.
    pub wavelengths_um: Vec<f64>,
    /// Number of samples at each wavelength, along each axis of a regular grid.
    pub samples_across: usize,
    /// Number of components of the model, the mean not counted.
    pub rank: usize,
    /// Number of wavelengths of the true PSF.
    pub true_wavelengths: usize,
    /// The stars, position by position.
    pub stars: Vec<ColourRow>,
}

/// A star, measured in the PSF of the model and in the true PSF.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ColourRow {
    /// The name of the position.
    pub place: &'static str,
    /// The temperature of the star, in kelvin.
    pub kelvin: f64,
    /// The measurements.
    #[serde(flatten)]
    pub object: ObjectRow,
}

impl ColourRow {
    /// FWHM in the model, divided by that in the truth, minus 1. None if one of them could not be
    /// measured.
    pub fn fwhm_error(&self) -> Option<f64> {
        Some(self.object.fwhm_difference_px()? / self.object.fwhm_px_true?)
    }

    /// Ellipticity `sqrt(e1^2 + e2^2)` in the model. None if it could not be measured.
    pub fn ellipticity(&self) -> Option<f64> {
        Some(self.object.e1?.hypot(self.object.e2?))
    }
}

impl ColourComparison {
    /// Fits a model to samples of the telescope at several wavelengths, and compares the PSFs of
    /// stars. With an even number of samples along each axis, no star has the position of a sample.
    ///
    /// # Errors
    /// [`LabError`] if the sampling or the fit fails, or if the optics cannot draw a PSF.
    pub(super) fn measure(telescope: &Telescope, samples_across: usize) -> Result<Self, LabError> {
        let bandpass = bandpass()?;
        let (low, high, count) = TEMPERATURES;
        let step = (high / low).powf(1.0 / (count - 1) as f64);
        let kelvins: Vec<f64> = (0..count).map(|k| low * step.powi(k as i32)).collect();
        let black_bodies = kelvins.iter().map(|&kelvin| Spectrum::black_body(kelvin));
        let spectra: Vec<Spectrum> = black_bodies.collect::<Result<_, _>>()?;
        let frame = telescope.field();
        let places = PLACES.map(|(_, distance)| {
            let along = |pixels: usize| f64::midpoint(1.0, distance) * (pixels - 1) as f64;
            Position::new(along(frame.nx()), along(frame.ny()))
        });
        let places: Vec<Position> = places.into_iter().collect::<Result<_, _>>()?;

        let psf = psf_of_wavelengths(telescope, &WAVELENGTHS_UM, samples_across)?;
        let of_spectra = psf.for_spectra(&bandpass, &spectra)?;
        let truth = psfs_of_spectra(telescope, &bandpass, &spectra, &places)?;
        let mut stars = Vec::with_capacity(places.len() * count);
        for ((&at, (place, _)), truth) in places.iter().zip(PLACES).zip(&truth) {
            for ((model, &kelvin), truth) in of_spectra.models()?.iter().zip(&kelvins).zip(truth) {
                let found = model.psf_at(at)?;
                let oversampling = found.grid().oversampling();
                stars.push(ColourRow {
                    place,
                    kelvin,
                    object: ObjectRow::measure(at, found.values(), truth.view(), oversampling),
                });
            }
        }
        Ok(Self {
            bandpass_um: bandpass.range_um().into(),
            wavelengths_um: WAVELENGTHS_UM.to_vec(),
            samples_across,
            rank: psf.record()?.basis().rank(),
            true_wavelengths: TRUE_WAVELENGTHS,
            stars,
        })
    }

    /// The targets for the largest errors.
    pub(super) fn targets(&self) -> [Target; 2] {
        let largest = |of: fn(&ColourRow) -> Option<f64>| {
            let errors: Option<Vec<f64>> = self.stars.iter().map(of).collect();
            Some(errors?.into_iter().map(f64::abs).fold(0.0, f64::max))
        };
        let (fwhm, ellipticity) = (
            largest(ColourRow::fwhm_error),
            largest(|star| star.object.ellipticity_difference()),
        );
        [
            Target::new("colours: largest relative error of the FWHM", FWHM_ERROR, fwhm),
            Target::new(
                "colours: largest difference of the ellipticity (e1, e2)",
                ELLIPTICITY_DIFFERENCE,
                ellipticity,
            ),
        ]
    }

    pub(super) fn section(&self) -> Section {
        let chart = |title: &str, y: Axis, of: fn(&ColourRow) -> Option<f64>| {
            let curves = PLACES.map(|(place, _)| {
                let stars = self.stars.iter().filter(|star| star.place == place);
                let points = stars.filter_map(|star| Some((star.kelvin, of(star)?)));
                Curve {
                    marker: Some(Marker::Circle),
                    ..Curve::new(place, points.collect())
                }
            });
            let (low, high, _) = TEMPERATURES;
            let x = Axis::logarithmic("temperature of the star (K)").within(0.9 * low, 1.1 * high);
            Chart::new(title, x, y, curves.into())
        };
        let charts = [
            chart("FWHM", Axis::linear("FWHM (pixels of the frame)"), |star| {
                star.object.fwhm_px
            }),
            chart(
                "ellipticity",
                Axis::linear("ellipticity sqrt(e1^2 + e2^2)"),
                ColourRow::ellipticity,
            ),
            chart(
                "relative error of the FWHM",
                Axis::logarithmic("|FWHM / true FWHM - 1|"),
                |star| star.fwhm_error().map(f64::abs),
            ),
            chart(
                "difference of the ellipticity",
                Axis::logarithmic("length of the difference of (e1, e2)"),
                |star| star.object.ellipticity_difference(),
            ),
        ];
        let [first, last] = self.bandpass_um;
        let text = format!(
            "A star with the spectrum of a black body, in the band from {first} to {last} um, at three \
             positions. psfield's model has {} components. It is fitted to {1} x {1} samples at each of {2} \
             wavelengths. The true PSF is the sum over {3} wavelengths of the optics' own PSF at the position \
             of the star, weighted with the detected photons. Short wavelengths are diffracted less, so that \
             the PSF of hot stars is narrower at the centre. But aberrations change their phase more, so that \
             it is wider in the corner.",
            self.rank,
            self.samples_across,
            self.wavelengths_um.len(),
            self.true_wavelengths,
        );
        let [fwhm, ellipticity] = self.targets().map(|target| short(target.measured));
        let caption = format!(
            "FWHM and ellipticity of a star's PSF against its temperature, by a Gaussian fit, and their \
             differences from the truth: at most {fwhm} and {ellipticity}."
        );
        Section::new("Stars of different colours", [&text]).with_figure("colour", &caption, &charts)
    }
}

/// Returns the true PSFs `[position][spectrum]`. The integral over the wavelength is a sum over
/// equal steps.
fn psfs_of_spectra(
    telescope: &Telescope,
    bandpass: &Bandpass,
    spectra: &[Spectrum],
    positions: &[Position],
) -> Result<Vec<Vec<Array2<f64>>>, LabError> {
    let (first, last) = bandpass.range_um();
    let step = (last - first) / TRUE_WAVELENGTHS as f64;
    let wavelengths: Vec<f64> = (0..TRUE_WAVELENGTHS)
        .map(|k| first + (k as f64 + 0.5) * step)
        .collect();
    let drawn = wavelengths.par_iter().map(|&um| {
        let telescope = telescope.at_wavelength_um(um)?;
        true_psfs(&telescope, positions)
    });
    let drawn: Vec<Vec<Array2<f64>>> = drawn.collect::<Result<_, LabError>>()?;
    let mean = |position: usize, spectrum: &Spectrum| {
        let mut sum = Array2::zeros(drawn[0][position].dim());
        let mut photons = 0.0;
        for (&um, psfs) in wavelengths.iter().zip(&drawn) {
            let weight = bandpass.throughput().at(um) * spectrum.photon_density(um);
            sum.scaled_add(weight, &psfs[position]);
            photons += weight;
        }
        sum / photons
    };
    let of_position = |position| spectra.iter().map(|spectrum| mean(position, spectrum)).collect();
    Ok((0..positions.len()).map(of_position).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_those_of_the_worst_star_and_need_every_measurement() {
        let star = |fwhm: f64, e1: f64| ColourRow {
            place: "centre",
            kelvin: 5000.0,
            object: ObjectRow {
                fwhm_px: Some(fwhm),
                fwhm_px_true: Some(2.0),
                e1: Some(e1),
                e1_true: Some(0.1),
                e2: Some(0.2),
                e2_true: Some(0.2),
                ..ObjectRow::default()
            },
        };
        let targets = |stars: Vec<ColourRow>| {
            let comparison = ColourComparison {
                bandpass_um: [0.4, 0.8],
                wavelengths_um: WAVELENGTHS_UM.to_vec(),
                samples_across: 4,
                rank: 3,
                true_wavelengths: 9,
                stars,
            };
            comparison.targets()
        };
        let near = |target: &Target, value: f64| (target.measured.unwrap() - value).abs() < 1e-12;
        let found = targets(vec![star(2.0, 0.1005), star(1.99, 0.1)]);
        assert!(near(&found[0], 0.005) && !found[0].met, "{found:?}");
        assert!(near(&found[1], 0.0005) && found[1].met, "{found:?}");
        let mut failed = star(2.0, 0.1);
        failed.object.fwhm_px = None;
        assert_eq!((targets(vec![failed])[0].measured, found.len()), (None, 2));
    }
}
