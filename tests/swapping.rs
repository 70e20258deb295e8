//! Every exchangeable part, implemented outside psfield and run through a whole simulation.

use std::collections::BTreeMap;
use std::sync::Arc;

use integration_tests::{relative_l2, test_scene};
use ndarray::{Array2, Array3, ArrayViewMut2, Axis};
use psfield::coeff_field::{
    CoeffFieldError, FieldInterpolation, FieldWeights, InterpolatedField, WeightList,
};
use psfield::conv_core::{BasisConvolution, ConvError, ConvolutionMethod};
use psfield::convert::PsfFormat;
use psfield::fit::fit_with;
use psfield::psf_basis::{BasisError, BasisFit, BasisMethod};
use psfield::psf_sample::{SampleError, Sampling, SamplingMethod, SamplingReport};
use psfield::psf_types::{
    Anchor, CoefficientField, DataError, FieldError, FrameShape, Image, ImageView, NoProgress, Normalisation,
    OutsidePolicy, PixelRegion, PointSource, Position, Progress, PsfBasis, PsfModel, PsfSamples, PsfSource,
    SampleCoefficients, SamplePositions, SourceError, StampGrid,
};
use psfield::{Method, Psf, Scene};

/// A PSF source: two points of light whose ratio changes along x.
#[derive(Debug)]
struct Doublet;

impl Doublet {
    fn share(x: f64) -> f64 {
        0.2 + 0.6 * x / 63.0
    }
}

impl PsfSource for Doublet {
    fn grid(&self) -> StampGrid {
        StampGrid::new(5, 3).unwrap()
    }
    fn field(&self) -> FrameShape {
        FrameShape::new(64, 48).unwrap()
    }
    fn draw_into(&self, at: Position, mut stamp: ArrayViewMut2<'_, f64>) -> Result<(), SourceError> {
        stamp.fill(0.0);
        stamp[[1, 1]] = 1.0 - Self::share(at.x());
        stamp[[1, 4]] = Self::share(at.x());
        Ok(())
    }
}

/// A sampling method: four rows of samples along the left and the right edge.
#[derive(Debug)]
struct TwoEdges;

impl SamplingMethod for TwoEdges {
    fn sample(&self, source: &dyn PsfSource, progress: &dyn Progress) -> Result<Sampling, SampleError> {
        let last = source.field().nx() as i64 - 1;
        let positions: Vec<Position> = [0, 11, 30, 47]
            .iter()
            .flat_map(|&y| [0, last].map(|x| Position::of_pixel(x, y)))
            .collect();
        progress.start(positions.len() as u64);
        let (ny, nx) = source.grid().dim();
        let mut stamps = Array3::zeros((positions.len(), ny, nx));
        for (stamp, &position) in stamps.outer_iter_mut().zip(&positions) {
            source
                .draw_into(position, stamp)
                .map_err(|source| SampleError::Draw { position, source })?;
            progress.advance(1);
        }
        let draws = positions.len();
        let positions = SamplePositions::new(positions, Some(source.field()))?;
        let samples = PsfSamples::new(stamps, positions, source.grid())?;
        Ok(Sampling {
            samples,
            report: SamplingReport::of_fixed_positions(draws),
        })
    }
}

/// A basis method: one component for each pixel that holds light. Exact and orthonormal for any
/// samples.
#[derive(Debug)]
struct LitPixels;

impl BasisMethod for LitPixels {
    fn fit(&self, samples: &psfield::psf_types::PsfSamples) -> Result<BasisFit, BasisError> {
        let (ny, nx) = samples.grid().dim();
        let lit: Vec<(usize, usize)> = (0..ny)
            .flat_map(|y| (0..nx).map(move |x| (y, x)))
            .filter(|&(y, x)| samples.stamps().axis_iter(Axis(0)).any(|s| s[[y, x]] != 0.0))
            .collect();
        if lit.is_empty() {
            return Err(BasisError::External(Box::new(DataError::EmptyBasis)));
        }
        let mut stamps = Array3::zeros((lit.len(), ny, nx));
        for (k, &(y, x)) in lit.iter().enumerate() {
            stamps[[k, y, x]] = 1.0;
        }
        let coefficients =
            Array2::from_shape_fn((samples.len(), lit.len()), |(j, k)| samples.stamp(j)[lit[k]]);
        BasisFit::new(
            samples,
            PsfBasis::new(None, stamps, samples.grid())?,
            coefficients,
            None,
        )
    }
}

