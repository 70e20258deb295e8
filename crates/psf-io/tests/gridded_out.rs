//! Writing gridded libraries and reading plain stamps.

mod support;

use std::collections::HashMap;
use std::path::Path;

use ndarray::{Array3, s};
use psf_io::{
    Card, CardValue, FileKind, HduChoice, IoError, IoErrorKind, PlaneOrder, StampCubeOptions, detect,
    detect_hdu, read_cube, read_header, read_stamp_cube, read_stamp_header, read_stdpsf, read_stdpsf_hdu,
    read_stpsf, read_stpsf_hdu, write_gridded,
};
use psf_types::{Position, PsfSamples, SamplePositions, StampGrid, StampInterpolation, StateKind};
use support::libraries::{stdpsf, stpsf};
use support::mutations::{assert_refused, cut, huge_sizes, not_finite, wrong_types};
use support::{IMAGE, SIMPLE, Scratch, assert_error, chain, f32s, image};

/// Rounding of bilinear sums of a few terms in double precision.
const ROUNDING: f64 = 1e-13;

fn grid() -> StampGrid {
    StampGrid::new(5, 5).unwrap().with_oversampling(2.0).unwrap()
}

/// Samples on a grid in an unusual order. All values of a sample are `100 + 2 x + 3 y + x y`.
fn samples(xs: &[f64], ys: &[f64], grid: StampGrid) -> PsfSamples {
    let positions: Vec<Position> = xs
        .iter()
        .rev()
        .flat_map(|&x| ys.iter().map(move |&y| Position::new(x, y).unwrap()))
        .collect();
    samples_at(positions, grid)
}

fn value(x: f64, y: f64) -> f64 {
    100.0 + 2.0 * x + 3.0 * y + x * y
}

fn samples_at(positions: Vec<Position>, grid: StampGrid) -> PsfSamples {
    let (ny, nx) = grid.dim();
    let mut stamps = Array3::zeros((positions.len(), ny, nx));
    for (mut stamp, position) in stamps.outer_iter_mut().zip(&positions) {
        stamp.fill(value(position.x(), position.y()));
    }
    PsfSamples::new(stamps, SamplePositions::new(positions, None).unwrap(), grid).unwrap()
}

/// The value of each plane by its position, as seen by two readers. One reads the cards in their
/// order as (x, y), the other reads them by their number as (y, x).
fn seen_by_both(path: &Path) -> [HashMap<(u64, u64), f64>; 2] {
    let planes = read_cube::<f64>(path).unwrap();
    let header = read_header(path).unwrap();
    let cards: Vec<(usize, f64, f64)> = header
        .iter()
        .filter_map(|card| {
            let number = card.keyword().strip_prefix("DET_YX")?.parse().unwrap();
            let Some(CardValue::Text(text)) = card.value() else {
                panic!("{card}");
            };
            let (first, second) = text.trim_matches(['(', ')']).split_once(',').unwrap();
            Some((number, first.parse().unwrap(), second.trim().parse().unwrap()))
        })
        .collect();
    assert_eq!(cards.len(), planes.dim().0);
    let bits = |x: f64, y: f64| (x.to_bits(), y.to_bits());
    let in_order = cards
        .iter()
        .enumerate()
        .map(|(plane, &(_, first, second))| (bits(first, second), planes[[plane, 0, 0]]));
    let by_number = cards
        .iter()
        .map(|&(number, first, second)| (bits(second, first), planes[[number, 0, 0]]));
    [in_order.collect(), by_number.collect()]
}

