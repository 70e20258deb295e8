//! Convolution with the model of a telescope.

use integration_tests::{
    convolve, direct_at, fitted, relative_l2, small_telescope, test_scene, uniform_samples,
};
use ndarray::{Array2, Array3, s};
use psfield::conv_core::{
    BasisConvolution, ConvError, Direct, LowRank, PatchConvolution, Paths, Plan, PlanOptions,
};
use psfield::fit::model_of;
use psfield::psf_basis::{Centring, RankSelection};
use psfield::psf_types::{
    Anchor, FieldError, FrameShape, Image, Interpolation, NoProgress, OutsidePolicy, Position, PsfModel,
    PsfSamples, PsfSource, SamplePositions,
};
use psfield::{FitOptions, Method, Psf, Scene};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Rounding of a few hundred transforms and products in double precision.
const ROUNDING: f64 = 1e-13;
/// Error of the fast engine at tolerance 0, over the peak: rounding of its transforms and modes.
const ENGINE_F64: f64 = 1e-12;
/// The limit [`ENGINE_F64`] in single precision.
const ENGINE_F32: f64 = 1e-6;
/// The limit in double precision, plus the rounding of interpolation weights (for instance the
/// terms of a polynomial).
const ENGINE_INTERPOLATED: f64 = 1e-11;

const ANCHORS: [Anchor; 2] = [Anchor::Source, Anchor::Output];
const PATHS: [Paths; 2] = [Paths::Cheapest, Paths::Transforms];

fn model(rank: RankSelection, centring: Centring) -> PsfModel {
    let options = FitOptions {
        rank,
        centring,
        ..FitOptions::default()
    };
    fitted(uniform_samples(&small_telescope(1), 9, 7), &options)
}

#[test]
fn the_methods_agree_and_patches_converge_to_them() {
    let scene = test_scene(160, 120, 0);
    for centring in [Centring::Mean, Centring::None] {
        let model = model(RankSelection::Auto, centring);
        for anchor in [Anchor::Source, Anchor::Output] {
            let direct = convolve(&Direct::new(anchor), &model, &scene).unwrap();
            let basis = convolve(&BasisConvolution::new(anchor), &model, &scene).unwrap();
            assert!(relative_l2(&basis, &direct) < ROUNDING);
            let patches = |size| {
                let method = PatchConvolution::new(size, anchor).unwrap();
                relative_l2(&convolve(&method, &model, &scene).unwrap(), &direct)
            };
            let (coarse, fine) = (patches(32), patches(8));
            println!("{anchor}: patches of 32 pixels are off by {coarse:.1e}, of 8 by {fine:.1e}");
            assert!(fine < 0.5 * coarse && coarse < 0.1);
            assert!(patches(1) < ROUNDING);
        }
    }
}

#[test]
fn centred_models_of_unit_flux_keep_the_flux_at_every_rank() {
    let scene = test_scene(160, 120, 13);
    let total = scene.pixels().sum();
    for rank in [0, 1, 2, 5, 20, 62] {
        let model = model(RankSelection::Fixed(rank), Centring::Mean);
        let image = convolve(&BasisConvolution::default(), &model, &scene).unwrap();
        assert!(
            (image.pixels().sum() / total - 1.0).abs() < 1e-12,
            "{rank} components"
        );
    }
    // Truncated models without centring keep the flux because every PSF is scaled.
    let model = model(RankSelection::Fixed(3), Centring::None);
    let image = convolve(&BasisConvolution::default(), &model, &scene).unwrap();
    assert!((image.pixels().sum() / total - 1.0).abs() < 1e-12);
}

#[test]
fn the_adjoint_is_the_transpose_of_the_operator() {
    let scene = test_scene(160, 120, 0);
    let model = model(RankSelection::Fixed(8), Centring::None);
    let g = Image::new(scene.pixels().mapv(|v| (v * 7.0).sin())).unwrap();
    for anchor in [Anchor::Source, Anchor::Output] {
        let method = BasisConvolution::new(anchor);
        let forward = convolve(&method, &model, &scene).unwrap();
        let back = method
            .adjoint(&model, &g.view(), scene.shape(), scene.shape().region())
            .unwrap();
        let left = (&forward.pixels() * &g.pixels()).sum();
        let right = (&scene.pixels() * &back.pixels()).sum();
        assert!((left / right - 1.0).abs() < 1e-12, "{left} {right}");
    }
}

