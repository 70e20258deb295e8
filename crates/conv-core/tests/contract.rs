//! Tests that compare every method with the double sum, over shapes, centres, frames, anchorings
//! and precisions.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::sync::Arc;

use common::{
    Constant, Execute, Scene, Waves, double_sum, largest_difference, model_with, noise, peak, region, scene,
    single,
};
use conv_core::{
    BasisConvolution, ConvError, ConvolutionMethod, Direct, LowRank, PatchConvolution, Paths, PlanOptions,
    StarPainter,
};
use ndarray::{Array2, Array3};
use psf_types::{
    Anchor, Image, NoProgress, Normalisation, PixelRegion, PointSource, Position, PsfBasis, PsfModel,
    StampGrid,
};

/// Rounding of a few hundred additions of values near 1 in f64.
const DIRECT: f64 = 1e-13;
/// Rounding of transforms of a few thousand values in f64.
const FFT_F64: f64 = 1e-13;
/// Rounding of transforms of a few thousand values in f32.
const FFT_F32: f64 = 3e-6;

const ANCHORS: [Anchor; 2] = [Anchor::Source, Anchor::Output];

/// Stamps: even, odd, off-centre, one pixel wide, wider than the scene. Scenes: square, not square,
/// prime, one pixel.
const STAMPS: [((usize, usize), (usize, usize)); 5] = [
    ((6, 4), (3, 2)),
    ((5, 7), (2, 3)),
    ((4, 4), (0, 3)),
    ((1, 3), (0, 0)),
    ((16, 9), (8, 4)),
];
const SCENES: [(usize, usize); 4] = [(12, 12), (13, 7), (1, 1), (17, 3)];

fn cases() -> impl Iterator<Item = (PsfModel, Scene<f64>)> {
    STAMPS.into_iter().enumerate().flat_map(|(n, (shape, centre))| {
        // With and without a mean, with and without scaling to unit flux.
        let (mean, normalisation) = [
            (true, Normalisation::Unit),
            (true, Normalisation::Keep),
            (false, Normalisation::Keep),
        ][n % 3];
        SCENES.into_iter().map(move |(nx, ny)| {
            (
                model_with(Arc::new(Waves), shape, centre, mean, normalisation),
                scene(nx, ny, (nx * ny + n) as u64),
            )
        })
    })
}

/// A field with one constant coefficient.
#[derive(Debug)]
struct Single(f64);
impl psf_types::CoefficientField for Single {
    fn component_count(&self) -> usize {
        1
    }
    fn evaluate_into(&self, _: Position, a: &mut [f64]) -> Result<(), psf_types::FieldError> {
        a[0] = self.0;
        Ok(())
    }
}

#[test]
fn a_gaussian_of_a_gaussian_is_the_wider_gaussian() {
    // Test of the reference itself: widths add in quadrature.
    let gauss = |r2: f64, s2: f64| (-r2 / (2.0 * s2)).exp() / (std::f64::consts::TAU * s2);
    let (n, s2_scene, s2_psf) = (41, 4.0, 6.0);
    let image = |s2: f64| {
        Array2::from_shape_fn((n, n), |(y, x)| {
            gauss((y as f64 - 20.0).powi(2) + (x as f64 - 20.0).powi(2), s2)
        })
    };
    let stamp = image(s2_psf);
    let norm = stamp.iter().map(|v| v * v).sum::<f64>().sqrt();
    let mut components = Array3::zeros((1, n, n));
    components
        .index_axis_mut(ndarray::Axis(0), 0)
        .assign(&(&stamp / norm));
    let basis = PsfBasis::new(
        Some(&stamp - &(&stamp * 0.5)),
        components,
        StampGrid::new(n, n).unwrap(),
    )
    .unwrap();
    let model = PsfModel::new(&basis, Arc::new(Single(0.5 * norm)), Normalisation::Keep, None).unwrap();
    let scene = Scene::new(image(s2_scene));
    let sum = double_sum(&model, &scene, Anchor::Source);
    let expected = image(s2_scene + s2_psf);
    let middle = ndarray::s![12..29, 12..29];
    let difference = largest_difference(&sum.slice(middle).to_owned(), &expected.slice(middle).to_owned());
    assert!(difference < 1e-8 && difference > 0.0, "{difference}");
}

