//! Simulations on pixels that belong to somebody else, whole and in pieces.

use ndarray::{Array2, Array3, ArrayView2, s};
use psfield::conv_core::{ConvError, ConvReal, PlanOptions, RowStream};
use psfield::psf_types::{
    Anchor, FrameShape, Image, ImageView, Interpolation, NoProgress, Normalisation, OutsidePolicy,
    PixelRegion, PointSource, Position, Progress, PsfSamples, Real, SamplePositions, Scene, StampGrid,
};
use psfield::{FitOptions, PsfInput, PsfieldError, Simulation, SimulationOptions};

/// Columns and rows of the frame, in its own pixels: primes.
const FRAME: (usize, usize) = (97, 83);
/// Columns and rows around the frame whose light comes in, in pixels of the frame.
const MARGIN: usize = 9;
const ANCHORS: [Anchor; 2] = [Anchor::Source, Anchor::Output];

/// Pieces against the whole, relative L2: rounding of transforms.
const SAME_F32: f64 = 1e-6;
const SAME_F64: f64 = 1e-12;

fn gauss(d: f64, sigma: f64) -> f64 {
    (-d * d / (2.0 * sigma * sigma)).exp() / (sigma * (2.0 * std::f64::consts::PI).sqrt())
}

/// Gaussians that widen and move over the field, two samples to a frame pixel, at places on a grid or scattered.
fn samples(interpolation: Interpolation) -> PsfInput {
    let n = 25;
    let grid = StampGrid::new(n, n)
        .and_then(|grid| grid.with_oversampling(2.0))
        .unwrap()
        .with_pixel_response_included(false);
    let places: Vec<(f64, f64)> = if interpolation == Interpolation::Bilinear {
        (0..16)
            .map(|i| (f64::from(i % 4) * 32.0, f64::from(i / 4) * 82.0 / 3.0))
            .collect()
    } else {
        (0..23)
            .map(|i| (f64::from(i * 37 % 97), f64::from(i * 29 % 83)))
            .collect()
    };
    let stamps = Array3::from_shape_fn((places.len(), n, n), |(j, y, x)| {
        let (u, v) = (places[j].0 / 97.0, places[j].1 / 83.0);
        let at = |i: usize| (i as f64 - (n / 2) as f64) / 2.0;
        gauss(at(x) - 0.3 * u * v, 1.0 + 0.3 * u) * gauss(at(y), 1.1 + 0.2 * v)
    });
    let positions = places
        .iter()
        .map(|&(x, y)| Position::new(x, y).unwrap())
        .collect();
    let field = FrameShape::new(FRAME.0, FRAME.1).unwrap();
    let positions = SamplePositions::new(positions, Some(field)).unwrap();
    let options = FitOptions {
        normalisation: Normalisation::Unit,
        interpolation,
        outside: OutsidePolicy::Nearest,
        ..FitOptions::default()
    };
    PsfInput::Samples(PsfSamples::new(stamps, positions, grid).unwrap(), options)
}

/// A scene with light around the frame and stars, some of them off the frame.
fn scene<T: Real>(finer: usize) -> Scene<T> {
    let (nx, ny) = ((FRAME.0 + 2 * MARGIN) * finer, (FRAME.1 + 2 * MARGIN) * finer);
    let light = Array2::from_shape_fn((ny, nx), |(y, x)| {
        let pixel = (x * 7919 + y * 104_729 + x * y) % 1000;
        T::nearest(if pixel == 7 { 300.0 } else { pixel as f64 / 500.0 })
    });
    let shape = FrameShape::new(FRAME.0 * finer, FRAME.1 * finer).unwrap();
    let first = (MARGIN * finer) as i64;
    let star = |i: usize| {
        let place = |factor: usize, limit: usize| ((i * factor) % (limit * 10)) as f64 / 10.0;
        PointSource::new(Position::new(place(7919, nx), place(104_729, ny)).unwrap(), 50.0).unwrap()
    };
    Scene::from_image(Image::new(light).unwrap())
        .with_frame(PixelRegion::new(first, first, shape))
        .unwrap()
        .with_sources((0..120).map(star).collect())
}

fn region(x0: usize, y0: usize, nx: usize, ny: usize) -> PixelRegion {
    PixelRegion::new(x0 as i64, y0 as i64, FrameShape::new(nx, ny).unwrap())
}

fn simulation(interpolation: Interpolation, finer: usize, anchor: Anchor) -> Simulation {
    let options = SimulationOptions::default()
        .with_oversample(finer)
        .unwrap()
        .with_anchor(anchor);
    Simulation::new(samples(interpolation), &scene::<f32>(finer), options).unwrap()
}

