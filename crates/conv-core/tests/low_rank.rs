//! Tests of the fast engine: it is compared with the double sum, its tolerance is checked pixel by
//! pixel, its adjoint is its transpose, and some conditions must not change its result.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::sync::Arc;

use common::grid_field::GridField;
use common::{
    ANCHORS, Constant, Execute, KINDS, PATHS, PixelByPixel, STAMPS, Scene, Waves, double_sum,
    largest_difference, model_with, noise, options, peak, region, scene, single,
};
use conv_core::{ConvError, Direct, LowRank, Paths, Plan, PlanOptions, RowStream};
use ndarray::{Array2, Axis, s};
use psf_types::{
    Anchor, CoefficientField, FieldError, Image, NoProgress, Normalisation, Position, PsfBasis, PsfModel,
    StampGrid, ToleranceOn,
};

/// Rounding of transforms of a few thousand values, and of the modes, in f64.
const ROUNDING_F64: f64 = 1e-12;
/// Rounding of transforms of a few thousand values in f32.
const ROUNDING_F32: f64 = 3e-6;

const SCENES: [(usize, usize); 6] = [(12, 12), (13, 7), (1, 1), (1, 37), (101, 1), (67, 53)];

fn cases() -> impl Iterator<Item = (PsfModel, Scene<f64>)> {
    STAMPS.into_iter().enumerate().flat_map(|(n, (shape, centre))| {
        SCENES.into_iter().enumerate().map(move |(m, (nx, ny))| {
            let (mean, normalisation) = KINDS[(n + m) % 3];
            let model = model_with(Arc::new(Waves), shape, centre, mean, normalisation);
            let scene = scene(nx, ny, (nx * ny + n) as u64);
            // Every second scene has a smaller frame.
            let frame = region((nx / 3) as i64, (ny / 4) as i64, nx - nx / 3, ny.div_ceil(2));
            let scene = if (n + m) % 2 == 0 {
                scene.with_frame(frame)
            } else {
                scene
            };
            (model, scene)
        })
    })
}

/// Only every fifth pixel is lit, so that every method for tiles is used.
fn sparse(scene: &Scene<f64>) -> Scene<f64> {
    let mut light = scene.pixels().to_owned();
    for ((y, x), value) in light.indexed_iter_mut() {
        if (3 * y + x) % 5 != 0 {
            *value = 0.0;
        }
    }
    Scene::new(light).with_frame(scene.frame)
}

#[test]
fn at_tolerance_0_it_is_the_double_sum() {
    for (model, scene) in cases() {
        for scene in [sparse(&scene), scene] {
            for anchor in ANCHORS {
                let truth = double_sum(&model, &scene, anchor);
                let scale = peak(&truth).max(1.0);
                for paths in PATHS {
                    let case = format!("{:?} {:?} {anchor} {paths:?}", model.grid(), scene.shape());
                    let engine = LowRank::new(options(0.0, anchor, paths));
                    let image = scene.through(&model, &engine).unwrap().into_pixels();
                    let error = largest_difference(&image, &truth) / scale;
                    assert!(error <= ROUNDING_F64, "f64, {case}: {error:e}");
                    let image = single(&scene).through(&model, &engine).unwrap();
                    let error = largest_difference(&image.pixels().mapv(f64::from), &truth) / scale;
                    assert!(error <= ROUNDING_F32, "f32, {case}: {error:e}");
                }
            }
        }
    }
}

/// Rounding of f64 on images of PSFs that are not scaled and have nearly equal fluxes.
const STATED_F64: f64 = 1e-14;