#[test]
fn direct_and_basis_are_the_double_sum() {
    for (model, scene) in cases() {
        for anchor in ANCHORS {
            let truth = double_sum(&model, &scene, anchor);
            let limit = |relative: f64| relative * peak(&truth).max(1.0);
            let case = format!("{:?} {:?} {anchor}", model.grid(), scene.shape());

            let direct = scene.through(&model, &Direct::new(anchor)).unwrap().into_pixels();
            assert!(
                largest_difference(&direct, &truth) <= limit(DIRECT),
                "direct, {case}"
            );

            let pixels: Vec<_> = truth.indexed_iter().map(|((y, x), _)| (x, y)).collect();
            let values = scene.at_pixels(&model, anchor, &pixels).unwrap();
            let values = Array2::from_shape_vec(truth.dim(), values).unwrap();
            assert!(
                largest_difference(&values, &truth) <= limit(DIRECT),
                "single pixels, {case}"
            );

            let basis = scene
                .through(&model, &BasisConvolution::new(anchor))
                .unwrap()
                .into_pixels();
            assert!(
                largest_difference(&basis, &truth) <= limit(FFT_F64),
                "basis f64, {case}"
            );

            let basis = single(&scene)
                .through(&model, &BasisConvolution::new(anchor))
                .unwrap();
            assert!(
                largest_difference(&basis.pixels().mapv(f64::from), &truth) <= limit(FFT_F32),
                "basis f32, {case}"
            );
        }
    }
}

#[test]
fn the_comparison_can_fail() {
    let (model, scene) = cases().next().unwrap();
    let source = double_sum(&model, &scene, Anchor::Source);
    let output = scene
        .through(&model, &BasisConvolution::new(Anchor::Output))
        .unwrap()
        .into_pixels();
    assert!(largest_difference(&source, &output) > 1e-3 * peak(&source));
}

#[test]
fn patches_of_one_pixel_are_exact_and_so_are_any_of_a_constant_psf() {
    let varying = model_with(Arc::new(Waves), (6, 4), (3, 2), true, Normalisation::Unit);
    let constant = model_with(Arc::new(Constant), (5, 7), (2, 3), true, Normalisation::Keep);
    let scene = scene(13, 11, 5).with_frame(region(2, 1, 9, 8));
    for anchor in ANCHORS {
        let check = |model: &PsfModel, size| {
            let truth = double_sum(model, &scene, anchor);
            let patch = scene
                .through(model, &PatchConvolution::new(size, anchor).unwrap())
                .unwrap()
                .into_pixels();
            largest_difference(&patch, &truth) / peak(&truth)
        };
        assert!(check(&varying, 1) <= FFT_F64, "{anchor}");
        for size in [2, 3, 5, 8, 13, 100] {
            assert!(check(&constant, size) <= FFT_F64, "{anchor}, patches of {size}");
        }
        assert!(check(&varying, 8) > 1e-3, "a varying PSF shows at patch borders");
    }
    assert!(matches!(
        PatchConvolution::new(0, Anchor::Source),
        Err(ConvError::PatchSize)
    ));
}

#[test]
fn light_from_beyond_the_frame_contributes() {
    let model = model_with(Arc::new(Waves), (6, 4), (3, 2), true, Normalisation::Unit);
    let scene = scene(14, 12, 3).with_frame(region(4, 3, 7, 6));
    for anchor in ANCHORS {
        let truth = double_sum(&model, &scene, anchor);
        for method in [
            &BasisConvolution::new(anchor) as &dyn ConvolutionMethod<f64>,
            &Direct::new(anchor),
        ] {
            let image = scene.through(&model, method).unwrap().into_pixels();
            assert_eq!(image.dim(), (6, 7));
            assert!(
                largest_difference(&image, &truth) <= FFT_F64 * peak(&truth),
                "{method:?}"
            );
        }
    }
}

