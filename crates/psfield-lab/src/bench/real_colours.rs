//! PSFs of several spectra, from the optics at several wavelengths.

use psf_optics::Telescope;
use psf_sample::{UniformSampling, draw_states};
use psf_types::{NoProgress, PsfModelRecord, PsfSource, SampleStates, StateKind};
use psfield::spectra::{Bandpass, Curve, Spectrum};
use psfield::{FitOptions, Psf, PsfieldError};

/// The bandpass: wavelengths in micrometres and throughputs.
const BANDPASS: ([f64; 4], [f64; 4]) = ([0.45, 0.47, 0.83, 0.85], [0.0, 1.0, 1.0, 0.0]);
/// Temperatures in kelvin of the black bodies of [`RealGroup::Colours`](crate::bench::RealGroup).
pub(super) const KELVINS: [f64; 5] = [2500.0, 4000.0, 6000.0, 10_000.0, 20_000.0];
/// Number of PSF samples at each wavelength, along each axis.
const SAMPLES_ACROSS: usize = 17;
/// Wavelengths of the samples, in micrometres.
const WAVELENGTHS_UM: [f64; 5] = [0.45, 0.55, 0.65, 0.75, 0.85];

/// A wide band in the visible.
pub(crate) fn bandpass() -> Result<Bandpass, PsfieldError> {
    let (wavelengths_um, throughputs) = BANDPASS;
    Ok(Bandpass::new(Curve::new(
        wavelengths_um.to_vec(),
        throughputs.to_vec(),
    )?))
}

/// The PSF of a telescope at several wavelengths, with one basis for all of them, from `across`
/// samples along each axis of a regular grid.
pub(crate) fn psf_of_wavelengths(
    telescope: &Telescope,
    wavelengths_um: &[f64],
    across: usize,
) -> Result<Psf, PsfieldError> {
    let telescopes = wavelengths_um.iter().map(|&um| telescope.at_wavelength_um(um));
    let telescopes = telescopes.collect::<Result<Vec<_>, _>>()?;
    psf_of_states(&telescopes, (StateKind::Wavelength, wavelengths_um), across)
}

/// The PSF of one telescope for each state, with one basis for all of them, from `across` samples along
/// each axis of a regular grid.
pub(super) fn psf_of_states(
    telescopes: &[Telescope],
    states: (StateKind, &[f64]),
    across: usize,
) -> Result<Psf, PsfieldError> {
    let sources: Vec<&dyn PsfSource> = telescopes.iter().map(|t| t as &dyn PsfSource).collect();
    let positions = UniformSampling::new(across, across)?.positions(telescopes[0].field())?;
    let samples = draw_states(&sources, states, &positions, &NoProgress)?;
    Ok(Psf::new(samples, FitOptions::default()))
}

/// The PSFs of the black bodies in the bandpass, on one basis, over the field of the survey
/// telescope.
pub(super) fn black_bodies() -> Result<PsfModelRecord, PsfieldError> {
    let psf = psf_of_wavelengths(&Telescope::survey_2m(), &WAVELENGTHS_UM, SAMPLES_ACROSS)?;
    black_bodies_in(&psf, &bandpass()?)
}

/// The PSFs of the black bodies of [`RealGroup::Colours`](crate::bench::RealGroup), on one basis, for a
/// PSF with wavelengths. The throughput is 1 from the first wavelength to the last.
///
/// # Errors
/// The errors of [`Psf::for_spectra`], such as that for a PSF without wavelengths.
pub fn of_black_bodies(psf: &Psf) -> Result<PsfModelRecord, PsfieldError> {
    let wavelengths_um = psf.states().map(SampleStates::values);
    match wavelengths_um {
        Some([first, .., last]) => {
            let flat = Curve::new(vec![*first, *last], vec![1.0, 1.0])?;
            black_bodies_in(psf, &Bandpass::new(flat))
        }
        // Not a PSF with wavelengths: the error says so.
        _ => black_bodies_in(psf, &bandpass()?),
    }
}

fn black_bodies_in(psf: &Psf, bandpass: &Bandpass) -> Result<PsfModelRecord, PsfieldError> {
    let spectra = KELVINS.map(Spectrum::black_body).into_iter();
    let spectra = spectra.collect::<Result<Vec<_>, _>>()?;
    Ok(psf.for_spectra(bandpass, &spectra)?.record()?.clone())
}
