//! Simulates borrowed images, as a whole and by regions.

use ndarray::{Array2, Array3, ArrayView2, s};
use psfield::conv_core::{ConvError, ConvReal, RowStream};
use psfield::psf_types::{
    Anchor, FrameShape, Image, ImageView, Interpolation, NoProgress, Normalisation, OutsidePolicy,
    PixelRegion, PointSource, Position, Progress, PsfSamples, Real, SamplePositions, StampGrid,
};
use psfield::{
    Device, ErrorKind, FitOptions, Method, Psf, PsfieldError, Scene, SimulateOptions, Simulator,
    SimulatorBuilder,
};

/// Columns and rows of the frame, in its own pixels. Both are prime numbers.
const FRAME: (usize, usize) = (97, 83);
/// Columns and rows of light around the frame, in pixels of the frame.
const MARGIN: usize = 9;
const ANCHORS: [Anchor; 2] = [Anchor::Source, Anchor::Output];

/// The largest relative L2 difference between the image made of all regions and the image of the
/// whole frame. It is due to rounding of the transforms.
const SAME_F32: f64 = 1e-6;
const SAME_F64: f64 = 1e-12;

fn gauss(d: f64, sigma: f64) -> f64 {
    (-d * d / (2.0 * sigma * sigma)).exp() / (sigma * (2.0 * std::f64::consts::PI).sqrt())
}

/// Gaussians that widen and move over the field, with two samples per frame pixel. Their positions
/// are on a grid or scattered.
fn psf(interpolation: Interpolation) -> Psf {
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
    Psf::new(PsfSamples::new(stamps, positions, grid).unwrap(), options)
}

/// Columns and rows of a scene, in scene pixels.
fn scene_size(finer: usize) -> (usize, usize) {
    ((FRAME.0 + 2 * MARGIN) * finer, (FRAME.1 + 2 * MARGIN) * finer)
}

/// Light in the frame and around it.
fn light<T: Real>(finer: usize) -> Image<T> {
    let (nx, ny) = scene_size(finer);
    let light = Array2::from_shape_fn((ny, nx), |(y, x)| {
        let pixel = (x * 7919 + y * 104_729 + x * y) % 1000;
        T::nearest(if pixel == 7 { 300.0 } else { pixel as f64 / 500.0 })
    });
    Image::new(light).unwrap()
}

/// Stars, some of them outside the frame.
fn stars(finer: usize) -> Vec<PointSource> {
    let (nx, ny) = scene_size(finer);
    let star = |i: usize| {
        let place = |factor: usize, limit: usize| ((i * factor) % (limit * 10)) as f64 / 10.0;
        // Convert from pixels of the scene to those of the frame.
        let of_frame = |v: f64| (v - (finer as f64 - 1.0) / 2.0) / finer as f64;
        let position = Position::new(of_frame(place(7919, nx)), of_frame(place(104_729, ny)));
        PointSource::new(position.unwrap(), 50.0).unwrap()
    };
    (0..120).map(star).collect()
}

fn region(x0: usize, y0: usize, nx: usize, ny: usize) -> PixelRegion {
    PixelRegion::new(x0 as i64, y0 as i64, FrameShape::new(nx, ny).unwrap())
}

fn options(finer: usize, anchor: Anchor, tolerance: f64) -> SimulateOptions {
    SimulateOptions {
        tolerance,
        anchor,
        oversample: finer,
        frame: Some(region(MARGIN, MARGIN, FRAME.0, FRAME.1)),
        device: Device::Cpu,
        ..SimulateOptions::default()
    }
}

/// A builder for scenes that reach beyond the frame.
fn builder(interpolation: Interpolation, finer: usize) -> SimulatorBuilder {
    let (nx, ny) = scene_size(finer);
    psf(interpolation).simulator((ny, nx))
}

/// Returns the options for a part of the frame.
fn of_region(options: &SimulateOptions, part: PixelRegion) -> SimulateOptions {
    SimulateOptions {
        region: Some(part),
        ..options.clone()
    }
}

