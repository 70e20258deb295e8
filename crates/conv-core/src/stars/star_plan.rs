//! Plans for stars.

use std::sync::Arc;

use ndarray::{Array1, ArrayViewMut2};
use psf_types::{Anchor, FieldError, PixelRegion, PointSource, Position, Progress, PsfModel};
use rayon::prelude::*;

use super::draw::{DrawGroups, Group, StarKey};
use super::painter::{StarPainter, StarStamps};
use super::phase_norms::PhaseNorms;
use super::phases::{PhasedAxis, PhasedStar, Star};
use super::star_block::{BlockKey, RowLayout, StarBlock};
use crate::image_memory::{check_shape, with_rows_in_memory};
use crate::kept::Kept;
use crate::overlap::region;
use crate::plan::PlanOptions;
use crate::plan::local_modes::LocalModes;
use crate::plan::psf_space::PsfSpace;
use crate::{ConvError, ConvReal};

/// A plan for drawing point sources through one model.
///
/// If the plan is source-anchored and the stamps' oversampling is a whole number, stars are drawn
/// from local bases in the working precision `T`. Each block of the field has a local basis: the
/// few PSFs that the tolerance requires. The relative L2 error of a star's PSF, on the pixels of the
/// frame that the star lights, is at most the tolerance. With
/// [`ToleranceOn::Aperture`](psf_types::ToleranceOn::Aperture), so is the error of its flux in every
/// circle. Every star is tested at its own sub-pixel position. A star that would exceed the tolerance
/// is drawn from all components in f64. This choice depends only on the star's position, so the
/// image is linear in the fluxes. Other plans draw all stars from all components in f64. The image
/// is the same, bit by bit, for any number of threads.
///
/// Blocks of the field are prepared when the first star falls on them. They are kept for the next
/// catalogue, as far as the memory limit in the options allows.
///
/// ```
/// use std::sync::Arc;
///
/// use conv_core::{PlanOptions, StarPlan};
/// use ndarray::{Array2, Array3};
/// use psf_types::{
///     CoefficientField, FieldError, FrameShape, NoProgress, Normalisation, PointSource, Position,
///     PsfBasis, PsfModel, StampGrid,
/// };
///
/// /// No component at all: the mean stamp everywhere.
/// #[derive(Debug)]
/// struct Constant;
/// impl CoefficientField for Constant {
///     fn component_count(&self) -> usize {
///         0
///     }
///     fn evaluate_into(&self, _: Position, _: &mut [f64]) -> Result<(), FieldError> {
///         Ok(())
///     }
/// }
///
/// let gauss = |d: f64| (-d * d / 18.0).exp();
/// let stamp =
///     Array2::from_shape_fn((41, 41), |(y, x)| gauss(y as f64 - 20.0) * gauss(x as f64 - 20.0));
/// let grid = StampGrid::new(41, 41)?.with_oversampling(4.0)?;
/// let basis = PsfBasis::new(Some(stamp), Array3::zeros((0, 41, 41)), grid)?;
/// let model = PsfModel::new(&basis, Arc::new(Constant), Normalisation::Unit, None)?;
///
/// let frame = FrameShape::new(32, 32)?.region();
/// let star = PointSource::new(Position::new(12.3, 20.75)?, 1000.0)?;
/// let plan = StarPlan::<f32>::new(&model, PlanOptions::default(), None)?;
/// let mut image = Array2::zeros((32, 32));
/// plan.draw_into(&[star], frame, frame, image.view_mut(), &NoProgress)?;
/// assert!((image.sum() - 1000.0).abs() < 0.1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct StarPlan<T> {
    model: PsfModel,
    size: Option<usize>,
    stamps: Arc<StarStamps>,
    /// `None` if all stars are drawn from all components.
    phased: Option<Phased<T>>,
}

#[derive(Debug)]
struct Phased<T> {
    axes: [PhasedAxis; 2],
    layout: RowLayout,
    space: PsfSpace,
    norms: PhaseNorms,
    tolerance: f64,
    /// Errors of PSFs up to this fraction count as rounding.
    rounding: f64,
    blocks: Kept<BlockKey, StarBlock<T>>,
}

/// Stars, with positions in pixels of a scene, and the frame, which is a region of the scene.
#[derive(Clone, Copy)]
struct Catalogue<'a> {
    stars: &'a [PointSource],
    frame: PixelRegion,
    progress: &'a dyn Progress,
}

