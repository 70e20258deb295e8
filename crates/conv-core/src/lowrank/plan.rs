//! Plans: everything about a convolution that does not depend on the light.

use std::ops::Range;
use std::sync::{Arc, OnceLock};

use ndarray::{Array2, ArrayView2, ArrayViewMut2, s};
use psf_types::{Anchor, FrameShape, Image, ImageView, NoProgress, PixelRegion, Progress, PsfModel, Scene};

use super::axis_cuts::Stretch;
use super::block::Block;
use super::cost_model::CostModel;
use super::execution::TileCounts;
use super::fresh::zeros;
use super::gather::Gather;
use super::geometry::Geometry;
use super::job::Job;
use super::options::{Paths, PlanOptions};
use super::scatter::Scatter;
use super::summary::text;
use super::tile_engine::TileEngine;
use super::tile_light::Direction;
use super::tiling::Tiling;
use super::whole_frame::WholeFrame;
use super::workspace::Pool;
use crate::image_memory::{check_shape, with_rows_in_memory};
use crate::stars::StarPlan;
use crate::transform::TileTransform;
use crate::{ConvError, ConvReal};

/// The convolution of scenes of one shape with one model, prepared: tiles, the modes of each, their stamps and coefficients.
///
/// Made once, it serves any number of scenes. It is a linear operator: which modes a tile has depends on the model and the
/// tolerance, never on the light. What depends on the light (skipping dark tiles, drawing single pixels) changes rounding
/// alone.
///
/// In a tile the PSFs are `h(x) = flux(x) reference + sum_j c_j(x) mode_j`, with the fewest modes that keep every one of them
/// within the tolerance; the modes hold no flux, so that flux is kept at any tolerance.
///
/// ```
/// use std::sync::Arc;
///
/// use conv_core::{Direct, ConvolutionMethod, Plan, PlanOptions};
/// use ndarray::{Array2, Array3};
/// use psf_types::{
///     CoefficientField, FieldError, Image, Normalisation, Position, PsfBasis, PsfModel, Scene, StampGrid,
/// };
///
/// /// One component, whose share grows from left to right.
/// #[derive(Debug)]
/// struct Ramp;
/// impl CoefficientField for Ramp {
///     fn component_count(&self) -> usize {
///         1
///     }
///     fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
///         a[0] = p.x() / 500.0;
///         Ok(())
///     }
/// }
///
/// let component = Array3::from_shape_fn((1, 3, 3), |(_, y, x)| if y == 1 { [-0.5, 0.0, 0.5][x] } else { 0.0 }) * 2f64.sqrt();
/// let basis = PsfBasis::new(Some(Array2::from_elem((3, 3), 1.0 / 9.0)), component, StampGrid::new(3, 3)?)?;
/// let model = PsfModel::new(&basis, Arc::new(Ramp), Normalisation::Unit, None)?;
///
/// let scene = |seed: usize| {
///     Image::new(Array2::from_shape_fn((60, 70), |(y, x)| ((3 * x + 5 * y + seed) % 7) as f64)).map(Scene::from_image)
/// };
/// let plan = Plan::for_scene(&model, &scene(0)?, PlanOptions::new(1e-3)?)?;
/// println!("{}", plan.summary());
/// for seed in 0..3 {
///     let image = plan.execute(&scene(seed)?)?;
///     let exact = Direct::default().convolve(&model, &scene(seed)?)?;
///     let largest = (&image.pixels() - &exact.pixels()).fold(0.0, |m: f64, d| m.max(d.abs()));
///     assert!(largest < 1e-3 * 7.0);
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Plan<T: ConvReal> {
    pub(super) model: PsfModel,
    pub(super) whole: Arc<WholeFrame>,
    pub(super) geometry: Geometry,
    pub(super) options: PlanOptions,
    pub(super) tiling: Tiling,
    pub(super) fft: TileTransform<T>,
    pub(super) cost: CostModel,
    /// Row by row.
    pub(super) blocks: Vec<Block<T>>,
    pub(super) shape: FrameShape,
    pub(super) frame: PixelRegion,
    /// The part of the frame that it makes, in pixels of the frame.
    pub(super) region: PixelRegion,
    /// Columns and rows of the scene that reach the region.
    pub(super) light: [Range<usize>; 2],
    pub(super) ramp: Vec<T>,
    pub(super) pool: Pool<T>,
    /// Made when the first star comes.
    pub(super) stars: OnceLock<StarPlan<T>>,
    #[cfg(feature = "gpu")]
    pub(super) gpu: Option<crate::gpu::GpuEngine>,
}