#[test]
fn the_spot_check_detects_a_wrong_image() {
    let light = test_scene(160, 120, 0);
    let psf = Psf::from(model(RankSelection::Auto, Centring::Mean));
    let scene = Scene::from(&light);
    let simulator = psf.simulator((120, 160)).method(Method::Basis).build().unwrap();
    let check = |image: &Image<f64>| {
        simulator
            .spot_check(&scene, image, (100, 3), &NoProgress)
            .unwrap()
    };
    let good = simulator.simulate(&scene).unwrap();
    let judged = check(&good);
    assert!(judged.max_over_peak.unwrap() < ROUNDING);
    assert_eq!(judged.passed, Some(true), "{judged:?}");
    // An engine whose error is one part in a thousand, at one pixel in ten.
    let mut perturbed = good.pixels().to_owned();
    for ((y, x), value) in perturbed.indexed_iter_mut() {
        if (3 * y + x) % 10 == 0 {
            *value *= 1.001;
        }
    }
    let judged = check(&Image::new(perturbed).unwrap());
    assert_eq!(judged.passed, Some(false), "{judged:?}");
    // Patches promise nothing.
    let patches = psf
        .simulator((120, 160))
        .method(Method::Patch(32))
        .build::<f64>()
        .unwrap();
    let patched = patches.simulate(&scene).unwrap();
    let found = patches
        .spot_check(&scene, &patched, (100, 3), &NoProgress)
        .unwrap();
    assert!(found.max_over_peak.unwrap() > 1e-4 && found.passed.is_none());
}

fn engine(anchor: Anchor, paths: Paths) -> LowRank {
    let options = PlanOptions::new(0.0).unwrap();
    LowRank::new(options.with_anchor(anchor).with_paths(paths))
}

/// Values that single precision holds exactly, so that both precisions convolve equal light. About
/// one pixel in `every` is lit.
fn noisy(nx: usize, ny: usize, every: usize) -> Array2<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64((nx * ny) as u64);
    Array2::from_shape_simple_fn((ny, nx), || {
        let value = f64::from(rng.random_range(0.5_f32..1.5));
        if rng.random_range(0..every) == 0 {
            value
        } else {
            0.0
        }
    })
}

/// Compares the fast engine with the double sum: both precisions, all paths, both anchorings.
fn assert_exact(name: &str, model: &PsfModel, light: &Array2<f64>) {
    let scene = Image::new(light.clone()).unwrap();
    let single = Image::new(light.mapv(|v| v as f32)).unwrap();
    for anchor in ANCHORS {
        let truth = convolve(&Direct::new(anchor), model, &scene)
            .unwrap()
            .into_pixels();
        let peak = truth.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        let off = |image: Array2<f64>| (image - &truth).iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        for paths in PATHS {
            let engine = engine(anchor, paths);
            let double = off(convolve(&engine, model, &scene).unwrap().into_pixels());
            let image = convolve(&engine, model, &single).unwrap();
            let single = off(image.pixels().mapv(f64::from));
            println!(
                "{name}, {anchor}, {paths:?}: off by {:.1e} and {:.1e} of the peak",
                double / peak.max(f64::MIN_POSITIVE),
                single / peak.max(f64::MIN_POSITIVE)
            );
            // Not divided by the peak, which is 0 for a scene without light.
            assert!(
                double <= ENGINE_F64 * peak && single <= ENGINE_F32 * peak,
                "{name}, {anchor}, {paths:?}: {double:e} and {single:e}, the peak is {peak:e}"
            );
        }
    }
}

#[test]
fn the_fast_engine_computes_extreme_scenes_exactly() {
    let model = model(RankSelection::Auto, Centring::Mean);
    let mut deltas = Array2::zeros((120, 160));
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for _ in 0..1000 {
        let flux = f64::from(10_f32.powf(rng.random_range(0.0..4.0)));
        deltas[[rng.random_range(0..120), rng.random_range(0..160)]] = flux;
    }
    assert_exact("a thousand deltas", &model, &deltas);
    assert_exact("no light", &model, &Array2::zeros((50, 70)));
    assert_exact("one pixel", &model, &Array2::from_elem((1, 1), 3.0));
    for (nx, ny) in [(131, 1), (1, 113), (53, 37), (127, 2), (7, 5), (3, 89)] {
        for every in [1, 9] {
            let name = format!("{nx} x {ny}, one in {every}");
            assert_exact(&name, &model, &noisy(nx, ny, every));
        }
    }
}

/// The stamps have 24 pixels, the frame 20 columns, and more rows than the largest tile.
#[test]
fn the_fast_engine_is_exact_where_stamps_are_larger_than_tiles() {
    let light = noisy(20, 700, 1);
    for interpolation in [Interpolation::Bilinear, Interpolation::Bicubic] {
        let options = FitOptions {
            rank: RankSelection::Full,
            interpolation,
            ..FitOptions::default()
        };
        let model = fitted(uniform_samples(&small_telescope(1), 21, 16), &options);
        let options = PlanOptions::new(0.0).unwrap().with_paths(Paths::Transforms);
        let shape = FrameShape::new(20, 700).unwrap();
        let plan = Plan::<f64>::new(&model, shape, shape.region(), options).unwrap();
        let summary = plan.summary();
        println!("{interpolation}: {summary}");
        assert!(summary.tile.0 < 24 && summary.tiles > 1, "{summary}");
        assert_exact(&format!("small tiles, {interpolation}"), &model, &light);
    }
}

/// Every interpolator that accepts scattered samples.
const SCATTERED: [Interpolation; 5] = [
    Interpolation::Delaunay,
    Interpolation::NaturalNeighbour,
    Interpolation::InverseDistance { power: 2.0 },
    Interpolation::Polynomial { degree: 3 },
    Interpolation::Nearest,
];

