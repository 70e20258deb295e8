//! Reading and writing PSF samples.

mod support;

use std::error::Error;

use ndarray::Array3;
use psf_io::{
    Card, FileKind, IoError, IoErrorKind, Place, Precision, detect, read_header, read_samples, write_samples,
};
use psf_types::{
    DataError, FrameShape, Position, PsfSamples, SamplePositions, SampleStates, StampGrid, StateKind,
};
use support::{IMAGE, SIMPLE, Scratch, assert_error, chain, f32s, f64s, i16s, image, names, table};

/// Samples whose numbers need all bits of a double.
fn samples() -> PsfSamples {
    let stamps = Array3::from_shape_fn((3, 4, 5), |(i, y, x)| 1.0 / (1 + i + 2 * y + 3 * x) as f64);
    let at = |x, y| Position::new(x, y).unwrap();
    let field = FrameShape::new(100, 80).unwrap();
    let positions = vec![
        at(-0.0, 0.1),
        at(1.0 / 3.0, 79.4),
        at(99.499_999_999_999_99, 0.1 + 0.2),
    ];
    let grid = StampGrid::new(5, 4)
        .and_then(|g| g.with_centre(2.123_456_789_012_345_6, 1.0 / 3.0))
        .and_then(|g| g.with_oversampling(std::f64::consts::PI))
        .unwrap()
        .with_pixel_response_included(false);
    PsfSamples::new(
        stamps,
        SamplePositions::new(positions, Some(field)).unwrap(),
        grid,
    )
    .unwrap()
}

#[test]
fn double_precision_comes_back_bit_by_bit() {
    let scratch = Scratch::new();
    let path = scratch.path("a.fits");
    let samples = samples();
    let cards = [
        Card::new("OVERSAMP", 99, "not this").unwrap(),
        Card::new("OBJECT", "demo", "").unwrap(),
    ];
    write_samples(&path, &samples, &cards, Precision::Double, false).unwrap();
    let back = read_samples(&path).unwrap();
    assert_eq!(back, samples);
    assert!(back.positions().as_slice()[0].x().is_sign_negative());
    assert_eq!(read_header(&path).unwrap().get("OBJECT"), Some(&cards[1]));
    assert_eq!(detect(&path).unwrap(), FileKind::PsfSamples);
}

#[test]
fn single_precision_rounds_only_stamps() {
    let scratch = Scratch::new();
    let path = scratch.path("a.fits");
    let samples = samples();
    write_samples(&path, &samples, &[], Precision::Single, false).unwrap();
    let back = read_samples(&path).unwrap();
    assert_eq!(
        (back.positions(), back.grid()),
        (samples.positions(), samples.grid())
    );
    assert_eq!(back.stamps(), samples.stamps().mapv(|v| f64::from(v as f32)));

    let huge = PsfSamples::new(
        Array3::from_elem((1, 1, 1), 1e300),
        SamplePositions::new(vec![Position::of_pixel(0, 0)], None).unwrap(),
        StampGrid::new(1, 1).unwrap(),
    );
    let path = scratch.path("huge.fits");
    let error = write_samples(&path, &huge.unwrap(), &[], Precision::Single, false);
    assert_error(error, IoErrorKind::Limit, "single precision");
    assert!(!path.exists());
}

/// A file of two 2 x 2 stamps, of which any part can be replaced.
struct File<'a> {
    axes: &'a [usize],
    cards: &'a [&'a str],
    values: &'a [f32],
    columns: &'a [(&'a str, &'a str)],
    rows: usize,
    bytes: Vec<u8>,
}

const STAMPS: [f32; 8] = [0.1, 0.2, 0.3, 0.4, 1.0, 0.0, 0.0, -0.5];

impl Default for File<'_> {
    fn default() -> Self {
        Self {
            axes: &[2, 2, 2],
            cards: &[],
            values: &STAMPS,
            columns: &[("X", "D"), ("Y", "D")],
            rows: 2,
            bytes: f64s(&[1.0, 2.0, 3.0, 4.0]),
        }
    }
}

impl File<'_> {
    fn read(self, scratch: &Scratch) -> Result<PsfSamples, IoError> {
        let mut file = image(SIMPLE, -32, self.axes, self.cards, &f32s(self.values));
        file.extend(image(IMAGE, 8, &[1, 1], &["EXTNAME = 'EXTRA'"], &[0]));
        file.extend(table("positions ", self.columns, self.rows, &[], &self.bytes));
        let path = scratch.put("a.fits", &file);
        let read = read_samples(&path);
        if let Err(error) = &read {
            assert!(names(error, &path), "{error}");
        }
        read
    }
}