/// PSFs whose fluxes differ from 1 by up to 8e-13 are not treated as PSFs of unit flux.
#[test]
fn small_differences_of_fluxes_are_kept() {
    const FLUXES: f64 = 8e-13;
    #[derive(Debug)]
    struct Ramp;
    impl CoefficientField for Ramp {
        fn component_count(&self) -> usize {
            1
        }
        fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
            a[0] = (p.x() - 20.0) / 20.0;
            Ok(())
        }
    }
    let bell = |y: usize, x: usize| (-((y as f64 - 3.0).powi(2) + (x as f64 - 3.0).powi(2)) / 4.0).exp();
    let mean = Array2::from_shape_fn((7, 7), |(y, x)| bell(y, x));
    let mean = &mean / mean.sum();
    // All but a small part of the component is antisymmetric and holds no flux.
    let odd = Array2::from_shape_fn((7, 7), |(y, x)| (x as f64 - 3.0) * bell(y, x));
    let component = &odd / odd.mapv(|v| v * v).sum().sqrt() + &(&mean * FLUXES);
    let grid = StampGrid::new(7, 7).unwrap();
    let basis = PsfBasis::new(Some(mean), component.insert_axis(Axis(0)), grid).unwrap();
    let model = PsfModel::new(&basis, Arc::new(Ramp), Normalisation::Keep, None).unwrap();
    for x in [3, 37] {
        // Light that lies where the fluxes differ from 1 the most.
        let mut light = Array2::zeros((24, 41));
        light.slice_mut(s![.., x - 3..x + 4]).fill(1.0);
        let scene = Scene::new(light);
        for anchor in ANCHORS {
            let truth = double_sum(&model, &scene, anchor);
            for paths in PATHS {
                let engine = LowRank::new(options(0.0, anchor, paths));
                let image = scene.through(&model, &engine).unwrap().into_pixels();
                let error = (image.sum() / truth.sum() - 1.0).abs();
                assert!(error < STATED_F64, "{anchor} {paths:?}: {error:e}");
            }
        }
    }
}

#[test]
fn the_adjoint_is_exact() {
    for (model, scene) in cases() {
        for anchor in ANCHORS {
            for (paths, tolerance) in PATHS.into_iter().flat_map(|paths| [(paths, 0.0), (paths, 1e-2)]) {
                let engine = scene.engine(&model, options(tolerance, anchor, paths));
                let shape = scene.frame.shape();
                let g = Image::new(noise(shape.ny(), shape.nx(), 77)).unwrap();
                let forward = engine.image_of(&scene).unwrap();
                let back = engine.adjoint(&g).unwrap();
                let left = (&forward.pixels() * &g.pixels()).sum();
                let right = (&scene.pixels() * &back.pixels()).sum();
                let scale =
                    (forward.pixels().mapv(|v| v * v).sum() * g.pixels().mapv(|v| v * v).sum()).sqrt();
                assert!(
                    (left - right).abs() <= ROUNDING_F64 * scale,
                    "{left} {right} {anchor} {paths:?} {:?} {:?}",
                    model.grid(),
                    scene.shape()
                );
            }
        }
    }
}

/// A field whose PSF jumps: tiles across the jump need the modes of both sides.
#[derive(Debug)]
struct Step;

impl CoefficientField for Step {
    fn component_count(&self) -> usize {
        3
    }
    fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
        Waves.evaluate_into(p, a)?;
        if p.x() + 0.3 * p.y() > 50.0 {
            a[1] -= 0.8;
            a[2] += 0.3;
        }
        Ok(())
    }
}

/// Adds one unit of light at a pixel of a scene with light everywhere. Compares the change of the
/// image with the exact PSF of that pixel.
#[test]
fn every_pixel_sees_a_psf_within_the_tolerance() {
    let (nx, ny) = (120, 90);
    let mut coarsest: f64 = 0.0;
    for (field, mean, normalisation) in [
        (
            Arc::new(Waves) as Arc<dyn CoefficientField>,
            true,
            Normalisation::Unit,
        ),
        (Arc::new(Step), true, Normalisation::Keep),
        (Arc::new(Step), false, Normalisation::Keep),
    ] {
        let model = model_with(field, (9, 8), (4, 4), mean, normalisation);
        let light = noise(ny, nx, 5).mapv(|v| v + 1.5);
        let lit = |light: &Array2<f64>| Scene::new(light.clone());
        for (tolerance, paths) in [
            (3e-1, PATHS[1]),
            (1e-1, PATHS[0]),
            (1e-2, PATHS[1]),
            (1e-3, PATHS[1]),
        ] {
            for anchor in ANCHORS {
                let engine = lit(&light).engine(&model, options(tolerance, anchor, paths));
                let before = engine.image_of(&lit(&light)).unwrap().into_pixels();
                for n in 0..40 {
                    let (x, y) = ((n * 37 + 11) % nx, (n * 53 + 7) % ny);
                    // If output-anchored, the kernel of one output pixel is a row of the operator,
                    // which is a column of its transpose.
                    let response = if anchor == Anchor::Source {
                        let mut more = light.clone();
                        more[[y, x]] += 1.0;
                        engine.image_of(&lit(&more)).unwrap().into_pixels() - &before
                    } else {
                        let mut one = Array2::zeros((ny, nx));
                        one[[y, x]] = 1.0;
                        engine.adjoint(&Image::new(one).unwrap()).unwrap().into_pixels()
                    };
                    let psf = model.psf_at(Position::of_pixel(x as i64, y as i64)).unwrap();
                    let mut exact = Array2::zeros((ny, nx));
                    for ((j, i), &h) in psf.values().indexed_iter() {
                        let sign = if anchor == Anchor::Source { 1 } else { -1 };
                        let row = y as i64 + sign * (j as i64 - 4);
                        let column = x as i64 + sign * (i as i64 - 4);
                        if (0..ny as i64).contains(&row) && (0..nx as i64).contains(&column) {
                            exact[[row as usize, column as usize]] = h;
                        }
                    }
                    let norm = |a: &Array2<f64>| a.mapv(|v| v * v).sum().sqrt();
                    // The tolerance is relative to the whole PSF. The response is truncated at the
                    // image's edge.
                    let whole = psf.values().mapv(|v| v * v).sum().sqrt();
                    let error = norm(&(&response - &exact)) / whole;
                    assert!(
                        error <= tolerance + ROUNDING_F64,
                        "{error:e} > {tolerance:e} at {x}, {y}"
                    );
                    coarsest = coarsest.max(error);
                }
            }
        }
    }
    // Some errors must be large: without truncation, the test would prove nothing.
    assert!(coarsest > 1e-2, "{coarsest:e}");
}

