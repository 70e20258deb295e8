//! Execution of plans on a device.

use std::ops::Range;
use std::slice::from_ref;

use ndarray::{Array2, ArrayView1, ArrayView2, ArrayViewMut2, s};
use psf_types::{Anchor, FrameShape, Image, ImageView, PixelRegion, Progress, PsfModel, Uncounted};

use crate::cpu::correlate::{Correlate, Correlations, LightAndImage, Pair};
use crate::cpu::gather::Gather;
use crate::cpu::many::Many;
use crate::cpu::processor::{LightPass, Processor};
use crate::cpu::scatter::Scatter;
pub use crate::cpu::treatment::TileCounts;
#[cfg(feature = "gpu")]
use crate::gpu::{GpuDevice, GpuEngine, GpuError, GpuOptions, GpuTimes};
use crate::image_memory::{check_shape, with_rows_in_memory};
use crate::plan::geometry::Direction;
use crate::{ConvError, ConvReal, ConvolutionMethod, Plan, PlanOptions, SampleWeights};

/// The operation that a plan is executed for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Operation {
    /// From light to its image.
    Convolve,
    /// From an image to light: the transpose of [`Convolve`](Self::Convolve).
    Adjoint,
}

/// A plan on a device, ready to convolve any number of light arrays. The device is a GPU or the
/// processor, with all threads of rayon's current pool.
///
/// An execution does not change the engine, so several may run at the same time. Every device uses
/// the plan's tiles and modes. A GPU computes in f32 and uses no direct sums. Its result differs
/// from the processor's result only by rounding. The modes of a tile never depend on the light.
/// Some steps depend on the light (skipping dark tiles, drawing single pixels), but they change
/// only the rounding of the result.
///
/// ```
/// use std::sync::Arc;
///
/// use conv_core::{ConvolutionMethod, Direct, Engine, Operation, Plan, PlanOptions};
/// use ndarray::{Array2, Array3};
/// use psf_types::{
///     CoefficientField, FieldError, FrameShape, ImageView, NoProgress, Normalisation, Position,
///     PsfBasis, PsfModel, StampGrid,
/// };
///
/// /// One component whose coefficient grows from left to right.
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
/// let half = 0.5_f64.sqrt();
/// let row = [-half, 0.0, half];
/// let component =
///     Array3::from_shape_fn((1, 3, 3), |(_, y, x)| if y == 1 { row[x] } else { 0.0 });
/// let mean = Array2::from_elem((3, 3), 1.0 / 9.0);
/// let basis = PsfBasis::new(Some(mean), component, StampGrid::new(3, 3)?)?;
/// let model = PsfModel::new(&basis, Arc::new(Ramp), Normalisation::Unit, None)?;
///
/// let shape = FrameShape::new(70, 60)?;
/// let engine = Engine::new(Plan::new(&model, shape, shape.region(), PlanOptions::new(1e-3)?)?);
/// println!("{}", engine.plan().summary());
/// for seed in 0..3 {
///     let light = Array2::from_shape_fn((60, 70), |(y, x)| ((3 * x + 5 * y + seed) % 7) as f64);
///     let light = ImageView::new(light.view())?;
///     let mut image = engine.plan().zeros();
///     engine.execute(Operation::Convolve, &[light.view()], vec![image.view_mut()], &NoProgress)?;
///     let exact = Direct::default().convolve(&model, &light, shape.region(), &NoProgress)?;
///     let largest = (&image - &exact.pixels()).fold(0.0, |m: f64, d| m.max(d.abs()));
///     assert!(largest < 1e-3 * 7.0);
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Engine<T: ConvReal> {
    processor: Processor<T>,
    #[cfg(feature = "gpu")]
    gpu: Option<GpuEngine>,
}

impl<T: ConvReal> Engine<T> {
    /// A plan on the processor.
    pub fn new(plan: Plan<T>) -> Self {
        Self {
            processor: Processor::new(plan),
            #[cfg(feature = "gpu")]
            gpu: None,
        }
    }

