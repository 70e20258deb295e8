use ndarray::{Array2, s};
use psf_types::{DataError, Image, ImageView};

fn numbered() -> Array2<f64> {
    Array2::from_shape_fn((7, 5), |(y, x)| (10 * y + x) as f64)
}

#[test]
fn any_layout_shows_the_same_pixels() {
    let whole = numbered();
    for (pixels, borrowed) in [
        (whole.view(), true),
        (whole.slice(s![2..5, 1..4]), true),
        (whole.slice(s![..;2, ..]), true),
        (whole.slice(s![..;-1, ..]), true),
        (whole.slice(s![3..4, ..]), true),
        (whole.slice(s![.., 2..3]), true),
        (whole.slice(s![.., ..;2]), false),
        (whole.slice(s![.., ..;-1]), false),
        (whole.t(), false),
        (
            whole
                .row(3)
                .insert_axis(ndarray::Axis(0))
                .broadcast((4, 5))
                .unwrap(),
            true,
        ),
    ] {
        let view = ImageView::new(pixels).unwrap();
        assert_eq!(view.pixels(), pixels);
        assert_eq!(
            view.is_borrowed(),
            borrowed,
            "{:?} {:?}",
            pixels.dim(),
            pixels.strides()
        );
        assert!(view.pixels().outer_iter().all(|row| row.to_slice().is_some()));
    }
    let image = Image::new(whole.clone()).unwrap();
    assert_eq!(image.view().pixels(), whole);
}

#[test]
fn nothing_gets_by_that_is_no_number() {
    // Rows shorter and longer than one inner loop (1024 values), and rows that are not adjacent in
    // memory.
    for (ny, nx) in [(1, 1), (3, 1023), (2, 1025), (5, 700)] {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for (y, x) in [(0, 0), (ny - 1, nx - 1), (ny / 2, nx / 2)] {
                let mut pixels = Array2::from_elem((ny + 1, nx + 2), f32::MAX);
                pixels[[y, x]] = bad;
                for part in [pixels.view(), pixels.slice(s![..ny, ..nx])] {
                    match ImageView::new(part) {
                        Err(DataError::NonFinite { index, value, .. }) => {
                            assert_eq!(index, [y, x]);
                            assert!(!value.is_finite());
                        }
                        other => panic!("{bad} at ({x}, {y}) of {nx} x {ny}: {other:?}"),
                    }
                }
            }
        }
    }
    // A NaN next to the part that the view shows.
    let mut pixels = Array2::zeros((4, 6));
    pixels[[1, 5]] = f64::NAN;
    assert!(ImageView::new(pixels.slice(s![.., ..5])).is_ok());
    assert!(matches!(
        ImageView::new(pixels.slice(s![.., ..0])),
        Err(DataError::EmptyFrame { nx: 0, ny: 4 })
    ));
}
