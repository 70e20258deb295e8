use std::sync::Arc;

use ndarray::{Array2, Array3, array, s};
use psf_types::{
    CoefficientField, DataError, FieldError, FrameShape, Interpolation, Normalisation, OutsidePolicy,
    PixelRegion, Position, PsfBasis, PsfModel, PsfModelRecord, SampleCoefficients, SamplePositions,
    StampGrid,
};

/// a_1 = x, a_2 = y.
#[derive(Debug)]
struct Plane;
impl CoefficientField for Plane {
    fn component_count(&self) -> usize {
        2
    }
    fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
        a.copy_from_slice(&[p.x(), p.y()]);
        Ok(())
    }
}

fn model(mean: Option<Array2<f64>>, normalisation: Normalisation) -> PsfModel {
    let components = Array3::from_shape_vec((2, 1, 3), vec![1.0, 0.0, 0.0, 0.0, 0.0, 1.0]).unwrap();
    let basis = PsfBasis::new(mean, components, StampGrid::new(3, 1).unwrap()).unwrap();
    PsfModel::new(&basis, Arc::new(Plane), normalisation, None).unwrap()
}

#[test]
fn the_psf_is_the_weighted_sum_of_the_stamps() {
    let p = Position::new(2.0, 5.0).unwrap();
    let keep = model(Some(array![[0.0, 1.0, 0.0]]), Normalisation::Keep)
        .psf_at(p)
        .unwrap();
    assert_eq!(keep.values(), array![[2.0, 1.0, 5.0]]);
    let unit = model(None, Normalisation::Unit).psf_at(p).unwrap();
    assert!((unit.values()[[0, 2]] - 5.0 / 7.0).abs() < 1e-15);
    let negative = model(None, Normalisation::Unit).psf_at(Position::new(1.0, -1.0).unwrap());
    assert!(matches!(negative, Err(FieldError::NonPositiveFlux { .. })));
}

#[test]
fn every_range_of_stamps_gives_the_same_planes() {
    let model = model(Some(array![[0.0, 1.0, 0.0]]), Normalisation::Keep);
    let region = PixelRegion::new(-1, 3, FrameShape::new(4, 2).unwrap());
    let mut all = Array3::from_elem((3, 2, 4), f64::NAN);
    model
        .coefficients_region_into(region, 0..3, all.view_mut())
        .unwrap();
    assert_eq!(all[[0, 1, 1]], 1.0);
    assert_eq!((all[[1, 1, 0]], all[[2, 1, 0]]), (-1.0, 4.0));
    for range in [0..1, 1..2, 0..2, 1..3, 2..3, 1..1] {
        let mut part = Array3::from_elem((range.len(), 2, 4), f64::NAN);
        model
            .coefficients_region_into(region, range.clone(), part.view_mut())
            .unwrap();
        assert_eq!(part, all.slice(s![range, .., ..]));
    }
}

#[test]
fn truncation_keeps_the_first_components() {
    // Each component has one pixel of 1, so that the components are orthonormal.
    let components = Array3::from_shape_fn((3, 2, 2), |(k, y, x)| f64::from(u8::from(2 * y + x == k)));
    let values = Array2::from_shape_fn((2, 3), |(sample, k)| (10 * sample + k) as f64);
    let positions = [(0, 0), (5, 0)].map(|(x, y)| Position::of_pixel(x, y));
    let positions = SamplePositions::new(positions.to_vec(), None).unwrap();
    let record = PsfModelRecord::new(
        PsfBasis::new(None, components, StampGrid::new(2, 2).unwrap()).unwrap(),
        SampleCoefficients::new(values, positions).unwrap(),
        Interpolation::Nearest,
        OutsidePolicy::Error,
        Normalisation::Keep,
    )
    .unwrap();
    let one = record.truncated(1).unwrap();
    assert_eq!(one.basis().rank(), 1);
    assert_eq!(
        one.basis().components(),
        record.basis().components().slice(s![..1, .., ..])
    );
    assert_eq!(
        one.coefficients().values(),
        record.coefficients().values().slice(s![.., ..1])
    );
    assert_eq!(one.outside(), OutsidePolicy::Error);
    assert_eq!(record.truncated(99).unwrap(), record);
    assert!(matches!(record.truncated(0), Err(DataError::EmptyBasis)));
}
