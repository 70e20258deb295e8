//! Plans for drawing stars and galaxies.

use ndarray::{ArrayView2, ArrayViewMut2};
use psf_types::{Anchor, PixelRegion, PointSource, Position, Progress, PsfModel};

use crate::dropped_light::DroppedLight;
use crate::galaxies::{
    ExtendedGradient, ExtendedSources, ExtendedToDraw, GalaxyDrawer, GalaxyErrors, Variations,
};
use crate::image_memory::{check_shape, with_rows_in_memory};
use crate::photons::{
    ExpectedPhotons, PhotonReport, PhotonShooter, PhotonSources, SharedWork, add_photons_of_light,
    photons_to_shoot_below,
};
use crate::plan::cost_model::CostModel;
use crate::plan::{PlanOptions, check_layers, share_stamps};
use crate::sources::{PointGradient, SourcePsfs};
use crate::stars::{StarDrawer, StarPainter, StarsToDraw, WingDrawer, wing_points};
use crate::{ConvError, ConvReal};

/// A plan for drawing sources through one model: stars, which are points, and extended sources such as
/// galaxies, which are functions on the sky ([`LightProfile`](psf_types::LightProfile)). A source is
/// convolved with the PSF of its own position. With [`Anchor::Output`], each pixel has the PSF of the pixel,
/// except in the outskirts of extended sources.
///
/// If the plan is source-anchored, PSFs come from local bases in the working precision `T`. Each block of the
/// field has a local basis: the few PSFs that the tolerance requires. The relative L2 error of a source's PSF
/// (for a star: on the pixels of the frame that it lights) is at most the tolerance. With
/// [`ToleranceOn::Aperture`](psf_types::ToleranceOn::Aperture), so is the error of its flux in every
/// circle. Every source is tested, stars at their own sub-pixel positions. A source that would exceed the
/// tolerance is drawn from all components. This choice depends only on the source's position.
///
/// - **Stars.** If the stamps' oversampling is not a whole number, or the plan is output-anchored, all stars
///   are drawn from all components in f64. Where stars are many, transforms draw them together, at their own
///   sub-pixel positions. Very bright stars are drawn one by one even there, because the rounding noise of
///   their transforms would hide faint stars. So the image is linear in the fluxes up to rounding.
/// - **Extended sources.** Beside the error of the PSF, a pixel has an error of at most about the tolerance
///   times the source's peak, and usually of a third of that. Below a tolerance of 1e-6 it hardly shrinks
///   further: transforms of light have errors of 1.5e-7, and light far out is computed in single precision.
///
/// The image is the same, bit by bit, for any number of threads. Another order of the catalogue changes only
/// rounding. Blocks of the field are prepared when the first source falls on them. They are kept for the next
/// catalogue, as far as the memory limit in the options allows.
///
/// ```
/// use std::sync::Arc;
///
/// use conv_core::{PlanOptions, SourcePlan};
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
/// let plan = SourcePlan::<f32>::new(&model, PlanOptions::default(), None)?;
/// let mut image = Array2::zeros((32, 32));
/// plan.draw_stars_into(&[star], frame, frame, image.view_mut(), &NoProgress)?;
/// assert!((image.sum() - 1000.0).abs() < 0.1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct SourcePlan<T> {
    psfs: SourcePsfs,
    stars: StarDrawer<T>,
    galaxies: GalaxyDrawer<T>,
    photons: PhotonShooter,
    /// Draws the wings of stars and extended sources, if the PSF has wings.
    wings: Option<WingDrawer<T>>,
}

/// The tolerance for extended sources of an exact plan.
const EXACT: f64 = 1e-7;

impl<T: ConvReal> SourcePlan<T> {
    /// Plans the drawing of sources with the PSFs of a model. If `size` is given, a star is drawn on
    /// `size` columns and rows. The pixel that the star lies on has index `size / 2` in both.
    /// Otherwise the star is drawn as far as its stamp reaches. Light beyond these pixels is lost. For
    /// extended sources, stamps are truncated to `size` frame pixels along each side.
    ///
    /// # Errors
    /// [`ConvError::PixelResponse`] if the stamps do not include the pixel response,
    /// [`ConvError::StampSize`] if `size` is 0.
    pub fn new(model: &PsfModel, options: PlanOptions, size: Option<usize>) -> Result<Self, ConvError> {
        Self::of_layers(std::slice::from_ref(model), options, size)
    }

