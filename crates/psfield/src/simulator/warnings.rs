//! Warns of errors that the spot check cannot detect.

use std::convert::Infallible;
use std::fmt;

use conv_core::ConvReal;
use psf_types::{PointSource, Position, ToleranceOn};

use super::Simulator;
use super::stamp_sampling::SamplingErrors;
use crate::device::Placement;
use crate::error::PsfieldError;
use crate::psf::{Extrapolation, get_or_make};
use crate::scene::Scene;

/// The largest error of a star's total flux by the interpolation of stamps that is not warned of: the
/// default tolerance, which bounds the flux in every circle.
const FLUX_ERROR: f64 = 1e-4;

/// The largest errors of the flux (relative) and the position (in pixels) from a PSF fit that are not
/// warned of: a thousandth. Few measurements of single stars are more precise. Stamps with two pixels per
/// frame pixel of a PSF with an FWHM of two pixels have half of it.
const FIT_ERROR: f64 = 1e-3;

/// The largest distance along x and along y, in pixels, at which a star counts as lying on the
/// centre of a pixel.
const ON_PIXEL: f64 = 1e-9;

/// Beyond this number of half-light radii, a galaxy counts as dark. At an index of 4, 4e-5 of the light
/// lies still farther out.
const HALF_LIGHT_RADII: f64 = 100.0;

impl<T: ConvReal> Simulator<T> {
    /// Returns a warning if the images of scenes like `scene` are convolved with
    /// stamps that are interpolated between their own pixels. There is no warning for scenes finer
    /// than the frame.
    ///
    /// # Errors
    /// No error occurs. The type allows the error of
    /// [`native_is_exact`](crate::Psf::native_is_exact) for a stamp size of 0, which the builder
    /// refuses.
    pub fn psf_warning(&self, scene: &Scene<'_, T>) -> Result<Option<SimulationWarning>, PsfieldError> {
        let options = self.options();
        let picked = !scene.has_image()
            || options.oversample > 1
            || self.psf().native_is_exact(self.setup.stamp_size(self.psf()))?;
        Ok((!picked).then_some(SimulationWarning::InterpolatedStamps))
    }

    /// Measures the errors of stars by the interpolation of stamps, in the middle and the corners of the
    /// frame: the largest of all layers. Zero if the PSF is not known there.
    fn sampling_errors(&self) -> SamplingErrors {
        let positions = self.some_positions();
        let layers = 0..self.layer_count();
        let models = layers.filter_map(|layer| Some(self.sources(layer).ok()?.model()));
        let measured = models.filter_map(|model| SamplingErrors::of_model(model, &positions).ok());
        measured.fold(SamplingErrors::default(), SamplingErrors::max)
    }

    /// The middle and the corners of the frame.
    pub(super) fn some_positions(&self) -> [Position; 5] {
        let shape = self.frame().shape();
        let (last_x, last_y) = (shape.nx() as i64 - 1, shape.ny() as i64 - 1);
        let pixels = [
            (last_x / 2, last_y / 2),
            (0, 0),
            (last_x, 0),
            (0, last_y),
            (last_x, last_y),
        ];
        pixels.map(|(x, y)| Position::of_pixel(x, y))
    }

    /// Returns a warning if the components that the model leaves out change the flux in circles by more
    /// than the tolerance allows.
    fn circle_warning(&self) -> Option<SimulationWarning> {
        let (on, tolerance) = (self.options().tolerance_on, self.options().tolerance);
        let bounded = on == ToleranceOn::Aperture && self.options().method.has_plan() && tolerance > 0.0;
        let error = self.psf().record_if_fitted()?.circle_error()?;
        let warning = SimulationWarning::FluxInCircles { error, tolerance };
        (bounded && error > tolerance).then_some(warning)
    }

    /// Returns warnings about a scene's stars and galaxies, about the PSF at them, and about the plan if
    /// it is made. `noise` is that of a dark pixel of the image, if it is known, in the unit of the image.
    pub fn warnings(&self, scene: &Scene<'_, T>, noise: Option<f64>) -> Vec<SimulationWarning> {
        let shape = self.frame().shape();
        let last = Position::of_pixel(shape.nx() as i64 - 1, shape.ny() as i64 - 1);
        let extrapolation = self.psf().extrapolation(&[Position::of_pixel(0, 0), last]);
        let beyond = extrapolation.map(SimulationWarning::BeyondPolynomial);
        let mut warnings: Vec<_> = beyond.into_iter().collect();
        let grid = self.psf().whole_grid();
        let stamp = grid.nx().max(grid.ny()) as f64 / grid.oversampling();
        let stars = scene.stars().map(|star| (star.position(), stamp));
        let galaxies = scene.galaxies().map(|galaxy| {
            let radius = galaxy.profile().half_light_radius_px();
            (galaxy.position(), stamp + HALF_LIGHT_RADII * radius)
        });
        // The light of other profiles may reach far.
        let profiles = scene
            .profiles()
            .map(|source| (source.point.position(), f64::INFINITY));
        let sources = scene.points().count();
        let mut reaching = stars.chain(galaxies).chain(profiles);
        if sources > 0
            && !reaching.any(|(position, reach)| self.setup.geometry.is_near_frame(position, reach))
        {
            warnings.push(SimulationWarning::NoSourceInFrame { count: sources });
        }
        let off = |v: f64| (v - v.round()).abs() > ON_PIXEL;
        let between = |star: &PointSource| off(star.position().x()) || off(star.position().y());
        let interpolated = scene.stars().any(between) || sources > scene.stars().count();
        if interpolated {
            // Computed once, because every simulated scene asks for warnings.
            let errors = || Ok::<_, Infallible>(self.sampling_errors());
            let Ok(&errors) = get_or_make(&self.shared.sampling_errors, errors);
            if errors.flux > FLUX_ERROR || errors.fitted_flux.max(errors.position_px) > FIT_ERROR {
                warnings.push(SimulationWarning::SourcesBetweenPixels(errors));
            }
        }
        warnings.extend(self.cut_stars(scene, noise));
        warnings.extend(self.circle_warning());
        let of_fit = self.psf().fit_warnings().iter().cloned();
        warnings.extend(of_fit.map(SimulationWarning::Fit));
        let kept = self.kept_convolvers();
        let on_cpu = kept
            .iter()
            .filter(|(_, convolver)| matches!(convolver.placement, Placement::Cpu { .. }));
        let plans = on_cpu.filter_map(|(_, convolver)| Some(convolver.engine.as_ref()?.plan().summary()));
        warnings.extend(plans.filter_map(|plan| {
            let made_anew = plan.made_anew.0.max(plan.made_anew.1);
            (made_anew > 0).then_some(SimulationWarning::MadeAnew {
                made_anew,
                blocks: plan.blocks,
                bytes: plan.all_bytes,
            })
        }));
        warnings
    }
}