#[test]
fn the_result_does_not_depend_on_threads_nor_on_kept_data() {
    let model = model_with(Arc::new(Waves), (16, 12), (8, 6), true, Normalisation::Unit);
    let scene = scene(420, 330, 9);
    for anchor in ANCHORS {
        let with = |threads: usize, memory: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| {
                let options = options(1e-3, anchor, Paths::Cheapest).with_memory(memory);
                let engine = scene.engine(&model, options);
                assert!(engine.plan().summary().blocks > 1);
                let image = engine.image_of(&scene).unwrap();
                let again = engine.image_of(&scene).unwrap();
                assert_eq!(image, again, "the second time, workspaces are dirty");
                (engine.adjoint(&image).unwrap(), image)
            })
        };
        let one = with(1, usize::MAX);
        assert!(
            with(2, usize::MAX) == one && with(5, usize::MAX) == one,
            "{anchor}"
        );
        let made_anew = with(3, 0);
        let difference = largest_difference(&made_anew.1.pixels().to_owned(), &one.1.pixels().to_owned());
        assert!(
            difference <= ROUNDING_F64 * peak(&one.1.pixels().to_owned()),
            "{difference:e}"
        );
    }
}

#[test]
fn flux_is_kept_at_any_tolerance() {
    let mut light = Array2::zeros((160, 200));
    light
        .slice_mut(s![40..120, 40..160])
        .assign(&noise(80, 120, 4).mapv(|v| v + 1.2));
    let scene = Scene::new(light.clone());
    for (field, mean, normalisation) in [
        (
            Arc::new(Waves) as Arc<dyn CoefficientField>,
            true,
            Normalisation::Unit,
        ),
        // Cells change fluxes of their own a little.
        (Arc::new(PixelByPixel(Waves)), true, Normalisation::Keep),
        (Arc::new(Step), true, Normalisation::Unit),
        (Arc::new(PixelByPixel(Step)), false, Normalisation::Keep),
    ] {
        let model = model_with(field, (16, 12), (8, 6), mean, normalisation);
        let exact: f64 = light
            .indexed_iter()
            .map(|((y, x), f)| {
                f * model
                    .psf_at(Position::of_pixel(x as i64, y as i64))
                    .unwrap()
                    .values()
                    .sum()
            })
            .sum();
        for tolerance in [0.0, 1e-3, 1e-2, 0.1, 0.5] {
            for paths in PATHS {
                let engine = LowRank::new(options(tolerance, Anchor::Source, paths));
                let flux = scene.through(&model, &engine).unwrap().pixels().sum();
                assert!(
                    (flux / exact - 1.0).abs() < 1e-12,
                    "{flux} {exact} at {tolerance:e}"
                );
                let image = single(&scene).through(&model, &engine).unwrap();
                let flux: f64 = image.pixels().iter().map(|&v| f64::from(v)).sum();
                assert!(
                    (flux / exact - 1.0).abs() < 1e-6,
                    "f32: {flux} {exact} at {tolerance:e}"
                );
            }
        }
    }
}

