//! Spectra and bandpasses by name, and the PSFs of spectra.

use std::path::Path;

use ndarray::Array2;
use psf_types::StateKind;
use spectra::{Bandpass, Curve, FluxDensity, PhotonFraction, SpectraError, Spectrum, photons};

use crate::error::{ErrorKind, PsfieldError};
use crate::psf::Psf;

/// The largest fraction of the detected photons that may have wavelengths outside those of the
/// samples. They get the PSF of the nearest sample.
const MAX_OUTSIDE: f64 = 1e-3;

/// Makes a spectrum from its name: `blackbody:KELVIN`, `powerlaw:INDEX` (`f_lambda` proportional to
/// `lambda^INDEX`), or a file with a table of wavelengths and values ([`psf_io::read_curve`]).
///
/// Behind the name of a file may stand the unit of the wavelengths (`:um`, `:nm`, `:Angstrom`, `:mm`,
/// `:m`) and the meaning of the values: `:flambda` (energy per wavelength, default), `:fnu` (energy
/// per frequency) or `:photons`. At the end of any name, `@z=REDSHIFT` sets the redshift.
///
/// ```
/// let star = psfield::colours::open_spectrum("blackbody:5800")?;
/// let quasar = psfield::colours::open_spectrum("powerlaw:-1.5@z=2")?;
/// assert_eq!((star.redshift(), quasar.redshift()), (0.0, 2.0));
/// # Ok::<(), psfield::PsfieldError>(())
/// ```
///
/// # Errors
/// [`ErrorKind::Data`] for a name or a table that is no spectrum, [`ErrorKind::Io`] when the file
/// cannot be read or does not state its unit.
pub fn open_spectrum(name: &str) -> Result<Spectrum, PsfieldError> {
    if name.starts_with("blackbody:") || name.starts_with("powerlaw:") {
        return Ok(name.parse()?);
    }
    let (file, redshift) = Spectrum::split_redshift(name)?;
    let (file, values) = split_values(file);
    let spectrum = Spectrum::table(open_curve(file, false)?, values.unwrap_or_default());
    Ok(spectrum.with_redshift(redshift)?)
}

/// The file that the name of a spectrum ([`open_spectrum`]) begins with. None for a black body or a power
/// law.
///
/// ```
/// assert_eq!(psfield::colours::spectrum_file("galaxy.txt:nm:photons@z=0.5"), Some("galaxy.txt"));
/// assert_eq!(psfield::colours::spectrum_file("blackbody:5800"), None);
/// ```
pub fn spectrum_file(name: &str) -> Option<&str> {
    if name.starts_with("blackbody:") || name.starts_with("powerlaw:") {
        return None;
    }
    let file = Spectrum::split_redshift(name).map_or(name, |(file, _)| file);
    Some(bandpass_file(split_values(file).0))
}

/// The name of a spectrum ([`open_spectrum`]), whose file, if its path is relative, is in a folder.
pub fn spectrum_in(folder: &Path, name: &str) -> String {
    match spectrum_file(name) {
        None => name.to_owned(),
        // The file is the beginning of the name.
        Some(_) => folder.join(name).to_string_lossy().into_owned(),
    }
}

/// The file that the name of a bandpass ([`open_bandpass`]) begins with.
pub fn bandpass_file(name: &str) -> &str {
    split_unit(name).0
}

/// Splits the meaning of the values off the end of a name.
fn split_values(name: &str) -> (&str, Option<FluxDensity>) {
    let parts = name.rsplit_once(':');
    parts
        .and_then(|(before, last)| Some((before, Some(last.parse().ok()?))))
        .unwrap_or((name, None))
}

/// Splits the unit of the wavelengths off the end of a name.
fn split_unit(name: &str) -> (&str, Option<&str>) {
    match name.rsplit_once(':') {
        Some((file, unit)) if psf_io::is_wavelength_unit(unit) => (file, Some(unit)),
        _ => (name, None),
    }
}

/// Reads a bandpass: a table of wavelengths and throughputs ([`psf_io::read_curve`]). Behind the name
/// of the file may stand the unit of the wavelengths, as for [`open_spectrum`].
///
/// # Errors
/// [`ErrorKind::Data`] for a table that is no bandpass, [`ErrorKind::Io`] when the file cannot be read
/// or does not state its unit.
pub fn open_bandpass(name: &str) -> Result<Bandpass, PsfieldError> {
    Ok(Bandpass::new(open_curve(name, true)?))
}

