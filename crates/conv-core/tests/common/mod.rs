//! Small models with PSFs that vary strongly, and the double sum in its simplest form.

pub(crate) mod extended;
pub(crate) mod grid_field;

use std::slice::from_ref;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use conv_core::{
    ConvError, ConvReal, ConvolutionMethod, Direct, Engine, Operation, Paths, Plan, PlanOptions, SourcePlan,
    TileCounts,
};
use ndarray::{Array2, Array3, ArrayView2};
use psf_types::{
    Anchor, BilinearCells, CoefficientField, ErrorLimit, FieldError, FrameShape, Image, ImageView,
    NoProgress, Normalisation, PixelRegion, PointSource, Position, Progress, PsfBasis, PsfModel, StampGrid,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub(crate) const ANCHORS: [Anchor; 2] = [Anchor::Source, Anchor::Output];
pub(crate) const PATHS: [Paths; 2] = [Paths::Cheapest, Paths::Transforms];

/// With or without a mean, and the normalisation of the flux.
pub(crate) const KINDS: [(bool, Normalisation); 3] = [
    (true, Normalisation::Unit),
    (true, Normalisation::Keep),
    (false, Normalisation::Keep),
];

/// Sizes and centres of stamps: even, odd, off-centre, one pixel wide, wider than the scene.
pub(crate) const STAMPS: [((usize, usize), (usize, usize)); 5] = [
    ((6, 4), (3, 2)),
    ((5, 7), (2, 3)),
    ((4, 4), (0, 3)),
    ((1, 3), (0, 0)),
    ((33, 29), (16, 11)),
];

pub(crate) fn options(tolerance: f64, anchor: Anchor, paths: Paths) -> PlanOptions {
    PlanOptions::new(tolerance)
        .unwrap()
        .with_anchor(anchor)
        .with_paths(paths)
}

/// Light, and the frame, which is a region of the light.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Scene<T = f64> {
    pub(crate) light: Image<T>,
    pub(crate) frame: PixelRegion,
}

impl<T: ConvReal> Scene<T> {
    pub(crate) fn new(light: Array2<T>) -> Self {
        let light = Image::new(light).unwrap();
        let frame = light.shape().region();
        Self { light, frame }
    }

    pub(crate) fn with_frame(self, frame: PixelRegion) -> Self {
        Self { frame, ..self }
    }

    pub(crate) fn shape(&self) -> FrameShape {
        self.light.shape()
    }

    pub(crate) fn pixels(&self) -> ArrayView2<'_, T> {
        self.light.pixels()
    }

    pub(crate) fn plan(&self, model: &PsfModel, options: PlanOptions) -> Plan<T> {
        Plan::new(model, self.shape(), self.frame, options).unwrap()
    }

    pub(crate) fn engine(&self, model: &PsfModel, options: PlanOptions) -> Engine<T> {
        Engine::new(self.plan(model, options))
    }

    pub(crate) fn through(
        &self,
        model: &PsfModel,
        method: &(impl ConvolutionMethod<T> + ?Sized),
    ) -> Result<Image<T>, ConvError> {
        method.convolve(model, &self.light.view(), self.frame, &NoProgress)
    }

    /// Computes single pixels by the direct sum.
    pub(crate) fn at_pixels(
        &self,
        model: &PsfModel,
        anchor: Anchor,
        pixels: &[(usize, usize)],
    ) -> Result<Vec<f64>, ConvError> {
        let light = (self.pixels(), (0, 0));
        Direct::new(anchor).at_pixels(model, light, self.shape(), self.frame, pixels, &NoProgress)
    }
}

/// Executions that return new images.
pub(crate) trait Execute<T: ConvReal> {
    fn counted(&self, scene: &Scene<T>, progress: &dyn Progress)
    -> Result<(Image<T>, TileCounts), ConvError>;