#[test]
fn the_adjoint_is_exact() {
    for (model, scene) in cases() {
        let (nx, ny) = (scene.shape().nx(), scene.shape().ny());
        let frames = [
            scene.frame,
            region((nx / 3) as i64, (ny / 3) as i64, nx - nx / 3, ny.div_ceil(2)),
        ];
        for (scene, anchor) in frames
            .into_iter()
            .flat_map(|frame| ANCHORS.map(|anchor| (scene.clone().with_frame(frame), anchor)))
        {
            let shape = scene.frame.shape();
            let g = Image::new(noise(shape.ny(), shape.nx(), 77)).unwrap();
            let method = BasisConvolution::new(anchor);
            let forward = scene.through(&model, &method).unwrap();
            let back = method
                .adjoint(&model, &g.view(), scene.shape(), scene.frame)
                .unwrap();
            let left = (&forward.pixels() * &g.pixels()).sum();
            let right = (&scene.pixels() * &back.pixels()).sum();
            let scale = (forward.pixels().mapv(|v| v * v).sum() * g.pixels().mapv(|v| v * v).sum()).sqrt();
            assert!(
                (left - right).abs() <= 1e-12 * scale,
                "{left} {right} {anchor} {:?}",
                model.grid()
            );
        }
    }
    let (model, scene) = cases().next().unwrap();
    let wrong = Image::new(noise(3, 3, 1)).unwrap();
    let refused = BasisConvolution::default().adjoint(&model, &wrong.view(), scene.shape(), scene.frame);
    assert!(matches!(refused, Err(ConvError::FrameShape { .. })));
}

#[test]
fn point_sources_on_pixels_are_pixels_of_light() {
    let model = model_with(Arc::new(Waves), (6, 4), (3, 2), true, Normalisation::Unit);
    let stars = [(0, 0, 5.0), (7, 3, -2.0), (11, 9, 1.0), (1, 8, 40.0)];
    let mut light = Array2::zeros((10, 12));
    for (x, y, flux) in stars {
        light[[y, x]] += flux;
    }
    let frame = region(1, 1, 10, 8);
    let pixels = Scene::new(light).with_frame(frame);
    let points = stars
        .map(|(x, y, flux)| PointSource::new(Position::of_pixel(x as i64, y as i64), flux).unwrap())
        .to_vec();
    for anchor in ANCHORS {
        let truth = double_sum(&model, &pixels, anchor);
        let image = painted(&model, &points, frame, anchor);
        assert!(
            largest_difference(&image, &truth) <= DIRECT * peak(&truth),
            "{anchor}"
        );
        let all: Vec<_> = truth.indexed_iter().map(|((y, x), _)| (x, y)).collect();
        let painter = StarPainter::new(&model, frame, anchor, None).unwrap();
        let values = painter.at_pixels(&points, &all).unwrap();
        let values = Array2::from_shape_vec(truth.dim(), values).unwrap();
        assert!(largest_difference(&values, &truth) <= DIRECT * peak(&truth));
    }
}

/// Draws stars one by one into a new image of the frame.
fn painted(model: &PsfModel, stars: &[PointSource], frame: PixelRegion, anchor: Anchor) -> Array2<f64> {
    let mut image = Array2::zeros((frame.shape().ny(), frame.shape().nx()));
    StarPainter::new(model, frame, anchor, None)
        .unwrap()
        .draw_into(stars, frame.shape().region(), image.view_mut(), &NoProgress)
        .unwrap();
    image
}

#[test]
fn sources_near_the_frame_contribute_light_and_far_ones_do_not() {
    let model = model_with(Arc::new(Constant), (7, 7), (3, 3), true, Normalisation::Keep);
    let at = |x: f64, y: f64| {
        let star = PointSource::new(Position::new(x, y).unwrap(), 1.0).unwrap();
        painted(&model, &[star], region(0, 0, 10, 10), Anchor::Source)
    };
    assert!(peak(&at(-2.0, 5.0)) > 0.0);
    for (x, y) in [(-30.0, 5.0), (5.0, 1e6), (1e300, -1e300), (-1e300, 0.0)] {
        assert_eq!(peak(&at(x, y)), 0.0, "{x}, {y}");
    }
}

