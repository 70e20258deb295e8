//! The dispersion of the atmosphere: light of each wavelength is shifted by another distance.

use std::str::FromStr;

use ndarray::{Array2, Array3, Axis};
use psf_basis::{PixelNoise, RankSelection};
use psf_types::{DataError, PsfModelRecord, PsfSamples, SamplePositions, StampGrid, StateKind};
use rayon::prelude::*;
use rustfft::num_complex::Complex64;
use spectra::{Atmosphere, Bandpass, PhotonFraction, Spectrum};

use crate::error::{ErrorKind, PsfieldError};
use crate::fit::FitOptions;
use crate::psf::Psf;
use crate::stack_size::check_stack;
use crate::stamp_plane::{Line, StampPlane, margin_of, widened};

/// The dispersion of the atmosphere on a frame. It shifts light of wavelength `lambda` towards the
/// zenith by `[R(lambda) - R(reference)] / pixel_scale` pixels, with the refraction `R`
/// ([`Atmosphere::refraction_arcsec`]).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dispersion {
    /// The atmosphere, and the zenith distance.
    pub atmosphere: Atmosphere,
    /// The direction of the zenith on the frame, in degrees from +x towards +y.
    pub zenith_direction_deg: f64,
    /// The size of a frame pixel in arcseconds.
    pub pixel_scale_arcsec: f64,
    /// The wavelength in micrometres whose light is not shifted. None: the mean wavelength of the
    /// bandpass, weighted with the throughput.
    pub reference_um: Option<f64>,
}

/// The largest relative L2 error of the basis of dispersed PSFs.
const BASIS_ERROR: f64 = 1e-6;

impl Dispersion {
    /// The shift `(dx, dy)` of light of a wavelength in micrometres, in frame pixels.
    ///
    /// ```
    /// use psfield::Dispersion;
    /// use psfield::spectra::Atmosphere;
    /// let dispersion = Dispersion {
    ///     atmosphere: Atmosphere::new(45.0)?,
    ///     zenith_direction_deg: 90.0,
    ///     pixel_scale_arcsec: 0.2,
    ///     reference_um: Some(0.5),
    /// };
    /// // Blue light is refracted more, towards the zenith.
    /// let (dx, dy) = dispersion.shift_px(0.4, 0.5);
    /// assert!(dx.abs() < 1e-12 && dy > 3.0);
    /// # Ok::<(), psfield::spectra::SpectraError>(())
    /// ```
    pub fn shift_px(&self, wavelength_um: f64, reference_um: f64) -> (f64, f64) {
        let refraction = |um| self.atmosphere.refraction_arcsec(um);
        let length = (refraction(wavelength_um) - refraction(reference_um)) / self.pixel_scale_arcsec;
        let (sine, cosine) = self.zenith_direction_deg.to_radians().sin_cos();
        (length * cosine, length * sine)
    }

    /// The wavelength whose light is not shifted.
    fn reference(&self, bandpass: &Bandpass) -> Result<f64, PsfieldError> {
        if let Some(um) = self.reference_um {
            return Ok(um);
        }
        // Photons per wavelength of this spectrum are constant.
        let flat = spectra::photons(bandpass, &Spectrum::power_law(-1.0)?, &[])?;
        Ok(flat.iter().map(|f| f.weight * f.wavelength_um).sum())
    }

    fn check(&self) -> Result<(), PsfieldError> {
        let above_zero = |value: f64| value > 0.0 && value.is_finite();
        let (scale, direction) = (self.pixel_scale_arcsec, self.zenith_direction_deg);
        let message = if !above_zero(scale) {
            format!("the pixel scale of the dispersion must be a number of arcseconds above 0, not {scale}")
        } else if !direction.is_finite() {
            format!("the direction of the zenith must be a finite number of degrees, not {direction}")
        } else if let Some(um) = self.reference_um.filter(|&um| !above_zero(um)) {
            format!("the reference wavelength of the dispersion must be above 0 micrometres, not {um}")
        } else {
            return Ok(());
        };
        Err(PsfieldError::new(ErrorKind::Data, message))
    }
}

