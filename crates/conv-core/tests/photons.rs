//! Sources drawn photon by photon, compared with the images that a plan draws.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::sync::Arc;

use common::extended::extended;
use common::grid_field::GridField;
use common::{PixelByPixel, Waves, drawn, model_of_stamp, region};
use conv_core::{ConvError, ExtendedSources, PhotonReport, PhotonSources, PlanOptions, SourcePlan};
use ndarray::{Array2, Array3, s};
use psf_types::{
    Anchor, CoefficientField, LightProfile, NoProgress, Normalisation, Outskirts, PixelRegion, PointSource,
    Position, PsfBasis, PsfModel, SersicProfile, SersicSource, StampGrid, StampInterpolation,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sersic::SersicLight;

const FRAME: (usize, usize) = (110, 97);
const NO_GALAXIES: ExtendedSources<'static> = ExtendedSources {
    points: &[],
    light: &|_| unreachable!(),
};
/// Pixels with fewer expected photons are left out of tests, because their counts are not nearly normal.
const LEAST_MEAN: f64 = 30.0;

fn frame() -> PixelRegion {
    region(0, 0, FRAME.0, FRAME.1)
}

/// A Gaussian that is wider along x, of unit flux.
fn gauss(grid: StampGrid, sigma: (f64, f64), centre: (f64, f64)) -> Array2<f64> {
    let s = grid.oversampling();
    Array2::from_shape_fn(grid.dim(), |(j, i)| {
        let x = ((i as f64 - grid.centre_x()) / s - centre.0) / sigma.0;
        let y = ((j as f64 - grid.centre_y()) / s - centre.1) / sigma.1;
        (-0.5 * (x * x + y * y)).exp() / (std::f64::consts::TAU * sigma.0 * sigma.1)
    })
}

fn stamps(oversampling: f64, kernel: StampInterpolation) -> StampGrid {
    let size = (31.0 * oversampling) as usize;
    let grid = StampGrid::new(size, size - 2).and_then(|grid| grid.with_oversampling(oversampling));
    let middle = 15.3 * oversampling;
    grid.and_then(|grid| grid.with_centre(middle, middle - 0.5))
        .unwrap()
        .with_interpolation(kernel)
}

/// Coefficients up to a size.
fn grid_field(size: f64) -> Arc<dyn CoefficientField> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let values = Array2::from_shape_simple_fn((16, 2), || size * rng.random_range(-1.0..1.0));
    Arc::new(GridField::new(40.0, 4, values))
}

/// PSFs that vary in shape and flux. All are positive.
fn varying(
    grid: StampGrid,
    field: impl Fn(f64) -> Arc<dyn CoefficientField>,
    normalisation: Normalisation,
) -> PsfModel {
    let mean = gauss(grid, (1.9, 1.5), (0.0, 0.0));
    // Multiples of the mean, so that it stays positive after the sum.
    let times = |wave: &dyn Fn(f64, f64) -> f64| {
        let factor = |(j, i)| wave(i as f64 - grid.centre_x(), j as f64 - grid.centre_y());
        Array2::from_shape_fn(grid.dim(), |at| mean[at] * factor(at))
    };
    let s = grid.oversampling();
    let mut first = times(&|x, y| ((0.7 * x + 0.3 * y) / s).sin());
    let mut second = times(&|x, y| ((0.5 * x - 0.6 * y) / s).cos());
    let norm = |stamp: &Array2<f64>| stamp.iter().map(|v| v * v).sum::<f64>().sqrt();
    first /= norm(&first);
    let overlap = (&first * &second).sum();
    second.scaled_add(-overlap, &first);
    second /= norm(&second);
    let size = 0.15 * norm(&mean);
    let mut components = Array3::zeros((2, grid.ny(), grid.nx()));
    components.index_axis_mut(ndarray::Axis(0), 0).assign(&first);
    components.index_axis_mut(ndarray::Axis(0), 1).assign(&second);
    let basis = PsfBasis::new(Some(mean), components, grid).unwrap();
    PsfModel::new(&basis, field(size), normalisation, None).unwrap()
}