#[test]
fn readers_of_either_kind_see_the_same_field() {
    let scratch = Scratch::new();
    let square: &[f64] = &[-1.0, 10.0, 35.5];
    let many: Vec<f64> = (0..11).map(f64::from).collect();
    let cases: [(&[f64], &[f64], usize); 5] = [
        (square, square, 9),
        (&[0.0, 10.0], &[0.0, 4.0, 10.0], 9),
        (&[0.0, 1.0, 2.0], &[50.0, 60.0], 25),
        (&[7.0], &[1.0, 2.0], 9),
        (&many, &many, 121),
    ];
    for (i, (xs, ys, planes)) in cases.into_iter().enumerate() {
        let path = scratch.path(&format!("{i}.fits"));
        let samples = samples(xs, ys, grid());
        assert_eq!(write_gridded(&path, &samples, &[], false).unwrap(), planes);
        assert_eq!(detect(&path).unwrap(), FileKind::Stpsf);
        let [in_order, by_number] = seen_by_both(&path);
        assert_eq!(in_order.len(), planes);
        assert_eq!(in_order, by_number);
        // The bilinear function of the samples holds between them, and the nearest sample outside.
        let within = |v: f64, lines: &[f64]| v.clamp(lines[0], lines[lines.len() - 1]);
        for ((x, y), found) in in_order {
            let (x, y) = (f64::from_bits(x), f64::from_bits(y));
            let expected = value(within(x, xs), within(y, ys));
            assert!(
                (found - expected).abs() <= ROUNDING * expected,
                "({x}, {y}): {found}, {expected}"
            );
        }
        // psfield reads only the samples, not the planes between them.
        let back = read_stpsf(&path, PlaneOrder::Auto).unwrap();
        assert_eq!(back.samples().grid(), samples.grid());
        assert_eq!(back.samples().len(), samples.len());
        for (sample, position) in samples.positions().as_slice().iter().enumerate() {
            let places = back.samples().positions().as_slice();
            let plane = places
                .iter()
                .position(|p| p == position)
                .expect("every sample is there");
            assert_eq!(back.samples().stamp(plane), samples.stamp(sample));
        }
    }
}

#[test]
fn a_wrong_list_of_grid_lines_is_refused() {
    let scratch = Scratch::new();
    let (good, bad) = (scratch.path("good.fits"), scratch.path("bad.fits"));
    write_gridded(
        &good,
        &samples(&[0.0, 10.0], &[0.0, 4.0, 10.0], grid()),
        &[],
        false,
    )
    .unwrap();
    let bytes = std::fs::read(&good).unwrap();
    let place = bytes.windows(13).position(|w| w == b"GRIDLINE= 'by").unwrap() + 11;
    for wrong in [&b"bb'"[..], b"xxx", b"b  "] {
        let mut bytes = bytes.clone();
        bytes[place..place + 3].copy_from_slice(wrong);
        std::fs::write(&bad, bytes).unwrap();
        let error = read_stpsf(&bad, PlaneOrder::Auto).unwrap_err().to_string();
        assert!(error.contains("GRIDLINE"), "{error}");
    }
}

#[test]
fn copied_cards_do_not_change_the_order_of_the_planes() {
    let scratch = Scratch::new();
    let path = scratch.path("a.fits");
    let cards = [
        Card::new("VERSION", "2.0.0", "").unwrap(),
        Card::new("DET_YX3", "(5.0, 5.0)", "").unwrap(),
        Card::new("DET_YX77", "(5.0, 5.0)", "").unwrap(),
        Card::new("FILTER", "F200W", "").unwrap(),
    ];
    let samples = samples(&[0.0, 10.0], &[0.0, 10.0], grid());
    write_gridded(&path, &samples, &cards, false).unwrap();
    let back = read_stpsf(&path, PlaneOrder::Auto).unwrap();
    let corner = &back.samples().positions().as_slice()[1];
    assert_eq!((corner.x(), corner.y()), (10.0, 0.0));
    assert_eq!(back.samples().stamps()[[1, 0, 0]], value(10.0, 0.0));
    assert_eq!(read_header(&path).unwrap().get("FILTER"), Some(&cards[3]));
    assert_error(
        write_gridded(&path, &samples, &[], false),
        IoErrorKind::Exists,
        "exists",
    );
    write_gridded(&path, &samples, &[], true).unwrap();
}

#[test]
fn a_single_psf_stays_one_plane() {
    let scratch = Scratch::new();
    let path = scratch.path("a.fits");
    let samples = samples(&[3.0], &[4.5], grid());
    assert_eq!(write_gridded(&path, &samples, &[], false).unwrap(), 1);
    assert_eq!(read_stpsf(&path, PlaneOrder::Auto).unwrap().samples(), &samples);
}