    /// Plans the drawing of sources with the PSFs of several models that share their stamps, such as
    /// those of one PSF at several times. The plan draws with the PSFs of the first. The local
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
        Self::made(SourcePsfs::new(models, options, size)?, false)
    }

    /// As [`of_layers`](Self::of_layers), for images without a tolerance: all stars are drawn from all
    /// components in f64, and extended sources within a tolerance of 1e-7.
    ///
    /// # Errors
    /// As for [`of_layers`](Self::of_layers).
    pub fn exact(models: &[PsfModel], anchor: Anchor, size: Option<usize>) -> Result<Self, ConvError> {
        let options = PlanOptions::new(EXACT)?.with_anchor(anchor);
        Self::made(SourcePsfs::new(models, options, size)?, true)
    }

    fn made(psfs: SourcePsfs, exactly: bool) -> Result<Self, ConvError> {
        let stars = StarDrawer::new(&psfs, exactly)?;
        let (kernel, window) = stars.kernel_and_window();
        let (options, model) = (psfs.options(), &psfs.model);
        let tolerance = options.tolerance_in::<T>();
        if model.wings().is_some() && options.anchor() == Anchor::Output {
            return Err(ConvError::WingsAtOutput);
        }
        Ok(Self {
            wings: WingDrawer::new(model, psfs.size(), options.floor(), !exactly)?,
            stars,
            galaxies: GalaxyDrawer::new(&psfs),
            photons: PhotonShooter::new(&psfs, kernel, window, tolerance),
            psfs,
        })
    }

    /// Returns a plan that draws sources with the PSFs of another model. Both plans share their local
    /// bases. Sources whose PSFs these do not represent within the tolerance are drawn from all components,
    /// which is slow: see [`of_layers`](Self::of_layers). `None` if the model has other stamps or another
    /// scaling to unit flux.
    pub fn for_other_field(&self, model: &PsfModel) -> Option<Self> {
        if !share_stamps(&self.psfs.model, model) {
            return None;
        }
        let psfs = self.psfs.with_model(model);
        Some(Self {
            stars: self.stars.clone(),
            galaxies: self.galaxies.with_same_bases(&psfs),
            photons: self.photons.for_other_field(),
            wings: self.wings_for(model),
            psfs,
        })
    }

    /// The drawer of the wings of another model. It has wings if and only if this plan's model has.
    fn wings_for(&self, model: &PsfModel) -> Option<WingDrawer<T>> {
        let wings = model.wings()?;
        Some(self.wings.as_ref()?.for_other_field(wings))
    }

    /// Returns a plan [of layers](Self::of_layers) for other models, with local bases of its own. It
    /// shares the other parts of this plan, so this is fast. Among these parts is the distance beyond the
    /// stamps up to which stars are drawn, which the edges of this plan's PSFs decide. `None` without
    /// models, or if they have other stamps or another scaling to unit flux.
    pub fn for_other_layers(&self, models: &[PsfModel]) -> Option<Self> {
        if !(check_layers(models).is_ok() && share_stamps(&self.psfs.model, &models[0])) {
            return None;
        }
        let psfs = self.psfs.for_other_models(models);
        Some(Self {
            stars: self.stars.with_own_bases(&psfs),
            galaxies: self.galaxies.with_own_bases(&psfs),
            photons: self.photons.for_other_field(),
            wings: self.wings_for(&models[0]),
            psfs,
        })
    }

    /// The model whose PSFs the sources have.
    pub fn model(&self) -> &PsfModel {
        &self.psfs.model
    }

    /// The number of columns and rows to which stars are truncated. `None` if they are not
    /// truncated.
    pub fn size(&self) -> Option<usize> {
        self.psfs.size()
    }

    /// Draws single stars of a frame from all components.
    pub fn painter(&self, frame: PixelRegion) -> StarPainter<'_> {
        self.stars.painter(&self.psfs, frame)
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
    pub fn draw_stars_into(
        &self,
        stars: &[PointSource],
        frame: PixelRegion,
        region: PixelRegion,
        image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<(), ConvError> {
        let catalogue = StarsToDraw {
            stars,
            frame,
            progress,
        };
        check_shape(region.shape(), image.dim())?;
        with_rows_in_memory(image, |mut image| {
            self.stars
                .draw_into(&self.psfs, catalogue, region, image.view_mut())
        })
    }

    /// Computes the derivatives of `sum(image * F)` with respect to the flux and the position of each star, where `F`
    /// is the image that [`draw_stars_into`](Self::draw_stars_into) draws. `image` holds the pixels `[y, x]` of
    /// `region`, which is in pixels of the frame.
    ///
    /// The derivatives include the change of the PSF with the position. They are those of the PSFs that stars are
    /// drawn with, within the tolerance. They leave out the floor: a star without flux has a derivative with respect
    /// to its flux. Where the coefficient field has a kink, those with respect to the position are one-sided.
    ///
    /// # Errors
    /// [`ConvError::Derivatives`] if the PSF has wings, and the errors of
    /// [`draw_stars_into`](Self::draw_stars_into).
    #[inline(never)]
    pub fn star_gradients(
        &self,
        stars: &[PointSource],
        frame: PixelRegion,
        region: PixelRegion,
        image: ArrayView2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<Vec<PointGradient>, ConvError> {
        self.check_derivatives()?;
        let catalogue = StarsToDraw {
            stars,
            frame,
            progress,
        };
        check_shape(region.shape(), image.dim())?;
        let image = image.as_standard_layout();
        self.stars.gradients(&self.psfs, catalogue, region, image.view())
    }

    /// As [`star_gradients`](Self::star_gradients), for extended sources, as
    /// [`draw_extended_into`](Self::draw_extended_into) draws them. `variations` gives the lights on either side of
    /// that of the source with an index, along each parameter of its light. A source is drawn in the same way for
    /// all of them. Far outside its window, derivatives are differences of light in single precision, without the
    /// change of the PSF.
    ///
    /// # Errors
    /// [`ConvError::Derivatives`] if the PSF has wings, and the errors of
    /// [`draw_extended_into`](Self::draw_extended_into).
    #[inline(never)]
    pub fn extended_gradients(
        &self,
        sources: ExtendedSources<'_>,
        variations: Variations<'_>,
        (frame, region): (PixelRegion, PixelRegion),
        image: ArrayView2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<Vec<ExtendedGradient>, ConvError> {
        self.check_derivatives()?;
        let catalogue = ExtendedToDraw {
            sources,
            frame,
            progress,
        };
        check_shape(region.shape(), image.dim())?;
        self.galaxies.gradients(catalogue, variations, region, image)
    }

    fn check_derivatives(&self) -> Result<(), ConvError> {
        if self.wings.is_some() {
            return Err(ConvError::Derivatives("a PSF with wings has none"));
        }
        Ok(())
    }

    /// The points whose wings [`draw_wings_into`](Self::draw_wings_into) draws, for an exact sum.
    ///
    /// # Errors
    /// [`ConvError`] for a position or a flux beyond the range of numbers.
    pub fn wing_points(
        &self,
        stars: &[PointSource],
        extended: ExtendedSources<'_>,
    ) -> Result<Vec<PointSource>, ConvError> {
        let points = wing_points(stars, extended)?;
        Ok(points.into_iter().map(|point| point.source).collect())
    }

    /// Adds the wings of stars and extended sources to a part of an image, if the PSF has wings. The other
    /// functions draw the core of the PSF. The wings of an extended source are those of 32 points, which
    /// represent its light.
    ///
    /// The wings of all sources of a scene belong into one call, which chooses how they are drawn: one by one, or
    /// together by transforms. The choice depends on all sources whose wings may reach the frame.
    ///
    /// # Errors
    /// As for [`draw_stars_into`](Self::draw_stars_into).
    #[inline(never)]
    pub fn draw_wings_into(
        &self,
        (stars, extended): (&[PointSource], ExtendedSources<'_>),
        frame: PixelRegion,
        region: PixelRegion,
        image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<(), ConvError> {
        let Some(wings) = &self.wings else { return Ok(()) };
        check_shape(region.shape(), image.dim())?;
        let points = wing_points(stars, extended)?;
        with_rows_in_memory(image, |image| {
            wings.draw_into(&points, (frame, region), image, progress)
        })
    }

    /// Adds extended sources to a part of an image, as [`draw_stars_into`](Self::draw_stars_into) adds stars.
    ///
    /// # Errors
    /// [`ConvError::FrameShape`] for an image of another shape than the region,
    /// [`ConvError::Cancelled`], and [`ConvError`] if the PSF has no value at a source that reaches
    /// the region. After an error the image may hold some of the sources.
    #[inline(never)]
    pub fn draw_extended_into(
        &self,
        sources: ExtendedSources<'_>,
        frame: PixelRegion,
        region: PixelRegion,
        image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<(), ConvError> {
        let catalogue = ExtendedToDraw {
            sources,
            frame,
            progress,
        };
        check_shape(region.shape(), image.dim())?;
        with_rows_in_memory(image, |image| self.galaxies.draw_into(catalogue, region, image))
    }

    /// Adds the light that stars and extended sources drop at most, because it is below the floor
    /// ([`PlanOptions::with_floor`]). `dropped` covers `region`, in pixels of the frame. Stars that are drawn
    /// together by transforms drop nothing, but are counted as if they did. Without a floor, only the flux is
    /// counted.
    ///
    /// # Errors
    /// [`ConvError`] if the PSF has wings that are not known at a source.
    pub fn add_dropped_light(
        &self,
        (stars, extended): (&[PointSource], ExtendedSources<'_>),
        frame: PixelRegion,
        region: PixelRegion,
        dropped: &mut DroppedLight,
    ) -> Result<(), ConvError> {
        let progress = &psf_types::NoProgress;
        let catalogue = StarsToDraw {
            stars,
            frame,
            progress,
        };
        self.stars.add_dropped(&self.psfs, catalogue, region, dropped);
        let catalogue = ExtendedToDraw {
            sources: extended,
            frame,
            progress,
        };
        self.galaxies.add_dropped(catalogue, region, dropped);
        match &self.wings {
            Some(wings) => wings.add_dropped(&wing_points(stars, extended)?, frame, dropped),
            None => Ok(()),
        }
    }

    /// The numbers of photons below which it is predicted to take the least time to draw stars and extended
    /// sources of a frame photon by photon ([`shoot_into`](Self::shoot_into)), the others as light. The prediction is
    /// for the first image: later images use its tables and local bases again.
    pub fn photons_to_shoot_below(&self, photons: ExpectedPhotons<'_>, frame: PixelRegion) -> [f64; 2] {
        if self.psfs.options().anchor() == Anchor::Output {
            return [0.0; 2];
        }
        let model = &self.psfs.model;
        let pixels_of_source = self.stars.kernel_and_window().1.shape().pixel_count();
        let draw_star = self.stars.seconds_of_star(model, photons.stars.len(), frame);
        let work = self.photons.work_of_photon(&self.psfs, frame);
        let costs = CostModel::of_kinds(draw_star, work);
        let shared = SharedWork {
            tables: self.photons.expected_tables(&self.psfs, frame),
            pixels_of_table: model.grid().pixel_count(),
            blocks: self.stars.block_count(frame),
            pixels_of_frame: frame.shape().pixel_count(),
            pixels_of_source,
        };
        // The wings of shot sources are drawn as light.
        let has_background = photons.has_background || self.wings.is_some();
        let photons = ExpectedPhotons {
            has_background,
            ..photons
        };
        photons_to_shoot_below(photons, costs, shared)
    }

    /// Adds the photons of sources to the counts of a part of an image. `counts` holds the pixels `[y, x]` of
    /// `region`, which is in pixels of the frame. This suits sources of few photons: each photon takes
    /// 15 to 40 ns (150 ns and more where sums of the PSF's terms have both signs, as those of sharp PSFs and of
    /// Lanczos-3), where drawing takes microseconds for each source.
    ///
    /// The counts of pixels are independent Poisson deviates. Their means are the source's flux times
    /// `photons_per_flux` times its PSF, as [`draw_stars_into`](Self::draw_stars_into) and
    /// [`draw_extended_into`](Self::draw_extended_into) draw it. Where a PSF is negative, photons count as -1, so
    /// the mean is negative, too. The variance of a pixel is its mean or, where the PSFs of nodes of the
    /// coefficient field have both signs, the weighted sum of their sizes.
    ///
    /// The mean is exact to 1e-6 of the flux if the field is a weighted mean of at most 8 nodes, as on grids and
    /// in triangles. The PSFs of other fields are bilinear in cells of the field, within the tolerance. Each
    /// extended source needs the distribution of its light
    /// ([`LightProfile::radial_light`](psf_types::LightProfile::radial_light)).
    ///
    /// If the PSF has wings, their light is drawn ([`draw_wings_into`](Self::draw_wings_into)), as far as the
    /// floor asks, and the photons of each pixel follow from it.
    ///
    /// The photons of a source depend on the seed and on the source's position, flux and profile. So neither
    /// threads nor the region nor the order of the sources matter. Sources that are equal in everything get
    /// different photons. Tables of the PSFs are kept for the next call, as far as the memory limit allows.
    ///
    /// `progress` is polled and may cancel the work. No steps are reported to it.
    ///
    /// # Errors
    /// [`ConvError::FrameShape`] for counts of another shape than the region, [`ConvError::Photons`] for an
    /// output-anchored plan or if a source has too many photons, [`ConvError::Cancelled`], and [`ConvError`] if
    /// the PSF has no value at a source that reaches the region. After an error the counts may hold some of the
    /// photons.
    pub fn shoot_into(
        &self,
        sources: &PhotonSources<'_>,
        frame: PixelRegion,
        region: PixelRegion,
        mut counts: ArrayViewMut2<'_, i32>,
        progress: &dyn Progress,
    ) -> Result<PhotonReport, ConvError> {
        check_shape(region.shape(), counts.dim())?;
        let mut report =
            self.photons
                .shoot_into(&self.psfs, sources, frame, region, counts.view_mut(), progress)?;
        if self.wings.is_some() {
            let mut light = crate::zeros::<T>(counts.dim());
            let of_sources = (sources.stars, sources.extended);
            self.draw_wings_into(of_sources, frame, region, light.view_mut(), progress)?;
            let chosen = (sources.photons_per_flux, sources.seed);
            add_photons_of_light(light.view(), chosen, region, counts, &mut report);
        }
        Ok(report)
    }

    /// Computes the light of extended sources in single pixels `(column, row)` of the frame, in f64, with the
    /// PSFs of all components, by integration on the sky. The time grows with the number of pairs of a source
    /// and a pixel: about a millisecond if the source's centre lies on the stamp around the pixel, and
    /// microseconds if it is farther away. [`StarPainter::at_pixels`] does this for stars.
    ///
    /// # Errors
    /// The errors of [`draw_extended_into`](Self::draw_extended_into), without those of an image.
    pub fn extended_at_pixels(
        &self,
        sources: ExtendedSources<'_>,
        frame: PixelRegion,
        pixels: &[(usize, usize)],
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, ConvError> {
        let catalogue = ExtendedToDraw {
            sources,
            frame,
            progress,
        };
        self.galaxies.at_pixels(catalogue, pixels)
    }

    /// The largest errors that extended sources may have in pixels `(column, row)` of the frame. For each
    /// source and each pixel that it lights, gives the index of the pixel and the errors to `take`.
    /// `rounding` is the relative rounding error of a PSF.
    ///
    /// # Errors
    /// [`ConvError`] if the PSF has no value at a source that lights one of the pixels.
    pub fn errors_of_extended(
        &self,
        sources: ExtendedSources<'_>,
        (frame, pixels): (PixelRegion, &[(usize, usize)]),
        rounding: f64,
        take: impl FnMut(usize, GalaxyErrors),
    ) -> Result<(), ConvError> {
        let catalogue = ExtendedToDraw {
            sources,
            frame,
            progress: &psf_types::NoProgress,
        };
        self.galaxies.errors_at_pixels(catalogue, pixels, rounding, take)
    }

    /// An upper limit of the L2 norm of the PSF of a source of flux 1 on the pixels of the frame,
    /// for any sub-pixel position. Positions are in pixels of the frame.
    ///
    /// # Errors
    /// [`ConvError`] if the PSF has no value at the position.
    pub fn psf_norm(&self, position: Position) -> Result<f64, ConvError> {
        Ok(self.psfs.norm_and_flux(position)?.0)
    }
}