    fn adjoint_of(&self, image: &ImageView<'_, T>, progress: &dyn Progress) -> Result<Image<T>, ConvError>;

    fn image_of(&self, scene: &Scene<T>) -> Result<Image<T>, ConvError> {
        Ok(self.counted(scene, &NoProgress)?.0)
    }

    fn adjoint(&self, image: &Image<T>) -> Result<Image<T>, ConvError> {
        self.adjoint_of(&image.view(), &NoProgress)
    }
}

impl<T: ConvReal> Execute<T> for Engine<T> {
    fn counted(
        &self,
        scene: &Scene<T>,
        progress: &dyn Progress,
    ) -> Result<(Image<T>, TileCounts), ConvError> {
        let mut image = self.plan().zeros();
        let counts = self.execute(
            Operation::Convolve,
            from_ref(&scene.light.view()),
            vec![image.view_mut()],
            progress,
        )?;
        Ok((Image::new(image).unwrap(), counts))
    }

    fn adjoint_of(&self, image: &ImageView<'_, T>, progress: &dyn Progress) -> Result<Image<T>, ConvError> {
        let shape = self.plan().scene_shape();
        let mut light = Array2::zeros((shape.ny(), shape.nx()));
        self.execute(
            Operation::Adjoint,
            from_ref(image),
            vec![light.view_mut()],
            progress,
        )?;
        Ok(Image::new(light).unwrap())
    }
}

/// Draws stars by a plan into a new image of a frame.
pub(crate) fn drawn<T: ConvReal>(
    plan: &SourcePlan<T>,
    stars: &[PointSource],
    frame: PixelRegion,
) -> Array2<T> {
    let mut image = Array2::zeros((frame.shape().ny(), frame.shape().nx()));
    let whole = frame.shape().region();
    plan.draw_stars_into(stars, frame, whole, image.view_mut(), &NoProgress)
        .unwrap();
    image
}

pub(crate) fn single(scene: &Scene<f64>) -> Scene<f32> {
    Scene::new(scene.pixels().mapv(|v| v as f32)).with_frame(scene.frame)
}

/// Smooth fields of three coefficients, defined everywhere.
#[derive(Debug)]
pub(crate) struct Waves;

impl CoefficientField for Waves {
    fn component_count(&self) -> usize {
        3
    }
    fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
        a[0] = 1.0 + 0.3 * (p.x() / 7.0).sin();
        a[1] = 0.4 * (p.y() / 5.0).cos();
        a[2] = 0.02 * (p.x() - p.y());
        Ok(())
    }
}

/// A field that convolution visits pixel by pixel.
#[derive(Debug)]
pub(crate) struct PixelByPixel<F>(pub(crate) F);

impl<F: CoefficientField> CoefficientField for PixelByPixel<F> {
    fn component_count(&self) -> usize {
        self.0.component_count()
    }
    fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
        self.0.evaluate_into(p, a)
    }
    fn bilinear_cells(&self, region: PixelRegion, _: ErrorLimit<'_>) -> BilinearCells {
        BilinearCells::every_row(region)
    }
}

/// A field with a constant PSF.
#[derive(Debug)]
pub(crate) struct Constant;

impl CoefficientField for Constant {
    fn component_count(&self) -> usize {
        3
    }
    fn evaluate_into(&self, _: Position, a: &mut [f64]) -> Result<(), FieldError> {
        a.copy_from_slice(&[0.9, 0.3, -0.2]);
        Ok(())
    }
}

/// No component at all: the mean stamp everywhere.
#[derive(Debug)]
struct MeanAlone;

impl CoefficientField for MeanAlone {
    fn component_count(&self) -> usize {
        0
    }
    fn evaluate_into(&self, _: Position, _: &mut [f64]) -> Result<(), FieldError> {
        Ok(())
    }
}

/// The model whose PSF is one stamp everywhere.
pub(crate) fn model_of_stamp(stamp: Array2<f64>, grid: StampGrid) -> PsfModel {
    let components = Array3::zeros((0, grid.ny(), grid.nx()));
    let basis = PsfBasis::new(Some(stamp), components, grid).unwrap();
    PsfModel::new(&basis, Arc::new(MeanAlone), Normalisation::Keep, None).unwrap()
}

pub(crate) fn noise(ny: usize, nx: usize, seed: u64) -> Array2<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    Array2::from_shape_simple_fn((ny, nx), || rng.random_range(-1.0..1.0))
}