#[test]
fn a_mean_centred_model_of_unit_flux_keeps_the_flux() {
    // The components have no flux and the mean has unit flux, so the flux does not depend on the
    // coefficients.
    let model = model_with(Arc::new(Waves), (6, 5), (3, 2), true, Normalisation::Keep);
    let mut components = model.stamps().slice_move(ndarray::s![1.., .., ..]).to_owned();
    for mut component in components.outer_iter_mut() {
        let mean = component.sum() / 30.0;
        component.mapv_inplace(|v| v - mean);
    }
    let mut flat = components.into_shape_with_order((3, 30)).unwrap();
    for k in 0..3 {
        for j in 0..k {
            let overlap = flat.row(k).dot(&flat.row(j));
            let other = flat.row(j).to_owned();
            flat.row_mut(k).scaled_add(-overlap, &other);
        }
        let norm = flat.row(k).dot(&flat.row(k)).sqrt();
        flat.row_mut(k).mapv_inplace(|v| v / norm);
    }
    let components = flat.into_shape_with_order((3, 5, 6)).unwrap();
    let mean = model.stamp(0).mapv(|v| v / model.stamp(0).sum());
    let basis = PsfBasis::new(Some(mean), components, StampGrid::new(6, 5).unwrap()).unwrap();
    let model = PsfModel::new(&basis, Arc::new(Waves), Normalisation::Unit, None).unwrap();
    let mut light = Array2::zeros((30, 40));
    light
        .slice_mut(ndarray::s![5..25, 6..34])
        .assign(&noise(20, 28, 4).mapv(|v| v + 1.2));
    let scene = Scene::new(light.clone());
    let image = scene.through(&model, &BasisConvolution::default()).unwrap();
    assert!((image.pixels().sum() / light.sum() - 1.0).abs() < 1e-12);
}

#[test]
fn stamps_that_do_not_suit_an_image_are_refused() {
    let (_, scene) = cases().next().unwrap();
    let with_grid = |grid: StampGrid| {
        let mut components = Array3::zeros((3, 4, 4));
        for k in 0..3 {
            components[[k, k, 1]] = 1.0;
        }
        PsfModel::new(
            &PsfBasis::new(None, components, grid).unwrap(),
            Arc::new(Waves),
            Normalisation::Keep,
            None,
        )
        .unwrap()
    };
    let grid = StampGrid::new(4, 4).unwrap();
    let refused = |grid| scene.through(&with_grid(grid), &Direct::default()).unwrap_err();
    assert!(matches!(
        refused(grid.with_oversampling(2.0).unwrap()),
        ConvError::StampScale { .. }
    ));
    assert!(matches!(
        refused(grid.with_centre(1.5, 1.5).unwrap()),
        ConvError::StampCentre { .. }
    ));
    assert!(matches!(
        refused(grid.with_pixel_response_included(false)),
        ConvError::PixelResponse
    ));
    let outside = scene.at_pixels(&with_grid(grid), Anchor::Source, &[(0, 0), (99, 0)]);
    assert!(matches!(
        outside,
        Err(ConvError::PixelOutsideFrame {
            column: 99,
            row: 0,
            ..
        })
    ));
}

#[test]
fn the_number_of_threads_does_not_matter() {
    // Large enough for the transforms to run in parallel.
    let model = model_with(Arc::new(Waves), (16, 12), (8, 6), true, Normalisation::Unit);
    let star = PointSource::new(Position::new(100.3, 77.8).unwrap(), 3.0).unwrap();
    let stars = vec![star; 100];
    let scene = scene(520, 530, 9);
    let small = Scene::new(noise(60, 50, 2));
    for anchor in ANCHORS {
        let with_threads = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| {
                let basis = BasisConvolution::new(anchor);
                let patches = PatchConvolution::new(50, anchor).unwrap();
                let image = scene.through(&model, &basis).unwrap();
                (
                    basis
                        .adjoint(&model, &image.view(), scene.shape(), scene.frame)
                        .unwrap(),
                    image,
                    scene.through(&model, &patches).unwrap(),
                    small.through(&model, &Direct::new(anchor)).unwrap(),
                    painted(&model, &stars, scene.frame, anchor),
                )
            })
        };
        let one = with_threads(1);
        for threads in [2, 5] {
            assert!(with_threads(threads) == one, "{threads} threads, {anchor}");
        }
        // The parallel transforms are also correct.
        let pixels: Vec<_> = (0..50).map(|n| ((n * 97) % 520, (n * 41) % 530)).collect();
        let exact = scene.at_pixels(&model, anchor, &pixels).unwrap();
        for (&(x, y), value) in pixels.iter().zip(exact) {
            assert!((one.1.pixels()[[y, x]] - value).abs() < 1e-12, "{anchor}");
        }
    }
}

/// A field with values on only a few pixels.
#[derive(Debug)]
struct Island;

