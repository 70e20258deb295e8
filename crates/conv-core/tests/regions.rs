//! Tests of frames that are computed region by region.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::slice::from_ref;
use std::sync::Arc;

use common::grid_field::GridField;
use common::{ANCHORS, Execute, PATHS, Scene, Waves, drawn, model_with, noise, options, region};
use conv_core::{ConvError, ConvReal, Engine, Operation, Plan, PlanOptions, RowStream, SourcePlan};
use ndarray::{Array2, ArrayView2, ArrayViewMut2, s};
use psf_types::{
    Anchor, FrameShape, Image, ImageView, NoProgress, Normalisation, PixelRegion, PointSource, Position,
    PsfModel,
};

/// Relative L2 difference between the regions put together and the whole frame: rounding of f32
/// transforms.
const SAME_F32: f64 = 1e-6;
/// The difference for the adjoint. Sums of noise with stamps of noise nearly cancel. So even for
/// the whole frame, f32 and f64 differ by 1.3e-6.
const SAME_ADJOINT_F32: f64 = 3e-6;
/// Forward and adjoint in f64.
const SAME_F64: f64 = 1e-13;
const F32: (f64, f64) = (SAME_F32, SAME_ADJOINT_F32);
const F64: (f64, f64) = (SAME_F64, SAME_F64);
/// Rounding of scalar products in f64.
const ROUNDING_F64: f64 = 1e-12;

const SCENE: (usize, usize) = (211, 163);

/// A field with grid lines that tiles can follow.
fn grid() -> GridField {
    let values = noise(NODES * NODES, 3, 21).mapv(|v| 0.2 * v);
    GridField::new(STEP, NODES, values)
}

const STEP: f64 = 37.25;
const NODES: usize = 6;