fn slice_of<T>(whole: ArrayView2<'_, T>, part: PixelRegion) -> ArrayView2<'_, T> {
    let (x, y) = (part.x0() as usize, part.y0() as usize);
    whole.slice_move(s![y..y + part.shape().ny(), x..x + part.shape().nx()])
}

fn norm<T: Real>(values: impl IntoIterator<Item = T>) -> f64 {
    values.into_iter().map(|v| v.as_f64().powi(2)).sum::<f64>().sqrt()
}

/// The same scene without its light: what is at hand on a machine that makes a piece.
fn outline<T: ConvReal>(scene: &Scene<T>) -> Scene<T> {
    Scene::dark(scene.shape())
        .with_frame(scene.frame())
        .unwrap()
        .with_sources(scene.sources().to_vec())
}

fn pieces_are_the_whole<T: ConvReal>(interpolation: Interpolation, finer: usize, anchor: Anchor, same: f64) {
    let case = format!("{interpolation:?} {} {finer} {anchor}", T::NAME);
    let simulation = simulation(interpolation, finer, anchor);
    let scene = scene::<T>(finer);
    let options = PlanOptions::new(1e-3).unwrap().with_anchor(anchor);
    let plan = simulation.plan(&scene, options).unwrap();
    let (whole, _) = simulation.run_planned(&plan, &scene, &NoProgress).unwrap();
    let outline = outline(&scene);
    let first = simulation
        .plan_for_region(&outline, region(0, 0, 1, 1), options, &NoProgress)
        .unwrap();
    let mut image = Array2::from_elem((FRAME.1, FRAME.0), T::nan());
    let (columns, rows) = ([0, 30, 61, 62, FRAME.0], [0, 41, FRAME.1]);
    for x in columns.windows(2) {
        for y in rows.windows(2) {
            let part = region(x[0], y[0], x[1] - x[0], y[1] - y[0]);
            let plan = simulation
                .plan_for_other_region(&first, &outline, part, &NoProgress)
                .unwrap();
            assert_eq!(plan.region(), Some(part));
            let light = slice_of(scene.pixels().unwrap(), plan.light_region().unwrap()).to_owned();
            let mut piece = image.slice_mut(s![y[0]..y[1], x[0]..x[1]]);
            piece.fill(T::zero());
            let light = ImageView::new(light.view()).unwrap();
            simulation
                .add_planned_to(&plan, &outline, Some(&light), piece, &NoProgress)
                .unwrap();
            // The plan that is made at once, and the scene as a whole.
            let plan = simulation
                .plan_for_region(&outline, part, options, &NoProgress)
                .unwrap();
            let (again, _) = simulation.run_planned(&plan, &scene, &NoProgress).unwrap();
            assert_eq!(again.pixels(), slice_of(image.view(), part), "{case}");
        }
    }
    let error = norm(&image - &whole.pixels()) / norm(whole.pixels().iter().copied());
    assert!(error <= same, "{case}: {error:e}");
}

#[test]
fn pieces_put_together_are_the_whole() {
    for interpolation in [Interpolation::Delaunay, Interpolation::Bilinear] {
        for finer in [1, 2, 3] {
            for anchor in ANCHORS {
                pieces_are_the_whole::<f32>(interpolation, finer, anchor, SAME_F32);
                pieces_are_the_whole::<f64>(interpolation, finer, anchor, SAME_F64);
            }
        }
    }
}

#[test]
fn the_adjoint_is_that_of_light_sampled_at_the_frames_pixels() {
    for finer in [1, 2, 3] {
        for anchor in ANCHORS {
            let simulation = simulation(Interpolation::Delaunay, finer, anchor);
            let scene = scene::<f64>(finer).with_sources(Vec::new());
            let options = PlanOptions::new(1e-2).unwrap().with_anchor(anchor);
            let whole = simulation.plan_for_images(&scene, options).unwrap();
            let part = simulation
                .plan_for_region(&scene, region(31, 17, 41, 29), options, &NoProgress)
                .unwrap();
            for plan in [whole, part] {
                let (image, _) = simulation.run_planned(&plan, &scene, &NoProgress).unwrap();
                let (ny, nx) = image.pixels().dim();
                let seen = Array2::from_shape_fn((ny, nx), |(y, x)| ((x * 31 + y * 17) % 23) as f64 - 11.0);
                let view = ImageView::new(seen.view()).unwrap();
                let back = simulation.adjoint_planned(&plan, &view, &NoProgress).unwrap();
                assert_eq!(back.shape(), scene.shape());
                let left = (&image.pixels() * &seen).sum();
                let right = (&scene.pixels().unwrap() * &back.pixels()).sum();
                let scale = norm(image.pixels().iter().copied()) * norm(seen.iter().copied());
                assert!(
                    (left - right).abs() <= 1e-12 * scale,
                    "{finer} {anchor}: {left} {right}"
                );
                let reach = plan.light_region().unwrap();
                let mut plane = Array2::zeros((reach.shape().ny(), reach.shape().nx()));
                simulation
                    .add_adjoint_planned_to(&plan, &view, plane.view_mut(), &NoProgress)
                    .unwrap();
                assert_eq!(plane, slice_of(back.pixels(), reach));
            }
        }
    }
}

/// Images of a region, row by row.
struct Rows<'a> {
    light: ArrayView2<'a, f64>,
    written: Vec<f64>,
}