    /// A plan on a GPU.
    ///
    /// # Errors
    /// [`GpuError`] if the plan is in f64, if the GPU's limits are too low for the plan, or if the
    /// GPU or its driver fails. The plan is returned with the error, for use on another device.
    #[cfg(feature = "gpu")]
    #[allow(
        clippy::result_large_err,
        reason = "a success holds the plan, too, and is as large"
    )]
    pub fn on_gpu(
        plan: Plan<T>,
        device: &GpuDevice,
        options: GpuOptions,
    ) -> Result<Self, (Plan<T>, GpuError)> {
        match GpuEngine::new(&plan, device, options) {
            Ok(gpu) => Ok(Self {
                processor: Processor::new(plan),
                gpu: Some(gpu),
            }),
            Err(error) => Err((plan, error)),
        }
    }

    /// The plan.
    pub fn plan(&self) -> &Plan<T> {
        &self.processor.plan
    }

    /// The GPU, if the plan is on one.
    #[cfg(feature = "gpu")]
    pub fn gpu(&self) -> Option<&GpuDevice> {
        self.gpu.as_ref().map(|gpu| &gpu.device)
    }

    /// The durations of the parts of the last execution without an error. [`stream`](Self::stream)
    /// executes the plan band by band, and only the times of its last band are returned. `None` if
    /// the plan is not on a GPU, or before the first execution.
    #[cfg(feature = "gpu")]
    pub fn gpu_times(&self) -> Option<GpuTimes> {
        self.gpu.as_ref().and_then(GpuEngine::times)
    }

    /// Applies the operation to the arrays `from` and adds the results to the arrays `into`. All are
    /// `[y, x]`.
    ///
    /// - [`Operation::Convolve`]: from light, one array for each layer of the plan
    ///   ([`Plan::of_layers`]), to one image, the sum of the images of all layers. The image has the shape
    ///   of the plan's [region](Plan::region): the frame or a part of it.
    /// - [`Operation::Adjoint`]: from one image to light, one array for each layer:
    ///   `<A f, g> = <f, A^T g>` for every light `f` and image `g`.
    ///
    /// An array of light covers the plan's whole scene ([`Plan::scene_shape`]), or only the part of
    /// it that reaches the image ([`Plan::light_region`]). If the pixels of a row of a result are not
    /// contiguous in memory, this function works on a copy of it and writes the copy back.
    ///
    /// # Errors
    /// [`ConvError`] if the light or the image has another shape than the plan expects, if there are
    /// other numbers of them, if the PSF has no value at a pixel where it is needed, if the GPU fails, or
    /// if the progress object cancels the work. After an error the result is incomplete.
    pub fn execute(
        &self,
        operation: Operation,
        from: &[ImageView<'_, T>],
        into: Vec<ArrayViewMut2<'_, T>>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, ConvError> {
        let rows = 0..self.plan().tiling.rows.len();
        let (light, images) = match operation {
            Operation::Convolve => (from.len(), into.len()),
            Operation::Adjoint => (into.len(), from.len()),
        };
        self.check_layers(light)?;
        if images != 1 {
            return Err(ConvError::Layers("an execution has one image"));
        }
        progress.start(rows.len() as u64);
        // The rows count once.
        let uncounted = Uncounted(progress);
        let results = into.into_iter().enumerate().map(|(number, into)| {
            let (from, into) = self.parts(operation, from, into)?;
            let progress: &dyn Progress = if number == 0 { progress } else { &uncounted };
            let pass = self.pass(rows.clone(), (from, number, 0), 0, operation, progress);
            with_rows_in_memory(into, |into| self.run(pass, into))
        });
        results.sum()
    }

    fn check_layers(&self, got: usize) -> Result<(), ConvError> {
        if got == self.plan().models().len() {
            return Ok(());
        }
        Err(ConvError::Layers(
            "the light must have as many layers as the plan",
        ))
    }

    /// Applies the operation to several arrays and adds each result to its own array, as
    /// [`execute`](Self::execute) does for one. The results are equal, bit by bit. For many small
    /// frames this is faster, because threads work on different frames, and the spectra of a block
    /// serve several frames. `progress` counts frames.
    ///
    /// # Errors
    /// As for [`execute`](Self::execute).
    ///
    /// # Panics
    /// If there is not one array `into` for each array `from`.
    #[inline(never)]
    pub fn execute_many(
        &self,
        operation: Operation,
        from: &[ImageView<'_, T>],
        into: Vec<ArrayViewMut2<'_, T>>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, ConvError> {
        assert_eq!(from.len(), into.len(), "an array for each result");
        self.check_layers(1)?;
        progress.start(from.len() as u64);
        let rows_in_memory = |into: &ArrayViewMut2<'_, T>| into.strides()[1] == 1;
        #[cfg(feature = "gpu")]
        let on_gpu = self.gpu.is_some();
        #[cfg(not(feature = "gpu"))]
        let on_gpu = false;
        let few = from.len() < rayon::current_num_threads();
        if few || on_gpu || !into.iter().all(rows_in_memory) {
            let results = from.iter().zip(into).map(|(from, into)| {
                let counts = self.execute(operation, from_ref(from), vec![into], &Uncounted(progress))?;
                progress.advance(1);
                Ok(counts)
            });
            return results.sum();
        }
        let parts = from.iter().zip(into).map(|(from, into)| {
            let (light, output) = self.parts(operation, from_ref(from), into)?;
            let rows = 0..self.plan().tiling.rows.len();
            Ok((self.pass(rows, (light, 0, 0), 0, operation, progress), output))
        });
        let passes = parts.collect::<Result<_, ConvError>>()?;
        T::dispatch(Many { passes })
    }

    /// Correlates light with images, which gives the derivatives with respect to the PSFs of samples
    /// ([`Correlations`]). `take` gets the parts of the result, in an order that does not depend on threads.
    /// `fluxes` are those of the samples' PSFs, before scaling. They are given if PSFs are scaled to unit flux.
    ///
    /// The processor computes them, for a plan on a GPU, too.
    ///
    /// # Errors
    /// As for [`execute`](Self::execute), and [`ConvError::Layers`] for a plan of several layers.
    ///
    /// # Panics
    /// If there is not one flux for each sample.
    #[inline(never)]
    pub fn correlate(
        &self,
        weights: &SampleWeights<T>,
        pairs: &[LightAndImage<'_, T>],
        fluxes: Option<ArrayView1<'_, f64>>,
        progress: &dyn Progress,
        take: &mut dyn FnMut(Correlations),
    ) -> Result<(), ConvError> {
        self.check_layers(1)?;
        let gathers = self.gathers();
        let pairs = pairs.iter().map(|pair| {
            let LightAndImage { light, image, result } = pair;
            let plan = self.plan();
            check_shape(plan.region().shape(), image.pixels().dim())?;
            let of_light = |light: &ImageView<'_, T>| plan.light_part(light.shape());
            let [columns, rows] = of_light(light)?;
            let light = light.pixels().slice_move(s![rows, columns]);
            let result = result.as_ref().map(|result| {
                if gathers {
                    check_shape(plan.region().shape(), result.pixels().dim())?;
                    return Ok::<_, ConvError>(result.pixels());
                }
                let [columns, rows] = of_light(result)?;
                Ok(result.pixels().slice_move(s![rows, columns]))
            });
            let (weighted, other) = if gathers {
                (image.pixels(), light)
            } else {
                (light, image.pixels())
            };
            let result = result.transpose()?;
            Ok(Pair {
                weighted,
                other,
                result,
            })
        });
        T::dispatch(Correlate {
            processor: &self.processor,
            weights,
            pairs: pairs.collect::<Result<_, ConvError>>()?,
            fluxes,
            progress,
            take,
        })
    }

    /// The parts of arrays between which light passes.
    fn parts<'f, 'i>(
        &self,
        operation: Operation,
        from: &'f [ImageView<'_, T>],
        into: ArrayViewMut2<'i, T>,
    ) -> Result<(Vec<ArrayView2<'f, T>>, ArrayViewMut2<'i, T>), ConvError> {
        let plan = self.plan();
        match operation {
            Operation::Convolve => {
                check_shape(plan.region().shape(), into.dim())?;
                let parts = from.iter().map(|light| {
                    let [columns, rows] = plan.light_part(light.shape())?;
                    Ok(light.pixels().slice_move(s![rows, columns]))
                });
                Ok((parts.collect::<Result<_, ConvError>>()?, into))
            }
            Operation::Adjoint => {
                let image = from[0].pixels();
                check_shape(plan.region().shape(), image.dim())?;
                let (height, width) = into.dim();
                let got = FrameShape::new(width, height).map_err(ConvError::Result)?;
                let [columns, rows] = plan.light_part(got)?;
                Ok((vec![image], into.slice_move(s![rows, columns])))
            }
        }
    }

    /// Reads light in bands of rows, convolves it, and writes the image in bands of rows. So
    /// neither the light nor the image is ever in memory as a whole. The image is the same, bit by
    /// bit, as the image that [`execute`](Self::execute) adds to an array of zeros.
    ///
    /// A plan of a region reads only the rows that reach the region, and writes the region's rows.
    ///
    /// # Errors
    /// The errors of the stream, and [`ConvError`] as for [`execute`](Self::execute), or if the
    /// image has values that are not finite.
    pub fn stream<R: RowStream<T>>(
        &self,
        stream: &mut R,
        progress: &dyn Progress,
    ) -> Result<TileCounts, R::Error> {
        let tiling = &self.plan().tiling;
        let rows_of_blocks = tiling.rows.len();
        progress.start(rows_of_blocks as u64);
        let shape = self.plan().region().shape();
        let mut counts = TileCounts::default();
        // Rows of the image that are not finished yet. `written` is the index of the first of them.
        let mut pending = Array2::<T>::zeros((0, shape.nx()));
        let mut written = 0;
        for first in (0..rows_of_blocks).step_by(tiling.band()) {
            let band = first..(first + tiling.band()).min(rows_of_blocks);
            let [light_rows, reached] = self.rows_of(&band);
            let layers = 0..self.plan().models().len();
            let light = layers.map(|layer| self.read(stream, layer, light_rows.clone()));
            let light = light.collect::<Result<Vec<_>, _>>()?;
            let next = if band.end < rows_of_blocks {
                self.rows_of(&(band.end..band.end + 1))[1].start
            } else {
                shape.ny()
            };
            // The rows `written..end` of the image are in memory. They include all rows that this
            // band reaches or finishes.
            let end = reached.end.max(written + pending.nrows()).max(next);
            let mut image = Array2::zeros((end - written, shape.nx()));
            image.slice_mut(s![..pending.nrows(), ..]).assign(&pending);
            // Blocks of an output-anchored plan write only to the rows that they cover. Other blocks
            // also write to rows around them, so they get all rows in memory.
            let into = if self.gathers() { reached } else { written..end };
            let output = image.slice_mut(s![into.start - written..into.end - written, ..]);
            let light = light.iter().map(|layer| layer.view()).collect();
            let (light, operation) = ((light, 0, light_rows.start), Operation::Convolve);
            counts += self.run(self.pass(band, light, into.start, operation, progress), output)?;
            pending = image.slice(s![next - written.., ..]).to_owned();
            if next > written {
                let finished = image.slice_move(s![..next - written, ..]);
                let finished = Image::new(finished).map_err(ConvError::Result)?;
                stream.write(finished.pixels())?;
            }
            written = next;
        }
        Ok(counts)
    }

    /// Executes a pass on the engine's device and adds the result to `output`. All arrays hold whole rows of
    /// pixels.
    #[inline(never)]
    pub(crate) fn run(
        &self,
        pass: LightPass<'_, T>,
        mut output: ArrayViewMut2<'_, T>,
    ) -> Result<TileCounts, ConvError> {
        if pass.light.len() > 1 && self.gathers() {
            // Layers are weighted after their transforms, so each has its own. The rows count once.
            let uncounted = Uncounted(pass.progress);
            let layers = pass.layers.clone().zip(&pass.light).map(|(layer, light)| {
                let is_first = layer == pass.layers.start;
                let pass = LightPass {
                    layers: layer..layer + 1,
                    light: vec![light.view()],
                    progress: if is_first { pass.progress } else { &uncounted },
                    ..pass.clone()
                };
                let output = output.view_mut();
                T::dispatch(Gather { pass, output })
            });
            return layers.sum();
        }
        #[cfg(feature = "gpu")]
        if let Some(gpu) = &self.gpu {
            let direct_sums = false;
            return gpu.run(&LightPass { direct_sums, ..pass }, output);
        }
        match pass.direction() {
            Direction::Scatter => T::dispatch(Scatter { pass, output }),
            Direction::Gather => T::dispatch(Gather { pass, output }),
        }
    }

    /// An execution for some rows of blocks: of an operation on `light`, one array for each layer from `layer`
    /// on. The light and the output come with the index of their first row.
    fn pass<'a>(
        &'a self,
        rows: Range<usize>,
        (light, layer, first_light): (Vec<ArrayView2<'a, T>>, usize, usize),
        first_output: usize,
        operation: Operation,
        progress: &'a dyn Progress,
    ) -> LightPass<'a, T> {
        LightPass {
            processor: &self.processor,
            rows,
            layers: layer..layer + light.len(),
            light,
            first_light,
            first_output,
            flip: operation == Operation::Adjoint,
            direct_sums: true,
            progress,
        }
    }

    /// Returns whether PSFs belong to pixels of the image (output-anchored), not of the light.
    fn gathers(&self) -> bool {
        self.plan().direction(false) == Direction::Gather
    }

    /// The rows of light that a band (some neighbouring rows of blocks) needs, and the rows of the
    /// image that it writes to. The rows of light count from the first row that reaches the plan's
    /// region. Blocks cover rows of the side that PSFs belong to, and reach rows of the other side.
    fn rows_of(&self, band: &Range<usize>) -> [Range<usize>; 2] {
        let (rows, extents) = (&self.plan().tiling.rows, self.plan().extents(1));
        let (first, last) = (band.start, band.end - 1);
        let covered = rows[first].start()..rows[last].end();
        let reached = extents[first].0..extents[last].1;
        if self.gathers() {
            [reached, covered]
        } else {
            [covered, reached]
        }
    }

    fn read<R: RowStream<T>>(
        &self,
        stream: &mut R,
        layer: usize,
        rows: Range<usize>,
    ) -> Result<Array2<T>, R::Error> {
        let [columns, light] = self.plan().light.clone();
        let mut whole = Array2::zeros((rows.len(), self.plan().scene_shape().nx()));
        let rows = light.start + rows.start..light.start + rows.end;
        stream.read(layer, rows, whole.view_mut())?;
        Ok(if columns.len() == whole.ncols() {
            whole
        } else {
            whole.slice(s![.., columns]).to_owned()
        })
    }
}

