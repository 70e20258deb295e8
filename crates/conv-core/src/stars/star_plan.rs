//! Plans for stars.

use std::sync::Arc;

use ndarray::ArrayViewMut2;
use psf_types::{Anchor, PixelRegion, PointSource, Progress, PsfModel};

use super::draw_blocks::{BlockDrawer, Catalogue, DrawBlocks, Phased};
use super::painter::{StarPainter, StarStamps};
use super::phases::PhasedAxis;
use crate::image_memory::{check_shape, with_rows_in_memory};
use crate::plan::{PlanOptions, check_layers, share_stamps};
use crate::{ConvError, ConvReal};

/// A plan for drawing point sources through one model.
///
/// If the plan is source-anchored and the stamps' oversampling is a whole number, stars are drawn
/// from local bases in the working precision `T`. Each block of the field has a local basis: the
/// few PSFs that the tolerance requires. The relative L2 error of a star's PSF, on the pixels of the
/// frame that the star lights, is at most the tolerance. With
/// [`ToleranceOn::Aperture`](psf_types::ToleranceOn::Aperture), so is the error of its flux in every
/// circle. Every star is tested at its own sub-pixel position. A star that would exceed the tolerance
/// is drawn from all components in f64. This choice depends only on the star's position. Other plans
/// draw all stars from all components in f64.
///
/// Where stars are many, transforms draw them together, at their own sub-pixel positions. Very bright
/// stars are drawn one by one even there, because the rounding noise of their transforms would hide
/// faint stars. So the image is linear in the fluxes up to rounding. It is the same, bit by bit, for
/// any number of threads. Another order of the catalogue changes only rounding.
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
    options: PlanOptions,
    size: Option<usize>,
    stamps: Arc<StarStamps>,
    /// `None` if all stars are drawn from all components.
    phased: Option<Arc<Phased<T>>>,
}

impl<T: ConvReal> StarPlan<T> {
    /// Plans the drawing of stars with the PSFs of a model. If `size` is given, a star is drawn on
    /// `size` columns and rows. The pixel that the star lies on has index `size / 2` in both.
    /// Otherwise the star is drawn as far as its stamp reaches. Light beyond these pixels is lost.
    ///
    /// # Errors
    /// [`ConvError::PixelResponse`] if the stamps do not include the pixel response,
    /// [`ConvError::StampSize`] if `size` is 0.
    pub fn new(model: &PsfModel, options: PlanOptions, size: Option<usize>) -> Result<Self, ConvError> {
        Self::of_layers(std::slice::from_ref(model), options, size)
    }

    /// Plans the drawing of stars with the PSFs of several models that share their stamps, such as
    /// those of one PSF at several times. The plan draws stars with the PSFs of the first. The local
    /// bases represent the PSFs of all models, so [`for_other_field`](Self::for_other_field) can use them
    /// for each model, and for sums of them.
    ///
    /// # Errors
    /// As for [`new`](Self::new), and [`ConvError::Layers`] without models, or if their stamps or their
    /// scaling to unit flux differ.
    #[inline(never)]
    pub fn of_layers(
        models: &[PsfModel],
        options: PlanOptions,
        size: Option<usize>,
    ) -> Result<Self, ConvError> {
        check_layers(models)?;
        let model = &models[0];
        let stamps = StarStamps::new(models, options.anchor(), size)?;
        let axes = PhasedAxis::both(model.grid(), stamps.kernel, stamps.window())
            .filter(|_| options.anchor() != Anchor::Output);
        Ok(Self {
            phased: axes
                .map(|axes| Phased::new(models, axes, stamps.target, (options, size)))
                .transpose()?
                .map(Arc::new),
            model: model.clone(),
            options,
            size,
            stamps: Arc::new(stamps),
        })
    }

    /// Returns a plan that draws stars with the PSFs of another model. Both plans share their local
    /// bases. Stars whose PSFs these do not represent within the tolerance are drawn from all components,
    /// which is slow: see [`of_layers`](Self::of_layers). `None` if the model has other stamps or another
    /// scaling to unit flux.
    pub fn for_other_field(&self, model: &PsfModel) -> Option<Self> {
        share_stamps(&self.model, model).then(|| Self {
            model: model.clone(),
            options: self.options,
            size: self.size,
            stamps: Arc::clone(&self.stamps),
            phased: self.phased.clone(),
        })
    }

    /// Returns a plan [of layers](Self::of_layers) for other models, with local bases of its own. It
    /// shares the other parts of this plan, so this is fast. Among these parts is the distance beyond the
    /// stamps up to which stars are drawn, which the edges of this plan's PSFs decide. `None` without
    /// models, or if they have other stamps or another scaling to unit flux.
    pub fn for_other_layers(&self, models: &[PsfModel]) -> Option<Self> {
        check_layers(models).ok()?;
        let phased = |phased: &Arc<Phased<T>>| Arc::new(phased.for_other_models(models, self.options));
        Some(Self {
            phased: self.phased.as_ref().map(phased),
            ..self.for_other_field(&models[0])?
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
        let drawer = BlockDrawer {
            model: &self.model,
            phased,
            catalogue,
            window: self.stamps.window(),
            region,
        };
        let mut missed = T::dispatch(DrawBlocks {
            drawer,
            image: image.view_mut(),
        })?;
        missed.sort_unstable();
        let missed: Vec<_> = missed.into_iter().map(|index| catalogue.stars[index]).collect();
        let stars = &missed[..];
        self.draw_exactly(Catalogue { stars, ..catalogue }, region, image)
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