fn slice_of<T>(whole: ArrayView2<'_, T>, part: PixelRegion) -> ArrayView2<'_, T> {
    let (x, y) = (part.x0() as usize, part.y0() as usize);
    whole.slice_move(s![y..y + part.shape().ny(), x..x + part.shape().nx()])
}

fn norm<T: Real>(values: impl IntoIterator<Item = T>) -> f64 {
    values.into_iter().map(|v| v.as_f64().powi(2)).sum::<f64>().sqrt()
}

fn pieces_are_the_whole<T: ConvReal>(interpolation: Interpolation, finer: usize, anchor: Anchor, same: f64) {
    let case = format!("{interpolation:?} {} {finer} {anchor}", T::NAME);
    let (builder, options) = (builder(interpolation, finer), options(finer, anchor, 1e-3));
    let build = |options| builder.clone().options(options).build::<T>().unwrap();
    let (light, stars) = (light::<T>(finer), stars(finer));
    let scene = Scene::from(&light).with_stars(&stars[..]);
    let whole = build(options.clone()).simulate(&scene).unwrap();
    let first = build(of_region(&options, region(0, 0, 1, 1)));
    let mut image = Array2::from_elem((FRAME.1, FRAME.0), T::nan());
    let (columns, rows) = ([0, 30, 61, 62, FRAME.0], [0, 41, FRAME.1]);
    for x in columns.windows(2) {
        for y in rows.windows(2) {
            let part = region(x[0], y[0], x[1] - x[0], y[1] - y[0]);
            let simulator = first.for_region(part, &NoProgress).unwrap();
            assert_eq!(simulator.options().region, Some(part));
            assert_eq!(simulator.image_shape(), part.shape());
            // The part of the scene that a machine needs to simulate one region.
            let reach = simulator.light_region(&NoProgress).unwrap();
            let at_hand = slice_of(light.pixels(), reach).to_owned();
            let at_hand = ImageView::new(at_hand.view()).unwrap();
            let mut piece = image.slice_mut(s![y[0]..y[1], x[0]..x[1]]);
            piece.fill(T::zero());
            let of_piece = Scene::from(at_hand).with_stars(&stars[..]);
            simulator.simulate_into(&of_piece, piece, &NoProgress).unwrap();
            // The result equals that of a plan made directly for the region, with the whole scene.
            let again = build(of_region(&options, part)).simulate(&scene).unwrap();
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
            let (builder, options) = (
                builder(Interpolation::Delaunay, finer),
                options(finer, anchor, 1e-2),
            );
            let light = light::<f64>(finer);
            let part = of_region(&options, region(31, 17, 41, 29));
            for (whole, options) in [(true, options), (false, part)] {
                let simulator = builder.clone().options(options).build().unwrap();
                let image = simulator.simulate(&Scene::from(&light)).unwrap();
                let (ny, nx) = image.pixels().dim();
                let seen = Array2::from_shape_fn((ny, nx), |(y, x)| ((x * 31 + y * 17) % 23) as f64 - 11.0);
                let view = ImageView::new(seen.view()).unwrap();
                let back = simulator.adjoint(&view, &NoProgress).unwrap().remove(0);
                let reach = simulator.light_region(&NoProgress).unwrap();
                let of_light = if whole { light.shape().region() } else { reach };
                assert_eq!(back.shape(), of_light.shape());
                let left = (&image.pixels() * &seen).sum();
                let right = (&slice_of(light.pixels(), of_light) * &back.pixels()).sum();
                let scale = norm(image.pixels().iter().copied()) * norm(seen.iter().copied());
                assert!(
                    (left - right).abs() <= 1e-12 * scale,
                    "{finer} {anchor}: {left} {right}"
                );
                // The adjoint is 0 for light that does not reach the image.
                let lit = |pixels: ArrayView2<'_, f64>| pixels.iter().filter(|v| **v != 0.0).count();
                if whole {
                    assert_eq!(lit(back.pixels()), lit(slice_of(back.pixels(), reach)));
                }
            }
        }
    }
}

/// A stream of rows from an array, which collects the rows of the image.
struct Rows<'a, T> {
    light: ArrayView2<'a, T>,
    written: Vec<T>,
}

impl<T: ConvReal> RowStream<T> for Rows<'_, T> {
    type Error = PsfieldError;
    fn read(
        &mut self,
        _layer: usize,
        rows: std::ops::Range<usize>,
        mut light: ndarray::ArrayViewMut2<'_, T>,
    ) -> Result<(), PsfieldError> {
        light.assign(&self.light.slice(s![rows, ..]));
        Ok(())
    }
    fn write(&mut self, rows: ArrayView2<'_, T>) -> Result<(), PsfieldError> {
        self.written.extend(rows);
        Ok(())
    }
}

#[test]
fn a_region_streams_and_is_checked_pixel_by_pixel() {
    for finer in [1, 2] {
        for anchor in ANCHORS {
            let part = region(31, 17, 41, 29);
            let options = of_region(&options(finer, anchor, 0.0), part);
            let builder = builder(Interpolation::Bilinear, finer).options(options);
            let simulator: Simulator<f64> = builder.build().unwrap();
            let (light, stars) = (light::<f64>(finer), stars(finer));
            let scene = Scene::from(&light).with_stars(&stars[..]);
            let image = simulator.simulate(&scene).unwrap();
            let mut rows = Rows {
                light: light.pixels(),
                written: Vec::new(),
            };
            let by_rows = Scene::streamed().with_stars(&stars[..]);
            let (_, check) = simulator
                .stream(&by_rows, &mut rows, (20, 1), &NoProgress)
                .unwrap();
            assert_eq!(check.unwrap().passed, Some(true), "{finer} {anchor}");
            assert!(image.pixels().iter().eq(&rows.written), "{finer} {anchor}");

            let reach = simulator.light_region(&NoProgress).unwrap();
            let at_hand = ImageView::new(slice_of(light.pixels(), reach)).unwrap();
            let of_piece = Scene::from(at_hand).with_stars(&stars[..]);
            let pixels = [(0, 0), (40, 28), (19, 13)];
            for scene in [&scene, &of_piece] {
                let exact = simulator.exact_at(scene, &pixels, &NoProgress).unwrap();
                for ((x, y), exact) in pixels.into_iter().zip(exact) {
                    let value = image.pixels()[[y, x]];
                    assert!((value - exact).abs() <= 1e-9 * exact.abs(), "{value} {exact}");
                }
            }
        }
    }
}

