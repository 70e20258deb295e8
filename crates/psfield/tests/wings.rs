//! PSFs with wings: fits, files, and every way to draw through them.

use ndarray::{Array2, Array3, ArrayViewMut2, s};
use psfield::conv_core::RowStream;
use psfield::fit::fit;
use psfield::psf_types::{
    Anchor, FrameShape, Image, NoProgress, PixelRegion, PointSource, Position, PsfSamples, SamplePositions,
    SersicProfile, SersicSource, StampGrid,
};
use psfield::{ErrorKind, FitOptions, Psf, PsfFileOptions, PsfieldError, Scene, SimulateOptions, Simulator};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Columns and rows of the stamps and of the frame.
const STAMP: usize = 401;
const SIDE: usize = 300;

/// A Moffat profile, a halo that falls with the third power of the radius, and four narrow spikes. `u` and `v` are
/// the place on the field, from 0 to 1.
fn light((x, y): (f64, f64), (u, v): (f64, f64)) -> f64 {
    let square = x * x + y * y;
    let core = (1.0 + square / (4.0 + 3.0 * u + v)).powf(-3.0);
    let halo = 3e-4 * (1.0 + 0.2 * u) * (1.0 + square / 25.0).powf(-1.5);
    let spike = |d: f64, along: f64| (-d * d / 4.0).exp() / (1.0 + along * along / 100.0);
    core + halo + 2e-3 * (1.0 + 0.1 * v) * (spike(x, y) + spike(y, x))
}

/// A whole PSF, of unit flux.
fn truth(place: (f64, f64), grid: StampGrid) -> Array2<f64> {
    let s = grid.oversampling();
    let mut stamp = Array2::from_shape_fn(grid.dim(), |(j, i)| {
        let at = ((i as f64 - grid.centre_x()) / s, (j as f64 - grid.centre_y()) / s);
        light(at, place)
    });
    let flux = grid.flux_of_sum(stamp.sum());
    stamp /= flux;
    stamp
}

fn samples(grid: StampGrid) -> PsfSamples {
    let places: Vec<(f64, f64)> = (0..9)
        .map(|j| (f64::from(j % 3) / 2.0, f64::from(j / 3) / 2.0))
        .collect();
    let at = |(u, v): &(f64, f64)| Position::new(u * (SIDE - 1) as f64, v * (SIDE - 1) as f64).unwrap();
    let mut stamps = Array3::zeros((9, grid.ny(), grid.nx()));
    for (mut stamp, &place) in stamps.outer_iter_mut().zip(&places) {
        stamp.assign(&truth(place, grid));
    }
    let field = FrameShape::new(SIDE, SIDE).unwrap();
    let positions = SamplePositions::new(places.iter().map(at).collect(), Some(field)).unwrap();
    PsfSamples::new(stamps, positions, grid).unwrap()
}

fn native() -> StampGrid {
    StampGrid::new(STAMP, STAMP).unwrap()
}

fn psf() -> Psf {
    Psf::new(samples(native()), FitOptions::default())
}

fn stars(count: usize, seed: u64) -> Vec<PointSource> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // Some lie outside the frame, and their wings reach it.
    let mut coordinate = || -60.0 + 420.0 * rng.random::<f64>();
    let places: Vec<Position> = (0..count)
        .map(|_| Position::new(coordinate(), coordinate()).unwrap())
        .collect();
    let flux = |k: usize| 10.0_f64.powf(2.0 + 5.0 * (k % 97) as f64 / 97.0);
    places
        .into_iter()
        .enumerate()
        .map(|(k, at)| PointSource::new(at, flux(k)).unwrap())
        .collect()
}

fn simulator(psf: &Psf, options: SimulateOptions) -> Simulator<f32> {
    psf.simulator((SIDE, SIDE)).options(options).build().unwrap()
}