impl psf_types::CoefficientField for Island {
    fn component_count(&self) -> usize {
        3
    }
    fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), psf_types::FieldError> {
        if (8.0..12.0).contains(&p.x()) && (5.0..9.0).contains(&p.y()) {
            Waves.evaluate_into(p, a)
        } else {
            Err(psf_types::FieldError::OutsideSamples { position: p })
        }
    }
}

/// Dark pixels need no PSF, and neither does light that falls on no pixel of the frame.
#[test]
fn only_light_that_reaches_the_frame_needs_a_psf() {
    let model = |field: Arc<dyn psf_types::CoefficientField>| {
        model_with(field, (6, 4), (3, 2), true, Normalisation::Unit)
    };
    let mut light = Array2::zeros((30, 300));
    light[[8, 10]] = 3.0;
    light[[9, 11]] = 2.0;
    light[[9, 290]] = 7.0;
    let scene = Scene::new(light).with_frame(region(1, 2, 40, 20));
    let truth = double_sum(&model(Arc::new(Waves)), &scene, Anchor::Source);
    let island = model(Arc::new(Island));
    let exact = LowRank::new(PlanOptions::new(0.0).unwrap());
    let methods: [&dyn ConvolutionMethod<f64>; 4] = [
        &BasisConvolution::default(),
        &Direct::default(),
        &PatchConvolution::new(1, Anchor::Source).unwrap(),
        &exact,
    ];
    for method in methods {
        let image = scene.through(&island, method).unwrap().into_pixels();
        assert!(
            largest_difference(&image, &truth) <= FFT_F64 * peak(&truth),
            "{method:?}"
        );
    }
    let lit_outside = scene.with_frame(region(200, 2, 100, 20));
    for method in [
        &BasisConvolution::default() as &dyn ConvolutionMethod<f64>,
        &exact,
    ] {
        let refused = lit_outside.through(&island, method);
        assert!(
            matches!(
                refused,
                Err(ConvError::Field(psf_types::FieldError::OutsideSamples { .. }))
            ),
            "{method:?}"
        );
    }
}

/// Light near both ends of the range of f32. Without scaling, sums of bright light would overflow,
/// and products of faint light with kernels would lose bits.
#[test]
fn light_at_the_ends_of_the_range_is_convolved_like_light_near_one() {
    let model = model_with(Arc::new(Waves), (16, 9), (8, 4), true, Normalisation::Unit);
    let scene = scene(67, 53, 5);
    let scaled = |power: i32| {
        let light = scene.pixels().mapv(|v| (v * 2_f64.powi(power)) as f32);
        Scene::new(light)
    };
    for anchor in ANCHORS {
        let truth = double_sum(&model, &scene, anchor);
        let options = PlanOptions::new(0.0).unwrap().with_anchor(anchor);
        let methods: [Box<dyn ConvolutionMethod<f32>>; 4] = [
            Box::new(BasisConvolution::new(anchor)),
            Box::new(PatchConvolution::new(1, anchor).unwrap()),
            Box::new(LowRank::new(options)),
            Box::new(LowRank::new(options.with_paths(Paths::Transforms))),
        ];
        // The brightest pixel is about 1, and 2^127 is the largest power in f32.
        for power in [-115, -85, 0, 85, 123] {
            for method in &methods {
                let image = scaled(power).through(&model, &**method).unwrap();
                let back = image.pixels().mapv(|v| f64::from(v) * 2_f64.powi(-power));
                assert!(
                    largest_difference(&back, &truth) <= FFT_F32 * peak(&truth),
                    "{method:?}, 2^{power}: {:e}",
                    largest_difference(&back, &truth)
                );
            }
            let adjoint = |scene: &Scene<f32>| {
                let image = &scene.light;
                let whole = BasisConvolution::new(anchor)
                    .adjoint(&model, &image.view(), scene.shape(), scene.frame)
                    .unwrap();
                let tiles = scene.engine(&model, options).adjoint(image).unwrap();
                [whole, tiles].map(|image| image.pixels().mapv(f64::from))
            };
            for (near_one, far) in adjoint(&scaled(0)).iter().zip(adjoint(&scaled(power))) {
                let back = far.mapv(|v| v * 2_f64.powi(-power));
                assert!(
                    largest_difference(&back, near_one) <= FFT_F32 * peak(near_one),
                    "the adjoint, 2^{power}"
                );
            }
        }
    }
}