/// Cancels every call at once.
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
    let (builder, options) = (
        builder(Interpolation::Bilinear, 2),
        options(2, Anchor::Source, 1e-3),
    );
    let build = |options| builder.clone().options(options).build::<f32>().unwrap();
    let (light, stars) = (light::<f32>(2), stars(2));
    let scene = Scene::from(&light).with_stars(&stars[..]);
    let stars_alone = Scene::dark().with_stars(&stars[..]);
    let simulator = build(options.clone());
    simulator.prepare(&scene, &NoProgress).unwrap();
    let stopped = |result: Result<(), PsfieldError>| {
        let error = result.unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Cancelled);
        assert!(
            matches!(error.cause(), Some(ConvError::Cancelled(_))),
            "{error:?}"
        );
    };
    let mut image = Array2::zeros((FRAME.1, FRAME.0));
    let part = region(3, 4, 5, 6);
    for scene in [&scene, &stars_alone] {
        let stars_too = simulator.simulate_into(scene, image.view_mut(), &Impatient);
        stopped(stars_too.map(|_| ()));
    }
    let view = ImageView::new(image.view()).unwrap();
    stopped(simulator.adjoint(&view, &Impatient).map(|_| ()));
    let of_part = build(of_region(&options, part));
    stopped(of_part.prepare(&scene, &Impatient).map(|_| ()));
    stopped(simulator.for_region(part, &Impatient).map(|_| ()));
    let fresh = build(options.clone());
    let by_rows = Scene::streamed().with_stars(&stars[..]);
    stopped(fresh.prepare(&by_rows, &Impatient).map(|_| ()));
    stopped(simulator.exact_at(&scene, &[(1, 1)], &Impatient).map(|_| ()));
    let mut rows = Rows {
        light: light.pixels(),
        written: Vec::new(),
    };
    let stream = simulator.stream(&by_rows, &mut rows, (0, 0), &Impatient);
    stopped(stream.map(|_| ()));

    let beyond = of_region(&options, region(90, 0, 8, 4));
    let beyond = builder.clone().options(beyond).build::<f32>();
    assert_eq!(
        beyond.unwrap_err().to_string(),
        "the region of 8 x 4 pixels at (90, 0) reaches beyond the frame of 97 x 83 pixels"
    );
    let mut wide = Array2::zeros((FRAME.1, FRAME.0 + 1));
    let refused = simulator.simulate_into(&scene, wide.view_mut(), &NoProgress);
    let error = refused.unwrap_err();
    assert!(
        matches!(error.cause(), Some(ConvError::FrameShape { .. })),
        "{error:?}"
    );
}

#[test]
fn methods_without_a_plan_say_what_they_cannot_do() {
    let options = SimulateOptions {
        method: Method::Basis,
        ..options(1, Anchor::Source, 1e-3)
    };
    let builder = builder(Interpolation::Bilinear, 1);
    let part = of_region(&options, region(3, 4, 5, 6));
    let assert_needs_plan = |error: PsfieldError, what: &str| {
        assert_eq!(
            (error.kind(), error.setting()),
            (ErrorKind::Setting, Some("method"))
        );
        let start = format!("{what} only by the methods auto and lowrank");
        assert!(error.to_string().starts_with(&start), "{error}");
    };
    let refused = builder.clone().options(part).build::<f64>();
    assert_needs_plan(refused.unwrap_err(), "a region of the frame can be computed");

    let simulator: Simulator<f64> = builder.options(options).build().unwrap();
    let refused = simulator.for_region(region(3, 4, 5, 6), &NoProgress);
    assert_needs_plan(refused.unwrap_err(), "a region of the frame can be computed");
    let seen = Image::zeros(simulator.image_shape());
    let refused = simulator.adjoint(&seen.view(), &NoProgress);
    assert_needs_plan(refused.unwrap_err(), "the adjoint can be computed");
    assert_needs_plan(simulator.blocks(&NoProgress).unwrap_err(), "blocks are made");
    let refused = simulator.plan_arrays(&NoProgress);
    assert_needs_plan(refused.unwrap_err(), "arrays of plans are made");
    let light = light::<f64>(1);
    let mut rows = Rows {
        light: light.pixels(),
        written: Vec::new(),
    };
    let refused = simulator.stream(&Scene::streamed(), &mut rows, (0, 0), &NoProgress);
    assert_needs_plan(refused.unwrap_err(), "rows can be streamed");
    assert!(rows.written.is_empty());
}