fn star(x: f64, y: f64, flux: f64) -> PointSource {
    PointSource::new(Position::new(x, y).unwrap(), flux).unwrap()
}

/// Stars on the frame, at its edges and outside.
fn stars() -> Vec<PointSource> {
    let mut stars = vec![
        star(20.0, 30.0, 1.0),
        star(64.37, 64.81, 2.0),
        star(-3.3, 50.2, 1.0),
        star(109.7, -2.4, 1.0),
        star(85.5, 21.25, 0.5),
    ];
    stars.extend((0..30).map(|i| star(5.0 + 3.37 * f64::from(i), 8.0 + 2.9 * f64::from(i), 0.3)));
    stars
}

fn galaxies() -> Vec<SersicSource> {
    let galaxy = |x: f64, y: f64, re: f64, n: f64, q: f64, angle: f64| {
        let profile = SersicProfile::new(re, n, q, angle).unwrap();
        SersicSource::new(Position::new(x, y).unwrap(), 1.0, profile).unwrap()
    };
    vec![
        galaxy(30.2, 60.7, 3.0, 1.0, 0.6, 30.0),
        galaxy(80.9, 30.1, 4.0, 4.0, 0.5, -70.0),
        galaxy(60.4, 80.3, 2.0, 0.5, 0.9, 110.0),
        galaxy(-4.0, 20.0, 5.0, 1.7, 0.3, 10.0),
    ]
}

fn shot(
    plan: &SourcePlan<f64>,
    stars: &[PointSource],
    galaxies: &[SersicSource],
    (photons_per_flux, seed): (f64, u64),
    region: PixelRegion,
) -> (Array2<i32>, PhotonReport) {
    let mut counts = Array2::zeros((region.shape().ny(), region.shape().nx()));
    let report = extended(galaxies, |extended| {
        let sources = PhotonSources {
            stars,
            extended,
            photons_per_flux,
            seed,
        };
        plan.shoot_into(&sources, frame(), region, counts.view_mut(), &NoProgress)
    });
    (counts, report.unwrap())
}

fn drawn_all(model: &PsfModel, stars: &[PointSource], galaxies: &[SersicSource]) -> Array2<f64> {
    let plan = SourcePlan::<f64>::exact(std::slice::from_ref(model), Anchor::Source, None).unwrap();
    let mut image = drawn(&plan, stars, frame());
    extended(galaxies, |sources| {
        plan.draw_extended_into(sources, frame(), frame(), image.view_mut(), &NoProgress)
    })
    .unwrap();
    image
}

/// The chi-square of counts whose variances are the sizes of their means, in standard deviations from its mean,
/// and the largest deviation of a pixel in standard deviations.
fn deviations(counts: &Array2<i32>, means: &Array2<f64>) -> (f64, f64) {
    let (mut chi, mut number, mut largest) = (0.0, 0.0, 0.0_f64);
    for (&count, &mean) in counts
        .iter()
        .zip(means)
        .filter(|(_, mean)| mean.abs() > LEAST_MEAN)
    {
        let square = (f64::from(count) - mean).powi(2) / mean.abs();
        (chi, number, largest) = (chi + square, number + 1.0, largest.max(square));
    }
    assert!(number > 300.0, "{number}");
    ((chi - number) / (2.0 * number).sqrt(), largest.sqrt())
}

/// The largest deviations that chance allows.
const CHANCE: f64 = 5.0;
/// The mean of the sum of counts is accurate to these standard deviations.
fn check(name: &str, counts: &Array2<i32>, means: &Array2<f64>) {
    let (chi, largest) = deviations(counts, means);
    assert!(
        chi.abs() < CHANCE && largest < CHANCE + 0.5,
        "{name}: {chi} {largest}"
    );
}

/// Photons of a source of flux 1 in tests of means.
const MANY: f64 = 4e5;

