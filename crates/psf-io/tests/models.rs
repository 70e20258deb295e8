//! Reading and writing PSF models.

mod support;

use ndarray::{Array2, Array3};
use psf_io::{Card, FileKind, IoError, IoErrorKind, detect, read_model, read_model_file, write_model};
use psf_types::{
    FrameShape, Interpolation, Normalisation, OutsidePolicy, Position, PsfBasis, PsfModelRecord,
    SampleCoefficients, SamplePositions, SampleStates, StampGrid, StateKind,
};
use support::{Scratch, assert_error, chain, names};

/// A model whose numbers need every bit: two orthonormal stamps of 2 x 3, rotated by an angle.
fn model(rank: usize, centred: bool, field: Option<FrameShape>) -> PsfModelRecord {
    let grid = StampGrid::new(3, 2)
        .and_then(|g| g.with_centre(1.0 / 3.0, 0.7))
        .and_then(|g| g.with_oversampling(4.000_000_000_000_001))
        .unwrap();
    let (sine, cosine) = 0.3_f64.sin_cos();
    let turned = [[cosine, -sine], [sine, cosine]];
    let components = Array3::from_shape_fn(
        (rank, 2, 3),
        |(k, y, x)| if y == 1 && x < 2 { turned[k][x] } else { -0.0 },
    );
    let mean = centred.then(|| Array2::from_shape_fn((2, 3), |(y, x)| 1.0 / (3 + y + 2 * x) as f64));
    let basis = PsfBasis::new(mean, components, grid).unwrap();
    let at = |x, y| Position::new(x, y).unwrap();
    let positions =
        SamplePositions::new(vec![at(0.1, -0.0), at(7.0, 1.0 / 3.0), at(5e-324, 8.0)], field).unwrap();
    let values = Array2::from_shape_fn((3, rank), |(i, k)| {
        ((i + 1) as f64 / 7.0).powi(10 - 40 * k as i32)
    });
    PsfModelRecord::new(
        basis,
        SampleCoefficients::new(values, positions).unwrap(),
        Interpolation::InverseDistance { power: 2.1 + 1e-15 },
        OutsidePolicy::Extend,
        Normalisation::Keep,
    )
    .unwrap()
}

/// All numbers of a model as bits, because `==` treats -0.0 and 0.0 as equal.
fn bits(model: &PsfModelRecord) -> Vec<u64> {
    let (basis, coefficients) = (model.basis(), model.coefficients());
    let positions = coefficients
        .positions()
        .as_slice()
        .iter()
        .flat_map(|p| [p.x(), p.y()]);
    let mean = basis.mean();
    let mean = mean.iter().flatten().copied();
    let values = basis.components();
    let weights = coefficients.values();
    mean.chain(values.iter().copied())
        .chain(weights.iter().copied())
        .chain(positions)
        .map(f64::to_bits)
        .collect()
}

#[test]
fn models_come_back_bit_by_bit() {
    let scratch = Scratch::new();
    let field = FrameShape::new(9216, 9232).ok();
    for (rank, centred, field) in [
        (2, true, field),
        (1, true, None),
        (2, false, field),
        (0, true, None),
        (1, false, None),
    ] {
        let path = scratch.path("model.fits");
        let model = model(rank, centred, field).with_circle_error(centred.then_some(1e-4 / 3.0));
        let singular_values = [3.0, 1.0 / 3.0, 1e-17];
        let cards = [
            Card::new("PSFMODEL", 77, "not this").unwrap(),
            Card::history("psfield fit samples.fits"),
        ];
        write_model(&path, &model, &singular_values, &cards, true).unwrap();
        let file = read_model_file(&path).unwrap();
        assert_eq!(file.record(), &model, "rank {rank}, centred {centred}");
        assert_eq!(bits(file.record()), bits(&model));
        assert_eq!(file.singular_values(), singular_values);
        assert!(file.header().iter().any(|card| card == &cards[1]));
        assert_eq!(detect(&path).unwrap(), FileKind::PsfModel);
    }
}