/// Components without flux and no mean: a kernel that computes differences.
#[test]
fn kernels_without_flux_are_kernels_too() {
    let model = model_with(Arc::new(Waves), (6, 4), (3, 2), false, Normalisation::Keep);
    let mut components = model.stamps().to_owned();
    for mut component in components.outer_iter_mut() {
        component.fill(0.0);
    }
    for k in 0..3 {
        components[[k, k, 1]] = 0.5_f64.sqrt();
        components[[k, k, 3]] = -(0.5_f64.sqrt());
    }
    let basis = psf_types::PsfBasis::new(None, components, model.grid()).unwrap();
    let model = PsfModel::new(&basis, Arc::new(Waves), Normalisation::Keep, None).unwrap();
    let scene = scene(67, 53, 8);
    for anchor in ANCHORS {
        let truth = double_sum(&model, &scene, anchor);
        let image = scene
            .through(&model, &LowRank::new(options(0.0, anchor, Paths::Transforms)))
            .unwrap()
            .into_pixels();
        assert!(largest_difference(&image, &truth) <= ROUNDING_F64 * peak(&truth));
    }
}

/// More components than a tile has modes, and fluxes that nearly cancel: the one mode that carries
/// flux must be kept.
#[test]
fn kernels_whose_flux_nearly_cancels_are_exact_and_keep_it() {
    /// Twelve smooth fields that few modes represent in a tile.
    #[derive(Debug)]
    struct Smooth;
    impl CoefficientField for Smooth {
        fn component_count(&self) -> usize {
            12
        }
        fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
            for (k, a) in a.iter_mut().enumerate() {
                let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
                *a = sign
                    * (1.0 + 1e-3 * (k as f64 + 1.0) * (p.x() / 90.0).sin() + 2e-3 * (p.y() / 70.0).cos());
            }
            Ok(())
        }
    }
    // Components of a single pixel each, in pairs of opposite coefficients.
    let mut components = ndarray::Array3::zeros((12, 5, 6));
    for k in 0..12 {
        components[[k, k / 4 + 1, k % 4 + 1]] = 1.0;
    }
    let grid = psf_types::StampGrid::new(6, 5).unwrap();
    let basis = psf_types::PsfBasis::new(None, components, grid).unwrap();
    let field = Arc::new(PixelByPixel(Smooth));
    let model = PsfModel::new(&basis, field, Normalisation::Keep, None).unwrap();
    let mut light = Array2::zeros((90, 110));
    light
        .slice_mut(s![10..80, 10..100])
        .assign(&noise(70, 90, 2).mapv(|v| v + 2.0));
    let scene = Scene::new(light);
    for anchor in ANCHORS {
        let truth = double_sum(&model, &scene, anchor);
        for tolerance in [0.0, 1e-3, 1e-1] {
            // Without total flux, a tolerance on apertures keeps every mode.
            let on_l2 = options(tolerance, anchor, Paths::Transforms).with_tolerance_on(ToleranceOn::L2);
            let engine = scene.engine(&model, on_l2);
            let image = engine.image_of(&scene).unwrap().into_pixels();
            let norm = |a: &Array2<f64>| a.mapv(|v| v * v).sum().sqrt();
            let error = norm(&(&image - &truth)) / norm(&truth);
            // The light has one sign and the kernels have both signs, so the values cancel partly,
            // but their errors do not.
            assert!(
                error <= 10.0 * tolerance + ROUNDING_F64,
                "{error:e} at {tolerance:e}, {anchor}"
            );
            if anchor == Anchor::Source {
                let lost = (image.sum() - truth.sum()).abs() / peak(&truth);
                assert!(lost < 1e-10, "{lost:e} at {tolerance:e}");
            }
            if tolerance == 1e-1 {
                assert!(engine.plan().summary().most_modes() < 12);
            }
        }
    }
}