#[test]
fn means_are_the_drawn_images() {
    let kernels = [StampInterpolation::default(), StampInterpolation::Lanczos3];
    for (kernel, oversampling, normalisation) in [
        (kernels[0], 1.0, Normalisation::Unit),
        (kernels[0], 4.0, Normalisation::Keep),
        (kernels[0], 3.0, Normalisation::Unit),
        (kernels[0], 1.6, Normalisation::Unit),
        (kernels[1], 1.0, Normalisation::Keep),
        (kernels[1], 4.0, Normalisation::Unit),
        (kernels[1], 2.3, Normalisation::Keep),
    ] {
        let model = varying(stamps(oversampling, kernel), grid_field, normalisation);
        let plan = SourcePlan::<f64>::new(&model, PlanOptions::default(), None).unwrap();
        let (counts, report) = shot(&plan, &stars(), &galaxies(), (MANY, 7), frame());
        let means = drawn_all(&model, &stars(), &galaxies()) * MANY;
        check(&format!("{kernel:?} {oversampling}"), &counts, &means);
        assert_eq!(report.counted, i64::from(counts.sum()));
        assert_eq!(report.sources, 39);
        assert!(report.photons as f64 >= report.mean - 5.0 * report.mean.sqrt());
    }
}

/// Means that are wrong by 2 percent, or moved by a fiftieth of a pixel, are noticed.
#[test]
fn the_test_of_means_can_fail() {
    let kernel = StampInterpolation::default();
    let model = varying(stamps(1.0, kernel), grid_field, Normalisation::Unit);
    let plan = SourcePlan::<f64>::new(&model, PlanOptions::default(), None).unwrap();
    let (counts, _) = shot(&plan, &stars(), &[], (MANY, 7), frame());
    let means = drawn_all(&model, &stars(), &[]) * MANY;
    assert!(deviations(&counts, &(&means * 1.02)).0 > CHANCE);
    let moved: Vec<PointSource> = stars()
        .iter()
        .map(|s| star(s.position().x() + 0.02, s.position().y(), s.flux()))
        .collect();
    let means = drawn_all(&model, &moved, &[]) * MANY;
    assert!(deviations(&counts, &means).0 > CHANCE);
}

/// Fields without nodes: cells within the tolerance, and PSFs of each source.
#[test]
fn fields_without_nodes_have_cells_or_own_psfs() {
    #[derive(Debug)]
    struct Two<F>(F, f64);
    impl<F: CoefficientField> CoefficientField for Two<F> {
        fn component_count(&self) -> usize {
            2
        }
        fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), psf_types::FieldError> {
            let mut all = [0.0; 3];
            self.0.evaluate_into(p, &mut all)?;
            a.copy_from_slice(&[self.1 * 2.0 * (all[0] - 1.0), self.1 * 2.0 * all[1]]);
            Ok(())
        }
    }
    let grid = stamps(2.0, StampInterpolation::default());
    let fields: [fn(f64) -> Arc<dyn CoefficientField>; 2] = [
        |size| Arc::new(Two(Waves, size)),
        |size| Arc::new(PixelByPixel(Two(Waves, size))),
    ];
    for field in fields {
        let model = varying(grid, field, Normalisation::Unit);
        let options = PlanOptions::new(1e-4).unwrap();
        let plan = SourcePlan::<f64>::new(&model, options, None).unwrap();
        let (counts, _) = shot(&plan, &stars(), &galaxies(), (MANY / 2.0, 1), frame());
        let means = drawn_all(&model, &stars(), &galaxies()) * (MANY / 2.0);
        check("no nodes", &counts, &means);
    }
}

/// A PSF that is negative in a ring, and has a flux of both signs.
#[test]
fn negative_pixels_count_as_minus_one() {
    for (kernel, oversampling) in [
        (StampInterpolation::default(), 1.0),
        (StampInterpolation::default(), 4.0),
        (StampInterpolation::Lanczos3, 2.0),
    ] {
        let grid = stamps(oversampling, kernel);
        let stamp = 3.0 * gauss(grid, (1.6, 1.4), (0.0, 0.0)) - 1.5 * gauss(grid, (3.0, 2.5), (0.0, 0.0));
        let model = model_of_stamp(stamp, grid);
        let plan = SourcePlan::<f64>::new(&model, PlanOptions::default(), None).unwrap();
        let sources = [star(40.3, 50.9, 1.0), star(80.0, 60.5, -1.0)];
        let (counts, report) = shot(&plan, &sources, &[], (MANY, 5), frame());
        let means = drawn_all(&model, &sources, &[]) * MANY;
        assert!(means.iter().any(|&m| m < -1000.0) && means.iter().any(|&m| m > 1000.0));
        // Here the sources do not overlap, so the sizes of the means are the variances.
        check("negative", &counts, &means);
        let sizes: f64 = means.iter().map(|m| m.abs()).sum();
        assert!((report.photons as f64 - sizes).abs() < 6.0 * sizes.sqrt());
    }
}

