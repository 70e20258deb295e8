//! Stamps with their centre in the middle.

use ndarray::{Array3, s};
use psf_types::{PsfSamples, StampGrid};

use crate::PsfieldError;

/// The same stamps on a grid of odd size whose middle is the centre, zeros around where need be: every convention about the
/// centre (`n / 2`, `(n - 1) / 2`) means the same pixel there.
///
/// # Errors
/// [`PsfieldError::Unholdable`] where the centre lies between pixels.
pub(super) fn with_centre_in_the_middle(
    samples: PsfSamples,
    format: &'static str,
) -> Result<PsfSamples, PsfieldError> {
    let grid = samples.grid();
    let Some((cx, cy)) = grid.whole_centre() else {
        return Err(PsfieldError::Unholdable {
            format,
            what: "stamps whose centre lies between pixels",
            remedy: "evaluate them on other pixels first (psfield evaluate --grid native)",
        });
    };
    let reach = |centre: usize, n: usize| centre.max(n - 1 - centre);
    let (rx, ry) = (reach(cx, grid.nx()), reach(cy, grid.ny()));
    let wide = StampGrid::new(2 * rx + 1, 2 * ry + 1)?
        .with_oversampling(grid.oversampling())?
        .with_pixel_response_included(grid.pixel_response_included())
        .with_interpolation(grid.interpolation());
    if wide == grid {
        return Ok(samples);
    }
    let mut stamps = Array3::zeros((samples.len(), wide.ny(), wide.nx()));
    let (x0, y0) = (rx - cx, ry - cy);
    stamps
        .slice_mut(s![.., y0..y0 + grid.ny(), x0..x0 + grid.nx()])
        .assign(&samples.stamps());
    Ok(PsfSamples::new(stamps, samples.positions().clone(), wide)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use psf_types::{Position, SamplePositions};

    fn samples(grid: StampGrid) -> PsfSamples {
        let positions = SamplePositions::new(vec![Position::of_pixel(0, 0)], None).unwrap();
        let stamps = Array3::from_shape_fn((1, grid.ny(), grid.nx()), |(_, y, x)| (10 * y + x + 1) as f64);
        PsfSamples::new(stamps, positions, grid).unwrap()
    }

    #[test]
    fn the_centre_keeps_its_value_and_moves_to_the_middle() {
        for (nx, ny, cx, cy) in [(4, 5, 2, 2), (3, 3, 0, 2), (1, 1, 0, 0), (4, 4, 1, 2)] {
            let grid = StampGrid::new(nx, ny)
                .unwrap()
                .with_centre(f64::from(cx), f64::from(cy))
                .unwrap();
            let wide = with_centre_in_the_middle(samples(grid), "it").unwrap();
            let (ny, nx) = wide.grid().dim();
            assert!(nx % 2 == 1 && ny % 2 == 1);
            assert_eq!(wide.stamps()[[0, ny / 2, nx / 2]], f64::from(10 * cy + cx + 1));
            assert_eq!(wide.stamps().sum(), samples(grid).stamps().sum());
            assert_eq!(wide.grid().whole_centre(), Some((nx / 2, ny / 2)));
        }
        let between = StampGrid::new(4, 4).unwrap().with_centre(1.5, 1.5).unwrap();
        assert!(matches!(
            with_centre_in_the_middle(samples(between), "it"),
            Err(PsfieldError::Unholdable { .. })
        ));
    }
}
