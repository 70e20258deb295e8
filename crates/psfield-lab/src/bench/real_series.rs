//! Series of exposures: the PSF changes with time, and the telescope drifts.

use std::time::Instant;

use ndarray::Array2;
use psf_optics::Telescope;
use psf_types::{NoProgress, PsfModelRecord, StateKind};
use psfield::psf_io::Catalog;
use psfield::series::{Exposures, LightCurves, Pointing, Series, SeriesFrames};
use psfield::{Psf, PsfieldError, Scene, SceneLight, SimulateOptions};

use crate::bench::real_colours::psf_of_states;

/// The PSF at each time is that of the telescope at one of these wavelengths, in micrometres. So it
/// widens by 20 %.
const WAVELENGTHS_UM: [f64; 5] = [0.50, 0.525, 0.55, 0.575, 0.60];
/// Number of PSF samples at each time, along each axis.
const SAMPLES_ACROSS: usize = 7;
/// Seconds from the start of an exposure to that of the next, and from the start to the end of one.
const CADENCE_S: f64 = 40.0;
const EXPOSURE_S: f64 = 30.0;
/// The stamps: side in stamp pixels, and stamp pixels per frame pixel.
const STAMP: (usize, usize) = (129, 3);
const DRIFT_PX_PER_S: f64 = 1e-3;
const JITTER_PX: f64 = 0.05;

/// The PSFs of the survey telescope at several times, which span this number of exposures.
pub(super) fn psf_of_times(exposures: usize) -> Result<PsfModelRecord, PsfieldError> {
    let mut params = Telescope::survey_2m().params().clone();
    (params.stamp.nx, params.stamp.ny, params.stamp.oversampling) = (STAMP.0, STAMP.0, STAMP.1);
    let telescope = Telescope::new(params)?;
    let telescopes = WAVELENGTHS_UM.map(|um| telescope.at_wavelength_um(um));
    let telescopes = telescopes.into_iter().collect::<Result<Vec<_>, _>>()?;
    let last = (telescopes.len() - 1) as f64;
    let times: Vec<f64> = (0..telescopes.len())
        .map(|k| exposures as f64 * CADENCE_S * k as f64 / last)
        .collect();
    let psf = psf_of_states(&telescopes, (StateKind::Time, &times), SAMPLES_ACROSS)?;
    Ok(psf.record()?.clone())
}

/// The images of a series.
#[derive(Clone)]
pub(super) struct SeriesCase {
    psf: Psf,
    shape: (usize, usize),
    options: SimulateOptions,
    series: Series,
    light: SceneLight<f32>,
}

impl SeriesCase {
    /// The light of a scene with this shape `(ny, nx)`, in exposures that span the times of the PSF.
    pub(super) fn new(
        psf: &Psf,
        (scene, shape): (&Scene<'_, f32>, (usize, usize)),
        options: SimulateOptions,
        exposures: usize,
    ) -> Result<Self, PsfieldError> {
        let mut light = SceneLight::new();
        if let Some(image) = scene.layers()[0].image() {
            light.add_image(None, image.pixels().to_owned())?;
        }
        light.set_catalog(Catalog::new(scene.stars().copied().collect(), Vec::new()));
        Ok(Self {
            psf: psf.clone(),
            shape,
            options,
            series: Series {
                exposures: Exposures::regular(exposures, EXPOSURE_S, CADENCE_S)?,
                pointing: Pointing {
                    drift_px_per_s: [DRIFT_PX_PER_S, 0.0],
                    jitter_px: JITTER_PX,
                    path: None,
                },
                light_curves: LightCurves::default(),
            },
            light,
        })
    }

    /// This series without drift, through the PSF of the first time: one plan and as many executions.
    pub(super) fn at_rest(&self) -> Result<Self, PsfieldError> {
        let mut at_rest = self.clone();
        at_rest.psf = self.psf.at_state(0.0)?;
        at_rest.series.pointing.drift_px_per_s = [0.0; 2];
        Ok(at_rest)
    }

    fn frames(&self) -> Result<SeriesFrames<f32>, PsfieldError> {
        let of = self.clone();
        SeriesFrames::new(&of.psf, of.shape, of.options, of.series, of.light)
    }

    /// Makes all images, the last in the array `image`. Returns the seconds of all plans and images.
    pub(super) fn seconds(&self, image: &mut Array2<f32>) -> Result<f64, PsfieldError> {
        let clock = Instant::now();
        let mut frames = self.frames()?;
        for number in 0..self.series.exposures.len() {
            image.fill(0.0);
            let exposure = frames.exposure(number, &NoProgress)?;
            let (scene, image) = (&exposure.scene, image.view_mut());
            exposure.simulator.simulate_into(scene, image, &NoProgress)?;
        }
        Ok(clock.elapsed().as_secs_f64())
    }

    /// The direct sum for the last exposure, at some pixels.
    pub(super) fn exact(&self, pixels: &[(usize, usize)]) -> Result<Vec<f64>, PsfieldError> {
        let mut frames = self.frames()?;
        let last = frames.exposure(self.series.exposures.len() - 1, &NoProgress)?;
        last.simulator.exact_at(&last.scene, pixels, &NoProgress)
    }
}
