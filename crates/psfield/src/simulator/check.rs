//! Checks images against the direct sum, and warns of errors that this check cannot detect.

use std::fmt;

use conv_core::{ConvReal, Direct, RowStream};
use ndarray::{Array2, ArrayView2};
use psf_types::{Image, PointSource, Position, Progress};

use super::stream::SceneRows;
use super::{Simulator, has_extended_light};
use crate::{EvaluateOptions, OutputGrid, PixelPicker, PsfieldError, Scene, SpotCheck, evaluate_stamps};

/// The largest number of image rows whose light a streamed check keeps in memory at once.
const BAND: usize = 512;
/// The number of scene pixels along each side of a frame pixel that galaxies need. On coarser
/// pixels, galaxies of any size are blurred by a few percent.
const FINE_FOR_GALAXIES: usize = 4;
/// The smallest half-light radius that galaxies need, in pixels of the scene. Smaller galaxies are
/// blurred by these pixels.
const RESOLVED_PX: f64 = 2.0;
/// The number of stamp pixels per frame pixel that stars between pixels need. The interpolation of
/// coarser stamps may be wrong.
const MIN_STAMP_OVERSAMPLING: f64 = 2.0;
/// The largest distance along x and along y, in pixels, at which a star counts as lying on the
/// centre of a pixel.
const ON_PIXEL: f64 = 1e-9;

/// A frame may extend beyond the range of the PSF's polynomials by this part of the range. Stars of
/// a frame, to which polynomials are fitted, reach less far than the frame.
const BEYOND_RANGE: f64 = 0.1;
/// The number of sub-pixel phases along x and along y at which the flux of a star is measured.
const PHASES: usize = 4;

/// Beyond this number of half-light radii, a galaxy counts as dark.
const HALF_LIGHT_RADII: f64 = 10.0;

impl<T: ConvReal> Simulator<T> {
    /// Compares `count` random pixels of an image that this simulator made of `scene` with the
    /// direct sum in f64. `seed` chooses the pixels. The check passes if the difference is within
    /// the limit of the method ([`SpotCheck::limit_of`]).
    ///
    /// # Errors
    /// The errors of [`exact_at`](Self::exact_at).
    pub fn spot_check(
        &self,
        scene: &Scene<'_, T>,
        image: &Image<T>,
        (count, seed): (usize, u64),
        progress: &dyn Progress,
    ) -> Result<SpotCheck, PsfieldError> {
        let check = SpotCheck::run(image, count, seed, |pixels| {
            self.exact_at(scene, pixels, progress)
        })?;
        Ok(self.judged(check, has_extended_light(scene)))
    }

    /// Compares pixels that `picker` has chosen from the rows of a streamed image
    /// ([`stream`](Self::stream)) with the direct sum. Reads the necessary rows of the scene again.
    ///
    /// # Errors
    /// The errors of the stream and of [`exact_at`](Self::exact_at).
    pub fn spot_check_stream<R: RowStream<T, Error = PsfieldError>>(
        &self,
        scene: &Scene<'_, T>,
        rows: &mut R,
        picker: PixelPicker,
        progress: &dyn Progress,
    ) -> Result<SpotCheck, PsfieldError> {
        let check = SpotCheck::of_picked(picker, |pixels| {
            let mut rows = SceneRows::new(self, scene, rows, progress)?;
            self.exact_by_rows(scene, &mut rows, pixels, progress)
        })?;
        Ok(self.judged(check, true))
    }