#[test]
fn a_model_with_states_is_version_2_and_others_are_version_1() {
    let scratch = Scratch::new();
    let version = |path: &std::path::Path| psf_io::read_header(path).unwrap().get("PSFMODEL").cloned();
    let plain = model(2, true, None);
    let path = scratch.path("plain.fits");
    write_model(&path, &plain, &[], &[], false).unwrap();
    assert_eq!(
        version(&path),
        Some(Card::new("PSFMODEL", 1, "version of this layout").unwrap())
    );
    for (rank, kind) in [(2, StateKind::Wavelength), (0, StateKind::Frame)] {
        let one_state = model(rank, true, None);
        let states = SampleStates::new(kind, &[1.0 / 3.0, 2.0, 1.0 / 3.0]).unwrap();
        let at = one_state.coefficients().positions().as_slice().to_vec();
        let positions = SamplePositions::with_states(at, None, Some(states)).unwrap();
        let coefficients =
            SampleCoefficients::new(one_state.coefficients().values().to_owned(), positions).unwrap();
        let model = PsfModelRecord::new(
            one_state.basis().clone(),
            coefficients,
            Interpolation::Nearest,
            OutsidePolicy::Extend,
            Normalisation::Unit,
        )
        .unwrap();
        let path = scratch.path(&format!("{kind}.fits"));
        write_model(&path, &model, &[], &[], false).unwrap();
        assert_eq!(
            version(&path),
            Some(Card::new("PSFMODEL", 2, "version of this layout").unwrap())
        );
        assert_eq!(read_model(&path).unwrap(), model);
        assert_eq!(bits(&read_model(&path).unwrap()), bits(&model));
    }
}

#[test]
fn equal_models_give_equal_bytes() {
    let scratch = Scratch::new();
    let (a, b) = (scratch.path("a.fits"), scratch.path("b.fits"));
    for path in [&a, &b] {
        write_model(path, &model(2, true, None), &[], &[], false).unwrap();
    }
    assert_eq!(std::fs::read(&a).unwrap(), std::fs::read(&b).unwrap());
    assert!(read_model_file(&a).unwrap().singular_values().is_empty());
    let error = write_model(
        scratch.path("c.fits"),
        &model(2, true, None),
        &[1.0, f64::NAN],
        &[],
        false,
    );
    assert_error(
        error,
        IoErrorKind::Data,
        "row 1 (0-based), column \"S (singular values)\"",
    );
}

/// Reads a good file in which a part of the header is replaced by a text of equal length.
fn edited(from: &str, to: &str) -> IoError {
    assert_eq!(from.len(), to.len());
    let scratch = Scratch::new();
    let path = scratch.path("model.fits");
    write_model(&path, &model(2, true, None), &[], &[], false).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    let at = bytes
        .windows(from.len())
        .position(|w| w == from.as_bytes())
        .expect(from);
    bytes[at..at + from.len()].copy_from_slice(to.as_bytes());
    std::fs::write(&path, &bytes).unwrap();
    let error = read_model(&path).expect_err(to);
    assert!(names(&error, &path), "{error}");
    error
}

#[test]
fn errors_describe_the_defect_of_a_model() {
    let version = edited("PSFMODEL=                    1", "PSFMODEL=                    4");
    let newer = ": this is a psf-model file of version 4, but the newest version that this psfield reads is 3: update psfield if the file is newer";
    let refused = |error: IoError, kind, part| assert_error(Err::<(), _>(error), kind, part);
    refused(version, IoErrorKind::Format, newer);
    let missing = edited("PSFMODEL=", "PSFMODEX=");
    refused(
        missing,
        IoErrorKind::Header,
        "keyword PSFMODEL: the keyword is missing",
    );
    let method = edited("'idw=2.100000000000001'", "'nearest-but-one'      ");
    assert!(chain(&method).contains("nearest-but-one"), "{method}");
    refused(method, IoErrorKind::Data, "HDU 0, keyword INTERPOL: ");
    let policy = edited("OUTSIDE = 'extend  '", "OUTSIDE = 'wrap    '");
    refused(policy, IoErrorKind::Data, "HDU 0, keyword OUTSIDE: ");
    let rank = edited("NCOMP   =                    2", "NCOMP   =                    3");
    refused(rank, IoErrorKind::Axes, "a cube of NCOMP planes");
    let policy = edited("OUTSIDE = 'extend  '", "OUTSIDE =        3.0");
    refused(
        policy,
        IoErrorKind::Header,
        "keyword OUTSIDE: must be nearest, extend or error, got 3",
    );
    let centred = edited("CENTRED =                    T", "CENTRED =                    F");
    refused(centred, IoErrorKind::Axes, "a cube of NCOMP planes");
    let table = edited("'COEFFS  '", "'COEFFX  '");
    refused(table, IoErrorKind::Format, "the file has no binary table COEFFS");
    let column = edited("'A       '", "'B       '");
    refused(
        column,
        IoErrorKind::Table,
        "column \"A\": there is no such column",
    );
}
