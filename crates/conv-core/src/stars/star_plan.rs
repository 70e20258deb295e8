//! Plans for stars.

use ndarray::{Array2, ArrayViewMut2};
use psf_types::{Anchor, FrameShape, NoProgress, PixelRegion, Position, Progress, PsfModel, Scene};
use rayon::prelude::*;

use super::cache::{BlockCache, BlockKey};
use super::groups::{DrawGroups, Group, StarKey};
use super::phases::PhasedAxis;
use super::star::{PreparedStar, Star, Window};
use super::star_block::{RowLayout, StarBlock};
use super::star_vectors::StarVectors;
use crate::image_memory::{check_shape, with_rows_in_memory};
use crate::lowrank::internals::{PsfSpace, rounding};
use crate::point_sources::{StampSplines, StarPainter};
use crate::{ConvError, ConvReal, PlanOptions};

/// The drawing of point sources through one model, prepared.
///
/// Source-anchored, and with stamps whose oversampling is a whole number, a star is drawn from the few PSFs of its part of the field that
/// the tolerance asks for, in the working precision: the relative L2 error of its PSF, at the stamps' own sampling, is at most the
/// tolerance. Every star is checked; one that would miss it is drawn from all components. So are all stars of other models, in
/// double precision. Which way a star takes depends on its position alone, so that the image is linear in the fluxes. At any number of
/// threads it has the same bytes.
///
/// Parts of the field are prepared when the first star falls on them, and kept for the next catalogue as far as the options' memory
/// reaches.
///
/// ```
/// use std::sync::Arc;
///
/// use conv_core::{PlanOptions, StarPlan};
/// use ndarray::{Array2, Array3};
/// use psf_types::{
///     CoefficientField, FieldError, FrameShape, Normalisation, PointSource, Position, PsfBasis, PsfModel, Scene, StampGrid,
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
/// let stamp = Array2::from_shape_fn((41, 41), |(y, x)| gauss(y as f64 - 20.0) * gauss(x as f64 - 20.0));
/// let grid = StampGrid::new(41, 41)?.with_oversampling(4.0)?;
/// let basis = PsfBasis::new(Some(stamp), Array3::zeros((0, 41, 41)), grid)?;
/// let model = PsfModel::new(&basis, Arc::new(Constant), Normalisation::Unit, None)?;
///
/// let frame = FrameShape::new(32, 32)?;
/// let star = PointSource::new(Position::new(12.3, 20.75)?, 1000.0)?;
/// let plan = StarPlan::<f32>::new(&model, PlanOptions::default(), None)?;
/// let mut image = Array2::zeros((32, 32));
/// plan.add_to(&Scene::<f32>::dark(frame).with_sources(vec![star]), &mut image)?;
/// assert!((image.sum() - 1000.0).abs() < 0.1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct StarPlan<T> {
    model: PsfModel,
    options: PlanOptions,
    size: Option<usize>,
    window: Window,
    splines: Option<StampSplines>,
    /// None where stars are drawn from all components.
    phased: Option<Phased<T>>,
}

#[derive(Debug)]
struct Phased<T> {
    axes: [PhasedAxis; 2],
    layout: RowLayout,
    space: PsfSpace,
    tolerance: f64,
    blocks: BlockCache<T>,
}

/// Columns and rows of the field that share a local basis: smaller ones need fewer kernels, but the values of all of them pass through the
/// caches once a catalogue.
const BLOCK: i64 = 256;
/// Stars that are prepared at a time, more or less.
const MOST_AT_ONCE: usize = 1 << 15;
/// Parts of the field that are drawn at a time.
const TILES_AT_ONCE: usize = 64;
/// Stars that are worth a task of their own.
const LEAST_AT_ONCE: usize = 1 << 10;

impl<T: ConvReal> StarPlan<T> {
    /// A plan for stars through a model, drawn on `size` by `size` pixels about the pixel that each lies on (its own at index
    /// `size / 2`) where given, else as far as the stamps reach. Light beyond these pixels is lost, not put elsewhere.
    ///
    /// # Errors
    /// [`ConvError::PixelResponse`] when the stamps lack the pixel response.
    pub fn new(model: &PsfModel, options: PlanOptions, size: Option<usize>) -> Result<Self, ConvError> {
        let painter = StarPainter::new(
            model,
            FrameShape::new(1, 1).map_err(ConvError::Result)?.region(),
            options.anchor(),
            size,
        )?;
        let axes =
            PhasedAxis::both(model.grid(), painter.window()).filter(|_| options.anchor() != Anchor::Output);
        Ok(Self {
            window: painter.window(),
            splines: painter.splines(),
            phased: axes.map(|axes| Phased {
                layout: RowLayout::new(&axes[0]),
                axes,
                space: PsfSpace::new(model),
                tolerance: options.tolerance().max(rounding::<T>()),
                blocks: BlockCache::new(options.memory_bytes()),
            }),
            model: model.clone(),
            options,
            size,
        })
    }

    /// The model.
    pub fn model(&self) -> &PsfModel {
        &self.model
    }

    /// Columns and rows to which stars are cut, if they are.
    pub fn size(&self) -> Option<usize> {
        self.size
    }

    /// Adds the point sources of a scene to an image of its frame, `[y, x]`. Sources off the frame shine in as far as their
    /// stamps reach.
    ///
    /// # Errors
    /// [`ConvError`] when the PSF has no value at a source that reaches the frame.
    ///
    /// # Panics
    /// When `image` has not the frame's shape.
    pub fn add_to(&self, scene: &Scene<T>, image: &mut Array2<T>) -> Result<(), ConvError> {
        let shape = scene.frame().shape();
        assert_eq!(image.dim(), (shape.ny(), shape.nx()), "an image of the frame");
        self.add_to_region(scene, shape.region(), image.view_mut(), &NoProgress)
    }