    /// Computes single pixels `(column, row)` of the image by the direct sum in f64.
    ///
    /// # Errors
    /// The errors of [`simulate_into`](Self::simulate_into). If the scene has an image or galaxies,
    /// also [`ErrorKind::Convolution`](crate::ErrorKind::Convolution) for a pixel outside the
    /// frame.
    #[inline(never)]
    pub fn exact_at(
        &self,
        scene: &Scene<'_, T>,
        pixels: &[(usize, usize)],
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, PsfieldError> {
        self.check_sources(scene, false)?;
        let mut sums = vec![0.0; pixels.len()];
        if has_extended_light(scene) {
            let convolver = self.convolver(scene, progress)?;
            let (light, first) = self.light(scene, convolver, progress)?;
            sums = self.extended_sums((light.pixels(), first), convolver.padding, pixels, progress)?;
        }
        self.add_star_sums(scene.stars(), pixels, &mut sums)?;
        Ok(sums)
    }

    /// Computes pixels of the image of a streamed scene. The pixels are sorted by rows. Only the
    /// scene's rows that they need are in memory.
    fn exact_by_rows<R: RowStream<T, Error = PsfieldError>>(
        &self,
        scene: &Scene<'_, T>,
        rows: &mut R,
        pixels: &[(usize, usize)],
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, PsfieldError> {
        let padding = self.padding(scene);
        let shape = self.geometry.padded_shape(padding)?;
        let frame = self.geometry.fine_frame(padding)?;
        let reach = self.image_model()?.0.grid().ny();
        let mut sums = Vec::with_capacity(pixels.len());
        let mut rest = pixels;
        while let Some(&(_, first)) = rest.first() {
            let count = rest.partition_point(|&(_, row)| row < first + BAND);
            let of_scene = |row: usize| frame.y0() as usize + self.geometry.sampled_pixel((0, row)).1;
            let from = of_scene(first).saturating_sub(reach);
            let to = (of_scene(rest[count - 1].1 + 1) + reach).min(shape.ny());
            let mut light = Array2::zeros((to - from, shape.nx()));
            rows.read(from..to, light.view_mut())?;
            sums.extend(self.extended_sums((light.view(), (0, from)), padding, &rest[..count], progress)?);
            rest = &rest[count..];
        }
        self.add_star_sums(scene.stars(), pixels, &mut sums)?;
        Ok(sums)
    }

    /// Returns the direct sums at pixels of the image. `light` is a part of the (padded) scene's
    /// light, and the column and row at which it begins.
    fn extended_sums(
        &self,
        light: (ArrayView2<'_, T>, (usize, usize)),
        padding: usize,
        pixels: &[(usize, usize)],
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, PsfieldError> {
        let (shape, frame) = (
            self.geometry.padded_shape(padding)?,
            self.geometry.fine_frame(padding)?,
        );
        let fine: Vec<_> = pixels
            .iter()
            .map(|&pixel| self.geometry.sampled_pixel(pixel))
            .collect();
        let (direct, area) = (Direct::new(self.options.anchor), self.geometry.pixel_area());
        let mut sums = direct.at_pixels(self.image_model()?.0, light, shape, frame, &fine, progress)?;
        for sum in &mut sums {
            *sum *= area;
        }
        Ok(sums)
    }

    fn add_star_sums(
        &self,
        stars: &[PointSource],
        pixels: &[(usize, usize)],
        sums: &mut [f64],
    ) -> Result<(), PsfieldError> {
        if stars.is_empty() {
            return Ok(());
        }
        let (x0, y0) = (
            self.geometry.region.x0() as usize,
            self.geometry.region.y0() as usize,
        );
        let of_frame: Vec<_> = pixels.iter().map(|&(x, y)| (x + x0, y + y0)).collect();
        let values = self.painter(&self.stars()?.model)?.at_pixels(stars, &of_frame)?;
        sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
        Ok(())
    }

    fn judged(&self, check: SpotCheck, of_image: bool) -> SpotCheck {
        match SpotCheck::limit_of::<T>(&self.options, of_image) {
            Some(limit) => check.judged(limit),
            None => check,
        }
    }

    /// Returns a warning if the image or the galaxies of scenes like `scene` are convolved with
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
        let (options, stars_alone) = (&self.options, !rows && !has_extended_light(scene));
        let picked =
            stars_alone || options.oversample > 1 || self.psf().native_is_exact(options.stamp_size)?;
        Ok((!picked).then_some(SimulationWarning::InterpolatedStamps))
    }

    /// Returns a warning if the PSF is a polynomial that the frame extrapolates far beyond the range
    /// to which it was fitted.
    fn range_warning(&self) -> Option<SimulationWarning> {
        let [x, y] = self.psf().polynomial_range()?;
        let shape = self.geometry.frame.shape();
        let beyond = |(low, high): (f64, f64), pixels: usize| {
            low.max((pixels - 1) as f64 - high).max(0.0) / (high - low)
        };
        let (of_x, of_y) = (beyond(x, shape.nx()), beyond(y, shape.ny()));
        (of_x.max(of_y) > BEYOND_RANGE).then(|| SimulationWarning::BeyondPolynomial {
            file: self.psf().file_name(),
            range: [x, y],
            frame: [shape.nx(), shape.ny()],
            beyond: [of_x, of_y],
        })
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

    /// Returns warnings about a scene's stars and galaxies, and about the PSF at them.
    pub fn warnings(&self, scene: &Scene<'_, T>) -> Vec<SimulationWarning> {
        let mut warnings: Vec<_> = self.range_warning().into_iter().collect();
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
        if self.psf().grid().oversampling() < MIN_STAMP_OVERSAMPLING && scene.stars().iter().any(between) {
            // Computed once, because every simulated scene asks for warnings.
            let flux = *self.shared.star_flux.get_or_init(|| self.flux_over_phases().ok());
            warnings.push(SimulationWarning::StarsBetweenPixels { flux });
        }
        let s = self.geometry.oversample;
        // A PSF of a single pixel adds no second blur.
        let is_pixel = self.psf().grid().pixel_count() == 1;
        let blurred = scene.galaxies().iter().filter(|galaxy| {
            s < FINE_FOR_GALAXIES || galaxy.profile().half_light_radius_px() * (s as f64) < RESOLVED_PX
        });
        let count = blurred.count();
        if count > 0 && !is_pixel {
            warnings.push(SimulationWarning::BlurredGalaxies { count });
        }
        warnings
    }
}

/// Warns of an error that the spot check cannot detect. If the error can be avoided, the text says
/// how.
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
    /// Stars lie between pixels, and the stamps are too coarse for an accurate interpolation.
    StarsBetweenPixels {
        /// The smallest and the largest flux that a star of flux 1 in the middle of the frame gets
        /// at different sub-pixel phases. None if the PSF is not known there.
        flux: Option<(f64, f64)>,
    },
    /// The frame reaches far beyond the range over which the polynomials of the PSF were fitted.
    BeyondPolynomial {
        /// The PSF file.
        file: Option<String>,
        /// The smallest and the largest coordinate of the range, for x and y.
        range: [(f64, f64); 2],
        /// Columns and rows of the frame.
        frame: [usize; 2],
        /// Distance of the frame's farthest pixel from the range, in parts of the range, along x
        /// and y.
        beyond: [f64; 2],
    },
    /// Galaxies are blurred by the pixels on which they are drawn.
    BlurredGalaxies {
        /// Number of galaxies.
        count: usize,
    },
}

impl SimulationWarning {
    /// The field of [`SimulateOptions`](crate::SimulateOptions), or of
    /// [`FitChoices`](crate::FitChoices), that avoids the error, if one does.
    pub fn setting(&self) -> Option<&'static str> {
        match self {
            Self::BlurredGalaxies { .. } => Some("oversample"),
            Self::BeyondPolynomial { .. } => Some("outside"),
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
            Self::StarsBetweenPixels { flux } => {
                f.write_str(
                    "stars lie between pixels, and the PSF stamps are oversampled by a factor below 2: the stamps are \
                     interpolated, with errors of a few percent where the PSF is under-sampled. The spot check does not \
                     detect this",
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
            Self::BeyondPolynomial {
                file,
                range: [x, y],
                frame: [nx, ny],
                beyond,
            } => {
                if let Some(file) = file {
                    write!(f, "{file}: ")?;
                }
                let [of_x, of_y] = beyond.map(|part| (100.0 * part).round());
                write!(
                    f,
                    "the polynomials of the PSF were fitted to x = {:.0} to {:.0} and y = {:.0} to {:.0}, but the frame has \
                     x = 0 to {} and y = 0 to {}. The PSF is extrapolated by {of_x} % of the range in x and {of_y} % in y, where it may \
                     be wrong. Check whether columns and rows of the frame are exchanged, or use the PSF at the edge of the range \
                     (nearest)",
                    x.0,
                    x.1,
                    y.0,
                    y.1,
                    nx - 1,
                    ny - 1
                )
            }
            Self::BlurredGalaxies { count } => write!(
                f,
                "{count} {} blurred twice: by the pixel response in the PSF, and by the scene pixels used for drawing. \
                 The median error is 3 % of a galaxy's peak, and more for small galaxies. The spot check does not detect this. Use \
                 finer scene pixels: at least {FINE_FOR_GALAXIES} along each side of a frame pixel, and {RESOLVED_PX} per \
                 half-light radius",
                if *count == 1 { "galaxy is" } else { "galaxies are" }
            ),
        }
    }
}