#[test]
fn defaults_hold_where_keywords_are_absent() {
    let samples = File::default().read(&Scratch::new()).unwrap();
    assert_eq!(samples.grid(), StampGrid::new(2, 2).unwrap());
    assert_eq!(samples.positions().field(), None);
    assert_eq!(
        samples.positions().as_slice()[1],
        Position::new(3.0, 4.0).unwrap()
    );
    assert_eq!(samples.stamps()[[1, 1, 1]], -0.5);
}

#[test]
fn whole_numbers_serve_as_reals_and_other_columns_do_not_matter() {
    let bytes: Vec<u8> = [(1_i16, 2.5_f32), (3, 4.5)]
        .iter()
        .flat_map(|&(x, y)| [b"ab".to_vec(), f32s(&[y]), i16s(&[x])].concat())
        .collect();
    let file = File {
        cards: &[
            "OVERSAMP= 4",
            "CENX    = 0",
            "CENY    = 5.0D-1",
            "PIXCONV = F",
            "FIELDNX = 4",
            "FIELDNY = 6",
        ],
        columns: &[("NAME", "2A"), ("y", "1E"), ("x", "I")],
        bytes,
        ..File::default()
    };
    let samples = file.read(&Scratch::new()).unwrap();
    let grid = samples.grid();
    assert_eq!(
        (grid.oversampling(), grid.centre_x(), grid.centre_y()),
        (4.0, 0.0, 0.5)
    );
    assert!(!grid.pixel_response_included());
    assert_eq!(
        samples.positions().as_slice()[0],
        Position::new(1.0, 2.5).unwrap()
    );
    assert_eq!(samples.positions().field(), Some(FrameShape::new(4, 6).unwrap()));
}

#[test]
fn an_image_is_a_single_sample() {
    let scratch = Scratch::new();
    for axes in [&[2, 4][..], &[2, 4, 1]] {
        let file = File {
            axes,
            rows: 1,
            bytes: f64s(&[1.0, 2.0]),
            ..File::default()
        };
        assert_eq!(file.read(&scratch).unwrap().stamps().dim(), (1, 4, 2));
    }
    let two_positions = File {
        axes: &[2, 4],
        ..File::default()
    };
    assert!(two_positions.read(&scratch).is_err());
    // With two positions for one stamp, the file is an image that happens to have a table.
    assert_eq!(detect(scratch.path("a.fits")).unwrap(), FileKind::Image);
}

/// The data error that caused the failure.
fn cause(result: Result<PsfSamples, IoError>) -> DataError {
    let error = result.unwrap_err();
    assert_eq!(error.kind(), IoErrorKind::Data, "{error}");
    let cause = error.source().and_then(|source| source.downcast_ref());
    DataError::clone(cause.unwrap_or_else(|| panic!("{error:?}")))
}

#[test]
fn samples_that_break_a_rule_are_refused() {
    let scratch = Scratch::new();
    let file = |bytes: &[f64]| File {
        rows: bytes.len() / 2,
        bytes: f64s(bytes),
        ..File::default()
    };
    let fewer = cause(file(&[1.0, 2.0]).read(&scratch));
    assert!(
        matches!(
            fewer,
            DataError::CountMismatch {
                expected: 1,
                got: 2,
                ..
            }
        ),
        "{fewer}"
    );
    let twice = cause(file(&[1.0, 2.0, 1.0, 2.0]).read(&scratch));
    assert!(
        matches!(
            twice,
            DataError::DuplicatePosition {
                first: 0,
                second: 1,
                ..
            }
        ),
        "{twice}"
    );
    let outside = File {
        cards: &["FIELDNX = 2", "FIELDNY = 5"],
        ..File::default()
    };
    let outside = cause(outside.read(&scratch));
    assert!(
        matches!(outside, DataError::OutsideField { sample: 1, .. }),
        "{outside}"
    );
    let dark = File {
        values: &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -1.0],
        ..File::default()
    };
    let dark = cause(dark.read(&scratch));
    assert!(
        matches!(dark, DataError::NonPositiveFlux { sample: 1, .. }),
        "{dark}"
    );
    for (card, hint) in [("OVERSAMP= 0", "oversampling"), ("CENX    = 7.0", "centre")] {
        let file = File {
            cards: &[card],
            ..File::default()
        };
        assert!(cause(file.read(&scratch)).to_string().contains(hint));
    }
}

#[test]
fn undefined_values_are_located() {
    let scratch = Scratch::new();
    let mut values = STAMPS;
    values[6] = f32::NAN;
    let file = File {
        values: &values,
        ..File::default()
    };
    assert_error(file.read(&scratch), IoErrorKind::Data, "HDU 0, pixel [1, 1, 0] (");
    let file = File {
        bytes: f64s(&[1.0, 2.0, 3.0, f64::NAN]),
        ..File::default()
    };
    let error = chain(&file.read(&scratch).unwrap_err());
    assert!(error.contains("row 1 (0-based), column \"Y\""), "{error}");
}

