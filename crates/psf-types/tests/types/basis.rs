use ndarray::{Array2, Array3};
use psf_types::{DataError, Position, PsfBasis, SampleCoefficients, SamplePositions, StampGrid};

#[test]
fn only_orthonormal_stamps_make_a_basis() {
    let grid = StampGrid::new(2, 1).unwrap();
    let unit = Array3::from_shape_vec((2, 1, 2), vec![1.0, 0.0, 0.0, 1.0]).unwrap();
    let basis = PsfBasis::new(None, unit.clone(), grid).unwrap();
    assert_eq!(basis.rank(), 2);
    let mut skewed = unit;
    skewed[[1, 0, 0]] = 1e-3;
    assert!(matches!(
        PsfBasis::new(None, skewed, grid),
        Err(DataError::NotOrthonormal {
            first: 0,
            second: 1,
            ..
        })
    ));
    assert!(matches!(
        PsfBasis::new(None, Array3::zeros((0, 1, 2)), grid),
        Err(DataError::EmptyBasis)
    ));
    assert!(PsfBasis::new(Some(Array2::ones((1, 2))), Array3::zeros((0, 1, 2)), grid).is_ok());
}

#[test]
fn serde_cannot_bypass_the_check() {
    let text = r#"{"mean":null,"components":{"v":1,"dim":[1,1,2],"data":[1.0,0.0]},
        "grid":{"nx":2,"ny":1,"centre_x":1.0,"centre_y":0.0,"oversampling":1.0,"pixel_response_included":true}}"#;
    assert!(serde_json::from_str::<PsfBasis>(text).is_ok());
    assert!(serde_json::from_str::<PsfBasis>(&text.replace("[1.0,0.0]", "[1.0,0.1]")).is_err());
}

#[test]
fn rows_and_values_are_checked() {
    let one = SamplePositions::new(vec![Position::of_pixel(0, 0)], None).unwrap();
    assert!(SampleCoefficients::new(Array2::zeros((1, 0)), one.clone()).is_ok());
    assert!(matches!(
        SampleCoefficients::new(Array2::zeros((2, 1)), one.clone()),
        Err(DataError::CountMismatch {
            expected: 1,
            got: 2,
            ..
        })
    ));
    assert!(matches!(
        SampleCoefficients::new(Array2::from_elem((1, 1), f64::NAN), one),
        Err(DataError::NonFinite { .. })
    ));
}