    /// The same for any part of the image: `image` is `[y, x]` of `region`, in pixels of the frame. What a pixel gets does not depend on which
    /// others are at hand. Pixels of a row that are no neighbours in memory are copied and back.
    ///
    /// `progress` is asked whether to go on, and not told how far it has come.
    ///
    /// # Errors
    /// As [`Self::add_to`]; [`ConvError::FrameShape`] for an image of another shape than the region. [`ConvError::Cancelled`]: some of the stars may
    /// have been added.
    pub fn add_to_region(
        &self,
        scene: &Scene<T>,
        region: PixelRegion,
        image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<(), ConvError> {
        check_shape(region.shape(), image.dim())?;
        with_rows_in_memory(image, |image| self.add_stars(scene, region, image, progress))
    }

    fn add_stars(
        &self,
        scene: &Scene<T>,
        region: PixelRegion,
        mut image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<(), ConvError> {
        let Some(phased) = &self.phased else {
            return self.draw_exactly(scene, scene.sources(), region, image, progress);
        };
        let frame = scene.frame();
        let mut stars: Vec<StarKey> = scene
            .sources()
            .par_iter()
            .enumerate()
            .with_min_len(LEAST_AT_ONCE)
            .filter_map(|(index, source)| {
                let star = Star::new(index, source, frame);
                let lights = star.reaches(self.window, region);
                lights.then(|| StarKey {
                    block: block_of(star.pixel),
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
            progress.still_wanted()?;
            let first = (region.x0(), region.y0());
            missed.extend(self.draw(phased, scene, now, (first, image.view_mut()), progress)?);
            rest = later;
        }
        missed.sort_unstable();
        let missed: Vec<_> = missed.into_iter().map(|index| scene.sources()[index]).collect();
        self.draw_exactly(scene, &missed, region, image, progress)
    }

    /// Draws groups of stars, and tells which would miss the tolerance and were not drawn.
    fn draw(
        &self,
        phased: &Phased<T>,
        scene: &Scene<T>,
        groups: &[&[StarKey]],
        (first, image): ((i64, i64), ArrayViewMut2<'_, T>),
        progress: &dyn Progress,
    ) -> Result<Vec<usize>, ConvError> {
        let prepared: Vec<(Group<T>, Vec<usize>)> = groups
            .par_iter()
            .map(|stars| self.prepare(phased, scene, stars, progress))
            .collect::<Result<_, _>>()?;
        let (groups, missed): (Vec<Group<T>>, Vec<Vec<usize>>) = prepared.into_iter().unzip();
        T::dispatch(DrawGroups {
            axes: &phased.axes,
            layout: phased.layout,
            groups: &groups,
            image,
            first,
            progress,
        })?;
        Ok(missed.into_iter().flatten().collect())
    }

    /// The block of some stars, and what each takes of it.
    fn prepare(
        &self,
        phased: &Phased<T>,
        scene: &Scene<T>,
        stars: &[StarKey],
        progress: &dyn Progress,
    ) -> Result<(Group<T>, Vec<usize>), ConvError> {
        progress.still_wanted()?;
        let key = stars[0].block;
        let block = phased.blocks.get(key, || {
            StarBlock::new(
                &self.model,
                &phased.space,
                region_of(key),
                &phased.axes,
                phased.tolerance,
            )
        });
        let mut vectors = StarVectors::new(&self.model, &phased.space);
        let mut coefficients = Vec::with_capacity(block.kernel_count());
        let taps = phased.axes[1].tap_count();
        let mut weights = Vec::with_capacity(stars.len() * taps * block.kernel_count());
        let (mut prepared, mut missed) = (Vec::with_capacity(stars.len()), Vec::new());
        for (number, &StarKey { index, .. }) in stars.iter().enumerate() {
            if number.is_multiple_of(LEAST_AT_ONCE) {
                progress.still_wanted()?;
            }
            let star = Star::new(index, &scene.sources()[index], scene.frame());
            let Some([columns, rows]) = star.phases(&phased.axes) else {
                continue;
            };
            let (x, y) = star.position;
            let position = Position::new(x, y).map_err(ConvError::Result)?;
            let scale = vectors.set(position)?;
            let whole = vectors.norm();
            vectors.project(block.modes(), &mut coefficients);
            if vectors.norm() > phased.tolerance * whole {
                missed.push(star.index);
                continue;
            }
            let scale = scale * star.flux;
            let first = weights.len();
            for tap in &rows.weights[..taps] {
                weights.extend(coefficients.iter().map(|c| T::nearest(tap * c * scale)));
            }
            prepared.push(PreparedStar::new(
                &star,
                [columns, rows],
                first..weights.len(),
                phased.axes[0].oversampling(),
            ));
        }
        Ok((Group::new(block, prepared, weights), missed))
    }

    fn draw_exactly(
        &self,
        scene: &Scene<T>,
        sources: &[psf_types::PointSource],
        region: PixelRegion,
        image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<(), ConvError> {
        if sources.is_empty() {
            return Ok(());
        }
        let painter = StarPainter::new(&self.model, scene.frame(), self.options.anchor(), self.size)?;
        painter
            .sharing(self.splines.clone())
            .add_to_region(sources, region, image, progress)
    }
}

fn block_of((column, row): (i64, i64)) -> BlockKey {
    (row.div_euclid(BLOCK), column.div_euclid(BLOCK))
}

fn region_of((row, column): BlockKey) -> PixelRegion {
    let shape = FrameShape::new(BLOCK as usize, BLOCK as usize).expect("blocks have pixels");
    PixelRegion::new(column * BLOCK, row * BLOCK, shape)
}