impl<T: ConvReal> Plan<T> {
    /// The image of a scene.
    ///
    /// # Errors
    /// [`ConvError`] when the scene has another shape or frame than the plan, or light where there is no PSF.
    pub fn execute(&self, scene: &Scene<T>) -> Result<Image<T>, ConvError> {
        Ok(self.execute_with_progress(scene, &NoProgress)?.0)
    }

    /// The image of a scene, and how its tiles were treated.
    ///
    /// # Errors
    /// As [`Self::execute`].
    pub fn execute_with_progress(
        &self,
        scene: &Scene<T>,
        progress: &dyn Progress,
    ) -> Result<(Image<T>, TileCounts), ConvError> {
        let mut image = self.dark_image();
        let counts = self.add_to(scene, &mut image, progress)?;
        Ok((Image::new(image).map_err(ConvError::Result)?, counts))
    }

    /// An image of the frame, or of the plan's region of it, `[y, x]` without light, for [`add_to`](Self::add_to). Adding to its
    /// fresh memory takes less time than to that of a large array of zeros made otherwise: its pages have been written to.
    pub fn dark_image(&self) -> Array2<T> {
        zeros((self.region.shape().ny(), self.region.shape().nx()))
    }

    /// The anchoring.
    pub fn anchor(&self) -> Anchor {
        self.options.anchor()
    }