fn some_pixels() -> Vec<(usize, usize)> {
    (0..60)
        .map(|k| ((k * 37 + 11) % SIDE, (k * 53 + 7) % SIDE))
        .collect()
}

/// Checks pixels of an image against the direct sum. `promised` is the largest difference beside rounding.
fn check(simulator: &Simulator<f32>, scene: &Scene<'_, f32>, promised: f64) {
    let image = simulator.simulate(scene).unwrap();
    let peak = image.pixels().iter().fold(0.0_f32, |peak, v| peak.max(v.abs()));
    let exact = simulator.exact_at(scene, &some_pixels(), &NoProgress).unwrap();
    for (&(x, y), exact) in some_pixels().iter().zip(exact) {
        let difference = (f64::from(image.pixels()[[y, x]]) - exact).abs();
        // The tolerance bounds the error relative to the PSF, whose core is as bright as the peak.
        let limit = promised + 2e-6 * f64::from(peak) + 1e-4 * exact;
        assert!(
            difference <= limit,
            "({x}, {y}): {difference:e} of {exact:e}, limit {limit:e}"
        );
    }
    let check = simulator
        .spot_check(scene, &image, (100, 3), &NoProgress)
        .unwrap();
    assert_eq!(check.passed, Some(true), "{check:?}");
}

/// The mean light at each distance from the source.
fn rings(stamp: &Array2<f64>) -> Vec<f64> {
    let half = stamp.dim().0 / 2;
    let mut rings = vec![(0.0, 0); half];
    for ((j, i), v) in stamp.indexed_iter() {
        let radius = (j as f64 - half as f64).hypot(i as f64 - half as f64).round() as usize;
        if let Some((sum, count)) = rings.get_mut(radius) {
            *sum += v;
            *count += 1;
        }
    }
    rings
        .into_iter()
        .map(|(sum, count)| sum / f64::from(count))
        .collect()
}

#[test]
fn core_and_wings_are_the_psf() {
    let fitted = fit(samples(native()), &FitOptions::default()).unwrap();
    let report = fitted.report().unwrap().wings.expect("wings");
    assert!(report.modes <= 4 && report.error < 3e-3, "{report:?}");
    let psf = Psf::from(fitted);
    let model = psf.model().unwrap();
    assert_eq!((model.grid().nx(), model.whole_grid().nx()), (191, STAMP));
    for place in [(0.0, 0.0), (0.5, 1.0), (0.31, 0.77)] {
        let at = Position::new(place.0 * (SIDE - 1) as f64, place.1 * (SIDE - 1) as f64).unwrap();
        let (found, truth) = (model.psf_at(at).unwrap(), truth(place, native()));
        assert!((found.flux() - 1.0).abs() < 1e-6, "{:e}", found.flux() - 1.0);
        let ratio: Vec<f64> = rings(&found.values().to_owned())
            .iter()
            .zip(rings(&truth))
            .map(|(found, truth)| found / truth)
            .collect();
        // The interpolation between samples has an error of its own.
        let interpolated = place == (0.31, 0.77);
        let limit = if interpolated { 1e-2 } else { 2e-3 };
        let worst = ratio.iter().map(|r| (r - 1.0).abs()).fold(0.0, f64::max);
        assert!(worst < limit, "{place:?}: {worst:e}");
        let step = ratio.windows(2).skip(30).map(|pair| (pair[1] - pair[0]).abs());
        let step = step.fold(0.0, f64::max);
        assert!(step < 1e-3, "{place:?}: {step:e}");
    }
}