#[test]
fn a_constant_psf_takes_one_mode_a_tile_and_dark_tiles_nothing() {
    let model = model_with(Arc::new(Constant), (16, 12), (8, 6), true, Normalisation::Unit);
    let mut light = Array2::zeros((500, 500));
    light
        .slice_mut(s![..40, ..40])
        .assign(&noise(40, 40, 3).mapv(|v| v + 2.0));
    light[[400, 300]] = 5.0;
    let scene = Scene::new(light);
    let engine = scene.engine(&model, options(0.0, Anchor::Source, Paths::Cheapest));
    let summary = engine.plan().summary();
    assert_eq!((summary.most_modes(), summary.mean_modes()), (1, 1.0));
    let (image, counts) = engine.counted(&scene, &NoProgress).unwrap();
    assert_eq!(counts.tiles(), summary.tiles);
    assert!(counts.dark > summary.tiles / 2 && counts.drawn >= 1, "{counts:?}");
    let truth = scene.through(&model, &Direct::default()).unwrap().into_pixels();
    assert!(largest_difference(&image.into_pixels(), &truth) < ROUNDING_F64);
    assert!(summary.to_string().contains("tolerance 0e0"), "{summary}");
}

/// The numbers of the summary are for fully lit tiles. A tile whose light lies in its middle is
/// close to one, at least within a factor of 3.
/// Tiles of zero PSFs follow tiles of others in the same memory.
#[test]
fn psfs_that_are_zero_give_no_light() {
    const NODES: usize = 4;
    let values = Array2::from_shape_fn((NODES * NODES, 3), |(node, k)| {
        if node % NODES == 0 { 1.0 + k as f64 } else { 0.0 }
    });
    let field = Arc::new(GridField::new(60.0, NODES, values));
    let model = model_with(field, (9, 8), (4, 4), false, Normalisation::Keep);
    let scene = Scene::new(noise(120, 500, 3));
    for anchor in ANCHORS {
        let truth = scene.through(&model, &Direct::new(anchor)).unwrap();
        for paths in PATHS {
            let engine = scene.engine(&model, options(0.0, anchor, paths));
            assert!(engine.plan().blocks().any(|(_, modes)| modes == 0));
            let image = engine.image_of(&scene).unwrap();
            let error = largest_difference(&image.pixels().to_owned(), &truth.pixels().to_owned());
            assert!(
                error <= ROUNDING_F64 * peak(&truth.pixels().to_owned()),
                "{anchor} {paths:?}: {error:e}"
            );
            let back = engine.adjoint(&image).unwrap();
            let (forward, backward) = (
                (&image.pixels() * &image.pixels()).sum(),
                (&back.pixels() * &scene.pixels()).sum(),
            );
            let error = (forward - backward).abs() / forward;
            assert!(error <= ROUNDING_F64, "adjoint, {anchor} {paths:?}: {error:e}");
        }
    }
}

#[test]
fn the_summary_says_which_tiles_are_drawn() {
    let model = model_with(Arc::new(Constant), (16, 12), (8, 6), true, Normalisation::Unit);
    for anchor in ANCHORS {
        let options = options(0.0, anchor, Paths::Cheapest);
        let engine = |lit: usize| {
            let mut light = Array2::zeros((500, 500));
            for i in 0..lit {
                light[[30 + i / 60, 30 + i % 60]] = 1.0;
            }
            let scene = Scene::new(light);
            let engine = scene.engine(&model, options);
            (
                engine.plan().summary().drawn_up_to,
                engine.counted(&scene, &NoProgress).unwrap().1,
            )
        };
        let (most, _) = engine(0);
        println!("{anchor} {most}");
        let (_, few) = engine(most / 3);
        assert!(
            few.drawn > 0 && few.transformed + few.direct == 0,
            "{anchor}, {most}: {few:?}"
        );
        let (_, many) = engine(3 * most);
        assert!(many.transformed + many.direct > 0, "{anchor}, {most}: {many:?}");
    }
}

