//! The cost of a plan and of its execution, as the plan knows it.

use coeff_field::interpolation;
use conv_core::{Plan, PlanOptions};
use ndarray::{Array2, Array3};
use psf_types::{
    FrameShape, Normalisation, OutsidePolicy, Position, PsfBasis, PsfModel, SampleCoefficients,
    SamplePositions, StampGrid,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const FRAME: usize = 2048;
const CROWD: usize = 1200;
const STAMP: usize = 25;
const COMPONENTS: usize = 100;

/// Tilings are not chosen to the percent.
const MARGIN: f64 = 1.2;

/// Many samples in a spot of 40 pixels, and a few all over the frame. Each pixel of a PSF's core has
/// noise, much more of it in the spot.
fn samples_in_a_spot() -> PsfModel {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut place = || 1300.0 + 40.0 * rng.random_range(0.0..1.0);
    let spot = (0..CROWD).map(|_| Position::new(place(), place()).unwrap());
    let grid = (0..64).map(|i| Position::of_pixel(i % 8 * 292, i / 8 * 292));
    let positions = spot.chain(grid).collect();
    let positions = SamplePositions::new(positions, None).unwrap();
    let middle = STAMP / 2;
    let mean = Array2::from_shape_fn((STAMP, STAMP), |(y, x)| {
        let square = (y as f64 - middle as f64).powi(2) + (x as f64 - middle as f64).powi(2);
        (-square / 2.0).exp()
    });
    // Each component is a pixel of the core.
    let mut components = Array3::zeros((COMPONENTS, STAMP, STAMP));
    for k in 0..COMPONENTS {
        components[[k, middle - 5 + k / 10, middle - 5 + k % 10]] = 1.0;
    }
    let basis = PsfBasis::new(Some(mean), components, StampGrid::new(STAMP, STAMP).unwrap()).unwrap();
    let values = Array2::from_shape_fn((CROWD + 64, COMPONENTS), |(sample, _)| {
        let scale = if sample < CROWD { 0.3 } else { 0.003 };
        scale * rng.random_range(-1.0..1.0)
    });
    let samples = SampleCoefficients::new(values, positions).unwrap();
    let method = interpolation("natural-neighbour".parse().unwrap()).unwrap();
    let field = method.interpolate(&samples, OutsidePolicy::Nearest).unwrap();
    PsfModel::new(&basis, field, Normalisation::Unit, None).unwrap()
}

#[test]
fn a_looser_tolerance_costs_no_more_where_samples_crowd_in_a_spot() {
    let model = samples_in_a_spot();
    let shape = FrameShape::new(FRAME, FRAME).unwrap();
    let plans = [1e-1, 1e-2, 1e-3, 1e-4].map(|tolerance| {
        let options = PlanOptions::new(tolerance).unwrap();
        let plan: Plan<f32> = Plan::new(&model, shape, shape.region(), options).unwrap();
        plan.summary()
    });
    for pair in plans.windows(2) {
        let [loose, tight] = pair else { unreachable!() };
        let coefficients = [loose, tight].map(|plan| plan.kept_bytes.0 as f64);
        assert!(coefficients[0] <= MARGIN * coefficients[1], "{coefficients:?}");
        let seconds = [loose, tight].map(|plan| plan.predicted_seconds);
        assert!(seconds[0] <= MARGIN * seconds[1], "{seconds:?}");
    }
}