#[test]
fn models_with_wings_are_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.fits");
    let psf = psf();
    psf.fit().unwrap().unwrap().write(&path, &[], false).unwrap();
    let back = Psf::open(&path).unwrap();
    assert_eq!(back.record().unwrap(), psf.record().unwrap());
    let header = psfield::psf_io::read_header(&path).unwrap();
    assert_eq!(header.get("PSFMODEL").unwrap().value().unwrap().to_string(), "3");
    // A model without wings keeps its version.
    let small = Psf::new(samples(StampGrid::new(61, 61).unwrap()), FitOptions::default());
    let path = folder.path().join("small.fits");
    small.fit().unwrap().unwrap().write(&path, &[], false).unwrap();
    assert!(small.record().unwrap().wings().is_none());
    let header = psfield::psf_io::read_header(&path).unwrap();
    assert_eq!(header.get("PSFMODEL").unwrap().value().unwrap().to_string(), "1");
    // The scaling of both parts together cannot be changed.
    let unit = psfield::FitChoices {
        normalisation: Some(psfield::psf_types::Normalisation::Unit),
        ..Default::default()
    };
    let error = Psf::open_with(
        folder.path().join("model.fits"),
        &PsfFileOptions::default(),
        &unit,
    )
    .unwrap_err();
    assert!(error.to_string().contains("has wings"), "{error}");
}

#[test]
fn stars_are_drawn_with_their_wings() {
    // The last is drawn from all components, and its wings on finer stamps.
    let finer = |pixels: usize, s: f64| {
        StampGrid::new(pixels, pixels)
            .unwrap()
            .with_oversampling(s)
            .unwrap()
    };
    for grid in [native(), finer(501, 2.0), finer(451, 1.5)] {
        let psf = Psf::new(samples(grid), FitOptions::default());
        assert!(psf.has_wings().unwrap());
        for floor in [0.0, 0.3] {
            let simulator = simulator(
                &psf,
                SimulateOptions {
                    floor,
                    ..Default::default()
                },
            );
            // One by one, and together by transforms.
            for count in [8, 3000] {
                let stars = stars(count, 1);
                let scene = Scene::dark().with_stars(&stars[..]);
                let dropped = simulator.dropped_light(&scene).unwrap();
                let dropped = dropped.map_or(0.0, |dropped| dropped.largest());
                assert!(dropped == 0.0 || floor > 0.0);
                check(&simulator, &scene, dropped);
            }
        }
    }
}

#[test]
fn galaxies_have_wings() {
    let profile = |re| SersicProfile::new(re, 1.0, 0.6, 30.0).unwrap();
    let galaxy = |x, y, re| SersicSource::new(Position::new(x, y).unwrap(), 1e6, profile(re)).unwrap();
    let galaxies = [
        galaxy(100.3, 80.1, 0.4),
        galaxy(210.0, 190.7, 6.0),
        galaxy(-40.0, 150.0, 3.0),
    ];
    let simulator = simulator(&psf(), SimulateOptions::default());
    let scene = Scene::dark().with_galaxies(&galaxies[..]);
    check(&simulator, &scene, 0.0);
    // Far from a galaxy, its wings are those of a star of its flux, within a part of their light.
    let alone = Scene::dark().with_galaxies(&galaxies[1..2]);
    let star = [PointSource::new(galaxies[1].position(), 1e6).unwrap()];
    let [of_galaxy, of_star] = [alone, Scene::dark().with_stars(&star[..])]
        .map(|scene| simulator.simulate(&scene).unwrap().into_pixels());
    let corner = |image: &Array2<f32>| f64::from(image.slice(s![20..60, 20..60]).sum());
    let ratio = corner(&of_galaxy) / corner(&of_star);
    assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
}

/// Rows of an image.
struct Rows {
    light: Array2<f32>,
    image: Vec<f32>,
}

impl RowStream<f32> for Rows {
    type Error = PsfieldError;
    fn read(
        &mut self,
        _: usize,
        rows: std::ops::Range<usize>,
        mut light: ArrayViewMut2<'_, f32>,
    ) -> Result<(), PsfieldError> {
        light.assign(&self.light.slice(s![rows, ..]));
        Ok(())
    }
    fn write(&mut self, rows: ndarray::ArrayView2<'_, f32>) -> Result<(), PsfieldError> {
        self.image.extend(rows.iter());
        Ok(())
    }
}