/// Columns and rows of a block of the field. A smaller block needs fewer kernels. But drawing a
/// catalogue reads the kernels of all blocks, and smaller blocks have more kernels in total.
const BLOCK: i64 = 256;
/// Groups of stars are prepared together up to about this many stars.
const MOST_AT_ONCE: usize = 1 << 15;
/// The most groups of stars drawn at a time. A group belongs to one block of the field.
const TILES_AT_ONCE: usize = 64;
/// The least number of stars for a task.
const MIN_STARS_PER_TASK: usize = 1 << 10;

impl<T: ConvReal> StarPlan<T> {
    /// Plans the drawing of stars with the PSFs of a model. If `size` is given, a star is drawn on
    /// `size` columns and rows. The pixel that the star lies on has index `size / 2` in both.
    /// Otherwise the star is drawn as far as its stamp reaches. Light beyond these pixels is lost.
    ///
    /// # Errors
    /// [`ConvError::PixelResponse`] if the stamps do not include the pixel response,
    /// [`ConvError::StampSize`] if `size` is 0.
    #[inline(never)]
    pub fn new(model: &PsfModel, options: PlanOptions, size: Option<usize>) -> Result<Self, ConvError> {
        let stamps = StarStamps::new(model, options.anchor(), size)?;
        let axes = PhasedAxis::both(model.grid(), stamps.kernel, stamps.window())
            .filter(|_| options.anchor() != Anchor::Output);
        Ok(Self {
            phased: axes
                .map(|axes| -> Result<_, ConvError> {
                    let space = PsfSpace::new(model, options.tolerance_on());
                    Ok(Phased {
                        layout: RowLayout::new(&axes[0]),
                        axes,
                        norms: PhaseNorms::new(&space, model.grid(), stamps.kernel, stamps.target)
                            .map_err(ConvError::Result)?,
                        space,
                        tolerance: options.tolerance_in::<T>(),
                        rounding: PlanOptions::rounding_in::<T>(),
                        blocks: Kept::new(options.memory_bytes()),
                    })
                })
                .transpose()?,
            model: model.clone(),
            size,
            stamps: Arc::new(stamps),
        })
    }

    /// The model.
    pub fn model(&self) -> &PsfModel {
        &self.model
    }

    /// The number of columns and rows to which stars are truncated. `None` if they are not
    /// truncated.
    pub fn size(&self) -> Option<usize> {
        self.size
    }