#[test]
fn keywords_of_the_wrong_type_and_missing_parts_are_named() {
    let scratch = Scratch::new();
    for (cards, keyword) in [
        (&["OVERSAMP= '4'"][..], "OVERSAMP"),
        (&["PIXCONV = 1"], "PIXCONV"),
        (&["CENX    ="], "CENX"),
        (&["FIELDNX = 0", "FIELDNY = 10"], "FIELDNX"),
        (&["FIELDNX = 10"], "FIELDNY"),
        (&["OVERSAMP= 0"], "OVERSAMP"),
        (&["CENX    = 99.0"], "CENX"),
        (&["CENY    = -9.0"], "CENY"),
        (&["STAMPINT= 'linear'"], "STAMPINT"),
        (&["FIELDNX = 999999999999", "FIELDNY = 999999999999"], "FIELDNX"),
    ] {
        let file = File {
            cards,
            ..File::default()
        };
        let error = file.read(&scratch).unwrap_err();
        let (hdu, keyword) = (0, keyword.to_owned());
        assert_eq!(error.place(), Some(&Place::Keyword { hdu, keyword }), "{error}");
    }
    let no_table = scratch.put("cube.fits", &image(SIMPLE, -32, &[2, 2, 2], &[], &f32s(&STAMPS)));
    assert!(
        read_samples(&no_table)
            .unwrap_err()
            .to_string()
            .contains("POSITIONS")
    );
    assert_eq!(detect(&no_table).unwrap(), FileKind::Cube);
    for (second, kind, part) in [
        (
            ("YY", "D"),
            IoErrorKind::Table,
            "column \"Y\": there is no such column",
        ),
        (("Y", "8A"), IoErrorKind::Table, "has the format"),
        (("Y", "E"), IoErrorKind::Header, "the columns do not add up"),
    ] {
        let columns = [("X", "D"), second];
        let file = File {
            columns: &columns,
            ..File::default()
        };
        assert_error(file.read(&scratch), kind, part);
    }
}

#[test]
fn states_come_back_bit_by_bit() {
    let scratch = Scratch::new();
    for kind in [
        StateKind::Wavelength,
        StateKind::Time,
        StateKind::Frame,
        StateKind::Spectrum,
    ] {
        let path = scratch.path(&format!("{kind}.fits"));
        let states = SampleStates::new(kind, &[0.9, 1.0 / 3.0, 0.9]).unwrap();
        let plain = samples();
        let at = plain.positions().as_slice().to_vec();
        let positions = SamplePositions::with_states(at, None, Some(states)).unwrap();
        let samples = PsfSamples::new(plain.stamps().to_owned(), positions, plain.grid()).unwrap();
        write_samples(&path, &samples, &[], Precision::Double, false).unwrap();
        assert_eq!(read_samples(&path).unwrap(), samples);
    }
}

/// A file of two samples, with a third column of doubles.
fn with_column(scratch: &Scratch, name: &str, unit: &str, values: [f64; 2]) -> Result<PsfSamples, IoError> {
    let bytes: Vec<f64> = values.iter().flat_map(|&v| [1.0, 2.0, v]).collect();
    let unit = format!("TUNIT3  = '{unit}'");
    let columns = [("X", "D"), ("Y", "D"), (name, "D")];
    let rows = table("POSITIONS", &columns, 2, &[&unit], &f64s(&bytes));
    let cube = image(SIMPLE, -32, &[2, 2, 2], &[], &f32s(&[1.0; 8]));
    read_samples(scratch.put("states.fits", &[cube, rows].concat()))
}

#[test]
fn wavelengths_have_any_unit_of_length_but_need_one() {
    let scratch = Scratch::new();
    for (unit, factor) in [("um", 1.0), ("nm", 1e-3), ("Angstrom", 1e-4), ("m", 1e6)] {
        let samples = with_column(&scratch, "WAVELENGTH", unit, [0.5 / factor, 0.75 / factor]).unwrap();
        let states = samples.positions().states().unwrap();
        for (found, expected) in states.values().iter().zip([0.5, 0.75]) {
            assert!((found - expected).abs() < 1e-15, "{unit}: {found}");
        }
    }
    let found = with_column(&scratch, "time", "min", [2.0, 1.0]).unwrap();
    assert_eq!(found.positions().states().unwrap().values(), [60.0, 120.0]);
    for (unit, part) in [("", "has no unit"), ("Hz", "has the unit \"Hz\"")] {
        let refused = with_column(&scratch, "WAVELENGTH", unit, [0.5, 0.6]);
        assert_error(refused, IoErrorKind::Table, part);
    }
    assert_error(
        with_column(&scratch, "WAVELENGTH", "um", [0.5, -0.6]),
        IoErrorKind::Data,
        "above 0",
    );
    let twice = with_column(&scratch, "FRAME", "", [3.0, 3.0]);
    assert_error(
        twice,
        IoErrorKind::Data,
        "share the position (1, 2) and the frame 3",
    );
}