#[test]
fn images_are_convolved_with_the_wings() {
    let psf = psf();
    let simulator = simulator(&psf, SimulateOptions::default());
    let mut light = Array2::<f32>::zeros((SIDE, SIDE));
    for k in 0..40 {
        light[[(k * 71 + 5) % SIDE, (k * 113 + 9) % SIDE]] = 10.0 + k as f32;
    }
    let stars = stars(20, 4);
    let scene = Scene::new(light.clone()).unwrap().with_stars(&stars[..]);
    check(&simulator, &scene, 0.0);
    let whole = simulator.simulate(&scene).unwrap();
    // Rows that are read one after the other give the image, too.
    let mut rows = Rows {
        light: light.clone(),
        image: Vec::new(),
    };
    let by_rows = Scene::streamed().with_stars(&stars[..]);
    let (_, checked) = simulator
        .stream(&by_rows, &mut rows, (20, 1), &NoProgress)
        .unwrap();
    assert_eq!(checked.unwrap().passed, Some(true));
    assert_eq!(rows.image, whole.pixels().iter().copied().collect::<Vec<f32>>());
    // And by regions, of the whole light and of the part that reaches the region.
    let part = PixelRegion::new(40, 120, FrameShape::new(90, 70).unwrap());
    let of_part = simulator.for_region(part, &NoProgress).unwrap();
    let reaching = of_part.light_region(&NoProgress).unwrap();
    let [x, y] = [reaching.x0() as usize, reaching.y0() as usize];
    let shape = reaching.shape();
    let lit = light.slice(s![y..y + shape.ny(), x..x + shape.nx()]).to_owned();
    let expected = whole.pixels().slice(s![120..190, 40..130]).to_owned();
    let peak = expected.iter().fold(0.0_f32, |peak, v| peak.max(v.abs()));
    for light in [light.clone(), lit] {
        let scene = Scene::new(light).unwrap().with_stars(&stars[..]);
        let image = of_part.simulate(&scene).unwrap();
        let differs = (&image.pixels() - &expected)
            .iter()
            .fold(0.0_f32, |most, v| most.max(v.abs()));
        assert!(differs <= 1e-6 * peak, "{differs:e} of {peak:e}");
    }
    // <A f, g> = <f, A^T g>
    let g = Array2::from_shape_fn((SIDE, SIDE), |(y, x)| ((y * 31 + x * 17) % 23) as f32 - 11.0);
    let g = Image::new(g).unwrap();
    let [adjoint] = &simulator.adjoint(&g.view(), &NoProgress).unwrap()[..] else {
        panic!("one layer")
    };
    let image = simulator.simulate(&Scene::new(light.clone()).unwrap()).unwrap();
    let dot = |a: ndarray::ArrayView2<'_, f32>, b: ndarray::ArrayView2<'_, f32>| -> f64 {
        a.iter().zip(&b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
    };
    let [left, right] = [
        dot(image.pixels(), g.pixels()),
        dot(light.view(), adjoint.pixels()),
    ];
    assert!(
        (left - right).abs() < 1e-5 * left.abs().max(1.0),
        "{left} {right}"
    );
    let of_region = of_part.adjoint(
        &Image::new(g.pixels().slice(s![..70, ..90]).to_owned())
            .unwrap()
            .view(),
        &NoProgress,
    );
    assert_eq!(of_region.unwrap()[0].shape(), reaching.shape());
}

/// Wings have the same bytes for any number of threads, any region and any order of the catalogue.
#[test]
fn wings_do_not_depend_on_threads_regions_or_order() {
    let psf = psf();
    // More stars than are prepared together.
    for (floor, count) in [(0.3, 9000), (0.0, 12), (0.0, 3000)] {
        let list = stars(count, 2);
        // The core of a star depends on the order to rounding, so the wings are looked at alone.
        let wings = |list: &[PointSource], region: PixelRegion| {
            let plan = psfield::conv_core::SourcePlan::<f32>::new(
                psf.model().unwrap(),
                SimulateOptions {
                    floor,
                    ..Default::default()
                }
                .plan_options()
                .unwrap()
                .unwrap(),
                None,
            );
            let none = |_: usize| -> psfield::conv_core::Light { unreachable!() };
            let extended = psfield::conv_core::ExtendedSources {
                points: &[],
                light: &none,
            };
            let mut image = Array2::<f32>::zeros((region.shape().ny(), region.shape().nx()));
            let frame = FrameShape::new(SIDE, SIDE).unwrap().region();
            plan.unwrap()
                .draw_wings_into((list, extended), frame, region, image.view_mut(), &NoProgress)
                .unwrap();
            image
        };
        let frame = FrameShape::new(SIDE, SIDE).unwrap().region();
        let whole = wings(&list, frame);
        assert!(whole.sum() > 0.0);
        let reversed: Vec<PointSource> = list.iter().rev().copied().collect();
        assert_eq!(wings(&reversed, frame), whole);
        let part = PixelRegion::new(37, 101, FrameShape::new(61, 83).unwrap());
        assert_eq!(wings(&list, part), whole.slice(s![101..184, 37..98]));
        let one = rayon_pool(1).install(|| wings(&list, frame));
        assert_eq!(one, whole);
    }
}

fn rayon_pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap()
}

