//! How plans are made.

use std::sync::{Arc, OnceLock};

use psf_types::{FrameShape, NoProgress, PixelRegion, Progress, PsfModel, Scene};
use rayon::prelude::*;

use super::block::stamps_of;
use super::blocks::blocks;
use super::cost_model::CostModel;
use super::options::PlanOptions;
use super::plan::{Plan, rounding};
use super::whole_frame::{View, WholeFrame};
use super::workspace::Pool;
use crate::transform::TileTransform;
use crate::{ConvError, ConvReal};

/// Blocks whose stamps are made by one product of matrices.
const BLOCKS_A_PRODUCT: usize = 32;

impl<T: ConvReal> Plan<T> {
    /// A plan for scenes of a shape seen through a frame, a region of the scene.
    ///
    /// # Errors
    /// [`ConvError`] when the model's stamps do not suit an image, or the frame reaches beyond the scene. A PSF that has no value somewhere is an error of the
    /// execution, if there is light.
    pub fn new(
        model: &PsfModel,
        shape: FrameShape,
        frame: PixelRegion,
        options: PlanOptions,
    ) -> Result<Self, ConvError> {
        Self::for_region(model, shape, frame, frame.shape().region(), options)
    }

    /// A plan for scenes like this one.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn for_scene(model: &PsfModel, scene: &Scene<T>, options: PlanOptions) -> Result<Self, ConvError> {
        Self::new(model, scene.shape(), scene.frame(), options)
    }

    /// A plan for a region of the frame, in pixels of the frame, so that a frame can be made in pieces, on many machines: with the tiles and the
    /// modes of the whole frame, of which it holds what reaches the region. Pieces put together are the image that the whole plan makes but for
    /// rounding, at any tolerance: their edges leave no trace.
    ///
    /// Executions take the light of the whole scene or only that of [`light_region`](Self::light_region), and give images of the region.
    ///
    /// The tiles are chosen anew, as for the whole frame; [`for_other_region`](Self::for_other_region) does without.
    ///
    /// ```
    /// use std::sync::Arc;
    ///
    /// use conv_core::{Plan, PlanOptions};
    /// use ndarray::{Array2, Array3, s};
    /// use psf_types::{
    ///     CoefficientField, FieldError, FrameShape, Image, ImageView, NoProgress, Normalisation, PixelRegion, Position, PsfBasis, PsfModel,
    ///     Scene, StampGrid,
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
    /// let basis = PsfBasis::new(Some(Array2::from_elem((5, 5), 0.04)), Array3::zeros((0, 5, 5)), StampGrid::new(5, 5)?)?;
    /// let model = PsfModel::new(&basis, Arc::new(Constant), Normalisation::Unit, None)?;
    /// let light = Array2::from_shape_fn((60, 80), |(y, x)| ((7 * x + 3 * y) % 11) as f64);
    /// let scene = Scene::from_image(Image::new(light)?);
    /// let options = PlanOptions::new(1e-3)?;
    /// let whole = Plan::for_scene(&model, &scene, options)?.execute(&scene)?;
    ///
    /// let region = PixelRegion::new(32, 20, FrameShape::new(16, 20)?);
    /// let plan = Plan::for_region(&model, scene.shape(), scene.frame(), region, options)?;
    /// let part = plan.light_region();
    /// assert_eq!((part.x0(), part.y0(), part.shape()), (30, 18, FrameShape::new(20, 24)?));
    /// let light = ImageView::new(scene.pixels().unwrap().slice_move(s![18..42, 30..50]))?;
    /// let mut image = Array2::zeros((20, 16));
    /// plan.add_light_to(&light, image.view_mut(), &NoProgress)?;
    /// let difference = &image - &whole.pixels().slice(s![20..40, 32..48]);
    /// assert!(difference.iter().all(|d| d.abs() < 1e-12));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// As [`Self::new`]; [`ConvError::RegionOutsideFrame`].
    pub fn for_region(
        model: &PsfModel,
        shape: FrameShape,
        frame: PixelRegion,
        region: PixelRegion,
        options: PlanOptions,
    ) -> Result<Self, ConvError> {
        Self::for_region_with_progress(model, shape, frame, region, options, &NoProgress)
    }

    /// The same, until it is no longer wanted: `progress` is asked whether to go on, and not told how far it has come.
    ///
    /// # Errors
    /// As [`Self::for_region`]; [`ConvError::Cancelled`].
    pub fn for_region_with_progress(
        model: &PsfModel,
        shape: FrameShape,
        frame: PixelRegion,
        region: PixelRegion,
        options: PlanOptions,
        progress: &dyn Progress,
    ) -> Result<Self, ConvError> {
        // A scene checks its frame.
        Scene::<T>::dark(shape)
            .with_frame(frame)
            .map_err(ConvError::Frame)?;
        let whole = WholeFrame::new::<T>(model, View { shape, frame }, options, progress)?;
        Self::of_whole(model, Arc::new(whole), region, options, progress)
    }

    /// A plan for another region of the same frame, or for all of it, with the tiles that were chosen for this one: much sooner made than one
    /// that has to choose. On the processor, whatever this one runs on.
    ///
    /// # Errors
    /// [`ConvError::RegionOutsideFrame`] or [`ConvError::Cancelled`].
    pub fn for_other_region(&self, region: PixelRegion, progress: &dyn Progress) -> Result<Self, ConvError> {
        Self::of_whole(
            &self.model,
            Arc::clone(&self.whole),
            region,
            self.options,
            progress,
        )
    }

    fn of_whole(
        model: &PsfModel,
        whole: Arc<WholeFrame>,
        region: PixelRegion,
        options: PlanOptions,
        progress: &dyn Progress,
    ) -> Result<Self, ConvError> {
        let part = whole.part(region)?;
        let tolerance = options.tolerance().max(rounding::<T>());
        let memory = options.memory_bytes();
        let (blocks, left) = blocks(model, &whole, &part.blocks, tolerance, memory, progress)?;
        let (nx, ny) = part.tiling.size;
        let mut plan = Self {
            fft: TileTransform::new(nx, ny),
            ramp: (0..whole.longest_row()).map(|i| T::nearest(i as f64)).collect(),
            model: model.clone(),
            light: part.light,
            region,
            pool: Pool::new(),
            stars: OnceLock::new(),
            #[cfg(feature = "gpu")]
            gpu: None,
            geometry: part.geometry,
            options,
            tiling: part.tiling,
            cost: CostModel::of::<T>(),
            blocks,
            shape: whole.view.shape,
            frame: whole.view.frame,
            whole,
        };
        plan.keep_stamps(left);
        Ok(plan)
    }

    /// Makes the stamps for which there is room.
    fn keep_stamps(&mut self, mut left: usize) {
        let stamp = self.geometry.stamp.0 * self.geometry.stamp.1 * size_of::<T>();
        let mut room = 0;
        while room < self.blocks.len() {
            match left.checked_sub(self.blocks[room].kernel_count() * stamp) {
                Some(rest) => left = rest,
                None => break,
            }
            room += 1;
        }
        let stamps = self.whole.space.stamps();
        self.blocks[..room]
            .par_chunks_mut(BLOCKS_A_PRODUCT)
            .for_each(|blocks| {
                let made = stamps_of(stamps, &blocks.iter().collect::<Vec<_>>());
                for (block, stamps) in blocks.iter_mut().zip(made) {
                    block.keep_stamps(stamps);
                }
            });
    }
}