/// Reads the curve of `FILE` or `FILE:UNIT`. If it is the `only` one, further curves in the file are an
/// error.
fn open_curve(name: &str, only: bool) -> Result<Curve, PsfieldError> {
    let (file, unit) = split_unit(name);
    let (wavelengths_um, values) = psf_io::read_curve(file, unit, only)?;
    Curve::new(wavelengths_um, values)
        .map_err(|error| PsfieldError::new(ErrorKind::Data, format!("{file}: {error}")).because(error))
}

impl Psf {
    /// The PSFs of spectra: `h_p = int h(lambda) f_p lambda T d lambda / int f_p lambda T d lambda`,
    /// the mean over the detected photons of each spectrum `f_p` in the bandpass `T`.
    ///
    /// This PSF must depend on the wavelength. Between the wavelengths of the samples its
    /// coefficients are interpolated as by [`at_state`](Self::at_state). The result has the same
    /// basis, and one state for each spectrum, numbered from 0.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] if the PSF does not depend on the wavelength, if a spectrum has no light
    /// in the bandpass or is unknown in a part of it, or if more than 0.1 % of the detected photons
    /// have wavelengths outside those of the samples. The errors of [`record`](Self::record).
    ///
    /// # Panics
    /// When there are no spectra.
    pub fn for_spectra(&self, bandpass: &Bandpass, spectra: &[Spectrum]) -> Result<Self, PsfieldError> {
        assert!(!spectra.is_empty(), "at least one spectrum");
        let wavelengths = self.wavelengths()?;
        let mut mixtures = Array2::zeros((spectra.len(), wavelengths.len()));
        for (spectrum, mut weights) in spectra.iter().zip(mixtures.outer_iter_mut()) {
            for fraction in self.photons_of(bandpass, spectrum)? {
                for (state, weight) in coeff_field::state_weights(wavelengths, fraction.wavelength_um) {
                    weights[state] += fraction.weight * weight;
                }
            }
        }
        let numbers: Vec<f64> = (0..).take(spectra.len()).map(f64::from).collect();
        self.mixed(mixtures.view(), Some((StateKind::Spectrum, &numbers)))
    }

    /// The detected photons of a spectrum. At most 0.1 % of them have wavelengths outside those of the
    /// samples.
    pub(crate) fn photons_of(
        &self,
        bandpass: &Bandpass,
        spectrum: &Spectrum,
    ) -> Result<Vec<PhotonFraction>, PsfieldError> {
        let wavelengths = self.wavelengths()?;
        let (first, last) = (wavelengths[0], wavelengths[wavelengths.len() - 1]);
        let found = photons(bandpass, spectrum, wavelengths)?;
        let is_outside = |f: &&PhotonFraction| !(first..=last).contains(&f.wavelength_um);
        let outside: f64 = found.iter().filter(is_outside).map(|f| f.weight).sum();
        if outside <= MAX_OUTSIDE {
            return Ok(found);
        }
        let (low, high) = bandpass.range_um();
        let message = format!(
            "{:.1} % of the photons that the bandpass ({low} to {high} um) detects have wavelengths outside those of \
             the PSF's samples ({first} to {last} um): sample the PSF at more wavelengths, or cut the bandpass",
            100.0 * outside
        );
        Err(PsfieldError::new(ErrorKind::Data, message))
    }

    /// The wavelengths of the samples, two or more.
    pub(crate) fn wavelengths(&self) -> Result<&[f64], PsfieldError> {
        let problem = match self.states() {
            Some(states) if states.kind() == StateKind::Wavelength => match states.values() {
                [only] => format!("all samples of the PSF have the wavelength {only} um"),
                several => return Ok(several),
            },
            Some(states) => format!("the PSF depends on the {}, not on the wavelength", states.kind()),
            None => "the PSF does not depend on the wavelength".to_owned(),
        };
        let message = format!(
            "{problem}, so that spectra make no difference: leave them out, or give samples at two or more wavelengths \
             (column WAVELENGTH)"
        );
        Err(PsfieldError::new(ErrorKind::Data, message))
    }
}

impl From<SpectraError> for PsfieldError {
    fn from(error: SpectraError) -> Self {
        Self::new(ErrorKind::Data, error.to_string()).because(error)
    }
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;
    use psf_types::{Position, PsfSamples, SamplePositions, SampleStates, StampGrid};

    use super::*;

    /// Rounding of sums over wavelengths, relative to the peak.
    const ROUNDING: f64 = 1e-12;