#[test]
fn photons_of_shot_sources_fall_in_the_wings() {
    let simulator = simulator(
        &psf(),
        SimulateOptions {
            floor: 1e-9,
            ..Default::default()
        },
    );
    let list = [PointSource::new(Position::new(150.2, 140.6).unwrap(), 3e5).unwrap()];
    let scene = Scene::dark().with_stars(&list[..]);
    let (counts, report) = simulator.shoot(&scene, (1.0, 7), &NoProgress).unwrap();
    let image = simulator.simulate(&scene).unwrap();
    assert!((report.mean - 3e5).abs() < 3e2, "{report:?}");
    // The light more than 100 pixels away.
    let far = |(y, x): (usize, usize)| (y as f64 - 140.6).hypot(x as f64 - 150.2) > 100.0;
    let found: f64 = counts
        .indexed_iter()
        .filter(|(at, _)| far(*at))
        .map(|(_, &v)| f64::from(v))
        .sum();
    let pixels = image.pixels();
    let expected: f64 = pixels
        .indexed_iter()
        .filter(|(at, _)| far(*at))
        .map(|(_, &v)| f64::from(v))
        .sum();
    assert!(expected > 100.0, "{expected}");
    assert!(
        (found - expected).abs() < 5.0 * expected.sqrt(),
        "{found} {expected}"
    );
}