/// The variance is the mean, and neighbouring pixels are independent.
#[test]
fn counts_are_independent_poisson_deviates() {
    let model = varying(
        stamps(2.0, StampInterpolation::default()),
        grid_field,
        Normalisation::Unit,
    );
    let plan = SourcePlan::<f64>::new(&model, PlanOptions::default(), None).unwrap();
    let (stars, galaxies) = ([star(50.3, 40.2, 1.0)], galaxies());
    let galaxies = &galaxies[..1];
    let per_flux = 300.0;
    let means = drawn_all(&model, &stars, galaxies) * per_flux;
    let (mut squares, mut products, mut fourth) = (0.0, [0.0; 3], 0.0);
    let mut weight = 0.0;
    for seed in 0..3000 {
        let (counts, _) = shot(&plan, &stars, galaxies, (per_flux, seed), frame());
        let scaled = Array2::from_shape_fn(counts.dim(), |at| {
            let mean = means[at];
            if mean > 0.5 {
                (f64::from(counts[at]) - mean) / mean.sqrt()
            } else {
                0.0
            }
        });
        squares += scaled.iter().map(|v| v * v).sum::<f64>();
        fourth += scaled.iter().map(|v| v.powi(4)).sum::<f64>();
        weight += means.iter().filter(|&&m| m > 0.5).count() as f64;
        let [a, b, c] = [
            scaled.slice(s![1.., ..]),
            scaled.slice(s![.., 1..]),
            scaled.slice(s![1.., 1..]),
        ];
        products[0] += (&a * &scaled.slice(s![..-1, ..])).sum();
        products[1] += (&b * &scaled.slice(s![.., ..-1])).sum();
        products[2] += (&c * &scaled.slice(s![..-1, ..-1])).sum();
    }
    // The standard deviation of the mean square follows from the fourth moment.
    let error = (fourth / weight - 1.0).sqrt() / weight.sqrt();
    assert!(
        (squares / weight - 1.0).abs() < CHANCE * error,
        "{} {error}",
        squares / weight
    );
    for product in products {
        assert!(
            product.abs() / weight < CHANCE / weight.sqrt(),
            "{product} {weight}"
        );
    }
}

/// Threads, regions, the order of the sources, and other sources do not matter.
#[test]
fn photons_depend_on_their_source_and_the_seed() {
    let model = varying(
        stamps(2.0, StampInterpolation::default()),
        grid_field,
        Normalisation::Unit,
    );
    let options = PlanOptions::default();
    let new_plan = |options| SourcePlan::<f64>::new(&model, options, None).unwrap();
    let plan = new_plan(options);
    let (mut stars, mut galaxies) = (stars(), galaxies());
    // Equal sources get photons of their own.
    stars.extend([stars[1], stars[1]]);
    galaxies.push(galaxies[0]);
    let run = (50.0, 11);
    let (all, report) = shot(&plan, &stars, &galaxies, run, frame());
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let plan = new_plan(options.with_memory(0));
        let again = pool.install(|| shot(&plan, &stars, &galaxies, run, frame()));
        assert_eq!(again, (all.clone(), report));
    }
    let (mut reversed, mut other_galaxies) = (stars.clone(), galaxies.clone());
    reversed.reverse();
    other_galaxies.rotate_left(2);
    assert_eq!(shot(&plan, &reversed, &other_galaxies, run, frame()).0, all);
    for (x, y, nx, ny) in [(0, 0, 50, 50), (37, 61, 40, 30), (109, 96, 1, 1)] {
        let part = shot(&new_plan(options), &stars, &galaxies, run, region(x, y, nx, ny)).0;
        let (x, y) = (x as usize, y as usize);
        assert_eq!(part, all.slice(s![y..y + ny, x..x + nx]));
    }
    let (of_stars, _) = shot(&plan, &stars, &[], run, frame());
    let (of_galaxies, _) = shot(&plan, &[], &galaxies, run, frame());
    assert_eq!(of_stars + of_galaxies, all);
    assert_ne!(shot(&plan, &stars, &galaxies, (50.0, 12), frame()).0, all);
    let [one, two] = [1, 2].map(|count| shot(&plan, &vec![stars[1]; count], &[], run, frame()).0);
    assert_ne!(&two - &one, one);
}

