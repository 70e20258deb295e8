//! Any data are read back from a file bit by bit.

mod support;

use ndarray::{Array2, Array3};
use proptest::prelude::*;
use psf_io::{
    Precision, PsfexAxis, PsfexModel, PsfexPolynomial, read_catalog, read_model_file, read_psfex,
    read_samples, write_csv, write_model, write_psfex, write_samples,
};
use psf_types::{
    FrameShape, Interpolation, Normalisation, OutsidePolicy, Position, PsfBasis, PsfModelRecord, PsfSamples,
    SampleCoefficients, SamplePositions, StampGrid,
};
use support::Scratch;

/// Numbers of all magnitudes, including subnormal numbers and numbers of single precision.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -1.0..1.0_f64,
        1 => prop::num::f64::NORMAL.prop_filter("squares must be finite", |v| v.abs() < 1e100),
        1 => prop::num::f64::SUBNORMAL,
        1 => Just(-0.0),
    ]
}

fn numbers(count: usize) -> impl Strategy<Value = Vec<f64>> {
    prop::collection::vec(number(), count)
}

/// This number of distinct positions, with or without the size of the frame.
fn positions(count: usize) -> impl Strategy<Value = SamplePositions> {
    let frame = prop::option::of((5000_usize..100_000, 5000_usize..100_000));
    (prop::collection::vec(-0.4..0.4_f64, 2 * count), frame).prop_map(move |(offsets, frame)| {
        let of = |k: usize| {
            Position::new(3.0 * k as f64 + offsets[2 * k], offsets[2 * k + 1].abs() * 1e4).unwrap()
        };
        let frame = frame.map(|(nx, ny)| FrameShape::new(nx, ny).unwrap());
        SamplePositions::new((0..count).map(of).collect(), frame).unwrap()
    })
}

/// Stamps of `nx` by `ny` pixels, with a centre inside and any oversampling.
fn grid(nx: usize, ny: usize) -> impl Strategy<Value = StampGrid> {
    let centre = (0.0..nx as f64 - 0.999, 0.0..ny as f64 - 0.999);
    let names = prop::sample::select(vec!["cubic-spline", "lanczos3"]);
    (centre, 0.3..9.0_f64, any::<bool>(), names).prop_map(move |((x, y), oversampling, response, name)| {
        let grid = StampGrid::new(nx, ny).unwrap().with_centre(x, y).unwrap();
        let grid = grid.with_oversampling(oversampling).unwrap();
        grid.with_pixel_response_included(response)
            .with_interpolation(name.parse().unwrap())
    })
}

fn samples() -> impl Strategy<Value = PsfSamples> {
    (1_usize..6, 1_usize..8, 1_usize..8).prop_flat_map(|(count, ny, nx)| {
        (numbers(count * ny * nx), positions(count), grid(nx, ny)).prop_map(
            move |(values, positions, grid)| {
                let mut stamps = Array3::from_shape_vec((count, ny, nx), values).unwrap();
                for mut stamp in stamps.outer_iter_mut() {
                    // A PSF needs flux.
                    stamp[[0, 0]] = 1.0 + 2.0 * stamp.iter().map(|v| v.abs()).sum::<f64>();
                }
                PsfSamples::new(stamps, positions, grid).unwrap()
            },
        )
    })
}

/// A model whose components are single pixels, which are orthonormal.
fn record() -> impl Strategy<Value = PsfModelRecord> {
    const METHODS: [&str; 9] = [
        "auto",
        "delaunay",
        "natural-neighbour",
        "idw",
        "idw=3.7",
        "bilinear",
        "bicubic",
        "polynomial=4",
        "nearest",
    ];
    let choices = (
        prop::sample::select(METHODS.to_vec()),
        prop::sample::select(vec!["nearest", "extend", "error"]),
        prop::sample::select(vec!["unit", "keep"]),
        any::<bool>(),
    );
    let sizes = (1_usize..6, 2_usize..6, 2_usize..6, 1_usize..4);
    (sizes, choices).prop_flat_map(|((count, ny, nx, rank), (method, outside, unit, centred))| {
        let parts = (
            numbers(count * rank),
            numbers(ny * nx),
            positions(count),
            grid(nx, ny),
        );
        parts.prop_map(move |(values, mean, positions, grid)| {
            let mut components = Array3::zeros((rank, ny, nx));
            for k in 0..rank {
                components[[k, k / nx, k % nx]] = if k % 2 == 0 { 1.0 } else { -1.0 };
            }
            let mean = centred.then(|| Array2::from_shape_vec((ny, nx), mean).unwrap());
            let values = Array2::from_shape_vec((count, rank), values).unwrap();
            PsfModelRecord::new(
                PsfBasis::new(mean, components, grid).unwrap(),
                SampleCoefficients::new(values, positions).unwrap(),
                method.parse::<Interpolation>().unwrap(),
                outside.parse::<OutsidePolicy>().unwrap(),
                unit.parse::<Normalisation>().unwrap(),
            )
            .unwrap()
        })
    })
}