/// Text form: `key=value`, separated by commas. `zenith` (the zenith distance in degrees) and `scale`
/// (arcseconds per frame pixel) are required. `direction` is that of the zenith (degrees from +x
/// towards +y, 90 by default), `reference` the wavelength without a shift (micrometres). `pressure`
/// (hPa), `temperature` (Celsius) and `humidity` (0 to 1) describe the air ([`Atmosphere::new`] gives
/// their defaults).
///
/// ```
/// let dispersion: psfield::Dispersion = "zenith=50,scale=0.2,pressure=750,humidity=0.1".parse()?;
/// assert_eq!(dispersion.zenith_direction_deg, 90.0);
/// assert!("zenith=50".parse::<psfield::Dispersion>().is_err());
/// # Ok::<(), psfield::PsfieldError>(())
/// ```
impl FromStr for Dispersion {
    type Err = PsfieldError;
    fn from_str(text: &str) -> Result<Self, PsfieldError> {
        const KEYS: [&str; 7] = [
            "zenith",
            "scale",
            "direction",
            "reference",
            "pressure",
            "temperature",
            "humidity",
        ];
        const ALLOWED: &str = "key=number, separated by commas, with zenith (degrees) and scale (arcsec per pixel), and if needed direction, reference, pressure, temperature and humidity";
        let refused = || PsfieldError::from(DataError::setting("the dispersion", ALLOWED, text));
        let mut given = [None; KEYS.len()];
        for part in text.split(',') {
            let (key, number) = part.split_once('=').ok_or_else(refused)?;
            let place = KEYS
                .iter()
                .position(|known| *known == key.trim())
                .ok_or_else(refused)?;
            let number: f64 = number.trim().parse().map_err(|_| refused())?;
            if given[place].replace(number).is_some() {
                return Err(refused());
            }
        }
        let [
            zenith,
            scale,
            direction,
            reference_um,
            pressure,
            temperature,
            humidity,
        ] = given;
        let mut atmosphere = Atmosphere::new(zenith.ok_or_else(refused)?)?;
        if let Some(pressure_hpa) = pressure {
            atmosphere = atmosphere.with_pressure_hpa(pressure_hpa)?;
        }
        if let Some(temperature_c) = temperature {
            atmosphere = atmosphere.with_temperature_c(temperature_c)?;
        }
        if let Some(humidity) = humidity {
            atmosphere = atmosphere.with_humidity(humidity)?;
        }
        let dispersion = Self {
            atmosphere,
            zenith_direction_deg: direction.unwrap_or(90.0),
            pixel_scale_arcsec: scale.ok_or_else(refused)?,
            reference_um,
        };
        dispersion.check()?;
        Ok(dispersion)
    }
}

/// The photons of a spectrum: how much the state of each wavelength of the samples counts, and by how many
/// stamp pixels its light is shifted.
type Shifted = Vec<(usize, Line)>;

impl Psf {
    /// The PSFs of spectra through a dispersing atmosphere: as [`for_spectra`](Self::for_spectra), with
    /// the light of each wavelength shifted by [`Dispersion::shift_px`].
    ///
    /// PSFs are interpolated over the wavelength while they are centred, and shifted afterwards, so that
    /// the shift of a wavelength between two samples is exact. The shifts are made in Fourier space. So
    /// stamps should be well sampled: two or more pixels per frame pixel, better four. The result has a
    /// basis of its own, with an error of at most 1e-6, and wider stamps.
    ///
    /// # Errors
    /// The errors of [`for_spectra`](Self::for_spectra), [`ErrorKind::Data`] for a dispersion with a
    /// value out of range, and [`ErrorKind::TooLarge`] if the stamps would fill too much memory.
    pub fn for_dispersed_spectra(
        &self,
        bandpass: &Bandpass,
        spectra: &[Spectrum],
        dispersion: &Dispersion,
    ) -> Result<Self, PsfieldError> {
        dispersion.check()?;
        let wavelengths = self.wavelengths()?;
        let undivided = self.undivided()?;
        let (record, grid) = (undivided.record_without_wings()?, undivided.grid());
        let reference = dispersion.reference(bandpass)?;
        let shifted: Vec<Shifted> = spectra
            .iter()
            .map(|spectrum| {
                let of_photon = |photon: PhotonFraction| {
                    let (dx, dy) = dispersion.shift_px(photon.wavelength_um, reference);
                    let states = coeff_field::state_weights(wavelengths, photon.wavelength_um);
                    states.into_iter().map(move |(state, weight)| {
                        let line = Line {
                            weight: weight * photon.weight,
                            middle: [dx, dy].map(|shift| shift * grid.oversampling()),
                            length: [0.0, 0.0],
                        };
                        (state, line)
                    })
                };
                let photons = self.photons_of(bandpass, spectrum)?.into_iter();
                Ok(photons.flat_map(of_photon).collect())
            })
            .collect::<Result<_, PsfieldError>>()?;
        let all = || shifted.iter().flatten();
        let margin = [0, 1].map(|axis| margin_of(all().map(|(_, line)| line.middle[axis])));
        let wide = widened(grid, margin)?;
        let (nodes, stamps) = stamps_at_nodes(record, wavelengths)?;
        check_stack(nodes.len() * spectra.len(), wide)?;
        let mixed = dispersed(&stamps, nodes.len(), &shifted, margin, wide);
        let numbers: Vec<f64> = (0..).take(spectra.len()).map(f64::from).collect();
        let (at, field) = (nodes.as_slice(), nodes.field());
        let positions = SamplePositions::in_every_state(at, field, StateKind::Spectrum, &numbers)?;
        let options = FitOptions {
            rank: RankSelection::Error(BASIS_ERROR),
            noise: PixelNoise::Known(0.0),
            interpolation: record.interpolation(),
            outside: record.outside(),
            normalisation: record.normalisation(),
            ..FitOptions::default()
        };
        Ok(Self::new(PsfSamples::new(mixed, positions, wide)?, options))
    }
}