#[test]
fn wings_are_joined_to_a_small_psf() {
    let small = Psf::new(samples(StampGrid::new(81, 81).unwrap()), FitOptions::default());
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let of_radius = rings(&truth((0.5, 0.5), native()));
    let rows = of_radius
        .iter()
        .enumerate()
        .map(|(radius, light)| format!("{radius}, {}\n", 7.0 * light));
    let profile: String = rows.collect();
    std::fs::write(
        file("profile.csv"),
        format!("# radius, light\nradius_px, light\n{profile}"),
    )
    .unwrap();
    let stamp = Image::new(truth((0.5, 0.5), native())).unwrap();
    psfield::psf_io::write_image(
        file("stamp.fits"),
        &stamp,
        &psfield::psf_io::HeaderCards::new(),
        &[psfield::psf_io::Card::new("OVERSAMP", 1.0, "").unwrap()],
        false,
    )
    .unwrap();
    for source in [
        file("profile.csv").display().to_string(),
        file("stamp.fits").display().to_string(),
        "power=3,200".to_owned(),
    ] {
        let joined = small.joined_to(&source.parse().unwrap()).unwrap();
        let at = Position::new(0.5 * (SIDE - 1) as f64, 0.5 * (SIDE - 1) as f64).unwrap();
        let found = joined.model().unwrap().psf_at(at).unwrap();
        assert!((found.flux() - 1.0).abs() < 1e-6, "{source}");
        // The stamps of 81 pixels lack some of the flux.
        let [a, b] = [found.values().to_owned(), truth((0.5, 0.5), native())].map(|stamp| rings(&stamp)[100]);
        let limit = if source.starts_with("power") { 0.3 } else { 0.05 };
        assert!((a / b - 1.0).abs() < limit, "{source}: {a:e} {b:e}");
        assert!(joined.joined_to(&source.parse().unwrap()).is_err());
    }
    for (source, words) in [("power=3,10", "not larger"), ("none.csv", "cannot be read")] {
        let error = small.joined_to(&source.parse().unwrap()).unwrap_err();
        assert!(error.to_string().contains(words), "{error}");
    }
    for text in ["power=3", "power=0,3", "power=2,1e9", "power=a,b"] {
        assert!(text.parse::<psfield::WingsSource>().is_err(), "{text}");
    }
    std::fs::write(file("bad.csv"), "1, 2\n1, 3\n").unwrap();
    let error = small
        .joined_to(&file("bad.csv").display().to_string().parse().unwrap())
        .unwrap_err();
    assert!(
        error.to_string().contains("line 2") && error.to_string().contains("increase"),
        "{error}"
    );
}

#[test]
fn what_wings_do_not_allow_is_refused() {
    let psf = psf();
    let moved = psf.moved(&psfield::Motion::fixed([0.5, 0.0]));
    // Samples are moved before they are fitted.
    assert!(moved.is_ok());
    let fitted = Psf::from(psf.record().unwrap().clone());
    let error = fitted.moved(&psfield::Motion::fixed([0.5, 0.0])).unwrap_err();
    assert!(error.to_string().contains("with wings"), "{error}");
    let options = SimulateOptions {
        anchor: Anchor::Output,
        ..Default::default()
    };
    let list = stars(1, 1);
    let error = simulator(&fitted, options)
        .simulate(&Scene::dark().with_stars(&list[..]))
        .unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Convolution);
    assert!(error.to_string().contains("with wings"), "{error}");
    // The samples themselves are fitted undivided for such work.
    let whole = psf
        .simulator((SIDE, SIDE))
        .anchor(Anchor::Output)
        .build::<f32>()
        .unwrap();
    assert!(whole.simulate(&Scene::dark().with_stars(&list[..])).is_ok());
    // Compact PSFs and centres near an edge need no wings.
    let narrow = Array2::from_shape_fn((STAMP, STAMP), |(j, i)| {
        (-((j as f64 - 200.0).powi(2) + (i as f64 - 200.0).powi(2)) / 8.0).exp()
    });
    let narrow = Psf::from_samples(narrow.insert_axis(ndarray::Axis(0)).view(), &[(5.0, 5.0)]).unwrap();
    let aside = samples(native().with_centre(50.0, 200.0).unwrap());
    for psf in [narrow, Psf::new(aside, FitOptions::default())] {
        assert!(!psf.has_wings().unwrap());
        assert_eq!(psf.model().unwrap().grid().nx(), STAMP);
    }
    // Samples whose wings differ too much are fitted as they are.
    let mut noisy = samples(native()).stamps().to_owned();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    noisy.mapv_inplace(|v| v + 1e-7 * (rng.random::<f64>() - 0.5));
    let positions = samples(native()).positions().clone();
    let whole = Psf::from(PsfSamples::new(noisy, positions, native()).unwrap());
    assert!(!whole.has_wings().unwrap());
    assert_eq!(whole.model().unwrap().grid().nx(), STAMP);
}
