//! Warns of errors that the spot check cannot detect.

use std::convert::Infallible;
use std::fmt;

use conv_core::ConvReal;
use psf_types::{PointSource, Position};

use super::{Convolver, Simulator};
use crate::device::Placement;
use crate::psf::get_or_make;
use crate::{EvaluateOptions, Extrapolation, OutputGrid, PsfieldError, Scene, evaluate_stamps};

/// The number of stamp pixels per frame pixel that galaxies, and stars between pixels, need. The
/// interpolation of coarser stamps may be wrong.
const MIN_STAMP_OVERSAMPLING: f64 = 2.0;

/// The largest distance along x and along y, in pixels, at which a star counts as lying on the
/// centre of a pixel.
const ON_PIXEL: f64 = 1e-9;

/// The number of sub-pixel phases along x and along y at which the flux of a star is measured.
const PHASES: usize = 4;

/// Beyond this number of half-light radii, a galaxy counts as dark. At an index of 4, 4e-5 of the light
/// lies still farther out.
const HALF_LIGHT_RADII: f64 = 100.0;

impl<T: ConvReal> Simulator<T> {
    /// Returns a warning if the image of scenes like `scene` is convolved with
    /// stamps that are interpolated between their own pixels. There is no warning for scenes finer
    /// than the frame. `rows` has the meaning that it has in [`prepare`](Self::prepare).
    ///
    /// # Errors
    /// No error occurs. The type allows the error of
    /// [`native_is_exact`](crate::Psf::native_is_exact) for a stamp size of 0, which the builder
    /// refuses.
    pub fn psf_warning(
        &self,
        scene: &Scene<'_, T>,
        rows: bool,
    ) -> Result<Option<SimulationWarning>, PsfieldError> {
        let (options, sources_alone) = (&self.options, !rows && scene.image().is_none());
        let picked =
            sources_alone || options.oversample > 1 || self.psf().native_is_exact(options.stamp_size)?;
        Ok((!picked).then_some(SimulationWarning::InterpolatedStamps))
    }

    /// Returns the smallest and the largest flux that a star of flux 1 in the middle of the frame
    /// gets, at different sub-pixel phases.
    fn flux_over_phases(&self) -> Result<(f64, f64), PsfieldError> {
        let (model, shape) = (self.psf().model()?, self.geometry.frame.shape());
        let middle = |pixels: usize, phase: usize| (pixels / 2) as f64 + phase as f64 / PHASES as f64;
        let positions: Vec<Position> = (0..PHASES * PHASES)
            .map(|i| Position::new(middle(shape.nx(), i % PHASES), middle(shape.ny(), i / PHASES)))
            .collect::<Result<_, _>>()?;
        let options = EvaluateOptions {
            grid: OutputGrid::Native,
            size: None,
            sub_pixel: true,
        };
        let (stamps, _) = evaluate_stamps(model, &positions, options)?;
        let mut range = (f64::INFINITY, f64::NEG_INFINITY);
        for (stamp, &position) in stamps.outer_iter().zip(&positions) {
            let flux = stamp.sum() / model.psf_at(position)?.flux();
            range = (range.0.min(flux), range.1.max(flux));
        }
        Ok(range)
    }

    /// Returns warnings about a scene's stars and galaxies, about the PSF at them, and about the plan if
    /// it is made.
    pub fn warnings(&self, scene: &Scene<'_, T>) -> Vec<SimulationWarning> {
        let shape = self.geometry.frame.shape();
        let last = Position::of_pixel(shape.nx() as i64 - 1, shape.ny() as i64 - 1);
        let extrapolation = self.psf().extrapolation(&[Position::of_pixel(0, 0), last]);
        let beyond = extrapolation.map(SimulationWarning::BeyondPolynomial);
        let mut warnings: Vec<_> = beyond.into_iter().collect();
        let grid = self.psf().grid();
        let stamp = grid.nx().max(grid.ny()) as f64 / grid.oversampling();
        let stars = scene.stars().iter().map(|star| (star.position(), stamp));
        let galaxies = scene.galaxies().iter().map(|galaxy| {
            let radius = galaxy.profile().half_light_radius_px();
            (galaxy.position(), stamp + HALF_LIGHT_RADII * radius)
        });
        let sources = scene.stars().len() + scene.galaxies().len();
        let mut reaching = stars.chain(galaxies);
        if sources > 0 && !reaching.any(|(position, reach)| self.geometry.is_near_frame(position, reach)) {
            warnings.push(SimulationWarning::NoSourceInFrame { count: sources });
        }
        let off = |v: f64| (v - v.round()).abs() > ON_PIXEL;
        let between = |star: &PointSource| off(star.position().x()) || off(star.position().y());
        let interpolated = scene.stars().iter().any(between) || !scene.galaxies().is_empty();
        if self.psf().grid().oversampling() < MIN_STAMP_OVERSAMPLING && interpolated {
            // Computed once, because every simulated scene asks for warnings.
            let flux = || Ok::<_, Infallible>(self.flux_over_phases().ok());
            let Ok(&flux) = get_or_make(&self.shared.star_flux, flux);
            warnings.push(SimulationWarning::SourcesBetweenPixels { flux });
        }
        let on_cpu = |convolver: &&Convolver<T>| matches!(convolver.placement, Placement::Cpu { .. });
        let convolver = self.convolver.get().filter(on_cpu);
        let engine = convolver.and_then(|convolver| convolver.engine.as_ref());
        let plan = engine.map(|engine| engine.plan().summary());
        warnings.extend(plan.and_then(|plan| {
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
    /// Stars between pixels or galaxies, and the stamps are too coarse for an accurate interpolation.
    SourcesBetweenPixels {
        /// The smallest and the largest flux that a star of flux 1 in the middle of the frame gets
        /// at different sub-pixel phases. None if the PSF is not known there.
        flux: Option<(f64, f64)>,
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
            Self::SourcesBetweenPixels { flux } => {
                f.write_str(
                    "stars between pixels and galaxies need interpolated PSF stamps, and the stamps are oversampled by a \
                     factor below 2: the interpolation has errors of a few percent where the PSF is under-sampled. The tolerance does not \
                     bound them, and the spot check does not detect them. Stamps with 2 or more pixels per frame pixel avoid them",
                )?;
                let Some((least, most)) = flux else {
                    return Ok(());
                };
                write!(
                    f,
                    ". In the middle of the frame, the image of a star has {least:.4} to {most:.4} of its flux, depending on \
                     its position within a pixel"
                )
            }
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