/// The nodes of all wavelengths, and the stamps `[wavelength and node, y, x]` at them.
fn stamps_at_nodes(
    record: &PsfModelRecord,
    wavelengths: &[f64],
) -> Result<(SamplePositions, Array3<f64>), PsfieldError> {
    let method = (record.interpolation(), record.outside());
    let each = Array2::eye(wavelengths.len());
    let labels = Some((StateKind::Wavelength, wavelengths));
    let on_nodes = coeff_field::mix_states(record.coefficients(), method, each.view(), labels)?;
    let nodes = on_nodes.of_state(0).positions().clone();
    let (basis, grid) = (record.basis(), record.basis().grid());
    check_stack(on_nodes.values().nrows(), grid)?;
    let components = basis.components();
    let flat = components
        .into_shape_with_order((basis.rank(), grid.pixel_count()))
        .expect("components are row-major");
    let stamps = on_nodes.values().dot(&flat);
    let shape = (stamps.nrows(), grid.ny(), grid.nx());
    let mut stamps = stamps.into_shape_with_order(shape).expect("row-major");
    if let Some(mean) = basis.mean() {
        stamps += &mean;
    }
    Ok((nodes, stamps))
}

/// The dispersed stamps `[spectrum and node, y, x]` on a wider grid.
fn dispersed(
    stamps: &Array3<f64>,
    nodes: usize,
    spectra: &[Shifted],
    margin: [usize; 2],
    wide: StampGrid,
) -> Array3<f64> {
    let plane = StampPlane::new(wide.dim(), 1);
    let transformed: Vec<Array2<Complex64>> = (0..stamps.dim().0)
        .into_par_iter()
        .map(|stamp| plane.forward(&[stamps.index_axis(Axis(0), stamp)], margin))
        .collect();
    let states = stamps.dim().0 / nodes;
    // The factor of a state's stamps in Fourier space. None if the state does not count.
    let factor = |spectrum: &Shifted, state: usize| {
        let own = spectrum.iter().filter(|photon| photon.0 == state);
        let own: Vec<Line> = own.map(|&(_, line)| line).collect();
        (!own.is_empty()).then(|| plane.shift_factor(&own))
    };
    let factors: Vec<Vec<_>> = spectra
        .par_iter()
        .map(|spectrum| (0..states).map(|state| factor(spectrum, state)).collect())
        .collect();
    let mut mixed = Array3::zeros((spectra.len() * nodes, wide.ny(), wide.nx()));
    let planes: Vec<_> = mixed.outer_iter_mut().collect();
    planes.into_par_iter().enumerate().for_each(|(number, mut into)| {
        let (spectrum, node) = (number / nodes, number % nodes);
        let mut sum = Array2::zeros(plane.shape());
        for (state, factor) in factors[spectrum].iter().enumerate() {
            if let Some(factor) = factor {
                ndarray::Zip::from(&mut sum)
                    .and(factor)
                    .and(&transformed[state * nodes + node])
                    .for_each(|sum, f, t| *sum += f * t);
            }
        }
        into.assign(&plane.inverse(sum)[0]);
    });
    mixed
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;
    use psf_types::{Position, SampleStates};
    use spectra::Curve;

    use super::*;

    /// The largest error of a centroid, in frame pixels.
    const CENTROID: f64 = 2e-4;

    /// A Gaussian that widens with the wavelength, with `oversampling` pixels per frame pixel.
    fn psf(oversampling: f64) -> Psf {
        let wavelengths = [0.4, 0.5, 0.6, 0.7, 0.8];
        let size = 40 * oversampling as usize + 1;
        let middle = (size / 2) as f64;
        let stamps = Array3::from_shape_fn((5, size, size), |(j, y, x)| {
            let sigma = (1.5 + wavelengths[j]) * oversampling;
            let square = (y as f64 - middle).powi(2) + (x as f64 - middle).powi(2);
            (-square / (2.0 * sigma * sigma)).exp()
        });
        let states = SampleStates::new(StateKind::Wavelength, &wavelengths).unwrap();
        let at = vec![Position::of_pixel(50, 50); 5];
        let positions = SamplePositions::with_states(at, None, Some(states)).unwrap();
        let grid = StampGrid::new(size, size)
            .unwrap()
            .with_oversampling(oversampling)
            .unwrap();
        Psf::new(
            PsfSamples::new(stamps, positions, grid).unwrap(),
            FitOptions::default(),
        )
    }

    fn bandpass() -> Bandpass {
        let curve = Curve::new(vec![0.42, 0.45, 0.75, 0.78], vec![0.0, 1.0, 1.0, 0.0]);
        Bandpass::new(curve.unwrap())
    }

    fn dispersion(zenith_distance: f64) -> Dispersion {
        Dispersion {
            atmosphere: Atmosphere::new(zenith_distance).unwrap(),
            zenith_direction_deg: 30.0,
            pixel_scale_arcsec: 0.2,
            reference_um: None,
        }
    }

    #[test]
    fn a_star_moves_by_the_mean_shift_of_its_photons() {
        let (psf, bandpass) = (psf(2.0), bandpass());
        let spectra = [
            Spectrum::black_body(3000.0).unwrap(),
            Spectrum::black_body(15_000.0).unwrap(),
        ];
        for zenith_distance in [0.0, 30.0, 60.0] {
            let dispersion = dispersion(zenith_distance);
            let reference = dispersion.reference(&bandpass).unwrap();
            let mixed = psf
                .for_dispersed_spectra(&bandpass, &spectra, &dispersion)
                .unwrap();
            for (spectrum, model) in spectra.iter().zip(mixed.models().unwrap()) {
                let stamp = model.psf_at(Position::of_pixel(50, 50)).unwrap();
                let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
                for ((row, column), &value) in stamp.values().indexed_iter() {
                    sum += value;
                    x += value * (column as f64 - stamp.grid().centre_x()) / 2.0;
                    y += value * (row as f64 - stamp.grid().centre_y()) / 2.0;
                }
                let mut expected = (0.0, 0.0);
                for fraction in spectra::photons(&bandpass, spectrum, &[]).unwrap() {
                    let (dx, dy) = dispersion.shift_px(fraction.wavelength_um, reference);
                    expected = (
                        expected.0 + fraction.weight * dx,
                        expected.1 + fraction.weight * dy,
                    );
                }
                assert!((sum / 4.0 - 1.0).abs() < 1e-9);
                let (dx, dy) = (x / sum - expected.0, y / sum - expected.1);
                assert!(
                    dx.abs() < CENTROID && dy.abs() < CENTROID,
                    "{zenith_distance}: {dx:e} {dy:e}"
                );
            }
        }
    }

    #[test]
    fn without_refraction_the_psf_is_that_of_the_spectrum() {
        let (psf, bandpass) = (psf(2.0), bandpass());
        let spectrum = [Spectrum::power_law(0.0).unwrap()];
        let plain = psf.for_spectra(&bandpass, &spectrum).unwrap();
        let moved = psf
            .for_dispersed_spectra(&bandpass, &spectrum, &dispersion(0.0))
            .unwrap();
        let position = Position::of_pixel(50, 50);
        let [plain, moved] = [plain, moved].map(|psf| psf.models().unwrap()[0].psf_at(position).unwrap());
        let margin = moved.grid().centre_x() as usize - plain.grid().centre_x() as usize;
        for ((y, x), value) in plain.values().indexed_iter() {
            let other = moved.values()[(y + margin, x + margin)];
            assert!(
                (value - other).abs() < 1e-5 * plain.values()[(40, 40)],
                "{value} {other}"
            );
        }
        let wrong = Dispersion {
            pixel_scale_arcsec: 0.0,
            ..dispersion(10.0)
        };
        assert!(psf.for_dispersed_spectra(&bandpass, &spectrum, &wrong).is_err());
    }
}