/// Every interpolator that accepts only samples on a grid.
const GRIDDED: [Interpolation; 2] = [Interpolation::Bilinear, Interpolation::Bicubic];

/// A model from samples at random positions in a frame of 160 x 120 pixels. The samples keep 20
/// pixels from the left and right edges and 15 from the others.
fn scattered(interpolation: Interpolation, outside: OutsidePolicy) -> PsfModel {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let mut at = vec![(20.0, 15.0), (140.0, 15.0), (20.0, 105.0), (140.0, 105.0)];
    at.extend((0..50).map(|_| (rng.random_range(20.0..140.0), rng.random_range(15.0..105.0))));
    let at: Vec<Position> = at
        .into_iter()
        .map(|(x, y)| Position::new(x, y).unwrap())
        .collect();
    sampled_at(at, interpolation, outside)
}

/// A model from samples on a grid whose lines lie between pixels, as far from the edges as in
/// [`scattered`].
fn gridded(interpolation: Interpolation, outside: OutsidePolicy) -> PsfModel {
    let at = (0..35).map(|i| {
        let (column, row) = (f64::from(i % 7), f64::from(i / 7));
        Position::new(20.3 + 19.9 * column, 15.0 + 22.6 * row).unwrap()
    });
    sampled_at(at.collect(), interpolation, outside)
}

fn sampled_at(at: Vec<Position>, interpolation: Interpolation, outside: OutsidePolicy) -> PsfModel {
    let telescope = small_telescope(1);
    let mut stamps = Array3::zeros((at.len(), 24, 24));
    for (&position, stamp) in at.iter().zip(stamps.outer_iter_mut()) {
        telescope.draw_into(position, stamp).unwrap();
    }
    let positions = SamplePositions::new(at, Some(FrameShape::new(160, 120).unwrap())).unwrap();
    let samples = PsfSamples::new(stamps, positions, telescope.grid()).unwrap();
    let options = FitOptions {
        rank: RankSelection::Full,
        interpolation,
        outside,
        ..FitOptions::default()
    };
    fitted(samples, &options)
}

#[test]
fn the_fast_engine_works_with_every_interpolator() {
    let scene = test_scene(160, 120, 0);
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let pixels: Vec<(usize, usize)> = (0..300)
        .map(|_| (rng.random_range(0..160), rng.random_range(0..120)))
        .collect();
    let by_kriging = scattered(Interpolation::Kriging(None), OutsidePolicy::Nearest);
    let extended = scattered(Interpolation::Kriging(None), OutsidePolicy::Extend);
    let scattered =
        SCATTERED.map(|interpolation| (interpolation, scattered(interpolation, OutsidePolicy::Nearest)));
    let policies = [OutsidePolicy::Nearest, OutsidePolicy::Extend];
    let gridded = GRIDDED
        .iter()
        .flat_map(|&interpolation| policies.map(|outside| (interpolation, gridded(interpolation, outside))));
    // The field nearest to a position has kinks, which no table holds.
    let tabulated = Psf::from(extended);
    let table = tabulated.record().unwrap();
    let smooth = [
        (Interpolation::Kriging(None), by_kriging),
        (table.interpolation(), model_of(table.clone()).unwrap()),
    ];
    for (interpolation, model) in scattered.into_iter().chain(gridded).chain(smooth) {
        for anchor in ANCHORS {
            let exact = direct_at(&model, &scene, anchor, &pixels).unwrap();
            let peak = exact.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            for paths in PATHS {
                let image = convolve(&engine(anchor, paths), &model, &scene).unwrap();
                let pairs = exact.iter().zip(&pixels);
                let off = pairs.fold(0.0_f64, |m, (v, &(x, y))| {
                    m.max((image.pixels()[[y, x]] - v).abs())
                });
                println!(
                    "{interpolation}, {anchor}, {paths:?}: off by {:.1e} of the peak",
                    off / peak
                );
                assert!(
                    off <= ENGINE_INTERPOLATED * peak,
                    "{interpolation}, {anchor}, {paths:?}: {off:e}"
                );
            }
        }
    }
}

#[test]
fn the_fast_engine_refuses_light_where_there_is_no_psf_and_only_there() {
    let mut inside = Array2::zeros((120, 160));
    inside.slice_mut(s![45..75, 60..100]).assign(&noisy(40, 30, 1));
    let mut outside = inside.clone();
    outside[[2, 157]] = 1e-30;
    let outside = Image::new(outside).unwrap();
    let scattered =
        SCATTERED.map(|interpolation| (interpolation, scattered(interpolation, OutsidePolicy::Error)));
    let gridded = GRIDDED.map(|interpolation| (interpolation, gridded(interpolation, OutsidePolicy::Error)));
    for (interpolation, model) in scattered.into_iter().chain(gridded) {
        assert_exact(&format!("{interpolation}, light only inside"), &model, &inside);
        for anchor in ANCHORS {
            for paths in PATHS {
                let refused = convolve(&engine(anchor, paths), &model, &outside);
                assert!(
                    matches!(refused, Err(ConvError::Field(FieldError::OutsideSamples { .. }))),
                    "{interpolation}, {anchor}, {paths:?}: {refused:?}"
                );
            }
        }
    }
}