impl RowStream<f64> for Rows<'_> {
    type Error = PsfieldError;
    fn read(
        &mut self,
        rows: std::ops::Range<usize>,
        mut light: ndarray::ArrayViewMut2<'_, f64>,
    ) -> Result<(), PsfieldError> {
        light.assign(&self.light.slice(s![rows, ..]));
        Ok(())
    }
    fn write(&mut self, rows: ArrayView2<'_, f64>) -> Result<(), PsfieldError> {
        self.written.extend(rows);
        Ok(())
    }
}

#[test]
fn a_region_streams_and_is_checked_pixel_by_pixel() {
    for finer in [1, 2] {
        for anchor in ANCHORS {
            let simulation = simulation(Interpolation::Bilinear, finer, anchor);
            let scene = scene::<f64>(finer);
            let options = PlanOptions::new(0.0).unwrap().with_anchor(anchor);
            let part = region(31, 17, 41, 29);
            let plan = simulation
                .plan_for_region(&scene, part, options, &NoProgress)
                .unwrap();
            let (image, _) = simulation.run_planned(&plan, &scene, &NoProgress).unwrap();
            let mut rows = Rows {
                light: scene.pixels().unwrap(),
                written: Vec::new(),
            };
            simulation.stream(&plan, &scene, &mut rows, &NoProgress).unwrap();
            assert!(image.pixels().iter().eq(&rows.written), "{finer} {anchor}");

            let reach = plan.light_region().unwrap();
            let light = slice_of(scene.pixels().unwrap(), reach);
            let light = ImageView::new(light).unwrap();
            let first = (reach.x0() as usize, reach.y0() as usize);
            let pixels = [(31, 17), (71, 45), (50, 30)];
            let exact = simulation
                .exact_at_part(&scene, Some((&light, first)), anchor, &pixels, &NoProgress)
                .unwrap();
            for ((x, y), exact) in pixels.into_iter().zip(exact) {
                let value = image.pixels()[[y - 17, x - 31]];
                assert!((value - exact).abs() <= 1e-9 * exact.abs(), "{value} {exact}");
            }
        }
    }
}

/// Wants everything to stop at once.
struct Impatient;

impl Progress for Impatient {
    fn start(&self, _: u64) {}
    fn advance(&self, _: u64) {}
    fn cancelled(&self) -> bool {
        true
    }
}

#[test]
fn every_call_can_be_stopped_and_errors_say_what_fits() {
    let simulation = simulation(Interpolation::Bilinear, 2, Anchor::Source);
    let scene = scene::<f32>(2);
    let options = PlanOptions::new(1e-3).unwrap();
    let plan = simulation.plan(&scene, options).unwrap();
    let stopped = |result: Result<(), PsfieldError>| match result {
        Err(PsfieldError::Convolution(ConvError::Cancelled(_))) => {}
        other => panic!("{other:?}"),
    };
    let light = scene.image().unwrap().view();
    let mut image = Array2::zeros((FRAME.1, FRAME.0));
    let part = region(3, 4, 5, 6);
    stopped(simulation.run_planned(&plan, &scene, &Impatient).map(|_| ()));
    for light in [Some(&light), None] {
        let stars_too = simulation.add_planned_to(&plan, &scene, light, image.view_mut(), &Impatient);
        stopped(stars_too.map(|_| ()));
    }
    let view = ImageView::new(image.view()).unwrap();
    stopped(simulation.adjoint_planned(&plan, &view, &Impatient).map(|_| ()));
    stopped(
        simulation
            .plan_for_region(&scene, part, options, &Impatient)
            .map(|_| ()),
    );
    stopped(
        simulation
            .plan_for_other_region(&plan, &scene, part, &Impatient)
            .map(|_| ()),
    );
    stopped(
        simulation
            .plan_for_images_with_progress(&scene, options, &Impatient)
            .map(|_| ()),
    );
    let exact = simulation.exact_at_part(
        &scene,
        Some((&light, (0, 0))),
        Anchor::Source,
        &[(1, 1)],
        &Impatient,
    );
    stopped(exact.map(|_| ()));

    let beyond = simulation.plan_for_region(&scene, region(90, 0, 8, 4), options, &NoProgress);
    assert_eq!(
        beyond.unwrap_err().to_string(),
        "the region of 8 x 4 pixels at (90, 0) reaches beyond the frame of 97 x 83 pixels"
    );
    let stars = simulation.plan(&outline(&scene), options).unwrap();
    let refused = simulation.add_planned_to(&stars, &scene, Some(&light), image.view_mut(), &NoProgress);
    assert!(matches!(refused, Err(PsfieldError::PlanForStars)), "{refused:?}");
    let mut wide = Array2::zeros((FRAME.1, FRAME.0 + 1));
    let refused = simulation.add_planned_to(&plan, &scene, Some(&light), wide.view_mut(), &NoProgress);
    assert!(
        matches!(
            refused,
            Err(PsfieldError::Convolution(ConvError::FrameShape { .. }))
        ),
        "{refused:?}"
    );
}
