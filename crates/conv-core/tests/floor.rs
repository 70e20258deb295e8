//! Light below the floor may be dropped, and the plan says how much.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::sync::Arc;

use common::extended::extended;
use common::{drawn, region};
use conv_core::{ConvError, ConvReal, DroppedLight, PlanOptions, SourcePlan};
use ndarray::{Array2, Axis};
use psf_types::{
    Anchor, CoefficientField, FieldError, NoProgress, Normalisation, PixelRegion, PointSource, Position,
    PsfBasis, PsfModel, SersicProfile, SersicSource, StampGrid, StampInterpolation,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const FRAME: (usize, usize) = (190, 170);

fn frame() -> PixelRegion {
    region(0, 0, FRAME.0, FRAME.1)
}

/// Two components that change over the frame, up to a largest coefficient.
#[derive(Debug)]
struct Slopes(f64);

impl CoefficientField for Slopes {
    fn component_count(&self) -> usize {
        2
    }

    fn evaluate_into(&self, at: Position, into: &mut [f64]) -> Result<(), FieldError> {
        into[0] = self.0 * (2.0 * at.x() / 190.0 - 1.0);
        into[1] = self.0 * (2.0 * at.y() / 170.0 - 1.0);
        Ok(())
    }
}

/// PSFs with wide wings and spikes along two directions.
fn model(pixels: usize, s: f64, kernel: StampInterpolation, normalisation: Normalisation) -> PsfModel {
    let grid = StampGrid::new(pixels, pixels)
        .and_then(|grid| grid.with_oversampling(s))
        .unwrap()
        .with_interpolation(kernel);
    let stamp = |of: &dyn Fn(f64, f64) -> f64| {
        Array2::from_shape_fn(grid.dim(), |(y, x)| {
            of((x as f64 - grid.centre_x()) / s, (y as f64 - grid.centre_y()) / s)
        })
    };
    let moffat = |x: f64, y: f64| (1.0 + (x * x + y * y) / 4.0).powf(-1.8);
    let spike = |x: f64, y: f64| 0.02 * (-(x - 0.5 * y).powi(2)).exp() / (1.0 + y.abs());
    let mean = stamp(&|x, y| moffat(x, y) + spike(x, y) + spike(y, -x));
    let mean = &mean / (mean.sum() / (s * s));
    let norm = mean.iter().map(|v| v * v).sum::<f64>().sqrt();
    let product = |a: &Array2<f64>, b: &Array2<f64>| (a * b).sum();
    let first = stamp(&|x, y| x * y * moffat(x, y) / (1.0 + x * x + y * y));
    let first = &first / product(&first, &first).sqrt();
    let second = stamp(&|x, y| (x * x - y * y) * moffat(x, y) / (1.0 + x * x + y * y));
    let second = &second - product(&second, &first) * &first;
    let second = &second / product(&second, &second).sqrt();
    let parts = ndarray::stack![Axis(0), first, second];
    let basis = PsfBasis::new(Some(mean), parts, grid).unwrap();
    PsfModel::new(&basis, Arc::new(Slopes(0.2 * norm)), normalisation, None).unwrap()
}

/// Positions on the frame and around it, and fluxes over eight decades.
fn sources(count: usize, most: f64) -> Vec<PointSource> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut source = || {
        let position = Position::new(rng.random_range(-20.0..210.0), rng.random_range(-20.0..190.0));
        let flux: f64 = most * 10.0_f64.powf(rng.random_range(-8.0..0.0));
        PointSource::new(position.unwrap(), if rng.random_bool(0.1) { -flux } else { flux }).unwrap()
    };
    (0..count).map(|_| source()).collect()
}

fn plan<T: ConvReal>(model: &PsfModel, floor: f64) -> SourcePlan<T> {
    let options = PlanOptions::new(1e-7).and_then(|options| options.with_floor(floor));
    SourcePlan::new(model, options.unwrap(), None).unwrap()
}

fn dropped_of<T: ConvReal>(
    plan: &SourcePlan<T>,
    stars: &[PointSource],
    galaxies: &[SersicSource],
    region: PixelRegion,
) -> DroppedLight {
    let mut dropped = DroppedLight::new(region);
    extended(galaxies, |sources| {
        plan.add_dropped_light((stars, sources), frame(), region, &mut dropped)
            .unwrap();
    });
    dropped
}