/// Truncated stars light only their squares. Galaxies have truncated stamps.
#[test]
fn stamps_are_truncated_as_for_drawing() {
    let model = varying(
        stamps(2.0, StampInterpolation::default()),
        grid_field,
        Normalisation::Unit,
    );
    let plan = SourcePlan::<f64>::new(&model, PlanOptions::new(1e-7).unwrap(), Some(5)).unwrap();
    let (counts, _) = shot(&plan, &stars(), &galaxies(), (MANY, 3), frame());
    let mut means = drawn(&plan, &stars(), frame());
    extended(&galaxies(), |sources| {
        plan.draw_extended_into(sources, frame(), frame(), means.view_mut(), &NoProgress)
    })
    .unwrap();
    means *= MANY;
    check("truncated", &counts, &means);
}

/// Stacked galaxies have the second moments of their light and of the PSF: shear is not biased.
#[test]
fn sheared_galaxies_have_unbiased_moments() {
    let grid = stamps(2.0, StampInterpolation::default());
    let model = model_of_stamp(gauss(grid, (1.5, 1.5), (0.0, 0.0)), grid);
    let plan = SourcePlan::<f64>::new(&model, PlanOptions::default(), None).unwrap();
    for n in [0.5, 1.0] {
        let profile = SersicProfile::new(2.0, n, 1.0, 0.0)
            .unwrap()
            .sheared(0.05, -0.03)
            .unwrap();
        let galaxy = |x, y| SersicSource::new(Position::new(x, y).unwrap(), 100.0, profile).unwrap();
        let mut sums = [0.0; 4];
        for seed in 0..40 {
            let many: Vec<SersicSource> = (0..1000)
                .map(|i| galaxy(54.0 + 1e-3 * f64::from(i), 48.0 + 1e-6 * f64::from(seed)))
                .collect();
            let (counts, _) = shot(&plan, &[], &many, (1.0, 9), frame());
            for ((j, i), &count) in counts.indexed_iter() {
                let (x, y, c) = (i as f64 - 54.4995, j as f64 - 48.0, f64::from(count));
                sums[0] += c;
                sums[1] += c * (x * x - 1.0 / 12.0 - y * y);
                sums[2] += c * 2.0 * x * y;
                sums[3] += c * (x * x + y * y);
            }
        }
        // For a round profile of second moment `m` along each axis, sheared by (g1, g2): m / (1 - g^2) times
        // (1 + g^2, 2 g1, 2 g2) for xx + yy over 2, xx - yy over 2, xy.
        let b = [std::f64::consts::LN_2, 1.678_346_990_016_66][usize::from(n == 1.0)];
        let m = 4.0 * [0.5 / b, 3.0 / (b * b)][usize::from(n == 1.0)];
        let g = 0.05_f64.powi(2) + 0.03_f64.powi(2);
        let truth = [0.05, -0.03].map(|g_i| m / (1.0 - g) * 4.0 * g_i);
        let size = 2.0 * (m * (1.0 + g) / (1.0 - g) + 1.5 * 1.5);
        // The standard deviation of a moment of a photon is about the size of the light.
        let error = 1.5 * size / sums[0].sqrt();
        for (sum, truth) in [sums[1], sums[2]].into_iter().zip(truth) {
            assert!(
                (sum / sums[0] - truth).abs() < 4.0 * error,
                "{n}: {} {truth} {error}",
                sum / sums[0]
            );
        }
        let measured = sums[3] / sums[0] - 1.0 / 12.0;
        assert!((measured / size - 1.0).abs() < 0.01, "{measured} {size}");
    }
}