/// An interpolator: linear along x between columns of samples, constant along y.
#[derive(Debug)]
struct AlongX;

#[derive(Debug)]
struct AlongXWeights {
    /// The first sample of each column, in order of x.
    columns: Vec<(f64, usize)>,
    samples: usize,
}

impl FieldInterpolation for AlongX {
    fn interpolate(
        &self,
        samples: &SampleCoefficients,
        _: OutsidePolicy,
    ) -> Result<Arc<dyn CoefficientField>, CoeffFieldError> {
        let at = samples.positions();
        let mut first = BTreeMap::new();
        for (sample, position) in at.as_slice().iter().enumerate() {
            first.entry(position.x() as i64).or_insert((position.x(), sample));
        }
        let weights = AlongXWeights {
            columns: first.into_values().collect(),
            samples: at.len(),
        };
        Ok(Arc::new(InterpolatedField::new(samples, Box::new(weights))?))
    }
}

impl FieldWeights for AlongXWeights {
    fn sample_count(&self) -> usize {
        self.samples
    }
    fn weights_into(&self, at: Position, weights: &mut WeightList) -> Result<(), FieldError> {
        weights.clear();
        let right = self
            .columns
            .partition_point(|&(x, _)| x <= at.x())
            .clamp(1, self.columns.len() - 1);
        let ((x0, left), (x1, right)) = (self.columns[right - 1], self.columns[right]);
        let t = (at.x() - x0) / (x1 - x0);
        weights.extend([(left, 1.0 - t), (right, t)]);
        Ok(())
    }
}

/// A nonlinear interpolator: the mean of the samples in logarithms of `1 + a^2`, with weights that fall as a
/// Gaussian of the distance.
#[derive(Debug)]
struct Curved;

#[derive(Debug)]
struct CurvedField(SampleCoefficients);

impl FieldInterpolation for Curved {
    fn interpolate(
        &self,
        samples: &SampleCoefficients,
        _: OutsidePolicy,
    ) -> Result<Arc<dyn CoefficientField>, CoeffFieldError> {
        Ok(Arc::new(CurvedField(samples.clone())))
    }
}

impl CoefficientField for CurvedField {
    fn component_count(&self) -> usize {
        self.0.component_count()
    }
    fn evaluate_into(&self, at: Position, a: &mut [f64]) -> Result<(), FieldError> {
        const WIDTH: f64 = 300.0;
        let distances = self
            .0
            .positions()
            .as_slice()
            .iter()
            .map(|p| p.distance(at) / WIDTH);
        let weights: Vec<f64> = distances.map(|d| (-0.5 * d * d).exp()).collect();
        let whole: f64 = weights.iter().sum();
        for (k, a) in a.iter_mut().enumerate() {
            let column = self.0.values().column(k).to_owned();
            let logarithms = column.iter().map(|v: &f64| v.signum() * v.abs().ln_1p());
            let mean = weights.iter().zip(logarithms).map(|(w, l)| w * l).sum::<f64>() / whole;
            *a = mean.signum() * mean.abs().exp_m1();
        }
        Ok(())
    }
}

/// A convolution method: a plain loop that spreads every lit pixel.
#[derive(Debug)]
struct PlainLoop;

impl ConvolutionMethod<f64> for PlainLoop {
    fn anchor(&self) -> Anchor {
        Anchor::Source
    }