/// A model with stamps of `nx x ny` pixels, three random orthonormal components and perhaps a mean.
pub(crate) fn model_with(
    field: Arc<dyn CoefficientField>,
    (nx, ny): (usize, usize),
    centre: (usize, usize),
    mean: bool,
    normalisation: Normalisation,
) -> PsfModel {
    let pixels = nx * ny;
    let mut rows = noise(3, pixels, 11);
    for k in 0..3 {
        for j in 0..k {
            let overlap = rows.row(k).dot(&rows.row(j));
            let other = rows.row(j).to_owned();
            rows.row_mut(k).scaled_add(-overlap, &other);
        }
        let norm = rows.row(k).dot(&rows.row(k)).sqrt();
        rows.row_mut(k).mapv_inplace(|v| v / norm);
    }
    let components: Array3<f64> = rows.into_shape_with_order((3, ny, nx)).unwrap();
    let grid = StampGrid::new(nx, ny)
        .unwrap()
        .with_centre(centre.0 as f64, centre.1 as f64)
        .unwrap();
    let mean = mean.then(|| noise(ny, nx, 12).mapv(|v| v + 1.5));
    PsfModel::new(
        &PsfBasis::new(mean, components, grid).unwrap(),
        field,
        normalisation,
        None,
    )
    .unwrap()
}

pub(crate) fn scene(nx: usize, ny: usize, seed: u64) -> Scene<f64> {
    let mut light = noise(ny, nx, seed);
    // A part of the light is dark, so that skipping is tested too.
    light.slice_mut(ndarray::s![ny / 3..ny / 2, ..]).fill(0.0);
    Scene::new(light)
}

pub(crate) fn region(x0: i64, y0: i64, nx: usize, ny: usize) -> PixelRegion {
    PixelRegion::new(x0, y0, FrameShape::new(nx, ny).unwrap())
}

/// Cancels the work from a given poll on, and counts polls.
pub(crate) struct Patience {
    questions: AtomicUsize,
    enough: usize,
}

impl Patience {
    pub(crate) fn of(enough: usize) -> Self {
        Self {
            questions: AtomicUsize::new(0),
            enough,
        }
    }

    pub(crate) fn endless() -> Self {
        Self::of(usize::MAX)
    }

    pub(crate) fn asked(&self) -> usize {
        self.questions.load(Ordering::Relaxed)
    }
}

impl Progress for Patience {
    fn start(&self, _: u64) {}
    fn advance(&self, _: u64) {}
    fn cancelled(&self) -> bool {
        self.questions.fetch_add(1, Ordering::Relaxed) >= self.enough
    }
}

/// The double sum over the frame, without any optimisation.
pub(crate) fn double_sum(model: &PsfModel, scene: &Scene<f64>, anchor: Anchor) -> Array2<f64> {
    let light = scene.pixels();
    let (ny, nx) = light.dim();
    let frame = scene.frame;
    let grid = model.grid();
    let (cx, cy) = grid.whole_centre().unwrap();
    let psf = |x: usize, y: usize| {
        model
            .psf_at(Position::of_pixel(x as i64 - frame.x0(), y as i64 - frame.y0()))
            .unwrap()
            .into_values()
    };
    let mut result = Array2::zeros((frame.shape().ny(), frame.shape().nx()));
    for x in 0..nx {
        for y in 0..ny {
            let of_source = psf(x, y);
            for ((row, column), sum) in result.indexed_iter_mut() {
                let (column, row) = (column + frame.x0() as usize, row + frame.y0() as usize);
                let (i, j) = ((column + cx).wrapping_sub(x), (row + cy).wrapping_sub(y));
                if i < grid.nx() && j < grid.ny() {
                    let h = if anchor == Anchor::Source {
                        of_source[[j, i]]
                    } else {
                        psf(column, row)[[j, i]]
                    };
                    *sum += light[[y, x]] * h;
                }
            }
        }
    }
    result
}

pub(crate) fn largest_difference(a: &Array2<f64>, b: &Array2<f64>) -> f64 {
    assert_eq!(a.dim(), b.dim());
    a.iter().zip(b).fold(0.0, |m, (a, b)| m.max((a - b).abs()))
}

pub(crate) fn peak(a: &Array2<f64>) -> f64 {
    a.iter().fold(0.0, |m, v| m.max(v.abs()))
}