/// A profile of the caller's own, without a distribution of its light.
#[derive(Debug)]
struct Own(SersicLight);

impl LightProfile for Own {
    fn transform_into(&self, kx: f64, first_ky: f64, step: f64, values: &mut [f32]) {
        self.0.transform_into(kx, first_ky, step, values);
    }
    fn transform_limits(&self, step: f64, smallest: &mut [f32], largest: &mut [f32]) {
        self.0.transform_limits(step, smallest, largest);
    }
    fn add_blurred(&self, covariance: [f64; 3], flux: f64, offsets: &[[f32; 2]], values: &mut [f64]) {
        self.0.add_blurred(covariance, flux, offsets, values);
    }
    fn outskirts(&self, distance_px: f64) -> Outskirts {
        self.0.outskirts(distance_px)
    }
    fn around(&self, offset: (f64, f64), half_px: f64) -> Outskirts {
        self.0.around(offset, half_px)
    }
    fn axis_ratio(&self) -> f64 {
        self.0.axis_ratio()
    }
    fn radius(&self, dx: f64, dy: f64) -> f64 {
        self.0.radius(dx, dy)
    }
    fn brightness(&self, radius_px: f64) -> f64 {
        self.0.brightness(radius_px)
    }
    fn index(&self) -> f64 {
        self.0.index()
    }
    fn squared_norm(&self) -> f64 {
        self.0.squared_norm()
    }
    fn flux_beyond(&self, distance_px: f64) -> f64 {
        self.0.flux_beyond(distance_px)
    }
}

#[test]
fn own_profiles_are_integrated() {
    let model = varying(
        stamps(1.0, StampInterpolation::default()),
        grid_field,
        Normalisation::Unit,
    );
    let plan = SourcePlan::<f64>::new(&model, PlanOptions::default(), None).unwrap();
    let galaxies = galaxies();
    let points = galaxies
        .iter()
        .map(|g| PointSource::new(g.position(), g.flux()).unwrap());
    let points: Vec<PointSource> = points.collect();
    let light = |index: usize| Arc::new(Own(SersicLight::new(&galaxies[index]))) as conv_core::Light;
    let sources = PhotonSources {
        stars: &[],
        extended: ExtendedSources {
            points: &points,
            light: &light,
        },
        photons_per_flux: MANY,
        seed: 4,
    };
    let mut counts = Array2::zeros((FRAME.1, FRAME.0));
    plan.shoot_into(&sources, frame(), frame(), counts.view_mut(), &NoProgress)
        .unwrap();
    let means = drawn_all(&model, &[], &galaxies) * MANY;
    check("own", &counts, &means);
}

#[test]
fn what_cannot_be_shot_is_refused() {
    let grid = stamps(1.0, StampInterpolation::default());
    let model = model_of_stamp(gauss(grid, (1.5, 1.5), (0.0, 0.0)), grid);
    let stars = [star(5.0, 5.0, 1.0)];
    let shoot = |anchor, photons_per_flux, shape| {
        let options = PlanOptions::default().with_anchor(anchor);
        let plan = SourcePlan::<f64>::new(&model, options, None).unwrap();
        let sources = PhotonSources {
            stars: &stars,
            extended: NO_GALAXIES,
            photons_per_flux,
            seed: 1,
        };
        plan.shoot_into(
            &sources,
            frame(),
            frame(),
            Array2::zeros(shape).view_mut(),
            &NoProgress,
        )
    };
    let shape = (FRAME.1, FRAME.0);
    assert!(matches!(
        shoot(Anchor::Output, 1.0, shape),
        Err(ConvError::Photons(_))
    ));
    for per_flux in [-1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(
            shoot(Anchor::Source, per_flux, shape),
            Err(ConvError::Photons(_))
        ));
    }
    assert!(matches!(
        shoot(Anchor::Source, 1.0, (3, 3)),
        Err(ConvError::FrameShape { .. })
    ));
    assert_eq!(shoot(Anchor::Source, 0.0, shape).unwrap().photons, 0);
}