    /// A Gaussian that widens with the wavelength and with x.
    fn psf(wavelengths: &[f64]) -> Psf {
        let (mut at, mut states) = (Vec::new(), Vec::new());
        for &wavelength in wavelengths {
            for x in [0, 50] {
                at.push(Position::of_pixel(x, 0));
                states.push(wavelength);
            }
        }
        let stamps = Array3::from_shape_fn((at.len(), 21, 21), |(j, y, x)| {
            let sigma = 1.0 + states[j] + at[j].x() / 100.0;
            let square = (y as f64 - 10.0).powi(2) + (x as f64 - 10.0).powi(2);
            (-square / (2.0 * sigma * sigma)).exp()
        });
        let states = SampleStates::new(StateKind::Wavelength, &states).unwrap();
        let positions = SamplePositions::with_states(at, None, Some(states)).unwrap();
        let options = crate::fit::FitOptions {
            rank: psf_basis::RankSelection::Full,
            ..crate::fit::FitOptions::default()
        };
        Psf::new(
            PsfSamples::new(stamps, positions, StampGrid::new(21, 21).unwrap()).unwrap(),
            options,
        )
    }

    fn top_hat() -> Bandpass {
        Bandpass::new(Curve::new(vec![0.5, 0.501, 0.799, 0.8], vec![0.0, 1.0, 1.0, 0.0]).unwrap())
    }

    #[test]
    fn the_psf_of_a_spectrum_is_the_mean_over_its_photons() {
        let psf = psf(&[0.4, 0.5, 0.6, 0.7, 0.8, 0.9]);
        let spectra = [
            Spectrum::black_body(3000.0).unwrap(),
            Spectrum::power_law(-4.0).unwrap(),
        ];
        let mixed = psf.for_spectra(&top_hat(), &spectra).unwrap();
        let models = mixed.models().unwrap();
        assert_eq!(models.len(), 2);
        let position = Position::new(20.0, 0.0).unwrap();
        for (spectrum, model) in spectra.iter().zip(models) {
            let mut mean = Array2::zeros((21, 21));
            for fraction in photons(&top_hat(), spectrum, &[0.6, 0.7]).unwrap() {
                let at = psf.at_state(fraction.wavelength_um).unwrap();
                mean.scaled_add(
                    fraction.weight,
                    &at.model().unwrap().psf_at(position).unwrap().values(),
                );
            }
            let found = model.psf_at(position).unwrap();
            for (a, b) in found.values().iter().zip(&mean) {
                assert!((a - b).abs() < ROUNDING * mean[(10, 10)], "{a} {b}");
            }
        }
        // The red spectrum has the wider PSF.
        let peak = |model: &psf_types::PsfModel| model.psf_at(position).unwrap().values()[(10, 10)];
        assert!(peak(&models[0]) < peak(&models[1]));
    }

    #[test]
    fn bandpasses_beyond_the_samples_are_refused() {
        let spectrum = [Spectrum::power_law(0.0).unwrap()];
        let message = |psf: &Psf| psf.for_spectra(&top_hat(), &spectrum).unwrap_err().to_string();
        assert!(
            message(&psf(&[0.5, 0.6, 0.7])).contains("outside those of the PSF's samples (0.5 to 0.7 um)")
        );
        assert!(message(&psf(&[0.5])).contains("have the wavelength 0.5 um"));
        let plain = psf(&[0.5, 0.9]).at_state(0.6).unwrap();
        assert!(message(&plain).contains("does not depend on the wavelength"));
        // A narrow tail outside the samples is allowed.
        assert!(
            psf(&[0.5, 0.6, 0.7995])
                .for_spectra(&top_hat(), &spectrum)
                .is_ok()
        );
    }

    #[test]
    fn names_of_files_may_have_a_unit_a_meaning_and_a_redshift() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("sed.txt");
        std::fs::write(&path, "500 1\n800 4\n").unwrap();
        let name = |end: &str| format!("{}{end}", path.display());
        let curve = Curve::new(vec![0.5, 0.8], vec![1.0, 4.0]).unwrap();
        let plain = Spectrum::table(curve.clone(), FluxDensity::PerWavelength);
        assert_eq!(open_spectrum(&name(":nm")).unwrap(), plain);
        let far = Spectrum::table(curve.clone(), FluxDensity::Photons)
            .with_redshift(0.5)
            .unwrap();
        assert_eq!(open_spectrum(&name(":nm:photons@z=0.5")).unwrap(), far);
        assert_eq!(open_bandpass(&name(":NM")).unwrap(), Bandpass::new(curve));
        assert!(
            open_spectrum(&name(""))
                .unwrap_err()
                .to_string()
                .contains("unit of its wavelengths")
        );
        std::fs::write(&path, "800 1\n500 4\n").unwrap();
        let message = open_bandpass(&name(":nm")).unwrap_err().to_string();
        assert!(
            message.contains("sed.txt") && message.contains("must ascend"),
            "{message}"
        );
    }
}