    /// Supports only a frame that covers all of the light.
    fn convolve(
        &self,
        model: &PsfModel,
        light: &ImageView<'_, f64>,
        frame: PixelRegion,
        _: &dyn Progress,
    ) -> Result<Image<f64>, ConvError> {
        assert_eq!(frame, light.shape().region());
        let mut image = Array2::zeros(light.pixels().dim());
        let (cx, cy) = model.grid().whole_centre().expect("centred on a pixel");
        for ((y, x), &flux) in light.pixels().indexed_iter() {
            let psf = model.psf_at(frame.position(x, y))?;
            for ((j, i), &h) in psf.values().indexed_iter() {
                if let (Some(row), Some(column)) = ((y + j).checked_sub(cy), (x + i).checked_sub(cx))
                    && let Some(pixel) = image.get_mut((row, column))
                {
                    *pixel += flux * h;
                }
            }
        }
        Image::new(image).map_err(ConvError::Result)
    }
}

#[test]
fn custom_parts_run_a_whole_simulation() {
    let sampling = TwoEdges.sample(&Doublet, &NoProgress).unwrap();
    let (model, fit) = fit_with(
        sampling.samples,
        &LitPixels,
        &AlongX,
        OutsidePolicy::Nearest,
        Normalisation::Unit,
    )
    .unwrap();
    assert_eq!(fit.rank(), 2);
    assert_eq!(fit.max_error(), 0.0);

    // The source is linear in x and so is the interpolator, so the exact image is known.
    let light = test_scene(64, 48, 0);
    let mut expected = Array2::zeros((48, 64));
    for ((y, x), &f) in light.pixels().indexed_iter() {
        let share = Doublet::share(x as f64);
        // The stamp's centre is (2, 1): light moves one pixel to the left and two to the right.
        if x >= 1 {
            expected[[y, x - 1]] += f * (1.0 - share);
        }
        if x + 2 < 64 {
            expected[[y, x + 2]] += f * share;
        }
    }
    let expected = Image::new(expected).unwrap();
    let psf = Psf::from(model);
    let scene = Scene::from(&light);
    let methods: [Box<dyn ConvolutionMethod<f64>>; 2] =
        [Box::new(PlainLoop), Box::new(BasisConvolution::default())];
    for method in methods {
        let name = format!("{method:?}");
        let simulator = psf.simulator((48, 64)).build_by(method).unwrap();
        let image = simulator.simulate(&scene).unwrap();
        assert!(relative_l2(&image, &expected) < 1e-13, "{name}");
        let check = simulator.spot_check(&scene, &image, (50, 1), &NoProgress);
        assert!(check.unwrap().max_over_peak.unwrap() < 1e-13);
    }
}

/// Stars, exact values and header cards follow the anchoring of the method. The cards and the spot
/// check contain no tolerance.
#[test]
fn a_custom_method_decides_the_anchoring() {
    let psf = Psf::from(TwoEdges.sample(&Doublet, &NoProgress).unwrap().samples);
    let light = test_scene(64, 48, 0);
    let star = PointSource::new(Position::of_pixel(31, 20), 7.0).unwrap();
    let scene = Scene::from(&light).with_stars(vec![star]);
    for anchor in [Anchor::Source, Anchor::Output] {
        let method = Box::new(BasisConvolution::new(anchor));
        let own = psf.simulator((48, 64)).build_by::<f64>(method).unwrap();
        assert_eq!(
            (own.options().anchor, own.options().method),
            (anchor, Method::Own)
        );
        let by_name = psf.simulator((48, 64)).method(Method::Basis).anchor(anchor);
        let expected = by_name.build().unwrap().simulate(&scene).unwrap();
        let image = own.simulate(&scene).unwrap();
        assert_eq!(image, expected);
        let check = own.spot_check(&scene, &image, (50, 1), &NoProgress).unwrap();
        assert!(
            check.max_over_peak.unwrap() < 1e-13 && check.limit.is_none(),
            "{check:?}"
        );
    }
    let nameless = psf.simulator((48, 64)).method(Method::Own);
    assert!(nameless.build::<f64>().is_err());
}

