//! Tests of blocks with many stars, which are drawn by transforms. A few stars at a time are drawn one
//! by one, so both ways are compared.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::sync::Arc;

use common::{Waves, drawn, largest_difference, peak, region};
use conv_core::{ConvReal, PlanOptions, SourcePlan};
use ndarray::{Array2, s};
use psf_types::{
    NoProgress, Normalisation, PixelRegion, PointSource, Position, PsfBasis, PsfModel, StampGrid,
    StampInterpolation,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Stars that are drawn together without transforms. No block of these has enough stars for them.
const FEW: usize = 20;

/// Two whole blocks and parts of others, within the scene.
fn frame() -> PixelRegion {
    region(13, 7, 520, 300)
}

/// A pixel (row and column) that no star lights.
const HOLE: (usize, usize) = (120, 130);

/// Stars on the frame, at its edges and outside, but not around the hole.
fn stars(count: usize) -> Vec<PointSource> {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut star = |_| {
        let x = rng.random_range(-20.0..560.0);
        let y = rng.random_range(-20.0..330.0);
        PointSource::new(Position::new(x, y).unwrap(), rng.random_range(0.1..4.0)).unwrap()
    };
    let hole = Position::of_pixel(HOLE.1 as i64 + frame().x0(), HOLE.0 as i64 + frame().y0());
    let is_far = |star: &PointSource| {
        let p = star.position();
        (p.x() - hole.x()).abs().max((p.y() - hole.y()).abs()) > 50.0
    };
    (0..count).map(&mut star).filter(is_far).collect()
}

fn model(side: usize, oversampling: f64, centre: (f64, f64), kernel: StampInterpolation) -> PsfModel {
    let model = common::model_with(
        Arc::new(Waves),
        (side, side - 3),
        (0, 0),
        false,
        Normalisation::Keep,
    );
    let grid = StampGrid::new(side, side - 3)
        .and_then(|g| g.with_oversampling(oversampling))
        .and_then(|g| g.with_centre(centre.0, centre.1))
        .unwrap()
        .with_interpolation(kernel);
    let basis = PsfBasis::new(None, model.stamps().to_owned(), grid).unwrap();
    PsfModel::new(&basis, Arc::new(Waves), Normalisation::Keep, None).unwrap()
}

/// A model of stamps at the frame's scale.
fn plain() -> PsfModel {
    model(41, 1.0, (20.0, 18.0), StampInterpolation::CubicSpline)
}

fn plan<T: ConvReal>(model: &PsfModel) -> SourcePlan<T> {
    SourcePlan::new(model, PlanOptions::new(1e-4).unwrap(), None).unwrap()
}

/// The sum of images of a few stars each.
fn few_at_a_time<T: ConvReal>(plan: &SourcePlan<T>, stars: &[PointSource]) -> Array2<f64> {
    let zeros = Array2::zeros((frame().shape().ny(), frame().shape().nx()));
    let images = stars.chunks(FEW).map(|some| drawn(plan, some, frame()));
    images.fold(zeros, |sum, image| sum + image.mapv(T::as_f64))
}

/// Light beyond the reach of a stamp, and rounding, relative to the peak of the image.
const BEYOND: f64 = 5e-7;

#[test]
fn crowds_are_drawn_as_single_stars_are() {
    use StampInterpolation::{CubicSpline, Lanczos3};
    for (side, oversampling, centre, kernel, count) in [
        (41, 1.0, (20.0, 18.0), CubicSpline, 4000),
        (41, 1.0, (20.5, 19.25), CubicSpline, 4000),
        (41, 1.0, (20.0, 18.0), Lanczos3, 4000),
        (41, 1.0, (2.0, 33.0), CubicSpline, 4000),
        (64, 2.0, (32.0, 30.5), CubicSpline, 9000),
        (64, 2.0, (32.0, 30.0), Lanczos3, 9000),
        (96, 3.0, (47.5, 46.0), CubicSpline, 30000),
    ] {
        let (model, stars) = (model(side, oversampling, centre, kernel), stars(count));
        let plan = plan::<f64>(&model);
        let (together, apart) = (drawn(&plan, &stars, frame()), few_at_a_time(&plan, &stars));
        let difference = largest_difference(&together, &apart) / peak(&apart);
        assert!(
            difference < BEYOND,
            "{kernel} {oversampling} {centre:?}: {difference:e}"
        );
        // Stars that are drawn one by one leave the hole dark. Transforms leave rounding noise.
        assert_eq!(apart[HOLE], 0.0);
        assert!(
            together[HOLE] != 0.0,
            "{kernel} {oversampling} {centre:?}: transforms must run"
        );
    }
}

/// The rounding noise of a bright star's transform would hide faint stars.
#[test]
fn a_bright_star_does_not_hide_faint_ones() {
    let (model, mut stars) = (plain(), stars(4000));
    let plan = plan::<f32>(&model);
    let faint = drawn(&plan, &stars, frame()).mapv(f64::from);
    let bright = PointSource::new(Position::new(40.3, 150.8).unwrap(), 1e9).unwrap();
    stars.insert(1000, bright);
    let image = drawn(&plan, &stars, frame()).mapv(f64::from);
    // These pixels are in the block of the bright star. It lights no pixel there.
    let part = s![100..200, 100..180];
    let difference = largest_difference(&image.slice(part).to_owned(), &faint.slice(part).to_owned());
    assert!(difference < 1e-5 * peak(&faint), "{difference:e}");
}

#[test]
fn extreme_fluxes_neither_overflow_nor_vanish() {
    let model = plain();
    let plan = plan::<f32>(&model);
    let ordinary = drawn(&plan, &stars(4000), frame()).mapv(f64::from);
    for factor in [1e-36, 1e34] {
        let scaled: Vec<_> = stars(4000)
            .iter()
            .map(|star| PointSource::new(star.position(), star.flux() * factor).unwrap())
            .collect();
        let image = drawn(&plan, &scaled, frame()).mapv(|v| f64::from(v) / factor);
        let difference = largest_difference(&image, &ordinary) / peak(&ordinary);
        assert!(difference < 1e-5, "{factor:e}: {difference:e}");
    }
}

#[test]
fn the_image_depends_neither_on_threads_nor_on_the_region() {
    let (model, stars) = (plain(), stars(4000));
    let plan = plan::<f32>(&model);
    let image = drawn(&plan, &stars, frame());
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let same = pool.unwrap().install(|| drawn(&plan, &stars, frame()));
        assert_eq!(image, same, "{threads} threads");
    }
    let mut bands = Array2::zeros(image.dim());
    for first in (0..300).step_by(37) {
        let height = 37.min(300 - first);
        let mut band = Array2::zeros((height, 520));
        let band_region = region(0, first as i64, 520, height);
        plan.draw_stars_into(&stars, frame(), band_region, band.view_mut(), &NoProgress)
            .unwrap();
        bands.slice_mut(s![first..first + height, ..]).assign(&band);
    }
    assert_eq!(image, bands);
}

#[test]
fn the_order_of_a_catalogue_changes_only_rounding() {
    let (model, mut stars) = (plain(), stars(4000));
    let plan = plan::<f32>(&model);
    let image = drawn(&plan, &stars, frame()).mapv(f64::from);
    stars.reverse();
    stars.swap(5, 3000);
    let other = drawn(&plan, &stars, frame()).mapv(f64::from);
    assert!(largest_difference(&image, &other) < 1e-5 * peak(&image));
}