/// Whether most light of a source is on the frame.
fn is_inside(at: Position) -> bool {
    (60.0..130.0).contains(&at.x()) && (60.0..110.0).contains(&at.y())
}

fn largest_difference(a: &Array2<f64>, b: &Array2<f64>) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

const CASES: [(usize, f64, StampInterpolation, Normalisation); 5] = [
    (63, 1.0, StampInterpolation::CubicSpline, Normalisation::Unit),
    (125, 2.0, StampInterpolation::Lanczos3, Normalisation::Unit),
    (150, 3.0, StampInterpolation::CubicSpline, Normalisation::Keep),
    (200, 4.0, StampInterpolation::CubicSpline, Normalisation::Unit),
    (250, 7.0, StampInterpolation::Lanczos3, Normalisation::Keep),
];

#[test]
fn light_above_the_floor_is_drawn() {
    const FLOOR: f64 = 0.01;
    for (pixels, s, kernel, normalisation) in CASES {
        let model = model(pixels, s, kernel, normalisation);
        let (whole, within) = (plan::<f64>(&model, 0.0), plan::<f64>(&model, FLOOR));
        let (mut dropped_pixels, mut drawn_pixels) = (0, 0);
        for star in sources(60, 1e5) {
            let case = format!("{s} {kernel} {star:?}");
            let (all, some) = (drawn(&whole, &[star], frame()), drawn(&within, &[star], frame()));
            let noise = 1e-12 * star.flux().abs();
            for (all, some) in all.iter().zip(&some) {
                let is_drawn = (all - some).abs() <= noise;
                assert!(
                    is_drawn || all.abs() <= FLOOR && some.abs() <= noise,
                    "{case}: {all} {some}"
                );
                dropped_pixels += usize::from(!is_drawn);
                drawn_pixels += usize::from(is_drawn && all.abs() > noise);
            }
            let (all, some) = (all.sum() / star.flux(), some.sum() / star.flux());
            assert!(
                !is_inside(star.position()) || some >= 0.85 * all,
                "{case}: {some} of {all}"
            );
        }
        // The test must see both.
        assert!(
            dropped_pixels > 10_000 && drawn_pixels > 10_000,
            "{dropped_pixels} {drawn_pixels}"
        );
    }
}

#[test]
fn the_dropped_light_is_within_its_limit() {
    for floor in [1e-4, 1e-2, 1.0] {
        for (pixels, s, kernel, normalisation) in CASES {
            let model = model(pixels, s, kernel, normalisation);
            let stars = sources(300, 1e5);
            let (whole, within) = (plan::<f64>(&model, 0.0), plan::<f64>(&model, floor));
            let (all, some) = (drawn(&whole, &stars, frame()), drawn(&within, &stars, frame()));
            let limit = dropped_of(&within, &stars, &[], frame());
            let difference = largest_difference(&all, &some);
            assert!(
                difference <= limit.largest() + 1e-7,
                "{s} {kernel}: {difference} {limit:?}"
            );
            assert!(
                difference > 0.02 * limit.largest(),
                "{s}: {difference} {}",
                limit.largest()
            );
            let missing = (all.sum() - some.sum()) / stars.iter().map(|star| star.flux().abs()).sum::<f64>();
            assert!(
                missing.abs() <= 2.0 * limit.fraction() + 1e-9,
                "{s}: {missing} {}",
                limit.fraction()
            );
            let nothing = dropped_of(&whole, &stars, &[], frame());
            assert_eq!((nothing.largest(), nothing.fraction()), (0.0, 0.0));
        }
    }
}