/// Fits samples of Gaussians that widen towards a corner of the frame, and interpolates them by [`Curved`].
fn curved_psf(frame: FrameShape) -> (Psf, PsfSamples) {
    let stamps = Array3::from_shape_fn((49, 32, 32), |(j, y, x)| {
        let (dx, dy) = (x as f64 - 16.0, y as f64 - 16.0);
        let width = 12.0 + (j % 7) as f64 + 0.3 * ((j / 7) as f64).powi(2);
        (-(dx * dx + dy * dy + 0.2 * (j % 7) as f64 * dx * dy / 6.0) / width).exp()
    });
    let place = |i: usize, pixels: usize| (i * (pixels - 1) / 6) as i64;
    let at = (0..49).map(|j| Position::of_pixel(place(j % 7, frame.nx()), place(j / 7, frame.ny())));
    let positions = SamplePositions::new(at.collect(), Some(frame)).unwrap();
    let grid = StampGrid::new(32, 32).unwrap().with_oversampling(2.0).unwrap();
    let samples = PsfSamples::new(stamps, positions, grid).unwrap();
    let method = psfield::psf_basis::Svd::new();
    let fitted = fit_with(
        samples.clone(),
        &method,
        &Curved,
        OutsidePolicy::Nearest,
        Normalisation::Unit,
    );
    (Psf::from(fitted.unwrap().0), samples)
}

/// A field that is not linear in the samples' coefficients can be saved and read again, and resampled to a
/// finer scene and other stamp sizes. The error is that of its table.
#[test]
fn a_nonlinear_field_is_saved_and_resampled() {
    let frame = FrameShape::new(800, 600).unwrap();
    let (psf, _) = curved_psf(frame);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.fits");
    psf.write(&path, &PsfFormat::Model, &[], false).unwrap();
    let again = Psf::open(&path).unwrap();
    for (x, y) in [(0.0, 0.0), (799.0, 599.0), (123.4, 456.7), (400.2, 3.9)] {
        let at = Position::new(x, y).unwrap();
        let (a, b) = (psf.model().unwrap().psf_at(at), again.model().unwrap().psf_at(at));
        let (a, b) = (a.unwrap().into_values(), b.unwrap().into_values());
        let norm = |v: &Array2<f64>| v.iter().map(|v| v * v).sum::<f64>().sqrt();
        assert!(norm(&(&a - &b)) <= 1e-5 * norm(&a), "{at}");
    }
    // A finer scene, and stamps of another size.
    let light = test_scene(1600, 1200, 3);
    let scene = Scene::from(&light);
    let options = psfield::SimulateOptions {
        oversample: 2,
        stamp_size: Some(13),
        tolerance: 1e-5,
        ..psfield::SimulateOptions::default()
    };
    let simulator = psf
        .simulator((1200, 1600))
        .options(options)
        .build::<f64>()
        .unwrap();
    let image = simulator.simulate(&scene).unwrap();
    let check = simulator
        .spot_check(&scene, &image, (200, 1), &NoProgress)
        .unwrap();
    assert!(check.max_over_peak.unwrap() < 1e-4, "{check:?}");
}

/// The engine needs as many cells and modes for a field of one's own as for kriging of the same samples.
#[test]
fn a_nonlinear_field_has_a_plan_like_kriging() {
    let frame = FrameShape::new(800, 600).unwrap();
    let (psf, samples) = curved_psf(frame);
    let kriging = psfield::FitOptions {
        interpolation: "kriging".parse().unwrap(),
        ..psfield::FitOptions::default()
    };
    let modes = |psf: &Psf| {
        let psf = psf.native(None).unwrap();
        let simulator = psf.simulator((600, 800)).tolerance(1e-3).build::<f32>().unwrap();
        let light = test_scene(800, 600, 1);
        let scene = Scene::new(light.pixels().mapv(|v| v as f32)).unwrap();
        let prepared = simulator.prepare(&scene, &NoProgress).unwrap();
        let summary = prepared.plan.unwrap();
        let modes = summary
            .blocks_by_modes
            .iter()
            .enumerate()
            .map(|(modes, blocks)| modes * blocks);
        modes.sum::<usize>() as f64 / summary.blocks as f64
    };
    let (own, built_in) = (modes(&psf), modes(&Psf::new(samples, kriging)));
    assert!(own <= built_in + 1.0, "{own} modes per block, kriging {built_in}");
}