#[test]
fn samples_that_the_layout_cannot_hold_are_refused() {
    let scratch = Scratch::new();
    let path = scratch.path("a.fits");
    let lines = [0.0, 10.0];
    let on = |grid: StampGrid| samples(&lines, &lines, grid);
    let size = |n| StampGrid::new(n, 5).unwrap();
    let irregular = [(0.0, 0.0), (10.0, 0.0), (0.0, 10.0)].map(|(x, y)| Position::new(x, y).unwrap());
    let long: Vec<f64> = (0..150).map(|i| f64::from(i) + 0.5).collect();
    let cases = [
        (
            on(grid().with_oversampling(2.5).unwrap()),
            "oversampled 2.5 times",
        ),
        (on(grid().with_centre(2.5, 2.0).unwrap()), "index (2.5, 2)"),
        (on(size(6)), "(3, 2)"),
        (on(grid().with_pixel_response_included(false)), "response"),
        (
            on(grid().with_interpolation(StampInterpolation::Lanczos3)),
            "lanczos3",
        ),
        (on(size(3)), "3 x 5 pixels"),
        (
            samples_at(irregular.into(), grid()),
            "3 samples do not fill a grid of 2 x 2",
        ),
        (samples(&[0.0], &long, grid()), "22801 planes"),
    ];
    for (samples, expected) in cases {
        let error = chain(&write_gridded(&path, &samples, &[], false).unwrap_err());
        assert!(error.contains(expected), "{expected}: {error}");
        assert!(!path.exists());
    }
}

#[test]
fn several_plain_stamps_need_positions() {
    let scratch = Scratch::new();
    let values: Vec<f32> = (1..=32).map(|v| v as f32).collect();
    let one = scratch.put(
        "one.fits",
        &image(SIMPLE, -32, &[4, 4], &["OVERSAMP= 3"], &f32s(&values[..16])),
    );
    let plain = read_stamp_cube(&one, &StampCubeOptions::default()).unwrap();
    assert_eq!((plain.len(), plain.grid().oversampling()), (1, 3.0));
    let options = StampCubeOptions::default()
        .with_oversampling(2.0)
        .with_centre(1.5, 1.5)
        .with_pixel_response_included(false);
    let grid = read_stamp_cube(&one, &options).unwrap().grid();
    assert_eq!(
        (grid.oversampling(), grid.centre_x(), grid.centre_y()),
        (2.0, 1.5, 1.5)
    );
    assert!(!grid.pixel_response_included());

    let two = scratch.put("two.fits", &image(SIMPLE, -32, &[4, 4, 2], &[], &f32s(&values)));
    let error = read_stamp_cube(&two, &StampCubeOptions::default()).unwrap_err();
    assert_eq!(error.setting(), Some("positions"), "{error}");
    let at = |count: i64| {
        let positions = (0..count).map(|i| Position::of_pixel(i, 0)).collect();
        read_stamp_cube(&two, &StampCubeOptions::default().with_positions(positions))
    };
    let samples = at(2).unwrap();
    assert_eq!(samples.positions().as_slice()[1], Position::of_pixel(1, 0));
    assert_eq!(
        samples.stamps().slice(s![1, 0, ..]).to_vec(),
        [17.0, 18.0, 19.0, 20.0]
    );
    for count in [1, 3] {
        assert!(chain(&at(count).unwrap_err()).contains("expected 2"), "{count}");
    }
    let wrong = StampCubeOptions::default().with_oversampling(0.0);
    assert!(chain(&read_stamp_cube(&one, &wrong).unwrap_err()).contains("oversampling"));
}