/// Planes in single precision, as in the file.
fn psfex() -> impl Strategy<Value = PsfexModel> {
    (0_usize..4, 1_usize..8, 1_usize..8).prop_flat_map(|(degree, ny, nx)| {
        let terms = PsfexPolynomial::term_count(degree);
        let values = prop::collection::vec(-1.0..1.0_f32, terms * ny * nx);
        (values, -1e4..1e4_f64, 0.1..1e4_f64, 0.2..3.0_f64).prop_map(
            move |(values, zero, scale, sampling)| {
                let values = values.into_iter().map(f64::from).collect();
                let axis = |name| PsfexAxis::new(name, zero.round(), scale).unwrap();
                let polynomial = PsfexPolynomial::new(axis("X_IMAGE"), axis("Y_IMAGE"), degree).unwrap();
                let planes = Array3::from_shape_vec((terms, ny, nx), values).unwrap();
                PsfexModel::new(planes, sampling, Some(polynomial)).unwrap()
            },
        )
    })
}

/// Compares bits, because `==` treats zeros of both signs as equal.
fn bits<'a>(values: impl IntoIterator<Item = &'a f64>) -> Vec<u64> {
    values.into_iter().map(|value| value.to_bits()).collect()
}

/// The position and the flux of a star.
fn star() -> impl Strategy<Value = [f64; 3]> {
    [number(), number(), number()].prop_filter("a flux is not 0", |star| star[2] != 0.0)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn samples_come_back(samples in samples()) {
        let scratch = Scratch::new();
        let path = scratch.path("samples.fits");
        write_samples(&path, &samples, &[], Precision::Double, false).unwrap();
        let read = read_samples(&path).unwrap();
        prop_assert_eq!(bits(read.stamps()), bits(samples.stamps()));
        prop_assert_eq!(read, samples);
    }

    #[test]
    fn models_come_back(record in record(), singular in prop::collection::vec(0.0..1e9_f64, 0..5)) {
        let scratch = Scratch::new();
        let path = scratch.path("model.fits");
        write_model(&path, &record, &singular, &[], false).unwrap();
        let read = read_model_file(&path).unwrap();
        prop_assert_eq!(bits(read.singular_values()), bits(&singular));
        prop_assert_eq!(bits(read.record().coefficients().values()), bits(record.coefficients().values()));
        prop_assert_eq!(read.into_record(), record);
    }

    #[test]
    fn psfex_models_come_back(model in psfex()) {
        let scratch = Scratch::new();
        let path = scratch.path("model.psf");
        write_psfex(&path, &model, &[], false).unwrap();
        let read = read_psfex(&path, None).unwrap();
        prop_assert_eq!(bits(read.planes()), bits(model.planes()));
        prop_assert_eq!(read, model);
    }

    #[test]
    fn catalogues_come_back(stars in prop::collection::vec(star(), 1..20)) {
        let scratch = Scratch::new();
        let path = scratch.path("stars.csv");
        let rows = stars.iter().map(|star| star.map(|value| value.to_string()));
        write_csv(&path, &["x", "y", "flux"], rows, false).unwrap();
        let read = read_catalog(&path).unwrap();
        prop_assert_eq!(read.len(), stars.len());
        for (read, [x, y, flux]) in read.iter().zip(&stars) {
            let position = read.position();
            prop_assert_eq!(bits(&[position.x(), position.y(), read.flux()]), bits([x, y, flux]));
        }
    }
}