    /// Adds stars to a part of an image. `image` holds the pixels `[y, x]` of `region`, which is in
    /// pixels of the frame.
    ///
    /// Stars are given in pixels of the scene, and `frame` is a region of the scene. Stars outside
    /// the frame contribute light as far as their stamps reach. The light of a pixel does not
    /// depend on the region. If the pixels of a row are not contiguous in memory, the image is
    /// copied and written back.
    ///
    /// `progress` is polled and may cancel the work. No steps are reported to it.
    ///
    /// # Errors
    /// [`ConvError::FrameShape`] for an image of another shape than the region,
    /// [`ConvError::Cancelled`], and [`ConvError`] if a PSF that is needed has no value. A
    /// source-anchored plan needs the PSF at every star that reaches the region. An output-anchored
    /// plan needs the PSF at every frame pixel that such a star may light. After an error the image
    /// may hold some of the stars.
    #[inline(never)]
    pub fn draw_into(
        &self,
        stars: &[PointSource],
        frame: PixelRegion,
        region: PixelRegion,
        image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<(), ConvError> {
        check_shape(region.shape(), image.dim())?;
        let catalogue = Catalogue {
            stars,
            frame,
            progress,
        };
        with_rows_in_memory(image, |image| self.draw_catalogue(catalogue, region, image))
    }

    fn draw_catalogue(
        &self,
        catalogue: Catalogue<'_>,
        region: PixelRegion,
        mut image: ArrayViewMut2<'_, T>,
    ) -> Result<(), ConvError> {
        let Some(phased) = &self.phased else {
            return self.draw_exactly(catalogue, region, image);
        };
        let window = self.stamps.window();
        let mut stars: Vec<StarKey> = catalogue
            .stars
            .par_iter()
            .enumerate()
            .with_min_len(MIN_STARS_PER_TASK)
            .filter_map(|(index, source)| {
                let star = Star::new(source, catalogue.frame);
                let lights = star.reaches(window, region);
                lights.then(|| StarKey {
                    block: block_of(star.pixel, BLOCK),
                    part: index / MOST_AT_ONCE,
                    phases: star.phase_numbers(&phased.axes),
                    index,
                })
            })
            .collect();
        stars.par_sort_unstable();
        let groups: Vec<&[StarKey]> = stars
            .chunk_by(|a, b| (a.block, a.part) == (b.block, b.part))
            .collect();
        let mut missed = Vec::new();
        let mut rest = &groups[..];
        while !rest.is_empty() {
            let mut stars = 0;
            let count = rest
                .iter()
                .take(TILES_AT_ONCE)
                .take_while(|group| {
                    let fits = stars < MOST_AT_ONCE;
                    stars += group.len();
                    fits
                })
                .count();
            let (now, later) = rest.split_at(count);
            catalogue.progress.check_cancelled()?;
            let first = (region.x0(), region.y0());
            missed.extend(self.draw(phased, catalogue, now, (first, image.view_mut()))?);
            rest = later;
        }
        missed.sort_unstable();
        let missed: Vec<_> = missed.into_iter().map(|index| catalogue.stars[index]).collect();
        let stars = &missed[..];
        self.draw_exactly(Catalogue { stars, ..catalogue }, region, image)
    }

    /// Draws groups of stars. Does not draw stars that would exceed the tolerance, but returns
    /// their indices.
    fn draw(
        &self,
        phased: &Phased<T>,
        catalogue: Catalogue<'_>,
        groups: &[&[StarKey]],
        (first, image): ((i64, i64), ArrayViewMut2<'_, T>),
    ) -> Result<Vec<usize>, ConvError> {
        let prepared: Vec<(Group<T>, Vec<usize>)> = groups
            .par_iter()
            .map(|stars| self.prepare(phased, catalogue, stars))
            .collect::<Result<_, _>>()?;
        let (groups, missed): (Vec<Group<T>>, Vec<Vec<usize>>) = prepared.into_iter().unzip();
        T::dispatch(DrawGroups {
            axes: &phased.axes,
            layout: phased.layout,
            groups: &groups,
            image,
            first,
            progress: catalogue.progress,
        })?;
        Ok(missed.into_iter().flatten().collect())
    }

    /// Returns the block of some stars with the sub-pixel phases and weights of each star. Leaves
    /// out stars that would exceed the tolerance, and returns their indices.
    fn prepare(
        &self,
        phased: &Phased<T>,
        catalogue: Catalogue<'_>,
        stars: &[StarKey],
    ) -> Result<(Group<T>, Vec<usize>), ConvError> {
        catalogue.progress.check_cancelled()?;
        let key = stars[0].block;
        let (region, space, axes) = (region_of(key, BLOCK), &phased.space, &phased.axes);
        let (norms, tolerance) = (&phased.norms, phased.tolerance);
        let make = || StarBlock::new(&self.model, space, region, axes, norms, tolerance);
        let block = phased.blocks.get(key, make, StarBlock::bytes);
        let mut vectors = StarVectors::new(&self.model, &phased.space);
        let mut coefficients = Vec::with_capacity(block.modes.kernel_count());
        let taps = phased.axes[1].kernel.tap_count();
        let mut weights = Vec::with_capacity(stars.len() * taps * block.modes.kernel_count());
        let (mut prepared, mut missed) = (Vec::with_capacity(stars.len()), Vec::new());
        for (number, &StarKey { index, .. }) in stars.iter().enumerate() {
            if number.is_multiple_of(MIN_STARS_PER_TASK) {
                catalogue.progress.check_cancelled()?;
            }
            let star = Star::new(&catalogue.stars[index], catalogue.frame);
            let Some([columns, rows]) = star.phases(&phased.axes) else {
                continue;
            };
            let (x, y) = star.position;
            let position = Position::new(x, y).map_err(ConvError::Result)?;
            let scale = vectors.set(position)?;
            let whole = vectors.norm();
            vectors.project(&block.modes, &mut coefficients);
            let on_circles = vectors.is_within(tolerance, whole);
            let error = vectors.norm();
            let within = on_circles
                && (error <= phased.rounding * whole
                    || norms.is_surely_within(
                        tolerance,
                        star.shift,
                        error,
                        &coefficients,
                        &block.along_mean,
                    )
                    || {
                        let error = vectors.psf.clone();
                        vectors.set(position)?;
                        norms.is_within(tolerance, star.shift, error.view(), vectors.psf.view())
                    });
            if !within {
                missed.push(index);
                continue;
            }
            let scale = scale * star.flux;
            let first = weights.len();
            for tap in &rows.weights[..taps] {
                weights.extend(coefficients.iter().map(|c| T::nearest(tap * c * scale)));
            }
            let ((column, row), oversampling) = (star.pixel, phased.axes[0].oversampling);
            prepared.push(PhasedStar {
                columns: column + columns.from..column + columns.to,
                rows: row + rows.from..row + rows.to,
                first_row: rows.first_of(rows.from, oversampling),
                first_column: columns.first_of(columns.from, oversampling),
                weights: first..weights.len(),
                taps: columns.weights.map(T::nearest),
            });
        }
        Ok((Group::new(block, prepared, weights), missed))
    }

    fn draw_exactly(
        &self,
        catalogue: Catalogue<'_>,
        region: PixelRegion,
        image: ArrayViewMut2<'_, T>,
    ) -> Result<(), ConvError> {
        let painter = StarPainter {
            model: &self.model,
            frame: catalogue.frame,
            stamps: Arc::clone(&self.stamps),
        };
        painter.draw_into(catalogue.stars, region, image, catalogue.progress)
    }
}

/// The block that holds a pixel, if blocks have `side` pixels along each side.
pub(crate) fn block_of((column, row): (i64, i64), side: i64) -> BlockKey {
    (row.div_euclid(side), column.div_euclid(side))
}

/// The pixels of such a block.
pub(crate) fn region_of((row, column): BlockKey, side: i64) -> PixelRegion {
    region(column * side, row * side, (side as usize, side as usize))
}

/// Computes the vectors of stars' PSFs in [`PsfSpace`], one star at a time. All stars use the same
/// memory.
#[derive(Debug)]
pub(crate) struct StarVectors<'a> {
    model: &'a PsfModel,
    space: &'a PsfSpace,
    coefficients: Vec<f64>,
    pub(crate) psf: Array1<f64>,
    flux: f64,
}

impl<'a> StarVectors<'a> {
    pub(crate) fn new(model: &'a PsfModel, space: &'a PsfSpace) -> Self {
        Self {
            model,
            space,
            coefficients: vec![0.0; model.stamp_count()],
            psf: space.mean.clone(),
            flux: 0.0,
        }
    }