#[test]
fn planes_may_be_wavelengths() {
    let scratch = Scratch::new();
    let values: Vec<f32> = (1..=32).map(|v| v as f32).collect();
    let read = |cards: &[&str]| {
        let cards = [&["OVERSAMP= 4"], cards].concat();
        let bytes = image(SIMPLE, -32, &[4, 4, 2], &cards, &f32s(&values));
        read_stamp_cube(scratch.put("cube.fits", &bytes), &StampCubeOptions::default())
    };
    let samples = read(&["WAVELN00= 2.5E-06", "WAVELN01= 2.0E-06"]).unwrap();
    let states = samples.positions().states().unwrap();
    assert_eq!(
        (states.kind(), states.values()),
        (StateKind::Wavelength, &[2.0, 2.5][..])
    );
    assert_eq!(states.per_sample().collect::<Vec<_>>(), [2.5, 2.0]);
    assert_eq!(samples.positions().as_slice(), [Position::of_pixel(0, 0); 2]);
    for (cards, expected) in [
        (&["WAVELN00= 2.5E-06"][..], "WAVELN01"),
        (&["WAVELN00= 2.5E-06", "WAVELN01= -1.0"], "WAVELN01"),
        (&["WAVELN00= 2.5E-06", "WAVELN01= 2.5E-06"], "2.5"),
        (&["WAVELN01= 2.5E-06"], "without positions"),
    ] {
        let error = chain(&read(cards).unwrap_err());
        assert!(error.contains(expected), "{expected}: {error}");
    }
}

#[test]
fn one_of_several_images_must_be_chosen() {
    let scratch = Scratch::new();
    let values: Vec<f32> = (1..=32).map(|v| v as f32).collect();
    let stamp = |first, values: &[f32]| image(first, -32, &[4, 4], &["OVERSAMP= 3"], &f32s(values));
    let cube = |first| image(first, -32, &[4, 4, 2], &["OVERSAMP= 3"], &f32s(&values));
    let one_hdu = [cube(SIMPLE), stpsf(&[]), stdpsf(3, 2)];
    let second = stamp(IMAGE, &values[16..]);
    let files = one_hdu.map(|bytes| [bytes, second.clone()].concat());
    let several = |result: Result<(), IoError>| {
        let error = result.unwrap_err();
        assert_eq!(error.setting(), Some("extension"), "{error}");
        assert_error(
            Err::<(), _>(error),
            IoErrorKind::Setting,
            "the file has 2 images, in the HDUs 0 (",
        );
    };
    let [cubes, grids, libraries] = [0, 1, 2].map(|i| scratch.put(&format!("{i}.fits"), &files[i]));
    let choice = |number| HduChoice::Number(number);
    several(read_stamp_cube(&cubes, &StampCubeOptions::default()).map(drop));
    several(read_stamp_header(&cubes, None).map(drop));
    several(read_stpsf(&grids, PlaneOrder::Auto).map(drop));
    several(read_stdpsf(&libraries, None).map(drop));
    let options = StampCubeOptions::default().with_extension(choice(1));
    let read = read_stamp_cube(&cubes, &options).unwrap();
    assert_eq!((read.len(), read.stamp(0)[[0, 0]]), (1, 17.0));
    assert_eq!(detect(&cubes).unwrap(), FileKind::Cube);
    assert_eq!(detect_hdu(&cubes, Some(&choice(1))).unwrap(), FileKind::Image);
    assert_eq!(
        read_stpsf_hdu(&grids, Some(&choice(0)), PlaneOrder::Auto, false)
            .unwrap()
            .samples()
            .len(),
        6
    );
    assert_eq!(
        read_stdpsf_hdu(&libraries, Some(&choice(0)), None, false)
            .unwrap()
            .samples()
            .len(),
        6
    );
    let error = read_stpsf_hdu(&grids, Some(&choice(2)), PlaneOrder::Auto, false).unwrap_err();
    assert_eq!(error.setting(), Some("extension"));
    assert!(
        error.to_string().contains("HDU 2 is none of the images"),
        "{error}"
    );
}

#[test]
fn damaged_stamps_are_refused_soon() {
    let cards = ["OVERSAMP= 2.0", "CENX    = 2", "CENY    = 2", "PIXCONV = T"];
    let good = image(SIMPLE, -64, &[5, 5], &cards, &support::f64s(&[1.0; 25]));
    let mut all = cut(&good);
    all.extend(huge_sizes(&good));
    all.extend(not_finite(&good));
    all.extend(wrong_types(&good, &["OVERSAMP", "CENX", "CENY"], &[]));
    assert_refused(all, |path| read_stamp_cube(path, &StampCubeOptions::default()));
}