fn models() -> [(&'static str, PsfModel); 3] {
    [
        (
            "grid",
            model_with(Arc::new(grid()), (13, 11), (6, 5), true, Normalisation::Unit),
        ),
        (
            "waves",
            model_with(Arc::new(Waves), (6, 9), (1, 6), true, Normalisation::Keep),
        ),
        (
            "no mean",
            model_with(Arc::new(grid()), (9, 5), (4, 2), false, Normalisation::Keep),
        ),
    ]
}

/// Light everywhere or, if `full` is false, in about every hundredth pixel. One star is very
/// bright.
fn light(full: bool) -> Image<f64> {
    let mut light = noise(SCENE.1, SCENE.0, 8).mapv(|v| v + 1.5);
    if !full {
        for ((y, x), value) in light.indexed_iter_mut() {
            if (7 * y + 3 * x) % 101 != 0 {
                *value = 0.0;
            }
        }
    }
    light[[77, 93]] = 500.0;
    Image::new(light).unwrap()
}

fn of_precision<T: ConvReal>(image: &Image<f64>) -> Image<T> {
    Image::new(image.pixels().mapv(T::nearest)).unwrap()
}

/// The whole scene, and a frame within it that receives light from all sides.
fn frames() -> [PixelRegion; 2] {
    [region(0, 0, SCENE.0, SCENE.1), region(23, 17, 151, 127)]
}

/// Divides a frame into `across` by `up` regions of nearly equal size.
fn pieces(frame: FrameShape, across: usize, up: usize) -> Vec<PixelRegion> {
    let cut = |length: usize, count: usize, i: usize| i * length / count;
    (0..up)
        .flat_map(|j| (0..across).map(move |i| (i, j)))
        .map(|(i, j)| {
            let (x, y) = (cut(frame.nx(), across, i), cut(frame.ny(), up, j));
            let (to_x, to_y) = (cut(frame.nx(), across, i + 1), cut(frame.ny(), up, j + 1));
            region(x as i64, y as i64, to_x - x, to_y - y)
        })
        .collect()
}

fn slice_of<T>(whole: ArrayView2<'_, T>, part: PixelRegion) -> ArrayView2<'_, T> {
    let (x, y) = (part.x0() as usize, part.y0() as usize);
    whole.slice_move(s![y..y + part.shape().ny(), x..x + part.shape().nx()])
}

/// An engine for another region of the same frame.
fn other<T: ConvReal>(engine: &Engine<T>, region: PixelRegion) -> Engine<T> {
    Engine::new(engine.plan().for_other_region(region, &NoProgress).unwrap())
}

/// The image of a region, computed only from the light that reaches it.
fn image_of<T: ConvReal>(engine: &Engine<T>, light: &Image<T>) -> Array2<T> {
    let cut = slice_of(light.pixels(), engine.plan().light_region()).to_owned();
    let mut image = engine.plan().zeros();
    engine
        .execute(
            Operation::Convolve,
            from_ref(&ImageView::new(cut.view()).unwrap()),
            vec![image.view_mut()],
            &NoProgress,
        )
        .unwrap();
    image
}

fn relative_l2<T: ConvReal>(image: ArrayView2<'_, T>, truth: ArrayView2<'_, T>) -> f64 {
    assert_eq!(image.dim(), truth.dim());
    let square = |sum: f64, v: f64| sum + v * v;
    let pairs = image.iter().zip(truth).map(|(a, b)| a.as_f64() - b.as_f64());
    (pairs.fold(0.0, square) / truth.iter().map(|v| v.as_f64()).fold(0.0, square)).sqrt()
}

/// Compares the results of all regions, put together, with the result of the whole frame, forward
/// and adjoint.
fn compare<T: ConvReal>(
    case: &str,
    whole: &Engine<T>,
    light: &Image<T>,
    regions: &[PixelRegion],
    ((same, same_back), make): ((f64, f64), &dyn Fn(PixelRegion) -> Engine<T>),
) {
    let scene = Scene::new(light.pixels().to_owned()).with_frame(whole.plan().frame());
    let truth = whole.image_of(&scene).unwrap();
    let seen = of_precision::<T>(&Image::new(noise(truth.shape().ny(), truth.shape().nx(), 31)).unwrap());
    let back = whole.adjoint(&seen).unwrap();
    let mut image = Array2::from_elem(truth.pixels().dim(), T::nan());
    let mut sum = Array2::zeros(back.pixels().dim());
    for &part in regions {
        let engine = make(part);
        assert_eq!(engine.plan().region(), part);
        let made = image_of(&engine, light);
        let (x, y) = (part.x0() as usize, part.y0() as usize);
        image
            .slice_mut(s![y..y + made.nrows(), x..x + made.ncols()])
            .assign(&made);
        // The transpose of the whole is the sum of the transposes of its parts.
        let cut = slice_of(seen.pixels(), part);
        engine
            .execute(
                Operation::Adjoint,
                from_ref(&ImageView::new(cut).unwrap()),
                vec![sum.view_mut()],
                &NoProgress,
            )
            .unwrap();
    }
    let error = relative_l2(image.view(), truth.pixels());
    assert!(error <= same, "{case}: {error:e}");
    let error = relative_l2(sum.view(), back.pixels());
    assert!(error <= same_back, "adjoint, {case}: {error:e}");
}

#[test]
fn pieces_put_together_are_the_whole() {
    for (name, model) in models() {
        for (n, frame) in frames().into_iter().enumerate() {
            for anchor in ANCHORS {
                for (m, tolerance) in [1e-1, 1e-3, 0.0].into_iter().enumerate() {
                    let options = options(tolerance, anchor, PATHS[(n + m) % 2]);
                    let (nx, ny) = SCENE;
                    let shape = FrameShape::new(nx, ny).unwrap();
                    let whole = Engine::new(Plan::<f64>::new(&model, shape, frame, options).unwrap());
                    let single = Engine::new(Plan::<f32>::new(&model, shape, frame, options).unwrap());
                    for (across, up) in [(1, 1), (2, 2), (5, 7)] {
                        let regions = pieces(frame.shape(), across, up);
                        for full in [true, false] {
                            let case = format!(
                                "{name} {anchor} {tolerance} {across} x {up}, full {full}, {frame:?}"
                            );
                            let light = light(full);
                            let make = |part| other(&whole, part);
                            compare(&case, &whole, &light, &regions, (F64, &make));
                            let light = of_precision(&light);
                            let make = |part| other(&single, part);
                            compare(&case, &single, &light, &regions, (F32, &make));
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn a_region_chooses_the_tiles_of_the_whole() {
    let shape = FrameShape::new(SCENE.0, SCENE.1).unwrap();
    let frame = frames()[1];
    for (name, model) in models() {
        for anchor in ANCHORS {
            let options = options(1e-3, anchor, PATHS[0]);
            let whole = Engine::new(Plan::<f64>::new(&model, shape, frame, options).unwrap());
            let regions = pieces(frame.shape(), 2, 3);
            let make = |part| {
                Engine::new(Plan::for_region(&model, shape, frame, part, options, &NoProgress).unwrap())
            };
            compare(
                &format!("{name} {anchor}"),
                &whole,
                &light(true),
                &regions,
                (F64, &make),
            );
            for part in regions {
                let (chosen, taken) = (make(part), other(&whole, part));
                assert_eq!(chosen.plan().summary(), taken.plan().summary());
                assert_eq!(
                    chosen.plan().summary().transform,
                    whole.plan().summary().transform
                );
                assert_eq!(image_of(&chosen, &light(true)), image_of(&taken, &light(true)));
            }
            // A plan of any region can make the plan of the whole frame again.
            let part = make(region(3, 4, 1, 1));
            let again = other(&part, frame.shape().region());
            assert_eq!(again.plan().summary(), whole.plan().summary());
            assert_eq!(image_of(&again, &light(true)), image_of(&whole, &light(true)));
        }
    }
}

#[test]
fn blocks_cover_their_side_exactly_once() {
    let shape = FrameShape::new(SCENE.0, SCENE.1).unwrap();
    for (name, model) in models() {
        for (frame, anchor) in frames().into_iter().flat_map(|frame| ANCHORS.map(|a| (frame, a))) {
            let options = options(1e-3, anchor, PATHS[0]);
            let whole = Plan::<f64>::new(&model, shape, frame, options).unwrap();
            for part in [frame.shape().region(), region(40, 31, 53, 47)] {
                let case = format!("{name} {anchor} {part:?} of {frame:?}");
                let plan = whole.for_other_region(part, &NoProgress).unwrap();
                let covered = if anchor == Anchor::Output {
                    part.shifted(frame.x0(), frame.y0())
                } else {
                    plan.light_region()
                };
                let mut expected = Array2::zeros((SCENE.1, SCENE.0));
                let (x, y) = (covered.x0() as usize, covered.y0() as usize);
                let (to_x, to_y) = (x + covered.shape().nx(), y + covered.shape().ny());
                expected.slice_mut(s![y..to_y, x..to_x]).fill(1);
                let mut counts = Array2::zeros((SCENE.1, SCENE.0));
                let mut by_modes = vec![0; plan.summary().blocks_by_modes.len()];
                for (block, modes) in plan.blocks() {
                    let (x, y) = (block.x0() as usize, block.y0() as usize);
                    let (to_x, to_y) = (x + block.shape().nx(), y + block.shape().ny());
                    counts
                        .slice_mut(s![y..to_y, x..to_x])
                        .mapv_inplace(|n: i32| n + 1);
                    by_modes[modes] += 1;
                }
                assert_eq!(counts, expected, "{case}");
                assert_eq!(by_modes, plan.summary().blocks_by_modes, "{case}");
                assert_eq!(plan.blocks().len(), plan.summary().blocks, "{case}");
            }
        }
    }
}

#[test]
fn single_pixels_and_thin_regions_anywhere() {
    let shape = FrameShape::new(SCENE.0, SCENE.1).unwrap();
    for (name, model) in models() {
        for frame in frames() {
            let (nx, ny) = (frame.shape().nx() as i64, frame.shape().ny() as i64);
            for anchor in ANCHORS {
                let engine = Engine::new(
                    Plan::<f64>::new(&model, shape, frame, options(1e-3, anchor, PATHS[0])).unwrap(),
                );
                let light = light(true);
                let scene = Scene::new(light.pixels().to_owned()).with_frame(frame);
                let truth = engine.image_of(&scene).unwrap();
                for part in [
                    region(0, 0, 1, 1),
                    region(nx - 1, 0, 1, 1),
                    region(0, ny - 1, 1, 1),
                    region(nx - 1, ny - 1, 1, 1),
                    region(37, 38, 1, 1),
                    region(70, 0, 1, ny as usize),
                    region(0, 60, nx as usize, 1),
                    region(nx - 2, 13, 2, 53),
                    region(11, ny - 3, 97, 3),
                ] {
                    let case = format!("{name} {anchor} {part:?} of {frame:?}");
                    let engine = other(&engine, part);
                    let error = relative_l2(image_of(&engine, &light).view(), slice_of(truth.pixels(), part));
                    assert!(error <= SAME_F64, "{case}: {error:e}");
                    // The engine also accepts the light of the whole scene.
                    let image = engine.image_of(&scene).unwrap();
                    assert_eq!(image.pixels(), image_of(&engine, &light), "{case}");
                }
            }
        }
    }
}

/// The adjoint of a region writes to the whole light, or only to the part of it that reaches the
/// region.
#[test]
fn a_region_has_its_own_adjoint() {
    let shape = FrameShape::new(SCENE.0, SCENE.1).unwrap();
    let (frame, part) = (frames()[1], region(40, 31, 53, 47));
    for (name, model) in models() {
        for anchor in ANCHORS {
            let options = options(1e-2, anchor, PATHS[0]);
            let engine = Engine::new(
                Plan::<f64>::for_region(&model, shape, frame, part, options, &NoProgress).unwrap(),
            );
            let light = light(true);
            let seen = Image::new(noise(47, 53, 3)).unwrap();
            let image = image_of(&engine, &light);
            let back = engine.adjoint(&seen).unwrap();
            assert_eq!(back.shape(), shape);
            let left = (&image * &seen.pixels()).sum();
            let right = (&light.pixels() * &back.pixels()).sum();
            let norm = |a: ArrayView2<'_, f64>| a.iter().map(|v| v * v).sum::<f64>().sqrt();
            let scale = norm(image.view()) * norm(seen.pixels());
            assert!((left - right).abs() <= ROUNDING_F64 * scale, "{name} {anchor}");
            let mut plane = Array2::zeros(slice_of(back.pixels(), engine.plan().light_region()).dim());
            engine
                .execute(
                    Operation::Adjoint,
                    from_ref(&seen.view()),
                    vec![plane.view_mut()],
                    &NoProgress,
                )
                .unwrap();
            assert_eq!(plane, slice_of(back.pixels(), engine.plan().light_region()));
            let outside = norm(back.pixels()).powi(2) - norm(plane.view()).powi(2);
            assert!(outside.abs() <= 1e-12 * norm(plane.view()).powi(2));
        }
    }
}

/// Light that is read by rows, and an image that is written by rows.
struct Rows<'a> {
    light: ArrayView2<'a, f64>,
    read: Vec<usize>,
    written: Vec<f64>,
}

impl RowStream<f64> for Rows<'_> {
    type Error = ConvError;
    fn read(
        &mut self,
        _layer: usize,
        rows: std::ops::Range<usize>,
        mut light: ArrayViewMut2<'_, f64>,
    ) -> Result<(), ConvError> {
        self.read.extend(rows.clone());
        light.assign(&self.light.slice(s![rows, ..]));
        Ok(())
    }
    fn write(&mut self, rows: ArrayView2<'_, f64>) -> Result<(), ConvError> {
        self.written.extend(rows);
        Ok(())
    }
}

#[test]
fn a_region_streams_its_rows_and_draws_its_stars() {
    let (frame, part) = (frames()[1], region(40, 31, 53, 47));
    let star = |i: usize| {
        let (x, y) = ((i * 37 % SCENE.0) as f64 + 0.3, (i * 53 % SCENE.1) as f64 - 0.1);
        PointSource::new(Position::new(x, y).unwrap(), 1.0 + i as f64).unwrap()
    };
    let scene = Scene::new(light(true).into_pixels()).with_frame(frame);
    let sources: Vec<PointSource> = (0..60).map(star).collect();
    for (name, model) in models() {
        for anchor in ANCHORS {
            let options = options(1e-2, anchor, PATHS[0]);
            let engine = Engine::new(
                Plan::for_region(&model, scene.shape(), frame, part, options, &NoProgress).unwrap(),
            );
            let image = engine.image_of(&scene).unwrap();
            let mut rows = Rows {
                light: scene.pixels(),
                read: Vec::new(),
                written: Vec::new(),
            };
            engine.stream(&mut rows, &NoProgress).unwrap();
            assert!(image.pixels().iter().eq(&rows.written), "{name} {anchor}");
            let reach = engine.plan().light_region();
            let (first, last) = (reach.y0() as usize, reach.y0() as usize + reach.shape().ny() - 1);
            assert!(
                rows.read.iter().all(|row| (first..=last).contains(row)),
                "{name} {anchor}"
            );

            // Stars drawn in the region equal, bit by bit, stars drawn in the whole frame.
            let stars = SourcePlan::<f64>::new(&model, options, None).unwrap();
            let whole = drawn(&stars, &sources, frame);
            let mut of_part = Array2::zeros((47, 53));
            stars
                .draw_stars_into(&sources, frame, part, of_part.view_mut(), &NoProgress)
                .unwrap();
            assert_eq!(of_part, slice_of(whole.view(), part), "{name} {anchor}");
        }
    }
}

#[test]
fn regions_lie_within_the_frame() {
    let shape = FrameShape::new(SCENE.0, SCENE.1).unwrap();
    let frame = frames()[1];
    let [(_, model), ..] = models();
    let options = PlanOptions::new(1e-2).unwrap().with_anchor(Anchor::Source);
    for bad in [
        region(-1, 0, 4, 4),
        region(150, 0, 2, 1),
        region(0, 120, 4, 8),
        region(i64::MAX, 0, 1, 1),
        region(0, i64::MIN, 1, 1),
    ] {
        let refused = Plan::<f64>::for_region(&model, shape, frame, bad, options, &NoProgress);
        assert!(
            matches!(refused, Err(ConvError::RegionOutsideFrame { .. })),
            "{bad:?}"
        );
    }
    let engine = Engine::new(
        Plan::<f64>::for_region(&model, shape, frame, region(5, 6, 20, 10), options, &NoProgress).unwrap(),
    );
    let wrong = light(true);
    let mut image = Array2::zeros((127, 151));
    let refused = engine.execute(
        Operation::Convolve,
        from_ref(&wrong.view()),
        vec![image.view_mut()],
        &NoProgress,
    );
    assert!(
        matches!(refused, Err(ConvError::FrameShape { .. })),
        "{refused:?}"
    );
    let text = engine.plan().summary().to_string();
    assert!(
        text.starts_with("20 x 10 at (5, 6) of 151 x 127 pixels in f64"),
        "{text}"
    );
}
