use ndarray::{Array3, Axis};
use psf_types::{DataError, FrameShape, Position, PsfSamples, SamplePositions, StampGrid};

fn two() -> SamplePositions {
    SamplePositions::new(vec![Position::of_pixel(0, 0), Position::of_pixel(1, 0)], None).unwrap()
}

#[test]
fn each_invariant_is_checked() {
    let grid = StampGrid::new(3, 2).unwrap();
    let make = |stamps: Array3<f64>| PsfSamples::new(stamps, two(), grid);
    assert!(make(Array3::ones((2, 2, 3))).is_ok());
    assert!(matches!(
        make(Array3::ones((3, 2, 3))),
        Err(DataError::CountMismatch {
            expected: 2,
            got: 3,
            ..
        })
    ));
    assert!(matches!(
        make(Array3::ones((2, 3, 2))),
        Err(DataError::StampShape { .. })
    ));
    let mut stamps = Array3::ones((2, 2, 3));
    stamps[[1, 0, 2]] = f64::INFINITY;
    assert!(matches!(make(stamps.clone()), Err(DataError::NonFinite { index, .. }) if index == [1, 0, 2]));
    stamps.index_axis_mut(Axis(0), 1).fill(0.0);
    assert!(matches!(
        make(stamps),
        Err(DataError::NonPositiveFlux { sample: 1, .. })
    ));
}

#[test]
fn unit_flux_counts_the_oversampling() {
    let grid = StampGrid::new(4, 4).unwrap().with_oversampling(2.0).unwrap();
    let samples = PsfSamples::new(Array3::from_elem((2, 4, 4), 3.0), two(), grid)
        .unwrap()
        .into_unit_flux();
    assert!((samples.flux(0) - 1.0).abs() < 1e-15);
    assert!((samples.stamp(0).sum() - 4.0).abs() < 1e-14);
}

fn at(x: f64, y: f64) -> Position {
    Position::new(x, y).unwrap()
}

#[test]
fn duplicates_are_named_also_across_the_two_zeros() {
    let error = SamplePositions::new(vec![at(0.0, 1.0), at(2.0, 2.0), at(-0.0, 1.0)], None).unwrap_err();
    assert!(
        matches!(
            error,
            DataError::DuplicatePosition {
                first: 0,
                second: 2,
                ..
            }
        ),
        "{error}"
    );
    assert!(SamplePositions::new(vec![at(1.0, 1.0), at(1.0 + 1e-9, 1.0)], None).is_ok());
}

#[test]
fn positions_off_the_field_are_named() {
    let field = FrameShape::new(10, 10).unwrap();
    // Grids of real libraries begin at 0 or end at n + 1 in pixels that count from 1.
    assert!(SamplePositions::new(vec![at(-1.0, -1.0), at(10.0, 10.0)], Some(field)).is_ok());
    let error = SamplePositions::new(vec![at(0.0, 0.0), at(10.6, 0.0)], Some(field)).unwrap_err();
    assert!(
        matches!(error, DataError::OutsideField { sample: 1, .. }),
        "{error}"
    );
}