/// Reads the rows of the light and writes the rows of its image, for frames larger than memory.
pub trait RowStream<T> {
    /// The error of reading or writing.
    type Error: From<ConvError>;

    /// Fills `light` with the given rows of the whole light, in all columns. `layer` is 0 unless the
    /// plan has several layers ([`Plan::of_layers`]).
    ///
    /// # Errors
    /// Errors of the source.
    fn read(
        &mut self,
        layer: usize,
        rows: Range<usize>,
        light: ArrayViewMut2<'_, T>,
    ) -> Result<(), Self::Error>;

    /// Writes the next rows of the image, in order from the first.
    ///
    /// # Errors
    /// Errors of the target.
    fn write(&mut self, rows: ArrayView2<'_, T>) -> Result<(), Self::Error>;
}

/// The fast engine with a new plan for each call. To convolve several light arrays, keep an
/// [`Engine`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LowRank {
    options: PlanOptions,
}

impl LowRank {
    /// The method with the given options for its plans.
    pub fn new(options: PlanOptions) -> Self {
        Self { options }
    }
}

impl<T: ConvReal> ConvolutionMethod<T> for LowRank {
    fn anchor(&self) -> Anchor {
        self.options.anchor()
    }

    fn convolve(
        &self,
        model: &PsfModel,
        light: &ImageView<'_, T>,
        frame: PixelRegion,
        progress: &dyn Progress,
    ) -> Result<Image<T>, ConvError> {
        let engine = Engine::new(Plan::new(model, light.shape(), frame, self.options)?);
        let mut image = engine.plan().zeros();
        engine.execute(
            Operation::Convolve,
            from_ref(light),
            vec![image.view_mut()],
            progress,
        )?;
        Image::new(image).map_err(ConvError::Result)
    }
}