/// Warns of an error that the spot check cannot detect, or of a loss of time. If it can be avoided,
/// the text says how.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum SimulationWarning {
    /// The image in the scene is convolved with interpolated stamps.
    InterpolatedStamps,
    /// All stars and galaxies lie so far outside the frame that no light of them reaches it.
    NoSourceInFrame {
        /// Number of stars and galaxies.
        count: usize,
    },
    /// Stamps end where stars still have light above a limit: the floor
    /// ([`SimulateOptions::floor`](crate::SimulateOptions::floor)) or, without one, a thousandth of the noise.
    CutStars {
        /// Number of stars.
        count: usize,
        /// The distance of the stamps' edges from the star along x or y, in pixels.
        radius_px: f64,
        /// The light of the brightest star at an edge, in flux per pixel.
        brightest: f64,
        /// The limit, in flux per pixel.
        limit: f64,
    },
    /// Stars between pixels or galaxies, and the stamps are too coarse for an accurate interpolation.
    SourcesBetweenPixels(SamplingErrors),
    /// The samples do not determine the model, or its fit kept nearly all components: a sentence.
    Fit(String),
    /// The components that the PSF model leaves out change the flux in circles about the source by more
    /// than the tolerance allows ([`ToleranceOn::Aperture`]).
    FluxInCircles {
        /// The largest change at the samples of the model, relative to the total flux.
        error: f64,
        /// The tolerance.
        tolerance: f64,
    },
    /// The frame reaches far beyond the range over which the polynomials of the PSF were fitted.
    BeyondPolynomial(Extrapolation),
    /// Each execution of the plan makes parts of it again, because they exceed the limit of memory.
    MadeAnew {
        /// The number of blocks with such parts.
        made_anew: usize,
        /// The number of blocks.
        blocks: usize,
        /// Bytes of the whole plan.
        bytes: usize,
    },
}

impl SimulationWarning {
    /// The field of [`SimulateOptions`](crate::SimulateOptions), or of
    /// [`FitChoices`](crate::FitChoices), that avoids the error or the loss of time, if one does.
    pub fn setting(&self) -> Option<&'static str> {
        match self {
            Self::BeyondPolynomial(_) => Some("outside"),
            Self::FluxInCircles { .. } => Some("rank"),
            Self::MadeAnew { .. } => Some("memory"),
            _ => None,
        }
    }
}

impl fmt::Display for SimulationWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::InterpolatedStamps => f.write_str(
                "the PSF stamps are not sampled at the centres of the image's pixels, or lack the pixel response: the stamps \
                 are interpolated",
            ),
            Self::NoSourceInFrame { count } => write!(
                f,
                "no light of the stars and galaxies ({count} in all) reaches the frame: check their positions (0-based pixels)"
            ),
            Self::CutStars {
                count,
                radius_px,
                brightest,
                limit,
            } => write!(
                f,
                "the stamps are too small for {count} {}: at {radius_px:.0} pixels, where the stamps end, the light is up to \
                 {brightest:.2e} per pixel, more than {limit:.2e}. A box shows in the image. Use larger stamps, or join wings to the PSF",
                if *count == 1 { "star" } else { "stars" }
            ),
            Self::SourcesBetweenPixels(errors) => write!(
                f,
                "the PSF stamps are too coarse to be interpolated for stars between pixels and for galaxies: depending on its \
                 position within a pixel, a star has an error of its total flux of up to {:.1e}, in a PSF fit of its flux of \
                 {:.1e} and of its position of {:.1e} pixel. The tolerance does not bound these errors, and the spot check does \
                 not detect them. Stamps with more pixels per frame pixel, a whole number, avoid them",
                errors.flux, errors.fitted_flux, errors.position_px
            ),
            Self::Fit(sentence) => f.write_str(sentence),
            Self::FluxInCircles { error, tolerance } => write!(
                f,
                "the PSF model does not keep the tolerance {tolerance:e} for the flux in circles about a source: the components \
                 that its fit left out change this flux by up to {error:.1e} of the total (fit with more components, or let the \
                 tolerance bound the L2 error alone)"
            ),
            Self::BeyondPolynomial(extrapolation) => extrapolation.fmt(f),
            Self::MadeAnew {
                made_anew,
                blocks,
                bytes,
            } => write!(
                f,
                "each execution makes {made_anew} of {blocks} blocks of the plan again, which is slow: \
                 the whole plan needs about {} MiB",
                bytes.div_ceil(1 << 20)
            ),
        }
    }
}