#[test]
fn the_reach_of_a_star_does_not_depend_on_regions() {
    let (pixels, s, kernel, normalisation) = CASES[3];
    let model = model(pixels, s, kernel, normalisation);
    let stars = sources(400, 1e4);
    let plan = plan::<f32>(&model, 0.003);
    let whole: Array2<f32> = drawn(&plan, &stars, frame());
    let draw = |region: PixelRegion, stars: &[PointSource]| {
        let mut image = Array2::<f32>::zeros((region.shape().ny(), region.shape().nx()));
        plan.draw_stars_into(stars, frame(), region, image.view_mut(), &NoProgress)
            .unwrap();
        image
    };
    for (x, y, nx, ny) in [(0, 0, 190, 31), (37, 11, 64, 90), (189, 169, 1, 1)] {
        let part = draw(region(x, y, nx, ny), &stars);
        let (x, y) = (x as usize, y as usize);
        let same = whole.slice(ndarray::s![y..y + ny, x..x + nx]);
        assert!(
            part.iter().zip(same).all(|(a, b)| a.to_bits() == b.to_bits()),
            "{x} {y}"
        );
    }
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(one.install(|| draw(frame(), &stars)), whole);
}

#[test]
fn galaxies_keep_the_floor() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let galaxies: Vec<SersicSource> = sources(80, 1e4)
        .iter()
        .map(|source| {
            let n = [0.5, 1.0, 1.5, 2.5][rng.random_range(0..4)];
            let profile = SersicProfile::new(
                rng.random_range(0.3..3.0),
                n,
                rng.random_range(0.2..1.0),
                rng.random_range(0.0..180.0),
            );
            SersicSource::new(source.position(), source.flux(), profile.unwrap()).unwrap()
        })
        .collect();
    for floor in [1e-3, 0.3] {
        for (pixels, s, kernel, normalisation) in CASES {
            let model = model(pixels, s, kernel, normalisation);
            let image = |plan: &SourcePlan<f64>, galaxies: &[SersicSource]| {
                let mut image = Array2::zeros((FRAME.1, FRAME.0));
                extended(galaxies, |sources| {
                    plan.draw_extended_into(sources, frame(), frame(), image.view_mut(), &NoProgress)
                })
                .unwrap();
                image
            };
            let options = |floor: f64| PlanOptions::new(1e-4).and_then(|o| o.with_floor(floor)).unwrap();
            let whole = SourcePlan::<f64>::new(&model, options(0.0), None).unwrap();
            let within = SourcePlan::<f64>::new(&model, options(floor), None).unwrap();
            for galaxy in &galaxies[..12] {
                let (all, some) = (image(&whole, &[*galaxy]), image(&within, &[*galaxy]));
                let difference = largest_difference(&all, &some);
                let rest = 1e-4 * all.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
                assert!(difference <= floor + rest, "{floor} {s} {galaxy:?}: {difference}");
                let (all, some) = (all.sum() / galaxy.flux(), some.sum() / galaxy.flux());
                assert!(
                    !is_inside(galaxy.position()) || some >= 0.85 * all,
                    "{galaxy:?}: {some} of {all}"
                );
            }
            let (all, some) = (image(&whole, &galaxies), image(&within, &galaxies));
            let limit = dropped_of(&within, &[], &galaxies, frame());
            let difference = largest_difference(&all, &some);
            assert!(
                difference <= limit.largest() + 1e-4,
                "{floor} {s}: {difference} {}",
                limit.largest()
            );
            assert!(
                difference > 1e-3 * floor,
                "{floor} {s}: {difference} {}",
                limit.largest()
            );
        }
    }
}

#[test]
fn floors_are_numbers_of_at_least_0() {
    for floor in [-1.0, f64::NAN, f64::INFINITY] {
        let refused = PlanOptions::default().with_floor(floor);
        assert!(matches!(refused, Err(ConvError::Floor { .. })), "{floor}");
    }
}

/// Plans that draw stars from all components ignore the floor.
#[test]
fn plans_without_local_bases_drop_nothing() {
    let (pixels, _, kernel, normalisation) = CASES[0];
    let model = model(pixels, 1.3, kernel, normalisation);
    let stars = sources(50, 10.0);
    for anchor in [Anchor::Source, Anchor::Output] {
        let options = |floor: f64| {
            PlanOptions::default()
                .with_anchor(anchor)
                .with_floor(floor)
                .unwrap()
        };
        let image = |floor: f64| {
            let plan = SourcePlan::<f64>::new(&model, options(floor), None).unwrap();
            let dropped = dropped_of(&plan, &stars, &[], frame());
            assert_eq!((dropped.largest(), dropped.fraction()), (0.0, 0.0));
            drawn(&plan, &stars, frame())
        };
        assert_eq!(image(0.1), image(0.0));
    }
}