    /// Computes the PSF at a position, not scaled to unit flux. Returns the factor that scales it
    /// to unit flux, or 1 if the model needs no scaling.
    pub(crate) fn set(&mut self, position: Position) -> Result<f64, FieldError> {
        self.space
            .psf_into(position, &mut self.coefficients, &mut self.psf)?;
        self.flux = self.psf.dot(&self.space.fluxes);
        if !self.model.needs_flux_scaling() {
            Ok(1.0)
        } else if self.flux > 0.0 && self.flux.is_finite() {
            Ok(1.0 / self.flux)
        } else {
            Err(FieldError::NonPositiveFlux {
                position,
                flux: self.flux,
            })
        }
    }

    pub(crate) fn norm(&self) -> f64 {
        self.psf.dot(&self.psf).sqrt()
    }

    /// Returns whether the remainder of [`project`](Self::project) is within the tolerance. `whole`
    /// is the norm of the PSF before.
    pub(crate) fn is_within(&self, tolerance: f64, whole: f64) -> bool {
        self.space.is_within(tolerance, self.psf.view(), whole, self.flux)
    }

    /// Computes the coefficients of a block's kernels for this PSF. Replaces the PSF by the
    /// remainder that the kernels do not represent.
    pub(crate) fn project(&mut self, modes: &LocalModes, coefficients: &mut Vec<f64>) {
        coefficients.clear();
        if let Some(reference) = modes.reference() {
            self.psf.scaled_add(-self.flux, &reference);
            coefficients.push(self.flux);
        }
        for (mode, dual) in modes.modes.outer_iter().zip(modes.duals().outer_iter()) {
            let c = dual.dot(&self.psf);
            self.psf.scaled_add(-c, &mode);
            coefficients.push(c);
        }
    }
}