/// In f32, transforms of a bright star would fill its tile with noise.
#[test]
fn a_bright_star_adds_no_noise_to_the_faint_light_of_its_tile() {
    let model = model_with(Arc::new(Waves), (9, 8), (4, 4), true, Normalisation::Unit);
    let mut light = noise(200, 200, 5).mapv(|v| v + 1.5);
    light[[100, 90]] = 1e8;
    let scene = Scene::new(light);
    let truth = double_sum_far_from(&model, &scene);
    for anchor in ANCHORS {
        let image = single(&scene)
            .through(&model, &LowRank::new(options(0.0, anchor, Paths::Cheapest)))
            .unwrap();
        let exact = &truth[usize::from(anchor == Anchor::Output)];
        let error = exact
            .iter()
            .map(|&((x, y), v)| (f64::from(image.pixels()[[y, x]]) - v).powi(2))
            .sum::<f64>();
        let norm = exact.iter().map(|&(_, v)| v * v).sum::<f64>();
        assert!(
            (error / norm).sqrt() < 1e-6,
            "{:e} {anchor}",
            (error / norm).sqrt()
        );
        // If only transforms are used, the noise appears.
        let noisy = single(&scene)
            .through(&model, &LowRank::new(options(0.0, anchor, Paths::Transforms)))
            .unwrap();
        let error = exact
            .iter()
            .map(|&((x, y), v)| (f64::from(noisy.pixels()[[y, x]]) - v).powi(2))
            .sum::<f64>();
        assert!((error / norm).sqrt() > 1e-3, "{anchor}");
    }
}

type PixelValues = Vec<((usize, usize), f64)>;

fn double_sum_far_from(model: &PsfModel, scene: &Scene<f64>) -> [PixelValues; 2] {
    let pixels: Vec<(usize, usize)> = (0..200_usize)
        .map(|n| (60 + (n * 7) % 60, 70 + (n * 11) % 60))
        .filter(|&(x, y)| x.abs_diff(90) > 12 || y.abs_diff(100) > 12)
        .collect();
    ANCHORS.map(|anchor| {
        let values = scene.at_pixels(model, anchor, &pixels).unwrap();
        pixels.iter().copied().zip(values).collect()
    })
}

#[test]
fn a_plan_refuses_what_it_was_not_made_for() {
    let model = model_with(Arc::new(Waves), (6, 4), (3, 2), true, Normalisation::Unit);
    let engine = scene(30, 20, 1).engine(&model, PlanOptions::default());
    assert!(matches!(
        engine.image_of(&scene(20, 30, 1)),
        Err(ConvError::LightShape { .. })
    ));
    let wrong = Image::new(noise(3, 3, 1)).unwrap();
    assert!(matches!(
        engine.adjoint(&wrong),
        Err(ConvError::FrameShape { .. })
    ));
    for frame in [region(-1, 0, 4, 4), region(28, 0, 4, 4)] {
        let plan = Plan::<f64>::new(&model, scene(30, 20, 1).shape(), frame, PlanOptions::default());
        assert!(matches!(plan, Err(ConvError::Frame(_))));
    }
    for bad in [-1e-3, 1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(PlanOptions::new(bad), Err(ConvError::Tolerance { .. })));
    }
}

/// A scene in memory that is read by rows.
struct Rows<'a> {
    scene: &'a Scene<f64>,
    image: Vec<f64>,
    most: usize,
}

impl RowStream<f64> for Rows<'_> {
    type Error = ConvError;
    fn read(
        &mut self,
        _layer: usize,
        rows: std::ops::Range<usize>,
        mut light: ndarray::ArrayViewMut2<'_, f64>,
    ) -> Result<(), ConvError> {
        self.most = self.most.max(rows.len());
        light.assign(&self.scene.pixels().slice(s![rows, ..]));
        Ok(())
    }
    fn write(&mut self, rows: ndarray::ArrayView2<'_, f64>) -> Result<(), ConvError> {
        self.image.extend(rows.iter());
        Ok(())
    }
}

#[test]
fn a_streamed_image_has_the_same_bytes() {
    let model = model_with(Arc::new(Waves), (16, 12), (8, 6), true, Normalisation::Unit);
    for frame in [
        region(0, 0, 20, 9000),
        region(7, 33, 9, 8800),
        region(3, 690, 12, 10),
    ] {
        let scene = scene(20, 9000, 6).with_frame(frame);
        for anchor in ANCHORS {
            let engine = scene.engine(&model, options(1e-3, anchor, Paths::Cheapest));
            let whole = engine.image_of(&scene).unwrap();
            let mut rows = Rows {
                scene: &scene,
                image: Vec::new(),
                most: 0,
            };
            let counts = engine.stream(&mut rows, &NoProgress).unwrap();
            assert_eq!(counts.tiles(), engine.plan().summary().tiles);
            assert_eq!(rows.image.len(), frame.shape().pixel_count());
            assert!(rows.image.iter().eq(whole.pixels().iter()), "{anchor}, {frame:?}");
            assert!(rows.most < 5000, "{} rows at once", rows.most);
        }
    }
}