    /// Adds the image of a scene to one that is there: `[y, x]` of the frame, or of the plan's region of it.
    ///
    /// # Errors
    /// As [`Self::execute`], and for an image of another shape.
    pub fn add_to(
        &self,
        scene: &Scene<T>,
        image: &mut Array2<T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, ConvError> {
        let counts = self.add_extended_to(scene, image, progress)?;
        if !scene.sources().is_empty() {
            self.stars()?
                .add_to_region(scene, self.region, image.view_mut(), progress)?;
        }
        Ok(counts)
    }

    /// Like [`Self::add_to`] without the scene's point sources.
    ///
    /// # Errors
    /// As [`Self::add_to`].
    pub fn add_extended_to(
        &self,
        scene: &Scene<T>,
        image: &mut Array2<T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, ConvError> {
        self.check_scene(scene)?;
        check_shape(self.region.shape(), image.dim())?;
        match scene.image() {
            None => Ok(TileCounts::default()),
            Some(light) => self.add_light_to(&light.view(), image.view_mut(), progress),
        }
    }

    /// Adds the image of light that belongs to somebody else to an image that does, without copies: `light` is `[y, x]` of the whole scene, or
    /// of its part that reaches the image ([`light_region`](Self::light_region)); `image` of the frame, or of the plan's
    /// [`region`](Self::region) of it.
    ///
    /// An image in which the pixels of a row are no neighbours in memory is copied and back.
    ///
    /// # Errors
    /// [`ConvError`] for light or an image of another shape, and light where there is no PSF. [`ConvError::Cancelled`]: the image is left half done.
    pub fn add_light_to(
        &self,
        light: &ImageView<'_, T>,
        image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, ConvError> {
        check_shape(self.region.shape(), image.dim())?;
        let [columns, rows] = self.light_part(light.shape())?;
        let light = light.pixels();
        let light = light.slice(s![rows, columns]);
        let rows_of_blocks = 0..self.tiling.rows.len();
        progress.start(rows_of_blocks.len() as u64);
        with_rows_in_memory(image, |image| {
            self.forward(rows_of_blocks, (light, 0), (image, 0), progress)
        })
    }

    /// Whether a scene has the shape and the frame of this plan.
    ///
    /// # Errors
    /// [`ConvError::PlanShape`] where it has not.
    pub fn check_scene(&self, scene: &Scene<T>) -> Result<(), ConvError> {
        if scene.shape() == self.shape && scene.frame() == self.frame {
            Ok(())
        } else {
            Err(self.wrong_shape(scene.shape(), scene.frame()))
        }
    }

    /// The shape of the scenes that it is for.
    pub fn scene_shape(&self) -> FrameShape {
        self.shape
    }

    /// The frame, in pixels of the scene.
    pub fn frame(&self) -> PixelRegion {
        self.frame
    }

    /// The part of the frame that this plan makes, in pixels of the frame: all of it unless it was made [for a region](Self::for_region).
    pub fn region(&self) -> PixelRegion {
        self.region
    }

    /// The part of the scene whose light reaches the frame, or the plan's region of it, in pixels of the scene.
    pub fn light_region(&self) -> PixelRegion {
        let [columns, rows] = &self.light;
        let shape = FrameShape::new(columns.len(), rows.len()).expect("a region's own light reaches it");
        PixelRegion::new(columns.start as i64, rows.start as i64, shape)
    }

    /// Columns and rows that reach the region of a plane with the shape of the scene or of its part that does.
    fn light_part(&self, got: FrameShape) -> Result<[Range<usize>; 2], ConvError> {
        let part = self.light_region();
        if got == part.shape() {
            Ok([0..got.nx(), 0..got.ny()])
        } else if got == self.shape {
            Ok(self.light.clone())
        } else {
            let part = text(part);
            let expected = format!(
                "the whole scene, {}, or its part that reaches the image, {part}",
                self.shape
            );
            Err(ConvError::LightShape { expected, got })
        }
    }

    /// The transpose: what each pixel of the scene gives to the scalar product of its image with `image`, for images of the
    /// frame or of the plan's region of it. `<A f, g> = <f, A^T g>` for every scene `f` without point sources.
    ///
    /// # Errors
    /// [`ConvError::FrameShape`] for an image of another shape.
    pub fn adjoint(&self, image: &Image<T>) -> Result<Image<T>, ConvError> {
        self.adjoint_with_progress(&image.view(), &NoProgress)
    }

    /// The transpose applied to pixels that belong to somebody else, telling how far it has come.
    ///
    /// # Errors
    /// As [`Self::adjoint`]; [`ConvError::Cancelled`].
    pub fn adjoint_with_progress(
        &self,
        image: &ImageView<'_, T>,
        progress: &dyn Progress,
    ) -> Result<Image<T>, ConvError> {
        check_shape(self.region.shape(), image.pixels().dim())?;
        let mut scene = zeros((self.shape.ny(), self.shape.nx()));
        self.add_adjoint_to(image, scene.view_mut(), progress)?;
        Image::new(scene).map_err(ConvError::Result)
    }

    /// Adds the transpose of an image to `light`: a plane `[y, x]` of the whole scene, or of its part that reaches the image
    /// ([`light_region`](Self::light_region)). One in which the pixels of a row are no neighbours in memory is copied and back.
    ///
    /// # Errors
    /// [`ConvError`] for an image or a plane of another shape. [`ConvError::Cancelled`]: the plane is left half done.
    pub fn add_adjoint_to(
        &self,
        image: &ImageView<'_, T>,
        light: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, ConvError> {
        let pixels = image.pixels();
        check_shape(self.region.shape(), pixels.dim())?;
        let (height, width) = light.dim();
        let got = FrameShape::new(width, height).map_err(ConvError::Result)?;
        let [columns, rows] = self.light_part(got)?;
        let rows_of_blocks = 0..self.tiling.rows.len();
        progress.start(rows_of_blocks.len() as u64);
        with_rows_in_memory(light.slice_move(s![rows, columns]), |light| {
            let job = Job {
                plan: self,
                rows: rows_of_blocks,
                light: pixels,
                first_light: 0,
                first_output: 0,
                flip: true,
                progress,
            };
            self.run(job, light)
        })
    }

    /// The image of the light in some rows of blocks: `light` and `output` come with the first row that they hold, counted from
    /// the first row that reaches the region and from the region's.
    pub(super) fn forward(
        &self,
        rows: Range<usize>,
        (light, first_light): (ArrayView2<'_, T>, usize),
        (output, first_output): (ArrayViewMut2<'_, T>, usize),
        progress: &dyn Progress,
    ) -> Result<TileCounts, ConvError> {
        let job = Job {
            plan: self,
            rows,
            light,
            first_light,
            first_output,
            flip: false,
            progress,
        };
        self.run(job, output)
    }

    /// Sends light through the operator on the device that executions run on.
    fn run(&self, job: Job<'_, T>, output: ArrayViewMut2<'_, T>) -> Result<TileCounts, ConvError> {
        #[cfg(feature = "gpu")]
        if let Some(gpu) = &self.gpu {
            return gpu.run(&job, output);
        }
        match self.direction(job.flip) {
            Direction::Scatter => T::dispatch(Scatter { job, output }),
            Direction::Gather => T::dispatch(Gather { job, output }),
        }
    }

    /// Which way light goes, or comes back where `transposed`.
    pub(crate) fn direction(&self, transposed: bool) -> Direction {
        match (self.options.anchor(), transposed) {
            (Anchor::Output, false) | (Anchor::Source, true) => Direction::Gather,
            _ => Direction::Scatter,
        }
    }

    /// Predicted seconds for a fully lit tile, and whether without transforms.
    pub(super) fn whole_tile(&self, tile: (usize, usize), kernels: usize) -> (f64, bool) {
        let transforms = self.cost.tile(tile, self.tiling.size, kernels as f64);
        let direct = self.cost.direct(tile, self.geometry.stamp, kernels);
        if direct < transforms && self.options.paths() == Paths::Cheapest {
            (direct, true)
        } else {
            (transforms, false)
        }
    }

    /// The plan for stars through the same model.
    pub(super) fn stars(&self) -> Result<&StarPlan<T>, ConvError> {
        if let Some(stars) = self.stars.get() {
            return Ok(stars);
        }
        let stars = StarPlan::new(&self.model, self.options, None)?;
        Ok(self.stars.get_or_init(|| stars))
    }

    pub(super) fn block(&self, column: usize, row: usize) -> &Block<T> {
        &self.blocks[row * self.tiling.columns.len() + column]
    }

    pub(super) fn pool(&self) -> &Pool<T> {
        &self.pool
    }

    pub(super) fn engine(&self, flip: bool) -> TileEngine<'_, T> {
        TileEngine {
            fft: &self.fft,
            stamp: self.geometry.stamp,
            flip,
            ramp: &self.ramp,
        }
    }

    /// The columns of the other side that each column of blocks reaches.
    pub(super) fn column_extents(&self) -> Vec<(usize, usize)> {
        let reach = |x: usize| self.geometry.reach_from(x, 0).0;
        extents(
            &self.tiling.columns,
            reach,
            self.geometry.stamp.0,
            self.geometry.other_size().0,
        )
    }

    /// The rows of the other side that each row of blocks reaches.
    pub(super) fn row_extents(&self) -> Vec<(usize, usize)> {
        let reach = |y: usize| self.geometry.reach_from(0, y).1;
        extents(
            &self.tiling.rows,
            reach,
            self.geometry.stamp.1,
            self.geometry.other_size().1,
        )
    }

    pub(super) fn wrong_shape(&self, got: FrameShape, got_frame: PixelRegion) -> ConvError {
        ConvError::PlanShape {
            expected: self.shape,
            expected_frame: text(self.frame),
            got,
            got_frame: text(got_frame),
        }
    }
}

fn extents(
    stretches: &[Stretch],
    reach: impl Fn(usize) -> i64,
    stamp: usize,
    limit: usize,
) -> Vec<(usize, usize)> {
    let clamp = |v: i64| v.clamp(0, limit as i64) as usize;
    stretches
        .iter()
        .map(|s| {
            let from = reach(s.start());
            (clamp(from), clamp(from + (s.length() + stamp - 1) as i64))
        })
        .collect()
}

/// Errors of a PSF below this are rounding of the working precision, and no mode is kept for them.
pub(crate) fn rounding<T: ConvReal>() -> f64 {
    // A sixteenth of the precision in f32; in f64 the coordinates themselves are no better than a few times theirs.
    (T::epsilon().as_f64() / 16.0).max(1e-15)
}
